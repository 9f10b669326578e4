"""Plan turns in the hand: CPU time, and how often one is found of those that there are.

Each case draws size, mass and friction like ``manipulate``; the planner knows them. The same turn
is planned twice, with starts of their own: as ``plan_motion`` does it unless told otherwise, and
with ``MANY`` attempts, which tell whether there is a motion to be found.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from typing import Annotated

import numpy as np
import typer

from benchmarks.bench import HandOptions, NumberOption
from benchmarks.common import checked_hand, known
from benchmarks.conditions import KINDS, Conditions, HeightOption
from benchmarks.summary import of, share, summary
from planner.errors import NoGraspFoundError
from planner.motion import plan_motion
from planner.motion.search import MAX_ATTEMPTS
from planner.objects import parse_object
from planner.task import GraspTask
from sim.tables import Row

MANY = 50
"""Starts out of which one that holds tells that there is a motion."""

OTHER_SEED = 1_000_003
"""What is added to the seed for those: they share no start with the first ones."""


@dataclass(frozen=True, kw_only=True)
class Options(HandOptions):
    """Cases of every hand and kind of object."""

    n: NumberOption = 20
    objects: Annotated[
        str, typer.Option(help="Comma separated: cylinder, block, sphere, ellipsoid.")
    ] = "cylinder,block"
    height: HeightOption = 0.08
    rotate: Annotated[
        float, typer.Option(min=-170.0, max=170.0, help="Turn about the vertical, degrees.")
    ] = 90.0


def cases(options: Options) -> Iterator[Row]:
    """Draws of every hand and kind of object."""
    given = {"height": options.height, "seed": options.seed, "angle_deg": options.rotate}
    for hand in options.hand_names:
        checked_hand(hand)
        for kind in known("kind of object", options.objects, KINDS):
            for k in range(options.n):
                yield {"hand": hand, "object": kind, "number": k, **given}


def measure(case: Row) -> Row:
    """Plan one case both ways."""
    kind, k = case["object"], case["number"]
    rng = np.random.default_rng([case["seed"], KINDS.index(kind), k])
    there = Conditions.draw(kind, case["height"], rng)
    task = GraspTask.create(case["hand"], parse_object(there.spec, mass=there.mass), mu=there.mu)
    angle, seed = math.radians(case["angle_deg"]), case["seed"] + k
    own = _planned(task, angle, seed, MAX_ATTEMPTS)
    many = _planned(task, angle, seed + OTHER_SEED, MANY)
    return {"conditions": asdict(there), "exists": own["found"] or many["found"], **own}


def _planned(task: GraspTask, angle: float, seed: int, max_attempts: int) -> Row:
    """What came of planning: CPU time without building, s, and attempts."""
    try:
        plan = plan_motion(task, angle=angle, seed=seed, max_attempts=max_attempts)
    except NoGraspFoundError as error:
        spent = sum(attempt.cpu_s for attempt in error.attempts)
        return {"found": False, "cpu_s": spent, "reason": str(error)}
    record = plan.record
    made = {"cpu_s": record.cpu_s, "attempts": record.attempts, "margin": plan.margin}
    return {"found": True, **made, "fingers": list(plan.grasp.task.finger_names)}


def tables(result: Row) -> Iterator[Row]:
    """Counts and medians per hand and kind of object."""
    yield summary(
        f"planning a turn by {result['setting']['rotate']:.0f} degrees: found; found where any of "
        f"{MANY} further starts holds, or one of its own; CPU seconds without building, median and "
        "90 %, found or not; medians of attempts and of the least margin of closure of those found",
        result["rows"],
        ("hand", "object"),
        {
            "found": share("found"),
            "of those there are": share("found", where="exists"),
            "CPU s": of("cpu_s"),
            "90 % CPU s": of("cpu_s", 0.9),
            "attempts": of("attempts", digits=0, where="found"),
            "margin": of("margin", where="found"),
        },
    )
