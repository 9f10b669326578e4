"""Settings of the process for a while: environment variables, and the answer to Ctrl-C.

Processes that are started meanwhile inherit the variables.

A recorder appends to several lists for one sample. A ``KeyboardInterrupt`` between two of them
would leave a sample of which half is missing: ``interrupts_wait`` holds it back meanwhile.
"""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from typing import Any


class Held:
    """One variable with one value, set while at least one thread needs it.

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


@contextmanager
def on_interrupt(handler: Callable[..., Any] | signal.Handlers) -> Iterator[None]:
    """Ctrl-C calls a handler meanwhile; nothing changes outside of the main thread.

    Args:
        handler: As for ``signal.signal``.
    """
    if threading.current_thread() is not threading.main_thread():
        yield  # signals are handled by the main thread
        return
    before = signal.signal(signal.SIGINT, handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


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


@contextmanager
def unheard_by_children() -> Iterator[None]:
    """Processes that are started meanwhile never hear Ctrl-C; this one hears it right afterwards.

    The signal is blocked, which a child inherits also across ``exec``. Ignoring it instead would
    lose a Ctrl-C that comes meanwhile. Another thread may still receive it: so it waits, too.
    """
    with interrupts_wait():
        if not hasattr(signal, "pthread_sigmask"):  # Windows
            yield
            return
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            yield
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
