"""Superquadric: from box over ellipsoid to double pyramid and star."""

from __future__ import annotations

from dataclasses import dataclass
from numbers import Real
from typing import ClassVar

import numpy as np

from planner.errors import ObjectError
from planner.shapes.made.base import Made
from planner.shapes.made.weave import Weave, circle
from planner.spatial import FloatArray, IntArray

__all__ = ["Superquadric"]

AROUND, ALONG = 96, 48
"""Points around z and from pole to pole."""

ROUNDEST, SHARPEST = 0.2, 3.0
"""Range of the exponents: 0.2 is nearly a box; beyond 3 the arms are thinner than a facet."""


@dataclass(frozen=True)
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
    size_names: ClassVar[tuple[str, ...]] = ("x", "y", "z", "e1", "e2")
    default_sizes: ClassVar[tuple[float, ...]] = (0.06, 0.06, 0.09, 0.5, 0.5)
    pure_numbers: ClassVar[tuple[str, ...]] = ("e1", "e2")
    x: float = 0.06
    y: float = 0.06
    z: float = 0.09
    e1: float = 0.5
    e2: float = 0.5

    def _check(self) -> None:
        for name in self.pure_numbers:
            value = getattr(self, name)
            number = isinstance(value, Real) and not isinstance(value, bool)
            if not number or not ROUNDEST <= float(value) <= SHARPEST:
                raise ObjectError(
                    f"superquadric: {name} is {value!r}; give a number from {ROUNDEST} to "
                    f"{SHARPEST}"
                )
            object.__setattr__(self, name, float(value))

    def _triangles(self) -> tuple[FloatArray, IntArray]:
        around = circle(AROUND)
        slope = np.pi * (np.arange(1, ALONG) / ALONG - 0.5)
        rays = np.empty((ALONG - 1, AROUND, 3))
        rays[:, :, :2] = np.cos(slope)[:, None, None] * around
        rays[:, :, 2] = np.sin(slope)[:, None]
        p, q = np.abs(rays) ** (2 / self.e2), np.abs(rays[:, :, 2]) ** (2 / self.e1)
        level = (p[:, :, 0] + p[:, :, 1]) ** (self.e2 / self.e1) + q
        half = np.array([self.x, self.y, self.z]) / 2
        rings = rays * half * (level ** (-self.e1 / 2))[:, :, None]
        weave = Weave()
        index = weave.stack(rings)
        weave.cap(index[0], np.array([0.0, 0.0, -half[2]]), last=False)
        weave.cap(index[-1], np.array([0.0, 0.0, half[2]]), last=True)
        return weave.triangles()
