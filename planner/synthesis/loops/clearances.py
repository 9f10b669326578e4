"""The violated clearances of a grasp with their derivatives, in loops: what ``Clearances`` does.

See ``planner.synthesis.terms.clearance`` and ``.hand_points`` for what the rows are.
"""

from __future__ import annotations

import math

import numpy as np

from planner.numerics.kernels import loops_of_kernels
from planner.numerics.tape import run_tape_on_lanes
from planner.spatial import FloatArray, IntArray
from planner.synthesis.link_capsules import PARALLEL, POINT_LENGTH
from planner.synthesis.loops.field import SplineTables, taylor_at
from planner.synthesis.loops.tables import (
    FINGERS_PLACE,
    OBJECT_PLACE,
    OBSTACLE_PLACE,
    TABLE_PLACE,
    Capsules,
    Clearance,
    Joints,
    ObjectRoom,
    Points,
    Rows,
    Surroundings,
)
from planner.synthesis.terms.clearance import FASTEST, FINGERS, OBJECT, OBSTACLE, TABLE

OBJECT_WEIGHT, TABLE_WEIGHT = OBJECT.weight, TABLE.weight
OBSTACLE_WEIGHT, FINGERS_WEIGHT = OBSTACLE.weight, FINGERS.weight


@loops_of_kernels
def clearance_rows(
    p: Joints,
    spheres: Points,
    hull: Points,
    capsules: Capsules,
    object_clearance: Clearance,
    obstacle_clearance: Clearance,
    room: ObjectRoom,
    around: Surroundings,
    rows: Rows,
    work: FloatArray,
    x: FloatArray,
    is_mesh: bool,
) -> tuple[int, int]:
    """Append the violated clearances: how many rows there are, and entries."""
    joints, twists = np.empty(p.joints_at.shape), np.empty(p.twists_at.shape)
    frames, rates, origins = np.empty((2, 3, 3)), np.empty((3, 3)), np.empty((2, 3))
    gather(work, p.joints_at, joints)
    gather(work, p.twists_at, twists)
    gather(work, p.rotation_at, frames[1])
    for i in range(3):
        origins[0, i], origins[1, i] = around.root_origin[i], x[3 + i]
        for j in range(3):
            frames[0, i, j] = around.root[i, j]
    turn_rates(x, rates)
    local, placed = np.empty(spheres.at.shape), np.empty(spheres.at.shape)
    slopes, gaps = np.empty(spheres.at.shape), np.empty(len(spheres.at))
    place(joints, p.carried, frames, origins, spheres, local, placed)
    n, at = 0, 0
    for obstacle in range(-1, len(around.lanes)):
        weight, term = OBJECT_WEIGHT, OBJECT_PLACE
        if obstacle >= 0:
            weight, term = OBSTACLE_WEIGHT, OBSTACLE_PLACE
            lanes = around.lanes[obstacle]
            on_lanes(obstacle_clearance, lanes, placed, around.reach, gaps, slopes)
        elif is_mesh:
            from_field(room.field, placed, room.reach, room.seen, room.known, gaps, slopes)
        else:
            on_lanes(object_clearance, room.lanes, placed, room.reach, gaps, slopes)
        n, at = point_rows(
            p, rows, twists, frames, rates, spheres.joint, local, gaps, slopes, weight, term, n, at
        )
    over, below = np.empty(hull.at.shape), np.empty(len(hull.at))
    above, up = np.empty(hull.at.shape), np.empty(hull.at.shape)
    place(joints, p.carried, frames, origins, hull, over, above)
    for k in range(len(below)):
        below[k] = dot(around.normal, above[k]) - around.height[k]
        for i in range(3):
            up[k, i] = around.normal[i]
    weight, term = TABLE_WEIGHT, TABLE_PLACE
    n, at = point_rows(
        p, rows, twists, frames, rates, hull.joint, over, below, up, weight, term, n, at
    )
    return finger_rows(p.chains, p.chain_ends, capsules, around.apart, rows, joints, twists, n, at)


@loops_of_kernels
def place(
    joints: FloatArray,
    carried: IntArray,
    frames: FloatArray,
    origins: FloatArray,
    points: Points,
    local: FloatArray,
    placed: FloatArray,
) -> None:
    """Points (k, 3) in the frame of base, flange or root, and in the object's frame."""
    for k in range(len(local)):
        joint = points.joint[k]
        move(joints[joint], points.at[k], local[k])
        f, o = frames[carried[joint]], origins[carried[joint]]
        for i in range(3):
            placed[k, i] = (
                f[i, 0] * local[k, 0] + f[i, 1] * local[k, 1] + f[i, 2] * local[k, 2] + o[i]
            )


