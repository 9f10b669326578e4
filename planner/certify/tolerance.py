"""How large an error closure tolerates: a size that is proven, and one that is known to break it.

For every kind of error,

promised    no error up to this size loses closure, as pyramids of k edges inside the cones have it:
            proven by ``planner.certify.robust``;
broken at   an error of this size that does lose it, true cones and all: found by search, and
            checked by the linear programme of ``planner.quality`` with pyramids around the cones.

What the true cones tolerate is between. The 8 edges with which grasps are planned cost 8 % of the
friction, and the promise as much; with 32 it is 0.5 %. Friction is monotone, so a drop of all
contacts together stands for any drops up to it.

Errors of the object's pose: the pads stay where the plan puts them, the object does not.

A pad is a ball of radius rho whose centre c is rho off the surface at the planned contact. When the
object has moved, its finger closes or gives way along the normal of the surface point nearest to c,
and touches there: contact and normal are those of the nearest point.

For a convex object this is bounded without knowing its shape. Seen from the object, c moves by some
e to c'. Let p, p' be the nearest points, n, n' the outward normals, c = p + rho n, c' = p' + d n',
and t = p' - p. Both points are in the object, so n . t <= 0 and n' . t >= 0, hence

    e^2 = |t + d n' - rho n|^2 = |t|^2 + 2 t . (d n' - rho n) + |d n' - rho n|^2
        >= |t|^2 + |d n' - rho n|^2 >= |t|^2 + rho^2 sin^2(n, n')      while d >= 0 and e < rho:

the contact moves by at most e and its normal turns by at most asin(e / rho). A shift of the object
by s gives e = s for every pad; a turn by phi about the centre of mass e = 2 sin(phi / 2) |c|.
For other objects, where the nearest point can jump, nothing is promised.

Of shapes that are known more can be said of the turn (``largest_turn``):

round   A body in which a ball of radius R rolls freely is a smaller convex body blown up by R
        (Blaschke), with the same normals. So rho may be replaced by rho + R. R is the radius of a
        sphere or capsule, and the least radius of curvature of an ellipsoid, c^2 / a for its
        shortest and longest half axes. A flat face has no turn at all.
edge    Where the contact is h from the edge of its face, the point must overhang the edge before
        the normal turns over it. Seen along the edge, the point begins at the distance
        D = sqrt(h^2 + rho^2) from it, atan(h / rho) short of overhanging, and e takes it
        asin(e / D) further: the normal turns by at most asin(e / D) - atan(h / rho), if that is
        positive. A corner adds nothing, since |o| + h <= |o + (h, h)| for overhangs o >= 0. The rim
        of a cylinder is such an edge for its caps and for its side, whose round turn is added.

Errors of contacts: at random within their sizes, and the worst against a given motion.

Both give ordinary contacts, whose closure anything can decide. They serve to test a promise of
``planner.certify.robust`` and to find where it really ends, not to make one.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Literal, TypeAlias

import numpy as np
from scipy.spatial.transform import Rotation

from planner.certify.robust import closure_survives, weakest_motion
from planner.contacts import ContactSet
from planner.quality import closure_of_wrenches, primitive_wrenches
from planner.shapes import Shape
from planner.spatial import FloatArray, contact_frames
from planner.system.scipy_parts import nnls

_SMALL = 1e-12
"""Lengths below this share of the others have no direction (-)."""

_SIDE, _ZOOMS = 11, 6
"""Places along the side of a square that are tried, and times it shrinks to a quarter (-)."""


def displaced(contacts: ContactSet, shifts: FloatArray, axes: FloatArray) -> ContactSet:
    """Contacts with moved positions and turned frames.

    Args:
        contacts: n contacts.
        shifts: (n, 3), m, added to the positions.
        axes: (n, 3), rad: each frame is turned about this vector by its length.
    """
    return replace(
        contacts,
        positions=contacts.positions + shifts,
        frames=rotations(axes) @ contacts.frames,
    )


def random_errors(
    contacts: ContactSet, shifts: FloatArray, tilts: FloatArray, rng: np.random.Generator
) -> ContactSet:
    """Each contact moved by up to ``shifts`` (n,) m and tilted by up to ``tilts`` (n,) rad.

    Half of the draws are of the full size, where closure is lost first; the others of any.
    """
    n = len(contacts)
    size = np.where(rng.random((2, n)) < 0.5, 1.0, rng.random((2, n)))
    moved = (size[0] * shifts)[:, None] * random_directions(n, rng)
    across = np.cross(contacts.normals, random_directions(n, rng))
    axis = across / np.maximum(np.linalg.norm(across, axis=1, keepdims=True), _SMALL)
    return displaced(contacts, moved, (size[1] * tilts)[:, None] * axis)


def worst_errors(
    contacts: ContactSet, shifts: FloatArray, tilts: FloatArray, motion: FloatArray
) -> ContactSet:
    """Errors that take most support from a motion of the object.

    Each normal tilts away from the velocity V of its contact; then each position goes by the d that
    makes least of the support n . V' + |(mu V'_t, mu_torsion n . w)|, V' = V + w x d. The product
    w x d is perpendicular to w: a disc is searched, on which
    the support is convex.

    Args:
        contacts: n contacts.
        shifts: (n,), m.
        tilts: (n,), rad.
        motion: (6,), [v; w] about ``contacts.center``, m and rad.
    """
    v, w = motion[:3], motion[3:]
    velocity = v + np.cross(w, contacts.positions - contacts.center)
    axis = _unit(np.cross(velocity, contacts.normals))
    tilted = displaced(contacts, np.zeros_like(velocity), tilts[:, None] * axis)
    size = float(np.linalg.norm(w))
    if size == 0.0:
        return tilted
    mu, mu_torsion = contacts.friction.T
    torsion = mu_torsion * (tilted.normals @ w)
    across = contact_frames(w)[0, :, 1:].T  # two unit vectors perpendicular to w
    axis_values = np.linspace(-1.0, 1.0, _SIDE)
    grid = np.stack(np.meshgrid(axis_values, axis_values), axis=2).reshape(-1, 1, 2)
    place = np.zeros((len(contacts), 2))  # of w x d, in units of |w| r
    for zoom in range(_ZOOMS):
        tried = place + 4.0**-zoom * grid  # (grid, n, 2)
        tried /= np.maximum(np.linalg.norm(tried, axis=2, keepdims=True), 1.0)
        moved = velocity + size * shifts[:, None] * (tried @ across)  # (grid, n, 3)
        along = (moved * tilted.normals).sum(axis=2)
        sliding = np.linalg.norm(moved - along[:, :, None] * tilted.normals, axis=2)
        best = (along + np.hypot(mu * sliding, torsion)).argmin(axis=0)
        place = tried[best, np.arange(len(contacts))]
    moved_by = -shifts[:, None] * np.cross(w / size, place @ across)
    return displaced(tilted, moved_by, np.zeros_like(velocity))


def random_directions(n: int, rng: np.random.Generator) -> FloatArray:
    """Unit vectors (n, 3), uniform on the sphere."""
    return _unit(rng.normal(size=(n, 3)))


def rotations(axes: FloatArray) -> FloatArray:
    """Rotation matrices (n, 3, 3) about vectors (n, 3) by their lengths, rad."""
    return np.asarray(Rotation.from_rotvec(axes.reshape(-1, 3)).as_matrix())


def _unit(vectors: FloatArray) -> FloatArray:
    """Vectors (n, 3) at unit length; those without a length stay 0."""
    size = np.linalg.norm(vectors, axis=1, keepdims=True)
    least = _SMALL * max(float(size.max(initial=0.0)), _SMALL)
    return np.where(size > least, vectors / np.maximum(size, least), 0.0)


PoseError: TypeAlias = Literal["shift", "turn"]

AGREEMENT = 1e-4
"""How far (m) from a planned contact a ball along its normal may touch the surface. More than that,
and the normal is not that of the surface."""


@dataclass(frozen=True, kw_only=True, eq=False)
class PoseErrors:
    """Pads as balls on an object, in the object's frame (origin in the centre of mass).

    Attributes:
        shape: The object.
        contacts: n contacts, nearest points of the surface to the pads' centres.
        centers: (n, 3), centres of the pads, m.
        radii: (n,), of the pads, m.
        reason: Why nothing can be promised; "" where it can.
    """

    shape: Shape
    contacts: ContactSet
    centers: FloatArray
    radii: FloatArray
    reason: str

    @classmethod
    def of(cls, shape: Shape, contacts: ContactSet, radii: FloatArray) -> PoseErrors:
        """Balls of given radii (n,) that touch at contacts in the object's frame."""
        centers = contacts.positions - radii[:, None] * contacts.normals
        nearest = at_nearest(shape, contacts, centers)
        off = np.linalg.norm(nearest.positions - contacts.positions, axis=1).max(initial=0.0)
        reason = ""
        if not shape.convex:
            reason = "a mesh may be concave, where the nearest point of the surface can jump"
        elif off > AGREEMENT:
            reason = (
                f"a contact's normal is not the surface's: a ball along it would touch "
                f"{1e3 * off:.2f} mm away"
            )
        return cls(shape=shape, contacts=nearest, centers=centers, radii=radii, reason=reason)

    def sizes(self, kind: PoseError, level: float) -> tuple[FloatArray, FloatArray]:
        """Bounds of what contacts do: shifts (n,) m and tilts (n,) rad.

        Args:
            kind: "shift" or "turn".
            level: Size of the object's error, m or rad.
        """
        moved = np.full(len(self.radii), level)
        if kind == "turn":
            moved = 2 * np.sin(min(level, np.pi) / 2) * np.linalg.norm(self.centers, axis=1)
        turned = largest_turn(
            self.shape, self.contacts.positions, -self.contacts.normals, self.radii, moved
        )
        return moved, turned

    def ceiling(self, kind: PoseError) -> float:
        """Error (m or rad) at which a pad's centre can reach the surface; more is not meant."""
        if kind == "shift":
            return float(self.radii.min(initial=np.inf))
        share = self.radii / np.maximum(2 * np.linalg.norm(self.centers, axis=1), self.radii)
        return float(2 * np.arcsin(share).min(initial=np.pi / 2))

    def at(self, shift: FloatArray, turn: FloatArray) -> ContactSet:
        """Contacts after the object moved by ``shift`` (3,), m, and ``turn`` (3,), rotation vector.

        In the moved object's frame; the turn is about the centre of mass.
        """
        seen = (self.centers - shift) @ rotations(turn)[0]
        return at_nearest(self.shape, self.contacts, seen)

    def random(self, kind: PoseError, level: float, rng: np.random.Generator) -> ContactSet:
        """Contacts after a random error of up to ``level`` (m or rad), half of the draws equal."""
        size = level * (1.0 if rng.random() < 0.5 else rng.random())
        error = size * random_directions(1, rng)[0]
        still = np.zeros(3)
        return self.at(error, still) if kind == "shift" else self.at(still, error)


