"""Child processes of Python that import nothing from the current folder.

joblib and ``multiprocessing`` start ``python -m`` or ``python -c``, which put the current folder
first on the path of modules: a user's ``joblib.py`` there would run instead of the library. The
environment variable PYTHONSAFEPATH forbids it, and processes inherit the environment.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager

__all__ = ["safe_path"]

VARIABLE = "PYTHONSAFEPATH"

_lock = threading.Lock()
_users = 0
_before: str | None = None


@contextmanager
def safe_path() -> Iterator[None]:
    """Processes that are started meanwhile do not import from the current folder.

    The environment is as it was before once the last of several threads has left.
    """
    global _users, _before
    with _lock:
        if _users == 0:
            _before = os.environ.get(VARIABLE)
            os.environ[VARIABLE] = "1"
        _users += 1
    try:
        yield
    finally:
        with _lock:
            _users -= 1
            if _users == 0:
                if _before is None:
                    os.environ.pop(VARIABLE, None)
                else:
                    os.environ[VARIABLE] = _before
