"""Starts of motions on objects with faces: the opposer on one side, all others opposite to it.

``Seeder`` and ``TurningSeeder`` (``planner.synthesis``) draw starts; this puts contacts elsewhere.

Which side a finger is on is told by where the fingers are, not by where each pad faces nor by what
is nearest to it: a finger that looks to the side would be given to a neighbouring face, where
nothing opposes it. That was the case with two of five starts of the Shadow-type hand on a block.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from planner.kinematics.state import HandState
from planner.shapes import Mesh
from planner.spatial import FloatArray
from planner.synthesis.problem import Start
from planner.synthesis.seeds.draw import Seeder
from planner.system.threads import made_once

__all__ = ["on_opposed_sides"]

FACING = float(np.cos(np.deg2rad(45.0)))
"""Least cosine between the normal of a side and the line across: less belongs to a neighbour."""

SAMPLES = 3000
"""Points of a mesh among which a finger's first contact is looked for: some 3 mm apart."""

EDGE_RADIUS, EDGE_SPREAD = 0.004, float(np.deg2rad(20.0))
"""A point around which (m) normals are dispersed by more (rad) is on an edge."""


def on_opposed_sides(start: Start, seeder: Seeder) -> Start:
    """The start with contacts on opposed sides, where the object has faces; else as it is."""
    task, opposer = seeder.task, seeder.pinch.opposer
    shape = task.object.shape
    if shape.flat_sides is None and not isinstance(shape, Mesh):
        return start
    state = HandState(task.hand, start.q)
    pads = np.array([start.T_object_base.act(state.pad_center(f)) for f in task.fingers])
    across = np.delete(pads, opposer, axis=0).mean(axis=0) - pads[opposer]
    if isinstance(shape, Mesh):
        return _on_mesh(start, shape, pads, across, opposer)
    return _on_faces(start, seeder, pads, across)


def _on_faces(start: Start, seeder: Seeder, pads: FloatArray, across: FloatArray) -> Start:
    """On the flat sides that face a line (3,) across the object the most, in either direction."""
    shape, opposer = seeder.task.object.shape, seeder.pinch.opposer
    sides = shape.flat_sides
    assert sides is not None
    normals = np.tile(sides[np.argmax(sides @ across)], (len(pads), 1))
    normals[opposer] = sides[np.argmin(sides @ across)]
    patches = tuple(
        seeder.surface.patch_at(shape, point, normal)
        for point, normal in zip(pads, normals, strict=True)
    )
    points = np.array([np.clip(p, c.lower, c.upper) for p, c in zip(pads, patches, strict=True)])
    return replace(start, points=points, forces=_pressing(start, normals), patches=patches)


def _on_mesh(start: Start, mesh: Mesh, pads: FloatArray, across: FloatArray, opposer: int) -> Start:
    """On the points nearest to the pads that face to their side and are on no edge."""
    points, normals = _off_edges(mesh)
    along = normals @ (across / np.linalg.norm(across))
    found = []
    for i, pad in enumerate(pads):
        facing = np.flatnonzero((-along if i == opposer else along) >= FACING)
        if not len(facing):
            return start
        away = np.linalg.norm(points[facing] - pad, axis=1)
        found.append(int(facing[np.argmin(away)]))
    return replace(start, points=points[found], forces=_pressing(start, normals[found]))


def _pressing(start: Start, normals: FloatArray) -> FloatArray:
    """Forces (n, 3) as large as the start's, against outward normals (n, 3)."""
    return np.asarray(-normals * np.linalg.norm(start.forces, axis=1, keepdims=True))


@made_once(8)
def _off_edges(mesh: Mesh) -> tuple[FloatArray, FloatArray]:
    """Points (m, 3) spread over a mesh but not on its edges, and outward normals (m, 3)."""
    points, normals = mesh.surface_samples(SAMPLES, np.random.default_rng(0))
    flat = mesh.normal_dispersion(points, EDGE_RADIUS, facing=normals) <= EDGE_SPREAD
    return points[flat], normals[flat]
