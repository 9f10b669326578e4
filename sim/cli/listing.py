"""The commands in groups, in the order in which one would use them, each with an example.

The only place where a command of ``opposable`` is registered: a new one is a line of ``GROUPS``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import typer

from sim.cli.audit import audit
from sim.cli.batch import batch, extract
from sim.cli.certify import certify
from sim.cli.creep import creep
from sim.cli.crosscheck import crosscheck
from sim.cli.drive import drive
from sim.cli.episodes import episodes
from sim.cli.export import export
from sim.cli.forces import forces
from sim.cli.grasp import plan, run, simulate
from sim.cli.hands import check_hand, describe, hands
from sim.cli.learn import learn
from sim.cli.look import analyse, inspect, schema
from sim.cli.manipulation import demo, manipulate
from sim.cli.motion import plan_gait, plan_motion
from sim.cli.refine import refine
from sim.cli.states import states
from sim.cli.test import test
from sim.cli.view import view


@dataclass(frozen=True, kw_only=True)
class Listed:
    """A command as it is listed.

    Attributes:
        call: What it does; its name with dashes is the command's.
        example: A line that can be typed as it stands.
    """

    call: Callable[..., Any]
    example: str

    @property
    def name(self) -> str:
        """The command's name."""
        return self.call.__name__.replace("_", "-")


MEASURE = "Measure"
"""The group that ``bench`` is in, too."""

GROUPS: dict[str, tuple[Listed, ...]] = {
    "Grasp": (
        Listed(call=run, example="opposable run shadow_hand box"),
        Listed(call=plan, example="opposable plan shadow_hand box -o plan.json"),
        Listed(call=simulate, example="opposable simulate plan.json -o report.json"),
        Listed(call=test, example="opposable test plan.json --protocol shake"),
        Listed(call=drive, example="opposable drive plan.json --rate 100 --log run.npz"),
    ),
    "In-hand": (
        Listed(call=demo, example="opposable demo --out runs/demo"),
        Listed(
            call=manipulate,
            example="opposable manipulate allegro_hand cylinder:0.03x0.08 --rotate 45",
        ),
        Listed(
            call=plan_motion,
            example="opposable plan-motion allegro_hand cylinder:0.03x0.08 --angle 30",
        ),
        Listed(
            call=plan_gait,
            example="opposable plan-gait shadow_hand cylinder:0.03x0.10 --angle 180",
        ),
        Listed(
            call=learn,
            example="opposable learn allegro_hand cylinder:0.03x0.08 -n 2 --rounds 0",
        ),
    ),
    "Look": (Listed(call=view, example="opposable view plan.json -o plan.html"),),
    "Forces and certificates": (
        Listed(call=analyse, example="opposable analyse plan.json"),
        Listed(call=forces, example="opposable forces plan.json"),
        Listed(call=certify, example="opposable certify plan.json --samples 100"),
    ),
    "Data": (
        Listed(call=batch, example="opposable batch allegro_hand box mug -n 20"),
        Listed(call=extract, example="opposable extract grasps 0 -o first.json"),
        Listed(call=states, example="opposable states allegro_hand cylinder:0.03x0.08 -n 500"),
        Listed(call=schema, example="opposable schema plan"),
    ),
    "Exchange": (
        Listed(call=export, example="opposable export plan.json --to ros2-grasp -o g.yaml"),
        Listed(call=audit, example="opposable audit plan.json"),
        Listed(call=refine, example="opposable refine plan.json --out refined"),
        Listed(call=episodes, example="opposable episodes plan.json -o episodes --video"),
    ),
    "Models": (
        Listed(call=describe, example="opposable describe my_hand.xml -o hand.toml"),
        Listed(call=check_hand, example="opposable check-hand hand.toml"),
        Listed(call=hands, example="opposable hands"),
        Listed(call=inspect, example="opposable inspect shadow_hand"),
        Listed(call=crosscheck, example="opposable crosscheck my_hand.xml"),
    ),
    MEASURE: (Listed(call=creep, example="opposable creep plan.json --physics menagerie"),),
}
"""Title of a group -> its commands; the first example is the group's."""


def register(app: typer.Typer) -> None:
    """Add the commands, each with its group and its example."""
    for title, commands in GROUPS.items():
        for listed in commands:
            app.command(
                listed.name,
                help=flowing(listed.call.__doc__ or ""),
                epilog=f"Example: {listed.example}",
                rich_help_panel=title,
            )(listed.call)


def flowing(text: str) -> str:
    """A docstring with every paragraph on one line, for a terminal of any width to break."""
    return "\n\n".join(" ".join(part.split()) for part in text.split("\n\n")).strip()


def overview(app: typer.Typer) -> str:
    """What ``opposable`` alone prints: the groups with their commands and an example of each."""
    width = 2 + max(map(len, GROUPS))
    lines = [str(app.info.help), ""]
    for title, commands in GROUPS.items():
        there = [c.name for c in commands] + ["bench"] * (title == MEASURE)
        lines.append(f"{title:<{width}}{', '.join(there)}")
        lines.append(f"{'':<{width}}[dim]{commands[0].example}[/]")
    more = "A line on each: opposable --help. All options: opposable COMMAND --help"
    return "\n".join([*lines, "", more])
