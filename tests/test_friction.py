"""Dry friction that is felt on the way: on paper, in trials, and made up for in a turn."""

from __future__ import annotations

import numpy as np
import pytest
from conftest import PlanOf

from planner.hand_loading import load_hand
from planner.hands.hand import Hand
from planner.kinematics import HandState
from planner.plan import GraspPlan
from planner.spatial import FloatArray
from sim.controllers import GraspController, Observation
from sim.controllers.hand_dynamics import FAST, LEAST_TIME, FrictionEstimate, joint_drag
from sim.controllers.torques import LEVER, HoldingTorques
from sim.scene.carrier import Timeline
from sim.sensing.errors import ErrorModel
from sim.trial import simulate

GRAVITY = np.array([0.0, 0.0, -9.81])
DT = 0.002


@pytest.fixture(scope="module", params=["allegro_hand", "shadow_hand", "shadow_hand_torque"])
def hand(request: pytest.FixtureRequest) -> Hand:
    return load_hand(request.param)


def of_fingers(hand: Hand) -> FloatArray:
    driven = np.zeros(hand.nq)
    for finger in hand.fingers.values():
        driven[finger.q_index] = 1.0
    return driven


def moved(hand: Hand, friction: float, rate: float, seconds: float) -> FloatArray:
    """What is found of joints that move evenly, to and fro, against a friction."""
    found = FrictionEstimate(hand)
    weight = HandState(hand, hand.neutral).gravity_torque(GRAVITY)
    drag, stiction = joint_drag(hand)
    for k in range(round(seconds / DT)):
        v = np.full(hand.nq, rate * (-1) ** k)
        torque = weight + drag * v + (stiction + friction) * np.sign(v)
        ctrl = hand.actuation.commands(hand.neutral, v, torque)
        found.update(DT, ctrl, hand.neutral, v, weight)
    return found.extra


def test_friction_on_paper_is_found_in_fingers_and_nowhere_else(hand: Hand) -> None:
    driven = of_fingers(hand)
    found = moved(hand, 0.02, 2.0 * FAST, 2.0 * LEAST_TIME)
    np.testing.assert_allclose(found, 0.02 * driven, atol=1e-6)


@pytest.mark.parametrize(
    ("friction", "rate", "seconds"),
    [(0.0, 1.0, 1.0), (0.002, 1.0, 1.0), (0.02, 0.5 * FAST, 1.0), (0.02, 1.0, 0.5 * LEAST_TIME)],
)
def test_nothing_is_claimed_of_little_friction_or_of_little_motion(
    hand: Hand, friction: float, rate: float, seconds: float
) -> None:
    assert not moved(hand, friction, rate, seconds).any()


@pytest.fixture(scope="module", params=["allegro_hand", "shadow_hand"])
def plan(request: pytest.FixtureRequest, plan_of: PlanOf) -> GraspPlan:
    return plan_of(request.param, "cylinder")


BRIEF = Timeline(approach=0.3, lift=0.1, hold=0.1, lift_height=0.01)
"""Long enough where fingers move: it is there that friction is felt."""


class Watched(GraspController):
    """Tells what friction it had found when it began to squeeze."""

    found: FloatArray

    def step(self, observation: Observation) -> FloatArray:
        self.found = self.friction.extra
        return super().step(observation)


@pytest.mark.slow
@pytest.mark.parametrize("friction", [0.0, 0.02])
def test_a_trial_finds_the_friction_that_the_model_does_not_have(
    plan: GraspPlan, friction: float
) -> None:
    made: list[Watched] = []

    def make(plan: GraspPlan) -> Watched:
        made.append(Watched(plan))
        return made[0]

    error_model = ErrorModel(name="dry", dry_friction=friction, encoder_offset=1e-9)
    simulate(plan, controller=make, error_model=error_model, timeline=BRIEF)
    expected = friction * of_fingers(plan.task.hand)
    np.testing.assert_allclose(made[0].found, expected, atol=0.002)


def test_what_is_found_is_made_up_for_along_the_motion(plan: GraspPlan) -> None:
    rate = np.where(np.arange(len(plan.q)) % 3 == 0, -0.4, 0.4)
    tips = np.zeros((len(plan.task.fingers), 3))

    def torque(friction: float) -> FloatArray:
        torques = HoldingTorques(plan)
        torques.compensate(np.full(len(plan.q), friction))
        torques.move(plan.q, np.zeros(len(plan.q)), GRAVITY)
        torques.aim(tips, plan.q, rate)
        return torques.own_torque

    expected = 0.02 * np.sign(rate) * of_fingers(plan.task.hand)
    np.testing.assert_allclose(torque(0.02) - torque(0.0), expected, atol=1e-12)


def test_a_finger_that_looks_for_the_object_overcomes_what_was_found(plan: GraspPlan) -> None:
    """Half a newton at its tip would not: joints of 0.02 N m stay where they are."""
    n, nq = len(plan.task.fingers), len(plan.q)
    contacts = plan.contacts.transformed(plan.T_world_base.inverse())
    searching = np.arange(n) == 1

    def torque(friction: float) -> FloatArray:
        torques = HoldingTorques(plan)
        torques.compensate(np.full(nq, friction))
        torques.move(plan.q, np.zeros(nq), GRAVITY)
        torques.touch(contacts.positions, contacts.center, ~searching)
        ctrl = torques.commands(np.zeros((n, 3)), contacts.normals, ~searching, searching)
        actuation = plan.task.hand.actuation
        return np.asarray(actuation.moment.T @ (actuation.gain * ctrl))

    def along(q: FloatArray) -> float:
        joint = plan.task.fingers[1].pad.joint_id
        fixed = HandState(plan.task.hand, plan.q).joint_pose(joint).actInv(contacts.positions[1])
        return float(
            HandState(plan.task.hand, q).joint_pose(joint).act(fixed) @ contacts.normals[1]
        )

    step = 1e-6
    lever = np.array([(along(plan.q + step * e) - along(plan.q)) / step for e in np.eye(nq)])
    mine = np.zeros(nq)
    mine[plan.task.fingers[1].q_index] = 1.0
    expected = 0.02 * mine * np.clip(lever / LEVER, -1.0, 1.0)
    # a tendon shares it between its joints
    moment = plan.task.hand.actuation.moment
    np.testing.assert_allclose(moment @ (torque(0.02) - torque(0.0)), moment @ expected, atol=1e-6)
    assert np.abs(expected).max() == pytest.approx(0.02)


def test_what_stuck_joints_may_keep_from_a_finger(plan: GraspPlan) -> None:
    """On paper: the joint with the longest lever along the normal bears least force."""
    n, nq = len(plan.task.fingers), len(plan.q)
    contacts = plan.contacts.transformed(plan.T_world_base.inverse())
    torques = HoldingTorques(plan)
    torques.move(plan.q, np.zeros(nq), GRAVITY)
    torques.touch(contacts.positions, contacts.center, np.ones(n, dtype=bool))
    np.testing.assert_array_equal(torques.held_back(contacts.normals), 0.0)
    torques.compensate(np.full(nq, 0.02))
    state = HandState(plan.task.hand, plan.q)
    for i, finger in enumerate(plan.task.fingers):
        at = state.point_jacobian(finger.pad.joint_id, contacts.positions[i])[:3]
        lever = np.abs(contacts.normals[i] @ at[:, finger.q_index])
        force = torques.held_back(contacts.normals)[i]
        assert (lever * force <= 0.02 + 1e-12).all()
        assert (lever * force).max() == pytest.approx(0.02)
