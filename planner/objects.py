"""Objects to grasp: a shape and a mass, by name, by specification or by parameters.

    sphere:RADIUS   box:XxYxZ   cylinder:RADIUSxHEIGHT   capsule:RADIUSxHEIGHT   ellipsoid:XxYxZ

All in metres; X, Y, Z and HEIGHT are full lengths, end to end. A name alone has default sizes.
"""

from __future__ import annotations

from dataclasses import dataclass
from numbers import Real

import numpy as np

from planner.errors import NotFoundError, ObjectError
from planner.shapes import SHAPES, Shape

__all__ = ["DEFAULT_MASS", "OBJECT_NAMES", "GraspObject", "parse_object"]

DEFAULT_MASS = 0.1
"""Mass (kg) of an object for which neither mass nor density is given."""

HEAVIEST = 100.0
"""Largest mass (kg) that is believed: more is too heavy to lift, or was given in grams."""

_DEFAULT_SIZES: dict[str, tuple[float, ...]] = {
    "sphere": (0.035,),
    "box": (0.05, 0.05, 0.08),
    "cylinder": (0.03, 0.10),
    "capsule": (0.03, 0.12),
    "ellipsoid": (0.09, 0.07, 0.06),
}

OBJECT_NAMES = tuple(_DEFAULT_SIZES)
"""Names that ``parse_object`` knows."""


@dataclass(frozen=True, kw_only=True)
class GraspObject:
    """A rigid object of uniform density.

    Attributes:
        name: What to call it.
        shape: Its shape; the origin is its centre of mass.
        mass: kg.
    """

    name: str
    shape: Shape
    mass: float = DEFAULT_MASS

    def __post_init__(self) -> None:
        """Check the mass."""
        mass = _positive(f"{self.name}: mass", self.mass, "kg")
        if mass > HEAVIEST:
            raise ObjectError(
                f"{self.name}: mass is {mass:.6g} kg, more than {HEAVIEST:g} kg; masses are in kg "
                "and densities in kg/m3, was it given in grams by mistake?"
            )
        object.__setattr__(self, "mass", mass)


def parse_object(
    spec: str, *, mass: float | None = None, density: float | None = None
) -> GraspObject:
    """An object from a specification such as "box" or "box:0.05x0.05x0.08".

    Args:
        spec: Name, or name and sizes in m.
        mass: kg; ``DEFAULT_MASS`` if neither it nor a density is given.
        density: kg/m3; give this or ``mass``, not both.

    Raises:
        NotFoundError: Unknown name.
        ObjectError: Wrong number of sizes, not numbers, out of range, or mass and density given.
    """
    kind, colon, numbers = spec.strip().lower().partition(":")
    kind = kind.strip()
    if kind not in _DEFAULT_SIZES:
        hint = "Sizes follow a colon, in metres: box:0.05x0.05x0.08."
        raise NotFoundError("object", kind, OBJECT_NAMES, hint)
    sizes = _parse_sizes(spec, numbers, SHAPES[kind]) if colon else _DEFAULT_SIZES[kind]
    shape = SHAPES[kind].from_sizes(sizes)
    if mass is not None and density is not None:
        raise ObjectError(
            f"{spec!r}: mass {mass} kg and density {density} kg/m3 are both given; give one of them"
        )
    if density is not None:
        mass = _positive(f"{kind}: density", density, "kg/m3") * shape.volume
    return GraspObject(name=kind, shape=shape, mass=DEFAULT_MASS if mass is None else mass)


def _parse_sizes(spec: str, text: str, shape: type[Shape]) -> tuple[float, ...]:
    try:
        values = tuple(float(part) for part in text.split("x"))
    except ValueError:
        raise ObjectError(
            f"{spec!r}: {text!r} is not numbers separated by x; write {shape.form()} in metres"
        ) from None
    needed = len(shape.size_names)
    if len(values) != needed:
        raise ObjectError(
            f"{spec!r} has {len(values)} size(s); {shape.form()} needs {needed}, in metres"
        )
    return values


def _positive(what: str, value: object, unit: str) -> float:
    if isinstance(value, bool) or not isinstance(value, Real):
        raise ObjectError(f"{what} is {value!r}, not a number; give {unit} > 0")
    if not np.isfinite(float(value)) or float(value) <= 0:
        raise ObjectError(f"{what} is {value}; give {unit} > 0")
    return float(value)
