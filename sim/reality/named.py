"""Realities by name, out of a file, or as they are: what ``--reality`` and ``simulate`` take.

A file is TOML or JSON and holds fields of ``Reality`` under their names (``sim.preset_files``)::

    preset = "lab"
    encoder_offset = 0.035  # rad
    object_mass = 0.0
"""

from __future__ import annotations

from pathlib import Path
from typing import TypeAlias

from planner.errors import TaskError, shown
from sim.preset_files import PresetFiles
from sim.reality.errors import IDEAL, REALITIES, Reality

AnyReality: TypeAlias = Reality | str
"""What is accepted as a reality: itself, the name of a preset, or the path of a file."""

_FILES = PresetFiles(kind="reality", presets=REALITIES, usual=IDEAL)


def named_reality(name: str, seed: int = 0) -> Reality:
    """A registered reality with a seed.

    Raises:
        NotFoundError: There is none of that name.
        TaskError: The seed is no integer >= 0.
    """
    return _FILES.named(name).seeded(seed)


def reality_for(text: str) -> Reality:
    """A preset by name, or a file by path: what ``--reality`` takes.

    Raises:
        NotFoundError: Neither a preset nor the path of a TOML or JSON file.
        FileFormatError: The file cannot be read, or is no such file.
        TaskError: A field that there is not, or a value out of range.
    """
    return _FILES.given(text)


def read_reality(path: Path) -> Reality:
    """A reality out of a TOML or JSON file; it is called as the file unless it says a name.

    Raises:
        NotFoundError: It names a preset that there is not.
        FileFormatError: The file cannot be read, or is no such file.
        TaskError: A field that there is not, or a value out of range.
    """
    return _FILES.read(path)


def as_reality(given: AnyReality | None) -> Reality:
    """The reality that was given, by name or itself; the ideal one if None.

    Raises:
        PlannerError: See ``reality_for``.
        TaskError: What was given is neither.
    """
    if given is None:
        return REALITIES[IDEAL]
    if isinstance(given, str):
        return reality_for(given)
    if not isinstance(given, Reality):
        raise TaskError(
            f"reality is {shown(given)}; give a Reality, one of {', '.join(REALITIES)}, or the "
            "path of a TOML or JSON file"
        )
    return given
