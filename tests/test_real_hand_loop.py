"""The loop that drives a hand: deadlines, limits, emergencies, with a clock of the tests' own."""

from __future__ import annotations

import time
from dataclasses import replace
from typing import Any, cast

import numpy as np
import pytest
from hands_in_loops import FakeClock, FakeHand, Steady, at, failing, looped, unplugged
from hypothesis import given, settings
from hypothesis import strategies as st

from planner.errors import HandError, NotFoundError, TaskError
from planner.hand_loading import load_hand
from planner.hands.hand import Hand
from planner.spatial import FloatArray
from sim.controllers.base import PadReading
from sim.real_hand import (
    CommandLimits,
    HandObservation,
    Observer,
    OnStop,
    RealClock,
    Safety,
)
from sim.real_hand.interface import Pace

PERIOD = 0.01

HAND = load_hand("allegro_hand")
NU = len(HAND.actuation.names)
LOW, HIGH = HAND.actuation.ctrl_range.T
BEGIN = np.clip(HAND.neutral, LOW, HIGH)  # its servos ask for the length of their joint
MIDDLE = (LOW + HIGH) / 2


def fake(**options: Any) -> FakeHand:
    return FakeHand(HAND, FakeClock(), **options)


# deadlines


def counted(costs: list[float], ticks: int) -> tuple[int, int, int]:
    """Ticks, misses and skipped slots, by going through the slots one by one, in whole parts."""
    part = 1000  # of a period
    left = [round(cost / PERIOD * part) for cost in costs]
    now = slot = done = misses = skipped = 0
    while slot < ticks:
        now = max(now, slot * part)
        now += left.pop(0) if left else 0
        done += 1
        late = now > (slot + 1) * part
        misses += late
        following = slot + 1
        while late and (following + 1) * part <= now:
            following += 1
            skipped += 1
        slot = following
    return done, misses, skipped


def test_a_loop_in_time_misses_nothing() -> None:
    hand = fake(costs=[0.004] * 20)
    _, report = looped(hand, Steady(MIDDLE), 20)
    assert (report.ticks, report.written, report.misses, report.skipped) == (20, 20, 0, 0)
    assert report.done and not hand.stops
    begun = np.diff([t for t, _ in hand.writes])
    assert begun == pytest.approx(PERIOD)
    assert report.latency_us.worst == pytest.approx(4000.0)


def test_deadlines_are_counted_one_by_one() -> None:
    # a little late; then two and a half slots late, of which one is skipped; then one in time
    hand = fake(costs=[0.001, 0.012, 0.001, 0.025, 0.001])
    loop, report = looped(hand, Steady(MIDDLE), 12)
    assert (report.misses, report.skipped, report.most_misses_in_a_row) == (2, 1, 1)
    # the slot after a miss begins at once, and the loop is back in time after it
    begins = loop.log.log().begin_s - 100.0
    assert begins[:7] == pytest.approx([0.0, 0.01, 0.022, 0.03, 0.055, 0.06, 0.07])
    assert report.latency_us.worst == pytest.approx(25000.0)


@settings(deadline=None, max_examples=60)
@given(st.lists(st.integers(0, 60).filter(lambda k: k % 10), max_size=25), st.integers(1, 30))
def test_any_costs_are_counted_exactly(tenths: list[int], ticks: int) -> None:
    costs = [k / 10 * PERIOD for k in tenths]
    _, report = looped(fake(costs=costs), Steady(MIDDLE), ticks)
    assert (report.ticks, report.misses, report.skipped) == counted(costs, ticks)


def test_misses_in_a_row_end_the_run() -> None:
    costs = [0.001, 0.015, 0.001] + [0.015] * 40
    hand = fake(costs=costs)
    bounds = Safety(misses_in_a_row=4, max_age=1.0)
    _, report = looped(hand, Steady(MIDDLE), 100, safety=bounds)
    assert report.reason == "deadline misses"
    assert "4 in a row at 100 Hz" in report.detail
    assert report.most_misses_in_a_row == 4
    assert hand.stops == 1


