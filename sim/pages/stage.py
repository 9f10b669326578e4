"""Hand, object and surroundings of a recording as models, actors and motions of a page."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from planner.errors import FileFormatError
from planner.pages.plan_scene import Stage
from planner.pages.scene import Contacts, Motion, Scene
from planner.spatial import FloatArray, pose_from_wxyz
from planner.task import GraspTask, Obstacle
from sim.recording import Recording

NO_STATES = (
    "This report has no recorded states (it is of an older version, or they were left out), so "
    "there is no motion to show; run it again for a page with the motion."
)
"""What a page without states says."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Moving:
    """What stands in a scene and how it moves.

    Attributes:
        scene: Models, actors, motions and the camera; without plots, contacts and phases.
        note: What the picture leaves out, "" for nothing.
    """

    scene: Scene
    note: str


def moving_stage(
    task: GraspTask, recording: Recording, obstacles: Sequence[Obstacle] | None = None
) -> Moving:
    """The stage of a recording, the camera placed for the moment at which most fingers touch.

    The camera goes along with the hand, with the object where the hand is on an arm.

    Args:
        task: Whose hand, object, table and obstacles are shown.
        recording: The motion; of at least one sample.
        obstacles: What stands about instead of the task's obstacles, if something else does.

    Raises:
        FileFormatError: The recording is of another hand.
    """
    hand = task.hand
    if recording.joint_names != hand.joint_names:
        raise FileFormatError(
            f"the recorded joints are not those of {hand.name}; the report is damaged"
        )
    if obstacles is not None:
        task = replace(task, obstacles=tuple(obstacles))
    grip = int(np.isfinite(recording.points[:, :, 0]).sum(axis=1).argmax())
    base, item = (
        pose_from_wxyz(rows[grip, :3], rows[grip, 3:])
        for rows in (recording.T_world_base, recording.T_world_object)
    )
    stage = Stage(task, base, recording.q[grip], item)
    followed = "hand" if hand.arm is None else "object"
    way = recording.T_world_base if hand.arm is None else recording.T_world_object
    scene = Scene(
        models=stage.models,
        actors=tuple(stage.actors),
        focus=stage.focus - (way[grip, :3] - way[0, :3]),
        radius=stage.radius,
        time=recording.time,
        motions=(
            Motion(actor="hand", pose=recording.T_world_base, q=recording.q),
            Motion(actor="object", pose=recording.T_world_object, q=np.zeros((len(recording), 0))),
        ),
        views=stage.views(recording.contacts(grip)),
        follow=followed,
    )
    return Moving(scene=scene, note=stage.shown.note)


def bare_scene(time: FloatArray) -> Scene:
    """A scene of plots only, for a report without states."""
    return Scene(models={}, actors=(), focus=np.zeros(3), radius=0.1, time=time)


def measured_contacts(recording: Recording) -> Contacts:
    """The recorded contacts, with cones of the sliding friction that most of them have."""
    friction = recording.friction[..., 0]
    known = friction[np.isfinite(friction)]
    return Contacts(
        name="measured",
        layer="measured contacts",
        fingers=recording.contact_names,
        points=recording.points,
        normals=recording.normals,
        forces=recording.forces,
        mu=float(np.median(known)) if len(known) else 0.0,
    )
