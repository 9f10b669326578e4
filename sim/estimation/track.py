"""``Track``: what was known at the last moments, so that a late look counts where it belongs.

A look is taken into account at the moment nearest to its time stamp, and everything after is
computed anew, with the Jacobians that are there: the result is that of a filter that had it in
time, to first order.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import pinocchio as pin

from planner.spatial import SE3
from sim.estimation.filter import Filtered, PoseFilter
from sim.estimation.moments import Look, Moment

KEPT = 0.4
"""How long (s) moments are kept: a look that is older when it arrives is not used."""


@dataclass(slots=True)
class _Node:
    """A moment, its estimate, and its estimate before any measured pose."""

    moment: Moment
    known: Filtered
    before: Filtered
    looks: list[Look] = field(default_factory=list)


class Track:
    """The last moments of one trial, in order."""

    def __init__(self, pose_filter: PoseFilter, moment: Moment, look: Look) -> None:
        """Begin with a moment at which the object was looked at."""
        self._filter = pose_filter
        known = pose_filter.first(look)
        self._nodes = [_Node(moment, known, known)]

    @property
    def known(self) -> Filtered:
        """What is known at the last moment."""
        return self._nodes[-1].known

    @property
    def last(self) -> Moment:
        """The last moment."""
        return self._nodes[-1].moment

    def go_on(self, moment: Moment) -> None:
        """Add a moment, later than the last."""
        known = self._filter.advanced(self.known, self.last, moment)
        self._nodes.append(_Node(moment, known, known))
        while self._nodes[1].moment.time < moment.time - KEPT:
            del self._nodes[0]

    def look(self, time: float, measured: SE3, number: int, period: float, *, world: bool) -> bool:
        """Take a measured pose into account; whether it was in time for that.

        Args:
            time: When it was measured, s.
            measured: Pose of the object in the world, or in the hand's base.
            number: Of this measurement, from 0.
            period: Time since the one before, s.
            world: Whether ``measured`` is in the world.
        """
        nodes = self._nodes
        if time < nodes[0].moment.time or time > nodes[-1].moment.time + 1e-9:
            return False
        i = max(k for k, node in enumerate(nodes) if node.moment.time <= time + 1e-9)
        here = nodes[i].moment
        pose = here.T_world_base.actInv(measured) if world else measured
        if i + 1 < len(nodes) and time > here.time + 1e-9:
            there = nodes[i + 1]
            share = (time - here.time) / (there.moment.time - here.time)
            base = SE3.Interpolate(here.T_world_base, there.moment.T_world_base, share)
            pose = base.actInv(measured) if world else measured
            motion = there.known.motion
            whole = 0.0 if motion is None else motion.displacement
            later = share >= 0.5
            rest = (1.0 - share) * whole if later else -share * whole
            pose = pin.exp6(pin.Motion(rest)) * pose
            i += int(later)
        look = Look(pose, number, period)
        nodes[i].looks.append(look)
        nodes[i].known = self._filter.looked(nodes[i].known, look)
        for before, node in zip(nodes[i:], nodes[i + 1 :], strict=False):
            known = self._filter.again(before.known, node.before)
            for seen in node.looks:
                known = self._filter.looked(known, seen)
            node.known = known
        return True
