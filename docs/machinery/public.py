"""Which names are public, where each is defined, and on which page of the reference it stands.

Public is what ``__all__`` says: of a room; of a package inside a room, if it has one; of each
module where a package has none. A name that several modules offer is documented in one of them.
"""

from __future__ import annotations

import ast
import pkgutil
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent.parent
PACKAGES = ("planner", "sim")
"""What a script imports from first: their names are those of rooms."""

NOT_FOR_SCRIPTS = ("sim.cli",)
"""Rooms that the page of the command line describes."""

GROUPS: dict[str, list[str]] = {
    "Hands": [
        "planner.hand_loading",
        "planner.hands",
        "planner.joints",
        "planner.describe",
        "planner.kinematics",
    ],
    "Objects and shapes": [
        "planner.objects",
        "planner.clouds",
        "planner.shapes",
    ],
    "Tasks and planning": [
        "planner.task",
        "planner.search",
        "planner.plan",
        "planner.synthesis",
        "planner.verification",
        "planner.failure",
        "planner.tolerances",
    ],
    "Contacts and grasp quality": [
        "planner.contacts",
        "planner.quality",
    ],
    "Contact forces": [
        "planner.forces",
    ],
    "Certificates": [
        "planner.certify",
    ],
    "Motions, gaits and manipulation": [
        "planner.motion",
        "sim.handover",
        "sim.manipulation",
        "sim.learning",
    ],
    "Many grasps and files": [
        "planner.batch",
        "planner.files",
        "planner.exchange",
        "planner.registry",
        "planner.schema",
    ],
    "Simulation and trials": [
        "sim.trial",
        "sim.report",
        "sim.verdict",
        "sim.simulation",
        "sim.scene",
        "sim.foreign",
        "sim.scan",
        "sim.recording",
        "sim.contacts",
        "sim.recorder",
        "sim.report_file",
        "sim.datasets",
    ],
    "Pages, pictures and films": [
        "sim.show",
        "planner.pages",
        "planner.showing",
    ],
    "Controllers": [
        "sim.controllers",
        "sim.sensing",
        "sim.real_hand",
    ],
    "Protocols": [
        "sim.protocols",
        "sim.creep",
    ],
    "Cross-checking models": [
        "sim.crosscheck",
        "planner.bridge",
    ],
    "Errors and conventions": [
        "planner.errors",
        "planner.spatial",
    ],
}
"""Title of a page -> its rooms, in the order in which people look for them."""

REST = "Geometry, numerics and tools"
"""Title of the page for all other rooms."""


@dataclass(frozen=True)
class PublicName:
    """A public name.

    Attributes:
        module: Where it is documented and imported from.
        name: The name.
        home: Module that defines it.
        home_name: What it is called there.
        shortcuts: Packages from which it can be imported too.
    """

    module: str
    name: str
    home: str
    home_name: str
    shortcuts: tuple[str, ...] = ()

    @property
    def full_name(self) -> str:
        """The dotted name under which it is documented."""
        return f"{self.module}.{self.name}"

    @property
    def value(self) -> object:
        """What the name means."""
        return getattr(import_module(self.module), self.name)


def rooms() -> list[str]:
    """Rooms of both packages from the bottom up, without those that only the command line needs."""
    text = (ROOT / "tests" / "rooms.toml").read_text(encoding="utf-8")
    listed = (f"{pkg}.{room}" for pkg, names in tomllib.loads(text).items() for room in names)
    return [room for room in listed if room not in NOT_FOR_SCRIPTS]


def groups() -> dict[str, list[str]]:
    """Title of a page -> its rooms; every room is on one page."""
    known = {room for listed in GROUPS.values() for room in listed}
    there = rooms()
    found = {title: [r for r in listed if r in there] for title, listed in GROUPS.items()}
    return {**found, REST: [room for room in there if room not in known]}


def offered(module: str) -> list[str]:
    """What a module's ``__all__`` says."""
    return list(getattr(import_module(module), "__all__", ()))


def faces(room: str) -> Iterator[str]:
    """Modules of a room whose names are public."""
    face = bool(offered(room))
    if face:
        yield room
    package = import_module(room)
    for child in pkgutil.iter_modules(getattr(package, "__path__", ())):
        name = f"{room}.{child.name}"
        if not face or (child.ispkg and offered(name)):
            yield from faces(name)


@cache
def imports(module: str) -> dict[str, tuple[str, str]]:
    """Name -> (module, name there) of what a module imports by name, for type checkers too."""
    spec = find_spec(module)
    assert spec is not None and spec.origin is not None
    tree = ast.parse(Path(spec.origin).read_text(encoding="utf-8"))
    return {
        alias.asname or alias.name: (node.module, alias.name)
        for node in ast.walk(tree)
        if isinstance(node, ast.ImportFrom) and node.module
        for alias in node.names
    }


def home_of(module: str, name: str) -> tuple[str, str]:
    """Module that defines a name, and its name there."""
    while name in imports(module) and imports(module)[name][0].split(".")[0] in PACKAGES:
        module, name = imports(module)[name]
    return module, name


@cache
def public_names() -> tuple[PublicName, ...]:
    """Every public name once, room by room."""
    offers: dict[tuple[str, str], list[tuple[str, str]]] = {}
    for room in rooms():
        for face in faces(room):
            for name in offered(face):
                offers.setdefault(home_of(face, name), []).append((face, name))
    short: dict[tuple[str, str], list[str]] = {}
    for package in PACKAGES:
        for name in offered(package):
            short.setdefault(home_of(package, name), []).append(package)
    return tuple(
        PublicName(*_nearest(home, where), *home, shortcuts=tuple(short.get(home, ())))
        for home, where in offers.items()
    )


def _nearest(home: tuple[str, str], where: list[tuple[str, str]]) -> tuple[str, str]:
    """Of the modules that offer a name the one it belongs to, and of those the shortest."""
    inside = [w for w in where if f"{home[0]}.".startswith(f"{w[0]}.")]
    return min(inside or where, key=lambda w: len(w[0]))


@cache
def documented() -> dict[str, str]:
    """Full name of a thing where it is defined -> where it is documented."""
    found = {f"{n.home}.{n.home_name}": n.full_name for n in public_names()}
    for name in public_names():
        value = name.value
        if isinstance(value, type):
            found.setdefault(f"{value.__module__}.{value.__qualname__}", name.full_name)
    return found
