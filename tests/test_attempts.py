"""``planner.search.attempt``: the loop of a search, and what is said when a budget ends."""

from __future__ import annotations

import itertools
import pickle
from dataclasses import dataclass, field

import numpy as np
import pytest

from planner.errors import TaskError
from planner.failure import Failure
from planner.plan import SearchRecord
from planner.search.attempt import (
    Attempt,
    SearchContext,
    check_seed,
    nothing_found,
    run_attempts,
    search,
)


@dataclass(frozen=True)
class Number:
    """What is searched for: a number above one half."""

    value: float
    record: SearchRecord = field(default_factory=SearchRecord)


@dataclass(frozen=True)
class Draws:
    """A context that draws numbers."""

    build_s: float = 0.5

    def attempt(self, rng: np.random.Generator) -> Number | Failure:
        value = float(rng.random())
        if value > 0.5:
            return Number(value)
        return Failure(kind="small", text=f"{value:.2f} is small", numbers={"value": value})


def context(index: int) -> SearchContext[Number]:
    return Draws()


def first(n: int, seed: int = 0) -> list[Attempt[Number]]:
    return list(itertools.islice(run_attempts(context, seed=seed), n))


def test_an_attempt_depends_on_seed_and_number_alone() -> None:
    values = [np.random.default_rng([3, i]).random() for i in range(20)]
    for i, attempt in enumerate(first(20, seed=3)):
        assert attempt.index == i
        if attempt.plan is None:
            assert attempt.failure is not None and attempt.failure.numbers["value"] == values[i]
        else:
            assert attempt.failure is None and attempt.plan.value == values[i]


def test_the_record_of_a_plan_tells_its_attempt_and_what_the_search_cost() -> None:
    made = first(20, seed=3)
    for i, attempt in enumerate(made):
        if attempt.plan is not None:
            record = attempt.plan.record
            assert (record.seed, record.attempt, record.attempts) == (3, i, i + 1)
            assert record.build_s == 0.5
            assert record.cpu_s == pytest.approx(sum(a.cpu_s for a in made[: i + 1]))


def test_a_search_ends_with_the_first_plan_or_the_best_of_several() -> None:
    made = first(30)
    values = [a.plan.value if a.plan is not None else 0.0 for a in made]
    found, tried = search(made, max_attempts=30)
    k = next(i for i, v in enumerate(values) if v)
    assert found is made[k].plan and len(tried) == k + 1
    places = [i for i, v in enumerate(values) if v]
    assert places[3] > 3  # some fail before, and do not count
    best, tried = search(made, max_attempts=30, best_of=4, merit=lambda plan: plan.value)
    assert len(tried) == places[3] + 1
    assert best is not None and best.value == max(values[: places[3] + 1])


def test_a_search_for_the_best_of_too_many_gives_the_best_that_the_budget_has() -> None:
    made = first(30)
    for best_of in (1000, None):
        best, tried = search(made, max_attempts=12, best_of=best_of, merit=lambda p: p.value)
        assert len(tried) == 12
        assert best is not None
        assert best.value == max(a.plan.value for a in made[:12] if a.plan is not None)


def test_progress_tells_the_best_so_far_and_may_end_the_search() -> None:
    seen: list[float | None] = []

    def enough(attempt: Attempt[Number]) -> bool:
        seen.append(attempt.best)
        return len(seen) == 9

    made = first(30)
    best, tried = search(
        made, max_attempts=30, best_of=None, merit=lambda plan: plan.value, progress=enough
    )
    assert len(tried) == 9 and [a.best for a in tried] == seen
    values = [a.plan.value if a.plan is not None else None for a in made[:9]]
    for k, told in enumerate(seen):
        known = [v for v in values[: k + 1] if v is not None]
        assert told == (max(known) if known else None)
    assert best is not None and best.value == seen[-1]


def test_budgets_end_a_search_between_attempts() -> None:
    failed = [a for a in first(30) if a.plan is None]
    seen: list[Attempt[Number]] = []
    found, tried = search(failed, max_attempts=2, progress=seen.append)
    assert found is None and tried == seen == failed[:2]
    slow: list[Attempt[Number]] = [
        Attempt(index=a.index, plan=None, failure=a.failure, cpu_s=1.0) for a in failed
    ]
    assert len(search(slow, max_attempts=30, max_cpu_s=2.5)[1]) == 3


@pytest.mark.parametrize("seed", [-1, 0.5, "1"])
def test_what_is_no_seed_is_refused(seed: int) -> None:
    with pytest.raises(TaskError, match="give an integer >= 0"):
        check_seed(seed)


def test_a_failure_is_sent_to_another_process_and_tells_where_it_occurred() -> None:
    failure = Failure(kind="small", text="0.20 is small", numbers={"value": 0.2})
    assert pickle.loads(pickle.dumps(failure)) == failure
    assert hash(failure) == hash(pickle.loads(pickle.dumps(failure)))
    inside = failure.at("start")
    assert (inside.kind, inside.text) == ("small", "start: 0.20 is small")
    assert inside.numbers == failure.numbers


def failures(*told: tuple[str, str]) -> list[Attempt[None]]:
    """Attempts that failed by these kinds and texts."""
    return [
        Attempt(index=i, plan=None, failure=Failure(kind=kind, text=text), cpu_s=0.0)
        for i, (kind, text) in enumerate(told)
    ]


def test_failures_of_one_kind_are_told_once() -> None:
    made = failures(
        ("forces", "forces: 49.1 N is too much; in the way: a; b"),
        ("load_0", "not solved: load of actuator A_thumb_0 at 0 % of the path, off by 0.33"),
        ("load_1", "not solved: load of actuator A_thumb_1 at 0 % of the path, off by 0.2"),
        ("load_1", "not solved: load of actuator A_thumb_1 at 33 % of the path, off by -1e-05"),
        ("load_1", "not solved: load of actuator A_thumb_1 at 67 % of the path, off by 3"),
    )
    error = nothing_found("way", made, "Try less")
    assert str(error) == (
        "no way in 5 attempts: "
        "3 x not solved: load of actuator A_thumb_1 at 0 % of the path, off by 0.2; "
        "1 x forces: 49.1 N is too much; "
        "1 x not solved: load of actuator A_thumb_0 at 0 % of the path, off by 0.33. Try less"
    )
    assert error.attempts == tuple(made)


def test_only_the_commonest_failure_is_told_to_its_end() -> None:
    made = failures(
        ("a", "a: 1 N; in the way: x"), ("a", "a: 2 N; in the way: y"), ("b", "b; in the way: z")
    )
    assert "2 x a: 1 N; in the way: x; 1 x b. " in str(nothing_found("way", made, "Try"))