def test_the_real_clock_goes_on_and_waits() -> None:
    clock = RealClock()
    begin = clock.now()
    clock.sleep_until(begin + 0.02)
    assert 0.02 <= clock.now() - begin < 5.0
    clock.sleep_until(begin)  # in the past: at once
    pace = Pace(clock, 0.01)
    pace.begin()
    time.sleep(0.012)
    assert pace.end()
    assert pace.misses == 1


# limits of commands


@settings(deadline=None, max_examples=60)
@given(
    wanted=st.lists(
        st.tuples(st.integers(0, NU - 1), st.floats(-1e6, 1e6)), min_size=1, max_size=30
    ),
    costs=st.lists(st.floats(0.0, 0.035), max_size=30),
    rate=st.floats(0.01, 50.0),
)
def test_no_command_moves_faster_than_its_rate(
    wanted: list[tuple[int, float]], costs: list[float], rate: float
) -> None:
    def want(k: int) -> FloatArray:
        commands = MIDDLE.copy()
        actuator, value = wanted[k % len(wanted)]
        commands[actuator] = value
        return np.asarray(commands)

    hand = fake(costs=costs)
    looped(hand, Steady(want), 40, limits=CommandLimits(rate=rate))
    times = np.array([t for t, _ in hand.writes])
    commands = np.array([c for _, c in hand.writes])
    assert commands[0] == pytest.approx(BEGIN, abs=1e-12)  # where it is, whatever is wanted
    change = np.abs(np.diff(commands, axis=0)).max(axis=1)
    assert (change <= rate * np.diff(times) + 1e-12).all()
    assert (change <= rate * PERIOD + 1e-12).all()  # a late loop does not leap
    assert (commands >= LOW - 1e-12).all() and (commands <= HIGH + 1e-12).all()


def test_without_limits_commands_are_those_of_the_controller() -> None:
    hand = fake()
    _, report = looped(hand, Steady(MIDDLE), 3, limits=CommandLimits.none())
    assert all((c == MIDDLE).all() for _, c in hand.writes)
    assert not report.clamped and not report.rate_limited


def test_what_is_clamped_and_limited_is_counted_by_actuator() -> None:
    wanted = BEGIN.copy()
    wanted[3] = HIGH[3] + 1.0
    hand = fake()
    rate = (HIGH[3] - BEGIN[3]) / (4 * PERIOD) * 1.0001
    _, report = looped(hand, Steady(wanted), 10, limits=CommandLimits(rate=rate))
    name = HAND.actuation.names[3]
    assert report.clamped == {name: 10}
    assert report.rate_limited == {name: 4}  # the first, which stays, and three on the way
    assert hand.writes[-1][1][3] == HIGH[3]


def test_a_narrower_range_is_kept() -> None:
    name = HAND.actuation.names[0]
    hand = fake()
    looped(hand, Steady(HIGH), 60, limits=CommandLimits(ranges={name: (-0.1, 0.2)}, rate=10.0))
    assert hand.writes[-1][1][0] == 0.2
    assert hand.writes[-1][1][1] == HIGH[1]


@pytest.mark.parametrize(
    ("limits", "error", "words"),
    [
        ({"rate": 0.0}, TaskError, "give a number > 0 in rad/s"),
        ({"rate": float("nan")}, TaskError, "give a number > 0"),
        ({"rate": {"A_index_9": 1.0}}, NotFoundError, "Did you mean"),
        ({"ranges": {"A_index_0": (0.2, -0.1)}}, TaskError, "the smaller one first"),
        ({"ranges": {"A_index_0": (-9.0, 0.0)}}, TaskError, r"within \[-0.7034"),
    ],
)
def test_limits_that_cannot_be_are_refused(
    limits: dict[str, Any], error: type[Exception], words: str
) -> None:
    hand = fake()
    with pytest.raises(error, match=words):
        looped(hand, Steady(MIDDLE), 3, limits=CommandLimits(**limits))
    assert not hand.writes


