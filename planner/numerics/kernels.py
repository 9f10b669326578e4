"""Small loops over arrays, compiled by numba once a search lasts: ``kernel``, and when it compiles.

Where arrays are small, calling NumPy costs more than its arithmetic. A kernel is written twice: as
plain loops, which numba compiles, and in NumPy. Both give the same numbers to rounding, which a
test of each kernel checks.

Loading numba and its machine code takes half a second per process, and compiling 20 to 45 s once
per machine: more than a single plan. So attempts run in NumPy until a search lasts, and compiled
from then on. Which attempts those are is a matter of counts, never of the clock or of what was
compiled before, and the same seed gives the same plan in any thread or process:

- attempt ``PLAIN_ATTEMPTS`` of a search and all after it are compiled (``attempt_kernels``);
- in batches, and wherever ``compiled_searches`` asks for it, all attempts are;
- the environment variable ``OPPOSABLE_COMPILE`` decides for a process: "0" for never, "1" for
  always, outside of searches too.

This is the only place that decides. Outside of attempts kernels run in NumPy.

Loops may call loops: those of other kernels, and those marked ``loops_of_kernels``, which only
kernels call.
"""

from __future__ import annotations

import dis
import hashlib
import importlib
import logging
import marshal
import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from functools import lru_cache, wraps
from types import CodeType, FunctionType
from typing import Any, ParamSpec, TypeVar

from planner.errors import PlannerError, shown

__all__ = [
    "COMPILE_VARIABLE",
    "PLAIN_ATTEMPTS",
    "attempt_kernels",
    "compile_loops",
    "compiled_searches",
    "globals_read",
    "kernel",
    "kernels_are_compiled",
    "loops_of_kernels",
]

COMPILE_VARIABLE = "OPPOSABLE_COMPILE"
"""Environment variable: "0" compiles nothing, "1" everything; unset, what lasts is compiled."""

PLAIN_ATTEMPTS = 100
"""Attempts of a search that run in NumPy (-), 2 to 5 s: the default budget of one plan."""

P = ParamSpec("P")
R = TypeVar("R")

_from_the_first: ContextVar[bool] = ContextVar("compiled from the first attempt", default=False)
_compiled: ContextVar[bool | None] = ContextVar("compiled", default=None)


@contextmanager
def compiled_searches() -> Iterator[None]:
    """Compile all attempts of the searches made in this block by this thread, as batches do.

    A row's seed of a batch gives the row's plan to the bit within such a block; outside of it the
    first ``PLAIN_ATTEMPTS`` attempts run in NumPy, and the plan differs by rounding.
    """
    token = _from_the_first.set(True)
    try:
        yield
    finally:
        _from_the_first.reset(token)


@contextmanager
def attempt_kernels(index: int) -> Iterator[None]:
    """Decide for an attempt of a search whether its kernels are compiled.

    Args:
        index: Number of the attempt, from 0.

    Raises:
        PlannerError: ``OPPOSABLE_COMPILE`` is neither 0 nor 1.
    """
    lasts = _from_the_first.get() or index >= PLAIN_ATTEMPTS
    token = _compiled.set({"0": False, "1": True}.get(_asked(), lasts))
    try:
        yield
    finally:
        _compiled.reset(token)


def kernels_are_compiled() -> bool:
    """Whether kernels run compiled now, in this thread.

    Raises:
        PlannerError: ``OPPOSABLE_COMPILE`` is neither 0 nor 1.
    """
    decided = _compiled.get()
    return _asked() == "1" if decided is None else decided


def _asked() -> str:
    """The value of ``OPPOSABLE_COMPILE``, "" where it is not set."""
    asked = os.environ.get(COMPILE_VARIABLE, "")
    if asked not in {"", "0", "1"}:
        raise PlannerError(
            f"{COMPILE_VARIABLE} is {shown(asked)}; set it to 1 or to 0, or not at all"
        )
    return asked


def kernel(plain: Callable[P, R]) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """Decorate loops that numba can compile; each call runs as ``kernels_are_compiled`` says.

    Args:
        plain: The same function in NumPy, same arguments and results. The decorated function keeps
            it as ``plain``, and its own loops as ``loops``, so that a test can compare the two.
    """

    def decorate(loops: Callable[P, R]) -> Callable[P, R]:
        @wraps(loops)
        def call(*args: P.args, **kwargs: P.kwargs) -> R:
            chosen = compile_loops(loops) if kernels_are_compiled() else plain
            return chosen(*args, **kwargs)

        call.plain, call.loops = plain, loops  # type: ignore[attr-defined]
        return call

    return decorate


def loops_of_kernels(loops: Callable[P, R]) -> Callable[P, R]:
    """Mark loops that kernels call: compiled as a part of them, never on their own."""
    loops.loops = loops  # type: ignore[attr-defined]
    return loops


