"""What a controller sees and what it must do.

Write your own to take part in a trial::

    class Limp:
        def step(self, observation):
            return np.zeros(16)

    simulate(plan, controller=Limp())

``Event``: what a controller noticed or did, and when; and many of them in words.

``Reference``: where object and fingers should be while a motion is executed, at every step.

``ObjectImpedance.reference`` may hold anything with ``advance``; it is asked in the phase "turn".
``sim.controllers.follow`` has the one that follows a planned motion.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal, Protocol, TypeAlias, runtime_checkable

from planner.contacts import ContactSet
from planner.spatial import SE3, FloatArray
from sim.controllers.readings import (
    TOUCH_FORCE,
    MeasuredPose,
    PadReading,
    PoseUncertainty,
    TouchReading,
)

EventKind: TypeAlias = Literal[
    "contact lost",
    "contact found",
    "slip",
    "infeasible",
    "feasible again",
    "finger leaves",
    "finger joins",
    "gave up",
    "pose lost",
    "pose known again",
]
"""What there is to notice. "infeasible" means that no contact forces give the wanted wrench; "pose
lost" that an estimator no longer knows where the object is."""


@dataclass(frozen=True, kw_only=True)
class Event:
    """One thing that a controller noticed, and what it did.

    Attributes:
        time: When, s since the start of the trial.
        kind: What.
        finger: Whose, "" if it concerns the whole grasp.
        detail: The numbers, and the reaction, in words.
    """

    time: float
    kind: EventKind
    finger: str = ""
    detail: str = ""


COMMANDED: tuple[EventKind, ...] = ("finger leaves", "finger joins")
"""Events that a caller brings about: it knows of them anyway."""


def event_lines(events: Sequence[Event]) -> list[str]:
    """One line for each kind and finger, in order of the first; what was commanded is left out."""
    alike: dict[tuple[str, str], list[Event]] = {}
    for event in events:
        if event.kind not in COMMANDED:
            alike.setdefault((event.kind, event.finger), []).append(event)
    lines = []
    for (kind, finger), same in alike.items():
        times = f" {len(same)} times up to {same[-1].time:.2f} s, first" if len(same) > 1 else ""
        first = f"{same[0].time:.2f} s {kind} {finger}".rstrip()
        lines.append(f"{first}{times}: {same[0].detail}")
    return lines


@dataclass(frozen=True, kw_only=True, eq=False)
class Target:
    """Where object and fingers should be now, in the palm.

    Attributes:
        T_palm_object: Pose of the object.
        twist: (6,), its velocity, of the centre of mass and angular, m/s and rad/s, palm axes.
        tips: (n, 3), pad centres of the fingers that take part, m. Only how they lie to each other
            is pursued for those that hold; one that leaves stays off its own.
        q: (nq,), posture that redundant fingers keep to.
        v: (nq,), its rates.
    """

    T_palm_object: SE3
    twist: FloatArray
    tips: FloatArray
    q: FloatArray
    v: FloatArray


class Reference(Protocol):
    """What gives a target at every step."""

    def advance(
        self, elapsed: float, T_palm_object: SE3, tips: FloatArray, q: FloatArray, *, missed: float
    ) -> Target:
        """Go on by one step.

        Args:
            elapsed: Time since the last call, s; in the first call it does not matter.
            T_palm_object: Measured pose of the object.
            tips: Pad centres (n, 3) where they are, palm, m.
            q: Joints (nq,) where they are.
            missed: Share (-) of the last step's wrench that could not be had, at least of 1 N.
        """
        ...


Phase: TypeAlias = Literal[
    "approach",
    "close",
    "squeeze",
    "settle",
    "lift",
    "hold",
    "turn",
    "carry",
    "lower",
    "release",
    "open",
    "retreat",
    "reach",
    "take",
    "transfer",
    "engage",
    "use",
    "withdraw",
]
"""A phase of a trial, a manipulation, a handover or the use of a tool."""

PHASES: tuple[Phase, ...] = ("approach", "close", "squeeze", "settle", "lift", "hold")
"""Phases of a trial in order. A manipulation (``sim.manipulation``) turns the object in the hand,
carries it elsewhere, lowers it, opens the fingers and retreats."""


Sense: TypeAlias = Literal["touch", "object_pose", "object_twist", "pads", "contacts"]
"""What a controller may read beside joints: ``normal_forces``, ``T_world_object``,
``object_twist``, ``pads``, ``contacts`` of an ``Observation``. A simulation has all of them."""


