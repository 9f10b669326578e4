"""Environment variables that are set for a while; processes that are started meanwhile see them."""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager

__all__ = ["SAFE_PATH", "Held", "safe_path"]


class Held:
    """One variable with one value, for as long as anybody needs it.

    Args:
        variable: Its name.
        value: What it is meanwhile.
    """

    def __init__(self, variable: str, value: str) -> None:
        """Nothing is set yet."""
        self._variable, self._value = variable, value
        self._lock, self._users = threading.Lock(), 0
        self._before: str | None = None

    @contextmanager
    def __call__(self) -> Iterator[None]:
        """The variable is set; it is as before once the last of several threads has left."""
        self._enter()
        try:
            yield
        finally:
            self._leave()

    def _enter(self) -> None:
        with self._lock:
            if self._users == 0:
                self._before = os.environ.get(self._variable)
                os.environ[self._variable] = self._value
            self._users += 1

    def _leave(self) -> None:
        with self._lock:
            self._users -= 1
            if self._users > 0:
                return
            if self._before is None:
                os.environ.pop(self._variable, None)
            else:
                os.environ[self._variable] = self._before


SAFE_PATH = "PYTHONSAFEPATH"
"""Environment variable under which Python does not import from the current folder.

joblib and ``multiprocessing`` start ``python -m`` or ``python -c``, which put the current folder
first on the path of modules: a user's ``joblib.py`` there would run instead of the library."""

_safe = Held(SAFE_PATH, "1")


def safe_path() -> AbstractContextManager[None]:
    """Python processes that are started meanwhile import nothing from the current folder."""
    return _safe()
