"""The page of the command line, out of the commands themselves, in the groups of ``--help``."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import typer.main
from sphinx.application import Sphinx

from benchmarks.__main__ import app as benchmarks
from machinery.write import write_pages
from sim.cli import app as opposable
from sim.cli.listing import RENAMED, Renamed

FOLDER = Path(__file__).parent.parent / "reference" / "generated" / "commands"
EXAMPLE = re.compile(r"^\s*(opposable .*)$", re.MULTILINE)
"""A command in an epilogue, on a line of its own or behind "Example:"."""


def shown(text: str) -> str:
    """Words of a help text, none of which is markup."""
    return re.sub(r"([\\*`|_])", r"\\\1", " ".join(text.split()))


def panel(of: Any, default: str) -> str:
    """The group of ``--help`` that a command or an option is in."""
    name = getattr(of, "rich_help_panel", None)
    return name if isinstance(name, str) else default


def described(command: Any, context: Any) -> Iterator[str]:
    """The lines that document one command: usage, what it does, an example, what it takes."""
    title = context.command_path
    yield from (title, "-" * len(title), "")
    yield from (shown(part) + "\n" for part in (command.help or "").split("\n\n"))
    usage = " ".join([title, *command.collect_usage_pieces(context)])
    yield from (".. code-block:: text", "", f"   {usage}", "")
    examples = EXAMPLE.findall((command.epilog or "").replace("Example: ", "\n"))
    if examples:
        yield from (".. code-block:: console", "", *(f"   $ {line}" for line in examples), "")
    panels: dict[str, list[tuple[str, str]]] = {}
    for parameter in command.get_params(context):
        if record := parameter.get_help_record(context):
            panels.setdefault(panel(parameter, ""), []).append(record)
    for name, records in panels.items():
        if name:
            yield from (f"**{name}**", "")
        yield from (".. list-table::", "   :class: names", "")
        for words, text in records:
            yield f"   * - ``{words}``"
            yield f"     - {shown(text)}"
        yield ""


def leaves(command: Any, context: Any) -> Iterator[tuple[str, Any, Any]]:
    """Every command below one that does something: (group, command, its context)."""
    for name in command.list_commands(context):
        found = command.get_command(context, name)
        inner = found.context_class(found, info_name=name, parent=context)
        if hasattr(found, "list_commands"):
            group = panel(found, "Measure")
            yield from ((group, leaf, deeper) for _, leaf, deeper in leaves(found, inner))
        else:
            yield panel(found, "Measure"), found, inner


SHOWN = {
    "bench": "python -m benchmarks ...",
    "extract": "opposable batch FOLDER --extract ROW",
}
"""New lines of which more changes than what stands before and behind the arguments."""


def renamed() -> Iterator[str]:
    """The lines that list names of commands that go with the next version."""
    yield from ("Names that go with the next version, and what does the same:", "")
    yield from (".. list-table::", "   :class: names", "")
    for old, new in sorted({**RENAMED, "bench": Renamed(begin=())}.items()):
        line = " ".join(["opposable", *new.begin, "...", *new.end])
        yield f"   * - ``opposable {old}``"
        yield f"     - ``{SHOWN.get(old, line)}``"
    yield ""


def commands() -> list[tuple[str, Any, Any]]:
    """Every command of ours, and those that measure: (group, command, its context)."""
    found: list[tuple[str, Any, Any]] = []
    for app, name in ((opposable, "opposable"), (benchmarks(), "python -m benchmarks")):
        root: Any = typer.main.get_command(app)
        found += leaves(root, root.context_class(root, info_name=name))
    return found


def slug(group: str) -> str:
    """A group as the name of a file."""
    return re.sub(r"\W+", "-", group.lower())


def pages() -> dict[str, str]:
    """Name of a file -> its text: one page a group, and their list."""
    groups: dict[str, list[tuple[Any, Any]]] = {}
    for group, command, context in commands():
        groups.setdefault(group, []).append((command, context))
    first = ["Command line", "============", ""]
    first += ["What each command takes; ``opposable COMMAND --help`` says the same.", ""]
    first += ["Exit codes: 0 done and good; 1 done, and the answer is no (no closure, object not"]
    first += ["held); 2 wrong usage; 3 bad input, an error that says what to do; 4 no grasp found;"]
    first += ["130 interrupted.", "", ".. toctree::", "   :maxdepth: 2", ""]
    first += [*(f"   {slug(group)}" for group in groups), "", *renamed()]
    written = {"index.rst": "\n".join([*first, ""])}
    for group, members in groups.items():
        lines = [group, "=" * len(group), ""]
        for command, context in members:
            lines += described(command, context)
        written[f"{slug(group)}.rst"] = "\n".join(lines)
    return written


def setup(app: Sphinx) -> dict[str, Any]:
    """Write the pages when a build begins."""
    app.connect("builder-inited", lambda _: write_pages(FOLDER, pages()))
    return {"parallel_read_safe": True, "parallel_write_safe": True}
