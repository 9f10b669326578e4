"""The residuals of a grasp with their derivatives, in loops: what ``Residuals`` does in NumPy.

``planner.synthesis.residuals`` and its row sources say what the rows are. Here a row has the
entries that can differ from zero, and no others: a tenth of all.
"""

from __future__ import annotations

import math

import numpy as np

from planner.numerics.kernels import loops_of_kernels
from planner.numerics.tape import run_tape, run_tape_on_lanes
from planner.spatial import FloatArray
from planner.synthesis.contact_wrenches import TINY
from planner.synthesis.link_capsules import PARALLEL, POINT_LENGTH
from planner.synthesis.loops.field import taylor_at
from planner.synthesis.loops.tables import ProblemTables, RunTables, Sources
from planner.synthesis.terms.clearance import FASTEST, FINGERS, OBJECT, OBSTACLE, TABLE
from planner.synthesis.terms.link_distance import LINKS, ROUNDING
from planner.synthesis.terms.resistance import RESISTANCE_WEIGHT

__all__ = ["evaluate"]

OBJECT_WEIGHT, TABLE_WEIGHT = OBJECT.weight, TABLE.weight
OBSTACLE_WEIGHT, FINGERS_WEIGHT = OBSTACLE.weight, FINGERS.weight
LINKS_WEIGHT = LINKS.weight


@loops_of_kernels
def evaluate(
    p: ProblemTables, run: RunTables, sources: Sources, x: FloatArray
) -> tuple[int, float]:
    """The rows at x (n,): how many, and the largest of those that must hold.

    What depends on x alone is kept where x is that of the last call.
    """
    same = run.kept[0] >= 0
    for k in range(len(x)):
        same = same and x[k] == run.kept_x[k]
    if not same:
        run.kept_x[:] = x
        look_up(p, run, x)
        run.least[:] = 0.0
        n, at = clearance_rows(p, run, x)
        worst = largest(run, 0, n)
        n, at, worst = written_rows(p, run, n, at, worst)
        run.kept[0], run.kept[1], run.kept_worst[0] = n, at, worst
    n, at, worst = run.kept[0], run.kept[1], run.kept_worst[0]
    begin = n
    n, at = link_rows(run, sources, x, n, at)
    worst = max(worst, largest(run, begin, n))
    n, at = resistance_rows(p, run, sources, x, n, at)
    return n, worst


@loops_of_kernels
def largest(run: RunTables, begin: int, end: int) -> float:
    """Largest absolute value of some rows."""
    out = 0.0
    for k in range(begin, end):
        out = max(out, abs(run.residuals[k]))
    return out


@loops_of_kernels
def look_up(p: ProblemTables, run: RunTables, x: FloatArray) -> None:
    """Run the program of the written terms and the kinematics at x."""
    run.work[: len(x)] = x
    if p.taylor_begin >= 0:
        found = np.empty(10)
        for i in range(len(p.normals_at)):
            point = x[p.point_begin + 3 * i : p.point_begin + 3 * i + 3]
            begin = p.taylor_begin + 13 * i
            taylor_at(run.field, point, 2, found)
            run.work[begin : begin + 3] = point
            run.work[begin + 3 : begin + 13] = found
    run_tape(p.program, run.work)


@loops_of_kernels
def written_rows(
    p: ProblemTables, run: RunTables, n: int, at: int, worst: float
) -> tuple[int, int, float]:
    """Append the written rows that count."""
    begin = 0
    for k in range(len(p.values_at)):
        value, end = run.work[p.values_at[k]], p.entry_ends[k]
        if p.both[k] or value < 0.0:
            for j in range(begin, end):
                run.columns[at] = p.entry_columns[j]
                run.entries[at] = run.work[p.entries_at[j]]
                at += 1
            run.residuals[n], run.row_ends[n] = value, at
            n += 1
            if k < p.n_required:
                worst = max(worst, abs(value))
        begin = end
    return n, at, worst


