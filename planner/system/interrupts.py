"""``interrupts_wait``: lines between which Ctrl-C does not come, so that lists stay of one length.

A recorder appends to several lists for one sample. A ``KeyboardInterrupt`` between two of them
would leave a sample of which half is missing.
"""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

__all__ = ["interrupts_wait"]

_SIGNALS: tuple[int, ...] = (signal.SIGINT, signal.SIGTERM)
"""What ends a command: Ctrl-C, and what a system sends to whatever runs too long."""


@contextmanager
def interrupts_wait() -> Iterator[None]:
    """Let the lines inside end before an interrupt is heard; it is heard right after them.

    Signals whose handler is Python's wait; those that the system handles or ignores act as before.
    Outside the main thread, where Python hears no signals, nothing is done. Costs a microsecond or
    two; for lines that end soon.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    heard: list[tuple[int, Any]] = []
    handlers: dict[int, Any] = {}

    def wait(number: int, frame: Any) -> None:
        heard.append((number, frame))

    try:
        for number in _SIGNALS:
            handler = signal.getsignal(number)
            if callable(handler):
                handlers[number] = handler
                signal.signal(number, wait)
        yield
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
        for number, frame in heard:
            handlers[number](number, frame)