@loops_of_kernels
def point_rows(
    p: Joints,
    rows: Rows,
    twists: FloatArray,
    frames: FloatArray,
    rates: FloatArray,
    joint_of: IntArray,
    local: FloatArray,
    gaps: FloatArray,
    slopes: FloatArray,
    weight: float,
    term: int,
    n: int,
    at: int,
) -> tuple[int, int]:
    """Append gaps (k,) below zero of points (k, 3) that move with joints, with slopes (k, 3).

    See ``planner.synthesis.terms.hand_points`` for the derivatives.
    """
    chains, ends, carried = p.chains, p.chain_ends, p.carried
    columns, entries, least = rows.columns, rows.entries, 0.0
    for k in range(len(gaps)):
        if gaps[k] >= 0.0:
            continue
        least = min(least, gaps[k])
        joint, d, b = joint_of[k], slopes[k], local[k]
        f = frames[carried[joint]]
        a0 = d[0] * f[0, 0] + d[1] * f[1, 0] + d[2] * f[2, 0]
        a1 = d[0] * f[0, 1] + d[1] * f[1, 1] + d[2] * f[2, 1]
        a2 = d[0] * f[0, 2] + d[1] * f[1, 2] + d[2] * f[2, 2]
        m0, m1, m2 = b[1] * a2 - b[2] * a1, b[2] * a0 - b[0] * a2, b[0] * a1 - b[1] * a0
        if carried[joint]:
            for i in range(3):
                columns[at + i], columns[at + 3 + i] = i, 3 + i
                entries[at + i] = weight * (m0 * rates[0, i] + m1 * rates[1, i] + m2 * rates[2, i])
                entries[at + 3 + i] = weight * d[i]
            at += 6
        for c in range(ends[joint], ends[joint + 1]):
            j = chains[c]
            rate = twists[j, 0] * a0 + twists[j, 1] * a1 + twists[j, 2] * a2
            rate += twists[j, 3] * m0 + twists[j, 4] * m1 + twists[j, 5] * m2
            columns[at], entries[at] = 6 + j, weight * rate
            at += 1
        rows.values[n], rows.ends[n] = weight * gaps[k], at
        n += 1
    rows.least[term] = min(rows.least[term], least)
    return n, at


@loops_of_kernels
def finger_rows(
    chains: IntArray,
    ends: IntArray,
    capsules: Capsules,
    apart: FloatArray,
    rows: Rows,
    joints: FloatArray,
    twists: FloatArray,
    n: int,
    at: int,
) -> tuple[int, int]:
    """Append the pairs of capsules that are too near."""
    joint_of, pairs = capsules.joint, capsules.pairs
    inner, outer = np.empty(capsules.inner.shape), np.empty(capsules.inner.shape)
    for k in range(len(joint_of)):
        move(joints[joint_of[k]], capsules.inner[k], inner[k])
        move(joints[joint_of[k]], capsules.outer[k], outer[k])
    foot, twice, moment = np.empty((2, 3)), np.empty(3), np.empty(3)
    dense = np.empty(len(twists))
    for k in range(len(pairs)):
        one, two = pairs[k, 0], pairs[k, 1]
        nearest(inner[one], outer[one], inner[two], outer[two], foot)
        room = -apart[k]
        for i in range(3):
            room += (foot[1, i] - foot[0, i]) ** 2
            twice[i] = 2.0 * (foot[0, i] - foot[1, i])
        if room >= 0.0:
            continue
        rows.least[FINGERS_PLACE] = min(rows.least[FINGERS_PLACE], room)
        for j in range(len(dense)):
            dense[j] = 0.0
        for side in range(2):
            cross(foot[side], twice, moment)
            joint = joint_of[pairs[k, side]]
            for c in range(ends[joint], ends[joint + 1]):
                j = chains[c]
                rate = dot(twists[j, :3], twice) + dot(twists[j, 3:], moment)
                dense[j] += rate if side == 0 else -rate
        for j in range(len(dense)):
            if dense[j] != 0.0:
                rows.columns[at], rows.entries[at] = 6 + j, FINGERS_WEIGHT * dense[j]
                at += 1
        rows.values[n], rows.ends[n] = FINGERS_WEIGHT * room, at
        n += 1
    return n, at


