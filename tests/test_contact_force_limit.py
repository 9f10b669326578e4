"""Light effort before the squeeze: servos on paper, and a free hand that must not notice."""

from __future__ import annotations

import numpy as np
import pytest

from planner.hand_loading import load_hand
from planner.hands.hand import Hand
from planner.kinematics import HandState
from planner.spatial import FloatArray
from sim.controllers.hand_dynamics import CONTACT_TORQUE, ContactForceLimit, joint_drag


@pytest.fixture(scope="module", params=["allegro_hand", "shadow_hand", "shadow_hand_torque"])
def hand(request: pytest.FixtureRequest) -> Hand:
    return load_hand(request.param)


def weight_of(hand: Hand) -> FloatArray:
    return HandState(hand, hand.neutral).gravity_torque(np.array([0.0, 0.0, -9.81]))


def pushed(hand: Hand, ctrl: FloatArray, v: FloatArray) -> FloatArray:
    """Actuator forces (nu,) by the affine law."""
    a = hand.actuation
    length = a.moment @ hand.neutral + a.length0
    return np.asarray(
        a.gain * ctrl + a.bias[:, 0] + a.bias[:, 1] * length + a.bias[:, 2] * (a.moment @ v)
    )


def of_fingers(hand: Hand) -> FloatArray:
    """Which actuators drive a finger's joint, (nu,)."""
    driven = np.concatenate([f.q_index for f in hand.fingers.values()])
    return np.asarray((hand.actuation.moment[:, driven] != 0).any(axis=1))


def test_weight_and_drag_are_let(hand: Hand) -> None:
    v = np.full(hand.nq, 0.8)
    drag, stiction = joint_drag(hand)
    weight = weight_of(hand)
    ctrl = hand.actuation.commands(hand.neutral, v, weight + drag * v + stiction)
    light = ContactForceLimit(hand)
    np.testing.assert_array_equal(light.commands(ctrl, hand.neutral, v, weight), ctrl)


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_what_blocks_a_finger_is_pushed_lightly_and_the_wrist_is_stiff(
    hand: Hand, sign: float
) -> None:
    still, weight = np.zeros(hand.nq), weight_of(hand)
    held = hand.actuation.commands(hand.neutral, still, weight)
    # each actuator asks for 0.4 N m more than the weight: a servo of 3 N m/rad, 8 degrees short
    ctrl = held + sign * 0.4 / hand.actuation.gain
    limited = ContactForceLimit(hand).commands(ctrl, hand.neutral, still, weight)
    more = pushed(hand, limited, still) - pushed(hand, held, still)
    expected = np.where(of_fingers(hand), CONTACT_TORQUE, 0.4) * sign
    np.testing.assert_allclose(more, expected, atol=1e-9)
