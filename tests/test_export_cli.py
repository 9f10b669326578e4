"""``opposable export`` and ``benchmarks exports``: what goes in, is refused, and comes back."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from benching import run_bench
from commands import opposable

from benchmarks import exports
from planner.batch import GraspSet, plan_grasps
from planner.errors import TaskError
from planner.exchange import export_plans
from planner.exchange.formats import FORMATS, load_formats
from planner.exchange.joints import T_object_body
from planner.files import write_plan
from planner.hands.hand import Hand
from planner.search.grasp import plan_grasp
from planner.task import GraspTask

pytest.importorskip("yaml")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory, allegro: Hand) -> Path:
    """With a plan, plan.json, and a batch, set."""
    pytest.importorskip("pyarrow")
    folder = tmp_path_factory.mktemp("export")
    write_plan(plan_grasp(GraspTask.create(allegro, "box"), seed=0), folder / "plan.json")
    plan_grasps("allegro_hand", ["sphere", "mug"], 3, workers=1, out=folder / "set")
    return folder


def test_a_plan_is_written_and_what_is_lost_is_said(folder: Path, tmp_path: Path) -> None:
    file = tmp_path / "g.json"
    words = ("export", folder / "plan.json", "--to", "ros2-grasp", "-o", file)
    code, out, _ = opposable(*words, "--rename", "thumb_0=joint_12", "--json")
    assert code == 0
    told = json.loads(out)
    assert told == {
        "format": "ros2-grasp",
        "count": 1,
        "files": [str(file)],
        "lost": FORMATS["ros2-grasp"].loses,
        "notes": [],
    }
    (message,) = json.loads(file.read_text(encoding="utf-8"))
    assert "joint_12" in message["grasp_posture"]["joint_names"]
    (tmp_path / "names.toml").write_text('thumb_1 = "joint_13"', encoding="utf-8")
    code, out, _ = opposable(*words, "--rename", tmp_path / "names.toml")
    assert code == 0
    assert "1 plan written to" in out
    assert f"not in it: {FORMATS['ros2-grasp'].loses}" in out
    (message,) = json.loads(file.read_text(encoding="utf-8"))
    assert "joint_13" in message["grasp_posture"]["joint_names"]


def test_grasps_are_chosen_out_of_a_batch(folder: Path, tmp_path: Path) -> None:
    batch, file = folder / "set", tmp_path / "g.json"
    words = ("--to", "ros2-grasp", "-o", file)
    found = [sum(1 for _ in GraspSet(batch).found(label)) for label in GraspSet(batch).labels]
    for choice, count in (
        ((), sum(found)),
        (("-n", "2"), sum(min(n, 2) for n in found)),
        (("--objects", GraspSet(batch).labels[0], "-n", "1"), 1),
    ):
        code, out, err = opposable("export", batch, *words, *choice)
        assert code == 0, err
        messages = json.loads(file.read_text(encoding="utf-8"))
        assert len(messages) == count
        assert f"{count} plan{'s' if count > 1 else ''} written" in out
    row = next(iter(GraspSet(batch).found(GraspSet(batch).labels[0])))[1]
    np.testing.assert_allclose(
        messages[0]["grasp_posture"]["points"][0]["positions"], row["q_rad"], atol=1e-12
    )


def test_what_cannot_be_is_refused_before_anything_is_written(folder: Path, tmp_path: Path) -> None:
    plan, batch, file = folder / "plan.json", folder / "set", tmp_path / "g.yaml"
    grasp = ("--to", "isaac-grasp", "-o", file)
    for words, code, said in (
        ((plan,), 2, "give plans or a batch, --to FORMAT and -o PATH"),
        ((plan, "--to", "isaac", "-o", file), 3, "Did you mean 'isaac-grasp'?"),
        ((plan, *grasp, "--world-frame", "map"), 3, "isaac-grasp has no place for world_frame; it"),
        ((plan, *grasp, "--by", "motors"), 3, "by is 'motors'; give joints or actuators"),
        ((plan, *grasp, "--rename", "=x"), 3, "--rename '=x' lacks a name; give OLD=NEW"),
        ((plan, *grasp, "--rename", "none.toml"), 3, "cannot read a file of names none.toml"),
        ((plan, *grasp, "--rename", "thum_0=x"), 3, "Did you mean 'thumb_0'?"),
        ((plan, *grasp, "-n", "2"), 3, "no folder of a batch is given"),
        ((folder / "no.json", *grasp), 3, "no.json does not exist; give plan files"),
        ((batch / "manifest.json", *grasp), 3, "what can be exported is opposable-plan"),
        ((batch, *grasp), 3, "more than one object"),
        ((batch, *grasp, "--objects", "cup"), 3, "no object of the batch is called 'cup'"),
        ((plan, "--to", "isaac-grasp", "-o", tmp_path / "a" / "b.yaml"), 3, "there is no folder"),
        (
            (plan, "--to", "isaac-grasp", "-o", tmp_path / "g.txt"),
            3,
            f"ends with .txt, and files of isaac-grasp end with .yaml or .yml; name it {file}",
        ),
        ((plan, "--to", "ros2-grasp", "-o", tmp_path / "g"), 3, ".yml or .json; name it"),
        ((plan, "--to", "table", "-o", tmp_path / "g.yaml"), 3, ".csv or .json or .npz; name it"),
        (
            (plan, "--to", "mjcf-scene", "-o", tmp_path / "scene.xml"),
            3,
            f"ends with .xml, and mjcf-scene is a folder; name one: {tmp_path / 'scene'}",
        ),
        ((plan, "--to", "nothing", "-o", file), 3, "There is: dexgraspbench, isaac-grasp, mjcf-sc"),
    ):
        given = opposable("export", *words)
        assert (given[0], said in given[2]) == (code, True), given
    assert not list(tmp_path.iterdir())
    with pytest.raises(TaskError, match="there are no plans to export"):
        export_plans([], file, "isaac-grasp")


def test_all_formats_are_listed() -> None:
    load_formats()
    code, out, _ = opposable("export", "--list")
    assert code == 0
    for form in FORMATS.values():
        assert f"{form.name} (" in out
    rows = json.loads(opposable("export", "--list", "--json")[1])["formats"]
    assert [row["name"] for row in rows] == list(FORMATS)
    (isaac,) = [row for row in rows if row["name"] == "isaac-grasp"]
    assert (isaac["reads"], isaac["writes"], isaac["movements"]) == (True, True, False)


@pytest.mark.slow
def test_a_round_trip_is_measured_and_an_error_is_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    def trips(formats: str) -> list[dict[str, Any]]:
        result = run_bench(
            "exports", hands=["allegro_hand"], objects="sphere", n=2, formats=formats
        )
        return list(result["rows"][0]["trips"])

    for trip in trips("isaac-grasp,ros2-grasp"):
        assert (trip["asked"], trip["back"], trip["within"], trip["refused"]) == (2, 2, 2, "")
        assert max(trip["position_m"] + trip["rotation_rad"] + trip["q_rad"]) <= 1e-12

    def off(plan: object) -> object:
        pose = T_object_body(plan).copy()  # type: ignore[arg-type]
        pose.translation[0] += 2e-6
        return pose

    monkeypatch.setattr(exports, "T_object_body", off)
    (trip,) = trips("isaac-grasp")
    assert (trip["back"], trip["within"]) == (2, 0)
    assert trip["position_m"] == pytest.approx([2e-6] * 2, rel=1e-6)
    monkeypatch.undo()
    form = FORMATS["isaac-grasp"]

    def none(*_: object) -> object:
        raise TaskError("not today")

    monkeypatch.setitem(FORMATS, "isaac-grasp", replace(form, write=none))  # type: ignore[arg-type]
    (trip,) = trips("isaac-grasp")
    assert (trip["asked"], trip["back"], trip["refused"]) == (2, 0, "not today")
