"""A hand and a clock for tests of loops: everything that happens is written into them."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import Any

import numpy as np

from planner.errors import HandError
from planner.hands.hand import Hand
from planner.spatial import FloatArray
from sim.controllers import Observation
from sim.real_hand import CommandLimits, ControlLoop, HandReading, LoopReport, Observer, Safety


class FakeClock:
    """Time that passes only where it is told to."""

    def __init__(self, start: float = 100.0) -> None:
        """Begin at a time, s."""
        self.time = start

    def now(self) -> float:
        return self.time

    def sleep_until(self, moment: float) -> None:
        self.time = max(self.time, moment)


class FakeHand:
    """A hand that stands still; each read takes the next of ``costs`` (s), then none.

    ``change`` may change a reading, or raise, by the number of the read.
    """

    def __init__(
        self,
        hand: Hand,
        clock: FakeClock,
        *,
        costs: Iterable[float] = (),
        change: Callable[[int, HandReading], HandReading] = lambda k, reading: reading,
        joints: tuple[str, ...] | None = None,
        actuators: tuple[str, ...] | None = None,
        rate_hz: float = 1000.0,
    ) -> None:
        """Nothing was read or written."""
        self.hand, self.clock = hand, clock
        self.joint_names = joints or hand.joint_names
        self.actuator_names = actuators or hand.actuation.names
        self.finger_names: tuple[str, ...] = ()
        self.rate_hz = rate_hz
        self.costs, self.change = list(costs), change
        self.q = np.array([hand.neutral[hand.joint_names.index(n)] for n in self.joint_names])
        self.reads = 0
        self.writes: list[tuple[float, FloatArray]] = []
        self.stops = self.closes = 0
        self.write_fault: Callable[[int], None] = lambda k: None

    def read(self) -> HandReading:
        k, self.reads = self.reads, self.reads + 1
        reading = HandReading(
            time=self.clock.time,
            joints=self.q.copy(),
            velocities=np.zeros(len(self.q)),
            efforts=np.zeros(len(self.actuator_names)),
        )
        if self.costs:
            self.clock.time += self.costs.pop(0)
        return self.change(k, reading)

    def write(self, commands: FloatArray) -> None:
        assert not self.stops, "written after the stop"
        self.write_fault(len(self.writes))
        self.writes.append((self.clock.time, commands.copy()))

    def stop(self) -> None:
        self.stops += 1

    def close(self) -> None:
        self.closes += 1


class Steady:
    """A controller that wants the same commands always, or what a function says by the tick."""

    def __init__(self, wanted: FloatArray | Callable[[int], Any]) -> None:
        """It has not been asked."""
        self.wanted, self.ticks = wanted, 0
        self.seen: list[Observation] = []

    def step(self, observation: Observation) -> FloatArray:
        k, self.ticks = self.ticks, self.ticks + 1
        self.seen.append(observation)
        return self.wanted(k) if callable(self.wanted) else self.wanted


def looped(
    hand: FakeHand,
    controller: Any,
    ticks: int,
    *,
    rate_hz: float = 100.0,
    limits: CommandLimits | None = None,
    safety: Safety | None = None,
) -> tuple[ControlLoop, LoopReport]:
    """A loop that has run one phase of so many slots."""
    loop = ControlLoop(
        hand,
        controller,
        hand.hand,
        Observer(hand, hand.hand),
        rate_hz=rate_hz,
        clock=hand.clock,
        limits=limits,
        safety=safety or Safety(misses_in_a_row=10**6, max_age=1e6),
    )
    return loop, loop.run(lambda loop: _one_phase(loop, ticks / rate_hz))


def _one_phase(loop: ControlLoop, duration: float) -> None:
    loop.phase("hold", duration)


def at(number: int, **changes: Any) -> Callable[[int, HandReading], HandReading]:
    """Change the reading of one number; a function is called with what there was."""

    def change(k: int, reading: HandReading) -> HandReading:
        if k != number:
            return reading
        new = {n: v(getattr(reading, n)) if callable(v) else v for n, v in changes.items()}
        return replace(reading, **new)

    return change


def failing(number: int, error: BaseException) -> Callable[[int, HandReading], HandReading]:
    """Raise at the read of one number."""

    def change(k: int, reading: HandReading) -> HandReading:
        if k == number:
            raise error
        return reading

    return change


def unplugged() -> HandError:
    return HandError("servo 3 does not answer; look at its cable")
