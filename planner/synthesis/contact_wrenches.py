"""Wrenches of contacts on the object, and their joint torques, as CasADi expressions.

The terms (``planner.synthesis.terms``) and the objectives share these.
"""

from __future__ import annotations

from typing import Any

import casadi as ca

from planner.hands.fingers import Finger
from planner.kinematics.symbolic import SymbolicHand

TINY = 1e-9
"""Keeps the root of a sum of squares differentiable at zero."""


def support(u: Any, points: list[Any], outward: list[Any], mu: Any, length: Any) -> Any:
    """Support of the round cones' unit wrenches in direction u (6,), torques over ``length``.

    max_i  g_i . n_i + mu |g_i - (g_i . n_i) n_i|,   g_i = u_f + u_t x p_i / length.
    """
    values = []
    for p, n in zip(points, outward, strict=True):
        g = u[:3] + ca.cross(u[3:], p) / length
        normal = -ca.dot(g, n)
        tangential = g + normal * n
        values.append(normal + mu * ca.sqrt(ca.sumsqr(tangential) + TINY))
    top = values[0]
    for value in values[1:]:
        top = ca.fmax(top, value)
    return top


def contact_torque(
    symbolic: SymbolicHand, finger: Finger, rotation: Any, center: Any, normal: Any, force: Any
) -> Any:
    """Joint torques (nq,) with which a finger presses ``force`` (object frame) at its contact.

    Args:
        symbolic: Kinematics.
        finger: The finger.
        rotation: Of the base in the object's frame (3, 3).
        center: Centre of the pad in the base (3,).
        normal: Outward normal, object frame (3,).
        force: On the object (3,).
    """
    point = center - finger.pad.radius * (rotation.T @ normal)
    local = rotation.T @ force
    out = ca.SX.zeros(symbolic.hand.nq)
    for name, index in zip(finger.joints, finger.q_index, strict=True):
        out[int(index)] = symbolic.joint_torque(name, point, local)
    return out
