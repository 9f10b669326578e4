"""Loops of ``ForceLoop``: rows and limits of point contacts, and what an answer misses.

``ForceLoop`` calls them at every step where kernels are compiled and all contacts are points. Else
it does the same with ``ContactWorkspace``, ``TorqueLimits`` and ``DenseQp``, array by array.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planner.numerics.kernels import kernel
from planner.spatial import FloatArray, cross

REFUSED, OPEN_CHANGED = 1, 2
"""What ``place_points`` answers beside 0: numbers that are not finite or frames that are no
rotations; that contacts load other joints than before."""

STOPS_CHANGED = 3
"""What ``renew_limits`` answers beside 0: other stops are active than the rows are for."""

AWAY_CHANGED = 4
"""What ``press_points`` answers beside 0 and ``REFUSED``: other contacts are away than before."""

ORTHONORMAL_TOL = 1e-6
"""Largest entry of F'F - 1 of a frame (-): ``planner.contacts.checks`` has the same."""


def _place_points_plain(
    positions: FloatArray,
    frames: FloatArray,
    center: FloatArray,
    jacobians: FloatArray,
    length: float,
    z: FloatArray,
    table: FloatArray,
    lever: FloatArray,
    torque_rows: FloatArray,
    loaded: NDArray[np.bool_],
) -> int:
    """``place_points`` in NumPy."""
    error = frames.transpose(0, 2, 1) @ frames - np.eye(3)
    finite = all(np.isfinite(a).all() for a in (positions, frames, center, jacobians))
    if not finite or np.abs(error).max() > ORTHONORMAL_TOL or (np.linalg.det(frames) < 0.0).any():
        return REFUSED
    axes = frames.transpose(0, 2, 1).reshape(-1, 3)
    arms, m = np.repeat((positions - center) / length, 3, axis=0), len(axes)
    table[:3, :m], table[3:, :m] = axes.T, cross(arms, axes).T
    lever[:m] = (frames.transpose(0, 2, 1) @ jacobians[:, :3]).reshape(m, -1)
    torque_rows[:, :m] = z @ lever[:m].T
    now = lever != 0.0
    same = bool((now == loaded).all())
    loaded[:] = now
    return 0 if same else OPEN_CHANGED


@kernel(_place_points_plain)
def place_points(
    positions: FloatArray,
    frames: FloatArray,
    center: FloatArray,
    jacobians: FloatArray,
    length: float,
    z: FloatArray,
    table: FloatArray,
    lever: FloatArray,
    torque_rows: FloatArray,
    loaded: NDArray[np.bool_],
) -> int:
    """Write the rows of n point contacts.

    Args:
        positions: (n, 3), m.
        frames: (n, 3, 3), axes in columns.
        center: (3,), m.
        jacobians: (n, 3 or more, nv).
        length: Torques are divided by it, m.
        z: (nv, nv), rows of ``TorqueCase``.
        table: (6, nx), grasp map in the first 3 n columns: written.
        lever: (nx, nv), joint torque per force in the first 3 n rows: written.
        torque_rows: (nv, nx), Z J' in the first 3 n columns: written.
        loaded: (nx, nv), where ``lever`` is not zero: compared and written.

    Returns:
        0, ``REFUSED`` (nothing is written then) or ``OPEN_CHANGED``.
    """
    n, nv = len(positions), z.shape[0]
    total = 0.0
    for k in range(3):
        total += center[k]
    for i in range(n):
        for k in range(3):
            total += positions[i, k]
            for j in range(nv):
                total += jacobians[i, k, j]
        for a in range(3):
            for b in range(a, 3):
                dot = 0.0
                for k in range(3):
                    dot += frames[i, k, a] * frames[i, k, b]
                if a == b:
                    dot -= 1.0
                if not abs(dot) <= ORTHONORMAL_TOL:
                    return REFUSED
        handed = 0.0
        for k in range(3):
            u, v = (k + 1) % 3, (k + 2) % 3
            handed += frames[i, k, 0] * (
                frames[i, u, 1] * frames[i, v, 2] - frames[i, v, 1] * frames[i, u, 2]
            )
        if not handed > 0.0:
            return REFUSED
    if not np.isfinite(total):
        return REFUSED
    same = True
    for i in range(n):
        x = (positions[i, 0] - center[0]) / length
        y = (positions[i, 1] - center[1]) / length
        w = (positions[i, 2] - center[2]) / length
        for c in range(3):
            at = 3 * i + c
            f0, f1, f2 = frames[i, 0, c], frames[i, 1, c], frames[i, 2, c]
            table[0, at], table[1, at], table[2, at] = f0, f1, f2
            table[3, at] = y * f2 - w * f1
            table[4, at] = w * f0 - x * f2
            table[5, at] = x * f1 - y * f0
            for j in range(nv):
                arm = f0 * jacobians[i, 0, j] + f1 * jacobians[i, 1, j] + f2 * jacobians[i, 2, j]
                lever[at, j] = arm
                is_loaded = arm != 0.0
                if is_loaded != loaded[at, j]:
                    same = False
                    loaded[at, j] = is_loaded
            for r in range(nv):
                row = 0.0
                for j in range(nv):
                    row += z[r, j] * lever[at, j]
                torque_rows[r, at] = row
    return 0 if same else OPEN_CHANGED


