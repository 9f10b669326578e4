"""Files whose content runs as code: only this user can write them, and each has its digest.

Loading a library runs it, so a library that another user could have written must not be loaded.
Checks: the folder and its parent belong to this user (or to the system's administrator), no other
user may write to them, and no folder above is open to all; the file is a plain one of this user,
closed to others, and has the digest that was written beside it when it was made. The digest finds
damage only; owner and mode protect from other users, who could write a digest too.
"""

from __future__ import annotations

import hashlib
import os
import stat
from pathlib import Path

from planner.errors import PlannerError

__all__ = [
    "check_folder",
    "digest_file",
    "is_closed",
    "is_intact",
    "is_mine",
    "make_private",
    "seal",
]

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
