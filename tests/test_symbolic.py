"""The CasADi twin beyond the tips: points, directions, exact derivatives, joint torques."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import casadi as ca
import mujoco
import numpy as np
import pinocchio as pin
import pytest

from planner.bridge import pinocchio_from_mujoco
from planner.errors import ModelError
from planner.hand_loading import load_hand
from planner.hands.hand import Hand
from planner.kinematics import HandState, joint_axes
from planner.spatial import FloatArray
from planner.synthesis.symbols import SymbolicHand

SLIDER = """
<mujoco>
  <compiler angle="radian"/>
  <worldbody>
    <body name="base" pos="0.1 0 0.2" euler="0.3 0.1 -0.2">
      <geom name="base" size="0.02"/>
      <body name="rail" pos="0 0 0.05" euler="0 0.4 0.3">
        <joint name="slide" type="slide" axis="1 2 -1" range="-0.1 0.1" ref="0.03"/>
        <geom name="rail" size="0.02"/>
        <body name="arm" pos="0.05 0 0">
          <joint name="hinge" type="hinge" axis="1 0 1" pos="0.01 -0.02 0" range="-2 2" ref="0.5"/>
          <geom name="arm" size="0.02"/>
          <site name="tip" pos="0 0.01 0.06" euler="0.2 0 0.7"/>
        </body>
      </body>
    </body>
  </worldbody>
