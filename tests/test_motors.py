"""Hands with torque motors in place of their own actuators."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import mujoco
import numpy as np
import pinocchio as pin
import pytest

from planner.bridge.edit import motorise_spec
from planner.errors import HandError
from planner.hand_loading import load_hand
from planner.hands.hand import Hand
from planner.kinematics import HandState
from planner.search.grasp import plan_grasp
from planner.spatial import FloatArray
from planner.system.package import models_dir
from planner.task import GraspTask
from sim.controllers import ObjectImpedance
from sim.scene.carrier import Timeline
from sim.trial import simulate

pytestmark = pytest.mark.usefixtures("coarse_steps")

HANDS = models_dir() / "hands"
EXACT = 1e-12


@cache
def hand(name: str) -> Hand:
    return load_hand(name)


def derived(folder: Path, of: Path, name: str = "hand.toml") -> Path:
    path = folder / name
    path.write_text(f'schema = 1\nname = "driven"\nmotors_of = "{of}"\n')
    return path


def posture(of: Hand, rng: np.random.Generator) -> FloatArray:
    """Joints (nq,) away from their limits that keep the ties: J1 = J2, which stand side by side."""
    share = rng.uniform(0.3, 0.7, size=of.nq)
    q = of.q_lower + share * (of.q_upper - of.q_lower)
    for coupling in of.couplings:
        a, b = np.flatnonzero(coupling.row)
        q[b] = q[a]
    return np.asarray(q)


# --- a small model, by hand -----------------------------------------------------------------------

SMALL = """
<mujoco>
  <compiler autolimits="true"/>
  <worldbody>
    <body name="base">
      <geom size="0.01"/>
      <body name="a" pos="0 0 0.1">
        <joint name="one" axis="1 0 0" actuatorfrcrange="-0.5 0.5"/>
        <geom size="0.01"/>
        <body name="b" pos="0 0 0.1">
          <joint name="two" axis="1 0 0"/>
          <geom size="0.01"/>
          <body name="c" pos="0 0 0.1">
            <joint name="three" axis="1 0 0"/>
            <geom size="0.01"/>
          </body>
        </body>
      </body>
    </body>
  </worldbody>
  <tendon>
    <fixed name="pull"><joint joint="two" coef="0.5"/><joint joint="three" coef="0.25"/></fixed>
    <fixed name="spring" stiffness="2"><joint joint="three" coef="1"/></fixed>
  </tendon>
  <equality>{equality}</equality>
  <actuator>
    <position name="first" joint="one" kp="3" gear="2" forcerange="-1 4"/>
    <position name="pulling" tendon="pull" kp="5" forcerange="0 8"/>
  </actuator>
