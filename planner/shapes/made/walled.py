"""Vessels of thin walls, revolved about z: cup, bowl, plate and tube.

An outline is a row of points (r, z) in the half plane r >= 0, run so that the solid is on its left.
A vessel's outer outline starts on the axis and ends at the rim; the inner one is parallel to it at
the wall's thickness, and a half circle joins the two.
"""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import ClassVar

import numpy as np

from planner.errors import ObjectError
from planner.shapes.made.base import Made
from planner.shapes.made.woven import circle, stacked
from planner.shapes.stable import StablePose
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
    first, count = np.arange(AROUND), len(vertices)
    last = first + count - AROUND
    fans = [
        np.column_stack([np.roll(first, -1), first, np.full(AROUND, count)]),
        np.column_stack([last, np.roll(last, -1), np.full(AROUND, count + 1)]),
    ]
    poles = [[0.0, 0.0, outline[0, 1]], [0.0, 0.0, outline[-1, 1]]]
    return np.vstack([vertices, poles]), np.vstack([faces, *fans])


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
    size_names: ClassVar[tuple[str, ...]] = ("radius", "height", "wall")
    default_sizes: ClassVar[tuple[float, ...]] = (0.035, 0.09, 0.002)
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
    size_names: ClassVar[tuple[str, ...]] = ("radius", "height", "wall")
    default_sizes: ClassVar[tuple[float, ...]] = (0.06, 0.055, 0.002)
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
    size_names: ClassVar[tuple[str, ...]] = ("radius", "height", "wall")
    default_sizes: ClassVar[tuple[float, ...]] = (0.09, 0.025, 0.003)
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
    size_names: ClassVar[tuple[str, ...]] = ("radius", "height", "wall")
    default_sizes: ClassVar[tuple[float, ...]] = (0.03, 0.1, 0.002)
    radius: float = 0.03
    height: float = 0.1
    wall: float = 0.002

    def _triangles(self) -> tuple[FloatArray, IntArray]:
        r, half = self.radius, self.height / 2 - self.wall / 2
        upper = spaced(closed_shell(np.array([[r, 0], [r, half]]), self.wall))
        lower = (upper * [1, -1])[::-1]
        return revolved(np.vstack([upper[:-1], lower[:-1]]), closed=True)
