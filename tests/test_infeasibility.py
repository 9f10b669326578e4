"""``InfeasibilityMonitor``: when a missed wrench is noted, gives way, and is given up."""

from __future__ import annotations

import numpy as np
import pytest

from sim.controllers.monitors import (
    GIVING_TIME,
    GIVING_TOL,
    INFEASIBLE_TIME,
    LEAST_GIVEN,
    MISSED_TOL,
    PATIENCE,
    TAKING_TIME,
    InfeasibilityMonitor,
)

STEP = 0.002


def watched() -> InfeasibilityMonitor:
    """Four fingers, of which two can hold."""
    return InfeasibilityMonitor(2, ("thumb", "index", "middle", "ring"), "box")


def run(
    monitor: InfeasibilityMonitor,
    time: float,
    *,
    short: float = 0.0,
    asked: float = 2.0,
    holding: int = 3,
) -> list[str]:
    """What is noted within a time (s)."""
    notes = []
    for _ in range(round(time / STEP)):
        holds = np.arange(4) < holding
        notes += monitor.update(STEP, residual=short, wanted=asked, holding=holds)
    return [kind for kind, _ in notes]


def test_a_wrench_is_missed_from_a_share_of_it_on() -> None:
    """2 N are asked for: 0.1 N may be left over."""
    monitor = watched()
    assert run(monitor, 2 * PATIENCE, short=0.99 * MISSED_TOL * 2.0) == []
    assert run(monitor, 2 * INFEASIBLE_TIME, short=1.01 * MISSED_TOL * 2.0) == ["infeasible"]


def test_the_least_forces_give_way_and_come_back() -> None:
    monitor = watched()
    run(monitor, GIVING_TIME, short=0.99 * GIVING_TOL * 2.0)
    assert monitor.grip_share == 1.0
    run(monitor, GIVING_TIME / 2, short=1.01 * GIVING_TOL * 2.0)  # long before it is infeasible
    assert monitor.grip_share == pytest.approx(0.5, abs=0.05)
    run(monitor, GIVING_TIME, short=1.0)
    assert monitor.grip_share == LEAST_GIVEN
    run(monitor, 0.2 * TAKING_TIME)
    assert monitor.grip_share == pytest.approx(LEAST_GIVEN + 0.2, abs=0.01)


def test_it_gives_up_once_and_goes_on_when_the_wrench_can_be_had() -> None:
    monitor = watched()
    assert run(monitor, 0.9 * PATIENCE, short=1.0) == ["infeasible"]
    assert not monitor.gave_up
    assert run(monitor, PATIENCE, short=1.0) == ["gave up"]
    who = "thumb, index, middle on box"
    assert f"{who}: 1.00 N of 2.00 N cannot be exerted, for" in monitor.gave_up
    assert run(monitor, STEP) == ["feasible again"]
    assert not monitor.gave_up


def test_too_few_fingers_are_given_up_until_they_hold_again() -> None:
    monitor = watched()
    assert run(monitor, 1.1 * PATIENCE, holding=1) == ["gave up"]
    assert "only 1 fingers" in monitor.gave_up
    assert run(monitor, STEP, holding=2) == [] and not monitor.gave_up
