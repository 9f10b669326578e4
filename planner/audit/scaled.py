"""An object in another size: the factor on a mesh that files of grasps give."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from planner.errors import TaskError
from planner.objects import GraspObject, parse_object
from planner.shapes import SIZED_SHAPES, Mesh

SAME = 1e-3
"""Largest relative error (-) of lengths and volume of the result; it is larger for
a shape of which not all sizes are lengths."""


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
    if name in SIZED_SHAPES and sizes:
        scaled = "x".join(repr(scale * float(size)) for size in sizes.split("x"))
        made_shape = parse_object(f"{name}:{scaled}").shape
        if np.isclose(made_shape.volume, scale**3 * shape.volume, rtol=SAME) and np.allclose(
            made_shape.half_extents, scale * shape.half_extents, rtol=SAME
        ):
            return replace(item, shape=made_shape)
    raise TaskError(
        f"the file scales its object by {scale:g}, and {shape.spec} cannot be scaled; give "
        "the mesh file that the grasps were made for"
    )
