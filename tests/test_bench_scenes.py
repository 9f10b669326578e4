"""The measurement in DexJoCo's scene: itself where DexJoCo is, and its plumbing on a stand-in."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import MagicMock

import mujoco
import numpy as np
import pytest
from benching import run_bench

from benchmarks import scenes, scenes_adroit, scenes_dexjoco, scenes_launch, scenes_task
from benchmarks.scenes_dexjoco import HAMMER
from benchmarks.scenes_task import Served
from planner.errors import NotFoundError, TaskError

PLACES = dict.fromkeys(("hammer_nail", "pinch_tongs", "click_mouse"), "DEXJOCO") | {
    "adroit_hammer": "ADROIT"
}
"""Environment variables by task: CHECKOUT:PYTHON:HAND_TOML, see docs/how/scenes.md."""

STAND_IN = """
import json, sys
print("loading", file=sys.stderr)
height = 1.0
for line in sys.stdin:
    asked = json.loads(line)
    if "action" in asked:
        if asked["action"][2] > 5:
            raise ValueError("too high")
        height = asked["action"][2]
    told = {"qpos": [0, 0, height, 1, 0, 0, 0], "time": height, "seconds": 0.02}
    told |= {"body_mass": [0, float(sys.argv[3])]} if "reset" in asked else {}
    print(json.dumps(told), flush=True)
"""

SCENE = '<mujoco><worldbody><body name="b"><freejoint/><geom size="1"/></body></worldbody></mujoco>'


@pytest.fixture
def checkout(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder that looks like a checkout, and a script in place of its task."""
    (tmp_path / HAMMER.model).parent.mkdir(parents=True)
    (tmp_path / HAMMER.model).write_text(SCENE)
    launch = tmp_path / "launch.py"
    launch.write_text(STAND_IN)
    monkeypatch.setattr(scenes_task, "LAUNCH", launch)
    return tmp_path


def test_state_and_drawn_model_are_mirrored(checkout: Path) -> None:
    served = Served(HAMMER, checkout, Path(sys.executable), 7)
    assert served.period == 0.02 and served.model.body_mass[1] == 7.0
    served.step([0.0, 0.0, 2.5])
    np.testing.assert_allclose(served.data.xpos[1], [0.0, 0.0, 2.5])
    assert served.steps == 1 and served.data.time == 2.5
    served.close()


def test_a_task_that_ends_says_why(checkout: Path) -> None:
    served = Served(HAMMER, checkout, Path(sys.executable), 0)
    with pytest.raises(TaskError, match="github brave-eai/dexjoco ended: ValueError: too high"):
        served.step([0.0, 0.0, 9.0])
    with pytest.raises(TaskError, match=r"there is no .*hammer_nail.xml; give --scene"):
        Served(HAMMER, checkout / "elsewhere", Path(sys.executable), 0)
    with pytest.raises(TaskError, match="there is no none; give --python"):
        Served(HAMMER, checkout, Path("none"), 0)


def test_a_scene_that_does_not_compile_starts_no_process(
    checkout: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (checkout / HAMMER.model).write_text("<mujoco><nothing/></mujoco>")
    started = []
    monkeypatch.setattr("subprocess.Popen", lambda *_, **__: started.append(1))
    with pytest.raises(ValueError, match="XML Error"):
        Served(HAMMER, checkout, Path(sys.executable), 0)
    assert not started


def test_every_task_is_served_and_another_is_none() -> None:
    assert scenes.TASKS.keys() == scenes_launch.SERVED.keys() == PLACES.keys()
    options = scenes.Options(scene=Path("a"), python=Path("b"), hand=Path("c"), task="hamer_nail")
    with pytest.raises(NotFoundError, match="Did you mean 'hammer_nail'"):
        list(scenes.cases(options))


def test_a_depth_that_is_not_told_is_not_zero(monkeypatch: pytest.MonkeyPatch) -> None:
    told = {"succeed": False, "hammer_hit": False}
    task = object.__new__(scenes_launch.DexJoCo)
    task._keys = ("succeed", "nail_depth")
    task._env = SimpleNamespace(step=lambda action: (None, 0.0, False, False, told))
    with pytest.raises(KeyError, match="nail_depth"):
        task.step([])
    run = MagicMock(slip=(0.0, 0.0))
    monkeypatch.setattr(scenes_dexjoco, "plan_use", MagicMock())
    monkeypatch.setattr(scenes_dexjoco, "ForeignRun", lambda *_, **__: run)
    hammering = object.__new__(scenes_dexjoco._Hammering)
    hammering.scene, hammering.served = MagicMock(), MagicMock(told=told)
    hammering._closed = True
    monkeypatch.setattr(hammering, "_episode", lambda _: "nail not in")
    with pytest.raises(KeyError, match="nail_depth"):
        hammering.row(0)


@pytest.mark.slow
@pytest.mark.parametrize("task", PLACES)
def test_it_is_done_by_their_own_test(task: str) -> None:
    if PLACES[task] not in os.environ:
        pytest.skip(f"{PLACES[task]} names no checkout, Python and hand.toml")
    scene, python, hand = os.environ[PLACES[task]].split(":")
    where: dict[str, Any] = {"scene": Path(scene), "python": Path(python), "hand": Path(hand)}
    (row,) = run_bench("scenes", **where, task=task, n=1, seed=1)["rows"]
    assert row["done"] and row["steps"] < 1200
    if "hammer" in task:
        assert row["depth_mm"] >= 40.0 and row["steps"] < 1000 and row["closed"]


def test_a_rehearsal_has_less_friction_and_leaves_the_task_alone() -> None:
    # gravity 35 degrees beside the plane's normal: friction of 1 holds the block, of 0.6 does not
    model = mujoco.MjModel.from_xml_string("""
<mujoco><option gravity="7 0 -10"/><worldbody>
  <geom type="plane" size="1 1 1"/>
  <body pos="0 0 0.02"><joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 0 1"/>
    <geom type="box" size="0.1 0.1 0.02"/></body>
  <body pos="0 0 2"><joint name="flap"/><geom size="0.1"/></body></worldbody>
  <actuator><position joint="flap" ctrlrange="-1 3"/></actuator></mujoco>""")
    served: Any = SimpleNamespace(
        model=model, data=mujoco.MjData(model), told={"ended": False}, steps=12, period=0.01
    )
    rehearsal = scenes_adroit._Rehearsal(served)
    for _ in range(50):
        rehearsal.step([0.5])
        mujoco.mj_step(model, served.data, 5)
    assert rehearsal.steps == 62 and served.steps == 12 and not rehearsal.told["ended"]
    assert rehearsal.data.ctrl[0] == 2.0 and served.data.ctrl[0] == 0.0
    assert rehearsal.data.qpos[0] > 0.05 > 0.01 > served.data.qpos[0]
