"""Kernels of ``planner.collision.link_bounds``: where forms are, and how far apart at least.

A form is a body (a box, a cylinder, an ellipsoid, the inside of planes) with a capsule around it,
or a capsule alone. The distance of a capsule's axis from a body is a convex function along the
axis: halving finds its least value.
"""

from __future__ import annotations

import numpy as np

from planner.numerics.kernels import kernel
from planner.spatial import FloatArray, IntArray

__all__ = [
    "BOX",
    "CAPSULE",
    "CYLINDER",
    "ELLIPSOID",
    "HULL",
    "bound_pairs",
    "place_forms",
]

CAPSULE, BOX, CYLINDER, ELLIPSOID, HULL = range(5)
"""Forms of bodies: half extents in ``sizes``, symmetry axes along z; or planes about a solid."""

HALVINGS = 8
"""Halvings of a capsule's axis in search of its point nearest to a body: a bound is less than the
distance by a 500th of the axis's length at most."""

ROUNDING = 1e-5
"""By how much (m) bounds are lowered: coal's accuracy, and more than rounding."""

PARALLEL = 1e-12
"""Squared sine (-) of the angle between two axes up to which they count as parallel."""


def _place_plain(
    q: FloatArray,
    parents: IntArray,
    joints: FloatArray,
    axes: FloatArray,
    carriers: IntArray,
    bodies: FloatArray,
) -> FloatArray:
    """``place_forms`` in NumPy, for all configurations at once."""
    n = len(q)
    turns, shifts = np.empty((len(parents), n, 3, 3)), np.empty((len(parents), n, 3))
    turns[0], shifts[0] = np.eye(3), 0.0
    for j in range(1, len(parents)):
        p, value = parents[j], q[:, j - 1]
        here = turns[p] @ joints[j, :, :3]
        x, y, z = axes[j, 3:]
        across = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        sine, versine = np.sin(value)[:, None, None], (1.0 - np.cos(value))[:, None, None]
        turns[j] = here @ (np.eye(3) + sine * across + versine * (across @ across))
        shifts[j] = shifts[p] + turns[p] @ joints[j, :, 3]
        shifts[j] += value[:, None] * (here @ axes[j, :3])
    out = np.empty((n, len(carriers), 3, 4))
    for i, carrier in enumerate(carriers):
        out[:, i, :, :3] = turns[carrier] @ bodies[i, :, :3]
        out[:, i, :, 3] = shifts[carrier] + turns[carrier] @ bodies[i, :, 3]
    return out


@kernel(_place_plain)
def place_forms(
    q: FloatArray,
    parents: IntArray,
    joints: FloatArray,
    axes: FloatArray,
    carriers: IntArray,
    bodies: FloatArray,
) -> FloatArray:
    """Poses (b, n, 3, 4) of bodies, [rotation, position], in the base.

    Args:
        q: Configurations (b, nq).
        parents: Parent (nj,) of each joint; 0 is the base.
        joints: Poses (nj, 3, 4) of joints in their parents at 0.
        axes: (nj, 6), see ``joint_axes``.
        carriers: Joint (n,) that each body moves with.
        bodies: Poses (n, 3, 4) in its frame.
    """
    nj, n = len(parents), len(carriers)
    pose, spin = np.zeros((nj, 3, 4)), np.empty((3, 3))
    for a in range(3):
        pose[0, a, a] = 1.0
    out = np.empty((len(q), n, 3, 4))
    for b in range(len(q)):
        for j in range(1, nj):
            p, value = parents[j], q[b, j - 1]
            x, y, z = axes[j, 3], axes[j, 4], axes[j, 5]
            sine, versine = np.sin(value), 1.0 - np.cos(value)
            spin[0, 0] = 1.0 - versine * (y * y + z * z)
            spin[1, 1] = 1.0 - versine * (x * x + z * z)
            spin[2, 2] = 1.0 - versine * (x * x + y * y)
            spin[0, 1], spin[1, 0] = versine * x * y - sine * z, versine * x * y + sine * z
            spin[0, 2], spin[2, 0] = versine * x * z + sine * y, versine * x * z - sine * y
            spin[1, 2], spin[2, 1] = versine * y * z - sine * x, versine * y * z + sine * x
            for r in range(3):
                pose[j, r, 3] = pose[p, r, 3]
                for c in range(3):
                    pose[j, r, 3] += pose[p, r, c] * joints[j, c, 3]
                h0 = h1 = h2 = 0.0
                for c in range(3):
                    h0 += pose[p, r, c] * joints[j, c, 0]
                    h1 += pose[p, r, c] * joints[j, c, 1]
                    h2 += pose[p, r, c] * joints[j, c, 2]
                along = h0 * axes[j, 0] + h1 * axes[j, 1] + h2 * axes[j, 2]
                pose[j, r, 3] += value * along
                for c in range(3):
                    pose[j, r, c] = h0 * spin[0, c] + h1 * spin[1, c] + h2 * spin[2, c]
        for i in range(n):
            k = carriers[i]
            for r in range(3):
                for c in range(4):
                    total = pose[k, r, 3] if c == 3 else 0.0
                    for m in range(3):
                        total += pose[k, r, m] * bodies[i, m, c]
                    out[b, i, r, c] = total
    return out


