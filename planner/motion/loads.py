"""Loads of contacts and actuators that bear the weight along the path.

The forces f of a knot balance each other and are known up to a factor. The fingers press with

    F = scale f + G^+ (-w),    scale = max(grip / min_i f_i, weight / (FRICTION_SHARE mu n))

with the wrench w of the weight and normal forces f_i of mean 1. Every finger presses with the
task's grip at least, friction of all together can carry the weight, and G^+ (-w), the least forces
that balance it, are added. The solver chooses the direction of f within its cones. Required are

    load    share of its limit that an actuator spends on F  <= MOST_LOAD
    bearing FRICTION_SHARE mu F_n - |F_t|                    >= 0,   in units of the scale

A grasp that is far from the centre of mass, or presses by a long lever, has forces that balance
each other, but none that also bear the weight.
"""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import pinocchio as pin

from planner.hands.fingers import Finger
from planner.hands.hand import Hand
from planner.kinematics.symbolic import SymbolicHand
from planner.motion.path import ObjectPath
from planner.motion.terms import BEARING, LOAD
from planner.spatial import FloatArray
from planner.synthesis.objectives.joint import LEAST_LIMIT, LEAST_PRESS, driving
from planner.synthesis.symbols import contact_torque
from planner.synthesis.unknowns import Unknowns, mrp_matrix
from planner.task import GraspTask
from planner.tolerances import FRICTION_SHARE

MOST_LOAD = 0.75
"""Largest share (-) of an actuator's limit that the contact forces may take."""

LEAST_GRAM = 1e-6
"""Added to G G^T (-), for contacts on a line."""

TINY = 1e-12
"""Added under the root of a squared tangential force (N^2)."""


def load_function(hand: Hand, fingers: tuple[Finger, ...]) -> Any:
    """CasADi function of a knot's grasp unknowns, R0 (9, by columns) and ``load_parameters``.

    Gives margins >= 0: ``MOST_LOAD`` less the load of every actuator of the fingers (k,) and
    then the friction margins (n,), as residuals; and their Jacobian (k + n, size).
    """
    unknowns = Unknowns(n_joints=hand.nq, n_contacts=len(fingers))
    n, at = len(fingers), 6 + hand.nq
    x, r0 = ca.SX.sym("x", unknowns.size), ca.SX.sym("R0", 3, 3)
    used = driving(hand, fingers)
    grip, carry, weight = ca.SX.sym("grip"), ca.SX.sym("carry"), ca.SX.sym("weight", 3)
    mu, length = ca.SX.sym("mu"), ca.SX.sym("length")
    per_limit = ca.SX.sym("per_limit", len(used), 2)
    symbolic = SymbolicHand(hand, x[6:at])
    rotation = r0 @ mrp_matrix(x[:3])
    normals, forces, centers, columns = [], [], [], []
    least = ca.SX(np.inf)
    for i, finger in enumerate(fingers):
        point = x[at + 3 * i : at + 3 * i + 3]
        force = x[at + 3 * n + 3 * i : at + 3 * n + 3 * i + 3]
        center = symbolic.point(finger.pad.joint_id, finger.pad.center)
        outward = rotation @ center + x[3:6] - point
        outward = outward / ca.norm_2(outward)
        least = ca.fmin(least, -ca.dot(force, outward))
        normals.append(outward)
        forces.append(force)
        centers.append(center)
        columns.append(ca.vertcat(ca.SX.eye(3), ca.skew(point) / length))
    grasp = ca.horzcat(*columns)
    gram = grasp @ grasp.T + LEAST_GRAM * ca.SX.eye(6)
    parts = ca.ldl(gram)  # fewer operations than with the default, QR
    bearing = grasp.T @ ca.ldl_solve(ca.vertcat(-weight, ca.SX.zeros(3)), *parts)
    scale = ca.fmax(grip / ca.fmax(least, LEAST_PRESS), carry)
    torque = ca.SX.zeros(hand.nq)
    friction = []
    for i, finger in enumerate(fingers):
        pressed = scale * forces[i] + bearing[3 * i : 3 * i + 3]
        torque += contact_torque(symbolic, finger, rotation, centers[i], normals[i], pressed)
        normal = -ca.dot(pressed, normals[i])
        aside = ca.sqrt(ca.sumsqr(pressed + normal * normals[i]) + TINY)
        friction.append((FRICTION_SHARE * mu * normal - aside) / scale)
    firm = [c.row for c in hand.couplings if not c.one_sided]
    drive = np.linalg.pinv(np.column_stack([hand.actuation.moment.T, *firm]))
    effort = ca.DM(drive[used]) @ torque
    spare = MOST_LOAD - ca.fmax(effort * per_limit[:, 0], effort * per_limit[:, 1])
    out = ca.densify(ca.vertcat(LOAD.weight * spare, BEARING.weight * ca.vertcat(*friction)))
    parameters = ca.vertcat(grip, carry, mu, length, weight, ca.vec(per_limit))
    jacobian = ca.densify(ca.jacobian(out, x))
    return ca.Function("loads", [x, ca.vec(r0), parameters], [out, jacobian])


def load_parameters(
    task: GraspTask, path: ObjectPath, path_parameters: FloatArray, q: FloatArray
) -> FloatArray:
    """Parameters (n_knots, m) of ``load_function`` along a path.

    The weight turns in the object's frame as if the whole path were covered.

    Args:
        task: The task.
        path: Where the object is to go.
        path_parameters: Of each knot (n_knots,), 0 to 1.
        q: Joints (nq,) at which the actuators' limits are taken.
    """
    used = driving(task.hand, task.fingers)
    low, high = task.hand.actuation.force_limits(q)[used].T
    low, high = np.minimum(low, -LEAST_LIMIT), np.maximum(high, LEAST_LIMIT)
    weight = task.object.mass * task.gravity
    carry = float(np.linalg.norm(weight)) / (FRICTION_SHARE * task.mu * len(task.fingers))
    to_object = task.T_world_object.rotation.T
    return np.array(
        [
            np.concatenate(
                [
                    [task.grip_force, carry, task.mu, task.object.shape.bounding_radius],
                    to_object @ pin.exp3(-c * path.angle * path.axis) @ weight,
                    1 / low,
                    1 / high,
                ]
            )
            for c in path_parameters
        ]
    )