# emergencies

NAN = float("nan")


def with_nan(values: FloatArray) -> FloatArray:
    out = values.copy()
    out[2] = NAN
    return out


PADS = PadReading(
    normal_force=np.ones(4),
    force=np.ones((4, 3)),
    position=np.zeros((4, 3)),
    normal=np.tile([0.0, 0.0, 1.0], (4, 1)),
    sliding=np.zeros((4, 3)),
    spin=np.zeros(4),
)


def bad_pads(name: str, value: float) -> Any:
    """A reading whose pads have one bad number, of the third finger."""
    array = np.array(getattr(PADS, name))
    array[(2, 1) if array.ndim == 2 else 2] = value
    return at(5, pads=replace(PADS, **cast(Any, {name: array})))


READINGS: dict[str, tuple[Any, str, str]] = {
    "joint NaN": (at(5, joints=with_nan), "reading not finite", "joints hold NaN"),
    "velocity NaN": (at(5, velocities=with_nan), "reading not finite", "velocities"),
    "effort NaN": (at(5, efforts=with_nan), "reading not finite", "efforts"),
    "velocity huge": (at(5, velocities=lambda v: v + 1e300), "reading not finite", "velocities"),
    **{
        f"pads {name} {value}": (bad_pads(name, value), "reading not finite", f"{name} of the pads")
        for name in ("normal_force", "force", "position", "normal", "sliding", "spin")
        for value in (NAN, np.inf, 1e9)
    },
    "time NaN": (at(5, time=NAN), "reading stale", "nan"),
    "old": (at(5, time=lambda t: t - 0.2), "reading stale", "0.2 s old"),
    "other clock": (at(5, time=lambda t: t + 1e9), "reading stale", "on the loop's clock?"),
    "beyond": (at(5, joints=lambda q: q + 3.0), "joint limit", "index_0 is at 3.000 rad"),
    "below": (at(5, joints=lambda q: q - 3.0), "joint limit", "index_0 is at -3.000 rad"),
    "effort": (at(5, efforts=lambda f: f - 0.9), "effort limit", "makes -0.9 N m; at most 0.84"),
    "shape": (at(5, joints=lambda q: q[:4]), "interface failed", "joints have shape (4,)"),
    "unplugged": (failing(5, unplugged()), "interface failed", "servo 3 does not answer"),
    "system": (failing(5, OSError("no such device")), "interface failed", "no such device"),
    "Ctrl-C": (failing(5, KeyboardInterrupt()), "interrupted", "Ctrl-C"),
}


@pytest.mark.parametrize("on_stop", ["torque off", "hold"])
@pytest.mark.parametrize("name", READINGS)
def test_a_bad_reading_ends_the_run_and_nothing_is_written_any_more(
    name: str, on_stop: OnStop
) -> None:
    change, reason, words = READINGS[name]
    hand = fake(change=change)
    loop, report = looped(hand, Steady(MIDDLE), 20, safety=Safety(on_stop=on_stop))
    assert report.reason == reason
    assert words in report.detail
    assert report.on_stop == on_stop and report.stopped and not report.done
    assert len(hand.writes) == report.written == report.ticks == 5
    assert hand.reads == 6
    assert hand.stops == (on_stop == "torque off")
    assert len(loop.log.log()) == 5
    with pytest.raises(TaskError, match="make a new one"):
        loop.run(lambda loop: None)


COMMANDS: dict[str, tuple[Any, str]] = {
    "NaN": (lambda k: with_nan(MIDDLE) if k == 5 else MIDDLE, "command for A_index_2 is not"),
    "infinity": (lambda k: MIDDLE + np.inf if k == 5 else MIDDLE, "is not finite"),
    "shape": (lambda k: MIDDLE[:3] if k == 5 else MIDDLE, "shape (3,); the hand needs (16,)"),
}


