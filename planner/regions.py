"""Regions of an object's surface that may, must not, or must be touched: plain data.

A ``TouchRegion`` belongs to a ``GraspObject``. Regions are boxes in the object's frame, whose
origin is the centre of mass; a half-space is a box with infinite bounds.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from planner.errors import ObjectError, shown
from planner.spatial import FloatArray

__all__ = ["Region", "TouchRegion", "parse_region"]


@dataclass(frozen=True, kw_only=True)
class Region:
    """A box in the object's frame.

    Attributes:
        name: What to call it in messages.
        lower: Lower corner (3,), m; -inf where it has no bound.
        upper: Upper corner (3,), m; inf where it has no bound.
    """

    name: str
    lower: tuple[float, float, float] = (-np.inf, -np.inf, -np.inf)
    upper: tuple[float, float, float] = (np.inf, np.inf, np.inf)

    def __post_init__(self) -> None:
        """Check the corners."""
        for which in ("lower", "upper"):
            corner = _corner(self.name, which, getattr(self, which))
            object.__setattr__(self, which, corner)
        if not (np.array(self.lower) < np.array(self.upper)).all():
            raise ObjectError(
                f"region {self.name!r} runs from {self.lower} to {self.upper}; give lower < upper "
                "along every axis, in m"
            )

    def contains(self, points: FloatArray) -> NDArray[np.bool_]:
        """Whether each point (n, 3), m, is in the region, (n,) bool."""
        p = np.asarray(points, dtype=np.float64)
        return np.asarray(((p >= self.lower) & (p <= self.upper)).all(axis=1))


@dataclass(frozen=True, kw_only=True)
class TouchRegion:
    """Where fingers may touch an object.

    Attributes:
        allowed: Contacts lie in one of these; everywhere if empty.
        forbidden: Contacts lie in none of these.
        required: By finger, the region that its contact lies in.
    """

    allowed: tuple[Region, ...] = ()
    forbidden: tuple[Region, ...] = ()
    required: Mapping[str, Region] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Freeze the mapping and check that no region is both allowed and forbidden."""
        object.__setattr__(self, "allowed", tuple(self.allowed))
        object.__setattr__(self, "forbidden", tuple(self.forbidden))
        object.__setattr__(self, "required", MappingProxyType(dict(self.required)))
        both = {r.name for r in self.allowed} & {r.name for r in self.forbidden}
        if both:
            raise ObjectError(f"regions {sorted(both)} are both allowed and forbidden; give one")

    def permits(self, points: FloatArray, fingers: Sequence[str] = ()) -> NDArray[np.bool_]:
        """Whether each contact may be where it is, (n,) bool.

        Args:
            points: Contacts (n, 3) in the object's frame, m.
            fingers: Their fingers (n,); without them, what is required of fingers is not asked.
        """
        p = np.asarray(points, dtype=np.float64)
        good = np.ones(len(p), dtype=bool)
        if self.allowed:
            good &= np.any(np.array([region.contains(p) for region in self.allowed]), axis=0)
        for region in self.forbidden:
            good &= ~region.contains(p)
        for i, finger in enumerate(fingers):
            if finger in self.required:
                good[i] &= bool(self.required[finger].contains(p[i : i + 1])[0])
        return good


def parse_region(text: str) -> Region:
    """A region from text such as "z>0.01" or "z>0.01,x<0.02": bounds in the object's frame, m.

    Raises:
        ObjectError: Not of that form, or empty.
    """
    lower, upper = np.full(3, -np.inf), np.full(3, np.inf)
    for part in text.split(","):
        found = _BOUND.fullmatch(part.strip())
        if found is None:
            raise ObjectError(
                f"region {text!r}: {part.strip()!r} is no bound; write an axis, < or >, and metres "
                'from the centre of mass: "z>0.01", several with commas: "z>0.01,x<0.02"'
            )
        axis, value = "xyz".index(found[1]), float(found[3])
        if found[2] == ">":
            lower[axis] = max(lower[axis], value)
        else:
            upper[axis] = min(upper[axis], value)
    (a, b, c), (d, e, f) = lower.tolist(), upper.tolist()
    return Region(name=text, lower=(a, b, c), upper=(d, e, f))


_BOUND = re.compile(r"([xyz])\s*([<>])\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)")


def _corner(name: str, which: str, values: object) -> tuple[float, float, float]:
    try:
        corner = np.array(values, dtype=np.float64)
    except (TypeError, ValueError):
        corner = np.empty(0)
    if corner.shape != (3,) or np.isnan(corner).any():
        raise ObjectError(
            f"region {name!r}: {which} is {shown(values)}; give three numbers x, y, z in m"
        )
    x, y, z = (float(v) for v in corner)
    return x, y, z
