"""Shapes as plain data for JSON: ``{"kind": "cylinder", "radius_m": 0.03, "height_m": 0.1}``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from typing import Any

from planner.errors import NotFoundError, ObjectError
from planner.shapes.base import Shape
from planner.shapes.box import Box
from planner.shapes.capsule import Capsule
from planner.shapes.cylinder import Cylinder
from planner.shapes.ellipsoid import Ellipsoid
from planner.shapes.sphere import Sphere

__all__ = ["SHAPES", "shape_from_dict", "shape_to_dict"]

SHAPES: dict[str, type[Shape]] = {s.kind: s for s in (Sphere, Box, Cylinder, Capsule, Ellipsoid)}
"""Every kind of shape by its name."""


def shape_to_dict(shape: Shape) -> dict[str, Any]:
    """A shape as strings, floats and lists: its kind, and its attributes with their unit."""
    data: dict[str, Any] = {"kind": shape.kind}
    for key, name in _keys(type(shape)).items():
        value = getattr(shape, name)
        data[key] = list(value) if isinstance(value, tuple) else value
    return data


def shape_from_dict(data: object) -> Shape:
    """The shape that ``shape_to_dict`` wrote, validated.

    Raises:
        NotFoundError: Unknown kind.
        ObjectError: Not a mapping, a key missing or unknown, or a size out of range.
    """
    if not isinstance(data, Mapping):
        raise ObjectError(f'a shape is {data!r}; give an object such as {{"kind": "box", ...}}')
    kind = data.get("kind")
    if not isinstance(kind, str):
        raise ObjectError(f'a shape has kind {kind!r}; give "kind" as one of {sorted(SHAPES)}')
    if kind not in SHAPES:
        raise NotFoundError("shape", kind, SHAPES)
    keys = _keys(SHAPES[kind])
    given = {str(key) for key in data} - {"kind"}
    if given != set(keys):
        raise ObjectError(f"a {kind} has {sorted(given)}; it needs {sorted(keys)} and no others")
    return SHAPES[kind](**{name: data[key] for key, name in keys.items()})


def _keys(shape: Any) -> dict[str, str]:
    """Keys of the plain data and the attributes they stand for."""
    return {f"{field.name}_m": field.name for field in fields(shape)}
