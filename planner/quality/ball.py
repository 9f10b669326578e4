"""Epsilon: the largest ball in a grasp's wrenches, exact for discretised cones, else an interval.

With L1 the normal forces of all contacts sum to 1, and the wrenches that the grasp can apply are
the hull of its primitive wrenches W. **Epsilon** is the radius of the largest ball about the origin
inside it (Ferrari and Canny 1992), the size of the least wrench that the grasp cannot apply; it is
0 where the origin is not inside. Qhull finds the facets, and the radius is the support function
h(u) = max_j u . w_j at the facet normal where it is least, evaluated on W itself.

Time grows fast with the number of edges: about 3, 8 and 40 ms for four contacts at k = 4, 8 and 16.

Where the wrench set is no polytope, or one too large to list, epsilon has a certified interval. A
convex body K that is known by its support function h(u) = max over w in K of u . w lies between
two bounds, whatever points and directions were tried:

lower   the hull of any points of K is part of K, so its largest ball about the origin is in K;
upper   K does not reach beyond h(u) along any unit u, so no ball of radius above h(u) is in K.

``ball_interval`` starts from a hull of seed points, asks for the support points along the normals
of the facets nearest to the origin, adds them, and repeats. Both bounds hold at every step; the
limits on tolerance and points only decide how near they come. Symmetric grasps put many points on
one facet, where Qhull may go astray; so it is given points shifted at random by a known 1e-8, which
the lower bound pays for.

Two bodies are offered, each for true cones or for inscribed ones of k edges:

L1      the normal forces sum to 1:        h = max_i h_i(u),
L-inf   each normal force is in [0, 1]:    h = sum_i max(0, h_i(u)),

with h_i the support function of contact i's cone section at unit normal component. The second is a
Minkowski sum with far too many corners to list (5 contacts, k = 8: 59,049).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from planner.arrays import checked_count, float_array
from planner.contacts import MIN_EDGES, ContactSet, Pyramid
from planner.errors import ContactError
from planner.quality.closure import RoundCones, check_length, contact_wrenches, primitive_wrenches
from planner.spatial import FloatArray

if TYPE_CHECKING:
    from scipy.spatial import ConvexHull


def wrench_reach(
    contacts: ContactSet, directions: FloatArray, *, length: float, edges: int = 8
) -> FloatArray:
    """The largest wrench along each direction that contacts apply with normal forces of sum 1.

    The wrench of a disturbance that they resist is its opposite.

    Args:
        contacts: n contacts with force closure.
        directions: (k, 6), [force; torque divided by ``length`` and about the centre], not 0.
        length: Torque is divided by it, m.
        edges: Edges per inscribed cone.

    Returns:
        (k,), in lengths of the directions; per newton of total normal force.

    Raises:
        ContactError: The contacts have no force closure, so that the hull does not hold 0.
    """
    from planner.system.scipy_parts import ConvexHull, QhullError  # here: SciPy loads slowly

    check_hull(len(contacts), edges)
    wrenches = primitive_wrenches(contacts, edges, length=length)
    try:
        # joggled: points in special position are common, and a chart shows three digits
        facets = ConvexHull(wrenches.T, qhull_options="QJ").equations
    except QhullError as error:
        raise ContactError(f"{NOTHING}: the wrenches are in a hyperplane") from error
    offsets = -facets[:, -1]
    if offsets.min() <= 0:
        raise ContactError(f"{NOTHING}: 0 is not inside the hull of wrenches")
    along = np.asarray(directions, dtype=np.float64) @ facets[:, :-1].T  # (k, facets)
    reach: FloatArray = np.min(np.where(along > 0, offsets / np.maximum(along, TINY), np.inf), 1)
    return reach


NOTHING = "contacts without force closure have no reach in every direction"
TINY = 1e-300
"""Against division by 0."""


FLAT_TOL = 1e-9
"""A hull is flat, and has no ball and no volume, where the least singular value of its centred
points is below this share of the largest (-). Qhull needs about 1e-13."""

JITTER = 1e-8
"""Size of the random shift that takes points out of special position, as a share of the longest
point (-). Far above rounding, which is what it shields Qhull from, and far below any use of the
result. The error of a radius is at most twice this."""

_AGREEMENT = 1e-9
"""Qhull's distance of the nearest facet and the support function there may differ by this share of
the longest point (-) before its facets are thought spoilt by points in special position."""

MOST_HULL_EDGES = 64
"""Most edges per cone of a hull (-): five contacts with 64 take 7 s, time grows elevenfold with
twice the edges, and the cones are then 99.9 % of the round ones."""

MOST_HULL_POINTS = 1000
"""Most points of a hull (-): 125 contacts with 8 edges take 5 s, ten with 64 take 15 s."""

LARGEST_WRENCH = 1e12
"""Largest component of a wrench whose hull can be had: Qhull squares them several times."""

FACETS_AT_ONCE = 50_000
"""Facets whose support is computed together: five contacts with 64 edges have 400,000, and a table
of all their supports takes a gigabyte."""

FROGGER_EDGES = 16
"""Edges per cone in the baseline's figures (-)."""


