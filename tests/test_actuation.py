"""Actuator laws and stops: answers by hand, MuJoCo as the second engine, optimality."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import ArrayLike
from scipy.sparse.csgraph import connected_components

from planner.bridge import actuation_from_mujoco
from planner.errors import HandError, ModelError
from planner.joints.actuation import STOP_TOL, Actuation, connected
from planner.spatial import FloatArray

FOUR_JOINTS = """
<mujoco>
  <compiler angle="radian"/>
  <option gravity="0 0 0" timestep="0.001"/>
  <default><geom type="capsule" size="0.01" mass="0.05"/></default>
  <worldbody>
    <body><joint name="motored" axis="0 1 0"/><geom fromto="0 0 0 0 0 .05"/></body>
    <body pos=".2 0 0"><joint name="servoed" axis="0 1 0" ref="0.1" range="-1.5 1.5"
      limited="true"/><geom fromto="0 0 0 0 0 .05"/></body>
    <body pos=".4 0 0"><joint name="J2" axis="0 1 0" damping=".01"/><geom fromto="0 0 0 0 0 .05"/>
      <body pos="0 0 .05"><joint name="J1" axis="0 1 0" damping=".01"/>
        <geom fromto="0 0 0 0 0 .03"/></body></body>
  </worldbody>
  <tendon>
    <fixed name="J0"><joint joint="J2" coef="1"/><joint joint="J1" coef="1"/></fixed>
    <fixed name="stop" limited="true" range="0 3" solreflimit="0.004 1">
      <joint joint="J2" coef="1"/><joint joint="J1" coef="-1"/></fixed>
  </tendon>
  <actuator>
    <motor name="motor" joint="motored" gear="3" ctrlrange="-.2 .3"/>
    <position name="servo" joint="servoed" kp="2" kv="0.1" ctrlrange="-1 1" forcerange="-.8 .8"/>
    <position name="pull" tendon="J0" kp="1.5" ctrlrange="-3 3" forcerange="-1 1"/>
  </actuator>
