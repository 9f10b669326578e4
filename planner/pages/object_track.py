"""Where the object is, and who touches it, at every sample of a plan's joint trajectory.

A trajectory states joints and base alone. Object and contacts follow from the knots: the phases of
a trajectory go along a path by the minimum-jerk profile, and the hand carries what it holds.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from planner.contacts import ContactSet
from planner.motion.gait import GaitPlan, Relocation
from planner.motion.manipulation import ManipulationPlan
from planner.motion.plan import Knot, MotionPlan
from planner.plan import JointTrajectory
from planner.spatial import SE3, minimum_jerk

__all__ = ["Held", "MotionKind", "object_track"]

MotionKind: TypeAlias = MotionPlan | GaitPlan | ManipulationPlan


@dataclass(frozen=True, kw_only=True, eq=False)
class Held:
    """The object at one sample.

    Attributes:
        T_world_object: Its pose.
        contacts: The planned contacts in its frame, with their forces; None before the hand holds
            it and after.
        knot: The knot whose contacts these are; None during a relocation and off the path.
    """

    T_world_object: SE3
    contacts: ContactSet | None
    knot: Knot | None


Course: TypeAlias = Callable[[float], Held]
"""Progress in a phase, 0 to 1 -> the object, as if the base stood where the grasp has it."""


def object_track(plan: MotionKind, trajectory: JointTrajectory) -> tuple[Held, ...]:
    """The object at every sample of ``plan.joint_trajectory()``."""
    motion = plan if isinstance(plan, MotionPlan) else plan.motion
    courses = _courses(plan)
    first = motion.knots[0]
    start = Held(T_world_object=first.T_world_object, contacts=None, knot=None)
    out: list[Held] = []
    now = _at_knot(first)
    T_base_world = motion.T_world_base.inverse()
    for begin, end in _runs(trajectory.phases):
        phase = trajectory.phases[begin]
        for i in range(begin, end):
            if phase in ("approach", "close"):
                out.append(now if i + 1 == len(trajectory.phases) else start)
                continue
            if phase in ("open", "retreat"):
                out.append(Held(T_world_object=out[-1].T_world_object, contacts=None, knot=None))
                continue
            if courses and phase == courses[0][0]:
                share = minimum_jerk(np.array([(i + 1 - begin) / (end - begin)]))[0]
                now = courses[0][1](float(share))
            carried = trajectory.T_world_base[i] * T_base_world
            out.append(
                Held(
                    T_world_object=carried * now.T_world_object,
                    contacts=now.contacts,
                    knot=now.knot,
                )
            )
        if courses and phase == courses[0][0]:
            courses.pop(0)
    return tuple(out)


def _runs(phases: tuple[str, ...]) -> list[tuple[int, int]]:
    """First sample and end of each stretch of one phase."""
    starts = [i for i in range(len(phases)) if i == 0 or phases[i] != phases[i - 1]]
    return list(zip(starts, [*starts[1:], len(phases)], strict=True))


def _courses(plan: MotionKind) -> list[tuple[str, Course]]:
    """The phases in which the object moves in the hand, by name, in their order."""
    if isinstance(plan, MotionPlan):
        return [("turn", _along(plan.knots, 1.0))]
    if isinstance(plan, GaitPlan):
        return _gait(plan, 1.0)
    end = plan.final_parameter
    if plan.gait is not None:
        return _gait(plan.gait, end)
    forth = _along(plan.motion.knots, end)
    return [("turn", forth), ("back", lambda share: forth(1.0 - share))]


def _gait(gait: GaitPlan, last: float) -> list[tuple[str, Course]]:
    out: list[tuple[str, Course]] = []
    for phase in gait.phases:
        if isinstance(phase, Relocation):
            out.append((f"regrasp {phase.finger}", _still(phase)))
        else:
            until = last if phase.cycle == gait.cycles - 1 else 1.0
            out.append((f"stroke {phase.cycle + 1}", _along(phase.knots, until)))
    return out


def _at_knot(knot: Knot) -> Held:
    return Held(T_world_object=knot.T_world_object, contacts=knot.contacts_in_object, knot=knot)


def _along(knots: tuple[Knot, ...], until: float) -> Course:
    """Along knots up to a path parameter; contacts are those of the knot before."""
    at = np.array([k.path_parameter for k in knots])
    held = [_at_knot(k) for k in knots]

    def course(share: float) -> Held:
        s = share * until
        i = int(np.clip(np.searchsorted(at, s + 1e-9, side="right") - 1, 0, len(at) - 1))
        j = min(i + 1, len(at) - 1)
        part = 0.0 if i == j else float(np.clip((s - at[i]) / (at[j] - at[i]), 0.0, 1.0))
        pose = SE3.Interpolate(knots[i].T_world_object, knots[j].T_world_object, part)
        return Held(T_world_object=pose, contacts=held[i].contacts, knot=knots[i])

    return course


def _still(relocation: Relocation) -> Course:
    """The object held still by the other fingers, until the last one has landed."""
    back = relocation.T_world_object.inverse()
    during, after = (c.transformed(back) for c in (relocation.during, relocation.after))

    def course(share: float) -> Held:
        contacts = during if share < 1.0 else after
        return Held(T_world_object=relocation.T_world_object, contacts=contacts, knot=None)

    return course