@dataclass(frozen=True, kw_only=True, eq=False)
class HullMeasure:
    """What the hull of wrenches says about a grasp.

    Attributes:
        epsilon: Radius of the largest ball about the origin in the hull, 0 where it is not inside.
        weakest: (d,), unit direction in which the hull reaches least far from the origin. The
            contacts apply at most epsilon along it, so they resist least along its opposite.
        volume: Volume of the hull, 0 where it is flat.
    """

    epsilon: float
    weakest: FloatArray
    volume: float


def epsilon_l1(
    contacts: ContactSet,
    *,
    length: float,
    edges: int = 8,
    cone: Pyramid = "inscribed",
    phase: float = 0.0,
) -> float:
    """Epsilon of the discretised cones with unit normal components: the normal forces sum to 1.

    Inscribed cones give a lower bound of the true cones' epsilon, circumscribed ones an upper.

    Args:
        contacts: n contacts.
        length: Torque is divided by it, m.
        edges: Edges k per cone, at least 3.
        cone: "inscribed" or "circumscribed".
        phase: Angle of the first edge from tangent1, rad.

    Returns:
        Epsilon, per unit of total normal force (-); 0 where there is no closure.

    Raises:
        ContactError: ``length`` is not positive, ``edges`` is below 3, or ``cone`` is unknown.
    """
    check_hull(len(contacts), edges)
    wrenches = primitive_wrenches(contacts, edges, cone=cone, length=length, phase=phase)
    return measure_hull(wrenches).epsilon


def volume_l1(contacts: ContactSet, *, length: float, edges: int = 8) -> float:
    """Volume (-) of the hull of primitive wrenches, inscribed cones; 0 where it is flat.

    Args:
        contacts: n contacts.
        length: Torque is divided by it, m.
        edges: Edges k per cone, at least 3.

    Raises:
        ContactError: ``length`` is not positive, or ``edges`` is below 3.
    """
    check_hull(len(contacts), edges)
    return measure_hull(primitive_wrenches(contacts, edges, length=length)).volume


def epsilon_frogger(contacts: ContactSet, *, half_longest_side: float) -> float:
    """Epsilon in the definition of the baseline's published figures (FRoGGeR, Li et al. 2023).

    Edges of unit LENGTH, 16 per cone, the first on tangent1, torque about the centre of mass
    divided by half the longest side of the object's bounding box, L1. The baseline knows point
    contacts only, so torsional friction is left out.

    Args:
        contacts: n contacts.
        half_longest_side: Half the longest side of the object's bounding box, m.

    Raises:
        ContactError: ``half_longest_side`` is not positive.
    """
    check_length(half_longest_side)
    wrenches = primitive_wrenches(
        contacts.with_friction(contacts.mu, 0.0),
        FROGGER_EDGES,
        length=half_longest_side,
        unit="length",
    )
    return measure_hull(wrenches).epsilon


