"""What limits a path: multipliers of the least squares that pulled it longer.

Where the pull r0 = w (1 - share) and the violated terms r_i balance, least squares are stationary:

    sum_i r_i dr_i/dz = w (w (1 - share)) e_share - (forces of the bounds).

So r_i / (w (1 - share)) is the growth of the share per unit by which the limit behind r_i is
relaxed; the same holds for the force of a bound. Limits are joint ends, pad rims, clearances,
friction cones and the path tolerance, each with its knot.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from planner.failure import Failure
from planner.motion.residuals import MotionResiduals
from planner.motion.terms import REACH
from planner.motion.unknowns import OFFSET, SHARE
from planner.spatial import FloatArray
from planner.synthesis.terms.term import Role

LISTED = 6
"""Largest number of limits in a report."""

AT_BOUND = 1e-9
"""Distance (rad or m) from a bound below which an unknown is on it."""

PER_UNIT = {
    "m": (1e-3, "mm"),
    "rad": (np.pi / 180, "degree"),
    "m2": (1e-6, "mm2"),
    "-": (0.01, "0.01"),
}
"""A step of each unit for reports, and its name."""


@dataclass(frozen=True, kw_only=True)
class Limit:
    """One limit of a path's length.

    Attributes:
        what: In words: a joint and its end, or a term and the finger it concerns.
        finger: Name of the finger, "" for none.
        joint: Name of the joint, "" for none.
        path_parameter: Where on the path, 0 to 1.
        gain: How much longer the path becomes, as a share of what was asked for, when it gives way
            by one ``unit``.
        unit: A millimetre, a degree, a hundredth of a number.
    """

    what: str
    finger: str
    joint: str
    path_parameter: float
    gain: float
    unit: str

    def __str__(self) -> str:
        """One line."""
        return f"{self.what}, at {100 * self.path_parameter:.0f} % of the path"


def what_limits(
    residuals: MotionResiduals, z: FloatArray, lower: FloatArray, upper: FloatArray
) -> tuple[Limit, ...]:
    """The limits that count most where the pull has come to rest, largest gain first.

    Args:
        residuals: With the pull on.
        z: Where least squares ended.
        lower: Least z.
        upper: Largest z.
    """
    r, blocks = residuals(z)
    jacobian = blocks.dense()
    missing = residuals.pull * (1.0 - z[SHARE])
    if missing <= 0.0:
        return ()
    scale = 1.0 / (residuals.pull * missing)
    found = [*_joints(residuals, z, jacobian.T @ r, lower, upper, scale)]
    found += _terms(residuals, r, scale)
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
    """Ends of joints' ranges with a force against them."""
    problem = residuals.problem
    hand, u = problem.grasp.hand, problem.unknowns
    degree, unit = PER_UNIT["rad"]
    for k in range(u.n_knots):
        at = u.columns(k).start + OFFSET
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
                    path_parameter=float(residuals.numbers.path_parameters[k]),
                    gain=abs(float(slope[i])) * scale * degree,
                    unit=unit,
                )


def _terms(residuals: MotionResiduals, r: FloatArray, scale: float) -> Iterator[Limit]:
    """Violated inequalities."""
    fingers = residuals.problem.grasp.hand.fingers
    for row, value in zip(residuals.row_names(), r, strict=True):
        if row.term.role is not Role.INEQUALITY:
            continue
        step, unit = PER_UNIT[row.term.unit]
        yield Limit(
            what=str(row),
            finger=next((name for name in row.about if name in fingers), ""),
            joint="",
            path_parameter=float(residuals.numbers.path_parameters[row.knot]),
            gain=abs(float(value)) * row.term.weight * scale * step,
            unit=unit,
        )


def worst_term(residuals: MotionResiduals, z: FloatArray) -> Failure:
    """The term with the largest weighted residual at z; a failure's kind is that of its term."""
    r, _ = residuals(z)
    rows = [row for row in residuals.row_names()[: residuals.n_terms] if row.term is not REACH]
    k = int(np.abs(r[: len(rows)]).argmax())
    term, place = rows[k].term, float(residuals.numbers.path_parameters[rows[k].knot])
    step, unit = WORDS[term.unit]
    off = abs(float(r[k])) / term.weight
    return Failure(
        kind=f"unsolved_{term.name}",
        text=f"{rows[k]} at {100 * place:.0f} % of the path, off by {off / step:.2g}{unit}",
        numbers={"place": place, "off": off},
    )


WORDS = {"m": (1e-3, " mm"), "rad": (np.pi / 180, " degrees"), "m2": (1e-6, " mm2"), "-": (1.0, "")}
"""For each unit the one in messages, and its name."""
