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


class _Guard:
    """Sets the variable for as long as anybody needs it."""

    def __init__(self) -> None:
        self._lock, self._users = threading.Lock(), 0
        self._before: str | None = None

    def enter(self) -> None:
        with self._lock:
            if self._users == 0:
                self._before = os.environ.get(VARIABLE)
                os.environ[VARIABLE] = "1"
            self._users += 1

    def leave(self) -> None:
        with self._lock:
            self._users -= 1
            if self._users > 0:
                return
            if self._before is None:
                os.environ.pop(VARIABLE, None)
            else:
                os.environ[VARIABLE] = self._before


_guard = _Guard()


@contextmanager
def safe_path() -> Iterator[None]:
    """Processes that are started meanwhile do not import from the current folder.

    The environment is as it was before once the last of several threads has left.
    """
    _guard.enter()
    try:
        yield
    finally:
        _guard.leave()
