"""Every kind of shape by its name, and how a new one is added.

A new primitive is one file: a subclass of ``Shape`` with its ``surface``. A line in ``_OWN`` below,
or ``register_shape`` from outside of this package, makes it known to specifications, files, plans
and simulations.
"""

from __future__ import annotations

from typing import TypeVar

from planner.errors import ObjectError
from planner.shapes.base import Shape
from planner.shapes.box import Box
from planner.shapes.capsule import Capsule
from planner.shapes.cylinder import Cylinder
from planner.shapes.ellipsoid import Ellipsoid
from planner.shapes.made import Hammer, Knot, LBracket, Mug, Superquadric, Torus
from planner.shapes.mesh import Mesh
from planner.shapes.sphere import Sphere

__all__ = ["SHAPES", "SIZED_SHAPES", "register_shape"]

_OWN: tuple[type[Shape], ...] = (
    *(Sphere, Box, Cylinder, Capsule, Ellipsoid),
    *(Mug, LBracket, Torus, Hammer, Superquadric, Knot),
)

SIZED_SHAPES: dict[str, type[Shape]] = {}
"""Every kind of shape that its sizes determine, by its name."""

SHAPES: dict[str, type[Shape]] = {Mesh.kind: Mesh}
"""Every kind of shape by its name."""

_S = TypeVar("_S", bound=type[Shape])


def register_shape(shape: _S) -> _S:
    """Make a kind of shape known by its name; usable as a decorator of the class.

    Args:
        shape: A subclass of ``Shape``. ``from_sizes(default_sizes)`` makes one of it.

    Raises:
        ObjectError: The name is taken or not a word, or the default sizes are not one number for
            each of ``size_names``.
    """
    kind = shape.kind
    if not kind.isidentifier() or kind != kind.lower():
        raise ObjectError(f"shape kind {kind!r}: give one word of lower-case letters and digits")
    if SHAPES.get(kind, shape) is not shape:
        raise ObjectError(f"shape kind {kind!r} is {SHAPES[kind].__name__} already; choose another")
    if len(shape.default_sizes) != len(shape.size_names):
        raise ObjectError(
            f"shape {kind!r} has {len(shape.default_sizes)} default sizes; give one for each of "
            f"{', '.join(shape.size_names)}"
        )
    shape.from_sizes(shape.default_sizes)
    SIZED_SHAPES[kind] = SHAPES[kind] = shape
    return shape


for _shape in _OWN:
    register_shape(_shape)
