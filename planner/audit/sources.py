"""Plans and batches of ours as grasps to be judged, through the same door as those of others."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from planner.batch.dataset import GraspSet
from planner.batch.recipe import with_fingers_of
from planner.exchange.frames import T_file_object
from planner.exchange.given import GivenGrasp, GivenGrasps
from planner.plan import GraspPlan
from planner.spatial import pose_from_wxyz
from planner.task import GraspTask


def given_of_plans(
    plans: Sequence[GraspPlan], source: Path, names: Sequence[str] | None = None
) -> Iterator[tuple[GraspTask, GivenGrasps]]:
    """Each plan with its task, as a grasp of which nothing is verified.

    Args:
        plans: The plans.
        source: Where they are from.
        names: What to call them; their seeds if None.
    """
    for plan, name in zip(plans, names or [f"seed {p.record.seed}" for p in plans], strict=True):
        to_file, upright = T_file_object(plan.task), plan.task.T_world_object
        grasp = GivenGrasp(
            name=name,
            T_object_base=to_file * upright.inverse() * plan.T_world_base,
            q=plan.q,
            q_pregrasp=plan.q_pregrasp,
            object=plan.task.object.shape.spec,
            T_world_object=upright * to_file.inverse(),
        )
        yield (
            plan.task,
            GivenGrasps(source=source, format="plan", hand=plan.task.hand.name, grasps=(grasp,)),
        )


def given_of_batch(grasps: GraspSet, source: Path) -> Iterator[tuple[GraspTask, GivenGrasps]]:
    """The found grasps of a batch, one set per object and fingers, with their task."""
    for label in grasps.labels:
        sets: dict[tuple[str, ...], tuple[GraspTask, list[GivenGrasp]]] = {}
        for index, row in grasps.found(label):
            task = with_fingers_of(grasps.task(label), row)
            to_file = T_file_object(task)
            base = pose_from_wxyz(
                np.array(row["base_position_object_m"]),
                np.array(row["base_quaternion_object_wxyz"]),
            )
            grasp = GivenGrasp(
                name=f"row {index}",
                T_object_base=to_file * base,
                q=np.array(row["q_rad"]),
                q_pregrasp=np.array(row["q_pregrasp_rad"]),
                object=label,
                T_world_object=task.T_world_object * to_file.inverse(),
            )
            sets.setdefault(task.finger_names, (task, []))[1].append(grasp)
        for task, some in sets.values():
            yield (
                task,
                GivenGrasps(source=source, format="batch", hand=task.hand.name, grasps=tuple(some)),
            )
