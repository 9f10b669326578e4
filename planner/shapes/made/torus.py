"""Ring."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from planner.errors import ObjectError
from planner.shapes.made.base import Made
from planner.shapes.made.weave import Weave, circle
from planner.spatial import FloatArray, IntArray

__all__ = ["Torus"]

AROUND, ACROSS = 72, 36
"""Points around the ring and around its tube: the facets deviate by 0.1 mm at the default size."""


@dataclass(frozen=True)
class Torus(Made):
    """A ring about z.

    Attributes:
        ring: Radius of the circle in the middle of the tube, m.
        tube: Radius of the tube, m; less than ``ring``.
    """

    kind: ClassVar[str] = "torus"
    size_names: ClassVar[tuple[str, ...]] = ("ring", "tube")
    default_sizes: ClassVar[tuple[float, ...]] = (0.035, 0.015)
    ring: float = 0.035
    tube: float = 0.015

    def _check(self) -> None:
        if self.tube >= 0.98 * self.ring:
            raise ObjectError(
                f"torus: tube {self.tube} m closes the hole of ring {self.ring} m; give a thinner "
                "tube or a wider ring"
            )

    def _triangles(self) -> tuple[FloatArray, IntArray]:
        # rings run around the tube; going around z they are stacked along y at angle 0
        turn, c = circle(AROUND), circle(ACROSS)
        radial = self.ring + self.tube * c[:, 0]
        rings = np.empty((AROUND, ACROSS, 3))
        rings[:, :, :2] = turn[:, None] * radial[None, :, None]
        rings[:, :, 2] = -self.tube * c[:, 1]
        weave = Weave()
        weave.stack(rings, closed=True)
        return weave.triangles()
