"""``Safety`` and ``Guard``: what ends a run at once, and what happens to the hand then.

An emergency stop writes nothing more. With "torque off" it then calls the interface's ``stop``: the
fingers go limp and an object falls. With "hold" the servos keep the last command that was written,
which had passed every check: the object stays, and so does whatever is between the fingers.

``CommandLimits``: how far and how fast commands may move, whatever a controller wants.

Every command is kept within its range, then within reach of the last one: a rate times the time
since that was written, and at most times one period, so that a late loop does not leap. The first
command is where the hand is read to be; from there it is led to what the controller wants.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Literal, TypeAlias, get_args

import numpy as np

from planner.arrays import checked_count, checked_number, float_array
from planner.errors import NotFoundError, TaskError, shown
from planner.hands.hand import Hand
from planner.joints.actuation import Actuation
from planner.spatial import FloatArray, IntArray
from sim.real_hand.interface import HandReading

OnStop: TypeAlias = Literal["torque off", "hold"]
"""What an emergency stop does after the last write."""

StopCause: TypeAlias = Literal[
    "asked",
    "interrupted",
    "reading not finite",
    "reading stale",
    "joint limit",
    "effort limit",
    "deadline misses",
    "bad command",
    "interface failed",
    "no more readings",
]
"""Why a run was ended: by the caller, by Ctrl-C, by a check, by the hand."""

EFFORT_MARGIN = 1.2
"""Share (-) of an actuator's force range up to which a reading is believed to be noise: currents
are read within some 10 %."""


class Stopped(Exception):
    """A run ends here. Raised and caught inside a loop; a caller sees the report.

    Attributes:
        cause: Why.
        detail: With numbers and names.
    """

    def __init__(self, cause: StopCause, detail: str) -> None:
        """Keep both."""
        self.cause: StopCause = cause
        self.detail = detail
        super().__init__(f"{cause}: {detail}")


@dataclass(frozen=True, kw_only=True)
class Safety:
    """Bounds of a run.

    Attributes:
        max_age: Age of a reading (s) from which on it is stale, and how far it may lie ahead.
        joint_margin: How far (rad, m) a joint may be read beyond the limits of the hand's model:
            homing offsets and play.
        max_effort: Greatest force (N m, N) that an actuator may be read to make: a number for all,
            or numbers by actuator name; 1.2 times the model's force range where none is given. A
            hand that reads no efforts is not checked.
        misses_in_a_row: So many deadlines missed one after the other end the run.
        on_stop: What is done then.
        stop: Asked before every write; the run ends where it says so. An event's ``is_set`` will
            do.
    """

    max_age: float = 0.1
    joint_margin: float = 0.1
    max_effort: float | Mapping[str, float] | None = None
    misses_in_a_row: int = 10
    on_stop: OnStop = "torque off"
    stop: Callable[[], bool] | None = None

    def __post_init__(self) -> None:
        """Check every number."""
        checked_number("max_age", self.max_age, above=0.0, unit="s", error=TaskError)
        checked_number("joint_margin", self.joint_margin, least=0.0, unit="rad", error=TaskError)
        checked_count("misses_in_a_row", self.misses_in_a_row, least=1, most=10**9, error=TaskError)
        if self.on_stop not in get_args(OnStop):
            raise NotFoundError("way to stop", str(self.on_stop), get_args(OnStop))
        if self.stop is not None and not callable(self.stop):
            raise TaskError(f"stop is {shown(self.stop)}; give a function, asked before each write")
        given = self.max_effort
        values = tuple(given.values()) if isinstance(given, Mapping) else (given,)
        for value in values:
            if value is not None:
                checked_number("max_effort", value, above=0.0, unit="N m", error=TaskError)

    def efforts(self, hand: Hand) -> FloatArray:
        """Greatest effort of each actuator of a hand (nu,), N m or N.

        Raises:
            NotFoundError: An actuator that there is not.
        """
        actuation = hand.actuation
        most = EFFORT_MARGIN * np.abs(actuation.force_range).max(axis=1)
        if isinstance(self.max_effort, Mapping):
            for name, value in self.max_effort.items():
                if name not in actuation.names:
                    raise NotFoundError("actuator", name, actuation.names)
                most[actuation.names.index(name)] = value
        elif self.max_effort is not None:
            most[:] = self.max_effort
        return np.asarray(most)


LARGEST = 1e6
"""Largest number of a reading, SI units, either sign: nothing that a hand measures is larger."""


def _check(name: str, value: FloatArray) -> None:
    """Refuse numbers that are not finite, or larger than ``LARGEST``."""
    if not (np.abs(value) <= LARGEST).all():  # NaN too
        raise Stopped(
            "reading not finite", f"{name} hold NaN, infinity or a number beyond {LARGEST:g}"
        )


class Guard:
    """Checks every number of the readings of one hand; rows of NaN are pads that touch nothing."""

    def __init__(
        self,
        safety: Safety,
        hand: Hand,
        joint_names: tuple[str, ...],
        actuator_names: tuple[str, ...],
        fingers: int,
    ) -> None:
        """Prepare bounds in the order in which the interface reads.

        Args:
            safety: The bounds.
            hand: Its model.
            joint_names: The interface's; those of the hand in any order.
            actuator_names: Likewise.
            fingers: How many fingers the interface feels with.
        """
        joints = [hand.joint_names.index(name) for name in joint_names]
        actuators = [hand.actuation.names.index(name) for name in actuator_names]
        self._joint_names, self._actuator_names = joint_names, actuator_names
        self._max_age = safety.max_age
        self._low = hand.q_lower[joints] - safety.joint_margin
        self._high = hand.q_upper[joints] + safety.joint_margin
        self._most = safety.efforts(hand)[actuators]
        self._sizes = {
            "joints": len(joints),
            "velocities": len(joints),
            "efforts": len(actuators),
            "touch": fingers,
            "object_twist": 6,
        }

    def check(self, reading: HandReading, now: float) -> None:
        """Refuse a reading that ends the run.

        Args:
            reading: Of the interface.
            now: Time, s.

        Raises:
            Stopped: It is not finite, stale, of a wrong shape, or beyond a limit.
        """
        for name, size in self._sizes.items():
            value = getattr(reading, name)
            if value is None and name not in ("joints", "velocities"):
                continue
            if np.shape(value) != (size,):
                raise Stopped(
                    "interface failed",
                    f"{name} have shape {np.shape(value)}; the interface has {size}",
                )
            _check(name, value)
        for name in ("T_world_base", "T_world_object"):
            pose = getattr(reading, name)
            if pose is not None:
                _check(name, pose.homogeneous)
        if reading.pads is not None:
            for name in ("normal_force", "force", "spin"):
                _check(f"{name} of the pads", getattr(reading.pads, name))
            for name in ("position", "normal", "sliding"):
                value = getattr(reading.pads, name)
                _check(f"{name} of the pads", value[~np.isnan(value).all(axis=1)])
        age = now - reading.time
        if not abs(age) <= self._max_age:  # NaN too
            why = "old" if age > 0 else "ahead: is its time on the loop's clock?"
            raise Stopped(
                "reading stale",
                f"it is {abs(age):.3g} s {why} (at most {self._max_age:g} s are allowed)",
            )
        beyond = (reading.joints < self._low) | (reading.joints > self._high)
        if beyond.any():
            i = int(np.argmax(beyond))
            raise Stopped(
                "joint limit",
                f"{self._joint_names[i]} is at {reading.joints[i]:.3f} rad; "
                f"{self._low[i]:.3f} to {self._high[i]:.3f} rad are allowed",
            )
        if reading.efforts is not None:
            over = np.abs(reading.efforts) > self._most
            if over.any():
                i = int(np.argmax(over))
                raise Stopped(
                    "effort limit",
                    f"{self._actuator_names[i]} makes {reading.efforts[i]:.3g} N m; at most "
                    f"{self._most[i]:.3g} N m are allowed",
                )


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
