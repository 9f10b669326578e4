"""Attempts of a search: each gives a plan or a failure; what they cost, and when they end.

Attempt i depends on the seed and on i alone, so a seed gives the same plan on any machine; budgets
stop between attempts.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import count
from typing import Any, ClassVar, Generic, Protocol, TypeVar

import numpy as np

from planner.errors import NoGraspFoundError, TaskError
from planner.failure import Failure

__all__ = [
    "Attempt",
    "SearchContext",
    "SearchRecord",
    "check_seed",
    "nothing_found",
    "run_attempts",
    "search",
]

COMMONEST = 3
"""Kinds of failure that are told, the commonest first."""


@dataclass(frozen=True, kw_only=True)
class SearchRecord:
    """Which attempt of a search gave a plan, and what that cost; ``run_attempts`` fills it in.

    Attributes:
        seed: Seed of the search.
        attempt: Number of the attempt that gave the plan, from 0; seed and attempt fix the start.
        attempts: How many attempts had been made when it was found.
        cpu_s: CPU time of the search until it was found, s, without building.
        build_s: Time that building the problem took, s: once per hand, fingers and kind of shape.
    """

    seed: int = 0
    attempt: int = 0
    attempts: int = 1
    cpu_s: float = 0.0
    build_s: float = 0.0


class Recorded(Protocol):
    """A plan, a frozen dataclass, that keeps the record of its search."""

    __dataclass_fields__: ClassVar[dict[str, Any]]

    @property
    def record(self) -> Any:
        """A ``SearchRecord``."""


PlanT = TypeVar("PlanT")
"""What a search is for."""

RecordedT = TypeVar("RecordedT", bound=Recorded)

FoundT_co = TypeVar("FoundT_co", covariant=True)


class SearchContext(Protocol[FoundT_co]):
    """What several attempts share: problem, solver, geometry."""

    @property
    def build_s(self) -> float:
        """Time that building the problem took, s."""

    def attempt(self, rng: np.random.Generator) -> FoundT_co | Failure:
        """One attempt: a plan, or why there is none."""


@dataclass(frozen=True, kw_only=True)
class Attempt(Generic[PlanT]):
    """One attempt: a plan, or why there is none.

    Attributes:
        index: Its number, from 0, among those of one task and path.
        plan: The plan if it was found.
        failure: Why not, None if found.
        cpu_s: CPU time of this attempt, s.
    """

    index: int
    plan: PlanT | None
    failure: Failure | None
    cpu_s: float


def check_seed(seed: int) -> None:
    """Refuse anything but an integer >= 0.

    Raises:
        TaskError: Not an integer, or negative.
    """
    if not isinstance(seed, int | np.integer) or seed < 0:
        raise TaskError(f"seed is {seed!r}; give an integer >= 0")


def run_attempts(
    context: Callable[[int], SearchContext[RecordedT]], *, seed: int
) -> Iterator[Attempt[RecordedT]]:
    """Endless attempts; those of one number and seed are the same.

    Args:
        context: What the attempt of a number shares with others; the time it takes does not count.
        seed: Seed of the search.
    """
    total = 0.0
    for index in count():
        shared = context(index)
        begin = time.process_time()
        outcome = shared.attempt(np.random.default_rng([seed, index]))
        cpu = time.process_time() - begin
        total += cpu
        if isinstance(outcome, Failure):
            yield Attempt(index=index, plan=None, failure=outcome, cpu_s=cpu)
            continue
        record = replace(
            outcome.record,
            seed=seed,
            attempt=index,
            attempts=index + 1,
            cpu_s=total,
            build_s=shared.build_s,
        )
        plan = replace(outcome, record=record)
        yield Attempt(index=index, plan=plan, failure=None, cpu_s=cpu)


def search(
    attempts: Iterable[Attempt[PlanT]],
    *,
    max_attempts: int,
    max_cpu_s: float | None = None,
    best_of: int = 1,
    merit: Callable[[PlanT], float] = lambda plan: 0.0,
    progress: Callable[[Attempt[PlanT]], None] | None = None,
) -> tuple[PlanT | None, list[Attempt[PlanT]]]:
    """The best plan of ``best_of`` attempts, else the first one later; and all attempts made.

    Args:
        attempts: One after the other.
        max_attempts: Budget in attempts.
        max_cpu_s: Budget in CPU seconds, looked at between attempts; None for no limit.
        best_of: Attempts that are made in any case.
        merit: The larger the better; of equals the first is taken.
        progress: Called after every attempt.
    """
    made: list[Attempt[PlanT]] = []
    best: PlanT | None = None
    used = 0.0
    for attempt in attempts:
        made.append(attempt)
        used += attempt.cpu_s
        if progress is not None:
            progress(attempt)
        plan = attempt.plan
        if plan is not None and (best is None or merit(plan) > merit(best)):
            best = plan
        spent = len(made) >= max_attempts or (max_cpu_s is not None and used >= max_cpu_s)
        if spent or (best is not None and len(made) >= best_of):
            break
    return best, made


def nothing_found(what: str, made: Sequence[Attempt[PlanT]], remedy: str) -> NoGraspFoundError:
    """The error of an exhausted budget, with the commonest kinds of failure, each by an example.

    The example is the first of its kind; only the commonest is told beyond a semicolon.

    Args:
        what: What was asked for, after "no".
        made: All attempts.
        remedy: What to try, a sentence without its full stop.
    """
    failures = [a.failure for a in made if a.failure is not None]
    example = {f.kind: f.text for f in reversed(failures)}
    common = Counter(f.kind for f in failures).most_common(COMMONEST)
    whole = [f"{n} x {example[kind]}" for kind, n in common]
    told = whole[:1] + [text.split(";")[0] for text in whole[1:]]
    return NoGraspFoundError(
        f"no {what} in {len(made)} attempts: {'; '.join(told)}. {remedy}", tuple(made)
    )
