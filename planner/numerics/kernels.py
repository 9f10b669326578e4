"""Small loops over arrays, compiled where numba is installed (extra ``fast``): ``kernel``.

Where arrays are small, calling NumPy costs more than its arithmetic. A kernel is written twice: as
plain loops, which numba compiles, and in NumPy, which runs where numba is missing or not wanted
(``OPPOSABLE_COMPILE=0``). Both give the same numbers to rounding, which a test of each kernel
checks. numba is imported at the first call of a kernel, never before: that costs 0.3 s.
"""

from __future__ import annotations

import importlib
import importlib.util
import os
from collections.abc import Callable
from functools import wraps
from typing import Any, ParamSpec, TypeVar

__all__ = ["COMPILE_VARIABLE", "compile_loops", "kernel", "kernels_are_compiled"]

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


def compile_loops(loops: Callable[P, R]) -> Callable[P, R]:
    """Compiled loops; numba keeps the machine code beside the module, or in the user's cache."""
    numba: Any = importlib.import_module("numba")
    compiled: Callable[P, R] = numba.njit(cache=True, fastmath=False, error_model="numpy")(loops)
    return compiled
