"""What all commands share: consoles, exit codes, errors for people, Ctrl-C, files."""

from __future__ import annotations

import json
import os
import shlex
import signal
import sys
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import typer
from rich.console import Console
from rich.markup import escape

if TYPE_CHECKING:
    from rich.table import Table

EXIT_NO, EXIT_USAGE, EXIT_BAD_INPUT, EXIT_NOT_FOUND, EXIT_INTERRUPTED = 1, 2, 3, 4, 130
"""Done, and the answer is no; wrong usage; bad input; no grasp found; interrupted."""

out = Console()
err = Console(stderr=True)

TABLE_WIDTH = 120
"""Least width of wide tables, characters; a narrow terminal breaks their lines."""


def say(console: Console, text: str) -> None:
    """Print a sentence that may hold a user's text; not broken into lines where it is piped."""
    console.print(text, highlight=False, soft_wrap=True)


def tell(*lines: str) -> None:
    """Print plain sentences on stdout; nothing in them is markup."""
    for line in lines:
        say(out, escape(line))


def show_wide(table: Table) -> None:
    """Print a table that does not fit into 80 columns."""
    Console(width=max(out.width, TABLE_WIDTH)).print(table)


def _leave(*_: object) -> None:
    """Ctrl-C before anything was done."""
    os.write(2, b"interrupted\n")
    os._exit(EXIT_INTERRUPTED)


@contextmanager
def errors_for_people() -> Iterator[None]:
    """Turn errors that a user can mend, and Ctrl-C, into a message and an exit code."""
    # Some libraries swallow a KeyboardInterrupt while they are imported: leave at once meanwhile.
    handler = signal.signal(signal.SIGINT, _leave)
    try:
        from planner.errors import NoGraspFoundError, PlannerError
    finally:
        signal.signal(signal.SIGINT, handler)
    _made.clear()
    try:
        yield
    except NoGraspFoundError as error:
        _remove_empty_folders()
        say(err, f"[bold]not found:[/] {escape(str(error))}")
        raise typer.Exit(EXIT_NOT_FOUND) from error
    except PlannerError as error:
        _remove_empty_folders()
        say(err, f"[bold red]error:[/] {escape(str(error))}")
        raise typer.Exit(EXIT_BAD_INPUT) from error
    except KeyboardInterrupt as error:
        _remove_empty_folders()
        say(err, "interrupted")
        raise typer.Exit(EXIT_INTERRUPTED) from error


class CtrlC:
    """Whether Ctrl-C was pressed; a call raises the KeyboardInterrupt that got lost, if one did."""

    def __init__(self) -> None:
        """Not yet."""
        self.pressed = False

    def __call__(self) -> None:
        """Raise if it was pressed.

        Raises:
            KeyboardInterrupt: It was.
        """
        if self.pressed:
            raise KeyboardInterrupt


@contextmanager
def heeding_ctrl_c(*, at_once: bool = True) -> Iterator[CtrlC]:
    """Note Ctrl-C, and raise the KeyboardInterrupt that got lost, if one did.

    CasADi makes a failed attempt out of a Ctrl-C while it solves, and planning would go on.
    SIGTERM, by which a system ends what runs too long, counts as Ctrl-C meanwhile.

    Args:
        at_once: Whether the first Ctrl-C raises; else it is only noted, and the second one raises.
    """
    noted = CtrlC()

    def remember(*_: object) -> None:
        again, noted.pressed = noted.pressed, True
        if at_once or again:
            raise KeyboardInterrupt

    handlers = {s: signal.signal(s, remember) for s in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield noted
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)


@contextmanager
def goes_on(kept: Callable[[], str]) -> Iterator[None]:
    """Ctrl-C ends a command that goes on where it was when it is given again.

    Args:
        kept: Says what is kept.
    """
    try:
        yield
    except KeyboardInterrupt as error:
        say(err, escape(f"interrupted: {kept()}; the same command goes on"))
        raise typer.Exit(EXIT_INTERRUPTED) from error


def _given(context: typer.Context) -> list[Any]:
    """Parameters of a command that stand on the command line."""
    return [
        parameter
        for parameter in context.command.params
        if (source := context.get_parameter_source(parameter.name or "")) is not None
        and source.name == "COMMANDLINE"
    ]


