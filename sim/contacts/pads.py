"""``pad_means``: forces, places and sliding of contacts on an object, per finger.

``read_pads`` asks at every step of a closed loop. Loops and plain numbers give the same bits.

``read_pads``: what ideal tactile pads would feel in a simulation, from MuJoCo's contacts.

Exact: ``sim.tactile`` has senses that know less. Everything belongs to the beginning of the step
that ended, like all contacts of MuJoCo.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from planner.numerics.kernels import kernel, loops_of_kernels
from planner.spatial import FloatArray, IntArray
from sim.contacts.reading import NO_FORCE, load_of
from sim.controllers.pads import PadReading
from sim.scene import Scene

MIN_LENGTH = 1e-12
"""Least length (-) of a mean of normals that is divided by: a finger that pinches the object by
itself can have none."""


def _pad_means_plain(
    geoms: IntArray,
    places: FloatArray,
    frames: FloatArray,
    addresses: IntArray,
    dims: IntArray,
    friction: FloatArray,
    forces: FloatArray,
    pyramids: bool,
    velocities: FloatArray,
    origins: FloatArray,
    centers: FloatArray,
    finger: IntArray,
    is_object: NDArray[np.bool_],
    body_of: IntArray,
    root_of: IntArray,
    object_body: int,
    n: int,
) -> FloatArray:
    """``pad_means`` in plain numbers, which are cheaper than arrays of three, and in NumPy."""
    sums = [[0.0] * 14 for _ in range(n)]
    columns = (geoms, places, frames, addresses, dims, friction)
    rows = zip(*(column.tolist() for column in columns), strict=True)
    values = forces.tolist()
    relative: dict[int, list[float]] = {}
    for (first, second), at, frame, address, dim, mu in rows:
        if is_object[first]:
            geom, sign = second, -1.0
        elif is_object[second]:
            geom, sign = first, 1.0
        else:
            continue
        k = int(finger[geom])
        load = load_of(values, address, dim, mu, pyramids)
        if k < 0 or load[0] <= NO_FORCE:
            continue
        body = int(body_of[geom])
        if body not in relative:
            pair = [
                twist_of(velocities[b].tolist(), origins[b].tolist(), centers[root_of[b]].tolist())
                for b in (object_body, body)
            ]
            relative[body] = [p - q for p, q in zip(*pair, strict=True)]
        _add(sums[k], load, at, frame, sign, relative[body])
    table = np.array(sums).reshape(n, 14)
    pressing = table[:, 0] > 0
    weight = np.where(pressing, table[:, 0], np.nan)[:, None]
    spin = np.where(pressing, table[:, 13] / np.where(pressing, table[:, 0], 1.0), 0.0)
    table[:, 4:13] /= weight
    normal = table[:, 7:10]
    length = np.sqrt((normal * normal).sum(axis=1, keepdims=True))
    table[:, 7:10] = normal / np.maximum(length, MIN_LENGTH)
    table[:, 13] = spin
    return table


@loops_of_kernels
def _add(sums: Any, load: Any, at: Any, frame: Any, sign: float, twist: Any) -> None:
    """Add a contact to the sums of its finger.

    Args:
        sums: Normal force, force; then place, normal, sliding and spin times the normal force:
            written.
        load: Force in the contact's frame, N.
        at: Its place, m.
        frame: Its axes, one after the other.
        sign: 1 where the first axis points into the object, else -1.
        twist: Of the object relative to the finger's body: angular velocity, and velocity of the
            point at the world's origin.
    """
    press, t1, t2 = load[0], load[1], load[2]
    x, y, z = at[0], at[1], at[2]
    a, b, c, u, v, w = twist[0], twist[1], twist[2], twist[3], twist[4], twist[5]
    n0, n1, n2, p0, p1, p2 = frame[0], frame[1], frame[2], frame[3], frame[4], frame[5]
    q0, q1, q2 = frame[6], frame[7], frame[8]
    s0, s1, s2 = u + b * z - c * y, v + c * x - a * z, w + a * y - b * x
    across = s0 * n0 + s1 * n1 + s2 * n2
    inward = press * sign
    sums[0] += press
    sums[1] += sign * (press * n0 + t1 * p0 + t2 * q0)
    sums[2] += sign * (press * n1 + t1 * p1 + t2 * q1)
    sums[3] += sign * (press * n2 + t1 * p2 + t2 * q2)
    sums[4] += press * x
    sums[5] += press * y
    sums[6] += press * z
    sums[7] += inward * n0
    sums[8] += inward * n1
    sums[9] += inward * n2
    sums[10] += press * (s0 - across * n0)
    sums[11] += press * (s1 - across * n1)
    sums[12] += press * (s2 - across * n2)
    sums[13] += inward * a * n0
    sums[13] += inward * b * n1
    sums[13] += inward * c * n2


@loops_of_kernels
def twist_of(
    velocity: Any, origin: Any, center: Any
) -> tuple[float, float, float, float, float, float]:
    """Angular velocity, and velocity of the body's point at the world's origin; world axes.

    Args:
        velocity: (6,), MuJoCo's ``cvel``: about the centre of mass of the whole tree.
        origin: (3,), of the body.
        center: (3,), that centre of mass.
    """
    a, b, c, u, v, w = velocity[0], velocity[1], velocity[2], velocity[3], velocity[4], velocity[5]
    x, y, z = origin[0], origin[1], origin[2]
    x0, y0, z0 = x - center[0], y - center[1], z - center[2]
    u, v, w = u - (y0 * c - z0 * b), v - (z0 * a - x0 * c), w - (x0 * b - y0 * a)
    return a, b, c, u - b * z + c * y, v - c * x + a * z, w - a * y + b * x


@kernel(_pad_means_plain)
def pad_means(
    geoms: IntArray,
    places: FloatArray,
    frames: FloatArray,
    addresses: IntArray,
    dims: IntArray,
    friction: FloatArray,
    forces: FloatArray,
    pyramids: bool,
    velocities: FloatArray,
    origins: FloatArray,
    centers: FloatArray,
    finger: IntArray,
    is_object: NDArray[np.bool_],
    body_of: IntArray,
    root_of: IntArray,
    object_body: int,
    n: int,
) -> FloatArray:
    """Per finger (n, 14): normal force, force, place, unit normal, sliding, spin.

    The last four are means weighted by normal force; without contact they are NaN, and the spin 0.

    Args:
        geoms: (k, 2), geoms of each contact.
        places: (k, 3), m.
        frames: (k, 9), MuJoCo's.
        addresses: (k,), where their forces begin, negative for a contact without.
        dims: (k,).
        friction: (k, 5), MuJoCo's.
        forces: (nefc,), of MuJoCo's constraints.
        pyramids: Whether friction cones are pyramids.
        velocities: (nbody, 6), MuJoCo's ``cvel``.
        origins: (nbody, 3), of the bodies, m.
        centers: (nbody, 3), MuJoCo's ``subtree_com``.
        finger: (ngeom,), number of the finger, negative for what is no finger that takes part.
        is_object: (ngeom,).
        body_of: (ngeom,).
        root_of: (nbody,).
        object_body: Body of the object.
        n: Number of fingers.
    """
    sums = np.zeros((n, 14))
    relative = np.zeros(6)
    for i in range(len(geoms)):
        first, second = geoms[i, 0], geoms[i, 1]
        if is_object[first]:
            geom, sign = second, -1.0
        elif is_object[second]:
            geom, sign = first, 1.0
        else:
            continue
        k = finger[geom]
        load = load_of(forces, addresses[i], dims[i], friction[i], pyramids)
        if k < 0 or load[0] <= NO_FORCE:
            continue
        body = body_of[geom]
        mine = twist_of(velocities[body], origins[body], centers[root_of[body]])
        other = twist_of(
            velocities[object_body], origins[object_body], centers[root_of[object_body]]
        )
        for j in range(6):
            relative[j] = other[j] - mine[j]
        _add(sums[k], load, places[i], frames[i], sign, relative)
    for k in range(n):
        weight = sums[k, 0]
        if not weight > 0.0:
            sums[k, 4:13] = np.nan
            sums[k, 13] = 0.0
            continue
        for j in range(4, 14):
            sums[k, j] /= weight
        length = np.sqrt(
            sums[k, 7] * sums[k, 7] + sums[k, 8] * sums[k, 8] + sums[k, 9] * sums[k, 9]
        )
        for j in range(7, 10):
            sums[k, j] /= max(length, MIN_LENGTH)
    return sums


def read_pads(scene: Scene, data: Any, fingers: tuple[str, ...]) -> PadReading:
    """What the pads of some fingers feel after a step."""
    n, contact = len(fingers), data.contact
    if data.ncon == 0:
        return PadReading.nothing(n)
    # copies, whose memory is laid out alike however many contacts there are
    table = pad_means(
        contact.geom.copy(),
        contact.pos.copy(),
        contact.frame.copy(),
        contact.efc_address.copy(),
        contact.dim.copy(),
        contact.friction.copy(),
        data.efc_force.copy(),
        scene.pyramids,
        data.cvel,
        data.xpos,
        data.subtree_com,
        scene.finger_numbers(fingers),
        scene.is_object_geom,
        scene.model.geom_bodyid,
        scene.model.body_rootid,
        scene.object_body,
        n,
    )
    return PadReading(
        normal_force=table[:, 0].copy(),
        force=table[:, 1:4],
        position=table[:, 4:7],
        normal=table[:, 7:10],
        sliding=table[:, 10:13],
        spin=table[:, 13],
    )


def body_twist(scene: Scene, data: Any, body: int) -> list[float]:
    """Angular velocity, and velocity of the body's point at the world's origin; world axes.

    MuJoCo keeps velocities about the centre of mass of the whole tree.
    """
    root = scene.root_of_body[body]
    rows = (data.cvel[body], data.xpos[body], data.subtree_com[root])
    return list(twist_of(*(row.tolist() for row in rows)))
