"""Solids bounded by triangles: convex or not, of one body or several, with cavities.

Every query is on the true triangles. ``Mesh.field`` is the smooth distance for contact synthesis.
``surface_triangles`` and ``surface_points`` give any shape's surface as triangles and as evenly
spread points.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Self

import numpy as np

from planner.errors import ObjectError
from planner.shapes.base import ON_SURFACE, Shape, checked_points, unit
from planner.shapes.hulls import StablePose, convex_geometry, hull_of, stable_poses
from planner.shapes.meshes.triangles import (
    Polyhedron,
    checked_triangles,
    digest_of,
    pierced,
    winding_number,
)
from planner.spatial import FloatArray, IntArray
from planner.system.disk_cache import read_arrays, write_arrays
from planner.tolerances import EDGE_SPREAD

if TYPE_CHECKING:
    from scipy.spatial import ConvexHull

    from planner.shapes.distance_field import DistanceField
    from planner.shapes.meshes.nearest_triangle import BallTree, NearestTriangles


@dataclass(frozen=True, kw_only=True)
class MeshSource:
    """Where a mesh came from.

    Attributes:
        path: File.
        scale: Metres per unit of the file.
        repair: Whether mending was asked for, however much it changes.
    """

    path: Path
    scale: float = 1.0
    repair: bool = False


THIN = 0.006
"""Thickness (m) below which walls are thin: of half of the surface, straight through the body."""

CHORDS = 200
"""Surface points from which edges are looked for, and the thickness of narrow solids is measured
straight through the body. A wall is as thick as ``wall_thickness``; of a bar that is half its
width."""

NEAR_EDGE, NARROW_SHARE = 0.004, 0.4
"""Distance (m) from an edge at which a pad of 12 mm still rolls or creeps onto it, and the share of
the surface (-) that is as near on a narrow solid. It is 0.43 to 0.86 on 50 of 52 edged parts of 2
by 6 by 6 to 6 by 8 by 8 cm, and at most 0.34 on the meshes of the catalogue."""

OPPOSITE = -0.5
"""Cosine between opposite normals, at most: 120 degrees."""

PLANE_DIGITS = 9
"""Decimal digits to which planes of the hull are equal: a nanometre."""

EDGES_VERSION = 1
"""To be raised when the share of a surface near edges is found otherwise."""

HULL_VERSION = "v1"
"""Part of the key of hulls and stable poses in the cache; changes whenever the results do."""

STANDS = 1e-9
"""By how much (m, and entries of a rotation) stored poses may differ from those of this mesh."""


class Mesh(Shape):
    """A solid bounded by triangles; axes as in the file, origin at the centre of mass.

    Two meshes are equal if their vertices and faces are.

    Attributes:
        source: The file; None for a mesh that was made.
        mended: What was mended and how far that moved the surface; "" if it is as it was given.
    """

    kind: ClassVar[str] = "mesh"
    convex: ClassVar[bool] = False
    size_names: ClassVar[tuple[str, ...]] = ()
    source: MeshSource | None
    mended: str = ""

    def __init__(
        self,
        vertices: FloatArray,
        faces: IntArray,
        *,
        source: MeshSource | None = None,
        mended: str = "",
    ) -> None:
        """A mesh of triangles that are known to bound a solid; see ``from_triangles``.

        Args:
            vertices: (n, 3), m.
            faces: (m, 3).
            source: The file it is from.
            mended: What was mended, in words.

        Raises:
            ObjectError: Other shapes, or faces that are not indices of the vertices.
        """
        self._solid = Polyhedron.centred(vertices, faces)
        self.source = source
        self.mended = mended

    @property
    def vertices(self) -> FloatArray:
        """(n, 3), m; read-only."""
        return self._solid.vertices

    @property
    def faces(self) -> IntArray:
        """(m, 3), indices of vertices, counter-clockwise seen from outside; read-only."""
        return self._solid.faces

    @property
    def offset(self) -> FloatArray:
        """The centre of mass (3,) in the frame of the given vertices, m."""
        return self._solid.offset

    @classmethod
    def from_triangles(
        cls,
        vertices: FloatArray,
        faces: IntArray,
        *,
        name: str = "mesh",
        repair: bool = False,
        strict: bool = False,
    ) -> Mesh:
        """A mesh of triangles in m, checked, and mended where that changes nothing that matters.

        Args:
            vertices: (n, 3), m.
            faces: (m, 3), counter-clockwise seen from outside.
            name: What to call it in messages.
            repair: Whether to mend it however much that changes.
            strict: Whether to refuse what would have to be mended.

        Raises:
            ObjectError: The triangles do not bound a solid; says what is wrong, where, what to do.
        """
        from planner.shapes.meshes.mending import check_solid

        v, f = checked_triangles(name, vertices, faces)
        mending = check_solid(name, v, f, repair=repair, strict=strict)
        if mending is None:
            return Mesh(v, f)
        return Mesh(mending.vertices, mending.faces, mended=mending.sentence)

    @classmethod
    def load(
        cls, path: Path | str, *, scale: float = 1.0, repair: bool = False, strict: bool = False
    ) -> Mesh:
        """A mesh from a GLB, OBJ, PLY or STL file.

        One that does not quite bound a solid is mended where that changes nothing that matters
        (``planner.shapes.meshes.mending``); ``mended`` says what was done and how far the surface
        moved. What is planned and verified is the mended surface.

        Args:
            path: The file.
            scale: Metres per unit of the file: 0.001 for millimetres.
            repair: Whether to mend it however much that changes.
            strict: Whether to refuse what would have to be mended.

        Raises:
            ObjectError: The file cannot be read, or bounds no solid; says what is wrong and what
                to do.
        """
        from planner.shapes.meshes.io import read_mesh
        from planner.shapes.meshes.mending import check_solid, checked_once

        file = Path(path)
        vertices, faces = read_mesh(file, scale)
        source = MeshSource(path=file.resolve(), scale=scale, repair=repair)
        if repair or strict:
            mending = check_solid(file.name, vertices, faces, repair=repair, strict=strict)
        else:
            mending = checked_once(file.name, vertices, faces)
        if mending is None:
            return Mesh(vertices, faces, source=source)
        return Mesh(mending.vertices, mending.faces, source=source, mended=mending.sentence)

    @classmethod
    def from_sizes(cls, sizes: Sequence[float]) -> Self:
        """Refused: a mesh of a file is named by its path."""
        raise ObjectError("a mesh has no sizes; give the path of a GLB, OBJ, PLY or STL file")

    @property
    def sizes(self) -> tuple[float, ...]:
        """Empty: triangles determine a mesh."""
        return ()

    @property
    def spec(self) -> str:
        """The path, with the scale where it is not 1: "mug.stl*0.001"; "mesh" without a file."""
        if self.source is None:
            return self.kind
        scale = "" if self.source.scale == 1 else f"*{self.source.scale!r}"
        return f"{self.source.path}{scale}"

    @cached_property
    def digest(self) -> str:
        """SHA-256 of vertices and faces, as hexadecimal."""
        return digest_of(self.vertices, self.faces)

    def __eq__(self, other: object) -> bool:
        """Equal triangles."""
        return isinstance(other, Mesh) and self.digest == other.digest

    def __hash__(self) -> int:
        """Of the triangles."""
        return hash(self.digest)

    @cached_property
    def bounds(self) -> tuple[FloatArray, FloatArray]:
        """Lower and upper corner (3,) of the bounding box, m."""
        return self.vertices.min(axis=0), self.vertices.max(axis=0)

    @cached_property
    def half_extents(self) -> FloatArray:
        """Largest |coordinate| along each axis, (3,), m: the box need not be even about the centre.

        Half the extents of the bounding box itself follow from ``bounds``.
        """
        reach: FloatArray = np.abs(self.vertices).max(axis=0)
        return reach

    @cached_property
    def bounding_radius(self) -> float:
        """Distance of the farthest vertex from the centre of mass, m."""
        return float(np.linalg.norm(self.vertices, axis=1).max())

    @property
    def volume(self) -> float:
        """By the divergence theorem, exact for the polyhedron, m3."""
        return self._solid.volume

    @property
    def wall_thickness(self) -> float:
        """Twice the volume by the area, m: on an object of thin walls, how thick they are."""
        return 2 * self.volume / float(self._surface.areas.sum())

    @cached_property
    def narrow(self) -> bool:
        """Whether much of its surface is near an edge: faces hardly wider than pads.

        The share is kept on disk: finding it needs a tree of points, and SciPy, which loads slowly.
        """
        key = f"{EDGES_VERSION}-{self.digest}"
        share = (read_arrays("edges", key) or {}).get("share")
        if share is None or share.shape != () or not 0.0 <= float(share) <= 1.0:
            points, normals = self.surface_samples(CHORDS, np.random.default_rng(0))
            spread = self.normal_dispersion(points, NEAR_EDGE, facing=normals)
            share = np.array(float((spread > EDGE_SPREAD).mean()))
            write_arrays("edges", key, {"share": share})
        return float(share) > NARROW_SHARE

    @cached_property
    def thin_walled(self) -> bool:
        """Whether it is made of walls thinner than ``THIN``; a bar of 10 mm is none."""
        if self.wall_thickness >= THIN or not self.narrow:
            return self.wall_thickness < THIN
        points, normals = self.surface_samples(CHORDS, np.random.default_rng(0))
        ray, depth, _ = self.pierced(points, -normals)
        first = np.flatnonzero(np.diff(ray, prepend=-1))
        return bool(np.median(depth[first]) < THIN)

    def inertia(self, mass: float) -> FloatArray:
        """By the divergence theorem, exact for the polyhedron; (3, 3), kg m2."""
        second = self._solid.second_moments
        inertia: FloatArray = np.trace(second) * np.eye(3) - second
        return mass / self.volume * inertia

    @cached_property
    def _surface(self) -> NearestTriangles:
        from planner.shapes.meshes.nearest_triangle import NearestTriangles  # here: few are meshes

        return NearestTriangles(self.vertices, self.faces)

    @property
    def ball_tree(self) -> BallTree:
        """Balls around ever fewer triangles."""
        return self._surface.ball_tree

    @cached_property
    def _hull(self) -> ConvexHull:
        from planner.system.scipy_parts import ConvexHull  # here: SciPy loads slowly

        return ConvexHull(self.vertices)

    @cached_property
    def _kept_hull(self) -> tuple[FloatArray, FloatArray]:
        """Vertices and planes of the convex hull, kept on disk: of a scan Qhull takes a second."""
        key = f"{HULL_VERSION}-{self.digest}"
        stored = read_arrays("hull", key)
        if stored is not None and self._is_hull(stored):
            return self.vertices[stored["corners"].astype(np.int64)], stored["planes"]
        planes = np.unique(np.round(self._hull.equations, PLANE_DIGITS), axis=0)
        planes[:, 3] -= 10.0**-PLANE_DIGITS  # rounding leaves nothing of the hull outside
        write_arrays("hull", key, {"corners": self._hull.vertices, "planes": planes})
        return self.vertices[self._hull.vertices], planes

    def _is_hull(self, stored: dict[str, FloatArray]) -> bool:
        """Whether stored corners and planes are of a hull that reaches as far as this mesh."""
        corners, planes = stored.get("corners"), stored.get("planes")
        if corners is None or planes is None or corners.dtype.kind not in "iu":
            return False
        if corners.ndim != 1 or planes.ndim != 2 or planes.shape[1:] != (4,) or len(corners) < 4:
            return False
        if corners.min() < 0 or corners.max() >= len(self.vertices):
            return False
        points = self.vertices[corners]
        lower, upper = self.bounds
        return bool((points.min(axis=0) == lower).all() and (points.max(axis=0) == upper).all())

    @cached_property
    def hull_vertices(self) -> FloatArray:
        """Vertices (k, 3) of the convex hull, m, read-only."""
        points = self._kept_hull[0]
        points.flags.writeable = False
        return points

    @property
    def hull_planes(self) -> FloatArray:
        """Planes (k, 4) of the convex hull: unit normal out of it and d, n . x + d <= 0 inside, m.

        Triangles of one plane share it.
        """
        return self._kept_hull[1]

    def coal_geometry(self) -> Any:
        """``coal.BVHModelOBBRSS``: a triangle soup without an inside."""
        return self._surface.tree

    @cached_property
    def coal_hull(self) -> Any:
        """The convex hull as a ``coal.Convex``: to a micrometre, see ``planner.shapes.hulls``."""
        return convex_geometry(self.hull_vertices)

    def mujoco_geom(self) -> tuple[str, tuple[float, ...]]:
        """None fits: see ``planner.shapes.solid``."""
        raise ObjectError("a mesh is no single MuJoCo geom; use planner.shapes.solid.solid_geoms")

    def closest_point(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """See ``Shape``; on the surface, the normal of the face, edge or vertex."""
        p = checked_points(points)
        if len(p) == 0:
            return p.copy(), p.copy()
        surface, _, feature = self._surface.nearest(p)
        feature = unit(feature)
        gap = p - surface
        distance = np.linalg.norm(gap, axis=1, keepdims=True)
        side = np.where(np.einsum("nd,nd->n", gap, feature) < 0, -1.0, 1.0)
        away = distance[:, 0] > ON_SURFACE
        normals = feature
        normals[away] = (side[:, None] * gap / np.where(distance > 0, distance, 1.0))[away]
        return surface, normals

    def winding_number(self, points: FloatArray) -> FloatArray:
        """How often the surface surrounds each point (n,): 1 inside, 0 outside; exact, but slow.

        The second witness of the sign of ``signed_distance``.

        Args:
            points: (n, 3), m, not on the surface.
        """
        return winding_number(checked_points(points), self._surface.corners)

    def support(self, direction: FloatArray) -> float:
        """Of the farthest vertex, m."""
        return float((self.hull_vertices @ direction).max())

    def normal_dispersion(
        self, points: FloatArray, radius: float, *, facing: FloatArray | None = None
    ) -> FloatArray:
        """How much the outward normals around surface points differ (n,), rad, weighted by area.

        arccos |sum a n| / sum a over the triangles within a ball: 0 on a flat face, 45 degrees on a
        right-angled edge, small where a scan is merely rough.

        Args:
            points: (n, 3), m, on the surface.
            radius: Of the balls, m.
            facing: Outward normals (n, 3) at the points. What looks the other way, by 120 degrees
                or more, is then the far side of a wall and does not count.
        """
        owner, near = self._surface.within(points, radius)
        if facing is not None:
            same = np.einsum("kd,kd->k", self._surface.normals[near], facing[owner]) > OPPOSITE
            owner, near = owner[same], near[same]
        areas = self._surface.areas[near]
        whole = np.bincount(owner, areas, len(points))
        weighted = (areas[:, None] * self._surface.normals[near]).T
        sums = np.array([np.bincount(owner, part, len(points)) for part in weighted])
        share = np.linalg.norm(sums, axis=0) / np.where(whole > 0.0, whole, 1.0)
        return np.where(whole > 0.0, np.arccos(np.clip(share, -1.0, 1.0)), 0.0)

    def surface_samples(self, n: int, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
        """Points (n, 3), m, uniform by area, and outward unit normals (n, 3) of their faces."""
        areas = self._surface.areas
        triangle = rng.choice(len(areas), size=n, p=areas / areas.sum())
        u, v = rng.random((2, n, 1))
        over = u + v > 1
        u, v = np.where(over, 1 - u, u), np.where(over, 1 - v, v)
        a, b, c = (self._surface.corners[triangle, k] for k in range(3))
        return a + u * (b - a) + v * (c - a), self._surface.normals[triangle]

    def pierced(
        self, starts: FloatArray, directions: FloatArray, *, least: float = 1e-6
    ) -> tuple[IntArray, FloatArray, FloatArray]:
        """Where rays pass through the surface, sorted by ray, then by depth.

        Args:
            starts: Where rays begin (n, 3), m.
            directions: Unit vectors (n, 3).
            least: Depth (m) from which on they are looked at: they may begin on the surface.

        Returns:
            Number of the ray (k,), depth (k,), m, and outward normal there (k, 3).
        """
        corners, length = self._surface.corners, 2 * self.bounding_radius
        ray, depth, triangle = pierced(
            self._surface.tree, corners, starts, directions, length, least=least
        )
        return ray, depth, self._surface.normals[triangle]

    def field(self, *, fine: bool = False) -> DistanceField:
        """The smooth distance: prepared once, kept in memory and on disk.

        Args:
            fine: Whether it must be right on thin walls too, as far as memory allows. Else it is
                right at some distance from them only: see ``planner.synthesis.mesh_surface``.
        """
        return self._fine_field if fine else self._field

    @cached_property
    def _fine_field(self) -> DistanceField:
        return self._kept_field("", self.wall_thickness)

    @cached_property
    def _field(self) -> DistanceField:
        return self._kept_field("-coarse", np.inf) if self.thin_walled else self._fine_field

    def _kept_field(self, name: str, wall: float) -> DistanceField:
        # here, as only grasps on meshes need a field
        from planner.shapes.distance_field import FIELD_VERSION, DistanceField

        key = f"{FIELD_VERSION}-{self.digest}{name}"
        stored = read_arrays("field", key)
        if stored is not None:
            try:
                known = DistanceField.from_arrays(stored)
                if known.fits(self, self.vertices):
                    return known
            except (KeyError, ValueError, IndexError, TypeError):  # TypeError: rows for numbers
                pass  # of another form: made anew
        from planner.shapes.mesh_field import fit_mesh_field  # here: most fields are kept

        field = fit_mesh_field(self._surface, self.wall_thickness, wall=wall)
        write_arrays("field", key, field.to_arrays())
        return field

    @cached_property
    def _resting_poses(self) -> tuple[StablePose, ...]:
        key = f"{HULL_VERSION}-{self.digest}"
        stored = read_arrays("poses", key)
        if stored is not None and self._are_poses(stored.get("poses")):
            return tuple(
                StablePose(
                    rotation=row[:9].reshape(3, 3),
                    height=float(row[9]),
                    margin_deg=float(row[10]),
                    probability=float(row[11]),
                )
                for row in stored["poses"]
            )
        hull = self._hull
        of_all = np.array_equal(hull.vertices, np.arange(len(self.vertices)))
        poses = stable_poses(self.hull_vertices, hull if of_all else None)
        rows = [[*p.rotation.ravel(), p.height, p.margin_deg, p.probability] for p in poses]
        write_arrays("poses", key, {"poses": np.array(rows)})
        return poses

    def _are_poses(self, rows: FloatArray | None) -> bool:
        """Whether stored rows are rotations with the heights that this mesh has in them."""
        if rows is None or rows.dtype != np.float64 or rows.ndim != 2 or rows.shape[1] != 12:
            return False
        turns = rows[:, :9].reshape(-1, 3, 3)
        square = np.abs(turns @ turns.transpose(0, 2, 1) - np.eye(3)).max(initial=0.0) < STANDS
        heights = -(turns[:, 2] @ self.hull_vertices.T).min(axis=1)
        return bool(len(rows) and square and (np.abs(heights - rows[:, 9]) < STANDS).all())

    def resting_poses(self) -> tuple[StablePose, ...]:
        """Stable poses on a horizontal table, the one that can be tilted farthest first.

        Of vessels that their sizes determine the upright one is first.
        """
        return self._resting_poses

    @property
    def resting_rotation(self) -> FloatArray:
        """Of the first stable pose."""
        return self.resting_poses()[0].rotation


FINENESS = 4
"""Subdivisions of the icosahedron in whose directions a convex shape is seen: 2562, 4 degrees
apart, so that chords of a sphere lie within 0.1 % of its radius."""

FAR = 100.0
"""From how far away (bounding radii) it is seen."""


def surface_triangles(shape: Shape) -> tuple[FloatArray, IntArray]:
    """Vertices (n, 3), m, and faces (m, 3), counter-clockwise from outside, of a shape.

    A mesh has its own. The other kinds are convex: the hull of the points nearest to far points all
    around, which are on the true surface.

    Raises:
        ObjectError: It is smaller than rounding.
    """
    import trimesh  # here, since trimesh loads slowly

    if isinstance(shape, Mesh):
        return shape.vertices, shape.faces
    directions = np.asarray(trimesh.creation.icosphere(subdivisions=FINENESS).vertices)
    points, _ = shape.closest_point(FAR * shape.bounding_radius * directions)
    hull = hull_of(points)
    if hull is None:
        raise ObjectError(f"{shape.spec} is too small to have a surface of triangles; enlarge it")
    return hull.points, hull.faces


@lru_cache(maxsize=64)
def surface_points(shape: Shape, n: int) -> FloatArray:
    """Points (n, 3), m, spread evenly by area over a shape's surface; always the same."""
    vertices, faces = surface_triangles(shape)
    corners = vertices[faces]
    sides = corners[:, 1:] - corners[:, :1]
    areas = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1)
    rng = np.random.default_rng(0)
    ends = np.cumsum(areas)
    # one in each of n equal shares of the area
    chosen = np.searchsorted(ends, (np.arange(n) + rng.random(n)) / n * ends[-1], side="right")
    chosen = np.minimum(chosen, len(faces) - 1)
    u, v = np.sqrt(rng.random(n)), rng.random(n)
    weights = np.column_stack([1.0 - u, u * (1.0 - v), u * v])
    points: FloatArray = np.einsum("nk,nkd->nd", weights, corners[chosen])
    return points
