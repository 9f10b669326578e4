"""The folder of a batch: grasps are added one by one, and an interruption anywhere loses none.

A row is safe once ``add`` returns: it is a line of the journal. When all rows of a shard are there
they become a Parquet file, which appears whole or not at all, and leave the journal. Shards divide
the requests by their number, so the files of a finished batch do not depend on who finished when.
Rows and files name the manifest that they were planned for, by its digest, so that no row is ever
taken for that of another batch. Memory holds the rows of unfinished shards only.

    manifest.json             what was asked for
    grasps/part-000000.parquet    one row per requested grasp, sorted by object and k
    attempts/part-000000.parquet  one row per attempt
    journal.jsonl             rows whose shard is not complete
"""

from __future__ import annotations

import fcntl
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

from planner.batch.recipe import MANIFEST, Manifest, read_manifest
from planner.batch.rows import arrow, attempt_rows, attempt_schema
from planner.errors import FileFormatError
from planner.files import write_json
from planner.files.disk import PART, Journal, read_json_lines

GRASPS, ATTEMPTS = "grasps", "attempts"
"""The two tables."""

JOURNAL, LOCK, PARTIAL = "journal.jsonl", "lock", "partial.tmp"

OWNER = "manifest_sha256"
"""Key of the manifest's digest in the journal and in the files' metadata."""


def shard_file(folder: Path, table: str, shard: int) -> Path:
    """The Parquet file of a shard."""
    return folder / table / f"part-{shard:06d}.parquet"


def whole_shards(folder: Path, manifest: Manifest) -> set[int]:
    """Shards that are there with all their rows; a damaged file counts as absent.

    Raises:
        FileFormatError: A file belongs to another batch.
    """
    arrow()  # says what to install before anything is looked at
    whole = set()
    for shard in range(manifest.n_shards):
        grasps, attempts = (shard_file(folder, table, shard) for table in (GRASPS, ATTEMPTS))
        rows = _rows_of(grasps, manifest)
        if rows == manifest.rows_in(shard) and _rows_of(attempts, manifest) is not None:
            whole.add(shard)
    return whole


def _rows_of(path: Path, manifest: Manifest) -> int | None:
    """Rows of a Parquet file; None where it is missing or damaged.

    Raises:
        FileFormatError: It belongs to another batch.
    """
    if not path.exists():
        return None
    pa = arrow()
    try:
        found = pa.parquet.read_metadata(path)
    except (pa.ArrowException, OSError):
        return None
    owner = (found.metadata or {}).get(OWNER.encode())
    _refuse_strangers(path, None if owner is None else owner.decode(), manifest)
    return int(found.num_rows)


def _refuse_strangers(path: Path, owner: str | None, manifest: Manifest) -> None:
    """Check that a row or file was planned for a manifest.

    Raises:
        FileFormatError: It was planned for another one.
    """
    if owner != manifest.digest:
        raise FileFormatError(
            f"{path} was planned for another {MANIFEST} than the one in its folder, which was "
            "changed or exchanged since; bring the old one back, or begin in a new folder"
        )


def waiting_rows(folder: Path, manifest: Manifest) -> dict[int, dict[str, Any]]:
    """Rows of the journal by their number; half a line, left by a kill, is skipped.

    Raises:
        FileFormatError: A row belongs to another batch.
    """
    path = folder / JOURNAL
    rows: dict[int, dict[str, Any]] = {}
    for row in read_json_lines(path):
        index = row.get("index")
        if not isinstance(index, int) or isinstance(index, bool):
            continue
        _refuse_strangers(path, row.pop(OWNER, None), manifest)
        if 0 <= index < manifest.total:
            rows[index] = row
    return rows


