"""``Touch``: contacts that are not between hand and object, and collisions of the hand."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias

from sim.contacts.reading import NO_FORCE, contact_forces
from sim.scene import HAND_PREFIX, OBJECT, OBSTACLE_PREFIX, TABLE, Scene

TouchKind: TypeAlias = Literal[
    "hand-hand", "hand-table", "hand-obstacle", "object-table", "object-obstacle"
]


@dataclass(frozen=True, kw_only=True)
class Touch:
    """A contact that is not between hand and object.

    Attributes:
        kind: Who touches whom.
        first: Geom name without the hand's prefix.
        second: Geom name of the other.
        normal_force: N, >= 0.
    """

    kind: TouchKind
    first: str
    second: str
    normal_force: float


def other_touches(scene: Scene, data: Any) -> list[Touch]:
    """Loaded contacts that are not between hand and object."""
    forces = contact_forces(scene.model, data)[:, 0].tolist()
    return _touches(scene, data.contact.geom.tolist(), forces)


def collisions(
    scene: Scene, geoms: Sequence[Sequence[int]], forces: Sequence[float]
) -> tuple[str, float]:
    """The pair with the largest normal force (N) of hand on table, obstacle or itself; "" and 0.

    Args:
        scene: What the geoms belong to.
        geoms: Pairs of geoms that touch.
        forces: Their normal forces, N.
    """
    hits: dict[str, float] = defaultdict(float)
    for touch in _touches(scene, geoms, forces):
        if touch.kind.startswith("hand"):
            hits[f"{touch.first} - {touch.second}"] += touch.normal_force
    return max(hits.items(), key=lambda hit: hit[1], default=("", 0.0))


def _touches(scene: Scene, geoms: Sequence[Sequence[int]], forces: Sequence[float]) -> list[Touch]:
    """Those of some contacts that are loaded, and not between hand and object."""
    touches = []
    for (first, second), force in zip(geoms, forces, strict=True):
        if force <= NO_FORCE:
            continue
        sides = {_side(scene, first): first, _side(scene, second): second}
        kind = _kind(set(sides))
        if kind is None:
            continue
        pair = [sides[side] for side in kind.split("-")] if len(sides) == 2 else [first, second]
        names = [_name(scene, geom) for geom in pair]
        touches.append(
            Touch(
                kind=kind,
                first=names[0].removeprefix(HAND_PREFIX),
                second=names[1].removeprefix(HAND_PREFIX).removeprefix(OBSTACLE_PREFIX),
                normal_force=force,
            )
        )
    return touches


def _side(scene: Scene, geom: int) -> str:
    if geom in scene.finger_of_geom:
        return "hand"
    if int(scene.model.geom_bodyid[geom]) == scene.object_body:
        return "object"
    return "table" if scene.model.geom(geom).name == TABLE else "obstacle"


def _name(scene: Scene, geom: int) -> str:
    """Name of a geom; the pieces of an object all bear the object's."""
    if int(scene.model.geom_bodyid[geom]) == scene.object_body:
        return OBJECT
    name: str = scene.model.geom(geom).name
    return name


def _kind(sides: set[str]) -> TouchKind | None:
    kinds: dict[frozenset[str], TouchKind] = {
        frozenset({"hand"}): "hand-hand",
        frozenset({"hand", "table"}): "hand-table",
        frozenset({"hand", "obstacle"}): "hand-obstacle",
        frozenset({"object", "table"}): "object-table",
        frozenset({"object", "obstacle"}): "object-obstacle",
    }
    return kinds.get(frozenset(sides))
