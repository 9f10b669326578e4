"""``BufferedFunction``: a CasADi function that reads and writes NumPy arrays which are kept.

Calling a function with matrices copies every number into CasADi's own and back, entry by entry;
for a Jacobian of a thousand entries that takes longer than evaluating it.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from planner.spatial import FloatArray

__all__ = ["BufferedFunction", "into_buffers"]


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
    """A function of dense matrices, with its own arguments and results.

    All are transposed: CasADi stores columns, NumPy rows.

    Attributes:
        results: As the last call left them; the next one overwrites them.
    """

    def __init__(self, function: Any) -> None:
        """Make room for arguments and results, whose entries must all be there."""
        self._arguments = [
            np.zeros(function.size_in(i)[::-1], dtype=np.float64) for i in range(function.n_in())
        ]
        self.results: tuple[FloatArray, ...] = tuple(
            np.zeros(function.size_out(i)[::-1], dtype=np.float64) for i in range(function.n_out())
        )
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
        self._call = into_buffers(function, self._arguments, list(self.results))

    def __call__(self, *arguments: FloatArray | float) -> tuple[FloatArray, ...]:
        """The results at these arguments, each in the shape of its transpose or one to spread."""
        for mine, given in zip(self._arguments, arguments, strict=True):
            mine[...] = given
        self._call()
        return self.results