def compile_loops(loops: Callable[P, R]) -> Callable[P, R]:
    """Compiled loops; numba keeps the machine code beside the module, or in the user's cache.

    numba notices a change of the module that it compiles. The name under which the machine code is
    kept changes with whatever the loops call or take from other modules.
    """
    compiled: Callable[P, R] = _compile(loops, called=False)
    return compiled


@lru_cache(maxsize=1)
def _numba() -> Any:
    """numba, which tells when it begins to compile what the disk does not have.

    Raises:
        PlannerError: It cannot be loaded.
    """
    try:
        numba: Any = importlib.import_module("numba")
        event: Any = importlib.import_module("numba.core.event")
    except ImportError as error:
        raise PlannerError(
            f"numba cannot be loaded ({error}); install it (pip install numba), or set "
            f"{COMPILE_VARIABLE}=0 to plan without"
        ) from error

    class Told(event.Listener):  # type: ignore[misc]
        def __init__(self) -> None:
            self.begun: list[float] = []  # of compilations within each other

        def on_start(self, event: Any) -> None:
            _tell_once()
            self.begun.append(time.process_time())

        def on_end(self, event: Any) -> None:
            begin = self.begun.pop()
            if not self.begun:
                _compiling[0] += time.process_time() - begin

    event.register("numba:compile", Told())
    return numba


_compiling = [0.0]
"""CPU time (s) that this process has spent on compiling."""


def planning_time() -> float:
    """CPU time (s) of this process without that of compiling: what a budget in seconds counts."""
    return time.process_time() - _compiling[0]


@lru_cache(maxsize=1)
def _tell_once() -> None:
    logging.getLogger(__name__).warning(
        "compiling the inner loops for this machine, once: 20 to 45 s of CPU"
    )


@lru_cache(maxsize=256)
def _compile(loops: Any, *, called: bool) -> Any:
    """Compiled loops; those that others call can be called from Python only slowly, if at all."""
    numba = _numba()
    calls = {name: value.loops for name, value in _taken(loops).items() if hasattr(value, "loops")}
    globals_ = {
        **loops.__globals__,
        **{name: _compile(one, called=True) for name, one in calls.items()},
    }
    copy = FunctionType(loops.__code__, globals_, loops.__name__, loops.__defaults__)
    copy.__qualname__ = f"{loops.__qualname__}_{_digest(loops)[:12]}"
    options = {"fastmath": False, "error_model": "numpy", "no_cfunc_wrapper": True}
    compiled = numba.njit(cache=not called, no_cpython_wrapper=called, **options)(copy)
    if called:
        _compile_once(compiled)
    return compiled


def _compile_once(compiled: Any) -> None:
    """Compile loops once for all whole numbers that others call them with.

    numba compiles anew for every number that is written out in a call. Where a version of it has no
    such method, it does: slower once, and with the same results.
    """
    unliteral = _numba().types.unliteral
    template_for = getattr(compiled, "get_call_template", None)
    if template_for is None:
        return

    def template(args: Any, kws: Any) -> Any:
        plain = tuple(unliteral(a) for a in args)
        return template_for(plain, {name: unliteral(a) for name, a in kws.items()})

    compiled.get_call_template = template


WITHOUT_REFERENCES = 2
"""Version of ``marshal`` whose bytes do not tell whether the code was read from a ``.pyc`` file."""


@lru_cache(maxsize=256)
def _digest(loops: Any) -> str:
    """Digest of loops, of the numbers that they take from modules, and of the loops they call."""
    parts = [marshal.dumps(_without_place(loops.__code__), WITHOUT_REFERENCES)]
    for value in _taken(loops).values():
        if hasattr(value, "loops"):
            parts.append(_digest(value.loops).encode())
        elif isinstance(value, int | float | str | tuple):
            parts.append(repr(value).encode())
    return hashlib.sha256(b"\0".join(parts)).hexdigest()


@lru_cache(maxsize=256)
def _taken(loops: Any) -> dict[str, Any]:
    """What loops take from their module, by name."""
    names = sorted(globals_read(loops.__code__))
    return {name: loops.__globals__[name] for name in names if name in loops.__globals__}


LOAD_GLOBAL, EXTENDED_ARG = dis.opmap["LOAD_GLOBAL"], dis.opmap["EXTENDED_ARG"]

FLAG_BITS = 1
"""Bits of the argument of ``LOAD_GLOBAL`` below the number of the name."""


def globals_read(code: CodeType) -> set[str]:
    """Names that code reads from its module: what ``dis`` tells, twenty times faster.

    ``dis`` describes every instruction, and every process that loads kernels asks for them all.
    """
    names, extended = set(), 0
    for operation, low in zip(code.co_code[::2], code.co_code[1::2], strict=True):
        argument = extended << 8 | low
        extended = argument if operation == EXTENDED_ARG else 0
        if operation == LOAD_GLOBAL:
            names.add(code.co_names[argument >> FLAG_BITS])
    return names


def _without_place(code: CodeType) -> CodeType:
    """Code that does not know where its file lies."""
    return code.replace(co_filename="", co_firstlineno=1, co_linetable=b"")
