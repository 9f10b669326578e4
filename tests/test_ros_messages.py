"""ROS 2 messages: fields are those of the definitions, numbers survive, damage is named."""

from __future__ import annotations

import copy
import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import pytest
from exchange import make_claw, moved, some_numbers
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from planner.errors import FileFormatError, NotFoundError, TaskError
from planner.exchange import Reading, Writing, export_plans
from planner.exchange.formats import format_of
from planner.exchange.joints import (
    T_object_body,
    channels_of,
    completed_joints,
    followers,
    read_renaming,
)
from planner.exchange.ros import (
    FIELDS,
    check_message,
    grasp_message,
    read_ros_grasps,
    trajectory_message,
    write_ros_grasps,
)
from planner.exchange.ros.messages import duration
from planner.hands.hand import Hand
from planner.motion import plan_motion
from planner.plan import GraspPlan
from planner.search.grasp import plan_grasp
from planner.spatial import SE3, pose_from_wxyz
from planner.task import GraspTask

Json: TypeAlias = Any

DEFINITIONS = {
    # https://github.com/moveit/moveit_msgs, branch ros2, commit ec3ba4b, msg/
    "moveit_msgs/Grasp": """string id
        trajectory_msgs/JointTrajectory pre_grasp_posture
        trajectory_msgs/JointTrajectory grasp_posture
        geometry_msgs/PoseStamped grasp_pose
        float64 grasp_quality
        GripperTranslation pre_grasp_approach
        GripperTranslation post_grasp_retreat
        GripperTranslation post_place_retreat
        float32 max_contact_force
        string[] allowed_touch_objects""",
    "moveit_msgs/GripperTranslation": """geometry_msgs/Vector3Stamped direction
        float32 desired_distance
        float32 min_distance""",
    # https://github.com/ros2/common_interfaces, commit c0c0bc5, PACKAGE/msg/
    "trajectory_msgs/JointTrajectory": """std_msgs/Header header
        string[] joint_names
        JointTrajectoryPoint[] points""",
    "trajectory_msgs/JointTrajectoryPoint": """float64[] positions
        float64[] velocities
        float64[] accelerations
        float64[] effort
        builtin_interfaces/Duration time_from_start""",
    "geometry_msgs/PoseStamped": "std_msgs/Header header\nPose pose",
    "geometry_msgs/Pose": "Point position\nQuaternion orientation",
    "geometry_msgs/Point": "float64 x\nfloat64 y\nfloat64 z",
    "geometry_msgs/Quaternion": "float64 x 0\nfloat64 y 0\nfloat64 z 0\nfloat64 w 1",
    "geometry_msgs/Vector3Stamped": "std_msgs/Header header\nVector3 vector",
    "geometry_msgs/Vector3": "float64 x\nfloat64 y\nfloat64 z",
    "std_msgs/Header": "builtin_interfaces/Time stamp\nstring frame_id",
    # https://github.com/ros2/rcl_interfaces, commit f6b3741, builtin_interfaces/msg/
    "builtin_interfaces/Time": "int32 sec\nuint32 nanosec",
    "builtin_interfaces/Duration": "int32 sec\nuint32 nanosec",
}
"""The definitions without their comments."""


@pytest.fixture(scope="module")
def plan(shadow: Hand) -> GraspPlan:
    return plan_grasp(GraspTask.create(shadow, "box"), seed=0)


@pytest.fixture(scope="module")
def good(plan: GraspPlan) -> Json:
    return json.loads(json.dumps(grasp_message(plan, "first")))


def defined(kind: str) -> dict[str, str]:
    """Field -> full type, in the order of a definition."""
    package, fields = kind.split("/")[0], {}
    for line in DEFINITIONS[kind].splitlines():
        wanted, name = line.split()[:2]
        own = "/" in wanted or wanted.removesuffix("[]") in ("string", "float64", "float32")
        own = own or wanted.removesuffix("[]") in ("int32", "uint32")
        fields[name] = wanted if own else f"{package}/{wanted}"
    return fields


