"""Models of an object, a table and obstacles for a page."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, TypeAlias

import numpy as np
import trimesh

from planner.pages.scene import Layer, Model, Part
from planner.shapes import Shape
from planner.shapes.mesh import Mesh, surface_triangles
from planner.shapes.meshes.simplify import simplified
from planner.spatial import FloatArray, IntArray
from planner.task import Obstacle

__all__ = ["ShownObject", "object_model", "obstacle_model", "table_model"]

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
    vertices, triangles = _triangles(shape)
    total = len(triangles)
    vertices, triangles, _ = simplified(vertices, triangles, MOST_TRIANGLES)
    body = Part(
        name=name,
        joint=-1,
        layer="object",
        vertices=vertices,
        triangles=triangles,
        colour=OBJECT_COLOUR,
        smooth=True,
    )
    parts = _striped(body)
    return ShownObject(model=Model(joints=(), parts=parts), triangles=total, shown=len(triangles))


def _triangles(shape: Shape) -> Triangles:
    """Vertices and triangles of a shape; flat faces in as few triangles as they need."""
    if isinstance(shape, Mesh):
        return shape.vertices, shape.faces
    return surface_triangles(shape)


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
        joint=-1,
        layer=layer,
        vertices=np.asarray(solid.vertices, np.float64),
        triangles=np.asarray(solid.faces, np.int64),
        colour=colour,
        smooth=True,
    )
