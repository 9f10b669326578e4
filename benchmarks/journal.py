"""Rows of a measurement in a file of JSON lines, each on disk as soon as it is made.

The first line holds the arguments. The same command continues a run that was interrupted or killed,
and repeats no finished row.
"""

from __future__ import annotations

import fcntl
import json
from pathlib import Path
from typing import Self

from planner.errors import FileFormatError
from sim.tables import Row


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

    def __exit__(self, *_: object) -> None:
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
        """Lock the file and read its rows; begin a new file with the arguments."""
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