</mujoco>
"""

SLIDER_TOML = """
schema = 1
name = "slider"
model = "slider.xml"
base_body = "base"
palm_body = "base"
palm_normal = [0, 0, 1]
[[actuators]]
joints = ["slide", "hinge"]
kp = 10.0
force_limit = 1.0
[[fingers]]
name = "only"
joints = ["slide", "hinge"]
tip_site = "tip"
[fingers.pad]
geom = "arm"
center = [0, 0, 0]
radius = 0.02
axis = [0, 0, 2]
half_angle_deg = 60
"""


@pytest.fixture(scope="module")
def slider(tmp_path_factory: pytest.TempPathFactory) -> Hand:
    """A hand of one finger whose first joint slides and whose joints do not start at 0."""
    folder: Path = tmp_path_factory.mktemp("slider")
    (folder / "slider.xml").write_text(SLIDER, encoding="utf-8")
    (folder / "hand.toml").write_text(SLIDER_TOML, encoding="utf-8")
    return load_hand(folder)


def random_q(hand: Hand, seed: int) -> FloatArray:
    return np.random.default_rng(seed).uniform(hand.q_lower, hand.q_upper)


def evaluate(expression: Any, q: Any, value: FloatArray) -> FloatArray:
    out = np.array(ca.Function("f", [q], [expression])(value))
    return out[:, 0] if out.shape[1] == 1 else out


def test_slides_offsets_and_references_agree_with_mujoco(slider: Hand) -> None:
    q = ca.SX.sym("q", 2)
    finger = slider.fingers["only"]
    twin = SymbolicHand(slider, q)
    rotation, origin = twin.tip(finger)
    data = mujoco.MjData(slider.mj_model)
    jac = np.zeros((6, 2))
    for seed in range(20):
        value = random_q(slider, seed)
        data.qpos[:] = value
        mujoco.mj_kinematics(slider.mj_model, data)
        mujoco.mj_comPos(slider.mj_model, data)
        mujoco.mj_jacSite(slider.mj_model, data, jac[:3], jac[3:], 0)
        np.testing.assert_allclose(evaluate(origin, q, value), data.site_xpos[0], atol=1e-12)
        matrix = evaluate(rotation, q, value)
        np.testing.assert_allclose(matrix, data.site_xmat[0].reshape(3, 3), atol=1e-12)
        np.testing.assert_allclose(evaluate(twin.tip_jacobian(finger), q, value), jac, atol=1e-12)
        np.testing.assert_allclose(
            HandState(slider, value).tip_jacobian(finger), jac, rtol=0, atol=1e-12
        )


def test_points_and_directions_agree_with_pinocchio(right_hand: Hand) -> None:
    q = ca.SX.sym("q", right_hand.nq)
    twin = SymbolicHand(right_hand, q)
    rng = np.random.default_rng(0)
    value = random_q(right_hand, 1)
    state = HandState(right_hand, value)
    for joint_id in range(1, right_hand.nq + 1):
        local, pose = rng.normal(size=3), state.joint_pose(joint_id)
        point = evaluate(twin.point(joint_id, local), q, value)
        np.testing.assert_allclose(point, pose.act(local), rtol=0, atol=1e-12)
        direction = evaluate(twin.direction(joint_id, local), q, value)
        np.testing.assert_allclose(direction, pose.rotation @ local, rtol=0, atol=1e-12)
        rotation, origin = twin.joint(joint_id)
        np.testing.assert_allclose(evaluate(rotation, q, value), pose.rotation, atol=1e-12)
        np.testing.assert_allclose(evaluate(origin, q, value), pose.translation, atol=1e-12)


def test_joint_zero_is_the_base(allegro: Hand) -> None:
    twin = SymbolicHand(allegro, ca.SX.sym("q", allegro.nq))
    np.testing.assert_array_equal(
        np.array(ca.DM(twin.point(0, np.array([1.0, 2, 3])))).ravel(), [1, 2, 3]
    )


def test_geometric_jacobian_is_the_derivative_that_casadi_takes_itself(right_hand: Hand) -> None:
    q = ca.SX.sym("q", right_hand.nq)
    twin = SymbolicHand(right_hand, q)
    value = random_q(right_hand, 2)
    for finger in right_hand.fingers.values():
        _, origin = twin.tip(finger)
        automatic = evaluate(ca.jacobian(origin, q), q, value)[:, finger.q_index]
        geometric = evaluate(twin.tip_jacobian(finger), q, value)[:3]
        np.testing.assert_allclose(geometric, automatic, rtol=0, atol=1e-12)


@pytest.mark.parametrize("name", ["allegro", "shadow", "slider"])
def test_joint_torque_is_jacobian_transposed_times_force(
    name: str, request: pytest.FixtureRequest
) -> None:
    hand: Hand = request.getfixturevalue(name)
    q = ca.SX.sym("q", hand.nq)
    twin = SymbolicHand(hand, q)
    value, force = random_q(hand, 3), np.array([0.7, -1.3, 2.1])
    state = HandState(hand, value)
    for finger in hand.fingers.values():
        point = state.pad_center(finger) + np.array([0.001, -0.004, 0.002])
        expected = state.point_jacobian(finger.pad.joint_id, point)[:3].T @ force
        torques = ca.vertcat(*(twin.joint_torque(j, point, force) for j in finger.joints))
        np.testing.assert_allclose(
            evaluate(torques, q, value), expected[finger.q_index], rtol=0, atol=1e-12
        )


def test_joint_torque_of_a_lever_by_hand(slider: Hand) -> None:
    # A slide along u feels u . f; nothing else matters.
    q = ca.SX.sym("q", 2)
    value, force = random_q(slider, 4), np.array([1.0, 2.0, 3.0])
    axis = HandState(slider, value).joint_pose(1).rotation @ np.array([1.0, 2, -1]) / np.sqrt(6)
    torque = SymbolicHand(slider, q).joint_torque("slide", np.zeros(3), force)
    assert evaluate(torque, q, value)[0] == pytest.approx(axis @ force, abs=1e-12)


def test_joint_axes_are_unit_and_of_one_kind(slider: Hand) -> None:
    axes = joint_axes(slider.pin_model)
    np.testing.assert_array_equal(axes[0], 0)
    np.testing.assert_allclose(axes[1], [*(np.array([1, 2, -1]) / np.sqrt(6)), 0, 0, 0], atol=1e-15)
    np.testing.assert_allclose(axes[2], [0, 0, 0, *(np.array([1, 0, 1]) / np.sqrt(2))], atol=1e-15)


def test_a_ball_joint_is_refused_by_name() -> None:
    model = mujoco.MjModel.from_xml_string(
        '<mujoco><worldbody><body><joint name="hip" type="ball"/><geom size="0.1"/></body>'
        "</worldbody></mujoco>"
    )
    with pytest.raises(ModelError, match="'hip' is neither a hinge nor a slide"):
        joint_axes(pinocchio_from_mujoco(model))


def test_planar_two_link_arm_by_hand() -> None:
    # Links of 0.3 m and 0.2 m in the plane: x = 0.3 cos a + 0.2 cos(a + b).
    xml = (
        '<mujoco><compiler angle="radian"/><worldbody><body name="a"><joint name="a" axis="0 0 1"/>'
        '<geom size="0.01"/><body name="b" pos="0.3 0 0"><joint name="b" axis="0 0 1"/>'
        '<geom size="0.01"/></body></body></worldbody></mujoco>'
    )
    model = pinocchio_from_mujoco(mujoco.MjModel.from_xml_string(xml))
    data = model.createData()
    a, b = 0.4, -1.2
    pin.framesForwardKinematics(model, data, np.array([a, b]))
    tip = data.oMi[2].act(np.array([0.2, 0, 0]))
    expected = [0.3 * np.cos(a) + 0.2 * np.cos(a + b), 0.3 * np.sin(a) + 0.2 * np.sin(a + b), 0]
    np.testing.assert_allclose(tip, expected, rtol=0, atol=1e-15)