@pytest.mark.parametrize("name", COMMANDS)
def test_a_bad_command_is_not_written(name: str) -> None:
    wanted, words = COMMANDS[name]
    hand = fake()
    _, report = looped(hand, Steady(wanted), 20)
    assert report.reason == "bad command"
    assert words in report.detail
    assert len(hand.writes) == 5 and hand.stops == 1


def test_the_caller_may_stop_it() -> None:
    hand = fake()
    controller = Steady(MIDDLE)
    bounds = Safety(stop=lambda: controller.ticks > 7)
    _, report = looped(hand, controller, 20, safety=bounds)
    assert report.reason == "asked"
    assert controller.ticks == 8 and len(hand.writes) == 7  # asked after the controller
    assert hand.stops == 1


def test_ctrl_c_while_writing_ends_the_run() -> None:
    hand = fake()

    def pressed(k: int) -> None:
        if k == 4:
            raise KeyboardInterrupt

    hand.write_fault = pressed
    loop, report = looped(hand, Steady(MIDDLE), 20)
    assert report.reason == "interrupted"
    assert len(hand.writes) == 4 and report.written == 4
    log = loop.log.log()
    assert (
        len(log) == 5 and np.isnan(log.commands[4]).all()
    )  # what was not written is not said to be
    assert np.isfinite(log.commands[:4]).all()


def test_a_write_that_fails_ends_the_run() -> None:
    hand = fake()

    def broken(k: int) -> None:
        if k == 4:
            raise OSError("bus error")

    hand.write_fault = broken
    _, report = looped(hand, Steady(MIDDLE), 20)
    assert (report.reason, report.detail) == ("interface failed", "writing: bus error")
    assert report.written == 4 and hand.stops == 1


def test_a_fault_of_the_program_stops_the_hand_and_is_seen() -> None:
    def broken(k: int) -> FloatArray:
        return np.asarray(MIDDLE if k < 5 else MIDDLE[[99]])

    hand = fake()
    with pytest.raises(IndexError):
        looped(hand, Steady(broken), 20)
    assert len(hand.writes) == 5 and hand.stops == 1


def test_a_torque_that_cannot_be_taken_off_is_told() -> None:
    hand = fake(change=failing(3, unplugged()))

    def fails() -> None:
        raise OSError("port closed")

    hand.stop = fails  # type: ignore[method-assign]
    _, report = looped(hand, Steady(MIDDLE), 20)
    assert report.on_stop == "torque off FAILED"
    assert "cut the power" in report.detail


def test_a_joint_beyond_its_limit_at_the_start_is_not_moved() -> None:
    hand = fake(change=at(0, joints=lambda q: q + 3.0))
    _, report = looped(hand, Steady(MIDDLE), 20, safety=Safety())
    assert report.reason == "joint limit"
    assert not hand.writes


def test_efforts_that_are_not_read_are_not_checked_and_that_is_said() -> None:
    hand = fake(change=lambda k, reading: at(k, efforts=None)(k, reading))
    _, report = looped(hand, Steady(MIDDLE), 5)
    assert report.done and not report.efforts_checked
    assert looped(fake(), Steady(MIDDLE), 5)[1].efforts_checked


def test_own_bounds_of_efforts_are_kept() -> None:
    change = at(5, efforts=lambda f: f + 0.2)
    name = HAND.actuation.names[7]
    for most in (0.1, {name: 0.1}):
        hand = fake(change=change)
        _, report = looped(hand, Steady(MIDDLE), 20, safety=Safety(max_effort=most))
        assert report.reason == "effort limit"
    _, report = looped(fake(change=change), Steady(MIDDLE), 20, safety=Safety(max_effort=0.3))
    assert report.done


