"""Disk cache of arrays and texts that are costly to compute, and files whose content runs as code.

The directory is that of the environment variable OPPOSABLE_CACHE_DIR, else the user's cache
directory. A file begins with the digest of its kind, key and content. A file that is damaged, has
another key, or could have been written by another user counts as missing. Callers still check that
the content fits its input.

By hand, because diskcache and ``joblib.Memory`` store pickles: reading one runs code, so that a
shared or damaged cache directory could run any. Arrays are read without pickles.

Loading a library runs it, so a library that another user could have written must not be loaded.
Checks: the folder and its parent belong to this user (or to the system's administrator), no other
user may write to them, and no folder above is open to all; the file is a plain one of this user,
closed to others, and has the digest that was written beside it when it was made. The digest finds
damage only; owner and mode protect from other users, who could write a digest too.
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

from planner.errors import PlannerError
from planner.spatial import FloatArray

OTHERS_WRITE = stat.S_IWGRP | stat.S_IWOTH
PRIVATE = 0o700
"""Mode of folders and libraries that are made here: of this user alone."""


def make_private(folder: Path) -> None:
    """Make a folder that only this user can enter, if it is not there; its parents likewise.

    Raises:
        PlannerError: It cannot be made.
    """
    missing = [f for f in (folder, *folder.parents) if not f.exists()]
    try:
        for each in reversed(missing):
            each.mkdir(mode=PRIVATE, exist_ok=True)
    except OSError as error:
        raise PlannerError(
            f"cannot make the folder {folder} for compiled code: {error.strerror}; let "
            "OPPOSABLE_CACHE_DIR name a folder that can be written"
        ) from error


def check_folder(folder: Path) -> None:
    """Refuse a folder in which another user could put code.

    Raises:
        PlannerError: Another user could; says which folder, and what to do.
    """
    real = folder.resolve()
    for place in (real, *real.parents):
        state = place.stat()
        if place in (real, real.parent) and not is_mine(state):
            reason = f"belongs to the user with id {state.st_uid}"
        elif state.st_mode & (OTHERS_WRITE if place == real else _too_open(state, place, real)):
            reason = f"can be written by others (mode {stat.S_IMODE(state.st_mode):o})"
        else:
            continue
        raise PlannerError(
            f"compiled code is not loaded from {real}: {place} {reason}. Close it (chmod go-w) or "
            "let OPPOSABLE_CACHE_DIR name a folder of your own"
        )


def is_intact(library: Path) -> bool:
    """Whether a library is a plain file of this user, closed to others, and undamaged."""
    try:
        state = library.lstat()
        if not is_closed(state):
            return False
        content = library.read_bytes()
        return digest_file(library).read_text(encoding="ascii").strip() == _digest(content)
    except (OSError, ValueError):
        return False


def seal(made: Path, library: Path) -> None:
    """Put a library that was made beside its place into it, with its digest."""
    made.chmod(PRIVATE)
    digest = made.with_name("digest")
    digest.write_text(_digest(made.read_bytes()) + "\n", encoding="ascii")
    os.replace(digest, digest_file(library))
    os.replace(made, library)


def digest_file(library: Path) -> Path:
    """Where the digest of a library is."""
    return library.with_suffix(".sha256")


def _digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


def is_closed(state: os.stat_result) -> bool:
    """Whether this is a plain file of this user that no other user can write."""
    return stat.S_ISREG(state.st_mode) and is_mine(state) and not state.st_mode & OTHERS_WRITE


def is_mine(state: os.stat_result) -> bool:
    """Whether a file belongs to this user or to the administrator; yes where none owns files."""
    return not hasattr(os, "getuid") or state.st_uid in (os.getuid(), 0)


def _too_open(state: os.stat_result, place: Path, folder: Path) -> int:
    """Rights to write that a folder above ours must not grant.

    None where it is sticky: users cannot rename each other's files there.
    """
    if state.st_mode & stat.S_ISVTX:
        return 0
    return OTHERS_WRITE if place == folder.parent else stat.S_IWOTH


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
