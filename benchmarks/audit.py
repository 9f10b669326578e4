"""``run_audit``: good grasps and known faults through an audit: all found, none invented, and time.

Grasps are planned, written as a table and read again, as those of another tool are. The good ones
must pass, and of each fault a stage that is meant must fail (``benchmarks.faults``).
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import cycle, islice
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import ClassVar

from rich.table import Table

from benchmarks.faults import FAULTS, judged_with_fault, other_hand
from benchmarks.objects import BenchObject
from benchmarks.requests import check_tasks, loaded_hand
from benchmarks.run import ObjectJob, measure
from benchmarks.statistics import ratio
from planner.batch.pool import grasp_seed
from planner.errors import NotFoundError, PlannerError
from planner.exchange.audit.judge import Judge
from planner.exchange.formats import GivenGrasp, Reading, Writing
from planner.exchange.table import read_table, write_table
from planner.objects import parse_object
from planner.plan import GraspPlan
from planner.search import plan_grasp
from planner.shapes import shape_key
from planner.task import GraspTask
from sim.runner import Check, Runner
from sim.tables import Row, number, table_of


@dataclass(frozen=True, kw_only=True)
class _AuditJob(ObjectJob):
    """Grasps of one hand and object."""

    SHOWN: ClassVar = ("hand", "label")

    n: int
    faulty: int
    timed: int
    seed: int

    def lost(self, reason: str) -> Row:
        """The row of a cell that could not be judged."""
        return self.row(
            error=reason, planned=0, passed=0, reasons=[], faults={}, timed=0, cpu_s=0.0
        )


def _made(job: _AuditJob, check: Check) -> Row:
    hand = loaded_hand(job.hand)
    try:
        item = parse_object(job.spec)
        task = GraspTask.create(hand, item)
        plans: list[GraspPlan] = []
        for k in range(job.n):
            check()
            plans.append(plan_grasp(task, seed=grasp_seed(job.seed, shape_key(item.shape), k)))
    except PlannerError as error:
        return job.lost(str(error))
    grasps = _through_a_file(plans)
    judge = Judge(task)
    rows = [judge.row(grasp) for grasp in grasps]
    faults: dict[str, Row] = {}
    broken: list[GivenGrasp] = []
    for name, fault in FAULTS.items():
        if name == "wrong hand" and not _has_other(job.hand):
            continue
        found, firsts = 0, Counter[str]()
        for plan, grasp in list(zip(plans, grasps, strict=True))[: job.faulty]:
            check()
            row, noticed = judged_with_fault(name, plan.task, grasp)
            found += noticed and not row.passed
            firsts[row.first_fault or "passed"] += 1
            broken.append(fault.grasp(grasp, plan.task))
        faults[name] = {"made": sum(firsts.values()), "found": found, "first": dict(firsts)}
    mixed = list(islice(cycle([*grasps, *broken]), job.timed))
    begin = time.process_time()
    for grasp in mixed:
        judge.row(grasp)
        check()
    return job.row(
        error="",
        planned=len(plans),
        passed=sum(row.passed for row in rows),
        reasons=[row.reason for row in rows if not row.passed],
        faults=faults,
        timed=len(mixed),
        cpu_s=time.process_time() - begin,
    )


def _through_a_file(plans: Sequence[GraspPlan]) -> tuple[GivenGrasp, ...]:
    """Plans as a reader gives them."""
    with TemporaryDirectory() as folder:
        (path,) = write_table(plans, Path(folder) / "grasps.npz", Writing())
        return read_table(path, plans[0].task.hand, Reading()).grasps


def _has_other(hand: str) -> bool:
    try:
        other_hand(loaded_hand(hand))
    except NotFoundError:
        return False
    return True


def run_audit(
    hands: Sequence[str],
    objects: Sequence[BenchObject],
    n: int,
    *,
    faulty: int,
    timed: int,
    seed: int,
    runner: Runner,
) -> Row:
    """Plan n grasps of every hand and object, and judge them and their faults (``benchmarks``).

    Args:
        hands: Names or paths.
        objects: What to grasp.
        n: Good grasps for each hand and object.
        faulty: How many of them get each fault.
        timed: Grasps, good and faulty, whose verdict is timed for each hand and object.
        seed: Of the measurement.
        runner: Who works.
    """
    check_tasks(hands, objects)
    cells = [(hand, item) for hand in hands for item in objects]
    jobs = [
        _AuditJob(
            index=i,
            hand=hand,
            spec=item.spec,
            label=item.label,
            n=n,
            faulty=faulty,
            timed=timed,
            seed=seed,
        )
        for i, (hand, item) in enumerate(cells)
    ]
    return measure(
        runner,
        _made,
        jobs,
        kind="opposable-bench-audit",
        title="plan and judge",
        lost=_AuditJob.lost,
        seed=seed,
    )


def audit_tables(result: Row) -> list[Table | str]:
    """Good grasps that pass, faults that are found, and time."""
    table = table_of(
        "good grasps that pass; known faults that are found; CPU per verdict",
        ("hand", "object"),
        ("good pass", *FAULTS, "ms each"),
    )
    rows = [row for row in result["rows"] if not row["error"]]
    for row in rows:
        table.add_row(row["hand"], row["object"], *_cells([row]))
    table.add_section()
    table.add_row("all", "", *_cells(rows))
    refused = [f"{r['hand']} {r['object']}: {r['error']}" for r in result["rows"] if r["error"]]
    invented = [f"{r['hand']} {r['object']}: {text}" for r in rows for text in r["reasons"]]
    return [table, *refused, *invented]


def _cells(rows: Sequence[Row]) -> list[str]:
    def counted(name: str) -> str:
        faults = [row["faults"][name] for row in rows if name in row["faults"]]
        return f"{sum(f['found'] for f in faults)}/{sum(f['made'] for f in faults)}"

    each = ratio(sum(r["cpu_s"] for r in rows), sum(r["timed"] for r in rows))
    return [
        f"{sum(r['passed'] for r in rows)}/{sum(r['planned'] for r in rows)}",
        *(counted(name) for name in FAULTS),
        number(each, 1, 1e3),
    ]
