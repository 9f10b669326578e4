"""Couplings and transmissions: what a model ties, which torques that leaves, and contradictions.

The finger of the tests: j1 moved by a motor, j2 and j3 tied to it in one of several ways.
"""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import ArrayLike

from planner.bridge import actuation_from_mujoco, couplings_from_mujoco
from planner.contacts import ContactSet
from planner.errors import HandError, ModelError
from planner.forces import distribute_forces
from planner.joints.couplings import Coupling, check_couplings, independent_couplings
from planner.spatial import FloatArray

FINGER = """
<mujoco>
  <compiler angle="radian"/>
  <option gravity="0 0 0"/>
  <worldbody>
    <site name="root"/>
    <body name="a">
      <joint name="j1" axis="0 1 0" range="-0.2 1.6" ref="0.1" damping="0.1" armature="0.001"/>
      <geom type="capsule" fromto="0 0 0 0.04 0 0" size="0.005" contype="0" conaffinity="0"/>
      <body name="b" pos="0.04 0 0">
        <joint name="j2" axis="0 1 0" range="-0.2 1.6" ref="-0.05" damping="0.1" armature="0.001"/>
        <geom type="capsule" fromto="0 0 0 0.03 0 0" size="0.005" contype="0" conaffinity="0"/>
        <body name="c" pos="0.03 0 0">
          <joint name="j3" axis="0 1 0" range="-0.2 1.6" damping="0.1" armature="0.001"/>
          <geom type="capsule" fromto="0 0 0 0.02 0 0" size="0.005" contype="0" conaffinity="0"/>
          <site name="tip" pos="0.02 0 0"/>
        </body>
      </body>
    </body>
  </worldbody>
  TIES
  <actuator><position name="m1" joint="j1" kp="5" forcelimited="true" forcerange="-1 1"/></actuator>
</mujoco>
"""

JOINTS = """<equality>
  <joint name="two" joint1="j2" joint2="j1" polycoef="0.02 0.8 0 0 0"/>
  <joint name="three" joint1="j3" joint2="j2" polycoef="0 0.5 0 0 0"/>
</equality>"""

TENDONS = """<tendon>
  <fixed name="t1"><joint joint="j1" coef="0.008"/><joint joint="j2" coef="-0.01"/></fixed>
  <fixed name="t2"><joint joint="j2" coef="0.01"/></fixed>
  <fixed name="t3"><joint joint="j3" coef="0.02"/></fixed>
</tendon>
<equality>
  <tendon name="two" tendon1="t1" polycoef="0.0001 1 0 0 0"/>
  <tendon name="three" tendon1="t3" tendon2="t2"/>
</equality>"""


def compiled(ties: str) -> Any:
    return mujoco.MjModel.from_xml_string(FINGER.replace("TIES", ties))


def coupling(row: ArrayLike, value: float, name: str = "c", one_sided: bool = False) -> Coupling:
    return Coupling(name=name, row=np.array(row, dtype=float), value=value, one_sided=one_sided)


# --- found in the model ---------------------------------------------------------------------------


def test_a_joint_equality_by_hand() -> None:
    # q2 + 0.05 = 0.02 + 0.8 (q1 - 0.1), with the positions at which MuJoCo draws the joints
    two, three = couplings_from_mujoco(compiled(JOINTS))
    assert (two.name, three.name) == ("two", "three")
    np.testing.assert_allclose(two.row, [-0.8, 1, 0], rtol=0, atol=1e-15)
    assert two.value == pytest.approx(-0.11, abs=1e-15)
    np.testing.assert_allclose(three.row, [0, -0.5, 1], rtol=0, atol=1e-15)
    assert three.value == pytest.approx(0.025, abs=1e-15)
    assert not two.one_sided


@pytest.mark.parametrize("ties", [JOINTS, TENDONS])
def test_mujoco_has_no_residual_where_the_couplings_hold(ties: str) -> None:
    # second witness: MuJoCo's own constraint positions and Jacobian
    model = compiled(ties)
    data = mujoco.MjData(model)
    found = couplings_from_mujoco(model)
    matrix = np.array([c.row for c in found])
    rng = np.random.default_rng(0)
    for _ in range(5):
        q = rng.uniform(0, 1, 3)
        data.qpos[:] = q
        mujoco.mj_forward(model, data)
        jacobian = data.efc_J.reshape(-1, model.nv)[: model.neq]
        np.testing.assert_allclose(matrix, jacobian, rtol=0, atol=1e-15)
        residual = matrix @ q - [c.value for c in found]
        np.testing.assert_allclose(residual, data.efc_pos[: model.neq], rtol=0, atol=1e-15)


