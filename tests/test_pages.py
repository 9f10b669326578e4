"""Pages without a browser: models, the file, and the numbers that are read back."""

from __future__ import annotations

import dataclasses
import json
import re
import shlex
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
import trimesh
from conftest import PlanOf
from scipy.optimize import linprog
from typer.testing import CliRunner

from planner import (
    GraspPlan,
    GraspTask,
    MotionPlan,
    load_hand,
    manipulation_task,
    parse_object,
    plan_gait,
    plan_manipulation,
    plan_motion,
)
from planner.contacts import ContactSet
from planner.errors import FileFormatError, NotFoundError
from planner.files import plan_to_dict, read_plan
from planner.hands.catalog import hand_names
from planner.hands.hand import Hand
from planner.kinematics import HandState
from planner.pages.blocks import resisted_forces
from planner.pages.hand_page import hand_page, named_joints
from planner.pages.motion_page import motion_page, object_motion
from planner.pages.page import pack, page_html, read_page_data, three_source, write_page
from planner.pages.plan_page import RATE, bands_of, plan_command, plan_page
from planner.pages.plan_scene import MOST_TRIANGLES, hand_points, object_model, stage_of, views_of
from planner.pages.scene import Model, hand_model, pose_row
from planner.quality import primitive_wrenches
from planner.shapes import SIZED_SHAPES
from planner.shapes.mesh import Mesh
from planner.shapes.meshes.triangles import simplified
from planner.showing import page_of
from planner.spatial import SE3, FloatArray, minimum_jerk, pose_from_wxyz
from sim.cli import app

LARGEST_PAGE = 1_000_000
"""Bytes of a plan's page."""


@pytest.fixture(scope="module")
def plan(plan_of: PlanOf) -> GraspPlan:
    return plan_of("allegro_hand", "box")


def joint_poses(model: Model, q: FloatArray) -> list[SE3]:
    """Pose of every joint's body in the base, as the page computes it."""
    out: list[SE3] = []
    for joint, value in zip(model.joints, q, strict=True):
        placement = pose_from_wxyz(joint.placement[:3], joint.placement[3:])
        if joint.kind == "hinge":
            move = SE3(pin.exp3(joint.axis * value), np.zeros(3))
        else:
            move = SE3(np.eye(3), joint.axis * value)
        pose = placement * move
        out.append(pose if joint.parent < 0 else out[joint.parent] * pose)
    return out


@pytest.mark.parametrize("name", hand_names())
def test_the_tree_of_a_hand_has_pinocchios_kinematics(name: str) -> None:
    hand = load_hand(name)
    model = hand_model(hand)
    assert [j.name for j in model.joints] == list(hand.joint_names)
    assert [j.lower for j in model.joints] == list(hand.q_lower)
    rng = np.random.default_rng(0)
    data = hand.pin_model.createData()
    for _ in range(3):
        q = rng.uniform(hand.q_lower, hand.q_upper)
        pin.forwardKinematics(hand.pin_model, data, q)
        for i, pose in enumerate(joint_poses(model, q)):
            assert np.allclose(pose.homogeneous, data.oMi[i + 1].homogeneous, atol=1e-6), i


@pytest.mark.parametrize("name", hand_names())
def test_a_hand_is_drawn_where_its_collision_geometry_is(name: str) -> None:
    hand = load_hand(name)
    parts = {p.name: p for p in hand_model(hand).parts if p.layer == "collision"}
    assert set(parts) == {g.name for g in hand.geometries}
    for geometry in hand.geometries:
        part = parts[geometry.name]
        assert part.joint == geometry.joint_id - 1
        geometry.geometry.computeLocalAABB()
        box = geometry.geometry.aabb_local
        # corners of coal's box around it, seen from the geometry
        inside = np.array(
            [geometry.T_joint_geometry.inverse().act(v) for v in np.asarray(part.vertices)]
        )
        assert np.allclose(inside.min(axis=0), box.min_, atol=1e-3), geometry.name
        assert np.allclose(inside.max(axis=0), box.max_, atol=1e-3), geometry.name


