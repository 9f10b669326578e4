"""Objects that a few sizes make: woven from rings, or a file of ``models/objects`` that is scaled.

A ring is a closed row of points; a surface is a stack of rings, wound so that normals point
outwards when a ring runs counter-clockwise about the direction of the stack. Sizes that are no
scales of one mesh are woven: the thickness of a bracket, the tube of a torus, the exponents of a
superquadric change the form.
"""

from __future__ import annotations

import re
from abc import abstractmethod
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np

from planner.arrays import checked_number
from planner.errors import ObjectError
from planner.shapes.base import Sized
from planner.shapes.mesh import Mesh
from planner.shapes.meshes.triangles import Polyhedron
from planner.spatial import FloatArray, IntArray
from planner.system.package import models_dir


class Made(Sized, Mesh):
    """A mesh that is made from a few sizes.

    A subclass is a frozen dataclass, compared as meshes are (``eq=False``), whose fields are its
    sizes: names, order and defaults of a specification are those of the fields.
    """

    source: ClassVar[None] = None  # type: ignore[misc]

    def __init_subclass__(cls) -> None:
        """Take the names and defaults of the fields."""
        names = [name for name, kind in cls.__annotations__.items() if kind == "float"]
        cls.size_names = tuple(names)
        cls.default_sizes = tuple(getattr(cls, name, 0.0) for name in names)

    @abstractmethod
    def _triangles(self) -> tuple[FloatArray, IntArray]:
        """Vertices (n, 3), m, and outward faces (m, 3)."""

    @cached_property
    def _solid(self) -> Polyhedron:  # type: ignore[override]
        return Polyhedron.centred(*self._triangles())


TORUS_AROUND, TORUS_ACROSS = 72, 36
"""Points around the ring and around its tube: the facets deviate by 0.1 mm at the default size."""

SUPERQUADRIC_AROUND, SUPERQUADRIC_ALONG = 96, 48
"""Points around z and from pole to pole."""

ROUNDEST, SHARPEST = 0.2, 3.0
"""Range of the exponents: 0.2 is nearly a box; beyond 3 the arms are thinner than a facet."""

KNOT_AROUND, KNOT_ACROSS = 180, 28
"""Points along the strand and around it."""

THICKEST = 0.2
"""Largest tube radius of a knot as a fraction of the outer radius: thicker strands touch."""


def circle(n: int) -> FloatArray:
    """Cosines and sines (n, 2) of evenly spaced angles, from 0."""
    angle = 2 * np.pi * np.arange(n) / n
    return np.column_stack([np.cos(angle), np.sin(angle)])


def stacked(rings: FloatArray, *, closed: bool = False) -> IntArray:
    """Triangles (m, 3) that join rings (k, n, 3) one after the other, the last to the first too.

    Args:
        rings: Their points, m; point j of ring i has the number n i + j.
        closed: Whether the last ring is joined to the first.
    """
    k, n = rings.shape[:2]
    index = np.arange(k * n).reshape(k, n)
    a, d = (index, np.roll(index, -1, 0)) if closed else (index[:-1], index[1:])
    b, c = np.roll(a, -1, 1), np.roll(d, -1, 1)
    halves = [np.stack(corners, axis=-1).reshape(-1, 3) for corners in ((a, b, c), (a, c, d))]
    return np.concatenate(halves)


def fans(k: int, n: int) -> IntArray:
    """Triangles (2 n, 3) that close k rings of n points below and above (``stacked``).

    The poles in the middle of the first and of the last ring have the numbers k n and k n + 1.
    """
    first, count = np.arange(n), k * n
    last = first + count - n
    return np.vstack(
        [
            np.column_stack([np.roll(first, -1), first, np.full(n, count)]),
            np.column_stack([last, np.roll(last, -1), np.full(n, count + 1)]),
        ]
    )


@dataclass(frozen=True, eq=False)
class LBracket(Made):
    """Two plates at a right angle: one lies along x, the other stands along z; extruded along y.

    Attributes:
        length: Extent along x, m.
        height: Extent along z, m.
        width: Extent along y, m.
        thickness: Of both plates, m; less than length and height.
    """

    kind: ClassVar[str] = "lbracket"
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
        outline = np.array([[0, 0], [0, h], [t, h], [t, t], [a, t], [a, 0]])
        fan = np.array([[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 4, 5]])
        return _extruded(outline, fan, self.width)


@dataclass(frozen=True, eq=False)
class Channel(Made):
    """A U-profile of sheet: a web in the plane of x and y, a flange along z at either end of x.

    Attributes:
        length: Extent along x, m.
        height: Extent along z, m.
        width: Extent along y, m.
        thickness: Of web and flanges, m.
    """

    kind: ClassVar[str] = "channel"
    length: float = 0.06
    height: float = 0.06
    width: float = 0.08
    thickness: float = 0.002

    def _check(self) -> None:
        if self.thickness >= 0.49 * min(self.length, 2 * self.height):
            raise ObjectError(
                f"channel: thickness {self.thickness} m leaves no inside in {self.length} x "
                f"{self.height} m; give a smaller thickness"
            )

    def _triangles(self) -> tuple[FloatArray, IntArray]:
        a, h, t = self.length, self.height, self.thickness
        outline = np.array([[0, 0], [0, h], [t, h], [t, t], [a - t, t], [a - t, h], [a, h], [a, 0]])
        fan = np.array([[0, 1, 2], [0, 2, 3], [0, 3, 7], [3, 4, 7], [4, 5, 6], [4, 6, 7]])
        return _extruded(outline, fan, self.width)