def check_hull(n_contacts: int, edges: int) -> None:
    """Refuse a hull that would take minutes and gigabytes.

    Raises:
        ContactError: More edges or points than can be had.
    """
    checked_count(
        "the number of edges per cone of a hull", edges, least=MIN_EDGES, most=MOST_HULL_EDGES
    )
    if n_contacts * edges > MOST_HULL_POINTS:
        raise ContactError(
            f"the hull of {n_contacts} contacts with {edges} edges each has more than "
            f"{MOST_HULL_POINTS} points; give fewer edges, or merge contacts that are one patch"
        )


def measure_hull(wrenches: FloatArray) -> HullMeasure:
    """Epsilon, weakest direction and volume of the hull of any points.

    Args:
        wrenches: (d, m), one point per column, in commensurable units; d is 6 for wrenches in
            space, 3 for [f_x, f_y, tau_z] in a plane.

    Raises:
        ContactError: The array is not of two dimensions, or a number is not finite.
    """
    from planner.system.scipy_parts import ConvexHull, QhullError  # here: SciPy loads slowly

    w = float_array("wrenches", wrenches)
    if w.ndim != 2 or len(w) < 2 or not np.isfinite(w).all():
        raise ContactError(f"wrenches have shape {w.shape}; give finite numbers of shape (d, m)")
    if w.size and np.abs(w).max() > LARGEST_WRENCH:
        raise ContactError(f"a wrench is larger than {LARGEST_WRENCH:g}; give it in other units")
    flat = flat_direction(w.T)
    if flat is not None:
        # All points lie in the plane flat . w = c: on the side c <= 0 they do not reach beyond 0.
        side = -1.0 if w.shape[1] and flat @ w[:, 0] > 0 else 1.0
        return HullMeasure(epsilon=0.0, weakest=side * flat, volume=0.0)
    longest = np.linalg.norm(w, axis=0).max()
    try:
        hull = ConvexHull(w.T)
        epsilon, weakest = _nearest_facet(hull, w)
        spoilt = abs(epsilon + hull.equations[:, -1].max()) > _AGREEMENT * longest
    except QhullError:
        spoilt = True
    if spoilt:
        try:
            hull = ConvexHull(jittered(w.T, JITTER * longest, np.random.default_rng(0)))
        except QhullError as fault:  # lengths below 1e-154 have no square
            raise ContactError(
                f"the hull of wrenches of at most {longest:g} is lost in rounding; give them in "
                "other units"
            ) from fault
        epsilon, weakest = _nearest_facet(hull, w)
    return HullMeasure(epsilon=max(epsilon, 0.0), weakest=weakest, volume=float(hull.volume))


def _nearest_facet(hull: ConvexHull, w: FloatArray) -> tuple[float, FloatArray]:
    """Least value of the support function of w (d, m) over the facet normals, and that normal."""
    normals = hull.equations[:, :-1]
    parts = range(0, len(normals), FACETS_AT_ONCE)
    reach = np.concatenate([(normals[i : i + FACETS_AT_ONCE] @ w).max(axis=1) for i in parts])
    nearest = int(reach.argmin())
    return float(reach[nearest]), normals[nearest]


def flat_direction(points: FloatArray) -> FloatArray | None:
    """Unit normal of a hyperplane that holds all points (m, d), or None where there is none."""
    m, d = points.shape
    if m == 0:
        first: FloatArray = np.eye(d)[0]
        return first
    _, s, vt = np.linalg.svd(points - points.mean(axis=0), full_matrices=m < d)
    if m > d and s[-1] > FLAT_TOL * s[0]:
        return None
    direction: FloatArray = vt[-1]
    return direction


def jittered(points: FloatArray, size: float, rng: np.random.Generator) -> FloatArray:
    """Points (m, d), each shifted at random by at most ``size``."""
    moved: FloatArray = points + size / np.sqrt(points.shape[1]) * rng.uniform(
        -1.0, 1.0, points.shape
    )
    return moved


