"""What the rows of an objective are made of: a grasp in symbols, and the same one in numbers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from planner.hands.fingers import Finger
from planner.kinematics.symbolic import SymbolicHand
from planner.spatial import FloatArray
from planner.task import GraspTask

__all__ = ["GraspSymbols", "Moment"]


@dataclass(frozen=True, kw_only=True)
class GraspSymbols:
    """The unknowns and parameters of a formulation that objectives are written in, SX.

    Attributes:
        fingers: Fingers that take part.
        symbolic: Kinematics at q.
        rotation: Of the base in the object's frame (3, 3).
        q: Joints (nq,).
        points: Contact points (3,) each, object frame, m.
        outward: Outward normals (3,) there.
        forces: Forces on the object (3,) each, in units of the mean normal force.
        mu: Friction (-).
        length: Characteristic length, m.
    """

    fingers: tuple[Finger, ...]
    symbolic: SymbolicHand
    rotation: Any
    q: Any
    points: list[Any]
    outward: list[Any]
    forces: list[Any]
    mu: Any
    length: Any


@dataclass(frozen=True, kw_only=True, eq=False)
class Moment:
    """A grasp in numbers when a round begins.

    Attributes:
        task: The task, with the fingers that take part.
        q: Joints (nq,).
        points: Contact points (n, 3), object frame, m.
        inward: Unit normals into the object (n, 3).
        wrenches: Task wrenches (k, 6), object frame, N and N m.
    """

    task: GraspTask
    q: FloatArray
    points: FloatArray
    inward: FloatArray
    wrenches: FloatArray

    @property
    def length(self) -> float:
        """Characteristic length, m."""
        return self.task.object.shape.bounding_radius
