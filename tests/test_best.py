"""The best of several grasps: ``best_of``, ``keep="best"``, ``plans``; and several that differ."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from planner.batch import GraspFeatures, plan_several, separations
from planner.batch.run import farthest_points
from planner.errors import FileFormatError, NoGraspFoundError, NotFoundError, TaskError
from planner.files import plan_to_dict, read_plan, write_plan
from planner.files.disk import read_json, write_json
from planner.files.plans import plan_from_dict
from planner.plan import GraspPlan
from planner.search.attempt import Attempt
from planner.search.best import FALLEN_BEHIND
from planner.search.grasp import attempts, plan_grasp, plans
from planner.search.metrics import METRICS, Measure, Metric, evaluate_metrics, register_metric
from planner.synthesis.objectives import OBJECTIVES
from planner.synthesis.options import SynthesisOptions
from planner.task import GraspTask

QUICK = SynthesisOptions(rounds=0)


@pytest.fixture(scope="module")
def task() -> GraspTask:
    """An object on which attempts fail now and then, and grasps differ much."""
    return GraspTask.create("allegro_hand", "cylinder")


@pytest.fixture(scope="module")
def improving(task: GraspTask) -> tuple[GraspPlan, list[Attempt[GraspPlan]]]:
    """The best of twelve attempts that build on each other, and these."""
    made: list[Attempt[GraspPlan]] = []
    plan = plan_grasp(task, seed=1, keep="best", max_attempts=12, progress=made.append)
    return plan, made


def epsilon_of(plan: GraspPlan) -> float:
    """The metric that is the default."""
    return evaluate_metrics(plan)["epsilon"]


def test_best_of_is_the_best_of_the_first_found_by_independent_attempts(task: GraspTask) -> None:
    found: list[GraspPlan] = []
    for attempt in attempts(task, seed=4, options=QUICK):
        if attempt.plan is not None:
            found.append(attempt.plan)
        if len(found) == 5:
            break
    best = plan_grasp(task, seed=4, best_of=5, options=QUICK)
    expected = max(found, key=epsilon_of)
    assert np.array_equal(best.q, expected.q)
    assert best.record.attempt == expected.record.attempt
    assert best.record.attempts == attempt.index + 1
    told = best.record.best
    assert told is not None
    assert (told.found, told.metric, told.improving) == (5, "epsilon", False)
    assert told.value == epsilon_of(expected)


def test_the_first_grasp_says_nothing_of_others(task: GraspTask) -> None:
    first = plan_grasp(task, seed=4, options=QUICK)
    assert first.record.best is None
    one = plan_grasp(task, seed=4, options=QUICK, best_of=1)
    assert np.array_equal(first.q, one.q)
    assert one.record.best is not None and one.record.best.found == 1


def test_a_metric_chooses_another_grasp(task: GraspTask) -> None:
    by = {m: plan_grasp(task, seed=4, best_of=5, metric=m, options=QUICK) for m in METRICS}
    values = {name: evaluate_metrics(plan) for name, plan in by.items()}
    for name in METRICS:
        assert values[name][name] == max(v[name] for v in values.values())
    assert len({plan.record.attempt for plan in by.values()}) > 1


def test_weights_sum_metrics(task: GraspTask) -> None:
    plan = plan_grasp(task, options=QUICK)
    values = evaluate_metrics(plan)
    measure = Measure.of({"limits": 0.5, "epsilon": 2})
    assert measure.text == "epsilon:2.0,limits:0.5"
    assert measure(plan) == pytest.approx(2 * values["epsilon"] + 0.5 * values["limits"])


@pytest.mark.slow
def test_attempts_that_build_on_each_other_find_better_grasps_than_as_many_independent_ones(
    task: GraspTask,
) -> None:
    """In the mean over seeds: a single search of either kind may be lucky."""
    gain = []
    for seed in range(1, 5):
        building = plan_grasp(task, seed=seed, keep="best", max_attempts=6)
        independent = plan_grasp(task, seed=seed, best_of=6, max_attempts=6)
        gain.append(epsilon_of(building) / epsilon_of(independent))
    assert np.mean(gain) > 1.05


def test_a_search_for_the_best_says_of_how_many_it_is_the_best(
    improving: tuple[GraspPlan, list[Attempt[GraspPlan]]],
) -> None:
    plan, made = improving
    assert plan.verification.ok and plan.forces.found
    told = plan.record.best
    assert told is not None and told.improving
    assert told.found == sum(a.plan is not None for a in made)
    assert plan.record.attempts == len(made) == 12


def test_only_what_would_be_the_best_is_verified(
    improving: tuple[GraspPlan, list[Attempt[GraspPlan]]],
) -> None:
    _, made = improving
    kinds = [a.failure.kind for a in made if a.failure is not None]
    assert FALLEN_BEHIND in kinds
    assert made[-1].best == max(epsilon_of(a.plan) for a in made if a.plan is not None)


@pytest.mark.slow
def test_a_budget_of_counts_cuts_the_same_search_short(
    improving: tuple[GraspPlan, list[Attempt[GraspPlan]]], task: GraspTask
) -> None:
    whole, made = improving
    steps = list(plans(task, seed=1, max_attempts=12))
    values = [epsilon_of(plan) for plan in steps]
    assert values == sorted(set(values)), "each is better than the last"
    assert np.array_equal(steps[-1].q, whole.q)
    early = steps[0]
    again = plan_grasp(task, seed=1, keep="best", max_attempts=early.record.attempts)
    assert np.array_equal(again.q, early.q)
    assert again.record.best == early.record.best
    # a budget in CPU seconds ends after some attempt: as many give the same plan
    timed = plan_grasp(task, seed=1, keep="best", max_cpu_s=sum(a.cpu_s for a in made[:3]))
    same = plan_grasp(task, seed=1, keep="best", max_attempts=timed.record.attempts)
    assert np.array_equal(timed.q, same.q)


def test_progress_that_says_so_ends_with_the_best_so_far(task: GraspTask) -> None:
    plan = plan_grasp(
        task, seed=1, keep="best", max_attempts=12, progress=lambda a: a.best is not None
    )
    first = next(plans(task, seed=1))
    assert np.array_equal(plan.q, first.q)


@pytest.mark.parametrize("metric", ["torque", "limits", "robustness:1,manipulability:0.1"])
def test_any_metric_is_climbed(task: GraspTask, metric: str) -> None:
    steps = list(plans(task, seed=2, metric=metric, max_attempts=5))
    assert steps and steps[-1].record.objective == Measure.of(metric).text
    worth = [Measure.of(metric)(plan) for plan in steps]
    assert worth == sorted(set(worth))


def test_without_rounds_nothing_is_climbed(task: GraspTask) -> None:
    plan = plan_grasp(task, seed=1, keep="best", max_attempts=4, options=QUICK)
    assert plan.record.best is not None


@pytest.mark.parametrize(
    ("given", "error", "message"),
    [
        ({"best_of": 0}, TaskError, "best_of is 0; give an integer, at least 1"),
        ({"best_of": 2.5}, TaskError, "best_of is 2.5"),
        ({"max_attempts": 0}, TaskError, "max_attempts is 0"),
        ({"max_cpu_s": 0.0, "keep": "best"}, TaskError, "give seconds > 0"),
        ({"keep": "bset"}, NotFoundError, "Did you mean 'best'"),
        ({"best_of": 3, "metric": "epsilonn"}, NotFoundError, "Did you mean 'epsilon'"),
        ({"best_of": 3, "metric": {"torque": -1}}, TaskError, "give a finite number > 0"),
        ({"best_of": 3, "metric": ""}, TaskError, "metric is ''"),
        ({"metric": "torque"}, TaskError, "give best_of or keep='best' too"),
        ({"best_of": 3, "keep": "best"}, TaskError, "leave one out"),
    ],
)
def test_bad_requests_end_before_the_search(
    task: GraspTask, given: dict[str, Any], error: type[Exception], message: str
) -> None:
    with pytest.raises(error, match=message):
        plan_grasp(task, progress=lambda _: pytest.fail("it searched"), **given)


def test_nothing_found_is_told_as_before() -> None:
    hopeless = GraspTask.create("allegro_hand", "box:0.05x0.05x0.05", mu=0.02)
    with pytest.raises(NoGraspFoundError, match="in 2 attempts"):
        plan_grasp(hopeless, keep="best", max_attempts=2)


def test_files_tell_of_how_many_a_plan_is_the_best(task: GraspTask, tmp_path: Path) -> None:
    best, first = tmp_path / "best.json", tmp_path / "first.json"
    plan = plan_grasp(task, seed=4, best_of=2, options=QUICK)
    write_plan(plan, best)
    assert read_json(best, "plan")["version"] == 2
    assert read_plan(best).record == plan.record
    assert "the best of 2 found" in str(plan) and "by epsilon" in str(plan)
    # the first found is written as before, so that older versions read it
    write_plan(replace(plan, record=replace(plan.record, best=None)), first)
    data = read_json(first, "plan")
    assert data["version"] == 1 and "best" not in data["record"]
    assert read_plan(first).record.best is None
    write_json({**data, "version": 5}, first)
    with pytest.raises(FileFormatError, match="reads version 1 or 2 or 3 or 4"):
        read_plan(first)
    data = plan_to_dict(plan)
    data["record"]["best"]["found"] = "many"
    with pytest.raises(FileFormatError, match=r"record\.best\.found"):
        plan_from_dict(data, "it")


def made_up(places: list[float]) -> GraspFeatures:
    """Grasps that differ in nothing but where the base is along x, in cm."""
    n = len(places)
    return GraspFeatures(
        positions=np.array([[0.01 * x, 0.0, 0.0] for x in places]),
        rotations=np.tile(np.eye(3), (n, 1, 1)),
        approach=np.tile([0.0, 0.0, 1.0], (n, 1)),
        contacts=np.zeros((n, 1, 3)),
        q=np.zeros((n, 2)),
    )


def test_the_farthest_comes_next_and_near_duplicates_never() -> None:
    grasps = made_up([0.0, 10.0, 0.5, 4.0, 10.4])
    assert farthest_points(grasps, 3, 0).tolist() == [0, 4, 3]
    assert farthest_points(grasps, 5, 0).tolist() == [0, 4, 3]  # 1 and 2 lie within a tolerance
    assert farthest_points(grasps, 1, 2).tolist() == [2]


def test_several_are_the_first_found_or_those_that_differ(task: GraspTask) -> None:
    first = plan_several(task, 3, seed=4, options=QUICK)
    alone = plan_grasp(task, seed=4, options=QUICK)
    assert len(first) == 3 and np.array_equal(first[0].q, alone.q)
    diverse = plan_several(task, 3, diverse=True, seed=4, options=QUICK)
    best = plan_grasp(task, seed=4, best_of=12, options=QUICK)
    assert np.array_equal(diverse[0].q, best.q)
    assert separations(diverse).min() > separations(first).min()
    assert (separations(diverse) > 1.0).all()
    assert separations(first[:1]).tolist() == [np.inf]


def test_plans_of_other_fingers_can_be_compared(task: GraspTask) -> None:
    whole = plan_grasp(task, options=QUICK)
    spared = plan_grasp(task.with_fingers(task.finger_names[:3]), options=QUICK)
    for pair in ([whole, spared], [spared, whole]):
        features = GraspFeatures.of_plans(pair)
        assert features.contacts.shape == (2, 4, 3)
        assert np.isnan(features.contacts).sum() == 3
        assert (separations(pair) > 1.0).all()


@pytest.mark.parametrize(
    ("n", "given", "message"),
    [
        (0, {}, "n is 0; give an integer, at least 1"),
        (1, {"diverse": True}, "one grasp cannot be diverse"),
        (2, {"metric": "torque"}, "give diverse=True too"),
    ],
)
def test_bad_numbers_of_grasps_are_refused(
    task: GraspTask, n: int, given: dict[str, Any], message: str
) -> None:
    with pytest.raises(TaskError, match=message):
        plan_several(task, n, **given)


@pytest.fixture
def own() -> Iterator[Metric]:
    """A metric that no one else has, and that synthesis improves by the rows of "limits"."""
    made = Metric(unit="m", value=lambda plan, _: -float(np.ptp(plan.contacts.positions[:, 2])))
    yield register_metric("own", made, OBJECTIVES["limits"])
    del METRICS["own"], OBJECTIVES["own"]


def test_a_metric_of_ones_own_compares_plans_and_is_improved(task: GraspTask, own: Metric) -> None:
    best = plan_grasp(task, seed=4, best_of=3, metric="own", options=QUICK)
    first = plan_several(task, 3, seed=4, options=QUICK)
    assert best.record.best is not None
    assert best.record.best.value == max(own.value(p, np.zeros((0, 6))) for p in first)
    mine, limits = (
        plan_grasp(task, seed=4, options=SynthesisOptions(objective=name, rounds=1))
        for name in ("own", "limits")
    )
    np.testing.assert_array_equal(mine.q, limits.q)
    with pytest.raises(TaskError, match="'own' already"):
        register_metric("own", own)
