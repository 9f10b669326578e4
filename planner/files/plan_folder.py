"""Plan files of a folder, as ``opposable refine`` writes one, without reading them whole.

``opposable refine``, ``export``, ``dataset`` and ``test`` take such a folder for its files.
"""

from __future__ import annotations

import re
from collections.abc import Collection
from pathlib import Path

from planner.errors import FileFormatError

HEAD = 4096
"""Bytes of a file within which it says its format."""

_FORMAT = re.compile(rb'"format"\s*:\s*"(opposable-[a-z-]+)"')


def format_told(file: Path) -> str:
    """The format that a JSON file of ours says of itself, "" for every other file or folder.

    Raises:
        FileFormatError: It cannot be read.
    """
    if not file.is_file():
        return ""
    try:
        with file.open("rb") as stream:
            head = stream.read(HEAD)
    except OSError as error:
        raise FileFormatError(f"cannot read {file}: {error.strerror}") from error
    told = _FORMAT.search(head) if head.lstrip().startswith(b"{") else None
    return told[1].decode() if told else ""


def plan_files(folder: Path, formats: Collection[str] = ("opposable-plan",)) -> tuple[Path, ...]:
    """JSON files of some formats that lie in a folder, by name.

    Args:
        folder: The folder; folders in it are not looked at.
        formats: What the files say of themselves.

    Raises:
        FileFormatError: The folder or a file cannot be read.
    """
    try:
        files = sorted(folder.iterdir())
    except OSError as error:
        raise FileFormatError(f"cannot read the folder {folder}: {error.strerror}") from error
    return tuple(f for f in files if f.suffix == ".json" and format_told(f) in formats)
