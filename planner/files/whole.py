"""Files that are written whole or not at all, and names that stay in their folder."""

from __future__ import annotations

import os
import re
import secrets
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

from planner.errors import FileFormatError

LONGEST_NAME = 100
"""Characters of a name in a file's name: file systems end at 255 bytes."""

PART = re.compile(r"\.[0-9a-f]{16}\.part")
"""Name of a file that is being written, or was when its process was killed."""


@contextmanager
def whole_file(path: Path) -> Iterator[BinaryIO]:
    """A stream whose content becomes the file, if the block ends without an error.

    Until then it is a new file beside it, of a random name. Links are not followed; a file or link
    at ``path`` is replaced.

    Raises:
        FileFormatError: The folder does not exist or cannot be written, or a folder is in the way.
    """
    partial = path.with_name(f".{secrets.token_hex(8)}.part")
    try:
        with partial.open("xb") as stream:
            yield stream
        os.replace(partial, path)
    except OSError as error:
        raise FileFormatError(f"cannot write {path}: {error.strerror or error}") from error
    except ValueError as error:  # a null character in the name
        raise FileFormatError(f"cannot write {str(path)!r}: {error}") from error
    finally:
        with suppress(OSError, ValueError):
            partial.unlink()


def plain_name(text: str) -> str:
    """A name of a hand or an object as part of a file's name: no folders, nothing hidden.

    Letters, digits, and ``_ . + -`` stay; everything else becomes a dash.
    """
    plain = re.sub(r"[^\w.+\-]", "-", text)[:LONGEST_NAME].lstrip(".-")
    return plain or "unnamed"
