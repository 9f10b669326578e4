"""The mesh files that a model names: found where models in the wild keep them, and converted.

What a URDF only shows is added here too, for MuJoCo leaves it out.

A repository is often called otherwise than the ROS package that it holds, and a model is often
moved without its meshes. Nothing outside of the folders above a model is searched.
"""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import mujoco
import numpy as np

from planner.bridge.numbers import MOST_LENGTH
from planner.errors import ModelError
from planner.spatial import FloatArray

HIDDEN_GROUP = 3
"""Group of geoms that collide and are not drawn; MuJoCo's viewer hides it too."""

_ROS_SCHEME = re.compile(r"package:/+")  # MuJoCo drops one of a URL's slashes; some write three

LFS_POINTER = b"version https://git-lfs"
"""What a file begins with that a clone without Git LFS has in place of its content."""

MOST_ABOVE = 5
"""Folders above a model in which the path of a mesh is looked for."""


def find_meshes(spec: Any, path: Path) -> None:
    """Let each mesh of a ``mujoco.MjSpec`` name a file that exists, if one is found.

    A path that leads nowhere is tried below the folders above the model, then by its last part in
    the model's mesh folder and beside the model. ``package://NAME/PATH`` is looked for in a folder
    called NAME above the model or beside one, then as PATH below the folders above it, then as the
    rest of PATH below a folder above it whose name PATH has.

    Args:
        spec: As read from ``path``.
        path: The model file.

    Raises:
        ModelError: A ``package://`` path leads nowhere, or a file is a pointer of Git LFS.
    """
    folder = path.parent / (spec.meshdir or "")
    for mesh in spec.meshes:
        if mesh.file:
            mesh.file = _found(mesh.file, folder, path)


def convert_meshes(spec: Any) -> None:
    """Replace meshes that MuJoCo does not read whole by their vertices and triangles.

    Args:
        spec: A ``mujoco.MjSpec`` read from a file; after ``find_meshes``.

    Raises:
        ModelError: A mesh cannot be converted.
    """
    from planner.shapes.meshes.io import converted_mesh, needs_conversion

    folder = Path(spec.modelfiledir or "") / (spec.meshdir or "")
    for mesh in spec.meshes:
        file = folder / mesh.file
        if not (mesh.file and file.is_file() and needs_conversion(file)):
            continue
        vertices, faces = converted_mesh(file)
        mesh.name = mesh.name or file.stem  # what MuJoCo calls a mesh without a name
        mesh.uservert, mesh.userface, mesh.file = vertices.ravel(), faces.ravel(), ""


def add_visuals(spec: Any, path: Path) -> None:
    """Add what a URDF only shows to its bodies: without mass, and touching nothing.

    Where a link shows something, what collides is in ``HIDDEN_GROUP``. A mesh that is not found or
    cannot be read is left out: a picture must not keep a hand from being planned with.

    Args:
        spec: The URDF as MuJoCo has read it, without its visuals.
        path: The file.
    """
    try:
        root = ElementTree.fromstring(path.read_bytes())
    except ElementTree.ParseError:
        return
    colours = {m.get("name"): c.get("rgba") for m in root.iter("material") for c in m.iter("color")}
    for link in root.findall("link"):
        body = spec.body(link.get("name", ""))
        colliding = [] if body is None else list(body.geoms)
        for visual in [] if body is None else link.findall("visual"):
            try:
                _add_visual(spec, body, visual, colours, path)
            except (ModelError, OSError, ValueError):
                continue
            spec.compiler.discardvisual = False
            for geom in colliding:
                geom.group = HIDDEN_GROUP


def _add_visual(
    spec: Any, body: Any, visual: Any, colours: dict[str | None, str | None], path: Path
) -> None:
    """One ``<visual>``.

    Raises:
        ModelError: Its mesh is not found or cannot be read.
        ValueError: It holds what is no number or no geometry.
    """
    shapes = [shape for geometry in visual.iter("geometry") for shape in geometry]
    if not shapes:
        raise ValueError("no geometry")
    (origin,) = visual.findall("origin")[:1] or [ElementTree.Element("origin")]
    turn = np.zeros(4)
    mujoco.mju_euler2Quat(turn, _numbers(origin.get("rpy"), (0.0, 0.0, 0.0)), "XYZ")
    radius, length = (_numbers(shapes[0].get(key), (0.0,))[0] for key in ("radius", "length"))
    kind, size, mesh = mujoco.mjtGeom.mjGEOM_MESH, np.zeros(3), None
    if shapes[0].tag == "box":
        kind, size = mujoco.mjtGeom.mjGEOM_BOX, _numbers(shapes[0].get("size"), size) / 2
    elif shapes[0].tag == "sphere":
        kind, size = mujoco.mjtGeom.mjGEOM_SPHERE, np.array([radius, 0.0, 0.0])
    elif shapes[0].tag == "cylinder":
        kind, size = mujoco.mjtGeom.mjGEOM_CYLINDER, np.array([radius, length / 2, 0.0])
    elif shapes[0].tag == "mesh":
        mesh = _add_visual_mesh(spec, shapes[0], f"{body.name}_visual{len(body.geoms)}", path)
    if mesh is None and not size.any():
        raise ValueError("no size")
    colour: Any = next((c.get("rgba") for c in visual.iter("color")), None)
    for material in visual.iter("material"):
        colour = colour or colours.get(material.get("name"))
    geom = body.add_geom(
        type=kind, size=size, pos=_numbers(origin.get("xyz"), (0.0, 0.0, 0.0)), quat=turn
    )
    geom.contype = geom.conaffinity = 0
    geom.mass = geom.density = 0.0
    geom.meshname = mesh or ""
    geom.rgba = _numbers(colour, geom.rgba)


