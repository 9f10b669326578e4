"""Why no contact forces exist: linear programmes on the very rows of a ``ForceProblem``.

They share nothing with the solver of the quadratic programme (``planner.numerics.lp``), so a
failure of that solver and a task that cannot be done are told apart:

    phase 1     min |r|_1   with  G f + wrench = r  and every other row and bound
    fraction    max s <= 1  with  G f + s wrench = 0  and every other row and bound

|r|_1 counts torque divided by the problem's length. r = 0 if and only if forces exist; else r is
the part of the wrench that is left over. Where the other limits contradict each other (a grip that
the actuators cannot produce), r is the whole wrench and the missing joint torque is minimised
instead. The multipliers of phase 1 prove it, and name the limits that stand in the way. Multipliers
are not unique: where two limits would each do, one is named.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from planner.contacts.friction import outline_faces
from planner.forces.problem import RESIDUAL_TOL, ForceProblem
from planner.numerics.lp import NOT_KNOWN, LpAnswer, LpSolution, solve_lp
from planner.spatial import FloatArray, IntArray

MULTIPLIER_TOL = 1e-7
"""Multipliers above this (-) name a limit; those of the unbalanced part are about 1."""

LISTED = 6
"""Limits that the sentence names; ``Infeasibility.limits`` has them all."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Infeasibility:
    """The independent verdict on a force problem.

    Attributes:
        feasible: Whether forces exist, within the tolerance of ``RESIDUAL_TOL``; False too where
            that is not known.
        wrench: (6,), part of the wrench that cannot be resisted, N and N m; 0 if feasible, NaN
            where that is not known.
        fraction: Largest s in [0, 1] such that s times the wrench can be resisted (-); 0 if none
            can, not even nothing at all; NaN where that is not known.
        limits: Names of the limits that stand in the way.
        reason: The verdict in words, "" if feasible.
    """

    feasible: bool
    wrench: FloatArray
    fraction: float
    limits: tuple[str, ...]
    reason: str


FEASIBLE = Infeasibility(feasible=True, wrench=np.zeros(6), fraction=1.0, limits=(), reason="")
"""The verdict where forces exist."""

UNDECIDED = Infeasibility(
    feasible=False,
    wrench=np.full(6, np.nan),
    fraction=np.nan,
    limits=(),
    reason="whether there are contact forces is not known: the solver found none, and no linear "
    "programme decides it",
)
"""The verdict where nothing is proven."""


def explain_infeasibility(problem: ForceProblem) -> Infeasibility:
    """Decide whether forces exist and, if not, what is left over and why.

    Round cones are judged by pyramids around and inside them. A problem between the two is called
    infeasible, with a reason that says so.
    """
    if problem.cone_sizes:
        outer = explain_infeasibility(outlined(problem, inner=False))
        if not outer.feasible:
            return outer
        inner = explain_infeasibility(outlined(problem, inner=True))
        if inner.feasible:
            return inner
        hair = "forces exist by a hair or not at all: pyramids inside the cones have none"
        return replace(inner, reason=f"{hair}, pyramids around them have; inside, {inner.reason}")
    wrench = problem.wrench
    if not problem.column_names:
        if problem.residuals(np.zeros(0)).worst <= RESIDUAL_TOL * problem.force_scale:
            return FEASIBLE
        reason = f"there are no contacts to balance {_words(wrench)}"
        return Infeasibility(feasible=False, wrench=wrench, fraction=0.0, limits=(), reason=reason)
    phase = _Phase1(problem)
    result = phase.least_unbalanced(np.arange(6))
    if result is NOT_KNOWN:
        return UNDECIDED
    if result is None:
        limits = phase.contradiction()
        return Infeasibility(
            feasible=False,
            wrench=wrench,
            fraction=0.0,
            limits=limits,
            reason="whatever the wrench, the hand's limits contradict each other" + _list(limits),
        )
    if result.value <= RESIDUAL_TOL:
        return FEASIBLE
    left, fraction = phase.unbalanced(result), phase.fraction()
    share = f"at best {100 * fraction:.3g} % of the wrench is resisted"
    if np.isnan(fraction):
        share = "which share of the wrench is resisted at best is not known"
    limits = phase.limits(result)
    return Infeasibility(
        feasible=False,
        wrench=left,
        fraction=fraction,
        limits=limits,
        reason=(
            f"no contact forces balance {_words(wrench)}: {_words(left)} is left over, and "
            f"{share}" + _list(limits)
        ),
    )


