"""What tests of manipulations share: short durations, tasks, objects that follow a reference."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pinocchio as pin
from brief import COARSE

from planner.hands.hand import Hand
from planner.motion import MotionPlan
from planner.motion.manipulation import ManipulationPlan, manipulation_task, plan_manipulation
from planner.objects import parse_object
from planner.spatial import SE3, FloatArray
from planner.task import GraspTask
from sim.controllers import Target
from sim.controllers.follow import MotionReference
from sim.manipulation import ManipulationReport, ManipulationTimeline, manipulate

UP = np.array([0.0, 0.0, 1.0])
DT = 0.002

QUICK = ManipulationTimeline(
    approach=0.4,
    close=0.3,
    squeeze=0.3,
    verify=0.1,
    lift=0.4,
    hold=0.2,
    carry=0.5,
    lower=0.4,
    open=0.3,
    retreat=0.4,
    height=0.03,
)


def task_of(
    spec: str,
    hand: Hand | str = "allegro_hand",
    *,
    mass: float | None = None,
    mu: float = 0.45,
    fingers: Sequence[str] | None = None,
) -> GraspTask:
    """The task of manipulating an object."""
    return manipulation_task(hand, parse_object(spec, mass=mass), mu=mu, fingers=fingers)


@cache
def turned_cylinder() -> ManipulationPlan:
    """A turn of a cylinder by 25 degrees in one stroke; planned once. Change none of its arrays."""
    task = task_of("cylinder:0.03x0.08", mass=0.1)
    return plan_manipulation(task, angle=math.radians(25.0), place=(0.04, -0.02))


@cache
def turned_cylinder_report() -> ManipulationReport:
    """What comes of it, in short phases, steps of 4 ms; made once. Change none of its arrays."""
    return manipulate(turned_cylinder(), timeline=QUICK, physics=COARSE)


def first_in_palm(motion: MotionPlan) -> SE3:
    """T_palm_object where a motion begins."""
    return motion.grasp.T_world_palm.inverse() * motion.knots[0].T_world_object


def follow(
    motion: MotionPlan,
    reference: MotionReference,
    turn: Callable[[MotionReference], float] | None = None,
    *,
    begin: SE3 | None = None,
    steps: int | None = None,
    tips: FloatArray | None = None,
    missed: float = 0.0,
    heard: Callable[[Target], None] | None = None,
) -> Target:
    """An object that turns about the axis of a reference, as far as ``turn`` says.

    Args:
        motion: What is followed.
        reference: What leads.
        turn: How far the object has come, rad; as far as the reference is if None.
        begin: T_palm_object at first; that of the motion if None.
        steps: Time steps; until the reference has arrived if None.
        tips: Pads (n, 3), palm; at the origin if None.
        missed: Share of the wrench that cannot be had.
        heard: Called with every target.

    Returns:
        The last target.
    """
    begin = first_in_palm(motion) if begin is None else begin
    tips = np.zeros((len(motion.grasp.task.fingers), 3)) if tips is None else tips
    made = 0
    while True:
        come = reference.place * motion.path.angle if turn is None else turn(reference)
        pose = SE3(pin.exp3(come * reference.axis) @ begin.rotation, begin.translation)
        target = reference.advance(DT, pose, tips, motion.knots[0].q, missed=missed)
        made += 1
        if heard is not None:
            heard(target)
        if made == steps or (steps is None and reference.arrived):
            return target


def phases_of(report: ManipulationReport) -> list[tuple[str, str]]:
    """Phases that were run, and what each was about."""
    return [(r.phase, r.about) for r in report.results]


def with_log(report: ManipulationReport, **channels: Any) -> ManipulationReport:
    """The report with other channels."""
    return replace(report, log=replace(report.log, **channels))