def _bound_plain(
    poses: FloatArray,
    kinds: IntArray,
    sizes: FloatArray,
    capsules: FloatArray,
    along: IntArray,
    planes: FloatArray,
    pairs: IntArray,
    limits: FloatArray,
) -> FloatArray:
    """``bound_pairs`` in NumPy, for all pairs at once."""
    first, second = pairs[:, 0], pairs[:, 1]
    axes = np.take_along_axis(poses[..., :3], along[None, :, None, None], axis=3)[..., 0]
    centers, halves, radii = poses[..., 3], capsules[:, 0], capsules[:, 1]
    c1, c2 = centers[:, first], centers[:, second]
    reach = halves + radii
    far = np.linalg.norm(c1 - c2, axis=2) - reach[first] - reach[second]
    near = np.full(far.shape, -np.inf)
    both = (kinds[first] == CAPSULE) & (kinds[second] == CAPSULE)
    u1, u2, h1, h2 = axes[:, first], axes[:, second], halves[first], halves[second]
    r = c1 - c2
    b, d, e = ((x * y).sum(axis=2) for x, y in ((u1, u2), (u1, r), (u2, r)))
    sine = 1.0 - b * b
    s = np.where(sine > PARALLEL, (b * e - d) / np.where(sine > PARALLEL, sine, 1.0), 0.0)
    s = np.clip(s, -h1, h1)
    t = np.clip(b * s + e, -h2, h2)
    s = np.clip(b * t - d, -h1, h1)
    t = np.clip(b * s + e, -h2, h2)
    apart = np.linalg.norm(r + s[..., None] * u1 - t[..., None] * u2, axis=2)
    near = np.where(both, apart - radii[first] - radii[second], near)
    for body, other in ((first, second), (second, first)):
        turn = poses[:, body, :, :3]
        middle = np.einsum("bkij,bki->bkj", turn, centers[:, other] - centers[:, body])
        axis = np.einsum("bkij,bki->bkj", turn, axes[:, other])
        half, size, kind = halves[other], sizes[body], kinds[body]
        low, high = (
            np.broadcast_to(-half, far.shape).copy(),
            np.broadcast_to(half, far.shape).copy(),
        )
        ends = [
            _distance_and_slope(middle + x[..., None] * axis, axis, kind, size) for x in (low, high)
        ]
        for _ in range(HALVINGS):
            mean = 0.5 * (low + high)
            falls = _distance_and_slope(middle + mean[..., None] * axis, axis, kind, size)[1] < 0.0
            low, high = np.where(falls, mean, low), np.where(falls, high, mean)
        mean = 0.5 * (low + high)
        inner = _distance_and_slope(middle + mean[..., None] * axis, axis, kind, size)[0]
        inner = inner - 0.5 * (high - low)
        least = np.where(
            ends[0][1] >= 0.0, ends[0][0], np.where(ends[1][1] <= 0.0, ends[1][0], inner)
        )
        sides = (
            middle @ planes[:, :3].T + planes[:, 3] - np.abs(axis @ planes[:, :3].T) * half[:, None]
        )
        least = np.where(kind == HULL, sides.max(axis=2, initial=-np.inf), least)
        near = np.where(kind != CAPSULE, np.maximum(near, least - radii[other]), near)
    return np.asarray(np.where(far - ROUNDING >= limits[:, None], far, near) - ROUNDING)