def test_an_equality_of_one_joint_holds_it() -> None:
    model = compiled('<equality><joint name="lock" joint1="j1" polycoef="0.3 1 0 0 0"/></equality>')
    (lock,) = couplings_from_mujoco(model)
    np.testing.assert_array_equal(lock.row, [1, 0, 0])
    assert lock.value == pytest.approx(0.4)  # 0.3 from where the joint is drawn, 0.1


def test_an_equality_that_is_switched_off_ties_nothing() -> None:
    off = JOINTS.replace('name="two"', 'name="two" active="false"')
    assert [c.name for c in couplings_from_mujoco(compiled(off))] == ["three"]


def test_a_tie_between_parts_of_one_link_ties_nothing_more() -> None:
    nail = '<body name="nail"><geom size="0.01" contype="0" conaffinity="0"/></body>'
    weld = '<weld body1="nail" body2="c"/></equality>'
    text = FINGER.replace('<site name="tip"', f'{nail}<site name="tip"')
    model = text.replace("TIES", JOINTS.replace("</equality>", weld))
    found = couplings_from_mujoco(mujoco.MjModel.from_xml_string(model))
    assert [c.name for c in found] == ["two", "three"]


@pytest.mark.parametrize(
    ("ties", "reason"),
    [
        (
            JOINTS.replace("0.02 0.8 0", "0.02 0.8 0.1"),
            r"'two' has polycoef \[0.02, 0.8, 0.1, .* not linear; only the first two",
        ),
        (
            '<equality><connect name="loop" body1="c" body2="world" anchor="0 0 0"/></equality>',
            r"'loop' closes a loop between bodies.*drop_couplings = \['loop'\]",
        ),
        (
            '<tendon><spatial name="rope"><site site="root"/><site site="tip"/></spatial></tendon>'
            '<equality><tendon tendon1="rope"/></equality>',
            "'rope' runs through space; only fixed tendons",
        ),
    ],
)
def test_what_is_not_linear_is_named(ties: str, reason: str) -> None:
    with pytest.raises(ModelError, match=reason):
        couplings_from_mujoco(compiled(ties))


# --- sets of couplings ----------------------------------------------------------------------------


def test_a_repeated_coupling_counts_once() -> None:
    given = [
        coupling([1, -1, 0], 0.1),
        coupling([0, 1, -1], 0.2, "d"),
        coupling([2, 0, -2], 0.6, "sum of both"),
        coupling([-1, 1, 0], -0.1, "a stop along it", one_sided=True),
        coupling([0, 0, 1], 0.0, "another stop", one_sided=True),
    ]
    kept = independent_couplings(given, "the hand")
    assert [c.name for c in kept] == ["c", "d", "another stop"]


@pytest.mark.parametrize(
    ("extra", "contradicts"),
    [
        (coupling([2, -2, 0], 0.3, "other"), True),
        (coupling([2, -2, 0], 0.2, "same"), False),
        (coupling([1, -1, 0], 0.0, "stop below", one_sided=True), False),  # never reached
        (coupling([1, -1, 0], 0.2, "stop above", one_sided=True), True),  # always violated
    ],
)
def test_contradictions_are_named(extra: Coupling, contradicts: bool) -> None:
    given = [coupling([1, -1, 0], 0.1)]
    if not contradicts:
        assert independent_couplings([*given, extra], "the hand") == tuple(given)
        return
    with pytest.raises(HandError, match=f"'{extra.name}' contradicts the couplings before it"):
        independent_couplings([*given, extra], "the hand")


def test_a_coupling_of_nothing_is_refused() -> None:
    with pytest.raises(HandError, match="'c' acts on no joint"):
        independent_couplings([coupling([0, 0, 0], 0.0)], "the hand")


@given(
    rows=st.lists(
        st.lists(st.integers(-3, 3), min_size=4, max_size=4).filter(any), min_size=1, max_size=7
    )
)
def test_what_is_kept_says_all_and_nothing_twice(rows: list[list[int]]) -> None:
    q = np.array([0.3, -0.2, 0.7, 0.1])  # keeps every one of them, so that none contradicts
    given = [coupling(row, float(np.dot(row, q)), str(i)) for i, row in enumerate(rows)]
    kept = independent_couplings(given, "the hand")
    matrix = np.array([c.row for c in kept])
    rank = np.linalg.matrix_rank(np.array(rows, dtype=float))
    assert len(kept) == rank == np.linalg.matrix_rank(matrix)


def test_couplings_within_the_joint_ranges() -> None:
    lower, upper = np.zeros(3), np.ones(3)
    check_couplings([coupling([1, -1, 0], 0.5), coupling([0, 1, -1], 0.5)], lower, upper, "h")
    with pytest.raises(HandError, match=r"'c' asks for 1\.5000, .* allow \[-1\.0000, 1\.0000\]"):
        check_couplings([coupling([1, -1, 0], 1.5)], lower, upper, "h")
    with pytest.raises(HandError, match="no q within the joint ranges keeps all couplings"):
        check_couplings([coupling([1, -1, 0], 0.7), coupling([0, 1, -1], 0.7)], lower, upper, "h")


