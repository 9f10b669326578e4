"""``SensorErrors``: how far an estimator trusts its senses. Each number is a standard deviation.

An estimator is told what data sheets and calibrations say: how large errors are, never what was
drawn of them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from planner.arrays import check_fields
from sim.reality import Reality

LEAST_CAMERA, LEAST_TURN = 2e-4, math.radians(0.2)
"""Least errors of a camera, m and rad, that an estimator believes: a better one would be believed
against the contacts, which give way by as much."""

LEAST_OFFSET = math.radians(0.3)
"""Least offset of a joint (rad) that an estimator allows for."""


@dataclass(frozen=True, kw_only=True)
class SensorErrors:
    """Errors that an estimator expects.

    Attributes:
        camera: White noise of a measured position, each axis, m.
        camera_turn: White noise of a measured rotation, each axis, rad.
        drift: Correlated noise of a measured position, m.
        drift_turn: Correlated noise of a measured rotation, rad.
        drift_time: Correlation time of what drifts, s.
        joint_offset: Constant offset of a joint, rad.
        joint_scale: Scale error of a joint (-).
        size: Error of all lengths of the object, as a share (-).
        sliding: White noise of a pad's sliding velocity, each axis, m/s.
        place: Correlated noise of where a pad feels a contact, each axis along the pad, m.
        touch_age: Largest age of what a pad says, s.
    """

    camera: float = 0.001
    camera_turn: float = math.radians(1.0)
    drift: float = 0.0
    drift_turn: float = 0.0
    drift_time: float = 1.0
    joint_offset: float = math.radians(1.0)
    joint_scale: float = 0.0
    size: float = 0.0
    sliding: float = 0.0
    place: float = 0.0
    touch_age: float = 0.0

    def __post_init__(self) -> None:
        """Check every number."""
        check_fields(self, what="sensor errors: ", least=0.0)

    @classmethod
    def of(cls, reality: Reality | None) -> SensorErrors:
        """What the data sheets of a reality say; those of no reality if None."""
        r = reality or Reality()
        return cls(
            camera=max(LEAST_CAMERA, math.hypot(r.pose_noise, r.pose_bias)),
            camera_turn=max(LEAST_TURN, math.hypot(r.turn_noise, r.turn_bias)),
            drift=r.pose_drift,
            drift_turn=r.turn_drift,
            drift_time=r.drift_time,
            joint_offset=max(LEAST_OFFSET, r.encoder_offset),
            joint_scale=r.encoder_scale,
            size=r.object_size / math.sqrt(3.0),
            sliding=r.sliding_noise,
            place=r.touch_place,
            touch_age=r.touch_delay + (1.0 / r.touch_rate if r.touch_rate else 0.0),
        )
