"""A mesh as a few convex pieces that together cover it, for MuJoCo, which collides convex geoms.

The solid is cut by planes into cells, and a piece is the convex hull of the solid within its cell.
So every point of the solid is in a piece, and a piece is too large only where it bridges a concave
part. A cell is cut again until its piece reaches nowhere farther than the tolerance from the solid:
a space that other parts of the solid fill does not count against it.

The cut is the plane, out of some, that leaves the least volume of hulls: planes across the
principal axes, and tangent planes of the concave part itself, which find the corners of brackets.
Then pieces are merged where their common hull keeps the tolerance too. Nothing here is random.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from heapq import heapify, heappop, heappush

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from planner.shapes.cache import read_arrays, write_arrays
from planner.shapes.mesh import Mesh
from planner.shapes.triangles import cover
from planner.spatial import FloatArray, IntArray

__all__ = ["MAX_PIECES", "TOLERANCE", "ConvexPiece", "Pieces", "convex_pieces"]

TOLERANCE = 0.0005
"""How far (m) a piece may reach out of the solid: the tolerance of a touch."""

MAX_PIECES = 96
"""Pieces that are made at most; past it the deviation, which is measured, tells what is missing."""

PIECES_VERSION = "v1"
"""Changes with the result, so that older files in the cache are left alone."""

SPACING = 1.5
"""Spacing of the points that stand at the tolerance off the surface, in tolerances."""

MAX_GUARDS = 40_000
"""Those points, at most."""

FREE = 0.95
"""A guard counts if it is at least so far from the solid, in tolerances: in a corner it is not."""

SHARES = (0.2, 0.35, 0.5, 0.65, 0.8)
"""Where planes across an axis cut, as shares of the extent."""

TANGENTS = 8
"""Tangent planes that are tried per cut."""

SCORED_POINTS = 300
"""Surface points, about, by which planes are compared."""

FLAT = 1e-5
"""Thickness (m) below which a piece is dropped: MuJoCo refuses it as a mesh."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ConvexPiece:
    """A convex polyhedron.

    Attributes:
        vertices: (n, 3), m, in the shape's frame; each is a corner.
        faces: (m, 3), counter-clockwise seen from outside.
    """

    vertices: FloatArray
    faces: IntArray


@dataclass(frozen=True, kw_only=True, eq=False)
class Pieces:
    """What covers a mesh.

    Attributes:
        pieces: The pieces.
        deviation: Largest distance (m) of their surface from the solid, measured.
    """

    pieces: tuple[ConvexPiece, ...]
    deviation: float


def convex_pieces(mesh: Mesh, *, tolerance: float = TOLERANCE) -> Pieces:
    """Pieces of a mesh, from the cache if they were made before.

    Args:
        mesh: The solid.
        tolerance: How far a piece may reach out of it, m.
    """
    key = f"{PIECES_VERSION}-{tolerance:g}-{mesh.digest}"
    stored = read_arrays("pieces", key)
    if stored is not None:
        return _from_arrays(stored)
    parts = _merged(_Guards(mesh, tolerance), _cut(mesh, _Guards(mesh, tolerance)))
    pieces = tuple(_piece(points) for points in parts)
    made = Pieces(pieces=pieces, deviation=_deviation(mesh, pieces))
    write_arrays("pieces", key, _to_arrays(made))
    return made
