"""Two hands as one: their model, contacts of both, one force programme, turns and tilts."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st

from planner import GraspTask, plan_grasp
from planner.collision.pad_contact import pad_contact_queries, pad_contacts
from planner.collision.pregrasp_ik import OPENED_SHARE
from planner.errors import HandError, PlannerError, TaskError
from planner.failure import Failure
from planner.files import read_plan
from planner.hand_loading import load_hand
from planner.hands.grasp_types import contact_sets
from planner.hands.hand import Hand
from planner.hands.two_hands import carriage_joints
from planner.kinematics import moving_hand
from planner.motion.search import check_task
from planner.objects import GraspObject, parse_object
from planner.plan import GraspPlan
from planner.spatial import SE3, FloatArray, pose_from_wxyz
from planner.synthesis.seeds import seeder_for
from planner.synthesis.seeds.facing_palms import PairSeeder
from planner.system.package import models_dir
from planner.verification import GAP_TOL, project_onto_surface
from sim import Timeline, simulate
from sim.protocols.dexgraspbench import unsuitable_for_dexgraspbench

pytestmark = pytest.mark.usefixtures("coarse_steps")

GRAVITY = 9.81
SIDE, MASS = 0.3, 3.0
"""Of the cube that is held, m and kg."""


@pytest.fixture(scope="module")
def pair() -> Hand:
    return load_hand("two_allegro_hands")


def heavy(spec: str, mass: float) -> GraspObject:
    return replace(parse_object(spec), mass=mass)


def refused(word: str) -> pytest.RaisesExc[PlannerError]:
    return pytest.raises(PlannerError, match=word)


@pytest.fixture(scope="module")
def plan(pair: Hand) -> GraspPlan:
    task = GraspTask.create(pair, heavy(f"box:{SIDE}x{SIDE}x{SIDE}", MASS), grasp_type="palms")
    return plan_grasp(task, seed=0)


def placed(hand: Hand, q: FloatArray) -> mujoco.MjData:
    """MuJoCo's kinematics of the hand alone."""
    data = mujoco.MjData(hand.mj_model)
    data.qpos[:] = q
    mujoco.mj_kinematics(hand.mj_model, data)
    return data


def body_pose(data: mujoco.MjData, name: str) -> SE3:
    body = data.body(name)
    return SE3(body.xmat.reshape(3, 3).copy(), body.xpos.copy())


@pytest.mark.parametrize("name", ["two_allegro_hands", "two_shadow_hands"])
def test_palms_look_at_each_other_half_a_metre_apart(name: str) -> None:
    hand = load_hand(name)
    data = placed(hand, hand.neutral)
    right, left = hand.sides
    T_right, T_left = (body_pose(data, s.palm_body) for s in (right, left))
    assert T_right.translation == pytest.approx([0.0, -0.25, 0.0], abs=1e-12)
    assert T_left.translation == pytest.approx([0.0, 0.25, 0.0], abs=1e-12)
    assert T_right.rotation @ right.palm_normal == pytest.approx([0, 1, 0], abs=1e-12)
    assert T_left.rotation @ left.palm_normal == pytest.approx([0, -1, 0], abs=1e-12)
    single = load_hand(name.replace("two_", "").replace("hands", "hand"))
    assert hand.nq == 2 * (single.nq + 6)
    assert len(hand.fingers) == 2 * len(single.fingers)
    most = [0.4, 0.4, 0.4, np.pi, 1.2, 1.2]
    for side in hand.sides:
        assert hand.q_upper[side.carriage] == pytest.approx(most)
        assert hand.q_lower[side.carriage] == pytest.approx([-m for m in most])


small, wide = st.floats(-1.1, 1.1), st.floats(-3.1, 3.1)
shift = st.floats(-0.4, 0.4)


