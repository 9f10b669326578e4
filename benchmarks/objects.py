"""Objects of a measurement: specifications, and the mesh files of folders."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from planner.errors import ObjectError
from planner.shapes.meshes.io import MESH_SUFFIXES


@dataclass(frozen=True, kw_only=True)
class BenchObject:
    """One object of a measurement.

    Attributes:
        label: What it is called in tables.
        spec: What ``planner.objects.parse_object`` reads.
        may_fail: Whether it comes from a folder: its errors then become a row.
    """

    label: str
    spec: str
    may_fail: bool = False


def bench_objects(given: Iterable[str]) -> list[BenchObject]:
    """The objects of specifications and folders, in order, files of a folder by name.

    Raises:
        ObjectError: A folder without mesh files, or nothing at all.
    """
    found: list[BenchObject] = []
    for text in given:
        folder = Path(text)
        if not folder.is_dir():
            label = folder.stem if folder.suffix.lower() in MESH_SUFFIXES else text
            found.append(BenchObject(label=label, spec=text))
            continue
        files = sorted(f for f in folder.iterdir() if f.suffix.lower() in MESH_SUFFIXES)
        if not files:
            raise ObjectError(
                f"the folder {text} holds no mesh file; meshes end in {', '.join(MESH_SUFFIXES)}"
            )
        found += [BenchObject(label=f.stem, spec=str(f), may_fail=True) for f in files]
    if not found:
        raise ObjectError("there are no objects; name a specification, a mesh file or a folder")
    return found
