"""A hand on an arm: description, composition, inverse kinematics, reach."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import casadi as ca
import mujoco
import numpy as np
import pinocchio as pin
import pytest

from planner.errors import (
    HandError,
    ModelError,
    NoGraspFoundError,
    NotFoundError,
    PlannerError,
    TaskError,
)
from planner.hand_loading import load_hand
from planner.hands.hand import Hand
from planner.kinematics import (
    POSITION_TOL,
    ROTATION_TOL,
    HandState,
    follow,
    palm_pose,
    reach,
    straight_path,
)
from planner.search.grasp import plan_grasp
from planner.spatial import SE3, FloatArray, rotation_angle
from planner.synthesis.symbols import SymbolicHand
from planner.system.package import models_dir
from planner.task import GraspTask
from sim.sensing.errors import Drawn, ErrorModel, drawn_numbers, drawn_text

# Craig's Denavit-Hartenberg parameters of the Panda: a (m), alpha (rad), d (m) of joints 1 to 7
DH = [
    (0.0, 0.0, 0.333),
    (0.0, -np.pi / 2, 0.0),
    (0.0, np.pi / 2, 0.316),
    (0.0825, np.pi / 2, 0.0),
    (-0.0825, -np.pi / 2, 0.384),
    (0.0, np.pi / 2, 0.0),
    (0.088, np.pi / 2, 0.0),
]
FLANGE = 0.107

GANTRY = """
<mujoco model="gantry">
  <compiler angle="radian" autolimits="true"/>
  <worldbody>
    <body name="rail">
      <geom name="rail" type="box" size="0.6 0.02 0.02"/>
      <body name="cart">
        <joint name="x" type="slide" axis="1 0 0" range="-0.5 0.5"/>
        <geom name="cart" type="box" size="0.05 0.05 0.05" mass="2"/>
        <body name="ram">
          <joint name="z" type="slide" axis="0 0 -1" range="0 0.5"/>
          <geom name="ram" type="capsule" size="0.02" fromto="0 0 0.1 0 0 0" mass="1"/>
          <site name="plate" quat="0 1 0 0"/>
        </body>
      </body>
    </body>
  </worldbody>
  <actuator>
    <position name="x" joint="x" kp="2000"/>
    <position name="z" joint="z" kp="2000"/>
  </actuator>
