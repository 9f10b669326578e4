"""Loops of ``HoldingTorques``: how the holding fingertips move, and joint torques for forces.

Called at every step from the squeeze on. Where kernels are not compiled NumPy computes the same;
sums are in another order, so that the two differ by rounding.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planner.numerics.kernels import kernel
from planner.spatial import FloatArray, skew

POSTURE_STIFFNESS = 0.3
"""Spring (N m/rad) on what a redundant finger can do by itself, a tenth of a servo's."""

SEARCH_FORCE, SEARCH_DAMPING = 0.5, 15.0
"""A finger that lost the object presses on along its last normal with this force (N), against this
damper (N s/m): it moves at some 3 cm/s."""

RETREAT, RETREAT_STIFFNESS = 0.01, 100.0
"""Distance (m) that a leaving finger keeps from where it held, and the spring (N/m) for that."""

RANK_TOL = 1e-6
"""Added to G G^T (-, m^2) where too few fingers hold to fix every motion."""

FLAT = 1e-8
"""Added to J J^T (m^2): a stretched finger has a direction in which it cannot push, 0.1 mm/rad."""

_RANK, _FLAT = RANK_TOL * np.eye(6), FLAT * np.eye(3)


def grasp_matrix(arms: FloatArray) -> FloatArray:
    """G (6, 3 n): forces in the axes at arms (n, 3) from the centre -> wrench about it."""
    n = len(arms)
    out = np.empty((6, n, 3))
    out[:3] = np.eye(3)[:, None]
    out[3:] = skew(arms).transpose(1, 0, 2)
    return out.reshape(6, 3 * n)


def twist_of(velocities: FloatArray, arms: FloatArray) -> FloatArray:
    """Twist (6,) of the body that points at arms (n, 3) from its centre move like, (n, 3) m/s."""
    grasp = grasp_matrix(arms)
    return np.asarray(np.linalg.solve(grasp @ grasp.T + _RANK, grasp @ velocities.ravel()))


def _tips_moved_plain(
    full: FloatArray,
    moved_by: NDArray[np.bool_],
    points: FloatArray,
    center: FloatArray,
    holding: NDArray[np.bool_],
    v: FloatArray,
    apart: FloatArray,
    stiffness: float,
    jacobians: FloatArray,
    velocity: FloatArray,
    spring: FloatArray,
) -> FloatArray:
    """``tips_moved`` in NumPy."""
    mine = np.where(moved_by[:, None], full, 0.0)
    jacobians[:] = mine[:, :3] - skew(points) @ mine[:, 3:]
    velocity[:] = jacobians @ v
    mask = holding[:, None]
    grasp = grasp_matrix(points - center) * np.repeat(holding, 3)
    held = np.where(mask, apart, 0.0)
    moved = np.column_stack([velocity.ravel(), held.ravel()])
    rigid = np.linalg.solve(grasp @ grasp.T + _RANK, grasp @ moved)
    rest = held - (rigid[:, 1] @ grasp).reshape(-1, 3)
    spring[:] = np.where(mask, stiffness * rest, 0.0)
    return np.asarray(rigid[:, 0])