def _distance_and_slope(
    x: FloatArray, axis: FloatArray, kind: IntArray, size: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Of points (b, k, 3) in frames of bodies: the bound, and the sign of its slope on an axis."""
    box = x - np.clip(x, -size, size)
    radial = np.hypot(x[..., 0], x[..., 1])
    share = np.maximum(radial - size[:, 0], 0.0) / np.where(radial > 0.0, radial, 1.0)
    round_off = np.concatenate([x[..., :2] * share[..., None], box[..., 2:]], axis=-1)
    off = np.where((kind == CYLINDER)[:, None], round_off, box)
    squares = np.where(size > 0.0, size, 1.0) ** 2
    level = np.sqrt((x * x / squares).sum(axis=-1))
    apart = np.where(
        kind == ELLIPSOID, (level - 1.0) * size.min(axis=1), np.linalg.norm(off, axis=-1)
    )
    uphill = np.where((kind == ELLIPSOID)[:, None], x / squares, off)
    return apart, (uphill * axis).sum(axis=-1)


@kernel(_bound_plain)
def bound_pairs(
    poses: FloatArray,
    kinds: IntArray,
    sizes: FloatArray,
    capsules: FloatArray,
    along: IntArray,
    planes: FloatArray,
    pairs: IntArray,
    limits: FloatArray,
) -> FloatArray:
    """Lower bounds (b, k) of the distances of pairs, m; rough ones from a limit on.

    Args:
        poses: Of bodies (b, n, 3, 4).
        kinds: (n,), forms of the bodies.
        sizes: (n, 3), their half extents, m.
        capsules: (n, 2), half length of the axis and radius of the capsule around each, m.
        along: (n,), which axis of its body the capsule's is.
        planes: (m, 4), normal and offset of planes about the solid of form ``HULL``, m.
        pairs: (k, 2).
        limits: (b,), m.
    """
    n_pairs = len(pairs)
    out, x, u = np.empty((len(poses), n_pairs)), np.empty(3), np.empty(3)
    r, u1, u2 = np.empty(3), np.empty(3), np.empty(3)
    for b in range(len(poses)):
        for k in range(n_pairs):
            i, j = pairs[k, 0], pairs[k, 1]
            square = 0.0
            for a in range(3):
                r[a] = poses[b, i, a, 3] - poses[b, j, a, 3]
                square += r[a] * r[a]
            h1, h2 = capsules[i, 0], capsules[j, 0]
            far = np.sqrt(square) - h1 - capsules[i, 1] - h2 - capsules[j, 1] - ROUNDING
            if far >= limits[b]:
                out[b, k] = far
                continue
            near = -np.inf
            if kinds[i] == CAPSULE and kinds[j] == CAPSULE:
                cosine = d = e = 0.0
                for a in range(3):
                    u1[a], u2[a] = poses[b, i, a, along[i]], poses[b, j, a, along[j]]
                    cosine += u1[a] * u2[a]
                    d += u1[a] * r[a]
                    e += u2[a] * r[a]
                sine = 1.0 - cosine * cosine
                s = (cosine * e - d) / sine if sine > PARALLEL else 0.0
                s = min(max(s, -h1), h1)
                t = min(max(cosine * s + e, -h2), h2)
                s = min(max(cosine * t - d, -h1), h1)
                t = min(max(cosine * s + e, -h2), h2)
                square = 0.0
                for a in range(3):
                    apart = r[a] + s * u1[a] - t * u2[a]
                    square += apart * apart
                near = np.sqrt(square) - capsules[i, 1] - capsules[j, 1]
            for turn in range(2):
                body, other = (i, j) if turn == 0 else (j, i)
                kind = kinds[body]
                if kind == CAPSULE:
                    continue
                flip = -1.0 if turn == 0 else 1.0
                sx, sy, sz = sizes[body, 0], sizes[body, 1], sizes[body, 2]
                shortest = min(sx, sy, sz)
                for a in range(3):
                    x[a] = u[a] = 0.0
                    for m in range(3):
                        x[a] += poses[b, body, m, a] * flip * r[m]
                        u[a] += poses[b, body, m, a] * poses[b, other, m, along[other]]
                if kind == HULL:
                    for m in range(len(planes)):
                        height = planes[m, 3]
                        slope = 0.0
                        for a in range(3):
                            height += planes[m, a] * x[a]
                            slope += planes[m, a] * u[a]
                        height -= abs(slope) * capsules[other, 0] + capsules[other, 1]
                        near = max(near, height)
                    continue
                low, high, apart = -capsules[other, 0], capsules[other, 0], 0.0
                for step in range(HALVINGS + 3):
                    if step == 0:
                        at = low
                    elif step == 1:
                        at = high
                    else:
                        at = 0.5 * (low + high)
                    px, py, pz = x[0] + at * u[0], x[1] + at * u[1], x[2] + at * u[2]
                    if kind == ELLIPSOID:
                        gx, gy, gz = px / (sx * sx), py / (sy * sy), pz / (sz * sz)
                        apart = (np.sqrt(px * gx + py * gy + pz * gz) - 1.0) * shortest
                    else:
                        gz = pz - min(max(pz, -sz), sz)
                        if kind == CYLINDER:
                            radial = np.sqrt(px * px + py * py)
                            share = max(radial - sx, 0.0) / radial if radial > 0.0 else 0.0
                            gx, gy = px * share, py * share
                        else:
                            gx = px - min(max(px, -sx), sx)
                            gy = py - min(max(py, -sy), sy)
                        apart = np.sqrt(gx * gx + gy * gy + gz * gz)
                    slope = gx * u[0] + gy * u[1] + gz * u[2]
                    if step == 0:
                        if slope >= 0.0:
                            break
                    elif step == 1:
                        if slope <= 0.0:
                            break
                    elif step == HALVINGS + 2:
                        apart -= 0.5 * (high - low)
                    elif slope < 0.0:
                        low = at
                    else:
                        high = at
                near = max(near, apart - capsules[other, 1])
            out[b, k] = near - ROUNDING
    return out
