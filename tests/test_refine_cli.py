"""The command ``refine``: given poses of files become plans, a row for each."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import PlanOf
from plain_check import doubts
from typer.testing import CliRunner

from benchmarks.refine import perturbed
from planner import GraspTask, plan_grasp, read_plan, write_plan
from planner.plan import GraspPlan
from planner.spatial import SE3, pose_to_wxyz
from sim.cli import app

pytestmark = pytest.mark.usefixtures("brief_trials")

RUN = CliRunner()


@pytest.fixture(scope="module")
def plan(plan_of: PlanOf) -> GraspPlan:
    return plan_of("allegro_hand", "box", table_height=None)


def table_file(path: Path, plan: GraspPlan, poses: dict[str, tuple[SE3, Any]], **head: Any) -> Path:
    """Poses as a table of another tool, in the object's frame."""
    grasps = []
    for name, (T_world_base, q) in poses.items():
        position, quaternion = pose_to_wxyz(plan.task.T_world_object.inverse() * T_world_base)
        grasps.append(
            {
                "name": name,
                "position": position.tolist(),
                "quaternion_wxyz": quaternion.tolist(),
                "joints": np.asarray(q).tolist(),
            }
        )
    data = {
        "format": "opposable-grasp-table",
        "version": 1,
        "joint_names": list(plan.task.hand.joint_names),
        "grasps": grasps,
        **head,
    }
    path.write_text(json.dumps(data))
    return path


def asked(*words: object) -> Any:
    return RUN.invoke(app, ["refine", *map(str, words)])


BOX = ("--hand", "allegro_hand", "--object", "box")


