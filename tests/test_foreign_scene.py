"""Scenes of others: a hand carried by what a planner does not know, a tool of two densities."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from planner import plan_grasp
from planner.describe import propose, write_proposal
from planner.errors import NotFoundError, TaskError
from planner.quality import force_closure
from planner.spatial import SE3, FloatArray, pose_to_wxyz, shifted
from planner.system.package import models_dir
from sim.contacts import ContactHistory, hand_contacts
from sim.foreign import ForeignRun, ForeignScene

TOOL = """
<mujoco><option timestep="0.002" integrator="implicitfast" noslip_iterations="5"/>
<worldbody>
  <geom name="bench" type="box" size="0.5 0.5 0.05" pos="0 0 0.35"/>
  <geom name="ball" size="0.02" pos="1 0 0"/>
  <geom name="wall" type="box" size="0.02 0.2 0.1" pos="0.3 0 0.5" euler="0 0 30"/>
  <body name="tool" pos="0.05 0.02 0.45" euler="0 0 40">
    <freejoint/>
    <geom name="grip" type="box" size="0.07 0.02 0.05" mass="0.08" friction="{friction}"/>
    <geom name="head" type="box" size="0.02 0.03 0.05" pos="0.09 0 0" mass="0.1"/>
  </body>
  <body name="fixed"><geom size="0.01" pos="1 1 1"/></body>
  <body name="carriage" pos="0 0 0.75">
    <joint name="x" type="slide" axis="1 0 0" range="-0.3 0.3" limited="true"/>
    <joint name="y" type="slide" axis="0 1 0"/>
    <joint name="z" type="slide" axis="0 0 1"/>
    <joint name="a" axis="1 0 0"/>
    <joint name="b" axis="0 1 0"/>
    <joint name="c" axis="0 0 1"/>
    <geom size="0.02" mass="2" contype="0" conaffinity="0"/>
  </body>
</worldbody>
<actuator>
  <position joint="x" kp="4000" kv="300"/><position joint="y" kp="4000" kv="300"/>
  <position joint="z" kp="4000" kv="300"/><position joint="a" kp="200" kv="12"/>
  <position joint="b" kp="200" kv="12"/><position joint="c" kp="200" kv="12"/>
</actuator>
</mujoco>"""
"""Somebody's scene: a table that is no table of ours, a tool whose head is heavy."""

MODEL = "hands/allegro_hand/allegro_hand.xml"

PALM_DOWN = SE3(Rotation.from_euler("y", 90, degrees=True).as_matrix(), np.array([0, 0, -0.05]))
"""Pose of the hand on its carriage."""

SUBSTEPS = 10
"""Steps of 2 ms that its owner makes at once."""


class Owner:
    """Who owns a scene: compiles, resets and steps it; carries the hand by six servos."""

    def __init__(
        self,
        friction: float = 1.0,
        moved: float = 0.0,
        change: Callable[[Any, Any], object] = lambda spec, hand: None,
    ) -> None:
        """Compile it.

        Args:
            friction: Of the tool's grip (-).
            moved: How far a link is from where the hand's own model has it, m.
            change: Changes the scene and the hand before they are put together.
        """
        spec = mujoco.MjSpec.from_string(TOOL.format(friction=friction))
        hand = mujoco.MjSpec.from_file(str(models_dir() / MODEL))
        hand.body("index_proximal").pos[2] += moved
        change(spec, hand)
        place, turn = pose_to_wxyz(PALM_DOWN)
        frame = spec.body("carriage").add_frame(pos=place, quat=turn)
        spec.attach(hand, frame=frame, prefix="robot/")
        for body in spec.body("carriage").find_all("body"):
            body.gravcomp = 1.0
        spec.body("carriage").gravcomp = 1.0
        self.spec, self.model = spec, spec.compile()
        self.data: Any = mujoco.MjData(self.model)
        mujoco.mj_forward(self.model, self.data)

    def step(self, T_world_base: SE3, ctrl: FloatArray) -> None:
        carriage = T_world_base * PALM_DOWN.inverse()
        turn = Rotation.from_matrix(carriage.rotation).as_euler("XYZ")
        place = carriage.translation - [0.0, 0.0, 0.75]
        self.data.ctrl[:6] = [*place, *turn]
        self.data.ctrl[6:] = ctrl
        mujoco.mj_step(self.model, self.data, SUBSTEPS)

    def scene(self, **changes: Any) -> ForeignScene:
        given = {"table": "bench", "obstacles": ("wall",), "touch": ("grip",)} | changes
        return ForeignScene(*self.parts, "allegro_hand", "tool", prefix="robot/", **given)

    @property
    def parts(self) -> tuple[Any, Any]:
        return self.model, self.data


