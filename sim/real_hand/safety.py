"""``Safety`` and ``Guard``: what ends a run at once, and what happens to the hand then.

An emergency stop writes nothing more. With "torque off" it then calls the interface's ``stop``: the
fingers go limp and an object falls. With "hold" the servos keep the last command that was written,
which had passed every check: the object stays, and so does whatever is between the fingers.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Literal, TypeAlias, get_args

import numpy as np

from planner.arrays import checked_count, checked_number
from planner.errors import NotFoundError, TaskError
from planner.hands.hand import Hand
from planner.spatial import FloatArray
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