</mujoco>
"""
SEEDS = st.integers(0, 2**32 - 1)
STILL2 = np.zeros(2)


def make(r: ArrayLike, stops: ArrayLike = (), values: ArrayLike = (), **changes: Any) -> Actuation:
    """Motors of unit gain without limits, unless changed."""
    moment = np.array(r, dtype=float)
    nu, nv = moment.shape
    fields: dict[str, Any] = {
        "names": tuple(f"A{i}" for i in range(nu)),
        "joint_names": tuple(f"J{i}" for i in range(nv)),
        "moment": moment,
        "length0": np.zeros(nu),
        "gain": np.ones(nu),
        "bias": np.zeros((nu, 3)),
        "force_range": np.tile([-np.inf, np.inf], (nu, 1)),
        "ctrl_range": np.tile([-np.inf, np.inf], (nu, 1)),
        "stop_rows": np.array(stops, dtype=float).reshape(-1, nv),
        "stop_values": np.array(values, dtype=float),
        "stop_names": tuple(f"stop {i}" for i in range(np.size(values))),
    }
    return Actuation(**{**fields, **changes})


def servo() -> Actuation:
    """Stiffness kp 2, kv 0.1, force within 1, ctrl within 1."""
    return make(
        [[1.0]],
        gain=[2.0],
        bias=[[0.0, -2.0, -0.1]],
        force_range=[[-1.0, 1.0]],
        ctrl_range=[[-1.0, 1.0]],
    )


def tendon_finger() -> Actuation:
    """Joints J2, J1 pulled by one tendon over both; the stop keeps J2 - J1 >= 0."""
    return make([[1, 1]], [[1, -1]], [0.0])


# By hand


def test_servo_by_hand() -> None:
    ctrl, torque = servo().ctrl_for_torque(np.array([0.3]), np.array([0.5]), np.array([0.4]))
    # 2 ctrl - 2 * 0.3 - 0.1 * 0.5 = 0.4
    assert ctrl == pytest.approx([0.525])
    assert torque == pytest.approx([0.4])


def test_servo_is_limited_by_force_range_and_by_what_gain_and_ctrl_range_allow() -> None:
    # 2 (+-1) - 2 q, within +-1
    assert servo().force_limits(np.array([0.3])) == pytest.approx(np.array([[-1.0, 1.0]]))
    assert servo().force_limits(np.array([0.9])) == pytest.approx(np.array([[-1.0, 0.2]]))
    # A negative gain turns the ends round: 2 q - 2 (+-1).
    turned = replace(servo(), gain=np.array([-2.0]), bias=np.array([[0.0, 2.0, 0.0]]))
    assert turned.force_limits(np.array([0.9])) == pytest.approx(np.array([[-0.2, 1.0]]))
    # The law gives -5 to -1 here: it cannot leave the lower limit.
    assert servo().force_limits(np.array([1.5])) == pytest.approx(np.array([[-1.0, -1.0]]))
    ctrl, torque = servo().ctrl_for_torque(np.array([0.9]), np.zeros(1), np.array([0.7]))
    assert (ctrl[0], torque[0]) == pytest.approx((1.0, 0.2))
    ctrl, torque = servo().ctrl_for_torque(np.zeros(1), np.zeros(1), np.array([-5.0]))
    assert (ctrl[0], torque[0]) == pytest.approx((-0.5, -1.0))


def test_torques_of_a_joint_are_the_sum_of_what_its_actuators_make() -> None:
    # two tendons pull the first joint either way, the stronger one the second joint too; a motor
    # without limits drives the third; nothing drives the fourth
    moment = np.array([[0.01, 0, 0, 0], [-0.02, 0.01, 0, 0], [0, 0, 1, 0]])
    limits = np.array([[0, 30], [0, 40], [-np.inf, np.inf]])
    tendons = make(
        moment, gain=np.ones(3), bias=np.zeros((3, 3)), force_range=limits, ctrl_range=limits
    )
    expected = np.array([[-0.8, 0.3], [0, 0.4], [-np.inf, np.inf], [0, 0]])
    np.testing.assert_allclose(tendons.torque_limits(np.zeros(4)), expected, atol=1e-15)


def test_length0_shifts_the_servo() -> None:
    shifted = replace(servo(), length0=np.array([0.25]))
    ctrl, _ = shifted.ctrl_for_torque(np.array([0.1]), np.zeros(1), np.zeros(1))
    assert ctrl == pytest.approx([0.35])


@pytest.mark.parametrize(
    ("q", "asked", "force", "stop"),
    [
        ([0.3, 0.3], [0.3, 0.1], 0.2, 0.1),  # leans on the stop: 0.2 (1, 1) + 0.1 (1, -1)
        ([0.3, 0.3], [0.1, 0.3], 0.2, 0.0),  # would open the stop, which cannot pull
        ([0.5, 0.3], [0.3, 0.1], 0.2, 0.0),  # the stop does not touch
    ],
)
def test_tendon_and_stop_by_hand(
    q: list[float], asked: list[float], force: float, stop: float
) -> None:
    finger = tendon_finger()
    f, lam = finger.split_torque(np.array(q), np.array(asked))
    assert (f[0], lam[0]) == pytest.approx((force, stop))
    ctrl, torque = finger.ctrl_for_torque(np.array(q), STILL2, np.array(asked))
    assert ctrl == pytest.approx([force])
    assert torque == pytest.approx([force + stop, force - stop])


def test_joint_limits_leave_the_torque_to_the_actuator_that_can_make_it() -> None:
    at_limit = make([[1.0]], [[1.0]], [0.0], force_range=[[-1.0, 1.0]])
    force, lam = at_limit.split_torque(np.zeros(1), np.array([0.5]))
    assert (force[0], lam[0]) == pytest.approx((0.5, 0.0))
    # Beyond the actuator's limit, the stop gives what is missing, but only upwards.
    assert at_limit.ctrl_for_torque(np.zeros(1), np.zeros(1), np.array([3.0]))[1] == pytest.approx(
        [3.0]
    )
    assert at_limit.ctrl_for_torque(np.zeros(1), np.zeros(1), np.array([-3.0]))[1] == pytest.approx(
        [-1.0]
    )


def test_of_two_stops_that_help_the_better_aligned_one_carries() -> None:
    # Stretched finger: J2 at its lower limit and the tendon stop both push J2 - J1 up.
    finger = make([[1, 1]], [[1, 0], [1, -1]], [0.0, 0.0])
    force, lam = finger.split_torque(STILL2, np.array([0.3, 0.1]))
    assert lam == pytest.approx([0.0, 0.1])
    assert force == pytest.approx([0.2])


def test_a_stop_is_active_within_its_tolerance() -> None:
    finger = tendon_finger()
    assert finger.active_stops(np.array([0.3, 0.31])).tolist() == [True]
    assert finger.active_stops(np.array([0.3 + 0.9 * STOP_TOL, 0.3])).tolist() == [True]
    assert finger.active_stops(np.array([0.3 + 1.1 * STOP_TOL, 0.3])).tolist() == [False]


# Optimality


@settings(max_examples=60, deadline=None)
@given(seed=SEEDS)
def test_split_is_the_least_squares_answer(seed: int) -> None:
    """By its optimality conditions, for hands that fall apart into fingers or do not."""
    rng = np.random.default_rng(seed)
    nv = int(rng.integers(1, 7))
    nu, ns = int(rng.integers(0, nv + 1)), int(rng.integers(0, 6))
    moment = rng.normal(size=(nu, nv)) * (rng.random((nu, nv)) < rng.choice([0.4, 1.0]))
    stops = rng.integers(-1, 2, size=(ns, nv)).astype(float)
    stops[~stops.any(axis=1), 0] = 1.0
    hand = make(moment, stops, np.zeros(ns))
    q = np.where(rng.random(nv) < 0.5, 0.0, rng.normal(size=nv))
    torque = rng.normal(size=nv)
    force, lam = hand.split_torque(q, torque)
    active = hand.active_stops(q)
    assert (lam >= 0).all()
    assert not lam[~active].any()
    # a convex problem: these conditions of Karush, Kuhn and Tucker prove the minimum
    left = torque - force @ moment - lam @ stops
    assert np.abs(moment @ left).max(initial=0.0) < 1e-9  # free actuators leave nothing they reach
    assert (stops[active] @ left).max(initial=0.0) < 1e-9  # no stop could push more with profit
    assert np.abs(lam * (stops @ left)).max(initial=0.0) < 1e-9


# Second engine


@pytest.fixture(scope="module")
def four_joints() -> tuple[Any, Actuation]:
    model = mujoco.MjModel.from_xml_string(FOUR_JOINTS)
    return model, actuation_from_mujoco(model)


def actuator_torque(model: Any, q: FloatArray, v: FloatArray, ctrl: FloatArray) -> FloatArray:
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:], data.ctrl[:] = q, v, ctrl
    mujoco.mj_forward(model, data)
    return np.array(data.qfrc_actuator)


def test_ctrl_makes_the_torque_in_mujoco(four_joints: tuple[Any, Actuation]) -> None:
    model, hand = four_joints
    rng = np.random.default_rng(1)
    for _ in range(50):
        q, v = rng.uniform(-0.3, 0.3, 4), rng.uniform(-1, 1, 4)
        q[2] = q[3] + 0.5  # the stop is off
        pull = rng.uniform(-0.3, 0.3)
        asked = np.array([rng.uniform(-0.5, 0.5), rng.uniform(-0.5, 0.5), pull, pull])
        ctrl, achieved = hand.ctrl_for_torque(q, v, asked)
        assert achieved == pytest.approx(asked, abs=1e-12)
        assert actuator_torque(model, q, v, ctrl) == pytest.approx(asked, abs=1e-12)


def test_clipped_torque_is_what_mujoco_makes(four_joints: tuple[Any, Actuation]) -> None:
    model, hand = four_joints
    rng = np.random.default_rng(2)
    for _ in range(50):
        q, v = rng.uniform(-0.9, 0.9, 4), rng.uniform(-1, 1, 4)
        q[2] = q[3] + 0.5
        ctrl, achieved = hand.ctrl_for_torque(q, v, rng.normal(size=4) * 5)
        assert (ctrl >= hand.ctrl_range[:, 0]).all()
        assert (ctrl <= hand.ctrl_range[:, 1]).all()
        assert actuator_torque(model, q, v, ctrl) == pytest.approx(achieved, abs=1e-12)


def test_force_limits_are_mujocos_forces_at_the_ends_of_ctrl(
    four_joints: tuple[Any, Actuation],
) -> None:
    model, hand = four_joints
    data = mujoco.MjData(model)
    rng = np.random.default_rng(3)
    for _ in range(20):
        data.qpos[:] = q = rng.uniform(-0.9, 0.9, 4)
        ends = []
        for end in hand.ctrl_range.T:
            data.ctrl[:] = end
            mujoco.mj_forward(model, data)
            ends.append(np.array(data.actuator_force))
        assert hand.force_limits(q) == pytest.approx(np.sort(np.array(ends).T, axis=1))
        assert np.array(data.actuator_length) == pytest.approx(hand.moment @ q + hand.length0)


def test_the_stop_carries_in_mujoco_what_it_is_said_to(four_joints: tuple[Any, Actuation]) -> None:
    """A load that leans on the stop is held; the opposite load runs away."""
    model, hand = four_joints
    q = np.array([0.0, 0.0, 0.4, 0.4])
    moved = []
    for asked in ([0.0, 0.0, 0.12, 0.04], [0.0, 0.0, 0.04, 0.12]):
        data = mujoco.MjData(model)
        data.qpos[:] = q
        data.ctrl[:], achieved = hand.ctrl_for_torque(q, np.zeros(4), np.array(asked))
        data.qfrc_applied[:] = -np.array(asked)
        for _ in range(300):
            mujoco.mj_step(model, data)
        moved.append(float(np.abs(data.qpos - q).max()))
        if len(moved) == 1:
            assert achieved == pytest.approx(asked)
            lam = np.array(data.qfrc_constraint)
            assert lam[2:] == pytest.approx([0.04, -0.04], abs=1e-3)
    assert moved[0] < STOP_TOL
    assert moved[1] > 0.1


# Bad input


def test_bad_actuations_are_refused() -> None:
    with pytest.raises(ModelError, match="gain 0"):
        make([[1.0]], gain=[0.0])
    with pytest.raises(ModelError, match=r"moment has shape \(1, 2\).*need \(1, 1\)"):
        make([[1.0]], moment=[[1.0, 2.0]])
    with pytest.raises(ModelError, match="bias holds NaN"):
        make([[1.0]], bias=[[0.0, np.nan, 0.0]])
    with pytest.raises(ModelError, match=r"force range of actuator 'A0' is \[1.0, -1.0\]"):
        make([[1.0]], force_range=[[1.0, -1.0]])
    with pytest.raises(ModelError, match="stop 'stop 0' acts on no joint"):
        make([[1.0]], [[0.0]], [0.0])


def test_bad_states_are_refused() -> None:
    with pytest.raises(HandError, match=r"q \(2,\).*give \(1,\) each"):
        servo().ctrl_for_torque(np.zeros(2), np.zeros(1), np.zeros(1))
    with pytest.raises(HandError, match="NaN"):
        servo().ctrl_for_torque(np.zeros(1), np.zeros(1), np.array([np.nan]))
    with pytest.raises(HandError, match="NaN"):
        servo().force_limits(np.array([np.inf]))


def test_an_actuation_cannot_be_changed_from_outside() -> None:
    moment = np.array([[1.0]])
    hand = make(moment)
    moment[0, 0] = 5.0
    assert hand.moment[0, 0] == 1.0
    with pytest.raises(ValueError, match="read-only"):
        hand.moment[0, 0] = 5.0


def test_the_limit_of_a_tendon_is_that_of_its_own_actuator_alone() -> None:
    model = mujoco.MjModel.from_xml_string("""
        <mujoco><worldbody>
          <body><joint name="j"/><geom size="0.1"/></body>
          <body><joint name="k"/><geom size="0.1"/></body>
        </worldbody>
        <tendon><fixed name="t" actuatorfrclimited="true" actuatorfrcrange="-3 5">
          <joint joint="j" coef="1"/></fixed></tendon>
        <actuator>
          <position tendon="t" kp="1000"/>
          <position joint="k" kp="1000" forcelimited="true" forcerange="-8 8"/>
        </actuator></mujoco>""")
    np.testing.assert_array_equal(actuation_from_mujoco(model).force_range, [[-3, 5], [-8, 8]])
    for ctrl, torque in ((10.0, [5.0, 8.0]), (-10.0, [-3.0, -8.0])):
        made = actuator_torque(model, np.zeros(2), np.zeros(2), np.full(2, ctrl))
        np.testing.assert_allclose(made, torque)


@pytest.mark.parametrize("gear", [0.5, 1.0, 2.0, -2.0])
def test_the_limit_of_a_tendon_holds_before_the_gear_as_in_mujoco(gear: float) -> None:
    model = mujoco.MjModel.from_xml_string(f"""
        <mujoco><option gravity="0 0 0"/><worldbody>
          <body><joint name="j"/><geom size="0.1"/></body></worldbody>
        <tendon><fixed name="t" actuatorfrclimited="true" actuatorfrcrange="-3 5">
          <joint joint="j" coef="1"/></fixed></tendon>
        <actuator><motor tendon="t" gear="{gear}"/></actuator></mujoco>""")
    data = mujoco.MjData(model)
    reached = []
    for ctrl in (-100.0, 100.0):
        data.ctrl[0] = ctrl
        mujoco.mj_forward(model, data)
        reached.append(float(data.actuator_force[0]))
    np.testing.assert_allclose(actuation_from_mujoco(model).force_range, [reached])


@given(st.integers(0, 12), st.integers(0, 2**31), st.floats(0.0, 0.4))
def test_connected_things_are_those_of_scipy(n: int, seed: int, share: float) -> None:
    linked = np.random.default_rng(seed).random((n, n)) < share
    _, label = connected_components(linked, directed=False)
    np.testing.assert_array_equal(connected(linked), label)