@pytest.fixture(scope="module")
def owner() -> Owner:
    return Owner()


def test_the_task_is_what_the_scene_holds_now(owner: Owner) -> None:
    scene = owner.scene()
    task = scene.task()
    model, data = owner.model, owner.data
    body = model.body("tool").id
    assert task.object.mass == pytest.approx(model.body_mass[body])
    assert task.table_height == pytest.approx(0.4) and task.mu == 0.5
    (wall,) = task.obstacles
    np.testing.assert_allclose(wall.size, [0.04, 0.4, 0.2])
    np.testing.assert_allclose(wall.T_world_obstacle.translation, data.geom("wall").xpos)
    # weight and needed wrench together are the weight at the model's own centre of mass
    (needed,) = task.needed
    lever = data.xipos[body] - task.T_world_object.translation
    assert np.linalg.norm(lever) > 0.01
    expected = np.cross(lever, -model.body_mass[body] * np.array(model.opt.gravity))
    turned = task.T_world_object.rotation @ np.array(needed.torque)
    np.testing.assert_allclose(turned, expected, atol=1e-9)
    # fingers may touch the grip alone
    head = scene.T_world_object.actInv(data.geom("head").xpos)
    grip = scene.T_world_object.actInv(data.geom("grip").xpos)
    assert task.object.touch is not None
    np.testing.assert_array_equal(task.object.touch.permits(np.array([head, grip])), [False, True])


def test_planning_never_relies_on_more_friction_than_the_scene_has() -> None:
    # the fingers' 1.0 does not count where the object's has priority
    owner = Owner(friction=0.3)
    owner.model.geom_priority[owner.model.geom("grip").id] = 1
    assert owner.scene().task().mu == pytest.approx(0.25)
    assert owner.scene().task(mu=0.4).mu == 0.4


def test_an_object_that_sank_into_its_table_stands_on_it() -> None:
    owner = Owner()
    owner.data.qpos[2] -= 0.0005
    mujoco.mj_forward(owner.model, owner.data)
    task = owner.scene().task()
    assert task.table_height == pytest.approx(0.3995)
    owner.data.qpos[2] -= 0.01
    mujoco.mj_forward(owner.model, owner.data)
    with pytest.raises(TaskError, match="below the table's top"):
        owner.scene().task()


@pytest.mark.parametrize(
    ("changes", "error", "message"),
    [
        (
            {"table": "bank"},
            NotFoundError,
            "no geom of the scene is called 'bank'. There is: ball, bench",
        ),
        ({"touch": ("bench",)}, TaskError, "geom 'bench' does not belong to the object"),
        ({"obstacles": ("ball",)}, TaskError, "geom 'ball' is no box; planning knows planes"),
        ({"table": "ball"}, TaskError, "geom 'ball' is no box"),
    ],
)
def test_names_that_do_not_fit(
    owner: Owner, changes: dict[str, Any], error: type[Exception], message: str
) -> None:
    with pytest.raises(error, match=message):
        owner.scene(**changes).task()


def test_what_is_no_free_body_or_another_hand_is_refused(owner: Owner) -> None:
    given = owner.parts
    with pytest.raises(
        NotFoundError, match=r"no body of the scene is called 'tol'\. Did you mean 'tool'"
    ):
        ForeignScene(*given, "allegro_hand", "tol")
    with pytest.raises(TaskError, match="body 'fixed' of the scene has no free joint"):
        ForeignScene(*given, "allegro_hand", "fixed")
    with pytest.raises(NotFoundError, match=r"called 'palm'\. There is: .*robot/palm"):
        ForeignScene(*given, "allegro_hand", "tool")
    with pytest.raises(TaskError, match=r"index_\S+ of the scene is 5.0 mm and 0.0 degrees"):
        Owner(moved=0.005).scene()


