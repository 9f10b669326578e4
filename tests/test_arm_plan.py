"""Grasps by a hand on an arm: the plan, its paths, its file, and its execution."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import mujoco
import numpy as np
import pinocchio as pin
import pytest
from conftest import PlanOf
from manipulations import QUICK, task_of

from planner.collision.arm_path import LIFT_HEIGHT, _Radii, verify_arm_path, verify_lift
from planner.collision.pair_table import Clearance, PairTable
from planner.collision.pregrasp import APPROACH_CLEARANCE, Approach, verify_approach
from planner.collision.world import CollisionWorld
from planner.errors import FileFormatError, NoGraspFoundError, TaskError
from planner.failure import Failure
from planner.files import read_plan, write_plan
from planner.files.movements import manipulation_from_dict, movement_to_dict
from planner.hands.hand import Hand
from planner.kinematics import (
    ARM_RATE,
    BRAKING,
    PATH_STEP,
    PEAK,
    HandState,
    palm_path,
    palm_pose,
    posture_times,
)
from planner.motion.context import OUT_OF_REACH
from planner.motion.manipulation import (
    GAITS,
    ManipulationPlan,
    plan_manipulation,
    plan_regrasping,
)
from planner.motion.on_arm import ARM_CLEARANCE, POSTURES, SHORT, OnArm, lifted_blocked
from planner.motion.path import ATTITUDES, ObjectPath
from planner.motion.plan import CLEAR, rise_for
from planner.motion.single_stroke import plan_single_stroke
from planner.objects import GraspObject
from planner.plan import GraspPlan
from planner.search.attempt import Attempt
from planner.spatial import SE3, FloatArray, interpolate_path, minimum_jerk, rotation_angle
from planner.task import GraspTask, Obstacle
from sim.manipulation import manipulate
from sim.scene.build import build_scene
from sim.scene.carrier import ArmCarrier, Timeline
from sim.simulation import Simulation
from sim.trial import Trial

pytestmark = pytest.mark.usefixtures("coarse_steps")


@pytest.fixture(scope="module")
def plan(plan_of: PlanOf) -> GraspPlan:
    return plan_of("allegro_on_arm7", "sphere")


@pytest.fixture(scope="module")
def paths(plan: GraspPlan) -> tuple[FloatArray, FloatArray]:
    assert plan.arm is not None
    return plan.arm.approach, plan.arm.lift


def palm_by_mujoco(plan: GraspPlan, q: FloatArray) -> SE3:
    """Pose of the palm in the world by the other engine."""
    hand: Hand = plan.task.hand
    data = mujoco.MjData(hand.mj_model)
    data.qpos[:] = q
    mujoco.mj_kinematics(hand.mj_model, data)
    palm = data.body(hand.description.palm_body)
    return plan.T_world_base * SE3(palm.xmat.reshape(3, 3), palm.xpos)


def with_arm(plan: GraspPlan, q: FloatArray, posture: FloatArray) -> FloatArray:
    q = q.copy()
    q[plan.task.hand.arm_index] = posture
    return q


def test_the_palm_is_where_the_arm_puts_it(plan: GraspPlan) -> None:
    assert plan.task.T_world_base is not None
    np.testing.assert_allclose(
        plan.T_world_base.homogeneous, plan.task.T_world_base.homogeneous, atol=1e-12
    )
    expected = palm_by_mujoco(plan, plan.q).homogeneous
    np.testing.assert_allclose(plan.T_world_palm.homogeneous, expected, atol=1e-10)
    assert (np.abs(plan.verification.pad_gaps) <= 5e-4).all()


def test_every_posture_is_within_the_limits(
    plan: GraspPlan, paths: tuple[FloatArray, FloatArray]
) -> None:
    hand = plan.task.hand
    index = hand.arm_index
    for posture in (*paths[0], *paths[1], plan.q[index], plan.q_pregrasp[index]):
        assert (posture >= hand.q_lower[index]).all()
        assert (posture <= hand.q_upper[index]).all()


def test_the_palm_comes_straight_in_and_lifts_straight_up(
    plan: GraspPlan, paths: tuple[FloatArray, FloatArray]
) -> None:
    approach, lift = (
        [palm_by_mujoco(plan, with_arm(plan, plan.q, posture)) for posture in path]
        for path in paths
    )
    grasp = plan.T_world_palm
    up = lift[-1].translation - grasp.translation
    np.testing.assert_allclose(up, [0, 0, LIFT_HEIGHT], atol=1e-4)
    back = approach[0].translation - grasp.translation
    assert np.linalg.norm(back) == pytest.approx(0.12, abs=1e-4)
    for path, way in ((approach[::-1], back), (lift, up)):
        for share, pose in zip(np.linspace(0, 1, len(path)), path, strict=True):
            off = pose.translation - grasp.translation - share * way
            assert np.linalg.norm(off) < 1e-4
            assert rotation_angle(grasp.rotation.T @ pose.rotation) < 1e-3
    hand = plan.task.hand
    np.testing.assert_array_equal(plan.q_start[hand.arm_index], paths[0][0])
    np.testing.assert_allclose(paths[0][-1], plan.q_pregrasp[hand.arm_index], atol=1e-9)


def test_nothing_is_near_between_the_postures(
    plan: GraspPlan, paths: tuple[FloatArray, FloatArray]
) -> None:
    world = CollisionWorld(plan.task)
    for posture in interpolate_path(paths[0], np.linspace(0, 1, 150)):
        q = with_arm(plan, plan.q_pregrasp, posture)
        near = world.nearest_on_arm(plan.T_world_base, q)
        assert near.distance >= APPROACH_CLEARANCE - 5e-4, near


def test_a_thin_wall_between_two_postures_is_found(
    plan: GraspPlan, paths: tuple[FloatArray, FloatArray]
) -> None:
    """The palm crosses a plate of 0.2 mm in one step from far on one side to the other."""
    hand = plan.task.hand
    far = paths[1][-1].copy()
    far[0] += 0.8
    path = np.array([paths[1][-1], far])
    ends = [plan.T_world_base * palm_pose(hand, with_arm(plan, plan.q, p)) for p in path]
    middle = (ends[0].translation + ends[1].translation) / 2
    way = ends[1].translation - ends[0].translation
    turn = np.arctan2(way[1], way[0])
    rotation = np.array(
        [[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1]]
    )
    plate = Obstacle(
        name="plate",
        size=np.array([0.0002, 0.01, 0.01]),
        T_world_obstacle=SE3(rotation, middle + np.array([0, 0, 0.03])),
    )
    task = dataclasses.replace(plan.task, obstacles=(plate,))
    q = with_arm(plan, plan.q, path[0])
    world, free = CollisionWorld(task), CollisionWorld(plan.task)
    for posture in path:
        at = with_arm(plan, q, posture)
        assert world.proximity(plan.T_world_base, at, "palm", "plate").distance > 0.05
    assert verify_arm_path(free, plan.T_world_base, q, path, clearance=0.001) is None
    assert "plate" in str(verify_arm_path(world, plan.T_world_base, q, path, clearance=0.001))


def test_no_point_moves_farther_than_the_bound(plan: GraspPlan) -> None:
    hand = plan.task.hand
    rng = np.random.default_rng(0)
    index, radii = hand.arm_index, _Radii(hand)
    data = hand.pin_model.createData()

    def corners(q: FloatArray) -> FloatArray:
        pin.forwardKinematics(hand.pin_model, data, q)
        out = []
        for g in hand.geometries:
            box = g.geometry.aabb_local
            for corner in (box.min_, box.max_):
                out.append(data.oMi[g.joint_id].act(g.T_joint_geometry.act(corner)))
        return np.array(out)

    tightest = np.inf
    for _ in range(50):
        q = plan.q.copy()
        q[index] = rng.uniform(hand.q_lower[index], hand.q_upper[index])
        step = np.zeros(hand.nq)
        step[index] = rng.normal(0, 0.1, len(index)) * (rng.random(len(index)) < 0.4)
        moved = np.linalg.norm(corners(q + step) - corners(q), axis=1).max()
        bound = np.abs(step[index]) @ radii.at(q)
        assert moved <= bound + 1e-12
        if bound > 0:
            tightest = min(tightest, bound / max(moved, 1e-12))
    assert tightest < 1.6  # the bound is worth something


def test_a_lift_into_an_obstacle_is_refused(
    plan: GraspPlan, paths: tuple[FloatArray, FloatArray]
) -> None:
    top = palm_by_mujoco(plan, with_arm(plan, plan.q, paths[1][-1]))
    beam = Obstacle(
        name="beam",
        size=np.array([0.02, 0.02, 0.02]),
        T_world_obstacle=SE3(np.eye(3), top.translation),
    )
    world = CollisionWorld(dataclasses.replace(plan.task, obstacles=(beam,)))
    assert "beam" in str(verify_lift(world, plan.T_world_base, plan.q, paths[1]))
    free = CollisionWorld(plan.task)
    assert verify_lift(free, plan.T_world_base, plan.q, paths[1]) is None


def test_an_object_too_heavy_for_the_arm_is_refused(
    plan: GraspPlan, paths: tuple[FloatArray, FloatArray]
) -> None:
    heavy = GraspObject(name="lead", shape=plan.task.object.shape, mass=40.0)
    world = CollisionWorld(dataclasses.replace(plan.task, object=heavy))
    fault = str(verify_lift(world, plan.T_world_base, plan.q, paths[1]))
    assert "arm/A_joint" in fault
    assert "beyond its limits" in fault


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ("jump", "path jumps"),
        ("bend", "the palm leaves the line"),
        ("limit", "beyond its range"),
        ("cut", "the palm leaves the line"),
        ("away", "does not meet the grasp"),
        ("flat", "needs rows of 7 joints"),
    ],
)
def test_a_lift_that_is_none_is_refused(
    plan: GraspPlan, paths: tuple[FloatArray, FloatArray], change: str, message: str
) -> None:
    path = paths[1].copy()
    if change == "jump":
        path[5, 0] += 0.5
    elif change == "bend":
        path[5, 0] += 0.02
    elif change == "limit":
        path[-1, 3] = 0.0
    elif change == "cut":
        path = path[:-3]
    elif change == "away":
        path[0, 0] += 0.01
    else:
        path = path.ravel()
    world = CollisionWorld(plan.task)
    assert message in str(verify_lift(world, plan.T_world_base, plan.q, path))


def test_an_approach_by_arm_must_be_complete(plan: GraspPlan) -> None:
    world = CollisionWorld(plan.task)
    approach = Approach(
        q=plan.q_pregrasp,
        pregrasp_distance=plan.pregrasp_distance,
        T_world_base_start=plan.T_world_base,
        arm=plan.arm,
    )
    assert verify_approach(world, plan.T_world_base, plan.q, approach) is None
    without = dataclasses.replace(approach, arm=None)
    assert "missing" in str(verify_approach(world, plan.T_world_base, plan.q, without))
    q = plan.q_pregrasp.copy()
    q[1] += 0.01
    moved = dataclasses.replace(approach, q=q)
    assert "while the fingers close" in str(
        verify_approach(world, plan.T_world_base, plan.q, moved)
    )
    shifted = SE3(np.eye(3), plan.T_world_base.translation + np.array([0, 0, 0.1]))
    rolling = dataclasses.replace(approach, T_world_base_start=shifted)
    assert "root of the arm moves" in str(
        verify_approach(world, plan.T_world_base, plan.q, rolling)
    )


def test_the_root_of_the_arm_may_stand_on_the_table_and_the_object_stays(plan: GraspPlan) -> None:
    world = CollisionWorld(plan.task)
    pairs = {(c.first, c.second) for c in world.distances(plan.T_world_base, plan.q)}
    assert ("arm/base", "table") not in pairs
    assert ("arm/link2", "table") in pairs
    assert ("arm/base", "object") in pairs
    before = world.distances(plan.T_world_base, plan.q)
    lifted = SE3(np.eye(3), plan.task.T_world_object.translation + np.array([0, 0, 1.0]))
    world.nearest_on_arm(plan.T_world_base, plan.q, T_world_object=lifted)
    assert world.distances(plan.T_world_base, plan.q) == before


def test_a_plan_file_keeps_the_paths(plan: GraspPlan, tmp_path: Path) -> None:
    path = tmp_path / "plan.json"
    write_plan(plan, path)
    again = read_plan(path)
    assert plan.arm is not None
    assert again.arm is not None
    np.testing.assert_array_equal(again.arm.approach, plan.arm.approach)
    np.testing.assert_array_equal(again.arm.lift, plan.arm.lift)


def _drop(arm: dict[str, Any]) -> None:
    arm["lift_q_rad"] = []


def _swap(arm: dict[str, Any]) -> None:
    arm["joint_names"] = arm["joint_names"][::-1]


def _shake(arm: dict[str, Any]) -> None:
    arm["approach_q_rad"][3][0] += 0.05


def _short(arm: dict[str, Any]) -> None:
    arm["lift_q_rad"][2] = arm["lift_q_rad"][2][:-1]


@pytest.mark.parametrize("damage", [_drop, _swap, _shake, _short])
def test_damaged_paths_are_refused(plan: GraspPlan, tmp_path: Path, damage: Any) -> None:
    path = tmp_path / "plan.json"
    write_plan(plan, path)
    data = json.loads(path.read_text())
    damage(data["grasp"]["arm"])
    path.write_text(json.dumps(data))
    with pytest.raises(FileFormatError):
        read_plan(path)


def test_a_plan_without_its_paths_is_refused(plan: GraspPlan, tmp_path: Path) -> None:
    path = tmp_path / "plan.json"
    write_plan(plan, path)
    data = json.loads(path.read_text())
    del data["grasp"]["arm"]
    path.write_text(json.dumps(data))
    with pytest.raises(FileFormatError, match="way in and lift are missing"):
        read_plan(path)


def test_the_trajectory_moves_the_arm_in(
    plan: GraspPlan, paths: tuple[FloatArray, FloatArray]
) -> None:
    trajectory = plan.joint_trajectory()
    np.testing.assert_allclose(trajectory.positions[0], plan.q_start, atol=1e-12)
    np.testing.assert_allclose(trajectory.positions[-1], plan.q, atol=1e-12)
    assert np.abs(np.diff(trajectory.positions, axis=0)).max() < 0.1


def test_the_scene_has_no_gantry(plan: GraspPlan) -> None:
    scene = build_scene(plan.task, T_world_base=plan.T_world_base, q=plan.q)
    assert scene.gantry is None
    assert scene.model.nq == plan.task.hand.nq + 7
    names = [scene.model.actuator(int(i)).name for i in scene.arm_ctrl]
    assert names == [f"hand/arm/A_joint{k}" for k in range(1, 8)]
    data = scene.start(plan.q, plan.T_world_base)
    palm = scene.body_pose(data, scene.palm_body)
    np.testing.assert_allclose(palm.homogeneous, plan.T_world_palm.homogeneous, atol=1e-9)


def test_rates_are_the_derivative_of_the_motion(plan: GraspPlan) -> None:
    assert plan.arm is not None
    scene = build_scene(plan.task, T_world_base=plan.T_world_base)
    timeline = Timeline()
    carrier = ArmCarrier(plan, plan.arm, scene, timeline)
    for phase in ("approach", "lift"):
        h = 1e-6
        for share in (0.13, 0.52, 0.91):
            _, rate = carrier.motion(phase, share)
            ends = [carrier.motion(phase, share + s * h)[0] for s in (-1, 1)]
            expected = (ends[1] - ends[0]) / (2 * h) / getattr(timeline, phase)
            np.testing.assert_allclose(rate, expected, atol=1e-6)
    np.testing.assert_allclose(carrier.motion("approach", 1.0)[0], plan.arm.lift[0], atol=1e-9)
    np.testing.assert_allclose(carrier.motion("hold", 0.5)[0], plan.arm.lift[-1], atol=1e-12)


def test_an_approach_that_was_given_up_half_way_is_left_from_there(
    plan: GraspPlan, plan_of: PlanOf
) -> None:
    """Neither arm nor gantry goes on to the grasp while the fingers open."""
    for one in (plan, plan_of("allegro_hand", "box")):
        simulation, timeline = Simulation(one), Timeline()
        carrier: Any = simulation.carrier
        first = carrier.motion("approach", 0.0)[0]
        assert np.allclose(carrier.motion("retreat", 1.0)[0], first)  # of one that was made, too
        carrier.drive(simulation.data, "approach", 0.4)
        there = carrier.motion("approach", 0.4)[0]
        for phase, share in (("open", 0.0), ("open", 0.7), ("retreat", 0.0)):
            at, rate = carrier.motion(phase, share)
            assert np.allclose(at, there) and not rate.any(), phase
        assert np.allclose(carrier.motion("retreat", 1.0)[0], first)
        h, (_, rate) = 1e-6, carrier.motion("retreat", 0.4)
        ends = [carrier.motion("retreat", 0.4 + s * h)[0] for s in (-1, 1)]
        assert np.allclose(rate, (ends[1] - ends[0]) / (2 * h) / timeline.approach, atol=1e-6)


def test_the_arm_holds_the_object_up(plan: GraspPlan) -> None:
    trial = Trial(plan, timeline=Timeline.quick(hold=0.3))
    report = trial.run()
    assert report.success, report.verdict.detail
    assert report.carried_by == "arm"
    assert report.to_dict()["carried_by"] == "arm"
    assert report.samples.lift_mm[-1] == pytest.approx(1e3 * LIFT_HEIGHT, abs=1.0)
    # and the palm is where the plan has it, to the servos' accuracy
    assert plan.arm is not None
    q = with_arm(plan, plan.q, plan.arm.lift[-1])
    at = trial.simulation.scene.body_pose(trial.simulation.data, trial.simulation.scene.palm_body)
    assert np.linalg.norm(at.translation - palm_by_mujoco(plan, q).translation) < 5e-4


def test_a_lift_that_was_not_planned_is_refused(plan: GraspPlan) -> None:
    with pytest.raises(TaskError, match=r"lifts by 0\.2 m; with an arm a plan lifts by 0\.1 m"):
        Trial(plan, timeline=Timeline(lift_height=0.2))
    for turned in (Timeline(turn=0.1), Timeline(tilt=0.1)):
        with pytest.raises(TaskError, match="lifts without turning"):
            Trial(plan, timeline=turned)


# --- turned in the hand -------------------------------------------------------------------------


@pytest.fixture(scope="module")
def turning() -> ManipulationPlan:
    task = task_of("cylinder:0.03x0.08", "allegro_on_arm7", mass=0.1)
    return plan_manipulation(task, angle=np.deg2rad(45.0), place=(0.03, 0.06), seed=0)


def test_while_the_hand_turns_the_object_its_arm_stands(turning: ManipulationPlan) -> None:
    hand, motion = turning.task.hand, turning.motion
    root = turning.task.T_world_base
    assert root is not None and motion.T_world_base.isApprox(root)
    for knot in motion.knots:
        np.testing.assert_array_equal(knot.q[hand.arm_index], motion.knots[0].q[hand.arm_index])
        # by the other engine: pads of all fingers are where the contacts are
        data = mujoco.MjData(hand.mj_model)
        data.qpos[:] = knot.q
        mujoco.mj_kinematics(hand.mj_model, data)
        for finger, contact in zip(turning.task.fingers, knot.contacts.positions, strict=True):
            body = data.geom(finger.pad.geom)
            off = np.linalg.norm(root.act(body.xpos.copy()) - contact)
            assert off < 0.03, "a fingertip is nearer to its contact than that"


@pytest.mark.slow
def test_the_arm_carries_what_the_hand_turns(turning: ManipulationPlan) -> None:
    arm: dict[str, list[FloatArray]] = {}

    def watch(simulation: Simulation) -> None:
        hand, scene = simulation.plan.task.hand, simulation.scene
        q = simulation.data.qpos[scene.hand_qpos][hand.arm_index].copy()
        arm.setdefault(simulation.phase, []).append(q)

    report = manipulate(turning, timeline=QUICK, on_step=watch)
    assert report.complete and report.success_with_closure, str(report)
    assert np.ptp(arm["turn"], axis=0).max() < 0.01 < 0.05 < np.ptp(arm["lift"], axis=0).max()
    assert np.ptp(arm["carry"], axis=0).max() > 0.05
    trajectory = turning.joint_trajectory()
    steps = np.abs(np.diff(trajectory.positions[:, turning.task.hand.arm_index], axis=0)).max(1)
    phases = np.array(trajectory.phases[1:])
    assert steps[phases == "turn"].max() == 0.0 and steps[phases == "carry"].max() > 0.0
    assert steps.max() < 0.1, "and it never jumps"
    end = with_arm(turning.grasp, trajectory.positions[-1], trajectory.positions[-1][:7])
    target = turning.ending.T_world_target.translation
    assert np.linalg.norm(palm_by_mujoco(turning.grasp, end).translation - target) < 0.4


@pytest.mark.slow
def test_its_file_holds_the_way_out(turning: ManipulationPlan) -> None:
    data = movement_to_dict(turning)
    again = manipulation_from_dict(json.loads(json.dumps(data)), "a file")
    read, out = again.ending.release, turning.ending.release
    assert read is not None and out is not None
    assert read.arm is not None and out.arm is not None
    np.testing.assert_allclose(read.arm.approach, out.arm.approach)
    for rows in data["ending"]["arm_out"]["approach_q_rad"]:
        rows[0] += 0.02
    with pytest.raises(FileFormatError, match="way out fails its checks"):
        manipulation_from_dict(data, "a file")
    data["ending"]["arm_out"] = None
    with pytest.raises(FileFormatError, match="way in and lift are missing"):
        manipulation_from_dict(data, "a file")


@pytest.fixture(scope="module")
def regrasping() -> ManipulationPlan:
    """Two strokes with the palm up."""
    task = task_of("cylinder:0.03x0.08", "allegro_on_arm7", mass=0.1)
    return plan_regrasping(task, angle=np.deg2rad(45.0), place=(0.03, 0.06), attitude="up")


@pytest.mark.slow
def test_an_arm_carries_what_the_hand_turns_by_regrasps(regrasping: ManipulationPlan) -> None:
    """All of the hand on its arm is judged, and the palm is up while fingers move on."""
    hand = regrasping.task.hand
    tilts: list[float] = []
    assert regrasping.cycles == 2 and set(regrasping.order) == set(hand.fingers)
    for one in regrasping.regrasps:
        arm = one.postures[:, hand.arm_index]
        np.testing.assert_array_equal(
            arm, np.tile(regrasping.grasp.q[hand.arm_index], (len(arm), 1))
        )

    def watch(simulation: Simulation) -> None:
        scene = simulation.scene
        palm = scene.body_pose(simulation.data, scene.palm_body).rotation
        tilts.append(rotation_angle(palm @ regrasping.grasp.T_world_palm.rotation.T))

    report = manipulate(regrasping, timeline=QUICK, on_step=watch)
    assert report.complete, str(report)
    phases = [one.phase for one in report.results]
    assert phases.count("regrasp") == len(hand.fingers) and phases.count("wrist back") == 1
    assert max(tilts) > np.deg2rad(175.0)


def test_headings_of_an_arm_are_tried_for_regrasps(monkeypatch: pytest.MonkeyPatch) -> None:
    """Gaits are planned for the hand alone where the arm reaches; what stops it there is told."""
    task = task_of("cylinder:0.03x0.08", "allegro_on_arm7")
    asked: list[tuple[Any, Any]] = []
    record = SimpleNamespace(attempts=1, cpu_s=0.0)

    def gait(alone: GraspTask, **given: Any) -> Any:
        assert alone.hand.arm is None
        asked.append((given["attitude"], given["reaches"]))
        if len(asked) == 1:
            raise NoGraspFoundError("none here", ())
        return SimpleNamespace(record=record)

    at = "planner.motion.manipulation"
    blocked = Failure(kind="arm_collision", text="the table is in the way")
    monkeypatch.setattr(f"{at}.plan_gait", gait)
    monkeypatch.setattr(f"{at}.whole_plan", lambda *_, **__: blocked)
    with pytest.raises(NoGraspFoundError, match="none here; the table is in the way"):
        plan_regrasping(task, angle=2.0, attitude="up")
    ways = {tuple(np.round(pin.log3(turn), 1).tolist()) for turn, _ in asked}
    assert ways == {(3.1, 0.0, 0.0), (-3.1, 0.0, 0.0), (0.0, 3.1, 0.0), (0.0, -3.1, 0.0)}
    assert len(asked) == 1 + 3 * GAITS and all(reaches is not None for _, reaches in asked)
    # at half a turn rounding alone would decide which way around each goes
    angles = np.array([rotation_angle(turn) for turn, _ in asked])
    assert angles == pytest.approx(np.pi - SHORT, abs=1e-7)


@pytest.mark.parametrize(("kind", "times"), [(OUT_OF_REACH, 4), ("penetration", 1)])
def test_a_stroke_is_tried_in_another_attitude_where_the_arm_stops_it(
    monkeypatch: pytest.MonkeyPatch, kind: str, times: int
) -> None:
    task = task_of("cylinder:0.03x0.08", "allegro_on_arm7")
    at = "planner.motion.single_stroke"
    ways = [(task, pin.exp3(np.array([x, 0.0, 0.0])), None, None) for x in (0.1, 0.2, 0.3, 0.4)]
    asked: list[Any] = []

    def attempts(_: Any, path: Any, **__: Any) -> Any:
        asked.append(path)
        failure = Failure(kind=kind, text="-")
        yield Attempt(index=0, plan=None, failure=failure, cpu_s=0.0)

    monkeypatch.setattr(f"{at}.carried_ways", lambda *_: iter(ways))
    monkeypatch.setattr(f"{at}.motion_attempts", attempts)
    with pytest.raises(NoGraspFoundError):
        plan_single_stroke(task, angle=0.5, max_attempts=1)
    assert len({id(path.attitude) for path in asked}) == times


def test_an_arm_is_drawn_until_a_posture_turns_the_hand(
    turning: ManipulationPlan, monkeypatch: pytest.MonkeyPatch
) -> None:
    """All of them bring the palm to the same pose, and no more than ``POSTURES`` are asked."""
    carrier = OnArm(task_of("cylinder:0.03x0.08", "allegro_on_arm7", mass=0.1))
    hand, root = turning.task.hand, turning.task.T_world_base
    assert root is not None
    q = turning.grasp.q[[hand.joint_names.index(n) for n in carrier.alone.hand.joint_names]]
    base = turning.grasp.T_world_palm * HandState(carrier.alone.hand, q).T_base_palm.inverse()
    asked: list[Any] = []
    able = 3

    def turns(self: OnArm, whole: Any, turned: Any) -> bool:
        asked.append(whole)
        return len(asked) >= able

    monkeypatch.setattr(OnArm, "_turns", turns)
    found = carrier._posture(base, q, ATTITUDES["sideways"])
    assert found is not None and len(asked) == 3
    assert not np.allclose(asked[0][hand.arm_index], found[hand.arm_index], atol=0.1)
    for one in asked:
        assert (root * palm_pose(hand, one)).isApprox(turning.grasp.T_world_palm, 1e-4)
    able = 10 * POSTURES
    assert carrier._posture(base, q, ATTITUDES["sideways"]) is None
    assert len(asked) <= 3 + POSTURES


def test_the_links_of_an_arm_keep_5_mm_clear_in_an_attitude(
    turning: ManipulationPlan, monkeypatch: pytest.MonkeyPatch
) -> None:
    carrier = OnArm(task_of("cylinder:0.03x0.08", "allegro_on_arm7", mass=0.1))
    path = np.tile(turning.grasp.q[turning.task.hand.arm_index], (2, 1))
    monkeypatch.setattr("planner.motion.on_arm.arm_way", lambda *_: iter([path] * 9))
    for distance, free in ((ARM_CLEARANCE + 1e-6, True), (ARM_CLEARANCE - 1e-6, False)):
        near = SimpleNamespace(distance=distance)
        carrier.__dict__["_world"] = SimpleNamespace(nearest_on_arm=lambda *_, n=near, **__: n)
        assert carrier._turns(turning.grasp.q, ATTITUDES["sideways"]) is free


def test_an_arm_keeps_5_mm_clear_while_it_turns_the_wrist(
    turning: ManipulationPlan, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = dataclasses.replace(turning.path, attitude=ATTITUDES["sideways"])
    motion = dataclasses.replace(turning.motion, path=path)
    still = np.tile(motion.grasp.q[motion.task.hand.arm_index], (2, 1))
    asked: list[float] = []
    at = "planner.motion.on_arm"
    monkeypatch.setattr(f"{at}.arm_way", lambda *_: iter([still] * 9))
    monkeypatch.setattr(
        f"{at}.verify_arm_path", lambda *_, clearance, **__: asked.append(clearance)
    )
    assert lifted_blocked(motion, 0.1) is None
    assert asked[0] == 0.0 and len(asked) > 1 and set(asked[1:]) == {ARM_CLEARANCE}


def test_an_arm_lifts_its_last_links_clear_of_the_table(turning: ManipulationPlan) -> None:
    """They are below the hand with the palm up; without them link 6 came within 5 mm of it."""
    task, grasp = turning.task, turning.grasp
    up = ObjectPath.of_wrist("up")
    height = rise_for(task, grasp.T_world_base, [grasp.q], up)
    state, center = HandState(task.hand, grasp.q), task.T_world_object.translation
    assert task.table_height is not None
    for share in up.wrist_shares:
        turn = up.wrist(share)
        turned = SE3(turn, center - turn @ center + [0.0, 0.0, height]) * grasp.T_world_base
        for one in task.hand.geometries:
            if one.name in ("arm/link6", "arm/link7"):
                pose = turned * state.joint_pose(one.joint_id) * one.T_joint_geometry
                corners = one.corners @ pose.rotation.T + pose.translation
                assert corners[:, 2].min() > task.table_height + CLEAR - 1e-9
    assert rise_for(task, grasp.T_world_base, [grasp.q], ObjectPath.of_wrist("down")) == 0.0


def test_the_link_that_carries_the_hand_is_of_the_hand(turning: ManipulationPlan) -> None:
    """Its distance from a finger is the same wherever the arm is: 3 mm refused all attitudes."""
    table, arm = PairTable.of(turning.task), turning.task.hand.arm_geometries
    pairs = [set(named) for named, of in zip(table.named, table.of_arm, strict=True) if of]
    assert any("arm/link6" in pair for pair in pairs)
    assert all(pair & (arm - {"arm/link7"}) for pair in pairs)


def test_a_way_without_a_bend_takes_as_long_as_its_fastest_joint_needs() -> None:
    """1 rad at 2 rad/s at most, and 15/8 of the mean rate in the middle: 15/16 s."""
    way = np.linspace([0.0, 0.0], [1.0, 0.2], 5)
    assert np.allclose(posture_times(way, 0.1), np.linspace(0.0, 15 / 16, 5))
    assert np.allclose(posture_times(way, 2.0), np.linspace(0.0, 2.0, 5)), "or as long as asked"


def test_no_joint_of_an_arm_is_faster_than_it_may() -> None:
    """A piece that is long in one joint takes longer, those around it as long as braking takes."""
    even = np.outer(np.arange(201), [0.01, 0.02])
    np.testing.assert_allclose(posture_times(even, 8.0), np.linspace(0.0, 8.0, 201), rtol=1e-9)
    way = even + np.where(np.arange(201) > 100, 0.3, 0.0)[:, None]
    times = posture_times(way, 6.0)
    share = np.linspace(0.0, 1.0, 20001)
    at = np.array([np.interp(minimum_jerk(share), times / times[-1], row) for row in way.T])
    assert np.abs(np.diff(at, axis=1)).max() / (times[-1] * share[1]) < ARM_RATE
    taken = np.diff(times)
    assert taken[0] == pytest.approx(6.0 / 200)
    assert taken[100] == pytest.approx(taken.max()) and taken[100] > 10 * taken[0]
    speeds = PEAK * PATH_STEP / taken
    assert np.abs(np.diff(speeds**2)).max() <= 2 * BRAKING * PATH_STEP * (1 + 1e-9)


def test_what_the_arm_cannot_do_is_refused(turning: ManipulationPlan) -> None:
    task = turning.task
    carrier = OnArm(task_of("cylinder:0.03x0.08", "allegro_on_arm7", mass=0.1))
    far = dataclasses.replace(
        turning.ending,
        T_world_target=SE3(
            turning.ending.T_world_target.rotation,
            turning.ending.T_world_target.translation + np.array([0.6, 0.0, 0.0]),
        ),
    )
    assert carrier.blocked(turning.motion, turning.ending) is None
    blocked = carrier.blocked(turning.motion, far)
    assert blocked is not None and "the arm cannot carry the object" in blocked.text
    hand, q = task.hand, turning.grasp.q
    assert task.T_world_base is not None
    moved = SE3(np.eye(3), np.array([2.0, 0.0, 0.0])) * task.T_world_base
    alone = carrier.alone
    columns = [hand.joint_names.index(name) for name in alone.hand.joint_names]
    palm = HandState(alone.hand, q[columns]).T_base_palm
    base = turning.grasp.T_world_palm * palm.inverse()
    assert carrier.reaches(base, q[columns])
    assert not carrier.reaches(moved * task.T_world_base.inverse() * base, q[columns])


def test_the_way_back_from_an_attitude_is_checked_to_where_it_is_put_down(
    turning: ManipulationPlan, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The arm comes back in another posture, from which it could not carry the object on."""
    asked: list[Any] = []

    def stuck(motion: Any, height: float, via: Any = (), ending: Any = None) -> Failure:
        asked.append(ending)
        return Failure(kind="arm_unreachable", text="no way back")

    monkeypatch.setattr("planner.motion.on_arm.lifted_blocked", stuck)
    carrier = OnArm(task_of("cylinder:0.03x0.08", "allegro_on_arm7", mass=0.1))
    assert carrier.blocked(turning.motion, turning.ending) is None and not asked
    path = dataclasses.replace(turning.path, attitude=ATTITUDES["sideways"])
    motion = dataclasses.replace(turning.motion, path=path)
    found = carrier.blocked(motion, turning.ending)
    assert found is not None and found.text == "no way back" and asked == [turning.ending]


