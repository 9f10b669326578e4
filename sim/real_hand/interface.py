"""``HandInterface``: a hand that is read and written, whatever stands behind it.

A driver of a real hand, a simulation (``SimulatedHand``), a log (``ReplayedHand``) and a wrapper
that makes readings worse (``HandWrapper``) all look like this. A loop needs nothing else of a hand.

``Clock`` and ``Pace``: when a loop runs, which deadlines it missed, how late it was.

Time is cut into slots of one period. A tick begins with its slot and has met its deadline if it
ends before the next slot begins. After a miss the loop goes on at once, in the slot that it is
then: slots that have passed altogether are skipped, so that a late loop does not run faster later.

``PlanMark``: which plan a log is of, so that it is replayed with that plan and no other.

``Observer``: turns what a hand reads into what a controller sees.

A real hand lacks senses that a simulation has. What is missing is missing: a controller that asks
for it is refused with a line that says what to do, before anything is written where the controller
says what it needs (``sim.controllers.NeedsSenses``), else at the moment at which it asks. Planned
values stand in only where that is asked for by name (``assume``):

    object_pose   the object lies in the hand as planned, also while the hand moves
    touch         no finger touches before the closing is over; from then on each presses as planned

Where the base is not read, it is where the plan grasps: only the direction of gravity counts then.
"""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Collection
from dataclasses import asdict, dataclass, fields
from functools import partial
from typing import Any, Protocol, cast, runtime_checkable

import numpy as np

from planner.errors import HandError, NotFoundError
from planner.hands.hand import Hand
from planner.plan import GraspPlan
from planner.shapes import shape_key
from planner.spatial import SE3, FloatArray
from sim.controllers.base import Controller, NeedsSenses, Observation, PadReading, Phase, Sense


class EndOfReadings(HandError):
    """There is nothing more to read: a log that is replayed has come to its end."""


@dataclass(frozen=True, kw_only=True, eq=False)
class HandReading:
    """What a hand says of itself at one moment; None for what it has no sense for.

    Attributes:
        time: When it was measured, s, on the clock of the loop (``time.monotonic`` unless another
            clock is given): how old it is decides whether it is used.
        joints: (nq,), rad or m, order of the interface's ``joint_names``.
        velocities: (nq,), rad/s or m/s.
        efforts: (nu,), force of each actuator, N m or N, order of ``actuator_names``.
        touch: (n,), normal force of each finger, N, order of ``finger_names``.
        T_world_base: Pose of the hand's base; where the plan grasps, if None.
        T_world_object: Pose of the object.
        object_twist: (6,), linear velocity of its centre of mass (m/s), angular velocity (rad/s),
            world axes.
        pads: What tactile pads feel, one row per finger of ``finger_names``, world axes.
    """

    time: float
    joints: FloatArray
    velocities: FloatArray
    efforts: FloatArray | None = None
    touch: FloatArray | None = None
    T_world_base: SE3 | None = None
    T_world_object: SE3 | None = None
    object_twist: FloatArray | None = None
    pads: PadReading | None = None


