"""``CommandLimits``: how far and how fast commands may move, whatever a controller wants.

Every command is kept within its range, then within reach of the last one: a rate times the time
since that was written, and at most times one period, so that a late loop does not leap. The first
command is where the hand is read to be; from there it is led to what the controller wants.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

import numpy as np

from planner.arrays import checked_number, float_array
from planner.errors import NotFoundError, TaskError, shown
from planner.joints.actuation import Actuation
from planner.spatial import FloatArray, IntArray

RANGES_PER_SECOND = 2.0
"""Fastest commands unless told otherwise, in widths of an actuator's range per second: 3 to 5 rad/s
for the fingers of an Allegro-type hand."""


SHORTEST, LONGEST = 1e-5, 10.0
"""Periods (s) of a loop that can be: beyond 100 kHz and below 0.1 Hz a rate is no limit."""


@dataclass(frozen=True, kw_only=True)
class CommandLimits:
    """Limits of commands, in the actuators' own units: rad for position servos, N m for motors.

    Attributes:
        rate: Fastest change per second: a number for all actuators, or numbers by actuator name
            (the others keep the default); two widths of the actuator's range per second if None.
        ranges: Narrower ranges (least, greatest) by actuator name; the model's if not named.
    """

    rate: float | Mapping[str, float] | None = None
    ranges: Mapping[str, tuple[float, float]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Check every number.

        Raises:
            TaskError: A rate that is not > 0, or a range that is not two numbers.
        """
        rates = self.rate if isinstance(self.rate, Mapping) else {"all actuators": self.rate}
        for name, rate in rates.items():
            if rate is not None or isinstance(self.rate, Mapping):
                checked_number(
                    f"the rate of {name}", rate, above=0.0, infinite=True,
                    unit="rad/s (N m/s for a motor)", error=TaskError,
                )  # fmt: skip
        for name, ends in self.ranges.items():
            given = float_array(f"the range of actuator {name}", ends, error=TaskError)
            if given.shape != (2,) or np.isnan(given).any():
                raise TaskError(f"the range of actuator {name} is {shown(ends)}; give two numbers")

    @classmethod
    def none(cls) -> CommandLimits:
        """No limit of the rate, and no ramp from where the hand is: for simulation."""
        return cls(rate=np.inf)

    def rates(self, actuation: Actuation) -> FloatArray:
        """Fastest change of each command (nu,), per second.

        Raises:
            NotFoundError: An actuator that there is not.
            TaskError: A rate that is not > 0, or none for an actuator without a range.
        """
        low, high = self.limits(actuation)
        rates = RANGES_PER_SECOND * (high - low)
        if isinstance(self.rate, Mapping):
            _check_names(self.rate, actuation)
            for name, value in self.rate.items():
                rates[actuation.names.index(name)] = value
        elif self.rate is not None:
            rates[:] = self.rate
        elif not np.isfinite(rates).all():
            name = actuation.names[int(np.flatnonzero(~np.isfinite(rates))[0])]
            raise TaskError(f"actuator {name!r} has no command range; give a rate for it")
        if not (rates > 0).all():
            name = actuation.names[int(np.flatnonzero(~(rates > 0))[0])]
            raise TaskError(f"actuator {name!r} has no width of command range; give a rate > 0")
        return rates

    def limits(self, actuation: Actuation) -> tuple[FloatArray, FloatArray]:
        """Least and greatest commands, (nu,) each.

        Raises:
            NotFoundError: An actuator that there is not.
            TaskError: A range that is empty, or not within that of the model.
        """
        _check_names(self.ranges, actuation)
        low, high = np.array(actuation.ctrl_range.T)
        for name, (least, greatest) in self.ranges.items():
            i = actuation.names.index(name)
            if not low[i] <= least < greatest <= high[i]:
                raise TaskError(
                    f"the range of actuator {name!r} is [{least}, {greatest}]; give two numbers "
                    f"within [{low[i]:g}, {high[i]:g}], the smaller one first"
                )
            low[i], high[i] = least, greatest
        return low, high


class CommandLimiter:
    """Keeps the commands of one run within limits, and counts.

    Attributes:
        last: (nu,), the last command that it gave.
        clamped: (nu,), how often a wanted command lay outside its range.
        limited: (nu,), how often it was farther away than the rate allows.
    """

    def __init__(
        self, limits: CommandLimits, actuation: Actuation, period: float, q: FloatArray
    ) -> None:
        """Begin where the hand is.

        Args:
            limits: Which.
            actuation: The hand's actuators.
            period: Of the loop, s.
            q: Joints (nq,) as they were read, rad or m.
        """
        self._low, self._high = limits.limits(actuation)
        rates = limits.rates(actuation)
        self._unlimited = np.isinf(rates)
        self._finite = np.where(self._unlimited, 0.0, rates)
        self._period = checked_number(
            "the period", period, least=SHORTEST, most=LONGEST, unit="s", error=TaskError
        )
        still = np.zeros(len(q))
        self.last: FloatArray = np.clip(actuation.commands(q, still, still), self._low, self._high)
        self._time: float | None = None
        n = len(actuation.names)
        self.clamped: IntArray = np.zeros(n, dtype=np.int64)
        self.limited: IntArray = np.zeros(n, dtype=np.int64)

    def step(self, wanted: FloatArray, now: float) -> FloatArray:
        """The command (nu,) nearest to a wanted one, at a time (s) that does not go back.

        The first one is ``last``, unless the rate is not limited.
        """
        within = np.minimum(np.maximum(wanted, self._low), self._high)
        elapsed = 0.0 if self._time is None else min(self._period, now - self._time)
        reach = np.where(self._unlimited, np.inf, self._finite * elapsed)
        command = np.minimum(np.maximum(within, self.last - reach), self.last + reach)
        self.clamped += within != wanted
        self.limited += command != within
        self.last, self._time = command, now
        return command.copy()


def _check_names(names: Iterable[str], actuation: Actuation) -> None:
    for name in names:
        if name not in actuation.names:
            raise NotFoundError("actuator", name, actuation.names)
