"""Random force programmes: theory of pyramids and cones checked, and solvers compared.

Each programme has two to five contacts on a ball, 30 % of them soft, and a wrench of about 1 N.
Checked are

cone      Feasible with an inscribed pyramid implies feasible with the cone, and that with a
          circumscribed pyramid; costs fall in this order. With point contacts, twice the sides
          stay feasible at no higher cost. A linear programme proves every infeasible pyramid so.
solvers   Every solver at tolerances of 1e-3 and 1e-6 N: solutions are recomputed from the contacts,
          refusals are compared with the linear programme.

Clarabel solves the cones, DAQP the pyramids, HiGHS the proofs: three libraries.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import get_args

import numpy as np
from rich.table import Table

from benchmarks.run import Job, measure
from benchmarks.statistics import median_of, quantile_of
from planner.contacts import ContactSet, Pyramid
from planner.forces import (
    DEFAULT_SOLVER,
    ForceArguments,
    ForceLoop,
    build_force_problem,
    distribute_forces,
    explain_infeasibility,
    solver_names,
)
from planner.spatial import FloatArray
from sim.runner import Check, Runner
from sim.tables import Row, number, table_of

SIDES = (4, 8, 16, 32)
"""Sides of the pyramids (-); each doubles the last, so that its edges are a subset of the next."""

LOOP_SIDES = 8
"""Sides of the pyramids that solvers are compared on (-)."""

TOLERANCES = (1e-3, 1e-6)
"""Tolerances asked of the solvers, N; torques divided by the length."""

RADIUS = 0.03
"""Of the ball, m."""

MAX_NORMAL = 30.0
"""Largest normal force, N; without a limit nearly every programme is feasible with large forces."""

SOFT_SHARE, TORSION = 0.3, 0.005
"""Share of soft contacts (-), and their torsional friction (m)."""

COST_TOL = 1e-5
"""Tolerance (relative) of the order of costs: duality gaps of Clarabel."""


def run_forces(n: int, *, seed: int, runner: Runner) -> Row:
    """Work on n random programmes; Ctrl-C keeps what is done.

    Args:
        n: How many.
        seed: Same seed, same programmes.
        runner: Who works on them.

    Raises:
        NotFoundError: Clarabel is not installed.
    """
    jobs = [_Programme(index=k, seed=seed) for k in range(n)]
    kind = "opposable-bench-forces"
    result = measure(
        runner, _work, jobs, kind=kind, title="solve", lost=_Programme.lost, version=2, seed=seed
    )
    done = [row for row in result["rows"] if not row["error"]]
    return result | {
        "given_up": len(result["rows"]) - len(done),
        "theory": _theory(done),
        "gaps": [
            _gap(soft, cone, sides, done)
            for soft in (False, True)
            for cone in get_args(Pyramid)
            for sides in SIDES
        ],
        "solvers": [
            _solver(name, tolerance, done) for tolerance in TOLERANCES for name in solver_names()
        ],
    }


@dataclass(frozen=True, kw_only=True)
class _Programme(Job):
    """One random force programme; its number and the seed are what is drawn from."""

    seed: int


def _work(job: _Programme, check: Check) -> Row:
    """One programme: which cones are feasible at what cost, and what each solver returns."""
    contacts, wrench = _draw(job.seed, job.index)
    given: ForceArguments = {"wrench": wrench, "max_normal": MAX_NORMAL}
    true_cone: ForceArguments = {**given, "cone": "round"}
    round_answer = distribute_forces(contacts, **true_cone)
    pyramids = []
    for cone in get_args(Pyramid):
        for sides in SIDES:
            pyramid: ForceArguments = {**given, "cone": cone, "edges": sides}
            answer = distribute_forces(contacts, solver=DEFAULT_SOLVER, **pyramid)
            pyramids.append(
                {
                    "cone": cone,
                    "sides": sides,
                    "holds": answer.found,
                    "cost": answer.cost if answer.found else None,
                    "proven": bool(answer.unresisted_wrench.any()),
                }
            )
            check()
    return job.row(
        error="",
        contacts=len(contacts),
        soft=contacts.models[0] == "soft",
        holds=round_answer.found,
        cost=round_answer.cost if round_answer.found else None,
        pyramids=pyramids,
        solvers=_solved(contacts, given, check),
    )


def _draw(seed: int, k: int) -> tuple[ContactSet, FloatArray]:
    """Contacts with normals about 10 degrees off the ball's, and a wrench (6,)."""
    rng = np.random.default_rng([seed, k])
    n = int(rng.integers(2, 6))
    out = rng.normal(size=(n, 3))
    out /= np.linalg.norm(out, axis=1, keepdims=True)
    contacts = ContactSet.from_arrays(
        RADIUS * out,
        -out + 0.15 * rng.normal(size=(n, 3)),
        mu=float(rng.uniform(0.3, 1.0)),
        mu_torsion=TORSION,
        model="soft" if rng.random() < SOFT_SHARE else "point",
    )
    return contacts, rng.normal(size=6) * [1, 1, 1, 0.01, 0.01, 0.01]


