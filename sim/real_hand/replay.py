"""``ReplayedHand``: a log as a hand: its readings again, its commands to compare.

Run by ``hand.clock`` the loop sees the times of the log, misses included, so that the same
controller with the same limits gives the same commands; another one shows where it differs. The
readings do not answer to the commands: what a controller would have caused is not replayed. A loop
of another plan or at another rate is refused.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from planner.errors import FileFormatError, HandError, TaskError
from planner.hands.hand import Hand
from planner.spatial import FloatArray
from sim.real_hand.interface import Clock, EndOfReadings, HandReading, PlanMark, places
from sim.real_hand.log import HandLog, read_log


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """Commands written to a replayed hand against those of the log.

    Attributes:
        compared: Ticks that were compared.
        largest: Largest difference of a command, rad or N m; 0 where nothing was compared.
        actuator: Where; "" where nothing differs.
        time_s: When, s since the log's first tick.
    """

    compared: int
    largest: float
    actuator: str
    time_s: float

    def __str__(self) -> str:
        """In words."""
        if not self.compared:
            return "no commands compared"
        where = f" ({self.actuator} at {self.time_s:.3f} s)" if self.actuator else ""
        return f"{self.compared} commands compared, largest difference {self.largest:.3g}{where}"


class ReplayedHand:
    """A log as a hand; also its clock.

    Attributes:
        log: What is replayed.
        clock: What a loop is to be run by.
        joint_names, actuator_names, finger_names: Those of the log.
        rate_hz: That of the log, Hz.
    """

    def __init__(self, log: HandLog | Path | str, hand: Hand | None = None) -> None:
        """Read a log.

        Args:
            log: The log, or its file.
            hand: The model that it is to fit; not checked if None.

        Raises:
            FileFormatError: The file cannot be read, is empty, or is of a hand with other joints
                or actuators.
        """
        self.log = log if isinstance(log, HandLog) else read_log(log)
        if not len(self.log):
            raise FileFormatError("the log holds no readings; record a longer run")
        if hand is not None:
            try:
                places("joint", hand.joint_names, self.log.joint_names)
                places("actuator", hand.actuation.names, self.log.actuator_names)
            except HandError as error:
                raise FileFormatError(
                    f"the log is of another hand than {hand.name}: {error}"
                ) from error
        self.joint_names, self.actuator_names = self.log.joint_names, self.log.actuator_names
        self.finger_names, self.rate_hz = self.log.finger_names, self.log.rate_hz
        self.clock: Clock = self
        self._i = 0
        self._now = float(self.log.begin_s[0])
        self._differences: list[tuple[int, FloatArray]] = []
        self._stopped = False

    def read(self) -> HandReading:
        """The reading of this tick.

        Raises:
            EndOfReadings: The log ends before it.
        """
        log, i = self.log, self._i
        if i >= len(log):
            raise EndOfReadings(f"the log ends after {len(log)} readings")
        self._now = float(log.write_s[i])
        return log.reading(i)

    def write(self, commands: FloatArray) -> None:
        """Compare commands (nu,) with those of the log.

        Raises:
            HandError: The hand was stopped.
        """
        if self._stopped:
            raise HandError("the replayed hand was stopped; make a new one to go on")
        logged = self.log.commands[self._i]
        if np.isfinite(logged).all():
            self._differences.append((self._i, np.abs(commands - logged)))
        self._now = float(self.log.end_s[self._i])

    def stop(self) -> None:
        """Refuse commands from now on."""
        self._stopped = True

    def close(self) -> None:
        """Nothing is open."""

    def comparison(self) -> Comparison:
        """How the commands written so far differ from those of the log."""
        if not self._differences:
            return Comparison(compared=0, largest=0.0, actuator="", time_s=float("nan"))
        table = np.array([row for _, row in self._differences])
        row, column = np.unravel_index(int(table.argmax()), table.shape)
        largest = float(table[row, column])
        tick = self._differences[int(row)][0]
        return Comparison(
            compared=len(table),
            largest=largest,
            actuator=self.actuator_names[int(column)] if largest > 0 else "",
            time_s=float(self.log.begin_s[tick] - self.log.begin_s[0]),
        )

    # ---- its own clock

    def check_same_run(self, rate_hz: float, plan: PlanMark | None) -> None:
        """See ``RecordedClock``: readings are those of the log's ticks and answer to its plan.

        A log of version 1 does not say which plan it is of, and none is refused.

        Raises:
            TaskError: Another rate, or another plan.
        """
        own = self.log.rate_hz
        if not math.isclose(rate_hz, own):
            raise TaskError(
                f"the log is of a loop at {own:g} Hz, and a rate of {rate_hz:g} Hz is asked for; "
                f"give {own:g} Hz: between its ticks there are no readings"
            )
        if plan is None or self.log.plan is None:
            return
        if said := self.log.plan.difference(plan):
            raise TaskError(f"the log is of {said}; give the plan that was driven")

    def now(self) -> float:
        """Time of the log, s."""
        return self._now

    def sleep_until(self, moment: float) -> None:
        """Go on to the next tick of the log, whenever that began."""
        self._i += 1
        later = moment if self._i >= len(self.log) else float(self.log.begin_s[self._i])
        self._now = max(self._now, later)
