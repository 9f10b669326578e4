"""Parts of the closed loop by themselves: impedance, gains, senses, schedule, slips, torques."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from conftest import PlanOf
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks.slips import LATENCY, Slip, score_slips, true_slips
from planner.contacts import ContactSet
from planner.errors import NotFoundError, TaskError
from planner.kinematics import HandState
from planner.plan import GraspPlan
from planner.search.grasp import plan_grasp
from planner.spatial import SE3, FloatArray, skew
from planner.task import GraspTask
from sim.controllers import (
    ImpedanceGains,
    ObjectImpedance,
    PadReading,
    named_controller,
)
from sim.controllers.impedance import ImpedanceLaw, effective_inertia
from sim.controllers.monitors import LOST_TIME, RAMP, TOUCH_TIME, ContactSchedule, SlipDetector
from sim.controllers.torques import (
    RETREAT,
    RETREAT_STIFFNESS,
    SEARCH_FORCE,
    HoldingTorques,
    grasp_matrix,
)

DT = 0.002


@pytest.fixture(scope="module")
def plan(plan_of: PlanOf) -> GraspPlan:
    return plan_of("allegro_hand", "sphere")


# --- impedance ---------------------------------------------------------------------------------


def pushed(law: ImpedanceLaw, mass: float, push: float, duration: float, dt: float) -> FloatArray:
    """Positions of a point mass under law and a push along x, from rest, semi-implicit Euler."""
    x, v = 0.0, 0.0
    out = []
    for _ in range(round(duration / dt)):
        pose = SE3(np.eye(3), np.array([x, 0.0, 0.0]))
        force = law.wrench(SE3.Identity(), pose, np.array([v, 0, 0, 0, 0, 0]))[0]
        law.learn(dt, np.zeros(6))
        v += dt * (force + push) / mass
        x += dt * v
        out.append(x)
    return np.array(out)


def test_a_constant_push_leaves_push_over_stiffness() -> None:
    gains = ImpedanceGains.of_body(mass=0.5, inertia=1e-3, bandwidth=20.0, learning_rate=0.0)
    assert gains.stiffness == 200.0  # 0.5 * 20^2
    x = pushed(ImpedanceLaw(gains), 0.5, push=3.0, duration=2.0, dt=1e-3)
    assert x[-1] == pytest.approx(3.0 / 200.0, rel=1e-9)


def test_the_way_there_is_that_of_a_critically_damped_mass() -> None:
    # worked on paper: x = P/K (1 - (1 + w t) exp(-w t))
    gains = ImpedanceGains.of_body(mass=0.5, inertia=1e-3, bandwidth=20.0, learning_rate=0.0)
    dt = 1e-5
    x = pushed(ImpedanceLaw(gains), 0.5, push=3.0, duration=0.3, dt=dt)
    t = dt * np.arange(1, len(x) + 1)
    np.testing.assert_allclose(x, 0.015 * (1 - (1 + 20 * t) * np.exp(-20 * t)), atol=1e-5)


def test_a_learned_load_takes_the_deflection_away() -> None:
    gains = ImpedanceGains.of_body(mass=0.5, inertia=1e-3, bandwidth=20.0, learning_rate=5.0)
    law = ImpedanceLaw(gains)
    x = pushed(law, 0.5, push=3.0, duration=4.0, dt=1e-3)
    assert np.abs(x).max() > 0.005
    assert abs(x[-1]) < 1e-6
    np.testing.assert_allclose(law.load, [-3.0, 0, 0, 0, 0, 0], atol=1e-4)


def test_what_cannot_be_given_is_not_learned() -> None:
    gains = ImpedanceGains.of_body(mass=0.5, inertia=1e-3, learning_rate=5.0)
    law = ImpedanceLaw(gains)
    away = SE3(np.eye(3), np.array([0.01, 0.0, 0.0]))
    for _ in range(1000):
        wanted = law.wrench(SE3.Identity(), away, np.zeros(6))
        law.learn(DT, np.clip(wanted, -4.0, 4.0) - wanted)
    # at rest with 4 N at most: spring + load = -4 N would be given, and the load stands still
    spring = -0.01 * gains.stiffness
    assert law.load[0] == pytest.approx(-4.0, abs=0.01)
    assert spring < -1.0


@pytest.mark.slow
@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_energy_never_grows_without_input(seed: int) -> None:
    rng = np.random.default_rng(seed)
    mass, inertia, dt = 0.3, 2e-4, 1e-4
    gains = ImpedanceGains.of_body(mass=mass, inertia=inertia, bandwidth=30.0, learning_rate=0.0)
    law = ImpedanceLaw(gains)
    wanted = SE3(pin.exp3(rng.normal(size=3)), rng.normal(size=3))
    pose = SE3(pin.exp3(rng.normal(size=3)) @ wanted.rotation, wanted.translation + 0.01)
    twist = 0.1 * rng.normal(size=6)
    energy = []
    for _ in range(1500):
        wrench = law.wrench(wanted, pose, twist)
        twist = twist + dt * wrench / np.repeat([mass, inertia], 3)
        turned = pin.exp3(dt * twist[3:]) @ pose.rotation
        pose = SE3(turned, pose.translation + dt * twist[:3])
        error = pin.log3(wanted.rotation @ pose.rotation.T)
        apart = wanted.translation - pose.translation
        energy.append(
            0.5 * (mass * twist[:3] @ twist[:3] + inertia * twist[3:] @ twist[3:])
            + 0.5 * (gains.stiffness * apart @ apart + gains.turning_stiffness * error @ error)
        )
    assert energy[-1] < 0.05 * energy[0]
    # one step of the integrator may store what it takes out again: 1e-3 of the energy
    assert np.diff(energy).max() < 1e-3 * energy[0]


def test_gains_and_names_that_make_no_sense_are_refused() -> None:
    with pytest.raises(TaskError, match="stiffness is -1; give a finite number >= 0"):
        ImpedanceGains(stiffness=-1, damping=0, turning_stiffness=0, turning_damping=0)
    with pytest.raises(NotFoundError, match="Did you mean 'impedance'"):
        named_controller("impedence")


def mobility(plan: GraspPlan, mass: float) -> FloatArray:
    """Acceleration (6, 6) per wrench on the object: one system of all bodies, contacts stick."""
    hand, state = plan.task.hand, HandState(plan.task.hand, plan.q)
    joints = pin.crba(hand.pin_model, hand.pin_model.createData(), plan.q)
    joints = np.triu(joints) + np.triu(joints, 1).T
    contacts = plan.contacts.transformed(plan.T_world_base.inverse())
    ball = 0.4 * mass * plan.task.object.shape.bounding_radius**2
    k = np.concatenate([finger.q_index for finger in plan.task.fingers])
    inertia = np.zeros((6 + len(k), 6 + len(k)))
    inertia[:6, :6] = np.diag([mass] * 3 + [ball] * 3)
    start = 6
    sticks = []  # velocity of the pad less that of the object where they touch
    for finger, point in zip(plan.task.fingers, contacts.positions, strict=True):
        own = slice(start, start + len(finger.q_index))
        start = own.stop
        inertia[own, own] = joints[np.ix_(finger.q_index, finger.q_index)]
        row = np.zeros((3, len(inertia)))
        row[:, :3], row[:, 3:6] = -np.eye(3), skew(point - contacts.center)
        row[:, own] = state.point_jacobian(finger.pad.joint_id, point)[:3, finger.q_index]
        sticks.append(row)
    table = np.vstack(sticks)
    kkt = np.block([[inertia, table.T], [table, np.zeros((len(table), len(table)))]])
    return np.asarray(np.linalg.solve(kkt, np.eye(len(kkt))[:, :6])[:6])


def test_felt_mass_is_force_by_acceleration(plan: GraspPlan) -> None:
    moved = np.diag(mobility(plan, 0.2))
    mass, turning = effective_inertia(plan, 0.2)
    assert mass == pytest.approx(1 / moved[:3].mean(), rel=1e-3)
    assert turning == pytest.approx(1 / moved[3:].mean(), rel=1e-3)
    assert mass > 0.2


@pytest.mark.parametrize("name", ["shadow_hand", "allegro_hand"])
def test_the_damper_suits_what_moves_most_easily(name: str) -> None:
    """D dt / M well below 1 in every direction: more than that in a control step swings."""
    grasp = plan_grasp(GraspTask.create(name, "cylinder:0.026x0.08"), seed=0)
    gains = ObjectImpedance(grasp).law.gains
    damper = np.repeat([gains.damping, gains.turning_damping], 3)
    rates = np.linalg.eigvals(mobility(grasp, grasp.task.object.mass) * damper)
    assert DT * rates.real.max() < 0.7


# --- senses ------------------------------------------------------------------------------------


def two_pads() -> PadReading:
    return PadReading(
        normal_force=np.array([2.0, 0.0]),
        force=np.array([[2.0, 0.5, 0.0], [0.0, 0.0, 0.0]]),
        position=np.array([[0.0, 0.0, 0.0], [np.nan] * 3]),
        normal=np.array([[1.0, 0.0, 0.0], [np.nan] * 3]),
        sliding=np.array([[0.0, 0.003, 0.004], [np.nan] * 3]),
    )


def test_a_reading_knows_its_tangential_part() -> None:
    pads = two_pads()
    np.testing.assert_allclose(pads.tangential_force, [0.5, 0.0])
    np.testing.assert_allclose(pads.friction_ratio(), [0.25, 0.0])
    np.testing.assert_allclose(pads.sliding_speed, [0.005, 0.0])


# --- schedule ----------------------------------------------------------------------------------


def test_a_lost_finger_gives_its_share_at_once_and_takes_it_back_along_a_ramp() -> None:
    schedule = ContactSchedule(np.array([True, True]))
    force = np.array([1.0, 1.0])
    assert schedule.holding.all()
    force[1] = 0.0
    steps = 0
    while schedule.touching[1]:
        lost, _ = schedule.step(DT, force)
        steps += 1
    assert steps == round(LOST_TIME / DT)
    assert lost.tolist() == [False, True]
    assert schedule.share.tolist() == [1.0, 0.0]
    assert schedule.searching.tolist() == [False, True]
    force[1] = 0.5
    found = np.zeros(2, dtype=bool)
    steps = 0
    while not found[1]:
        _, found = schedule.step(DT, force)
        steps += 1
    assert steps == round(TOUCH_TIME / DT)
    for _ in range(round(RAMP / DT / 2)):
        schedule.step(DT, force)
    assert schedule.share[1] == pytest.approx(0.5, abs=0.03)


def test_a_flicker_is_no_loss() -> None:
    schedule = ContactSchedule(np.array([True]))
    for k in range(100):
        lost, _ = schedule.step(DT, np.array([0.0 if k % 3 else 1.0]))
        assert not lost.any()
    assert schedule.share[0] == 1.0


def test_a_finger_that_is_told_to_leave_gives_its_force_away_slowly() -> None:
    schedule = ContactSchedule(np.array([True, True]))
    schedule.wanted[0] = False
    shares = []
    for _ in range(round(RAMP / DT) + 1):
        schedule.step(DT, np.ones(2))
        shares.append(float(schedule.share[0]))
    assert np.abs(np.diff(shares)).max() <= DT / RAMP + 1e-12
    assert shares[-1] == 0.0
    assert schedule.holding.tolist() == [False, True]
    assert not schedule.searching.any()


# --- slips -------------------------------------------------------------------------------------


def reading(velocity: FloatArray, force: float = 2.0) -> PadReading:
    n = len(velocity)
    return PadReading(
        normal_force=np.full(n, force),
        force=np.tile([force, 0.0, 0.0], (n, 1)),
        position=np.zeros((n, 3)),
        normal=np.tile([1.0, 0.0, 0.0], (n, 1)),
        sliding=velocity,
    )


def test_slips_are_told_by_speed_time_and_load() -> None:
    times: FloatArray = DT * np.arange(100, dtype=np.float64)
    speed, force = np.zeros((100, 3)), np.ones((100, 3))
    speed[10:21, 0] = 0.006  # 20 ms: a slip
    speed[50:53, 0] = 0.1  # 4 ms: none
    speed[:, 1] = 0.004  # too slow
    speed[30:60, 2] = 0.1
    force[30:60, 2] = 0.01  # opens
    assert true_slips(times, speed, force) == [Slip(finger=0, begin=times[10], end=times[20])]


def test_scores_count_what_is_found_in_time() -> None:
    slips = [Slip(finger=0, begin=1.0, end=1.3), Slip(finger=1, begin=2.0, end=2.1)]
    alarms = [
        Slip(finger=0, begin=1.02, end=1.25),  # in time
        Slip(finger=1, begin=2.0 + LATENCY + 0.01, end=2.2),  # too late to find it, but true
        Slip(finger=2, begin=1.02, end=1.1),  # false
    ]
    score = score_slips(slips, alarms)
    assert (score.slips, score.found, score.alarms, score.right) == (2, 1, 3, 2)
    assert score.recall == 0.5
    assert score.precision == pytest.approx(2 / 3)
    assert score.delay == pytest.approx(0.02)
    assert np.isnan(score_slips([], []).recall)


def test_a_slip_is_seen_within_50_ms_and_noise_is_not() -> None:
    rng = np.random.default_rng(0)
    detector = SlipDetector(4)
    noise = 0.002  # m/s, each axis
    alarms = 0
    for _ in range(10_000):  # 20 s of four fingers
        velocity = noise * rng.standard_normal((4, 3)) * [0, 1, 1]
        alarms += int(detector.update(DT, reading(velocity)).sum())
    assert alarms == 0
    for angle in np.linspace(0, 2 * np.pi, 12, endpoint=False):
        detector = SlipDetector(1)
        steps = 0
        while not detector.slipping[0]:
            velocity = 0.008 * np.array([[0, np.cos(angle), np.sin(angle)]])
            detector.update(DT, reading(velocity + noise * rng.standard_normal(3) * [0, 1, 1]))
            steps += 1
        assert 4 <= steps <= LATENCY / DT


def test_noise_of_slow_pads_is_no_slip() -> None:
    """Pads of 100 Hz tell each reading at five control steps, with the same noise."""
    rng = np.random.default_rng(0)
    noise, last = 0.002, 4  # m/s, each axis

    def seen(detector: SlipDetector, velocity: FloatArray, step: int) -> int:
        told = replace(reading(velocity), time=0.01 * (step // (last + 1)))
        return int(detector.update(DT, told).sum())

    detector, alarms = SlipDetector(4), 0
    for step in range(10_000):  # 20 s of four fingers
        if step % (last + 1) == 0:
            velocity = noise * rng.standard_normal((4, 3)) * [0, 1, 1]
        alarms += seen(detector, velocity, step)
    assert alarms == 0
    for angle in np.linspace(0, 2 * np.pi, 12, endpoint=False):
        detector, step, alarms = SlipDetector(1), 0, 0
        while not alarms:
            if step % (last + 1) == 0:
                white = noise * rng.standard_normal(3) * [0, 1, 1]
                velocity = (0.008 * np.array([0, np.cos(angle), np.sin(angle)]) + white)[None]
            alarms = seen(detector, velocity, step)
            step += 1
        assert 0.03 <= step * DT <= 0.1


def test_an_alarm_takes_as_many_steps_whenever_it_begins() -> None:
    """Times are sums of steps: their rounding must not cost a step."""
    needed = set()
    for start in range(300):
        detector, steps = SlipDetector(1), 0
        times = np.cumsum(np.full(start + 20, DT))[start:]
        for elapsed in np.diff(times):
            steps += 1
            if detector.update(float(elapsed), reading(np.array([[0.0, 0.02, 0.0]]))).any():
                break
        needed.add(steps)
    # the average passes 4.5 mm/s at the second step of 20 mm/s, and 8 ms are four of them
    assert needed == {5}


def test_an_unloaded_contact_does_not_slip() -> None:
    detector = SlipDetector(1)
    for _ in range(50):
        assert not detector.update(DT, reading(np.array([[0.0, 0.1, 0.0]]), force=0.01)).any()


# --- forces ------------------------------------------------------------------------------------


def test_forces_that_stay_are_not_missed(plan: GraspPlan) -> None:
    """Where the programme has no answer the last forces go on, and so does what they exert."""

    class NoAnswer:
        allowed, left_over = False, np.full(6, np.nan)

    controller = ObjectImpedance(plan)
    contacts = plan.contacts.transformed(plan.T_world_base.inverse())
    controller.forces = contacts.forces.copy()
    controller._loop.step = lambda *_, **__: NoAnswer()  # type: ignore[method-assign,assignment]
    wanted = contacts.wrench() + np.array([1.0, 0.0, 0.0, 0.0, 0.0, 0.02])
    missed = controller._distribute(
        wanted, contacts.center, plan.q, 1.0, held_back=np.zeros(len(contacts)), eases=True
    )
    np.testing.assert_allclose(missed, [-1.0, 0.0, 0.0, 0.0, 0.0, -0.02], atol=1e-9)


# --- torques -----------------------------------------------------------------------------------


@pytest.mark.parametrize("hand", ["allegro_hand", "two_allegro_hands"])
def test_a_palm_that_turns_on_a_base_that_stands_is_noticed(hand: str, plan_of: PlanOf) -> None:
    """As an arm turns it: nothing is learned for a while, and the load stays in the base's axes."""
    plan = plan_of(hand, "sphere" if hand == "allegro_hand" else "box:0.3x0.2x0.2")
    controller, turn = ObjectImpedance(plan), plan.T_world_base.rotation.T
    if not plan.task.hand.pair:
        controller._torques.T_base_palm = plan.T_world_base.actInv(plan.T_world_palm)
    load = np.arange(6.0)
    controller.law.load, controller._time = load.copy(), 3.0
    controller._turn_load(turn)
    assert controller._turning_until == 0.0
    bent = SE3(pin.exp3(np.array([0.0, np.deg2rad(4.0), 0.0])), np.zeros(3))
    controller._torques.T_base_palm = controller._torques.T_base_palm * bent
    controller._turn_load(turn)
    assert controller._turning_until == pytest.approx(3.0 + ObjectImpedance.turning_time)
    assert controller.law.load == pytest.approx(load)


