"""Smooth patches of a surface, for contact synthesis.

A contact point is a decision variable that lies exactly on the true surface. Edges need no
rounding, because the surface is cut along them into smooth patches (the faces of a box; side and
ends of a cylinder), each finger is assigned to one patch, and the point keeps a margin from the
patch's rim. The assignment enters the problem as numbers (``Patch.code``, bounds of the point), so
one problem per hand and kind of shape serves every size and every assignment.

``clearance`` is used for links that must stay away. It is exact for spheres and capsules; the
largest of the face distances, softened over ``SOFTNESS``, for boxes and cylinders, which for balls
of 8 mm or more is within 0.08 mm of a lower bound of the true distance (the worst is straight above
a box's corner); first-order accurate for ellipsoids. The verdict is always on the true geometry,
see ``planner.verification``.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, ClassVar

import casadi as ca
import numpy as np

from planner.spatial import FloatArray

SOFTNESS = 0.002
"""Length (m) over which the largest of several face distances is softened."""

EDGE_MARGIN = 0.004
"""Distance (m) that a contact keeps from the rim of its patch: a fingertip that rolls or creeps by
a few millimetres must not reach the edge. At most a quarter of the patch's half width."""

KEPT = 16
"""Shapes whose patches a surface keeps: every start asks for them."""

SIZE_DIM = 3
"""Numbers that describe a shape's size in the synthesis problem."""

CODE_DIM = 3
"""Numbers that say which patch a finger touches."""


@dataclass(frozen=True, kw_only=True)
class Patch:
    """A smooth part of a surface.

    Attributes:
        name: For people, for example "+x".
        code: (3,), which patch, as numbers for the problem.
        lower: (3,), lower bounds of a contact point in the object's frame, m.
        upper: (3,), upper bounds.
    """

    name: str
    code: FloatArray
    lower: FloatArray
    upper: FloatArray


class Surface(ABC):
    """One kind of shape in the synthesis problem; expressions are in the object's frame, m."""

    kind: ClassVar[str]
    field: Any = None
    """The ``FieldPoints`` where expressions need a distance field; None where they are formulas."""
    normal_error: float = 0.0
    """How far (rad) ``outward_normal`` may be from the true one; pads keep that from their rim."""
    distance_error: float = 0.0
    """How far (m) ``clearance`` may be from the true one; links keep that much more away."""

    def field_of(self, shape: Any) -> Any:
        """The distance field of a shape, where ``field`` is not None."""
        return None

    @abstractmethod
    def size(self, shape: Any) -> FloatArray:
        """Parameters (3,) of the problem for a shape's size, m."""

    def skin(self, size: Any) -> Any:
        """How far in front of the true surface contact points are looked for, m.

        Pads are shorter by as much.

        Args:
            size: Of the shape, see ``size``: numbers or symbols.
        """
        return 0.0

    @abstractmethod
    def patches(self, shape: Any) -> tuple[Patch, ...]:
        """The patches of a shape."""

    @abstractmethod
    def patch_at(self, shape: Any, point: FloatArray, normal: FloatArray) -> Patch:
        """The patch to which a surface point with this outward normal belongs."""

    @abstractmethod
    def outward_normal(self, size: Any, code: Any, p: Any) -> Any:
        """Outward unit normal (3,) at a point of the patch."""

    @abstractmethod
    def surface_error(self, size: Any, code: Any, p: Any) -> Any:
        """Zero on the patch; m near it. None where the bounds of the patch fix the point."""

    def flatness(self, size: Any, p: Any) -> Any:
        """At least 0 (-) at a contact off edges; None where patches keep contacts off them."""
        return None

    @abstractmethod
    def clearance(self, size: Any, c: Any) -> Any:
        """Smooth signed distance of a point from the surface, m, for avoidance."""


def soft_norm(*parts: Any) -> Any:
    """Euclidean norm, differentiable at 0; 1e-6 there."""
    return ca.sqrt(sum(v * v for v in parts) + 1e-12)


def soft_max(*values: Any) -> Any:
    """Maximum, softened over ``SOFTNESS``; never less than it."""
    top = ca.fmax(values[0], values[1])
    for v in values[2:]:
        top = ca.fmax(top, v)
    # log-sum-exp; shifting by the maximum keeps the exponentials finite and changes nothing
    return top + SOFTNESS * ca.log(sum(ca.exp((v - top) / SOFTNESS) for v in values))


def box_clearance(half: Any, c: Any) -> Any:
    """Smooth distance (m) of a point (3,) from a box of half extents ``half`` at the origin."""
    return soft_max(*(soft_norm(c[k]) - half[k] for k in range(3)))


def edge_margin(half: float) -> float:
    """Distance (m) from the rim that contacts keep on a patch of half width ``half`` (m)."""
    return min(EDGE_MARGIN, half / 4)


def whole_surface(name: str, reach: FloatArray) -> Patch:
    """The patch of a surface without edges, in a box of half extents ``reach`` (3,), m."""
    return Patch(name=name, code=np.zeros(CODE_DIM), lower=-reach, upper=reach)


class WholeSurface(Surface):
    """Base of a surface without edges: one patch."""

    def patches(self, shape: Any) -> tuple[Patch, ...]:
        """See ``Surface``."""
        return _whole(self.kind, shape)

    def patch_at(self, shape: Any, point: FloatArray, normal: FloatArray) -> Patch:
        """See ``Surface``."""
        return self.patches(shape)[0]


@lru_cache(maxsize=2 * KEPT)
def _whole(kind: str, shape: Any) -> tuple[Patch, ...]:
    return (whole_surface(kind, 2 * shape.half_extents),)
