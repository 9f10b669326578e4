"""``Sensing`` and ``Senses``: what a controller gets to know, with noise and delay.

The object's pose in the palm is measured with white noise, and late: what arrives is the pose of a
moment ago relative to where the palm was at that moment. Pads measure force and sliding
with white noise. Joints are known exactly and at once. The same seed gives the same noise.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, fields, replace

import numpy as np
import pinocchio as pin

from planner.errors import TaskError
from planner.spatial import SE3, FloatArray
from sim.controllers.base import Observation
from sim.controllers.pads import PadReading

__all__ = ["TIME_TOL", "Senses", "Sensing"]

TIME_TOL = 1e-9
"""Times that differ by less (s) are the same: rounding of sums of time steps."""


@dataclass(frozen=True, kw_only=True)
class Sensing:
    """How well the object is known. Without arguments: exactly and at once.

    Attributes:
        pose_noise: Standard deviation of the measured position, each axis, m.
        turn_noise: Standard deviation of the measured rotation, each axis, rad.
        pose_delay: Age of a pose when it arrives, s.
        force_noise: Standard deviation of a pad's force, each axis, N.
        sliding_noise: Standard deviation of a pad's sliding velocity, each axis, m/s.
        seed: Of the noise.
    """

    pose_noise: float = 0.0
    turn_noise: float = 0.0
    pose_delay: float = 0.0
    force_noise: float = 0.0
    sliding_noise: float = 0.0
    seed: int = 0

    def __post_init__(self) -> None:
        """Check every number."""
        for field in fields(self):
            value = getattr(self, field.name)
            if not (np.isfinite(value) and value >= 0):
                raise TaskError(f"sensing: {field.name} is {value}; give a finite number >= 0")


class Senses:
    """Turns exact observations into measurements; call each method once a time step."""

    def __init__(self, sensing: Sensing) -> None:
        """Start the noise and an empty memory of poses."""
        self._sensing = sensing
        pose_seed, pad_seed = np.random.SeedSequence(sensing.seed).spawn(2)
        self._pose_rng = np.random.default_rng(pose_seed)
        self._pad_rng = np.random.default_rng(pad_seed)
        self._poses: deque[tuple[float, SE3]] = deque()

    def pose(self, time: float, exact: SE3) -> SE3:
        """T_palm_object as it is known now, from how it is; at first the oldest there is."""
        s, measured = self._sensing, exact
        if s.turn_noise > 0 or s.pose_noise > 0:
            noise = self._pose_rng.standard_normal(6)
            turn = pin.exp3(s.turn_noise * noise[3:])
            measured = SE3(turn @ exact.rotation, exact.translation + s.pose_noise * noise[:3])
        self._poses.append((time, measured))
        due = time - s.pose_delay + TIME_TOL
        while len(self._poses) > 1 and self._poses[1][0] <= due:
            self._poses.popleft()
        return self._poses[0][1]

    def pads(self, observation: Observation) -> PadReading:
        """What the pads say; a pad without contact says so without noise."""
        s, exact = self._sensing, observation.pads
        if s.force_noise == 0.0 and s.sliding_noise == 0.0:
            return exact
        noise = self._pad_rng.standard_normal((2, len(exact.normal_force), 3))
        touching = exact.normal_force > 0
        error = s.force_noise * noise[0] * touching[:, None]
        normal = np.nan_to_num(exact.normal)
        return replace(
            exact,
            normal_force=np.maximum(exact.normal_force + _along(error, normal), 0.0),
            force=exact.force + error,
            sliding=exact.sliding + s.sliding_noise * _tangential(noise[1], normal),
        )


def _along(vectors: FloatArray, normal: FloatArray) -> FloatArray:
    return np.asarray((vectors * normal).sum(axis=1))


def _tangential(vectors: FloatArray, normal: FloatArray) -> FloatArray:
    return np.asarray(vectors - _along(vectors, normal)[:, None] * normal)
