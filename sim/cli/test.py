"""The command ``test``."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.markup import escape

from sim.cli.common import (
    EXIT_INTERRUPTED,
    EXIT_NO,
    ControllerOption,
    JsonOption,
    SeedOption,
    err,
    errors_for_people,
    heeding_ctrl_c,
    make_folder,
    out,
    print_json,
    say,
)

TABLE_WIDTH = 120
"""Characters that the table needs."""


class Which(StrEnum):
    """Protocols."""

    fc = "fc"
    forces = "forces"
    shake = "shake"
    robust = "robust"
    all = "all"


@errors_for_people()
def test(
    plans: Annotated[list[Path], typer.Argument(help="Plan files.", metavar="PLAN...")],
    protocol: Annotated[Which, typer.Option(help="What to do to the grasp.")] = Which.all,
    controller: ControllerOption = "open",
    only: Annotated[
        list[str] | None, typer.Option(help='Only trials of this name: "force +z"; repeatable.')
    ] = None,
    workers: Annotated[int, typer.Option(help="Processes; -1 for one per core.")] = -1,
    folder: Annotated[
        Path, typer.Option("--out", help="Folder for lines as they come, reports and trials.csv.")
    ] = Path("runs/test"),
    seed: SeedOption = 0,
    as_json: JsonOption = False,
) -> None:
    """Test plans in MuJoCo by named protocols: fc, forces, shake, robust.

    Ends with 0 if every grasp held in every trial without a growing load.
    """
    from planner.files import read_plan, write_json
    from sim.controllers import named_controller
    from sim.protocols import PROTOCOLS, ProtocolReport, protocol_table, run_protocol, write_csv

    named_controller(controller)  # bad input ends here
    loaded = [(path, read_plan(path)) for path in plans]
    make_folder(folder)
    names = PROTOCOLS if protocol is Which.all else (protocol.value,)
    reports: list[ProtocolReport] = []
    with heeding_ctrl_c() as check:
        for number, (path, plan) in enumerate(loaded):
            for name in names:
                stem = f"{number:03d}-{path.stem}-{name}"
                report = run_protocol(
                    plan,
                    name,
                    controller=controller,
                    seed=seed,
                    workers=workers,
                    only=only or (),
                    name=str(path),
                    file=folder / f"{stem}.jsonl",
                    console=err,
                    check=check,
                )
                reports.append(report)
                write_json(report.to_dict(), folder / f"{stem}.json")
                write_csv(reports, folder / "trials.csv")
                if not as_json:
                    _show(report, protocol_table(report))
                if not report.complete:
                    break
            if not reports[-1].complete:
                break
    if as_json:
        print_json({"reports": [report.summary() for report in reports]})
    else:
        say(out, escape(f"written to {folder}: a report per plan and protocol, trials.csv"))
    if not all(report.complete for report in reports):
        say(err, "interrupted; what was done is kept")
        raise typer.Exit(EXIT_INTERRUPTED)
    if not all(report.success for report in reports):
        raise typer.Exit(EXIT_NO)


def _show(report: Any, table: Any) -> None:
    """Table, physics and what it comes to."""
    # the table does not fit into 80 columns; a narrow terminal breaks its lines
    Console(width=max(out.width, TABLE_WIDTH)).print(table)
    p, s = report.physics, report.summary()
    say(
        out,
        f"physics: {p['timestep_s']:g} s, {p['integrator']}, {p['solver']}, {p['cone']} cones, "
        f"impratio {p['impratio']:g}, noslip {p['noslip_iterations']}, friction {p['friction']:g} "
        f"and {p['torsional_friction_m']:g} m",
    )
    if s["of"]:
        say(out, f"held in {s['held']} of {s['of']}")
    for reason, count in s["reasons"].items():
        say(out, f"ended by {reason}: {count}")
    if s["median_borne_N"] is not None:
        say(
            out,
            f"borne: median {s['median_borne_N']:.3g} N, least {s['least_borne_N']:.3g} N; "
            f"{100 * s['median_share_of_bound']:.0f} % of what the certificate allows any control",
        )
    for name in s["contradictions"]:
        say(out, f"[bold red]contradiction:[/] {escape(name)}: more than the certificate allows")


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command()(test)