def at_nearest(shape: Shape, contacts: ContactSet, points: FloatArray) -> ContactSet:
    """The same contacts at the surface points nearest to points (n, 3), in the object's frame."""
    surface, outward = shape.closest_point(points)
    moved = ContactSet.from_arrays(surface, -outward, center=contacts.center)
    return replace(contacts, positions=moved.positions, frames=moved.frames)


def largest_turn(
    shape: Shape, points: FloatArray, normals: FloatArray, radii: FloatArray, moved: FloatArray
) -> FloatArray:
    """Bound of the turn of the normal at nearest points, (n,), rad.

    Args:
        shape: A convex shape.
        points: Nearest surface points (n, 3) at first, m, shape's frame.
        normals: Outward normals (n, 3) there; the moving points are at ``points`` + radius normal.
        radii: Distances rho (n,) from the surface at first, m.
        moved: Largest way e (n,) of each point, m; nothing (pi / 2) is known from the radius on.
    """
    curvature, gap = shape.curvature_and_edges(points, normals)
    gap = np.maximum(gap, 0.0)
    any_shape = _arcsin(moved / radii)
    over = _arcsin(moved / np.hypot(gap, radii)) - np.arctan2(gap, radii)
    this_shape = _arcsin(moved / (radii + curvature)) + np.maximum(over, 0.0)
    return np.where(moved < radii, np.minimum(any_shape, this_shape), np.pi / 2)


