"""Two hands under one impedance of the object: springs between palms, the object's path, trials."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from planner import GraspTask, plan_grasp
from planner.errors import TaskError
from planner.hand_loading import load_hand
from planner.hands.hand import Hand
from planner.kinematics import HandState
from planner.objects import parse_object
from planner.plan import GraspPlan
from planner.spatial import SE3, FloatArray, skew
from sim import ObjectImpedance, Timeline, simulate
from sim.controllers.hand_dynamics import HandLoads
from sim.controllers.impedance import ImpedanceGains, ImpedanceLaw
from sim.controllers.object_impedance import MAX_NORMAL
from sim.controllers.two_hands import PATCH, ObjectPath, PalmSprings, check_two_hands
from sim.recorder import tilt_deg
from sim.report_file import PathRecord, read_report, write_report_of
from sim.show.trial_page import trial_page
from sim.simulation import Simulation

MASS, SIDE = 3.0, 0.3
"""Of the cube that is held, kg and m."""

STEP = 1e-4
"""Time between two looks at a path that is known in closed form, s."""


@pytest.fixture(scope="module")
def pair() -> Hand:
    return load_hand("two_allegro_hands")


def cube(pair: Hand, **more: object) -> GraspTask:
    item = replace(parse_object(f"box:{SIDE}x{SIDE}x{SIDE}"), mass=MASS)
    return GraspTask.create(pair, item, **more)  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def plan(pair: Hand) -> GraspPlan:
    return plan_grasp(cube(pair, grasp_type="palms"), seed=0)


def palm_wrenches(plan: GraspPlan, q: FloatArray, torque: FloatArray) -> list[FloatArray]:
    """Wrenches (6,) of both palms about their joints' origins that carriages give by torques."""
    state, out = HandState(plan.task.hand, q), []
    for side in plan.task.hand.sides:
        joint = plan.task.hand.contact_parts[side.palm_body].pad.joint_id
        jacobian = state.point_jacobian(joint, state.joint_pose(joint).translation)
        out.append(np.asarray(np.linalg.solve(jacobian[:, side.carriage].T, torque[side.carriage])))
    return out


def moved_springs(plan: GraspPlan, q: FloatArray) -> tuple[PalmSprings, HandLoads]:
    """Springs that were latched at the grasp, with the hand elsewhere."""
    task = plan.task
    springs, loads = PalmSprings(task), HandLoads(task.hand, task.fingers)
    for where in (plan.q, q):
        loads.move(where, task.gravity)
        springs.move(loads)
        if where is plan.q:
            springs.latch()
    return springs, loads


def test_springs_between_palms_do_not_move_the_object(plan: GraspPlan) -> None:
    hand, center = plan.task.hand, np.array([0.02, -0.01, 0.03])
    rng = np.random.default_rng(5)
    q = plan.q.copy()
    q[hand.carriage_index] += rng.uniform(-0.01, 0.01, len(hand.carriage_index))
    springs, _ = moved_springs(plan, q)
    torque, _, _ = springs.pull(center, np.zeros(hand.nq))
    state, whole, largest = HandState(hand, q), np.zeros(6), 0.0
    for side, wrench in zip(hand.sides, palm_wrenches(plan, q, torque), strict=True):
        joint = hand.contact_parts[side.palm_body].pad.joint_id
        arm = state.joint_pose(joint).translation - center
        moment = wrench[3:] + np.cross(arm, wrench[:3])
        whole += np.concatenate([wrench[:3], moment])
        largest = max(largest, float(np.abs(wrench[:3]).max()))
    assert largest > 10.0  # 2e4 N/m by millimetres
    assert np.abs(whole).max() < 1e-6 * largest


def test_palms_that_move_together_are_not_held_back(plan: GraspPlan) -> None:
    hand, center = plan.task.hand, np.zeros(3)
    q = plan.q.copy()
    for side in hand.sides:  # slides alone, by the same way in the axes of the pair
        joint = hand.contact_parts[side.palm_body].pad.joint_id
        state = HandState(hand, q)
        jacobian = state.point_jacobian(joint, state.joint_pose(joint).translation)[:3]
        way = np.linalg.solve(jacobian[:, side.carriage[:3]], [0.002, -0.004, 0.003])
        q[side.carriage[:3]] += way
    springs, _ = moved_springs(plan, q)
    torque, _, _ = springs.pull(center, np.zeros(hand.nq))
    assert np.abs(torque).max() < 1e-6
    q[hand.sides[0].carriage[0]] += 0.001  # one palm 1 mm further: half of it pulls each
    springs, _ = moved_springs(plan, q)
    torque, _, _ = springs.pull(center, np.zeros(hand.nq))
    assert np.abs(torque[hand.carriage_index]).max() > 5.0


