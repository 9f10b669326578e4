"""An arrow as a mesh that is fixed to a joint: where a palm or a pad faces."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import trimesh

from planner.pages.scene import Layer, Part
from planner.spatial import FloatArray

__all__ = ["arrow_part"]

HEAD, SLIMNESS = 0.35, 0.035
"""Length of the head and radius of the shaft over the arrow's length (-)."""

SIDES = 16


def arrow_part(
    name: str,
    *,
    joint: int,
    layer: Layer,
    start: FloatArray,
    direction: FloatArray,
    length: float,
    colour: tuple[float, float, float, float],
) -> Part:
    """An arrow in a joint's frame.

    Args:
        name: What is said where it is pointed at.
        joint: Number of the joint that carries it; -1 for the base.
        layer: What switches it.
        start: Where it begins, (3,), m.
        direction: (3,), unit.
        length: m.
        colour: Red, green, blue, opacity.
    """
    shaft = trimesh.creation.cylinder(
        SLIMNESS * length, segment=[[0, 0, 0], [0, 0, (1 - HEAD) * length]], sections=SIDES
    )
    head = trimesh.creation.cone(3 * SLIMNESS * length, HEAD * length, sections=SIDES)
    head.apply_translation([0, 0, (1 - HEAD) * length])
    solid = trimesh.util.concatenate([shaft, head])
    turn = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), np.array(direction))
    return Part(
        name=name,
        joint=joint,
        layer=layer,
        vertices=np.asarray(solid.vertices) @ turn.toRotationMatrix().T + np.asarray(start),
        triangles=np.asarray(solid.faces, np.int64),
        colour=colour,
        smooth=True,
    )
