"""Check random force programmes: pyramids and cones, proofs, every solver (needs clarabel).

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

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Annotated, get_args

import numpy as np
import typer

from benchmarks.bench import Options as Shared
from benchmarks.summary import flat, largest, of, summary, table_data
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
from sim.tables import Row

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


@dataclass(frozen=True, kw_only=True)
class Options(Shared):
    """Programmes."""

    n: Annotated[int, typer.Option("-n", "--number", min=1, help="Programmes.")] = 1000


def cases(options: Options) -> Iterator[Row]:
    """Options: how many programmes of each kind are drawn, from the seed."""
    yield from ({"seed": options.seed, "k": k} for k in range(options.n))


def measure(case: Row) -> Row:
    """One programme: which cones are feasible at what cost, and what each solver returns."""
    contacts, wrench = _draw(case["seed"], case["k"])
    given: ForceArguments = {"wrench": wrench, "max_normal": MAX_NORMAL}
    true_cone: ForceArguments = {**given, "cone": "round"}
    exact = distribute_forces(contacts, **true_cone)
    pyramids = []
    for cone in get_args(Pyramid):
        for sides in SIDES:
            pyramid: ForceArguments = {**given, "cone": cone, "edges": sides}
            answer = distribute_forces(contacts, solver=DEFAULT_SOLVER, **pyramid)
            shown = {"cone": cone, "sides": sides, "holds": answer.found}
            shown["cost"] = answer.cost if answer.found else None
            pyramids.append(shown | {"proven": bool(answer.unresisted_wrench.any())})
    return {
        "contacts": len(contacts),
        "soft": contacts.models[0] == "soft",
        "cone_holds": exact.found,
        "cone_cost": exact.cost if exact.found else None,
        "pyramids": pyramids,
        "solvers": _solved(contacts, given),
    }


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


def _solved(contacts: ContactSet, given: ForceArguments) -> list[Row]:
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
            row |= {"solved": step.balanced}
            if step.balanced:
                unit = np.repeat([1.0, 1.0 / loop.problem.length], 3)
                size = max(1.0, float(np.linalg.norm(unit * wrench)))
                missed = contacts.with_forces(step.forces).wrench() + wrench
                row["violation"] = step.violation / size
                row["missed"] = float(np.abs(unit * missed).max()) / size
            out.append(row)
    return out


def _theory(rows: Sequence[Row]) -> dict[str, int]:
    """Counts of programmes by kind, and of contradictions to theory: 0."""
    every = flat(rows, "pyramids")
    inner = [p for p in every if p["cone"] == "inscribed"]
    outer = [p for p in every if p["cone"] == "circumscribed"]
    pairs = [
        (p, finer)
        for r in rows
        if not r["soft"]
        for p, finer in zip(r["pyramids"], r["pyramids"][1:], strict=False)
        if p["cone"] == finer["cone"] == "inscribed"
    ]
    return {
        "programmes": len(rows),
        "cone holds": sum(r["cone_holds"] for r in rows),
        "inscribed holds, cone does not": sum(p["holds"] and not p["cone_holds"] for p in inner),
        "cone holds, circumscribed does not": sum(
            p["cone_holds"] and not p["holds"] for p in outer
        ),
        "inscribed is cheaper than the cone": sum(
            _dearer(p["cone_cost"], p["cost"]) for p in inner
        ),
        "cone is cheaper than circumscribed": sum(
            _dearer(p["cost"], p["cone_cost"]) for p in outer
        ),
        "lost with twice the sides": sum(p["holds"] and not q["holds"] for p, q in pairs),
        "dearer with twice the sides": sum(_dearer(q["cost"], p["cost"]) for p, q in pairs),
        "pyramids that hold nothing": sum(not p["holds"] for p in every),
        "of them not proven": sum(not p["holds"] and not p["proven"] for p in every),
    }


def _dearer(one: float | None, other: float | None) -> bool:
    """Whether both hold and the first costs more."""
    if one is None or other is None:
        return False
    return one > other * (1 + COST_TOL) + COST_TOL**2


def tables(result: Row) -> Iterator[Row]:
    """Theory, pyramids beside the cone, solvers."""
    rows = [row for row in result["rows"] if not row["error"]]
    counts = [[what, str(n)] for what, n in _theory(rows).items()]
    yield table_data("pyramids and cones", ("what",), ("programmes",), counts)
    pyramids = []
    for p in flat(rows, "pyramids"):
        both = p["cone_cost"] is not None and p["cost"] is not None
        off = abs(p["cost"] / p["cone_cost"] - 1) if both else None
        kind = {"kind": "soft" if p["soft"] else "point", "one": p["cone_holds"] != p["holds"]}
        pyramids.append({**p, **kind, "off": off})
    yield summary(
        "cost beside the cone's",
        sorted(pyramids, key=lambda p: p["kind"]),
        {"kind": "contacts", "cone": "pyramid", "sides": "sides"},
        {
            "compared": of("off", "count", 0),
            "one holds": of("one", "sum", 0),
            # more sides bring soft contacts no nearer to the cone in torsion
            "median %": of("off", digits=3, scale=100.0),
            "90 % below": of("off", 0.9, 3, 100.0),
            "worst %": of("off", "max", 3, 100.0),
        },
    )
    solved = [
        {
            **s,
            "refused": not s["solved"] and not s["exists"],
            "failed": not s["solved"] and s["exists"],
            "hair": s["solved"] and not s["exists"],
        }
        for s in flat(rows, "solvers")
    ]
    counted = {"solved": "solved", "refused": "refused", "failed": "failed", "by a hair": "hair"}
    yield summary(
        f"solvers, {LOOP_SIDES} sides",
        solved,
        {"solver": "solver", "tolerance": "asked N"},
        {
            **{head: of(name, "sum", 0) for head, name in counted.items()},
            "violation N": largest("violation"),
            "missed N": largest("missed"),
        },
    )