def refuse_given(
    context: typer.Context,
    why: str,
    *,
    kept: Collection[str] | None = None,
    of: Collection[str] = (),
    because: Mapping[str, str] = MappingProxyType({}),
) -> None:
    """Refuse options that mean nothing beside another one.

    Args:
        context: Of the command.
        why: What they mean nothing for, the beginning of the message.
        kept: Names of the parameters that go with it; all others are refused.
        of: Without ``kept``, the parameters that are refused.
        because: Parameter -> why it means nothing, where that says more than ``why``.

    Raises:
        TaskError: One of them is given.
    """
    from planner.errors import TaskError

    idle = {
        p.opts[0] if p.param_type_name != "argument" else p.name.upper(): because.get(p.name, "")
        for p in _given(context)
        if (p.name in of if kept is None else p.name not in kept)
    }
    if idle:
        reasons = [
            f"{', '.join(o for o in idle if idle[o] == reason)}: {reason}"
            for reason in dict.fromkeys(filter(None, idle.values()))
        ]
        told = f" ({'; '.join(reasons)})" if reasons else ""
        raise TaskError(f"{why}; leave {', '.join(idle)} out{told}")


def told_command(context: typer.Context) -> str:
    """What the command line was told, as it can be typed again; defaults are left out."""
    words = context.command_path.split()
    for parameter in _given(context):
        value = context.params[parameter.name or ""]
        values = list(value) if isinstance(value, list | tuple) else [value]
        if parameter.param_type_name == "argument":
            words += [str(v) for v in values]
        elif isinstance(value, bool):
            words.append(parameter.opts[0] if value else parameter.secondary_opts[0])
        else:
            words += [word for v in values for word in (parameter.opts[0], str(v))]
    return shlex.join(words)


def print_json(data: dict[str, Any]) -> None:
    """JSON on stdout, for machines; a number that is not finite becomes null."""
    from planner.arrays import finite

    sys.stdout.write(json.dumps(finite(data), indent=1, allow_nan=False) + "\n")


def make_folder(folder: Path) -> None:
    """Make a folder, with an error for people; one that an error leaves empty is removed again."""
    from planner.errors import FileFormatError

    try:
        missing = [f for f in (folder, *folder.parents) if not f.exists()]
        folder.mkdir(parents=True, exist_ok=True)
    except (OSError, ValueError) as error:  # ValueError: a null character in the name
        reason = getattr(error, "strerror", None) or error
        raise FileFormatError(f"cannot make the folder {folder}: {reason}") from error
    _made.extend(reversed(missing))


_made: list[Path] = []
"""Folders that the command made, outermost first."""


def _remove_empty_folders() -> None:
    while _made:
        with suppress(OSError):  # it holds something, or has gone
            _made.pop().rmdir()


def check_folder(*files: Path | None) -> None:
    """Refuse files in a folder that does not exist, before the work and not after it."""
    from planner.errors import FileFormatError

    for file in files:
        if file is None:
            continue
        try:
            has_folder, is_folder = file.parent.is_dir(), file.is_dir()
        except (OSError, ValueError) as error:  # too long a name, a barred way, a null character
            reason = getattr(error, "strerror", None) or error
            raise FileFormatError(f"cannot write {file}: {reason}; give another name") from error
        if not has_folder:
            raise FileFormatError(f"cannot write {file}: there is no folder {file.parent}; make it")
        if is_folder:
            raise FileFormatError(f"cannot write {file}: it is a folder; name a file")


def keep_inputs(output: Path | None, *inputs: Path | None) -> None:
    """Refuse to write over a file that is read.

    Raises:
        FileFormatError: The output is one of the inputs.
    """
    from planner.errors import FileFormatError

    if output is None or not output.exists():
        return
    for given in inputs:
        if given is not None and given.is_file() and output.samefile(given):
            raise FileFormatError(f"{given} would be written over; give another name for it")


def check_films(*files: Path | None) -> None:
    """Refuse files that cannot be written, the last of them a film, before the work.

    Raises:
        FileFormatError: A folder that does not exist.
        TaskError: A film of an unknown kind, or one that needs a package.
    """
    check_folder(*files)
    if files[-1] is not None:
        from sim.show.picture import check_video

        check_video(files[-1])


def warn_of_friction(believed: float, true: float) -> None:
    """Tell when there is less friction than planning relies on."""
    if true < believed:
        text = (
            f"--sim-mu {true:g} is less friction than is believed, --mu {believed:g}: plan and "
            "controller rely on what is not there, so expect slips and drops; give "
            f"--sim-mu {believed:g} or more, or a smaller --mu"
        )
        say(err, f"[yellow]{escape(text)}[/yellow]")


def exit_for(report: Any) -> None:
    """Exit as a trial report says."""
    if report.reason == "interrupted":
        raise typer.Exit(EXIT_INTERRUPTED)
    if not report.as_planned:
        raise typer.Exit(EXIT_NO)
