"""Why no contact forces exist: linear programmes on the very constraints of a ``ForceProblem``.

They share nothing with the solver of the quadratic programme (HiGHS solves them), so a failure of
that solver and a task that cannot be done are told apart:

    phase 1     min |r|_1   with  G f + wrench = r  and every other constraint
    fraction    max s <= 1  with  G f + s wrench = 0  and every other constraint

|r|_1 counts torque divided by the problem's length. r = 0 if and only if forces exist; else r is
the part of the wrench that is left over. Where the other constraints contradict each other (a grip
that the actuators cannot produce), r is the whole wrench and the missing joint torque is minimised
instead. The multipliers of phase 1 prove it, and name the limits that stand in the way. Multipliers
are not unique: where two limits would each do, one is named.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from planner.forces.outlines import outlined
from planner.forces.problem import RESIDUAL_TOL, ForceProblem
from planner.numerics.programme import programme
from planner.spatial import FloatArray, IntArray

__all__ = ["FEASIBLE", "Infeasibility", "explain_infeasibility"]

MULTIPLIER_TOL = 1e-7
"""Multipliers above this (-) name a limit; those of the unbalanced part are about 1."""

LISTED = 6
"""Limits that the sentence names; ``Infeasibility.limits`` has them all."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Infeasibility:
    """The independent verdict on a force problem.

    Attributes:
        feasible: Whether forces exist, within the tolerance of ``RESIDUAL_TOL``.
        wrench: (6,), part of the wrench that cannot be resisted, N and N m; 0 if feasible.
        fraction: Largest s in [0, 1] such that s times the wrench can be resisted (-); 0 if none
            can, not even nothing at all.
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
    programme = _Programme(problem)
    result = programme.least_unbalanced(np.arange(6))
    if result is None:
        limits = programme.contradiction()
        return Infeasibility(
            feasible=False,
            wrench=wrench,
            fraction=0.0,
            limits=limits,
            reason="whatever the wrench, the hand's limits contradict each other" + _list(limits),
        )
    if result.cost <= RESIDUAL_TOL:
        return FEASIBLE
    left, fraction = programme.unbalanced(result), programme.fraction()
    limits = programme.limits(result)
    return Infeasibility(
        feasible=False,
        wrench=left,
        fraction=fraction,
        limits=limits,
        reason=(
            f"no contact forces balance {_words(wrench)}: {_words(left)} is left over, and at best "
            f"{100 * fraction:.3g} % of the wrench is resisted" + _list(limits)
        ),
    )


def _words(wrench: FloatArray) -> str:
    force, torque = (", ".join(f"{v:.3g}" for v in part) for part in np.split(wrench + 0.0, 2))
    return f"[{force}] N, [{torque}] N m"


def _list(limits: tuple[str, ...]) -> str:
    more = len(limits) - LISTED
    tail = f"; and {more} more" if more > 0 else ""
    return f"; in the way: {'; '.join(limits[:LISTED])}{tail}" if limits else ""


@dataclass(frozen=True, kw_only=True, eq=False)
class _Solved:
    """A solution of phase 1 and its multipliers: change of the cost per unit of each limit."""

    cost: float
    x: FloatArray
    equality_prices: FloatArray
    face_prices: FloatArray
    bound_prices: FloatArray


class _Programme:
    """A force problem in units of its own force scale and length."""

    def __init__(self, problem: ForceProblem) -> None:
        """Scale its rows and columns."""
        self.problem = problem
        unit, scale = problem.column_scale, problem.force_scale
        self.rows = problem.row_scale[:, None] * problem.equality * unit
        self.values = problem.row_scale * problem.equality_value / scale
        self.faces = problem.faces * unit
        self.bounds = np.stack([problem.lower, problem.upper], axis=1) / (scale * unit)[:, None]

    def least_unbalanced(self, relaxed: IntArray, first: int = 0) -> _Solved | None:
        """Least sum of absolute residuals of the ``relaxed`` rows; rows before ``first`` are off.

        Returns:
            A solution, or None where the other constraints have none.
        """
        kept = np.arange(first, len(self.rows))
        slack = (kept[:, None] == relaxed).astype(float)
        return self._solve(
            np.ones(2 * len(relaxed)),
            np.hstack([self.rows[kept], -slack, slack]),
            self.values[kept],
            np.tile([0.0, np.inf], (2 * len(relaxed), 1)),
        )

    def contradiction(self) -> tuple[str, ...]:
        """Limits that leave joint torques unbalanced even if the wrench does not matter."""
        result = self.least_unbalanced(np.arange(6, len(self.rows)), first=6)
        return () if result is None else self.limits(result)

    def unbalanced(self, result: _Solved) -> FloatArray:
        """G f + wrench (6,) of a solved phase 1, N and N m; rounding is taken off."""
        plus, minus = np.split(result.x[len(self.bounds) :], 2)
        left = np.where(np.abs(plus - minus) > RESIDUAL_TOL, plus - minus, 0.0)
        return np.asarray(left * self.problem.force_scale / self.problem.row_scale[:6])

    def fraction(self) -> float:
        """Largest share of the wrench that can be resisted."""
        wrench = np.where(np.arange(len(self.rows)) < 6, self.values, 0.0)  # minus the wrench
        rows = np.column_stack([self.rows, -wrench])
        result = self._solve(np.array([-1.0]), rows, self.values - wrench, np.array([[0.0, 1.0]]))
        return 0.0 if result is None else max(0.0, float(result.x[-1]))

    def limits(self, result: _Solved) -> tuple[str, ...]:
        """Names of what has a multiplier: joints, actuators, stops, normal bounds, friction."""
        problem, n, first = self.problem, len(self.bounds), self.problem.n_force
        low = result.bound_prices[:n] > MULTIPLIER_TOL
        high = result.bound_prices[:n] < -MULTIPLIER_TOL
        # Torque rows are the last ones, with and without the balance before them.
        rows = np.abs(result.equality_prices)[::-1][: len(problem.joints)][::-1] > MULTIPLIER_TOL
        drive = problem.equality[6:, first:] != 0
        free = np.flatnonzero(rows & ~(drive & (low | high)[first:]).any(axis=1))
        named = []
        if len(free):
            joints = ", ".join(problem.equality_names[6 + i] for i in free)
            named.append(f"no actuator or stop supplies that share of {joints}")
        columns = np.flatnonzero(low | high)
        for j in [*columns[columns >= first], *columns[columns < first]]:
            bound = problem.lower[j] if low[j] else problem.upper[j]
            named.append(self._bound_in_words(int(j), bool(low[j]), float(bound)))
        faces = np.flatnonzero(np.abs(result.face_prices) > MULTIPLIER_TOL)
        return tuple(dict.fromkeys([*named, *(problem.face_names[j] for j in faces)]))

    def _bound_in_words(self, column: int, at_lower: bool, bound: float) -> str:
        problem = self.problem
        name = problem.column_names[column]
        if column >= problem.n_drive:  # an excess that would have to be below 0
            return f"friction of {name.rsplit(' ', 1)[0]}"
        which = "least" if at_lower else "greatest"
        if column >= problem.n_force + len(problem.actuators):
            return f"{name} only pushes"
        if column >= problem.n_force:
            return f"{name} at its {which} force {bound:.3g} N m"
        contact = name.rsplit(" ", 1)[0]
        if not name.endswith("f_n"):
            return f"no friction at {contact}"
        if bound == 0.0:
            return f"{contact} can only push"
        return f"{which} normal force {bound:.3g} N at {contact}"

    def _solve(
        self,
        slack_cost: FloatArray,
        rows: FloatArray,
        values: FloatArray,
        slack_bounds: FloatArray,
    ) -> _Solved | None:
        """A solution, None where the constraints have none."""
        free, n_faces = len(slack_cost), len(self.faces)
        bounds = np.vstack([self.bounds, slack_bounds])
        table = np.vstack([rows, np.hstack([self.faces, np.zeros((n_faces, free))])])
        cost = np.concatenate([np.zeros(len(self.bounds)), slack_cost])
        solver = programme("highs", len(cost), len(table))
        x = solver.solve(
            g=cost,
            a=table,
            lba=np.concatenate([values, np.full(n_faces, -np.inf)]),
            uba=np.concatenate([values, np.zeros(n_faces)]),
            lbx=bounds[:, 0],
            ubx=bounds[:, 1],
        )
        if x is None:
            return None
        equalities, faces = np.split(solver.row_prices, [len(values)])
        return _Solved(
            cost=float(cost @ x),
            x=x,
            equality_prices=equalities,
            face_prices=faces,
            bound_prices=solver.bound_prices,
        )
