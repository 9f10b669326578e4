"""Stops under encoder offsets: answers on paper for a finger of one tendon over two joints."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from test_actuation import make, tendon_finger

from planner.joints.actuation import STOP_TOL
from planner.spatial import FloatArray
from sim.controllers.calibration import (
    LEAST_EFFORT,
    MOST_OFF,
    STILL_TIME,
    StopCorrection,
    servo_commands,
)

BENT = np.array([0.5, 0.5])  # the stop J2 - J1 >= 0 touches
OPEN = np.array([0.7, 0.3])
PRESS = np.array([2.0 * LEAST_EFFORT])
DT = 0.002


def felt(
    joints: StopCorrection,
    q: FloatArray,
    duration: float,
    *,
    pressing: FloatArray = PRESS,
    v: FloatArray | None = None,
) -> None:
    """The stops feel an effort for a time."""
    for _ in range(round(duration / DT)):
        joints.update(DT, q, np.zeros(2) if v is None else v, pressing)


def test_a_stop_that_the_plan_leans_on_carries_in_spite_of_the_reading() -> None:
    finger = tendon_finger()
    read = np.array([0.53, 0.48])  # 0.05 open: a plan would say that nothing carries
    torque = np.array([0.3, 0.1])  # 0.2 (1, 1) + 0.1 (1, -1)
    assert finger.split_torque(read, torque)[1] == pytest.approx([0.0])
    believed = StopCorrection(finger, BENT).corrected(read)
    np.testing.assert_allclose(believed, [0.505, 0.505], atol=1e-12)
    force, stop = finger.split_torque(believed, torque)
    assert (force[0], stop[0]) == pytest.approx((0.2, 0.1))


def test_what_the_plan_leaves_open_stays_open() -> None:
    finger = tendon_finger()
    read = np.array([0.53, 0.48])
    assert StopCorrection(finger, OPEN).corrected(read) is read
    joints = StopCorrection(finger, BENT)
    joints.set_posture(OPEN)
    assert joints.corrected(read) is read


def test_readings_that_agree_with_the_stops_are_left_as_they_are() -> None:
    joints = StopCorrection(tendon_finger(), BENT)
    for gap in (-0.9 * STOP_TOL, 0.0, 0.9 * STOP_TOL, 1.01 * MOST_OFF):
        read = np.array([0.5 + gap, 0.5])
        assert joints.corrected(read) is read
    motors = StopCorrection(make([[1, 0], [0, 1]], [[1, 0]], [0.0]), np.zeros(2))
    assert not motors.acts  # a stop along a motor carries nothing that the motor cannot
    read = np.array([0.05, 0.0])
    assert motors.corrected(read) is read


def test_no_joint_is_beyond_its_stop() -> None:
    joints = StopCorrection(tendon_finger(), OPEN)
    np.testing.assert_allclose(joints.corrected(np.array([0.4, 0.5])), [0.45, 0.45], atol=1e-12)


@given(
    st.floats(-0.2, 0.2),
    st.floats(0.2, 1.0),
    st.floats(STOP_TOL * 1.01, MOST_OFF * 0.99),
    st.floats(0.5, 2.0),
)
def test_a_correction_closes_the_stop_and_keeps_the_tendon(
    other: float, middle: float, gap: float, pull: float
) -> None:
    """Least change: along the stop's row only, and a tendon over both keeps its length."""
    hand = make([[pull, pull, 0.0], [0.0, 0.0, 1.0]], [[1, -1, 0], [0, 0, 1]], [0.0, -1.0])
    read = np.array([middle + gap, middle, other])
    believed = StopCorrection(hand, np.array([middle, middle, other])).corrected(read)
    assert believed[0] - believed[1] == pytest.approx(0.0, abs=1e-12)
    np.testing.assert_allclose(hand.moment @ believed, hand.moment @ read, atol=1e-12)


def test_effort_at_rest_confirms_where_a_stop_is() -> None:
    joints = StopCorrection(tendon_finger(), BENT)
    read = np.array([0.53, 0.48])
    felt(joints, read, STILL_TIME + DT)
    assert joints.offset == pytest.approx([0.05])
    joints.set_posture(OPEN)  # no plan needs to say so from now on
    np.testing.assert_allclose(joints.corrected(read), [0.505, 0.505], atol=1e-12)
    # 0.08 open as read is 0.03 open
    moved = joints.corrected(np.array([0.56, 0.48]))
    assert moved[0] - moved[1] == pytest.approx(0.03)


def test_a_reading_below_the_stop_is_an_offset_too() -> None:
    joints = StopCorrection(tendon_finger(), BENT)
    felt(joints, np.array([0.47, 0.52]), STILL_TIME + DT)
    assert joints.offset == pytest.approx([-0.05])
    joints.set_posture(OPEN)
    # read as closed, open by 0.05
    moved = joints.corrected(np.array([0.5, 0.5]))
    assert moved[0] - moved[1] == pytest.approx(0.05)


@pytest.mark.parametrize(
    ("gap", "duration", "effort", "rate"),
    [
        (0.05, STILL_TIME - 2 * DT, 2.0, 0.0),  # too short
        (0.05, 1.0, 0.9, 0.0),  # a spring or friction could bear it
        (0.05, 1.0, 2.0, 0.3),  # it moves: nothing bears it
        (0.9 * STOP_TOL, 1.0, 2.0, 0.0),  # nothing is off
        (1.1 * MOST_OFF, 1.0, 2.0, 0.0),  # no encoder is off by that much: something else bears it
    ],
)
def test_what_is_no_evidence(gap: float, duration: float, effort: float, rate: float) -> None:
    joints = StopCorrection(tendon_finger(), BENT)
    read = np.array([0.5 + gap, 0.5])
    pressing = np.array([effort * LEAST_EFFORT])
    felt(joints, read, duration, pressing=pressing, v=np.array([rate, 0.0]))
    assert np.isnan(joints.offset).all()


def test_a_servo_gets_its_torque_at_the_joints_that_it_reads() -> None:
    """Force = kp (ctrl - length as read); what stops are believed does not change that."""
    kp = 3.0
    finger = replace(tendon_finger(), gain=np.array([kp]), bias=np.array([[0.0, -kp, 0.0]]))
    torque, read = np.array([0.3, 0.1]), np.array([0.53, 0.41])
    believed = np.array([0.5, 0.5])  # a tendon 0.06 longer than read
    ctrl = servo_commands(finger, read, believed, np.zeros(2), torque)
    assert kp * (ctrl[0] - read.sum()) == pytest.approx(0.2)  # the stop has 0.1
    same = servo_commands(finger, believed, believed, np.zeros(2), torque)
    np.testing.assert_array_equal(same, finger.commands(believed, np.zeros(2), torque))


def test_a_command_stays_within_its_range() -> None:
    finger = replace(
        tendon_finger(),
        gain=np.array([1.0]),
        bias=np.array([[0.0, -1.0, 0.0]]),
        ctrl_range=np.array([[-1.0, 1.05]]),
    )
    ctrl = servo_commands(
        finger, np.array([0.6, 0.5]), np.array([0.5, 0.5]), np.zeros(2), np.array([0.05, 0.05])
    )
    assert ctrl == pytest.approx([1.05])
