"""error models by name and out of files, and what reports say was drawn of them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
from conftest import PlanOf

from planner.errors import FileFormatError, NotFoundError, TaskError
from planner.plan import GraspPlan
from sim.cli.execution import error_model_of
from sim.presets import SUFFIXES
from sim.protocols import Settings, run_protocol
from sim.scene.carrier import Timeline
from sim.screen import error_lines
from sim.sensing.errors import (
    ERROR_MODELS,
    Drawn,
    ErrorModel,
    drawn_numbers,
    drawn_text,
    named_errors,
    register_errors,
)
from sim.simulation import Simulation
from sim.trial import simulate

pytestmark = pytest.mark.usefixtures("coarse_steps")


@pytest.fixture(scope="module")
def plan(plan_of: PlanOf) -> GraspPlan:
    return plan_of("allegro_hand", "sphere")


def written(tmp_path: Path, name: str, text: str) -> Path:
    path = tmp_path / name
    path.write_text(text, encoding="utf-8")
    return path


def test_a_file_changes_a_preset(tmp_path: Path) -> None:
    text = 'preset = "lab"\nencoder_offset = 0.05\ntouch = "effort"\nseed = 4\n'
    found = ERROR_MODELS.given(str(written(tmp_path, "mine.toml", text)))
    lab = ERROR_MODELS["lab"]
    assert found == replace(lab, name="mine.toml", encoder_offset=0.05, touch="effort", seed=4)


def test_a_preset_is_a_name_and_a_file_is_a_path(tmp_path: Path) -> None:
    kept = ERROR_MODELS
    assert kept.given("rough") is ERROR_MODELS["rough"]
    for suffix, text in zip(SUFFIXES, ('preset = "rough"', '{"preset": "rough"}'), strict=True):
        path = written(tmp_path, f"mine{suffix}", text)
        assert kept.given(str(path)) == replace(ERROR_MODELS["rough"], name=path.name)
    with pytest.raises(NotFoundError, match=r"'rogh'.*lab.*TOML or JSON"):
        kept.given("rogh")


def test_a_file_without_preset_changes_ideal_and_may_have_a_name(tmp_path: Path) -> None:
    path = written(tmp_path, "a.json", '{"name": "rig", "command_delay": 0.01}')
    assert ERROR_MODELS.read(path) == ErrorModel(name="rig", command_delay=0.01)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("encoder_ofset = 0.1", "encoder_ofset: no such field; give some of preset, name, encoder"),
        ("encoder_offset = -0.1", "encoder_offset is -0.1; give a finite number"),
        ('pose_noise = "1 mm"', "pose_noise is '1 mm', not a number; give a finite number"),
        ("object_mass = 1.0", "object_mass is 1.0; give a share in"),
        ("seed = 1.5", "seed is 1.5; give an integer"),
        ('name = ""', "name is ''; give a text"),
        ("preset = 3", "preset is 3; give one of ideal, lab, rough"),
    ],
)
def test_bad_fields_are_named_with_the_file(tmp_path: Path, text: str, said: str) -> None:
    with pytest.raises(TaskError, match=f"bad.toml: .*{said}"):
        ERROR_MODELS.given(str(written(tmp_path, "bad.toml", text)))


def test_bad_files_are_told(tmp_path: Path) -> None:
    with pytest.raises(FileFormatError, match="cannot read the error model file"):
        ERROR_MODELS.given(str(tmp_path / "none.toml"))
    with pytest.raises(FileFormatError, match="no TOML or JSON by its ending"):
        ERROR_MODELS.given(str(written(tmp_path, "a.json", "seed = 3")))
    with pytest.raises(
        NotFoundError, match=r"no error model is called .labs.\. Did you mean .lab."
    ):
        ERROR_MODELS.given(str(written(tmp_path, "b.toml", 'preset = "labs"')))
    with pytest.raises(NotFoundError, match="no sense of touch is called 'skin'"):
        ERROR_MODELS.given(str(written(tmp_path, "c.toml", 'touch = "skin"')))
    with pytest.raises(NotFoundError, match="A TOML or JSON file of fields is taken too"):
        ERROR_MODELS.given("./mine")


@pytest.mark.slow
def test_a_error_model_is_taken_by_its_name(plan: GraspPlan) -> None:
    by_name = Simulation(plan, error_model="lab").error_model
    assert by_name is not None
    assert by_name.drawn.to_dict() == Drawn.of(ERROR_MODELS["lab"], plan.task.hand).to_dict()
    assert ERROR_MODELS.given(None) == ErrorModel()
    with pytest.raises(NotFoundError, match="no error model is called 'labs'"):
        simulate(plan, error_model="labs")
    for wrong in ({"preset": "lab"}, 3, ErrorModel):
        with pytest.raises(TaskError, match="give a ErrorModel, one of ideal, lab, rough"):
            simulate(plan, error_model=cast(Any, wrong))


def test_alone_asks_for_errors() -> None:
    lab = ERROR_MODELS["lab"]
    with pytest.raises(TaskError, match=r"only\(\) was given no name"):
        lab.only()
    for kept in ("touch", "seed", "drift_time", "name"):
        with pytest.raises(TaskError, match=f"{kept} is always kept"):
            lab.only(kept)


def test_what_is_registered_is_an_error_model() -> None:
    with pytest.raises(TaskError, match="'lab' is no error model; give a ErrorModel"):
        register_errors(cast(Any, "lab"))


def test_the_command_line_takes_a_seed_only_where_something_is_drawn() -> None:
    assert error_model_of("lab", 3) == named_errors("lab", 3)
    assert error_model_of("ideal", 3, "taxels").seed == 3  # taxels have noise
    assert error_model_of("ideal", 3, draws=True).seed == 3
    with pytest.raises(TaskError, match="the error model 'ideal' has none; give --error-model lab"):
        error_model_of("ideal", 3)
    with pytest.raises(TaskError, match="--error-seed 3"):
        error_model_of("ideal", 3, "exact")


def test_the_command_line_keeps_seed_and_touch_of_a_file(tmp_path: Path) -> None:
    path = str(written(tmp_path, "m.toml", 'preset = "lab"\ntouch = "binary"\nseed = 4\n'))
    assert (error_model_of(path).seed, error_model_of(path).touch) == (4, "binary")
    assert (error_model_of(path, 0, "exact").seed, error_model_of(path, 0, "exact").touch) == (
        0,
        "exact",
    )


# --- what was drawn ----------------------------------------------------------------------------


def test_draws_are_told_in_the_units_of_people(plan: GraspPlan) -> None:
    hand = plan.task.hand
    offset = np.zeros(hand.nq)
    offset[3] = -np.deg2rad(2.1)
    drawn = replace(
        Drawn.of(ErrorModel(), hand),
        encoder_offset=offset,
        mass=1.184,
        friction=0.72,
        pose_bias=np.array([0.0, 0.003, 0.004]),
        center=np.array([0.02, -0.08, 0.0]),
    )
    assert drawn_text([drawn_numbers(drawn, hand)]) == (
        "joints up to 2.1 degrees off, poses 5.0 mm aside, mass x 1.18, "
        "centre of mass up to 8 % of half the extents aside, friction x 0.72"
    )
    lighter = replace(drawn, mass=0.9, encoder_offset=0.5 * offset)
    both = drawn_text([drawn_numbers(d, hand) for d in (drawn, lighter)])
    assert "joints up to 2.1 degrees off" in both  # the worst
    assert "mass x 0.90 to 1.18" in both
    assert drawn_text([drawn_numbers(Drawn.of(ErrorModel(), hand), hand)]) == ""


def test_a_report_says_what_was_drawn(plan: GraspPlan) -> None:
    asked = named_errors("lab", 3)
    short = Timeline.quick(hold=0.1)
    report = simulate(plan, timeline=short, error_model=asked, estimator="none")
    drawn = Drawn.of(asked, plan.task.hand)
    line = f"drawn: {drawn_text([drawn_numbers(drawn, plan.task.hand)])}"
    assert error_lines(report.error_model) == ["error model: lab, seed 3, estimator: none", line]
    assert f"mass x {drawn.mass:.2f}, friction x {drawn.friction:.2f}" in line
    assert line in " ".join(str(text) for text in report.details())
    assert error_lines(None) == []


@pytest.mark.slow
def test_a_protocol_says_what_it_drew_and_what_a_failure_had(plan: GraspPlan) -> None:
    error_model = ErrorModel(name="heavy", object_mass=0.3, encoder_offset=0.5, seed=2)
    report = run_protocol(plan, "errors", settings=Settings(error_draws=2), error_model=error_model)
    told = " ".join(str(report).split())
    hand = plan.task.hand
    draws = [drawn_numbers(Drawn.of(error_model.seeded(2 + k), hand), hand) for k in range(2)]
    assert f"error model: heavy, seed 2, estimator: none drawn: {drawn_text(draws)}" in told
    assert report.failed  # with joints 29 degrees off
    for outcome in report.failed:
        assert f"(drawn: {drawn_text([draws[outcome.index]])})" in told


@pytest.mark.slow
def test_other_protocols_draw_once(plan: GraspPlan) -> None:
    report = run_protocol(
        plan, "shake", error_model=named_errors("lab", 3), only=["shake x"], estimator="none"
    )
    drawn = drawn_numbers(Drawn.of(named_errors("lab", 3), plan.task.hand), plan.task.hand)
    assert f"drawn: {drawn_text([drawn])}" in " ".join(str(report).split())
    exact = run_protocol(plan, "shake", only=["shake x"])
    assert "error_model" not in str(exact)
