"""Parts that overlap, touch or lie in each other, united into one solid.

By manifold3d where it is installed (extra ``meshes``), which is exact; else by a surface wrapped
around them on a grid.
"""

from __future__ import annotations

import importlib
import importlib.util
from typing import Any

import numpy as np

from planner.shapes.meshes.soundness import bodies_of, body_volumes, nested
from planner.spatial import FloatArray, IntArray

Triangles = tuple[FloatArray, IntArray]


def manifold_is_installed() -> bool:
    """Whether manifold3d can be imported."""
    return importlib.util.find_spec("manifold3d") is not None


def united(vertices: FloatArray, faces: IntArray) -> Triangles:
    """The union of the bodies of a surface, by manifold3d.

    A body that is wound inwards is a cavity if another lies around it, and of matter otherwise.

    Args:
        vertices: (n, 3), m.
        faces: (m, 3), each body closed, consistently wound, and not crossing itself.
    """
    manifold3d: Any = importlib.import_module("manifold3d")
    body = bodies_of(faces)
    volumes = body_volumes(vertices, faces, body)
    turned = np.where((volumes < 0)[body][:, None], faces[:, ::-1], faces)
    cavities: dict[int, list[int]] = {}
    matter = set(range(len(volumes)))
    pairs = [(inner, outer) for inner, outer, _ in nested(vertices[turned], body, len(volumes))]
    for cavity in sorted({inner for inner, _ in pairs if volumes[inner] < 0}):
        # of the body closest around it; matter of another body fills it
        around = [outer for inner, outer in pairs if inner == cavity]
        owner = min(around, key=lambda outer: abs(float(volumes[outer])))
        matter.discard(cavity)
        cavities.setdefault(owner, []).append(cavity)

    def solid(number: int) -> Any:
        used, own = np.unique(turned[body == number], return_inverse=True)
        mesh = manifold3d.Mesh64(
            np.ascontiguousarray(vertices[used]),
            np.ascontiguousarray(own.reshape(-1, 3), dtype=np.uint64),
        )
        return manifold3d.Manifold(mesh)

    parts = []
    for number in sorted(matter):
        hollow = [solid(k) for k in cavities.get(number, ())]
        subtract = manifold3d.OpType.Subtract
        parts.append(manifold3d.Manifold.batch_boolean([solid(number), *hollow], subtract))
    mesh = manifold3d.Manifold.batch_boolean(parts, manifold3d.OpType.Add).to_mesh64()
    points = np.array(mesh.vert_properties, dtype=np.float64)[:, :3]
    return points, np.array(mesh.tri_verts, dtype=np.int64)
