"""What each row of a motion's residuals is about: told by the unknowns that it depends on.

Least squares keep no names. Rows stand in an order, knot by knot: clearances, equalities, then the
inequalities that are violated. A clearance belongs to the fingers whose joints move it. An
inequality that does not depend on forces is a pad's rim, one that depends on one finger's force
alone is its cone or its least pressure, any other a stop.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from planner.motion.loads import PER_HOLD, PER_LOAD
from planner.motion.residuals import PER_METRE, MotionResiduals
from planner.motion.unknowns import SHARED, TUBE
from planner.spatial import FloatArray
from planner.synthesis.avoid import TERMS
from planner.synthesis.objectives.joint import driving
from planner.synthesis.residuals import WEIGHTS

__all__ = ["Row", "described"]

CLEARANCES = {
    "object": "clearance of {} from the object",
    "table": "clearance of {} from the table",
    "obstacle": "clearance of {} from an obstacle",
    "fingers": "clearance between {}",
}
"""What a term of ``planner.synthesis.avoid`` is about."""


@dataclass(frozen=True, kw_only=True)
class Row:
    """What one row of the residuals is about.

    Attributes:
        what: In words.
        finger: Name of the finger that it concerns first, "" for none.
        knot: Number of the knot.
        weight: Residual of one unit.
        unit: Its unit.
        equality: Whether it is to be zero, else not negative.
    """

    what: str
    finger: str
    knot: int
    weight: float
    unit: str
    equality: bool


def described(residuals: MotionResiduals, z: FloatArray, jacobian: FloatArray) -> list[Row]:
    """All rows of the terms at z but the pull, in their order.

    Args:
        residuals: The residuals.
        z: Unknowns.
        jacobian: What they gave there, dense (m, n).
    """
    problem, tally = residuals.problem, residuals.tally(z)
    u, fingers = problem.unknowns, problem.grasp.fingers
    out: list[Row] = []
    for k, (avoided, others) in enumerate(zip(tally.avoided, tally.terms, strict=True)):
        out += [
            _clearance(residuals, TERMS[number], jacobian[len(out) + i], k)
            for i, number in enumerate(avoided)
        ]
        out += list(_equalities(residuals, k))
        violated = others - sum(1 for row in out if row.equality and row.knot == k)
        start = len(out)
        out += [_inequality(residuals, jacobian[start + i], k) for i in range(violated)]
    for k in range(u.n_knots - 1):
        for finger in fingers:
            row = _row(f"rolling of {finger.name}", [finger.name], k + 1, PER_METRE, "m", True)
            out += [row] * 3
    for i in range(len(out), len(out) + tally.tube):
        k = (int(np.flatnonzero(jacobian[i])[0]) - SHARED) // u.own
        out.append(_row("the tube around the path", [], k, PER_METRE, "m", False))
    for hold, count in zip(problem.holds, tally.holds, strict=True):
        name = fingers[hold.lifted].name
        row = _row(f"closure without {name}", [name], u.n_knots - 1, WEIGHTS["balance"], "-", True)
        out += [row] * count
    used = driving(problem.grasp.hand, problem.grasp.fingers)
    for k, i in tally.loads.tolist():
        if i < len(used):
            name = problem.grasp.hand.actuation.names[used[i]]
            out.append(_row(f"load of actuator {name}", [], k, PER_LOAD, "-", False))
        else:
            name = fingers[i - len(used)].name
            what = f"friction of {name} under the weight"
            out.append(_row(what, [name], k, PER_HOLD, "-", False))
    return out


def _equalities(residuals: MotionResiduals, k: int) -> Iterator[Row]:
    grasp = residuals.problem.grasp
    for term in grasp.formulation.terms:
        if not term.equality:
            continue
        size = term.expression.numel()
        of_fingers = term.name in ("touch", "surface")
        each = size // len(grasp.fingers) if of_fingers else size
        for i in range(size):
            name = grasp.fingers[i // each].name if of_fingers else ""
            what = f"{term.name} of {name}" if name else term.name
            fingers = [name] if name else []
            yield _row(what, fingers, k, WEIGHTS[term.name], term.unit, True)


def _clearance(residuals: MotionResiduals, name: str, row: FloatArray, k: int) -> Row:
    fingers = _fingers_of(residuals, row, k)
    what = CLEARANCES[name].format(" and ".join(fingers) or "palm or wrist")
    unit = "m2" if name == "fingers" else "m"
    return _row(what, fingers, k, WEIGHTS[name], unit, False)


def _inequality(residuals: MotionResiduals, row: FloatArray, k: int) -> Row:
    u, fingers = residuals.problem.unknowns, _fingers_of(residuals, row, k)
    forces = row[u.columns(k)][TUBE + u.grasp.n_joints :].reshape(2, -1, 3)[1]
    pressed = np.flatnonzero(np.abs(forces).max(axis=1))
    if not len(pressed):
        what = f"{fingers[0] if fingers else 'a finger'} at the rim of its pad"
        return _row(what, fingers, k, WEIGHTS["facing"], "-", False)
    if fingers:
        return _row("a stop that can only push", fingers, k, WEIGHTS["stop"], "-", False)
    name = residuals.problem.grasp.fingers[int(pressed[0])].name
    what = f"force of {name} at the edge of its cone, or at its least"
    return _row(what, [name], k, WEIGHTS["cone"], "-", False)


def _fingers_of(residuals: MotionResiduals, row: FloatArray, k: int) -> list[str]:
    """Names of the fingers whose joints at knot k a row (n,) depends on."""
    u = residuals.problem.unknowns
    moves = np.flatnonzero(row[u.columns(k)][TUBE : TUBE + u.grasp.n_joints])
    hand = residuals.problem.grasp.hand
    return [f.name for f in hand.fingers.values() if np.isin(f.q_index, moves).any()]


def _row(what: str, fingers: list[str], knot: int, weight: float, unit: str, equality: bool) -> Row:
    return Row(
        what=what,
        finger=fingers[0] if fingers else "",
        knot=knot,
        weight=weight,
        unit=unit,
        equality=equality,
    )
