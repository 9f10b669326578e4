"""Meshes of links that MuJoCo does not read, or not whole, as vertices and triangles.

Read by trimesh and kept in the disk cache by content: a Collada file takes about a second.
"""

from __future__ import annotations

import hashlib
import re
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np

from planner.errors import ModelError
from planner.shapes.meshes.simplify import simplified
from planner.spatial import FloatArray, IntArray
from planner.system.disk_cache import read_arrays, write_arrays

CONVERTED_SUFFIXES = (".dae", ".glb", ".off", ".ply")
"""Formats that are converted, in lower case; MuJoCo itself reads OBJ, STL and MSH."""

_OBJECT = re.compile(rb"^[ \t]*[og](?:[ \t].*)?\r?$", re.MULTILINE)
_FACE = re.compile(rb"^[ \t]*f[ \t]", re.MULTILINE)

KIND = "converted"


def needs_conversion(path: Path) -> bool:
    """Whether MuJoCo does not read a mesh file whole, by its suffix or its content.

    Of an OBJ file with several objects (``o`` or ``g``) MuJoCo 4.0 takes all vertices and the faces
    of the first object: the hull is right, the picture and the mass are not.
    """
    if path.suffix.lower() != ".obj":
        return path.suffix.lower() in CONVERTED_SUFFIXES
    return sum(bool(_FACE.search(part)) for part in _OBJECT.split(path.read_bytes())) > 1


def converted_mesh(path: Path, most: int = 0) -> tuple[FloatArray, IntArray]:
    """Vertices (n, 3), m, and faces (m, 3) of a mesh file; all its objects become one mesh.

    Axes are the file's: ``up_axis`` of a Collada file and the upright y of glTF are ignored, as ROS
    does. The unit of a Collada file is heeded; the other formats are in metres.

    Args:
        path: A file of a format that trimesh reads.
        most: Largest number of triangles, for a mesh to be looked at; 0 for all.

    Raises:
        ModelError: It cannot be read, holds no triangles, or Collada needs a package that is
            missing.
    """
    content = path.read_bytes()
    made_with = f"trimesh {metadata.version('trimesh')};{path.suffix.lower()};".encode()
    if most:
        made_with += f"{most};".encode()
    key = hashlib.sha256(made_with + content).hexdigest()
    known = read_arrays(KIND, key)
    if known is not None and {"vertices", "faces"} <= set(known):
        return known["vertices"], known["faces"].astype(np.int64)
    vertices, faces = _read(path)
    if most:
        vertices, faces, _ = simplified(vertices, faces, most)
    write_arrays(KIND, key, {"vertices": vertices, "faces": faces})
    return vertices, faces


def _read(path: Path) -> tuple[FloatArray, IntArray]:
    try:
        mesh = _loaded(path)
        vertices = np.array(mesh.vertices, dtype=np.float64)
        faces = np.array(mesh.faces, dtype=np.int64)
    except Exception as fault:  # trimesh's readers raise whatever the bytes provoke
        if path.suffix.lower() == ".dae" and not _installed("pycollada"):
            raise ModelError(
                f"{path} is a Collada file, which needs a package that is not installed; "
                "pip install pycollada"
            ) from fault
        raise ModelError(
            f"{path} cannot be read as {path.suffix.lower()} ({type(fault).__name__}: {fault}); "
            "export it again, or as .stl or .obj"
        ) from fault
    if len(faces) == 0 or not np.isfinite(vertices).all():
        raise ModelError(f"{path} holds no triangles of finite size; export it again")
    return vertices, faces


def _loaded(path: Path) -> Any:
    # imported here: models without such meshes need no trimesh, whose import takes 0.1 s of CPU
    import trimesh

    mesh = trimesh.load_mesh(path, process=False, skip_materials=True)
    if isinstance(mesh, trimesh.Scene):
        mesh = mesh.to_mesh()
    if path.suffix.lower() == ".stl":
        mesh.merge_vertices()  # the format repeats each corner
    if path.suffix.lower() == ".dae" and mesh.units is not None:
        mesh.apply_scale(trimesh.units.unit_conversion(mesh.units, "meters"))
    return mesh


def _installed(distribution: str) -> bool:
    try:
        metadata.version(distribution)
    except metadata.PackageNotFoundError:
        return False
    return True
