"""Kinematics of the hands: Pinocchio, its CasADi twin and MuJoCo are witnesses of each other."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import mujoco
import numpy as np
import pinocchio as pin
import pytest

from planner.hands.hand import Hand
from planner.kinematics import HandState
from planner.spatial import SE3, FloatArray
from planner.synthesis.symbols import SymbolicHand

CONFIGURATIONS = 1100
AGREEMENT = 1e-10  # m, -, m/rad


def random_q(hand: Hand, count: int, seed: int = 0) -> FloatArray:
    """Configurations (count, nq) all over the joint ranges; the limits themselves come first."""
    q = np.random.default_rng(seed).uniform(hand.q_lower, hand.q_upper, size=(count, hand.nq))
    q[0], q[1] = hand.q_lower, hand.q_upper
    return q


@dataclass(frozen=True)
class Tips:
    """Tip frames of all fingers at n configurations, in the base's axes."""

    positions: FloatArray  # (n, n_fingers, 3), m
    rotations: FloatArray  # (n, n_fingers, 3, 3)
    jacobians: FloatArray  # (n, n_fingers, 6, nq); zero beyond a finger's own joints

    def assert_equal(self, other: Tips) -> None:
        for name in ("positions", "rotations", "jacobians"):
            np.testing.assert_allclose(
                getattr(self, name), getattr(other, name), rtol=0, atol=AGREEMENT, err_msg=name
            )


def empty_tips(hand: Hand, n: int) -> Tips:
    k = len(hand.fingers)
    return Tips(np.zeros((n, k, 3)), np.zeros((n, k, 3, 3)), np.zeros((n, k, 6, hand.nq)))


def tips_by_pinocchio(hand: Hand, qs: FloatArray) -> Tips:
    out = empty_tips(hand, len(qs))
    for i, q in enumerate(qs):
        state = HandState(hand, q)
        for k, finger in enumerate(hand.fingers.values()):
            pose = state.tip_pose(finger)
            out.positions[i, k], out.rotations[i, k] = pose.translation, pose.rotation
            out.jacobians[i, k][:, finger.q_index] = state.tip_jacobian(finger)
    return out


def tips_by_casadi(hand: Hand, qs: FloatArray) -> Tips:
    q = ca.SX.sym("q", hand.nq)
    twin = SymbolicHand(hand, q)
    parts = []
    for finger in hand.fingers.values():
        rotation, origin = twin.tip(finger)
        parts += [origin, ca.reshape(rotation, -1, 1), ca.reshape(twin.tip_jacobian(finger), -1, 1)]
    values = np.array(ca.Function("tips", [q], [ca.vertcat(*parts)]).map(len(qs))(qs.T)).T
    out, at = empty_tips(hand, len(qs)), 0
    for k, finger in enumerate(hand.fingers.values()):
        n = len(finger.joints)
        out.positions[:, k] = values[:, at : at + 3]
        # CasADi runs down the columns
        turned = values[:, at + 3 : at + 12].reshape(-1, 3, 3)
        out.rotations[:, k] = np.swapaxes(turned, 1, 2)
        columns = values[:, at + 12 : at + 12 + 6 * n].reshape(-1, n, 6)
        out.jacobians[:, k][:, :, finger.q_index] = np.swapaxes(columns, 1, 2)
        at += 12 + 6 * n
    return out


def tips_by_mujoco(hand: Hand, qs: FloatArray) -> Tips:
    model = hand.mj_model
    data = mujoco.MjData(model)
    sites = [model.site(f.tip_frame).id for f in hand.fingers.values()]
    out = empty_tips(hand, len(qs))
    for i, q in enumerate(qs):
        data.qpos[:] = q
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        for k, site in enumerate(sites):
            jac = out.jacobians[i, k]
            mujoco.mj_jacSite(model, data, jac[:3], jac[3:], site)
        out.positions[i] = data.site_xpos[sites]
        out.rotations[i] = data.site_xmat[sites].reshape(-1, 3, 3)
    return out


def test_three_engines_agree_on_every_tip(right_hand: Hand) -> None:
    # MuJoCo's Jacobian is over all joints: equality says too that no other joint moves the tip,
    # except the wrist, which is not among a finger's own joints.
    qs = random_q(right_hand, CONFIGURATIONS)
    by_mujoco = tips_by_mujoco(right_hand, qs)
    by_mujoco.jacobians[..., right_hand.wrist_index] = 0
    by_pinocchio = tips_by_pinocchio(right_hand, qs)
    by_pinocchio.assert_equal(by_mujoco)
    tips_by_casadi(right_hand, qs).assert_equal(by_pinocchio)


def test_mass_matrix_and_gravity_torque_agree_with_mujoco(right_hand: Hand) -> None:
    model, data = right_hand.mj_model, mujoco.MjData(right_hand.mj_model)
    pin_data = right_hand.pin_model.createData()
    dense = np.zeros((right_hand.nq, right_hand.nq))
    for q in random_q(right_hand, 100, seed=1):
        data.qpos[:] = q
        mujoco.mj_forward(model, data)
        mujoco.mj_fullM(model, data, dense)
        upper = np.triu(pin.crba(right_hand.pin_model, pin_data, q))
        mass_matrix = upper + np.triu(upper, 1).T
        np.testing.assert_allclose(mass_matrix, dense, rtol=0, atol=1e-12)
        # velocity is zero: MuJoCo's bias force is gravity alone
        torque = HandState(right_hand, q).gravity_torque(np.array(model.opt.gravity))
        np.testing.assert_allclose(torque, data.qfrc_bias, rtol=0, atol=1e-10)


