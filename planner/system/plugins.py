"""What other installed packages bring, found by their entry points.

A package names a group and what it brings in its ``pyproject.toml``::

    [project.entry-points."opposable.hands"]
    my_hand = "my_package:HAND"              # path of a hand.toml or of a model
    [project.entry-points."opposable.shapes"]
    cone = "my_package:Cone"                 # a planner.shapes.Shape
    [project.entry-points."opposable.formats"]
    my-format = "my_package:FORMAT"          # a planner.exchange.GraspFormat
    [project.entry-points."opposable.protocols"]
    my_test = "my_package:cases"             # (settings, seed) -> cases; sim.protocols.Protocol
    [project.entry-points."opposable.senses"]
    my_skin = "my_package:make_sense"        # sim.sensing.touch.TouchContext -> sense
    [project.entry-points."opposable.controllers"]
    my_control = "my_package:MyController"   # plan -> controller

Names of this package come first. Nothing of others is imported before its name is asked for.
"""

from __future__ import annotations

from functools import lru_cache
from importlib.metadata import EntryPoint, entry_points
from typing import Any

from planner.errors import ModelError

PREFIX = "opposable."
"""How the groups of entry points begin."""


@lru_cache
def _brought(group: str) -> dict[str, EntryPoint]:
    return {entry.name: entry for entry in entry_points(group=PREFIX + group)}


def plugin_names(group: str) -> tuple[str, ...]:
    """Names that installed packages bring for a group such as "hands", sorted."""
    return tuple(sorted(_brought(group)))


def plugin(group: str, name: str) -> Any:
    """What an installed package brings under a name; None if none brings it.

    Raises:
        ModelError: It cannot be imported.
    """
    entry = _brought(group).get(name)
    if entry is None:
        return None
    try:
        return entry.load()
    except (ImportError, AttributeError) as error:
        whose = entry.dist.name if entry.dist else "a package"
        raise ModelError(
            f"{whose} brings {name!r} as {entry.value} for {PREFIX}{group}, and that cannot be "
            f"imported: {error}; mend or uninstall it"
        ) from error


def forget_plugins() -> None:
    """Look for installed packages again, once one was installed while this process runs."""
    _brought.cache_clear()