@dataclass(frozen=True, eq=False)
class Tray(Made):
    """A floor in the plane of x and y with upright walls around it, open at the top.

    Attributes:
        length: Extent along x, m.
        width: Extent along y, m.
        height: Extent along z, m.
        thickness: Of floor and walls, m.
    """

    kind: ClassVar[str] = "tray"
    length: float = 0.4
    width: float = 0.3
    height: float = 0.1
    thickness: float = 0.01

    def _check(self) -> None:
        if self.thickness >= 0.49 * min(self.length, self.width, 2 * self.height):
            raise ObjectError(
                f"tray: thickness {self.thickness} m leaves no inside in {self.length} x "
                f"{self.width} x {self.height} m; give a smaller thickness"
            )

    def _triangles(self) -> tuple[FloatArray, IntArray]:
        t, top = self.thickness, self.height
        corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) / 2
        outer, inner = (corners * [self.length - off, self.width - off] for off in (0.0, 2 * t))
        rings = np.array(
            [
                np.insert(ring, 2, z, axis=1)
                for ring, z in ((outer, 0.0), (outer, top), (inner, top), (inner, t))
            ]
        )
        floor = np.array([[0, 1, 2], [0, 2, 3]])
        faces = np.concatenate([stacked(rings), floor[:, ::-1], floor + 12])
        return rings.reshape(-1, 3), faces


def _extruded(outline: FloatArray, fan: IntArray, width: float) -> tuple[FloatArray, IntArray]:
    """Vertices and faces of a polygon (n, 2) in x and z, filled by triangles, and moved along y.

    Args:
        outline: m, counter-clockwise seen against y: about the direction of the stack.
        fan: Triangles (k, 3) of the polygon, likewise.
        width: m.
    """
    ring = np.insert(outline, 1, 0.0, axis=1)
    rings = np.stack([ring, ring + np.array([0.0, width, 0.0])])
    return rings.reshape(-1, 3), np.concatenate([stacked(rings), fan + len(ring), fan[:, ::-1]])


@dataclass(frozen=True, eq=False)
class Torus(Made):
    """A ring about z.

    Attributes:
        ring: Radius of the circle in the middle of the tube, m.
        tube: Radius of the tube, m; less than ``ring``.
    """

    kind: ClassVar[str] = "torus"
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
        turn, c = circle(TORUS_AROUND), circle(TORUS_ACROSS)
        radial = self.ring + self.tube * c[:, 0]
        rings = np.empty((TORUS_AROUND, TORUS_ACROSS, 3))
        rings[:, :, :2] = turn[:, None] * radial[None, :, None]
        rings[:, :, 2] = -self.tube * c[:, 1]
        return rings.reshape(-1, 3), stacked(rings, closed=True)


@dataclass(frozen=True, eq=False)
class Superquadric(Made):
    """The solid (|x/a|^(2/e2) + |y/b|^(2/e2))^(e2/e1) + |z/c|^(2/e1) <= 1 (Barr 1981).

    e1 shapes the outline seen from the side, e2 the one seen from above: towards 0 a rectangle, 1
    an ellipse, 2 a rhombus, above 2 a concave star. It is star-shaped, so that the surface is
    found along rays.

    Attributes:
        x: Full extent 2 a, m.
        y: Full extent 2 b, m.
        z: Full extent 2 c, m.
        e1: Exponent from the side (-).
        e2: Exponent from above (-).
    """

    kind: ClassVar[str] = "superquadric"
    pure_numbers: ClassVar[tuple[str, ...]] = ("e1", "e2")
    x: float = 0.06
    y: float = 0.06
    z: float = 0.09
    e1: float = 0.5
    e2: float = 0.5

    def _check(self) -> None:
        for name in self.pure_numbers:
            value = checked_number(
                f"superquadric: {name}", getattr(self, name), least=ROUNDEST, most=SHARPEST,
                error=ObjectError,
            )  # fmt: skip
            object.__setattr__(self, name, value)

    def _triangles(self) -> tuple[FloatArray, IntArray]:
        n, along = SUPERQUADRIC_AROUND, SUPERQUADRIC_ALONG
        slope = np.pi * (np.arange(1, along) / along - 0.5)
        rays = np.empty((along - 1, n, 3))
        rays[:, :, :2] = np.cos(slope)[:, None, None] * circle(n)
        rays[:, :, 2] = np.sin(slope)[:, None]
        p, q = np.abs(rays) ** (2 / self.e2), np.abs(rays[:, :, 2]) ** (2 / self.e1)
        level = (p[:, :, 0] + p[:, :, 1]) ** (self.e2 / self.e1) + q
        half = np.array([self.x, self.y, self.z]) / 2
        rings = rays * half * (level ** (-self.e1 / 2))[:, :, None]
        # a fan closes each end; the poles are the last two points
        poles = [[0.0, 0.0, -half[2]], [0.0, 0.0, half[2]]]
        return np.vstack([rings.reshape(-1, 3), poles]), np.vstack(
            [stacked(rings), fans(along - 1, n)]
        )


