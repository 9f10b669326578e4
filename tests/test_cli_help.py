"""Help of the command line: groups, one line per command, examples that work, 80 columns."""

from __future__ import annotations

import re
import shlex
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest
import typer
from documents import blocks, is_run, programs
from test_docs import RUNNING
from typer.testing import CliRunner

from planner.system.package import models_dir
from sim.cli import app
from sim.cli.listing import GROUPS, RENAMED, Commands, Listed, flowing

RUN = CliRunner()
LISTED = [c for group in GROUPS.values() for c in group]
WIDTH, HEIGHT = 80, 40
"""A terminal, characters."""

PLANNING = ("Hand and grip", "Search")
LONG = {
    **dict.fromkeys(("run", "plan", "batch", "manipulate", "dataset states"), PLANNING),
    "test": ("Protocols", "Trial"),
    "refine": ("Hand and grip", "What the file does not say"),
}
"""Commands with so many options that no help of one line each fits a screen, and panels of them."""

SLOW = ("learn", "use")
"""Commands whose example takes more than a few seconds, and that no page runs with its options."""


FEWER = {"learn": ("-n", "1")}
"""What is added to an example: smaller numbers of what takes long."""


def printed(*arguments: str, width: int = WIDTH) -> str:
    """What a command prints on a terminal of a width."""
    return RUN.invoke(app, arguments, env={"COLUMNS": str(width)}, prog_name="opposable").output


def test_every_command_is_in_one_group_and_on_one_line() -> None:
    lines = printed("--help").splitlines()
    assert len(lines) <= HEIGHT
    assert len(Commands()) <= 17
    for title in GROUPS:
        assert sum(f"─ {title} ─" in line for line in lines) == 1
    for listed in LISTED:
        name, _, below = listed.name.partition(" ")
        shown = printed(name, "--help").splitlines() if below else lines
        (line,) = [x for x in shown if x.startswith(f"│ {below or name} ")]
        first = flowing(listed.call.__doc__ or "").split("\n\n")[0]
        assert first in line  # so it is not broken
        assert first.endswith(".")
    assert max(map(len, lines)) <= WIDTH
    command: Any = typer.main.get_command(app)
    assert {c.name.split()[0] for c in LISTED} == set(command.commands)
    assert all(c.rich_help_panel in GROUPS for c in command.commands.values())
    assert not [old for old in (*RENAMED, "bench") if any(f"│ {old} " in x for x in lines)]


def test_the_names_of_extras_keep_their_brackets() -> None:
    """Rich takes [drake] for markup unless it is escaped."""
    told = [c for c in LISTED if "pip install" in (c.call.__doc__ or "")]
    assert "test" in [c.name for c in told]
    for listed in told:
        text = " ".join(printed(*listed.name.split(), "--help").split())
        for extra in re.findall(r"opposable\\?\[(\w+)\]", listed.call.__doc__ or ""):
            assert f'"opposable[{extra}]"' in text


def test_alone_it_shows_the_groups_on_one_screen() -> None:
    done = RUN.invoke(app, [], env={"COLUMNS": str(WIDTH)})
    assert done.exit_code == 2
    lines = done.output.splitlines()
    assert len(lines) <= HEIGHT // 2
    assert max(map(len, lines)) <= WIDTH
    for title, commands in GROUPS.items():
        (line,) = [x for x in lines if x.startswith(title)]
        assert all(c.name.split()[0] in line for c in commands)
        assert commands[0].example in done.output


@pytest.mark.parametrize("listed", LISTED, ids=lambda c: c.name)
def test_help_of_a_command_fits_a_screen_and_ends_in_its_example(listed: Listed) -> None:
    lines = printed(*listed.name.split(), "--help").splitlines()
    assert max(map(len, lines)) <= WIDTH
    assert f"Example: {listed.example}" in "\n".join(lines)
    if listed.name not in LONG:
        # a line or two more where a terminal of today is taller than the oldest
        assert len(lines) <= HEIGHT + 3