def _arcsin(sine: FloatArray) -> FloatArray:
    """The angle, rad; pi / 2 beyond a sine of 1."""
    return np.asarray(np.arcsin(np.minimum(sine, 1.0)))


REL_TOL = 0.02
"""A promise ends within this share (-) of a size for which no proof was found."""

JUDGE_EDGES = 32
"""Edges of the pyramids that decide whether closure is lost (-): within 0.5 % of the friction."""

LEAST = 1e-3
"""Share of the first size that is tried below which nothing is promised (-)."""

FACTORS = (1.03, 1.1, 1.2, 1.35, 1.6, 2.0, 4.0)
"""Errors that break closure are sought at these multiples of the promise (-)."""

HALVINGS = 6
"""Steps of a bisection between a promise and an error that breaks it (-)."""

LEVELS, DRAWS = 10, 12
"""Pose errors: sizes tried between the promise and the largest, and draws of each (-)."""

SOUND = 1e-4
"""Shares (-): least singular value, root of the residual, least weight over the mean, beyond which
closure is not in doubt; ``planner.quality`` asks for 1e-6 and less."""

Sizes: TypeAlias = tuple[ContactSet, FloatArray, FloatArray]
"""Contacts, and the largest errors of their positions (n,), m, and normals (n,), rad."""

