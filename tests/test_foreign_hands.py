"""Models as others write them: isolated, named, repaired, completed, and loaded as hands.

The gripper of the tests: a palm with two fingers of one hinge each, whose pads are spheres.
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import coal
import mujoco
import numpy as np
import pytest
import trimesh
from conftest import hand_of_others, needs

from planner.bridge import (
    compile_spec,
    isolate_base,
    load_spec,
    name_parts,
    spec_from_model,
)
from planner.bridge.geometry import coal_geometry
from planner.bridge.load import model_bytes, model_files
from planner.errors import HandError, ModelError, NotFoundError
from planner.hand_loading import hand_from_model, hand_from_spec, load_hand
from planner.hands.catalog import FOREIGN_HANDS
from planner.hands.hand import Hand
from planner.joints.description import HandDescription
from planner.kinematics import HandState
from planner.shapes.convex_pairs import DistancePair
from planner.spatial import SE3

GRIPPER = """
<mujoco model="gripper">
  <compiler angle="radian"/>
  <worldbody>
    <geom name="floor" type="plane" size="1 1 1"/>
    <site name="beacon"/>
    <light name="lamp"/>
    <body name="palm" pos="0 0 0.5" euler="0.3 0.2 0.1">
      <freejoint/>
      <geom name="palm" type="box" size="0.03 0.01 0.02"/>
      <body name="left" pos="-0.03 0 0">
        <joint name="left" axis="0 1 0" range="-0.5 1"/>
        <geom name="left" type="capsule" fromto="0 0 0 0 0 0.04" size="0.006"/>
        <geom name="left_pad" type="sphere" pos="0 0 0.04" size="0.008"/>
        <site name="left_tip" pos="0 0 0.04"/>
      </body>
      <body name="right" pos="0.03 0 0">
        <joint name="right" axis="0 -1 0" range="-0.5 1"/>
        <geom name="right" type="capsule" fromto="0 0 0 0 0 0.04" size="0.006"/>
        <geom name="right_pad" type="sphere" pos="0 0 0.04" size="0.008"/>
        <site name="right_tip" pos="0 0 0.04"/>
      </body>
    </body>
    <body name="cup" pos="1 0 0"><freejoint name="cup"/><geom name="cup" size="0.03"/></body>
  </worldbody>
  <contact><exclude body1="palm" body2="cup"/></contact>
  <equality><weld name="held" body1="palm" body2="cup"/></equality>
  <actuator>
    <position name="left" joint="left" kp="2" forcerange="-1 1"/>
    <position name="right" joint="right" kp="2" forcerange="-1 1"/>
  </actuator>
  <sensor>
    <framepos name="where" objtype="body" objname="palm" reftype="body" refname="cup"/>
  </sensor>
  <keyframe><key qpos="0 0 0 1 0 0 0 0 0 1 0 0 1 0 0 0"/></keyframe>
