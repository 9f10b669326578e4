"""Arrays and texts that are costly to compute, kept on disk by content.

The directory is that of the environment variable OPPOSABLE_CACHE_DIR, else the user's cache
directory. A file that is damaged, or cannot be written, is as if it were not there.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any
from zipfile import BadZipFile
from zlib import error as ZlibError

import numpy as np
from numpy.typing import NDArray
from platformdirs import user_cache_dir

from planner.spatial import FloatArray

__all__ = [
    "CACHE_VARIABLE",
    "cache_directory",
    "read_arrays",
    "read_text",
    "write_arrays",
    "write_text",
]

CACHE_VARIABLE = "OPPOSABLE_CACHE_DIR"
"""Environment variable that names the directory of the cache."""

_DAMAGED = (OSError, ValueError, KeyError, EOFError, BadZipFile, ZlibError)
"""What reading an ``.npz`` raises where the file is missing, cut short or of another kind."""


def cache_directory() -> Path:
    """Where prepared objects are kept; it need not exist."""
    given = os.environ.get(CACHE_VARIABLE)
    return Path(given) if given else Path(user_cache_dir("opposable"))


def read_arrays(kind: str, key: str) -> dict[str, FloatArray] | None:
    """The arrays kept under a kind ("field") and a key (a digest); None if there are none."""
    try:
        # opened here, since np.load leaves a file open that it cannot read
        with _path(kind, key).open("rb") as stream, np.load(stream, allow_pickle=False) as stored:
            return {name: stored[name] for name in stored.files}
    except _DAMAGED:
        return None


def write_arrays(kind: str, key: str, arrays: Mapping[str, NDArray[Any]]) -> None:
    """Keep arrays: all of them or, where the disk refuses, none."""
    path = _path(kind, key)
    with suppress(OSError):
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, temporary = tempfile.mkstemp(dir=path.parent, suffix=".part")
        try:
            with os.fdopen(handle, "wb") as stream:
                np.savez(stream, allow_pickle=False, **arrays)
            os.replace(temporary, path)
        except OSError:
            Path(temporary).unlink(missing_ok=True)


def read_text(kind: str, key: str) -> str | None:
    """The text kept under a kind and a key; None if there is none."""
    stored = read_arrays(kind, key)
    try:
        return None if stored is None else stored["text"].tobytes().decode()
    except _DAMAGED:
        return None


def write_text(kind: str, key: str, text: str) -> None:
    """Keep a text, as bytes in a file of arrays: those are checked as they are read."""
    write_arrays(kind, key, {"text": np.frombuffer(text.encode(), dtype=np.uint8)})


def _path(kind: str, key: str) -> Path:
    return cache_directory() / kind / f"{key}.npz"
