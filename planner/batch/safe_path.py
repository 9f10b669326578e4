"""Child processes of Python that import nothing from the current folder.

joblib and ``multiprocessing`` start ``python -m`` or ``python -c``, which put the current folder
first on the path of modules: a user's ``joblib.py`` there would run instead of the library. The
environment variable PYTHONSAFEPATH forbids it, and processes inherit the environment.
"""

from __future__ import annotations

from contextlib import AbstractContextManager

from planner.system.environment import Held

__all__ = ["safe_path"]

VARIABLE = "PYTHONSAFEPATH"

_held = Held(VARIABLE, "1")


def safe_path() -> AbstractContextManager[None]:
    """Processes that are started meanwhile do not import from the current folder.

    The environment is as it was before once the last of several threads has left.
    """
    return _held()