def gripped(plan: GraspPlan) -> tuple[HoldingTorques, ContactSet]:
    """Torques at the plan's grasp, at rest, all fingers touching where planned."""
    torques = HoldingTorques(plan)
    gravity = plan.T_world_base.rotation.T @ plan.task.gravity
    torques.move(plan.q, np.zeros(plan.task.hand.nq), gravity)
    torques.latch()
    contacts = plan.contacts.transformed(plan.T_world_base.inverse())
    torques.touch(contacts.positions, contacts.center, np.ones(len(contacts), dtype=bool))
    return torques, contacts


@pytest.mark.parametrize("model", ["point", "soft"])
def test_commands_produce_the_torques_of_the_forces(model: str, plan_of: PlanOf) -> None:
    plan = plan_of("allegro_hand", "sphere", contact_model=model, mu_torsion=0.005)
    torques, contacts = gripped(plan)
    n = len(contacts)
    all_hold, none = np.ones(n, dtype=bool), np.zeros(n, dtype=bool)
    assert (model == "soft") == bool(np.abs(contacts.forces[:, 3]).max() > 1e-6)
    ctrl = torques.commands(
        contacts.forces_in_axes(), contacts.normals, all_hold, none, moments=contacts.forces[:, 3]
    )
    a = plan.task.hand.actuation
    length = a.moment @ plan.q + a.length0
    made = (a.gain * ctrl + a.bias[:, 0] + a.bias[:, 1] * length) @ a.moment
    np.testing.assert_allclose(made, plan.forces.joint_torques, atol=1e-6)
    assert torques.saturated_actuators() == ()


