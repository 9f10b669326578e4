"""Objects whose mesh is a file of ``models/objects``, scaled along its axes to other sizes."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from planner.errors import ObjectError
from planner.shapes.made.base import Made
from planner.spatial import FloatArray, IntArray
from planner.system.models import models_dir

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
        vertices, faces = read_object(self.kind)
        length, head, radius = self.default_sizes
        factors = [self.head / head, self.radius / radius, self.length / length]
        return vertices * factors, faces
