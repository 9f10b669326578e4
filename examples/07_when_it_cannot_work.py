"""Ask for what cannot be, and read the reasons: honest failure is part of the interface.

Every error that you can mend is a ``PlannerError`` whose message says what was given, what is
allowed and what to do. What can be known is found out before any solving; where a search was
needed, the error carries every attempt with its reason. Prints the errors of an object that is too
large, too few fingers, misspelt names, a negative mass, and an object that is too heavy for the
fingers: all but the last take no time.
"""

from __future__ import annotations

import time
from collections.abc import Callable

from planner import GraspTask, NoGraspFoundError, PlannerError, parse_object, plan_grasp

HAND = "allegro_hand"
TOO_LARGE = "box:0.4x0.4x0.4"  # full lengths, m
TOO_HEAVY = 15.0  # kg
ATTEMPTS = 4  # budget of a search


def plan(task: GraspTask) -> None:
    """Plan with a small budget."""
    plan_grasp(task, max_attempts=ATTEMPTS)


cases: dict[str, Callable[[], object]] = {
    "an object that is too large": lambda: plan(GraspTask.create(HAND, TOO_LARGE)),
    "two fingers": lambda: GraspTask.create(HAND, "box", fingers=["thumb", "index"]),
    "a misspelt hand": lambda: GraspTask.create("alegro_hand", "box"),
    "a misspelt finger": lambda: GraspTask.create(HAND, "box", fingers=["tumb", "index", "ring"]),
    "a negative mass": lambda: parse_object("box", mass=-0.1),
    "an object that is too heavy": lambda: plan(
        GraspTask.create(HAND, parse_object("box", mass=TOO_HEAVY))
    ),
}
for title, ask in cases.items():
    begin = time.perf_counter()
    try:
        ask()
    except PlannerError as error:
        print(f"{title} ({time.perf_counter() - begin:.1f} s)")
        print(f"  {type(error).__name__}: {error}")
        if isinstance(error, NoGraspFoundError):
            for attempt in error.attempts:
                print(f"    attempt {attempt.index}: {attempt.failure}")
    else:
        print(f"{title}: it worked after all")
    print()
