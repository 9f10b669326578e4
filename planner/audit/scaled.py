"""An object in another size: the factor on a mesh that files of grasps give."""

from __future__ import annotations

from dataclasses import replace

from planner.errors import TaskError
from planner.objects import GraspObject, parse_object
from planner.shapes import Mesh

__all__ = ["scaled_object"]

LENGTHS_ONLY = ("sphere", "box", "cylinder", "capsule", "ellipsoid")
"""Shapes whose sizes are all lengths."""


def scaled_object(item: GraspObject, scale: float) -> GraspObject:
    """The same object, mass and region, with all lengths multiplied.

    Args:
        item: The object.
        scale: Factor, > 0.

    Raises:
        TaskError: Its shape cannot be made in another size.
        ObjectError: The factor makes it too small or too large.
    """
    if scale == 1.0:
        return item
    shape = item.shape
    if isinstance(shape, Mesh) and shape.source is not None:
        source = shape.source
        made = Mesh.load(source.path, scale=source.scale * scale, repair=source.repair)
        return replace(item, shape=made)
    name, _, sizes = shape.spec.partition(":")
    if name not in LENGTHS_ONLY or not sizes:
        raise TaskError(
            f"the file scales its object by {scale:g}, and {shape.spec} cannot be scaled; give "
            "the mesh file that the grasps were made for"
        )
    scaled = "x".join(repr(scale * float(size)) for size in sizes.split("x"))
    return replace(item, shape=parse_object(f"{name}:{scaled}").shape)
