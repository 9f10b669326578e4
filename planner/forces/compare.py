"""Solvers side by side on one sequence of force programmes, and pyramids beside the round cone.

Every solver walks through the same wrenches in a ``ForceLoop``: one structure, the workspace kept,
each step started from the last. What is reported was measured or recomputed here: time per step
with and without the Python around the solver, violation of rows and bounds, stationarity of the
multipliers, distance from the exact answer, and failures. A refusal counts as a failure unless a
linear programme, which shares nothing with the solver, finds no forces either.

How far the answers of friction pyramids are from the round cone's, by the number of sides.

A pyramid with k sides has between cos(pi/k) (inscribed) and 1 (or between 1 and 1/cos(pi/k),
circumscribed) of the sliding friction, so 1 - cos(pi/k) bounds what an inscribed one loses where
there is no torsion: 50 % at 3 sides, 7.6 % at 8, 1.9 % at 16. Inscribed answers cost at least what
the cone's costs, circumscribed ones at most that.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any, Unpack, get_args

import numpy as np
from numpy.typing import ArrayLike

from planner.contacts import ContactSet, Pyramid
from planner.errors import ContactError
from planner.forces.build import ForceArguments, LimitArguments, build_force_problem
from planner.forces.infeasible import explain_infeasibility
from planner.forces.loop import STEP_TOL, ForceLoop
from planner.forces.solve import distribute_forces
from planner.joints.actuation import Actuation
from planner.numerics.qp import DEFAULT_SOLVER, solver_names
from planner.spatial import FloatArray

PUSH_SHARE = 0.5
"""Greatest pulsating push, in units of the turning force (-)."""

TURNS = 12
"""Turns about the vertical while the force goes from pole to pole (-)."""

PULSES = 25
"""Pulses of the push over the sequence (-)."""


@dataclass(frozen=True, kw_only=True)
class SolverRecord:
    """One solver on the sequence; times in microseconds, residuals in N.

    Attributes:
        solver: Its name.
        solved: Steps whose answer is within tolerance.
        refused: Steps without forces, that it refused.
        failed: Steps with forces, that it missed.
        median_us, p99_us: Wall time of a step, all Python included, over the steps it solved.
        solver_median_us: Of that, the solver and its interface.
        iterations: Mean of its iterations, NaN where it does not say.
        primal: Greatest violation of a row or bound among its answers.
        dual: Greatest residual of stationarity and of the multipliers' signs; NaN where it gives no
            multipliers.
        off: Greatest distance of a force component from the default solver's exact answer.
    """

    solver: str
    solved: int
    refused: int
    failed: int
    median_us: float
    p99_us: float
    solver_median_us: float
    iterations: float
    primal: float
    dual: float
    off: float


@dataclass(frozen=True, kw_only=True)
class SolverComparison:
    """Records of all solvers on one sequence.

    Attributes:
        records: One per solver.
        steps: Programmes in the sequence.
        unknowns, rows: Size of a programme; bounds are rows too.
        tolerance: Asked for, N, torques divided by the length.
    """

    records: tuple[SolverRecord, ...]
    steps: int
    unknowns: int
    rows: int
    tolerance: float

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        return asdict(self)

    def __str__(self) -> str:
        """A table."""
        lines = [
            f"{self.steps} programmes of {self.unknowns} unknowns and {self.rows} rows, "
            f"tolerance {self.tolerance:g} N",
            f"{'solver':<10}{'solved':>8}{'refused':>9}{'failed':>8}{'median us':>11}{'99 % us':>9}"
            f"{'in solver':>11}{'iter':>7}{'primal':>10}{'dual':>10}{'off N':>10}",
        ]
        for r in self.records:
            lines.append(
                f"{r.solver:<10}{r.solved:>8}{r.refused:>9}{r.failed:>8}{r.median_us:>11.0f}"
                f"{r.p99_us:>9.0f}{r.solver_median_us:>11.0f}{r.iterations:>7.1f}{r.primal:>10.1e}"
                f"{r.dual:>10.1e}{r.off:>10.1e}"
            )
        return "\n".join(lines)


def turning_wrenches(force: float, arm: float, steps: int) -> FloatArray:
    """Wrenches (steps, 6): a force that turns through all directions, and a pulsating push.

    The force goes from pole to pole on a spiral; the push, at most ``PUSH_SHARE`` of it, points
    along x and acts ``arm`` above the centre.

    Args:
        force: Size of the turning force, N, for example the weight.
        arm: Lever of the push, m.
        steps: How many.

    Raises:
        ContactError: Fewer than one step, or a force or arm that is not finite.
    """
    if steps < 1 or not np.isfinite([force, arm]).all():
        raise ContactError(
            f"force {force} N, arm {arm} m, {steps} steps; give finite numbers and at least 1 step"
        )
    s = (np.arange(steps) + 0.5) / steps
    up, around = np.pi * (s - 0.5), 2 * np.pi * TURNS * s
    direction = np.stack(
        [np.cos(up) * np.cos(around), np.cos(up) * np.sin(around), np.sin(up)], axis=1
    )
    push = PUSH_SHARE * force * np.sin(2 * np.pi * PULSES * s) ** 2
    wrenches = np.zeros((steps, 6))
    wrenches[:, :3] = force * direction
    wrenches[:, 0] += push
    wrenches[:, 4] = arm * push
    return wrenches


def compare_solvers(
    contacts: ContactSet,
    wrenches: ArrayLike,
    *,
    solvers: Sequence[str] | None = None,
    tolerance: float = STEP_TOL,
    period: float = 0.0,
    jacobians: FloatArray | None = None,
    actuation: Actuation | None = None,
    q: FloatArray | None = None,
    gravity_torque: FloatArray | None = None,
    **limits: Unpack[LimitArguments],
) -> SolverComparison:
    """Run solvers over wrenches (m, 6), N and N m, with the contacts where they are.

    Args:
        contacts: n contacts.
        wrenches: External wrenches, in the order of time.
        solvers: Names; None for all that are installed.
        tolerance: Of every solver, N, torques divided by the length.
        period: Time from one step to the next, s; a loop that waits finds its caches cold. 0 for
            one after the other.
        jacobians: (n, 3 or 6, nv).
        actuation: Limits the joint torques.
        q: Joints (nv,).
        gravity_torque: (nv,), N m.
        **limits: As for ``ForceLoop``.

    Raises:
        ContactError: The arguments do not fit together.
        NotFoundError: A solver is not installed.
    """
    rows = np.array(wrenches, dtype=np.float64).reshape(-1, 6)
    joints = 0 if jacobians is None else jacobians.shape[2]
    state: dict[str, Any] = {"jacobians": jacobians, "q": q, "gravity_torque": gravity_torque}
    exist: dict[int, bool] = {}

    def forces_exist(step: int) -> bool:
        if step not in exist:
            problem = build_force_problem(
                contacts, wrench=rows[step], actuation=actuation, **limits, **state
            )
            exist[step] = explain_infeasibility(problem).feasible
        return exist[step]

    def walk(solver: str, exact: FloatArray | None) -> tuple[SolverRecord, FloatArray, ForceLoop]:
        loop = ForceLoop(
            contacts,
            solver=solver,
            tolerance=tolerance,
            joints=joints,
            actuation=actuation,
            **limits,
        )
        forces = np.full((len(rows), len(contacts), 4), np.nan)
        total, inside, turns = (np.full(len(rows), np.nan) for _ in range(3))
        primal, dual = np.full(len(rows), np.nan), np.full(len(rows), np.nan)
        due = time.perf_counter()
        for i, wrench in enumerate(rows):
            due = _wait(due + period)
            r = loop.step(wrench, **state)
            if r.balanced:
                forces[i], primal[i] = r.forces, r.violation
                total[i], inside[i] = 1e6 * r.total_s, 1e6 * r.solver_s
                turns[i] = r.iterations if r.iterations >= 0 else np.nan
                dual[i] = loop.qp.dual_residual(loop.solver.x, loop.solver.duals)
        solved = np.isfinite(primal)
        failed = sum(forces_exist(int(i)) for i in np.flatnonzero(~solved))
        timed = solved & (np.arange(len(rows)) > 0)  # the first step sets the solver up
        off = np.nan if exact is None else _most(np.abs(forces - exact))
        record = SolverRecord(
            solver=solver,
            solved=int(solved.sum()),
            refused=int((~solved).sum()) - failed,
            failed=failed,
            median_us=_percentile(total[timed], 50),
            p99_us=_percentile(total[timed], 99),
            solver_median_us=_percentile(inside[timed], 50),
            iterations=float(turns[timed].mean()) if timed.any() else np.nan,
            primal=_most(primal),
            dual=_most(dual),
            off=off,
        )
        return record, forces, loop

    _, exact, loop = walk(DEFAULT_SOLVER, None)
    names = solver_names() if solvers is None else tuple(solvers)
    records = tuple(walk(name, exact)[0] for name in names)
    return SolverComparison(
        records=records,
        steps=len(rows),
        unknowns=len(loop.qp.q),
        rows=int(np.isfinite(loop.qp.limits).any(axis=0).sum()),
        tolerance=tolerance,
    )


def _wait(due: float) -> float:
    """Wait until a time on the clock of ``perf_counter``; that, or now if it has gone by."""
    now = time.perf_counter()
    if due <= now:
        return now
    time.sleep(due - now)
    return due


def _percentile(values: FloatArray, share: float) -> float:
    return float(np.percentile(values, share)) if len(values) else np.nan


def _most(values: FloatArray) -> float:
    """Greatest of the finite values, NaN if there is none."""
    known = values[np.isfinite(values)]
    return float(known.max()) if known.size else np.nan


SIDES = (3, 4, 6, 8, 12, 16, 32)
"""Numbers of sides that are compared unless others are given."""


@dataclass(frozen=True, kw_only=True)
class PyramidGap:
    """Answers of one pyramid beside those of the cone, over the wrenches that both hold.

    Attributes:
        cone: "inscribed" or "circumscribed".
        edges: Sides k.
        compared: Wrenches that pyramid and cone hold.
        cone_only: Wrenches that the cone holds and the pyramid does not.
        pyramid_only: Wrenches that the pyramid holds and the cone does not.
        median_N, worst_N: Greatest change of a force component per wrench, N; NaN if none compared.
        median_cost, worst_cost: Change of the cost, relative; > 0 above the cone's.
    """

    cone: Pyramid
    edges: int
    compared: int
    cone_only: int
    pyramid_only: int
    median_N: float
    worst_N: float
    median_cost: float
    worst_cost: float


def cone_gaps(
    contacts: ContactSet,
    wrenches: ArrayLike,
    *,
    sides: Sequence[int] = SIDES,
    **arguments: Unpack[ForceArguments],
) -> tuple[PyramidGap, ...]:
    """Compare pyramids with the cone on wrenches (m, 6), N and N m.

    Args:
        contacts: n contacts.
        wrenches: External wrenches, one programme each.
        sides: Numbers of sides.
        **arguments: As for ``build_force_problem``; ``wrench``, ``cone``, ``edges`` are not read.

    Raises:
        ContactError: The arguments do not fit together.
        NotFoundError: Clarabel is not installed.
    """
    rows = np.asarray(wrenches, dtype=np.float64).reshape(-1, 6)
    exact = []
    for wrench in rows:
        given: ForceArguments = {**arguments, "wrench": wrench, "cone": "round"}
        exact.append(distribute_forces(contacts, **given))
    out = []
    for cone in get_args(Pyramid):
        for edges in sides:
            moved, dearer, cone_only, pyramid_only = [], [], 0, 0
            for wrench, best in zip(rows, exact, strict=True):
                given = {**arguments, "wrench": wrench, "cone": cone, "edges": edges}
                answer = distribute_forces(contacts, solver=DEFAULT_SOLVER, **given)
                cone_only += best.found and not answer.found
                pyramid_only += answer.found and not best.found
                if best.found and answer.found:
                    moved.append(float(np.abs(answer.forces - best.forces).max(initial=0.0)))
                    dearer.append(answer.cost / best.cost - 1.0 if best.cost else 0.0)
            out.append(
                PyramidGap(
                    cone=cone,
                    edges=edges,
                    compared=len(moved),
                    cone_only=cone_only,
                    pyramid_only=pyramid_only,
                    median_N=float(np.median(moved)) if moved else np.nan,
                    worst_N=max(moved, default=np.nan),
                    median_cost=float(np.median(dearer)) if dearer else np.nan,
                    worst_cost=max(dearer, key=abs, default=np.nan),
                )
            )
    return tuple(out)
