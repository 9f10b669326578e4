"""Commands about hands: ``hands``, ``describe``, ``check-hand``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

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


@errors_for_people()
def hands() -> None:
    """Hands that ship, and hands in packages of others."""
    from planner.errors import PlannerError
    from planner.hands.catalog import find_hand, foreign_hand_names, hand_names

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
        Path | None, typer.Option("--out", "-o", help="Write a hand.toml instead of printing.")
    ] = None,
    name: Annotated[str | None, typer.Option(help="What to call the hand.")] = None,
    base_body: Annotated[
        str | None, typer.Option(help="Body that is the root of the hand.", metavar="NAME")
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Overwrite the file.", metavar="")] = False,
) -> None:
    """Propose a hand.toml from a model, a reason for each line."""
    from planner.describe import description_text, propose, write_proposal
    from planner.errors import FileFormatError
    from planner.hand_loading import load_hand
    from planner.pages.notebook import postures_picture

    check_folder(output)
    for file in () if output is None else (output, output.with_suffix(".png")):
        if file.exists() and not force:
            raise FileFormatError(f"{file} exists already; name another file, or give --force")
    with err.status(f"reading {escape(model)}: kinematics, tips, collisions ..."):
        proposal = propose(model, name=name, base_body=base_body)
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
    picture = output.with_suffix(".png")
    picture.write_bytes(postures_picture(load_hand(output)))
    say(out, escape(f"its postures are drawn in {picture}"))


@errors_for_people()
def check_hand(hand: HandArgument, as_json: JsonOption = False) -> None:
    """What the planner sees of a hand, and what is in its way."""
    from planner.describe import check_hand as check
    from planner.hand_loading import load_hand
    from sim.cli.inspection import print_check

    with err.status(f"checking {escape(hand)} ..."):
        report = check(load_hand(hand))
    if as_json:
        print_json(report.to_dict())
    else:
        print_check(report, out)
    if not report.ok:
        raise typer.Exit(EXIT_NO)
