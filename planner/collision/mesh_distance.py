"""Signed distance of a convex geometry and a closed triangle mesh: coal, an inside, and a depth.

coal measures to the triangles and knows no inside: a body wholly inside a mesh is apart from every
triangle. Two bodies whose surfaces do not meet are apart, or one contains the other; a point of the
convex body tells which. Where surfaces cross, or the body is inside, its depth is the length of the
way out. Of a ball that is the signed distance of its centre less its radius, exactly, except where
it is in two surfaces at a time.

coal's depth in a triangle mesh is that of single triangles, which have no inside: of a ball of
6.5 mm that is 1 mm deep in a ball of 1280 triangles it says 0.4 mm. Apart, its distances are
exact. So the geometry is moved out of the mesh, and what is measured is the way.

**Depth** is the length of the shortest translation, among those that are tried, after which
geometry and solid share no point. It is thus an upper bound of the penetration depth (the least
translation in any direction): never too shallow but for ``TOLERANCE``. And no point of either is
farther inside the other than that. Directions are tried as in a descent: first normals of the
surface nearby, then the normal at which the geometry left the mesh, until the way gets no shorter.
The shortest way across a face may be longer than one across its edge, so the surface next to the
geometry's farthest point within the mesh is tried too. In a concave corner, one way out leads into
the next surface; the least translation across the planes of both is tried then.
``tests/test_depths.py`` measures how much longer it is than the least translation of all.

Along one direction, the end of the way is found from outside. A step towards the mesh by no more
than the distance passes through nothing. Newton's step, the distance by its slope, is tried first:
the distance of convex bodies is a convex function of a translation.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import coal
import numpy as np
from numpy.typing import NDArray

from planner.shapes.convex_pairs import Proximity
from planner.spatial import SE3, FloatArray

TOLERANCE = 2e-6
"""Distance (m) at which a geometry counts as having just left: twice coal's accuracy."""

TURNS = 5
"""Most directions that are tried from one start."""

STEPS = 16
"""Most queries along one direction on the way back to the surface."""

GROWTH = 2.0
"""Factor by which a way is lengthened that has not yet led out."""

SHORTEST = 2e-4
"""First way (m) that is tried where the surface seems to be nearer."""

FLATTEST = 0.1
"""Least slope (-) of the distance along a direction that Newton's step trusts."""

ALIGNED = 1e-3
"""One less the cosine between direction and normal up to which turning is not worth it: it gains
about that share of the way."""

