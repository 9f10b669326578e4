"""Where the time of an attempt goes: CPU seconds by stage, for the benchmark of synthesis.

``with stage("solve"):`` adds to whoever is timing; nobody as a rule, and then it costs a
microsecond. Stages may nest; the inner one's time is not the outer one's.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

__all__ = ["stage", "timed"]


class _Clock:
    """Time by stage, and how much of the running stage belongs to inner ones."""

    def __init__(self) -> None:
        self.spent: dict[str, float] = {}
        self.inner = 0.0


_clock: ContextVar[_Clock | None] = ContextVar("clock", default=None)


@contextmanager
def timed() -> Iterator[dict[str, float]]:
    """Time the stages within; the dictionary fills while they run, CPU s by name."""
    clock = _Clock()
    token = _clock.set(clock)
    try:
        yield clock.spent
    finally:
        _clock.reset(token)


@contextmanager
def stage(name: str) -> Iterator[None]:
    """What runs within is this stage."""
    clock = _clock.get()
    if clock is None:
        yield
        return
    outer, clock.inner = clock.inner, 0.0
    begin = time.process_time()
    try:
        yield
    finally:
        whole = time.process_time() - begin
        clock.spent[name] = clock.spent.get(name, 0.0) + whole - clock.inner
        clock.inner = outer + whole
