"""Phases of a movement, and how it ends: what a ``MovementPlan`` is made of.

``Stroke``: the object goes along its path while all fingers hold it. ``Relocation``: one finger
moves on while the others hold it. ``ToolUse``: the hand goes where the use of a tool takes it.
``Handover``: another hand takes the object. Knots and relocations are verified by
``planner.motion.verify``, the way of a use beside by ``tool_use``, a handover's by ``handover``.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from planner.collision.pregrasp import Approach
from planner.contacts import Contact, ContactSet
from planner.forces import ForceSolution
from planner.immutable import fixed_pose, freeze
from planner.plan import GraspPlan, Verification
from planner.quality import ClosureResult
from planner.spatial import SE3, FloatArray
from planner.task import GraspTask


@dataclass(frozen=True, kw_only=True, eq=False)
class Knot:
    """The object in the hand at one point of its path, verified like a grasp.

    Attributes:
        path_parameter: Where on the path, 0 to 1.
        T_world_object: Pose of the object; the base stands where the grasp has it.
        q: Joints (nq,), pads just touching.
        contacts: Contacts with the true surface, world, with the planned forces.
        forces: The distribution that bears the object's weight here.
        closure: Force closure of the contacts.
        verification: Residuals on the true geometry.
        off_path: Distance of the object from its path, m.
        slips: Slip (n,), m, of each pad since the knot before: 0 if it rolls.
        between: Largest pad gap, m, half-way from the knot before, joints interpolated linearly.
        on_the_way: The distributions while the wrist turns from the path's attitude back to that
            of the grasp, at its ``wrist_shares`` from the last but one to the first; () without.
        needed: The distributions that produce each wrench that the task needs, with its margin.
    """

    path_parameter: float
    T_world_object: SE3
    q: FloatArray
    contacts: ContactSet
    forces: ForceSolution
    closure: ClosureResult
    verification: Verification
    off_path: float
    slips: FloatArray
    between: float
    on_the_way: tuple[ForceSolution, ...] = ()
    needed: tuple[ForceSolution, ...] = ()

    def __post_init__(self) -> None:
        """Keep copies that nobody changes."""
        freeze(self, poses=("T_world_object",), arrays=("q", "slips"))

    @property
    def contacts_in_object(self) -> ContactSet:
        """The contacts in the object's frame."""
        return self.contacts.transformed(self.T_world_object.inverse())

    @property
    def clearance(self) -> float:
        """Smallest distance of geometries that must not touch, m."""
        return min((c.distance for c in self.verification.closest), default=np.inf)


@dataclass(frozen=True, kw_only=True, eq=False)
class Stroke:
    """The object goes along its path while all fingers hold it.

    Attributes:
        cycle: Its number, from 0.
        knots: In order, each verified like a grasp.
    """

    cycle: int
    knots: tuple[Knot, ...]

    @property
    def postures(self) -> FloatArray:
        """Joints (m, nq) at the knots."""
        return np.array([knot.q for knot in self.knots])

    @property
    def margin(self) -> float:
        """Least normalised min-weight of closure (-) over all knots."""
        return min(knot.closure.normalised_min_weight for knot in self.knots)

    def __str__(self) -> str:
        """One line."""
        return f"stroke {self.cycle + 1}: {len(self.knots)} knots, least closure {self.margin:.3f}"


@dataclass(frozen=True, kw_only=True, eq=False)
class Relocation:
    """One finger moves on while the others hold the object still.

    Attributes:
        cycle: Number of the stroke before it.
        finger: Name of the finger.
        T_world_object: Pose of the object, held still.
        postures: Joints (m, nq) along the swing; the finger touches at the first and the last.
        before: All contacts before the lift, with their forces, world.
        during: The contacts that hold, with the forces that take over the load before the lift.
        after: All contacts after the landing, with their forces.
        margin: Normalised min-weight (-) of the contacts that hold.
        grip: Least normal force (N) of each of them.
    """

    cycle: int
    finger: str
    T_world_object: SE3
    postures: FloatArray
    before: ContactSet
    during: ContactSet
    after: ContactSet
    margin: float
    grip: float

    def __post_init__(self) -> None:
        """Keep copies that nobody changes."""
        freeze(self, poses=("T_world_object",), arrays=("postures",))

    @property
    def landing(self) -> Contact:
        """Where the finger lands, world."""
        return self.after[self.after.fingers.index(self.finger)]

    def __str__(self) -> str:
        """One line."""
        strongest = float(self.during.forces[:, 0].max())
        return (
            f"{self.finger} moves on: the others close with {self.margin:.3f} and press with up to "
            f"{strongest:.2f} N"
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class ToolUse:
    """The hand uses the tool that it holds; how far it goes follows what the tool's fixture does.

    Attributes:
        way: Poses of the base, world, through which the use takes the hand, close together.
        finger: Name of a finger that does not hold and works, as at a lever; "" for none.
        postures: Joints (m, nq) along that finger's way, in and through its stroke.
            (0, nq) without one.
    """

    way: tuple[SE3, ...]
    finger: str
    postures: FloatArray

    def __post_init__(self) -> None:
        """Keep copies that nobody changes."""
        freeze(self, arrays=("postures",))
        object.__setattr__(self, "way", tuple(fixed_pose(pose) for pose in self.way))

    def __str__(self) -> str:
        """One line."""
        if self.finger:
            return f"use: {self.finger} works, through {len(self.postures)} postures"
        return f"use: the hand goes through {len(self.way)} poses"


@dataclass(frozen=True, kw_only=True, eq=False)
class Handover:
    """Another hand of a pair takes the object; the joints are those of the pair.

    The movement's grasp is that of the giving hand, while the other one waits.

    Attributes:
        both: Grasp of both hands, at the same place.
        take: Grasp of the taking hand, with the other one still there.
        way_in: Joints (m, nq): the taking hand's way from where it waits to the pre-grasp, straight
            from one to the next.
        way_out: Joints (m, nq): the giving hand's way back, from where its fingers are open.
        giver: Name of the hand that gives.
        taker: Name of the hand that takes.
        lift_height: How far the object is lifted before the other hand comes, m. The poses of all
            three grasps are those before the lift.
        task: What was asked.
        alone: The grasps of both hands, each alone, the giving one's first.
    """

    both: GraspPlan
    take: GraspPlan
    way_in: FloatArray
    way_out: FloatArray
    giver: str
    taker: str
    lift_height: float
    task: GraspTask
    alone: tuple[GraspPlan, GraspPlan]

    def __post_init__(self) -> None:
        """Keep copies that nobody changes."""
        freeze(self, arrays=("way_in", "way_out"))

    def __str__(self) -> str:
        """One line."""
        return (
            f"handover: {self.taker} takes it from {self.giver}, {1e3 * self.lift_height:.0f} mm "
            "above where it stood"
        )


Phase: TypeAlias = Stroke | Relocation | ToolUse | Handover
"""One phase of a movement."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Ending:
    """How an object is put down, or held at last.

    Attributes:
        T_world_target: Final pose of the object; if it is held, at the height of the grasp.
        release: Opened fingers and the way out where the motion ends, or where it began if the
            motion is reversed, both for a hand that is not turned by the wrist; None if it is held.
        back: Why the motion is reversed before, "" if it is not.
        turned: Whether the hand stays in the attitude of the path; else the wrist turns back.
    """

    T_world_target: SE3
    release: Approach | None
    back: str
    turned: bool = False

    def __post_init__(self) -> None:
        """Keep copies that nobody changes."""
        freeze(self, poses=("T_world_target",))