GAIN = 5e-7
"""What a direction may gain (m) at most for not being tried."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Moved:
    """How geometry and mesh lie after a translation of the geometry.

    Attributes:
        distance: Signed distance, m, right if they are apart; not above 0 where they share a point.
        normal: Unit vector (3,) out of the mesh, where they are nearest or of a place they share.
        on_mesh: The mesh's point (3,) there, m.
    """

    distance: float
    normal: FloatArray
    on_mesh: FloatArray


@dataclass(frozen=True, kw_only=True, eq=False)
class Start:
    """A direction to begin with.

    Attributes:
        along: Unit vector (3,).
        likely: A way (m) that probably leads out.
        certain: A way (m) that leads out for certain.
    """

    along: FloatArray
    likely: float
    certain: float


@dataclass(frozen=True, kw_only=True, eq=False)
class Exit:
    """How a geometry leaves a mesh.

    Attributes:
        way: Length of the translation, m.
        along: Its direction (3,), unit.
        normal: Unit vector (3,) out of the mesh where they touch last.
        on_mesh: The point (3,) of the mesh there, m.
    """

    way: float
    along: FloatArray
    normal: FloatArray
    on_mesh: FloatArray


Movement = Callable[[FloatArray, float], Moved]
"""How they lie after a translation (3,), m, and a bound (m) that their distance does not exceed."""


def shortest_exit(
    moved: Movement,
    starts: Sequence[FloatArray],
    start_of: Callable[[FloatArray], Start],
    outward_at: Callable[[FloatArray], FloatArray],
) -> Exit:
    """The shortest way out of those tried.

    Args:
        moved: How they lie after a translation.
        starts: Directions (3,) to begin with, unit; at least one.
        start_of: What is known of the way along a direction.
        outward_at: Unit normal (3,) of the surface next to a point (3,), m.
    """
    best = _turned(moved, start_of, start_of(starts[0]))
    for start in (*starts[1:], None):
        # last, out of the surface next to the geometry's farthest point within: it may be another
        direction = outward_at(best.on_mesh - best.way * best.along) if start is None else start
        if max(direction @ best.along, direction @ best.normal) > ALONGSIDE:
            continue
        found = _turned(moved, start_of, start_of(direction))
        if found.way < best.way:
            best = found
    return best


ALONGSIDE = 0.998
"""Cosine between a start and the best direction so far from which on it ends at the same: 4
degrees."""


def _turned(moved: Movement, start_of: Callable[[FloatArray], Start], start: Start) -> Exit:
    """The shortest way out from one start, turned to the normal at its end as long as it gains."""
    best = _exit(moved, start)
    for _ in range(TURNS):
        slope = float(best.normal @ best.along)
        if slope > 1.0 - ALIGNED or best.way * (1.0 - slope) < GAIN:
            break
        known = start_of(best.normal)
        # the plane that they touch last is as far away as this: all there is if both are convex
        likely = best.way * slope
        found = _exit(moved, Start(along=known.along, likely=likely, certain=known.certain))
        if found.way > best.way - GAIN:
            break
        best = found
    return best


def _exit(moved: Movement, start: Start) -> Exit:
    """The way out along one direction, or beside it where something is in the way."""
    along, inside = start.along, 0.0
    # a little farther, lest what they leave is what they cross by a rounding error
    way = min(max(start.likely, 0.0) + TOLERANCE / 2, start.certain)
    at = moved(way * along, np.inf)
    if at.distance <= 0.0:
        pushed = _pushed(moved, way * along, at)
        if pushed is not None:
            at, way = pushed[1], float(np.linalg.norm(pushed[0]))
            along = pushed[0] / way
    while at.distance <= 0.0 and way < start.certain:
        inside, way = way, min(max(GROWTH * way, SHORTEST), start.certain)
        at = moved(way * along, np.inf)
    for _ in range(STEPS):
        if at.distance <= TOLERANCE or way - inside <= TOLERANCE:
            break
        missing = at.distance - TOLERANCE / 2
        nearer = way - missing / max(float(at.normal @ along), FLATTEST)
        nearer = nearer if nearer > inside else (inside + way) / 2
        # a distance changes by no more than the step
        there = moved(nearer * along, at.distance + way - nearer + TOLERANCE)
        if there.distance <= 0.0:
            inside, nearer = nearer, max(way - missing, (inside + way) / 2)
            there = moved(nearer * along, at.distance + way - nearer + TOLERANCE)
            if there.distance <= 0.0:  # rounding: the way so far is one that leads out
                break
        way, at = nearer, there
    apart = max(at.distance, 0.0)  # the last bit of the way touches nothing
    return Exit(way=way - apart, along=along, normal=at.normal, on_mesh=at.on_mesh)


def _pushed(moved: Movement, way: FloatArray, at: Moved) -> tuple[FloatArray, Moved] | None:
    """A translation out of a concave corner: the least one across all planes met so far.

    Args:
        moved: How they lie after a translation.
        way: A translation (3,), m, that led out of one surface and into another.
        at: How they lie there.

    Returns:
        The translation and how they lie after it, apart; None if none was found.
    """
    length = float(np.linalg.norm(way))
    normals, rooms = [way / length], [length]
    for _ in range(PUSHES):
        normals.append(at.normal)
        depth = max(-at.distance, LEAST_PUSH * length) + TOLERANCE / 2
        rooms.append(float(at.normal @ way) + depth)
        across = _least_across(np.array(normals), np.array(rooms))
        if across is None:
            return None
        way, at = across, moved(across, np.inf)
        if at.distance > 0.0:
            return way, at
    return None


PUSHES = 6
"""Most planes that a translation is pushed across before it is given up."""

LEAST_PUSH = 0.02
"""Least depth that is believed of triangles, by the way so far: they are said to be too shallow."""


def _least_across(normals: FloatArray, rooms: FloatArray) -> FloatArray | None:
    """The shortest v (3,) with normals (k, 3) @ v >= rooms (k,), by Lawson and Hanson's LDP."""
    from planner.system.scipy_parts import nnls  # here: SciPy loads slowly

    unit = float(np.abs(rooms).max())
    rows = np.vstack([normals.T, rooms / unit])
    weights, _ = nnls(rows, LDP_GOAL)
    rest = rows @ weights - LDP_GOAL
    if not np.isfinite(rest).all() or rest[3] > -OPPOSED:
        return None
    v: FloatArray = -rest[:3] / rest[3] * unit
    return v


