"""``touch_equations``: contacts lie on the object's surface, and pads feel its normal.

With the signed distance f of the object's shape, grown by the share s, and a contact p_i, or the
centre of a round tip of radius r_i:

    (1 + s) f(x_i) = r_i,    x_i = T^-1 p_i / (1 + s);    outward normal of the shape at x_i = m_i

The Jacobians are those of the error of ``sim.estimation.state``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from planner.shapes.base import Shape
from planner.spatial import FloatArray, contact_frames, cross, skew
from sim.estimation.state import Belief
from sim.estimation.tips import Tips

STEP = 1e-4
"""Step (m) of the differences that give the curvature of a surface."""


@dataclass(frozen=True, slots=True, eq=False)
class Equations:
    """residual = jacobian error + noise, of distances first, then of normals.

    Attributes:
        residual: (k,), m, then rad.
        jacobian: (k, 7 + m).
        distances: How many of the rows are distances.
    """

    residual: FloatArray
    jacobian: FloatArray
    distances: int


def nearest(shape: Shape, belief: Belief, points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Signed distances (k,), m, and outward normals (k, 3), base axes, at points (k, 3) there."""
    T, grown = belief.T_base_object, 1.0 + belief.size
    local = (points - T.translation) @ T.rotation / grown
    surface, normals = shape.closest_point(local)
    distance = grown * ((local - surface) * normals).sum(axis=1)
    return distance, np.asarray(normals @ T.rotation.T)


def touch_equations(
    shape: Shape,
    belief: Belief,
    tips: Tips,
    points: FloatArray,
    radii: FloatArray,
    felt: FloatArray | None,
) -> Equations:
    """What contacts say of pose, offsets and size.

    Args:
        shape: The object's.
        belief: What is known.
        tips: Fingertips of the k fingers that touch, at the joints as they are believed.
        points: (k, 3), contacts, or centres of round tips, m, base.
        radii: (k,), 0 or the tips' radii, m.
        felt: (k, 3), outward normals as the pads feel them; None if they do not.
    """
    k, m = len(points), len(belief.offsets)
    center = belief.T_base_object.translation
    if felt is None:
        distance, normals = nearest(shape, belief, points)
    else:
        frames = contact_frames(felt)  # the surface's own would jump with it
        across = frames[:, :, 1:].transpose(0, 2, 1)  # (k, 2, 3)
        beside = points[:, None] + STEP * across
        distance, normals = nearest(shape, belief, np.concatenate([points, beside.reshape(-1, 3)]))
        distance, normals, near = distance[:k], normals[:k], normals[k:].reshape(k, 2, 3)
    jacobians = tips.jacobians(points)  # (k, m, 3)
    rows = np.empty((k, 7 + m))
    rows[:, :3] = -normals
    rows[:, 3:6] = -cross(points, normals)
    rows[:, 6:-1] = -(jacobians @ normals[:, :, None])[:, :, 0]
    arm = points - center
    rows[:, -1] = (distance - (normals * arm).sum(axis=1)) / (1.0 + belief.size)
    if felt is None:
        return Equations(radii - distance, rows, k)
    bend = ((near - normals[:, None]) / STEP).transpose(0, 2, 1) @ across  # (k, 3, 3)
    turning = np.empty((k, 3, 7 + m))
    turning[:, :, :3] = -bend
    turning[:, :, 3:6] = bend @ skew(points) - skew(normals)
    turning[:, :, 6:-1] = -bend @ jacobians.transpose(0, 2, 1)
    turning[:, :, 6:-1] -= skew(felt) @ tips.angular.transpose(0, 2, 1)
    turning[:, :, -1] = -(bend @ arm[:, :, None])[:, :, 0] / (1.0 + belief.size)
    of_normals = (across @ turning).reshape(2 * k, -1)
    off = (across @ (felt - normals)[:, :, None]).reshape(-1)
    return Equations(np.concatenate([radii - distance, off]), np.concatenate([rows, of_normals]), k)