def test_pads_are_drawn_on_the_surface_of_their_tips() -> None:
    hand = load_hand("allegro_hand")
    pads = {p.name: p for p in hand_model(hand).parts if p.layer == "pads"}
    for finger in hand.fingers.values():
        part = pads[f"pad of {finger.name}"]
        away = np.asarray(part.vertices) - finger.pad.center
        assert np.allclose(np.linalg.norm(away, axis=1), finger.pad.radius, atol=5e-4)
        assert (away @ finger.pad.axis / np.linalg.norm(away, axis=1)).min() > (
            np.cos(finger.pad.half_angle) - 1e-9
        )


@pytest.mark.parametrize("kind", sorted(SIZED_SHAPES))
def test_an_object_is_drawn_with_its_true_surface_and_a_mark(kind: str) -> None:
    shape = SIZED_SHAPES[kind].from_sizes(SIZED_SHAPES[kind].default_sizes)
    shown = object_model(shape)
    vertices = np.concatenate([p.vertices for p in shown.model.parts])
    assert np.abs(shape.signed_distance(vertices)).max() < 1e-3 * shape.bounding_radius
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    for axis in np.eye(3):
        assert high @ axis == pytest.approx(shape.support(axis), abs=2e-4)
        assert -low @ axis == pytest.approx(shape.support(-axis), abs=2e-4)
    names = [p.name for p in shown.model.parts]
    assert names == ["object", "heading mark of object"]
    assert shown.note == ""


@pytest.mark.slow
def test_a_mesh_of_very_many_triangles_is_simplified_and_the_page_says_so() -> None:
    ball = trimesh.creation.icosphere(subdivisions=6, radius=0.04)
    assert len(ball.faces) > 2 * MOST_TRIANGLES
    mesh = Mesh.from_triangles(np.asarray(ball.vertices), np.asarray(ball.faces))
    shown = object_model(mesh)
    assert 0.5 * MOST_TRIANGLES < shown.shown <= MOST_TRIANGLES
    assert str(shown.shown) in shown.note and str(len(ball.faces)) in shown.note
    vertices, triangles, changed = simplified(mesh.vertices, mesh.faces, 5_000)
    assert changed and len(triangles) <= 5_000
    assert np.abs(np.linalg.norm(vertices, axis=1) - 0.04).max() < 1e-3


def test_the_numbers_of_a_page_read_back(plan: GraspPlan, tmp_path: Path) -> None:
    path = tmp_path / "plan.html"
    plan.save_html(path)
    assert path.stat().st_size <= LARGEST_PAGE
    assert read_page_data(path) == ("plan", json.loads(json.dumps(plan_to_dict(plan))))
    assert [p.name for p in tmp_path.iterdir()] == ["plan.html"]


def test_a_page_names_no_address(plan: GraspPlan) -> None:
    text = page_html(plan_page(plan))
    assert "default-src 'none'" in text
    outside = re.sub(r"<script type=.*?</script>", "", text, flags=re.DOTALL)
    assert set(re.findall(r"https?://[^\"'\s)]+", outside)) <= {"http://www.w3.org/2000/svg"}
    assert not re.findall(r'(?:src|href)="(?!data:)', outside)


def test_what_is_not_a_page_of_ours_is_refused(plan: GraspPlan, tmp_path: Path) -> None:
    foreign = tmp_path / "foreign.html"
    foreign.write_text("<html>hello</html>")
    with pytest.raises(FileFormatError, match="is not a page with numbers"):
        read_page_data(foreign)
    with pytest.raises(FileFormatError, match="cannot read"):
        read_page_data(tmp_path / "missing.html")
    (tmp_path / "binary.html").write_bytes(b"\xff\xfe\x00\x80")
    with pytest.raises(FileFormatError, match="cannot read"):
        read_page_data(tmp_path / "binary.html")
    text = page_html(plan_page(plan))
    begin = text.index('data-kind="plan">') + 2000
    damaged = tmp_path / "damaged.html"
    damaged.write_text(text[:begin] + text[begin + 400 :], encoding="utf-8")
    with pytest.raises(FileFormatError, match="damaged"):
        read_page_data(damaged)


