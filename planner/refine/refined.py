"""``RefinedGrasp``: what became of a given hand pose."""

from __future__ import annotations

from dataclasses import dataclass

from planner.attempt import Attempt
from planner.failure import Failure
from planner.immutable import freeze
from planner.plan import GraspPlan
from planner.refine.movement import Movement
from planner.spatial import SE3, FloatArray
from planner.task import GraspTask


@dataclass(frozen=True, kw_only=True)
class RefinedGrasp:
    """The nearest grasp to a given pose that passes the whole verdict, or why there is none near.

    Attributes:
        task: The task, with the fingers that take part.
        T_world_base: Base pose as given.
        q: Joints as given (nq,).
        plan: The grasp; None where none was found.
        failure: Why there is none, that of the try that came farthest; None where one was found.
        movement: How far the hand moved to the plan, or to the nearest that was reached; None where
            nothing was tried.
        T_world_base_reached: Base pose of the plan, or of the nearest that was reached.
        q_reached: Its joints (nq,).
        attempts: All tries, the nearest first.
        notes: What was changed of the given pose before it began, a sentence each.
        cpu_s: CPU time of all tries, s.
        build_s: Time that building the problem took, s: once per hand, fingers and kind of shape.
    """

    task: GraspTask
    T_world_base: SE3
    q: FloatArray
    plan: GraspPlan | None
    failure: Failure | None
    movement: Movement | None
    T_world_base_reached: SE3
    q_reached: FloatArray
    attempts: tuple[Attempt[GraspPlan], ...]
    notes: tuple[str, ...]
    cpu_s: float
    build_s: float

    def __post_init__(self) -> None:
        """Keep read-only copies."""
        freeze(self, poses=("T_world_base", "T_world_base_reached"), arrays=("q", "q_reached"))

    @classmethod
    def untried(
        cls, task: GraspTask, T_world_base: SE3, q: FloatArray, failure: Failure
    ) -> RefinedGrasp:
        """The result of a pose from which nothing was tried.

        Args:
            task: The task.
            T_world_base: Base pose as given.
            q: Joints as given.
            failure: Why not.
        """
        return cls(
            task=task,
            T_world_base=T_world_base,
            q=q,
            plan=None,
            failure=failure,
            movement=None,
            T_world_base_reached=T_world_base,
            q_reached=q,
            attempts=(),
            notes=(),
            cpu_s=0.0,
            build_s=0.0,
        )

    @property
    def found(self) -> bool:
        """Whether there is a plan."""
        return self.plan is not None

    def __str__(self) -> str:
        """What became of it, and how far the hand moved, in a few lines."""
        head = (
            f"brought back with {', '.join(self.task.finger_names)} at try {len(self.attempts)}"
            if self.failure is None
            else f"not brought back: {self.failure}"
        )
        moved = []
        if self.movement is not None:
            moved = [f"{'moved' if self.found else 'nearest reached, moved'}: {self.movement}"]
        return "\n".join([head, *moved, *(f"note: {note}" for note in self.notes)])
