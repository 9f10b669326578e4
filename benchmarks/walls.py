"""``run_walls``: grasps of vessels and sheets with thin walls, planned, timed and executed.

Objects stand as they are used: in the stable pose whose z axis points up most.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

from rich.table import Table

from benchmarks.objects import BenchObject
from benchmarks.requests import check_tasks, loaded_hand
from benchmarks.run import ObjectJob, measure, stated
from benchmarks.statistics import ratio, summed
from planner.batch.pool import grasp_seed
from planner.errors import PlannerError
from planner.objects import parse_object
from planner.plan import GraspPlan
from planner.search import attempts
from planner.shapes import Mesh, Shape, shape_key
from planner.task import GraspTask
from sim.reality import Reality
from sim.runner import Check, Runner
from sim.tables import Row, grouped, number, percent, table_of
from sim.trial import simulate

WALLED = (
    "cup:0.035x0.09x0.001",
    "cup:0.03x0.1x0.002",
    "cup:0.04x0.08x0.003",
    "teacup:0.04x0.09x0.0015",
    "teacup:0.035x0.1x0.003",
    "mug",
    "bowl:0.06x0.055x0.002",
    "bowl:0.05x0.04x0.001",
)
"""Cups, mugs and bowls with walls of 1 to 4 mm."""

SOON = 1.0
"""CPU time (s) within which a request should be met, and after which it is given up."""


@dataclass(frozen=True, kw_only=True)
class _WallJob(ObjectJob):
    """A request: attempts until a grasp is found or its time is over, and a trial if asked."""

    SHOWN: ClassVar = ("hand", "label", "k")

    k: int
    seed: int
    execute: bool
    reality: Reality

    def lost(self, reason: str) -> Row:
        """The row of a request that could not be tried."""
        return self.row(
            error=reason,
            found=False,
            attempts=0,
            cpu_s=0.0,
            prepare_s=0.0,
            reasons={},
            held=None,
            fault="",
        )


def as_used(shape: Shape) -> int:
    """Number of the stable pose in which the object's z axis points up most."""
    up = [float(pose.rotation[2, 2]) for pose in shape.resting_poses()]
    return up.index(max(up))


def _made(job: _WallJob, check: Check) -> Row:
    hand = loaded_hand(job.hand)
    begin = time.process_time()
    try:
        item = parse_object(job.spec)
        pose = item.shape.resting_pose(index=as_used(item.shape))
        off = job.reality.encoder_offset if job.execute else 0.0
        task = GraspTask.create(hand, item, T_world_object=pose, table_height=0.0, joint_error=off)
        made = attempts(task, seed=grasp_seed(job.seed, shape_key(item.shape), job.k))
    except PlannerError as error:
        return job.lost(str(error))
    prepare_s = time.process_time() - begin
    reasons: Counter[str] = Counter()
    plan: GraspPlan | None = None
    cpu_s, tried = 0.0, 0
    for attempt in made:
        cpu_s, tried, plan = cpu_s + attempt.cpu_s, tried + 1, attempt.plan
        if attempt.failure is not None:
            reasons[attempt.failure.kind] += 1
        check()
        if plan is not None or cpu_s >= SOON:
            break
    plan = plan if cpu_s <= SOON else None
    report = None
    if job.execute and plan is not None:
        report = simulate(plan, reality=job.reality.seeded(job.k))
    return job.row(
        error="",
        found=plan is not None,
        attempts=tried,
        cpu_s=cpu_s,
        prepare_s=prepare_s,
        reasons=dict(reasons),
        held=None if report is None else report.success,
        fault="" if report is None or report.success else report.reason,
    )


def run_walls(
    hands: Sequence[str],
    objects: Sequence[BenchObject],
    n: int,
    trials: int,
    *,
    seed: int,
    runner: Runner,
    reality: Reality | None = None,
) -> Row:
    """Make n requests of every hand and object, and execute the first few (``benchmarks``).

    Args:
        hands: Names or paths.
        objects: What to grasp.
        n: Requests for each hand and object.
        trials: How many of them are executed too.
        seed: Of the measurement.
        runner: Who works.
        reality: Errors of sensors, drives and object in trials, drawn from the number of the
            request; none if None.
    """
    reality = reality or Reality()
    check_tasks(hands, objects)
    cells = [(hand, item, k) for hand in hands for item in objects for k in range(n)]
    jobs = [
        _WallJob(
            index=i,
            hand=hand,
            spec=item.spec,
            label=item.label,
            k=k,
            seed=seed,
            execute=k < trials,
            reality=reality,
        )
        for i, (hand, item, k) in enumerate(cells)
    ]
    return measure(
        runner,
        _made,
        jobs,
        kind="opposable-bench-walls",
        title="plan and execute",
        lost=_WallJob.lost,
        seed=seed,
        walls_mm={item.label: _wall_mm(item.spec) for item in objects},
        **stated(reality),
    )


def _wall_mm(spec: str) -> float | None:
    """Twice the volume by the area, mm: how thick the walls of a mesh are."""
    try:
        shape = parse_object(spec).shape
    except PlannerError:  # a file of a folder, whose rows say what is wrong
        return None
    return 1e3 * shape.wall_thickness if isinstance(shape, Mesh) else None


def walls_tables(result: Row) -> list[Table | str]:
    """Figures by hand and object, and why trials failed."""
    table = table_of(
        f"found within {SOON:g} s of CPU after preparation; found per CPU second; held in trials",
        ("hand", "object"),
        ("wall mm", "found", "tries", "found/s", "prepare s", "held"),
    )
    table.add_column("failed attempts by reason", overflow="fold")
    rows = [row for row in result["rows"] if not row["error"]]
    for (hand, item), members in grouped(rows, "hand", "object").items():
        table.add_row(hand, item, number(result["walls_mm"][item], 1), *_cells(members))
    table.add_section()
    for (hand,), members in grouped(rows, "hand").items():
        table.add_row(hand, "all", "", *_cells(members))
    faults = [f"{r['hand']} {r['object']} {r['k']}: {r['fault']}" for r in rows if r["fault"]]
    refused = {f"{r['object']}: {r['error']}": None for r in result["rows"] if r["error"]}
    return [table, *refused, *faults]


def _cells(rows: list[Row]) -> list[str]:
    found = sum(r["found"] for r in rows)
    tried = [r["held"] for r in rows if r["held"] is not None]
    reasons = summed(r["reasons"] for r in rows)
    return [
        f"{found}/{len(rows)} = {percent(found, len(rows), 0)}",
        number(ratio(sum(r["attempts"] for r in rows), found), 2),
        number(ratio(found, sum(r["cpu_s"] for r in rows)), 1),
        number(max(r["prepare_s"] for r in rows), 2),
        f"{sum(tried)}/{len(tried)}",
        ", ".join(f"{name} {count:g}" for name, count in reasons.items()),
    ]