def _renew_limits_plain(
    linear: FloatArray,
    state: FloatArray,
    active: NDArray[np.bool_],
    stop_tol: float,
    ends: FloatArray,
    least: FloatArray,
    most: FloatArray,
    opened: FloatArray,
    made: FloatArray,
    limits: FloatArray,
) -> int:
    """``renew_limits`` in NumPy."""
    ns, nv = len(active), limits.shape[1]
    out = linear @ state
    if ((out[:ns] <= stop_tol) != active).any():
        return STOPS_CHANGED
    made[:] = np.minimum(np.maximum(ends + out[ns + nv :], least), most)
    limits[:] = made[:, :nv] - out[ns : ns + nv] + opened
    return 0


@kernel(_renew_limits_plain)
def renew_limits(
    linear: FloatArray,
    state: FloatArray,
    active: NDArray[np.bool_],
    stop_tol: float,
    ends: FloatArray,
    least: FloatArray,
    most: FloatArray,
    opened: FloatArray,
    made: FloatArray,
    limits: FloatArray,
) -> int:
    """Write the limits of the rows of torque; see ``TorqueCase`` for the arrays.

    Args:
        linear: (ns + 2 nv + ne, 2 nv + 1).
        state: (2 nv + 1,), [q, 1, gravity torque].
        active: (ns,), stops that the rows are for.
        stop_tol: Gap (rad) at which a stop is active.
        ends: (2, nv + ne).
        least: (2, nv + ne).
        most: (2, nv + ne).
        opened: (2, nv), infinite for rows that do not count, else 0.
        made: (2, nv + ne), limits of what rows are about: written.
        limits: (2, nv): written.

    Returns:
        0 or ``STOPS_CHANGED``, when nothing is written.
    """
    ns, nv = len(active), limits.shape[1]
    width = made.shape[1]
    size = len(state)
    for r in range(ns):
        gap = 0.0
        for j in range(size):
            gap += linear[r, j] * state[j]
        if (gap <= stop_tol) != active[r]:
            return STOPS_CHANGED
    for k in range(width):
        offset = 0.0
        for j in range(size):
            offset += linear[ns + nv + k, j] * state[j]
        shift = 0.0
        if k < nv:
            for j in range(size):
                shift += linear[ns + k, j] * state[j]
        for side in range(2):
            value = min(max(ends[side, k] + offset, least[side, k]), most[side, k])
            made[side, k] = value
            if k < nv:
                limits[side, k] = value - shift + opened[side, k]
    return 0


def _shortfall_plain(
    table: FloatArray, limits: FloatArray, x: FloatArray, value: FloatArray
) -> float:
    """``shortfall`` in NumPy."""
    value[:] = table @ x
    worst = float(np.max([limits[0] - value, value - limits[1]]))
    return max(worst, 0.0) if np.isfinite(worst) else np.inf


@kernel(_shortfall_plain)
def shortfall(table: FloatArray, limits: FloatArray, x: FloatArray, value: FloatArray) -> float:
    """Largest violation of a programme's limits at x, as ``DenseQp.violation`` without cones.

    Args:
        table: (m, n).
        limits: (2, m).
        x: (n,).
        value: (m,), table @ x: written.

    Returns:
        >= 0; infinite for NaN.
    """
    m, n = table.shape
    worst = 0.0
    for r in range(m):
        dot = 0.0
        for j in range(n):
            dot += table[r, j] * x[j]
        value[r] = dot
        under, over = limits[0, r] - dot, dot - limits[1, r]
        if not (under <= worst and over <= worst):
            worst = max(under, over) if np.isfinite(dot) else np.inf
    return worst


def _press_points_plain(
    least: FloatArray,
    most: FloatArray,
    step: int,
    lower: FloatArray,
    upper: FloatArray,
    away: NDArray[np.bool_],
) -> int:
    """``press_points`` in NumPy."""
    sound = (least >= 0.0) & np.isfinite(least) & (most >= 0.0)
    if not (sound & ((least <= most) | (most <= 0.0))).all():
        return REFUSED
    now = most <= 0.0
    lower[: step * len(least) : step] = np.minimum(least, most)
    upper[: step * len(least) : step] = most
    same = bool((now == away).all())
    away[:] = now
    return 0 if same else AWAY_CHANGED