# --- torques --------------------------------------------------------------------------------------


def settled(model: Any, ctrl: float, push: ArrayLike) -> FloatArray:
    """Joint positions (3,) at rest under a command and a joint torque from outside."""
    data = mujoco.MjData(model)
    data.qpos[:] = [0.1, 0.1, 0.1]
    data.ctrl[0] = ctrl
    data.qfrc_applied[:] = push
    for _ in range(4000):
        mujoco.mj_step(model, data)
    assert np.abs(data.qvel).max() < 1e-6
    return np.array(data.qpos)


@pytest.mark.parametrize("ties", [JOINTS, TENDONS])
def test_a_tied_finger_holds_any_torque_with_one_motor(ties: str) -> None:
    # tau = R^T F + C^T lam for every tau: by hand, F is the virtual work along q(q1)
    model = compiled(ties)
    ours = actuation_from_mujoco(model)
    q = np.array([0.5, 0.29, 0.17])  # keeps JOINTS; TENDONS has the same directions
    slope = np.array([1.0, 0.8, 0.4])
    rng = np.random.default_rng(1)
    for _ in range(10):
        torque = rng.normal(size=3)
        force, lam = ours.split_torque(q, torque)
        np.testing.assert_allclose(
            ours.moment.T @ force + ours.stop_rows.T @ lam, torque, rtol=0, atol=1e-12
        )
        assert (lam >= 0).all()
        assert force[0] == pytest.approx(slope @ torque, abs=1e-12)


def test_the_motor_of_a_tied_finger_feels_what_mujoco_says() -> None:
    model = compiled(JOINTS)
    ours = actuation_from_mujoco(model)
    push = np.array([0.0, 0.05, -0.2])  # from outside, to be held
    q = settled(model, 0.6, push)
    two, three = couplings_from_mujoco(model)
    assert abs(two.row @ q - two.value) < 0.01
    assert abs(three.row @ q - three.value) < 0.01
    force, _ = ours.split_torque(q, -push)
    # the servo's law: 5 (0.6 - q1); MuJoCo's equalities give way by some mrad
    assert force[0] == pytest.approx(5 * (0.6 - q[0]), abs=1e-3)
    assert force[0] == pytest.approx(-(0.8 * 0.05 + 0.4 * -0.2), abs=1e-12)


def test_the_command_for_a_torque_holds_a_tied_finger_still() -> None:
    model = compiled(JOINTS)
    ours = actuation_from_mujoco(model)
    q = np.array([0.5, 0.29, 0.17])
    ctrl, made = ours.ctrl_for_torque(q, np.zeros(3), np.array([0.1, 0.2, 0.3]))
    np.testing.assert_allclose(made, [0.1, 0.2, 0.3], rtol=0, atol=1e-9)
    at_rest = settled(model, float(ctrl[0]), [-0.1, -0.2, -0.3])
    np.testing.assert_allclose(at_rest, q, rtol=0, atol=0.02)
    # beyond the limit of 1 N m the motor is clipped and the rest is missing, not made up
    ctrl, made = ours.ctrl_for_torque(q, np.zeros(3), np.array([5.0, 0.0, 0.0]))
    assert 5 * (ctrl[0] - 0.5) == pytest.approx(1.0)
    slope = np.array([1.0, 0.8, 0.4])
    assert slope @ made == pytest.approx(1.0)


def test_without_ties_the_motor_holds_its_own_joint_alone() -> None:
    ours = actuation_from_mujoco(compiled(""))
    force, lam = ours.split_torque(np.array([0.5, 0.29, 0.17]), np.array([0.3, 0.2, 0.1]))
    np.testing.assert_allclose(force, [0.3], rtol=0, atol=1e-12)
    assert not lam.any()


def pressed(ties: str, press: float) -> Any:
    """A finger's site pressed with a force normal to its last link, by the force QP."""
    model = compiled(ties)
    q = np.array([0.5, 0.29, 0.17])
    data = mujoco.MjData(model)
    data.qpos[:] = q
    mujoco.mj_forward(model, data)
    linear, angular = np.zeros((3, 3)), np.zeros((3, 3))
    tip = data.site("tip")
    mujoco.mj_jacSite(model, data, linear, angular, tip.id)
    normal = -tip.xmat.reshape(3, 3)[:, 2]  # flexion about +y moves the tip down
    contacts = ContactSet.from_arrays([tip.xpos], [normal], center=tip.xpos)
    result = distribute_forces(
        contacts,
        wrench=np.concatenate([-press * normal, np.zeros(3)]),
        jacobians=np.vstack([linear, angular])[None],
        actuation=actuation_from_mujoco(model),
        q=q,
    )
    return result, linear.T @ (press * normal)