Draw: TypeAlias = Callable[[float, np.random.Generator], ContactSet]


@dataclass(frozen=True, kw_only=True, eq=False)
class Tolerance:
    """What closure tolerates of one kind of error, all contacts at once.

    Attributes:
        kind: "position", "normal", "friction", "pose shift" or "pose turn".
        unit: "mm", "deg" or "%".
        promised: Proven; None where nothing can be.
        broken_at: An error of this size loses closure; None where none was found.
        note: Why nothing is promised, "" otherwise.
        samples: Random errors of up to the promise that were tried.
        lost: How many of them lost closure.
        draw: Contacts with a random error of up to a size in ``unit``.
        edges: Edges of the pyramids by which the promise and its samples understand closure.
    """

    kind: str
    unit: str
    promised: float | None
    broken_at: float | None
    note: str
    draw: Draw
    edges: int
    samples: int = 0
    lost: int = 0

    def as_dict(self) -> dict[str, Any]:
        """Plain data for JSON."""
        names = ("kind", "unit", "promised", "broken_at", "note", "edges", "samples", "lost")
        return {name: getattr(self, name) for name in names}


def contact_tolerances(contacts: ContactSet, *, edges: int = 8) -> tuple[Tolerance, ...]:
    """Tolerance to errors of positions (mm), normals (deg) and friction (%).

    Args:
        contacts: n contacts, closed.
        edges: Edges of the pyramids by which promises understand closure, at least 3.

    Raises:
        ContactError: ``edges`` is below 3.
    """
    none = np.zeros(len(contacts))
    arm = float(np.linalg.norm(contacts.positions - contacts.center, axis=1).max(initial=0.0))

    def moved(level: float) -> Sizes:
        return contacts, none + 1e-3 * level, none

    def tilted(level: float) -> Sizes:
        return contacts, none, none + np.deg2rad(level)

    def weaker(level: float) -> Sizes:
        keep = max(1.0 - level / 100.0, 0.0)
        return contacts.with_friction(keep * contacts.mu, keep * contacts.mu_torsion), none, none

    def each_weaker(level: float, rng: np.random.Generator) -> ContactSet:
        n = len(contacts)
        keep = 1.0 - level / 100.0 * np.where(rng.random(n) < 0.5, 1.0, rng.random(n))
        return contacts.with_friction(keep * contacts.mu, keep * contacts.mu_torsion)

    return (
        _tolerance("position", "mm", moved, edges, start=100.0 * arm),
        _tolerance("normal", "deg", tilted, edges, start=10.0),
        replace(
            _tolerance("friction", "%", weaker, edges, start=50.0, ceiling=100.0), draw=each_weaker
        ),
    )


def pose_tolerances(poses: PoseErrors, *, edges: int = 8, seed: int = 0) -> tuple[Tolerance, ...]:
    """Tolerance to an error of the object's position (mm) and orientation (deg).

    Args:
        poses: Pads and object, closed.
        edges: As for ``contact_tolerances``.
        seed: Of the search for errors that break closure.
    """
    kinds: tuple[tuple[PoseError, str, float], ...] = (
        ("shift", "mm", 1e-3),
        ("turn", "deg", float(np.deg2rad(1.0))),
    )
    return tuple(
        _pose_tolerance(poses, kind, unit, size, edges, seed) for kind, unit, size in kinds
    )


def sampled(tolerance: Tolerance, samples: int, seed: int = 0) -> Tolerance:
    """The same tolerance, with its promise tried on random errors.

    Closure is decided with inscribed pyramids, by weights that prove it or by the linear programme
    of ``planner.quality``; neither has a part in the promise.
    """
    if tolerance.promised is None:
        return tolerance
    rng = np.random.default_rng(seed)
    lost = 0
    for _ in range(samples):
        wrenches = primitive_wrenches(tolerance.draw(tolerance.promised, rng), tolerance.edges)
        lost += not (_plainly_closed(wrenches) or closure_of_wrenches(wrenches).closed)
    return replace(tolerance, samples=samples, lost=lost)


