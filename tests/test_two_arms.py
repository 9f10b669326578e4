"""Two hands on two arms: kinematics, starts, torques and clearances, each against MuJoCo's."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pinocchio as pin
import pytest

from planner import GraspTask, plan_grasp
from planner.collision.arm_path import PAIR_LIFT_HEIGHT, _load, lift_height, onto_arms
from planner.collision.pair_table import PairTable
from planner.collision.pregrasp import Approach
from planner.collision.world import CollisionWorld
from planner.errors import HandError, TaskError
from planner.failure import Failure
from planner.files import read_plan, write_plan
from planner.hand_loading import load_hand
from planner.hands.hand import Hand
from planner.kinematics import straight_path
from planner.motion.handover import plan_handover
from planner.objects import GraspObject, parse_object
from planner.plan import GraspPlan
from planner.spatial import SE3, FloatArray
from planner.synthesis.seeds import seeder_for
from planner.system.package import models_dir
from planner.task import Obstacle
from planner.verification import lift_torques, verify_grasp
from sim import Timeline, simulate
from sim.scene.build import HAND_PREFIX, Scene, build_scene

ARMS = "allegro_on_arm7+allegro_on_arm7"
BOX, MASS = "box:0.3x0.2x0.2", 2.0

pytestmark = pytest.mark.usefixtures("coarse_steps")


def heavy(spec: str, mass: float) -> GraspObject:
    return replace(parse_object(spec), mass=mass)


@pytest.fixture(scope="module")
def arms() -> Hand:
    return load_hand(ARMS)


@pytest.fixture(scope="module")
def task(arms: Hand) -> GraspTask:
    return GraspTask.create(arms, heavy(BOX, MASS), grasp_type="palms")


@pytest.fixture(scope="module")
def plan(task: GraspTask) -> GraspPlan:
    return plan_grasp(task, seed=0)


def placed(hand: Hand, q: FloatArray, T_world_base: SE3 | None = None) -> Callable[[str], SE3]:
    """MuJoCo's poses of bodies, by name."""
    data = mujoco.MjData(hand.mj_model)
    data.qpos[:] = q
    mujoco.mj_kinematics(hand.mj_model, data)
    base = T_world_base or SE3.Identity()

    def pose(name: str) -> SE3:
        body = data.body(name)
        return base * SE3(body.xmat.reshape(3, 3).copy(), body.xpos.copy())

    return pose


def test_arms_stand_opposite_each_other_with_a_palm_each(arms: Hand) -> None:
    pose, alone = placed(arms, arms.at_rest), load_hand("allegro_on_arm7")
    there = placed(alone, alone.at_rest)("palm").translation
    for side, sign in zip(arms.sides, (1.0, -1.0), strict=True):
        root = pose(f"{side.name}/arm/base")
        assert root.translation == pytest.approx([0.0, -sign * 0.6, 0.0], abs=1e-9)
        assert root.rotation @ [1.0, 0.0, 0.0] == pytest.approx([0.0, sign, 0.0], abs=1e-9)
        assert root.homogeneous == pytest.approx(side.T_base_root.homogeneous, abs=1e-9)
        # the palm is where the arm alone has it, seen from its root
        assert root.actInv(pose(side.palm_body).translation) == pytest.approx(there, abs=1e-9)
        names = [arms.joint_names[k] for k in side.carriage]
        assert names == [f"{side.name}/arm/joint{k}" for k in range(1, 8)]
    assert arms.nq == 2 * alone.nq
    assert arms.on_arm
    assert len(arms.arm_index) == 14
    limits = arms.actuation.torque_limits(arms.at_rest)[arms.pair[1].carriage]
    assert limits[:, 1] == pytest.approx([87.0] * 4 + [12.0] * 3)


def test_a_file_places_arms(tmp_path: Path) -> None:
    path = tmp_path / "hand.toml"
    path.write_text(described(), encoding="utf-8")
    pair = load_hand(path)
    pose = placed(pair, pair.at_rest)
    assert pose("right/arm/base").translation == pytest.approx([-0.4, -0.4, 0.05])
    assert pose("left/arm/base").translation == pytest.approx([-0.4, 0.4, 0.05])
    assert pose("left/arm/base").rotation == pytest.approx(np.eye(3), abs=1e-12)


