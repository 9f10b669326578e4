"""Estimators in trials: which one there is, what it knows, when it no longer knows."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
from conftest import PlanOf

from planner.errors import NotFoundError, TaskError
from planner.plan import GraspPlan
from planner.task import GraspTask
from sim.controllers import Event, Observation
from sim.scene.carrier import Timeline
from sim.scene.physics import PhysicsOptions
from sim.sensing.errors import ERROR_MODELS, ErrorModel
from sim.sensing.estimation import EstimateLog, ObjectEstimator, SensorErrors, register_estimator
from sim.simulation import Simulation
from sim.trial import simulate

pytestmark = pytest.mark.usefixtures("coarse_steps")

SHORT = Timeline.quick(hold=0.3)


@pytest.fixture(scope="module")
def plan(plan_of: PlanOf) -> GraspPlan:
    return plan_of("allegro_hand", "sphere")


@pytest.mark.parametrize(
    ("error_model", "name"),
    [
        (None, "none"),
        (ErrorModel(), "none"),
        (ErrorModel(name="late", command_delay=0.004), "none"),
        (ERROR_MODELS["lab"], "all"),
        (ERROR_MODELS["rough"], "all"),
    ],
)
def test_an_estimator_by_default_where_the_pose_has_errors(
    plan: GraspPlan, error_model: ErrorModel | None, name: str
) -> None:
    simulation = Simulation(plan, error_model=error_model)
    assert (simulation.estimator is None) == (name == "none")
    told = simulation.senses()
    assert told is None if simulation.error_model is None else (told or {})["estimator"] == name


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "most_mm", "most_deg"), [("all", 1.5, 2.0), ("touch", 3.0, 4.0), ("contact", 4.0, 8.0)]
)
def test_an_estimate_is_near_the_truth_and_says_how_near(
    plan: GraspPlan, tmp_path: Path, name: str, most_mm: float, most_deg: float
) -> None:
    log = EstimateLog()
    lab = ERROR_MODELS["lab"].seeded(2)
    report = simulate(plan, timeline=SHORT, error_model=lab, estimator=name, on_step=log)
    assert report.success
    assert (report.error_model or {})["estimator"] == name
    late = np.array(log.phase) == "hold"
    error = np.abs(log.error[late]).max(axis=0)
    assert 1e3 * np.linalg.norm(error[:3]) < most_mm
    assert np.rad2deg(np.linalg.norm(error[3:])) < most_deg
    assert log.within_two_sigma > 0.9
    assert not [e for e in report.events if e.kind == "pose lost"]
    log.write_csv(tmp_path / "errors.csv")
    lines = (tmp_path / "errors.csv").read_text(encoding="utf-8").splitlines()
    assert len(lines) == len(log) + 1
    assert lines[0].startswith("time_s,phase,error_x_mm")
    log.draw(tmp_path / "errors.png")
    assert (tmp_path / "errors.png").stat().st_size > 10_000


class Numb:
    """An estimator by touch, of a hand whose pads fail in the hold."""

    def __init__(self, task: GraspTask, errors: SensorErrors) -> None:
        """Made for each trial."""
        self._inner = ObjectEstimator(task, errors, camera=False)

    @property
    def events(self) -> tuple[Event, ...]:
        return self._inner.events

    def step(self, observation: Observation) -> Observation:
        if observation.phase == "hold":
            none = np.zeros_like(observation.normal_forces)
            observation = replace(observation, normal_forces=none)
        return self._inner.step(observation)


@pytest.mark.slow
def test_without_touch_and_camera_a_held_object_is_soon_unknown(plan: GraspPlan) -> None:
    fine = PhysicsOptions(timestep=0.002)  # s; when it is lost is told to a sample
    report = simulate(
        plan, timeline=SHORT, physics=fine, error_model=ERROR_MODELS["lab"], estimator=Numb
    )
    begin = report.samples.time[report.samples.during("hold")[0]]
    (lost,) = (e for e in report.events if e.kind == "pose lost")
    assert begin - 0.02 < lost.time < begin + 0.15
    assert (report.error_model or {})["estimator"] == "Numb"


def test_bad_estimators_are_refused(plan: GraspPlan) -> None:
    with pytest.raises(NotFoundError, match=r"estimator.*tuoch"):
        Simulation(plan, estimator="tuoch")

    def three(task: GraspTask, errors: SensorErrors) -> Any:
        return 3

    with pytest.raises(TaskError, match="is no estimator; give a name"):
        Simulation(plan, estimator=three)
    with pytest.raises(TaskError, match="already"):
        register_estimator("touch", "the same again")(ObjectEstimator)
    with pytest.raises(TaskError, match=r"camera is -1.0; give a finite number >= 0"):
        SensorErrors(camera=-1.0)
    with pytest.raises(
        TaskError, match=r"camera is '1 mm', not a number; give a finite number >= 0"
    ):
        SensorErrors(camera=cast(Any, "1 mm"))
    with pytest.raises(TaskError, match="nothing was noted"):
        EstimateLog().draw("nowhere.png")


def test_an_empty_log_is_refused_whatever_is_asked_of_it(tmp_path: Path) -> None:
    log, file = EstimateLog(), tmp_path / "errors"
    asked = (lambda: log.draw(file), lambda: log.write_csv(file), lambda: log.within_two_sigma)
    for ask in asked:
        with pytest.raises(TaskError, match="nothing was noted; give a trial with an estimator"):
            ask()
    assert not file.exists()
    assert log.error.shape == (0, 6)


def test_an_estimator_is_told_the_size_of_errors_and_no_draw() -> None:
    one, other = (SensorErrors.of(ERROR_MODELS["rough"].seeded(seed)) for seed in (1, 2))
    assert one == other
    assert one.joint_offset == ERROR_MODELS["rough"].encoder_offset
    assert SensorErrors.of(None).camera > 0
