"""Disk cache of arrays and texts that are costly to compute, keyed by content.

The directory is that of the environment variable OPPOSABLE_CACHE_DIR, else the user's cache
directory. A file begins with the digest of its kind, key and content. A file that is damaged, has
another key, or could have been written by another user counts as missing. Callers still check that
the content fits its input.

By hand, because diskcache and ``joblib.Memory`` store pickles: reading one runs code, so that a
shared or damaged cache directory could run any. Arrays are read without pickles.
"""

from __future__ import annotations

import hashlib
import io
import os
import stat
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

CACHE_VARIABLE = "OPPOSABLE_CACHE_DIR"
"""Environment variable that names the directory of the cache."""

MOST_BYTES = 2**30
"""Largest file (bytes) that is read; fields, the largest content, have some ten megabytes."""

SEAL_BYTES = hashlib.sha256().digest_size
"""Length of the digest at the beginning of a file."""

_DAMAGED = (OSError, ValueError, KeyError, EOFError, BadZipFile, ZlibError)
"""What reading an ``.npz`` raises where the file is missing, cut short or of another kind."""

_NOT_WAITING = getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)
"""Flags of ``os.open`` with which a pipe in place of a file does not block its reader."""


def cache_directory() -> Path:
    """The cache's directory; it need not exist."""
    given = os.environ.get(CACHE_VARIABLE)
    return Path(given) if given else Path(user_cache_dir("opposable"))


def read_arrays(kind: str, key: str) -> dict[str, FloatArray] | None:
    """The arrays stored under a kind ("field") and a key (a digest); None if there are none."""
    content = _sealed(kind, key)
    if content is None:
        return None
    try:
        with np.load(io.BytesIO(content), allow_pickle=False) as stored:
            arrays = {name: stored[name] for name in stored.files}
    except _DAMAGED:
        return None
    # texts are kept as bytes; nothing that is cached has numbers that are not finite
    known = all(a.dtype.kind in "fiub" and np.isfinite(a).all() for a in arrays.values())
    return arrays if known else None


def write_arrays(kind: str, key: str, arrays: Mapping[str, NDArray[Any]]) -> None:
    """Store arrays: all of them or, where the disk refuses, none."""
    path = _path(kind, key)
    packed = io.BytesIO()
    np.savez(packed, allow_pickle=False, **arrays)
    content = packed.getvalue()
    with suppress(OSError):
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, temporary = tempfile.mkstemp(dir=path.parent, suffix=".part")
        try:
            with os.fdopen(handle, "wb") as stream:
                stream.write(_seal(kind, key, content) + content)
            os.replace(temporary, path)
        except OSError:
            Path(temporary).unlink(missing_ok=True)


def is_stored(kind: str, key: str) -> bool:
    """Whether there is a file under a kind and a key, be it damaged."""
    return _path(kind, key).exists()


def read_text(kind: str, key: str) -> str | None:
    """The text stored under a kind and a key; None if there is none."""
    stored = read_arrays(kind, key)
    try:
        return None if stored is None else stored["text"].tobytes().decode()
    except _DAMAGED:
        return None


def write_text(kind: str, key: str, text: str) -> None:
    """Store a text, as bytes in a file of arrays."""
    write_arrays(kind, key, {"text": np.frombuffer(text.encode(), dtype=np.uint8)})


def _path(kind: str, key: str) -> Path:
    return cache_directory() / kind / f"{key}.arrays"


def _sealed(kind: str, key: str) -> bytes | None:
    """Content of a file that only this user can write and that is undamaged; else None."""
    try:
        handle = os.open(_path(kind, key), os.O_RDONLY | _NOT_WAITING)
        with os.fdopen(handle, "rb") as stream:
            state = os.fstat(handle)
            if not _is_closed(state) or state.st_size > MOST_BYTES:
                return None
            stored = stream.read()
    except OSError:
        return None
    seal, content = stored[:SEAL_BYTES], stored[SEAL_BYTES:]
    return content if seal == _seal(kind, key, content) else None


def _seal(kind: str, key: str, content: bytes) -> bytes:
    return hashlib.sha256(f"{kind}/{key}/".encode() + content).digest()


def _is_closed(state: os.stat_result) -> bool:
    """Whether this is a plain file of this user or the administrator that no other can write."""
    is_mine = not hasattr(os, "getuid") or state.st_uid in (os.getuid(), 0)
    others_write = state.st_mode & (stat.S_IWGRP | stat.S_IWOTH)
    return stat.S_ISREG(state.st_mode) and is_mine and not others_write
