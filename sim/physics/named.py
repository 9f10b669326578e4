"""Named sets of ``PhysicsOptions``: a file each, registered in ``PRESETS``; and files of users.

A file is TOML or JSON and holds fields of ``PhysicsOptions`` under their names. What it leaves out
is that of the preset that its field ``preset`` names, or ``ours``::

    preset = "mujoco-default"
    impratio = 100
    cone = "elliptic"
"""

from __future__ import annotations

import json
import tomllib
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from planner.errors import FileFormatError, NotFoundError, TaskError
from sim.physics.options import FIELDS, OURS, PRESETS, PhysicsOptions

__all__ = ["PRESETS", "SUFFIXES", "named_physics", "physics_for", "read_physics"]

SUFFIXES = (".toml", ".json")
"""Ends of files that hold physics."""

BASE = "preset"
"""Field of a file that names what it is based on."""


def named_physics(name: str) -> PhysicsOptions:
    """A preset.

    Raises:
        NotFoundError: There is none of that name.
    """
    if name not in PRESETS:
        raise NotFoundError("physics", name, PRESETS)
    return PRESETS[name]


def physics_for(text: str) -> PhysicsOptions:
    """A preset by name, or a file by path: what ``--physics`` takes.

    Raises:
        NotFoundError: Neither a preset nor the path of a TOML or JSON file.
        FileFormatError: The file cannot be read, or is no such file.
        TaskError: A field that there is not, or a value out of range.
    """
    if text in PRESETS or Path(text).suffix.lower() not in SUFFIXES:
        return named_physics(text)
    return read_physics(Path(text))


def read_physics(path: Path) -> PhysicsOptions:
    """Physics out of a TOML or JSON file; it is called as the file unless it says a name.

    Raises:
        NotFoundError: It names a preset that there is not.
        FileFormatError: The file cannot be read, or is no such file.
        TaskError: A field that there is not, or a value out of range.
    """
    try:
        content = path.read_bytes().decode("utf-8")
        given = json.loads(content) if path.suffix.lower() == ".json" else tomllib.loads(content)
    except OSError as error:
        raise FileFormatError(f"cannot read the physics file {path}: {error.strerror}") from error
    except (ValueError, RecursionError) as error:
        raise FileFormatError(f"{path} is no TOML or JSON by its ending: {error}") from error
    if not isinstance(given, dict):
        raise FileFormatError(f"{path} holds no fields; give some of {', '.join(FIELDS)}")
    try:
        return _from_fields({"name": path.name, **given})
    except TaskError as error:
        raise TaskError(f"{path}: {error}") from error


def _from_fields(given: Mapping[str, Any]) -> PhysicsOptions:
    values = dict(given)
    base = values.pop(BASE, OURS)
    if not isinstance(base, str):
        raise TaskError(f"{BASE} is {base!r}; give one of {', '.join(PRESETS)}")
    if unknown := sorted(set(values) - set(FIELDS)):
        raise TaskError(
            f"{', '.join(unknown)}: no such field; give some of {', '.join((BASE, *FIELDS))}"
        )
    return replace(named_physics(base), **values)
