"""Regrasps executed: one finger at a time moves on while the others hold; the turn counts on."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from conftest import noting_advances
from manipulations import DT, QUICK, task_of
from star_hand import write_star_hand

from benchmarks.conditions import FRICTION, REGRASP_FRICTION
from benchmarks.manipulate import Turn
from planner.contacts import ContactSet
from planner.errors import NoGraspFoundError, TaskError
from planner.failure import Failure
from planner.hand_loading import load_hand
from planner.motion import manipulation as search
from planner.motion.gait import GaitPlan, cut_motion, plan_back, plan_others
from planner.motion.manipulation import ManipulationPlan, plan_manipulation, plan_regrasping
from planner.motion.phase import Relocation
from planner.spatial import SE3, FloatArray
from planner.task import GraspTask
from sim.controllers import Event, ObjectImpedance, Observation
from sim.controllers.base import event_lines
from sim.controllers.follow import MotionReference
from sim.manipulation import (
    ManipulationReport,
    manipulate,
    regrasping,
)
from sim.manipulation.driver import FingerSwing
from sim.manipulation.regrasping import margin_without
from sim.scene.physics import PhysicsOptions

ANGLE = math.radians(40.0)

SHORT = replace(
    QUICK,
    approach=0.3,
    squeeze=0.2,
    lift=0.3,
    finger_rate=6.0,
    carry=0.4,
    lower=0.3,
    release=0.2,
    retreat=0.3,
    height=0.02,
)


@pytest.fixture(scope="module")
def plan(tmp_path_factory: pytest.TempPathFactory) -> ManipulationPlan:
    """Two strokes of 21 degrees by a hand of four fingers in a circle."""
    hand = load_hand(write_star_hand(tmp_path_factory.mktemp("star"), 4))
    task = task_of("cylinder:0.03x0.08", hand, mass=0.1, mu=0.6)
    return plan_regrasping(task, angle=ANGLE, place=(0.03, 0.0))


@pytest.fixture(scope="module")
def gait(plan: ManipulationPlan) -> GaitPlan:
    assert plan.cycles > 1
    return plan


@pytest.fixture(scope="module")
def lead_times() -> list[float]:
    """Times (s) for which the references of ``report`` led, a control step each."""
    return []


@pytest.fixture(scope="module")
def report(plan: ManipulationPlan, lead_times: list[float]) -> ManipulationReport:
    """What comes of it with an object of twice the mass."""
    task = plan.motion.grasp.task
    true_task = replace(task, object=replace(task.object, mass=0.2))
    with noting_advances(lead_times):
        return manipulate(plan, true_task=true_task, physics=PhysicsOptions(mu=0.7), timeline=SHORT)


def test_nothing_leads_while_fingers_move_on(
    report: ManipulationReport, lead_times: list[float]
) -> None:
    steps = ("turn", "hold", "verify again")
    led_for = sum(c.end - c.begin for c in report.results if c.phase in steps)
    assert sum(lead_times) == pytest.approx(led_for, abs=0.01)
    assert any(c.phase == "regrasp" and c.end - c.begin > 0.1 for c in report.results)


def test_a_turn_by_strokes_is_planned_a_little_further(gait: GaitPlan) -> None:
    assert gait.cycles == 2
    assert math.radians(41.0) < gait.planned_angle < math.radians(43.0)


def test_two_strokes_and_a_regrasp_of_every_finger(
    gait: GaitPlan, report: ManipulationReport
) -> None:
    assert report.complete, str(report)
    assert report.success_with_closure
    assert report.turned >= ANGLE
    assert math.degrees(report.largest_tilt) < 3.0
    done = [(c.phase, c.about) for c in report.results if c.phase in ("turn", "regrasp")]
    moved = [("regrasp", finger) for finger in gait.order]
    assert done == [("turn", "stroke 1"), *moved, ("turn", "stroke 2")]
    assert "regrasp finger1" in str(report)


def test_one_finger_at_a_time_is_away_and_really_off(report: ManipulationReport) -> None:
    log = report.log
    air = log.during("regrasp")
    assert log.away[air].sum(axis=1).max() == 1
    assert report.least_fingers == 3
    for i in range(len(report.fingers)):
        off = air[np.isnan(log.points[air, i, 0])]
        assert len(off) > 5
        # it is off where it is told to be, but for the moment between touch and landing
        assert (report.measured_modes[off, i] == "off").mean() > 0.9
    others = np.delete(np.arange(len(log)), log.during("regrasp", "open", "retreat"))
    assert not log.away[others].any()


def test_fingers_land_back_around_the_object(report: ManipulationReport) -> None:
    log = report.log
    turns = log.during("turn")
    split = int(np.flatnonzero(np.diff(turns) > 1)[0])
    before, after = log.points[turns[split]], log.points[turns[split + 1]]
    angle = np.arctan2(after[:, 1], after[:, 0]) - np.arctan2(before[:, 1], before[:, 0])
    # in the stroke pads of 8 mm rolled on the cylinder of 30 mm: the contact kept R / (R + r) of
    # the turn, and that is what the finger goes back; measured, not planned
    stroke = next(c for c in report.results if c.phase == "turn").numbers["stroke_deg"]
    went = np.rad2deg(np.angle(np.exp(1j * angle)))
    np.testing.assert_allclose(went, -stroke * 30.0 / 38.0, atol=1.5)
    for check in report.results:
        if check.phase == "regrasp":
            assert check.numbers["landed_off_mm"] < 2.0
            assert check.numbers["margin"] > regrasping.MEASURED_MARGIN


def test_the_gate_measures_the_closure_that_was_planned_for_the_others(
    plan: ManipulationPlan, report: ManipulationReport
) -> None:
    """Never that of all fingers, the leaving one counted."""
    assert plan.cycles > 1
    planned = {move.finger: move.margin for move in plan.relocations}
    measured = {r.about: r.numbers["margin"] for r in report.results if r.phase == "regrasp"}
    assert measured == pytest.approx(planned, abs=0.01)
    for move in plan.relocations:
        margin = margin_without(move.before, plan.task, move.finger)
        assert margin == pytest.approx(move.margin, abs=1e-6)
        assert abs(margin_without(move.before, plan.task, "nobody") - margin) > 0.02


@pytest.mark.slow
def test_lifts_are_refused_while_the_others_do_not_close(
    plan: ManipulationPlan, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Three fingers do not close at a friction of 0.05: all are refused, and it is begun anew.

    The gate alone believes in that; planner and controller go on believing in 0.6.
    """

    def doubting(measured: ContactSet, task: GraspTask, finger: str) -> float:
        return margin_without(measured, replace(task, mu=0.05), finger)

    monkeypatch.setattr(regrasping, "margin_without", doubting)
    told = manipulate(
        plan,
        controller=lambda _: ObjectImpedance(plan.grasp, max_normal=12.0),
        timeline=replace(SHORT, lift_wait=0.1),
        retry=True,
    )
    first = told.earlier
    assert first is not None and first.put_down and not first.dropped
    tried = [r for r in first.results if r.phase == "regrasp"]
    assert sorted(r.about for r in tried) == sorted(plan.task.finger_names)
    for result in tried:
        assert result.numbers["margin"] < regrasping.MEASURED_MARGIN
        words = f"{result.about} cannot be lifted: the measured contacts of the others close with"
        assert words in result.reason
    assert [r.then for r in tried[:-1]] == ["the fingers move on in another order"] * 3
    assert tried[-1].then.endswith("it is put down")
    assert first.least_fingers == 4, "no finger left the object"


