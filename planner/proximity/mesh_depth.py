"""How deep a convex geometry is in a closed mesh: the way that it takes to part them.

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

import numpy as np

from planner.spatial import FloatArray

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
