"""Exact geometry of triangles, and fewer of them to be looked at.

Single triangles are vectorised over pairs or points, in m, and know nothing of meshes and their
topology. ``Polyhedron`` is a solid of them as bare arrays. Rays find walls of any thickness, unlike
a march through the smooth distance: coal's tree finds the triangles, closed form measures.

Fewer triangles, to be looked at: vertices in one cell of a grid become one.
"""

from __future__ import annotations

from dataclasses import dataclass
from hashlib import sha256
from typing import Any, Self

import coal
import numpy as np
from numpy.typing import NDArray

from planner.arrays import float_array
from planner.errors import ObjectError
from planner.spatial import FloatArray, IntArray

FACE = 6
"""Feature of a nearest point in the face; 0, 1, 2 are corners, 3 + k the edge from corner k."""

CHUNK = 1_000_000
"""Pairs of point and triangle that are held in memory at once: some 300 MB."""


def nearest_on_triangles(points: FloatArray, corners: FloatArray) -> tuple[FloatArray, IntArray]:
    """The point of each triangle that is nearest to each point.

    Args:
        points: (n, 3), m.
        corners: (n, 3 corners, 3), m; a triangle may be degenerate.

    Returns:
        Nearest points (n, 3), m, and the features (n,) that they are on, see ``FACE``.
    """
    edges = corners[:, _NEXT] - corners  # (n, 3 edges, 3)
    to_point = points[:, None] - corners
    squares = np.einsum("nkd,nkd->nk", edges, edges)
    along = np.einsum("nkd,nkd->nk", to_point, edges)
    t = np.minimum(np.maximum(along / np.where(squares > 0, squares, 1.0), 0.0), 1.0)
    on_edges = corners + t[:, :, None] * edges
    gaps = points[:, None] - on_edges
    row = np.arange(len(points))
    edge = np.argmin(np.einsum("nkd,nkd->nk", gaps, gaps), axis=1)
    nearest, share = on_edges[row, edge], t[row, edge]
    feature = np.where(share <= 0, edge, np.where(share >= 1, (edge + 1) % 3, edge + 3))
    normal = _cross(edges[:, 0], edges[:, 1])
    area = np.einsum("nd,nd->n", normal, normal)
    # over the face: on the inner side of all three edges
    inner = np.einsum("nkd,nkd->nk", _cross(normal[:, None], edges), to_point)
    over = (inner > 0).all(axis=1) & (area > 0)
    height = np.einsum("nd,nd->n", to_point[:, 0], normal) / np.where(area > 0, area, 1.0)
    nearest[over] = (points - height[:, None] * normal)[over]
    feature[over] = FACE
    return nearest, feature.astype(np.int64)


_NEXT = [1, 2, 0]
"""The corner after each."""


def _cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """``np.cross`` of (..., 3) and (..., 3), a quarter of its time for few vectors."""
    return a[..., [1, 2, 0]] * b[..., [2, 0, 1]] - a[..., [2, 0, 1]] * b[..., [1, 2, 0]]


