"""Grasp cups, mugs and bowls of thin walls: found within 1 s, rate, held.

Objects stand as they are used: in the stable pose whose z axis points up most. Where no fingers are
named, a search may spare one.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated

import typer

from benchmarks.bench import HandOptions, ObjectsOption
from benchmarks.common import cells_of, checked_hand, seed_of
from benchmarks.summary import counted, of, parts, ratio, share, summary
from planner.objects import parse_object
from planner.search.grasp import attempts
from planner.shapes import Mesh, Shape
from planner.task import GraspTask
from sim.cli.execution import error_model_of
from sim.cli.options import ErrorModelOption, FingersOption, names
from sim.tables import Row
from sim.trial import simulate

WALLED = (
    "cup:0.035x0.09x0.001,cup:0.03x0.1x0.002,cup:0.04x0.08x0.003,teacup:0.04x0.09x0.0015,"
    "teacup:0.035x0.1x0.003,mug,bowl:0.06x0.055x0.002,bowl:0.05x0.04x0.001"
)
"""Cups, mugs and bowls with walls of 1 to 4 mm."""

SOON = 1.0
"""CPU time (s) within which a request should be met, and after which it is given up."""


@dataclass(frozen=True, kw_only=True)
class Options(HandOptions):
    """Requests of every hand and object, of which the first few are executed."""

    objects: ObjectsOption = WALLED
    trials: Annotated[
        int, typer.Option(min=0, help="How many of them are executed in simulation.")
    ] = 2
    error_model: ErrorModelOption = "ideal"
    fingers: FingersOption = None


def cases(options: Options) -> Iterator[Row]:
    """Requests of every hand and object."""
    error_model = error_model_of(options.error_model)
    fingers = names(options.fingers) if options.fingers else None
    for cell in cells_of(options.hand_names, options.objects):
        for k in range(options.n):
            run = {"seed": options.seed, "execute": k < options.trials, "error_model": error_model}
            yield {**cell, "k": k, "fingers": fingers, **run}


def as_used(shape: Shape) -> int:
    """Number of the stable pose in which the object's z axis points up most."""
    up = [float(pose.rotation[2, 2]) for pose in shape.resting_poses()]
    return up.index(max(up))


def measure(case: Row) -> Row:
    """Attempts until a grasp is found or its time is over, and a trial if asked."""
    hand = checked_hand(case["hand"])
    begin = time.process_time()
    item = parse_object(case["spec"])
    shape = item.shape
    off = case["error_model"].encoder_offset if case["execute"] else 0.0
    task = GraspTask.create(
        hand,
        item,
        T_world_object=shape.resting_pose(index=as_used(shape)),
        table_height=0.0,
        fingers=case["fingers"],
        joint_error=off,
    )
    made = attempts(task, seed=seed_of(case["seed"], shape, case["k"]))
    prepare_s = time.process_time() - begin
    reasons: Counter[str] = Counter()
    cpu_s, tried, plan = 0.0, 0, None
    for attempt in made:
        cpu_s, tried, plan = cpu_s + attempt.cpu_s, tried + 1, attempt.plan
        if attempt.failure is not None:
            reasons[attempt.failure.kind] += 1
        if plan is not None or cpu_s >= SOON:
            break
    plan = plan if cpu_s <= SOON else None
    report = None
    if case["execute"] and plan is not None:
        report = simulate(plan, error_model=case["error_model"].seeded(case["k"]))
    return {
        # twice the volume by the area
        "wall_mm": 1e3 * shape.wall_thickness if isinstance(shape, Mesh) else None,
        "requested": 1,
        "found": plan is not None,
        "met": int(plan is not None),
        "spared": None if plan is None else len(plan.task.finger_names) < len(task.finger_names),
        "attempts": tried,
        "cpu_s": cpu_s,
        "prepare_s": prepare_s,
        "reasons": dict(reasons),
        "held": None if report is None else report.success,
        "fault": "" if report is None or report.success else report.reason,
    }


def tables(result: Row) -> Iterator[Row | str]:
    """Figures by hand and object, and why trials failed."""
    rows = [row for row in result["rows"] if not row["error"]]
    percent, wall = ratio("met", "requested", 0, 100.0), of("wall_mm", digits=1)
    yield summary(
        f"found within {SOON:g} s of CPU after preparation; found per CPU second; held in trials",
        rows,
        ("hand", "object"),
        {
            "wall mm": lambda frame: wall(frame) if frame["object"].nunique() == 1 else "",
            "found": lambda frame: f"{parts('met', 'requested')(frame)} = {percent(frame)} %",
            "tries": ratio("attempts", "met"),
            "found/s": ratio("met", "cpu_s", 1),
            "prepare s": of("prepare_s", "max"),
            "with a finger less": share("spared", known="spared"),
            "held": share("held", known="held"),
            "failed attempts by reason": counted("reasons"),
        },
        [(None, "all")],
    )
    yield from (f"{r['hand']} {r['object']} {r['k']}: {r['fault']}" for r in rows if r["fault"])