def test_the_way_of_a_carry_is_checked_before_anything_moves(turning: ManipulationPlan) -> None:
    """At the height at which it is made, which is that of the check."""
    motion = turning.motion
    assert lifted_blocked(motion, 0.1, [(0.03, 0.06), (-0.05, 0.06)]) is None
    for height, place, why in ((0.1, (0.9, 0.0), "cannot carry"), (-0.3, (0.0, 0.0), "table")):
        blocked = lifted_blocked(motion, height, [place])
        assert blocked is not None and why in blocked.text
        assert "attitude" not in blocked.text
    blocked = lifted_blocked(motion, 5.0)
    assert blocked is not None and blocked.text == "the arm cannot lift the object"
    with pytest.raises(TaskError, match=r"cannot carry the object to .* give other places"):
        manipulate(turning, via=((0.9, 0.0),))
    target = SE3(turning.ending.T_world_target)
    target.translation = target.translation + np.array([0.6, 0.0, 0.0])
    far = dataclasses.replace(
        turning, ending=dataclasses.replace(turning.ending, T_world_target=target)
    )
    with pytest.raises(TaskError, match="to where it is put down; give other places"):
        manipulate(far, via=((0.03, 0.06),))
    sideways = ObjectPath(
        axis=motion.path.axis, angle=0.5, shift=np.zeros(3), attitude=ATTITUDES["sideways"]
    )
    assert motion.rise == 0.0
    assert motion.with_knots(motion.knots, sideways).rise >= LIFT_HEIGHT


