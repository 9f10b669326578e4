"""How large an error closure tolerates: a size that is proven, and one that is known to break it.

Closure is that of the true cones. For every kind of error,

promised    no error up to this size loses closure: proven by ``planner.certify.robust``;
broken at   an error of this size that does lose it: found by search, and checked by the linear
            programme of ``planner.quality`` with circumscribed pyramids, which hold the cones.

The truth is between. Friction is monotone, so a drop of all contacts together stands for any drops
up to it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

import numpy as np
from scipy.optimize import nnls

from planner.certify.errors import random_errors, worst_errors
from planner.certify.pose import PoseError, PoseErrors
from planner.certify.robust import Verdict, closure_survives
from planner.contacts import ContactSet
from planner.quality import closure_of_wrenches, force_closure, primitive_wrenches
from planner.spatial import FloatArray

__all__ = ["JUDGE_EDGES", "Tolerance", "contact_tolerances", "pose_tolerances", "sampled"]

REL_TOL = 0.02
"""A promise ends within this share (-) of a size for which no proof was found."""

JUDGE_EDGES = 32
"""Edges of the pyramids that decide whether closure is lost (-): within 0.5 % of the friction."""

LEAST = 1e-3
"""Share of the first size that is tried below which nothing is promised (-)."""

SEARCHED = 3.0
"""Errors of contacts that break closure are sought up to this many times the promise (-)."""

HALVINGS = 8
"""Steps of a bisection between a promise and an error that breaks it (-)."""

LEVELS, DRAWS = 10, 12
"""Pose errors: sizes tried between the promise and the largest, and draws of each (-)."""

SOUND = 1e-4
"""Shares (-): least singular value, root of the residual, least weight over the mean, beyond which
closure is not in doubt; ``planner.quality`` asks for 1e-6 and less."""

Ask: TypeAlias = Callable[[float, tuple[FloatArray, ...]], Verdict]
Spoil: TypeAlias = Callable[[float, FloatArray], ContactSet]
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
    """

    kind: str
    unit: str
    promised: float | None
    broken_at: float | None
    note: str
    draw: Draw
    samples: int = 0
    lost: int = 0

    def as_dict(self) -> dict[str, Any]:
        """Plain data for JSON."""
        names = ("kind", "unit", "promised", "broken_at", "note", "samples", "lost")
        return {name: getattr(self, name) for name in names}


def contact_tolerances(contacts: ContactSet) -> tuple[Tolerance, ...]:
    """Tolerance to errors of positions (mm), normals (deg) and friction (%).

    Args:
        contacts: n contacts, closed.
    """
    none = np.zeros(len(contacts))
    one = none + 1.0
    arm = float(np.linalg.norm(contacts.positions - contacts.center, axis=1).max(initial=0.0))
    mm, deg = 1e-3, np.deg2rad(1.0)

    def weaker(level: float) -> ContactSet:
        keep = max(1.0 - level / 100.0, 0.0)
        return contacts.with_friction(keep * contacts.mu, keep * contacts.mu_torsion)

    return (
        _tolerance(
            "position",
            "mm",
            ask=lambda s, w: closure_survives(contacts, s * mm * one, none, suspects=w),
            spoil=lambda s, u: worst_errors(contacts, s * mm * one, none, u),
            draw=lambda s, rng: random_errors(contacts, s * mm * one, none, rng),
            start=0.1 * arm / mm,
        ),
        _tolerance(
            "normal",
            "deg",
            ask=lambda s, w: closure_survives(contacts, none, s * deg * one, suspects=w),
            spoil=lambda s, u: worst_errors(contacts, none, s * deg * one, u),
            draw=lambda s, rng: random_errors(contacts, none, s * deg * one, rng),
            start=10.0,
        ),
        _tolerance(
            "friction",
            "%",
            ask=lambda s, w: closure_survives(weaker(s), none, none, suspects=w),
            spoil=lambda s, _: weaker(s),
            draw=lambda s, rng: _each_weaker(contacts, s / 100.0, rng),
            start=50.0,
            ceiling=100.0,
        ),
    )