@pytest.mark.slow
def test_another_finger_goes_first_where_a_lift_is_refused(
    plan: ManipulationPlan, gait: GaitPlan, monkeypatch: pytest.MonkeyPatch
) -> None:
    first = gait.order[0]
    refused = regrasping.Regrasping._refused
    asked: list[str] = []

    def stubborn(self: regrasping.Regrasping, finger: str, numbers: dict[str, float]) -> str:
        asked.append(finger)
        seen = set(asked) == {first}
        return "it is stuck" if seen else refused(self, finger, numbers)

    monkeypatch.setattr(regrasping.Regrasping, "_refused", stubborn)
    told = manipulate(plan, timeline=replace(SHORT, lift_wait=0.1), retry=True)
    tried = [c for c in told.results if c.phase == "regrasp"]
    assert tried[0].about == first
    assert tried[0].reason == f"{first} cannot be lifted: it is stuck"
    assert tried[0].then == "the fingers move on in another order"
    assert tried[1].about != first
    assert sorted(c.about for c in tried[1:]) == sorted(gait.order)
    assert told.complete, str(told)
    assert told.success_with_closure


def test_fingers_that_are_left_have_orders_of_their_own(gait: GaitPlan) -> None:
    stroke, names = gait.motion, gait.order
    found = plan_others(stroke, names[:1], names[1:2])
    assert not isinstance(found, Failure)
    assert sorted(r.finger for r in found) == sorted(names[1:])
    assert found[0].finger != names[1]
    told = plan_others(stroke, names[:1], names[1:])
    assert isinstance(told, Failure)
    assert "could not be lifted when it was tried" in told.text