def test_fields_are_those_of_the_definitions() -> None:
    assert set(FIELDS) == set(DEFINITIONS)
    for kind in DEFINITIONS:
        assert list(FIELDS[kind].items()) == list(defined(kind).items()), kind


def whole(value: Any, kind: str) -> None:
    """See that every field is there, in order, and of the very type that Python has for it."""
    if kind.endswith("[]"):
        for one in value:
            whole(one, kind[:-2])
    elif kind in FIELDS:
        assert list(value) == list(FIELDS[kind])
        for name, wanted in FIELDS[kind].items():
            whole(value[name], wanted)
    else:
        wanted_type = {"string": str, "int32": int, "uint32": int}.get(kind, float)
        assert type(value) is wanted_type, (kind, value)


def test_messages_are_whole_and_of_the_right_types(plan: GraspPlan) -> None:
    for message, kind in (
        (grasp_message(plan, "first"), "moveit_msgs/Grasp"),
        (trajectory_message(plan), "trajectory_msgs/JointTrajectory"),
    ):
        whole(message, kind)
        check_message(message, kind, "here")


def test_the_codec_of_rosbags_takes_them(plan: GraspPlan) -> None:
    typesys = pytest.importorskip("rosbags.typesys")
    store = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
    for name in ("GripperTranslation", "Grasp"):
        text = DEFINITIONS[f"moveit_msgs/{name}"].replace("GripperT", "moveit_msgs/GripperT")
        lines = "\n".join(line.strip() for line in text.splitlines())
        store.register(typesys.get_types_from_msg(lines, f"moveit_msgs/msg/{name}"))

    def made(value: Any, kind: str) -> Any:
        if kind.endswith("[]"):
            inner = kind[:-2]
            if inner == "float64":
                return np.array(value, dtype=np.float64)
            return [made(one, inner) for one in value]
        if kind not in FIELDS:
            return value
        package, name = kind.split("/")
        fields = {key: made(value[key], wanted) for key, wanted in FIELDS[kind].items()}
        return store.types[f"{package}/msg/{name}"](**fields)

    message = grasp_message(plan, "first")
    kind = "moveit_msgs/msg/Grasp"
    raw = store.serialize_cdr(made(message, "moveit_msgs/Grasp"), kind)
    back: Any = store.deserialize_cdr(raw, kind)
    assert back.id == "first"
    assert back.grasp_posture.joint_names == list(plan.task.hand.joint_names)
    np.testing.assert_array_equal(back.grasp_posture.points[0].positions, plan.q)
    np.testing.assert_array_equal(back.pre_grasp_posture.points[0].positions, plan.q_pregrasp)
    assert back.grasp_posture.points[0].time_from_start.sec == 1
    assert back.grasp_pose.pose.orientation.w == message["grasp_pose"]["pose"]["orientation"]["w"]
    kind, way = "trajectory_msgs/msg/JointTrajectory", plan.joint_trajectory()
    raw = store.serialize_cdr(
        made(trajectory_message(plan), "trajectory_msgs/JointTrajectory"), kind
    )
    moves: Any = store.deserialize_cdr(raw, kind)
    np.testing.assert_array_equal([p.positions for p in moves.points], way.positions)
    times = [p.time_from_start.sec + 1e-9 * p.time_from_start.nanosec for p in moves.points]
    np.testing.assert_allclose(times, way.times, atol=1e-9)


