"""``opposable refine --judge-only``: files of others, plans and batches of ours, exit codes."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from typer.testing import CliRunner

from planner.batch import GraspSet, plan_grasps
from planner.exchange.audit import plans_as_imported
from planner.exchange.dexgraspbench import export_dexgraspbench
from planner.exchange.formats import Writing
from planner.exchange.table import write_table
from planner.files import write_plan
from planner.plan import GraspPlan
from planner.search.grasp import plan_grasp
from planner.task import GraspTask
from sim.cli import app
from sim.protocols.dexgraspbench import hold_imported_grasp

RUN = CliRunner()
BOX = "box:0.05x0.05x0.08"
FOR = ["--hand", "allegro_hand", "--object", BOX, "--workers", "1"]


@pytest.fixture(scope="module")
def plans() -> list[GraspPlan]:
    task = GraspTask.create("allegro_hand", BOX)
    return [plan_grasp(task, seed=seed) for seed in range(3)]


@pytest.fixture(scope="module")
def folder(plans: list[GraspPlan], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A good table, one with a bad grasp, a plan, a batch and its export."""
    made = tmp_path_factory.mktemp("audit")
    write_table(plans, made / "good.csv", Writing())
    worse = replace(plans[0], q=plans[0].q_pregrasp)
    write_table([*plans, worse], made / "bad.json", Writing())
    plain = json.loads((made / "bad.json").read_text())
    del plain["hand"]
    for k, grasp in enumerate(plain["grasps"]):
        grasp["object"] = ("can", "can", "pot", BOX)[k]
    (made / "plain.json").write_text(json.dumps(plain))
    write_plan(plans[0], made / "plan.json")
    plan_grasps("allegro_hand", [BOX], 2, seed=1, workers=1, out=made / "set")
    export_dexgraspbench(GraspSet(made / "set"), made / "out")
    return made


def test_good_grasps_exit_with_0_and_bad_ones_with_1(folder: Path, tmp_path: Path) -> None:
    done = RUN.invoke(app, ["refine", "--judge-only", str(folder / "good.csv"), *FOR])
    assert done.exit_code == 0, done.output
    assert "3 of 3 grasps pass" in done.output
    rows = tmp_path / "rows.csv"
    done = RUN.invoke(
        app, ["refine", "--judge-only", str(folder / "bad.json"), *FOR, "--out", str(rows)]
    )
    assert done.exit_code == 1, done.output
    for words in (
        "3 of 4 grasps pass, 1 fail first at gap",
        "mm from the surface",
        "75.0 %",
        "0.5 mm is asked",
    ):
        assert words in done.output
    assert len(rows.read_text().splitlines()) == 5


def test_a_table_brings_its_hand_and_its_objects(folder: Path, tmp_path: Path) -> None:
    """Columns that say what the grasps are for are used where nothing is told."""
    done = RUN.invoke(app, ["refine", "--judge-only", str(folder / "good.csv"), "--json"])
    assert done.exit_code == 0, done.output
    data = json.loads(done.stdout)
    assert (data["hand"], data["object"], data["passed"]) == ("allegro_hand", BOX, 3)
    table = json.loads((folder / "good.csv").with_name("bad.json").read_text())
    table["grasps"][1]["object"] = "box:0.05x0.05x0.09"  # of it the pads touch as well
    (tmp_path / "two.json").write_text(json.dumps(table))
    done = RUN.invoke(app, ["refine", "--judge-only", str(tmp_path / "two.json"), "--json"])
    data = json.loads(done.stdout)
    assert data["object"] == f"{BOX}, box:0.05x0.05x0.09"
    assert [row["index"] for row in data["rows"]] == [0, 1, 2, 3]
    assert [row["object"] for row in data["rows"]] == [BOX] * 3 + ["box:0.05x0.05x0.09"]
    table["hand"] = "my_hand"
    (tmp_path / "two.json").write_text(json.dumps(table))
    done = RUN.invoke(app, ["refine", "--judge-only", str(tmp_path / "two.json")])
    assert done.exit_code == 3
    said = " ".join(done.output.split())
    assert "is for the hand 'my_hand', which is not known here; give its name or file" in said


def test_a_mesh_that_a_file_names(folder: Path, tmp_path: Path) -> None:
    """A table's is used, found beside the table; another tool's is offered."""
    box = trimesh.creation.box((0.05, 0.05, 0.08))
    box.export(tmp_path / "can.obj")
    table = json.loads((folder / "plain.json").read_text())
    table["grasps"] = table["grasps"][:1]
    table["grasps"][0]["object"] = "can.obj"
    (tmp_path / "t.json").write_text(json.dumps(table))
    done = RUN.invoke(app, ["refine", "--judge-only", str(tmp_path / "t.json"), *FOR[:2], "--json"])
    data = json.loads(done.stdout)
    assert data["object"].endswith("can.obj") and data["stages"]["gap"]["passed"] == 1
    for other, code in (("box:0.05x0.05x0.08", 0), ("box:0.05x0.05x0.09", 3)):
        words = ["refine", "--judge-only", str(tmp_path / "t.json"), *FOR[:2], "--object", other]
        assert RUN.invoke(app, words).exit_code == code, "the same in another form, or another"
    (source,) = sorted((folder / "out" / "graspdata").rglob("*0.npy"))[:1]
    grasp = np.load(source, allow_pickle=True).item()
    grasp["obj_path"] = "can.obj"
    np.save(tmp_path / "g.npy", np.array(grasp, dtype=object))
    words = ["refine", "--judge-only", str(tmp_path / "g.npy"), *FOR[:2], "--by-number"]
    done = RUN.invoke(app, words)
    said = " ".join(done.output.split())
    assert f"it names can.obj, which is there: give --object {tmp_path / 'can.obj'}" in said
    assert RUN.invoke(app, [*words, "--object", str(tmp_path / "can.obj")]).exit_code in (0, 1)


