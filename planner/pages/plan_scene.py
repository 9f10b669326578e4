"""What pages of plans, motions and runs have in common: actors, contacts, the camera's place.

Table, obstacles and object are models; the camera stands beside the palm when a page opens, where
the hand hides little.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

import numpy as np
import trimesh

from planner.contacts import ContactSet
from planner.kinematics import HandState
from planner.pages.scene import (
    IDENTITY_ROW,
    Actor,
    Contacts,
    Layer,
    Model,
    Part,
    View,
    hand_model,
    pose_row,
)
from planner.plan import GraspPlan
from planner.shapes import Shape
from planner.shapes.mesh import surface_points, surface_triangles
from planner.shapes.meshes.triangles import simplified
from planner.spatial import SE3, FloatArray, IntArray
from planner.task import GraspTask, Obstacle

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
            Actor(name="object", model="object", pose=pose_row(T_world_object)),
        ]
        if task.table_height is not None:
            self.models["table"] = table_model(TABLE_RADIUS * self.radius)
            place = IDENTITY_ROW.copy()
            place[:3] = [*self.focus[:2], task.table_height]
            self.actors.append(Actor(name="table", model="table", pose=place))
        for obstacle in task.obstacles:
            name = f"obstacle {obstacle.name}"
            self.models[name] = obstacle_model(obstacle)
            pose = pose_row(obstacle.T_world_obstacle)
            self.actors.append(Actor(name=name, model=name, pose=pose))

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


def planned_contacts(sets: Sequence[ContactSet], actor: str | None = None) -> Contacts:
    """Planned contacts for a scene: one set for all times, or one for each of its times."""
    rows = [contact_rows(s) for s in sets]
    points, normals, forces = (np.array([r[k] for r in rows]) for k in range(3))
    return Contacts(
        name="planned",
        layer="planned contacts",
        fingers=sets[0].fingers,
        points=points,
        normals=normals,
        forces=forces,
        mu=float(np.min(sets[0].mu)),
        actor=actor,
    )


Triangles: TypeAlias = tuple[FloatArray, IntArray]
"""Vertices (n, 3), m, and triangles (k, 3), numbers of vertices."""

MOST_TRIANGLES = 30_000
"""Of an object in a page; such a page stays below 1 MB."""

OBJECT_COLOUR = (0.36, 0.62, 0.84, 1.0)
MARK_COLOUR = (0.98, 0.98, 0.96, 1.0)
TABLE_COLOUR = (0.83, 0.82, 0.80, 1.0)
OBSTACLE_COLOUR = (0.66, 0.55, 0.47, 1.0)
"""Colours; the mark is a stripe that shows turns."""

STRIPE = 0.09
"""Half width of the stripe over the object's half extent (-)."""

TABLE_THICKNESS = 0.006
"""Of a table as drawn, m."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ShownObject:
    """An object's model, and whether it has fewer triangles than the object.

    Attributes:
        model: The model.
        triangles: Triangles of the object.
        shown: Triangles of the model.
    """

    model: Model
    triangles: int
    shown: int

    @property
    def note(self) -> str:
        """A sentence for the page; "" where all triangles are shown."""
        if self.shown >= self.triangles:
            return ""
        return (
            f"The picture shows {self.shown} triangles of the object's {self.triangles}; contacts "
            "and clearances were computed with all of them."
        )


def object_model(shape: Shape, name: str = "object") -> ShownObject:
    """An object with its true triangles and a stripe around it, by which a turn can be seen.

    Args:
        shape: Its shape; a mesh of more than ``MOST_TRIANGLES`` triangles is simplified.
        name: What is said where it is pointed at.
    """
    vertices, triangles = surface_triangles(shape)
    total = len(triangles)
    vertices, triangles, _ = simplified(vertices, triangles, MOST_TRIANGLES)
    body = Part(
        name=name,
        layer="object",
        vertices=vertices,
        triangles=triangles,
        colour=OBJECT_COLOUR,
    )
    parts = _striped(body)
    return ShownObject(model=Model(joints=(), parts=parts), triangles=total, shown=len(triangles))


def _striped(body: Part) -> tuple[Part, ...]:
    """The body in two parts: a stripe around it where x > 0 and y is near 0, and the rest."""
    width = STRIPE * float(np.ptp(body.vertices, axis=0).max()) / 2
    rest: list[Triangles] = []
    stripe: Triangles = (np.asarray(body.vertices), np.asarray(body.triangles))
    for outwards, offset in (((0, 1, 0), width), ((0, -1, 0), width), ((-1, 0, 0), 0.0)):
        normal = np.array(outwards, dtype=np.float64)
        rest.append(_half(stripe, normal, offset * normal))
        stripe = _half(stripe, -normal, offset * normal)
    out = []
    for pieces, colour, name in (
        (rest, body.colour, body.name),
        ([stripe], MARK_COLOUR, f"heading mark of {body.name}"),
    ):
        vertices, triangles = _joined(pieces)
        if len(triangles):
            out.append(
                replace(body, name=name, vertices=vertices, triangles=triangles, colour=colour)
            )
    return tuple(out)


def _half(surface: Triangles, normal: FloatArray, origin: FloatArray) -> Triangles:
    """What of a surface lies on the normal's side of a plane."""
    if not len(surface[1]):
        return surface
    vertices, triangles, *_ = trimesh.intersections.slice_faces_plane(
        *surface, plane_normal=normal, plane_origin=origin
    )
    return np.asarray(vertices, np.float64), np.asarray(triangles, np.int64)