Support: TypeAlias = Callable[[FloatArray], tuple[FloatArray, FloatArray]]
"""Directions (q, d) -> values h (q,) and points of the body (q, p, d), those that attain h among
them, and others on the way out that may serve too."""

MARGIN = 1e-9
"""Taken off lower bounds beside the jitter, as a share of the longest point (-): Qhull's rounding,
which is near 1e-14 for points in general position."""

_NEAR = 1e-5
"""A support point this near to a known one, as a share of the longest point (-), is not added: it
would make slivers, and could move the bound by no more than this."""

_EXAMINED = 400
"""Facets, nearest the origin first, whose support is evaluated at a time (-)."""

_QUERIES = 3
"""Facets refined at a time: fewer rebuild the hull too often, more add points that do not count."""

_ALIKE = 0.999
"""Normals with a cosine above this are refined one at a time (-)."""

ROUND_SEED_EDGES = 8
"""Edges per cone that seed the hull of true cones (-)."""


@dataclass(frozen=True, kw_only=True)
class Interval:
    """Bounds that hold for a quantity, however far they are apart.

    Attributes:
        lower: The quantity is at least this.
        upper: The quantity is at most this.
    """

    lower: float
    upper: float

    def __post_init__(self) -> None:
        """Check the order."""
        if not self.lower <= self.upper:
            raise ContactError(f"an interval needs lower <= upper; got {self.lower}, {self.upper}")

    @property
    def width(self) -> float:
        """Upper minus lower."""
        return self.upper - self.lower

    def __str__(self) -> str:
        """Both ends in brackets."""
        return f"[{self.lower:.4f}, {self.upper:.4f}]"


def epsilon_round(
    contacts: ContactSet, *, length: float, rel_tol: float = 0.02, max_points: int = 150
) -> Interval:
    """Epsilon (L1) of the true round or elliptic cones, as a certified interval.

    Args:
        contacts: n contacts.
        length: Torque is divided by it, m.
        rel_tol: Ends when the width is below this share of the upper end (-).
        max_points: Ends when the inner hull has this many points.

    Returns:
        Bounds of epsilon, per unit of total normal force (-).

    Raises:
        ContactError: ``length`` is not positive.
    """
    cones = RoundCones.of(contacts, length)
    seeds = np.hstack(
        [np.zeros((6, 0)), *contact_wrenches(contacts, ROUND_SEED_EDGES, length=length)]
    )

    def support(directions: FloatArray) -> tuple[FloatArray, FloatArray]:
        reach, points = cones.extremes(directions)
        return reach.max(axis=1, initial=0.0 if not len(contacts) else -np.inf), points

    return ball_interval(support, seeds.T, rel_tol=rel_tol, max_points=max_points)


def epsilon_linf(
    contacts: ContactSet,
    *,
    length: float,
    edges: int | None = None,
    rel_tol: float = 0.05,
    max_points: int = 120,
) -> Interval:
    """Epsilon with each normal force in [0, 1] on its own, as a certified interval.

    Args:
        contacts: n contacts.
        length: Torque is divided by it, m.
        edges: Edges per inscribed cone, at least 3; None for the true cones.
        rel_tol: Ends when the width is below this share of the upper end (-).
        max_points: Ends when the inner hull has this many points.

    Returns:
        Bounds of epsilon, per unit of the largest normal force (-). Between the L1 value and n
        times it.

    Raises:
        ContactError: ``length`` is not positive, or ``edges`` is below 3.
    """
    cones = RoundCones.of(contacts, length)
    groups = [] if edges is None else contact_wrenches(contacts, edges, length=length)

    def extremes(directions: FloatArray) -> tuple[FloatArray, FloatArray]:
        if edges is None:
            return cones.extremes(directions)
        reach = np.zeros((len(directions), len(groups)))
        points = np.zeros((len(directions), len(groups), 6))
        for i, group in enumerate(groups):
            along = directions @ group
            best = along.argmax(axis=1)
            reach[:, i] = along.max(axis=1)
            points[:, i] = group.T[best]
        return reach, points

    def support(directions: FloatArray) -> tuple[FloatArray, FloatArray]:
        reach, points = extremes(directions)
        total = np.einsum("qn,qnd->qd", (reach > 0).astype(float), points)
        return np.maximum(reach, 0.0).sum(axis=1), total[:, None, :]

    # Edges of single cones lie deep inside; start from both ends along the grasp map's axes.
    axes, _, _ = np.linalg.svd(np.hstack([np.zeros((6, 6)), *cones.maps]))
    seeds = support(np.vstack([axes.T, -axes.T]))[1].reshape(-1, 6)
    return ball_interval(support, seeds, rel_tol=rel_tol, max_points=max_points)


