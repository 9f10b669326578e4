"""The command ``forces``: the force problem of a plan, and solvers side by side on it."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.markup import escape

from sim.cli.common import (
    EXIT_NO,
    JsonOption,
    PlanArgument,
    errors_for_people,
    names,
    out,
    print_json,
    say,
)
from sim.cli.reading import one_plan

if TYPE_CHECKING:
    from planner.forces import ForceSolution, PyramidGap

GAP_WRENCHES = 24
"""Wrenches, evenly out of the sequence, on which pyramids are set beside the cone."""


@errors_for_people()
def forces(
    plan_file: PlanArgument,
    solvers: Annotated[
        str | None, typer.Option(help="Compare solvers: all, or daqp,osqp,... by name.")
    ] = None,
    steps: Annotated[
        int, typer.Option(min=1, help="Programmes in the sequence that solvers are compared on.")
    ] = 1000,
    tolerance: Annotated[float, typer.Option(help="Asked of the solvers, N.")] = 1e-6,
    rate: Annotated[
        float | None,
        typer.Option(min=1.0, help="Steps per second of the sequence; at once unless given."),
    ] = None,
    edges: Annotated[int, typer.Option(min=3, help="Sides of the friction pyramids.")] = 8,
    gaps: Annotated[
        bool,
        typer.Option(
            "--gaps", help="Set pyramids beside the round cone (needs clarabel).", metavar=""
        ),
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Contact forces of a plan: problem, answer, solvers compared.

    Solvers meet a sequence: the weight turned through all directions, and a pulsating push. Exit
    code 1 if the forces do not exist, or a solver missed forces that do.
    """
    import numpy as np

    from planner.arrays import checked_number
    from planner.errors import TaskError
    from planner.forces import compare_solvers, cone_gaps, distribute_forces, turning_wrenches
    from planner.verification.grasp import force_arguments

    checked_number("--tolerance", tolerance, above=0.0, error=TaskError)
    checked_number("--rate", 1.0 if rate is None else rate, above=0.0, error=TaskError)
    plan = one_plan(plan_file)
    given: dict[str, Any] = dict(
        force_arguments(plan.task, plan.contacts, plan.T_world_base, plan.q)
    )
    weight = float(np.linalg.norm(given["wrench"][:3]))
    solution = distribute_forces(plan.contacts, edges=edges, **given)
    data: dict[str, Any] = {"found": solution.found, "reason": solution.reason}
    texts = [str(solution.problem), _answer(solution)]
    failed = not solution.found
    wrenches = turning_wrenches(weight, solution.problem.length, steps)
    if solvers is not None:
        report = compare_solvers(
            plan.contacts,
            wrenches,
            solvers=None if solvers == "all" else names(solvers),
            tolerance=tolerance,
            period=1.0 / rate if rate else 0.0,
            edges=edges,
            **{key: value for key, value in given.items() if key != "wrench"},
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
        say(out, escape("\n\n".join(texts)))
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