</mujoco>
"""


def finger(side: str, inwards: float) -> dict[str, Any]:
    return {
        "name": side,
        "joints": [side],
        "tip_site": f"{side}_tip",
        "pad": {
            "geom": f"{side}_pad",
            "center": [0.0, 0.0, 0.04],
            "radius": 0.008,
            "axis": [inwards, 0.0, 0.0],
            "half_angle_deg": 40.0,
        },
    }


def description(**changes: Any) -> HandDescription:
    raw: dict[str, Any] = {
        "schema": 1,
        "name": "gripper",
        "model": "gripper.xml",
        "base_body": "palm",
        "palm_body": "palm",
        "palm_normal": [0.0, 0.0, 1.0],
        "fingers": [finger("left", 1.0), finger("right", -1.0)],
    }
    return HandDescription.model_validate({**raw, **changes})


def spec_of(text: str = GRIPPER) -> Any:
    return mujoco.MjSpec.from_string(text)


def gripper(text: str = GRIPPER, **changes: Any) -> Hand:
    return hand_from_spec(spec_of(text), description(**changes))


def placements(model: Any, q: float) -> dict[str, np.ndarray[Any, Any]]:
    """Pose (3, 4) of every named body with all joints at q."""
    data = mujoco.MjData(model)
    for j in range(model.njnt):
        if int(model.jnt_type[j]) >= 2:  # slides and hinges
            data.qpos[model.jnt_qposadr[j]] = q
    mujoco.mj_kinematics(model, data)
    return {
        model.body(b).name: np.column_stack([data.xmat[b].reshape(3, 3), data.xpos[b]])
        for b in range(1, model.nbody)
    }


# --- the base alone -------------------------------------------------------------------------------


def test_only_the_subtree_of_the_base_stays_and_its_frame_is_the_root() -> None:
    hand = gripper()
    assert hand.joint_names == ("left", "right")
    assert [g.name for g in hand.geometries] == ["palm", "left", "left_pad", "right", "right_pad"]
    model = hand.mj_model
    assert (model.nsensor, model.nkey, model.neq, model.nexclude, model.nlight) == (0, 0, 0, 0, 0)
    np.testing.assert_array_equal(model.body("palm").pos, [0, 0, 0])
    np.testing.assert_array_equal(model.body("palm").quat, [1, 0, 0, 0])
    whole = spec_of().compile()
    before, after = placements(whole, 0.3), placements(model, 0.3)
    turn, origin = before["palm"][:, :3], before["palm"][:, 3]
    for name in ("left", "right"):
        np.testing.assert_allclose(
            after[name][:, 3], turn.T @ (before[name][:, 3] - origin), rtol=0, atol=1e-15
        )
        np.testing.assert_allclose(
            after[name][:, :3], turn.T @ before[name][:, :3], rtol=0, atol=1e-15
        )


ON_AN_ARM = (
    GRIPPER.replace("<freejoint/>", "")
    .replace(
        '<body name="palm"',
        '<frame euler="0 1 0" pos="0 1 0"><body name="arm" pos="0 0 1"><joint name="lift" '
        'axis="0 0 1" type="slide" range="0 1"/>'
        '<inertial pos="0 0 0" mass="9" diaginertia="1 1 1"/>'
        '<geom name="arm" size="0.1"/><site name="mark"/>'
        '<frame pos="1 2 3"><body name="palm"',
    )
    .replace(
        '    <body name="cup"',
        '</frame><body name="shelf"><geom size="0.1"/></body></body></frame>    <body name="cup"',
    )
    .replace(
        "</actuator>",
        '<motor name="lift" joint="lift"/><motor name="both" tendon="both"/></actuator>'
        '<tendon><fixed name="both"><joint joint="lift" coef="1"/><joint joint="left" coef="1"/>'
        '</fixed><fixed name="kept"><joint joint="left" coef="1"/></fixed></tendon>',
    )
    .replace(
        "<equality>",
        '<equality><joint joint1="left" joint2="lift"/><tendon tendon1="kept" tendon2="both"/>',
    )
    .replace(' qpos="0 0 0 1 0 0 0 0 0 1 0 0 1 0 0 0"', "")
)


def test_a_hand_on_an_arm_is_cut_off_with_what_refers_to_the_arm() -> None:
    hand = gripper(ON_AN_ARM)
    model = hand.mj_model
    assert hand.joint_names == ("left", "right")
    assert hand.actuation.names == ("left", "right")
    assert (model.neq, model.ntendon, model.nsite) == (0, 1, 2)
    expected, found = placements(gripper().mj_model, 0.3), placements(model, 0.3)
    assert set(found) - set(expected) == {"arm"}
    for name, pose in expected.items():
        np.testing.assert_allclose(found[name], pose, rtol=0, atol=1e-15)
    assert model.body("arm").mass == 0
    assert model.body("palm").mass == gripper().mj_model.body("palm").mass


def test_a_base_that_is_not_there() -> None:
    with pytest.raises(
        NotFoundError, match=r"no body of the model 'gripper' is called 'plam'.*'palm'"
    ):
        gripper(base_body="plam")


def test_a_base_without_joints() -> None:
    with pytest.raises(HandError, match="no joint below 'palm'; name another base_body"):
        gripper('<mujoco><worldbody><body name="palm"><geom size="1"/></body></worldbody></mujoco>')


def test_parts_without_a_name_get_one() -> None:
    spec = spec_of(
        """<mujoco><worldbody><body name="base"><geom size="1"/><geom name="base_geom1" size="1"/>
        <geom size="1"/><body><joint/><geom size="1"/><geom size="1"/></body><body name="b"/>
        <body/></body></worldbody><tendon><fixed/></tendon></mujoco>""".replace("<fixed/>", "")
    )
    name_parts(spec)
    assert [g.name for g in spec.geoms] == [
        "base_geom0",
        "base_geom1",
        "base_geom2",
        "base_body0_geom0",
        "base_body0_geom1",
    ]
    assert [b.name for b in spec.bodies] == ["world", "base", "base_body0", "b", "base_body2"]
    assert [j.name for j in spec.joints] == ["base_body0_joint0"]


def test_a_new_name_is_never_one_that_is_taken() -> None:
    spec = spec_of(
        '<mujoco><worldbody><body name="a"><geom name="a_geom1" size="1"/><geom size="1"/></body>'
        "</worldbody></mujoco>"
    )
    name_parts(spec)
    assert [g.name for g in spec.geoms] == ["a_geom1", "a_geom1_"]


# --- repairs and additions ------------------------------------------------------------------------


def test_a_file_in_radians_that_does_not_say_so() -> None:
    silent = GRIPPER.replace('<compiler angle="radian"/>', "")
    np.testing.assert_allclose(gripper(silent).q_upper, np.deg2rad(1), rtol=1e-12)
    np.testing.assert_array_equal(gripper(silent, repair={"angle": "radian"}).q_upper, [1, 1])


def test_inertia_that_breaks_the_triangle_inequality() -> None:
    bad = GRIPPER.replace(
        '<joint name="left"',
        '<inertial pos="0 0 0" mass="0.1" diaginertia="1e-4 1e-4 9e-4"/><joint name="left"',
    )
    with pytest.raises(ModelError, match=r"A \+ B >= C.*balance_inertia = true under \[repair\]"):
        gripper(bad)
    model = gripper(bad, repair={"balance_inertia": True}).mj_model
    np.testing.assert_allclose(model.body("left").inertia, 11e-4 / 3, rtol=1e-12)


def test_a_geom_that_only_looks() -> None:
    hand = gripper(repair={"drop_collision": ["left", "palm"]})
    assert [g.name for g in hand.geometries] == ["left_pad", "right", "right_pad"]
    assert hand.mj_model.ngeom == 5  # still to be seen
    with pytest.raises(NotFoundError, match="no geom of the model 'gripper' is called 'lfet'"):
        gripper(repair={"drop_collision": ["lfet"]})


def test_bodies_that_overlap_by_construction_may_be_excluded() -> None:
    pair = frozenset({"left_pad", "right_pad"})
    assert pair not in gripper().allowed_pairs
    hand = gripper(repair={"exclude": [["left", "right"]]})
    assert pair in hand.allowed_pairs
    assert hand.mj_model.nexclude == 1


def test_joint_defaults_replace_what_the_model_says() -> None:
    text = GRIPPER.replace('name="left" axis', 'name="left" damping="3 1" frictionloss="5" axis')
    before = gripper(text).mj_model
    assert (before.dof_damping[0], before.dof_frictionloss[0]) == (3, 5)
    model = gripper(text, joint_defaults={"damping": 0.05, "armature": 2e-4}).mj_model
    np.testing.assert_array_equal(model.dof_damping, [0.05, 0.05])
    np.testing.assert_array_equal(model.dof_dampingpoly, np.zeros((2, 2)))
    np.testing.assert_array_equal(model.dof_armature, [2e-4, 2e-4])
    np.testing.assert_array_equal(model.dof_frictionloss, [5, 0])


def without_actuators() -> str:
    start, end = GRIPPER.index("<actuator>"), GRIPPER.index("</actuator>")
    return GRIPPER[:start] + GRIPPER[end + len("</actuator>") :]


def test_joints_that_nothing_holds_are_named() -> None:
    with pytest.raises(HandError, match=r"no actuator and no coupling holds the joints \['left', "):
        gripper(without_actuators())
    one = {"actuators": [{"joints": ["left"], "kp": 2.0, "force_limit": 0.5}]}
    with pytest.raises(HandError, match=r"holds the joints \['right'\]; add an \[\[actuators\]\]"):
        gripper(without_actuators(), **one)


def test_servos_that_the_description_adds() -> None:
    servo = {"joints": ["right", "left"], "kp": 2.0, "damping": 0.1, "force_limit": 0.5}
    hand = gripper(without_actuators(), actuators=[servo])
    ours = hand.actuation
    assert ours.names == ("right", "left")
    np.testing.assert_array_equal(ours.moment, [[0, 1], [1, 0]])
    np.testing.assert_array_equal(ours.gain, [2, 2])
    np.testing.assert_array_equal(ours.bias, [[0, -2, -0.1]] * 2)
    np.testing.assert_array_equal(ours.force_range, [[-0.5, 0.5]] * 2)
    # commanded 0.5 N m / (2 N m/rad) beyond the stops, so that the full force is there at them
    np.testing.assert_array_equal(ours.ctrl_range, [[-0.75, 1.25]] * 2)


def test_servos_in_a_file_in_degrees_have_ranges_in_radians() -> None:
    degrees = without_actuators().replace('angle="radian"', 'angle="degree"')
    degrees = degrees.replace('range="-0.5 1"', 'range="-30 60"')
    servo = {"joints": ["right", "left"], "kp": 2.0, "force_limit": 0.5}
    hand = gripper(degrees, actuators=[servo])
    beyond = np.array([-0.25, 0.25])  # force limit over kp, rad
    wanted = np.deg2rad([[-30, 60]] * 2) + beyond
    np.testing.assert_allclose(hand.actuation.ctrl_range, wanted, rtol=1e-12)


def test_a_servo_on_a_tendon_and_a_described_equality_hold_two_joints() -> None:
    text = without_actuators().replace(
        "</worldbody>",
        '</worldbody><tendon><fixed name="t"><joint joint="left" coef="2"/>'
        '<joint joint="right" coef="-1"/></fixed></tendon>',
    )
    text = text.replace('name="right" axis', 'name="right" ref="0.2" axis')
    hand = gripper(
        text,
        actuators=[{"tendon": "t", "kp": 1.0, "force_limit": 1.0}],
        couplings=[
            {"name": "c", "joints": {"left": 1.0, "right": -1.0}, "value": 0.1, "kind": "equality"}
        ],
    )
    assert hand.actuation.names == ("t",)
    np.testing.assert_array_equal(hand.actuation.moment, [[2, -1]])
    np.testing.assert_allclose(hand.actuation.ctrl_range, [[-3, 3.5]], rtol=0, atol=1e-15)
    (c,) = hand.couplings
    assert not c.one_sided
    np.testing.assert_allclose(c.row, [1, -1], rtol=0, atol=1e-15)
    assert c.value == pytest.approx(0.1, abs=1e-15)
    # and MuJoCo holds it: the scene is built from the same spec
    model = hand.new_spec().compile()
    data = mujoco.MjData(model)
    model.dof_damping[:] = 0.1
    for _ in range(2000):
        data.ctrl[0] = 0.5
        mujoco.mj_step(model, data)
    assert data.qpos[0] - data.qpos[1] == pytest.approx(0.1, abs=2e-3)


def test_a_wrong_coupling_can_be_dropped() -> None:
    wrong = GRIPPER.replace(
        "<equality>",
        '<tendon><fixed name="x"><joint joint="left" coef="1"/><joint joint="right" coef="1"/>'
        '</fixed></tendon><equality><tendon name="x" tendon1="x" polycoef="3 1 0 0 0"/>',
    )
    with pytest.raises(HandError, match=r"coupling 'x' asks for 3\.0.*drop_couplings = \['x'\]"):
        gripper(wrong)
    hand = gripper(wrong, repair={"drop_couplings": ["x"]})
    assert hand.couplings == ()
    assert hand.mj_model.ntendon == 0
    with pytest.raises(NotFoundError, match=r"no tendon or equality of .* is called 'y'"):
        gripper(wrong, repair={"drop_couplings": ["y"]})


def test_a_coupling_that_is_told_twice_counts_once() -> None:
    twice = GRIPPER.replace(
        "<equality>",
        '<equality><joint name="x" joint1="left" joint2="right" polycoef="0 1 0 0 0"/>'
        '<joint name="again" joint1="right" joint2="left" polycoef="0 1 0 0 0"/>',
    )
    stop = {"name": "y", "joints": {"left": 1.0, "right": -1.0}, "value": 0.0, "kind": "stop"}
    hand = gripper(twice, couplings=[stop])
    assert [c.name for c in hand.couplings] == ["x"]
    matrix, _ = hand.coupling_matrix
    assert np.linalg.matrix_rank(matrix) == len(matrix) == 1


def test_a_tip_where_the_model_has_no_site() -> None:
    left = finger("left", 1.0)
    del left["tip_site"]
    left["tip"] = {"body": "left", "position": [0.0, 0.001, 0.048]}
    text = GRIPPER.replace('<site name="left_tip" pos="0 0 0.04"/>', "")
    hand = gripper(text, fingers=[left, finger("right", -1.0)])
    tip = hand.pin_model.frames[hand.fingers["left"].tip_frame_id]
    assert tip.name == hand.fingers["left"].tip_frame == "left_tip"
    np.testing.assert_array_equal(tip.placement.translation, [0, 0.001, 0.048])
    with pytest.raises(HandError, match="has a site 'left_tip' already; name it as tip_site"):
        gripper(fingers=[left, finger("right", -1.0)])


def test_a_finger_has_one_tip() -> None:
    both = {**finger("left", 1.0), "tip": {"body": "left", "position": [0, 0, 0]}}
    neither = {**finger("left", 1.0), "tip_site": ""}
    for wrong in (both, neither):
        with pytest.raises(ValueError, match="give either tip_site or a"):
            description(fingers=[wrong])
    with pytest.raises(ValueError, match="give either joints = "):
        description(actuators=[{"kp": 1.0, "force_limit": 1.0}])


def test_bodies_of_fingers_are_told_by_name() -> None:
    assert gripper().finger_of_body == {"left": "left", "right": "right"}


# --- URDF -----------------------------------------------------------------------------------------

LINK = (
    '<link name="{0}"><inertial><mass value="0.05"/><inertia ixx="1e-5" iyy="1e-5" izz="1e-5" '
    'ixy="0" ixz="0" iyz="0"/></inertial><collision><geometry>{1}</geometry></collision></link>'
)
HINGE = (
    '<joint name="{0}" type="revolute"><parent link="{1}"/><child link="{2}"/><origin xyz="{3}"/>'
    '<axis xyz="0 1 0"/><limit lower="-0.5" upper="1" effort="{4}" velocity="1"/>{5}</joint>'
)
BALL = '<sphere radius="0.008"/>'
URDF = (
    '<robot name="claw">'
    + LINK.format("palm", '<box size="0.06 0.02 0.04"/>')
    + LINK.format("left", BALL)
    + LINK.format("right", BALL)
    + HINGE.format("left", "palm", "left", "-0.03 0 0.04", 2, "")
    + HINGE.format(
        "right", "palm", "right", "0.03 0 0.04", 0, '<mimic joint="left" multiplier="-0.5"/>'
    )
    + "</robot>"
)


def claw_fingers() -> list[dict[str, Any]]:
    out = []
    for side, inwards in (("left", 1.0), ("right", -1.0)):
        raw = finger(side, inwards)
        del raw["tip_site"]
        raw["tip"] = {"body": side, "position": [0.0, 0.0, 0.0]}
        raw["pad"] = {**raw["pad"], "geom": f"{side}_geom0", "center": [0.0, 0.0, 0.0]}
        out.append(raw)
    return out


@pytest.fixture
def write_hand(tmp_path: Path) -> Callable[[str, str], Path]:
    """A model and the description of the claw beside it; gives the hand.toml."""

    def write(model: str, name: str) -> Path:
        (tmp_path / name).write_text(model, encoding="utf-8")
        text = (
            f'schema = 1\nname = "claw"\nmodel = "{name}"\nbase_body = "palm"\npalm_body = "palm"\n'
            "palm_normal = [0, 0, 1]\n"
            '[[actuators]]\njoints = ["left"]\nkp = 3.0\nforce_limit = 0.7\n'
        )
        for raw in claw_fingers():
            text += (
                f'[[fingers]]\nname = "{raw["name"]}"\njoints = {raw["joints"]}\n'
                f'[fingers.tip]\nbody = "{raw["tip"]["body"]}"\nposition = [0, 0, 0]\n'
                f'[fingers.pad]\ngeom = "{raw["pad"]["geom"]}"\ncenter = [0, 0, 0]\n'
                f"radius = 0.008\naxis = {raw['pad']['axis']}\nhalf_angle_deg = 40\n"
            )
        (tmp_path / "hand.toml").write_text(text, encoding="utf-8")
        return tmp_path / "hand.toml"

    return write


def test_a_urdf_with_mimic(write_hand: Callable[[str, str], Path]) -> None:
    hand = load_hand(write_hand(URDF, "claw.urdf"))
    assert hand.joint_names == ("left", "right")
    (mimic,) = hand.couplings
    np.testing.assert_allclose(mimic.row, [0.5, 1], rtol=0, atol=1e-15)
    np.testing.assert_array_equal(hand.actuation.force_range, [[-0.7, 0.7]])  # effort is 2
    assert "palm_geom0" in {g.name for g in hand.geometries}
    # one motor holds any torque, and the fingers part alike
    force, _ = hand.actuation.split_torque(np.array([0.2, -0.1]), np.array([0.3, 0.2]))
    assert force[0] == pytest.approx(0.3 - 0.5 * 0.2, abs=1e-12)


def test_a_mirrored_hand_mirrors_what_its_description_adds(
    write_hand: Callable[[str, str], Path], tmp_path: Path
) -> None:
    file = write_hand(URDF, "claw.urdf")
    text = file.read_text(encoding="utf-8").replace("position = [0, 0, 0]", "position = [1, 2, 3]")
    file.write_text(text, encoding="utf-8")
    for sub, axis in (("x", 0), ("y", 1), ("z", 2)):
        (tmp_path / sub).mkdir()
        mirrored = tmp_path / sub / "hand.toml"
        mirrored.write_text(
            f'schema = 1\nname = "m"\nmirror_of = "../hand.toml"\nmirror_axis = "{sub}"\n'
        )
        one, other = load_hand(file), load_hand(mirrored)
        signs = np.ones(3)
        signs[axis] = -1
        for q in (np.array([0.4, -0.2]), np.array([-0.4, 0.2])):
            tips = [
                HandState(hand, q).tip_pose(hand.fingers["left"]).translation
                for hand in (one, other)
            ]
            np.testing.assert_allclose(tips[1], signs * tips[0], rtol=0, atol=1e-12)
        assert [c.name for c in one.couplings] == [c.name for c in other.couplings]
        assert other.description.model == "../claw.urdf"


def test_effort_of_a_urdf_limits_the_servo(write_hand: Callable[[str, str], Path]) -> None:
    hand = load_hand(write_hand(URDF.replace('effort="2"', 'effort="0.4"'), "claw.urdf"))
    np.testing.assert_array_equal(hand.actuation.force_range, [[-0.4, 0.4]])


def test_a_mimic_is_stiff(write_hand: Callable[[str, str], Path]) -> None:
    model = load_hand(write_hand(URDF, "claw.urdf")).new_spec().compile()
    model.opt.gravity[:] = 0
    model.dof_damping[:] = 0.02
    data = mujoco.MjData(model)
    data.qfrc_applied[1] = 0.1
    for _ in range(2000):
        mujoco.mj_step(model, data)
    assert abs(data.qpos[1] + 0.5 * data.qpos[0]) < 5e-3  # 0.3 with MuJoCo's defaults


def test_a_urdf_whose_joint_has_no_range(write_hand: Callable[[str, str], Path]) -> None:
    endless = URDF.replace('name="left" type="revolute"', 'name="left" type="continuous"')
    with pytest.raises(
        HandError, match=r"joints \['left'\] of claw\.urdf have no range; give them"
    ):
        load_hand(write_hand(endless, "claw.urdf"))


@pytest.mark.parametrize("above", [True, False])
def test_package_paths_of_a_urdf(tmp_path: Path, above: bool) -> None:
    # .../claw_description/urdf/claw.urdf, or a sibling folder of the URDF's
    folder = tmp_path / "claw_description"
    urdf = (folder if above else tmp_path / "elsewhere") / "urdf" / "claw.urdf"
    urdf.parent.mkdir(parents=True)
    mesh = folder / "meshes" / "palm.stl"
    mesh.parent.mkdir(parents=True)
    trimesh.creation.box((0.06, 0.02, 0.04)).export(mesh)
    text = URDF.replace(
        '<box size="0.06 0.02 0.04"/>',
        '<mesh filename="package://claw_description/meshes/palm.stl"/>',
    )
    urdf.write_text(text, encoding="utf-8")
    model = compile_spec(load_spec(urdf), "the claw")
    assert model.nmesh == 1
    assert mesh in model_files(urdf)
    mesh.unlink()
    with pytest.raises(ModelError, match=r"names package://claw_description/meshes/palm\.stl, and"):
        load_spec(urdf)


# --- files that are not whole ---------------------------------------------------------------------


def test_a_fragment_says_what_includes_it(tmp_path: Path) -> None:
    (tmp_path / "part.xml").write_text("<mujoco><asset/></mujoco>")
    with pytest.raises(
        ModelError, match=r"part\.xml holds no body; give a model with a <worldbody>"
    ):
        load_spec(tmp_path / "part.xml")
    (tmp_path / "scene.xml").write_text('<mujoco><include file="part.xml"/></mujoco>')
    with pytest.raises(ModelError, match=r"is meant to be included: load a file that does, scene"):
        load_spec(tmp_path / "part.xml")


def test_an_include_that_is_missing(tmp_path: Path) -> None:
    (tmp_path / "scene.xml").write_text('<mujoco><include file="gone.xml"/></mujoco>')
    with pytest.raises(
        ModelError, match=r"MuJoCo cannot read .*scene\.xml as a model: .*gone\.xml"
    ):
        load_spec(tmp_path / "scene.xml")


def test_a_mesh_that_is_missing(tmp_path: Path) -> None:
    text = '<mujoco><asset><mesh name="m" file="gone.stl"/></asset>' + GRIPPER[len("\n<mujoco") :]
    text = text.replace(' model="gripper">', "", 1)
    path = tmp_path / "hand.xml"
    path.write_text(
        text.replace(
            '<geom name="palm" type="box" size="0.03 0.01 0.02"/>',
            '<geom name="palm" type="mesh" mesh="m"/>',
        )
    )
    with pytest.raises(
        ModelError, match=r"cannot compile .*gone\.stl.*; put the missing file there"
    ):
        compile_spec(load_spec(path), str(path))


def test_a_name_that_is_repeated_is_told(tmp_path: Path) -> None:
    path = tmp_path / "hand.xml"
    path.write_text(GRIPPER.replace('<geom name="left_pad"', '<geom name="left"'))
    with pytest.raises(ModelError, match="repeated name 'left'"):
        compile_spec(load_spec(path), str(path))


def test_names_with_spaces_are_names() -> None:
    text = GRIPPER.replace('"palm"', '"the palm"').replace('"left_pad"', '"left pad"')
    left = finger("left", 1.0)
    left["pad"]["geom"] = "left pad"
    hand = gripper(
        text,
        base_body="the palm",
        palm_body="the palm",
        fingers=[left, finger("right", -1.0)],
    )
    assert hand.fingers["left"].pad.geom == "left pad"


# --- identity -------------------------------------------------------------------------------------


def test_the_digest_follows_includes_and_meshes(write_hand: Callable[[str, str], Path]) -> None:
    file = write_hand('<mujoco><include file="body.xml"/></mujoco>', "claw.xml")
    body = file.parent / "body.xml"
    spec = mujoco.MjSpec.from_string(URDF)
    spec.compiler.fusestatic = False
    spec.compile()
    text = spec.to_xml().replace(
        "<worldbody>", '<asset><mesh name="m" file="m.stl"/></asset><worldbody>', 1
    )
    text = text.replace(
        '<body name="palm">',
        '<body name="palm"><geom type="mesh" mesh="m" contype="0" conaffinity="0"/>',
    )
    body.write_text(text, encoding="utf-8")
    mesh = trimesh.creation.box((0.01, 0.01, 0.01))
    mesh.export(file.parent / "m.stl")
    first = load_hand(file)
    assert set(model_files(file.parent / "claw.xml")) == {
        file.parent / "claw.xml",
        body,
        file.parent / "m.stl",
    }
    assert load_hand(file).digest == first.digest
    mesh.apply_scale(1.001)
    mesh.export(file.parent / "m.stl")
    second = load_hand(file)
    body.write_text(text.replace('mass="0.05"', 'mass="0.06"'), encoding="utf-8")
    assert len({first.digest, second.digest, load_hand(file).digest}) == 3


def test_a_hand_made_in_python_has_a_digest_and_no_reference() -> None:
    hand, again, other = gripper(), gripper(), gripper(GRIPPER.replace('kp="2"', 'kp="3"'))
    assert hand.reference is None
    assert hand.path is None
    assert hand.digest == again.digest != other.digest
    assert hand.digest != gripper(summary="another").digest


def test_the_digest_is_the_same_in_another_process() -> None:
    code = (
        "import sys, mujoco; from planner.hand_loading import hand_from_spec;"
        "from planner.joints.description import HandDescription;"
        "spec = mujoco.MjSpec.from_string(sys.argv[1]);"
        "print(hand_from_spec(spec, HandDescription.from_json(sys.argv[2])).digest)"
    )
    command = [sys.executable, "-c", code, GRIPPER, description().to_json()]
    run = subprocess.run(command, capture_output=True, text=True, check=True)
    assert run.stdout.strip() == gripper().digest


def test_the_spec_that_is_given_stays_as_it_is() -> None:
    spec = spec_of()
    hand_from_spec(spec, description())
    assert spec.body("cup") is not None
    assert spec.compile().nbody == 5


# --- compiled models ------------------------------------------------------------------------------

RICH = GRIPPER.replace(
    "</worldbody>",
    """</worldbody>
  <tendon><fixed name="t" limited="true" range="-1 2" stiffness="0.3" springlength="0.1"
    damping="0.2" frictionloss="0.01"><joint joint="left" coef="1"/><joint joint="right" coef="-2"/>
  </fixed></tendon>""",
).replace(
    '<weld name="held" body1="palm" body2="cup"/>',
    '<joint name="tie" joint1="left" joint2="right" polycoef="0.1 0.5 0 0 0" solref="0.01 1"/>',
).replace(
    'name="left" axis="0 1 0"',
    'name="left" axis="0 1 0" ref="0.2" stiffness="0.4" springref="0.1" damping="0.03" '
    'armature="0.001" frictionloss="0.02" actuatorfrcrange="-3 4"',
).replace(
    '</actuator>',
    '<general name="f" tendon="t" dyntype="filter" dynprm="0.02" gainprm="2" biastype="affine" '
    'biasprm="0.1 -2 -0.3" ctrlrange="-1 1" gear="0.7"/></actuator>',
)  # fmt: skip


def test_a_compiled_model_comes_back_as_a_spec() -> None:
    spec = spec_of(RICH)
    isolate_base(spec, "palm", "the gripper")
    model = spec.compile()
    again = spec_from_model(model).compile()
    for name in dir(model):
        part = name.partition("_")[0]
        if part not in {"body", "jnt", "dof", "geom", "site", "tendon", "actuator", "eq", "qpos"}:
            continue
        before, after = getattr(model, name), getattr(again, name)
        if isinstance(before, np.ndarray):
            np.testing.assert_allclose(after, before, rtol=0, atol=1e-12, err_msg=name)


def test_a_hand_from_a_compiled_model_is_the_hand_from_its_spec() -> None:
    text = RICH.replace(' actuatorfrcrange="-3 4"', "")
    changes = {"repair": {"drop_couplings": ["tie"]}}
    one = gripper(text, **changes)
    other = hand_from_model(spec_of(text).compile(), description(**changes))
    q = np.array([0.3, 0.2])
    np.testing.assert_array_equal(one.actuation.moment, other.actuation.moment)
    np.testing.assert_allclose(
        one.actuation.passive_torque(q), other.actuation.passive_torque(q), rtol=0, atol=1e-15
    )
    np.testing.assert_array_equal(one.actuation.stop_rows, other.actuation.stop_rows)
    assert [g.name for g in one.geometries] == [g.name for g in other.geometries]


def test_meshes_of_a_compiled_model_stay_where_they_are() -> None:
    box = trimesh.creation.box((0.02, 0.03, 0.05))
    box.apply_translation((0.01, 0.02, 0.03))
    spec = mujoco.MjSpec()
    spec.add_mesh(name="m", uservert=box.vertices.ravel(), userface=box.faces.ravel())
    body = spec.worldbody.add_body(name="a")
    body.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname="m", pos=(0.1, 0, 0), euler=(0.1, 0, 0))
    clouds = []
    for model in (spec.compile(), spec_from_model(spec.compile()).compile()):
        data = mujoco.MjData(model)
        mujoco.mj_kinematics(model, data)
        points = data.geom_xpos[0] + model.mesh_vert @ data.geom_xmat[0].reshape(3, 3).T
        clouds.append(points)
    np.testing.assert_allclose(clouds[1], clouds[0], rtol=0, atol=1e-8)  # vertices are float32


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        (GRIPPER, "equality 'held' ties bodies"),
        (
            GRIPPER.replace('<weld name="held" body1="palm" body2="cup"/>', "").replace(
                "</actuator>", '<adhesion name="u" body="left" ctrlrange="0 1"/></actuator>'
            ),
            "actuator 'u' drives neither a joint nor a tendon",
        ),
        (
            GRIPPER.replace("</worldbody>", '</worldbody><tendon><spatial name="rope"><site '
            'site="left_tip"/><site site="right_tip"/></spatial></tendon>'),
            "tendon 'rope' runs through space",
        ),
    ],
)  # fmt: skip
def test_what_a_compiled_model_does_not_give_back(text: str, reason: str) -> None:
    with pytest.raises(ModelError, match=f"{reason}.*give the MjSpec or the file instead"):
        spec_from_model(spec_of(text).compile())


# --- pads on hulls and boxes ----------------------------------------------------------------------


def tetrahedron(center: tuple[float, float, float], size: float) -> Any:
    """A regular tetrahedron whose inscribed sphere has radius ``size`` / 3 about ``center``."""
    corners = size * np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]]) / np.sqrt(3)
    return trimesh.Trimesh(corners + center, [[0, 1, 2], [0, 2, 3], [0, 3, 1], [1, 3, 2]])


PAD_SHAPES: dict[str, tuple[str, float]] = {
    # geom, and the depth of the point (0, 0, 0.04) below its surface by hand
    "box": ('type="box" size="0.02 0.006 0.01" pos="0.003 0.001 0.037"', 0.005),
    "cylinder": ('type="cylinder" size="0.009 0.02" pos="0.002 0 0.04"', 0.007),
    "ellipsoid": ('type="ellipsoid" size="0.006 0.012 0.02" pos="0 0 0.04"', 0.006),
    "capsule": ('type="capsule" fromto="0 0 0 0 0 0.04" size="0.008"', 0.008),
    "mesh": ('type="mesh" mesh="m"', 0.007),
}


@pytest.mark.parametrize("shape", PAD_SHAPES)
def test_the_depth_of_a_pad_is_that_of_the_true_solid(shape: str) -> None:
    geom, depth = PAD_SHAPES[shape]
    text = GRIPPER.replace('type="sphere" pos="0 0 0.04" size="0.008"/>\n        <site name="left',
                           f'{geom}/>\n        <site name="left')  # fmt: skip
    assert text != GRIPPER
    spec = spec_of(text.replace('mesh="m"', "")) if shape != "mesh" else None
    if spec is None:
        solid = tetrahedron((0.0, 0.0, 0.04), 3 * depth)
        spec = spec_of(GRIPPER)
        spec.add_mesh(name="m", uservert=solid.vertices.ravel(), userface=solid.faces.ravel())
        pad = spec.geom("left_pad")
        pad.type, pad.meshname, pad.pos = mujoco.mjtGeom.mjGEOM_MESH, "m", (0, 0, 0)
    for error, fits in ((0.0, True), (4e-4, True), (-4e-4, True), (6e-4, False), (-6e-4, False)):
        left = finger("left", 1.0)
        left["pad"]["radius"] = depth + error
        chosen = description(fingers=[left, finger("right", -1.0)])
        if fits:
            hand_from_spec(spec, chosen)
            continue
        with pytest.raises(
            HandError, match=rf"its center lies {1e3 * depth:.2f} mm below the surf"
        ):
            hand_from_spec(spec, chosen)


def test_a_hull_is_that_of_its_corners() -> None:
    # a box mesh with square sides, which a hull cuts into triangles, and points inside
    box = trimesh.creation.box((0.02, 0.03, 0.05)).subdivide()
    spec = mujoco.MjSpec()
    spec.add_mesh(name="m", uservert=box.vertices.ravel(), userface=box.faces.ravel())
    body = spec.worldbody.add_body(name="a")
    body.add_geom(name="m", type=mujoco.mjtGeom.mjGEOM_MESH, meshname="m")
    hull = coal_geometry(spec.compile(), 0)
    assert (hull.num_points, hull.num_polygons) == (8, 12)
    assert hull.computeVolume() == pytest.approx(0.02 * 0.03 * 0.05, rel=1e-6)


def test_a_hull_without_volume_is_refused_before_coal_crashes() -> None:
    spec = mujoco.MjSpec()
    box = trimesh.creation.box((0.02, 0.03, 0.05))
    spec.add_mesh(name="m", uservert=box.vertices.ravel(), userface=box.faces.ravel())
    body = spec.worldbody.add_body(name="a")
    body.add_geom(name="m", type=mujoco.mjtGeom.mjGEOM_MESH, meshname="m")
    model = spec.compile()
    model.mesh_vert[:, 2] = 0
    with pytest.raises(
        ModelError, match=r"the mesh of geom 'm' is flat, .* drop_collision = \['m'\]"
    ):
        coal_geometry(model, 0)


def test_a_flat_mesh_is_named() -> None:
    spec = spec_of()
    corners = np.array([[0, 0, 0], [0.01, 0, 0], [0.01, 0.01, 0], [0, 0.01, 0]])
    spec.add_mesh(
        name="m",
        uservert=corners.ravel(),
        userface=[0, 1, 2, 0, 2, 3],
        inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL,
    )
    nail = spec.body("left").add_geom(name="nail", type=mujoco.mjtGeom.mjGEOM_MESH, meshname="m")
    nail.mass = 0.001
    with pytest.raises(ModelError, match=r"mesh 'm' has coplanar.* its geom in drop_collision"):
        hand_from_spec(spec, description())
    hand_from_spec(spec, description(repair={"drop_collision": ["nail"]}))


def test_coal_knows_how_deep_a_point_lies_in_a_hull() -> None:
    # second witness: the nearest face plane, which is exact inside a convex polyhedron
    rng = np.random.default_rng(5)
    for _ in range(20):
        cloud = rng.normal(size=(40, 3)) * (0.006, 0.008, 0.02)
        solid = trimesh.convex.convex_hull(cloud)
        points = coal.StdVec_Vec3s()
        points.extend(list(np.array(solid.vertices)))
        pair = DistancePair(coal.Convex.convexHull(points, True, "Qt"), coal.Sphere(1e-6))
        for point in rng.uniform(-0.5, 0.5, size=(5, 3)) * (0.006, 0.008, 0.02):
            planes = np.einsum(
                "ij,ij->i", solid.face_normals, solid.triangles[:, 0] - point
            )  # distance to each face
            depth = -pair.distance(SE3.Identity(), SE3(np.eye(3), point)) - 1e-6
            assert depth == pytest.approx(planes.min(), abs=1e-7)


def test_a_pad_outside_its_geom_is_refused() -> None:
    left = finger("left", 1.0)
    left["pad"]["center"] = [0.0, 0.0, 0.06]
    with pytest.raises(HandError, match=r"its center lies -12\.00 mm below the surface"):
        gripper(fingers=[left, finger("right", -1.0)])


# --- hands of others, where they are installed ----------------------------------------------------


BASES = {
    "gymnasium-robotics:adroit": ("forearm", 24, 24),
    "gymnasium-robotics:shadow": ("robot0:hand mount", 24, 20),
    "example-robot-data:allegro_left": ("palm_link", 16, 0),
    "example-robot-data:allegro_right": ("palm_link", 16, 0),
    "robosuite:fourier_left": ("left_hand", 11, 11),
    "robosuite:fourier_right": ("right_hand", 11, 11),
    "robosuite:inspire_left": ("left_hand", 12, 12),
    "robosuite:inspire_right": ("right_hand", 12, 12),
    "robosuite:jaco_three_finger": ("right_gripper", 6, 3),
    "robosuite:robotiq_3f": ("palm", 11, 4),
}


def test_every_known_hand_is_tried_below() -> None:
    assert set(BASES) == set(FOREIGN_HANDS)


@pytest.mark.parametrize("name", BASES)
def test_a_known_hand_is_isolated_from_its_scene(name: str) -> None:
    base, joints, actuators = BASES[name]
    spec = load_spec(hand_of_others(name))
    spec.compiler.balanceinertia = True
    whole = spec.copy().compile()
    isolate_base(spec, base, name)
    name_parts(spec)
    model = compile_spec(spec, name)
    assert (model.njnt, model.nu) == (joints, actuators)
    assert all(model.geom(g).name for g in range(model.ngeom))
    before, after = placements(whole, 0.1), placements(model, 0.1)
    turn, origin = before[base][:, :3], before[base][:, 3]
    for body, pose in after.items():
        if body in before:
            place = turn.T @ (before[body][:, 3] - origin)
            np.testing.assert_allclose(pose[:, 3], place, rtol=0, atol=1e-12)
    assert model_bytes(spec.copy().compile()) == model_bytes(model)


def test_the_fragment_of_the_shadow_hand_says_what_to_load() -> None:
    fragment = hand_of_others("gymnasium-robotics:shadow").with_name("robot.xml")
    with pytest.raises(
        ModelError, match=r"meant to be included: load a file that does, manipulate"
    ):
        load_spec(fragment)


def test_the_allegro_needs_its_inertia_balanced_as_measured() -> None:
    path = hand_of_others("example-robot-data:allegro_right")
    with pytest.raises(ModelError, match="balance_inertia = true"):
        compile_spec(load_spec(path), "the Allegro")


@needs("gymnasium_robotics")
def test_nothing_of_other_packages_is_imported_to_find_a_hand() -> None:
    code = (
        "import sys; from planner.hands.catalog import find_hand;"
        "find_hand('gymnasium-robotics:shadow');"
        "print('gymnasium_robotics' in sys.modules)"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.strip() == "False"