def test_a_table_of_poses_becomes_plans(plan: GraspPlan, tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    poses = {f"pose {k}": perturbed(plan, 0.006, 0.1, rng) for k in range(2)}
    file = table_file(tmp_path / "poses.json", plan, poses)
    done = asked(file, *BOX, "--out", tmp_path / "out")
    assert done.exit_code == 0, done.output
    assert "2 of 2 brought back" in done.output
    rows = json.loads((tmp_path / "out" / "refined.json").read_text())["grasps"]
    assert [row["name"] for row in rows] == list(poses)
    for row, (base, q) in zip(rows, poses.values(), strict=True):
        found = read_plan(tmp_path / "out" / row["plan"])  # verified again as it is read
        assert doubts(found) == []
        assert row["joint_rad"] == pytest.approx(np.abs(found.q - q).max(), abs=1e-6)
        moved = np.linalg.norm(found.T_world_base.translation - base.translation)
        assert moved < 0.02
        assert max(row["contact_m"]) < 0.012
        assert row["cpu_s"] > 0.0


def test_a_pose_that_cannot_be_brought_back_is_told_and_the_others_are_kept(
    plan: GraspPlan, tmp_path: Path
) -> None:
    far = SE3(plan.T_world_base.rotation, plan.T_world_base.translation + 3.0)
    poses = {"far": (far, plan.q), "good": (plan.T_world_base, plan.q)}
    file = table_file(tmp_path / "poses.json", plan, poses)
    done = asked(file, *BOX, "--out", tmp_path / "out", "--json")
    assert done.exit_code == 1
    report = json.loads(done.stdout)
    assert [row["failure"] for row in report["grasps"]] == ["too_few_pads", ""]
    assert "no pad comes near" in report["grasps"][0]["reason"]
    assert report["found"] == 1
    assert len(list((tmp_path / "out").glob("*-*.json"))) == 1
    only = table_file(tmp_path / "far.json", plan, {"far": (far, plan.q)})
    assert asked(only, *BOX, "--out", tmp_path / "none").exit_code == 4


def test_of_a_plan_file_only_the_pose_is_taken(plan: GraspPlan, tmp_path: Path) -> None:
    path = tmp_path / "plan.json"
    write_plan(plan, path)
    data = json.loads(path.read_text())
    data["grasp"]["T_world_base"]["position_m"][0] += 0.006
    data["grasp"]["q_rad"][2] += 0.1
    path.write_text(json.dumps(data))  # no plan any more: reading it as one is refused
    done = asked(path, "--out", tmp_path / "out")
    assert done.exit_code == 0, done.output
    found = read_plan(tmp_path / "out" / "0-plan.json")
    assert found.task.table_height is None
    assert asked(path, *BOX, "--out", tmp_path / "out").exit_code == 3


def test_another_size_of_the_object_is_that_of_its_grasp(plan: GraspPlan, tmp_path: Path) -> None:
    sphere = plan_grasp(GraspTask.create("allegro_hand", "sphere:0.036", table_height=None))
    file = table_file(tmp_path / "poses.json", sphere, {"one": (sphere.T_world_base, sphere.q)})
    data = json.loads(file.read_text())
    data["grasps"][0]["scale"] = 0.9
    file.write_text(json.dumps(data))
    words = ("--hand", "allegro_hand", "--object", "sphere:0.04", "--out", tmp_path / "out")
    done = asked(file, *words)
    assert done.exit_code == 0, done.output
    found = read_plan(next((tmp_path / "out").glob("0-*.json")))
    assert found.task.object.shape.half_extents == pytest.approx([0.036] * 3)
    assert found.q == pytest.approx(sphere.q, abs=1e-6)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("nowhere.json", *BOX), "nowhere.json does not exist"),
        (("{poses}", "--hand", "allegro_hand"), "give --object"),
        (("{poses}", "--object", "box"), "give --hand"),
        (("{poses}", *BOX, "--unit", "cm"), "--unit 'cm' is none of m, mm"),
        (
            ("{poses}", "--hand", "shadow_hand", "--object", "box"),
            "does not fit shadow_hand: it lacks WRJ2, WRJ1, FFJ4, FFJ3, ... (24 in all) and names "
            "index_0, index_1, index_2, index_3, ... (16 in all), which shadow_hand does not have; "
            "give the hand that the file is for",
        ),
        (("{poses}", *BOX, "--format", "nothing"), "no format is called 'nothing'"),
        (
            ("{poses}", *BOX, "--format", "ros2-trajectory"),
            "ros2-trajectory is written only; formats that are read: dexgraspbench,",
        ),
    ],
)
def test_what_is_wrong_is_one_line(
    plan: GraspPlan, tmp_path: Path, words: tuple[str, ...], said: str
) -> None:
    file = table_file(tmp_path / "poses.json", plan, {"one": (plan.T_world_base, plan.q)})
    told = [word.replace("{poses}", str(file)) for word in words]
    done = asked(*told, "--out", tmp_path / "out")
    assert done.exit_code == 3
    assert said in " ".join(done.output.split())
    assert not (tmp_path / "out").exists()


def test_millimetres_are_noticed(plan: GraspPlan, tmp_path: Path) -> None:
    """By the check of ``audit``, with its words; poses that are nearly grasps are let through."""
    rng = np.random.default_rng(0)
    poses = {f"pose {k}": perturbed(plan, 0.01, 0.1, rng) for k in range(4)}
    file = table_file(tmp_path / "poses.json", plan, poses)
    data = json.loads(file.read_text())
    for grasp in data["grasps"]:
        grasp["position"] = [1e3 * p for p in grasp["position"]]
    file.write_text(json.dumps(data))
    done = asked(file, *BOX, "--out", tmp_path / "out")
    assert done.exit_code == 3, done.output
    assert "with lengths in millimetres, " in done.output and "give --unit mm" in done.output
    assert not (tmp_path / "out").exists()
    done = asked(file, *BOX, "--unit", "mm", "--out", tmp_path / "out")
    assert "4 of 4 brought back" in done.output


