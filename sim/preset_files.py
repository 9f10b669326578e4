"""Presets by name, and files that change one: TOML or JSON with fields of one dataclass.

Called for physics (``sim.physics.named``) and for realities (``sim.reality.named``). What a file
leaves out is that of the preset that its field ``preset`` names, or of the usual one. The set is
called as the file unless its field ``name`` says otherwise.
"""

from __future__ import annotations

import json
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, Generic, TypeVar

from planner.errors import FileFormatError, NotFoundError, TaskError

__all__ = ["SUFFIXES", "PresetFiles"]

SUFFIXES = (".toml", ".json")
"""Ends of files that hold a set of fields."""

BASE = "preset"
"""Field of a file that names what it is based on."""

Preset = TypeVar("Preset")


@dataclass(frozen=True, kw_only=True)
class PresetFiles(Generic[Preset]):
    """One kind of presets.

    Attributes:
        kind: What a message calls it.
        presets: Frozen dataclasses by their names, each with a field ``name``.
        usual: Name of the preset on which a file is based that names none.
    """

    kind: str
    presets: Mapping[str, Preset]
    usual: str

    def named(self, name: str) -> Preset:
        """A preset.

        Raises:
            NotFoundError: There is none of that name.
        """
        if name not in self.presets:
            hint = "A TOML or JSON file of fields is taken too."
            raise NotFoundError(self.kind, name, self.presets, hint)
        return self.presets[name]

    def given(self, text: str) -> Preset:
        """A preset by name, or a file by path.

        Raises:
            NotFoundError: Neither a preset nor the path of a TOML or JSON file.
            FileFormatError: The file cannot be read, or is no such file.
            TaskError: A field that there is not, or a value out of range.
        """
        if text in self.presets or Path(text).suffix.lower() not in SUFFIXES:
            return self.named(text)
        return self.read(Path(text))

    def read(self, path: Path) -> Preset:
        """A set of fields out of a TOML or JSON file.

        Raises:
            NotFoundError: It names a preset that there is not.
            FileFormatError: The file cannot be read, or is no such file.
            TaskError: A field that there is not, or a value out of range.
        """
        try:
            content = path.read_bytes().decode("utf-8")
            is_json = path.suffix.lower() == ".json"
            given = json.loads(content) if is_json else tomllib.loads(content)
        except OSError as error:
            reason = f"cannot read the {self.kind} file {path}: {error.strerror}"
            raise FileFormatError(reason) from error
        except (ValueError, RecursionError) as error:
            raise FileFormatError(f"{path} is no TOML or JSON by its ending: {error}") from error
        if not isinstance(given, dict):
            raise FileFormatError(f"{path} holds no fields; give some of {', '.join(self._fields)}")
        try:
            return self._from_fields({"name": path.name, **given})
        except TaskError as error:
            raise TaskError(f"{path}: {error}") from error

    @property
    def _fields(self) -> tuple[str, ...]:
        usual: Any = self.presets[self.usual]
        return tuple(field.name for field in fields(usual))

    def _from_fields(self, given: Mapping[str, Any]) -> Preset:
        values = dict(given)
        name = values.pop(BASE, self.usual)
        if not isinstance(name, str):
            raise TaskError(f"{BASE} is {name!r}; give one of {', '.join(self.presets)}")
        if unknown := sorted(set(values) - set(self._fields)):
            known = ", ".join((BASE, *self._fields))
            raise TaskError(f"{', '.join(unknown)}: no such field; give some of {known}")
        base: Any = self.named(name)
        changed: Preset = replace(base, **values)
        return changed