@given(numbers=some_numbers(), suffix=st.sampled_from([".json", ".yaml"]))
@settings(
    max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
def test_what_is_written_is_read(
    plan: GraspPlan, numbers: list[float], suffix: str, tmp_path: Path
) -> None:
    pytest.importorskip("yaml")
    plans, path = [plan, moved(plan, numbers)], tmp_path / f"g{suffix}"
    write_ros_grasps(plans, path, Writing())
    found = read_ros_grasps(path, plan.task.hand, Reading())
    assert [g.object for g in found.grasps] == ["box", "box"]
    for wanted, grasp in zip(plans, found.grasps, strict=True):
        np.testing.assert_array_equal(grasp.q, wanted.q)
        np.testing.assert_array_equal(grasp.q_pregrasp, wanted.q_pregrasp)
        np.testing.assert_allclose(
            grasp.T_object_base.homogeneous, T_object_body(wanted).homogeneous, rtol=0, atol=1e-12
        )


def vector(data: Mapping[str, float], keys: str = "xyz") -> Any:
    return np.array([data[k] for k in keys])


def test_a_grasp_is_in_the_frame_that_its_header_names(plan: GraspPlan) -> None:
    task = plan.task
    for writing, T_frame_world in (
        (Writing(world_frame="map"), SE3.Identity()),
        (Writing(object_frame="thing"), task.T_world_object.inverse()),
    ):
        message = grasp_message(plan, "first", writing)
        frame = writing.world_frame or "thing"
        pose = message["grasp_pose"]["pose"]
        found = pose_from_wxyz(vector(pose["position"]), vector(pose["orientation"], "wxyz"))
        np.testing.assert_allclose(
            found.homogeneous, (T_frame_world * plan.T_world_base).homogeneous, atol=1e-12
        )
        assert message["grasp_pose"]["header"]["frame_id"] == frame
        way = plan.T_world_base.translation - plan.T_world_base_start.translation
        approach = message["pre_grasp_approach"]
        assert approach["direction"]["header"]["frame_id"] == frame
        direction = vector(approach["direction"]["vector"])
        np.testing.assert_allclose(
            T_frame_world.rotation.T @ direction * approach["desired_distance"], way, atol=1e-12
        )
        lift = vector(message["post_grasp_retreat"]["direction"]["vector"])
        np.testing.assert_allclose(T_frame_world.rotation.T @ lift, [0, 0, 1], atol=1e-12)
        away = vector(message["post_place_retreat"]["direction"]["vector"])
        np.testing.assert_allclose(away, -direction, atol=1e-12)
    assert message["allowed_touch_objects"] == ["thing"]


def test_efforts_and_the_largest_force_are_those_of_the_plan(plan: GraspPlan) -> None:
    message = grasp_message(plan, "first")
    largest = max(np.linalg.norm(f[:3]) for f in plan.contacts.forces)
    assert message["max_contact_force"] == pytest.approx(largest, rel=1e-12)
    joints = np.array(message["grasp_posture"]["points"][0]["effort"])
    told = grasp_message(plan, "first", Writing(by="actuators"))["grasp_posture"]
    assert told["joint_names"] == list(plan.task.hand.actuation.names)
    forces = np.array(told["points"][0]["effort"])
    np.testing.assert_array_equal(forces, plan.forces.actuator_forces)
    np.testing.assert_allclose(joints, plan.task.hand.actuation.moment.T @ forces, atol=1e-15)


@given(st.floats(0.0, 1e6))
def test_a_duration_is_right_to_the_nanosecond(seconds: float) -> None:
    told = duration(seconds)
    assert 0 <= told["nanosec"] < 10**9
    assert abs(told["sec"] + 1e-9 * told["nanosec"] - seconds) <= 0.5e-9 + 1e-15 * seconds


def test_times_that_no_duration_holds_are_refused() -> None:
    assert duration(0.9999999999) == {"sec": 1, "nanosec": 0}
    for seconds in (-0.1, 2.0**31, float("nan")):
        with pytest.raises(FileFormatError, match="is no ROS duration"):
            duration(seconds)


DAMAGE: list[tuple[str, Json, str]] = [
    ("grasp_pose", ..., "message 0 has no grasp_pose"),
    ("grasp_pose.pose", ..., "message 0.grasp_pose has no pose"),
    ("grasp_pose.pose.position.x", ..., "pose.position has no x"),
    ("grasp_pose.pose.position.x", None, "pose.position.x is None; a finite number"),
    ("grasp_pose.pose.orientation.w", 9.0, "orientation is a quaternion of length 9"),
    ("grasp_pose.pose.angle", 1.0, "pose.angle is no field of geometry_msgs/Pose; it has position"),
    ("grasp_posture", ..., "message 0 has no grasp_posture"),
    ("grasp_posture.points", [], "grasp_posture.points is empty"),
    ("grasp_posture.points", 4, "grasp_posture.points is a int; a list is needed"),
    ("grasp_posture.joint_names", ["FFJ4"], r"positions is a list of 24; a list of 1 numbers"),
    ("grasp_posture.joint_names.2", "WRJ1", "grasp_posture names twice WRJ1"),
    (
        "grasp_posture.joint_names.2",
        "X",
        "does not fit shadow_hand: it lacks FFJ4 and names X",
    ),
    ("grasp_posture.points.0.positions.3", "nan", r"positions\[3\] is 'nan'; a finite"),
    ("grasp_posture.points.0.time_from_start.sec", 0.5, "sec is 0.5; an integer from -2147483648"),
    ("grasp_posture.points.0.time_from_start.nanosec", -1, "nanosec is -1; an integer from 0"),
    ("allowed_touch_objects", "box", "allowed_touch_objects is a str; a list is needed"),
    ("id", 3, "message 0.id is 3; a text is needed"),
    ("pose", {}, "message 0.pose is no field of moveit_msgs/Grasp; it has id"),
]


@pytest.mark.parametrize(("where", "value", "said"), DAMAGE, ids=[f"{d[0]}-{d[1]}" for d in DAMAGE])
def test_damage_is_named_with_its_place(
    good: Json, shadow: Hand, tmp_path: Path, where: str, value: Json, said: str
) -> None:
    pytest.importorskip("yaml")
    data = copy.deepcopy(good)
    *path, last = [int(k) if k.isdigit() else k for k in where.split(".")]
    inner = data
    for key in path:
        inner = inner[key]
    if value is ...:
        del inner[last]
    else:
        inner[last] = value
    file = tmp_path / "g.json"
    file.write_text(json.dumps([data]), encoding="utf-8")
    with pytest.raises(FileFormatError, match=said) as raised:
        read_ros_grasps(file, shadow, Reading())
    assert "g.json" in str(raised.value)


def test_what_a_message_may_leave_out_may_be_missing(
    good: Json, shadow: Hand, tmp_path: Path
) -> None:
    pytest.importorskip("yaml")
    short = {key: good[key] for key in ("grasp_pose", "grasp_posture")}
    (tmp_path / "g.json").write_text(json.dumps([short]), encoding="utf-8")
    (grasp,) = read_ros_grasps(tmp_path / "g.json", shadow, Reading()).grasps
    assert (grasp.name, grasp.q_pregrasp, grasp.confidence) == ("message 0", None, None)
    assert format_of(tmp_path / "g.json").name == "ros2-grasp"
    (tmp_path / "g.json").write_text("[]", encoding="utf-8")
    with pytest.raises(FileFormatError, match="holds no message"):
        read_ros_grasps(tmp_path / "g.json", shadow, Reading())


# --- joints and actuators -------------------------------------------------------------------------


def test_a_joint_that_follows_is_told_to_nobody(tmp_path: Path) -> None:
    claw = make_claw(tmp_path)
    assert [claw.joint_names[i] for i in followers(claw)] == ["right"]
    channels = channels_of(claw, Writing(rename={"left": "drive"}))
    q = completed_joints(claw, ["left"], np.array([0.4]), where="here")
    np.testing.assert_allclose(q, [0.4, -0.1], atol=1e-12)
    assert channels.by_name(q) == {"drive": 0.4}
    (said,) = channels.said
    assert said == "left out, since they follow other joints by couplings: right"
    with pytest.raises(NotFoundError, match="no joint of claw is called 'right'"):
        channels_of(claw, Writing(rename={"right": "other"}))
    given = completed_joints(claw, ["right", "left"], np.array([0.3, 0.4]), where="here")
    np.testing.assert_array_equal(given, [0.4, 0.3])  # what a file says is left as it is


def test_a_motor_of_two_joints_is_told_their_sum(shadow: Hand, plan: GraspPlan) -> None:
    assert not len(followers(shadow))
    by_joints = channels_of(shadow, Writing())
    assert by_joints.names == shadow.joint_names
    assert "actuator A_FFJ0 commands FFJ2 + FFJ1" in by_joints.said
    channels = channels_of(shadow, Writing(by="actuators", rename={"A_FFJ0": "FFJ0"}))
    values = channels.by_name(plan.q)
    joints = dict(zip(shadow.joint_names, plan.q.tolist(), strict=True))
    assert len(values) == 20
    assert values["FFJ0"] == pytest.approx(joints["FFJ1"] + joints["FFJ2"])
    assert values["A_THJ5"] == pytest.approx(joints["THJ5"])
    message = trajectory_message(plan, Writing(by="actuators", rename={"A_FFJ0": "FFJ0"}))
    last = dict(zip(message["joint_names"], message["points"][-1]["positions"], strict=True))
    assert last["FFJ0"] == pytest.approx(values["FFJ0"])


def test_names_that_cannot_be_are_refused(shadow: Hand, tmp_path: Path) -> None:
    with pytest.raises(TaskError, match="more than one joint of shadow_hand is called FFJ3"):
        channels_of(shadow, Writing(rename={"FFJ4": "FFJ3"}))
    with pytest.raises(TaskError, match="by is 'motors'; give joints or actuators"):
        Writing(by="motors")
    for name, text, said in (
        ("a.toml", "FFJ4 = 3", "a.toml: FFJ4 is 3; a text is needed"),
        ("b.toml", "FFJ4 = ", "b.toml is damaged or not TOML"),
    ):
        (tmp_path / name).write_text(text, encoding="utf-8")
        with pytest.raises(FileFormatError, match=re.escape(said)):
            read_renaming(tmp_path / name)
    with pytest.raises(FileFormatError, match="cannot read a file of names"):
        read_renaming(tmp_path / "none.toml")
    (tmp_path / "c.toml").write_text('FFJ4 = "rh_FFJ4"', encoding="utf-8")
    assert read_renaming(tmp_path / "c.toml") == {"FFJ4": "rh_FFJ4"}


def test_movements_go_where_they_can(plan: GraspPlan, tmp_path: Path) -> None:
    task = GraspTask.create("allegro_hand", "cylinder:0.03x0.08")
    motion = plan_motion(task, angle=0.1, max_attempts=5)
    export_plans([motion, plan], tmp_path / "t.json", "ros2-trajectory")
    first, second = json.loads((tmp_path / "t.json").read_text(encoding="utf-8"))
    way = motion.joint_trajectory()
    np.testing.assert_array_equal([p["positions"] for p in first["points"]], way.positions)
    assert second["joint_names"] == list(plan.task.hand.joint_names)
    with pytest.raises(
        TaskError, match=r"a MovementPlan is a movement as well; .* ros2-trajectory"
    ):
        export_plans([motion], tmp_path / "g.json", "ros2-grasp")
    on_arm = plan_grasp(GraspTask.create("allegro_on_arm7", "sphere"), seed=0)
    with pytest.raises(TaskError, match="is on an arm"):
        export_plans([on_arm], tmp_path / "g.json", "ros2-grasp")
    export_plans([on_arm], tmp_path / "arm.json", "ros2-trajectory")
    (message,) = json.loads((tmp_path / "arm.json").read_text(encoding="utf-8"))
    assert len(message["joint_names"]) == on_arm.task.hand.nq