def described(second: str = "allegro_on_arm7", place: str = "[-0.4, 0.4, 0.05]") -> str:
    folder, turn = models_dir() / "hands", "quaternion_wxyz = [1.0, 0.0, 0.0, 0.0]"
    first = f'hand = "{folder}/allegro_on_arm7/hand.toml"\nposition = [-0.4, -0.4, 0.05]\n{turn}'
    other = f'hand = "{folder}/{second}/hand.toml"\nposition = {place}\n{turn}'
    return (
        'schema = 1\nname = "arms"\n'
        f'[[hands]]\nname = "right"\n{first}\n[[hands]]\nname = "left"\n{other}\n'
    )


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (described("allegro_hand"), "allegro_on_arm7 is on an arm and the other hand is not"),
        (described(place="[-0.4, -0.3, 0.05]"), "stand in one place; move them apart"),
        (described(place="[-0.4, -0.4, 1.05]"), "one arm stands above the other"),
    ],
)
def test_descriptions_with_faults_are_refused(text: str, message: str, tmp_path: Path) -> None:
    path = tmp_path / "hand.toml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(HandError, match=message):
        load_hand(path)


def test_on_carriages_palms_face_each_other_with_the_last_links(arms: Hand) -> None:
    pair = arms.on_carriages
    assert pair is not None
    assert not pair.on_arm
    pose = placed(pair, pair.neutral)
    for side, sign in zip(pair.sides, (1.0, -1.0), strict=True):
        palm, link = pose(side.palm_body), pose(f"{side.name}/arm/link7")
        assert palm.translation == pytest.approx([0.0, -sign * 0.25, 0.0], abs=1e-9)
        assert palm.rotation @ side.palm_normal == pytest.approx([0.0, sign, 0.0], abs=1e-9)
        # as the arm's ready posture has it: the last link above, its axis straight down
        assert link.rotation[:, 2] == pytest.approx([0.0, 0.0, -1.0], abs=1e-4)
        assert link.translation[2] > palm.translation[2]
    names = {g.name for g in pair.geometries if "arm/" in g.name}
    assert names == {"first/arm/link7", "second/arm/link7"} == pair.arm_geometries


@pytest.mark.parametrize("seed", range(4))
def test_arms_bring_palms_and_fingers_where_carriages_have_them(seed: int, task: GraspTask) -> None:
    start = seeder_for(task).draw(np.random.default_rng(seed))
    assert not isinstance(start, Failure)
    base = task.T_world_object * start.T_object_base
    q = onto_arms(CollisionWorld(task), base, start.q)
    assert not isinstance(q, Failure)
    hand, pair = task.hand, task.on_carriages.hand
    arms, carriages = placed(hand, q, task.T_world_base), placed(pair, start.q, base)
    for side in pair.sides:
        tips = [pair.fingers[name].pad.geom for name in side.fingers]
        bodies = [side.palm_body, *(g.body for g in pair.geometries if g.name in tips)]
        for body in bodies:
            wanted, there = carriages(body), arms(body)
            assert there.translation == pytest.approx(wanted.translation, abs=5e-5), body
            assert pin.log3(there.rotation.T @ wanted.rotation) == pytest.approx(
                np.zeros(3), abs=2e-4
            )
    assert (q >= hand.q_lower).all()
    assert (q <= hand.q_upper).all()


def test_palms_rise_straight_together(plan: GraspPlan) -> None:
    hand, arm = plan.task.hand, plan.arm
    assert arm is not None
    assert lift_height(hand) == PAIR_LIFT_HEIGHT == 0.2
    q, begin = plan.q.copy(), placed(hand, plan.q, plan.T_world_base)
    shares = np.linspace(0.0, 1.0, len(arm.lift))
    for share, posture in zip(shares, arm.lift, strict=True):
        q[hand.arm_index] = posture
        now = placed(hand, q, plan.T_world_base)
        for side in hand.sides:
            moved = now(side.palm_body).translation - begin(side.palm_body).translation
            assert moved == pytest.approx([0.0, 0.0, 0.2 * share], abs=1e-4)
            turn = begin(side.palm_body).rotation.T @ now(side.palm_body).rotation
            assert pin.log3(turn) == pytest.approx(np.zeros(3), abs=5e-4)


def test_each_palm_goes_its_own_way(plan: GraspPlan) -> None:
    hand, q = plan.task.hand, plan.q.copy()
    ways = np.array([[0.0, -0.04, 0.03], [0.03, 0.04, 0.0]])
    path = straight_path(hand, q, ways)
    assert path is not None
    begin = placed(hand, q)
    q[hand.arm_index] = path[-1]
    end = placed(hand, q)
    for side, way in zip(hand.sides, ways, strict=True):
        moved = end(side.palm_body).translation - begin(side.palm_body).translation
        assert moved == pytest.approx(way, abs=1e-4)


