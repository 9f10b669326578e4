"""What a controller sees and what it must do.

Write your own to take part in a trial::

    class Limp:
        def step(self, observation):
            return np.zeros(16)

    simulate(plan, controller=Limp())

``PadReading``: what tactile pads feel, one row per finger that takes part. A pad that measures
force in three axes and sees the surface move under it (optical pads do) gives the force on the
object, where it acts, along which normal, and how fast the object slides over it. Contacts of one
finger are summed; positions and velocities are means weighted by normal force. ``TouchReading``:
what arrays of taxels read, one image per finger, for whoever wants more: policies, pictures.
``MeasuredPose`` and ``PoseUncertainty``: when a pose was seen, and how well one is known.

``Event``: what a controller noticed or did, and when; and many of them in words.

``Reference``: where object and fingers should be while a motion is executed, at every step.

``ObjectImpedance.reference`` may hold anything with ``advance``; it is asked in the phase "turn".
``sim.controllers.follow`` has the one that follows a planned motion.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Literal, Protocol, TypeAlias, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from planner.contacts import ContactSet
from planner.errors import ContactError, shown
from planner.spatial import SE3, FloatArray

TOUCH_FORCE, LOST_FORCE = 0.1, 0.03
"""Normal forces (N) from which on a finger touches, and below which it has lost the object: a tenth
of what moves an object of 0.1 kg, and both far above rounding; apart, so that noise does not toggle
them."""


@dataclass(frozen=True, kw_only=True, eq=False)
class MeasuredPose:
    """A measured pose of the object.

    Attributes:
        time: When it was measured, s since the start of the trial.
        T_world_object: What was measured.
    """

    time: float
    T_world_object: SE3


@dataclass(frozen=True, kw_only=True, eq=False)
class PoseUncertainty:
    """What an estimator knows of the error of ``Observation.T_world_object``.

    Attributes:
        covariance: (6, 6), of the position of the object's origin, m, and of its rotation vector,
            rad, true minus estimated, world axes.
        known: Whether the estimate is worth acting on.
    """

    covariance: FloatArray
    known: bool

    @property
    def position_deviation(self) -> float:
        """Root mean square of the position's error as it is believed, m."""
        return float(np.sqrt(np.trace(self.covariance[:3, :3])))

    @property
    def rotation_deviation(self) -> float:
        """Root mean square of the rotation's error as it is believed, rad."""
        return float(np.sqrt(np.trace(self.covariance[3:, 3:])))


EXACT = "exact"
"""Name of the sense of touch without error."""


@dataclass(frozen=True, kw_only=True, eq=False)
class TouchReading:
    """Images of n fingers; empty of a hand that has no taxels.

    Attributes:
        time: When each image was taken, (n,), s.
        images: n arrays (rows, columns, 3): force of each taxel on what touches it, N, in the
            taxel's own axes: outward, along the columns (around the bone), along the rows (along
            the bone).
    """

    time: FloatArray
    images: tuple[FloatArray, ...]

    @classmethod
    def nothing(cls) -> TouchReading:
        """The reading of a hand that has no taxels."""
        return cls(time=np.zeros(0), images=())


ZERO_NOISE = 0.1
"""How far (N) below 0 a pad without contact may read: pads are zeroed, and drift by some 0.03 N."""

CREEP = 0.01
"""Sliding per spin (m): a soft finger that spins under a tangential force creeps along it, far
inside its cone. With the ellipsoidal limit surface it does so by (a / mu) mu_torsion /
sqrt(1 - a^2) per radian at the share a of its sliding friction: 10 mm at a = 0.7, mu = 0.7 and
mu_torsion = 7 mm, or a = 0.7, mu = 0.5 and 5 mm."""


