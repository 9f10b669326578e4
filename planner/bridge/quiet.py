"""MuJoCo without its log, which is a file MUJOCO_LOG.TXT in the current folder by default.

What matters of a warning is read elsewhere: numbers that diverge from ``data.warning``, what a
model lost from the model.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager

import mujoco

__all__ = ["without_log"]

_lock = threading.Lock()
_inside = [0]


@contextmanager
def without_log() -> Iterator[None]:
    """MuJoCo writes no warnings meanwhile; several threads and blocks within blocks are fine.

    MuJoCo has one handler of warnings: one of the user's own is not there any more afterwards.
    """
    with _lock:
        _inside[0] += 1
        mujoco.set_mju_user_warning(_ignore)
    try:
        yield
    finally:
        with _lock:
            _inside[0] -= 1
            if _inside[0] == 0:
                mujoco.set_mju_user_warning(None)


def _ignore(message: str) -> None:
    """Do nothing with a warning."""