@given(way=st.tuples(shift, shift, shift, wide, small, small), side=st.integers(0, 1))
def test_a_carriage_moves_its_palm_as_its_joints_say(
    way: tuple[float, ...], side: int, pair: Hand
) -> None:
    mine, other = pair.sides[side], pair.sides[1 - side]
    rest = placed(pair, pair.neutral)
    root = body_pose(rest, f"{mine.name}/carriage")
    x, y, z, rx, ry, rz = way
    turn = pin.utils.rotate("x", rx) @ pin.utils.rotate("y", ry) @ pin.utils.rotate("z", rz)
    moved = SE3(turn, np.array([x, y, z]))
    q = pair.neutral
    q[mine.carriage] = carriage_joints(moved)
    assert q[mine.carriage] == pytest.approx(way, abs=1e-9)
    data = placed(pair, q)
    wanted = root * moved * root.inverse() * body_pose(rest, mine.palm_body)
    there = body_pose(data, mine.palm_body)
    assert there.homogeneous == pytest.approx(wanted.homogeneous, abs=1e-9)
    # at rest its origin is the palm's, and its x axis is where the palm looks
    assert root.translation == pytest.approx(body_pose(rest, mine.palm_body).translation)
    looking = body_pose(rest, mine.palm_body).rotation @ mine.palm_normal
    assert root.rotation[:, 0] == pytest.approx(looking, abs=1e-12)
    still = body_pose(data, other.palm_body).homogeneous
    assert still == pytest.approx(body_pose(rest, other.palm_body).homogeneous, abs=1e-12)


def test_palms_press_on_opposite_sides(plan: GraspPlan) -> None:
    palms = [plan.task.finger_names.index(f"{side}/palm") for side in ("right", "left")]
    middle = plan.task.T_world_object.translation
    points = plan.contacts.positions[palms] - middle
    assert points[:, 1] == pytest.approx([-SIDE / 2, SIDE / 2], abs=5e-4)
    inward = np.array([[0.0, 1.0, 0.0], [0.0, -1.0, 0.0]])
    assert plan.contacts.normals[palms] == pytest.approx(inward, abs=1e-6)
    # MuJoCo agrees where the faces of the palms are
    data = placed(plan.task.hand, plan.q)
    for name, sign in (("right", -1.0), ("left", 1.0)):
        geom = plan.task.hand.contact_parts[f"{name}/palm"].pad.geom
        k = plan.task.hand.mj_model.geom(geom).id
        center, turn = data.geom_xpos[k], data.geom_xmat[k].reshape(3, 3)
        reach = plan.task.hand.mj_model.geom_size[k] @ np.abs(turn[1])
        gap = sign * center[1] - reach - SIDE / 2
        assert -5e-4 <= gap <= 5e-4, name


def test_the_grip_is_the_palms_and_fingers_touch(plan: GraspPlan) -> None:
    # a reserve of 2 of the friction of two palms: 2 m g / (mu 2)
    grip = 2.0 * MASS * GRAVITY / (0.5 * 2.0)
    assert plan.task.grip_force == pytest.approx(grip)
    least = [grip if name.endswith("palm") else 1.5 for name in plan.task.finger_names]
    assert plan.task.least_normals == pytest.approx(least)
    assert (plan.contacts.forces[:, 0] >= np.array(least) - 1e-6).all()
    assert plan.contacts.forces_in_axes().sum(axis=0) == pytest.approx(
        [0, 0, MASS * GRAVITY], abs=1e-3
    )


def test_a_carriage_bears_what_its_hand_presses_with_and_weighs(plan: GraspPlan) -> None:
    hand = plan.task.hand
    data, pressing = placed(hand, plan.q), plan.contacts.forces_in_axes()
    torques = plan.forces.joint_torques
    assert torques is not None
    for side in hand.sides:
        mine = [
            i
            for i, name in enumerate(plan.task.finger_names)
            if name in side.fingers or name.startswith(f"{side.name}/")
        ]
        root = hand.mj_model.body(f"{side.name}/carriage").id
        weight = float(hand.mj_model.body_subtreemass[root]) * GRAVITY
        wanted = pressing[mine].sum(axis=0) + np.array([0.0, 0.0, weight])
        # slides are before the hinges: their axes are those of the carriage at rest
        rest = body_pose(placed(hand, hand.neutral), f"{side.name}/carriage").rotation
        assert rest @ torques[side.carriage[:3]] == pytest.approx(wanted, abs=1e-3)
    assert data.qpos == pytest.approx(plan.q)


