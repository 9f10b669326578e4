"""``BufferedFunction``: a CasADi function that reads and writes the same NumPy arrays every time.

Calling a function with matrices copies every number into CasADi's own and back, entry by entry;
for a Jacobian of a thousand entries that takes longer than evaluating it.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

import numpy as np

from planner.spatial import FloatArray


def into_buffers(
    function: Any, arguments: list[FloatArray], results: list[FloatArray]
) -> Callable[[], None]:
    """A call that reads and writes these arrays: nonzeros by columns, as CasADi stores them."""
    buffer, trigger = function.buffer()
    for i, array in enumerate(arguments):
        buffer.set_arg(i, array.data)
    for i, array in enumerate(results):
        buffer.set_res(i, array.data)

    def call(_kept: Any = (function, buffer)) -> None:
        trigger()

    return call


class BufferedFunction:
    """A function of dense matrices, with arguments and results of every thread's own.

    All are transposed: CasADi stores columns, NumPy rows.
    """

    def __init__(self, function: Any) -> None:
        """Keep the function.

        Raises:
            TypeError: An argument or result is sparse.
        """
        sparse = [
            name
            for names, sparsity in (
                (function.name_in(), function.sparsity_in),
                (function.name_out(), function.sparsity_out),
            )
            for i, name in enumerate(names)
            if not sparsity(i).is_dense()
        ]
        if sparse:
            raise TypeError(f"{function.name()} has entries that are not stored: {sparse}; densify")
        self._function, self._own = function, threading.local()

    def __call__(self, *arguments: FloatArray | float) -> tuple[FloatArray, ...]:
        """The results at these arguments; the thread's next call overwrites them.

        Args:
            *arguments: Each in the shape of its transpose, or one to spread.
        """
        try:
            room: _Room = self._own.room
        except AttributeError:
            room = self._own.room = _Room(self._function)
        for mine, given in zip(room.arguments, arguments, strict=True):
            mine[...] = given
        room.call()
        return room.results


class _Room:
    """Arguments and results of a function for one thread."""

    def __init__(self, function: Any) -> None:
        self.arguments = [
            np.zeros(function.size_in(i)[::-1], dtype=np.float64) for i in range(function.n_in())
        ]
        self.results: tuple[FloatArray, ...] = tuple(
            np.zeros(function.size_out(i)[::-1], dtype=np.float64) for i in range(function.n_out())
        )
        self.call = into_buffers(function, self.arguments, list(self.results))
