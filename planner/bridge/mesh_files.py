"""The mesh files that a model names: found where models in the wild keep them, and converted.

A repository is often called otherwise than the ROS package that it holds, and a model is often
moved without its meshes. Nothing outside of the folders above a model is searched.
"""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import Any

from planner.errors import ModelError
from planner.shapes.meshes.convert import CONVERTED_SUFFIXES, converted_mesh

__all__ = ["convert_meshes", "find_meshes"]

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
        if not mesh.file:
            continue
        url = _ROS_SCHEME.match(mesh.file)
        if url:
            mesh.file = str(_ros_file(mesh.file[url.end() :], path))
        elif not os.path.isfile(folder / mesh.file):
            found = _elsewhere(mesh.file, folder, path)
            mesh.file = mesh.file if found is None else str(found)
        _check_content(folder / mesh.file, path)


def convert_meshes(spec: Any, path: Path) -> None:
    """Replace meshes in formats that MuJoCo does not read by their vertices and triangles.

    Args:
        spec: After ``find_meshes``.
        path: The model file.

    Raises:
        ModelError: A mesh cannot be converted.
    """
    folder = path.parent / (spec.meshdir or "")
    for mesh in spec.meshes:
        file = folder / mesh.file
        if file.suffix.lower() not in CONVERTED_SUFFIXES or not file.is_file():
            continue
        vertices, faces = converted_mesh(file)
        mesh.name = mesh.name or file.stem  # what MuJoCo calls a mesh without a name
        mesh.uservert, mesh.userface, mesh.file = vertices.ravel(), faces.ravel(), ""


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
