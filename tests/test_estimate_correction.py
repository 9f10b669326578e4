"""What an estimate takes back is no motion: the wanted pose goes along, as far as it was unsure."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from conftest import PlanOf
from hypothesis import given, settings
from hypothesis import strategies as st

from planner.plan import GraspPlan
from planner.spatial import SE3, FloatArray
from sim import simulate
from sim.controllers import ObjectImpedance, Phase
from sim.controllers.base import PoseUncertainty
from sim.controllers.impedance import DEVIATIONS, EstimateCorrection
from sim.scene.carrier import Timeline
from sim.sensing.errors import ErrorModel
from sim.simulation import Simulation

DT = 0.002


def uncertainty(position: float, rotation: float) -> PoseUncertainty:
    """Standard deviations (m, rad) along every axis."""
    variances = np.repeat([position**2, rotation**2], 3)
    return PoseUncertainty(covariance=np.diag(variances), known=True)


def pose(x: FloatArray) -> SE3:
    return SE3(pin.exp3(x[3:]), x[:3])


def error(wanted: SE3, estimate: SE3) -> FloatArray:
    turn = pin.log3(wanted.rotation @ estimate.rotation.T)
    return np.concatenate([wanted.translation - estimate.translation, turn])


numbers = st.lists(st.floats(-1.0, 1.0), min_size=6, max_size=6).map(np.array)


@given(way=numbers, jump=numbers)
@settings(max_examples=50)
def test_a_motion_with_the_fingertips_is_all_seen(way: FloatArray, jump: FloatArray) -> None:
    """Whatever is in doubt, the loop answers to what the fingertips did."""
    correction, known = EstimateCorrection(), uncertainty(0.01, 0.1)
    start, twist = pose(0.01 * jump), 0.02 * way
    wanted = correction.follow(start, start, np.zeros(6), DT, known)
    now = start
    for _ in range(50):
        turn = pin.exp3(DT * twist[3:])
        now = SE3(turn @ now.rotation, now.translation + DT * twist[:3])
        wanted = correction.follow(wanted, now, twist, DT, known)
    np.testing.assert_allclose(error(wanted, now), -50 * DT * twist, atol=1e-9)


@given(jump=numbers)
@settings(max_examples=50)
def test_what_is_taken_back_within_the_doubt_is_no_error(jump: FloatArray) -> None:
    size = np.array([0.002] * 3 + [0.03] * 3)  # within 3 standard deviations, however it points
    correction, known, start = EstimateCorrection(), uncertainty(0.001, 0.015), SE3.Identity()
    wanted = correction.follow(start, start, np.zeros(6), DT, known)
    after = pose(size * jump / np.sqrt(3.0))
    wanted = correction.follow(wanted, after, np.zeros(6), DT, known)
    np.testing.assert_allclose(error(wanted, after), 0.0, atol=1e-9)


def test_beyond_the_doubt_the_object_moved() -> None:
    correction, known, start = EstimateCorrection(), uncertainty(0.001, 0.01), SE3.Identity()
    wanted = correction.follow(start, start, np.zeros(6), DT, known)
    after = SE3(np.eye(3), np.array([0.02, 0.0, 0.0]))
    for _ in range(3):  # as often as one looks
        wanted = correction.follow(wanted, after, np.zeros(6), DT, known)
    may = DEVIATIONS * np.sqrt(3.0) * 0.001
    np.testing.assert_allclose(error(wanted, after)[:3], [may - 0.02, 0.0, 0.0], atol=1e-12)
    correction.forget()  # at another wanted pose nothing was taken back yet
    assert correction.follow(start, after, np.zeros(6), DT, known) is start


@pytest.fixture(scope="module")
def plan(plan_of: PlanOf) -> GraspPlan:
    return plan_of("allegro_hand", "cylinder", seed=3)


@pytest.fixture(scope="module")
def held(plan: GraspPlan) -> Simulation:
    """A simulation in which the object is held; only looked at."""
    simulation = Simulation(plan, controller=ObjectImpedance(plan))
    for kind, seconds in (("approach", 0.8), ("close", 1.0), ("squeeze", 0.4), ("hold", 0.1)):
        for _ in simulation.run(kind, seconds):  # type: ignore[arg-type]
            pass
    return simulation


def answered(held: Simulation, phase: Phase, sliding: float, rates: float) -> float:
    """How far the wanted pose goes along, mm, with an estimate that moves 2 mm upward.

    Meanwhile the object slides upward over all pads, m/s, and all joints move, rad/s.
    """
    plan, now = held.plan, held.observe(phase, 1.0)
    controller, known = ObjectImpedance(plan), uncertainty(0.005, 0.1)
    pads = replace(now.pads, sliding=np.tile([0.0, 0.0, sliding], (len(now.pads.sliding), 1)))
    begin = None
    for k in range(51):
        up = np.array([0.0, 0.0, 4e-5 * k])
        pose = SE3(now.T_world_object.rotation, now.T_world_object.translation + up)
        controller.step(
            now.altered(
                time=now.time + k * DT,
                v=np.full_like(now.v, rates),
                T_world_object=pose,
                read_pads=lambda: pads,
                uncertainty=known,
            )
        )
        begin = controller.T_palm_wanted if begin is None else begin
    assert begin is not None and controller.T_palm_wanted is not None
    went = controller.T_palm_wanted.translation - begin.translation
    return 1e3 * float(np.linalg.norm(went))


@pytest.mark.slow
def test_an_object_that_slides_over_the_pads_is_brought_back(held: Simulation) -> None:
    """At 20 mm/s it slides the 2 mm itself; before, a slip counted as doubt, and no force grew."""
    assert answered(held, "hold", sliding=0.0, rates=0.0) == pytest.approx(2.0, abs=0.02)
    assert answered(held, "hold", sliding=0.02, rates=0.0) < 0.1


def test_fingers_that_close_around_an_object_that_stands_do_not_move_it(held: Simulation) -> None:
    went = answered(held, "settle", sliding=0.0, rates=1.0)
    assert went == pytest.approx(2.0, abs=0.02)
    assert abs(answered(held, "hold", sliding=0.0, rates=1.0) - went) > 0.1


@pytest.mark.slow
def test_a_camera_that_drifts_moves_no_object(plan: GraspPlan) -> None:
    """Five degrees and five millimetres of it: the loop that believed it turned the object."""
    drifting = ErrorModel(
        name="drift", pose_drift=0.005, turn_drift=np.deg2rad(5.0), pose_rate=60.0, seed=4
    )
    brief = Timeline.quick(approach=0.2, lift=0.4, lift_height=0.04, hold=0.5)
    report = simulate(plan, controller=ObjectImpedance(plan), error_model=drifting, timeline=brief)
    assert report.success, report.reason
    moved, turned = report.largest_slip
    assert moved < 0.5
    assert turned < 0.5