class Store:
    """A batch's folder, open for adding rows; use it as a context."""

    def __init__(self, folder: Path, manifest: Manifest, schema: Any) -> None:
        """Begin a batch, or go on with one.

        Args:
            folder: Made if it does not exist.
            manifest: What is asked for.
            schema: Arrow schema of the grasps.

        Raises:
            FileFormatError: The folder cannot be written, holds another batch or other files, or
                another process is writing to it.
        """
        self.folder, self.manifest, self._schema = folder, manifest, schema
        self._owner = manifest.digest
        self._lock = _locked(folder)
        try:
            self._begin()
            self._shards = whole_shards(folder, manifest)
            self._rows = {
                i: row for i, row in waiting_rows(folder, manifest).items() if not self._stored(i)
            }
            self._counts: dict[int, int] = {}
            for index in self._rows:
                self._count(index)
            self._journal = self._rewritten_journal()
            for shard in [s for s in self._counts if self._full(s)]:
                self._write_shard(shard)
        except BaseException:
            os.close(self._lock)
            raise

    def __enter__(self) -> Store:
        """The store itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Let go of the folder."""
        self._journal.close()
        os.close(self._lock)

    def has(self, index: int) -> bool:
        """Whether the row of a request is there."""
        return index in self._rows or self._stored(index)

    def __len__(self) -> int:
        """Rows that are there."""
        return len(self._rows) + sum(self.manifest.rows_in(s) for s in self._shards)

    def add(self, row: dict[str, Any]) -> None:
        """Add a row; it survives the death of this process."""
        self._rows[row["index"]] = row
        self._journal.add(self._owned(row))
        shard = self._count(row["index"])
        if self._full(shard):
            self._write_shard(shard)

    def _begin(self) -> None:
        if (self.folder / MANIFEST).exists():
            read_manifest(self.folder).refuse_unless_same(self.manifest, self.folder)
        else:
            write_json(self.manifest.model_dump(mode="json"), self.folder / MANIFEST)
        for table in (GRASPS, ATTEMPTS):
            (self.folder / table).mkdir(exist_ok=True)

    def _owned(self, row: dict[str, Any]) -> dict[str, Any]:
        """A row as the journal has it."""
        return {OWNER: self._owner, **row}

    def _stored(self, index: int) -> bool:
        return index // self.manifest.shard_rows in self._shards

    def _count(self, index: int) -> int:
        shard = index // self.manifest.shard_rows
        self._counts[shard] = self._counts.get(shard, 0) + 1
        return shard

    def _full(self, shard: int) -> bool:
        return self._counts[shard] == self.manifest.rows_in(shard)

    def _write_shard(self, shard: int) -> None:
        """Turn a shard's rows into files; the file of grasps comes last and makes it valid."""
        pa = arrow()
        size = self.manifest.shard_rows
        rows = [self._rows[i] for i in sorted(self._rows) if i // size == shard]
        attempts = [attempt for row in rows for attempt in attempt_rows(row)]
        self._write(ATTEMPTS, shard, pa.Table.from_pylist(attempts, schema=attempt_schema()))
        self._write(GRASPS, shard, pa.Table.from_pylist(rows, schema=self._schema))
        self._shards.add(shard)
        del self._counts[shard]
        for row in rows:
            del self._rows[row["index"]]
        self._journal.close()
        self._journal = self._rewritten_journal()

    def _write(self, table: str, shard: int, data: Any) -> None:
        owned = data.replace_schema_metadata(
            {**(data.schema.metadata or {}), OWNER: self._owner or ""}
        )

        def write(path: Path) -> None:
            arrow().parquet.write_table(owned, path)

        _replace(self.folder, shard_file(self.folder, table, shard), write)

    def _rewritten_journal(self) -> Journal:
        """The journal of the rows that wait, open at its end."""

        def write(path: Path) -> None:
            with Journal(path, anew=True) as journal:
                for i in sorted(self._rows):
                    journal.add(self._owned(self._rows[i]))

        _replace(self.folder, self.folder / JOURNAL, write)
        return Journal(self.folder / JOURNAL)


def _refuse_rows(folder: Path) -> None:
    """Check that a folder without a manifest holds no rows either.

    Raises:
        FileFormatError: It does; without a manifest their tasks are unknown.
    """
    journal = folder / JOURNAL
    rows = [journal] if journal.exists() and journal.stat().st_size else []
    rows += [p for t in (GRASPS, ATTEMPTS) if (folder / t).is_dir() for p in (folder / t).iterdir()]
    if rows:
        raise FileFormatError(
            f"{folder} holds grasps ({rows[0].relative_to(folder)}) but no {MANIFEST}, which says "
            "what they were planned for; bring that file back, or name a new or an empty folder"
        )


def _replace(folder: Path, target: Path, write: Callable[[Path], None]) -> None:
    """Write a file under another name, sync it to the disk, and rename it into place."""
    partial = folder / PARTIAL
    partial.unlink(missing_ok=True)  # of a process that was killed, or a link to elsewhere
    partial.open("xb").close()
    write(partial)
    with partial.open("rb") as file:
        os.fsync(file.fileno())
    partial.replace(target)


BEGUN = {LOCK, GRASPS, ATTEMPTS, JOURNAL, PARTIAL}
"""What a folder may hold where a batch was killed before its manifest was there, beside the part of
that file that was written (``files.whole_file``)."""


def _locked(folder: Path) -> int:
    """Make the folder and lock it for this process; a file descriptor.

    Raises:
        FileFormatError: It cannot be made or written, holds other files, or is locked.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        there = {p.name for p in folder.iterdir()}
    except OSError as error:
        raise FileFormatError(f"cannot write to {folder}: {error.strerror}") from error
    if MANIFEST not in there:
        _refuse_rows(folder)
        if not all(name in BEGUN or PART.fullmatch(name) for name in there):
            raise FileFormatError(
                f"{folder} holds files but no batch; name a new or an empty folder"
            )
    return lock_folder(folder, "grasps")


def lock_folder(folder: Path, what: str) -> int:
    """Lock a folder that exists for this process, whose death unlocks it.

    Args:
        folder: The folder; a file ``lock`` appears in it.
        what: What this process is about to add, for the message to another one.

    Returns:
        A file descriptor; closing it unlocks the folder.

    Raises:
        FileFormatError: It cannot be written, or another process has locked it.
    """
    try:
        lock = os.open(folder / LOCK, os.O_RDWR | os.O_CREAT)
    except OSError as error:
        raise FileFormatError(f"cannot write to {folder}: {error.strerror}") from error
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        os.close(lock)
        raise FileFormatError(
            f"another process is adding {what} to {folder}; wait for it, or name another folder"
        ) from error
    return lock
