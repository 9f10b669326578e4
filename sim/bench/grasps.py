"""``run_grasps``: plan and execute hands x objects x seeds.

Outcomes are kept as they come (``sim.bench.journal``).
"""

from __future__ import annotations

import math
import statistics
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from rich.table import Table

from planner.errors import NoGraspFoundError, PlannerError
from planner.plain import finite
from planner.search import plan_grasp
from planner.synthesis.problem_cache import problems_for
from sim.bench.journal import run_with_journal
from sim.bench.objects import BenchObject
from sim.bench.requests import Setting, check_tasks, task_for
from sim.bench.tables import table_of
from sim.physics import PhysicsOptions
from sim.runner import Check, Runner, made_with
from sim.trial import simulate

__all__ = ["Outcome", "Seed", "grasps_table", "plan_and_execute", "run_grasps"]

FORMAT = "opposable-bench-grasps"


@dataclass(frozen=True, kw_only=True)
class Seed:
    """One seed of a hand and an object, as it is sent to a worker.

    Attributes:
        index: Its number among all.
        hand: Name or path of the hand.
        spec: The object.
        label: What it is called.
        seed: Seed of planning.
        physics: How MuJoCo computes.
    """

    index: int
    hand: str
    spec: str
    label: str
    seed: int
    physics: PhysicsOptions


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """What became of a seed.

    Attributes:
        index: Its number among all.
        hand: The hand as it was asked for.
        object: What the object is called.
        seed: Seed.
        found: Whether a plan was found.
        attempts: Attempts made.
        cpu_s: CPU time of planning without building, s.
        build_s: Time of building the problems, s; 0 where they were at hand.
        epsilon: Of the planned contacts; None if not found.
        held: Whether the object was held.
        reason: Why not.
        slip_mm: Largest movement of the object in the hand after the squeeze.
        slip_deg: Largest turn.
        position_errors_mm: Planned against measured contact, per finger.
        force_errors_percent: The same for normal forces.
    """

    index: int
    hand: str
    object: str
    seed: int
    found: bool = False
    attempts: int = 0
    cpu_s: float = 0.0
    build_s: float = 0.0
    epsilon: float | None = None
    held: bool = False
    reason: str = ""
    slip_mm: float | None = None
    slip_deg: float | None = None
    position_errors_mm: tuple[float, ...] = ()
    force_errors_percent: tuple[float, ...] = ()


def plan_and_execute(seed: Seed, check: Check) -> dict[str, Any]:
    """The outcome of a seed, as plain data.

    Args:
        seed: Which.
        check: Called between attempts and after the trial; what it raises ends it.
    """
    task = task_for(seed.hand, seed.spec, Setting())
    if isinstance(task, str):
        return _outcome(seed, reason=task)
    build_s = problems_for(task).build_s
    try:
        plan = plan_grasp(task, seed=seed.seed, progress=lambda _: check())
    except PlannerError as error:
        made = error.attempts if isinstance(error, NoGraspFoundError) else ()
        return _outcome(
            seed,
            attempts=len(made),
            cpu_s=sum(a.cpu_s for a in made),
            build_s=build_s,
            reason=str(error),
        )
    report = simulate(plan, physics=seed.physics)
    check()
    slip_mm, slip_deg = report.largest_slip
    return _outcome(
        seed,
        found=True,
        attempts=plan.record.attempts,
        cpu_s=plan.record.cpu_s,
        build_s=build_s,
        epsilon=plan.quality.epsilon,
        held=report.success,
        reason=report.reason,
        slip_mm=finite(slip_mm),
        slip_deg=finite(slip_deg),
        position_errors_mm=_known(c.position_error_mm for c in report.comparison),
        force_errors_percent=_known(c.force_error_percent for c in report.comparison),
    )


def _given_up(seed: Seed, reason: str) -> dict[str, Any]:
    return _outcome(seed, reason=reason)


def _outcome(seed: Seed, **values: Any) -> dict[str, Any]:
    return asdict(
        Outcome(index=seed.index, hand=seed.hand, object=seed.label, seed=seed.seed, **values)
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
) -> dict[str, Any]:
    """Plan and execute the seeds that the file does not have yet.

    Args:
        hands: Names or paths.
        objects: The objects.
        seeds: Seeds for each hand and object, from 0.
        physics: How MuJoCo computes.
        file: Of the outcomes; made if it is not there.
        runner: Who works on them.

    Returns:
        Plain data: all outcomes that the file has then, and what they were made with.

    Raises:
        FileFormatError: The file is not one of these, or was begun with other arguments.
        PlannerError: A hand or an object that was named cannot be used.
    """
    check_tasks(hands, objects)
    cells = [(hand, item, seed) for hand in hands for item in objects for seed in range(seeds)]
    jobs = [
        Seed(index=k, hand=hand, spec=item.spec, label=item.label, seed=seed, physics=physics)
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
    outcomes, whole = run_with_journal(
        runner,
        plan_and_execute,
        jobs,
        file=file,
        asked=asked,
        title="plan and execute",
        given_up=_given_up,
    )
    return {
        "format": FORMAT,
        "version": 2,
        **made_with(),
        "mu_simulation": physics.mu,
        "physics": physics.to_dict(),
        "workers": runner.workers,
        "interrupted": not whole,
        "outcomes": sorted(outcomes, key=lambda o: (o["hand"], o["object"], o["seed"])),
    }


COLUMNS = ("found", "held", "tries", "CPU s", "slip mm", "slip deg", "off mm", "force %", "epsilon")


def grasps_table(result: dict[str, Any]) -> Table:
    """Medians per hand and object, over all, and the worst of all."""
    outcomes = [Outcome(**o) for o in result["outcomes"]]
    table = table_of(
        "medians; CPU without building; off: planned to measured contact; force: its error",
        ("hand", "object"),
        COLUMNS,
    )
    cells: dict[tuple[str, str], list[Outcome]] = {}
    for o in outcomes:
        cells.setdefault((o.hand, o.object), []).append(o)
    for (hand, object), members in cells.items():
        table.add_row(hand, object, *_row(members, statistics.median, statistics.median))
    table.add_section()
    table.add_row("all", "median", *_row(outcomes, statistics.median, statistics.median))
    table.add_row("all", "worst", *_row(outcomes, max, min))
    return table


def _row(
    members: list[Outcome], middle: Callable[..., float], low: Callable[..., float]
) -> list[str]:
    """Cells of one row; ``middle`` sums up what should be small, ``low`` what should be large."""
    found = [o for o in members if o.found]
    held = [o for o in found if o.held]

    def cell(values: list[float], digits: int, sum_up: Callable[..., float]) -> str:
        return f"{sum_up(values):.{digits}f}" if values else "-"

    return [
        f"{len(found)}/{len(members)}",
        f"{len(held)}/{len(found)}",
        cell([o.attempts for o in members], 1, middle),
        cell([o.cpu_s for o in found], 3, middle),
        cell([o.slip_mm for o in held if o.slip_mm is not None], 2, middle),
        cell([o.slip_deg for o in held if o.slip_deg is not None], 2, middle),
        cell([e for o in held for e in o.position_errors_mm], 2, middle),
        cell([e for o in held for e in o.force_errors_percent], 1, middle),
        cell([o.epsilon for o in found if o.epsilon is not None], 3, low),
    ]
