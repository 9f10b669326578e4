"""``run_motion``: planning a turn in the hand; how long it takes, and how often there is one.

Each case draws size, mass and friction like ``bench manipulate``; the planner knows them. The same
turn is planned twice, with starts of their own: as ``plan_motion`` does it unless told otherwise,
and with ``MANY`` attempts, which tell whether there is a motion to be found.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich.table import Table

from benchmarks.cases import row_of, run_cases
from benchmarks.conditions import KINDS, Conditions, Kind
from benchmarks.run import by_cell
from benchmarks.statistics import median_of
from planner.errors import NoGraspFoundError, NotFoundError, PlannerError
from planner.motion import plan_motion
from planner.motion.search import MAX_ATTEMPTS
from planner.objects import parse_object
from planner.task import GraspTask
from sim.runner import Check, Runner
from sim.tables import number, table_of

FORMAT = "opposable-bench-motion"

MANY = 50
"""Starts out of which one that holds tells that there is a motion."""

OTHER_SEED = 1_000_003
"""What is added to the seed for those: they share no start with the first ones."""


@dataclass(frozen=True, kw_only=True)
class MotionCase:
    """One case, as it is sent to a worker.

    Attributes:
        index: Its number among all.
        hand: Name or path of the hand.
        kind: Kind of object.
        number: Its number in its cell.
        height: Height of cylinder, block and ellipsoid, m.
        seed: Of what is drawn, and of the starts.
        angle: Turn about the vertical, rad.
    """

    index: int
    hand: str
    kind: Kind
    number: int
    height: float
    seed: int
    angle: float

    def draw(self) -> Conditions:
        """What is to be turned."""
        rng = np.random.default_rng([self.seed, KINDS.index(self.kind), self.number])
        return Conditions.draw(self.kind, self.height, rng)


def run_case(case: MotionCase, check: Check) -> dict[str, Any]:
    """Plan one case both ways; its row, as plain data."""
    there = case.draw()
    try:
        item = parse_object(there.spec, mass=there.mass)
        task = GraspTask.create(case.hand, item, mu=there.mu)
        own = _planned(task, case, seed=case.seed + case.number, max_attempts=MAX_ATTEMPTS)
        check()
        seed = case.seed + case.number + OTHER_SEED
        many = _planned(task, case, seed=seed, max_attempts=MANY)
    except PlannerError as error:
        return row_of(case, found=False, exists=False, reason=str(error))
    return row_of(case, exists=own["found"] or many["found"], **own)


def _planned(task: GraspTask, case: MotionCase, *, seed: int, max_attempts: int) -> dict[str, Any]:
    """What came of planning: CPU time without building, s, and attempts."""
    try:
        plan = plan_motion(task, angle=case.angle, seed=seed, max_attempts=max_attempts)
    except NoGraspFoundError as error:
        spent = sum(attempt.cpu_s for attempt in error.attempts)
        return {
            "found": False,
            "cpu_s": spent,
            "attempts": len(error.attempts),
            "reason": str(error),
        }
    record = plan.record
    return {
        "found": True,
        "cpu_s": record.cpu_s,
        "attempts": record.attempts,
        "fingers": list(plan.grasp.task.finger_names),
        "margin": plan.margin,
    }


def run_motion(
    hands: Sequence[str],
    kinds: Sequence[str],
    n: int,
    *,
    height: float,
    angle: float,
    seed: int,
    file: Path,
    runner: Runner,
) -> dict[str, Any]:
    """Run the cases that the file does not have yet.

    Args:
        hands: Names or paths.
        kinds: Kinds of objects out of ``KINDS``.
        n: Cases for each hand and kind.
        height: Height of cylinder, block and ellipsoid, m.
        angle: Turn about the vertical, rad.
        seed: Of all that is drawn.
        file: Of the rows; made if it is not there.
        runner: Who works on them.

    Returns:
        Plain data: all rows that the file has then, and what they were made with.

    Raises:
        FileFormatError: The file is not one of these, or was begun with other arguments.
        NotFoundError: A kind or a hand that does not exist.
    """
    for kind in kinds:
        if kind not in KINDS:
            raise NotFoundError("kind of object", kind, KINDS)
    for hand in hands:
        GraspTask.create(hand, "cylinder")
    cells = [(hand, kind, k) for hand in hands for kind in kinds for k in range(n)]
    jobs = [
        MotionCase(
            index=i,
            hand=hand,
            kind=KINDS[KINDS.index(kind)],
            number=k,
            height=height,
            seed=seed,
            angle=angle,
        )
        for i, (hand, kind, k) in enumerate(cells)
    ]
    asked = {
        "hands": list(hands),
        "kinds": list(kinds),
        "n": n,
        "height": height,
        "seed": seed,
        "angle_deg": math.degrees(angle),
    }
    return run_cases(runner, run_case, jobs, kind=FORMAT, asked=asked, file=file, title="turns")


COLUMNS = ("found", "of those there are", "CPU s", "90 % CPU s", "attempts", "margin")


def motion_table(result: dict[str, Any]) -> Table:
    """Counts and medians per hand and kind of object."""
    table = table_of(
        f"planning a turn by {result['angle_deg']:.0f} degrees: found; found where any of {MANY} "
        "further starts holds, or one of its own; CPU seconds without building, median and 90 %, "
        "found or not; medians of attempts and of the least margin of closure of those found",
        ("hand", "object"),
        COLUMNS,
    )
    for (hand, kind), rows in by_cell(result["rows"]).items():
        found = [row for row in rows if row["found"]]
        there = sum(bool(row.get("exists")) for row in rows)
        spent = [row["cpu_s"] for row in rows if "cpu_s" in row]
        table.add_row(
            hand,
            kind,
            f"{len(found)}/{len(rows)}",
            f"{len(found)}/{there}",
            number(median_of(spent), 2),
            number(float(np.percentile(spent, 90)), 2) if spent else "-",
            number(median_of(row["attempts"] for row in found), 0),
            number(median_of(row["margin"] for row in found), 2),
        )
    return table