@dataclass(frozen=True, eq=False)
class Knot(Made):
    """A trefoil knot of round rope about z: the deliberately nasty object.

    No two facing sides are flat or parallel, strands pass over each other with gaps narrower than a
    fingertip, the centre of mass is in the air, and contact normals turn within millimetres. A
    planner that treats objects as convex, or trusts its normals over a fingertip's width, fails.

    Attributes:
        radius: Distance of the rope's middle from z at the outermost, m.
        tube: Radius of the rope, m; at most ``THICKEST`` of the radius.
    """

    kind: ClassVar[str] = "knot"
    radius: float = 0.04
    tube: float = 0.007

    def _check(self) -> None:
        if self.tube > THICKEST * self.radius:
            raise ObjectError(
                f"knot: tube {self.tube} m is more than {THICKEST} of radius {self.radius} m, so "
                "that strands touch; give a thinner tube or a larger radius"
            )

    def _triangles(self) -> tuple[FloatArray, IntArray]:
        t = 2 * np.pi * np.arange(KNOT_AROUND) / KNOT_AROUND
        scale = self.radius / 3
        path = scale * np.stack(
            [np.sin(t) + 2 * np.sin(2 * t), np.cos(t) - 2 * np.cos(2 * t), -np.sin(3 * t)], axis=1
        )
        along = scale * np.stack(
            [np.cos(t) + 4 * np.cos(2 * t), -np.sin(t) + 4 * np.sin(2 * t), -3 * np.cos(3 * t)],
            axis=1,
        )
        along /= np.linalg.norm(along, axis=1, keepdims=True)
        # the strand never runs along z, so that z gives each ring its start, without a seam
        across = np.cross(along, [0.0, 0.0, 1.0])
        across /= np.linalg.norm(across, axis=1, keepdims=True)
        up = np.cross(along, across)
        c = circle(KNOT_ACROSS)
        rings = path[:, None] + self.tube * (
            c[:, 0, None] * across[:, None] + c[:, 1, None] * up[:, None]
        )
        return rings.reshape(-1, 3), stacked(rings, closed=True)


SLENDER, SQUAT = 6.0, 1.4
"""Largest and smallest height of a mug, in radii."""

SHORTEST_HEAD, SHORTEST_HANDLE = 2.5, 2.0
"""Smallest width of a hammer's head and length of its handle, in radii of the head."""


def read_object(name: str) -> tuple[FloatArray, IntArray]:
    """Vertices (n, 3), m, and faces (m, 3) of ``models/objects/NAME.ply``, as they are stored.

    Read by NumPy: the digest of a default mesh depends on the stored order, and trimesh takes 0.1 s
    of CPU to import (``python -X importtime -c "import trimesh"``).
    """
    content = (models_dir() / "objects" / f"{name}.ply").read_bytes()
    head, _, body = content.partition(b"end_header\n")
    n, m = (int(count) for count in re.findall(rb"element \w+ (\d+)", head))
    vertices = np.frombuffer(body, "<f8", 3 * n).reshape(n, 3)
    rows = np.frombuffer(body, [("corners", "u1"), ("at", "<i4", 3)], m, offset=vertices.nbytes)
    return vertices, rows["at"]


@dataclass(frozen=True, eq=False)
class Mug(Made):
    """A cup about z, open at the top, with a handle towards +x.

    Attributes:
        radius: Outer radius of the cup, m.
        height: Of the cup, m.
    """

    kind: ClassVar[str] = "mug"
    radius: float = 0.04
    height: float = 0.09

    def _check(self) -> None:
        if not SQUAT * self.radius <= self.height <= SLENDER * self.radius:
            raise ObjectError(
                f"mug: height {self.height} m does not go with radius {self.radius} m; give a "
                f"height from {SQUAT} to {SLENDER} radii"
            )

    def _triangles(self) -> tuple[FloatArray, IntArray]:
        vertices, faces = read_object(self.kind)
        radius, height = self.default_sizes
        across = self.radius / radius
        return vertices * [across, across, self.height / height], faces


@dataclass(frozen=True, eq=False)
class Hammer(Made):
    """A head along x on a handle along z; round at the default proportions, else oval.

    Attributes:
        length: From the end of the handle to the top of the head, m.
        head: Width of the head, end to end, m.
        radius: Of the head, across the handle, m.
    """

    kind: ClassVar[str] = "hammer"
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
        vertices, faces = read_object(self.kind)
        length, head, radius = self.default_sizes
        factors = [self.head / head, self.radius / radius, self.length / length]
        return vertices * factors, faces