def turn_link(_: Any, hand: Any) -> None:
    """Its origin stays where it is, those of the links after it too: it has no joint after it."""
    tip = next(b for b in hand.bodies if b.name == "index_distal")
    tip.quat = Rotation.from_euler("x", 5, degrees=True).as_quat(scalar_first=True)


def turn_axis(_: Any, hand: Any) -> None:
    """A joint at zero, so that all links stay."""
    joint = hand.body("index_distal").first_joint()
    joint.axis = [0.1, 1.0, 0.0]


def change_gain(_: Any, hand: Any) -> None:
    hand.actuators[2].gainprm[0] *= 2.0


def change_force(_: Any, hand: Any) -> None:
    hand.actuators[2].forcerange = [-0.1, 0.1]


def add_flap(spec: Any, _: Any) -> None:
    """A part on a hinge along y at the end of the tool's grip, and one fixed to that."""
    flap = spec.body("tool").add_body(name="flap", pos=[-0.09, 0, 0])
    flap.add_joint(name="hinge", axis=[0, 1, 0])
    box = {"type": mujoco.mjtGeom.mjGEOM_BOX, "size": [0.005, 0.015, 0.03]}
    flap.add_geom(name="flap", pos=[0, 0, 0.03], mass=0.05, **box)
    knob = flap.add_body(name="knob", pos=[0, 0, 0.08])
    knob.add_geom(name="knob", size=[0.01] * 3, mass=0.02, friction=[0.3, 0, 0], priority=1)


@pytest.mark.parametrize("angle", [0.0, 0.4])
def test_bodies_on_joints_are_part_of_an_object_as_they_are_now(angle: float) -> None:
    owner = Owner(change=add_flap)
    model, data = owner.parts
    data.joint("hinge").qpos = -angle
    mujoco.mj_forward(model, data)
    scene = owner.scene(touch=("knob",))
    assert [model.body(part).name for part in scene.parts] == ["tool", "flap", "knob"]
    task = scene.task()
    assert task.object.mass == pytest.approx(0.08 + 0.1 + 0.05 + 0.02)
    # by hand, in the tool's axes: flap and knob 30 and 80 mm along a line at that angle
    out = np.array([-np.sin(angle), 0.0, np.cos(angle)])
    flap, knob = [-0.09, 0, 0] + 0.03 * out, [-0.09, 0, 0] + 0.08 * out
    center = (0.1 * np.array([0.09, 0, 0]) + 0.05 * flap + 0.02 * knob) / 0.25
    np.testing.assert_allclose(scene.T_body_object.act(scene.center), center, atol=1e-9)
    there = data.subtree_com[scene.object_body]
    np.testing.assert_allclose(scene.T_world_object.act(scene.center), there, atol=1e-9)
    shape, at = task.object.shape, scene.T_body_object.translation
    assert shape.volume == pytest.approx(
        8 * (70 * 20 * 50 + 20 * 30 * 50 + 5 * 15 * 30) * 1e-9 + 4 / 3 * np.pi * 1e-6, rel=1e-3
    )
    assert shape.support(np.array([0, 0, 1.0])) + at[2] == pytest.approx(knob[2] + 0.01, abs=1e-4)
    assert shape.support(np.array([-1.0, 0, 0])) - at[0] == pytest.approx(0.01 - knob[0], abs=1e-4)
    # its weight acts there
    (needed,) = task.needed
    turned = task.T_world_object.rotation @ np.array(needed.torque)
    lever = there - task.T_world_object.translation
    weight = -0.25 * np.array(model.opt.gravity)
    np.testing.assert_allclose(turned, np.cross(lever, weight), atol=1e-9)
    # fingers may touch the knob alone, with its friction, and what they feel of it counts
    assert task.mu == pytest.approx(0.25)
    assert task.object.touch is not None
    seen = np.array([knob, flap]) - at
    np.testing.assert_array_equal(task.object.touch.permits(seen), [True, False])
    assert scene.for_task(task, 0.02).object_geoms == {
        model.geom(name).id for name in ("grip", "head", "flap", "knob")
    }