LDP_GOAL: FloatArray = np.array([0.0, 0.0, 0.0, 1.0])

OPPOSED = 1e-6
"""Residual (-) of the programme below which the planes leave no common side."""


class ClosedMesh(Protocol):
    """What is asked of a mesh; ``planner.shapes.Mesh`` has it."""

    @property
    def bounds(self) -> tuple[FloatArray, FloatArray]:
        """Corners (3,) of the bounding box, m."""
        ...

    @property
    def hull_planes(self) -> FloatArray:
        """Planes (k, 4) of the convex hull."""
        ...

    def coal_geometry(self) -> Any:
        """Coal's tree of triangles."""
        ...

    def signed_distance(self, points: FloatArray) -> FloatArray:
        """Exact, (n,), m, of points (n, 3)."""
        ...

    def closest_point(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Surface points and normals, (n, 3) each, of points (n, 3)."""
        ...

    def support(self, direction: FloatArray) -> float:
        """Largest coordinate (m) of the solid along a unit direction (3,)."""
        ...

    def field(self) -> Any:
        """The smooth distance."""
        ...


CROSSING = 1e-6
"""Distance (m) up to which coal's word that two surfaces are apart is not believed: its accuracy.
It gives 0 for some that cross."""

UNIT = 1e-3
"""How far (-) the length of coal's normals may be from 1."""


class MeshPair:
    """A convex geometry and a mesh, asked for at many poses; the counterpart of ``DistancePair``.

    Attributes:
        geometry: Convex coal geometry.
        mesh: Closed mesh, a shape.
        inner: A point (3,) of the geometry, m, in its frame.
    """

    def __init__(self, geometry: Any, mesh: ClosedMesh) -> None:
        """Prepare the query."""
        self.geometry, self.mesh = geometry, mesh
        self._triangles = mesh.coal_geometry()  # coal's functor holds bare pointers
        self._radius = float(geometry.radius) if isinstance(geometry, coal.Sphere) else None
        # coal gives minus the radius for some spheres that are far from the triangles
        self._measured = geometry if self._radius is None else coal.Sphere(0.0)
        self._compute = coal.ComputeDistance(self._measured, self._triangles)
        self._request, self._result = coal.DistanceRequest(), coal.DistanceResult()
        self._exit: Exit | None = None
        self.inner = np.array(geometry.computeCOM())

    def distance(self, pose: SE3, pose_mesh: SE3) -> float:
        """Signed distance, m; negative where they share a point.

        Args:
            pose: ``T_world_geometry``.
            pose_mesh: ``T_world_mesh``.
        """
        inner = pose_mesh.actInv(pose.act(self.inner))[None]
        maybe_inside = bool(maybe_within(self.mesh, inner)[0])
        at = coal.Transform3s(pose), coal.Transform3s(pose_mesh)
        return self.distance_below(*at, np.inf, inner, maybe_inside=maybe_inside)

    def distance_below(
        self,
        pose: Any,
        pose_mesh: Any,
        limit: float,
        inner: FloatArray,
        *,
        maybe_inside: bool,
    ) -> float:
        """Signed distance, m, or at least ``limit`` where it is not below that.

        Args:
            pose: ``T_world_geometry``, a ``coal.Transform3s``.
            pose_mesh: ``T_world_mesh``, likewise.
            limit: m, above 0.
            inner: The point ``inner`` in the mesh's frame, (1, 3), m.
            maybe_inside: Whether that point may be inside the mesh, see ``maybe_within``.
        """
        reach = 0.0 if self._radius is None else self._radius
        result, self._exit = self._result, None
        result.clear()
        if limit < np.inf:
            result.min_distance = limit + reach
        found = self._compute(pose, pose_mesh, self._request, result)
        # at the limit it is the limit, and not a rounding error less
        distance = float(found) - reach if found < limit + reach else limit
        if maybe_inside:
            within = float(self.mesh.signed_distance(inner)[0])
            if self._radius is not None:
                distance = within - reach
            elif within < 0.0:
                distance = min(distance, within)
        if distance > CROSSING:
            return distance
        # out of the triangle that coal calls deepest, or from inside of all to the nearest
        guess = pose_mesh.getRotation().T @ np.array(result.normal)
        way_out = self._leave(pose_mesh.inverseTimes(pose), guess if found > CROSSING else -guess)
        if self._radius is not None and way_out.way <= TOLERANCE - distance:
            return distance  # exact; more only where it is in two surfaces at a time
        self._exit = way_out
        return -way_out.way

    def _leave(self, pose: Any, guess: FloatArray) -> Exit:
        """The way out of the mesh from a pose in its frame; a guess (3,) of its direction."""
        mesh, result = self.mesh, self._result
        reach = 0.0 if self._radius is None else self._radius
        rotation, begin = pose.getRotation(), pose.getTranslation()
        middle = begin + rotation @ self.inner
        surface, outward = mesh.closest_point(middle[None])
        identity, at = coal.Transform3s.Identity(), coal.Transform3s(pose)

        def moved(way: FloatArray, bound: float) -> Moved:
            at.setTranslation(begin + way)
            result.clear()
            if bound < np.inf:
                result.min_distance = bound + reach
            distance = float(self._compute(at, identity, self._request, result))
            on_mesh, normal = np.array(result.getNearestPoint2()), -np.array(result.normal)
            inner = (middle + way)[None]
            if distance > 0.0 and maybe_within(mesh, inner)[0]:
                within = float(mesh.signed_distance(inner)[0])
                if within < 0.0:
                    distance, normal = within, -normal
            return Moved(distance=distance - reach, normal=normal, on_mesh=on_mesh)

        def start_of(along: FloatArray) -> Start:
            beyond = coal.Halfspace(along, float(along @ surface[0]))
            result.clear()
            likely = -coal.distance(
                self.geometry, coal.Transform3s(pose), beyond, identity, self._request, result
            )
            certain = likely + mesh.support(along) - float(along @ surface[0]) + TOLERANCE
            return Start(along=along, likely=likely, certain=certain)

        def outward_at(point: FloatArray) -> FloatArray:
            return np.asarray(mesh.closest_point(point[None])[1][0])

        starts = [outward[0]]
        if abs(float(np.linalg.norm(guess)) - 1.0) < UNIT:  # coal has none where it failed
            starts.append(guess)
        return shortest_exit(moved, starts, start_of, outward_at)

    def last_points(self, distance: float, pose_mesh: SE3) -> FloatArray:
        """Nearest points (3,) + (3,) and normal (3,) of the last query, which gave a distance (m).

        Of a geometry that is in the mesh, the points that part last on its way out.

        Args:
            distance: m.
            pose_mesh: ``T_world_mesh`` of that query.
        """
        result = self._result
        if self._exit is not None:
            on_mesh = pose_mesh.act(self._exit.on_mesh)
            normal = -(pose_mesh.rotation @ self._exit.along)
            return np.concatenate([on_mesh - distance * normal, on_mesh, normal])
        point, on_mesh = np.array(result.getNearestPoint1()), np.array(result.getNearestPoint2())
        if self._radius is None:
            return np.concatenate([point, on_mesh, result.normal])
        normal = (on_mesh - point) / (distance + self._radius)  # turned about where it is inside
        return np.concatenate([point + self._radius * normal, on_mesh, normal])

    def query(self, pose: SE3, pose_mesh: SE3) -> Proximity:
        """Distance, nearest points and normal.

        Args:
            pose: ``T_world_geometry``.
            pose_mesh: ``T_world_mesh``.
        """
        distance = self.distance(pose, pose_mesh)
        if self._radius is not None and self._exit is None:
            return self._from_sphere(distance, pose, pose_mesh, self._radius)
        row = self.last_points(distance, pose_mesh)
        return Proximity(distance=distance, point_a=row[:3], point_b=row[3:6], normal=row[6:])

    def _from_sphere(self, distance: float, pose: SE3, pose_mesh: SE3, radius: float) -> Proximity:
        surface, outward = self.mesh.closest_point(pose_mesh.actInv(pose.translation)[None])
        normal = -(pose_mesh.rotation @ outward[0])
        return Proximity(
            distance=distance,
            point_a=pose.translation + radius * normal,
            point_b=pose_mesh.act(surface[0]),
            normal=normal,
        )


def maybe_within(mesh: ClosedMesh, points: FloatArray) -> NDArray[np.bool_]:
    """Which points (n, 3), m, may be inside a mesh, (n,); the others are outside for certain."""
    lower, upper = mesh.bounds
    maybe = np.asarray(((points >= lower) & (points <= upper)).all(axis=1))
    if maybe.any():
        planes = mesh.hull_planes
        maybe[maybe] = (points[maybe] @ planes[:, :3].T <= -planes[:, 3]).all(axis=1)
    if maybe.any():
        field = mesh.field()
        maybe[maybe] = field.value(points[maybe]) <= field.error
    return np.asarray(maybe)
