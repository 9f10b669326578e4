"""The manifest of a stored batch: everything that its rows depend on.

A batch goes on only under the manifest it began with, so that one folder never mixes two.
"""

from __future__ import annotations

from hashlib import sha256
from pathlib import Path
from typing import Any, Literal

from pydantic import ValidationError

from planner.batch.recipe import Recipe
from planner.errors import FileFormatError, shown
from planner.files import read_json
from planner.schema import StrictData, faults_of

MANIFEST = "manifest.json"
"""Name of the file."""

SHARD_ROWS = 1000
"""Rows per Parquet file, about 1 MB: few files for many grasps, and few rows in memory."""

MOST_DIFFERENCES = 4
"""Most differences between two manifests in one message."""


class ManifestObject(Recipe):
    """One object: its label and its task."""

    label: str

    @property
    def recipe(self) -> str:
        """The task as text, see ``planner.batch.recipe``."""
        return Recipe(**{k: getattr(self, k) for k in Recipe.model_fields}).model_dump_json()


class Manifest(StrictData):
    """The request of a batch.

    Version 1, whose rows name neither their manifest nor their fingers, is read, but not continued.
    """

    format: Literal["opposable-grasps"] = "opposable-grasps"
    version: Literal[1, 2] = 2
    written_by: str
    hand: str
    joint_names: list[str]
    n: int
    seed: int
    max_attempts: int
    max_cpu_s: float | None = None
    options: dict[str, Any]
    shard_rows: int = SHARD_ROWS
    objects: list[ManifestObject]

    @property
    def digest(self) -> str | None:
        """SHA-256 by which rows name their manifest, hexadecimal; None for version 1."""
        return None if self.version == 1 else sha256(self.model_dump_json().encode()).hexdigest()

    @property
    def total(self) -> int:
        """Requested grasps of all objects."""
        return self.n * len(self.objects)

    @property
    def n_shards(self) -> int:
        """Files that hold all rows."""
        return -(-self.total // self.shard_rows)

    def rows_in(self, shard: int) -> int:
        """Rows of a complete shard."""
        return min(self.shard_rows, self.total - shard * self.shard_rows)

    def refuse_unless_same(self, asked: Manifest, folder: Path) -> None:
        """Refuse another request than the one that the folder was begun with.

        Raises:
            FileFormatError: Another request; lists the differences.
        """
        found = list(_differences("", self.model_dump(), asked.model_dump()))
        if found:
            more = len(found) - MOST_DIFFERENCES
            raise FileFormatError(
                f"{folder} holds another batch: {'; '.join(found[:MOST_DIFFERENCES])}"
                + (f"; and {more} more" if more > 0 else "")
                + ". Ask for the same to go on with it, or name another folder"
            )


def read_manifest(folder: Path) -> Manifest:
    """The manifest of a folder.

    Raises:
        FileFormatError: There is none, or it is damaged.
    """
    try:
        return Manifest.model_validate(read_json(folder / MANIFEST, "the manifest of a batch"))
    except ValidationError as error:
        raise FileFormatError(f"{folder / MANIFEST} is damaged: {faults_of(error)}") from error


def _differences(where: str, there: Any, asked: Any) -> Any:
    """Sentences about the differences of two values of plain data."""
    if isinstance(there, dict) and isinstance(asked, dict):
        for key in dict.fromkeys((*there, *asked)):
            inner = f"{where}.{key}" if where else str(key)
            yield from _differences(inner, there.get(key), asked.get(key))
    elif isinstance(there, list) and isinstance(asked, list) and len(there) == len(asked):
        for i, (a, b) in enumerate(zip(there, asked, strict=True)):
            yield from _differences(f"{where}[{i}]", a, b)
    elif there != asked:
        yield f"{where} is {_short(there)} there and {_short(asked)} here"


def _short(value: Any) -> str:
    if isinstance(value, list):
        return f"{len(value)} values"
    return shown(value)
