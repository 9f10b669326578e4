"""An object as DexGraspBench reads it: convex pieces, and the file its density comes from.

Pieces and pose are in the frame of the object's own file, in metres: ours has its origin at the
centre of mass. ``simplified.json`` says under ``gravity_center`` where that is, as the benchmark's
own files do. What is not from a file keeps our frame.
"""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

import numpy as np

from planner.files import write_json
from planner.shapes import Shape
from planner.shapes.decomposition.pieces import convex_pieces, deviation
from planner.shapes.hulls import hull_of
from planner.shapes.mesh import Mesh, surface_triangles
from planner.spatial import FloatArray, IntArray
from planner.task import GraspTask

NO_BETTER = 0.9
"""Pieces that reach out of the solid by more than this share of what the hull does (-) gain
nothing, and the hull is written: for example of a can with a thin rim at both ends."""


def frame_shift(shape: Shape) -> FloatArray:
    """The centre of mass (3,), m, in the frame of the object's file."""
    if isinstance(shape, Mesh) and shape.source is not None:
        return np.array(shape.offset)
    return np.zeros(3)


@lru_cache(maxsize=32)
def benchmark_pieces(shape: Shape) -> tuple[tuple[FloatArray, IntArray], ...]:
    """Vertices (n, 3), m, about the centre of mass, and faces (m, 3) of convex pieces of a shape.

    One for a convex shape, and for a mesh that cutting makes no truer than its hull is.
    """
    if not isinstance(shape, Mesh):
        return (surface_triangles(shape),)
    pieces = convex_pieces(shape)
    if len(pieces) > 1:
        hull = hull_of(shape.hull_vertices)
        if hull is not None and pieces.deviation > NO_BETTER * deviation(shape, [hull]):
            return ((hull.points, hull.faces),)
    return tuple(zip(pieces.vertices, pieces.faces, strict=True))


def write_object(task: GraspTask, folder: Path) -> None:
    """Write the object of a task: ``urdf/meshes/convex_piece_*.obj`` and ``info/simplified.json``.

    Args:
        task: The task.
        folder: The object's folder; made if it does not exist.
    """
    shape = task.object.shape
    shift = frame_shift(shape)
    (folder / "urdf" / "meshes").mkdir(parents=True, exist_ok=True)
    (folder / "info").mkdir(exist_ok=True)
    for old in (folder / "urdf" / "meshes").glob("convex_piece_*.obj"):
        old.unlink()  # of an export before
    for i, (vertices, faces) in enumerate(benchmark_pieces(shape)):
        lines = [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in vertices + shift]
        lines += [f"f {a} {b} {c}" for a, b, c in faces + 1]
        path = folder / "urdf" / "meshes" / f"convex_piece_{i:03d}.obj"
        path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    info = {
        "gravity_center": shift.tolist(),
        "obb": (2.0 * shape.half_extents).tolist(),
        "scale": 1.0,
        "density": task.object.mass / shape.volume,
        "mass": task.object.mass,
    }
    write_json(info, folder / "info" / "simplified.json")
