"""Hammer: a cylindrical head across a round handle, as one closed surface."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from planner.errors import ObjectError
from planner.shapes.made.base import Made
from planner.shapes.made.weave import Weave, circle
from planner.spatial import FloatArray, IntArray

__all__ = ["Hammer"]

AROUND = 32
"""Points around the head."""

BLOCK = 8
"""Cells of the head, around and along, that the handle takes the place of: a quarter turn."""

GRIP = 0.72
"""Radius of the handle, as a fraction of the head's."""

CHAMFER = 0.15
"""Chamfer of the edges, as a fraction of the head's radius."""

ROW = 0.004
"""Distance of rings along the handle, m, about."""

SHORTEST_HEAD, SHORTEST_HANDLE = 2.5, 2.0
"""Smallest width of the head and length of the handle, in radii of the head."""


@dataclass(frozen=True)
class Hammer(Made):
    """A head along x on a handle along z.

    Attributes:
        length: From the end of the handle to the top of the head, m.
        head: Width of the head, end to end, m.
        radius: Of the head, m.
    """

    kind: ClassVar[str] = "hammer"
    size_names: ClassVar[tuple[str, ...]] = ("length", "head", "radius")
    default_sizes: ClassVar[tuple[float, ...]] = (0.2, 0.09, 0.02)
    length: float = 0.20
    head: float = 0.09
    radius: float = 0.02

    def _check(self) -> None:
        handle = self.length - 2 * self.radius
        if self.head < SHORTEST_HEAD * self.radius or handle < SHORTEST_HANDLE * self.radius:
            raise ObjectError(
                f"hammer: head {self.head} m and length {self.length} m are too short for radius "
                f"{self.radius} m; give a head of at least {SHORTEST_HEAD} radii and a length of "
                f"at least {SHORTEST_HANDLE + 2} radii"
            )

    def _triangles(self) -> tuple[FloatArray, IntArray]:
        r, half, bevel = self.radius, self.head / 2, CHAMFER * self.radius
        # rings across x; the handle's cells straddle the lowest point
        side = np.sqrt(2.0) * r / BLOCK
        rows = max(2, round((half - bevel - BLOCK / 2 * side) / side))
        right = np.linspace(BLOCK / 2 * side, half - bevel, rows + 1)
        x = np.concatenate([-right[::-1], side * (np.arange(1, BLOCK) - BLOCK / 2), right])
        x = np.concatenate([[-half], x, [half]])
        radii = np.full(len(x), r)
        radii[[0, -1]] = r - bevel
        c = np.roll(circle(AROUND), BLOCK // 2, axis=0)
        rings = np.empty((len(x), AROUND, 3))
        rings[:, :, 0] = x[:, None]
        rings[:, :, 1] = radii[:, None] * c[:, 1]
        rings[:, :, 2] = -radii[:, None] * c[:, 0]
        first = rows + 1
        cells = np.stack(np.meshgrid(first + np.arange(BLOCK), np.arange(BLOCK)), axis=-1).reshape(
            -1, 2
        )
        weave = Weave()
        index = weave.stack(rings, without=cells)
        weave.cap(index[0], np.array([-half, 0.0, 0.0]), last=False)
        weave.cap(index[-1], np.array([half, 0.0, 0.0]), last=True)
        e1, e2 = np.array([1.0, 0.0, 0.0]), np.array([0.0, -1.0, 0.0])
        rim, angles = weave.around(index, cells, e1, e2)
        grip, end = GRIP * r, self.length - r
        steps = max(4, round((end - bevel - 1.15 * r) / ROW))
        z = np.append(np.linspace(1.15 * r, end - bevel, steps), end)
        thick = np.append(np.full(steps, grip), grip - bevel)
        bar = np.empty((len(z), len(rim), 3))
        bar[:, :, 0] = thick[:, None] * np.cos(angles)
        bar[:, :, 1] = -thick[:, None] * np.sin(angles)
        bar[:, :, 2] = -z[:, None]
        bars = weave.stack(bar)
        weave.join(rim, bars[0])
        weave.cap(bars[-1], np.array([0.0, 0.0, -end]), last=True)
        return weave.triangles()
