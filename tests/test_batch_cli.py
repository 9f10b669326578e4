"""``opposable batch`` and ``opposable batch --extract``."""

from __future__ import annotations

import io
import json
from inspect import signature
from pathlib import Path

import numpy as np
import pytest
import trimesh
from commands import opposable
from rich.console import Console

from planner.batch import BatchProgress, GraspSet
from planner.files import read_plan
from planner.numerics.kernels import compiled_searches
from sim.cli import batch as commands
from sim.cli import grasp
from sim.cli.batch import BatchBar

pytest.importorskip("pyarrow")


def test_a_batch_is_planned_summed_up_exported_and_picked_from(tmp_path: Path) -> None:
    folder = tmp_path / "set"
    words = ("batch", "allegro_hand", "sphere", "sphere:0.2", "-n", "3", "--workers", "1")
    code, out, err = opposable(*words, "--out", folder, "--export", "dexgraspbench")
    assert code == 0, err
    assert "3/3" in out
    assert "0/3" in out
    assert "3 grasps exported" in err
    written = folder / "dexgraspbench" / "graspdata" / "allegro_hand" / "sphere-0.035"
    assert (written / "2.npy").exists()

    code, out, _ = opposable(*words, "--out", folder, "--json")
    summary = json.loads(out)
    assert summary == json.loads((folder / "summary.json").read_text(encoding="utf-8"))
    sphere, too_large = summary["objects"]
    assert (sphere["requested"], sphere["found"], sphere["attempts_per_found"]) == (3, 3, 1.0)
    assert sphere["diversity"]["n"] == 3
    assert "too large" in too_large["commonest_reason"]
    assert too_large["cpu_s_per_found"] is None

    code, _, err = opposable(*words, "--out", folder, "--mu", "0.6")
    assert code == 3
    assert "mu is 0.5 there and 0.6 here" in err
    for other in (("--objective", "torque"), ("--rounds", "0")):
        code, _, err = opposable(*words, "--out", folder, *other)
        assert code == 3
        assert "options" in err

    code, _, err = opposable("batch", folder, "--extract", "1", "-o", tmp_path / "plan.json")
    assert code == 0, err
    assert read_plan(tmp_path / "plan.json").task.object.name == "sphere"
    assert (
        "was not found"
        in opposable("batch", folder, "--extract", "4", "-o", tmp_path / "no.json")[2]
    )
    assert (
        "There is: 0 to 5"
        in opposable("batch", folder, "--extract", "6", "-o", tmp_path / "no.json")[2]
    )
    assert not (tmp_path / "no.json").exists()


def test_a_batch_without_a_grasp_says_so(tmp_path: Path) -> None:
    words = ("batch", "allegro_hand", "sphere:0.2", "-n", "1", "--workers", "1")
    assert opposable(*words, "--out", tmp_path / "set")[0] == 4
    (tmp_path / "file").write_text("in the way", encoding="utf-8")
    code, _, err = opposable(*words, "--out", tmp_path / "file" / "set")
    assert code == 3
    assert "cannot write to" in err


def test_the_bar_shows_rate_and_estimated_end() -> None:
    drawn = io.StringIO()
    with BatchBar(Console(file=drawn, force_terminal=True, width=120)) as bar:
        assert bar.kept() == "nothing was planned"
        bar.told(BatchProgress(total=100, done=20, kept=20, found=0, elapsed_s=0.0))
        bar.told(BatchProgress(total=100, done=40, kept=20, found=18, elapsed_s=10.0))
        assert bar.kept() == "40 grasps are kept"
    assert "40/100" in drawn.getvalue()
    assert "2.0/s, found 18 of 20" in drawn.getvalue()


@pytest.mark.slow
def test_a_batch_takes_what_a_plan_takes(tmp_path: Path) -> None:
    box = trimesh.creation.box((0.04, 0.05, 0.08))
    faces = box.faces.copy()
    faces[0] = faces[0][::-1]  # a triangle that is seen from the wrong side
    trimesh.Trimesh(box.vertices, faces, process=False).export(tmp_path / "turned.stl")
    words: tuple[str | Path, ...] = ("allegro_hand", tmp_path / "turned.stl")
    code, _, err = opposable("batch", *words, "--strict", "-n", "1", "--out", tmp_path / "unmended")
    assert code == 3 and "not mended, since --strict" in err
    assert not (tmp_path / "unmended").exists()
    asked = ("--repair", "--pose", "1", "--mass", "0.2", "--avoid", "z<-0.03", "--touch", "z>-0.03")
    folder = tmp_path / "not" / "yet" / "there"  # parents are made
    code, _, err = opposable(
        "batch", *words, *asked, "-n", "1", "--workers", "1", "--out", folder, "--max-cpu-s", "60"
    )
    assert code == 0, err
    grasps = GraspSet(folder)
    seed = str(grasps[0]["seed"])
    with compiled_searches():  # to the bit, as rows are planned
        code, _, err = opposable(
            "plan", *words, *asked, "--seed", seed, "--out", tmp_path / "plan.json"
        )
    assert code == 0, err
    plan, row = read_plan(tmp_path / "plan.json"), grasps[0]
    assert row["q_rad"] == plan.q.tolist()
    task = grasps.task("turned")
    assert task.object.mass == plan.task.object.mass == 0.2
    assert task.object.touch == plan.task.object.touch
    mine, theirs = (T.homogeneous for T in (task.T_world_object, plan.task.T_world_object))
    np.testing.assert_allclose(mine, theirs, rtol=0, atol=1e-15)  # plan files have quaternions
    assert grasps.manifest.max_cpu_s == 60.0


def test_the_options_of_run_are_those_of_batch() -> None:
    # but for how a plan is executed and chosen among several, which a batch does not do
    run, batch = (set(signature(command).parameters) for command in (grasp.run, commands.batch))
    executed = {"sim_mu", "physics", "controller", "view", "video", "arrows", "verbose"}
    executed |= {"error_model", "error_seed", "estimate", "pads"}
    chosen = {"best_of", "keep", "metric", "handover_to"}
    assert run - batch == {"object", "out_dir"} | executed | chosen


@pytest.mark.slow
def test_grasps_that_spare_fingers_go_the_same_ways(tmp_path: Path) -> None:
    folder = tmp_path / "set"
    code, _, err = opposable(
        *("batch", "shadow_hand", "sphere:0.018", "sphere:0.03", "-n", "2", "--workers", "1"),
        *("--out", folder, "--export", "dexgraspbench", "--max-attempts", "20"),
    )
    assert code == 0, err
    grasps = GraspSet(folder)
    small, large = grasps.labels
    rows = [row for _, row in grasps.found(small)]
    assert [len(row["fingers"]) for row in rows] == [3, 3]
    assert grasps.plan(0).task.finger_names == tuple(rows[0]["fingers"])
    assert grasps.plan(0).q.tolist() == rows[0]["q_rad"]
    assert np.isnan(grasps.features(small).contacts).any(axis=(1, 2)).all()
    assert len(grasps.thinned(small)) >= 1
    assert grasps.diversity(small).surface_share > 0.0
    assert len(grasps.features(large)) == 2


def test_a_batch_folder_without_its_manifest_is_refused(tmp_path: Path) -> None:
    words = ("batch", "allegro_hand", "sphere", "-n", "2", "--workers", "1", "--out", tmp_path)
    assert opposable(*words, "--seed", "3")[0] == 0
    (tmp_path / "manifest.json").unlink()
    code, _, err = opposable(*words, "--seed", "99", "--mu", "0.9")
    assert code == 3
    assert "no manifest.json" in err
    assert not (tmp_path / "manifest.json").exists()