def pose_tolerances(poses: PoseErrors, *, seed: int = 0) -> tuple[Tolerance, ...]:
    """Tolerance to an error of the object's position (mm) and orientation (deg).

    Args:
        poses: Pads and object, closed.
        seed: Of the search for errors that break closure.
    """
    kinds: tuple[tuple[PoseError, str, float], ...] = (
        ("shift", "mm", 1e-3),
        ("turn", "deg", float(np.deg2rad(1.0))),
    )
    return tuple(_pose_tolerance(poses, kind, unit, size, seed) for kind, unit, size in kinds)


def sampled(tolerance: Tolerance, samples: int, seed: int = 0) -> Tolerance:
    """The same tolerance, with its promise tried on random errors.

    Closure is decided by the linear programme of ``planner.quality``, inscribed pyramids.
    """
    if tolerance.promised is None:
        return tolerance
    rng = np.random.default_rng(seed)
    drawn = (tolerance.draw(tolerance.promised, rng) for _ in range(samples))
    lost = sum(not force_closure(contacts, JUDGE_EDGES).closed for contacts in drawn)
    return replace(tolerance, samples=samples, lost=lost)


def _tolerance(
    kind: str,
    unit: str,
    *,
    ask: Ask,
    spoil: Spoil,
    draw: Draw,
    start: float,
    ceiling: float = np.inf,
) -> Tolerance:
    promised, failures = _largest(ask, start, ceiling)
    found = [_breaks(spoil, m, promised, min(SEARCHED * f, ceiling)) for f, m in failures[-2:]]
    known = [level for level in found if level is not None]
    return Tolerance(
        kind=kind,
        unit=unit,
        promised=promised,
        broken_at=min(known, default=None),
        note="",
        draw=draw,
    )


def _pose_tolerance(
    poses: PoseErrors, kind: PoseError, unit: str, size: float, seed: int
) -> Tolerance:
    def ask(level: float, suspects: tuple[FloatArray, ...]) -> Verdict:
        return closure_survives(
            poses.contacts, *poses.sizes(kind, level * size), suspects=suspects
        )

    def draw(level: float, rng: np.random.Generator) -> ContactSet:
        return poses.random(kind, level * size, rng)

    promised: float | None = None
    ceiling = poses.ceiling(kind) / size
    if not poses.reason:
        promised, _ = _largest(ask, 0.5 * ceiling, ceiling)
    rng = np.random.default_rng(seed)
    broken = None
    for level in np.geomspace(promised or 0.02 * ceiling, ceiling, LEVELS)[1:]:
        if any(_lost(draw(float(level), rng)) for _ in range(DRAWS)):
            broken = float(level)
            break
    return Tolerance(
        kind=f"pose {kind}",
        unit=unit,
        promised=promised,
        broken_at=broken,
        note=poses.reason,
        draw=draw,
    )


def _largest(
    ask: Ask, start: float, ceiling: float
) -> tuple[float, list[tuple[float, FloatArray]]]:
    """The largest size that was proven, and sizes that were not, with the motions that are left."""
    low, high, level = 0.0, np.inf, min(start, ceiling)
    failures: list[tuple[float, FloatArray]] = []
    suspects: tuple[FloatArray, ...] = ()
    while high - low > REL_TOL * high or np.isinf(high):
        verdict = ask(level, suspects)
        if verdict.survives:
            low = level
            if low >= ceiling:
                break
            level = min(2.0 * level, ceiling) if np.isinf(high) else 0.5 * (low + high)
        else:
            high = level
            if verdict.motion is not None:
                failures.append((level, verdict.motion))
                suspects = (*suspects[-1:], verdict.motion[3:])
            level = 0.5 * (low + high)
            if high < LEAST * start:
                break
    return low, failures


def _breaks(spoil: Spoil, motion: FloatArray, low: float, high: float) -> float | None:
    """The smallest error against a motion for which closure is lost, as far as bisection finds."""
    if not _lost(spoil(high, motion)):
        return None
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        if _lost(spoil(middle, motion)):
            high = middle
        else:
            low = middle
    return high


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


def _each_weaker(contacts: ContactSet, drop: float, rng: np.random.Generator) -> ContactSet:
    """Each contact loses up to a share of its friction, half of the draws all of that share."""
    n = len(contacts)
    keep = 1.0 - drop * np.where(rng.random(n) < 0.5, 1.0, rng.random(n))
    return contacts.with_friction(keep * contacts.mu, keep * contacts.mu_torsion)
