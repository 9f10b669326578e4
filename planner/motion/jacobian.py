"""``MotionJacobian``: rows that depend on what all knots share and on one knot or two neighbours.

Kept as blocks. Least squares need J'J and J'r; of blocks they take a tenth of the time that the
product of the whole matrix takes, which has some 900 rows and 220 columns and is mostly zeros.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from planner.motion.unknowns import SHARED
from planner.spatial import FloatArray
from planner.synthesis.terms.term import Row


@dataclass(frozen=True, kw_only=True)
class Block:
    """Some rows with the residuals that they are the derivatives of.

    Attributes:
        values: Residuals (m,).
        rows: Derivatives (m, SHARED + w): by what all knots share, then by the unknowns ``at``.
        at: Which w unknowns those are, after the shared ones.
        names: Tells the names of the rows (m).
    """

    values: FloatArray
    rows: FloatArray
    at: slice
    names: Callable[[], Sequence[Row]]

    def head(self, n: int) -> Block:
        """The first n rows."""
        return self._part(slice(n))

    def tail(self, n: int) -> Block:
        """All rows but the first n."""
        return self._part(slice(n, None))

    def _part(self, which: slice) -> Block:
        return Block(
            values=self.values[which],
            rows=self.rows[which],
            at=self.at,
            names=lambda: self.names()[which],
        )


class MotionJacobian:
    """A Jacobian (m, size) in blocks, one under the other."""

    def __init__(self, blocks: list[Block], size: int) -> None:
        """Keep the blocks, in their order, and the number of unknowns."""
        self._blocks, self._size = blocks, size

    def normal_equations(self) -> tuple[FloatArray, FloatArray]:
        """J'J (size, size) and J'r (size,) with the blocks' residuals."""
        normal, slope = np.zeros((self._size, self._size)), np.zeros(self._size)
        for block in self._blocks:
            if not len(block.values):
                continue
            product, pull = block.rows.T @ block.rows, block.values @ block.rows
            at = block.at
            normal[:SHARED, :SHARED] += product[:SHARED, :SHARED]
            normal[:SHARED, at] += product[:SHARED, SHARED:]
            normal[at, at] += product[SHARED:, SHARED:]
            slope[:SHARED] += pull[:SHARED]
            slope[at] += pull[SHARED:]
        normal[SHARED:, :SHARED] = normal[:SHARED, SHARED:].T
        return normal, slope

    def row_names(self) -> list[Row]:
        """The names of all rows, in their order."""
        return [row for block in self._blocks for row in block.names()]

    def dense(self) -> FloatArray:
        """The whole matrix (m, size)."""
        out = np.zeros((sum(len(b.values) for b in self._blocks), self._size))
        first = 0
        for block in self._blocks:
            mine = out[first : first + len(block.values)]
            mine[:, :SHARED], mine[:, block.at] = block.rows[:, :SHARED], block.rows[:, SHARED:]
            first += len(mine)
        return out