def _solved(contacts: ContactSet, given: ForceArguments, check: Check) -> list[Row]:
    """What every solver gives at every tolerance, recomputed from the contacts."""
    wrench = np.asarray(given["wrench"])
    pyramid: ForceArguments = {**given, "edges": LOOP_SIDES}
    exists = explain_infeasibility(build_force_problem(contacts, **pyramid)).feasible
    out = []
    for tolerance in TOLERANCES:
        for name in solver_names():
            loop = ForceLoop(
                contacts,
                solver=name,
                tolerance=tolerance,
                edges=LOOP_SIDES,
                max_normal=MAX_NORMAL,
            )
            step = loop.step(wrench)
            row = {"solver": name, "tolerance": tolerance, "exists": exists}
            row |= {"solved": step.balanced, "violation": None, "missed": None}
            if step.balanced:
                unit = np.repeat([1.0, 1.0 / loop.problem.length], 3)
                size = max(1.0, float(np.linalg.norm(unit * wrench)))
                missed = contacts.with_forces(step.forces).wrench() + wrench
                row["violation"] = step.violation / size
                row["missed"] = float(np.abs(unit * missed).max()) / size
            out.append(row)
            check()
    return out


def _theory(rows: Sequence[Row]) -> Row:
    """Counts of programmes by kind, and of contradictions to theory: 0."""
    inner = [(r, p) for r in rows for p in r["pyramids"] if p["cone"] == "inscribed"]
    outer = [(r, p) for r in rows for p in r["pyramids"] if p["cone"] == "circumscribed"]
    pairs = [
        (p, finer)
        for r in rows
        if not r["soft"]
        for p, finer in zip(r["pyramids"], r["pyramids"][1:], strict=False)
        if p["cone"] == finer["cone"] == "inscribed"
    ]
    every = [p for r in rows for p in r["pyramids"]]
    return {
        "programmes": len(rows),
        "cone holds": sum(r["holds"] for r in rows),
        "inscribed holds, cone does not": sum(p["holds"] and not r["holds"] for r, p in inner),
        "cone holds, circumscribed does not": sum(r["holds"] and not p["holds"] for r, p in outer),
        "inscribed is cheaper than the cone": sum(_dearer(r, p) for r, p in inner),
        "cone is cheaper than circumscribed": sum(_dearer(p, r) for r, p in outer),
        "lost with twice the sides": sum(p["holds"] and not q["holds"] for p, q in pairs),
        "dearer with twice the sides": sum(_dearer(q, p) for p, q in pairs),
        "pyramids that hold nothing": sum(not p["holds"] for p in every),
        "of them not proven": sum(not p["holds"] and not p["proven"] for p in every),
    }


def _dearer(one: Row, other: Row) -> bool:
    """Whether both hold and the first costs more."""
    if not (one["holds"] and other["holds"]):
        return False
    return bool(one["cost"] > other["cost"] * (1 + COST_TOL) + COST_TOL**2)


def _gap(soft: bool, cone: str, sides: int, rows: Sequence[Row]) -> Row:
    """One pyramid beside the cone; more sides bring soft contacts no nearer to it in torsion."""
    pairs = [(r, p) for r in rows if r["soft"] == soft for p in r["pyramids"]]
    mine = [(r, p) for r, p in pairs if (p["cone"], p["sides"]) == (cone, sides)]
    off = [abs(p["cost"] / r["cost"] - 1) for r, p in mine if r["holds"] and p["holds"]]
    return {
        "contacts": "soft" if soft else "point",
        "cone": cone,
        "sides": sides,
        "compared": len(off),
        "held_by_one": sum(r["holds"] != p["holds"] for r, p in mine),
        "cost_median": median_of(off),
        "cost_p90": quantile_of(off, 0.9),
        "cost_worst": max(off, default=None),
    }


def _solver(name: str, tolerance: float, rows: Sequence[Row]) -> Row:
    """One solver at one tolerance, over all programmes."""
    every = [s for r in rows for s in r["solvers"]]
    mine = [s for s in every if (s["solver"], s["tolerance"]) == (name, tolerance)]
    solved = [s for s in mine if s["solved"]]
    return {
        "solver": name,
        "tolerance": tolerance,
        "solved": len(solved),
        "refused": sum(not s["solved"] and not s["exists"] for s in mine),
        "failed": sum(not s["solved"] and s["exists"] for s in mine),
        "only_within_tolerance": sum(not s["exists"] for s in solved),
        "violation": max((s["violation"] for s in solved), default=None),
        "missed": max((s["missed"] for s in solved), default=None),
    }


def force_tables(result: Row) -> list[Table]:
    """What a person sees: theory, pyramids beside the cone, solvers."""
    theory = table_of("pyramids and cones", ("what",), ("programmes",))
    for what, count in result["theory"].items():
        theory.add_row(what, str(count))
    gaps = table_of(
        "cost beside the cone's",
        ("contacts", "pyramid"),
        ("sides", "compared", "one holds", "median %", "90 % below", "worst %"),
    )
    for contacts, cone, *counts in ([*g.values()] for g in result["gaps"]):
        costs = (number(cost, 3, 100.0) for cost in counts[3:])
        gaps.add_row(contacts, cone, *map(str, counts[:3]), *costs)
    solvers = table_of(
        f"solvers, {LOOP_SIDES} sides",
        ("solver",),
        ("asked N", "solved", "refused", "failed", "by a hair", "violation N", "missed N"),
    )
    for name, tolerance, *counts in ([*s.values()] for s in result["solvers"]):
        sizes = ("-" if size is None else f"{size:.1e}" for size in counts[4:])
        solvers.add_row(name, f"{tolerance:g}", *map(str, counts[:4]), *sizes)
    return [theory, gaps, solvers]
