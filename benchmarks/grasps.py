"""Plan and execute hands x objects x seeds: how many are found, and how many hold."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np

from benchmarks.bench import HandOptions, ObjectsOption
from benchmarks.common import PRIMITIVES, Setting, cells_of, task_of
from benchmarks.summary import Columns, of, share, summary
from planner.errors import NoGraspFoundError, TaskError
from planner.motion.handover import plan_handover
from planner.search.grasp import plan_grasp
from planner.synthesis.problem import problems_for
from planner.task import GraspTask
from sim.cli.execution import error_model_of, physics_of
from sim.cli.options import (
    ControllerOption,
    ErrorModelOption,
    MassOption,
    PhysicsOption,
    SimMuOption,
    TypeOption,
    flag,
)
from sim.handover import hand_over
from sim.report import TrialReport
from sim.scene.carrier import Timeline
from sim.tables import Row
from sim.trial import simulate

CARRIED = Timeline(lift_height=0.2, hold=5.0, turn=np.deg2rad(45.0), tilt=np.deg2rad(20.0))
"""What is asked of an object between two hands; on arms without turn and tilt."""


@dataclass(frozen=True, kw_only=True)
class Options(HandOptions):
    """Seeds count from ``--seed``."""

    objects: ObjectsOption = PRIMITIVES
    sim_mu: SimMuOption = None
    physics: PhysicsOption = "ours"
    error_model: ErrorModelOption = "ideal"
    type: TypeOption = None
    mass: MassOption = None
    controller: ControllerOption = "feedforward"
    carry: Annotated[
        bool,
        flag(
            "--carry",
            "Lift by 0.2 m, turn by 45 degrees, tilt by 20 (not on arms), and hold for 5 s.",
        ),
    ] = False
    handover: Annotated[
        bool, flag("--handover", "The first of two hands hands each object to the second.")
    ] = False
    floating: Annotated[
        bool, flag("--floating", "No table: each object is held until it is lifted.")
    ] = False


def cases(options: Options) -> Iterator[Row]:
    """Seeds of every hand and object."""
    error_model = error_model_of(options.error_model)
    if options.handover and (options.carry or options.type or not error_model.ideal):
        raise TaskError("--handover goes without --carry, --type and --error-model; leave them out")
    setting = Setting(
        joint_error=error_model.encoder_offset,
        grasp_type=options.type,
        mass=options.mass,
        floating=options.floating,
    )
    physics = physics_of(options.physics, options.sim_mu)
    given = {
        "physics": physics,
        "timeline": CARRIED if options.carry else Timeline(),
        "handover": options.handover,
        "controller": options.controller,
    }
    for cell in cells_of(options.hand_names, options.objects):
        for seed in range(options.seed, options.seed + options.n):
            yield {**cell, "seed": seed, **given, "error_model": error_model, "setting": setting}


def measure(case: Row) -> Row:
    """Plan and execute one seed.

    CPU time (s) of planning without building the problem and of building it; largest movement of
    the object in the hand after the squeeze; planned against measured contact position and normal
    force, per finger.
    """
    task = task_of(case["hand"], case["spec"], case["setting"])
    if case["handover"]:
        return _handed_over(task, case)
    row: Row = {"build_s": problems_for(task).build_s, "found": False}
    try:
        plan = plan_grasp(task, seed=case["seed"])
    except NoGraspFoundError as error:
        cpu_s = sum(a.cpu_s for a in error.attempts)
        return row | {"attempts": len(error.attempts), "cpu_s": cpu_s, "reason": str(error)}
    error_model, timeline = case["error_model"].seeded(case["seed"]), case["timeline"]
    if task.hand.on_arm:
        timeline = replace(timeline, turn=0.0, tilt=0.0)
    report = simulate(
        plan,
        physics=case["physics"],
        error_model=error_model,
        timeline=timeline,
        controller=case["controller"],
    )
    row |= {"attempts": plan.record.attempts, "cpu_s": plan.record.cpu_s}
    return row | _told(report) | {"epsilon": plan.quality.epsilon}


def _handed_over(task: GraspTask, case: Row) -> Row:
    """The same of a handover; its CPU time is all of planning, with building."""
    begin = time.process_time()
    try:
        plan = plan_handover(task, seed=case["seed"])
    except NoGraspFoundError as error:
        row: Row = {"found": False, "attempts": len(error.attempts), "reason": str(error)}
        return row | {"cpu_s": time.process_time() - begin}
    handover = plan.handover
    assert handover is not None
    row = {"attempts": 1 + handover.take.record.attempt, "cpu_s": time.process_time() - begin}
    row["epsilon"] = handover.both.quality.epsilon
    return row | _told(hand_over(plan, physics=case["physics"]))


def _told(report: TrialReport) -> Row:
    """What a trial tells of a grasp that was found."""
    slip_mm, slip_deg = report.largest_slip
    off = report.comparison  # a finger that lost its contact has no error
    path = {}
    if report.path is not None:
        path = dict(zip(("path_mm", "path_deg", "tilt_deg"), report.path.largest, strict=True))
    return path | {
        "found": True,
        "held": report.success,
        "reason": report.reason,
        "slip_mm": slip_mm,
        "slip_deg": slip_deg,
        "off_mm": [c.position_error_mm for c in off if math.isfinite(c.position_error_mm)],
        "force_off": [c.force_error_percent for c in off if math.isfinite(c.force_error_percent)],
    }


def _columns(small: str, large: str) -> Columns:
    """How what should be small, and what should be large, is summed up."""
    return {
        "found": share("found"),
        "held": share("held", where="found"),
        "tries": of("attempts", small, 1),
        "CPU s": of("cpu_s", small, 3, where="found"),
        "slip mm": of("slip_mm", small, 2, where="held"),
        "slip deg": of("slip_deg", small, 2, where="held"),
        "path mm": of("path_mm", small, 2, where="held"),
        "path deg": of("path_deg", small, 2, where="held"),
        "off mm": of("off_mm", small, 2, where="held"),
        "force %": of("force_off", small, 1, where="held"),
        "epsilon": of("epsilon", large, 3, where="found"),
    }


def tables(result: Row) -> Iterator[Row]:
    """Medians per hand and object and over all, and the worst of all."""
    title = "medians; CPU without building; off: planned to measured contact; force: its error"
    rows = sorted(result["rows"], key=lambda r: (r["hand"], r["object"]))
    table = summary(
        title, rows, ("hand", "object"), _columns("median", "median"), [("all", "median")]
    )
    worst = summary(title, rows, ("hand",), _columns("max", "min"), [("all",)])
    table["rows"] += [["all", "worst", *cells[1:]] for cells in worst["rows"][-1:]]
    yield table