def test_a_page_that_cannot_be_written_says_so(plan: GraspPlan, tmp_path: Path) -> None:
    with pytest.raises(FileFormatError, match="cannot write"):
        write_page(plan_page(plan), tmp_path / "nowhere" / "plan.html")


def test_what_has_no_page_says_so() -> None:
    with pytest.raises(NotFoundError, match="kind of thing with a page"):
        page_of(3)


def test_bands_cover_a_trajectory(plan: GraspPlan) -> None:
    trajectory = plan.joint_trajectory()
    bands = bands_of(trajectory)
    assert [b.name for b in bands] == ["approach", "close"]
    assert bands[0].begin == 0.0 and bands[-1].end == trajectory.times[-1]
    assert bands[0].end == bands[1].begin == 1.5


def test_packed_arrays_stand_at_multiples_of_eight() -> None:
    packed = pack({"a": np.arange(17.0), "b": np.array([np.nan, 1.0]), "c": [np.inf, 2]})
    length = int.from_bytes(packed[:4], "little")
    assert (4 + length) % 8 == 0
    tree = json.loads(packed[4 : 4 + length])
    assert tree["c"] == [None, 2]
    kind, shape, offset = tree["a"]["$"]
    assert (kind, shape, offset % 8) == ("f4", [17], 0)
    data = np.frombuffer(packed, np.float32, 17, 4 + length + offset)
    assert np.array_equal(data, np.arange(17.0))
    kind, shape, offset = tree["b"]["$"]
    data = np.frombuffer(packed, np.float32, 2, 4 + length + offset)
    assert np.isnan(data[0]) and data[1] == 1.0


def test_three_js_is_the_library_alone() -> None:
    source = three_source()
    assert "THREE={}" in source and "TrackballControls" not in source


def test_rows_of_poses_hold_position_and_unit_quaternion() -> None:
    pose = SE3.Random()
    row = pose_row(pose)
    assert np.allclose(pose_from_wxyz(row[:3], row[3:]).homogeneous, pose.homogeneous)


@pytest.fixture(scope="module")
def motion() -> MotionPlan:
    return plan_motion(GraspTask.create("shadow_hand", "cylinder"), angle=0.5, seed=0)


def test_the_page_of_a_motion_has_every_knot(motion: MotionPlan) -> None:
    trajectory = motion.joint_trajectory(rate_hz=RATE)
    track = object_motion(motion, trajectory)
    assert len(track.poses) == len(track.contacts) == len(trajectory.times)
    turning = [i for i, phase in enumerate(trajectory.phases) if phase == "turn"]
    assert all(c is None for c in track.contacts[: turning[0]])
    shares = minimum_jerk((np.arange(len(turning)) + 1) / len(turning))
    for i, share in zip(turning, shares, strict=True):
        assert np.allclose(
            track.poses[i].homogeneous, motion.at(float(share))[0].homogeneous, atol=1e-9
        )
    seen = {id(track.knots[i]) for i in turning}
    assert len(seen) >= len(motion.knots) - 2
    last = track.contacts[-1]
    assert last is not None
    points = [track.poses[-1].act(p) for p in last.positions]
    assert np.allclose(points, motion.knots[-1].contacts.positions, atol=1e-9)


def test_the_page_of_a_motion_tells_the_least_margin_of_its_knots(motion: MotionPlan) -> None:
    verdict = motion_page(motion).verdict
    assert verdict is not None
    told = re.search(r"least normalised min-weight (\S+)\)", verdict.reason)
    least = min(knot.closure.normalised_min_weight for knot in motion.knots)
    assert told is not None and float(told[1]) == pytest.approx(least, abs=5e-4)


@pytest.mark.parametrize("name", ["shadow_hand", "shadow_hand_left"])
def test_the_view_of_the_palm_is_from_where_the_fingers_close(name: str) -> None:
    """Fingertips move towards the camera from the back of the open hand, whose palm is turned."""
    hand = load_hand(name)
    scene = hand_page(hand).scene
    assert scene is not None
    views = {view.name: np.array(view.direction) for view in scene.views}
    opened, closed = (HandState(hand, hand.posture(posture)) for posture in ("open", "pinch"))
    ways = [
        closed.pad_center(finger) - opened.pad_center(finger)
        for name, finger in hand.fingers.items()
        if name != "thumb"
    ]
    assert np.mean(ways, axis=0) @ views["palm"] > 0.002
    assert np.allclose(views["back"], -views["palm"])