def test_gravity_torque_turns_with_the_base(right_hand: Hand) -> None:
    # A base that lies on its side sees gravity along another of its axes.
    model, data = right_hand.mj_model, mujoco.MjData(right_hand.mj_model)
    q = random_q(right_hand, 3, seed=2)[2]
    before = np.array(model.opt.gravity)
    gravity = np.array([3.0, -9.0, 1.0])
    try:
        model.opt.gravity[:] = gravity
        data.qpos[:] = q
        mujoco.mj_forward(model, data)
    finally:
        model.opt.gravity[:] = before
    torque = HandState(right_hand, q).gravity_torque(gravity)
    np.testing.assert_allclose(torque, data.qfrc_bias, rtol=0, atol=1e-10)


def numeric_jacobian(hand: Hand, q: FloatArray, pose_at: Any, step: float = 1e-6) -> FloatArray:
    """Central differences (6, nq) of a pose: [velocity of the origin; angular velocity], base."""
    columns = []
    for i in range(hand.nq):
        shift = np.zeros(hand.nq)
        shift[i] = step
        low, high = pose_at(HandState(hand, q - shift)), pose_at(HandState(hand, q + shift))
        linear = (high.translation - low.translation) / (2 * step)
        angular = pin.log3(high.rotation @ low.rotation.T) / (2 * step)
        columns.append(np.concatenate([linear, angular]))
    return np.array(columns).T


def test_tip_jacobian_is_the_derivative_of_the_tip_pose(right_hand: Hand) -> None:
    for q in random_q(right_hand, 6, seed=3):
        state = HandState(right_hand, q)
        for finger in right_hand.fingers.values():
            numeric = numeric_jacobian(right_hand, q, lambda s, f=finger: s.tip_pose(f))
            np.testing.assert_allclose(
                state.tip_jacobian(finger), numeric[:, finger.q_index], rtol=0, atol=1e-8
            )


def test_point_jacobian_is_the_derivative_of_a_material_point(right_hand: Hand) -> None:
    rng = np.random.default_rng(4)
    for q in random_q(right_hand, 4, seed=5):
        state = HandState(right_hand, q)
        for joint_id in (1, right_hand.nq // 2, right_hand.nq):
            local = SE3(np.eye(3), rng.uniform(-0.05, 0.05, 3))
            numeric = numeric_jacobian(
                right_hand, q, lambda s, j=joint_id, p=local: s.joint_pose(j) * p
            )
            point = state.joint_pose(joint_id).act(local.translation)
            np.testing.assert_allclose(
                state.point_jacobian(joint_id, point), numeric, rtol=0, atol=1e-8
            )


def test_point_jacobian_at_the_tip_extends_the_tip_jacobian(right_hand: Hand) -> None:
    state = HandState(right_hand, random_q(right_hand, 3, seed=6)[2])
    for finger in right_hand.fingers.values():
        tip = state.tip_pose(finger).translation
        full = state.point_jacobian(finger.pad.joint_id, tip)
        np.testing.assert_allclose(
            full[:, finger.q_index], state.tip_jacobian(finger), rtol=0, atol=1e-12
        )


def test_pads_are_where_mujoco_has_them(right_hand: Hand) -> None:
    model, data = right_hand.mj_model, mujoco.MjData(right_hand.mj_model)
    for q in random_q(right_hand, 5, seed=7):
        data.qpos[:] = q
        mujoco.mj_kinematics(model, data)
        state = HandState(right_hand, q)
        for described in right_hand.description.fingers:
            body = data.body(model.geom_bodyid[model.geom(described.pad.geom).id])
            rotation = body.xmat.reshape(3, 3)
            finger = right_hand.fingers[described.name]
            np.testing.assert_allclose(
                state.pad_center(finger),
                body.xpos + rotation @ described.pad.center,
                rtol=0,
                atol=AGREEMENT,
            )
            np.testing.assert_allclose(
                state.pad_axis(finger), rotation @ described.pad.axis, rtol=0, atol=AGREEMENT
            )


def test_palm_pose_is_that_of_the_palm_body(right_hand: Hand) -> None:
    data = mujoco.MjData(right_hand.mj_model)
    for q in random_q(right_hand, 5, seed=8):
        data.qpos[:] = q
        mujoco.mj_kinematics(right_hand.mj_model, data)
        body, pose = (
            data.body(right_hand.description.palm_body),
            HandState(right_hand, q).T_base_palm,
        )
        np.testing.assert_allclose(pose.translation, body.xpos, rtol=0, atol=AGREEMENT)
        np.testing.assert_allclose(pose.rotation, body.xmat.reshape(3, 3), rtol=0, atol=AGREEMENT)


def test_state_keeps_its_own_read_only_q(allegro: Hand) -> None:
    q = allegro.posture("open")
    state = HandState(allegro, q)
    tip = state.tip_pose(allegro.fingers["index"]).translation.copy()
    q[:] = 0
    np.testing.assert_array_equal(state.q, allegro.posture("open"))
    np.testing.assert_array_equal(state.tip_pose(allegro.fingers["index"]).translation, tip)
    with pytest.raises(ValueError, match="read-only"):
        state.q[0] = 1.0


def test_two_states_of_one_hand_do_not_disturb_each_other(allegro: Hand) -> None:
    finger = allegro.fingers["index"]
    first = HandState(allegro, allegro.posture("open"))
    before = first.tip_pose(finger).copy()
    HandState(allegro, allegro.posture("pinch"))
    np.testing.assert_array_equal(first.tip_pose(finger).homogeneous, before.homogeneous)