def test_a_finger_that_presses_on_a_part_touches_the_object() -> None:
    def beside(spec: Any, hand: Any) -> None:
        add_flap(spec, hand)
        spec.body("tool").pos = [0, 0, 2]

    owner = Owner(change=beside)
    model, data = owner.parts
    scene = owner.scene(table=None, obstacles=(), touch=())
    seen = scene.for_task(scene.task(), 0.02)
    tip = data.body("robot/index_distal").xpos
    data.qpos[:3] += tip - data.body("knob").xpos
    mujoco.mj_forward(model, data)
    assert "index" in hand_contacts(seen, data).fingers
    history = ContactHistory.of(seen)
    history.note(data)
    assert history.rows().finger.size == len(hand_contacts(seen, data).fingers)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (turn_link, r"index_distal of the scene is 0\.0 mm and 5\.0 degrees from where allegro"),
        (turn_axis, r"joint \S+ of the scene has axis \[.*, that of allegro_hand \["),
        (change_gain, r"actuator \S+ of the scene has gainprm \[6\.0, "),
        (change_force, r"actuator \S+ of the scene has forcerange \[-0\.1, 0\.1\], that of alleg"),
    ],
)
def test_what_the_plan_would_not_know_is_refused(
    change: Callable[[Any, Any], object], message: str
) -> None:
    with pytest.raises(TaskError, match=message):
        Owner(change=change).scene()


def test_a_scene_without_kinematics_is_told_so() -> None:
    owner = Owner()
    owner.data = mujoco.MjData(owner.model)
    with pytest.raises(TaskError, match=r"call mujoco.mj_forward\(model, data\)"):
        owner.scene()


def test_what_the_scene_gives_is_no_argument(owner: Owner) -> None:
    with pytest.raises(TaskError, match="gravity, obstacles of the task is read from the scene"):
        owner.scene().task(gravity=[0, 0, -1], obstacles=())


def test_a_table_is_level() -> None:
    def plane(tilt: float) -> Owner:
        turn = Rotation.from_euler("x", tilt, degrees=True).as_quat(scalar_first=True)
        given = {"type": mujoco.mjtGeom.mjGEOM_PLANE, "size": [1, 1, 1], "pos": [0, 0, 0.4]}
        return Owner(change=lambda spec, _: spec.worldbody.add_geom(name="g", quat=turn, **given))

    assert plane(0.0).scene(table="g").task().table_height == pytest.approx(0.4)
    with pytest.raises(TaskError, match="geom 'g' is not level"):
        plane(5.0).scene(table="g").task()


def six_joints(spec: Any, _: Any) -> None:
    """The tool free by three slides and three hinges, as some scenes have it."""
    tool = spec.body("tool")
    for joint in tool.find_all("joint"):
        spec.delete(joint)
    for kind in (mujoco.mjtJoint.mjJNT_SLIDE, mujoco.mjtJoint.mjJNT_HINGE):
        for axis in np.eye(3):
            tool.add_joint(type=kind, axis=axis)


def test_an_object_may_be_free_by_slides_and_hinges(owner: Owner) -> None:
    there, here = owner.scene().task(), Owner(change=six_joints).scene().task()
    np.testing.assert_allclose(
        here.T_world_object.homogeneous, there.T_world_object.homogeneous, atol=1e-9
    )

    def without_one(spec: Any, hand: Any) -> None:
        six_joints(spec, hand)
        spec.delete(spec.body("tool").find_all("joint")[0])

    def along_one(kind: int, spec: Any, hand: Any) -> None:
        six_joints(spec, hand)
        for joint in spec.body("tool").find_all("joint"):
            joint.armature = 0.001  # of joints along one axis alone MuJoCo would warn
            if joint.type == kind:
                joint.axis = [1, 0, 0]

    refused = "'tool' of the scene has no free joint, nor three slides"
    with pytest.raises(TaskError, match=refused):
        Owner(change=without_one).scene()
    for kind in (mujoco.mjtJoint.mjJNT_SLIDE, mujoco.mjtJoint.mjJNT_HINGE):
        with pytest.raises(TaskError, match=refused):
            Owner(change=partial(along_one, kind)).scene()


