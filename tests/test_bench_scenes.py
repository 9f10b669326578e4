"""The measurement in DexJoCo's scene: itself where DexJoCo is, and its plumbing on a stand-in."""

from __future__ import annotations

import gc
import os
import sys
import weakref
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import MagicMock

import mujoco
import numpy as np
import pinocchio as pin
import pytest
from benching import run_bench

from benchmarks import (
    scenes,
    scenes_adroit,
    scenes_bucket,
    scenes_dexjoco,
    scenes_glasses,
    scenes_launch,
    scenes_task,
)
from benchmarks.scenes_dexjoco import HAMMER, LAG, Ahead, Played
from benchmarks.scenes_task import Served
from planner.errors import NoGraspFoundError, NotFoundError, TaskError
from planner.spatial import SE3, FloatArray

DEXJOCO = ("hammer_nail", "pinch_tongs", "click_mouse", "pick_bucket", "fold_glasses")

PLACES = dict.fromkeys(DEXJOCO, "DEXJOCO") | {"adroit_hammer": "ADROIT"}
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


def test_a_start_for_which_no_grasp_is_found_is_not_done(monkeypatch: pytest.MonkeyPatch) -> None:
    served = MagicMock()
    monkeypatch.setattr(scenes, "Served", lambda *_: served)
    task = MagicMock(play=MagicMock(side_effect=NoGraspFoundError("none of 300", ())))
    monkeypatch.setitem(scenes.TASKS, "hammer_nail", task)
    where = scenes.Where(scene=Path("a"), python=Path("b"), hand=Path("c"))
    left, collected = type("Episode", (), {})(), gc.isenabled()
    left.itself, before = left, weakref.ref(left)
    gc.disable()
    del left
    row = scenes.measure({"task": "hammer_nail", "seed": 0, "where": where})
    assert before() is None, "what an earlier start left in a cycle is given back"
    if collected:
        gc.enable()
    assert row == {"done": False, "ended": "no plan", "detail": "none of 300"}
    served.close.assert_called_once()


