"""The head of a file of ours: its format, its version, and then data of that schema."""

from __future__ import annotations

from typing import Any, TypeVar

from pydantic import ValidationError

from planner.errors import FileFormatError
from planner.schema import StrictData, faults_of

__all__ = ["checked_file"]

FileT = TypeVar("FileT", bound=StrictData)


def checked_file(schema: type[FileT], data: dict[str, Any], source: str) -> FileT:
    """Plain data as the file of a schema.

    Args:
        schema: With fields ``format`` ("opposable-KIND") and ``version``, whose defaults are what
            is read.
        data: What the file holds.
        source: What errors call it, as its path.

    Raises:
        FileFormatError: Another format or version, or damaged.
    """
    wanted = {name: schema.model_fields[name].default for name in ("format", "version")}
    kind = str(wanted["format"]).removeprefix("opposable-")
    if data.get("format") != wanted["format"]:
        raise FileFormatError(
            f"{source} is not a {kind} file: its format is {data.get('format')!r}"
        )
    if data.get("version") != wanted["version"]:
        raise FileFormatError(
            f"{source} has {kind} version {data.get('version')!r}; this Opposable reads version "
            f"{wanted['version']}; plan again"
        )
    try:
        return schema.model_validate(data)
    except ValidationError as error:
        raise FileFormatError(f"{source} is damaged: {faults_of(error)}") from error
