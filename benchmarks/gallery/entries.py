"""What the gallery shows: every script in ``examples``, and some commands."""

from __future__ import annotations

import ast
from dataclasses import dataclass
from pathlib import Path

from planner.errors import NotFoundError

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
"""Folder of the examples, in the checkout."""

FULL_TURN = (
    *("manipulate", "shadow_hand", "cylinder:0.03x0.08", "--rotate", "z:360"),
    *("--mu", "0.7", "--sim-mu", "0.8"),
)
"""By strokes and regrasps: the hand turns the object by some 60 degrees at a time."""

COMMANDS = {
    "demo": ("The demonstration: pick, turn by 90 degrees, place", ("demo",)),
    "full-turn": (
        "A full turn in the hand, by strokes and regrasps",
        FULL_TURN,
    ),
}
"""Commands beside the scripts: name -> title and arguments of ``opposable``."""

GROUPS = {"": "Examples", "lab": "The lab's six steps and its errors"}
"""Folder below ``examples`` -> heading."""


MODULES = {EXAMPLES / "udp_hand.py"}
"""What stands beside the scripts to be imported by them."""


@dataclass(frozen=True, kw_only=True)
class Entry:
    """One thing that the gallery shows.

    Attributes:
        name: The script without its ending, or the name of the command.
        group: Heading.
        title: What it shows, a sentence without its full stop.
        script: The script, relative to ``examples``; "" for a command.
        command: Arguments of ``opposable``; empty for a script.
    """

    name: str
    group: str
    title: str
    script: str = ""
    command: tuple[str, ...] = ()


def gallery_entries() -> list[Entry]:
    """All of them: the scripts by name, then the commands."""
    entries = []
    for folder, heading in GROUPS.items():
        for path in sorted(set((EXAMPLES / folder).glob("*.py")) - MODULES):
            document = ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or path.stem
            title = " ".join(document.split("\n\n")[0].split()).removesuffix(".")
            script = path.relative_to(EXAMPLES).as_posix()
            entries.append(Entry(name=path.stem, group=heading, title=title, script=script))
    for name, (title, arguments) in COMMANDS.items():
        entries.append(Entry(name=name, group="Commands", title=title, command=arguments))
    return entries


def chosen(entries: list[Entry], names: list[str]) -> list[Entry]:
    """Those of some names; all if none is named.

    Raises:
        NotFoundError: Nothing in the gallery is called so.
    """
    by_name = {entry.name: entry for entry in entries}
    for name in names:
        if name not in by_name:
            raise NotFoundError("entry of the gallery", name, by_name)
    return [by_name[name] for name in names] or entries