</mujoco>
"""
TIE = '<joint joint1="three" joint2="two" polycoef="0 -2 0 0 0"/>'


def motors_of(text: str) -> tuple[mujoco.MjModel, dict[str, list[float]]]:
    spec = mujoco.MjSpec.from_string(text)
    motorise_spec(spec, "it")
    model = spec.compile()
    assert (model.actuator_biastype == int(mujoco.mjtBias.mjBIAS_NONE)).all()
    np.testing.assert_array_equal(model.actuator_ctrlrange, model.actuator_forcerange)
    found = {model.actuator(i).name: model.actuator_forcerange[i].tolist() for i in range(model.nu)}
    return model, found


def test_motors_have_the_torque_of_what_they_replace() -> None:
    # the gear doubles a force, the joint then allows half a newton metre
    model, motors = motors_of(SMALL.format(equality=""))
    assert motors == {"one": [-0.5, 0.5], "two": [0.0, 4.0], "three": [0.0, 2.0]}
    assert model.ntendon == 0


def test_ties_stay_and_tied_joints_keep_their_motors() -> None:
    model, motors = motors_of(SMALL.format(equality=TIE))
    assert list(motors) == ["one", "two", "three"]
    assert model.neq == 1


def test_a_tendon_that_an_equality_holds_stays() -> None:
    model, motors = motors_of(SMALL.format(equality='<tendon tendon1="pull"/>'))
    assert [model.tendon(i).name for i in range(model.ntendon)] == ["pull"]
    assert list(motors) == ["one", "two", "three"]


def test_a_joint_that_nothing_drives_has_no_motor() -> None:
    text = SMALL.format(equality=TIE).replace('<joint joint="three" coef="0.25"/>', "", 1)
    assert list(motors_of(text)[1]) == ["one", "two"]


def test_a_motor_needs_a_greatest_torque() -> None:
    text = SMALL.format(equality="").replace(' forcerange="0 8"', "")
    with pytest.raises(HandError, match=r"\['pulling'\] have no limit; give each a forcerange"):
        motorise_spec(mujoco.MjSpec.from_string(text), "it")


# --- the hand that comes along --------------------------------------------------------------------


def test_motors_of_the_shadow_type_hand() -> None:
    driven, own = hand("shadow_hand_torque"), hand("shadow_hand")
    motors = dict(zip(driven.actuation.names, driven.actuation.force_range[:, 1], strict=True))
    assert tuple(motors) == own.joint_names
    assert (motors["FFJ3"], motors["FFJ2"], motors["FFJ1"]) == (1, 1, 1)
    assert (motors["THJ5"], motors["WRJ2"]) == (3, 10)
    assert not driven.actuation.stiffness.any()
    assert all(not c.one_sided for c in driven.couplings)
    for a, b in zip(driven.couplings, own.couplings, strict=True):
        np.testing.assert_array_equal(a.row, b.row)
    assert driven.digest != own.digest


def test_kinematics_and_masses_are_those_of_the_hand_itself() -> None:
    driven, own = hand("shadow_hand_torque"), hand("shadow_hand")
    assert driven.joint_names == own.joint_names
    np.testing.assert_array_equal(
        driven.pin_model.lowerPositionLimit, own.pin_model.lowerPositionLimit
    )
    np.testing.assert_array_equal(
        driven.pin_model.upperPositionLimit, own.pin_model.upperPositionLimit
    )
    rng = np.random.default_rng(0)
    for _ in range(5):
        q = posture(driven, rng)
        pairs = [(HandState(h, q), h) for h in (driven, own)]
        for name, finger in own.fingers.items():
            mine, theirs = (state.pad_center(h.fingers[name]) for state, h in pairs)
            np.testing.assert_array_equal(mine, theirs)
            assert driven.fingers[name].pad.half_angle == finger.pad.half_angle
        mass = [pin.crba(h.pin_model, h.pin_model.createData(), q) for h in (driven, own)]
        np.testing.assert_array_equal(*mass)


def test_torques_act_as_asked() -> None:
    # a load as large as the torque, the other way: nothing moves
    of = hand("shadow_hand_torque")
    model = of.new_spec().compile()
    model.opt.gravity[:] = 0.0
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    model.dof_frictionloss[:] = 0.0  # it would hide a hundredth of a newton metre
    model.dof_damping[:] = 1e-3  # so that anything that is wrong shows at once
    data = mujoco.MjData(model)
    rng = np.random.default_rng(1)
    for _ in range(3):
        q = posture(of, rng)
        torque = rng.uniform(-0.4, 0.4, size=of.nq)
        ctrl, achieved = of.actuation.ctrl_for_torque(q, np.zeros(of.nq), torque)
        np.testing.assert_allclose(achieved, torque, atol=1e-9)
        mujoco.mj_resetData(model, data)
        data.qpos[:], data.ctrl[:], data.qfrc_applied[:] = q, ctrl, -torque
        mujoco.mj_forward(model, data)
        np.testing.assert_allclose(data.qfrc_actuator, torque, atol=1e-9)
        mujoco.mj_step(model, data, 100)
        np.testing.assert_allclose(data.qpos, q, atol=1e-9)


def test_a_torque_beyond_a_motor_is_cut() -> None:
    of = hand("shadow_hand_torque")
    torque = np.zeros(of.nq)
    torque[of.joint_names.index("FFJ3")] = 5.0
    ctrl, achieved = of.actuation.ctrl_for_torque(of.posture("open"), np.zeros(of.nq), torque)
    assert ctrl[of.actuation.names.index("FFJ3")] == 1.0
    np.testing.assert_allclose(achieved[of.joint_names.index("FFJ3")], 1.0, atol=1e-9)


@pytest.mark.slow
def test_it_grasps_and_holds() -> None:
    # light links stick short of the object where a spring is softer than their dry friction, and
    # the thumb's middle joint is against its stop here
    task = GraspTask.create("shadow_hand_torque", "cylinder:0.03x0.08")
    plan = plan_grasp(task, seed=0)
    brief = Timeline.quick(approach=0.2, lift=0.3, hold=0.3)
    report = simulate(plan, controller=ObjectImpedance(plan), timeline=brief)
    assert report.success, report.reason
    assert not [e for e in report.events if e.kind in ("infeasible", "gave up")]


# --- any hand -------------------------------------------------------------------------------------


def test_any_hand_can_have_motors(tmp_path: Path) -> None:
    own, driven = (
        hand("allegro_hand"),
        load_hand(derived(tmp_path, HANDS / "allegro_hand" / "hand.toml")),
    )
    assert driven.actuation.names == own.joint_names
    np.testing.assert_array_equal(driven.actuation.force_range, own.actuation.force_range)
    np.testing.assert_array_equal(driven.actuation.bias, 0.0)


def test_a_mirror_image_can_have_motors(tmp_path: Path) -> None:
    left = load_hand(derived(tmp_path, HANDS / "shadow_hand_left" / "hand.toml"))
    right = hand("shadow_hand_torque")
    np.testing.assert_array_equal(left.actuation.force_range, right.actuation.force_range)
    q = right.posture("pinch")
    tips = [HandState(h, q).pad_center(h.fingers["thumb"]) for h in (left, right)]
    np.testing.assert_allclose(tips[0], tips[1] * [-1, 1, 1], atol=EXACT)


def test_the_mirror_image_of_motors_is_refused(tmp_path: Path) -> None:
    first = derived(tmp_path, HANDS / "allegro_hand" / "hand.toml", "motors.toml")
    mirror = tmp_path / "mirror.toml"
    mirror.write_text(f'schema = 1\nname = "m"\nmirror_of = "{first}"\nmirror_axis = "x"\n')
    with pytest.raises(HandError, match="motors_of = that mirror image"):
        load_hand(mirror)


def test_a_hand_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(HandError, match=r"motors_of names .*nowhere.toml, which does not exist"):
        load_hand(derived(tmp_path, tmp_path / "nowhere.toml"))


def test_stops_have_nothing_that_presses_on_them(tmp_path: Path) -> None:
    text = (HANDS / "shadow_hand" / "hand.toml").read_text(encoding="utf-8")
    path = tmp_path / "hand.toml"
    path.write_text(text.replace("schema = 1\n", "schema = 1\nmotors = true\n"), encoding="utf-8")
    with pytest.raises(HandError, match=r"stops \['index_stop', .*kind = \"equality\""):
        load_hand(path)
