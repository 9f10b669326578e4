"""``read_pads``: what ideal tactile pads would feel in a simulation, from MuJoCo's contacts.

Exact: ``sim.controllers.sensing`` adds what a sensor does not know. Everything belongs to the
beginning of the step that ended, like all contacts of MuJoCo.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from planner.numerics.kernels import kernel
from planner.spatial import FloatArray, IntArray
from sim.contacts import NO_FORCE
from sim.controllers.pads import PadReading
from sim.scene import Scene

__all__ = ["read_pads"]

MIN_LENGTH = 1e-12
"""Least length (-) of a mean of normals that is divided by: a finger that pinches the object by
itself can have none."""


def read_pads(scene: Scene, data: Any, fingers: tuple[str, ...]) -> PadReading:
    """What the pads of some fingers feel after a step."""
    n, model, contact = len(fingers), scene.model, data.contact
    # per finger: normal force; force; and, times normal force, place, normal, sliding and spin
    table = np.zeros((n, 14))
    if data.ncon:
        pad_sums(
            contact.geom,
            contact.efc_address,
            contact.dim,
            contact.pos,
            contact.frame,
            data.efc_force,
            scene.place_of_geom(fingers),
            model.geom_bodyid,
            scene.object_body,
            model.body_rootid,
            data.cvel,
            data.xpos,
            data.subtree_com,
            table,
        )
    normal_force = table[:, 0].copy()
    pressing = normal_force > 0
    weight = np.where(pressing, normal_force, np.nan)[:, None]
    force, position, normal, sliding = table[:, 1:13].reshape(n, 4, 3).transpose(1, 0, 2)
    normal = normal / weight
    length = np.sqrt((normal * normal).sum(axis=1, keepdims=True))
    return PadReading(
        normal_force=normal_force,
        force=force,
        position=position / weight,
        normal=normal / np.maximum(length, MIN_LENGTH),
        sliding=sliding / weight,
        spin=np.where(pressing, table[:, 13] / np.where(pressing, normal_force, 1.0), 0.0),
    )


def _pad_sums_plain(
    geoms: IntArray,
    address: IntArray,
    dims: IntArray,
    positions: FloatArray,
    frames: FloatArray,
    efc_force: FloatArray,
    place: IntArray,
    body_of_geom: IntArray,
    object_body: int,
    root: IntArray,
    cvel: FloatArray,
    xpos: FloatArray,
    subtree_com: FloatArray,
    table: FloatArray,
) -> None:
    """``pad_sums`` in NumPy."""
    bodies, places = body_of_geom[geoms], place[geoms]
    turned = (bodies[:, 0] == object_body) & (places[:, 1] >= 0)
    counts = turned | ((bodies[:, 1] == object_body) & (places[:, 0] >= 0))
    counts &= address >= 0
    counts[counts] = efc_force[address[counts]] > NO_FORCE
    i = np.flatnonzero(counts)
    side, sign = turned[i].astype(int), np.where(turned[i], -1.0, 1.0)[:, None]
    part = np.minimum(address[i, None] + np.arange(3), len(efc_force) - 1)
    load = np.where(np.arange(3) < dims[i, None], efc_force[part], 0.0)
    twist = np.zeros(6)
    for body, way in ((np.full(len(i), object_body), 1.0), (bodies[i, side], -1.0)):
        omega, at = cvel[body, :3], xpos[body]
        # of the body's frame, then of its point at the world's origin
        linear = cvel[body, 3:] - np.cross(at - subtree_com[root[body]], omega)
        twist = twist + way * np.hstack([omega, linear - np.cross(omega, at)])
    axes, at, press = frames[i].reshape(-1, 3, 3), positions[i], load[:, :1]
    slip = twist[:, 3:] + np.cross(twist[:, :3], at)
    across = (slip * axes[:, 0]).sum(axis=1, keepdims=True)
    spin = (twist[:, :3] * axes[:, 0]).sum(axis=1, keepdims=True)
    force = np.einsum("ni,nij->nj", load, axes)
    weighted = [at, sign * axes[:, 0], slip - across * axes[:, 0], sign * spin]
    np.add.at(table, places[i, side], np.hstack([press, sign * force, press * np.hstack(weighted)]))


@kernel(_pad_sums_plain)
def pad_sums(
    geoms: IntArray,
    address: IntArray,
    dims: IntArray,
    positions: FloatArray,
    frames: FloatArray,
    efc_force: FloatArray,
    place: IntArray,
    body_of_geom: IntArray,
    object_body: int,
    root: IntArray,
    cvel: FloatArray,
    xpos: FloatArray,
    subtree_com: FloatArray,
    table: FloatArray,
) -> None:
    """Add up the contacts of hand and object per finger, as MuJoCo has them after a step.

    Args:
        geoms: (K, 2), of each contact.
        address: (K,), where its force begins in ``efc_force``; negative without a force.
        dims: (K,), components of the force.
        positions: (K, 3), m, world.
        frames: (K, 9), axes in rows, from geom 1 to geom 2.
        efc_force: Constraint forces, N.
        place: (ngeom,), which row a geom of a finger adds to, negative for other geoms.
        body_of_geom: (ngeom,).
        object_body: Body id of the object.
        root: (nbody,), root of each body's tree.
        cvel: (nbody, 6), velocities about the trees' centres of mass.
        xpos: (nbody, 3), m.
        subtree_com: (nbody, 3), m.
        table: (n, 14), added to: normal force, force; and times the normal force place, normal,
            sliding velocity of the object over the pad, and spin.
    """
    twists = np.zeros((2, 6))
    for i in range(geoms.shape[0]):
        one, two = geoms[i, 0], geoms[i, 1]
        if body_of_geom[one] == object_body and place[two] >= 0:
            geom, sign = two, -1.0
        elif body_of_geom[two] == object_body and place[one] >= 0:
            geom, sign = one, 1.0
        else:
            continue
        start = address[i]
        if start < 0 or efc_force[start] <= 1e-6:  # NO_FORCE
            continue
        press, t1, t2 = efc_force[start], 0.0, 0.0
        if dims[i] >= 3:
            t1, t2 = efc_force[start + 1], efc_force[start + 2]
        for side in range(2):
            b = object_body if side == 0 else body_of_geom[geom]
            a0, a1, a2 = cvel[b, 0], cvel[b, 1], cvel[b, 2]
            com = root[b]
            d0 = xpos[b, 0] - subtree_com[com, 0]
            d1 = xpos[b, 1] - subtree_com[com, 1]
            d2 = xpos[b, 2] - subtree_com[com, 2]
            u = cvel[b, 3] - (d1 * a2 - d2 * a1)
            v = cvel[b, 4] - (d2 * a0 - d0 * a2)
            w = cvel[b, 5] - (d0 * a1 - d1 * a0)
            x, y, z = xpos[b, 0], xpos[b, 1], xpos[b, 2]
            twists[side, 0], twists[side, 1], twists[side, 2] = a0, a1, a2
            twists[side, 3] = u - a1 * z + a2 * y
            twists[side, 4] = v - a2 * x + a0 * z
            twists[side, 5] = w - a0 * y + a1 * x
        a, b1, c = (
            twists[0, 0] - twists[1, 0],
            twists[0, 1] - twists[1, 1],
            twists[0, 2] - twists[1, 2],
        )
        x, y, z = positions[i, 0], positions[i, 1], positions[i, 2]
        s0 = twists[0, 3] - twists[1, 3] + b1 * z - c * y
        s1 = twists[0, 4] - twists[1, 4] + c * x - a * z
        s2 = twists[0, 5] - twists[1, 5] + a * y - b1 * x
        across = s0 * frames[i, 0] + s1 * frames[i, 1] + s2 * frames[i, 2]
        slip, spin = (s0, s1, s2), (a, b1, c)
        k = place[geom]
        table[k, 0] += press
        for j in range(3):
            normal = frames[i, j]
            table[k, 1 + j] += sign * (
                press * normal + t1 * frames[i, 3 + j] + t2 * frames[i, 6 + j]
            )
            table[k, 4 + j] += press * positions[i, j]
            table[k, 7 + j] += press * sign * normal
            table[k, 10 + j] += press * (slip[j] - across * normal)
            table[k, 13] += press * sign * spin[j] * normal