@pytest.mark.parametrize("model", ["point", "soft"])
def test_what_the_controller_exerts_is_the_wrench_of_its_forces_about_any_point(
    model: str, plan_of: PlanOf
) -> None:
    """Those of the plan, moved from the centre of mass to a point far off."""
    plan = plan_of("allegro_hand", "sphere", contact_model=model, mu_torsion=0.005)
    contacts = plan.contacts.transformed(plan.T_world_base.inverse())
    controller = ObjectImpedance(plan)
    controller.forces[:, : contacts.forces.shape[1]] = contacts.forces
    lever = np.array([0.1, -0.2, 0.3])
    force, torque = np.split(contacts.wrench(), 2)
    expected = np.concatenate([force, torque - np.cross(lever, force)])
    assert np.abs(np.cross(lever, force)).max() > 0.05
    np.testing.assert_allclose(controller._exerted(contacts.center + lever), expected, atol=1e-9)


def test_the_grasp_matrix_is_that_of_the_contacts(plan: GraspPlan) -> None:
    contacts = plan.contacts
    forces = contacts.forces_in_axes()
    wrench = grasp_matrix(contacts.positions - contacts.center) @ forces.ravel()
    np.testing.assert_allclose(wrench, contacts.wrench(), atol=1e-12)


def test_a_body_that_moves_is_seen_by_the_joints(plan: GraspPlan) -> None:
    torques, contacts = gripped(plan)
    hand = plan.task.hand
    twist = np.array([0.02, -0.01, 0.03, 0.2, 0.1, -0.3])
    arms = contacts.positions - contacts.center
    tips = twist[:3] + np.cross(twist[3:], arms)
    jac = torques.jacobians.reshape(-1, hand.nq)
    v = np.linalg.lstsq(jac, tips.ravel(), rcond=None)[0]
    np.testing.assert_allclose(jac @ v, tips.ravel(), atol=1e-9)
    torques.move(plan.q, v, np.zeros(3))
    seen = torques.touch(contacts.positions, contacts.center, np.ones(len(arms), dtype=bool))
    np.testing.assert_allclose(seen, twist, atol=2e-3)  # what keeps G G^T regular takes 0.3 %