def test_a_grasp_is_refused_where_the_arm_does_not_reach_the_route(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    ways: list[Any] = []
    monkeypatch.setattr(scenes_dexjoco, "plan_use", lambda task, way, **_: ways.append(way))
    played = object.__new__(scenes_dexjoco._Hammering)
    far, near = (SE3(np.eye(3), np.array([x, 0.0, 0.0])) for x in (2.0, 0.5))
    played.scene = MagicMock(reaches=lambda pose: pose.translation[0] < 1.0)
    monkeypatch.setattr(played, "route", lambda plan: [plan.T_world_base])
    played.plan(0)
    (way,) = ways
    assert way(SimpleNamespace(T_world_base_start=near, T_world_base=near)) == [near]
    for start, end in ((far, near), (near, far)):
        with pytest.raises(TaskError, match="does not reach"):
            way(SimpleNamespace(T_world_base_start=start, T_world_base=end))


@pytest.fixture
def ahead(monkeypatch: pytest.MonkeyPatch) -> Ahead:
    """An episode without a scene. Its ``served.arm`` lists the poses that the arm was sent to."""
    played = object.__new__(scenes_glasses._Folding)
    played.served = MagicMock(period=0.02, told={"ended": False}, arm=[])
    played.scene = MagicMock()
    played.home = played.sent = SE3.Identity()
    monkeypatch.setattr(Played, "_step", lambda self, pose, _: self.served.arm.append(pose))
    return played


def test_an_arm_that_lags_comes_along_its_way(ahead: Ahead) -> None:
    velocity = np.array([0.1, 0.0, -0.05])
    ahead.follow(np.zeros(1), lambda share: SE3(np.eye(3), 4.0 * share * velocity), 4.0)
    x = np.zeros(3)
    for sent in ahead.served.arm:  # type: ignore[attr-defined]  # the fixture's
        x += 0.02 / LAG[0] * (sent.translation - x)
    # the last step's own lag remains: 2 mm, of 45 mm if it were not sent ahead
    np.testing.assert_allclose(x, 4.0 * velocity, atol=2.5e-3)
    ahead.served.told["ended"] = True
    ahead.move(np.zeros(1), SE3.Identity(), 1.0)
    assert len(ahead.served.arm) == 200  # type: ignore[attr-defined]


def test_a_run_goes_on_from_where_the_hand_was_sent(
    ahead: Ahead, monkeypatch: pytest.MonkeyPatch
) -> None:
    ahead.sent = SE3(np.eye(3), np.ones(3))
    monkeypatch.setattr(Played, "run", lambda *_: SimpleNamespace(wanted=SE3.Identity()))
    assert ahead.run(MagicMock()).wanted == ahead.sent


BUCKET = """
<mujoco><worldbody><body pos="0.1 0.2 0.5" euler="0 0 15"><geom name="bucket_bottom" size="0.01"/>
  <body name="link"><joint name="bucket_joint_0" axis="0 1 0" pos="0 0 0.1" range="0 180"/>
    <geom name="handle1" type="box" size="0.002 0.1 0.008" pos="-0.17 0 0.1"/></body>
</body></worldbody></mujoco>"""


@pytest.mark.parametrize("angle", [0.0, 0.9, 1.95])
def test_fingers_are_inside_the_handle_as_it_will_be(ahead: Ahead, angle: float) -> None:
    model = mujoco.MjModel.from_xml_string(BUCKET)
    data, raised = mujoco.MjData(model), mujoco.MjData(model)
    data.qpos[0], raised.qpos[0] = 0.1, angle
    mujoco.mj_forward(model, data)
    mujoco.mj_forward(model, raised)
    filling = object.__new__(scenes_bucket._Filling)
    filling.served, filling.home = MagicMock(model=model, data=data), ahead.home
    end = np.array([0.01, 0.02, 0.1])
    pose = filling._inside(end, angle, 0.003)
    bar = raised.geom("handle1")
    seen = bar.xmat.reshape(3, 3).T @ (pose.rotation @ end + pose.translation - bar.xpos)
    # inwards by half the bar, the finger's radius and the gap; across: below the bar
    wanted = [0.002 + scenes_bucket.TIP_RADIUS + 0.003, 0.0, -scenes_bucket.BELOW]
    np.testing.assert_allclose(seen, wanted, atol=1e-9)


def test_the_box_is_carried_over_the_bucket_by_a_hand_that_is_turned_little(ahead: Ahead) -> None:
    model = mujoco.MjModel.from_xml_string(BUCKET)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    filling = object.__new__(scenes_bucket._Filling)
    filling.served, filling.home = MagicMock(model=model, data=data), ahead.home
    box = np.array([-0.3, 0.15, 0.4])
    filling.scene = MagicMock(T_world_object=SE3(np.eye(3), box))
    # beyond: the arm ends at a stop beside the grasp (start 1041 of development)
    for degrees in (85.0, -85.0, 161.0):
        base = SE3(pin.exp3(np.deg2rad(degrees) * np.array([0.0, 0.0, 1.0])), box + 0.1)
        plan: Any = SimpleNamespace(T_world_base=base)
        if degrees > 100.0:
            with pytest.raises(TaskError, match="does not turn"):
                filling.route(plan)
            continue
        up, over, down = filling.route(plan)
        np.testing.assert_allclose(up.translation[:2], base.translation[:2])
        for pose, height in ((over, scenes_dexjoco.CLEAR), (down, 0.0)):
            place = (pose * base.inverse()).act(box)
            np.testing.assert_allclose(place, [0.1, 0.2, 0.4 + scenes_bucket.DROP + height])


GLASSES = """
<mujoco><worldbody>
  <body pos="0.3 0.4 0.9" euler="0 0 {box}"><geom name="box_bottom" size="0.1"/></body>
  <body name="glass" pos="-0.3 -0.2 1" euler="0 0 {glass}"><freejoint/><geom size="0.01"/></body>
</worldbody></mujoco>"""


@pytest.mark.parametrize(("box", "glass", "turn"), [(8, 95, 3), (-9, 80, 1), (8, -95, 13)])
def test_glasses_are_laid_along_the_box_by_the_smaller_turn(
    box: float, glass: float, turn: float
) -> None:
    model = mujoco.MjModel.from_xml_string(GLASSES.format(box=box, glass=glass))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    folding = object.__new__(scenes_glasses._Folding)
    body = data.body("glass")
    object_now = SE3(body.xmat.reshape(3, 3), body.xpos)
    folding.served = MagicMock(model=model, data=data)
    folding.scene = MagicMock(T_world_object=object_now)
    base = SE3(np.eye(3), np.array([-0.28, -0.25, 1.1]))
    up, over, down = folding.route(MagicMock(T_world_base=base))
    laid: SE3 = down * base.inverse() * object_now
    wide: FloatArray = data.geom("box_bottom").xmat.reshape(3, 3)[:, 1]
    assert abs(wide @ laid.rotation[:, 0]) == pytest.approx(1.0)
    turned = np.rad2deg(np.arccos((np.trace(down.rotation) - 1.0) / 2.0))
    assert turned == pytest.approx(turn)
    np.testing.assert_allclose(laid.translation[:2], [0.3, 0.4], atol=1e-9)
    assert laid.translation[2] == pytest.approx(1.0 + scenes_glasses.FLOOR)
    for pose in (up, over):
        assert pose.translation[2] >= 1.1 + scenes_glasses.CLEAR