def test_a_reference_goes_on_from_an_object_that_was_turned(gait: GaitPlan) -> None:
    motion = gait.motion
    T_palm_world = motion.grasp.T_world_palm.inverse()
    knots = [T_palm_world * k.T_world_object for k in motion.knots]

    def led(about: float) -> tuple[SE3, np.ndarray[tuple[int, ...], np.dtype[np.float64]]]:
        reference = MotionReference(motion)
        turned = pin.exp3(about * reference.axis)
        pose = SE3(turned @ knots[0].rotation, knots[0].translation)
        tips = motion.knots[0].contacts.transformed(T_palm_world).positions
        target = reference.advance(DT, pose, tips, motion.knots[0].q, missed=0.0)
        np.testing.assert_allclose(target.tips, tips, atol=1e-12)
        assert target.T_palm_object.isApprox(pose, 1e-9)
        while not reference.arrived:
            turn = pin.exp3(reference.place * motion.path.angle * reference.axis)
            pose = SE3(turn @ turned @ knots[0].rotation, knots[0].translation)
            target = reference.advance(DT, pose, tips, motion.knots[0].q, missed=0.0)
        seen = SE3(turned.T @ target.T_palm_object.rotation, target.T_palm_object.translation)
        return seen, target.tips

    # to the hand it is the same motion, whichever side of a round object it sees
    pose, tips = led(0.0)
    for about in (0.7, 3.1, -2.5):
        again, tips_again = led(about)
        assert again.isApprox(pose, 1e-9)
        np.testing.assert_allclose(tips_again, tips, atol=1e-9)