def _joined(pieces: list[Triangles]) -> Triangles:
    """Several surfaces as one."""
    vertices, triangles, count = [], [], 0
    for v, t in pieces:
        if len(t):
            vertices.append(v)
            triangles.append(t + count)
            count += len(v)
    if not triangles:
        return np.zeros((0, 3)), np.zeros((0, 3), np.int64)
    return np.concatenate(vertices), np.concatenate(triangles)


def table_model(radius: float) -> Model:
    """A round plate whose top is at z = 0; a table of the planner has no end, this is a part.

    It has no underside, so that a camera from below looks through it.
    """
    solid = trimesh.creation.cylinder(radius=radius, height=TABLE_THICKNESS, sections=96)
    solid.update_faces(solid.face_normals[:, 2] > -0.5)
    shift = np.array([0.0, 0.0, -TABLE_THICKNESS / 2])
    plate = _part("table", "table", solid, TABLE_COLOUR)
    return Model(joints=(), parts=(replace(plate, vertices=plate.vertices + shift),))


def obstacle_model(obstacle: Obstacle) -> Model:
    """An obstacle's box in its own frame."""
    solid = trimesh.creation.box(extents=obstacle.size)
    part = _part(f"obstacle {obstacle.name}", "obstacles", solid, OBSTACLE_COLOUR)
    return Model(joints=(), parts=(part,))


def _part(name: str, layer: Layer, solid: Any, colour: tuple[float, float, float, float]) -> Part:
    return Part(
        name=name,
        layer=layer,
        vertices=np.asarray(solid.vertices, np.float64),
        triangles=np.asarray(solid.faces, np.int64),
        colour=colour,
    )


POINTS = 2000
"""Points of a hand, about 7 mm apart."""

NEAR = 0.008
"""Distance (m) from a line of sight within which a point of the hand hides what is behind."""

IN_FRONT = 0.01
"""How much nearer to the camera (m) it is then at least: a tip does not hide its own contact."""

AZIMUTHS = np.deg2rad(np.arange(-180, 180, 15))
HEIGHTS = (0.25, 0.45, 0.8)
USUAL_HEIGHT = 0.45
"""Places that are compared: angles (rad) about the vertical, heights over the distance (-)."""

USUAL = np.array([0.5, -0.75, 0.0])
"""From the right and the front, where the rest leaves a choice."""


def hand_points(model: Model, T_world_base: SE3, state: HandState) -> FloatArray:
    """Points (n, 3), m, world, spread by area over what is drawn of a hand."""
    rng = np.random.default_rng(0)
    corners = []
    for part in model.parts:
        if part.layer != "hand":
            continue
        pose = T_world_base if part.joint < 0 else T_world_base * state.joint_pose(part.joint + 1)
        vertices = np.asarray(part.vertices) @ pose.rotation.T + pose.translation
        corners.append(vertices[part.triangles])
    triangles = np.concatenate(corners)  # (k, 3, 3)
    sides = triangles[:, 1:] - triangles[:, :1]
    ends = np.cumsum(np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1))
    chosen = np.searchsorted(ends, (np.arange(POINTS) + 0.5) / POINTS * ends[-1])
    weights = rng.dirichlet(np.ones(3), size=POINTS)
    points: FloatArray = np.einsum("nk,nkd->nd", weights, triangles[chosen])
    return points


def views_of(
    facing: FloatArray, contacts: ContactSet | None, hiding: FloatArray, seen: FloatArray
) -> tuple[View, ...]:
    """The opening view, named "start", and "palm".

    The opening one looks neither along the palm's normal nor along the grip, and as little of the
    object as possible is behind the hand.

    Args:
        facing: Direction that the palm faces (3,), unit, world.
        contacts: World; None where nothing is held.
        hiding: Points of the hand (n, 3), m, world.
        seen: Points of the object (m, 3), m, world.
    """
    grip = np.zeros(3)
    if contacts is not None and len(contacts):
        grip = np.linalg.eigh(contacts.normals.T @ contacts.normals)[1][:, -1]
    azimuth, height = (v.ravel() for v in np.meshgrid(AZIMUTHS, HEIGHTS))
    directions = np.column_stack([np.cos(azimuth), np.sin(azimuth), height])
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    costs = np.abs(directions @ facing) + 0.6 * np.abs(directions @ grip)
    costs += np.abs(height - USUAL_HEIGHT) - 0.1 * directions @ USUAL
    best, least = 0, np.inf
    for k in np.argsort(costs):
        if costs[k] >= least:
            break  # what the hand hides only adds to it
        cost = costs[k] + 2.0 * _hidden(directions[k], hiding, seen)
        if cost < least:
            best, least = k, cost
    return _view("start", directions[best]), _view("palm", facing)


def _hidden(direction: FloatArray, hiding: FloatArray, seen: FloatArray) -> float:
    """Share of points (m, 3) that are behind others (n, 3) for a camera in a direction."""
    across = np.linalg.svd(direction[None])[2][1:].T  # (3, 2): the plane of the picture
    u, v = ((seen @ a)[:, None] - hiding @ a for a in across.T)
    nearer = hiding @ direction - (seen @ direction)[:, None] > IN_FRONT
    return float(((u * u + v * v < NEAR**2) & nearer).any(axis=1).mean())


def _view(name: str, direction: FloatArray) -> View:
    x, y, z = (float(v) for v in direction)
    return View(name=name, direction=(x, y, z))
