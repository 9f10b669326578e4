"""The drawing library of the pages, three.js, as it lies in trimesh's package.

trimesh's notebook viewer carries the library; a page takes it from there when it is written, so
that it needs no network and our tree holds no third-party code.
"""

from __future__ import annotations

import zipfile
from functools import cache
from pathlib import Path

import trimesh

from planner.errors import PlannerError

__all__ = ["three_source"]

REVISION = 'const e="140"'
"""Revision of three.js that the pages were written for."""

BEGIN = "Three.js Authors"
END = 'Object.defineProperty(t,"__esModule",{value:!0})}));'
"""Where the library ends; what follows are trimesh's own controls."""


@cache
def three_source() -> str:
    """three.js r140 as a script that defines the global THREE.

    Raises:
        PlannerError: trimesh is of a version that carries another one, or none.
    """
    archive = Path(trimesh.__file__).parent / "resources/templates/viewer.zip"
    try:
        with zipfile.ZipFile(archive) as zipped:
            page = zipped.read("viewer.html.template").decode()
    except (OSError, KeyError, zipfile.BadZipFile, UnicodeDecodeError) as error:
        raise _not_there(str(error)) from error
    begin = page.find("<script>") + len("<script>")
    end = page.find(END)
    source = page[begin : end + len(END)]
    if end < 0 or REVISION not in source or BEGIN not in source[:500] or "</script" in source:
        raise _not_there("its viewer holds another revision of three.js than r140")
    return source


def _not_there(reason: str) -> PlannerError:
    return PlannerError(
        f"pages are drawn by three.js out of the package trimesh, and trimesh {trimesh.__version__}"
        f" does not have it: {reason}; pip install 'trimesh{TRIMESH}'"
    )


TRIMESH = ">=4.10,<6"
"""Versions of trimesh with that revision; the same in pyproject.toml."""
