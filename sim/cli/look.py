"""Commands that look: ``inspect``, ``analyse``, ``schema``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from sim.cli.common import EXIT_NO, HandArgument, JsonOption, errors_for_people, out, print_json


@errors_for_people()
def inspect(hand: HandArgument, as_json: JsonOption = False) -> None:
    """What a hand is made of: joints, actuators, tips, masses."""
    from planner.hand_loading import load_hand
    from sim.cli.inspection import hand_tables, inspect_hand

    loaded = load_hand(hand)
    if as_json:
        print_json(inspect_hand(loaded))
    else:
        for table in hand_tables(loaded):
            out.print(table)


@errors_for_people()
def analyse(
    contacts_file: Annotated[
        Path, typer.Argument(help="A plan file or a list of contacts (JSON).", metavar="FILE")
    ],
    edges: Annotated[int, typer.Option(min=3, help="Sides of the friction pyramid.")] = 8,
    as_json: JsonOption = False,
) -> None:
    """Force closure, epsilon, min-weight of a plan or of contacts."""
    from planner.files import read_contacts
    from planner.quality import analyse as analyse_contacts

    contacts, length = read_contacts(contacts_file)
    report = analyse_contacts(contacts, length=length, edges=edges)
    if as_json:
        print_json(report.to_dict())
    else:
        out.print(str(report), highlight=False)
    if not report.closure.closed:
        raise typer.Exit(EXIT_NO)


@errors_for_people()
def schema(
    kind: Annotated[
        str,
        typer.Argument(
            help="plan, motion, gait, manipulation, report, manipulation-report, contacts or "
            "grasp-table"
        ),
    ] = "plan",
) -> None:
    """The JSON Schema of plans, reports, contact lists and tables."""
    from pydantic import BaseModel

    from planner.errors import NotFoundError
    from planner.exchange.table_forms import TableFile
    from planner.files import ContactsFile, GaitFile, ManipulationFile, MotionFile, PlanFile
    from sim.manipulation import ManipulationReportFile
    from sim.report_file import ReportFile

    models: dict[str, type[BaseModel]] = {
        "plan": PlanFile,
        "motion": MotionFile,
        "gait": GaitFile,
        "manipulation": ManipulationFile,
        "report": ReportFile,
        "manipulation-report": ManipulationReportFile,
        "contacts": ContactsFile,
        "grasp-table": TableFile,
    }
    if kind not in models:
        raise NotFoundError("schema", kind, models)
    print_json(models[kind].model_json_schema())
