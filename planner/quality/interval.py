"""Certified intervals for epsilon where the wrench set is no polytope, or one too large to list.

A convex body K that is known by its support function h(u) = max over w in K of u . w lies between
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
from typing import TypeAlias

import numpy as np

from planner.contacts import ContactSet
from planner.errors import ContactError
from planner.quality.ball import JITTER, flat_direction, jittered
from planner.quality.cones import RoundCones, contact_wrenches
from planner.spatial import FloatArray

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
