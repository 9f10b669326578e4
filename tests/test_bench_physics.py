"""``bench physics``: what is asked, what rows say of grip, noslip and the formula, and tables."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from rich.console import Console

from benchmarks import manipulate
from benchmarks.objects import bench_objects
from benchmarks.physics import (
    PARTS,
    PhysicsJob,
    physics_jobs,
    physics_row,
    physics_tables,
    run_physics,
)
from benchmarks.physics_variants import VARIANTS
from planner.errors import NotFoundError
from planner.plan import GraspPlan
from planner.search import plan_grasp
from planner.synthesis.options import SynthesisOptions
from planner.task import GraspTask
from planner.verification.grasp import with_grip
from sim.physics import PRESETS, PhysicsOptions
from sim.reality import Reality
from sim.runner import Runner

BOX = bench_objects(["box"])
HEIGHT_M = 0.08


def row_of(part: str, case: str, hand: str = "allegro_hand", spec: str = "box") -> dict[str, Any]:
    job = PhysicsJob(index=0, part=part, hand=hand, spec=spec, label=spec, case=case)
    return physics_row(job, lambda: None)


@pytest.fixture(scope="module")
def amid() -> GraspPlan:
    """A box held so far below its upper rim that it is held while creep is measured.

    Under MuJoCo's defaults pads climb by 5.5 mm/s, for 1.7 s until creep is measured. A pad near
    the rim (rounds on epsilon spread them, to 4 mm from it) is past it before: the box is lost.
    """
    task, options = GraspTask.create("allegro_hand", "box"), SynthesisOptions(rounds=0)
    plans = (plan_grasp(task, seed=seed, options=options) for seed in range(10))
    return next(p for p in plans if HEIGHT_M - p.contacts.positions[:, 2].max() > 5.5e-3 * 1.7)


def creep_of(plan: GraspPlan, case: str) -> dict[str, Any]:
    return {"error": "", **PARTS["creep"][0](plan, case, Reality())}


def test_jobs_have_numbers_that_do_not_depend_on_the_parts_asked_for() -> None:
    every = {j.index: (j.part, j.case) for j in physics_jobs(["a", "b"], BOX, list(PARTS))}
    some = {j.index: (j.part, j.case) for j in physics_jobs(["a", "b"], BOX, ["creep"])}
    assert len(every) == 2 * sum(len(cases) for _, cases in PARTS.values())
    assert some == {k: v for k, v in every.items() if v[0] == "creep"}
    assert PARTS["holds"][1] == tuple(PRESETS)
    with pytest.raises(NotFoundError, match="no part is called 'hold'"):
        physics_jobs(["a"], BOX, ["hold"])


def test_variants_change_what_they_say() -> None:
    soft = PRESETS["mujoco-default"]
    for name, variant in VARIANTS.items():
        assert (variant.grip != 1.0) == ("grip" in name)
        assert isinstance(variant.physics, PhysicsOptions)
    assert VARIANTS["mujoco-default"].physics == soft
    assert VARIANTS["noslip 10"].physics.label == "mujoco-default with noslip_iterations 10"
    assert VARIANTS["condim 4"].physics.label == "mujoco-default with condim 4"


@pytest.mark.parametrize("case", ["mujoco-default", "elliptic", "solref 0.005"])
def test_creep_of_a_held_box_is_that_of_the_formula(amid: GraspPlan, case: str) -> None:
    row = creep_of(amid, case)
    assert row["error"] == ""
    assert row["predicted_mm_s"] >= row["least_mm_s"] > 1.0
    assert row["creep_mm_s"] == pytest.approx(row["predicted_mm_s"], rel=0.15)


@pytest.mark.slow
def test_noslip_ends_creep_and_more_grip_does_not(amid: GraspPlan) -> None:
    soft = creep_of(amid, "mujoco-default")["creep_mm_s"]
    assert creep_of(amid, "noslip 10")["creep_mm_s"] < 0.01 * soft
    assert creep_of(amid, "elliptic, impratio 10")["creep_mm_s"] < 0.15 * soft
    assert creep_of(amid, "grip x 1.5")["creep_mm_s"] > 0.8 * soft


def test_a_grip_beyond_the_motors_is_told(amid: GraspPlan) -> None:
    """Of a plan that presses as hard as its motors can, by halving."""
    least, most = amid.task.grip_force, 1e3
    while most > 1.01 * least:
        middle = (least + most) / 2
        least, most = (middle, most) if with_grip(amid, middle).forces.found else (least, middle)
    firmest = with_grip(amid, least)
    assert firmest.forces.found
    assert creep_of(firmest, "grip x 1.5")["error"] == "the hand cannot press so hard"
    assert creep_of(with_grip(amid, least / 2), "grip x 1.5")["error"] == ""


def test_creep_is_a_part_of_what_rows_say() -> None:
    """Noslip holds whatever grasp the seed gives."""
    row = row_of("creep", "noslip 10")
    assert row["error"] == ""
    assert row["creep_mm_s"] < 0.01 * row["predicted_mm_s"]


@pytest.mark.slow
def test_a_grasp_is_lost_by_the_defaults_and_held_by_a_remedy() -> None:
    lost = row_of("holds", "mujoco-default")
    assert (lost["held"], lost["reason"]) == (False, "slipped")
    held = row_of("remedies", "contacts")
    assert held["held"]
    assert 'priority="1"' in held["what"]
    assert held["physics"].startswith("mujoco-default with solref")


def test_objects_that_cannot_be_planned_are_a_row() -> None:
    row = row_of("holds", "ours", spec="sphere:5")
    assert row["error"]
    assert "held" not in row


@pytest.mark.slow
def test_tables_count_and_files_go_on(tmp_path: Path) -> None:
    file = tmp_path / "rows.jsonl"
    runner = Runner(console=Console(quiet=True), check=lambda: None, workers=1)
    once = run_physics(["allegro_hand"], BOX, ["remedies"], file=file, runner=runner)
    size = file.stat().st_size
    again = run_physics(["allegro_hand"], BOX, ["remedies"], file=file, runner=runner)
    assert file.stat().st_size == size
    assert once["rows"] == again["rows"]
    assert once["physics"]["mujoco-default"]["impratio"] == 1.0
    assert [table.row_count for table in physics_tables(once)] == [3, 1]
    made = [
        {"part": "creep", "case": "x", "error": "", "creep_mm_s": 2.0, "predicted_mm_s": 1.0}
        | {"least_mm_s": 0.5, "hand": "h", "object": "o"},
        {"part": "creep", "case": "x", "error": "lost", "hand": "h", "object": "p"},
    ]
    wide = Console(width=200)
    with wide.capture() as told:
        wide.print(*physics_tables({"rows": made}))
    cells = told.get().splitlines()[-2].split()
    assert cells == ["x", "1", "2.000", "1.000", "0.500", "2.00", "1", "0"]


def test_turns_are_made_under_the_physics_asked_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[dict[str, Any]] = []
    jobs: list[manipulate.Turn] = []

    def keep(
        runner: Runner, work: object, turns: list[manipulate.Turn], **given: Any
    ) -> dict[str, Any]:
        del runner, work
        jobs.extend(turns)
        asked.append(given["asked"])
        return {}

    monkeypatch.setattr(manipulate, "run_cases", keep)
    runner = Runner(console=Console(quiet=True), check=lambda: None, workers=1)
    given: dict[str, Any] = {"height": 0.08, "fingers": None, "stand": 0.0, "seed": 0}
    given |= {"file": tmp_path / "rows.jsonl", "runner": runner}
    manipulate.run_manipulate(["allegro_hand"], ["cylinder"], 1, **given)
    soft = PRESETS["mujoco-default"]
    manipulate.run_manipulate(["allegro_hand"], ["cylinder"], 1, **given, physics=soft)
    assert [job.physics for job in jobs] == [PhysicsOptions(), soft]
    assert "physics" not in asked[0]  # files go on that were begun before there was a choice
    assert asked[1]["physics"]["name"] == "mujoco-default"
    assert "mu" not in asked[1]["physics"]  # it is drawn
