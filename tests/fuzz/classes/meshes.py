"""Mesh files: OBJ, STL and PLY with changed bytes, numbers, or triangles."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from random import Random

import numpy as np
import trimesh

from planner.objects import parse_object
from planner.shapes import Mesh

from ..hostile import damaged, number, replaced_numbers
from ..samples import Samples


def case(rng: Random, samples: Samples) -> Callable[[], object]:
    del samples
    mesh = rng.choice(MAKERS)(rng)
    vertices, faces = np.array(mesh.vertices), np.array(mesh.faces)
    kind = rng.randrange(8)
    if kind == 0:
        vertices[rng.randrange(len(vertices)), rng.randrange(3)] = number(rng)
    elif kind == 1:
        faces = np.delete(faces, rng.randrange(len(faces)), axis=0)
    elif kind == 2:
        faces[rng.randrange(len(faces))] = faces[rng.randrange(len(faces))][::-1]
    elif kind == 3:
        vertices *= rng.choice([1e-3, 0.1, 1.5, 10.0, abs(number(rng))])
    suffix = rng.choice([".stl", ".obj", ".ply"])
    path = Path(f"part{suffix}")
    with np.errstate(all="ignore"):
        content = trimesh.Trimesh(vertices, faces, process=False).export(file_type=suffix[1:])
    content = content.encode() if isinstance(content, str) else content
    if suffix == ".obj" and rng.random() < 0.5:
        content = replaced_numbers(content.decode(), rng, 2).encode(errors="replace")
    elif rng.random() < 0.3:
        content = damaged(content, rng)
    path.write_bytes(content)
    repair, scale = rng.random() < 0.4, abs(number(rng)) if rng.random() < 0.2 else 1.0
    name = rng.choice([str(path)] * 8 + ["x" * 5000 + ".stl", "a\0.stl", f"{path}*nan", f"{path}*"])

    def load() -> None:
        if name != str(path):
            parse_object(name, repair=repair)
        mesh = Mesh.load(path, scale=scale, repair=repair)
        mesh.signed_distance(np.zeros((2, 3)))
        mesh.resting_poses()
        mesh.inertia(0.1)
        parse_object(str(path), repair=repair)

    return load


def _round(rng: Random) -> trimesh.Trimesh:
    return trimesh.creation.icosphere(subdivisions=rng.choice([0, 1, 2]), radius=0.03)


def _can(rng: Random) -> trimesh.Trimesh:
    return trimesh.creation.cylinder(0.03, 0.09, sections=rng.choice([3, 8, 64, 300]))


MAKERS: tuple[Callable[[Random], trimesh.Trimesh], ...] = (
    _round,
    _can,
    lambda _: trimesh.creation.box((0.03, 0.04, 0.05)),
    lambda _: trimesh.creation.torus(0.03, 0.01, major_sections=12, minor_sections=8),
)