def test_every_contact_opens_along_its_normal(plan: GraspPlan) -> None:
    state = moving_hand(plan.task.hand)
    at, before = (state.move(q).pads(plan.task.fingers)[1] for q in (plan.q, plan.q_pregrasp))
    inward = plan.contacts.normals @ plan.T_world_base.rotation
    back = -((before - at) * inward).sum(axis=1)
    assert (back >= OPENED_SHARE * plan.pregrasp_distance - 1e-6).all()
    assert plan.T_world_base_start.homogeneous == pytest.approx(plan.T_world_base.homogeneous)


def test_a_plan_file_keeps_the_pair(plan: GraspPlan, tmp_path: Path) -> None:
    plan.save(tmp_path / "plan.json")
    again = read_plan(tmp_path / "plan.json")
    assert again.q.tobytes() == plan.q.tobytes()
    assert again.task.hand.name == "two_allegro_hands"
    assert again.task.finger_names == plan.task.finger_names


def test_two_hands_try_tips_and_palms(pair: Hand) -> None:
    task = GraspTask.create(pair, heavy("box:0.25x0.25x0.25", 1.0))
    assert task.finger_names == tuple(pair.fingers)
    assert [len(names) for names in task.alternatives] == [6, 8]
    assert task.T_world_base is not None
    assert task.T_world_base.translation == pytest.approx([0.0, 0.0, 0.125])
    assert task.wrist_free and not task.may_spare_fingers
    assert {n.split("/")[0].split("_")[0] for n in contact_sets(pair, "power")[0]} == {
        "right",
        "left",
    }


def test_starts_lay_palms_on_the_sides_that_they_look_at(pair: Hand) -> None:
    task = GraspTask.create(pair, heavy("box:0.2x0.3x0.25", 1.0), grasp_type="palms")
    seeder = seeder_for(task)
    for seed in range(5):
        start = seeder.draw(np.random.default_rng(seed))
        assert not isinstance(start, Failure)
        state = moving_hand(pair).move(start.q)
        for side, y in zip(pair.sides, (-0.15, 0.15), strict=True):
            pad = pair.contact_parts[side.palm_body].pad
            pose = start.T_object_base * state.joint_pose(pad.joint_id)
            face = pose.act(pad.center + pad.radius * pad.axis)
            assert face[1] == pytest.approx(y, abs=1e-9)
            assert pose.rotation @ pad.axis == pytest.approx([0, -np.sign(y), 0], abs=1e-9)


def test_hands_whose_tips_touch_stay_before_the_object(pair: Hand) -> None:
    task = GraspTask.create(pair, heavy("box:0.2x0.2x0.25", 1.0), grasp_type="fingertip")
    seeder = seeder_for(task)
    for seed in range(5):
        start = seeder.draw(np.random.default_rng(seed))
        assert not isinstance(start, Failure)
        state = moving_hand(pair).move(start.q)
        for side, away in zip(pair.sides, (-1.0, 1.0), strict=True):
            pad = pair.contact_parts[side.palm_body].pad
            face = (start.T_object_base * state.joint_pose(pad.joint_id)).act(
                pad.center + pad.radius * pad.axis
            )
            assert 0.03 - 1e-9 <= away * face[1] - 0.1 <= 0.09 + 1e-9