def outlined(problem: ForceProblem, *, inner: bool) -> ForceProblem:
    """The problem with fine pyramids around or inside its round cones in their place."""
    faces, names, start = [problem.rows[: 6 + problem.n_faces]], list[str](), 0
    for size, name in zip(problem.cone_sizes, problem.cone_names, strict=True):
        faces.append(outline_faces(size, inner=inner) @ problem.cones[start : start + size])
        names += [name] * len(faces[-1])
        start += size
    m, at = len(names), 6 + problem.n_faces
    return replace(
        problem,
        rows=np.vstack([*faces, problem.rows[at:]]),
        low=np.insert(problem.low, at, np.full(m, -np.inf)),
        high=np.insert(problem.high, at, np.zeros(m)),
        row_scale=np.insert(problem.row_scale, at, np.ones(m)),
        row_names=(*problem.row_names[:at], *names, *problem.row_names[at:]),
        n_faces=problem.n_faces + m,
        cones=problem.cones[:0],
        cone_sizes=(),
        cone_names=(),
    )


def _words(wrench: FloatArray) -> str:
    force, torque = (", ".join(f"{v:.3g}" for v in part) for part in np.split(wrench + 0.0, 2))
    return f"[{force}] N, [{torque}] N m"


def _list(limits: tuple[str, ...]) -> str:
    more = len(limits) - LISTED
    tail = f"; and {more} more" if more > 0 else ""
    return f"; in the way: {'; '.join(limits[:LISTED])}{tail}" if limits else ""


