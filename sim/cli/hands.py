"""Commands about hands: ``hands``, ``describe``, ``check-hand``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.markup import escape

from sim.cli.common import (
    EXIT_NO,
    HandArgument,
    JsonOption,
    check_folder,
    err,
    errors_for_people,
    out,
    print_json,
    say,
)

if TYPE_CHECKING:
    from planner.describe import CheckReport


@errors_for_people()
def hands() -> None:
    """Hands that come with Opposable, and hands in packages of others that it knows."""
    from planner.catalog import find_hand, foreign_hand_names, hand_names
    from planner.errors import PlannerError

    for name in hand_names():
        say(out, name)
    for name in foreign_hand_names():
        try:
            find_hand(name)
            say(out, name)
        except PlannerError:
            say(out, f"{name} [dim](its package is not installed)[/]")


@errors_for_people()
def describe(
    model: Annotated[
        str,
        typer.Argument(
            help="A model: MJCF or URDF file, or PACKAGE:NAME (see opposable hands).",
            metavar="MODEL",
        ),
    ],
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="Write a hand.toml instead of printing.")
    ] = None,
    name: Annotated[str | None, typer.Option(help="What to call the hand.")] = None,
    base: Annotated[str | None, typer.Option(help="Body that is the root of the hand.")] = None,
    force: Annotated[bool, typer.Option("--force", help="Overwrite the file.")] = False,
) -> None:
    """Propose a hand description from a model's structure alone, with the reason for each line."""
    from planner.describe import description_text, propose, write_proposal
    from planner.errors import FileFormatError

    check_folder(output)
    if output is not None and output.exists() and not force:
        raise FileFormatError(f"{output} exists already; name another file, or give --force")
    proposal = propose(model, name=name, base_body=base)
    if output is None:
        text = description_text(
            proposal.description, Path.cwd(), proposal.reasons, proposal.open_questions
        )
        typer.echo(text, nl=False)
        return
    write_proposal(proposal, output, overwrite=force)
    for question in proposal.open_questions:
        say(err, f"[bold]to do:[/] {escape(question)}")
    say(out, escape(f"wrote {output}; now: opposable check-hand {output}"))


@errors_for_people()
def check_hand(hand: HandArgument, as_json: JsonOption = False) -> None:
    """What the planner will see of a hand, and what stands in its way."""
    from planner.describe import check_hand as check
    from planner.hand import Hand

    report = check(Hand.load(hand))
    if as_json:
        print_json(report.to_dict())
    else:
        _print_report(report)
    if not report.ok:
        raise typer.Exit(EXIT_NO)


def _print_report(report: CheckReport) -> None:
    """The tables, and the findings last."""
    from rich.table import Table

    joints = Table(title=f"{report.hand}: joints in the order of q")
    for column in ("joint", "of", "q", "qpos", "range", "torque N m", "actuators"):
        joints.add_column(column)
    for j in report.joints:
        joints.add_row(
            escape(j.name),
            j.belongs_to,
            str(j.q_index),
            str(j.qpos_index),
            f"{j.lower:.3f} .. {j.upper:.3f}",
            f"{j.torque[0]:.2f} .. {j.torque[1]:.2f}",
            escape(", ".join(j.actuators)),
        )
    out.print(joints)
    for coupling in report.couplings:
        say(out, escape(f"coupling {coupling}"))
    pads = Table(title="pads")
    for column in ("finger", "geom", "radius mm", "cone deg", "stands out mm", "presses N"):
        pads.add_column(column)
    for p in report.pads:
        pads.add_row(
            p.finger,
            escape(f"{p.geom} ({p.kind})"),
            f"{1e3 * p.radius:.2f}",
            f"{p.half_angle_deg:.0f}",
            f"{1e3 * p.stands_out:.2f}",
            f"{p.presses:.1f}",
        )
    out.print(pads)
    spaces = Table(title="where the tips get to, base frame, mm")
    for column in ("finger", "x", "y", "z"):
        spaces.add_column(column)
    for w in report.workspaces:
        ends = zip(w.lower, w.upper, strict=True)
        spaces.add_row(w.finger, *(f"{1e3 * a:.0f} .. {1e3 * b:.0f}" for a, b in ends))
    out.print(spaces)
    postures = Table(title="postures")
    for column in ("posture", "gap mm", "pads off the opposite ones, deg", "clearance mm"):
        postures.add_column(column)
    for r in report.postures:
        facing = " ".join(f"{angle:.0f}" for angle in r.facing_deg)
        postures.add_row(r.name, f"{1e3 * r.gap:.0f}", facing, f"{1e3 * r.clearance:.1f}")
    out.print(postures)
    say(out, f"Pinocchio and MuJoCo agree to {report.kinematics_error:.1e} m")
    styles = {"error": "bold red", "warning": "bold yellow", "note": "bold"}
    for f in report.findings:
        style = styles[f.level]
        say(out, f"[{style}]{f.level}:[/] {escape(f.what)}; {escape(f.what_to_do)}")
    if report.ok:
        say(out, "nothing forbids planning")


def register(app: typer.Typer) -> None:
    """Add the commands."""
    app.command()(hands)
    app.command()(describe)
    app.command("check-hand")(check_hand)