@pytest.mark.slow
def test_what_is_refined_is_read_again(plan: GraspPlan, tmp_path: Path) -> None:
    """The folder that ``refine`` writes is an input of every command that takes plans."""
    poses = {name: (plan.T_world_base, plan.q) for name in ("a", "b")}
    folder = tmp_path / "out"
    assert asked(table_file(tmp_path / "p.json", plan, poses), *BOX, "--out", folder).exit_code == 0

    def run(*words: object) -> tuple[int, str]:
        done = RUN.invoke(app, [str(w) for w in words])
        return done.exit_code, " ".join(done.output.split())

    assert run("refine", "--judge-only", folder)[1].endswith("2 of 2 grasps pass")
    rows = json.loads(RUN.invoke(app, ["refine", "--judge-only", str(folder), "--json"]).stdout)[
        "rows"
    ]
    assert [row["name"] for row in rows] == ["0-a", "1-b"]
    assert "2 of 2 brought back" in run("refine", folder, "-o", tmp_path / "again")[1]
    assert "2 plans written" in run("export", folder, "--to", "table", "-o", tmp_path / "t.csv")[1]
    code, said = run("test", folder)  # each of them, one after the other
    assert code == 0
    assert all(f"{name}: " in said for name in ("0-a.json", "1-b.json"))
    refused = run("test", folder, "-o", tmp_path / "report.json")
    assert refused[0] == 3 and "--out, --picture and --video are of one plan" in refused[1]
    one = ("certify", folder)
    assert "holds 2 plans, and one is taken; give a file of it: 0-a.json, 1-b.json" in run(*one)[1]
    for file in folder.glob("*-*.json"):
        file.unlink()
    code, said = run("test", folder)
    assert code == 3 and "is a folder without plan files; give plan files" in said
    code, said = run("export", folder, "--to", "table", "-o", tmp_path / "t.csv")
    assert code == 3 and "holds neither plan files nor a batch" in said


def test_what_a_plan_brings_is_not_told_again(plan: GraspPlan, tmp_path: Path) -> None:
    write_plan(plan, tmp_path / "plan.json")
    done = asked(tmp_path / "plan.json", "--mu", "0.3", "--hand", "shadow_hand")
    assert done.exit_code == 3
    assert "brings hand, object and surroundings; leave --hand, --mu out" in done.output


def test_a_table_brings_its_hand_and_object(plan: GraspPlan, tmp_path: Path) -> None:
    poses = {"a": (plan.T_world_base, plan.q)}
    file = table_file(tmp_path / "p.json", plan, poses, hand="allegro_hand")
    data = json.loads(file.read_text())
    data["grasps"][0]["object"] = plan.task.object.shape.spec
    file.write_text(json.dumps(data))
    done = asked(file, "--out", tmp_path / "out")
    assert done.exit_code == 0, done.output
    found = read_plan(tmp_path / "out" / "0-a.json")
    assert found.task.object.shape.spec == plan.task.object.shape.spec


def test_ctrl_c_keeps_what_was_refined(
    plan: GraspPlan, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from planner.batch import refine_grasps

    def pressed(*args: Any, **options: Any) -> Any:
        yield next(refine_grasps(*args, **options))
        raise KeyboardInterrupt

    monkeypatch.setattr("planner.batch.refine_grasps", pressed)
    poses = {name: (plan.T_world_base, plan.q) for name in ("first", "second")}
    file = table_file(tmp_path / "poses.json", plan, poses)
    done = asked(file, *BOX, "--out", tmp_path / "out")
    assert done.exit_code == 130
    assert "1 of 2 are kept" in " ".join(done.output.split())
    assert json.loads((tmp_path / "out" / "refined.json").read_text())["total"] == 2
    assert len(list((tmp_path / "out").glob("0-*.json"))) == 1


def test_plans_of_two_runs_never_lie_beside_each_other(tmp_path: Path, plan: GraspPlan) -> None:
    write_plan(plan, tmp_path / "plan.json")
    folder = tmp_path / "refined"
    folder.mkdir()
    (folder / "0-earlier.json").write_text("{}")
    done = RUN.invoke(app, ["refine", str(tmp_path / "plan.json"), "--out", str(folder)])
    assert done.exit_code == 3
    assert "is not empty; name another folder" in " ".join(done.output.split())
    assert [path.name for path in folder.iterdir()] == ["0-earlier.json"]
