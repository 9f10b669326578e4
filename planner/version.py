"""The version of this code, as files and the command line name it.

It is written here and nowhere else: the package's metadata are made from it, and a checkout on
PYTHONPATH has no metadata, or those of another version that is installed beside it.
"""

from __future__ import annotations

__all__ = ["__version__", "written_by"]

__version__ = "0.1.0"
"""Version of both packages; the wheel is built with it."""


def written_by() -> str:
    """This version, as files name it."""
    return f"opposable {__version__}"
