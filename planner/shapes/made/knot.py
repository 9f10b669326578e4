"""Trefoil knot: the deliberately nasty one.

No two facing sides are flat or parallel, strands pass over each other with gaps that a fingertip
does not fit into, the centre of mass is in the air, and contact normals turn within millimetres.
A planner that treats objects as convex, or trusts its normals over a fingertip's width, fails here.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from planner.errors import ObjectError
from planner.shapes.made.base import Made
from planner.shapes.made.weave import Weave, circle
from planner.spatial import FloatArray, IntArray

__all__ = ["Knot"]

AROUND, ACROSS = 180, 28
"""Points along the strand and around it."""

THICKEST = 0.2
"""Largest tube radius as a fraction of the outer radius: thicker strands touch each other."""


@dataclass(frozen=True)
class Knot(Made):
    """A trefoil knot of round rope about z.

    Attributes:
        radius: Distance of the rope's middle from z at the outermost, m.
        tube: Radius of the rope, m; at most ``THICKEST`` of the radius.
    """

    kind: ClassVar[str] = "knot"
    size_names: ClassVar[tuple[str, ...]] = ("radius", "tube")
    default_sizes: ClassVar[tuple[float, ...]] = (0.04, 0.007)
    radius: float = 0.04
    tube: float = 0.007

    def _check(self) -> None:
        if self.tube > THICKEST * self.radius:
            raise ObjectError(
                f"knot: tube {self.tube} m is more than {THICKEST} of radius {self.radius} m, so "
                "that strands touch; give a thinner tube or a larger radius"
            )

    def _triangles(self) -> tuple[FloatArray, IntArray]:
        t = 2 * np.pi * np.arange(AROUND) / AROUND
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
        c = circle(ACROSS)
        rings = path[:, None] + self.tube * (
            c[:, 0, None] * across[:, None] + c[:, 1, None] * up[:, None]
        )
        weave = Weave()
        weave.stack(rings, closed=True)
        return weave.triangles()