def _tolerance(
    kind: str,
    unit: str,
    sizes: Callable[[float], Sizes],
    edges: int,
    *,
    start: float,
    ceiling: float = np.inf,
) -> Tolerance:
    """The tolerance to independent errors of contacts, whose sizes a level sets."""
    promised = _largest(sizes, edges, start, ceiling)
    broken = None
    for factor in FACTORS:
        level = min(factor * max(promised, LEAST * start), ceiling)
        # The motion of least support at a size that breaks closure is nearly the one that breaks it
        # first; look once more where that was.
        motion = weakest_motion(*sizes(level))
        if _lost(worst_errors(*sizes(level), motion)):
            broken = _least_lost(sizes, motion, promised, level)
            motion = weakest_motion(*sizes(broken), near=motion)
            if _lost(worst_errors(*sizes(broken), motion)):
                broken = _least_lost(sizes, motion, promised, broken)
            break
    return Tolerance(
        kind=kind,
        unit=unit,
        promised=promised,
        broken_at=broken,
        note="",
        edges=edges,
        draw=lambda level, rng: random_errors(*sizes(level), rng),
    )


def _least_lost(
    sizes: Callable[[float], Sizes], motion: FloatArray, low: float, high: float
) -> float:
    """The least level up to ``high`` whose errors against a motion lose closure, by bisection."""
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        if _lost(worst_errors(*sizes(middle), motion)):
            high = middle
        else:
            low = middle
    return high


def _pose_tolerance(
    poses: PoseErrors, kind: PoseError, unit: str, size: float, edges: int, seed: int
) -> Tolerance:
    """The tolerance to an error of the object's pose; ``size`` is a unit in m or rad."""

    def sizes(level: float) -> Sizes:
        return poses.contacts, *poses.sizes(kind, level * size)

    def draw(level: float, rng: np.random.Generator) -> ContactSet:
        return poses.random(kind, level * size, rng)

    ceiling = poses.ceiling(kind) / size
    promised = None if poses.reason else _largest(sizes, edges, 0.5 * ceiling, ceiling)
    rng = np.random.default_rng(seed)
    broken = None
    for level in np.geomspace(promised or LEAST * ceiling, ceiling, LEVELS)[1:]:
        if any(_lost(draw(float(level), rng)) for _ in range(DRAWS)):
            broken = float(level)
            break
    return Tolerance(
        kind=f"pose {kind}",
        unit=unit,
        promised=promised,
        broken_at=broken,
        note=poses.reason,
        edges=edges,
        draw=draw,
    )


def _largest(sizes: Callable[[float], Sizes], edges: int, start: float, ceiling: float) -> float:
    """The largest level of errors for which closure was proven to survive, 0 if none was."""
    low, high, level = 0.0, np.inf, min(start, ceiling)
    suspects: tuple[FloatArray, ...] = ()
    while high - low > REL_TOL * high or np.isinf(high):
        verdict = closure_survives(*sizes(level), edges=edges, suspects=suspects)
        if verdict.survives:
            low = level
            if low >= ceiling:
                break
            level = min(2.0 * level, ceiling) if np.isinf(high) else 0.5 * (low + high)
        else:
            high = level
            if verdict.motion is not None:
                suspects = (*suspects[-1:], verdict.motion[3:])
            level = 0.5 * (low + high)
            if high < LEAST * start:
                break
    return low


def _lost(contacts: ContactSet) -> bool:
    """Whether not even pyramids around the cones close the grasp."""
    wrenches = primitive_wrenches(contacts, JUDGE_EDGES, cone="circumscribed")
    return not _plainly_closed(wrenches) and not closure_of_wrenches(wrenches).closed


def _plainly_closed(wrenches: FloatArray) -> bool:
    """Whether W (6, m) closes the grasp beyond doubt; a fortieth of the linear programme's time.

    b >= 0 with W b = -W 1 gives weights a = 1 + b > 0 with W a = 0, so with rank 6 it is closed.
    """
    force, torque = np.linalg.norm(wrenches[:3]), np.linalg.norm(wrenches[3:])
    if torque == 0.0:
        return False
    scaled = wrenches / np.repeat([force, torque], 3)[:, None]
    values = np.linalg.svd(scaled, compute_uv=False)
    if values[-1] < SOUND * values[0]:
        return False
    weights, left = nnls(scaled, -scaled.sum(axis=1))
    return bool(left < SOUND**2 * values[0] and SOUND * weights.sum() < len(weights))
