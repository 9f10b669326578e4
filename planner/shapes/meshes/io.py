"""Reading triangle meshes: a path becomes vertices in m and faces, or a named error.

``read_mesh`` reads objects; ``converted_mesh`` reads meshes of links that MuJoCo does not read, or
not whole, and keeps them in the disk cache by content: a Collada file takes about a second.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Callable
from importlib import metadata
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from planner.errors import ModelError, ObjectError
from planner.spatial import FloatArray, IntArray
from planner.system.disk_cache import read_arrays, write_arrays

MESH_SUFFIXES = (".glb", ".obj", ".ply", ".stl")
"""File formats that are read, by their suffix in lower case."""

CONVERTIBLE = {
    ".3mf": "networkx lxml",
    ".dae": "pycollada",
    ".gltf": "",
    ".off": "",
}
"""Formats of meshes that trimesh converts, and the packages that it needs for that."""

STL_HEAD, STL_TRIANGLE = 84, 50
"""Bytes of a binary STL: of its head, whose last four count the triangles, and of a triangle."""

PLAIN_PATH = re.compile(r"[\w./ :+,@=~-]+")
"""Paths that mean the same to every shell, between double quotes, and to Python."""


def read_mesh(path: Path, scale: float) -> tuple[FloatArray, IntArray]:
    """Vertices (n, 3), m, and faces (m, 3) of a file; seams of colours and normals are merged.

    Args:
        path: A GLB, OBJ, PLY or STL file; several objects in one file become one mesh, each where
            the file places it. Axes are the file's: in a GLB file, y is up.
        scale: Metres per unit of the file.

    Raises:
        ObjectError: Missing, unreadable, empty, too large, or not finite.
    """
    if path.suffix.lower() not in MESH_SUFFIXES:
        raise ObjectError(
            f"{path.name!r} is not a mesh that can be read; give one of {', '.join(MESH_SUFFIXES)}"
            f"{_conversion(path)}"
        )
    try:
        there = path.is_file()
    except (OSError, ValueError) as error:  # a name that no file can have
        reason = getattr(error, "strerror", None) or error
        raise ObjectError(f"there is no mesh file {str(path)[:60]!r}...: {reason}") from error
    if not there:
        raise ObjectError(f"there is no mesh file {str(path)!r}; check the path")
    if not (np.isfinite(scale) and scale > 0):
        raise ObjectError(f"{path.name}: scale is {scale}; give metres per unit of the file, > 0")
    from planner.shapes.meshes.soundness import MOST_TRIANGLES

    try:
        vertices, faces = _kept(READ, path, _read)
    except OSError:  # the reader says what is wrong
        vertices, faces = _read(path)
    if len(faces) == 0:
        raise ObjectError(f"{path.name} holds no triangles; give a mesh of a closed surface")
    if len(faces) > MOST_TRIANGLES:
        raise ObjectError(
            f"{path.name} has {len(faces)} triangles, more than {MOST_TRIANGLES}; simplify it "
            "first, for example with trimesh's simplify_quadric_decimation or in MeshLab"
        )
    if not np.isfinite(vertices[np.unique(faces)]).all():
        raise ObjectError(f"{path.name} has vertices that are NaN or infinite; export it again")
    used, faces = np.unique(faces, return_inverse=True)
    return vertices[used] * scale, faces.reshape(-1, 3).astype(np.int64)


def _conversion(path: Path) -> str:
    """How to make a file of another format one that is read; "" where we know no way."""
    packages = CONVERTIBLE.get(path.suffix.lower())
    if packages is None:
        return ""
    needed = f" (after pip install {packages})" if packages else ""
    # a file name of other characters must not become part of a command that is pasted
    if not PLAIN_PATH.fullmatch(path.as_posix()):
        return f". Convert it to .ply{needed}"
    source, target = path.as_posix(), path.with_suffix(".ply").as_posix()
    command = f"import trimesh; trimesh.load_mesh({source!r}).export({target!r})"
    return f'. To convert it{needed}: python -c "{command}"'


def _is_whole_stl(path: Path) -> bool:
    """Whether a binary STL has the bytes of the triangles that it announces; text counts as whole.

    trimesh takes what is left of another for text, in whatever encoding a detector suggests.
    """
    with path.open("rb") as file:
        head = file.read(STL_HEAD)
    if head.lstrip()[:5].lower() == b"solid":
        return True
    announced = int.from_bytes(head[STL_HEAD - 4 :], "little")
    return len(head) == STL_HEAD and path.stat().st_size >= STL_HEAD + STL_TRIANGLE * announced


Triangles = tuple[FloatArray, IntArray]
"""Vertices (n, 3), m, and faces (m, 3)."""

READ = "read"
"""Kind under which the disk cache keeps the triangles of files."""


def _kept(kind: str, path: Path, make: Callable[[Path], Triangles], more: str = "") -> Triangles:
    """What is made of a file's content, kept in the disk cache under the content's digest.

    Loading trimesh alone takes 0.5 s of CPU. A file of these formats holds all of its triangles.
    """
    made_with = f"trimesh {metadata.version('trimesh')};{path.suffix.lower()};{more}"
    key = hashlib.sha256(made_with.encode() + path.read_bytes()).hexdigest()
    known = read_arrays(kind, key)
    if known is not None and _are_triangles(known):
        return known["vertices"], known["faces"].astype(np.int64, copy=False)
    vertices, faces = make(path)
    write_arrays(kind, key, {"vertices": vertices, "faces": faces})
    return vertices, faces


def _are_triangles(known: dict[str, FloatArray]) -> bool:
    """Whether stored arrays are vertices and triangles of them."""
    vertices, faces = known.get("vertices"), known.get("faces")
    if vertices is None or faces is None or faces.dtype != np.int64 or not faces.size:
        return False
    if vertices.dtype != np.float64 or vertices.shape[1:] != (3,) or faces.shape[1:] != (3,):
        return False
    return bool(faces.min() >= 0 and faces.max() < len(vertices))


def _read(path: Path) -> Triangles:
    broken = ObjectError(
        f"{path.name} cannot be read as {path.suffix.lower()}: it is neither binary nor text "
        "of that format, or it is cut short; export it again"
    )
    try:
        if path.suffix.lower() == ".stl" and not _is_whole_stl(path):
            raise broken
        # read_mesh refuses vertices that are not finite
        with np.errstate(invalid="ignore"):
            mesh = _loaded(path)
            mesh.merge_vertices(merge_tex=True, merge_norm=True)
            vertices, faces = np.array(mesh.vertices, dtype=np.float64), np.array(mesh.faces)
    except ImportError as fault:  # bytes of no known encoding send trimesh looking for a detector
        raise broken from fault
    except ObjectError:
        raise
    except Exception as fault:  # trimesh's readers raise whatever the bytes provoke
        raise ObjectError(
            f"{path.name} cannot be read as {path.suffix.lower()} ({type(fault).__name__}: "
            f"{fault}); export it again"
        ) from fault
    if vertices.ndim != 2 or vertices.shape[1] != 3:  # an OBJ line of two or seven numbers
        raise ObjectError(
            f"{path.name} has vertices of another number of coordinates than 3 (shape "
            f"{vertices.shape}); export it again"
        )
    # merging may leave triangles with two equal corners, which are nothing
    faces = faces.reshape(-1, 3)
    return vertices, faces[(faces != np.roll(faces, 1, axis=1)).all(axis=1)]


def _loaded(path: Path) -> Any:
    """As trimesh has it, all objects in one mesh."""
    # imported here: primitives need no trimesh, and its import takes 0.1 s of CPU
    import trimesh

    mesh = trimesh.load_mesh(path, process=False, skip_materials=True)
    if isinstance(mesh, trimesh.Scene):
        mesh = mesh.to_mesh()
    return mesh


CONVERTED_SUFFIXES = (".dae", ".glb", ".off", ".ply")
"""Formats that are converted, in lower case; MuJoCo itself reads OBJ, STL and MSH."""

_OBJECT = re.compile(rb"^[ \t]*[og](?:[ \t].*)?\r?$", re.MULTILINE)
_FACE = re.compile(rb"^[ \t]*f[ \t]", re.MULTILINE)

CONVERTED = "converted"


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

    def made(file: Path) -> Triangles:
        vertices, faces = _read_link(file)
        if most:
            from planner.shapes.meshes.triangles import simplified

            vertices, faces, _ = simplified(vertices, faces, most)
        return vertices, faces

    return _kept(CONVERTED, path, made, f"{most};" if most else "")


def _read_link(path: Path) -> Triangles:
    from trimesh.units import unit_conversion  # here, as in ``_loaded``

    try:
        mesh = _loaded(path)
        if path.suffix.lower() == ".stl":
            mesh.merge_vertices()  # the format repeats each corner
        if path.suffix.lower() == ".dae" and mesh.units is not None:
            mesh.apply_scale(unit_conversion(mesh.units, "meters"))
        vertices = np.array(mesh.vertices, dtype=np.float64)
        faces = np.array(mesh.faces, dtype=np.int64)
    except Exception as fault:  # trimesh's readers raise whatever the bytes provoke
        if path.suffix.lower() == ".dae" and find_spec("collada") is None:
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
