"""Features by which grasps of one object are compared: base, contacts and joints.

All in the object's frame, so that where the object lies in the world makes no difference.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from planner.errors import TaskError
from planner.failure import Failure
from planner.kinematics.state import HandState
from planner.plan import GraspPlan
from planner.spatial import FloatArray, pose_from_wxyz
from planner.synthesis.seeds.mesh import seeder_for
from planner.task import GraspTask

DRAWS_PER_START = 50
"""Draws per start before the seeder counts as unable to give one."""


@dataclass(frozen=True, kw_only=True, eq=False)
class GraspFeatures:
    """n grasps of one object by one hand with c fingers, of which some may be spared.

    Attributes:
        positions: Hand's base (n, 3), m.
        rotations: Hand's base (n, 3, 3).
        approach: Direction that the palm faces (n, 3), unit.
        contacts: (n, c, 3), m, finger by finger; NaN where one does not touch.
        q: Joints of these fingers (n, d), rad (m for slides).
    """

    positions: FloatArray
    rotations: FloatArray
    approach: FloatArray
    contacts: FloatArray
    q: FloatArray

    def __post_init__(self) -> None:
        """Check the shapes.

        Raises:
            TaskError: They do not fit.
        """
        n = len(self.positions)
        given = [np.shape(getattr(self, name)) for name in self.__dataclass_fields__]
        tails = ((3,), (3, 3), (3,), (*given[3][1:2], 3), given[4][1:2])
        if given != [(n, *tail) for tail in tails]:
            raise TaskError(
                f"arrays of grasps have shapes {given}; give (n, 3), (n, 3, 3), (n, 3), (n, c, 3) "
                "and (n, d)"
            )

    def __len__(self) -> int:
        """Number of grasps."""
        return len(self.positions)

    def __getitem__(self, rows: Any) -> GraspFeatures:
        """Some of the grasps, as numpy indexes rows."""
        return GraspFeatures(**{k: getattr(self, k)[rows] for k in self.__dataclass_fields__})

    @classmethod
    def of_rows(cls, task: GraspTask, rows: Sequence[Mapping[str, Any]]) -> GraspFeatures:
        """Of rows of a dataset, all found, all of the task's object."""
        index, n = _finger_joints(task), len(rows)
        contacts = np.full((n, len(task.fingers), 3), np.nan)
        for places, row in zip(contacts, rows, strict=True):
            names = row.get("fingers") or task.finger_names
            places[[task.finger_names.index(f) for f in names]] = row["contact_positions_object_m"]
        rotations = [
            pose_from_wxyz(np.zeros(3), np.array(row["base_quaternion_object_wxyz"])).rotation
            for row in rows
        ]
        return cls(
            positions=_stack([row["base_position_object_m"] for row in rows], (n, 3)),
            rotations=_stack(rotations, (n, 3, 3)),
            approach=_stack([row["approach_object"] for row in rows], (n, 3)),
            contacts=contacts,
            q=_stack([np.array(row["q_rad"])[index] for row in rows], (n, len(index))),
        )

    @classmethod
    def of_plans(cls, plans: Sequence[GraspPlan]) -> GraspFeatures:
        """Of plans of one object by one hand; c is for the fingers of the one that has most.

        Raises:
            TaskError: There is none, or one has fingers that this one has not.
        """
        if not plans:
            raise TaskError("there are no plans to compare; give at least one")
        whole = max((plan.task for plan in plans), key=lambda task: len(task.fingers))
        index, names = _finger_joints(whole), list(whole.finger_names)
        contacts = np.full((len(plans), len(names), 3), np.nan)
        for places, plan in zip(contacts, plans, strict=True):
            if other := sorted(set(plan.task.finger_names) - set(names)):
                raise TaskError(
                    f"a plan uses {', '.join(other)}, and another {', '.join(names)}; give plans "
                    "of one task"
                )
            taken = [names.index(name) for name in plan.task.finger_names]
            places[taken] = plan.contacts_in_object.positions
        to_object = [plan.task.T_world_object.inverse() for plan in plans]
        bases = [T * plan.T_world_base for T, plan in zip(to_object, plans, strict=True)]
        palms = [T * plan.T_world_palm for T, plan in zip(to_object, plans, strict=True)]
        normal = plans[0].task.hand.palm_normal
        return cls(
            positions=np.array([T.translation for T in bases]),
            rotations=np.array([T.rotation for T in bases]),
            approach=np.array([T.rotation @ normal for T in palms]),
            contacts=contacts,
            q=np.array([plan.q[index] for plan in plans]),
        )

    @classmethod
    def of_random_starts(cls, task: GraspTask, n: int, *, seed: int = 0) -> GraspFeatures:
        """Of n independent starts of the search, as they are before solving.

        Reference for the diversity of a batch: solving should not bring grasps together.

        Raises:
            TaskError: The object cannot be grasped by this hand, or starts cannot be drawn.
        """
        seeder, rng = seeder_for(task), np.random.default_rng(seed)
        starts: list[Any] = []
        for _ in range(DRAWS_PER_START * n):
            if len(starts) == n:
                break
            start = seeder.draw(rng)
            if not isinstance(start, Failure):
                starts.append(start)
        else:
            raise TaskError(
                f"of {DRAWS_PER_START * n} starts drawn for {task!r} only {len(starts)} can be "
                "used; bring the object into reach"
            )
        index, hand, c = _finger_joints(task), task.hand, len(task.fingers)
        palms = [s.T_object_base * HandState(hand, s.q).T_base_palm for s in starts]
        return cls(
            positions=_stack([s.T_object_base.translation for s in starts], (n, 3)),
            rotations=_stack([s.T_object_base.rotation for s in starts], (n, 3, 3)),
            approach=_stack([T.rotation @ hand.palm_normal for T in palms], (n, 3)),
            contacts=_stack([s.points for s in starts], (n, c, 3)),
            q=_stack([s.q[index] for s in starts], (n, len(index))),
        )


def _finger_joints(task: GraspTask) -> Any:
    """Where the joints of the fingers that take part stand in q."""
    return np.concatenate([finger.q_index for finger in task.fingers])


def _stack(items: Sequence[Any], shape: tuple[int, ...]) -> FloatArray:
    """Items as one array of a known shape, which says the rest where there are none."""
    return np.array(items, dtype=np.float64).reshape(shape)
