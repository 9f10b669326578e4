"""The convex geoms that together stand for a shape in MuJoCo."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from planner.shapes.base import Shape
from planner.shapes.mesh import Mesh, surface_triangles
from planner.spatial import SE3, FloatArray, IntArray

MESH = "mesh"
"""Kind of a geom that is given by its vertices and faces."""


@dataclass(frozen=True, kw_only=True, eq=False)
class SolidGeom:
    """One convex geom of an object.

    Attributes:
        kind: MuJoCo's geom type, for example "box"; "mesh" for a convex polyhedron.
        size: Half lengths and radii, m, one to three; empty for a mesh.
        T_object_geom: Its pose in the shape's frame.
        vertices: (n, 3), m, in the geom's frame; None unless a mesh.
        faces: (m, 3), counter-clockwise seen from outside; None unless a mesh.
    """

    kind: str
    size: tuple[float, ...]
    T_object_geom: SE3
    vertices: FloatArray | None = None
    faces: IntArray | None = None


def solid_geoms(shape: Shape) -> tuple[SolidGeom, ...]:
    """The geoms that together stand for a shape in MuJoCo."""
    here = SE3(np.eye(3), np.zeros(3))
    if isinstance(shape, Mesh):
        from planner.shapes.pieces import convex_pieces  # here: for meshes alone

        pieces = convex_pieces(shape)
        return tuple(
            SolidGeom(kind=MESH, size=(), T_object_geom=here, vertices=v, faces=f)
            for v, f in zip(pieces.vertices, pieces.faces, strict=True)
        )
    geom = shape.mujoco_geom()
    if geom is None:
        vertices, faces = surface_triangles(shape)
        return (SolidGeom(kind=MESH, size=(), T_object_geom=here, vertices=vertices, faces=faces),)
    kind, size = geom
    return (SolidGeom(kind=kind, size=size, T_object_geom=here),)


def solid_deviation(shape: Shape) -> float:
    """How far (m) ``solid_geoms`` reach out of the true shape at most; 0 where they are exact."""
    if not isinstance(shape, Mesh):
        return 0.0
    from planner.shapes.pieces import convex_pieces

    return convex_pieces(shape).deviation
