"""Named sets of ``PhysicsOptions``: a file each, registered in ``PRESETS``; and files of users.

A file is TOML or JSON and holds fields of ``PhysicsOptions`` under their names
(``sim.preset_files``)::

    preset = "mujoco-default"
    impratio = 100
    cone = "elliptic"
"""

from __future__ import annotations

from pathlib import Path
from typing import TypeAlias

from planner.errors import TaskError
from sim.physics.options import OURS, PRESETS, PhysicsOptions
from sim.preset_files import PresetFiles

AnyPhysics: TypeAlias = PhysicsOptions | str
"""Physics, or what ``--physics`` takes: a preset's name or the path of a file."""

_FILES = PresetFiles(kind="physics", presets=PRESETS, usual=OURS)


def named_physics(name: str) -> PhysicsOptions:
    """A preset.

    Raises:
        NotFoundError: There is none of that name.
    """
    return _FILES.named(name)


def physics_for(text: str) -> PhysicsOptions:
    """A preset by name, or a file by path: what ``--physics`` takes.

    Raises:
        NotFoundError: Neither a preset nor the path of a TOML or JSON file.
        FileFormatError: The file cannot be read, or is no such file.
        TaskError: A field that there is not, or a value out of range.
    """
    return _FILES.given(text)


def as_physics(given: AnyPhysics | None) -> PhysicsOptions:
    """The physics that was given, by name or itself; the defaults if None.

    Raises:
        PlannerError: See ``physics_for``.
        TaskError: What was given is neither.
    """
    if isinstance(given, str):
        return physics_for(given)
    if given is not None and not isinstance(given, PhysicsOptions):
        raise TaskError(
            f"physics is a {type(given).__name__}; give PhysicsOptions, one of "
            f"{', '.join(PRESETS)}, or the path of a TOML or JSON file"
        )
    return given or PhysicsOptions()


def read_physics(path: Path) -> PhysicsOptions:
    """Physics out of a TOML or JSON file; it is called as the file unless it says a name.

    Raises:
        NotFoundError: It names a preset that there is not.
        FileFormatError: The file cannot be read, or is no such file.
        TaskError: A field that there is not, or a value out of range.
    """
    return _FILES.read(path)