def _add_visual_mesh(spec: Any, shape: Any, name: str, path: Path) -> str:
    """The mesh of a ``<visual>`` under a name that is free."""
    from planner.shapes.meshes.io import converted_mesh

    file = Path(
        path.parent / (spec.meshdir or ""),
        _found(shape.get("filename", ""), path.parent / (spec.meshdir or ""), path),
    )
    vertices, faces = converted_mesh(file, MOST_TRIANGLES)
    scale = _numbers(shape.get("scale"), (1.0, 1.0, 1.0))
    reach = np.abs(vertices * scale).max()
    if len(vertices) < LEAST_VERTICES or reach > MOST_LENGTH:
        raise ValueError(f"{file} has {len(vertices)} vertices and reaches {reach:g} m")
    while name in {mesh.name for mesh in spec.meshes}:
        name += "_"
    shell = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL  # never refused; it has no mass
    spec.add_mesh(
        name=name, uservert=vertices.ravel(), userface=faces.ravel(), scale=scale, inertia=shell
    )
    return name


MOST_TRIANGLES = 40_000
"""Triangles of a link that is only shown; fewer leave holes in thin shells (5,000 did). With
270,000 in all a hand compiles in 0.9 s of CPU, without them in 0.3."""

LEAST_VERTICES = 4
"""Vertices below which MuJoCo takes no mesh."""


def _numbers(text: str | None, default: Any) -> FloatArray:
    """Finite numbers of an attribute, as many as the default has.

    Raises:
        ValueError: It holds something else.
    """
    values = np.array(default if text is None else text.split(), dtype=np.float64)
    if len(values) != len(default) or not np.isfinite(values).all():
        raise ValueError(f"{text!r} is not {len(default)} numbers")
    return values


def _found(file: str, folder: Path, model: Path) -> str:
    """The path of a mesh that exists, if one is found; relative to the mesh folder, or absolute.

    Raises:
        ModelError: A ``package://`` path leads nowhere, or the file is a pointer of Git LFS.
    """
    url = _ROS_SCHEME.match(file)
    if url:
        file = str(_ros_file(file[url.end() :], model))
    elif not os.path.isfile(folder / file):
        file = str(_elsewhere(file, folder, model) or file)
    _check_content(folder / file, model)
    return file


def _elsewhere(file: str, folder: Path, model: Path) -> Path | None:
    """A mesh that is not where the model says."""
    inside = Path(file.replace("\\", "/"))
    above = model.resolve().parents[: MOST_ABOVE + 1]
    tries = [] if inside.is_absolute() else [root / inside for root in above]
    tries += [folder / inside.name, model.resolve().parent / inside.name]
    return next((t for t in tries if os.path.isfile(t)), None)


def _ros_file(inside: str, model: Path) -> Path:
    """``PACKAGE/PATH`` of a ROS URL.

    Raises:
        ModelError: It is not there.
    """
    package, _, rest = inside.partition("/")
    rest, above = rest.lstrip("/"), model.resolve().parents
    for folder in above:
        for root in (folder, folder / package):
            if root.name == package and os.path.isfile(root / rest):
                return root / rest
    for folder in above[: MOST_ABOVE + 1]:  # a clone that is called otherwise than the package
        if rest and os.path.isfile(folder / rest):
            return folder / rest
    parts = rest.split("/")
    for folder in above:  # a part of the package, moved alone
        for k, part in enumerate(parts[:-1], start=1):
            if folder.name == part and os.path.isfile(folder.joinpath(*parts[k:])):
                return folder.joinpath(*parts[k:])
    raise ModelError(
        f"{model} names package://{inside}, and none of the folders above it is or holds "
        f"{package!r} with that file; copy the package's folder into {above[0]}, from which the "
        "search goes upwards, or write a relative path"
    )


def _check_content(file: Path, model: Path) -> None:
    """Refuse what a clone without Git LFS leaves of a mesh.

    Raises:
        ModelError: It is such a pointer.
    """
    if not file.is_file():
        return
    with file.open("rb") as stream:
        if stream.read(len(LFS_POINTER)) == LFS_POINTER:
            raise ModelError(
                f"{model} names {file.name}, which is only a pointer of Git LFS, not the mesh; run "
                "git lfs pull in that repository"
            )
