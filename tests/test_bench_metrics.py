"""Which metric predicts success: the area under the curve, the samples, and their file."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rich.console import Console

from benchmarks import metrics
from benchmarks.auc import auc
from benchmarks.metrics import metrics_table, run_metrics, samples_for, summary_of_trials
from benchmarks.objects import BenchObject
from benchmarks.predictors import PREDICTORS, predictors_of
from benchmarks.trials import CONDITIONS, GRADES, TIMELINE, Sample, try_sample
from planner.errors import FileFormatError, PlannerError
from planner.hands.hand import Hand
from planner.search import plan_grasp
from planner.task import GraspTask
from sim.runner import Runner
from sim.trial import Trial

SPHERE = BenchObject(label="sphere", spec="sphere")
BOX = BenchObject(label="box", spec="box")


def nothing() -> None:
    """A check that never finds Ctrl-C."""


def test_areas_worked_by_hand() -> None:
    def area(values: list[float], success: list[bool]) -> float:
        found = auc(np.array(values), success)
        assert found is not None
        return found.area

    won = [True, True, False, False]
    assert area([4, 3, 2, 1], won) == 1.0
    assert area([1, 2, 3, 4], won) == 0.0
    assert area([4, 1, 2, 3], won) == 0.5
    assert area([4, 2, 2, 1], won) == pytest.approx(3.5 / 4)  # a tie is half a win
    assert auc(np.ones(2), [True, True]) is None


def test_the_area_is_the_share_of_pairs_in_order() -> None:
    rng = np.random.default_rng(0)
    values = rng.integers(0, 5, 60).astype(float)
    won = (rng.random(60) < 0.4).tolist()
    groups = rng.integers(0, 4, 60).tolist()
    found, within = auc(values, won), auc(values, won, groups)
    assert found is not None
    assert within is not None
    wins, pairs, wins_within, pairs_within = 0.0, 0, 0.0, 0
    for i in range(60):
        for j in range(60):
            if won[i] and not won[j]:
                point = float(values[i] > values[j]) + 0.5 * float(values[i] == values[j])
                wins, pairs = wins + point, pairs + 1
                if groups[i] == groups[j]:
                    wins_within, pairs_within = wins_within + point, pairs_within + 1
    assert (found.pairs, within.pairs) == (pairs, pairs_within)
    assert found.area == pytest.approx(wins / pairs)
    assert within.area == pytest.approx(wins_within / pairs_within)


def hanley_mcneil(area: float, n_good: int, n_bad: int) -> float:
    """Their equations 1 and 2, written once more."""
    pairs = area * (1 - area)
    pairs += (n_good - 1) * (area / (2 - area) - area**2)
    pairs += (n_bad - 1) * (2 * area**2 / (1 + area) - area**2)
    return float(np.sqrt(pairs / (n_good * n_bad)))


def test_the_standard_error_is_that_of_hanley_and_mcneil() -> None:
    # the example of their paper: area 0.893 with 51 abnormal and 58 normal images, error 0.032
    rng = np.random.default_rng(1)
    won = [True] * 51 + [False] * 58
    for shift in (1.0, 2.0):
        found = auc(rng.normal(size=109) + shift * np.array(won), won)
        assert found is not None
        assert found.error == pytest.approx(hanley_mcneil(found.area, 51, 58))
    assert hanley_mcneil(0.893, 51, 58) == pytest.approx(0.032, abs=6e-4)


def test_within_groups_an_offset_between_them_makes_no_difference() -> None:
    values = np.array([10.0, 9.0, 2.0, 1.0])
    won = [True, False, True, False]
    assert auc(values, won, ["a", "a", "b", "b"]).area == 1.0  # type: ignore[union-attr]
    assert auc(values, won).area == 0.75  # type: ignore[union-attr]


def test_samples_ask_every_grade_under_every_condition() -> None:
    n = 4 * len(GRADES) * len(CONDITIONS)
    samples = samples_for(["allegro_hand", "shadow_hand"], [SPHERE, BOX], n, 0)
    assert [s.index for s in samples] == list(range(n))
    asked = {(s.hand, s.label, s.grade, s.condition) for s in samples}
    assert len(asked) == n  # each once
    assert len(samples_for(["allegro_hand"], [SPHERE, BOX], 7, 0)) == 7


def test_predictors_are_what_they_are_called(allegro: Hand) -> None:
    plan = plan_grasp(GraspTask.create(allegro, "sphere"), seed=1)
    values = predictors_of(plan)
    assert list(values) == list(PREDICTORS)
    assert values["epsilon"] == pytest.approx(plan.quality.epsilon)
    assert values["min_weight"] == pytest.approx(plan.quality.closure.normalised_min_weight)
    assert values["grip"] == pytest.approx(plan.forces.forces[:, 0].min() / 0.981, rel=1e-6)
    used = np.abs(plan.forces.actuator_forces) / 0.7  # symmetric limits
    at_least = 1.0 - used.max()
    assert values["torque_margin"] <= at_least + 1e-9
    assert values["torque_margin"] > -1.0
    free = np.minimum(plan.q - allegro.q_lower, allegro.q_upper - plan.q)
    assert values["joint_margin"] == pytest.approx(
        (free / (allegro.q_upper - allegro.q_lower)).min()
    )
    assert 0 < values["friction_margin"] < 1
    assert 0 < values["near_center"] <= 1


@pytest.mark.slow
def test_reckless_plans_are_worse_at_the_common_friction(allegro: Hand) -> None:
    def epsilons(name: str) -> list[float]:
        grade = GRADES[name]
        tasks = [GraspTask.create(allegro, item, mu=grade.mu) for item in ("box", "cylinder")]
        plans = [
            plan_grasp(t, seed=seed, options=grade.options) for t in tasks for seed in range(4)
        ]
        return [predictors_of(plan)["epsilon"] for plan in plans]

    assert np.mean(epsilons("reckless")) < 0.8 * np.mean(epsilons("best"))


def sample(condition: str) -> Sample:
    return Sample(
        index=3,
        hand="allegro_hand",
        spec="sphere",
        label="sphere",
        grade="plain",
        condition=condition,
        seed=0,
    )


@pytest.mark.parametrize("name", CONDITIONS)
def test_a_condition_changes_the_trial_and_not_the_plan(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen: list[Trial] = []

    class Verdict:
        success, reason = True, ""

    class Report:
        verdict = Verdict()

    def run(trial: Trial, *, on_step: Any) -> Report:
        seen.append(trial)
        forces, simulation = [], trial.simulation
        simulation.phase = "lift"
        on_step(simulation)
        assert not simulation.data.xfrc_applied.any()
        simulation.phase = "hold"
        for _ in range(round(TIMELINE.hold / simulation.timestep)):
            on_step(simulation)
            forces.append(simulation.data.xfrc_applied[simulation.scene.object_body, :3].copy())
        push = CONDITIONS[name].push * 0.981
        assert np.linalg.norm(forces, axis=1) == pytest.approx(push)
        assert np.abs(np.sum(forces, axis=0)).max() == pytest.approx(0.0, abs=1e-9)
        assert len(np.unique(forces, axis=0)) == (6 if push else 1)
        return Report()

    monkeypatch.setattr(Trial, "run", run)
    row = try_sample(sample(name), nothing)
    condition, (trial,) = CONDITIONS[name], seen
    assert row["success"] is True
    scene, task = trial.simulation.scene, trial.plan.task
    assert scene.physics.mu == condition.mu
    assert scene.model.body_mass[scene.object_body] == pytest.approx(0.1 * condition.mass_factor)
    aside = trial.simulation.data.qpos[scene.object_qpos[:3]] - task.T_world_object.translation
    assert np.linalg.norm(aside[:2]) == pytest.approx(condition.shift)
    assert aside[2] == pytest.approx(0.0, abs=1e-12)
    assert task.mu == 0.5
    # the forces are those of the plan for the object as it was thought to be
    assert trial.plan.forces.problem.wrench[2] == pytest.approx(-0.981, abs=1e-3)


def test_a_plan_that_is_executed_as_planned_holds() -> None:
    row = try_sample(sample("as planned"), nothing)
    assert row["found"]
    assert row["success"], row["reason"]
    assert json.loads(json.dumps(row, allow_nan=False)) == row


def fake(wanted: Sample, check: Any) -> dict[str, Any]:
    """A row without planning: grasps with a larger epsilon hold."""
    check()
    rng = np.random.default_rng(wanted.index)
    values = {name: float(rng.random()) for name in PREDICTORS}
    return {
        "index": wanted.index,
        "hand": wanted.hand,
        "object": wanted.label,
        "grade": wanted.grade,
        "condition": wanted.condition,
        "found": True,
        "success": values["epsilon"] > 0.5,
        "reason": "" if values["epsilon"] > 0.5 else "slipped",
        "predictors": values,
    }


def run(file: Path, n: int = 40, check: Any = nothing, **options: Any) -> dict[str, Any]:
    runner = Runner(console=Console(quiet=True), check=check)
    given: dict[str, Any] = {"seed": 0, "runner": runner}
    return run_metrics(["allegro_hand"], [SPHERE], n, file=file, **(given | options))


def test_an_interrupted_run_goes_on_where_it_ended(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(metrics, "try_sample", fake)
    whole = run(tmp_path / "whole.jsonl")
    assert (whole["simulated"], whole["interrupted"]) == (40, False)
    calls = []

    def check() -> None:
        calls.append(True)
        if len(calls) == 6:
            raise KeyboardInterrupt

    file = tmp_path / "cut.jsonl"
    first = run(file, check=check)
    assert (first["simulated"], first["interrupted"]) == (5, True)
    text = file.read_text(encoding="utf-8")
    file.write_text(text[:-20], encoding="utf-8")  # killed while it wrote
    again = run(file)
    assert again["auc"] == whole["auc"]
    assert len(file.read_text(encoding="utf-8").splitlines()) == 1 + 40
    with pytest.raises(FileFormatError, match=r"begun with other arguments \(different: seed\)"):
        run(file, seed=1)


def test_the_table_puts_the_best_predictor_first(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(metrics, "try_sample", fake)
    result = run(tmp_path / "x.jsonl")
    assert result["auc"]["epsilon"]["all"]["area"] == 1.0
    assert 0.2 < result["auc"]["isotropy"]["all"]["area"] < 0.8
    table = metrics_table(result)
    assert next(iter(table.columns[0].cells)) == "epsilon"
    assert table.row_count == len(PREDICTORS) + 1


def test_samples_without_a_plan_count_for_nothing() -> None:
    row = fake(sample("heavy"), nothing)
    lost = row | {"found": False, "success": None, "reason": "no plan"}
    del lost["predictors"]
    result = summary_of_trials([row, lost])
    assert (result["samples"], result["simulated"]) == (2, 1)
    assert result["auc"]["epsilon"]["all"] is None
    assert result["by_condition"]["heavy"]["of"] == 1


def test_bad_objects_end_it_before_anything_is_written(tmp_path: Path) -> None:
    file = tmp_path / "x.jsonl"
    with pytest.raises(PlannerError, match="no object is called 'bx'"):
        run_metrics(
            ["allegro_hand"],
            [BenchObject(label="bx", spec="bx")],
            2,
            seed=0,
            file=file,
            runner=Runner(console=Console(quiet=True), check=nothing),
        )
    assert not file.exists()