class HandInterface(Protocol):
    """A hand, as a loop reads and commands it.

    Names are those of the hand's model (``hand.joint_names``, ``hand.actuation.names``); their
    order is the interface's own. Calls come from one thread.
    """

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the joints that are read, all joints of the hand."""
        ...

    @property
    def actuator_names(self) -> tuple[str, ...]:
        """Names of the actuators that are written, all actuators of the hand."""
        ...

    @property
    def finger_names(self) -> tuple[str, ...]:
        """Fingers whose touch is read; empty if none."""
        ...

    @property
    def rate_hz(self) -> float:
        """Highest rate at which it can be read and written, Hz."""
        ...

    def read(self) -> HandReading:
        """The newest reading; returns at once, or within a fraction of a period.

        Raises:
            HandError: It cannot be read. ``OSError`` is taken as that, too.
        """
        ...

    def write(self, commands: FloatArray) -> None:
        """Send one command per actuator (nu,), rad for a position servo, N m for a motor.

        Raises:
            HandError: It cannot be written. ``OSError`` is taken as that, too.
        """
        ...

    def stop(self) -> None:
        """Take the torque off, and refuse to be written from now on. May be called twice."""
        ...

    def close(self) -> None:
        """Give back what was opened; does not take the torque off. May be called twice."""
        ...


class HandWrapper:
    """A hand interface around another one: derive from it to change readings or commands.

    Whatever is not changed is passed on, so wrappers can be put around each other::

        class Late(HandWrapper):
            def read(self):
                return replace(self.inner.read(), T_world_object=self.pose_of_a_moment_ago())
    """

    def __init__(self, inner: HandInterface) -> None:
        """Put it around a hand."""
        self.inner = inner

    @property
    def joint_names(self) -> tuple[str, ...]:
        """As inside."""
        return self.inner.joint_names

    @property
    def actuator_names(self) -> tuple[str, ...]:
        """As inside."""
        return self.inner.actuator_names

    @property
    def finger_names(self) -> tuple[str, ...]:
        """As inside."""
        return self.inner.finger_names

    @property
    def rate_hz(self) -> float:
        """As inside, Hz."""
        return self.inner.rate_hz

    def read(self) -> HandReading:
        """The reading inside."""
        return self.inner.read()

    def write(self, commands: FloatArray) -> None:
        """Write commands (nu,) inside."""
        self.inner.write(commands)

    def stop(self) -> None:
        """Take the torque off inside."""
        self.inner.stop()

    def close(self) -> None:
        """Close inside."""
        self.inner.close()


class DryRun(HandWrapper):
    """A hand that is read and never written, nor stopped."""

    def write(self, commands: FloatArray) -> None:
        """Do nothing."""

    def stop(self) -> None:
        """Do nothing: a hand that was never written keeps the state that it has."""


LATE_TOL = 1e-9
"""Lateness (s) that is rounding."""


class Clock(Protocol):
    """Tells the time and waits; a test has its own."""

    def now(self) -> float:
        """Time, s; never goes back."""
        ...

    def sleep_until(self, moment: float) -> None:
        """Return at a time (s), or at once where it has passed."""
        ...


@runtime_checkable
class RecordedClock(Clock, Protocol):
    """A clock whose time is that of a recorded run: it serves the same run alone."""

    def check_same_run(self, rate_hz: float, plan: PlanMark | None) -> None:
        """Refuse a loop that is not the one that was recorded.

        Args:
            rate_hz: Its rate, Hz.
            plan: What it executes; None where it executes none.

        Raises:
            TaskError: Another rate, or another plan.
        """
        ...


class RealClock:
    """The system's monotonic clock, which nobody sets."""

    def now(self) -> float:
        """``time.monotonic()``, s."""
        return time.monotonic()

    def sleep_until(self, moment: float) -> None:
        """Sleep until a time (s)."""
        left = moment - time.monotonic()
        if left > 0.0:
            time.sleep(left)


class Pace:
    """Slots of one period.

    Attributes:
        period: Length of a slot, s.
        slot: Number of the slot of the present tick.
        begun: When the present tick began, s.
        misses: Ticks that ended after their slot.
        skipped: Slots in which no tick began.
        in_a_row: Misses since the last tick that ended in time.
        most_in_a_row: The most of these.
        duration: From the first tick's beginning to the last one's end, s.
    """

    def __init__(self, clock: Clock, period: float) -> None:
        """The first slot begins with the first tick."""
        self._clock = clock
        self.period = period
        self.slot = 0
        self.begun = 0.0
        self.misses = 0
        self.skipped = 0
        self.in_a_row = 0
        self.most_in_a_row = 0
        self.duration = 0.0
        self._first: float | None = None
        self._latencies: list[float] = []

    def begin(self) -> float:
        """Wait for the slot; returns the time at which the tick begins, s."""
        if self._first is None:
            self._first = self._clock.now()
        else:
            self._clock.sleep_until(self._first + self.slot * self.period)
        self.begun = self._clock.now()
        return self.begun

    def end(self) -> bool:
        """End the tick and choose the next slot; returns whether the deadline was missed."""
        first = 0.0 if self._first is None else self._first
        since = self._clock.now() - first
        self.duration = since
        latency = since - self.slot * self.period
        self._latencies.append(latency)
        missed = latency > self.period + LATE_TOL
        next_slot = self.slot + 1
        if missed:
            next_slot = max(next_slot, int((since + LATE_TOL) / self.period))
            self.misses += 1
            self.skipped += next_slot - self.slot - 1
        self.in_a_row = self.in_a_row + 1 if missed else 0
        self.most_in_a_row = max(self.most_in_a_row, self.in_a_row)
        self.slot = next_slot
        return missed

    def rest(self) -> None:
        """Wait for the next slot without beginning a tick: the last command acts that long."""
        if self._first is not None:
            self._clock.sleep_until(self._first + self.slot * self.period)

    @property
    def latencies(self) -> FloatArray:
        """(m,), time from the beginning of each tick's slot to the tick's end, s."""
        return np.array(self._latencies)


DIGITS = 9
"""Decimals of numbers that count: a plan that was written and read is the same to rounding."""