def test_the_page_of_a_motion_reads_back(motion: MotionPlan, tmp_path: Path) -> None:
    motion.save_html(tmp_path / "motion.html")
    assert (tmp_path / "motion.html").stat().st_size <= LARGEST_PAGE
    kind, data = read_page_data(tmp_path / "motion.html")
    assert kind == "motion"
    assert len(data["knots"]) == len(motion.knots)


@pytest.mark.slow
def test_what_the_hand_holds_goes_with_it() -> None:
    task = manipulation_task("shadow_hand", parse_object("cylinder"), mu=0.6)
    plan = plan_manipulation(task, angle=0.6, seed=0)
    trajectory = plan.joint_trajectory(rate_hz=RATE)
    track = object_motion(plan, trajectory)
    phases = np.array(trajectory.phases)
    assert set(phases) >= {"lift", "turn", "carry", "lower", "open", "retreat"}
    start, end = task.T_world_object, plan.ending.T_world_target
    assert np.allclose(track.poses[0].homogeneous, start.homogeneous)
    lifted = int(np.flatnonzero(phases == "lift")[-1])
    assert track.poses[lifted].translation[2] == pytest.approx(start.translation[2] + 0.08)
    # put down where the plan says, and left there
    for k in np.flatnonzero((phases == "open") | (phases == "retreat")):
        assert np.allclose(track.poses[k].homogeneous, end.homogeneous, atol=1e-6)
        assert track.contacts[k] is None
    # as long as it is held, pads stay at their contacts
    hand, fingers = task.hand, plan.task.fingers
    data = hand.pin_model.createData()
    for k in np.flatnonzero(phases == "turn")[::7]:
        pin.forwardKinematics(hand.pin_model, data, trajectory.positions[k])
        contacts = track.contacts[k]
        assert contacts is not None
        for finger, point in zip(fingers, contacts.positions, strict=True):
            pad = trajectory.T_world_base[k] * data.oMi[finger.pad.joint_id]
            away = pad.act(finger.pad.center) - track.poses[k].act(point)
            assert np.linalg.norm(away) < finger.pad.radius + 4e-3


@pytest.mark.slow
def test_a_gait_shows_the_contacts_that_hold_while_a_finger_moves_on() -> None:
    plan = plan_gait(GraspTask.create("shadow_hand", "sphere:0.03"), angle=np.pi / 4, seed=1)
    trajectory = plan.joint_trajectory(rate_hz=RATE)
    track = object_motion(plan, trajectory)
    relocation = plan.relocations[0]
    at = trajectory.phases.index(f"regrasp {relocation.finger}")
    holding = track.contacts[at]
    assert holding is not None and relocation.finger not in holding.fingers
    assert np.allclose(track.poses[at].homogeneous, relocation.T_world_object.homogeneous)
    scene = motion_page(plan).scene
    assert scene is not None
    moving = scene.contacts[0].fingers.index(relocation.finger)
    assert np.isnan(scene.contacts[0].points[at, moving]).all()
    turned = scene.plots[0].lines[0].values
    assert turned[-1] == pytest.approx(np.rad2deg(plan.angle), abs=1.0)


def test_resisted_forces_are_those_of_a_linear_programme(plan: GraspPlan) -> None:
    length = plan.task.object.shape.bounding_radius
    polar = resisted_forces(plan.contacts, length)
    assert polar is not None
    wrenches = primitive_wrenches(plan.contacts, 8, length=length)
    m = wrenches.shape[1]
    for axis, (chart, k) in enumerate(((0, 0), (0, 18), (1, 18))):
        force = np.zeros(6)
        force[axis] = -1.0  # what balances a pull along the axis
        # most reach t with W a = t force, sum a = 1, a >= 0
        found = linprog(
            np.r_[np.zeros(m), -1.0],
            A_eq=np.r_[np.c_[wrenches, -force], [np.r_[np.ones(m), 0.0]]],
            b_eq=np.r_[np.zeros(6), 1.0],
        )
        assert polar.charts[chart].values[k] == pytest.approx(-found.fun, rel=1e-6)