@dataclass(frozen=True, kw_only=True)
class Observation:
    """What a controller knows at one time step.

    Joints are those of now. Poses, forces and contacts are those of the beginning of the step that
    ended now, where MuJoCo computed them together.

    Attributes:
        time: Since the start of the trial, s.
        phase: Where the trial is.
        progress: Share of the phase's nominal duration that has passed, in [0, 1].
        q: Hand joints (nq,), rad or m, order of ``hand.joint_names``.
        v: Their rates (nq,).
        T_world_base: Pose of the hand's base.
        T_world_object: Pose of the object.
        normal_forces: Sum of normal forces on the object per finger that takes part, N, order of
            ``task.finger_names``.
        read_twist: Reads ``object_twist``.
        read_contacts: Reads ``contacts``.
        read_pads: Reads ``pads``.
        measured_pose: The newest measured pose that has arrived, with its time stamp; None where
            ``T_world_object`` is one of now.
        uncertainty: How well an estimator knows ``T_world_object``; None of a pose that was read.
        read_touch: Reads ``touch``: raw images of taxels, where there are any.
    """

    time: float
    phase: Phase
    progress: float
    q: FloatArray
    v: FloatArray
    T_world_base: SE3
    T_world_object: SE3
    normal_forces: FloatArray
    read_twist: Callable[[], FloatArray]
    read_contacts: Callable[[], ContactSet]
    read_pads: Callable[[], PadReading] = PadReading.nothing
    measured_pose: MeasuredPose | None = None
    uncertainty: PoseUncertainty | None = None
    read_touch: Callable[[], TouchReading] = TouchReading.nothing

    @property
    def reads_pads(self) -> bool:
        """Whether ``pads`` can be asked for; a real hand may have none."""
        return True

    def altered(self, **changes: Any) -> Observation:
        """The same with other values of some fields."""
        return replace(self, **changes)

    @property
    def all_touch(self) -> bool:
        """Whether every finger that takes part touches the object."""
        return bool((self.normal_forces >= TOUCH_FORCE).all())

    @cached_property
    def object_twist(self) -> FloatArray:
        """Linear velocity of the object's centre of mass and its angular velocity, (6,), world."""
        return self.read_twist()

    @cached_property
    def contacts(self) -> ContactSet:
        """Loaded contacts of hand and object, world, not merged; read when first asked for."""
        return self.read_contacts()

    @cached_property
    def pads(self) -> PadReading:
        """What tactile pads feel, per finger that takes part; read when first asked for."""
        return self.read_pads()

    @cached_property
    def touch(self) -> TouchReading:
        """Images of taxels, per finger that takes part; read when first asked for."""
        return self.read_touch()


class Controller(Protocol):
    """Anything with this method can drive the hand in a trial; the trial moves the gantry.

    The trial also moves an arm that carries the hand: commands for its actuators are not used.
    """

    def step(self, observation: Observation) -> FloatArray:
        """Commands (nu,) for the hand's actuators, order of ``hand.actuation.names``."""
        ...


@runtime_checkable
class ReportsLimits(Protocol):
    """A controller that knows when it wanted more of an actuator than there is.

    MuJoCo shows only what an actuator did, not what was wanted; with this a trial can tell a weak
    hand from a bad grasp.
    """

    def saturated_actuators(self) -> tuple[str, ...]:
        """Names of the actuators that could not give what the last step wanted."""
        ...


@runtime_checkable
class ReportsEvents(Protocol):
    """A controller that notices what goes wrong, and says when; a report repeats it."""

    @property
    def events(self) -> tuple[Event, ...]:
        """What it has noticed and done so far, in order."""
        ...


@runtime_checkable
class Recloses(Protocol):
    """A controller that may open the fingers after the first touch, to close them better."""

    @property
    def closing(self) -> bool:
        """Whether it is at that: the phase "close" then goes on though all fingers may touch."""
        ...


@runtime_checkable
class Refuses(Protocol):
    """A controller that may find that what it feels is no grasp to lift."""

    @property
    def refused(self) -> str:
        """Why it would not lift, "" while nothing speaks against it."""
        ...


@runtime_checkable
class HasOwnAim(Protocol):
    """A controller that turns further than asked by a margin of its own, however sure a pose is."""

    @property
    def aim(self) -> float:
        """Turn beyond the asked one at which it ends, rad."""
        ...


@runtime_checkable
class NeedsSenses(Protocol):
    """A controller that says what it reads beside joints.

    A hand that lacks one of these senses is refused before it moves (``sim.real_hand``).
    """

    @property
    def needs(self) -> tuple[Sense, ...]:
        """Senses without which it cannot work."""
        ...


@runtime_checkable
class UsesSenses(Protocol):
    """A controller that says what it reads where there is a sense for it, and does without else."""

    @property
    def uses(self) -> tuple[Sense, ...]:
        """Senses that it reads beside those that it needs."""
        ...