def scene_at(plan: GraspPlan, posture: FloatArray, lifted: float) -> tuple[mujoco.MjData, Scene]:
    """MuJoCo's scene with arms at a posture (14,), the object lifted, and contacts found."""
    scene = build_scene(plan.task, T_world_base=plan.T_world_base, q=plan.q)
    q = plan.q.copy()
    q[plan.task.hand.arm_index] = posture
    there = plan.task.T_world_object
    there = SE3(there.rotation, there.translation + np.array([0.0, 0.0, lifted]))
    data = mujoco.MjData(scene.model)
    data.qpos[:] = scene.posed(q, plan.T_world_base, there)
    mujoco.mj_forward(scene.model, data)
    return data, scene


def pressing(plan: GraspPlan, k: int) -> tuple[FloatArray, FloatArray]:
    """Torques (14,) of weight, and of the contact forces, at row k of the lift, by MuJoCo."""
    assert plan.arm is not None
    lifted = 0.2 * k / (len(plan.arm.lift) - 1)
    data, scene = scene_at(plan, plan.arm.lift[k], lifted)
    index, torque = scene.hand_dof[plan.task.hand.arm_index], np.zeros(data.model.nv)
    forces = plan.contacts.forces_in_axes()
    for i, finger in enumerate(plan.task.fingers):
        geom = data.model.geom(HAND_PREFIX + finger.pad.geom)
        linear, angular = np.zeros((2, 3, data.model.nv))
        point = plan.contacts.positions[i] + [0.0, 0.0, lifted]
        mujoco.mj_jac(data.model, data, linear, angular, point, int(geom.bodyid[0]))
        twist = plan.contacts.forces[i, 3] * plan.contacts.normals[i]
        torque += linear.T @ forces[i] + angular.T @ twist
    return np.array(data.qfrc_bias[index]), torque[index]


def test_arms_bear_what_they_press_with_up_to_the_limits_of_their_motors(plan: GraspPlan) -> None:
    """The share of the forces at which a motor first ends the lift is MuJoCo's."""
    hand, arm = plan.task.hand, plan.arm
    assert arm is not None
    weight, press = pressing(plan, 0)
    own = plan.forces.joint_torques[hand.arm_index]
    assert weight + press == pytest.approx(own, abs=0.02)
    limits = hand.actuation.torque_limits(plan.q)[hand.arm_index]
    shares = []
    for k in range(len(arm.lift)):
        weight, press = pressing(plan, k)
        ends = np.where(press > 0.0, limits[:, 1], limits[:, 0]) - weight
        shares.append((ends / press)[np.abs(press) > 0.1].min())
    most = min(shares)
    assert most > 1.0
    for share, holds in ((0.98 * most, True), (1.02 * most, False)):
        contacts = replace(plan.contacts, forces=share * plan.contacts.forces)
        found = lift_torques(plan.task, plan.T_world_base, plan.q, contacts, arm.lift)
        assert (found is None) == holds
    assert found is not None
    assert found.kind == "arm_torque"
    assert "arm/A_joint" in found.text and "beyond its limits [" in found.text


def test_what_an_arm_uses_of_its_motors_is_mujocos(plan: GraspPlan) -> None:
    """Its weight and the grip at its palm, as the largest share of a motor."""
    for side in plan.task.hand.pair:
        alone, q = side.alone, plan.q[side.joints]
        data = mujoco.MjData(alone.mj_model)
        data.qpos[:] = q
        mujoco.mj_forward(data.model, data)
        palm, rates = data.body(alone.description.palm_body), np.zeros((3, data.model.nv))
        mujoco.mj_jac(data.model, data, rates, None, palm.xpos, palm.id)
        press = plan.task.grip_force * palm.xmat.reshape(3, 3) @ alone.palm_normal
        used = np.abs(data.qfrc_bias + press @ rates) / alone.actuation.torque_limits(q)[:, 1]
        root = plan.T_world_base * side.T_base_root
        most = used[alone.arm_index].max()
        assert _load(plan.task, side, root, q) == pytest.approx(most, rel=1e-6)


def test_pairs_of_both_hands_are_known(task: GraspTask) -> None:
    table = PairTable.of(task)
    for pair, between, of_arm in zip(table.named, table.between_hands, table.of_arm, strict=True):
        ones = {name.split("/")[0].split("_")[0] for name in pair}
        assert between == (ones == {"first", "second"}), pair
        links = [n for n in pair if "/arm/" in n and not n.endswith("link7")]
        assert of_arm == bool(links), pair


def test_nothing_of_either_arm_touches_along_the_lift(plan: GraspPlan) -> None:
    """MuJoCo's contacts on the whole way: the pads on the object, and nothing of the arms."""
    assert plan.arm is not None
    for k in range(0, len(plan.arm.lift), 4):
        data, _ = scene_at(plan, plan.arm.lift[k], 0.2 * k / (len(plan.arm.lift) - 1))
        for contact in data.contact:
            names = [data.model.geom(int(g)).name for g in contact.geom]
            if any("/arm/" in name for name in names):
                assert contact.dist > -1e-3, names


