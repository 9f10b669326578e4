"""``run``: cases in, rows out, in one or several processes; an interrupted run goes on.

Rows are appended to ``FILE.journal`` as they come and become ``FILE`` when all are there. A row is
known by its case, so that a journal also serves a run with more or other cases.
"""

from __future__ import annotations

import fcntl
import json
from collections.abc import Callable, Iterable
from contextlib import nullcontext
from dataclasses import asdict, dataclass, is_dataclass
from functools import partial
from hashlib import blake2b
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Annotated, Any, Self

import typer
from rich.console import Console
from rich.markup import escape

from planner.arrays import finite
from planner.errors import FileFormatError, PlannerError
from planner.files import write_json
from sim.cli.common import EXIT_INTERRUPTED, check_folder, err, heeding_ctrl_c, out, print_json
from sim.cli.options import JsonOption, SeedOption
from sim.runner import Check, Runner, made_with
from sim.tables import Row, table

VERSION = 4
"""Of results: the first with their tables in them."""

TABLE_WIDTH = 216
"""Least width of the tables, characters: the columns of text in ``manipulate`` vanish at 140."""

NumberOption = Annotated[
    int, typer.Option("-n", "--number", min=1, help="How many for each hand and object.")
]
HandsArgument = Annotated[
    list[str] | None,
    typer.Argument(help="Names or paths; both right hands if none.", metavar="[HAND]..."),
]
ObjectsOption = Annotated[
    str,
    typer.Option(help="Objects, comma separated; a folder stands for the mesh files in it."),
]
BOTH_HANDS = ("shadow_hand", "allegro_hand")
"""Hands where none is named."""


@dataclass(frozen=True, kw_only=True)
class Options:
    """What every measurement takes."""

    n: NumberOption = 10
    seed: SeedOption = 0
    workers: Annotated[int, typer.Option(min=1, help="Processes.")] = 1
    output: Annotated[
        Path | None,
        typer.Option(
            "--out",
            help="Write the result here as JSON; an interrupted run continues from FILE.journal.",
        ),
    ] = None
    as_json: JsonOption = False


@dataclass(frozen=True, kw_only=True)
class HandOptions(Options):
    """The same with hands."""

    hands: HandsArgument = None

    @property
    def hand_names(self) -> list[str]:
        """Names or paths of the hands."""
        return list(self.hands or BOTH_HANDS)