def test_the_force_problem_knows_the_ties() -> None:
    # free distal joints press with nothing; tied ones carry virtual work
    free, _ = pressed("", 1.0)
    assert not free.found
    tied, torque = pressed(JOINTS, 1.0)
    assert tied.found
    slope = np.array([1.0, 0.8, 0.4])
    assert tied.actuator_forces[0] == pytest.approx(slope @ torque, rel=1e-3)
    beyond, torque = pressed(JOINTS, 20.0)
    assert slope @ torque > 1.0  # more than the motor's limit
    assert not beyond.found


# --- springs --------------------------------------------------------------------------------------

SPRUNG = JOINTS.replace(
    "<equality>",
    '<tendon><fixed name="s" stiffness="3" springlength="0.2"><joint joint="j1" coef="0.4"/>'
    '<joint joint="j2" coef="-0.3"/></fixed></tendon><equality>',
)


def test_springs_carry_their_part_of_a_torque() -> None:
    ours = actuation_from_mujoco(compiled(SPRUNG))
    q, torque = np.array([0.5, 0.29, 0.17]), np.array([0.1, 0.2, -0.3])
    passive = ours.passive_torque(q)
    # 3 (0.2 - 0.4 * 0.5 + 0.3 * 0.29) along (0.4, -0.3, 0)
    np.testing.assert_allclose(passive, 0.261 * np.array([0.4, -0.3, 0]), rtol=0, atol=1e-12)
    force, lam = ours.split_torque(q, torque)
    made = ours.moment.T @ force + ours.stop_rows.T @ lam + passive
    np.testing.assert_allclose(made, torque, rtol=0, atol=1e-12)
    assert force[0] == pytest.approx(np.array([1.0, 0.8, 0.4]) @ (torque - passive), abs=1e-12)
    ctrl, achieved = ours.ctrl_for_torque(q, np.zeros(3), torque)
    np.testing.assert_allclose(achieved, torque, rtol=0, atol=1e-9)
    assert 5 * (ctrl[0] - 0.5) == pytest.approx(force[0], abs=1e-12)


def test_a_spring_between_idle_joints_is_held_without_a_contact() -> None:
    # no coupling: the spring pulls j2 where no motor can hold it, and no stop is near
    ours = actuation_from_mujoco(compiled(SPRUNG[: SPRUNG.index("<equality>")]))
    q = np.array([0.5, 0.29, 0.17])
    _, achieved = ours.ctrl_for_torque(q, np.zeros(3), np.zeros(3))
    np.testing.assert_allclose(achieved, [0, -0.3 * 0.261, 0], rtol=0, atol=1e-9)


def test_the_force_problem_knows_the_springs() -> None:
    plain, _ = pressed(JOINTS, 1.0)
    sprung, _ = pressed(SPRUNG, 1.0)
    assert sprung.found
    # the spring's virtual work along the coupled motion is the motor's to give
    spring = np.array([1.0, 0.8, 0.4]) @ (0.261 * np.array([0.4, -0.3, 0]))
    difference = sprung.actuator_forces[0] - plain.actuator_forces[0]
    assert difference == pytest.approx(-spring, abs=1e-6)


# --- limits of tendons ----------------------------------------------------------------------------


def test_stops_of_tendons_are_in_radians_and_only_where_they_can_be_reached() -> None:
    model = compiled(
        '<tendon><fixed name="soft" limited="true" range="-0.001 0.001"><joint joint="j2" '
        'coef="0.007"/><joint joint="j1" coef="-0.008"/></fixed><fixed name="loose" limited="true" '
        'range="-9 9"><joint joint="j3" coef="0.01"/></fixed></tendon>'
    )
    ours = actuation_from_mujoco(model)
    assert [n for n in ours.stop_names if n.startswith("tendon")] == [
        "tendon soft lower",
        "tendon soft upper",
    ]
    first = ours.stop_names.index("tendon soft lower")
    np.testing.assert_allclose(ours.stop_rows[first], [-1, 0.875, 0], rtol=0, atol=1e-15)
    assert ours.stop_values[first] == pytest.approx(-0.125)
    # 0.1 rad from the stop is not at the stop, though 0.7 mm of tendon would be within 0.01
    assert not ours.active_stops(np.array([0.5, (0.5 - 0.125 + 0.1) / 0.875, 0.0]))[first]
    assert ours.active_stops(np.array([0.5, (0.5 - 0.125 + 0.005) / 0.875, 0.0]))[first]
