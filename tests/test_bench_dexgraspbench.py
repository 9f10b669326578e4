"""The command that runs DexGraspBench: its plumbing, on a stand-in for the benchmark."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import opposable

from benchmarks import dexgraspbench as checkout
from benchmarks.dexgraspbench import Installed, install
from planner.batch import plan_grasps
from planner.errors import TaskError

pytest.importorskip("pyarrow")

STAND_IN = """
import glob, json, os, sys
import numpy as np
import torch
from pxr import Usd

def f(x: torch.Tensor, y=torch.tensor([0, 0, 1.0])) -> Usd.Stage:
    return x

given = dict(a.split("=", 1) for a in sys.argv[1:] if "=" in a)
folder = sys.argv[sys.argv.index("--config-dir") + 1]
hand = json.load(open(os.path.join(folder, "hand", given["hand"] + ".yaml")))
assert os.path.isfile(hand["xml_path"])
if given["setting"] == "tabletop" and os.path.exists("fail"):
    torch.zeros(3)
for path in glob.glob(os.path.join(given["grasp_dir"], "**/*.npy"), recursive=True):
    data = np.load(path, allow_pickle=True).item()
    out = path.replace(given["grasp_dir"], given["eval_dir"])
    os.makedirs(os.path.dirname(out), exist_ok=True)
    held = given["setting"] == "fc"
    found = {"succ_flag": held, "delta_pos": 0.002, "delta_angle": 3.0, "ho_pene": 0.0004}
    np.save(out, {**found, **data})
"""


def git(folder: Path, *words: str) -> str:
    name = ("-c", "user.name=n", "-c", "user.email=e@example.org")
    done = subprocess.run(
        ["git", "-C", str(folder), *name, *words], check=True, capture_output=True, text=True
    )
    return done.stdout.strip()


@pytest.fixture
def repository(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A repository with one commit, which stands for the pinned one; no environment is made."""
    folder = tmp_path / "origin"
    (folder / "src").mkdir(parents=True)
    (folder / "src" / "main.py").write_text(STAND_IN, encoding="utf-8")
    git(folder, "init", "-q")
    git(folder, "add", "-A")
    git(folder, "commit", "-q", "-m", "one")
    monkeypatch.setattr(checkout, "COMMIT", git(folder, "rev-parse", "HEAD"))
    monkeypatch.setattr(checkout, "_environment", lambda folder: Path(sys.executable))
    return folder


@pytest.mark.slow
def test_a_batch_is_exported_evaluated_read_back_and_compared(
    repository: Path, tmp_path: Path
) -> None:
    plan_grasps("allegro_hand", ["sphere"], 2, workers=1, out=tmp_path / "set")
    words = ("bench", "dexgraspbench", tmp_path / "set", "--benchmark", repository)
    home = ("--home", tmp_path / "home")
    code, out, err = opposable(*words, *home, "--json")
    assert code == 0, err
    result = json.loads(out)
    assert len(result["rows"]) == 2
    for grasp in result["rows"]:
        assert (grasp["fc"], grasp["tabletop"]) == (True, False)
        assert grasp["penetration_mm"] == pytest.approx(0.4)
        assert grasp["ours"] is True
    code, out, _ = opposable(*words, *home, "--no-compare")
    assert code == 0
    assert " 100.0 " in out
    assert " 0.40 " in out

    (tmp_path / "home" / "checkout" / "fail").touch()
    code, again, _ = opposable(*words, *home, "--no-compare")
    assert code == 0 and again == out  # what was evaluated is not evaluated again
    note = tmp_path / "home" / "evaluation" / "tabletop" / "allegro_hand" / "export.sha256"
    note.write_text("of another export", encoding="utf-8")
    code, _, err = opposable(*words, *home, "--no-compare")
    assert code == 3
    assert "torch.zeros is used, and not installed" in err


def test_without_a_batch_it_says_which_hands_there_are(repository: Path, tmp_path: Path) -> None:
    meshes = tmp_path / "menagerie"
    (meshes / "shadow_hand" / "assets").mkdir(parents=True)
    words = ("bench", "dexgraspbench", "--benchmark", repository, "--home", tmp_path / "home")
    code, out, err = opposable(*words, "--meshes", meshes)
    assert code == 0, err
    text = " ".join(out.split())
    assert "assets/hand/shadow/right_hand.xml" in text.replace(" ", "")
    assert "without meshes: allegro, leap" in text


def test_a_changed_benchmark_is_refused(repository: Path, tmp_path: Path) -> None:
    installed = install(tmp_path / "home", str(repository), None)
    assert isinstance(installed, Installed)
    (installed.checkout / "src" / "main.py").write_text("", encoding="utf-8")
    with pytest.raises(TaskError, match="was changed"):
        install(tmp_path / "home", str(repository), None)


def test_a_benchmark_that_is_not_there_is_told(repository: Path, tmp_path: Path) -> None:
    with pytest.raises(TaskError, match=r"(?s)git clone .* failed with code \d+"):
        install(tmp_path / "home", str(tmp_path / "nowhere"), None)


def test_results_are_read_without_arrays(tmp_path: Path) -> None:
    (tmp_path / "can").mkdir()
    row: Any = {
        "succ_flag": np.bool_(True),
        "ho_pene": 0.0,
        "obj_pose": np.zeros(7),
        "obj_path": "x",
    }
    np.save(tmp_path / "can" / "0.npy", row, allow_pickle=True)
    installed = Installed(python=Path(sys.executable), checkout=tmp_path, lacking=())
    assert installed.results(tmp_path) == [{"file": "can/0.npy", "succ_flag": 1.0, "ho_pene": 0.0}]
