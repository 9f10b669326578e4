"""Vessels of thin walls with a handle: teacup and pan.

The handle grows out of the outer wall: a patch of the wall's squares is left out, and rings of as
many points as its border has run from there along the handle.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from planner.errors import ObjectError
from planner.shapes.made.walled import AROUND, Walled, closed_shell, revolved, spaced
from planner.shapes.made.woven import stacked
from planner.spatial import FloatArray, IntArray

HALF = 1
"""Half the width of a patch, in squares of the wall."""

BENDS = 18
"""Rings along a bent handle."""


class _Handled(Walled):
    """A cup whose outer wall has patches about +x, where handles begin.

    The rings of its straight wall are the outline's points from ``_bottom`` on.
    """

    radius: float
    height: float
    wall: float

    def _outline(self) -> tuple[FloatArray, int, int]:
        """The outline, and the numbers of its rings at the lower and upper end of the wall."""
        r, top = self.radius, self.height - self.wall / 2
        corners = np.array([[0, 0], [r, 0], [r, top]])
        outline = spaced(closed_shell(corners, self.wall))
        bottom = len(spaced(corners[:2])) - 2  # the pole is no ring
        return outline, bottom, len(spaced(corners)) - 2

    def _patch(self, row: int, half_rows: int) -> IntArray:
        """Vertices (k,) around a patch, from the middle of its +y side on, upwards."""
        a, b = HALF, half_rows
        up = [(a, k) for k in range(b)]
        back = [(k, b) for k in range(a, -a, -1)]
        down = [(-a, k) for k in range(b, -b, -1)]
        forth = [(k, -b) for k in range(-a, a)]
        rise = [(a, k) for k in range(-b, 0)]
        border = np.array([*up, *back, *down, *forth, *rise])
        out: IntArray = AROUND * (row + border[:, 1]) + border[:, 0] % AROUND
        return out


def _without_patches(faces: IntArray, patches: list[tuple[int, int]]) -> IntArray:
    """Faces of a revolved outline but for those of patches (row of the middle, half its rows)."""
    row, turn = np.divmod(faces, AROUND)
    turn = (turn + AROUND // 2) % AROUND - AROUND // 2  # 0 at +x
    within = np.abs(turn).max(axis=1) <= HALF
    for middle, half in patches:
        faces_in = within & (np.abs(row - middle).max(axis=1) <= half)
        faces, row, within = faces[~faces_in], row[~faces_in], within[~faces_in]
    return faces


def _joined(vertices: FloatArray, faces: IntArray) -> tuple[FloatArray, IntArray]:
    """The same without vertices that no face has."""
    used, renamed = np.unique(faces, return_inverse=True)
    return vertices[used], renamed.reshape(-1, 3)


def _section(border: FloatArray, wide: float, high: float) -> FloatArray:
    """Points (k, 2) of an ellipse in the directions of a patch's border (k, 3), along y and z."""
    across = border[:, 1:] - (border[:, 1:].min(axis=0) + border[:, 1:].max(axis=0)) / 2
    across /= np.abs(across).max(axis=0)
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    out: FloatArray = across * [wide, high]
    return out


REACH = 0.75
"""How far a teacup's handle stands off, middle of the handle, in radii."""

LOW_END, HIGH_END = 0.25, 0.8
"""Heights of the ends of a teacup's handle, in heights of the wall."""


