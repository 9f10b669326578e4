"""``Track``: what was known at the last samples; a late pose counts where it belongs.

A measurement is taken into account at the sample nearest to its time stamp, and everything after is
computed anew, with the Jacobians that are there: the result is that of a filter that had it in
time, to first order.

``LossDetector``: the moment at which an estimator no longer knows where the object is.

A pose counts as known while the believed errors stay below limits; with hysteresis, so that it
does not change to and fro.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
import pinocchio as pin

from planner.spatial import SE3, FloatArray
from sim.controllers import Event
from sim.sensing.estimation.filter import Filtered, PoseFilter
from sim.sensing.estimation.state import PoseMeasurement, SensorSample

LOST = (0.01, math.radians(15.0))
"""Believed errors, m and rad (root mean squares), beyond which a pose is not known."""

FOUND = 0.7
"""Share of these below which it is known again."""


class LossDetector:
    """Whether the pose is known.

    Attributes:
        known: Whether it is.
    """

    def __init__(self) -> None:
        """It is known, until it is not."""
        self.known = True
        self._events: list[Event] = []

    @property
    def events(self) -> tuple[Event, ...]:
        """What changed, in order."""
        return tuple(self._events)

    def update(self, time: float, covariance: FloatArray) -> bool:
        """Take over the covariance (6, 6) of a pose at a time (s); whether it is known."""
        diagonal = np.maximum(np.diagonal(covariance), 0.0)
        off, turned = math.sqrt(diagonal[:3].sum()), math.sqrt(diagonal[3:].sum())
        share = max(off / LOST[0], turned / LOST[1])
        if self.known != (share < (1.0 if self.known else FOUND)):
            self.known = not self.known
            detail = f"{1e3 * off:.1f} mm and {math.degrees(turned):.1f} degrees"
            self._events.append(
                Event(
                    time=time,
                    kind="pose known again" if self.known else "pose lost",
                    detail=f"believed to be off by {detail}",
                )
            )
        return self.known


KEPT = 0.4
"""How long (s) samples are kept: a measurement that is older when it arrives is not used."""


@dataclass(slots=True)
class _Node:
    """A sample, its estimate, and its estimate before any measured pose."""

    sample: SensorSample
    known: Filtered
    before: Filtered
    measurements: list[PoseMeasurement] = field(default_factory=list)


class Track:
    """The last samples of one trial, in order."""

    def __init__(
        self, pose_filter: PoseFilter, sample: SensorSample, measurement: PoseMeasurement
    ) -> None:
        """Begin with a sample, and the pose measured then."""
        self._filter = pose_filter
        known = pose_filter.first(measurement)
        self._nodes = [_Node(sample, known, known)]

    @property
    def known(self) -> Filtered:
        """What is known at the last sample."""
        return self._nodes[-1].known

    @property
    def last(self) -> SensorSample:
        """The last sample."""
        return self._nodes[-1].sample

    def go_on(self, sample: SensorSample) -> None:
        """Add a sample, later than the last."""
        known = self._filter.advanced(self.known, self.last, sample)
        self._nodes.append(_Node(sample, known, known))
        while self._nodes[1].sample.time < sample.time - KEPT:
            del self._nodes[0]

    def add_pose(
        self, time: float, measured: SE3, number: int, period: float, *, world: bool
    ) -> bool:
        """Take a measured pose into account; whether it was in time for that.

        Args:
            time: When it was measured, s.
            measured: Pose of the object in the world, or in the hand's base.
            number: Of this measurement, from 0.
            period: Time since the one before, s.
            world: Whether ``measured`` is in the world.
        """
        nodes = self._nodes
        if time < nodes[0].sample.time or time > nodes[-1].sample.time + 1e-9:
            return False
        i = max(k for k, node in enumerate(nodes) if node.sample.time <= time + 1e-9)
        here = nodes[i].sample
        pose = here.T_world_base.actInv(measured) if world else measured
        if i + 1 < len(nodes) and time > here.time + 1e-9:
            there = nodes[i + 1]
            share = (time - here.time) / (there.sample.time - here.time)
            base = SE3.Interpolate(here.T_world_base, there.sample.T_world_base, share)
            pose = base.actInv(measured) if world else measured
            motion = there.known.motion
            whole = 0.0 if motion is None else motion.displacement
            later = share >= 0.5
            rest = (1.0 - share) * whole if later else -share * whole
            pose = pin.exp6(pin.Motion(rest)) * pose
            i += int(later)
        measurement = PoseMeasurement(pose, number, period)
        nodes[i].measurements.append(measurement)
        nodes[i].known = self._filter.corrected_by_pose(nodes[i].known, measurement)
        for before, node in zip(nodes[i:], nodes[i + 1 :], strict=False):
            known = self._filter.recomputed(before.known, node.before)
            for seen in node.measurements:
                known = self._filter.corrected_by_pose(known, seen)
            node.known = known
        return True