def test_carriages_stay_while_the_fingers_of_a_start_close(pair: Hand) -> None:
    """Also where nothing is there to stop them."""
    task = GraspTask.create(pair, heavy("sphere:0.05", 1.0), grasp_type="fingertip")
    seeder = seeder_for(task)
    assert isinstance(seeder, PairSeeder) and task.T_world_base is not None
    q = pair.posture("open")
    q[pair.carriage_index] = 0.1
    T_object_base = task.T_world_object.inverse() * task.T_world_base
    closed = seeder._closed(T_object_base, q, np.random.default_rng(0))
    assert closed[pair.carriage_index] == pytest.approx(0.1)
    assert np.abs(closed - q).max() > 0.5  # fingers do close


def test_palms_far_from_the_middle_of_all_contacts_touch_at_places_that_are_numbers(
    pair: Hand,
) -> None:
    """The end of a tilted palm that touches may be much farther from the middle than the other."""
    task = GraspTask.create(pair, heavy("box:0.8x1.29x0.8", 1.0), grasp_type="palms")
    seeder = seeder_for(task)
    for seed in range(40):
        rng = np.random.default_rng(seed)
        start = seeder.draw(rng)
        assert not isinstance(start, Failure)
        q = start.q.copy()
        q[pair.sides[0].carriage[4:]] += np.random.default_rng(seed).uniform(-0.6, 0.6, 2)
        with np.errstate(over="raise", invalid="raise"):
            touches = pad_contacts(task, task.T_world_base, q)
        assert np.isfinite([touch.point for touch in touches]).all()


def test_tips_are_put_onto_the_surface_by_the_carriage(pair: Hand) -> None:
    task = GraspTask.create(pair, heavy("sphere:0.125", 1.0), grasp_type="fingertip")
    found = plan_grasp(task, seed=0)
    off = found.q.copy()
    off[pair.sides[0].carriage[0]] -= 2e-4  # back along the palm's normal, 0.2 mm
    q = project_onto_surface(found.task, found.T_world_base, off)
    gaps = [touch.pad_gap for touch in pad_contacts(found.task, found.T_world_base, q)]
    assert np.abs(gaps).max() <= GAP_TOL
    fingers = np.setdiff1d(np.arange(pair.nq), pair.carriage_index)
    # fingers alone would have to bend by 0.2 mm in some 50 mm
    assert np.abs(q - off)[fingers].max() < 1e-3


def test_carriages_carry_their_force_less_the_weight_of_hand_and_carriage(pair: Hand) -> None:
    roots = [pair.mj_model.body(f"{side.name}/carriage").id for side in pair.sides]
    most = (2 * 100.0) / GRAVITY - float(pair.mj_model.body_subtreemass[roots].sum())
    cube = "box:0.3x0.3x0.3"
    seeder_for(GraspTask.create(pair, heavy(cube, 0.999 * most), grasp_type="palms"))
    with refused("carriages of two_allegro_hands carry 200 N"):
        seeder_for(GraspTask.create(pair, heavy(cube, 1.001 * most), grasp_type="palms"))


@pytest.mark.slow
def test_what_two_hands_hold_is_lifted_turned_and_tilted(plan: GraspPlan) -> None:
    turn, tilt = np.deg2rad(45.0), np.deg2rad(20.0)
    report = simulate(plan, timeline=Timeline.quick(lift_height=0.2, turn=turn, tilt=tilt))
    assert report.success, report.verdict.detail
    poses = report.recording.T_world_object[[0, -1]]
    begin, end = (pose_from_wxyz(pose[:3], pose[3:]) for pose in poses)
    assert end.translation - begin.translation == pytest.approx([0, 0, 0.2], abs=5e-3)
    wanted = pin.utils.rotate("x", tilt) @ pin.utils.rotate("z", turn)
    off = pin.log3(end.rotation @ begin.rotation.T @ wanted.T)
    assert float(np.linalg.norm(off)) < np.deg2rad(1.0)


