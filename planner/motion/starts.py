"""Starts of motions: which fingers hold the object, with which pads, and where they touch it.

Fingers. Where the caller names none, attempts take turns between several sets. Three fingers go
further than four, though four have a contact to spare. Of four starts on each of six cylinders of 5
to 7 cm with 50 to 300 g and friction 0.5 to 1, 90 degrees about the vertical, these hold on the
Allegro-type hand: 22 with thumb, index and middle, 13 with middle and ring (the two nearest to the
thumb), 14 with all four; on the Shadow-type hand, of four starts on four of them, 12, 13 and 10,
and none with ring and little.

Contacts. ``planner.synthesis.seeds`` draws the hand's pose and posture. On objects with faces the
opposer's contact is then put on one side and all others on the opposite one. A finger's side
follows from where the finger is, not from its pad's axis or the nearest face: a finger that looks
to the side would get a neighbouring face, where nothing opposes it. Two of five starts of the
Shadow-type hand on a block had such a finger.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np

from planner.errors import TaskError
from planner.kinematics.state import HandState
from planner.shapes import Mesh
from planner.spatial import FloatArray
from planner.synthesis.problem import Start
from planner.synthesis.seeds.draw import TRIPOD, Seeder
from planner.synthesis.seeds.mesh import turning_seeder_for
from planner.system.threads import made_once
from planner.task import GraspTask

FACING = float(np.cos(np.deg2rad(45.0)))
"""Least cosine between the normal of a side and the line across: less belongs to a neighbour."""

SAMPLES = 3000
"""Points of a mesh among which a finger's first contact is looked for: some 3 mm apart."""

EDGE_RADIUS, EDGE_SPREAD = 0.004, float(np.deg2rad(20.0))
"""A point around which (m) normals are dispersed by more (rad) is on an edge."""


def with_rolling_pads(task: GraspTask) -> GraspTask:
    """The task with pads as wide as the tips are round, where its object has faces or is a ball.

    Of 8 starts for 94 degrees on blocks of 5, 6 and 7 cm, 60 mm high, path tolerance 30 mm, 3, 3
    and 2 hold with thumb, index and middle of the Shadow-type hand; none with the pads of a grasp.
    Torsional friction of tips that pivot turns balls of 55 to 70 mm with 0 to 3 mN m in an
    Allegro-type hand (9 plans), with the pads of a grasp with up to 23 (4 plans).
    """
    if not task.object.shape.turns_tips or task.hand.rolls:
        return task
    return replace(task, hand=task.hand.rolling)


@made_once(4)
def finger_sets(task: GraspTask) -> tuple[GraspTask, ...]:
    """The task for each set of fingers that attempts take turns between.

    Of the first ``PAIRS`` tripods those that open wide enough, then all; all alone where the caller
    chose.
    """
    if not task.may_spare_fingers or len(task.fingers) <= TRIPOD:
        return (task,)
    chosen = [tripod for names in tripods(task)[:PAIRS] if (tripod := _alone(task, names))]
    return (*chosen, task)


PAIRS = 2
"""Tripods that take turns; little fingers come last and seldom turn anything."""


def tripods(task: GraspTask) -> list[tuple[str, ...]]:
    """The finger that opposes the others with each pair of neighbours among those."""
    opposer = task.finger_names[turning_seeder_for(task).pinch.opposer]
    others = [name for name in task.finger_names if name != opposer]
    return [(opposer, *pair) for pair in pairwise(others)]


def _alone(task: GraspTask, names: tuple[str, ...]) -> GraspTask | None:
    """The task for these fingers, if they can do it.

    A region may be required of a spared finger, and without a thumb some do not open wide enough.
    """
    try:
        alone = task.with_fingers(names)
        turning_seeder_for(alone)
    except TaskError:
        return None
    return alone


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
