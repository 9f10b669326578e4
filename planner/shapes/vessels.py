"""Vessels of thin walls about z: cup, bowl, plate and tube, and with a handle teacup and pan.

An outline is a row of points (r, z) in the half plane r >= 0, run so that the solid is on its left.
A vessel's outer outline starts on the axis and ends at the rim; the inner one is parallel to it at
the wall's thickness, and a half circle joins the two. A handle grows out of the outer wall: a patch
of the wall's squares is left out, and rings of as many points as its border has run from there
along the handle.
"""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import ClassVar

import numpy as np

from planner.errors import ObjectError
from planner.shapes.hulls import StablePose
from planner.shapes.made import Made, circle, fans, stacked
from planner.spatial import FloatArray, IntArray

AROUND = 72
"""Points around the axis: facets of a wall of 40 mm radius deviate by 0.04 mm."""

ROW = 0.004
"""Longest row (m) along an outline: triangles of a wall are about as long as they are wide."""

RIM_PARTS = 6
"""Parts of the half circle of a rim."""

THINNEST = 2e-4
"""Thinnest wall, m."""

UPRIGHT = 0.999
"""Cosine between z and the vertical (-) from which on a vessel stands upright."""

THICKEST = 0.25
"""Thickest wall as a share of the smallest other size."""


def spaced(corners: FloatArray) -> FloatArray:
    """An outline (n, 2) through corners (k, 2), with points at most ``ROW`` apart, m."""
    parts = [corners[:1]]
    for a, b in pairwise(corners):
        count = max(1, int(np.ceil(np.linalg.norm(b - a) / ROW - 1e-9)))
        parts.append(a + (b - a) * (np.arange(1, count + 1) / count)[:, None])
    return np.concatenate(parts)


def closed_shell(outer: FloatArray, wall: float) -> FloatArray:
    """The whole outline (m, 2) of a vessel, from the axis below to the axis above.

    Args:
        outer: Outer outline (n, 2), m, from the axis to the rim; its first and its last edge are
            straight on.
        wall: Thickness of the wall, m.
    """
    edges = np.diff(outer, axis=0)
    edges /= np.linalg.norm(edges, axis=1, keepdims=True)
    left = np.column_stack([-edges[:, 1], edges[:, 0]])
    before, after = np.vstack([left[:1], left]), np.vstack([left, left[-1:]])
    mitre = before + after
    mitre *= 2 / (mitre**2).sum(axis=1)[:, None]  # parallel to both edges at distance 1
    inner = outer + wall * mitre
    turn = np.pi * np.arange(1, RIM_PARTS) / RIM_PARTS
    middle = outer[-1] + wall / 2 * left[-1]
    rim = middle - wall / 2 * (np.cos(turn)[:, None] * left[-1] - np.sin(turn)[:, None] * edges[-1])
    return np.concatenate([outer, rim, inner[::-1]])


def revolved(outline: FloatArray, *, closed: bool = False) -> tuple[FloatArray, IntArray]:
    """Vertices (k, 3), m, and faces (m, 3) of an outline (n, 2) turned about z.

    The vertex of point i at angle j is number ``AROUND`` i + j; poles come last.

    Args:
        outline: (r, z), m; starts and ends on the axis if it is not closed.
        closed: Whether the last point is joined to the first, and none is on the axis.
    """
    turn = circle(AROUND)
    points = outline if closed else outline[1:-1]
    rings = np.empty((len(points), AROUND, 3))
    rings[:, :, :2] = points[:, None, :1] * turn
    rings[:, :, 2] = points[:, None, 1]
    vertices, faces = rings.reshape(-1, 3), stacked(rings, closed=closed)
    if closed:
        return vertices, faces
    poles = [[0.0, 0.0, outline[0, 1]], [0.0, 0.0, outline[-1, 1]]]
    return np.vstack([vertices, poles]), np.vstack([faces, fans(len(points), AROUND)])


class Walled(Made):
    """A mesh with a ``wall``, the last of its sizes.

    A vessel stands with its open side, which is towards z, up, although a bowl and a plate are
    harder to tilt upside down.
    """

    wall: float

    @cached_property
    def _resting_poses(self) -> tuple[StablePose, ...]:
        poses = super()._resting_poses
        return tuple(sorted(poses, key=lambda pose: pose.rotation[2, 2] < UPRIGHT))

    def _check(self) -> None:
        """Whether the wall is thin beside the other sizes; ObjectError if not."""
        least = min(getattr(self, name) for name in self.size_names if name != "wall")
        if not THINNEST <= self.wall <= THICKEST * least:
            raise ObjectError(
                f"{self.kind}: wall {self.wall} m does not go with a smallest size of {least} m; "
                f"give a wall from {THINNEST} m to {THICKEST} of it"
            )

    @abstractmethod
    def _triangles(self) -> tuple[FloatArray, IntArray]:
        """See ``Made``."""


