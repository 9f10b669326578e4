"""Attempts of a search: each gives a plan or a reason; and what is said when the budget ends.

Attempt i depends on the seed and on i alone, so a seed gives the same plan on any machine; budgets
stop between attempts.
"""

from __future__ import annotations

import re
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import count
from typing import Generic, TypeVar

from planner.errors import NoGraspFoundError

__all__ = ["Attempt", "nothing_found", "numbered"]

PlanT = TypeVar("PlanT")
"""What a search is for."""

_NUMBER = re.compile(r"(?<!\w)-?\d+(\.\d+)?(e-?\d+)?(?!\w)")

COMMONEST = 3
"""Reasons that are told, the commonest first."""


@dataclass(frozen=True, kw_only=True)
class Attempt(Generic[PlanT]):
    """One attempt: a plan, or the reason why there is none.

    Attributes:
        index: Its number, from 0, among those of one task and path.
        plan: The plan if it was found.
        reason: Why not, "" if found.
        cpu_s: CPU time of this attempt, s.
    """

    index: int
    plan: PlanT | None
    reason: str
    cpu_s: float


def numbered(
    make: Callable[[int], PlanT | str],
    record: Callable[[PlanT, int, float], PlanT],
    *,
    prepare: Callable[[int], object] = lambda index: None,
) -> Iterator[Attempt[PlanT]]:
    """Endless attempts.

    Args:
        make: Makes the attempt of a number: a plan, or why there is none.
        record: Writes into a plan the number of its attempt, and the CPU time of all until then, s.
        prepare: Builds what the attempt of a number shares with others; its time does not count.
    """
    total = 0.0
    for index in count():
        prepare(index)
        begin = time.process_time()
        outcome = make(index)
        cpu = time.process_time() - begin
        total += cpu
        if isinstance(outcome, str):
            yield Attempt(index=index, plan=None, reason=outcome, cpu_s=cpu)
        else:
            yield Attempt(index=index, plan=record(outcome, index, total), reason="", cpu_s=cpu)


def nothing_found(what: str, made: Sequence[Attempt[PlanT]], remedy: str) -> NoGraspFoundError:
    """The error of an exhausted budget, with the commonest reasons, each by its first example.

    Reasons that differ in their numbers alone, or in what follows a semicolon, are one.

    Args:
        what: What was asked for, after "no".
        made: All attempts.
        remedy: What to try, a sentence without its full stop.
    """
    kinds = [_NUMBER.sub("#", a.reason.split(";")[0]) for a in made]
    example = {kind: a.reason for kind, a in reversed(list(zip(kinds, made, strict=True)))}
    common = Counter(kinds).most_common(COMMONEST)
    whole = [f"{n} x {example[kind]}" for kind, n in common]
    told = whole[:1] + [text.split(";")[0] for text in whole[1:]]
    return NoGraspFoundError(
        f"no {what} in {len(made)} attempts: {'; '.join(told)}. {remedy}", tuple(made)
    )