@pytest.mark.parametrize(
    ("bad", "words"),
    [
        ({"max_age": 0.0}, "max_age is 0.0"),
        ({"joint_margin": -1.0}, "joint_margin is -1.0"),
        ({"misses_in_a_row": 0}, "misses_in_a_row is 0"),
        ({"max_effort": -1.0}, "max_effort is -1.0"),
        ({"on_stop": "panic"}, "no way to stop is called 'panic'"),
    ],
)
def test_bounds_that_cannot_be_are_refused(bad: dict[str, Any], words: str) -> None:
    with pytest.raises((TaskError, NotFoundError), match=words):
        Safety(**bad)


# names and readings


def test_names_in_another_order_are_matched() -> None:
    joints, actuators = HAND.joint_names[::-1], HAND.actuation.names[3:] + HAND.actuation.names[:3]
    hand = fake(joints=joints, actuators=actuators)
    hand.q += np.linspace(0.0, 0.05, NU)
    controller = Steady(np.linspace(0.0, 0.3, NU))
    looped(hand, controller, 4, limits=CommandLimits.none())
    assert controller.seen[0].q == pytest.approx(hand.q[::-1])
    by_name = dict(zip(actuators, hand.writes[-1][1], strict=True))
    assert by_name == pytest.approx(
        dict(zip(HAND.actuation.names, np.linspace(0.0, 0.3, NU), strict=True))
    )


@pytest.mark.parametrize(
    ("names", "words"),
    [
        (("index_0",), "lacks index_1"),
        ((*HAND.joint_names[:-1], "wrist"), "has wrist, which the model has not"),
        ((*HAND.joint_names, "index_0"), "index_0 more than once"),
    ],
)
def test_other_names_are_refused(names: tuple[str, ...], words: str) -> None:
    hand = fake()
    hand.joint_names = names
    with pytest.raises(HandError, match=words):
        Observer(hand, HAND)


def test_a_rate_above_that_of_the_hand_is_refused() -> None:
    with pytest.raises(TaskError, match="at 200 Hz at most"):
        looped(fake(rate_hz=200.0), Steady(MIDDLE), 3, rate_hz=500.0)


def test_readings_that_come_again_are_counted() -> None:
    hand = fake()
    frozen = hand.clock.time

    def again(k: int, reading: Any) -> Any:
        return at(k, time=frozen)(k, reading) if k < 4 else reading

    hand.change = again
    _, report = looped(hand, Steady(MIDDLE), 10, safety=Safety())
    assert report.repeated_readings == 3
    assert report.oldest_reading_ms == pytest.approx(30.0)


def test_the_time_that_a_controller_sees_begins_at_zero() -> None:
    controller = Steady(MIDDLE)
    looped(fake(), controller, 4)
    assert [o.time for o in controller.seen] == pytest.approx([0.0, 0.01, 0.02, 0.03])
    assert [o.progress for o in controller.seen] == pytest.approx([0.0, 0.25, 0.5, 0.75])


def test_a_report_is_plain_data_and_a_table() -> None:
    _, report = looped(fake(), Steady(MIDDLE), 4)
    data = report.to_dict()
    assert data["format"] == "opposable-loop-report" and data["version"] == 1
    assert data["done"] and data["ticks"] == 4 and data["misses"] == 0
    assert set(data["latency_us"]) == {"p50", "p99", "worst"}
    assert str(report) == "done: 4 ticks at 100 Hz, 0 deadlines missed"


def test_the_model_is_the_one_that_the_tests_reckon_with(hand: Hand = HAND) -> None:
    """Position servos of one joint each: their command is the joint's angle."""
    assert (hand.actuation.moment == np.eye(NU)).all()
    assert (hand.actuation.gain == -hand.actuation.bias[:, 1]).all()


def test_a_reading_that_is_changed_takes_the_place_of_what_was_read() -> None:
    """As where pads are moved by what is believed of joints: the old reading is not told again."""
    before, after, q = object(), object(), np.zeros(2)
    observation = HandObservation({"q": q, "read_pads": lambda: before})
    assert observation.pads is before
    moved = observation.altered(read_pads=lambda: after)
    assert moved.pads is after and observation.pads is before
    assert moved.altered(time=1.0).pads is after and moved.q is q
