"""Commands about contacts and forces of a plan: ``analyse``, ``certify``."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from sim.cli.common import EXIT_NO, out, print_json, refuse_given, tell
from sim.cli.options import (
    JsonOption,
    PlanArgument,
    SeedOption,
    argument,
    command,
    flag,
    names,
    option,
)
from sim.cli.reading import one_plan

if TYPE_CHECKING:
    from planner.forces import ForceSolution, PyramidGap

GAP_WRENCHES = 24
"""Wrenches, evenly out of the sequence, on which pyramids are set beside the cone."""

FORCES = "With --forces"
"""Group of options in the help."""


@command
def analyse(
    context: typer.Context,
    file: Annotated[Path, argument("A plan file or a list of contacts (JSON).", "FILE")],
    forces: Annotated[
        bool, flag("--forces", "The force problem of a plan, and its answer.")
    ] = False,
    solvers: Annotated[
        str | None, option("Compare solvers: all, or daqp,osqp,... by name.", "NAMES", FORCES)
    ] = None,
    steps: Annotated[
        int,
        option("Programmes in the sequence that solvers are compared on.", "N", FORCES, min=1),
    ] = 1000,
    rate: Annotated[
        float | None,
        option("Steps per second of the sequence; at once unless given.", "HZ", FORCES, min=1.0),
    ] = None,
    gaps: Annotated[
        bool, flag("--gaps", "Set pyramids beside the round cone (needs clarabel).", FORCES)
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Force closure, epsilon, min-weight; contact forces.

    With --forces: the force problem of a plan, its answer, and solvers side by side on a sequence:
    the weight turned through all directions, and a pulsating push.

    Exit code 1 without force closure, or with --forces if the forces do not exist, or a solver
    missed forces that do.
    """
    if forces:
        _forces(file, solvers, steps, rate, gaps, as_json)
        return
    refuse_given(context, "only --forces compares solvers", of=("solvers", "steps", "rate", "gaps"))
    from planner.files import read_contacts
    from planner.quality import analyse as analyse_contacts

    contacts, length = read_contacts(file)
    report = analyse_contacts(contacts, length=length)
    if as_json:
        print_json(report.to_dict())
    else:
        out.print(str(report), highlight=False)
    if not report.closure.closed:
        raise typer.Exit(EXIT_NO)


def _forces(
    file: Path,
    solvers: str | None,
    steps: int,
    rate: float | None,
    gaps: bool,
    as_json: bool,
) -> None:
    """The force problem of a plan, and solvers side by side on it."""
    import numpy as np

    from planner.arrays import checked_number
    from planner.errors import TaskError
    from planner.forces import compare_solvers, cone_gaps, distribute_forces, turning_wrenches
    from planner.verification import force_arguments

    checked_number("--rate", 1.0 if rate is None else rate, above=0.0, error=TaskError)
    plan = one_plan(file)
    given: dict[str, Any] = dict(
        force_arguments(plan.task, plan.contacts, plan.T_world_base, plan.q)
    )
    weight = float(np.linalg.norm(given["wrench"][:3]))
    solution = distribute_forces(plan.contacts, **given)
    data: dict[str, Any] = {"found": solution.found, "reason": solution.reason}
    texts = [str(solution.problem), _answer(solution)]
    failed = not solution.found
    wrenches = turning_wrenches(weight, solution.problem.length, steps)
    if solvers is not None:  # a loop has no rows of passive forces: it is for fingertips
        asked = given.keys() - {"wrench", "contact_compliance"}
        report = compare_solvers(
            plan.contacts,
            wrenches,
            solvers=None if solvers == "all" else names(solvers),
            period=1.0 / rate if rate else 0.0,
            **{key: given[key] for key in asked},
        )
        failed = failed or any(r.failed for r in report.records)
        data["solvers"] = report.as_dict()
        texts = [str(report)]
    if gaps:
        some = wrenches[:: max(1, steps // GAP_WRENCHES)]
        table = cone_gaps(plan.contacts, some, **given)
        data["gaps"] = [asdict(gap) for gap in table]
        texts = [*(texts if solvers is not None else []), _gap_table(table)]
    if as_json:
        data["forces"] = solution.forces.tolist() if solution.found else None
        print_json(data)
    else:
        tell("\n\n".join(texts))
    if failed:
        raise typer.Exit(EXIT_NO)


def _answer(solution: ForceSolution) -> str:
    if not solution.found:
        return f"no forces: {solution.reason}"
    shares = solution.contacts.friction_utilisation()
    lines = [
        f"forces found by {solution.solver}, largest residual {solution.residuals.worst:.1e} N"
    ]
    for name, force, share in zip(
        solution.problem.contact_names, solution.forces, shares, strict=True
    ):
        tangential = (force[1:3] ** 2).sum() ** 0.5
        lines.append(
            f"  {name}: normal {force[0]:.3f} N, tangential {tangential:.3f} N, "
            f"{100 * share:.0f} % of the friction"
        )
    return "\n".join(lines)


def _gap_table(gaps: tuple[PyramidGap, ...]) -> str:
    lines = [
        f"{'pyramid':<14}{'sides':>6}{'compared':>10}{'cone only':>11}{'pyramid only':>14}"
        f"{'median N':>10}{'worst N':>9}{'median cost':>13}{'worst cost':>12}"
    ]
    for g in gaps:
        lines.append(
            f"{g.cone:<14}{g.edges:>6}{g.compared:>10}{g.cone_only:>11}{g.pyramid_only:>14}"
            f"{g.median_N:>10.3f}{g.worst_N:>9.3f}{g.median_cost:>+12.1%}{g.worst_cost:>+11.1%}"
        )
    return "\n".join(lines)


@command
def certify(
    plan_file: PlanArgument,
    samples: Annotated[
        int, option("Random errors of every kind to try within its promise.", "N", min=0)
    ] = 0,
    seed: SeedOption = 0,
    as_json: JsonOption = False,
) -> None:
    """Prove which loads and which errors a plan withstands.

    Loads are those of the planned posture under the best control that the actuators allow.

    Exit code 0 if the grasp is closed and no sample contradicts a promise, else with 1.
    """
    from planner.certify import certify as prove

    certificate = prove(one_plan(plan_file), samples=samples, seed=seed)
    if as_json:
        print_json(certificate.as_dict())
    else:
        tell(str(certificate))
    if not certificate.closed or any(t.lost for t in certificate.tolerances):
        raise typer.Exit(EXIT_NO)
