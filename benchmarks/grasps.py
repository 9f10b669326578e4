"""``run_grasps``: plan and execute hands x objects x seeds."""

from __future__ import annotations

import math
import statistics
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

from rich.table import Table

from benchmarks.objects import BenchObject
from benchmarks.requests import Setting, check_tasks, task_for
from benchmarks.run import ObjectJob, measure, stated
from planner.errors import NoGraspFoundError, PlannerError
from planner.search import plan_grasp
from planner.synthesis.problem_cache import problems_for
from sim.physics import PhysicsOptions
from sim.reality import Reality
from sim.runner import Check, Runner
from sim.tables import Row, grouped, share, table_of
from sim.trial import simulate

FORMAT = "opposable-bench-grasps"


@dataclass(frozen=True, kw_only=True)
class GraspJob(ObjectJob):
    """One seed of a hand and an object.

    Attributes:
        seed: Seed of planning.
        physics: How MuJoCo computes.
        reality: Errors of sensors, drives and object; drawn from the seed.
    """

    SHOWN: ClassVar = ("hand", "label", "seed")
    NOTHING: ClassVar[Row] = {"found": False, "attempts": 0, "cpu_s": 0.0, "build_s": 0.0} | {
        "epsilon": None,
        "held": False,
        "reason": "",
        "slip_mm": None,
        "slip_deg": None,
        "position_errors_mm": (),
        "force_errors_percent": (),
    }
    """CPU time of planning without building the problem and of building it, s; planned epsilon;
    largest movement and turn of the object in the hand after the squeeze; planned against measured
    contact position and normal force, per finger."""

    seed: int
    physics: PhysicsOptions
    reality: Reality = field(default_factory=Reality)

    def row(self, **values: Any) -> Row:
        """The row: what is not given stands for a grasp that was not found."""
        return super().row(**{**self.NOTHING, **values})

    def lost(self, reason: str) -> Row:
        """The row of a seed that could not be tried."""
        return self.row(reason=reason)


def plan_and_execute(job: GraspJob, check: Check) -> Row:
    """Plan and execute one seed; ``check`` is called between attempts and may raise."""
    task = task_for(job.hand, job.spec, Setting(joint_error=job.reality.encoder_offset))
    if isinstance(task, str):
        return job.lost(task)
    build_s = problems_for(task).build_s
    try:
        plan = plan_grasp(task, seed=job.seed, progress=lambda _: check())
    except PlannerError as error:
        made = error.attempts if isinstance(error, NoGraspFoundError) else ()
        cpu_s = sum(a.cpu_s for a in made)
        return job.row(attempts=len(made), cpu_s=cpu_s, build_s=build_s, reason=str(error))
    report = simulate(plan, physics=job.physics, reality=job.reality.seeded(job.seed))
    check()
    slip_mm, slip_deg = report.largest_slip
    return job.row(
        found=True,
        attempts=plan.record.attempts,
        cpu_s=plan.record.cpu_s,
        build_s=build_s,
        epsilon=plan.quality.epsilon,
        held=report.success,
        reason=report.reason,
        slip_mm=slip_mm,
        slip_deg=slip_deg,
        position_errors_mm=_known(c.position_error_mm for c in report.comparison),
        force_errors_percent=_known(c.force_error_percent for c in report.comparison),
    )


def _known(values: Iterable[float]) -> tuple[float, ...]:
    """Without those that were not measured: a finger that lost its contact has no error."""
    return tuple(v for v in values if math.isfinite(v))


def run_grasps(
    hands: Sequence[str],
    objects: Sequence[BenchObject],
    seeds: int,
    *,
    physics: PhysicsOptions,
    file: Path,
    runner: Runner,
    reality: Reality | None = None,
) -> Row:
    """Plan and execute the seeds, from 0, that the file does not have yet (``benchmarks``)."""
    check_tasks(hands, objects)
    cells = [(hand, item, seed) for hand in hands for item in objects for seed in range(seeds)]
    reality = reality or Reality()
    jobs = [
        GraspJob(
            index=k,
            hand=hand,
            spec=item.spec,
            label=item.label,
            seed=seed,
            physics=physics,
            reality=reality,
        )
        for k, (hand, item, seed) in enumerate(cells)
    ]
    asked = {
        "format": f"{FORMAT}-outcomes",
        "version": 1,
        "hands": list(hands),
        "objects": [item.spec for item in objects],
        "seeds": seeds,
        "mu_simulation": physics.mu,
        "physics": {k: v for k, v in physics.to_dict().items() if k not in ("name", "mu")},
    }
    asked |= stated(reality)
    return measure(
        runner,
        plan_and_execute,
        jobs,
        kind=FORMAT,
        title="plan and execute",
        lost=GraspJob.lost,
        version=3,
        file=file,
        asked=asked,
        mu_simulation=physics.mu,
        physics=physics.to_dict(),
    )


COLUMNS = ("found", "held", "tries", "CPU s", "slip mm", "slip deg", "off mm", "force %", "epsilon")


def grasps_table(result: Row) -> Table:
    """Medians per hand and object, over all, and the worst of all."""
    title = "medians; CPU without building; off: planned to measured contact; force: its error"
    table = table_of(title, ("hand", "object"), COLUMNS)
    rows = sorted(result["rows"], key=lambda r: (r["hand"], r["object"]))
    for cell, members in grouped(rows, "hand", "object").items():
        table.add_row(*cell, *_cells(members, statistics.median, statistics.median))
    table.add_section()
    table.add_row("all", "median", *_cells(rows, statistics.median, statistics.median))
    table.add_row("all", "worst", *_cells(rows, max, min))
    return table


def _cells(rows: list[Row], small: Callable[..., float], large: Callable[..., float]) -> list[str]:
    """Cells of a line; ``small`` sums up what should be small, ``large`` what should be large."""
    found = [r for r in rows if r["found"]]
    held = [r for r in found if r["held"]]

    def cell(values: Iterable[float | None], digits: int, sum_up: Callable[..., float]) -> str:
        known = [v for v in values if v is not None]
        return f"{sum_up(known):.{digits}f}" if known else "-"

    return [
        share(r["found"] for r in rows),
        share(r["held"] for r in found),
        cell((r["attempts"] for r in rows), 1, small),
        cell((r["cpu_s"] for r in found), 3, small),
        cell((r["slip_mm"] for r in held), 2, small),
        cell((r["slip_deg"] for r in held), 2, small),
        cell((e for r in held for e in r["position_errors_mm"]), 2, small),
        cell((e for r in held for e in r["force_errors_percent"]), 1, small),
        cell((r["epsilon"] for r in found), 3, large),
    ]
