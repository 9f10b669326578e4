"""``GaitPlan``: strokes that turn or move the object, and relocations of fingers between them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from planner.contacts import Contact, ContactSet
from planner.immutable import freeze
from planner.motion.plan import Knot, MotionPlan, MotionRecord
from planner.motion.trajectory import JOINT_RATE, TURN_RATE, TrajectoryBuilder
from planner.plan import JointTrajectory
from planner.showing import Shown
from planner.spatial import SE3, FloatArray


@dataclass(frozen=True, kw_only=True, eq=False)
class Stroke:
    """The object goes along a piece of its path while all fingers hold it.

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

    def __str__(self) -> str:
        """One line."""
        least = min(knot.closure.normalised_min_weight for knot in self.knots)
        return f"stroke {self.cycle + 1}: {len(self.knots)} knots, least closure {least:.3f}"


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
class GaitPlan(Shown):
    """Strokes and relocations in turn; the base stands where the grasp has it.

    As with a motion, hand and object are lifted first, which is left out here.

    Attributes:
        motion: The first stroke, with the grasp and its way in.
        cycles: Number of strokes.
        phases: Strokes and relocations in their order, beginning and ending with a stroke.
        record: Where the plan comes from.
    """

    motion: MotionPlan
    cycles: int
    phases: tuple[Stroke | Relocation, ...]
    record: MotionRecord

    @property
    def angle(self) -> float:
        """Turn of all strokes together, rad."""
        return self.cycles * self.motion.path.angle

    @property
    def shift(self) -> FloatArray:
        """Translation of all strokes together (3,), m, world."""
        return self.cycles * self.motion.path.shift

    @property
    def T_world_base(self) -> SE3:
        """Pose of the hand's base throughout."""
        return self.motion.T_world_base

    @property
    def strokes(self) -> tuple[Stroke, ...]:
        """The strokes, in order."""
        return tuple(p for p in self.phases if isinstance(p, Stroke))

    @property
    def relocations(self) -> tuple[Relocation, ...]:
        """The relocations, in order."""
        return tuple(p for p in self.phases if isinstance(p, Relocation))

    @property
    def order(self) -> tuple[str, ...]:
        """Names of the fingers in the order in which they move on."""
        return tuple(r.finger for r in self.relocations if r.cycle == 0)

    @property
    def margin(self) -> float:
        """Least normalised min-weight (-) over all strokes and lifts."""
        lifts = [r.margin for r in self.relocations]
        return min([self.motion.margin, *lifts])

    def joint_trajectory(
        self,
        *,
        approach_s: float = 1.5,
        close_s: float = 1.0,
        joint_rate: float = JOINT_RATE,
        turn_rate: float = TURN_RATE,
        rate_hz: float = 50.0,
    ) -> JointTrajectory:
        """Approach, closing, strokes and relocations as joint positions by name, for a real hand.

        Phases are "stroke 1", "regrasp FINGER", "stroke 2" and so on. For arguments and errors see
        ``MotionPlan.joint_trajectory``.
        """
        builder = TrajectoryBuilder(
            self.motion.grasp,
            approach_s=approach_s,
            close_s=close_s,
            joint_rate=joint_rate,
            turn_rate=turn_rate,
            rate_hz=rate_hz,
        )
        self.add_to(builder)
        return builder.built()

    def add_to(self, builder: TrajectoryBuilder, last: float = 1.0) -> None:
        """Append all strokes and relocations to a trajectory.

        Args:
            builder: The trajectory.
            last: Path parameter, in (0, 1], at which the last stroke ends.
        """
        for phase in self.phases:
            if isinstance(phase, Stroke):
                until = last if phase.cycle == self.cycles - 1 else 1.0
                self.motion.add_to(builder, f"stroke {phase.cycle + 1}", until)
            else:
                parameters = np.linspace(0.0, 1.0, len(phase.postures))
                builder.turn(f"regrasp {phase.finger}", phase.postures, parameters)

    def __repr__(self) -> str:
        """One line."""
        return f"<GaitPlan of {self.motion.grasp.task!r}: {self.cycles} x {self.motion.path}>"

    def __str__(self) -> str:
        """Strokes, the order in which fingers move on, and the margins."""
        task = self.motion.grasp.task
        lines = [
            f"{task.hand.name} ({', '.join(task.finger_names)}), {task.object.shape.spec}: "
            f"{self.cycles} stroke{'s' if self.cycles > 1 else ''} of {self.motion.path}",
            f"  strokes: least closure {self.motion.margin:.3f}, clearance "
            f"{1e3 * self.motion.clearance:.2f} mm",
        ]
        lines += [f"  after each, {r}" for r in self.relocations if r.cycle == 0]
        return "\n".join(lines)