@dataclass(frozen=True, eq=False)
class Cup(Walled):
    """A round cup about z, open at the top, without a handle.

    Attributes:
        radius: Outer radius, m.
        height: With the rim, m.
        wall: Thickness of wall and bottom, m.
    """

    kind: ClassVar[str] = "cup"
    radius: float = 0.035
    height: float = 0.09
    wall: float = 0.002

    def _triangles(self) -> tuple[FloatArray, IntArray]:
        r, top = self.radius, self.height - self.wall / 2
        return revolved(spaced(closed_shell(np.array([[0, 0], [r, 0], [r, top]]), self.wall)))


FOOT, ARC_PARTS = 0.4, 24
"""Radius of a bowl's foot in outer radii, and parts of the quarter of an ellipse beside it."""


@dataclass(frozen=True, eq=False)
class Bowl(Walled):
    """A round bowl about z on a flat foot; its side is a quarter of an ellipse.

    Attributes:
        radius: Outer radius at the rim, m.
        height: With the rim, m.
        wall: Thickness, m.
    """

    kind: ClassVar[str] = "bowl"
    radius: float = 0.06
    height: float = 0.055
    wall: float = 0.002

    def _check(self) -> None:
        super()._check()
        across, up = (1 - FOOT) * self.radius, self.height
        tightest = min(across**2 / up, up**2 / across)  # radius of the ellipse's curvature
        if tightest < 2 * self.wall:
            raise ObjectError(
                f"bowl: its side bends with a radius of {tightest:.2g} m, too tight for a wall of "
                f"{self.wall} m; give a thinner wall, or radius and height nearer to each other"
            )

    def _triangles(self) -> tuple[FloatArray, IntArray]:
        foot, top = FOOT * self.radius, self.height - self.wall / 2
        turn = np.pi / 2 * np.arange(1, ARC_PARTS + 1) / ARC_PARTS
        side = [foot + (self.radius - foot) * np.sin(turn), top * (1 - np.cos(turn))]
        base = np.array([[0, 0], [foot, 0]])
        outline = closed_shell(np.vstack([base, np.column_stack(side)]), self.wall)
        return revolved(spaced(_fitted(outline, self.radius, self.height)))


def _fitted(outline: FloatArray, radius: float, height: float) -> FloatArray:
    """An outline (n, 2) scaled to its sizes, which its rim misses by tenths of a millimetre."""
    out: FloatArray = outline * (np.array([radius, height]) / outline.max(axis=0))
    return out


WELL = 0.6
"""Radius of a plate's flat part in outer radii."""


@dataclass(frozen=True, eq=False)
class Plate(Walled):
    """A flat round plate about z with a rim that rises straight outwards.

    Attributes:
        radius: Outer radius, m.
        height: Of the rim, m.
        wall: Thickness, m.
    """

    kind: ClassVar[str] = "plate"
    radius: float = 0.09
    height: float = 0.025
    wall: float = 0.003

    def _triangles(self) -> tuple[FloatArray, IntArray]:
        well, half = WELL * self.radius, self.wall / 2
        rise = np.array([self.radius - well, self.height])
        x, z = rise / np.linalg.norm(rise)
        # the rim's half circle reaches beyond the end of the outer side, up and outwards
        end = [self.radius - half * (1 - z), self.height - half * (1 + x)]
        outline = closed_shell(np.array([[0, 0], [well, 0], end]), self.wall)
        return revolved(spaced(_fitted(outline, self.radius, self.height)))


@dataclass(frozen=True, eq=False)
class Tube(Walled):
    """A round tube about z, open at both ends.

    Attributes:
        radius: Outer radius, m.
        height: Length along z, m.
        wall: Thickness, m.
    """

    kind: ClassVar[str] = "tube"
    radius: float = 0.03
    height: float = 0.1
    wall: float = 0.002

    def _triangles(self) -> tuple[FloatArray, IntArray]:
        r, half = self.radius, self.height / 2 - self.wall / 2
        upper = spaced(closed_shell(np.array([[r, 0], [r, half]]), self.wall))
        lower = (upper * [1, -1])[::-1]
        return revolved(np.vstack([upper[:-1], lower[:-1]]), closed=True)


HALF = 1
"""Half the width of a patch, in squares of the wall."""

BENDS = 18
"""Rings along a bent handle."""


class _Handled(Walled):
    """A cup whose outer wall has patches about +x, where handles begin.

    ``_outline`` says at which rings its straight wall begins and ends.
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
        upper = self._patch(ends[0], HALF)
        # seen along the handle, the lower border is passed the other way round
        lower = self._patch(ends[1], HALF)[-np.arange(len(upper)) % len(upper)]
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