def test_json_for_machines(folder: Path) -> None:
    done = RUN.invoke(app, ["refine", "--judge-only", str(folder / "bad.json"), *FOR, "--json"])
    data = json.loads(done.stdout, parse_constant=pytest.fail)
    assert (data["total"], data["passed"], data["format"]) == (4, 3, "table")
    assert data["stages"]["gap"] == {"passed": 3, "failed": 1, "not_judged": 0, "first_fault": 1}
    assert data["rows"][3]["gap_tolerance_mm"] > 1.0


def test_plans_and_batches_bring_all_that_is_needed(folder: Path) -> None:
    for name, count in (("plan.json", 1), ("set", 2)):
        done = RUN.invoke(
            app,
            [
                "refine",
                "--judge-only",
                str(folder / name),
                "--approach",
                "--workers",
                "1",
                "--json",
            ],
        )
        assert done.exit_code == 0, done.output
        data = json.loads(done.stdout)
        assert (data["passed"], data["stages"]["approach"]["passed"]) == (count, count)


def test_an_export_for_dexgraspbench_is_held(folder: Path) -> None:
    path = folder / "out" / "graspdata"
    done = RUN.invoke(
        app, ["refine", "--judge-only", str(path), *FOR, "--by-number", "--simulate", "--json"]
    )
    assert done.exit_code == 0, done.output
    data = json.loads(done.stdout)
    assert data["stages"]["held"]["passed"] == 2
    assert "order of allegro_hand" in data["assumed"][0]
    assert all(row["held_moved_mm"] < 50.0 for row in data["rows"])


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["plain.json"], "does not say which hand it is for; give --hand"),
        (
            ["plain.json", "--hand", "allegro_hand", "--only", "can"],
            "of the object 'can', which is neither a shape nor a mesh .*; give --object",
        ),
        (["plain.json", *FOR], "grasps of 3 objects: box:0.05x0.05x0.08, can, pot; one .* --only"),
        (["out/graspdata", *FOR[:2], "--by-number"], "does not bring its object .*; give --object"),
        (
            ["good.csv", "--object", "box:0.05x0.05x0.09"],
            "is of the object 'box:0.05x0.05x0.08', and 'box:0.05x0.05x0.09' is given; leave",
        ),
        (["good.csv", "--out", "good.csv"], "good.csv would be written over; give another name"),
        (["good.csv", "--object", "mug"], "is of the object 'box:0.05x0.05x0.08', and 'mug'"),
        (["plan.json", "--object", "box"], "brings hand, object .*; leave --object out"),
        (
            ["good.csv", *FOR, "--format", "mjcf-scene"],
            "formats? (to read|that are read|is called)",
        ),
        (["none.csv", *FOR], "does not exist"),
        (["good.csv", *FOR, "--unit", "inch"], "--unit 'inch' is none of m, mm"),
        (["good.csv", *FOR, "--quaternion", "abcd"], "none of wxyz, xyzw"),
        (["good.csv", *FOR, "--quaternion", "xyzw"], "give --quaternion wxyz"),
        (["good.csv", *FOR, "--unit", "mm"], "give --unit m"),
        (["good.csv", *FOR, "--format", "tables"], "Did you mean 'table'"),
        (["good.csv", *FOR, "--base-body", "wrist"], "no body of allegro_hand"),
        (["good.csv", *FOR, "--joint-names", "a,b"], "has 16 joints and --joint-names gives 2"),
        (["good.csv", *FOR, "--out", "rows.xlsx"], "rows are written as"),
        (["good.csv", "--hand", "shadow_hand", "--object", "box"], "is for the hand"),
        (["out/graspdata", *FOR], "say --by-number"),
    ],
)
def test_bad_input_is_told(folder: Path, arguments: list[str], said: str) -> None:
    name, *rest = arguments
    rest = [str(folder / r) if r in ("rows.xlsx", "good.csv") else r for r in rest]
    before = sorted(folder.iterdir())
    done = RUN.invoke(app, ["refine", "--judge-only", str(folder / name), *rest])
    assert done.exit_code == 3, done.output
    assert re.search(said, " ".join(done.output.split())), done.output
    assert sorted(folder.iterdir()) == before


def test_a_grasp_that_does_not_press_falls(plans: list[GraspPlan]) -> None:
    """The trial tells grasps apart: one opened to its pre-grasp holds nothing."""
    for task, given in plans_as_imported(plans[:1], Path("x")):
        (grasp,) = given.grasps
        good = hold_imported_grasp(task, grasp)
        assert good.passed, good.reason
        loose = replace(grasp, q=plans[0].q_pregrasp, q_squeeze=plans[0].q_pregrasp)
        bad = hold_imported_grasp(task, loose)
        assert bad.passed is False and "the object moved" in bad.reason
        still = hold_imported_grasp(replace(task, gravity=np.zeros(3)), loose)
        assert still.passed, "without weight it stays"


def test_the_benchmark_of_the_audit(tmp_path: Path) -> None:
    arguments = ["bench", "audit", "allegro_hand", "--objects", "box", "-n", "2"]
    done = RUN.invoke(app, [*arguments, "--faulty", "2", "--timed", "20", "--json"])
    assert done.exit_code == 0, done.output
    (row,) = json.loads(done.stdout)["rows"]
    assert row["passed"] == row["planned"] == 2
    assert all(f["found"] == f["made"] == 2 for f in row["faults"].values())
    assert len(row["faults"]) == 6
    assert 0.0 < row["cpu_s"] < 20 * 0.12  # 1,000 in 120 CPU seconds
