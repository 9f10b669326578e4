"""Rows of a measurement in a file of JSON lines, as they come, so that it can go on.

The first line says what was asked for. A run that was interrupted or killed goes on with the same
command and repeats no row that is there.
"""

from __future__ import annotations

import fcntl
import json
from collections.abc import Callable, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, Protocol, Self, TypeVar

from rich.markup import escape

from planner.errors import FileFormatError
from sim.runner import Check, Runner

__all__ = ["Journal", "Row", "run_with_journal"]

Row = dict[str, Any]


class _Numbered(Protocol):
    """A job with a number of its own."""

    @property
    def index(self) -> int:
        """The number."""
        ...


Job = TypeVar("Job", bound=_Numbered)


def run_with_journal(
    runner: Runner,
    work: Callable[[Job, Check], Row],
    jobs: Sequence[Job],
    *,
    file: Path,
    asked: Row,
    title: str,
    given_up: Callable[[Job, str], Row],
) -> tuple[list[Row], bool]:
    """Do the jobs whose rows a file does not have yet.

    Args:
        runner: Who works.
        work: Makes the row of a job, plain data with the job's number as "index".
        jobs: All jobs.
        file: Made if it is not there.
        asked: What the jobs follow from; plain data. "format" says what kind of file it is.
        title: What the progress bar says.
        given_up: The row of a job that killed every process that tried it.

    Returns:
        All rows that the file has then, in the order in which they were made; and whether those are
        all, or Ctrl-C came first.

    Raises:
        FileFormatError: The file is another one, or cannot be written.
    """
    with Journal(file, asked) as journal:
        done = {row["index"] for row in journal.rows}
        left = [job for job in jobs if job.index not in done]
        if done:
            _say(runner, f"{len(jobs) - len(left)} of {len(jobs)} are in {file} already")
        whole = runner.run(work, left, title=title, keep=journal.add, given_up=given_up)
        if not whole:
            made = {row["index"] for row in journal.rows}
            kept = f"{sum(job.index in made for job in jobs)} of {len(jobs)} are in {file}"
            _say(runner, f"interrupted: {kept}; the same command goes on")
    return journal.rows, whole


def _say(runner: Runner, text: str) -> None:
    runner.console.print(escape(text), highlight=False, soft_wrap=True)


class Journal:
    """An open file of rows, which no other run writes meanwhile.

    Attributes:
        rows: Those of the file, the oldest first.
    """

    def __init__(self, file: Path, asked: Row) -> None:
        """Open a file, or begin it; a last line that was cut short is cut off.

        Raises:
            FileFormatError: It is not one of these, was begun with other arguments, is written by
                another run, or cannot be written.
        """
        self._file = file
        try:
            self._stream = file.open("ab+")
        except OSError as error:
            raise FileFormatError(
                f"cannot write {file}: {error.strerror}; name another file"
            ) from error
        try:
            self.rows = self._read(asked)
        except BaseException:
            self._stream.close()
            raise

    def __enter__(self) -> Self:
        """The journal itself."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Close the file."""
        self._stream.close()

    def add(self, row: Row) -> None:
        """Append a row; it is read back, so that rows of this run are like those of earlier ones.

        Raises:
            FileFormatError: The file cannot be written.
        """
        line = _line(row)
        self._append(line)
        self.rows.append(json.loads(line))

    def _append(self, line: bytes) -> None:
        try:
            self._stream.write(line)
            self._stream.flush()
        except OSError as error:
            raise FileFormatError(
                f"cannot write {self._file}: {error.strerror}; what it has is kept, and the same "
                "command goes on"
            ) from error

    def _read(self, asked: Row) -> list[Row]:
        """Lock the file, and the rows that it has; what is asked for is written into a new one."""
        file, kind = self._file, asked["format"]
        try:
            fcntl.flock(self._stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise FileFormatError(
                f"{file} is being written by another run; wait for its end, or give another file"
            ) from error
        self._stream.seek(0)
        content, header = self._stream.read(), _line(asked)
        if content != header and header.startswith(content):  # new, or killed while it began
            self._stream.truncate(0)
            self._append(header)
            return []
        whole = content[: content.rfind(b"\n") + 1]
        try:
            first, *rows = [json.loads(line) for line in whole.splitlines()]
            if not isinstance(first, dict) or first.get("format") != kind:
                raise ValueError("its first line is another one")
            if not all(isinstance(row, dict) and "index" in row for row in rows):
                raise ValueError("a row has no index")
        except ValueError as error:
            raise FileFormatError(
                f"{file} is not a file of the format {kind}, or damaged: {error}; name another"
            ) from error
        wanted = json.loads(header)
        if first != wanted:
            names = sorted(key for key in {*first, *wanted} if first.get(key) != wanted.get(key))
            raise FileFormatError(
                f"{file} was begun with other arguments (different: {', '.join(names)}); give the "
                "same, or another file"
            )
        self._stream.truncate(len(whole))
        return rows


def _line(row: Row) -> bytes:
    return json.dumps(row).encode() + b"\n"