@kernel(_tips_moved_plain)
def tips_moved(
    full: FloatArray,
    moved_by: NDArray[np.bool_],
    points: FloatArray,
    center: FloatArray,
    holding: NDArray[np.bool_],
    v: FloatArray,
    apart: FloatArray,
    stiffness: float,
    jacobians: FloatArray,
    velocity: FloatArray,
    spring: FloatArray,
) -> FloatArray:
    """Twist (6,), about ``center``, of the body that the holding fingertips move like.

    Args:
        full: (6, nq), twist of the point at the origin per joint rate.
        moved_by: (n, nq), which joints move each pad.
        points: (n, 3), contacts, m.
        center: (3,), m.
        holding: (n,), which fingers hold.
        v: (nq,), joint rates.
        apart: (n, 3), from the fingertips to where they were latched, m.
        stiffness: Spring (N/m) of fingertips against each other.
        jacobians: (n, 3, nq), of the contacts: written.
        velocity: (n, 3), of the contacts, m/s: written.
        spring: (n, 3), forces of that spring, without a wrench, N: written.
    """
    n, nq = moved_by.shape
    gram, right = np.zeros((6, 6)), np.zeros((6, 2))
    for k in range(6):
        gram[k, k] = RANK_TOL
    for i in range(n):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        v0, v1, v2 = 0.0, 0.0, 0.0
        for j in range(nq):
            if moved_by[i, j]:
                a, b, c = full[3, j], full[4, j], full[5, j]
                p = full[0, j] - (y * c - z * b)
                q = full[1, j] - (z * a - x * c)
                r = full[2, j] - (x * b - y * a)
                v0, v1, v2 = v0 + p * v[j], v1 + q * v[j], v2 + r * v[j]
            else:
                p, q, r = 0.0, 0.0, 0.0
            jacobians[i, 0, j], jacobians[i, 1, j], jacobians[i, 2, j] = p, q, r
        velocity[i, 0], velocity[i, 1], velocity[i, 2] = v0, v1, v2
        if holding[i]:
            x, y, z = x - center[0], y - center[1], z - center[2]
            for k in range(3):
                gram[k, k] += 1.0
                right[k, 0] += velocity[i, k]
                right[k, 1] += apart[i, k]
            gram[0, 4] += z
            gram[0, 5] -= y
            gram[1, 3] -= z
            gram[1, 5] += x
            gram[2, 3] += y
            gram[2, 4] -= x
            gram[3, 3] += y * y + z * z
            gram[4, 4] += x * x + z * z
            gram[5, 5] += x * x + y * y
            gram[3, 4] -= x * y
            gram[3, 5] -= x * z
            gram[4, 5] -= y * z
            right[3, 0] += y * v2 - z * v1
            right[4, 0] += z * v0 - x * v2
            right[5, 0] += x * v1 - y * v0
            right[3, 1] += y * apart[i, 2] - z * apart[i, 1]
            right[4, 1] += z * apart[i, 0] - x * apart[i, 2]
            right[5, 1] += x * apart[i, 1] - y * apart[i, 0]
    # Cholesky: gram = U'U with U in its upper triangle
    for k in range(6):
        for m in range(k):
            gram[k, k] -= gram[m, k] * gram[m, k]
        gram[k, k] = np.sqrt(gram[k, k])
        for j in range(k + 1, 6):
            for m in range(k):
                gram[k, j] -= gram[m, k] * gram[m, j]
            gram[k, j] /= gram[k, k]
    for s in range(2):
        for k in range(6):
            for m in range(k):
                right[k, s] -= gram[m, k] * right[m, s]
            right[k, s] /= gram[k, k]
        for k in range(5, -1, -1):
            for m in range(k + 1, 6):
                right[k, s] -= gram[k, m] * right[m, s]
            right[k, s] /= gram[k, k]
    u0, u1, u2 = right[0, 1], right[1, 1], right[2, 1]
    w0, w1, w2 = right[3, 1], right[4, 1], right[5, 1]
    for i in range(n):
        if holding[i]:
            x, y, z = points[i, 0] - center[0], points[i, 1] - center[1], points[i, 2] - center[2]
            spring[i, 0] = stiffness * (apart[i, 0] - (u0 + w1 * z - w2 * y))
            spring[i, 1] = stiffness * (apart[i, 1] - (u1 + w2 * x - w0 * z))
            spring[i, 2] = stiffness * (apart[i, 2] - (u2 + w0 * y - w1 * x))
        else:
            spring[i, 0], spring[i, 1], spring[i, 2] = 0.0, 0.0, 0.0
    return right[:, 0].copy()


def _torques_for_plain(
    forces: FloatArray,
    normals: FloatArray,
    holding: NDArray[np.bool_],
    searching: NDArray[np.bool_],
    spring: FloatArray,
    apart: FloatArray,
    velocity: FloatArray,
    jacobians: FloatArray,
    own: NDArray[np.bool_],
    bent: FloatArray,
    rates: FloatArray,
    stiffness: FloatArray,
    damping: FloatArray,
    torque: FloatArray,
) -> FloatArray:
    """``torques_for`` in NumPy."""
    seek = SEARCH_FORCE * normals
    away = RETREAT_STIFFNESS * (apart - RETREAT * normals)
    alone = np.where(searching[:, None], seek, away) - SEARCH_DAMPING * velocity
    total = np.where(holding[:, None], forces + spring, alone)
    out = total.ravel() @ jacobians.reshape(-1, len(bent)) + torque
    posture = np.where(own, POSTURE_STIFFNESS * bent, 0.0)  # (n, nq)
    jac = np.where(own[:, None], jacobians, 0.0)
    gram = jac @ jac.transpose(0, 2, 1) + _FLAT
    force = np.linalg.solve(gram, jac @ posture[..., None])
    idle = (posture - (jac.transpose(0, 2, 1) @ force)[..., 0]).sum(axis=0)
    return np.asarray(out + idle + stiffness * bent - damping * rates)