@dataclass(frozen=True, kw_only=True, eq=False)
class PadReading:
    """What the pads of n fingers feel, world axes.

    Attributes:
        normal_force: (n,), sum of the normal forces, N; 0 without contact.
        force: (n, 3), force on the object, N.
        position: (n, 3), where it acts, m; NaN without contact.
        normal: (n, 3), unit, into the object; NaN without contact.
        sliding: (n, 3), velocity of the object relative to the pad along the surface, m/s; NaN
            without contact.
        spin: (n,), angular velocity of the object relative to the pad about the normal, rad/s, 0
            without contact; or a single 0 of pads that do not feel it.
        slipping: (n,), which pads notice by themselves that they slip; None of pads whose slip
            follows from ``sliding`` alone.
        time: When it was felt, s: the same reading told again has the same time. None of pads that
            are read anew whenever they are asked.
    """

    normal_force: FloatArray
    force: FloatArray
    position: FloatArray
    normal: FloatArray
    sliding: FloatArray
    spin: FloatArray = field(default_factory=lambda: np.zeros(1))
    slipping: NDArray[np.bool_] | None = None
    time: float | None = None

    def __post_init__(self) -> None:
        """Check shapes and signs; whether numbers are finite is for whoever reads a hand.

        A pad that was zeroed reads a little below 0 without contact (``ZERO_NOISE``): that is 0.

        Raises:
            ContactError: Another shape, or a normal force further below 0.
        """
        pressed = np.asarray(self.normal_force)
        shape = pressed.shape
        if len(shape) != 1 or np.any(pressed < -ZERO_NOISE):
            raise ContactError(
                f"the normal forces of pads are {shown(self.normal_force)}; give (n,) numbers >= 0 "
                f"in N ({ZERO_NOISE:g} N below is noise)"
            )
        object.__setattr__(self, "normal_force", np.maximum(pressed, 0.0))
        for name in ("force", "position", "normal", "sliding"):
            if np.shape(getattr(self, name)) != (*shape, 3):
                given = np.shape(getattr(self, name))
                raise ContactError(f"{name} of the pads has shape {given}; give {(*shape, 3)}")
        if np.shape(self.spin) not in ((1,), shape):
            raise ContactError(f"spin has shape {np.shape(self.spin)}; give {shape} or (1,)")

    @classmethod
    def nothing(cls, n: int = 0) -> PadReading:
        """The reading of n pads that touch nothing."""
        none = np.full((n, 3), np.nan)
        return cls(
            normal_force=np.zeros(n),
            force=np.zeros((n, 3)),
            position=none,
            normal=none.copy(),
            sliding=none.copy(),
        )

    def of(self, rows: slice) -> PadReading:
        """What some of the pads feel."""
        vectors = ("normal_force", "force", "position", "normal", "sliding")
        chosen = {name: getattr(self, name)[rows] for name in vectors}
        if self.spin.shape == self.normal_force.shape:
            chosen["spin"] = self.spin[rows]
        slipping = None if self.slipping is None else self.slipping[rows]
        return replace(self, **chosen, slipping=slipping)

    def moved(self, moves: Sequence[SE3]) -> PadReading:
        """The same with the vectors of each of the n pads moved."""
        turns = np.array([move.rotation for move in moves])

        def turned(rows: FloatArray) -> FloatArray:
            return np.asarray((turns @ rows[:, :, None])[:, :, 0])

        return replace(
            self,
            force=turned(self.force),
            position=turned(self.position) + np.array([move.translation for move in moves]),
            normal=turned(self.normal),
            sliding=turned(self.sliding),
        )

    @property
    def tangential_force(self) -> FloatArray:
        """Size of the force along the surface, (n,), N; 0 without contact."""
        normal = np.nan_to_num(self.normal)
        along = (self.force * normal).sum(axis=1)
        return np.asarray(np.linalg.norm(self.force - along[:, None] * normal, axis=1))

    @property
    def sliding_speed(self) -> FloatArray:
        """Size of ``sliding``, (n,), m/s; 0 without contact."""
        return np.asarray(np.linalg.norm(np.nan_to_num(self.sliding), axis=1))

    @property
    def creep_speed(self) -> FloatArray:
        """Speed (n,), m/s, to which spinning explains sliding: see ``CREEP``."""
        return np.asarray(CREEP * np.abs(self.spin))

    def friction_ratio(self) -> FloatArray:
        """Tangential over normal force, (n,), -: the friction in use; 0 without contact."""
        loaded = self.normal_force > 0
        return np.where(
            loaded, self.tangential_force / np.where(loaded, self.normal_force, 1.0), 0.0
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


def _nothing() -> None:
    """What is read where there is nothing to read."""


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
        read_planned: Reads ``T_world_base_planned``.
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
    read_planned: Callable[[], SE3 | None] = _nothing

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
    def T_world_base_planned(self) -> SE3 | None:
        """Where what carries the hand should have brought its base; None where nobody says."""
        return self.read_planned()

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
