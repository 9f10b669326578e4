"""``Presets``: sets of numbers by name, and files that change one: TOML or JSON with their fields.

Used for physics (``sim.scene.physics``) and for error models (``sim.sensing.errors``). What a file
leaves out is that of the preset that its field ``preset`` names, or of the usual one. The set is
called as the file unless its field ``name`` says otherwise.
"""

from __future__ import annotations

import json
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import fields, replace
from pathlib import Path
from typing import Any, TypeVar

from planner.errors import FileFormatError, NotFoundError, TaskError, shown

__all__ = ["SUFFIXES", "Presets"]

SUFFIXES = (".toml", ".json")
"""Ends of files that hold a set of fields."""

BASE = "preset"
"""Field of a file that names what it is based on."""

Preset = TypeVar("Preset")


class Presets(Mapping[str, Preset]):
    """One kind of presets by their names: frozen dataclasses with a field ``name``.

    Attributes:
        kind: What a message calls them.
        usual: The preset on which a file is based that names none.
    """

    def __init__(self, kind: str, usual: Preset) -> None:
        """Begin with the usual one.

        Args:
            kind: What a message calls them.
            usual: The preset on which a file is based that names none.
        """
        self.kind, self.usual = kind, usual
        self._known: dict[str, Preset] = {}
        self.register(usual)

    def __getitem__(self, name: str) -> Preset:
        """A preset; see ``named`` for names that people write."""
        return self._known[name]

    def __iter__(self) -> Iterator[str]:
        """Names, in the order of registration."""
        return iter(self._known)

    def __len__(self) -> int:
        """How many there are."""
        return len(self._known)

    def register(self, preset: Preset) -> Preset:
        """Make a preset known by its name, and return it.

        Raises:
            TaskError: Another one has that name, or what was given is of another type.
        """
        kind = type(self.usual)
        if not isinstance(preset, kind):
            raise TaskError(
                f"{shown(preset)} is no {self.kind}; give a {kind.__name__} with a name of its own"
            )
        name: str = vars(preset)["name"]
        if preset != self._known.setdefault(name, preset):
            raise TaskError(
                f"a preset of {self.kind} is called {name!r} already; give another name"
            )
        return preset

    def named(self, name: str) -> Preset:
        """A preset.

        Raises:
            NotFoundError: There is none of that name.
        """
        if name not in self._known:
            hint = "A TOML or JSON file of fields is taken too."
            raise NotFoundError(self.kind, name, self._known, hint)
        return self._known[name]

    def given(self, given: Preset | str | None) -> Preset:
        """What a caller gave: a preset, the name of one, or the path of a file; the usual if None.

        Raises:
            NotFoundError: Neither a preset nor the path of a TOML or JSON file.
            FileFormatError: The file cannot be read, or is no such file.
            TaskError: A field that there is not, a value out of range, or another type.
        """
        if given is None:
            return self.usual
        if isinstance(given, type(self.usual)):
            return given
        if not isinstance(given, str):
            raise TaskError(
                f"{self.kind} is {shown(given)}; give a {type(self.usual).__name__}, one of "
                f"{', '.join(self)}, or the path of a TOML or JSON file"
            )
        if given in self._known or Path(given).suffix.lower() not in SUFFIXES:
            return self.named(given)
        return self.read(Path(given))

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
        usual: Any = self.usual
        return tuple(field.name for field in fields(usual))

    def _from_fields(self, given: Mapping[str, Any]) -> Preset:
        values = dict(given)
        name = values.pop(BASE, None)
        if name is not None and not isinstance(name, str):
            raise TaskError(f"{BASE} is {name!r}; give one of {', '.join(self)}")
        if unknown := sorted(set(values) - set(self._fields)):
            known = ", ".join((BASE, *self._fields))
            raise TaskError(f"{', '.join(unknown)}: no such field; give some of {known}")
        base: Any = self.usual if name is None else self.named(name)
        changed: Preset = replace(base, **values)
        return changed