def test_a_finger_goes_from_where_it_was_to_where_it_lands(
    plan: ManipulationPlan, gait: GaitPlan
) -> None:
    """Its servos pull at nothing when it sets off, and at its way alone when it is there."""
    grasp = plan.motion.grasp
    move = next(phase for phase in gait.phases if isinstance(phase, Relocation))
    hand, index = grasp.task.hand, grasp.task.hand.fingers[move.finger].q_index
    model = hand.pin_model.copy()
    model.gravity.linear = grasp.T_world_base.rotation.T @ grasp.task.gravity
    away = FingerSwing(grasp, move, QUICK.finger_rate)

    def commands(time: float, q: FloatArray) -> FloatArray:
        observation = Observation(
            time=time,
            phase="hold",
            progress=0.0,
            q=q,
            v=np.zeros_like(q),
            T_world_base=grasp.T_world_base,
            T_world_object=move.T_world_object,
            normal_forces=np.zeros(len(grasp.task.fingers)),
            read_twist=lambda: np.zeros(6),
            read_contacts=lambda: move.during,
        )
        return away.command(observation)[away.actuators]

    def resting(q: FloatArray) -> FloatArray:
        """Commands that bear the weight of the finger alone, where it is."""
        torque = pin.computeGeneralizedGravity(model, model.createData(), q)
        return hand.actuation.ctrl_for_torque(q, np.zeros_like(q), torque)[0][away.actuators]

    begin = move.postures[0].copy()
    begin[index] += [0.05, -0.1, 0.1, 0.15]  # the grip has bent it
    np.testing.assert_allclose(commands(1.0, begin), resting(begin), atol=1e-3)
    # one that keeps up is driven on, along its way
    commands(1.0 + 0.3 * away.duration, begin)
    assert away._bent is not None
    here, there = (away._at(share, away._bent) for share in (0.3, 0.31))
    begin[index] = here
    driven = commands(1.0 + 0.3 * away.duration, begin) - resting(begin)
    assert driven @ (there - here) > 0.9 * np.linalg.norm(driven) * np.linalg.norm(there - here)
    end = move.postures[-1].copy()
    np.testing.assert_allclose(commands(1.0 + away.duration, end), resting(end), atol=1e-3)


def test_fingers_find_back_from_half_way(gait: GaitPlan) -> None:
    motion = gait.motion
    half = cut_motion(motion, 0.5)
    assert half.knots[-1].path_parameter == pytest.approx(0.5, abs=0.3)
    assert half.path.angle == pytest.approx(half.knots[-1].path_parameter * motion.path.angle)
    back = plan_back(motion, 1.0)
    assert not isinstance(back, Failure)
    assert sorted(r.finger for r in back) == sorted(motion.grasp.task.finger_names)
    q = back[-1].postures[-1]
    np.testing.assert_allclose(q, motion.knots[0].q, atol=1e-9)


def test_regrasps_are_planned_where_one_stroke_is_not_enough(
    plan: ManipulationPlan, monkeypatch: pytest.MonkeyPatch
) -> None:
    task = plan.motion.grasp.task

    def nothing(*_: object, **__: object) -> ManipulationPlan:
        raise NoGraspFoundError("too far for one stroke", ())

    monkeypatch.setattr(search, "plan_single_stroke", nothing)
    monkeypatch.setattr(search, "plan_regrasping", lambda *_, **__: plan)
    assert plan_manipulation(task, angle=ANGLE) is plan
    monkeypatch.setattr(search, "plan_regrasping", nothing)
    with pytest.raises(NoGraspFoundError, match=r"one stroke\. With regrasps: too far"):
        plan_manipulation(task, angle=ANGLE)
    with pytest.raises(TaskError, match="no table"):
        plan_regrasping(replace(task, table_height=None), angle=ANGLE)


def test_repeated_events_are_one_line() -> None:
    events = [
        Event(time=0.1 * k, kind="contact lost", finger="ring", detail=f"{k}") for k in (1, 3)
    ]
    events.insert(1, Event(time=0.2, kind="finger leaves", finger="ring", detail="as told"))
    events.append(Event(time=0.5, kind="slip", finger="ring", detail="6 mm/s"))
    assert event_lines(events) == [
        "0.10 s contact lost ring 2 times up to 0.30 s, first: 1",
        "0.50 s slip ring: 6 mm/s",
    ]


@pytest.mark.parametrize(
    ("degrees", "friction"), [(90.0, FRICTION), (-90.0, FRICTION), (360.0, REGRASP_FRICTION)]
)
def test_turns_by_regrasps_have_friction_for_it(
    degrees: float, friction: tuple[float, float]
) -> None:
    turns = [
        Turn(
            hand="shadow_hand",
            kind="cylinder",
            number=k,
            height=0.08,
            fingers=None,
            stand=0.0,
            seed=3,
            angle=math.radians(degrees),
        )
        for k in range(100)
    ]
    low, high = friction
    drawn = [t.draw().mu for t in turns]
    assert low <= min(drawn) < low + 0.05 and high - 0.05 < max(drawn) <= high