@pytest.mark.parametrize("fault", ["meets the object", "meets the other arm", "flips"])
def test_a_path_that_is_wrong_is_refused(fault: str, plan: GraspPlan) -> None:
    assert plan.arm is not None
    lift, index = plan.arm.lift.copy(), plan.task.hand.arm_index
    if fault == "meets the object":
        lift[:, 3] -= np.linspace(0.0, 0.3, len(lift))
    elif fault == "meets the other arm":
        lift[:, 0] += np.linspace(0.0, 0.6, len(lift))
    else:
        lift[10:] += 0.5
    assert len(index) == lift.shape[1]
    way = replace(approach_of(plan), arm=replace(plan.arm, lift=lift))
    found = verify_grasp(plan.task, plan.T_world_base, plan.q, record=plan.record, approach=way)
    assert isinstance(found, Failure)
    assert found.kind == "arm_path"


def approach_of(plan: GraspPlan) -> Approach:
    return Approach(
        q=plan.q_pregrasp,
        pregrasp_distance=plan.pregrasp_distance,
        T_world_base_start=plan.T_world_base_start,
        arm=plan.arm,
    )


def test_an_obstacle_in_an_elbow_s_way_is_noticed(plan: GraspPlan) -> None:
    assert plan.arm is not None
    q = plan.q.copy()
    q[plan.task.hand.arm_index] = plan.arm.lift[-1]
    elbow = placed(plan.task.hand, q, plan.T_world_base)("second/arm/link4").translation
    block = Obstacle(name="block", size=np.full(3, 0.02), T_world_obstacle=SE3(np.eye(3), elbow))
    there = replace(plan.task, obstacles=(block,))
    found = verify_grasp(
        there, plan.T_world_base, plan.q, record=plan.record, approach=approach_of(plan)
    )
    assert isinstance(found, Failure)
    assert "block" in found.text


def test_a_file_gives_the_same_plan_again(plan: GraspPlan, tmp_path: Path) -> None:
    path = tmp_path / "plan.json"
    write_plan(plan, path)
    again = read_plan(path)
    assert again.arm is not None
    assert plan.arm is not None
    assert again.task.hand.digest == plan.task.hand.digest
    assert again.q == pytest.approx(plan.q, abs=0.0)
    assert again.arm.lift == pytest.approx(plan.arm.lift, abs=0.0)


def test_two_arms_lift_and_hold(plan: GraspPlan) -> None:
    report = simulate(plan, timeline=Timeline.quick(lift_height=0.2))
    assert report.success, str(report)
    assert report.carried_by == "arm"
    assert report.samples.lift_mm[-1] == pytest.approx(200.0, abs=5.0)


@pytest.mark.parametrize(
    ("changes", "message"),
    [({"turn": 0.5}, "lifts without turning"), ({"lift_height": 0.3}, "a plan lifts by 0.2 m")],
)
def test_what_arms_do_not_do_is_refused(
    changes: dict[str, float], message: str, plan: GraspPlan
) -> None:
    with pytest.raises(TaskError, match=message):
        simulate(plan, timeline=Timeline.quick(**changes))


def test_the_closed_loop_of_two_arms_is_refused_by_name(plan: GraspPlan) -> None:
    with pytest.raises(TaskError, match="commands two hands on carriages"):
        simulate(plan, controller="impedance")


@pytest.mark.parametrize(
    ("spec", "base", "message"),
    [
        ("box:0.3x1.5x0.3", [0.0, 0.0, 0.0], "in the way: .*/arm/.* - object"),
        (BOX, [1.5, 0.0, 0.0], "comes no nearer than"),
    ],
)
def test_out_of_reach_together_is_said_at_once(
    spec: str, base: list[float], message: str, arms: Hand
) -> None:
    there = SE3(np.eye(3), np.array(base))
    task = GraspTask.create(arms, heavy(spec, MASS), T_world_base=there)
    begin = time.process_time()
    with pytest.raises(TaskError, match=f"cannot reach the object together: .*{message}"):
        plan_grasp(task)
    assert time.process_time() - begin < 4.0  # 1.6 s; twice that beside other work


def test_a_handover_takes_hands_on_carriages(arms: Hand) -> None:
    task = GraspTask.create(arms, parse_object("box:0.06x0.06x0.16"))
    with pytest.raises(TaskError, match="a handover takes hands on carriages"):
        plan_handover(task)
