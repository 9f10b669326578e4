"""The command ``creep``: whether an object that is held stays held in one's own scene."""

from __future__ import annotations

from typing import Annotated, Any

import typer
from rich.markup import escape

from sim.cli.common import (
    EXIT_NO,
    JsonOption,
    PhysicsOption,
    PlanArgument,
    err,
    errors_for_people,
    out,
    physics_of,
    print_json,
    say,
)
from sim.cli.reading import one_plan


@errors_for_people()
def creep(
    plan_file: PlanArgument,
    physics: PhysicsOption = "mujoco-default",
    budget: Annotated[float, typer.Option(help="Largest creep that is wanted, mm/s.")] = 0.1,
    as_json: JsonOption = False,
) -> None:
    """How fast a held object creeps, and what to do about it.

    Each change is tried and made larger until the creep that is measured keeps to the budget. Exit
    code 0 if nothing is to be changed, 1 if the object creeps faster than the budget.
    """
    from planner.errors import TaskError
    from sim.protocols.creep import measure_creep, sized_remedies

    plan, computed = one_plan(plan_file), physics_of(physics)
    if not 0 < budget < float("inf"):
        raise TaskError(f"--budget is {budget:g}; give a finite speed > 0 in mm/s")
    with err.status(f"creep: {plan.task.hand.name}, {plan.task.object.name} ..."):
        seen = measure_creep(plan, computed)
        slow = seen.measured <= 1e-3 * budget
        tried = () if slow else sized_remedies(plan, computed, seen, 1e-3 * budget)
    data: dict[str, Any] = {
        "physics": computed.to_dict(),
        "budget_mm_s": budget,
        "within_budget": slow,
        **_speeds(seen),
        "changes": [{"what": t.remedy.what, "enough": t.enough, **_speeds(t.creep)} for t in tried],
    }
    if as_json:
        print_json(data)
    else:
        say(out, escape(f"physics: {computed}"))
        say(out, escape(f"creep: {_told(data)}; {budget:g} mm/s are wanted"))
        for change in data["changes"]:
            enough = "enough" if change["enough"] else "not enough"
            say(out, escape(f"  {enough}: {change['what']}: {_told(change)}"))
    if not slow:
        raise typer.Exit(EXIT_NO)


def _speeds(seen: Any) -> dict[str, Any]:
    return {
        "creep_mm_s": 1e3 * seen.measured,
        "formula_mm_s": 1e3 * seen.predicted,
        "formula_however_firm_mm_s": 1e3 * seen.least,
        "lost": seen.lost,
    }


def _told(speeds: dict[str, Any]) -> str:
    """Measured and computed speeds in words."""
    formula = f"by the formula at least {speeds['formula_however_firm_mm_s']:.2g} without noslip"
    if speeds["lost"]:
        return f"lost ({speeds['lost']}); {formula}"
    return f"{speeds['creep_mm_s']:.2g} mm/s; {formula}"
