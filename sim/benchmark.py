"""Plan and execute hands x objects x seeds: behind ``opposable bench grasps``."""

from __future__ import annotations

import math
import platform
import statistics
from collections.abc import Callable, Iterable
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict, dataclass
from functools import lru_cache
from importlib.metadata import version
from typing import Any, Literal

from rich import box
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TimeElapsedColumn
from rich.table import Table

from planner.errors import NoGraspFoundError, TaskError
from planner.hand import Hand
from planner.objects import parse_object
from planner.search import plan_grasp
from planner.synthesis.problems import problems_for
from planner.task import GraspTask
from sim.scene import PhysicsOptions
from sim.trial import simulate

__all__ = ["Outcome", "bench_table", "run_benchmark"]


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """One seed of one cell.

    Attributes:
        hand: Name of the hand.
        object: The object as it was asked for.
        seed: Seed.
        found: Whether a plan was found.
        attempts: Attempts made.
        cpu_s: CPU time of planning without building, s.
        build_s: Time of building the NLPs, s; 0 where they were at hand.
        epsilon: Of the planned contacts; None if not found.
        held: Whether the object was held.
        reason: Why not.
        slip_mm: Largest movement of the object in the hand after the squeeze.
        slip_deg: Largest turn.
        position_errors_mm: Planned against measured contact, per finger.
        force_errors_percent: The same for normal forces.
    """

    hand: str
    object: str
    seed: int
    found: bool
    attempts: int
    cpu_s: float
    build_s: float
    epsilon: float | None = None
    held: bool = False
    reason: str = ""
    slip_mm: float | None = None
    slip_deg: float | None = None
    position_errors_mm: tuple[float, ...] = ()
    force_errors_percent: tuple[float, ...] = ()


@lru_cache(maxsize=32)
def _task(hand: str, object: str) -> GraspTask:
    """One task for all seeds of a cell: meshes and their fields are read once."""
    return GraspTask.create(_hand(hand), parse_object(object))


@lru_cache(maxsize=16)
def _hand(name: str) -> Hand:
    return Hand.load(name)


def _one(hand: str, object: str, seed: int, mu: float) -> Outcome:
    task = _task(hand, object)
    name = object
    build_s = problems_for(task).build_s
    try:
        plan = plan_grasp(task, seed=seed)
    except (NoGraspFoundError, TaskError) as error:
        made = error.attempts if isinstance(error, NoGraspFoundError) else ()
        return Outcome(
            hand=hand,
            object=name,
            seed=seed,
            found=False,
            attempts=len(made),
            cpu_s=sum(a.cpu_s for a in made),
            build_s=build_s,
            reason=str(error),
        )
    report = simulate(plan, physics=PhysicsOptions(mu=mu))
    slip_mm, slip_deg = report.largest_slip
    return Outcome(
        hand=hand,
        object=name,
        seed=seed,
        found=True,
        attempts=plan.record.attempts,
        cpu_s=plan.record.cpu_s,
        build_s=build_s,
        epsilon=plan.quality.epsilon,
        held=report.success,
        reason=report.reason,
        slip_mm=slip_mm if math.isfinite(slip_mm) else None,
        slip_deg=slip_deg if math.isfinite(slip_deg) else None,
        position_errors_mm=_known(c.position_error_mm for c in report.comparison),
        force_errors_percent=_known(c.force_error_percent for c in report.comparison),
    )


def _known(values: Iterable[float]) -> tuple[float, ...]:
    """Without those that were not measured: a finger that lost its contact has no error."""
    return tuple(v for v in values if math.isfinite(v))


def run_benchmark(
    hands: Iterable[str],
    objects: Iterable[str],
    seeds: Iterable[int],
    *,
    mu: float,
    workers: int,
    console: Console,
) -> dict[str, Any]:
    """Run every cell; Ctrl-C keeps what is finished.

    Args:
        hands: Hand names.
        objects: Object specifications.
        seeds: Seeds per cell.
        mu: Sliding friction in simulation (-).
        workers: Processes.
        console: Where the progress bar goes.

    Returns:
        Plain data: the outcomes, and what they were made with.
    """
    objects, seeds = list(objects), list(seeds)
    jobs = [(h, o, s) for h in hands for o in objects for s in seeds]
    for hand in dict.fromkeys(h for h, _, _ in jobs):
        for object in objects:
            _task(hand, object)  # bad input ends here, not after minutes
    outcomes: list[Outcome] = []
    interrupted = False
    columns = ("{task.description}", BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, console=console) as progress:
        bar = progress.add_task("plan and execute", total=len(jobs))
        try:
            if workers == 1:
                for job in jobs:
                    outcomes.append(_one(*job, mu))
                    progress.advance(bar)
            else:
                with ProcessPoolExecutor(workers) as pool:
                    futures = [pool.submit(_one, *job, mu) for job in jobs]
                    for future in as_completed(futures):
                        outcomes.append(future.result())
                        progress.advance(bar)
        except KeyboardInterrupt:
            interrupted = True
    outcomes.sort(key=lambda o: (o.hand, o.object, o.seed))
    return {
        "format": "opposable-bench-grasps",
        "version": 1,
        "written_by": f"opposable {version('opposable')}",
        "machine": f"{platform.machine()}, Python {platform.python_version()}",
        "mu_simulation": mu,
        "workers": workers,
        "interrupted": interrupted,
        "outcomes": [asdict(o) for o in outcomes],
    }


COLUMNS = ("found", "held", "tries", "CPU s", "slip mm", "slip deg", "off mm", "force %", "epsilon")


def bench_table(result: dict[str, Any]) -> Table:
    """Medians per hand and object, over all, and the worst of all."""
    outcomes = [Outcome(**o) for o in result["outcomes"]]
    table = Table(
        title="medians; CPU without building; off: planned to measured contact; force: its error",
        box=box.SIMPLE_HEAD,
    )
    for name in ("hand", "object", *COLUMNS):
        justify: Literal["left", "right"] = "left" if name in ("hand", "object") else "right"
        table.add_column(name, justify=justify, no_wrap=True)
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
