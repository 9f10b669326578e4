"""Meshes in trials of turns: how large they are, and how they stand.

Those of the project are scaled as a whole, so that they are as wide as the cylinders and blocks of
a trial; files, and names with sizes of their own, are taken as they are. All stand as high as they
can, as cylinders and blocks do: a hand from above needs room below its fingertips.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from planner.objects import object_names, parse_object
from planner.shapes import SIZED_SHAPES, Shape
from planner.shapes.made import Made
from planner.spatial import SE3, FloatArray

SURE_DEG = 10.0
"""Least tilt (degrees) that an object must bear to stand higher than in its surest pose."""

ALIKE = 0.001
"""Difference of two heights (m) that is none: the surer pose is taken."""


def scaled_spec(spec: str, width: float) -> str:
    """The specification of an object that is about this wide, m, if its size is not given.

    Width is the narrower side of its bounding box as it stands.
    """
    name = spec.strip().lower()
    if name not in object_names() or not issubclass(SIZED_SHAPES[name], Made):
        return spec
    own, sizes = _default(name)
    factor = width / own
    scaled = (size if is_pure else round(factor * size, 5) for size, is_pure in sizes)
    return f"{name}:{'x'.join(f'{size:g}' for size in scaled)}"


@lru_cache
def _default(name: str) -> tuple[float, tuple[tuple[float, bool], ...]]:
    """Width (m) of a mesh of the project, and its sizes, with whether they are pure numbers."""
    shape = parse_object(name).shape
    width = float(_extents(shape, standing(shape).rotation)[:2].min())
    sizes = zip(shape.sizes, shape.size_names, strict=True)
    return width, tuple((size, of in shape.pure_numbers) for size, of in sizes)


def standing(shape: Shape) -> SE3:
    """``T_world_object`` on a table at height 0, as high as the object stands surely."""
    poses = shape.resting_poses()
    sure = [k for k, pose in enumerate(poses) if (pose.margin_deg or SURE_DEG) >= SURE_DEG] or [0]
    heights = [float(_extents(shape, poses[k].rotation)[2]) for k in sure]
    # the first one is the surest
    return shape.resting_pose(
        index=next(k for k, h in zip(sure, heights, strict=True) if h > max(heights) - ALIKE)
    )


def _extents(shape: Shape, rotation: FloatArray) -> FloatArray:
    """Extents (3,) along the world's axes, m."""
    return np.array([shape.support(axis) + shape.support(-axis) for axis in rotation])
