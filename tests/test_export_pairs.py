"""Grasps of two hands for a model that carries both on arms: where they stand, how they press."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pinocchio as pin
import pytest

from planner import GraspTask, load_hand, plan_grasp
from planner.errors import ModelError, TaskError
from planner.exchange.dexgraspbench.pairs import PairModel, pair_dict, pair_squeeze
from planner.hands.hand import Hand
from planner.objects import parse_object
from planner.plan import GraspPlan
from planner.spatial import SE3

MASS = 2.0


@pytest.fixture(scope="module")
def pair() -> Hand:
    return load_hand("two_allegro_hands")


@pytest.fixture(scope="module")
def plan(pair: Hand) -> GraspPlan:
    ball = replace(parse_object("sphere:0.12"), mass=MASS)
    task = GraspTask.create(pair, ball, grasp_type="palms", table_height=None)
    return plan_grasp(task, seed=0)


@pytest.fixture(scope="module")
def file(pair: Hand, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The pair's own model: its carriages are three slides and three hinges."""
    path = tmp_path_factory.mktemp("model") / "pair.xml"
    path.write_text(pair.new_spec().to_xml(), encoding="utf-8")
    return path


def test_in_the_pairs_own_model_nothing_changes(plan: GraspPlan, file: Path) -> None:
    hand = plan.task.hand
    model = PairModel.of(file, hand)
    squeeze = pair_squeeze(plan, MASS)
    np.testing.assert_allclose(model.joints(SE3.Identity(), plan.q), plan.q, atol=1e-12)
    commanded = model.squeezed(plan.T_world_base, plan.q, plan.q, squeeze.torques)
    np.testing.assert_allclose(commanded, squeeze.posture(plan.task, plan.q), atol=1e-9)


def test_a_grasp_stands_turned_as_a_whole_and_presses_the_same(
    plan: GraspPlan, file: Path, tmp_path: Path
) -> None:
    """Palms and fingertips are at the object where they were planned, by MuJoCo's kinematics."""
    hand = plan.task.hand
    made = pair_dict(plan, pair_squeeze(plan, MASS), PairModel.of(file, hand), tmp_path)
    model = mujoco.MjModel.from_xml_path(str(file))
    data = mujoco.MjData(model)
    seen = []
    for joints in (made["grasp_qpos"], made["squeeze_qpos"]):
        for name, value in zip(made["joint_names"], joints, strict=True):
            data.joint(name).qpos[0] = value
        mujoco.mj_kinematics(model, data)
        seen.append({n: data.body(n).xpos.copy() for n in ("right/palm", "left/index_distal")})
    at, quaternion = made["obj_pose"][:3], made["obj_pose"][3:]
    turn = np.zeros(9)
    mujoco.mju_quat2Mat(turn, quaternion)
    frames = hand.pin_model.createData()
    pin.framesForwardKinematics(hand.pin_model, frames, plan.q)
    to_object = plan.task.T_world_object.inverse() * plan.T_world_base
    for name, there in seen[0].items():
        planned = to_object * frames.oMf[hand.pin_model.getBodyId(name)]
        found = turn.reshape(3, 3).T @ (there - at)
        np.testing.assert_allclose(found, planned.translation, atol=1e-9)
    # commanded, the right palm is deeper in the ball
    deeper = [np.linalg.norm(where["right/palm"] - at) for where in seen]
    assert deeper[1] < deeper[0] - 1e-4
    middle = [k for k, n in enumerate(made["joint_names"]) if n.endswith("carriage_ry")]
    assert np.abs(made["grasp_qpos"][middle]).max() < 0.5


def test_models_that_are_no_such_arms_are_refused(pair: Hand, file: Path, tmp_path: Path) -> None:
    with pytest.raises(TaskError, match="allegro_hand is one hand"):
        PairModel.of(file, load_hand("allegro_hand"))
    with pytest.raises(TaskError, match="has no joint 'index_0'"):
        PairModel.of(_edited(file, tmp_path, '"right/index_0"', '"x"', count=-1), pair)
    name = 'name="right/carriage_ry"'
    turned = _edited(file, tmp_path, name, f'{name} pos="0 0.1 0"')
    with pytest.raises(ModelError, match="three slides and three hinges"):
        PairModel.of(turned, pair).joints(SE3.Identity(), pair.neutral + 0.3)


def _edited(file: Path, folder: Path, old: str, new: str, count: int = 1) -> Path:
    text = file.read_text(encoding="utf-8")
    assert old in text
    path = folder / "edited.xml"
    path.write_text(text.replace(old, new, count), encoding="utf-8")
    return path