@dataclass(frozen=True, eq=False)
class Teacup(_Handled):
    """A round cup about z with a handle towards +x.

    Attributes:
        radius: Outer radius of the cup, m.
        height: With the rim, m.
        wall: Thickness of wall and bottom, m.
    """

    kind: ClassVar[str] = "teacup"
    size_names: ClassVar[tuple[str, ...]] = ("radius", "height", "wall")
    default_sizes: ClassVar[tuple[float, ...]] = (0.04, 0.09, 0.002)
    radius: float = 0.04
    height: float = 0.09
    wall: float = 0.002

    def _check(self) -> None:
        super()._check()
        if not 1.0 <= self.height / self.radius <= 6.0 or self.height < 0.04:
            raise ObjectError(
                f"teacup: height {self.height} m does not go with radius {self.radius} m; give a "
                "height of at least 0.04 m, from 1 to 6 radii"
            )

    def _triangles(self) -> tuple[FloatArray, IntArray]:
        outline, bottom, top = self._outline()
        vertices, faces = revolved(outline)
        rows = top - bottom
        ends = [bottom + round(share * rows) for share in (HIGH_END, LOW_END)]
        faces = _without_patches(faces, [(row, HALF) for row in ends])
        upper, lower = (self._patch(row, HALF) for row in ends)
        # seen along the handle, the lower border is passed the other way round
        lower = self._patch(ends[1], HALF)[_mirrored(len(lower))]
        border = vertices[upper]
        step = vertices[upper].max(axis=0) - vertices[upper].min(axis=0)
        section = _section(border, step[1] / 2, step[2] / 2)
        high, low = (float(vertices[AROUND * row, 2]) for row in ends)
        turn = np.pi * (np.arange(BENDS) + 0.5) / BENDS
        half, reach = (high - low) / 2, REACH * self.radius
        middle = np.column_stack(
            [self.radius + reach * np.sin(turn), 0 * turn, (high + low) / 2 + half * np.cos(turn)]
        )
        along = np.column_stack([reach * np.cos(turn), 0 * turn, -half * np.sin(turn)])
        along /= np.linalg.norm(along, axis=1, keepdims=True)
        across = np.array([0.0, 1.0, 0.0])
        above = np.cross(along, across)
        rings = middle[:, None] + section[:, :1] * across + section[:, 1:] * above[:, None]
        whole = np.concatenate([vertices[upper][None], rings, vertices[lower][None]])
        numbers = np.concatenate(
            [upper, len(vertices) + np.arange(rings.size // 3), lower], dtype=np.int64
        )
        faces = np.vstack([faces, numbers[stacked(whole)]])
        return _joined(np.vstack([vertices, rings.reshape(-1, 3)]), faces)


def _mirrored(n: int) -> IntArray:
    """Order of a border's n points turned upside down."""
    out: IntArray = -np.arange(n) % n
    return out


GRIP, GRIP_WIDE, GRIP_HIGH = 0.12, 0.011, 0.006
"""Length of a pan's handle, and half its width and height, m."""

GRIP_RINGS = 24
"""Rings along it."""


@dataclass(frozen=True, eq=False)
class Pan(_Handled):
    """A low round pan about z with a straight handle towards +x.

    Attributes:
        radius: Outer radius, m.
        height: With the rim, m.
        wall: Thickness of wall and bottom, m.
    """

    kind: ClassVar[str] = "pan"
    size_names: ClassVar[tuple[str, ...]] = ("radius", "height", "wall")
    default_sizes: ClassVar[tuple[float, ...]] = (0.08, 0.045, 0.002)
    radius: float = 0.08
    height: float = 0.045
    wall: float = 0.002

    def _check(self) -> None:
        super()._check()
        if self.height < 0.025 or self.radius < 0.03:
            raise ObjectError(
                f"pan: radius {self.radius} m and height {self.height} m have no room for its "
                "handle; give a radius of at least 0.03 m and a height of at least 0.025 m"
            )

    def _triangles(self) -> tuple[FloatArray, IntArray]:
        outline, bottom, top = self._outline()
        vertices, faces = revolved(outline)
        row = (bottom + top) // 2
        faces = _without_patches(faces, [(row, HALF)])
        border = self._patch(row, HALF)
        section = _section(vertices[border], GRIP_WIDE, GRIP_HIGH)
        x = self.radius + GRIP * np.arange(1, GRIP_RINGS + 1) / GRIP_RINGS
        z = float(vertices[AROUND * row, 2])
        rings = np.empty((GRIP_RINGS, len(border), 3))
        rings[:, :, 0] = x[:, None]
        rings[:, :, 1], rings[:, :, 2] = section[:, 0], z + section[:, 1]
        whole = np.concatenate([vertices[border][None], rings])
        numbers = np.concatenate([border, len(vertices) + np.arange(rings.size // 3)])
        last, tip = numbers[-len(border) :], len(vertices) + rings.size // 3
        cap = np.column_stack([last, np.roll(last, -1), np.full(len(border), tip)])
        faces = np.vstack([faces, numbers[stacked(whole)], cap])
        points = np.vstack([vertices, rings.reshape(-1, 3), [[x[-1], 0.0, z]]])
        return _joined(points, faces)
