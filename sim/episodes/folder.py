"""A folder that appears whole or not at all."""

from __future__ import annotations

import os
import secrets
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from planner.errors import FileFormatError


@contextmanager
def whole_folder(folder: Path) -> Iterator[Path]:
    """A new folder whose content becomes ``folder``, if the block ends without an error.

    Until then it stands beside it under a random name that begins with a dot; an error, such as a
    full disk, removes it.

    Raises:
        FileFormatError: The folder exists and holds something, or cannot be written.
    """
    refuse_full(folder)
    partial = folder.with_name(f".{secrets.token_hex(8)}.part")
    try:
        partial.parent.mkdir(parents=True, exist_ok=True)
        partial.mkdir()
        yield partial
        os.rename(partial, folder)  # onto nothing, or an empty folder
    except OSError as error:
        raise FileFormatError(f"cannot write {folder}: {error.strerror or error}") from error
    except ValueError as error:
        if "null" not in str(error):
            raise
        raise FileFormatError(f"cannot write {str(folder)!r}: {error}") from error
    finally:
        shutil.rmtree(partial, ignore_errors=True)


def refuse_full(folder: Path) -> None:
    """Check that a folder can begin here.

    Raises:
        FileFormatError: It is a file, or holds something.
    """
    try:
        taken = folder.exists() and (not folder.is_dir() or any(folder.iterdir()))
    except (OSError, ValueError) as error:  # too long a name, a barred way, a null character
        reason = getattr(error, "strerror", None) or error
        raise FileFormatError(f"cannot write {folder}: {reason}; give another name") from error
    if taken:
        raise FileFormatError(
            f"{folder} exists and is not empty; a data set is written whole, so name a new folder"
        )
