"""``Registry``: things of one kind by name, ours and those that others add.

What is added is found by name wherever such a thing is named: on the command line, in files, in
options. Other installed packages add to it by their entry points: a package names a group and what
it brings in its ``pyproject.toml``::

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

from collections.abc import Callable, Iterator, Mapping, MutableMapping
from functools import lru_cache
from importlib import import_module
from importlib.metadata import EntryPoint, entry_points
from typing import Any, Generic, TypeVar

from planner.errors import ModelError, NotFoundError, PlannerError, TaskError, shown

__all__ = ["Registry"]


T = TypeVar("T")


class _Home(str):
    """Where a thing is that was not asked for yet: "module:attribute"."""


class Registry(MutableMapping[str, T], Generic[T]):
    """A mapping of names to things, in the order in which they were added.

    Attributes:
        kind: What a message calls one of them, for example "shape".
        group: Group of ``planner.registry`` by which packages add some; "" for none.
    """

    def __init__(
        self,
        kind: str,
        *,
        group: str = "",
        error: type[PlannerError] = TaskError,
        check: Callable[[str, T], None] | None = None,
    ) -> None:
        """Begin empty.

        Args:
            kind: What a message calls one of them.
            group: Group of entry points.
            error: What is raised where something cannot be added.
            check: Raises ``error`` if a thing is not usable under a name.
        """
        self.kind, self.group = kind, group
        self._error, self._check = error, check
        self._known: dict[str, T | _Home] = {}

    def add(self, name: str, thing: T) -> T:
        """Add a thing; the same one may be added again.

        Raises:
            PlannerError: ``error`` of the registry: the name is another's, or it is not usable.
        """
        if name in self._known and self[name] is not thing:
            known = getattr(self._known[name], "__name__", "there")
            raise self._error(f"{self.kind} {shown(name)} is {known} already; choose another name")
        if self._check is not None:
            self._check(name, thing)
        self._known[name] = thing
        return thing

    def add_homes(self, homes: Mapping[str, str]) -> None:
        """Add names of ours whose things are imported when they are first asked for.

        Args:
            homes: Name -> "module:attribute".

        Raises:
            PlannerError: ``error`` of the registry: a name is another's.
        """
        if taken := sorted(homes.keys() & self._known.keys()):
            raise self._error(f"{self.kind} {', '.join(taken)} is there already; choose another")
        self._known |= {name: _Home(home) for name, home in homes.items()}

    def named(self, name: str, hint: str = "") -> T:
        """The thing of a name.

        Args:
            name: Its name.
            hint: What else the user can do, a sentence for the message.

        Raises:
            NotFoundError: There is none.
        """
        if name not in self:
            raise NotFoundError(self.kind, name, self, hint)
        return self[name]

    def _brought(self) -> tuple[str, ...]:
        """Names that other packages bring; none is loaded."""
        return plugin_names(self.group) if self.group else ()

    def __getitem__(self, name: str) -> T:
        """The thing of a name; KeyError if there is none."""
        if name not in self._known and name in self._brought():
            thing: T = plugin(self.group, name)
            if self._check is not None:
                self._check(name, thing)
            return thing
        known = self._known[name]
        if isinstance(known, _Home):
            module, _, attribute = known.partition(":")
            found: T = getattr(import_module(module), attribute)
            self._known[name] = known = found
        return known

    def __setitem__(self, name: str, thing: T) -> None:
        """See ``add``."""
        self.add(name, thing)

    def __delitem__(self, name: str) -> None:
        """Forget a thing."""
        del self._known[name]

    def __contains__(self, name: object) -> bool:
        """Whether there is a thing of a name; it is not loaded."""
        return name in self._known or name in self._brought()

    def __iter__(self) -> Iterator[str]:
        """Names, ours in the order in which they were added, then those that packages bring."""
        yield from [*self._known, *(name for name in self._brought() if name not in self._known)]

    def __len__(self) -> int:
        """How many there are."""
        return len({*self._known, *self._brought()})


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