def test_the_springs_of_fingertips_and_posture_do_not_move_the_object(plan: GraspPlan) -> None:
    torques, contacts = gripped(plan)
    rng = np.random.default_rng(1)
    n, hand = len(contacts), plan.task.hand
    bent = plan.q + 0.02 * rng.standard_normal(hand.nq)
    torques.move(bent, np.zeros(hand.nq), np.zeros(3))
    hold = np.ones(n, dtype=bool)
    torques.touch(contacts.positions, contacts.center, hold)
    a = hand.actuation
    ctrl = torques.commands(np.zeros((n, 3)), contacts.normals, hold, ~hold)
    made = (a.gain * ctrl + a.bias[:, 0] + a.bias[:, 1] * (a.moment @ bent + a.length0)) @ a.moment
    assert np.abs(made).max() > 1e-3
    # the forces that the fingertips then exert, finger by finger: J^T f = torque, least squares
    pressed = []
    for finger, jac in zip(plan.task.fingers, torques.jacobians, strict=True):
        own = jac[:, finger.q_index]
        pressed.append(np.linalg.lstsq(own.T, made[finger.q_index], rcond=None)[0])
    forces = np.array(pressed)
    assert np.abs(forces).max() > 0.05
    wrench = grasp_matrix(contacts.positions - contacts.center) @ forces.ravel()
    assert np.abs(wrench[:3]).max() < 1e-2 * np.abs(forces).max()
    assert np.abs(wrench[3:]).max() < 1e-2 * np.abs(forces).max() * 0.035


def test_one_that_leaves_goes_off_the_object_and_one_that_searches_presses(plan: GraspPlan) -> None:
    torques, contacts = gripped(plan)
    hand, fingers = plan.task.hand, plan.task.fingers
    torques.move(plan.q, np.zeros(hand.nq), np.zeros(3))
    hold, searching = np.ones((2, len(fingers)), dtype=bool)
    hold[[1, 2]], searching[:] = False, False
    searching[2] = True
    torques.touch(contacts.positions, contacts.center, hold)
    a, none = hand.actuation, np.zeros((len(fingers), 3))
    ctrl = torques.commands(none, contacts.normals, hold, searching)
    made = (
        a.gain * ctrl + a.bias[:, 0] + a.bias[:, 1] * (a.moment @ plan.q + a.length0)
    ) @ a.moment
    for i, push in enumerate((0.0, -RETREAT * RETREAT_STIFFNESS, SEARCH_FORCE)):
        joints = fingers[i].q_index
        expected = torques.jacobians[i].T @ (push * contacts.normals[i])
        np.testing.assert_allclose(made[joints], expected[joints], atol=1e-9)
