"""``StateFormat`` and the registry of formats of states.

A new one is a module with ``register_state_format(StateFormat(...))`` and its name in ``_MODULES``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

from planner.errors import NotFoundError, TaskError
from planner.spatial import FloatArray
from sim.reset_states.states import StateSet

_MODULES = ("arrays", "parquet", "hora", "playground", "isaac_lab")

_PACKAGE = __name__.rpartition(".")[0]

_FORMATS: dict[str, StateFormat] = {}


@dataclass(frozen=True, kw_only=True)
class StateFormat:
    """A format of states of one hand, object and size.

    Attributes:
        name: Its name on the command line.
        title: What it is, in one line.
        lost: What of a state it does not hold, in one line; "" if it holds all.
        refuses: Why it cannot hold these states; "" if it can.
        write: Writes states into a folder, the root of all of a cache; the file.
        read: The columns of a file by name: what its own users see.
    """

    name: str
    title: str
    lost: str
    refuses: Callable[[StateSet], str]
    write: Callable[[StateSet, str, Path], Path]
    read: Callable[[Path], Mapping[str, FloatArray | Any]]


def register_state_format(made: StateFormat) -> StateFormat:
    """Make a format known by its name, and return it.

    Raises:
        TaskError: Another format has that name.
    """
    if _FORMATS.setdefault(made.name, made) is not made:
        raise TaskError(f"there is a format of states called {made.name!r}; choose another name")
    return made


def state_formats() -> tuple[str, ...]:
    """Names of all formats."""
    for module in _MODULES:
        import_module(f"{_PACKAGE}.{module}")
    return tuple(_FORMATS)


def state_format(name: str) -> StateFormat:
    """A format by its name.

    Raises:
        NotFoundError: There is none of that name.
    """
    if name not in state_formats():
        raise NotFoundError("format of states", name, _FORMATS)
    return _FORMATS[name]
