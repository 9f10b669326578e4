"""Every kind of shape by its name, and how a new one is added.

A new primitive is one file: a subclass of ``Shape`` with its ``surface``. ``register_shape``
makes it known to specifications, files, plans and simulations.

As plain data for JSON a shape is ``{"kind": "cylinder", "radius_m": 0.03, "height_m": 0.1}``. A
mesh of a file is its path, scale and digest: the file must be there, unchanged, when it is read
back. A mesh without a file is its vertices and faces themselves.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import fields
from typing import Any, TypeVar

import numpy as np

from planner.errors import NotFoundError, ObjectError, shown
from planner.registry import Registry
from planner.shapes.base import Shape
from planner.shapes.mesh import Mesh

_S = TypeVar("_S", bound=type[Shape])


def _check(kind: str, shape: type[Shape]) -> None:
    if not kind.isidentifier() or kind != kind.lower():
        raise ObjectError(
            f"shape kind {shown(kind)}: give one word of lower-case letters and digits"
        )
    if kind != shape.kind:
        raise ObjectError(f"shape kind {shown(kind)}: the class calls itself {shown(shape.kind)}")
    if len(shape.default_sizes) != len(shape.size_names):
        raise ObjectError(
            f"shape {shown(kind)} has {len(shape.default_sizes)} default sizes; give one for each "
            f"of {', '.join(shape.size_names)}"
        )
    shape.from_sizes(shape.default_sizes)


SIZED_SHAPES: Registry[type[Shape]] = Registry(
    "shape", group="shapes", error=ObjectError, check=_check
)
"""Every kind of shape that its sizes determine, by its name."""


def register_shape(shape: _S) -> _S:
    """Make a kind of shape known by its name; usable as a decorator of the class.

    A package of others needs no call: an entry point of the group ``opposable.shapes`` will do.

    Args:
        shape: A subclass of ``Shape``. ``from_sizes(default_sizes)`` makes one of it.

    Raises:
        ObjectError: The name is taken or not a word, or the default sizes are not one number for
            each of ``size_names``.
    """
    if shape.kind == Mesh.kind:
        raise ObjectError(f"shape kind {shown(shape.kind)} is Mesh already; choose another name")
    SIZED_SHAPES.add(shape.kind, shape)
    return shape


_OURS = {
    "sphere": "round:Sphere",
    "box": "box:Box",
    "cylinder": "round:Cylinder",
    "capsule": "round:Capsule",
    "ellipsoid": "round:Ellipsoid",
    "mug": "made:Mug",
    "lbracket": "made:LBracket",
    "torus": "made:Torus",
    "hammer": "made:Hammer",
    "superquadric": "made:Superquadric",
    "knot": "made:Knot",
    "cup": "vessels:Cup",
    "teacup": "vessels:Teacup",
    "bowl": "vessels:Bowl",
    "pan": "vessels:Pan",
    "plate": "vessels:Plate",
    "channel": "made:Channel",
    "tube": "vessels:Tube",
    "tray": "made:Tray",
}
"""Kind -> its module here and its class, which is imported when an object of the kind is met."""

SIZED_SHAPES.add_homes({kind: f"planner.shapes.{home}" for kind, home in _OURS.items()})

_FILE_KEYS = {"path", "scale", "repair", "sha256"}
_MENDED = "mended"
_TRIANGLE_KEYS = {"vertices_m", "faces"}


def shape_to_dict(shape: Shape) -> dict[str, Any]:
    """A shape as strings, floats and lists: its kind, and its attributes with their unit."""
    data: dict[str, Any] = {"kind": shape.kind}
    if type(shape) is Mesh:
        return data | _mesh_to_dict(shape)
    for key, name in _keys(type(shape)).items():
        value = getattr(shape, name)
        data[key] = list(value) if isinstance(value, tuple) else value
    return data


def shape_key(shape: Shape) -> str:
    """What identifies a shape wherever its file is: SHA-256, hexadecimal."""
    if type(shape) is Mesh:
        return shape.digest
    return hashlib.sha256(json.dumps(shape_to_dict(shape), sort_keys=True).encode()).hexdigest()


def shape_from_dict(data: object) -> Shape:
    """The shape that ``shape_to_dict`` wrote, validated.

    Raises:
        NotFoundError: Unknown kind.
        ObjectError: Not a mapping, a key missing or unknown, a size out of range, or a mesh file
            that is missing or was changed.
    """
    if not isinstance(data, Mapping):
        raise ObjectError(
            f'a shape is {shown(data)}; give an object such as {{"kind": "box", ...}}'
        )
    kind = data.get("kind")
    if not isinstance(kind, str):
        kinds = sorted((*SIZED_SHAPES, Mesh.kind))
        raise ObjectError(f'a shape has kind {shown(kind)}; give "kind" as one of {kinds}')
    given = {str(key) for key in data} - {"kind"}
    if kind == Mesh.kind:
        return _mesh_from_dict(data, given)
    if kind not in SIZED_SHAPES:
        raise NotFoundError("shape", kind, (*SIZED_SHAPES, Mesh.kind))
    keys = _keys(SIZED_SHAPES[kind])
    if given != set(keys):
        raise ObjectError(f"a {kind} has {sorted(given)}; it needs {sorted(keys)} and no others")
    return SIZED_SHAPES[kind](**{name: data[key] for key, name in keys.items()})


def _keys(shape: Any) -> dict[str, str]:
    """Keys of the plain data and the attributes they stand for."""
    names = [field.name for field in fields(shape)]
    return {name if name in shape.pure_numbers else f"{name}_m": name for name in names}


def _mesh_to_dict(mesh: Mesh) -> dict[str, Any]:
    if mesh.source is None:
        return {
            "vertices_m": mesh.vertices.ravel().tolist(),
            "faces": [float(i) for i in mesh.faces.ravel()],
        }
    data: dict[str, Any] = {
        "path": str(mesh.source.path),
        "scale": mesh.source.scale,
        "repair": "yes" if mesh.source.repair else "no",
        "sha256": mesh.digest,
    }
    return data | ({_MENDED: mesh.mended} if mesh.mended else {})


def _mesh_from_dict(data: Mapping[Any, Any], given: set[str]) -> Mesh:
    if given == _TRIANGLE_KEYS:
        try:
            vertices = np.array(data["vertices_m"], dtype=np.float64).reshape(-1, 3)
            faces = np.array(data["faces"], dtype=np.float64).reshape(-1, 3).astype(np.int64)
        except (TypeError, ValueError):
            raise ObjectError(
                'a mesh has "vertices_m" and "faces" that are not lists of numbers, three for each'
            ) from None
        return Mesh.from_triangles(vertices, faces)
    if given - {_MENDED} != _FILE_KEYS:
        raise ObjectError(
            f"a mesh has {sorted(given)}; it needs {sorted(_FILE_KEYS)} or "
            f"{sorted(_TRIANGLE_KEYS)} and no others"
        )
    path, scale, repair, digest = (data[key] for key in ("path", "scale", "repair", "sha256"))
    if not isinstance(path, str) or isinstance(scale, bool) or not isinstance(scale, int | float):
        raise ObjectError(
            f"a mesh has path {shown(path, 300)} and scale {shown(scale)}; give text and a number"
        )
    if repair not in ("yes", "no"):
        raise ObjectError(f'a mesh has repair {shown(repair)}; give "yes" or "no"')
    mesh = Mesh.load(path, scale=float(scale), repair=repair == "yes")
    if mesh.digest != digest:
        told = data.get(_MENDED, "")
        if told != mesh.mended:
            raise ObjectError(
                f"the mesh file {path!r} was mended as {shown(told)} when it was stored, "
                f"and now as {mesh.mended!r}: it was changed since, or another version mended it; "
                "plan again"
            )
        raise ObjectError(
            f"the mesh file {path!r} is not the one that was stored: it was changed "
            "since; plan again, or bring the old file back"
        )
    return mesh