@kernel(_press_points_plain)
def press_points(
    least: FloatArray,
    most: FloatArray,
    step: int,
    lower: FloatArray,
    upper: FloatArray,
    away: NDArray[np.bool_],
) -> int:
    """Write bounds on the normal forces of n contacts.

    Args:
        least: (n,), N.
        most: (n,), N; 0 for a contact that is away.
        step: Unknowns per contact, the normal force first.
        lower: (nx,): written.
        upper: (nx,): written.
        away: (n,), which contacts are away: compared and written.

    Returns:
        0, ``REFUSED`` (nothing is written then) or ``AWAY_CHANGED``.
    """
    n = len(least)
    for i in range(n):
        sound = least[i] >= 0.0 and least[i] < np.inf and most[i] >= 0.0
        if not (sound and (least[i] <= most[i] or most[i] <= 0.0)):
            return REFUSED
    same = True
    for i in range(n):
        lower[step * i], upper[step * i] = min(least[i], most[i]), most[i]
        is_away = most[i] <= 0.0
        if is_away != away[i]:
            same = False
            away[i] = is_away
    return 0 if same else AWAY_CHANGED


def _give_answer_plain(
    x: FloatArray,
    met: FloatArray,
    row_unit: FloatArray,
    wrench: FloatArray,
    lever: FloatArray,
    gravity: FloatArray,
    forces: FloatArray,
    left_over: FloatArray,
    torques: FloatArray,
) -> None:
    """``give_answer`` in NumPy."""
    forces[:, :3] = x[: 3 * len(forces)].reshape(-1, 3)
    left_over[:] = met * row_unit + wrench
    torques[:] = x @ lever + gravity


@kernel(_give_answer_plain)
def give_answer(
    x: FloatArray,
    met: FloatArray,
    row_unit: FloatArray,
    wrench: FloatArray,
    lever: FloatArray,
    gravity: FloatArray,
    forces: FloatArray,
    left_over: FloatArray,
    torques: FloatArray,
) -> None:
    """Write what unknowns of n point contacts mean.

    Args:
        x: (nx,), forces first, N.
        met: (6,), balance rows at x.
        row_unit: (6,), of these rows.
        wrench: (6,), N and N m.
        lever: (nx, nv), joint torque per unknown.
        gravity: (nv,), N m.
        forces: (n, 4): written but for the torques about the normals.
        left_over: (6,), unbalanced wrench: written.
        torques: (nv,), of the joints: written.
    """
    for i in range(len(forces)):
        for k in range(3):
            forces[i, k] = x[3 * i + k]
    for k in range(6):
        left_over[k] = met[k] * row_unit[k] + wrench[k]
    for j in range(len(torques)):
        torque = 0.0
        for k in range(len(x)):
            torque += x[k] * lever[k, j]
        torques[j] = torque + gravity[j]


def _turn_onto_plain(
    frames: FloatArray, normals: FloatArray, opposed: float, out: FloatArray
) -> bool:
    """``turn_onto`` in NumPy."""
    old = frames[:, :, 0]
    cosine = (old * normals).sum(axis=1)
    if (cosine < opposed).any():
        return False
    dyad = normals[:, :, None] * old[:, None]
    turn = dyad - dyad.transpose(0, 2, 1)  # the cross-product matrix of old x normals
    rotation = _IDENTITY + turn + turn @ turn / (1.0 + cosine)[:, None, None]
    out[:] = rotation @ frames
    return True


_IDENTITY = np.eye(3)


@kernel(_turn_onto_plain)
def turn_onto(frames: FloatArray, normals: FloatArray, opposed: float, out: FloatArray) -> bool:
    """Turn contact frames by the least rotation onto normals.

    Args:
        frames: (n, 3, 3), axes in columns.
        normals: (n, 3), unit.
        opposed: Cosine of old and new normal below which there is no least rotation.
        out: (n, 3, 3): written.

    Returns:
        Whether all could be turned; else some are not written.
    """
    for i in range(len(frames)):
        a, b, c = normals[i, 0], normals[i, 1], normals[i, 2]
        u, v, w = frames[i, 0, 0], frames[i, 1, 0], frames[i, 2, 0]
        cosine = u * a + v * b + w * c
        if cosine < opposed:
            return False
        x, y, z = v * c - w * b, w * a - u * c, u * b - v * a  # old x new
        share = 1.0 / (1.0 + cosine)
        for k in range(3):
            p, q, r = frames[i, 0, k], frames[i, 1, k], frames[i, 2, k]
            s0, s1, s2 = y * r - z * q, z * p - x * r, x * q - y * p
            out[i, 0, k] = p + s0 + share * (y * s2 - z * s1)
            out[i, 1, k] = q + s1 + share * (z * s0 - x * s2)
            out[i, 2, k] = r + s2 + share * (x * s1 - y * s0)
    return True