def test_the_way_home_is_checked_with_the_object_where_the_hand_has_it(
    turning: ManipulationPlan, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Turned to the attitude, to the place, turned back there, and to above the target."""
    motion, seen = turning.motion, []
    tilted = dataclasses.replace(motion.path, attitude=pin.exp3(np.array([0.4, 0.0, 0.0])))
    nearest = CollisionWorld.nearest_on_arm

    def looked(*args: Any, T_world_object: SE3) -> Clearance:
        seen.append(T_world_object)
        return nearest(*args, T_world_object=T_world_object)

    monkeypatch.setattr(CollisionWorld, "nearest_on_arm", looked)
    place, height = np.array([-0.05, 0.06]), 0.2
    tilted_motion = motion.with_knots(motion.knots, tilted)
    via = [(float(place[0]), float(place[1]))]
    assert lifted_blocked(tilted_motion, height, via, turning.ending) is None
    first, target = turning.task.T_world_object, turning.ending.T_world_target
    up = np.array([0.0, 0.0, height])
    there = np.append(place, first.translation[2]) + up
    at_place = [p for p in seen if np.linalg.norm(p.translation - there) < 1e-3]
    turns = [rotation_angle(p.rotation @ first.rotation.T) for p in at_place]
    assert max(turns) == pytest.approx(0.4, abs=1e-3) and turns[-1] < 1e-3
    end = target.translation + up  # the object drifts by up to 5 mm in the planned motion
    np.testing.assert_allclose(seen[-1].translation, end, atol=0.01)


def test_a_way_of_the_palm_ends_where_it_was_asked(turning: ManipulationPlan) -> None:
    hand, q = turning.task.hand, turning.grasp.q
    turn, shift = pin.exp3(np.array([0.1, -0.05, 0.2])), np.array([0.02, 0.01, 0.04])
    begin = palm_pose(hand, q)
    goal = SE3(turn @ begin.rotation, begin.translation + shift)
    path = palm_path(hand, q, goal)
    assert path is not None and len(path) > 4
    np.testing.assert_array_equal(path[0], q[hand.arm_index])
    end = palm_by_mujoco(turning.grasp, with_arm(turning.grasp, q, path[-1]))
    wanted = turning.motion.T_world_base * goal
    np.testing.assert_allclose(end.homogeneous, wanted.homogeneous, atol=2e-4)
    middle = palm_pose(hand, with_arm(turning.grasp, q, path[len(path) // 2]))
    part = len(path) // 2 / (len(path) - 1)
    np.testing.assert_allclose(middle.translation, begin.translation + part * shift, atol=2e-5)
    assert palm_path(hand, q, SE3(begin.rotation, begin.translation + 3.0 * shift / 0.04)) is None