def ball_interval(
    support: Support, seeds: FloatArray, *, rel_tol: float, max_points: int
) -> Interval:
    """Radius of the largest ball about the origin in a convex body, as a certified interval.

    Args:
        support: The body's support function, with points of the body.
        seeds: Points of the body (m, d), any number.
        rel_tol: Ends when the width is below this share of the upper end (-).
        max_points: Ends when the inner hull has this many points.

    Returns:
        Bounds of the radius; [0, 0] where the origin is not inside the body.
    """
    from planner.system.scipy_parts import ConvexHull  # here: SciPy loads slowly

    points, upper = _full_hull_points(support, seeds)
    if points is None or upper <= 0.0:
        return Interval(lower=0.0, upper=max(upper, 0.0) if points is not None else 0.0)
    rng = np.random.default_rng(0)
    longest = float(np.linalg.norm(points, axis=1).max())
    size = JITTER * longest
    hull = ConvexHull(jittered(points, size, rng), incremental=True)
    while True:
        offsets = -hull.equations[:, -1]
        nearest = np.argsort(offsets)[:_EXAMINED]
        normals, offsets = hull.equations[nearest, :-1], offsets[nearest]
        lower = max(float(offsets[0]) - size - MARGIN * longest, 0.0)
        reach, found = support(normals)
        upper = max(min(upper, float(reach.min())), 0.0)
        if upper - lower <= rel_tol * upper:
            break
        chosen = _distinct(normals)
        # Only points beyond their own facet: the others are inside the hull or soon will be.
        beyond = np.einsum("qpd,qd->qp", found[chosen], normals[chosen]) > offsets[chosen, None]
        fresh = _unknown(found[chosen][beyond], points, _NEAR * longest)
        if len(fresh) == 0 or len(points) + len(fresh) > max_points:
            break
        points = np.vstack([points, fresh])
        hull.add_points(jittered(fresh, size, rng))
    hull.close()
    return Interval(lower=min(lower, upper), upper=upper)


def _full_hull_points(support: Support, seeds: FloatArray) -> tuple[FloatArray | None, float]:
    """Points that span a volume, and the least support met on the way; no points if flat."""
    points, upper = seeds, np.inf
    for _ in range(seeds.shape[1] + 1):
        flat = flat_direction(points)
        if flat is None:
            return points, upper
        reach, found = support(np.stack([flat, -flat]))
        upper = min(upper, float(reach.min()))
        fresh = found.reshape(-1, seeds.shape[1])
        points = np.vstack([points, fresh])
    return None, upper


def _distinct(normals: FloatArray) -> list[int]:
    """The first few of ``normals`` (q, d) that do not nearly coincide."""
    chosen = [0]
    for i in range(1, len(normals)):
        if len(chosen) == _QUERIES:
            break
        if (normals[chosen] @ normals[i]).max() < _ALIKE:
            chosen.append(i)
    return chosen


def _unknown(candidates: FloatArray, points: FloatArray, distance: float) -> FloatArray:
    """Those of ``candidates`` (q, d) that are not near ``points`` (m, d), nor near each other."""
    fresh: list[FloatArray] = []
    for candidate in candidates:
        known = np.vstack([points, *fresh])
        if np.linalg.norm(known - candidate, axis=1).min() > distance:
            fresh.append(candidate[None])
    return np.vstack(fresh) if fresh else np.zeros((0, points.shape[1]))