def test_contacts_without_closure_have_no_chart(plan: GraspPlan) -> None:
    set_ = plan.contacts
    two = ContactSet.from_contacts([set_[0], set_[1]], center=set_.center)
    assert resisted_forces(two, 0.05) is None


def test_a_page_opens_from_where_the_hand_does_not_hide_the_object() -> None:
    down = np.array([0.0, 0.0, -1.0])
    seen = 0.03 * np.random.default_rng(0).uniform(-1, 1, size=(30, 3))
    nothing = np.full((1, 3), 9.0)
    open_view = views_of(down, None, nothing, seen)[0].direction
    # a wall between the object and that place
    grid = np.stack(np.meshgrid(np.linspace(-0.1, 0.1, 40), np.linspace(-0.1, 0.1, 40)), axis=-1)
    across = np.linalg.svd(np.array([open_view]))[2][1:]
    wall = 0.1 * np.array(open_view) + grid.reshape(-1, 2) @ across
    moved, palm = views_of(down, None, wall, seen)
    assert np.dot(moved.direction, open_view) < 0.8
    assert palm.direction == (0.0, 0.0, -1.0)


def test_a_page_opens_from_beside_the_palm(plan: GraspPlan) -> None:
    views = {v.name: np.array(v.direction) for v in stage_of(plan).views(plan.contacts)}
    facing = plan.T_world_palm.rotation @ plan.task.hand.palm_normal
    assert abs(views["start"] @ facing) < 0.6
    assert np.allclose(views["palm"], facing)


def test_points_of_a_hand_lie_on_its_geometry(plan: GraspPlan) -> None:
    hand = plan.task.hand
    state = HandState(hand, plan.q)
    points = hand_points(hand_model(hand), plan.T_world_base, state)
    tip = hand.fingers["index"].pad
    center = (plan.T_world_base * state.joint_pose(tip.joint_id)).act(tip.center)
    away = np.linalg.norm(points - center, axis=1)
    assert (np.abs(away - tip.radius) < 1e-2 * tip.radius).sum() > 5
    assert away.max() < 0.4


def test_the_command_on_the_page_gives_the_plan_again(plan: GraspPlan, tmp_path: Path) -> None:
    words = shlex.split(plan_command(plan))
    assert words[0] == "opposable"
    result = CliRunner().invoke(app, [*words[1:], "--out", str(tmp_path / "plan.json")])
    assert result.exit_code == 0, result.output
    again = read_plan(tmp_path / "plan.json")
    assert np.allclose(again.q, plan.q, atol=1e-9)
    assert np.allclose(again.T_world_base.homogeneous, plan.T_world_base.homogeneous, atol=1e-9)


def test_a_task_that_the_command_line_cannot_say_has_no_command(plan: GraspPlan) -> None:
    lifted = dataclasses.replace(plan.task, gravity=np.array([0.0, 0.0, -1.62]))
    assert plan_command(dataclasses.replace(plan, task=lifted)) == ""
    ball = trimesh.creation.icosphere(radius=0.03)
    made = Mesh.from_triangles(np.asarray(ball.vertices), np.asarray(ball.faces))
    item = dataclasses.replace(plan.task.object, shape=made)
    task = dataclasses.replace(plan.task, object=item, T_world_object=item.resting_pose())
    assert plan_command(dataclasses.replace(plan, task=task)) == ""


@pytest.mark.parametrize(
    ("sentence", "joints"),
    [
        ("index_3 is stiff", [3]),
        ("the finger thumb.", [12, 13, 14, 15]),
        ("the geometry index_pad touches", [3]),
        ("the body middle_distal touches", [7]),
        ("nothing", []),
    ],
)
def test_a_sentence_names_joints(allegro: Hand, sentence: str, joints: list[int]) -> None:
    assert list(named_joints(allegro, sentence)) == joints
