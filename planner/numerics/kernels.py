"""Small loops over arrays, compiled where numba is installed (extra ``fast``): ``kernel``.

Where arrays are small, calling NumPy costs more than its arithmetic. A kernel is written twice: as
plain loops, which numba compiles, and in NumPy, which runs where numba is missing or not wanted
(``OPPOSABLE_COMPILE=0``). Both give the same numbers to rounding, which a test of each kernel
checks. numba is imported at the first call of a kernel, never before: that costs 0.3 s.

Loops may call loops: those of other kernels, and those marked ``loops_of_kernels``, which only
kernels call.
"""

from __future__ import annotations

import dis
import hashlib
import importlib
import importlib.util
import marshal
import os
from collections.abc import Callable
from functools import lru_cache, wraps
from types import CodeType, FunctionType
from typing import Any, ParamSpec, TypeVar

__all__ = [
    "COMPILE_VARIABLE",
    "compile_loops",
    "globals_read",
    "kernel",
    "kernels_are_compiled",
    "loops_of_kernels",
]

COMPILE_VARIABLE = "OPPOSABLE_COMPILE"
"""Environment variable: "0" compiles nothing, "1" compiles expressions of CasADi too."""

P = ParamSpec("P")
R = TypeVar("R")


def kernels_are_compiled() -> bool:
    """Whether kernels run compiled: numba is installed, and ``OPPOSABLE_COMPILE`` is not 0."""
    return os.environ.get(COMPILE_VARIABLE, "") != "0" and _HAS_NUMBA


_HAS_NUMBA = importlib.util.find_spec("numba") is not None


def kernel(plain: Callable[P, R]) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """Decorate loops that numba can compile; the first call decides for the whole process.

    Args:
        plain: The same function in NumPy, same arguments and results. The decorated function keeps
            it as ``plain``, and its own loops as ``loops``, so that a test can compare the two.
    """

    def decorate(loops: Callable[P, R]) -> Callable[P, R]:
        chosen: Callable[P, R] | None = None

        @wraps(loops)
        def call(*args: P.args, **kwargs: P.kwargs) -> R:
            nonlocal chosen
            if chosen is None:
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


@lru_cache(maxsize=256)
def _compile(loops: Any, *, called: bool) -> Any:
    """Compiled loops; those that others call can be called from Python only slowly, if at all."""
    numba: Any = importlib.import_module("numba")
    calls = {name: value.loops for name, value in _taken(loops).items() if hasattr(value, "loops")}
    globals_ = {
        **loops.__globals__,
        **{name: _compile(one, called=True) for name, one in calls.items()},
    }
    copy = FunctionType(loops.__code__, globals_, loops.__name__, loops.__defaults__)
    copy.__qualname__ = f"{loops.__qualname__}_{_digest(loops)[:12]}"
    options = {"fastmath": False, "error_model": "numpy", "no_cfunc_wrapper": True}
    return numba.njit(cache=not called, no_cpython_wrapper=called, **options)(copy)


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