@kernel(_torques_for_plain)
def torques_for(
    forces: FloatArray,
    normals: FloatArray,
    holding: NDArray[np.bool_],
    searching: NDArray[np.bool_],
    spring: FloatArray,
    apart: FloatArray,
    velocity: FloatArray,
    jacobians: FloatArray,
    own: NDArray[np.bool_],
    bent: FloatArray,
    rates: FloatArray,
    stiffness: FloatArray,
    damping: FloatArray,
    torque: FloatArray,
) -> FloatArray:
    """Joint torques (nq,), N m: of contact forces, of fingers that hold nothing, of the posture.

    The spring on the posture presses nowhere: its torque t becomes t - J^T f, f by least squares,
    so that it moves what a redundant finger can move without its tip.

    Args:
        forces: (n, 3), of the fingers that hold, N.
        normals: (n, 3), into the object.
        holding: (n,), which fingers hold.
        searching: (n,), which look for the object; the rest stay off it.
        spring: (n, 3), forces of the fingers that hold against each other, N.
        apart: (n, 3), from the fingertips to where they were latched, m.
        velocity: (n, 3), of the contacts, m/s.
        jacobians: (n, 3, nq).
        own: (n, nq), joints of each finger.
        bent: (nq,), from where the joints are to their posture, rad.
        rates: (nq,), of the joints beyond those of the posture, rad/s.
        stiffness: (nq,), springs on the joints that take no part, N m/rad.
        damping: (nq,), N m s/rad.
        torque: (nq,), added, N m.
    """
    n, nq = own.shape
    out = torque.copy()
    for j in range(nq):
        out[j] += stiffness[j] * bent[j] - damping[j] * rates[j]
    push = np.empty(3)
    for i in range(n):
        for k in range(3):
            if holding[i]:
                push[k] = forces[i, k] + spring[i, k]
            else:
                if searching[i]:
                    push[k] = SEARCH_FORCE * normals[i, k]
                else:
                    push[k] = RETREAT_STIFFNESS * (apart[i, k] - RETREAT * normals[i, k])
                push[k] -= SEARCH_DAMPING * velocity[i, k]
        f0, f1, f2 = push[0], push[1], push[2]
        a, b, c, d, e, f = FLAT, 0.0, 0.0, FLAT, 0.0, FLAT  # J J^T by its upper triangle
        r0, r1, r2 = 0.0, 0.0, 0.0
        for j in range(nq):
            p, q, r = jacobians[i, 0, j], jacobians[i, 1, j], jacobians[i, 2, j]
            out[j] += f0 * p + f1 * q + f2 * r
            if own[i, j]:
                t = POSTURE_STIFFNESS * bent[j]
                a, b, c = a + p * p, b + p * q, c + p * r
                d, e, f = d + q * q, e + q * r, f + r * r
                r0, r1, r2 = r0 + p * t, r1 + q * t, r2 + r * t
        # Cholesky of the 3 x 3 matrix
        l00 = np.sqrt(a)
        l10, l20 = b / l00, c / l00
        l11 = np.sqrt(d - l10 * l10)
        l21 = (e - l20 * l10) / l11
        l22 = np.sqrt(f - l20 * l20 - l21 * l21)
        s0 = r0 / l00
        s1 = (r1 - l10 * s0) / l11
        s2 = (r2 - l20 * s0 - l21 * s1) / l22
        g2 = s2 / l22
        g1 = (s1 - l21 * g2) / l11
        g0 = (s0 - l10 * g1 - l20 * g2) / l00
        for j in range(nq):
            if own[i, j]:
                p, q, r = jacobians[i, 0, j], jacobians[i, 1, j], jacobians[i, 2, j]
                out[j] += POSTURE_STIFFNESS * bent[j] - (g0 * p + g1 * q + g2 * r)
    return out