@loops_of_kernels
def on_lanes(
    clearance: Clearance,
    lanes: FloatArray,
    placed: FloatArray,
    reach: FloatArray,
    gaps: FloatArray,
    slopes: FloatArray,
) -> None:
    """Gaps (k,) and gradients (k, 3) at points (k, 3) by a program, a lane for each."""
    results = clearance.results
    for k in range(len(gaps)):
        for i in range(3):
            lanes[clearance.point + i, k] = placed[k, i]
    run_tape_on_lanes(clearance.program, lanes)
    for k in range(len(gaps)):
        gaps[k] = lanes[results[0], k] - reach[k]
        for i in range(3):
            slopes[k, i] = lanes[results[1 + i], k]


@loops_of_kernels
def from_field(
    field: SplineTables,
    placed: FloatArray,
    reach: FloatArray,
    seen: FloatArray,
    known: FloatArray,
    gaps: FloatArray,
    slopes: FloatArray,
) -> None:
    """The same from a mesh, of the spheres that may be near since they were last looked up.

    Where they were ``seen``, what is ``known`` of them; others are far.
    """
    found = np.empty(10)
    for k in range(len(gaps)):
        gaps[k] = 1.0
        far = 0.0
        for i in range(3):
            far += (placed[k, i] - seen[k, i]) ** 2
        if known[k] < FASTEST * math.sqrt(far):
            taylor_at(field, placed[k], 1, found)
            known[k] = gaps[k] = found[0] - reach[k]
            for i in range(3):
                seen[k, i] = placed[k, i]
                slopes[k, i] = found[1 + i]


@loops_of_kernels
def turn_rates(s: FloatArray, out: FloatArray) -> None:
    """``mrp_rates`` of s (3,) or more, into (3, 3)."""
    a, b, c = s[0], s[1], s[2]
    n = a * a + b * b + c * c
    d, k = 1 - n, 4 / (1 + n) ** 2
    out[0, 0], out[0, 1] = k * (d + 2 * a * a), k * (2 * (a * b + c))
    out[0, 2], out[1, 0] = k * (2 * (a * c - b)), k * (2 * (a * b - c))
    out[1, 1], out[1, 2] = k * (d + 2 * b * b), k * (2 * (b * c + a))
    out[2, 0], out[2, 1] = k * (2 * (a * c + b)), k * (2 * (b * c - a))
    out[2, 2] = k * (d + 2 * c * c)


@loops_of_kernels
def nearest(
    p1: FloatArray, q1: FloatArray, p2: FloatArray, q2: FloatArray, out: FloatArray
) -> None:
    """Nearest points (2, 3) of two segments, as ``closest_on_segments``."""
    a = b = c = e = f = 0.0
    for i in range(3):
        first, second, apart = q1[i] - p1[i], q2[i] - p2[i], p1[i] - p2[i]
        a += first * first
        b += first * second
        c += first * apart
        e += second * second
        f += second * apart
    a, e = max(a, POINT_LENGTH**2), max(e, POINT_LENGTH**2)
    s = share((b * f - c * e) / max(a * e - b * b, PARALLEL * a * e))
    t = share((b * s + f) / e)
    s = share((b * t - c) / a)
    for i in range(3):
        out[0, i], out[1, i] = p1[i] + s * (q1[i] - p1[i]), p2[i] + t * (q2[i] - p2[i])


@loops_of_kernels
def share(value: float) -> float:
    """A value cut to 0 to 1."""
    return min(max(value, 0.0), 1.0)


@loops_of_kernels
def gather(work: FloatArray, places: IntArray, out: FloatArray) -> None:
    """Entries of the work array at places (k, m)."""
    for k in range(len(out)):
        for i in range(out.shape[1]):
            out[k, i] = work[places[k, i]]


@loops_of_kernels
def move(joint: FloatArray, point: FloatArray, out: FloatArray) -> None:
    """A point fixed to a joint that is given by its rotation by rows and its origin (12,)."""
    for i in range(3):
        out[i] = (
            joint[3 * i] * point[0]
            + joint[3 * i + 1] * point[1]
            + joint[3 * i + 2] * point[2]
            + joint[9 + i]
        )


@loops_of_kernels
def dot(a: FloatArray, b: FloatArray) -> float:
    """Of two columns (3,)."""
    return float(a[0] * b[0] + a[1] * b[1] + a[2] * b[2])


@loops_of_kernels
def cross(a: FloatArray, b: FloatArray, out: FloatArray) -> None:
    """Of two columns (3,)."""
    out[0] = a[1] * b[2] - a[2] * b[1]
    out[1] = a[2] * b[0] - a[0] * b[2]
    out[2] = a[0] * b[1] - a[1] * b[0]
