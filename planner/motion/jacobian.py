"""``MotionJacobian``: rows that depend on what all knots share and on one knot or two neighbours.

Kept as blocks. A descent needs J'J and J'r; of blocks they take a tenth of what the product of the
whole matrix does, which has some 900 rows and 220 columns and is mostly zeros.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from planner.motion.unknowns import SHARED
from planner.spatial import FloatArray

__all__ = ["Block", "MotionJacobian"]


@dataclass(frozen=True, kw_only=True)
class Block:
    """Some rows with the residuals that they are the derivatives of.

    Attributes:
        values: Residuals (m,).
        rows: Derivatives (m, SHARED + w): by what all knots share, then by the unknowns ``at``.
        at: Which w unknowns those are, after the shared ones.
    """

    values: FloatArray
    rows: FloatArray
    at: slice

    def head(self, n: int) -> Block:
        """The first n rows."""
        return Block(values=self.values[:n], rows=self.rows[:n], at=self.at)

    def tail(self, n: int) -> Block:
        """All rows but the first n."""
        return Block(values=self.values[n:], rows=self.rows[n:], at=self.at)


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

    def dense(self) -> FloatArray:
        """The whole matrix (m, size)."""
        out = np.zeros((sum(len(b.values) for b in self._blocks), self._size))
        first = 0
        for block in self._blocks:
            mine = out[first : first + len(block.values)]
            mine[:, :SHARED], mine[:, block.at] = block.rows[:, :SHARED], block.rows[:, SHARED:]
            first += len(mine)
        return out