def test_what_two_hands_cannot_do_is_refused_by_name(pair: Hand, plan: GraspPlan) -> None:
    with refused("weighs 392 N, and the carriages"):
        seeder_for(GraspTask.create(pair, heavy("box:0.3x0.3x0.3", 40.0), grasp_type="palms"))
    with refused("cannot reach around the object together"):
        seeder_for(GraspTask.create(pair, heavy("box:0.3x1.5x0.3", 1.0), grasp_type="palms"))
    cube = heavy("box:0.2x0.2x0.2", 1.0)
    onto_a_corner = pin.Quaternion.FromTwoVectors(np.array([0.0, 1.0, 0.0]), np.ones(3)).matrix()
    base = SE3(onto_a_corner, np.zeros(3))
    leaning = GraspTask.create(pair, cube, table_height=None, T_world_base=base)
    with refused("no side of the object looks towards the hands"):
        seeder_for(leaning).draw(np.random.default_rng(0))
    with pytest.raises(TaskError, match="palms takes two hands, and allegro_hand is one"):
        GraspTask.create("allegro_hand", "box", grasp_type="palms")
    with refused("a motion takes one hand, and two_allegro_hands is two"):
        check_task(plan.task, 1e-3, 0)
    with refused("a trial with sensor errors takes one hand"):
        simulate(plan, error_model="lab")
    assert "is two" in unsuitable_for_dexgraspbench(pair)


Change = Callable[[str], str]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda t: t.replace('name = "left"', 'name = "right"'), "both hands are called 'right'"),
        (lambda t: t.replace("[0.0, 0.25, 0.0]", "[0.0, -0.3, 0.0]"), "does not look towards"),
        (lambda t: t.replace("allegro_hand_left", "nobody"), "nobody/hand.toml, which does not"),
        (lambda t: t.replace("allegro_hand_left", "allegro_on_arm7"), "is on an arm and the"),
        (lambda t: t.replace("allegro_hand_left", "two_shadow_hands"), "which is two hands itself"),
        (lambda t: t + "\n[carriage]\nforce = -1.0\n", "carriage.force"),
        (
            lambda t: t.replace("0.0, 0.0, -0.7071067811865476", "0.0, 0.0, 0.0").replace(
                "[0.7071067811865476, 0.0, 0.0, 0.0]", "[0.0, 0.0, 0.0, 0.0]"
            ),
            "quaternion_wxyz of 'left' has no length",
        ),
    ],
)
def test_descriptions_with_faults_are_refused(change: Change, message: str, tmp_path: Path) -> None:
    hands = models_dir() / "hands"
    text = (hands / "two_allegro_hands" / "hand.toml").read_text(encoding="utf-8")
    path = tmp_path / "hand.toml"
    path.write_text(change(text).replace("../", f"{hands}/"), encoding="utf-8")
    with pytest.raises(HandError, match=message):
        load_hand(path)


def test_palms_touch_next_to_the_middle_of_both(plan: GraspPlan) -> None:
    """Fingertips, which press with 1.5 N, do not draw the palms' contacts to the palms' ends."""
    palms = {side.palm_body for side in plan.task.hand.pair}
    middling = pad_contact_queries(plan.task).middling
    assert {plan.task.finger_names[i] for i in middling} == palms


def test_two_weak_hands_hold_with_half_the_reserve() -> None:
    """A grip that tips of the Shadow-type pair lack is halved; friction still bears the weight."""
    mass = 3.2
    task = GraspTask.create("two_shadow_hands", heavy("box:0.368x0.328x0.404", mass))
    found = plan_grasp(task, seed=11)
    whole = 2 * mass * GRAVITY / (task.mu * len(found.task.finger_names))
    assert found.task.is_of_fingertips
    assert found.task.grip_force == pytest.approx(whole / 2)
    normals = found.contacts.forces[:, 0]
    assert normals.min() >= whole / 2 - 1e-6
    assert task.mu * normals.sum() > mass * GRAVITY


def test_two_hands_keep_the_whole_reserve_where_they_have_it(plan: GraspPlan) -> None:
    assert plan.task.grip_force == pytest.approx(MASS * GRAVITY / plan.task.mu, rel=1e-3)
