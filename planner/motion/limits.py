"""What keeps a path from being longer: multipliers of the descent that pulled at it.

Where the pull r0 = w (1 - share) and the violated terms r_i balance, least squares are stationary:

    sum_i r_i dr_i/dz = w (w (1 - share)) e_share - (what bounds push back).

So r_i / (w (1 - share)) tells by how much the share grows when the limit behind r_i gives way by
one of its units, and likewise what a bound pushes back. Named: a joint's end, a pad's rim, a
clearance, a friction cone, the tube; with the knot at which it happens.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from planner.motion.unknowns import SHARE, SHARED, TUBE
from planner.spatial import FloatArray
from planner.synthesis.avoid import TERMS
from planner.synthesis.residuals import WEIGHTS

if TYPE_CHECKING:
    from planner.motion.residuals import MotionResiduals, Tally

__all__ = ["Limit", "what_limits"]

LISTED = 6
"""Limits that are told."""

AT_BOUND = 1e-9
"""Distance from a bound (rad or m) that is none."""

PER_METRE = 1e3
"""Residual of a metre beyond the tube, as in ``planner.motion.residuals``."""

PER_UNIT = {
    "m": (1e-3, "mm"),
    "rad": (np.pi / 180, "degree"),
    "m2": (1e-6, "mm2"),
    "-": (0.01, "0.01"),
}
"""A step of each unit that a person thinks in, and its name."""


@dataclass(frozen=True, kw_only=True)
class Limit:
    """One thing that is in the way.

    Attributes:
        what: In words: a joint and its end, or a term and the finger it concerns.
        finger: Name of the finger, "" for none.
        joint: Name of the joint, "" for none.
        place: Where on the path, 0 to 1.
        gain: How much longer the path becomes, as a share of what was asked for, when it gives way
            by one ``unit``.
        unit: A millimetre, a degree, a hundredth of a number.
    """

    what: str
    finger: str
    joint: str
    place: float
    gain: float
    unit: str

    def __str__(self) -> str:
        """One line."""
        return f"{self.what}, at {100 * self.place:.0f} % of the path"


def what_limits(
    residuals: MotionResiduals, z: FloatArray, lower: FloatArray, upper: FloatArray
) -> tuple[Limit, ...]:
    """The limits that count most where a pull at the path has come to rest, largest gain first.

    Args:
        residuals: With the pull on.
        z: Where a descent ended.
        lower: Least z.
        upper: Largest z.
    """
    r, jacobian = residuals(z)
    missing = residuals.pull * (1.0 - z[SHARE])
    if missing <= 0.0:
        return ()
    scale = 1.0 / (residuals.pull * missing)
    found = [*_joints(residuals, z, jacobian.T @ r, lower, upper, scale)]
    found += _terms(residuals, residuals.tally(z), r, jacobian, scale)
    found.sort(key=lambda limit: -limit.gain)
    best: dict[str, Limit] = {}
    for limit in found:
        best.setdefault(limit.what, limit)
    return tuple(list(best.values())[:LISTED])


def _joints(
    residuals: MotionResiduals,
    z: FloatArray,
    slope: FloatArray,
    lower: FloatArray,
    upper: FloatArray,
    scale: float,
) -> Iterator[Limit]:
    """Ends of joints' ranges that push back."""
    problem = residuals.problem
    hand, u = problem.grasp.hand, problem.unknowns
    degree, unit = PER_UNIT["rad"]
    for k in range(u.n_knots):
        at = u.columns(k).start + TUBE
        for j, name in enumerate(hand.joint_names):
            i = at + j
            if upper[i] <= lower[i]:
                continue
            low = z[i] <= lower[i] + AT_BOUND and slope[i] > 0
            high = z[i] >= upper[i] - AT_BOUND and slope[i] < 0
            if low or high:
                finger = next((f.name for f in hand.fingers.values() if name in f.joints), "")
                yield Limit(
                    what=f"joint {name} at its {'lower' if low else 'upper'} limit",
                    finger=finger,
                    joint=name,
                    place=float(residuals.numbers.places[k]),
                    gain=abs(float(slope[i])) * scale * degree,
                    unit=unit,
                )


def _terms(
    residuals: MotionResiduals, tally: Tally, r: FloatArray, jacobian: FloatArray, scale: float
) -> Iterator[Limit]:
    """Violated inequalities; those of grasps are told by the unknowns that they depend on."""
    problem = residuals.problem
    u, places = problem.unknowns, residuals.numbers.places
    terms = problem.grasp.formulation.terms
    equalities = sum(t.expression.numel() for t in terms if t.equality)
    row = 0
    for k, (avoided, others) in enumerate(zip(tally.avoided, tally.terms, strict=True)):
        for i, number in enumerate(avoided, start=row):
            name = TERMS[number]
            fingers = _fingers_of(residuals, jacobian[i], k)
            what = CLEARANCES[name].format(" and ".join(fingers) or "palm or wrist")
            unit = "m2" if name == "fingers" else "m"
            yield _limit(what, fingers, places[k], r[i] * WEIGHTS[name] * scale, unit)
        row += len(avoided)
        for i in range(row + equalities, row + others):
            own = jacobian[i, u.columns(k)][TUBE:]
            pressed = own[u.grasp.n_joints :].reshape(2, -1, 3)[1]
            which = np.flatnonzero(np.abs(pressed).max(axis=1))
            fingers = _fingers_of(residuals, jacobian[i], k)
            if not len(which):
                what, name = f"{fingers[0]} at the rim of its pad", "facing"
            elif fingers:
                what, name = "a stop that can only push", "stop"
            else:
                fingers = [problem.grasp.fingers[int(which[0])].name]
                what, name = f"force of {fingers[0]} at the edge of its cone", "cone"
            yield _limit(what, fingers, places[k], r[i] * WEIGHTS[name] * scale, "-")
        row += others
    row += tally.rolling
    for i in range(row, row + tally.tube):
        k = (int(np.flatnonzero(jacobian[i])[0]) - SHARED) // u.own
        yield _limit("the tube around the path", [], places[k], r[i] * PER_METRE * scale, "m")


CLEARANCES = {
    "object": "clearance of {} from the object",
    "table": "clearance of {} from the table",
    "fingers": "clearance between {}",
}
"""What a term of ``planner.synthesis.avoid`` is about."""


def _limit(what: str, fingers: list[str], place: float, multiplier: float, unit: str) -> Limit:
    step, name = PER_UNIT[unit]
    return Limit(
        what=what,
        finger=fingers[0] if fingers else "",
        joint="",
        place=float(place),
        gain=abs(float(multiplier)) * step,
        unit=name,
    )


def _fingers_of(residuals: MotionResiduals, row: FloatArray, k: int) -> list[str]:
    """Names of the fingers whose joints at knot k a row (n,) depends on."""
    u = residuals.problem.unknowns
    moves = np.flatnonzero(row[u.columns(k)][TUBE : TUBE + u.grasp.n_joints])
    hand = residuals.problem.grasp.hand
    return [f.name for f in hand.fingers.values() if np.isin(f.q_index, moves).any()]