</mujoco>
"""

MOUNT = """
schema = 1
name = "allegro_on_gantry"
hand = "{hand}"
[arm]
model = "gantry.xml"
attach = "plate"
position = [0.0, 0.0, 0.1]
base_position = [0.0, 0.0, 0.6]
[arm.ready]
z = 0.2
"""


@pytest.fixture(scope="module")
def arm_hand() -> Hand:
    return load_hand("allegro_on_arm7")


@pytest.fixture
def gantry(tmp_path: Path) -> Path:
    """Description of the Allegro on a gantry of two slides."""
    hand = models_dir() / "hands" / "allegro_hand" / "hand.toml"
    (tmp_path / "gantry.xml").write_text(GANTRY)
    (tmp_path / "hand.toml").write_text(MOUNT.format(hand=hand.as_posix()))
    return tmp_path / "hand.toml"


def edit(path: Path, old: str, new: str) -> None:
    text = path.read_text()
    assert old in text, f"{old!r} is not in {path.name}: the test edits nothing"
    path.write_text(text.replace(old, new))


def random_q(hand: Hand, rng: np.random.Generator) -> FloatArray:
    """Pinch posture with the arm anywhere within its limits."""
    q, index = hand.posture("pinch"), hand.arm_index
    q[index] = rng.uniform(hand.q_lower[index], hand.q_upper[index])
    return q


def by_hand(q: FloatArray) -> SE3:
    """Pose of the flange from the published parameters."""
    pose = SE3.Identity()
    for (a, alpha, d), angle in zip(DH, q, strict=True):
        x, z = np.array([1.0, 0, 0]), np.array([0, 0, 1.0])
        pose = pose * SE3(pin.exp3(alpha * x), np.array([a, 0, 0]))
        pose = pose * SE3(pin.exp3(angle * z), np.array([0, 0, d]))
    return pose * SE3(np.eye(3), np.array([0, 0, FLANGE]))


def test_the_flange_is_where_the_published_parameters_put_it(arm_hand: Hand) -> None:
    rng = np.random.default_rng(0)
    data, mj = arm_hand.pin_model.createData(), mujoco.MjData(arm_hand.mj_model)
    flange = arm_hand.pin_model.getFrameId("arm/flange")
    for _ in range(10):
        q = random_q(arm_hand, rng)
        expected = by_hand(q[:7])
        pin.framesForwardKinematics(arm_hand.pin_model, data, q)
        np.testing.assert_allclose(data.oMf[flange].homogeneous, expected.homogeneous, atol=1e-12)
        mj.qpos[:] = q
        mujoco.mj_kinematics(arm_hand.mj_model, mj)
        np.testing.assert_allclose(mj.site("arm/flange").xpos, expected.translation, atol=1e-12)


def test_the_hand_is_the_same_as_without_an_arm(arm_hand: Hand, allegro: Hand) -> None:
    assert arm_hand.joint_names == (*(f"arm/joint{k}" for k in range(1, 8)), *allegro.joint_names)
    assert arm_hand.arm_index.tolist() == list(range(7))
    assert arm_hand.digest != allegro.digest
    rng = np.random.default_rng(1)
    for _ in range(5):
        q = random_q(arm_hand, rng)
        carried, alone = HandState(arm_hand, q), HandState(allegro, q[7:])
        for name, finger in arm_hand.fingers.items():
            in_palm = carried.T_base_palm.inverse().act(carried.pad_center(finger))
            expected = alone.T_base_palm.inverse().act(alone.pad_center(allegro.fingers[name]))
            np.testing.assert_allclose(in_palm, expected, atol=1e-12)
    arm_mass = sum(m for i, m in enumerate(arm_hand.mj_model.body_mass)) - 0.9549
    assert arm_mass == pytest.approx(18.0, abs=1e-3)


def test_a_mirrored_hand_can_be_on_an_arm(gantry: Path) -> None:
    edit(gantry, "allegro_hand/", "allegro_hand_left/")
    left, right = load_hand(gantry), load_hand("allegro_hand")
    q = left.posture("pinch")
    thumb = HandState(left, q)
    in_palm = thumb.T_base_palm.inverse().act(thumb.pad_center(left.fingers["thumb"]))
    mirrored = HandState(right, q[2:]).pad_center(right.fingers["thumb"]) * [1, -1, 1]
    np.testing.assert_allclose(in_palm, mirrored, atol=1e-9)


def test_symbolic_flange_and_hand_together_are_the_whole_chain(arm_hand: Hand) -> None:
    q = random_q(arm_hand, np.random.default_rng(2))
    symbolic = SymbolicHand(arm_hand, ca.SX(q), from_flange=True)
    turn, origin = (np.array(ca.DM(v)) for v in symbolic.flange)
    state = HandState(arm_hand, q)
    assert arm_hand.arm is not None
    last = state.joint_pose(arm_hand.arm.flange)
    np.testing.assert_allclose(turn, last.rotation, atol=1e-12)
    np.testing.assert_allclose(origin.ravel(), last.translation, atol=1e-12)
    for finger in arm_hand.fingers.values():
        local = np.array(ca.DM(symbolic.point(finger.pad.joint_id, finger.pad.center)))
        expected = state.pad_center(finger)
        np.testing.assert_allclose((turn @ local + origin).ravel(), expected, atol=1e-12)
    elbow = arm_hand.pin_model.getJointId("arm/joint4")
    assert symbolic.is_cut_off(elbow)
    assert not symbolic.is_cut_off(arm_hand.fingers["thumb"].pad.joint_id)
    above = np.array(ca.DM(symbolic.point(elbow, np.zeros(3)))).ravel()
    np.testing.assert_allclose(above, state.joint_pose(elbow).translation, atol=1e-12)


def test_inverse_kinematics_undoes_forward_kinematics(arm_hand: Hand) -> None:
    rng = np.random.default_rng(3)
    found = 0
    for _ in range(60):
        wanted = palm_pose(arm_hand, random_q(arm_hand, rng))
        reached = reach(arm_hand, wanted, arm_hand.posture("pinch"))
        assert (reached.q >= arm_hand.q_lower).all()
        assert (reached.q <= arm_hand.q_upper).all()
        np.testing.assert_array_equal(reached.q[7:], arm_hand.posture("pinch")[7:])
        error = wanted.inverse() * palm_pose(arm_hand, reached.q)
        assert reached.distance == pytest.approx(np.linalg.norm(error.translation), abs=1e-9)
        assert reached.there == (
            np.linalg.norm(error.translation) <= POSITION_TOL
            and rotation_angle(error.rotation) <= ROTATION_TOL
        )
        found += reached.there
    assert found >= 57


def test_what_is_out_of_reach_is_not_reached(arm_hand: Hand) -> None:
    far = SE3(np.eye(3), np.array([2.0, 0.0, 0.333]))
    reached = reach(arm_hand, far, arm_hand.posture("pinch"), restarts=1)
    assert not reached.there
    assert arm_hand.arm is not None
    # the palm is at most `longest` from the first joint, which is at (0, 0, 0.333)
    assert reached.distance >= 2.0 - arm_hand.arm.longest


def test_no_posture_is_longer_than_the_longest(arm_hand: Hand) -> None:
    rng = np.random.default_rng(4)
    assert arm_hand.arm is not None
    first = np.array([0.0, 0.0, 0.333])
    lengths = [
        np.linalg.norm(palm_pose(arm_hand, random_q(arm_hand, rng)).translation - first)
        for _ in range(500)
    ]
    assert 0.7 < max(lengths) <= arm_hand.arm.longest


def test_a_straight_path_is_straight(arm_hand: Hand) -> None:
    q = arm_hand.posture("pinch")
    begin = palm_pose(arm_hand, q)
    shift = np.array([0.05, 0.0, -0.1])
    path = straight_path(arm_hand, q, shift)
    assert path is not None
    for share, posture in zip(np.linspace(0, 1, len(path)), path, strict=True):
        q[arm_hand.arm_index] = posture
        palm = palm_pose(arm_hand, q)
        wanted = begin.translation + share * shift
        np.testing.assert_allclose(palm.translation, wanted, atol=POSITION_TOL)
        assert rotation_angle(begin.rotation.T @ palm.rotation) <= ROTATION_TOL
    assert straight_path(arm_hand, arm_hand.posture("pinch"), np.array([1.0, 0, 0])) is None


def test_any_tree_of_joints_is_an_arm(gantry: Path) -> None:
    hand = load_hand(gantry)
    assert hand.joint_names[:2] == ("arm/x", "arm/z")
    q = hand.posture("open")
    assert q[:2].tolist() == [0.0, 0.2]
    begin = palm_pose(hand, q)
    reached = follow(hand, SE3(begin.rotation, begin.translation + np.array([0.3, 0.0, -0.1])), q)
    assert reached.there
    np.testing.assert_allclose(reached.q[:2], [0.3, 0.3], atol=1e-5)
    assert not reach(hand, SE3(begin.rotation, begin.translation + np.array([0, 0.1, 0])), q).there
    # neighbours of the fixed root may touch in MuJoCo as they may in the planner
    data = mujoco.MjData(hand.mj_model)
    data.qpos[:] = q
    mujoco.mj_forward(hand.mj_model, data)
    names = {hand.mj_model.geom(int(g)).name for c in data.contact for g in c.geom}
    assert not {n for n in names if n.startswith("arm/")}


@pytest.mark.parametrize(
    ("old", "new", "error", "message"),
    [
        ('"plate"', '"plat"', NotFoundError, "no site of .*gantry.xml is called 'plat'"),
        ("z = 0.2", "z = 0.7", HandError, r"z at 0.7000, outside its range \[0.0000, 0.5000\]"),
        ("z = 0.2", "w = 0.2", NotFoundError, "no joint of .*gantry.xml is called 'w'"),
        ("attach", "atach", HandError, "arm.attach is missing.*arm.atach is no field"),
        ("allegro_hand/", "allegro_on_arm7/", HandError, "which is on an arm; name the hand"),
        ("allegro_hand/", "alegro_hand/", HandError, "which does not exist"),
        ("gantry.xml", "none.xml", ModelError, "no model file .*none.xml"),
    ],
)
def test_a_wrong_mount_is_told(
    gantry: Path, old: str, new: str, error: type[PlannerError], message: str
) -> None:
    edit(gantry, old, new)
    with pytest.raises(error, match=message):
        load_hand(gantry)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('<position name="z" joint="z" kp="2000"/>', "", r"holds the joints \['arm/z'\]"),
        ('<body name="rail">', '<geom size="1"/><body name="rail">', "1 geoms in its world"),
        ('type="slide" axis="1 0 0" range="-0.5 0.5"', 'type="ball"', "has free or ball joints"),
        ('range="0 0.5"', "", r"joints \['arm/z'\] .* have no range"),
    ],
)
def test_a_model_that_is_no_arm_is_told(gantry: Path, old: str, new: str, message: str) -> None:
    edit(gantry.parent / "gantry.xml", old, new)
    with pytest.raises(PlannerError, match=message):
        load_hand(gantry)


def test_the_arm_stands_where_its_description_says(arm_hand: Hand) -> None:
    T_world_object = SE3(np.eye(3), np.array([0.3, 0.2, 0.54]))
    task = GraspTask.create(
        arm_hand, "box:0.04x0.04x0.08", T_world_object=T_world_object, table_height=0.5
    )
    assert task.T_world_base is not None
    np.testing.assert_allclose(task.T_world_base.translation, [-0.2, 0.2, 0.5])
    with pytest.raises(TaskError, match="is on an arm, which stands somewhere; give T_world_base"):
        dataclasses.replace(task, T_world_base=None)


def test_an_object_two_metres_away_is_refused_at_once(arm_hand: Hand) -> None:
    far = SE3(np.eye(3), np.array([-2.0, 0.0, 0.0]))
    task = GraspTask.create(arm_hand, "sphere", T_world_base=far)
    with pytest.raises(TaskError, match=r"out of the arm's reach: it is 2\.0. m .* 1\.\d\d m long"):
        plan_grasp(task)


@pytest.mark.slow
def test_an_object_just_out_of_reach_ends_in_reasons_that_say_so(arm_hand: Hand) -> None:
    far = SE3(np.eye(3), np.array([-1.05, 0.0, 0.0]))
    task = GraspTask.create(arm_hand, "sphere", T_world_base=far)
    with pytest.raises(NoGraspFoundError, match=r"3 x out of reach: .*nearest it comes .* \d+ mm"):
        plan_grasp(task, max_attempts=3)


def test_without_an_arm_inverse_kinematics_says_what_is_missing(allegro: Hand) -> None:
    with pytest.raises(HandError, match="allegro_hand is not on an arm"):
        reach(allegro, SE3.Identity(), allegro.posture("pinch"))


def test_the_offset_of_a_slide_is_a_length(gantry: Path) -> None:
    hand = load_hand(gantry)
    offset = np.zeros(hand.nq)
    offset[hand.joint_index("arm/z")] = 0.002
    drawn = dataclasses.replace(Drawn.of(ErrorModel(), hand), encoder_offset=offset)
    assert drawn_text([drawn_numbers(drawn, hand)]) == "slides up to 2.0 mm off"
