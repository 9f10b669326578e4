"""Angle bracket."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from planner.errors import ObjectError
from planner.shapes.made.base import Made
from planner.shapes.made.weave import Weave
from planner.spatial import FloatArray, IntArray

__all__ = ["LBracket"]


@dataclass(frozen=True)
class LBracket(Made):
    """Two plates at a right angle: one lies along x, the other stands along z; extruded along y.

    Attributes:
        length: Extent along x, m.
        height: Extent along z, m.
        width: Extent along y, m.
        thickness: Of both plates, m; less than length and height.
    """

    kind: ClassVar[str] = "lbracket"
    size_names: ClassVar[tuple[str, ...]] = ("length", "height", "width", "thickness")
    default_sizes: ClassVar[tuple[float, ...]] = (0.09, 0.08, 0.045, 0.025)
    length: float = 0.09
    height: float = 0.08
    width: float = 0.045
    thickness: float = 0.025

    def _check(self) -> None:
        if self.thickness >= 0.98 * min(self.length, self.height):
            raise ObjectError(
                f"lbracket: thickness {self.thickness} m leaves no corner in {self.length} x "
                f"{self.height} m; give a smaller thickness"
            )

    def _triangles(self) -> tuple[FloatArray, IntArray]:
        a, h, t = self.length, self.height, self.thickness
        # counter-clockwise seen against y: about the direction of the stack
        outline = np.array([[0, 0], [0, h], [t, h], [t, t], [a, t], [a, 0]])
        ring = np.insert(outline, 1, 0.0, axis=1)
        rings = np.stack([ring, ring + np.array([0.0, self.width, 0.0])])
        weave = Weave()
        index = weave.stack(rings)
        weave.faces(np.array([[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 4, 5]]), index[1])
        weave.faces(np.array([[2, 1, 0], [3, 2, 0], [4, 3, 0], [5, 4, 0]]), index[0])
        return weave.triangles()