@dataclass(frozen=True, kw_only=True)
class PlanMark:
    """What identifies a plan.

    Attributes:
        hand: Name of its hand.
        hand_sha256: Digest of the hand's files.
        object: Specification of its object.
        sha256: Digest of hand, object, mass, friction, gravity, grip and of the grasp's joints and
            poses.
    """

    hand: str
    hand_sha256: str
    object: str
    sha256: str

    @classmethod
    def of(cls, plan: GraspPlan) -> PlanMark:
        """That of a plan; the same before the plan is written and after it is read."""
        task = plan.task
        numbers: tuple[Any, ...] = (
            *(task.object.mass, task.mu, task.grip_force, task.gravity),
            *(task.T_world_object.homogeneous, plan.T_world_base.homogeneous),
            *(plan.T_world_base_start.homogeneous, plan.q, plan.q_pregrasp),
        )
        content = [
            task.hand.digest,
            shape_key(task.object.shape),
            task.finger_names,
            [(np.round(n, DIGITS) + 0.0).tolist() for n in numbers],  # + 0.0: no minus zero
        ]
        return cls(
            hand=task.hand.name,
            hand_sha256=task.hand.digest,
            object=task.object.shape.spec,
            sha256=hashlib.sha256(json.dumps(content).encode()).hexdigest(),
        )

    def to_dict(self) -> dict[str, str]:
        """Plain data."""
        return asdict(self)

    def difference(self, other: PlanMark) -> str:
        """What the two plans differ in, for people; "" if they are the same."""
        if self.sha256 == other.sha256:
            return ""
        if self.hand_sha256 != other.hand_sha256:
            same_name = self.hand == other.hand
            return f"another {self.hand}" if same_name else f"{self.hand}, not of {other.hand}"
        if self.object != other.object:
            return f"{self.object}, not of {other.object}"
        return f"another grasp of {self.object} by {self.hand}"


ASSUMABLE: tuple[Sense, ...] = ("object_pose", "touch")
"""Senses for which planned values may stand in."""

_SENSE_OF: dict[str, Sense] = {
    "normal_forces": "touch",
    "T_world_object": "object_pose",
}
"""Name in an ``Observation`` that is always there in a trial -> the sense that it takes."""


def _refuse(sense: Sense) -> Any:
    raise HandError(_missing("the controller", (sense,)))


_NOT_READ: dict[str, Any] = {
    "read_twist": partial(_refuse, "object_twist"),
    "read_pads": partial(_refuse, "pads"),
    "read_contacts": partial(_refuse, "contacts"),
}
"""What an ``Observation`` reads when it is first asked for, where a hand does not read it."""


class HandObservation(Observation):
    """An ``Observation`` of a hand that may lack senses.

    Asking for what there is no sense for raises ``HandError``.
    """

    def __init__(self, known: dict[str, Any]) -> None:
        """Hold what is known, by the names of ``Observation``."""
        self.__dict__.update(_NOT_READ | known)

    @property
    def feels(self) -> bool:
        """Whether the touch of fingers is known."""
        return "normal_forces" in self.__dict__

    @property
    def reads_pads(self) -> bool:
        """Whether the hand has pads."""
        return "pads" in self.__dict__ or self.__dict__["read_pads"] is not _NOT_READ["read_pads"]

    def altered(self, **changes: Any) -> HandObservation:
        """The same with other values of some fields."""
        kept = {k: v for k, v in self.__dict__.items() if f"read_{k}" not in changes}
        return HandObservation(kept | changes)

    def __getattr__(self, name: str) -> Any:
        """Refuse what there is no sense for; asked only where nothing is known by that name."""
        if name in _SENSE_OF:
            raise HandError(_missing("the controller", (_SENSE_OF[name],)))
        raise AttributeError(f"{type(self).__name__!r} object has no attribute {name!r}")


