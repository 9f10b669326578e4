"""The command ``states``: stable hand-object states for reinforcement learning."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.markup import escape

from sim.cli.common import (
    EXIT_INTERRUPTED,
    EXIT_NOT_FOUND,
    SEARCH_PANEL,
    FingersOption,
    HandArgument,
    JsonOption,
    MuOption,
    PhysicsOption,
    SeedOption,
    err,
    errors_for_people,
    names,
    numbers,
    out,
    physics_of,
    print_json,
    say,
)

DRAWS_PANEL = "What is drawn"
"""Group of the options that make states differ."""

TABLE_WIDTH = 120
"""Width of the table, characters."""


@errors_for_people()
def states(
    hand: HandArgument,
    objects: Annotated[
        list[str], typer.Argument(help="Objects as `plan` takes them.", metavar="OBJECT...")
    ],
    n: Annotated[
        int, typer.Option("-n", "--number", min=1, help="States per object and size.", metavar="N")
    ] = 1000,
    folder: Annotated[
        Path, typer.Option("--out", help="Folder; a cache that is there goes on.", metavar="DIR")
    ] = Path("cache"),
    scales: Annotated[
        str, typer.Option(help="Sizes relative to the object's.", metavar="S,...")
    ] = "1",
    formats: Annotated[
        list[str] | None,
        typer.Option(
            "--format",
            help="npz, parquet, hora, playground, isaac_lab, all.",
            metavar="NAME",
        ),
    ] = None,
    workers: Annotated[int, typer.Option(help="Processes; -1 for one per core.", metavar="N")] = -1,
    seed: SeedOption = 0,
    grasps: Annotated[
        int,
        typer.Option(
            min=0, metavar="N", help="Grasps per object and size.", rich_help_panel=SEARCH_PANEL
        ),
    ] = 200,
    motions: Annotated[
        int,
        typer.Option(
            min=0, metavar="N", help="Planned turns, likewise.", rich_help_panel=SEARCH_PANEL
        ),
    ] = 30,
    gaits: Annotated[
        int,
        typer.Option(
            min=0, metavar="N", help="Planned gaits, likewise.", rich_help_panel=SEARCH_PANEL
        ),
    ] = 4,
    turn: Annotated[
        float,
        typer.Option(
            help="Of a motion, degrees; twice that of a gait.",
            metavar="DEG",
            rich_help_panel=SEARCH_PANEL,
        ),
    ] = 30.0,
    fingers: FingersOption = None,
    mu: MuOption = 0.5,
    friction: Annotated[
        str,
        typer.Option(help="Range (-).", metavar="LOW,HIGH", rich_help_panel=DRAWS_PANEL),
    ] = "0.6,1.2",
    mass: Annotated[
        str | None,
        typer.Option(
            help="Range, kg; 0.5 to 1.5 times the object's.",
            metavar="LOW,HIGH",
            rich_help_panel=DRAWS_PANEL,
        ),
    ] = None,
    squeeze: Annotated[
        str,
        typer.Option(
            help="Range of the planned squeeze's factor.",
            metavar="LOW,HIGH",
            rich_help_panel=DRAWS_PANEL,
        ),
    ] = "1,2",
    gravity: Annotated[
        str,
        typer.Option(
            help="Direction in the hand's base.",
            metavar="random|X,Y,Z",
            rich_help_panel=DRAWS_PANEL,
        ),
    ] = "random",
    spread: Annotated[
        float,
        typer.Option(
            min=0.0,
            help="Factor of errors (2 mm, 4.6 degrees).",
            metavar="F",
            rich_help_panel=DRAWS_PANEL,
        ),
    ] = 1.0,
    physics: PhysicsOption = "ours",
    as_json: JsonOption = False,
) -> None:
    """Make stable states of an object in the hand to learn from.

    They are drawn around planned grasps, turns and gaits, and each is held in MuJoCo for 2 s by
    position commands alone. Exit code 0 if every object and size got as many as were asked for.

    An interrupted run goes on when the same command is given again, also with a larger -n; a
    smaller one takes no state away.
    """
    from sim.cli.states_report import StatesBar, states_table
    from sim.reset_states import Draws, StatesAsked, make_states

    drawn = Draws()
    asked = StatesAsked(
        hand=hand,
        objects=tuple(objects),
        n=n,
        seed=seed,
        scales=tuple(_list("--scales", scales)),
        grasps=grasps,
        motions=motions,
        gaits=gaits,
        turn=math.radians(turn),
        fingers=() if fingers is None else tuple(names(fingers)),
        mu=mu,
        draws=Draws(
            position=spread * drawn.position,
            angle=spread * drawn.angle,
            joints=spread * drawn.joints,
            squeeze=_range("--squeeze", squeeze),
            friction=_range("--friction", friction),
            mass=None if mass is None else _range("--mass", mass),
            gravity=None if gravity == "random" else _direction(gravity),
        ),
        physics=physics_of(physics),
    )
    with StatesBar(err) as bar:
        try:
            summary = make_states(
                asked, folder, workers=workers, formats=formats or ("all",), progress=bar.told
            )
        except KeyboardInterrupt as error:
            say(err, escape(f"interrupted: {bar.kept()}; the same command goes on"))
            raise typer.Exit(EXIT_INTERRUPTED) from error
    if as_json:
        print_json(summary)
    else:
        # a narrow terminal breaks its lines
        Console(width=max(out.width, TABLE_WIDTH)).print(states_table(summary))
        for cell in summary["cells"]:
            if cell["before"] > n:
                say(out, f"{cell['name']} had {cell['before']} states before, and keeps them")
            for name, reason in cell["left_out"].items():
                say(out, escape(f"no {name} of {cell['name']}: {reason}"))
        files = [file for cell in summary["cells"][:1] for file in cell["files"].values()]
        say(out, escape(f"written to {folder}: {', '.join((*files, 'summary.json'))}"))
        first = summary["cells"][0]["name"]
        check = f"python {folder / 'check_states.py'} {folder / first / 'states.npz'}"
        say(out, escape(f"to hold a sample without Opposable: {check}"))
    if any(cell["states"] < n for cell in summary["cells"]):
        raise typer.Exit(EXIT_NOT_FOUND)


def _list(option: str, text: str) -> list[float]:
    return numbers(option, text, text.count(",") + 1)


def _range(option: str, text: str) -> tuple[float, float]:
    low, high = numbers(option, text, 2)
    return low, high


def _direction(text: str) -> tuple[float, float, float]:
    x, y, z = numbers("--gravity", text, 3)
    return x, y, z