class _Phase1:
    """A force problem in units of its own force scale and length."""

    def __init__(self, problem: ForceProblem) -> None:
        """Scale its rows and columns."""
        self.problem = problem
        qp = problem.dense_qp(problem.force_scale)
        self.rows, self.limits_of_rows = qp.a, np.column_stack([qp.low, qp.high])
        self.bounds = np.column_stack([qp.lower, qp.upper])

    def least_unbalanced(self, relaxed: IntArray, first: int = 0) -> LpAnswer:
        """Least sum of absolute violations of the ``relaxed`` rows; rows before ``first`` are off.

        Returns:
            A solution, None where the other limits have none, or ``NOT_KNOWN``.
        """
        kept = np.arange(first, len(self.rows))
        slack = (kept[:, None] == relaxed).astype(float)
        return solve_lp(
            np.concatenate([np.zeros(len(self.bounds)), np.ones(2 * len(relaxed))]),
            np.hstack([self.rows[kept], -slack, slack]),
            self.limits_of_rows[kept],
            np.vstack([self.bounds, np.tile([0.0, np.inf], (2 * len(relaxed), 1))]),
        )

    def contradiction(self) -> tuple[str, ...]:
        """Limits that leave joint torques unbalanced even if the wrench does not matter."""
        first = 6 + self.problem.n_faces
        result = self.least_unbalanced(np.arange(first, len(self.rows)), first=6)
        return self.limits(result) if isinstance(result, LpSolution) else ()

    def unbalanced(self, result: LpSolution) -> FloatArray:
        """G f + wrench (6,) of a solved phase 1, N and N m; rounding is taken off."""
        plus, minus = np.split(result.x[len(self.bounds) :], 2)
        left = np.where(np.abs(plus - minus) > RESIDUAL_TOL, plus - minus, 0.0)
        return np.asarray(left * self.problem.force_scale / self.problem.row_scale[:6])

    def fraction(self) -> float:
        """Largest share of the wrench that can be resisted."""
        balance = np.where(np.arange(len(self.rows)) < 6, self.limits_of_rows[:, 0], 0.0)
        found = solve_lp(
            np.append(np.zeros(len(self.bounds)), -1.0),
            np.column_stack([self.rows, -np.where(np.isfinite(balance), balance, 0.0)]),
            np.vstack([np.zeros((6, 2)), self.limits_of_rows[6:]]),
            np.vstack([self.bounds, [0.0, 1.0]]),
        )
        if found is NOT_KNOWN:
            return float("nan")
        return 0.0 if found is None else max(0.0, float(found.x[-1]))

    def limits(self, result: LpSolution) -> tuple[str, ...]:
        """Names of what has a multiplier: torques, normal bounds, friction."""
        problem = self.problem
        mt, nx = len(problem.torque_rows), len(self.bounds)
        duals, ends = result.row_duals[len(result.row_duals) - mt :], result.bound_duals[:nx]
        named = self._torques_in_words(duals)
        columns = np.flatnonzero(np.abs(ends) > MULTIPLIER_TOL)
        first = nx - problem.n_extra
        for j in [*columns[columns >= first].tolist(), *columns[columns < first].tolist()]:
            named.append(self._bound_in_words(j, at_lower=bool(ends[j] > 0)))
        between, first = len(problem.rows) - mt, len(problem.rows) - len(result.row_duals)
        names = problem.row_names[6:between]
        others = result.row_duals[6 - first : between - first]
        named += [names[j] for j in np.flatnonzero(np.abs(others) > MULTIPLIER_TOL)]
        return tuple(dict.fromkeys(named))

    def _torques_in_words(self, duals: FloatArray) -> list[str]:
        """What rows of torque (mt,) with these multipliers ask for, undriven joints first."""
        problem, limits = self.problem, self.problem.torque_limits
        if limits is None:
            return []
        used = np.flatnonzero(np.abs(duals) > MULTIPLIER_TOL)
        rows, case, a = problem.torque_rows[used], limits.case, limits.actuation
        driven = case.made[rows] >= 0
        named = []
        # joints whose torque nothing makes, but for those of an actuator or stop at its limit
        weight = duals[used][~driven] @ case.rows[rows[~driven]]
        at_limit = np.vstack([a.moment, a.stop_rows])[case.made[rows[driven]]].any(axis=0)
        free = np.flatnonzero((np.abs(weight) > MULTIPLIER_TOL) & ~at_limit)
        if len(free):
            joints = ", ".join(f"torque {a.joint_names[j]}" for j in free)
            named.append(f"no actuator or stop supplies that share of {joints}")
        for row, dual in zip(rows[driven], duals[used][driven], strict=True):
            side = int(dual < 0)  # a multiplier > 0 is of the lower limit
            bound = float(limits.made_limits[side, row])
            named.append(self._drive_in_words(int(case.made[row]), side, bound))
        return named

    def _drive_in_words(self, column: int, side: int, bound: float) -> str:
        limits = self.problem.torque_limits
        assert limits is not None
        names = limits.actuation.names
        if column >= len(names):
            return f"{limits.actuation.stop_names[column - len(names)]} only pushes"
        return f"{names[column]} at its {('least', 'greatest')[side]} force {bound:.3g} N m"

    def _bound_in_words(self, column: int, *, at_lower: bool) -> str:
        problem = self.problem
        name = problem.column_names[column]
        bound = float((problem.lower if at_lower else problem.upper)[column])
        first_extra = len(problem.column_names) - problem.n_extra
        if column >= first_extra and problem.torque_limits is not None:
            made = int(problem.torque_limits.case.extra[column - first_extra])
            return self._drive_in_words(made, int(not at_lower), bound)
        contact = name.rsplit(" ", 1)[0]
        if column >= problem.n_force:  # an excess that would have to be below 0
            return f"friction of {contact}"
        if not name.endswith("f_n"):
            return f"no friction at {contact}"
        if bound == 0.0:
            return f"{contact} can only push"
        return f"{'least' if at_lower else 'greatest'} normal force {bound:.3g} N at {contact}"