@loops_of_kernels
def clearance_rows(p: ProblemTables, run: RunTables, x: FloatArray) -> tuple[int, int]:
    """Append the violated clearances: how many rows there are, and entries."""
    joints, twists = np.empty(p.joints_at.shape), np.empty(p.twists_at.shape)
    for j in range(len(joints)):
        for i in range(12):
            joints[j, i] = run.work[p.joints_at[j, i]]
    for j in range(len(twists)):
        for i in range(6):
            twists[j, i] = run.work[p.twists_at[j, i]]
    rotation, rates = np.empty((3, 3)), np.empty((3, 3))
    for i in range(9):
        rotation[i // 3, i % 3] = run.work[p.rotation_at[i]]
    turn_rates(x, rates)
    n_spheres, n_hull = len(p.sphere_joint), len(p.hull_joint)
    local, placed = np.empty((n_spheres, 3)), np.empty((n_spheres, 3))
    for k in range(n_spheres):
        place(p, run, joints, rotation, x, p.sphere_joint[k], p.sphere_point[k], local[k], placed[k])
    n, at = 0, 0
    slope = np.empty(3)
    if p.taylor_begin >= 0:
        found = np.empty(10)
        for k in range(n_spheres):
            far = 0.0
            for i in range(3):
                far += (placed[k, i] - run.seen[k, i]) ** 2
            if run.gaps[k] < FASTEST * math.sqrt(far):
                taylor_at(run.field, placed[k], 1, found)
                run.seen[k] = placed[k]
                run.gaps[k] = found[0] - run.reach[k]
                if run.gaps[k] < 0.0:
                    run.least[0] = min(run.least[0], run.gaps[k])
                    slope[:] = found[1:4]
                    point_row(
                        p, run, rotation, rates, twists, p.sphere_joint[k], local[k], slope,
                        OBJECT_WEIGHT, n, at,
                    )  # fmt: skip
                    run.residuals[n] = OBJECT_WEIGHT * run.gaps[k]
                    at = run.row_ends[n]
                    n += 1
    else:
        for i in range(3):
            run.lanes[p.clearance_point + i] = placed[:, i]
        run_tape_on_lanes(p.clearance, run.lanes)
        for k in range(n_spheres):
            gap = run.lanes[p.clearance_at[0], k] - run.reach[k]
            if gap < 0.0:
                run.least[0] = min(run.least[0], gap)
                for i in range(3):
                    slope[i] = run.lanes[p.clearance_at[1 + i], k]
                point_row(
                    p, run, rotation, rates, twists, p.sphere_joint[k], local[k], slope,
                    OBJECT_WEIGHT, n, at,
                )  # fmt: skip
                run.residuals[n] = OBJECT_WEIGHT * gap
                at = run.row_ends[n]
                n += 1
    point, over = np.empty(3), np.empty(3)
    for k in range(n_hull):
        place(p, run, joints, rotation, x, p.hull_joint[k], p.hull_point[k], point, over)
        gap = dot(run.normal, over) - run.height[k]
        if gap < 0.0:
            run.least[1] = min(run.least[1], gap)
            point_row(
                p, run, rotation, rates, twists, p.hull_joint[k], point, run.normal, TABLE_WEIGHT,
                n, at,
            )  # fmt: skip
            run.residuals[n] = TABLE_WEIGHT * gap
            at = run.row_ends[n]
            n += 1
    for box in range(len(run.box_lanes)):
        lanes = run.box_lanes[box]
        for i in range(3):
            lanes[p.box_point + i] = placed[:, i]
        run_tape_on_lanes(p.box, lanes)
        for k in range(n_spheres):
            gap = lanes[p.box_at[0], k] - run.obstacle_reach[k]
            if gap < 0.0:
                run.least[2] = min(run.least[2], gap)
                for i in range(3):
                    slope[i] = lanes[p.box_at[1 + i], k]
                point_row(
                    p, run, rotation, rates, twists, p.sphere_joint[k], local[k], slope,
                    OBSTACLE_WEIGHT, n, at,
                )  # fmt: skip
                run.residuals[n] = OBSTACLE_WEIGHT * gap
                at = run.row_ends[n]
                n += 1
    return finger_rows(p, run, joints, twists, n, at)


@loops_of_kernels
def finger_rows(
    p: ProblemTables, run: RunTables, joints: FloatArray, twists: FloatArray, n: int, at: int
) -> tuple[int, int]:
    """Append the pairs of capsules that are too near."""
    k_capsules = len(p.capsule_joint)
    inner, outer = np.empty((k_capsules, 3)), np.empty((k_capsules, 3))
    for k in range(k_capsules):
        move(joints[p.capsule_joint[k]], p.capsule_inner[k], inner[k])
        move(joints[p.capsule_joint[k]], p.capsule_outer[k], outer[k])
    end, foot, twice, moment = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    dense = np.empty(len(twists))
    for k in range(len(p.pairs)):
        one, two = p.pairs[k, 0], p.pairs[k, 1]
        nearest(inner[one], outer[one], inner[two], outer[two], end, foot)
        room = -run.apart[k]
        for i in range(3):
            room += (foot[i] - end[i]) ** 2
            twice[i] = 2.0 * (end[i] - foot[i])
        if room < 0.0:
            run.least[3] = min(run.least[3], room)
            dense[:] = 0.0
            for side in range(2):
                cross(end if side == 0 else foot, twice, moment)
                joint = p.capsule_joint[one if side == 0 else two]
                begin = p.chain_ends[joint - 1] if joint > 0 else 0
                for c in range(begin, p.chain_ends[joint]):
                    j = p.chains[c]
                    rate = dot(twists[j, :3], twice) + dot(twists[j, 3:], moment)
                    dense[j] += rate if side == 0 else -rate
            for j in range(len(dense)):
                if dense[j] != 0.0:
                    run.columns[at], run.entries[at] = 6 + j, FINGERS_WEIGHT * dense[j]
                    at += 1
            run.residuals[n], run.row_ends[n] = FINGERS_WEIGHT * room, at
            n += 1
    return n, at


@loops_of_kernels
def link_rows(
    run: RunTables, sources: Sources, x: FloatArray, n: int, at: int
) -> tuple[int, int]:
    """Append the linearised distances of true links that are too small."""
    run.least[4] = 0.0
    for k in range(len(sources.link_values)):
        value = sources.link_values[k]
        for j in range(len(x)):
            value += sources.link_rows[k, j] * (x[j] - sources.link_x[j])
        if value < -ROUNDING:
            run.least[4] = min(run.least[4], value)
            for j in range(len(x)):
                if sources.link_rows[k, j] != 0.0:
                    run.columns[at] = j
                    run.entries[at] = LINKS_WEIGHT * sources.link_rows[k, j]
                    at += 1
            run.residuals[n], run.row_ends[n] = LINKS_WEIGHT * value, at
            n += 1
    return n, at


@loops_of_kernels
def resistance_rows(
    p: ProblemTables, run: RunTables, sources: Sources, x: FloatArray, n: int, at: int
) -> tuple[int, int]:
    """Append the directions of wrench in which resistance falls short of its target."""
    g, t, normal, cg, z = np.empty(3), np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    w, slope = np.empty(3), np.empty(3)
    for k in range(len(sources.directions)):
        u = sources.directions[k]
        best, highest = -1, -math.inf
        for i in range(len(p.normals_at)):
            # force of the wrench at the contact, along its normal, and across it
            pressed, across = part(p, run, u, x, i, g, t, normal)
            if pressed + run.mu * across > highest:
                best, highest = i, pressed + run.mu * across
        size = 0.0
        for i in range(6):
            size += u[i] * u[i]
        value = highest - sources.target * math.sqrt(size)
        if value < 0.0:
            pressed, across = part(p, run, u, x, best, g, t, normal)
            c = 1.0 + run.mu / across * dot(t, normal)
            for i in range(3):
                along = run.mu / across * t[i]
                cg[i] = c * g[i]
                w[i], z[i] = along - c * normal[i], pressed * along - cg[i]
            cross(w, u[3:], slope)
            for j in range(3):
                slope[j] /= run.length
                for i in range(3):
                    slope[j] += z[i] * run.work[p.slopes_at[best, i, j]]
                run.columns[at] = p.point_begin + 3 * best + j
                run.entries[at] = RESISTANCE_WEIGHT * slope[j]
                at += 1
            run.residuals[n], run.row_ends[n] = RESISTANCE_WEIGHT * value, at
            n += 1
    return n, at


@loops_of_kernels
def part(
    p: ProblemTables,
    run: RunTables,
    u: FloatArray,
    x: FloatArray,
    contact: int,
    g: FloatArray,
    t: FloatArray,
    normal: FloatArray,
) -> tuple[float, float]:
    """A wrench's part at a contact: g, t and the normal (3,) each; its sizes along and across."""
    b = p.point_begin + 3 * contact
    g[0] = u[0] + (u[4] * x[b + 2] - u[5] * x[b + 1]) / run.length
    g[1] = u[1] + (u[5] * x[b] - u[3] * x[b + 2]) / run.length
    g[2] = u[2] + (u[3] * x[b + 1] - u[4] * x[b]) / run.length
    for i in range(3):
        normal[i] = run.work[p.normals_at[contact, i]]
    pressed = -dot(g, normal)
    for i in range(3):
        t[i] = g[i] + pressed * normal[i]
    return pressed, math.sqrt(dot(t, t) + TINY)


@loops_of_kernels
def point_row(
    p: ProblemTables,
    run: RunTables,
    rotation: FloatArray,
    rates: FloatArray,
    twists: FloatArray,
    joint: int,
    local: FloatArray,
    direction: FloatArray,
    weight: float,
    n: int,
    at: int,
) -> None:
    """Write the derivatives of a point that moves with a joint along a direction, as row n.

    See ``planner.synthesis.terms.hand_points``.
    """
    along, moment = np.empty(3), np.empty(3)
    frame = rotation if p.carried[joint] else run.root
    for i in range(3):
        along[i] = (
            direction[0] * frame[0, i] + direction[1] * frame[1, i] + direction[2] * frame[2, i]
        )
    cross(local, along, moment)
    if p.carried[joint]:
        for i in range(3):
            run.columns[at + i], run.columns[at + 3 + i] = i, 3 + i
            run.entries[at + i] = weight * (
                moment[0] * rates[0, i] + moment[1] * rates[1, i] + moment[2] * rates[2, i]
            )
            run.entries[at + 3 + i] = weight * direction[i]
        at += 6
    begin = p.chain_ends[joint - 1] if joint > 0 else 0
    for c in range(begin, p.chain_ends[joint]):
        j = p.chains[c]
        run.columns[at] = 6 + j
        run.entries[at] = weight * (dot(twists[j, :3], along) + dot(twists[j, 3:], moment))
        at += 1
    run.row_ends[n] = at


@loops_of_kernels
def place(
    p: ProblemTables,
    run: RunTables,
    joints: FloatArray,
    rotation: FloatArray,
    x: FloatArray,
    joint: int,
    point: FloatArray,
    local: FloatArray,
    placed: FloatArray,
) -> None:
    """A point fixed to a joint, in the base (or an arm's last link) and in the object's frame."""
    move(joints[joint], point, local)
    frame, origin = rotation, x[3:6]
    if not p.carried[joint]:
        frame, origin = run.root, run.root_origin
    for i in range(3):
        placed[i] = (
            frame[i, 0] * local[0] + frame[i, 1] * local[1] + frame[i, 2] * local[2] + origin[i]
        )


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
    p1: FloatArray,
    q1: FloatArray,
    p2: FloatArray,
    q2: FloatArray,
    one: FloatArray,
    other: FloatArray,
) -> None:
    """Nearest points (3,) of two segments, as ``closest_on_segments``."""
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
        one[i], other[i] = p1[i] + s * (q1[i] - p1[i]), p2[i] + t * (q2[i] - p2[i])


@loops_of_kernels
def share(value: float) -> float:
    """A value cut to 0 to 1."""
    return min(max(value, 0.0), 1.0)


@loops_of_kernels
def dot(a: FloatArray, b: FloatArray) -> float:
    """Of two columns (3,)."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@loops_of_kernels
def cross(a: FloatArray, b: FloatArray, out: FloatArray) -> None:
    """Of two columns (3,)."""
    out[0] = a[1] * b[2] - a[2] * b[1]
    out[1] = a[2] * b[0] - a[0] * b[2]
    out[2] = a[0] * b[1] - a[1] * b[0]