def test_rates_of_both_palms_are_one_twist_and_dampers_brake_it(plan: GraspPlan) -> None:
    hand, center = plan.task.hand, np.array([0.0, 0.01, 0.02])
    twist = np.array([0.1, -0.2, 0.05, 0.3, 0.1, -0.4])
    springs, _ = moved_springs(plan, plan.q)
    state, v = HandState(hand, plan.q), np.zeros(hand.nq)
    for side in hand.sides:
        joint = hand.contact_parts[side.palm_body].pad.joint_id
        at = state.joint_pose(joint).translation
        palm = twist - np.concatenate([skew(at - center) @ twist[3:], np.zeros(3)])
        v[side.carriage] = np.linalg.solve(state.point_jacobian(joint, at)[:, side.carriage], palm)
    _, common, brake = springs.pull(center, v)
    assert common == pytest.approx(twist, abs=1e-9)
    assert brake[:3] @ twist[:3] < 0.0
    assert brake @ twist < 0.0


def test_palms_give_a_torque_that_points_miss_as_far_as_they_reach(plan: GraspPlan) -> None:
    springs, _ = moved_springs(plan, plan.q)
    for size, kept in ((0.1, 0.1), (100.0, 2 * 50.0 * PATCH)):
        missed = size * np.array([0.6, 0.0, 0.8])
        torque, exerted = springs.moment(missed, np.array([50.0, 50.0]))
        assert exerted == pytest.approx(kept / size * missed, abs=1e-9)
        wrenches = palm_wrenches(plan, plan.q, torque)
        assert sum(w[:3] for w in wrenches) == pytest.approx(np.zeros(3), abs=1e-9)
        given = np.sum([w[3:] for w in wrenches], axis=0)
        assert given == pytest.approx(kept / size * missed, abs=1e-9)


def test_what_a_damper_does_is_asked_for_once() -> None:
    gains = ImpedanceGains(stiffness=0, damping=10, turning_stiffness=0, turning_damping=1)
    law = ImpedanceLaw(gains)
    twist = np.array([0.5, 0.5, 0.5, 0.0, 1.0, 0.0])  # wanted: -5, -5, -5 N, 0, -1 N m, 0
    brake = np.array([-3.0, -8.0, 2.0, -0.3, -0.4, 0.0])
    more = law.damped_by(brake, twist)
    assert more == pytest.approx([3.0, 5.0, 0.0, 0.0, 0.4, 0.0])


def test_the_path_of_the_object_is_that_of_the_planned_base(pair: Hand) -> None:
    uneven = replace(parse_object("box:0.4x0.2x0.1"), mass=MASS)
    task = GraspTask.create(pair, uneven)
    kept = SE3(pin.exp3(np.array([0.1, 0.2, -0.3])), np.array([0.1, 0.05, -0.02]))
    acceleration, spin = np.array([0.4, -0.3, 1.2]), np.array([0.2, 0.5, -0.9])
    sway = SE3(pin.exp3(np.array([0.0, 0.02, 0.0])), np.array([0.003, 0.0, -0.002]))
    path = ObjectPath(task, MASS)

    def planned(t: float) -> SE3:
        return SE3(pin.exp3(spin * t), 0.5 * acceleration * t**2)

    for k in range(3):
        base = planned(k * STEP) * sway
        path.follow(STEP, kept, base, planned(k * STEP))
    at = 2 * STEP
    wanted = planned(at) * kept
    assert (base * path.T_base_wanted).homogeneous == pytest.approx(wanted.homogeneous)
    turn = base.rotation.T
    lever = planned(at).rotation @ kept.translation
    felt = acceleration + np.cross(spin, np.cross(spin, lever))
    assert path.acceleration == pytest.approx(turn @ felt, rel=1e-3, abs=1e-3)
    inertia = wanted.rotation @ task.object.shape.inertia(MASS) @ wanted.rotation.T
    torque = np.cross(spin, inertia @ spin)  # the spin is constant
    assert np.linalg.norm(torque) > 0.005
    assert path.inertial[:3] == pytest.approx(MASS * turn @ felt, rel=2e-3, abs=2e-3)
    assert path.inertial[3:] == pytest.approx(turn @ torque, abs=5e-4)


def test_an_object_that_stands_moves_in_a_base_that_sways(plan: GraspPlan) -> None:
    path, still = ObjectPath(plan.task, MASS), SE3.Identity()
    velocity = np.array([0.02, 0.0, -0.01])
    for k in range(3):
        path.follow(STEP, still, SE3(np.eye(3), k * STEP * velocity), still)
    assert path.twist[:3] == pytest.approx(-velocity, abs=1e-9)
    assert path.inertial == pytest.approx(np.zeros(6), abs=1e-6)
    assert path.T_base_wanted.translation == pytest.approx(-2 * STEP * velocity, abs=1e-12)


