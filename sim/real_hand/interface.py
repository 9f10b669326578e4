"""``HandInterface``: a hand that is read and written, whatever stands behind it.

A driver of a real hand, a simulation (``SimulatedHand``), a log (``ReplayedHand``) and a wrapper
that makes readings worse (``HandWrapper``) all look like this. A loop needs nothing else of a hand.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from planner.errors import HandError
from planner.spatial import SE3, FloatArray
from sim.controllers.pads import PadReading


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