def winding_number(points: FloatArray, corners: FloatArray) -> FloatArray:
    """How often the triangles surround each point (n,): 1 inside, 0 outside of a closed solid.

    The sum of the signed solid angles, each exact (Van Oosterom and Strackee, "The solid angle of a
    plane triangle", 1983), divided by 4 pi. Not defined on the surface itself.

    Args:
        points: (n, 3), m.
        corners: (m, 3 corners, 3), m, wound counter-clockwise seen from outside.
    """
    out = np.zeros(len(points))
    step = max(1, CHUNK // max(1, len(corners)))
    for start in range(0, len(points), step):
        part = slice(start, start + step)
        seen = solid_angles(corners[None] - points[part, None, None])
        out[part] = seen.sum(axis=1) / (4 * np.pi)
    return out


def solid_angles(corners: FloatArray) -> FloatArray:
    """Signed solid angles (...), sr, of triangles (..., 3 corners, 3), m, seen from the origin.

    Positive where they run clockwise as seen: from inside of an outward surface.
    """
    a, b, c = (corners[..., k, :] for k in range(3))
    la, lb, lc = (np.sqrt(np.einsum("...d,...d->...", v, v)) for v in (a, b, c))
    above = np.einsum("...d,...d->...", a, np.cross(b, c))
    below = la * lb * lc
    for u, v, w in ((a, b, lc), (b, c, la), (c, a, lb)):
        below += np.einsum("...d,...d->...", u, v) * w
    angles: FloatArray = 2 * np.arctan2(above, below)
    return angles


def crossings(starts: FloatArray, ends: FloatArray, corners: FloatArray) -> NDArray[np.bool_]:
    """Whether each segment passes through the inside of its triangle, (n,) bool.

    A segment that only touches the rim, or lies in the plane, does not.

    Args:
        starts: (n, 3), m.
        ends: (n, 3), m.
        corners: (n, 3 corners, 3), m.
    """
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    normal = normal / np.where(length > 0, length, 1.0)
    h0 = np.einsum("nd,nd->n", starts - corners[:, 0], normal)
    h1 = np.einsum("nd,nd->n", ends - corners[:, 0], normal)
    through: NDArray[np.bool_] = (h0 * h1 < 0) & (np.minimum(np.abs(h0), np.abs(h1)) > TOUCHING)
    share = h0 / np.where(through, h0 - h1, 1.0)
    hit = starts + share[:, None] * (ends - starts)
    for k in range(3):
        edge = corners[:, (k + 1) % 3] - corners[:, k]
        size = np.linalg.norm(edge, axis=1)
        inward = np.einsum("nd,nd->n", np.cross(normal, edge), hit - corners[:, k])
        through &= inward > TOUCHING * size
    return through


TOUCHING = 1e-9
"""Depth (m) up to which triangles that meet count as touching, not as crossing: rounding."""


def cover(corners: FloatArray, step: float) -> tuple[FloatArray, IntArray]:
    """Points on triangles such that no point of a triangle is farther than ``COVERED`` steps away.

    Rows run along the longest edge; a needle takes as many points as its length needs, no more.

    Args:
        corners: (n, 3 corners, 3), m.
        step: Spacing of the points, m.

    Returns:
        Points (m, 3), m, and the triangle (m,) that each is on; at least one each.
    """
    edges = np.roll(corners, -1, axis=1) - corners
    longest = np.argmax(np.einsum("nkd,nkd->nk", edges, edges), axis=1)
    row = np.arange(len(corners))
    origin, base = corners[row, longest], edges[row, longest]
    apex = corners[row, (longest + 2) % 3] - origin
    length = np.linalg.norm(base, axis=1)
    along = base / np.where(length > 0, length, 1.0)[:, None]
    foot = np.einsum("nd,nd->n", apex, along)  # where the apex is along the longest edge
    up = apex - foot[:, None] * along
    height = np.linalg.norm(up, axis=1)
    up = up / np.where(height > 0, height, 1.0)[:, None]
    n_rows = np.maximum(1, np.ceil(height / step)).astype(np.int64)
    owner = np.repeat(row, n_rows)
    j = _counting(n_rows)
    # each row takes the width of its lower rim, so that nothing beside the upper one is missed
    share = j / n_rows[owner]
    low, high = share * foot[owner], length[owner] - share * (length - foot)[owner]
    n_points = np.maximum(1, np.ceil((high - low) / step)).astype(np.int64)
    line = np.repeat(np.arange(len(owner)), n_points)
    owner = owner[line]
    x = low[line] + (_counting(n_points) + 0.5) / n_points[line] * (high - low)[line]
    before = x <= foot[owner]
    run = np.where(before, foot[owner], length[owner] - foot[owner])
    rise = np.where(before, x, length[owner] - x) / np.where(run > 0, run, 1.0)
    top = np.where(run > 0, rise, 1.0) * height[owner]
    y = np.minimum((j + 0.5)[line] / n_rows[owner] * height[owner], top)
    return origin[owner] + x[:, None] * along[owner] + y[:, None] * up[owner], owner


COVERED = 1.12
"""Half a step along a row and a whole one across, in steps: sqrt(0.25 + 1)."""


def _counting(counts: IntArray) -> IntArray:
    """0, 1, .. count - 1 for each of the counts, one after the other."""
    ends = np.cumsum(counts)
    out: IntArray = np.arange(int(ends[-1])) - np.repeat(ends - counts, counts)
    return out


@dataclass(frozen=True, kw_only=True, eq=False)
class Polyhedron:
    """A solid bounded by triangles, with its centre of mass at the origin.

    Attributes:
        vertices: (n, 3), m; read-only.
        faces: (m, 3), indices of vertices, counter-clockwise seen from outside; read-only.
        offset: The centre of mass (3,) where it was before, m.
        volume: m3.
        second_moments: (3, 3) about the centre of mass, m5.
    """

    vertices: FloatArray
    faces: IntArray
    offset: FloatArray
    volume: float
    second_moments: FloatArray

    @classmethod
    def centred(cls, vertices: FloatArray, faces: IntArray) -> Self:
        """From vertices (n, 3), m, about any origin, and faces (m, 3) that bound a solid.

        Raises:
            ObjectError: See ``checked_triangles``.
        """
        points, triangles = checked_triangles("mesh", vertices, faces)
        v, f = np.array(points), np.array(triangles)
        volume, center, second = moments(v[f])
        v -= center
        v.setflags(write=False)
        f.setflags(write=False)
        second -= volume * np.outer(center, center)
        return cls(vertices=v, faces=f, offset=center, volume=volume, second_moments=second)


def moments(corners: FloatArray) -> tuple[float, FloatArray, FloatArray]:
    """Volume (m3), centroid (3,) and second moments (3, 3), m5, about the origin.

    Each triangle spans a tetrahedron with the origin, of determinant D: volume D/6, first moments
    D/24 (a + b + c), second moments D/120 (a a' + b b' + c c' + s s') with s = a + b + c (Tonon,
    "Explicit exact formulas for the 3-D tetrahedron inertia tensor", 2004).
    """
    a, b, c = (corners[:, k] for k in range(3))
    d = np.einsum("nd,nd->n", a, np.cross(b, c))
    total = a + b + c
    volume = float(d.sum() / 6)
    center = np.einsum("n,nd->d", d, total) / 24 / volume
    second = sum(np.einsum("n,ni,nj->ij", d, v, v) for v in (a, b, c, total)) / 120
    return volume, center, np.asarray(second)


def digest_of(vertices: FloatArray, faces: IntArray) -> str:
    """SHA-256 of vertices (n, 3) and faces (m, 3), as hexadecimal; the same on every machine."""
    content = sha256(np.ascontiguousarray(vertices, dtype="<f8").tobytes())
    content.update(np.ascontiguousarray(faces, dtype="<i8").tobytes())
    return content.hexdigest()


def checked_triangles(
    name: str, vertices: FloatArray, faces: IntArray
) -> tuple[FloatArray, IntArray]:
    """Vertices (n, 3), m, as float64 and faces (m, 3) as int64.

    Raises:
        ObjectError: Other shapes, NaN or infinity, no faces, or faces of vertices that are not
            there.
    """
    v = float_array(f"{name}: vertices", vertices, error=ObjectError)
    try:
        f = np.asarray(faces)
        if isinstance(faces, np.ma.MaskedArray) and faces.mask.any():
            raise ValueError("some of it is masked")
    except ValueError as fault:  # rows of different lengths
        raise ObjectError(f"{name}: faces are no array ({fault}); give integers (m, 3)") from fault
    if v.ndim != 2 or v.shape[1:] != (3,) or not np.isfinite(v).all():
        raise ObjectError(f"{name}: vertices have shape {v.shape}; give finite (n, 3), in m")
    if f.ndim != 2 or f.shape[1:] != (3,) or not np.issubdtype(f.dtype, np.integer) or len(f) == 0:
        raise ObjectError(f"{name}: faces are {f.dtype} of shape {f.shape}; give integers (m, 3)")
    if f.min() < 0 or f.max() >= len(v):
        raise ObjectError(
            f"{name}: faces name vertex {f.min()} to {f.max()}, but there are 0 to {len(v) - 1}"
        )
    return v, f.astype(np.int64)


NEEDLE = 1e-7
"""Radius (m) of the capsule by which coal looks for triangles."""

MOST = 1000
"""Most triangles on a line that coal tells."""


def pierced(
    tree: Any,
    corners: FloatArray,
    starts: FloatArray,
    directions: FloatArray,
    length: float,
    *,
    least: float,
) -> tuple[IntArray, FloatArray, IntArray]:
    """Triangles that rays pass through: number of the ray, depth (m), triangle; (k,) each.

    Sorted by ray, then by depth. A ray through an edge meets one of its triangles, both, or by
    rounding none.

    Args:
        tree: The triangles as a coal geometry (``coal_tree``).
        corners: The same (m, 3 corners, 3), m.
        starts: Where rays begin (n, 3), m.
        directions: Unit vectors (n, 3).
        length: Of the rays, m.
        least: Depth (m) from which on they are looked at: they may begin on the surface.
    """
    rays, triangles = _near(tree, starts, directions, length)
    a, b, c = (corners[triangles, k] for k in range(3))
    along, origin = directions[rays], starts[rays]
    # Moeller and Trumbore, "Fast, minimum storage ray/triangle intersection", 1997
    across = np.cross(along, c - a)
    volume = np.einsum("kd,kd->k", b - a, across)
    inverse = 1.0 / np.where(volume != 0.0, volume, np.inf)
    to_start = origin - a
    u = np.einsum("kd,kd->k", to_start, across) * inverse
    turned = np.cross(to_start, b - a)
    v = np.einsum("kd,kd->k", along, turned) * inverse
    depth = np.einsum("kd,kd->k", c - a, turned) * inverse
    met = (volume != 0.0) & (u >= 0.0) & (v >= 0.0) & (u + v <= 1.0)
    met &= (depth >= least) & (depth <= length)
    rays, triangles, depth = rays[met], triangles[met], depth[met]
    order = np.lexsort((triangles, depth, rays))
    return rays[order], depth[order], triangles[order]


def _near(
    tree: Any, starts: FloatArray, directions: FloatArray, length: float
) -> tuple[IntArray, IntArray]:
    """Pairs of ray and triangle (k,) that a thin capsule along the ray touches."""
    request, result = coal.CollisionRequest(), coal.CollisionResult()
    request.num_max_contacts = MOST
    needle, here, pose = (
        coal.Capsule(NEEDLE, length),
        coal.Transform3s.Identity(),
        coal.Transform3s(),
    )
    rotations = _along_z(directions)
    rays, triangles = [], []
    for i, middle in enumerate(starts + length / 2 * directions):
        pose.setRotation(rotations[i])
        pose.setTranslation(middle)
        result.clear()
        coal.collide(tree, here, needle, pose, request, result)
        found = [result.getContact(k).b1 for k in range(result.numContacts())]
        rays += [i] * len(found)
        triangles += found
    return np.array(rays, dtype=np.int64), np.array(triangles, dtype=np.int64)


def _along_z(directions: FloatArray) -> FloatArray:
    """Rotations (n, 3, 3) whose third columns are unit vectors (n, 3)."""
    aside = np.eye(3)[np.argmin(np.abs(directions), axis=1)]
    x = np.cross(aside, directions)
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    return np.stack([x, np.cross(directions, x), directions], axis=2)


ROUNDS = 8
"""Sizes of cells that are tried at most."""

ENOUGH = 0.85
"""Share of the allowed triangles that ends the search (-)."""

CELLS = 1 << 20
"""Cells along the longest side at most; three numbers of a cell fit into 63 bits."""


def simplified(
    vertices: FloatArray, triangles: IntArray, most: int
) -> tuple[FloatArray, IntArray, bool]:
    """A mesh of at most ``most`` triangles, and whether it is another one than was given.

    Args:
        vertices: (n, 3), m.
        triangles: (k, 3), numbers of vertices.
        most: Largest number of triangles.
    """
    if len(triangles) <= most:
        return vertices, triangles, False
    low, size = vertices.min(axis=0), float(np.ptp(vertices, axis=0).max())
    # a surface of this area has about one vertex and two triangles per cell
    cell = float(np.sqrt(2.0 * _area(vertices, triangles) / most))
    finest, best = size / CELLS, None
    too_fine = 0.0
    for _ in range(ROUNDS):
        cell = max(cell, finest)
        kept, number = _cells(vertices, triangles, low, cell)
        if len(kept) <= most:
            best = (kept, number)
            if len(kept) >= ENOUGH * most:
                break
        else:
            too_fine = max(too_fine, cell)
        step = np.sqrt(max(len(kept), 1) / (0.95 * most))
        cell = max(cell * step, 1.02 * too_fine)
    if best is None:
        best = _cells(vertices, triangles, low, size)
    kept, number = best
    return _means(vertices, number), kept, True


def clustered(
    vertices: FloatArray, triangles: IntArray, low: FloatArray, cell: float
) -> tuple[FloatArray, IntArray]:
    """Each cell's vertices become their mean; triangles without area and doubles go.

    Args:
        vertices: (n, 3), m.
        triangles: (k, 3), numbers of vertices.
        low: Corner (3,) of the grid, below all vertices, m.
        cell: Edge of a cell, m.
    """
    kept, number = _cells(vertices, triangles, low, cell)
    return _means(vertices, number), kept


def _means(vertices: FloatArray, number: IntArray) -> FloatArray:
    """Mean (c, 3) of the vertices of each cell."""
    sums = np.column_stack([np.bincount(number, vertices[:, k]) for k in range(3)])
    return np.asarray(sums / np.bincount(number)[:, None])


def _area(vertices: FloatArray, triangles: IntArray) -> float:
    a, b, c = (vertices[triangles[:, k]] for k in range(3))
    return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum()) / 2


def _cells(
    vertices: FloatArray, triangles: IntArray, low: FloatArray, cell: float
) -> tuple[IntArray, IntArray]:
    """Triangles (m, 3) between cells, no two alike, and the number of each vertex's cell (n,)."""
    at = np.floor((vertices - low) / cell).astype(np.int64)
    _, number = np.unique((at[:, 0] << 42) + (at[:, 1] << 21) + at[:, 2], return_inverse=True)
    new = number[triangles]
    new = new[(new[:, 0] != new[:, 1]) & (new[:, 1] != new[:, 2]) & (new[:, 2] != new[:, 0])]
    corners, n = np.sort(new, axis=1), int(number.max()) + 1
    _, first = np.unique((corners[:, 0] * n + corners[:, 1]) * n + corners[:, 2], return_index=True)
    return np.asarray(new[np.sort(first)], dtype=np.int64), number
