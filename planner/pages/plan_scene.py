"""What pages of plans, motions and runs have in common: actors, contacts, the camera's place."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from planner.contacts import ContactSet
from planner.kinematics.state import HandState
from planner.pages.hand_model import hand_model
from planner.pages.rows import IDENTITY_ROW, pose_row
from planner.pages.scene import Actor, Contacts, Layer, Model, View
from planner.pages.surroundings import ShownObject, object_model, obstacle_model, table_model
from planner.pages.viewpoint import hand_points, views_of
from planner.plan import GraspPlan
from planner.shapes.mesh import surface_points
from planner.spatial import SE3, FloatArray
from planner.task import GraspTask

__all__ = ["Stage", "contact_rows", "planned_contacts", "stage_of"]

SEEN = 40
"""Points of the object by which views are compared."""

MARGIN = 0.03
"""How far (m) the picture reaches beyond joints and object: the thickness of a finger."""

TABLE_RADIUS = 1.6
"""Of the table as drawn, in radii of what is seen."""


class Stage:
    """Hand, object, table and obstacles of a task as actors and models of a scene.

    Attributes:
        models: Name -> model.
        actors: "hand", "object", "table" and the obstacles by their names.
        shown: The object as drawn.
        focus: Middle of hand and object, (3,), m, world.
        radius: Of the ball about it that holds both, m.
    """

    def __init__(
        self,
        task: GraspTask,
        T_world_base: SE3,
        q: FloatArray,
        T_world_object: SE3,
        *,
        for_painter: bool = False,
    ) -> None:
        """Models and actors for hand and object where they are given; see ``hand_model``."""
        self._hand, self._object = task.hand, task.object.shape
        self._T_world_base, self._q, self._T_world_object = T_world_base, q, T_world_object
        self.shown: ShownObject = object_model(task.object.shape, task.object.name)
        self.models: dict[str, Model] = {
            "hand": hand_model(task.hand, for_painter=for_painter),
            "object": self.shown.model,
        }
        self.focus, self.radius = _extent(task, T_world_base, q, T_world_object)
        self.actors: list[Actor] = [
            Actor(name="hand", model="hand", pose=pose_row(T_world_base), q=np.array(q)),
            Actor(name="object", model="object", pose=pose_row(T_world_object), q=np.zeros(0)),
        ]
        if task.table_height is not None:
            self.models["table"] = table_model(TABLE_RADIUS * self.radius)
            place = IDENTITY_ROW.copy()
            place[:3] = [*self.focus[:2], task.table_height]
            self.actors.append(Actor(name="table", model="table", pose=place, q=np.zeros(0)))
        for obstacle in task.obstacles:
            name = f"obstacle {obstacle.name}"
            self.models[name] = obstacle_model(obstacle)
            pose = pose_row(obstacle.T_world_obstacle)
            self.actors.append(Actor(name=name, model=name, pose=pose, q=np.zeros(0)))

    def views(self, contacts: ContactSet | None) -> tuple[View, ...]:
        """The opening place of the camera, and that which faces the palm.

        Args:
            contacts: World; None where nothing is held.
        """
        state = HandState(self._hand, self._q)
        palm = self._T_world_base * state.T_base_palm
        hiding = hand_points(self.models["hand"], self._T_world_base, state)
        seen = surface_points(self._object, SEEN)
        seen = seen @ self._T_world_object.rotation.T + self._T_world_object.translation
        return views_of(palm.rotation @ self._hand.palm_normal, contacts, hiding, seen)


def stage_of(plan: GraspPlan) -> Stage:
    """The stage of a plan, hand at the grasp."""
    return Stage(plan.task, plan.T_world_base, plan.q, plan.task.T_world_object)


def _extent(
    task: GraspTask, T_world_base: SE3, q: FloatArray, T_world_object: SE3
) -> tuple[FloatArray, float]:
    """Middle and radius of the fingers, the palm and the object."""
    hand = task.hand
    state = HandState(hand, q)
    points = [(T_world_base * state.T_base_palm).translation]
    for finger in hand.fingers.values():
        joints = [int(i) + 1 for i in finger.q_index]
        points += [(T_world_base * state.joint_pose(j)).translation for j in joints]
        points.append((T_world_base * state.joint_pose(finger.pad.joint_id)).act(finger.pad.center))
    half = task.object.shape.half_extents
    corners = np.array(np.meshgrid(*([[-1, 1]] * 3))).reshape(3, -1).T * half
    points += [T_world_object.act(c) for c in corners]
    cloud = np.array(points)
    focus = (cloud.min(axis=0) + cloud.max(axis=0)) / 2
    return focus, float(np.linalg.norm(cloud - focus, axis=1).max()) + MARGIN


def contact_rows(contacts: ContactSet) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Points, normals and forces of contacts, (n, 3) each, in the frame of the contacts."""
    return np.array(contacts.positions), np.array(contacts.normals), contacts.forces_in_axes()


def planned_contacts(
    sets: Sequence[ContactSet], actor: str | None = None, layer: Layer = "planned contacts"
) -> Contacts:
    """Planned contacts for a scene: one set for all times, or one for each of its times."""
    rows = [contact_rows(s) for s in sets]
    points, normals, forces = (np.array([r[k] for r in rows]) for k in range(3))
    return Contacts(
        name="planned",
        layer=layer,
        fingers=sets[0].fingers,
        points=points,
        normals=normals,
        forces=forces,
        mu=float(np.min(sets[0].mu)),
        actor=actor,
    )
