"""Hand, object and surroundings of a recording as models, actors and motions of a page."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from planner.errors import FileFormatError
from planner.pages.hand_model import hand_model
from planner.pages.rows import IDENTITY_ROW, pose_row
from planner.pages.scene import Actor, Contacts, Model, Motion
from planner.pages.surroundings import object_model, obstacle_model, table_model
from planner.spatial import FloatArray
from planner.task import GraspTask, Obstacle
from sim.recording import Recording

__all__ = ["NO_STATES", "Stage", "measured_contacts", "stage_of"]

NO_STATES = (
    "This report has no recorded states (it is of an older version, or they were left out), so "
    "there is no motion to show; run it again for a page with the motion."
)
"""What a page without states says."""

FAR = 0.4
"""Distance (m) from where the object stood at first beyond which the camera does not look: an
object that fell may roll away."""

TABLE_WIDTH = 8.0
"""Width of the table as drawn, over the radius of what is to be seen (-)."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Stage:
    """What stands in a scene and how it moves.

    Attributes:
        models: Name -> model.
        actors: Hand, object, table, obstacles.
        motions: Of hand and object.
        focus: Where the camera looks first (3,), m, world.
        radius: Size of what is to be seen, m.
        note: What the picture leaves out, "" for nothing.
    """

    models: dict[str, Model]
    actors: tuple[Actor, ...]
    motions: tuple[Motion, ...]
    focus: FloatArray
    radius: float
    note: str


def stage_of(
    task: GraspTask, recording: Recording, obstacles: Sequence[Obstacle] | None = None
) -> Stage:
    """The stage of a recording.

    Args:
        task: Whose hand, object, table and obstacles are shown.
        recording: The motion.
        obstacles: What stands about instead of the task's obstacles, if something else does.

    Raises:
        FileFormatError: The recording is of another hand.
    """
    if recording.joint_names != task.hand.joint_names:
        raise FileFormatError(f"the recorded joints are not those of {task.hand.name}; damaged")
    shown = object_model(task.object.shape)
    focus, radius = _view(task, recording)
    models = {"hand": hand_model(task.hand), "object": shown.model}
    still = np.zeros(0)
    actors = [
        Actor(name="hand", model="hand", pose=recording.T_world_base[0], q=recording.q[0]),
        Actor(name="object", model="object", pose=recording.T_world_object[0], q=still),
    ]
    if task.table_height is not None:
        models["table"] = table_model(task.table_height, TABLE_WIDTH * radius)
        x, y, _ = task.T_world_object.translation
        pose = np.array([x, y, *IDENTITY_ROW[2:]])
        actors.append(Actor(name="table", model="table", pose=pose, q=still, layer="table"))
    for k, obstacle in enumerate(task.obstacles if obstacles is None else obstacles):
        name = f"obstacle {k}: {obstacle.name}"
        models[name] = obstacle_model(obstacle)
        pose = pose_row(obstacle.T_world_obstacle)
        actors.append(Actor(name=name, model=name, pose=pose, q=still, layer="obstacles"))
    motions = (
        Motion(actor="hand", pose=recording.T_world_base, q=recording.q),
        Motion(actor="object", pose=recording.T_world_object, q=np.zeros((len(recording.time), 0))),
    )
    return Stage(
        models=models,
        actors=tuple(actors),
        motions=motions,
        focus=focus,
        radius=radius,
        note=shown.note,
    )


def measured_contacts(recording: Recording, mu: float) -> Contacts:
    """The recorded contacts, with cones of the simulation's friction."""
    return Contacts(
        name="measured",
        layer="measured contacts",
        fingers=recording.contact_names,
        points=recording.points,
        normals=recording.normals,
        forces=recording.forces,
        mu=mu,
    )


def _view(task: GraspTask, recording: Recording) -> tuple[FloatArray, float]:
    """Centre and radius of where object and hand are, what rolled away left out."""
    size = task.object.shape.bounding_radius
    first = recording.T_world_object[0, :3]
    seen = [recording.T_world_object[:, :3]]
    if task.hand.arm is None:
        seen.append(recording.T_world_base[:, :3])
    points = np.concatenate(seen)
    points = points[np.linalg.norm(points - first, axis=1) < FAR]
    points = np.concatenate([points, first[None]])
    low, high = points.min(axis=0) - size, points.max(axis=0) + size
    return (low + high) / 2, float(np.linalg.norm(high - low)) / 2
