"""How large an error closure tolerates: a size that is proven, and one that is known to break it.

For every kind of error,

promised    no error up to this size loses closure, as pyramids of k edges inside the cones have it:
            proven by ``planner.certify.robust``;
broken at   an error of this size that does lose it, true cones and all: found by search, and
            checked by the linear programme of ``planner.quality`` with pyramids around the cones.

What the true cones tolerate is between. The 8 edges with which grasps are planned cost 8 % of the
friction, and the promise as much; with 32 it is 0.5 %. Friction is monotone, so a drop of all
contacts together stands for any drops up to it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

import numpy as np
from scipy.optimize import nnls

from planner.certify.pose import PoseError, PoseErrors, random_errors, worst_errors
from planner.certify.robust import closure_survives, weakest_motion
from planner.contacts import ContactSet
from planner.quality import closure_of_wrenches, primitive_wrenches
from planner.spatial import FloatArray

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