class Journal:
    """An open file of rows, JSON lines, each on disk as soon as it is made.

    Attributes:
        rows: Key of a case -> its row.
    """

    def __init__(self, file: Path, kind: str) -> None:
        """Open a file that no other run writes, or begin it; a line that was cut short is cut off.

        Raises:
            FileFormatError: It is another file, is written by another run, or cannot be written.
        """
        self._file = file
        head = json.dumps({"format": f"{kind}-journal"}).encode() + b"\n"
        try:
            self._stream = file.open("ab+")
        except OSError as error:
            raise FileFormatError(
                f"cannot write {file}: {error.strerror}; name another file"
            ) from error
        try:
            self.rows = self._read(head)
        except BaseException:
            self._stream.close()
            raise

    def _read(self, head: bytes) -> dict[str, Row]:
        try:
            fcntl.flock(self._stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise FileFormatError(
                f"{self._file} is being written by another run; wait for its end, or give another"
            ) from error
        self._stream.seek(0)
        content = self._stream.read()
        if content != head and head.startswith(content):  # new, or killed while it began
            self._stream.truncate(0)
            self._append(head)
            return {}
        whole = content[: content.rfind(b"\n") + 1]
        try:
            if not whole.startswith(head):
                raise ValueError("its first line is another one")
            rows = dict(json.loads(line) for line in whole[len(head) :].splitlines())
        except ValueError as error:
            raise FileFormatError(
                f"{self._file} is no journal of this measurement, or damaged: {error}; name another"
            ) from error
        self._stream.truncate(len(whole))
        return rows

    def add(self, key: str, row: Row) -> None:
        """Append a row.

        Raises:
            FileFormatError: The file cannot be written.
        """
        self._append(json.dumps([key, row]).encode() + b"\n")
        self.rows[key] = row

    def _append(self, line: bytes) -> None:
        try:
            self._stream.write(line)
            self._stream.flush()
        except OSError as error:
            raise FileFormatError(
                f"cannot write {self._file}: {error.strerror}; what it has is kept, and the same "
                "command goes on"
            ) from error

    def __enter__(self) -> Self:
        """The journal itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close the file."""
        self._stream.close()


def plain(value: Any) -> Any:
    """Plain data of a value: dictionaries for dataclasses, text for paths; see ``finite``."""
    if is_dataclass(value) and not isinstance(value, type):
        value = asdict(value)
    if isinstance(value, dict):
        return {key: plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    return str(value) if isinstance(value, Path) else finite(value)


def key_of(case: Row) -> str:
    """What a row is known by: a digest of its case."""
    return blake2b(json.dumps(plain(case), sort_keys=True).encode(), digest_size=12).hexdigest()


def row_of(case: Row, **values: Any) -> Row:
    """A row, plain data: the case without its dataclasses, and what came of it."""
    shown = {name: value for name, value in case.items() if not is_dataclass(value)}
    row: Row = plain({**shown, "error": "", **values})
    return row


def measured(bench: str, case: Row, check: Check) -> Row:
    """The row of a case; an error for people costs this row alone.

    Args:
        bench: Module of the measurement.
        case: Which.
        check: Raises a Ctrl-C that a library swallowed.
    """
    measure: Callable[[Row], Row] = import_module(bench).measure
    try:
        row = row_of(case, **measure(case))
    except PlannerError as error:
        row = row_of(case, error=str(error))
    check()
    return row


def _lost(case: Row, reason: str) -> Row:
    return row_of(case, error=reason)


def run(bench: ModuleType, options: Options, runner: Runner) -> Row:
    """Measure the cases that the journal does not have yet; Ctrl-C keeps what is done.

    Args:
        bench: The measurement.
        options: Its options.
        runner: Who works.

    Returns:
        Plain data: what the rows were made with, the rows, and the summary: texts, and tables with
        title, columns and rows of texts.

    Raises:
        FileFormatError: The journal is another file or cannot be written.
        PlannerError: The options ask for what there is not.
    """
    name = bench.__name__
    kind = getattr(bench, "FORMAT", f"opposable-bench-{name.rpartition('.')[2]}")
    made, cases = made_with(), list(bench.cases(options))
    keys = [key_of(case) for case in cases]
    file = options.output and options.output.with_name(f"{options.output.name}.journal")
    rows: dict[str, Row] = {}
    with nullcontext() if file is None else Journal(file, kind) as journal:
        if journal is not None:
            rows = journal.rows
        left = {key: case for key, case in zip(keys, cases, strict=True) if key not in rows}
        if journal is not None and rows:
            _say(runner, f"{len(cases) - len(left)} of {len(cases)} are in {file} already")

        def keep(found: tuple[str, Row]) -> None:
            rows.__setitem__(*found) if journal is None else journal.add(*found)

        whole = runner.run(
            partial(_keyed, name),
            list(left.items()),
            title=name.rpartition(".")[2],
            keep=keep,
            given_up=lambda job, reason: (job[0], _lost(job[1], reason)),
        )
        if not whole and file is not None:
            kept = f"{sum(key in rows for key in keys)} of {len(cases)} are in {file}"
            _say(runner, f"interrupted: {kept}; the same command goes on")
    shared = {n: v for n, v in (cases[0] if cases else {}).items() if is_dataclass(v)}
    result = {"format": kind, "version": VERSION, **made, "workers": runner.workers}
    result["setting"] = plain({**asdict(options), **shared})
    result |= {"interrupted": not whole, "rows": [rows[key] for key in keys if key in rows]}
    return result | {"summary": [*bench.tables(result), *errors_of(result["rows"])]}


def _keyed(bench: str, job: tuple[str, Row], check: Check) -> tuple[str, Row]:
    return job[0], measured(bench, job[1], check)


def errors_of(rows: Iterable[Row]) -> list[str]:
    """What could not be measured and why, every reason once."""
    reasons: dict[str, int] = {}
    for row in rows:
        if row["error"]:
            where = " ".join(str(row[name]) for name in ("hand", "object") if row.get(name))
            text = f"{where}: {row['error']}" if where else row["error"]
            reasons[text] = reasons.get(text, 0) + 1
    return [f"not measured, {count}: {text}" for text, count in reasons.items()]


def _say(runner: Runner, text: str) -> None:
    runner.console.print(escape(text), highlight=False, soft_wrap=True)


def carry_out(bench: ModuleType, options: Options) -> None:
    """Run a measurement as a command: progress and notes on stderr, its tables on stdout.

    Raises:
        Exit: It was interrupted, or the measurement says that something is wrong.
    """
    check_folder(options.output)
    with heeding_ctrl_c() as check:
        result = run(bench, options, Runner(console=err, check=check, workers=options.workers))
    if options.output is not None and not result["interrupted"]:
        write_json(result, options.output)
        options.output.with_name(f"{options.output.name}.journal").unlink()
    if options.as_json:
        print_json(result)
    else:
        show(result["summary"])
    if result["interrupted"]:
        raise typer.Exit(EXIT_INTERRUPTED)


def show(summary: Iterable[Row | str]) -> None:
    """Print a summary on a console where tables fit; a narrow terminal breaks their lines."""
    console = Console(width=max(out.width, TABLE_WIDTH))
    for one in summary:
        if isinstance(one, str):
            console.print(one, highlight=False, soft_wrap=True, markup=False)
            continue
        console.print(
            table(
                one["title"],
                one["columns"],
                one["rows"],
                left=one["left"],
                title_justify="left",
                caption=one.get("caption"),
            ),
            markup=False,
        )
