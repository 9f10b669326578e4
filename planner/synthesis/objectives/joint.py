"""Objectives of the hand's joints: torque margin, manipulability, distance from limits.

torque           The share of its limit that each actuator spends on the internal force, scaled such
                 that every finger presses with the task's grip at least, and on an equal share of
                 the weight. Squared: the worst counts most. The weight of the links is left out.
manipulability   log det(J J^T / a^2 + e I) / 6 for the velocity Jacobian J of every finger at its
                 contact, of the joint velocities that couplings allow: the logarithm of Yoshikawa's
                 measure (1985, Manipulability of robotic mechanisms) per direction of motion. Its
                 derivative weighs each singular value by its inverse: the least one counts most,
                 and the measure is smooth where two are equal; e keeps it finite.
limits           How far every joint of the fingers is from its nearer limit, as a share of its
                 range.
"""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

from planner.hands.fingers import Finger
from planner.hands.hand import Hand
from planner.spatial import FloatArray, IntArray
from planner.synthesis.symbols import GraspPoint, GraspSymbols, contact_torque

MANIPULABILITY_TARGET = 0.15
"""Target of manipulability, more than fingers reach, m/rad."""

SINGULAR = 2e-4
"""Added to the eigenvalues of J J^T / ``MANIPULABILITY_TARGET``^2 (-): 2 mm/rad."""

LIMIT_TARGET = 0.25
"""Target of the distance from a limit over the range (-): the middle half is good."""

LEAST_PRESS = 0.1
"""Least normal force over the mean (-) below which forces are not scaled up further; the term
``press`` asks for more."""

LEAST_LIMIT = 1e-3
"""Limits of actuators nearer to zero than this (N m, N) count as this: a servo at the end of its
command range can hardly pull further."""


def driving(hand: Hand, fingers: tuple[Finger, ...]) -> IntArray:
    """Numbers (k,) of the actuators that move joints of these fingers."""
    joints = np.concatenate([f.q_index for f in fingers])
    return np.flatnonzero(hand.actuation.moment[:, joints].any(axis=1))


def free_velocities(hand: Hand, finger: Finger) -> FloatArray:
    """Basis (n, k) of the velocities of a finger's joints that its two-sided couplings allow."""
    from scipy.linalg import null_space  # here, since SciPy loads slowly

    rows = [
        c.row[finger.q_index]
        for c in hand.couplings
        if not c.one_sided and set(np.flatnonzero(c.row)) <= {int(i) for i in finger.q_index}
    ]
    return null_space(np.array(rows)) if rows else np.eye(len(finger.q_index))


def torque_rows(g: GraspSymbols) -> tuple[Any, Any]:
    """Minus the squared share of its limit that each actuator spends."""
    hand, n = g.symbolic.hand, len(g.fingers)
    used = driving(hand, g.fingers)
    grip, weight = ca.SX.sym("grip"), ca.SX.sym("weight", 3)
    per_limit = ca.SX.sym("per_limit", len(used), 2)
    torque = ca.SX.zeros(hand.nq)
    least = ca.SX(np.inf)
    for normal, force in zip(g.outward, g.forces, strict=True):
        least = ca.fmin(least, -ca.dot(force, normal))
    least = ca.fmax(least, LEAST_PRESS)
    for finger, normal, force in zip(g.fingers, g.outward, g.forces, strict=True):
        center = g.symbolic.point(finger.pad.joint_id, finger.pad.center)
        pressed = grip * force / least - weight / n
        torque += contact_torque(g.symbolic, finger, g.rotation, center, normal, pressed)
    firm = [c.row for c in hand.couplings if not c.one_sided]
    drive = np.linalg.pinv(np.column_stack([hand.actuation.moment.T, *firm]))
    effort = ca.DM(drive[used]) @ torque
    share = ca.fmax(effort * per_limit[:, 0], effort * per_limit[:, 1])
    return -(share**2), ca.vertcat(grip, weight, ca.vec(per_limit))


def update_torque(point: GraspPoint) -> FloatArray:
    """Grip (N), weight in the object's frame (N), inverse limits of the actuators."""
    task = point.task
    used = driving(task.hand, task.fingers)
    limits = task.hand.actuation.force_limits(point.q)[used]
    low, high = np.minimum(limits[:, 0], -LEAST_LIMIT), np.maximum(limits[:, 1], LEAST_LIMIT)
    weight = task.object.mass * task.T_world_object.rotation.T @ task.gravity
    return np.concatenate([[task.grip_force], weight, 1 / low, 1 / high])


def manipulability_rows(g: GraspSymbols) -> tuple[Any, Any]:
    """Logarithm of each finger's manipulability over its target."""
    rows = []
    for finger, normal in zip(g.fingers, g.outward, strict=True):
        pad = finger.pad
        point = g.symbolic.point(pad.joint_id, pad.center) - pad.radius * (g.rotation.T @ normal)
        jacobian = ca.vertcat(
            *[
                ca.horzcat(*[g.symbolic.joint_torque(name, point, axis) for name in finger.joints])
                for axis in np.eye(3)
            ]
        )
        free = jacobian @ ca.DM(free_velocities(g.symbolic.hand, finger)) / MANIPULABILITY_TARGET
        rows.append(ca.log(ca.det(free @ free.T + SINGULAR * ca.SX.eye(3))) / 6)
    return ca.vertcat(*rows), ca.SX(0, 1)


def limits_rows(g: GraspSymbols) -> tuple[Any, Any]:
    """Distance of each joint from both limits over its range, less its target."""
    hand = g.symbolic.hand
    index = np.concatenate([f.q_index for f in g.fingers])
    index = index[hand.q_upper[index] > hand.q_lower[index]]
    lower, upper = hand.q_lower[index], hand.q_upper[index]
    q = g.q[index.tolist()]
    rows = ca.vertcat((q - lower) / (upper - lower), (upper - q) / (upper - lower))
    return rows - LIMIT_TARGET, ca.SX(0, 1)
