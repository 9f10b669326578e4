"""Data that threads share, data of one thread, and settings of the process for a while.

Hands, tasks, shapes, plans and expressions never change once they are made. Threads share them;
``made_once`` and ``built`` let one thread make each while the others wait. Arrays that a
computation writes into, and engines that remember their last query, belong to one thread:
``kept_by_thread`` gives every thread its own. So functions of this package may be called from any
number of threads, and a seed gives the same plan in each.

An object with a state of its own is for one thread at a time: ``CollisionWorld``, ``ForceLoop``,
``MovingHand``, ``Residuals`` and iterators of attempts. Make one for every thread.

CasADi lets other threads run while it computes, and counts references to its expressions without
locks of its own in some builds. So expressions are only ever made under ``BUILDING``.

``stage`` tells where the time of an attempt goes: CPU seconds, for the benchmark of synthesis.
``with stage("solve"):`` adds to whoever is timing; nobody as a rule, and then it costs a
microsecond. Stages may nest; the inner one's time is not the outer one's.

Environment variables and the answer to Ctrl-C are set for a while, ``safe_path`` and the like;
processes that are started meanwhile inherit the variables.

A recorder appends to several lists for one sample. A ``KeyboardInterrupt`` between two of them
would leave a sample of which half is missing: ``interrupts_wait`` holds it back meanwhile.
"""

from __future__ import annotations

import os
import signal
import threading
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from contextvars import ContextVar
from functools import lru_cache, wraps
from typing import Any, Generic, ParamSpec, TypeVar, overload

P = ParamSpec("P")
T = TypeVar("T")

BUILDING = threading.RLock()
"""Held by the thread that makes something for all; one lock, so that no two can wait for each
other."""


def made_once(size: int) -> Callable[[Callable[P, T]], Callable[P, T]]:
    """A function whose last results are kept for all threads; one thread at a time computes.

    For immutable results.

    Args:
        size: How many are kept.
    """

    def decorate(make: Callable[P, T]) -> Callable[P, T]:
        cached: Callable[..., T] = lru_cache(maxsize=size)(make)

        @wraps(make)
        def get(*args: P.args, **kwargs: P.kwargs) -> T:
            with BUILDING:
                return cached(*args, **kwargs)

        return get

    return decorate


def kept_by_thread(size: int) -> Callable[[Callable[P, T]], Callable[P, T]]:
    """A function whose last results are kept for the thread that asked, and for no other.

    For results with a state: worlds, workspaces, solvers. Ask anew wherever one is used, since the
    holder may have moved on to another thread.

    Args:
        size: How many a thread keeps; they go with it.
    """

    def decorate(make: Callable[P, T]) -> Callable[P, T]:
        mine = threading.local()

        @wraps(make)
        def get(*args: P.args, **kwargs: P.kwargs) -> T:
            try:
                cached = mine.cached
            except AttributeError:
                cached = mine.cached = lru_cache(maxsize=size)(make)
            result: T = cached(*args, **kwargs)
            return result

        return get

    return decorate


class _Quiet:
    """Number of open blocks without warnings, and the settings that the first one found."""

    def __init__(self) -> None:
        self.lock, self.blocks = threading.Lock(), 0
        self.before = warnings.catch_warnings()


_QUIET = _Quiet()


@contextmanager
def without_warnings() -> Iterator[None]:
    """No warnings meanwhile, in any thread; the last block restores the process's settings.

    ``warnings.catch_warnings`` changes the settings of the whole process. Two threads that leave it
    in the order in which they entered leave them changed for good.
    """
    with _QUIET.lock:
        if _QUIET.blocks == 0:
            _QUIET.before = warnings.catch_warnings()
            _QUIET.before.__enter__()
            warnings.simplefilter("ignore")
        _QUIET.blocks += 1
    try:
        yield
    finally:
        with _QUIET.lock:
            _QUIET.blocks -= 1
            if _QUIET.blocks == 0:
                _QUIET.before.__exit__(None, None, None)


class built(Generic[T]):
    """An attribute that is computed when first asked for, by one thread, under ``BUILDING``.

    Like ``functools.cached_property``, which has a lock of its own in Python 3.11 and none later.
    """

    def __init__(self, make: Callable[[Any], T]) -> None:
        """Keep the function; its name is that of the attribute."""
        self._make, self._name, self.__doc__ = make, make.__name__, make.__doc__

    @overload
    def __get__(self, holder: None, kind: type | None = None) -> built[T]: ...

    @overload
    def __get__(self, holder: object, kind: type | None = None) -> T: ...

    def __get__(self, holder: object | None, kind: type | None = None) -> built[T] | T:
        """The value; from then on it stands in the holder's own dictionary."""
        if holder is None:
            return self
        with BUILDING:
            kept: dict[str, Any] = holder.__dict__
            if self._name not in kept:
                kept[self._name] = self._make(holder)
            value: T = kept[self._name]
            return value


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
