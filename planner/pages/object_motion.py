"""``object_motion``: where the object is, and what touches it, along a planned trajectory.

A trajectory has joints and poses of the base alone. The object stands until the hand closes, then
goes along with the base, moves in the hand as the knots say, and stays where the hand opens.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby

import numpy as np

from planner.contacts import ContactSet
from planner.motion import Knot, MotionPlan
from planner.motion.gait import GaitPlan, Relocation, Stroke
from planner.motion.manipulation import ManipulationPlan
from planner.plan import JointTrajectory
from planner.spatial import SE3, minimum_jerk

__all__ = ["AnyMotion", "ObjectMotion", "object_motion"]

AnyMotion = MotionPlan | GaitPlan | ManipulationPlan
"""A plan of how an object moves in the hand, of either kind, or a whole manipulation."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ObjectMotion:
    """The object along a trajectory of m samples.

    Attributes:
        poses: T_world_object, m poses.
        contacts: In the object's frame; None while the hand does not hold it.
        knots: The nearest knot of a stroke; None elsewhere.
    """

    poses: tuple[SE3, ...]
    contacts: tuple[ContactSet | None, ...]
    knots: tuple[Knot | None, ...]


def object_motion(plan: AnyMotion, trajectory: JointTrajectory) -> ObjectMotion:
    """Follow the object along ``plan.joint_trajectory(...)``."""
    follower = _Follower(plan)
    first = 0
    for phase, members in groupby(trajectory.phases):
        count = len(list(members))
        follower.phase(phase, trajectory.T_world_base[first : first + count])
        first += count
    return ObjectMotion(
        poses=tuple(follower.poses),
        contacts=tuple(follower.contacts),
        knots=tuple(follower.knots),
    )


class _Follower:
    def __init__(self, plan: AnyMotion) -> None:
        self.motion = plan if isinstance(plan, MotionPlan) else plan.motion
        gait = plan.gait if isinstance(plan, ManipulationPlan) else plan
        phases = gait.phases if isinstance(gait, GaitPlan) else ()
        self.strokes = [p for p in phases if isinstance(p, Stroke)]
        self.relocations = [p for p in phases if isinstance(p, Relocation)]
        self.cycles = len(self.strokes)
        self.end = plan.final_parameter if isinstance(plan, ManipulationPlan) else 1.0
        self.T_base_world = self.motion.T_world_base.inverse()
        self.held = self.motion.grasp.contacts_in_object
        self.T_base_object = self.T_base_world * self.motion.grasp.task.T_world_object
        self.poses: list[SE3] = []
        self.contacts: list[ContactSet | None] = []
        self.knots: list[Knot | None] = []

    def phase(self, name: str, bases: Sequence[SE3]) -> None:
        """Append the samples of a phase."""
        kind, _, which = name.partition(" ")
        if kind in ("turn", "back", "stroke"):
            cycle = int(which) - 1 if kind == "stroke" else 0
            self._stroke(bases, cycle, backwards=kind == "back")
        elif kind == "regrasp":
            relocation = self.relocations.pop(0)
            self.T_base_object = self.T_base_world * relocation.T_world_object
            to_object = relocation.T_world_object.inverse()
            self._carried(bases, relocation.during.transformed(to_object))
            self.held = relocation.after.transformed(to_object)
        elif kind in ("approach", "close"):
            self._standing(self.motion.grasp.task.T_world_object, len(bases))
        elif kind in ("open", "retreat"):
            self._standing(self.poses[-1], len(bases))
        else:  # lift, carry, lower
            self._carried(bases, self.held)

    def _standing(self, pose: SE3, count: int) -> None:
        self.poses += [pose] * count
        self.contacts += [None] * count
        self.knots += [None] * count

    def _carried(self, bases: Sequence[SE3], contacts: ContactSet) -> None:
        self.poses += [base * self.T_base_object for base in bases]
        self.contacts += [contacts] * len(bases)
        self.knots += [None] * len(bases)

    def _stroke(self, bases: Sequence[SE3], cycle: int, *, backwards: bool) -> None:
        knots = self.strokes[cycle].knots if self.strokes else self.motion.knots
        is_last = cycle + 1 >= self.cycles
        shares = minimum_jerk(np.linspace(0.0, 1.0, len(bases) + 1)[1:])
        shares = (1.0 - shares if backwards else shares) * (self.end if is_last else 1.0)
        for base, share in zip(bases, shares.tolist(), strict=True):
            pose, knot = _between(knots, share)
            self.T_base_object = self.T_base_world * pose
            self.held = knot.contacts_in_object
            self.poses.append(base * self.T_base_object)
            self.contacts.append(self.held)
            self.knots.append(knot)


def _between(knots: Sequence[Knot], share: float) -> tuple[SE3, Knot]:
    """The object at a path parameter, along the screw between knots, and the nearest knot."""
    at = np.array([k.path_parameter for k in knots])
    i = int(np.clip(np.searchsorted(at, share, side="right") - 1, 0, len(at) - 2))
    part = float(np.clip((share - at[i]) / (at[i + 1] - at[i]), 0.0, 1.0))
    pose = SE3.Interpolate(knots[i].T_world_object, knots[i + 1].T_world_object, part)
    return pose, knots[i + (part > 0.5)]
