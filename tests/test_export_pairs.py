"""Grasps of two hands for a model that carries both on arms: where they stand, how they press."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from planner import GraspTask, load_hand, plan_grasp
from planner.errors import ModelError, TaskError
from planner.exchange.dexgraspbench.pairs import PairModel, pair_dict, pair_squeeze
from planner.hands.hand import Hand
from planner.hands.two_hands import AXES
from planner.objects import parse_object
from planner.plan import GraspPlan
from planner.spatial import SE3, FloatArray

MASS, GRAVITY = 2.0, 9.81


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


def pressing(data: mujoco.MjData, side: str) -> tuple[FloatArray, FloatArray]:
    """Force and moment of a carriage's servos on the palm, in world axes."""
    model = data.model
    mujoco.mj_forward(model, data)
    jac = np.zeros((6, model.nv))
    mujoco.mj_jacBody(model, data, jac[:3], jac[3:], model.body(f"{side}/palm").id)
    dofs = [int(model.joint(f"{side}/carriage_{a}").dofadr[0]) for a in AXES]
    wrench = np.linalg.solve(jac[:, dofs].T, data.qfrc_actuator[dofs])
    return wrench[:3], wrench[3:]


def test_a_grasp_stands_turned_as_a_whole_and_presses_the_same(
    plan: GraspPlan, file: Path, tmp_path: Path
) -> None:
    """By MuJoCo: palms and fingertips are where they were planned, and servos press as planned."""
    hand, squeeze = plan.task.hand, pair_squeeze(plan, MASS)
    made = pair_dict(plan, squeeze, PairModel.of(file, hand), tmp_path)
    model = mujoco.MjModel.from_xml_path(str(file))
    here, there = mujoco.MjData(model), mujoco.MjData(model)
    here.qpos[:], here.ctrl[:] = plan.q, squeeze.ctrl
    for k, name in enumerate(made["joint_names"]):
        there.joint(name).qpos[0] = made["grasp_qpos"][k]
    commanded = dict(zip(made["joint_names"], made["squeeze_qpos"], strict=True))
    there.ctrl[:] = [commanded[model.joint(j).name] for j in model.actuator_trnid[:, 0]]
    frame = np.zeros(9)
    mujoco.mju_quat2Mat(frame, made["obj_pose"][3:])
    place = SE3(frame.reshape(3, 3), made["obj_pose"][:3])
    moved = place * plan.task.T_world_object.inverse() * plan.T_world_base
    for side in ("right", "left"):
        planned, found = pressing(here, side), pressing(there, side)
        np.testing.assert_allclose(found[0], moved.rotation @ planned[0], atol=1e-6)
        np.testing.assert_allclose(found[1], moved.rotation @ planned[1], atol=1e-6)
        assert np.linalg.norm(planned[0]) > GRAVITY
    for name in ("right/palm", "left/index_distal"):
        np.testing.assert_allclose(
            there.body(name).xpos, moved.act(here.body(name).xpos), rtol=0, atol=1e-9
        )


def test_the_arms_are_far_from_their_singular_posture(plan: GraspPlan, file: Path) -> None:
    model = PairModel.of(file, plan.task.hand)
    to_object = plan.task.T_world_object.inverse() * plan.T_world_base
    middle = [k for k, n in enumerate(model.names) if n.endswith("carriage_ry")]
    for seed in range(4):
        stance = SE3(model.stance(to_object, plan.q, seed), np.zeros(3))
        assert np.abs(model.joints(stance * to_object, plan.q)[middle]).max() < 0.7


def test_arms_that_reach_a_grasp_in_no_stance_are_said(plan: GraspPlan, file: Path) -> None:
    model = PairModel.of(file, plan.task.hand)
    model.pin_model.upperPositionLimit[model.arms] = -10.0
    with pytest.raises(TaskError, match="in none of 60 orientations"):
        model.stance(plan.task.T_world_object.inverse() * plan.T_world_base, plan.q, 0)


def test_models_that_are_no_such_arms_are_refused(pair: Hand, file: Path, tmp_path: Path) -> None:
    with pytest.raises(TaskError, match="allegro_hand is one hand"):
        PairModel.of(file, load_hand("allegro_hand"))
    with pytest.raises(TaskError, match="is on arms of its own; plan with two hands on carriages"):
        PairModel.of(file, load_hand("allegro_on_arm7+allegro_on_arm7"))
    with pytest.raises(TaskError, match="has no joint 'index_0'"):
        PairModel.of(_edited(file, tmp_path, '"right/index_0"', '"x"', count=-1), pair)
    name = 'name="right/carriage_ry"'
    turned = _edited(file, tmp_path, name, f'{name} pos="0.1 0 0"')
    with pytest.raises(ModelError, match="three slides and three hinges"):
        PairModel.of(turned, pair).joints(SE3.Identity(), pair.neutral + 0.3)


def _edited(file: Path, folder: Path, old: str, new: str, count: int = 1) -> Path:
    text = file.read_text(encoding="utf-8")
    assert old in text
    path = folder / "edited.xml"
    path.write_text(text.replace(old, new, count), encoding="utf-8")
    return path