class Observer:
    """Makes observations of one hand for one plan.

    Attributes:
        assume: Senses for which planned values stand in.
        plan: What is executed; None where nothing is grasped.
    """

    def __init__(
        self,
        interface: HandInterface,
        hand: Hand,
        plan: GraspPlan | None = None,
        assume: Collection[str] = (),
    ) -> None:
        """Match the interface's names with the hand's.

        Args:
            interface: The hand that is read.
            hand: Its model.
            plan: What is executed; None where nothing is grasped.
            assume: Names out of ``ASSUMABLE``.

        Raises:
            HandError: Joints, actuators or fingers that do not match, or an assumption without a
                plan.
            NotFoundError: An assumption that there is not.
        """
        for name in assume:
            if name not in ASSUMABLE:
                raise NotFoundError("planned value that may stand in for a sense", name, ASSUMABLE)
        if assume and plan is None:
            raise HandError("planned values stand in for senses only where there is a plan")
        self.assume = cast("tuple[Sense, ...]", tuple(assume))
        self.plan = plan
        self._joints = places("joint", hand.joint_names, interface.joint_names)
        self.actuators = places("actuator", hand.actuation.names, interface.actuator_names)
        self._fingers: list[int] | None = None
        if plan is not None and interface.finger_names:
            self._fingers = [
                _place("finger", name, interface.finger_names) for name in plan.task.finger_names
            ]
        self._first: float | None = None
        if plan is not None:
            self._T_world_base = plan.T_world_base
            self._T_base_object = plan.T_world_base.inverse() * plan.task.T_world_object
            self._planned_forces = plan.contacts.forces[:, 0]

    def observe(self, reading: HandReading, phase: Phase, progress: float) -> HandObservation:
        """What the controller sees of a reading.

        Args:
            reading: Of the interface.
            phase: What the controller is told.
            progress: How much of it has passed, in [0, 1].
        """
        if self._first is None:
            self._first = reading.time
        known: dict[str, Any] = {
            "time": reading.time - self._first,
            "phase": phase,
            "progress": progress,
            "q": reading.joints[self._joints],
            "v": reading.velocities[self._joints],
        }
        base = reading.T_world_base
        if base is None and self.plan is not None:
            base = self._T_world_base
        known["T_world_base"] = SE3.Identity() if base is None else base
        if "object_pose" in self.assume:
            known["T_world_object"] = known["T_world_base"] * self._T_base_object
        elif reading.T_world_object is not None:
            known["T_world_object"] = reading.T_world_object
        if "touch" in self.assume:
            closed = phase not in ("approach", "close") or (phase == "close" and progress >= 1.0)
            known["normal_forces"] = self._planned_forces * closed
        elif reading.touch is not None:
            known["normal_forces"] = reading.touch[self._fingers]
        if reading.object_twist is not None:
            known["object_twist"] = reading.object_twist
        if reading.pads is not None:
            known["pads"] = self._own_pads(reading.pads)
        return HandObservation(known)

    def _own_pads(self, pads: PadReading) -> PadReading:
        """The rows of the fingers that take part, in their order."""
        if self._fingers is None or self._fingers == list(range(len(pads.normal_force))):
            return pads
        given = {field.name: getattr(pads, field.name) for field in fields(pads)}
        own = {
            name: value if np.size(value) == 1 else value[self._fingers]
            for name, value in given.items()
        }
        return PadReading(**own)

    def check_senses(self, controller: Controller, reading: HandReading) -> None:
        """Refuse a controller that needs what this hand has no sense for.

        Raises:
            HandError: It says that it needs a sense, and a reading holds none and nothing stands
                in.
        """
        if not isinstance(controller, NeedsSenses):
            return
        there = set(self.assume)
        seen: dict[Sense, object] = {
            "touch": reading.touch,
            "object_pose": reading.T_world_object,
            "object_twist": reading.object_twist,
            "pads": reading.pads,
        }
        there |= {sense for sense, value in seen.items() if value is not None}
        missing = tuple(sense for sense in controller.needs if sense not in there)
        if missing:
            raise HandError(_missing(type(controller).__name__, missing))


def places(what: str, expected: tuple[str, ...], names: tuple[str, ...]) -> list[int]:
    """Where each expected name stands among others, which must be the same names.

    Raises:
        HandError: Names that are missing, unknown or given twice.
    """
    if len(set(names)) != len(names):
        twice = sorted({name for name in names if names.count(name) > 1})
        raise HandError(f"the interface names {what} {twice[0]} more than once; name each once")
    missing = [name for name in expected if name not in names]
    unknown = [name for name in names if name not in expected]
    if missing or unknown:
        parts = [f"lacks {', '.join(missing)}"] * bool(missing)
        parts += [f"has {', '.join(unknown)}, which the model has not"] * bool(unknown)
        raise HandError(
            f"the {what}s of the interface do not match the hand's model: it "
            f"{' and '.join(parts)}; use the model's names: {', '.join(expected)}"
        )
    return [names.index(name) for name in expected]


def _place(what: str, name: str, names: tuple[str, ...]) -> int:
    if name not in names:
        raise NotFoundError(f"{what} of the interface", name, names)
    return names.index(name)


def _missing(who: str, senses: tuple[Sense, ...]) -> str:
    """What to tell about senses that there are not."""
    named = " and ".join(senses)
    advice = "choose a controller that does without"
    if all(sense in ASSUMABLE for sense in senses):
        advice += f", or let planned values stand in: assume {', '.join(senses)}"
    return f"{who} needs {named}, which this hand does not read; {advice}"