def test_a_table_without_a_name_is_that_of_its_body() -> None:
    def unnamed(spec: Any, _: Any) -> None:
        counter = spec.worldbody.add_body(name="counter", pos=[0, 0, 0.38])
        size = {"type": mujoco.mjtGeom.mjGEOM_BOX, "size": [0.5, 0.5, 0.02]}
        counter.add_geom(**size)
        counter.add_geom(**size, pos=[0, 0, 1], contype=0, conaffinity=0)  # only drawn

    assert Owner(change=unnamed).scene(table="counter").task().table_height == pytest.approx(0.4)


def test_a_base_whose_joints_are_the_hands_is_where_they_are_zero(tmp_path: Path) -> None:
    """A forearm on hinges that the hand's description begins with, as Adroit's."""

    def hinges(spec: Any, _: Any) -> None:
        for joint in spec.body("carriage").find_all("joint"):
            if joint.name not in "ab":
                spec.delete(joint)
            else:
                joint.range, joint.limited = [-1, 1], True
        for actuator in list(spec.actuators):
            if actuator.target in ("a", "b"):
                actuator.name = f"A_{actuator.target}"
            else:
                spec.delete(actuator)

    owner = Owner(change=hinges)
    model, data = owner.parts
    file = tmp_path / "scene.xml"
    file.write_text(owner.spec.to_xml())
    write_proposal(propose(file, base_body="carriage"), tmp_path / "hand.toml")
    data.qpos[model.joint("a").qposadr] = 0.2
    data.qpos[model.joint("b").qposadr] = -0.1
    mujoco.mj_forward(model, data)
    scene = ForeignScene(model, data, tmp_path / "hand.toml", "tool", table="bench")
    assert scene.hand.description.wrist_joints == ("a", "b")
    np.testing.assert_allclose(scene.T_world_base.rotation, np.eye(3), atol=1e-9)
    np.testing.assert_allclose(scene.T_world_base.translation, [0, 0, 0.75], atol=1e-9)
    # nothing carries it
    turned = SE3(Rotation.from_euler("x", 0.2).as_matrix(), np.zeros(3))
    with pytest.raises(TaskError, match="is not carried by hinges and slides alone"):
        scene.reaches(scene.T_world_base * turned)