def test_a_base_without_a_plan_carries_the_object(plan: GraspPlan) -> None:
    path, kept = ObjectPath(plan.task, MASS), SE3(np.eye(3), np.array([0.0, 0.1, 0.0]))
    path.follow(STEP, kept, SE3(np.eye(3), np.ones(3)), None)
    assert path.T_base_wanted.homogeneous == pytest.approx(kept.homogeneous)


def test_a_tilt_is_what_a_turn_leaves_beside_one_about_the_vertical() -> None:
    wanted = SE3(pin.exp3(np.array([0.2, -0.5, 0.9])), np.zeros(3))
    up = pin.exp3(np.array([0.0, 0.0, 0.7]))
    for angle in (0.0, 0.3, 2.8):  # the last is beyond a right angle
        aside = pin.exp3(angle * np.array([0.6, 0.8, 0.0]))
        pose = SE3(up @ aside @ wanted.rotation, np.ones(3))
        assert tilt_deg(wanted, pose) == pytest.approx(np.rad2deg(angle), abs=1e-6)


def test_one_palm_and_inner_links_are_refused_by_name(pair: Hand, plan: GraspPlan) -> None:
    check_two_hands(plan.task)
    check_two_hands(cube(pair))
    tips = [f"left_{name}" for name in ("thumb", "index", "middle")]
    with pytest.raises(TaskError, match="takes both palms or none, and right/palm touches alone"):
        check_two_hands(cube(pair, fingers=["right/palm", *tips]))
    inner = next(b for b in pair.contact_parts if b.startswith("left/index_proximal"))
    both = ["right/palm", "left/palm", "left_index", "left_middle", inner]
    with pytest.raises(TaskError, match=f"commands one contact of each finger, and {inner}"):
        check_two_hands(cube(pair, fingers=both))


def pushed(plan: GraspPlan, controller: str, newton: float) -> PathRecord:
    """How far a held object is from its place while it is pushed along x for 0.4 s."""
    begun: list[float] = []

    def push(simulation: Simulation) -> None:
        if simulation.phase == "hold":
            begun.append(simulation.time)
            force = newton * (simulation.time - begun[0] < 0.4)
            simulation.data.xfrc_applied[simulation.scene.object_body, 0] = force

    report = simulate(plan, timeline=Timeline.quick(hold=0.4), controller=controller, on_step=push)
    assert report.success and report.path is not None
    return report.path


@pytest.mark.slow
def test_two_hands_keep_an_object_on_its_path_and_level(plan: GraspPlan, tmp_path: Path) -> None:
    turn, tilt = np.deg2rad(45.0), np.deg2rad(20.0)
    timeline = Timeline(lift_height=0.2, turn=turn, tilt=tilt, hold=0.5)
    report = simulate(plan, timeline=timeline, controller="impedance")
    assert report.success, report.verdict.detail
    assert report.path is not None
    off, turned, tilted = report.path.largest
    assert off < 1.0 and turned < 1.0 and tilted < 1.0
    assert "level to" in str(report.path)
    write_report_of(report, tmp_path / "report.json")
    again = read_report(tmp_path / "report.json")
    assert again.path is not None and again.path.largest == report.path.largest
    titles = [plot.title for plot in trial_page(again).scene.plots]  # type: ignore[union-attr]
    assert "Object off its planned path" in titles


@pytest.mark.slow
def test_a_push_moves_the_object_less_than_under_posture_control(plan: GraspPlan) -> None:
    posture, loop = (pushed(plan, name, 30.0).largest[0] for name in ("feedforward", "impedance"))
    assert loop < 0.7 * posture


def test_palms_press_more_than_pads_unless_a_largest_force_is_given(plan: GraspPlan) -> None:
    palms = [plan.task.finger_names.index(name) for name in ("right/palm", "left/palm")]
    planned = plan.contacts.forces[palms, 0]
    assert (planned > MAX_NORMAL / 2).all()
    assert ObjectImpedance(plan)._max_normal[palms] == pytest.approx(2.0 * planned)
    assert ObjectImpedance(plan, max_normal=30.0)._max_normal == pytest.approx(30.0)


def test_the_loop_believes_torsional_friction_of_palms_alone(plan: GraspPlan) -> None:
    loop = ObjectImpedance(plan)
    soft = [
        name
        for name, m in zip(plan.task.finger_names, loop._contacts.models, strict=True)
        if m == "soft"
    ]
    assert soft == ["right/palm", "left/palm"]