@pytest.mark.parametrize("name", LONG)
def test_long_lists_of_options_are_in_panels(name: str) -> None:
    shown = printed(*name.split(), "--help")
    assert all(f"─ {title} ─" in shown for title in LONG[name])
    panels = shown.split("╭─")[1:]
    assert max(panel.count("│ --") for panel in panels) <= 12


@pytest.mark.parametrize("listed", LISTED, ids=lambda c: c.name)
def test_examples_are_lines_that_the_command_takes(listed: Listed) -> None:
    program, *words = shlex.split(listed.example)
    assert (program, *words[: len(listed.name.split())]) == ("opposable", *listed.name.split())
    command: Any = typer.main.get_command(app)
    for name in listed.name.split():
        command = command.commands[name]
        assert words.pop(0) == name
    context = command.make_context(name, words)  # exits where something is not taken
    assert context.command is command


def options_of(words: Sequence[str]) -> set[str]:
    """Options among the words of a command, without their values."""
    return {word.partition("=")[0] for word in words if re.match(r"--?[a-z]", word)}


def run_by_pages() -> dict[str, list[set[str]]]:
    """Command -> the options of each line with it that tests/test_docs.py runs."""
    found: dict[str, list[set[str]]] = {}
    for page in RUNNING:
        for block in [b for b in blocks(page) if not b.note("skip")]:
            added = [word for note in block.note("add") for word in shlex.split(note)]
            for _, command in block.commands:
                for name, *words in programs(command):
                    if name == "opposable" and words and is_run([name]):
                        pair = " ".join(words[:2])  # of a command with commands
                        called = pair if pair in {c.name for c in LISTED} else words[0]
                        found.setdefault(called, []).append(options_of([*words, *added]))
    return found


def is_run_by_a_page(listed: Listed) -> bool:
    """Whether a page runs the command with all options of its example, and perhaps more."""
    mine = options_of(shlex.split(listed.example))
    return any(mine <= options for options in run_by_pages().get(listed.name, []))


def run_examples(folder: Path, monkeypatch: pytest.MonkeyPatch, chosen: list[Listed]) -> None:
    """Run examples in a folder in the order in which they are listed, as a reader would."""
    shutil.copy(
        models_dir() / "hands" / "allegro_hand" / "allegro_hand.xml", folder / "my_hand.xml"
    )
    monkeypatch.chdir(folder)
    for listed in chosen:
        words = [*shlex.split(listed.example)[1:], *FEWER.get(listed.name, ())]
        done = RUN.invoke(app, words)
        assert done.exit_code == 0, f"{listed.example}: {done.output}"


def of_no_page(*, slow: bool) -> list[Listed]:
    """Commands whose examples are run here; ``plan``, whose file most others need, always."""
    return [
        c
        for c in LISTED
        if c.name == "plan" or (not is_run_by_a_page(c) and (c.name in SLOW) == slow)
    ]


@pytest.mark.slow
@pytest.mark.usefixtures("virtual_time", "brief_trials")
def test_slow_examples_do_what_they_show(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    run_examples(tmp_path, monkeypatch, of_no_page(slow=True))
    assert (tmp_path / "plan.json").exists()


@pytest.mark.slow
@pytest.mark.usefixtures("virtual_time", "brief_trials")
def test_quick_examples_do_what_they_show(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    run_examples(tmp_path, monkeypatch, of_no_page(slow=False))
    assert (tmp_path / "plan.json").exists()


def test_every_example_is_run_once() -> None:
    """By a page or here; a name that is slow no longer, or run by a page now, leaves the list."""
    assert {c.name for c in LISTED if c.name in SLOW} == set(SLOW)
    assert not [c.name for c in LISTED if c.name in SLOW and is_run_by_a_page(c)]
    assert {"run", "dataset states", "manipulate"} <= set(run_by_pages())