def test_a_palm_that_is_the_base_moves_with_its_joints(tmp_path: Path) -> None:
    """A hand whose wrist is in its palm, on three slides."""

    def wrist(spec: Any, hand: Any) -> None:
        for joint in spec.body("carriage").find_all("joint")[3:]:
            spec.delete(joint)
        for actuator in list(spec.actuators)[3:]:
            spec.delete(actuator)
        for name, axis in (("a", [0, 1, 0]), ("b", [1, 0, 0])):
            hand.body("palm").add_joint(name=name, axis=axis, range=[-1, 1], limited=True)
            drive = hand.add_actuator(name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
            drive.set_to_position(kp=100)
        hand.compile()
        (tmp_path / "allegro_hand.xml").write_text(hand.to_xml())

    owner = Owner(change=wrist)
    model, data = owner.parts
    described = (models_dir() / MODEL).with_name("hand.toml").read_text()
    file = tmp_path / "hand.toml"
    file.write_text(described.replace("wrist_joints = []", 'wrist_joints = ["a", "b"]'))
    palm = data.body("robot/palm")
    zero = SE3(palm.xmat.reshape(3, 3).copy(), palm.xpos.copy())
    data.qpos[model.joint("robot/a").qposadr] = 0.4
    data.qpos[model.joint("robot/b").qposadr] = 0.2
    mujoco.mj_forward(model, data)
    scene = ForeignScene(model, data, file, "tool", prefix="robot/", table="bench", touch=["grip"])
    assert scene.hand.description.base_body == scene.hand.description.palm_body
    run = ForeignRun(plan_grasp(scene.task(), seed=0), scene, owner.step, period=0.02)
    np.testing.assert_allclose(run.T_world_base.homogeneous, zero.homogeneous, atol=1e-9)
    now = SE3(palm.xmat.reshape(3, 3), palm.xpos).actInv(scene.T_world_object)
    np.testing.assert_allclose(run.T_palm_object.homogeneous, now.homogeneous, atol=1e-9)
    # the slides carry the base, wherever the wrist is; they do not turn it, nor does the wrist
    assert scene.reaches(shifted(zero, [0.2, 0.1, -0.1]))
    turned = SE3(Rotation.from_euler("y", 0.2).as_matrix(), np.zeros(3))
    assert not scene.reaches(zero * turned)


@pytest.mark.parametrize("carried", ["free", "fixed"])
def test_a_carrier_with_a_free_joint_or_none_has_no_reach_here(carried: str) -> None:
    def change(spec: Any, _: Any) -> None:
        for joint in spec.body("carriage").find_all("joint"):
            spec.delete(joint)
        for actuator in list(spec.actuators):
            spec.delete(actuator)
        if carried == "free":
            spec.body("carriage").add_freejoint()

    scene = Owner(change=change).scene()
    with pytest.raises(TaskError, match="is not carried by hinges and slides alone"):
        scene.reaches(scene.T_world_base)


def test_reach_is_that_of_the_joints_above_the_base(owner: Owner) -> None:
    scene = owner.scene()
    before = owner.data.qpos.copy()
    turned = SE3(Rotation.from_euler("xyz", [0.4, -0.3, 0.2]).as_matrix(), np.zeros(3))
    pose = scene.T_world_base * turned
    assert scene.reaches(shifted(pose, [0.25, 0.4, -0.1]))
    assert not scene.reaches(shifted(pose, [0.4, 0.0, 0.0]))  # its slide along x ends at 0.3 m
    np.testing.assert_array_equal(owner.data.qpos, before)


@pytest.mark.parametrize("change", [lambda spec, hand: None, six_joints])
def test_motion_of_the_object_is_that_of_its_origin(change: Callable[[Any, Any], object]) -> None:
    owner = Owner(change=change)
    scene, model = owner.scene(), owner.model
    seen = scene.for_task(scene.task(), 0.02)
    data, h = owner.data, 1e-6
    data.qvel[:6] = [0.3, -0.1, 0.2, 1.0, 2.0, -0.5]
    twist, before = seen.object_twist(data), scene.T_world_object
    assert np.linalg.norm(before.translation - data.body("tool").xpos) > 0.01  # another origin
    there = seen.body_pose(data, seen.object_body)
    np.testing.assert_allclose(there.homogeneous, before.homogeneous)
    mujoco.mj_integratePos(model, data.qpos, data.qvel, h)
    mujoco.mj_forward(model, data)
    after = scene.T_world_object
    np.testing.assert_allclose(twist[:3], (after.translation - before.translation) / h, atol=1e-4)
    turn = Rotation.from_matrix(after.rotation @ before.rotation.T).as_rotvec()
    np.testing.assert_allclose(twist[3:], turn / h, atol=1e-4)


def test_a_tool_is_grasped_and_carried_through_its_owners_steps_alone() -> None:
    owner = Owner()
    scene = owner.scene()
    plan = plan_grasp(scene.task(grip_force=4.0), seed=0)
    made = []

    def step(T_world_base: SE3, ctrl: FloatArray) -> None:
        made.append(owner.data.time)
        owner.step(T_world_base, ctrl)

    late = ForeignRun(plan, scene, lambda *_: mujoco.mj_step(owner.model, owner.data), period=0.02)
    with pytest.raises(TaskError, match=r"period is 0.02 s, and the scene's step took 0.002 s"):
        late.step("approach", 0.0)
    run = ForeignRun(plan, scene, step, period=SUBSTEPS * owner.model.opt.timestep)
    # pressed with the forces that bear the weight where the model has its centre of mass
    pressed = run.plan.contacts
    (needed,) = plan.task.needed
    moment = plan.task.T_world_object.rotation @ np.array(needed.torque)
    weight = -plan.task.object.mass * plan.task.gravity
    np.testing.assert_allclose(pressed.wrench(), [*weight, *moment], atol=1e-3)
    assert run.move(plan.T_world_base_start, 1.0, wait=1.0, phase="approach")
    assert run.grasp()
    height = scene.T_world_object.translation[2]
    assert run.move(shifted(plan.T_world_base, [0.05, 0.0, 0.1]), 1.0, wait=1.0)
    assert scene.T_world_object.translation[2] - height > 0.09
    assert max(run.slip) < 2.0  # mm, degrees
    assert force_closure(run.contacts).closed
    # nothing but its owner's steps moved time
    assert run.steps == len(made)
    assert owner.data.time == pytest.approx(0.002 + run.steps * run.timestep)
