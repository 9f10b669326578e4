"""Mug: a hollow cup with a handle, as one closed surface."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from planner.errors import ObjectError
from planner.shapes.made.base import Made
from planner.shapes.made.weave import Weave, circle
from planner.spatial import FloatArray, IntArray

__all__ = ["Mug"]

AROUND = 72
"""Points around the cup."""

WALL, FLOOR = 0.1, 0.12
"""Thickness of wall and floor, as fractions of the radius."""

ROUNDING = 0.1
"""Radius of the rounded edge at the bottom, outside and inside, as a fraction of the radius."""

BLOCK = 4
"""Cells of the wall, along and up, that each end of the handle takes the place of."""

GRIP = 0.15
"""Radius of the handle's bar, as a fraction of the cup's radius."""

REACH = 0.75
"""How far the middle of the handle's bar is from the wall, as a fraction of the cup's radius."""

BEND = 1.5
"""Smallest radius to which the handle's middle is bent, in radii of its bar."""

SLENDER, SQUAT = 6.0, 1.4
"""Largest and smallest height, in radii: the handle must fit, and the cells stay near square."""


@dataclass(frozen=True)
class Mug(Made):
    """A cup about z, open at the top, with a handle towards +x.

    Attributes:
        radius: Outer radius of the cup, m.
        height: Of the cup, m.
    """

    kind: ClassVar[str] = "mug"
    size_names: ClassVar[tuple[str, ...]] = ("radius", "height")
    default_sizes: ClassVar[tuple[float, ...]] = (0.04, 0.09)
    radius: float = 0.04
    height: float = 0.09

    def _check(self) -> None:
        if not SQUAT * self.radius <= self.height <= SLENDER * self.radius:
            raise ObjectError(
                f"mug: height {self.height} m does not go with radius {self.radius} m; give a "
                f"height from {SQUAT} to {SLENDER} radii"
            )

    def _triangles(self) -> tuple[FloatArray, IntArray]:
        profile, first, rows = self._profile()
        c = np.roll(circle(AROUND), BLOCK // 2, axis=0)  # the handle's cells straddle angle 0
        rings = np.empty((len(profile), AROUND, 3))
        rings[:, :, :2] = profile[:, None, :1] * c
        rings[:, :, 2] = profile[:, 1, None]
        # the wall's cells run from ring `first` upwards
        margin = max(1, round(0.15 * rows))
        low, high = first + margin, first + rows - margin - BLOCK
        cells = [
            np.stack(np.meshgrid(start + np.arange(BLOCK), np.arange(BLOCK)), axis=-1).reshape(
                -1, 2
            )
            for start in (low, high)
        ]
        weave = Weave()
        index = weave.stack(rings, without=np.concatenate(cells))
        floor = FLOOR * self.radius
        weave.cap(index[0], np.zeros(3), last=False)
        weave.cap(index[-1], np.array([0.0, 0.0, floor]), last=True)
        y, z = np.array([0.0, 1.0, 0.0]), np.array([0.0, 0.0, 1.0])
        upper, angles = weave.around(index, cells[1], y, z)
        lower, _ = weave.around(index, cells[0], y, -z)
        middle = [profile[k + BLOCK // 2, 1] for k in (low, high)]
        bars = weave.stack(self._handle(middle[0], middle[1], angles))
        weave.join(upper, bars[0])
        weave.join(bars[-1], lower)
        return weave.triangles()

    def _profile(self) -> tuple[FloatArray, int, int]:
        """Outline (k, 2): radius and z, from the bottom's middle over the rim to the inside.

        Also the ring at which the straight outer wall begins, and its count of cells.
        """
        r, h = self.radius, self.height
        wall, floor, edge = WALL * r, FLOOR * r, ROUNDING * r
        rim = wall / 2
        quarter = np.linspace(0.0, np.pi / 2, 5)
        outer = [(r - edge + edge * np.sin(a), edge - edge * np.cos(a)) for a in quarter]
        rows = max(2 * BLOCK + 3, round((h - edge - rim) / (2 * np.pi * r / AROUND)))
        straight = [(r, z) for z in np.linspace(edge, h - rim, rows + 1)[1:]]
        half = np.linspace(0.0, np.pi, 9)[1:-1]
        lip = [(r - rim + rim * np.cos(a), h - rim + rim * np.sin(a)) for a in half]
        inside = r - wall
        inner = [(inside, z) for z in np.linspace(h - rim, floor + edge, rows + 1)]
        bend = [
            (inside - edge + edge * np.cos(a), floor + edge - edge * np.sin(a)) for a in quarter[1:]
        ]
        rounds = np.array([0.3, 0.6])
        below = [(share * (r - edge), 0.0) for share in rounds]
        above = [(share * (inside - edge), floor) for share in rounds[::-1]]
        profile = np.array(below + outer + straight + lip + inner + bend + above)
        return profile, len(below) + len(outer) - 1, rows

    def _handle(self, low: float, high: float, angles: FloatArray) -> FloatArray:
        """Rings (k, n, 3) of the bar from the upper to the lower end, m.

        Args:
            low: z of the middle of the lower end, m.
            high: z of the middle of the upper end, m.
            angles: (n,), of the points of a ring, from y towards up, rad.
        """
        grip, rise = GRIP * self.radius, (high - low) / 2
        # a bar must not bend more sharply than it is thick, which a low mug's would
        reach = min(REACH * self.radius, rise**2 / (BEND * grip))
        # an ellipse that leaves the wall and comes back to it at right angles
        begin = np.arcsin(0.08)
        t = np.linspace(begin, np.pi - begin, 33)
        path = np.column_stack(
            [self.radius + reach * np.sin(t), np.zeros_like(t), (low + high) / 2 + rise * np.cos(t)]
        )
        along = np.column_stack([reach * np.cos(t), np.zeros_like(t), -rise * np.sin(t)])
        along /= np.linalg.norm(along, axis=1, keepdims=True)
        y = np.array([0.0, 1.0, 0.0])
        up = np.cross(along, y)
        rings: FloatArray = path[:, None] + grip * (
            np.cos(angles)[:, None] * y + np.sin(angles)[:, None] * up[:, None]
        )
        return rings
