"""``Samples``: what was recorded over time. Its fields are the one table of channels.

A channel is one field of ``Samples`` and one column that ``sim.recorder`` makes. Its name in
files, its type and whether it has a column per finger stand with the field; arrays, JSON and the
schema of the file follow from that.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import GenericAlias, MappingProxyType
from typing import TYPE_CHECKING, Annotated, Any, TypeAlias, get_args, get_type_hints

import numpy as np
from numpy.typing import NDArray
from pydantic import create_model

from planner.arrays import finite
from planner.schema import StrictData
from planner.spatial import FloatArray, IntArray
from sim.controllers.base import Phase

__all__ = ["CHANNELS", "Channel", "SampleData", "Samples"]

BoolArray: TypeAlias = NDArray[np.bool_]

LATER = ("closed", "closed_unmerged", "epsilon")
"""Fields that may be computed when one of them is first asked for: 1 to 3 ms per sample."""

_JSON: dict[type, Any] = {float: float | None, int: int, bool: bool, str: str, tuple: list[str]}
"""Type of a channel -> type of one of its values in a file."""


@dataclass(frozen=True)
class Channel:
    """What belongs to a field of ``Samples``.

    Attributes:
        key: Its name in files, which says the unit.
        kind: float (NaN where unknown), int and bool are arrays; str and tuple stay as they are.
        per_finger: Whether it has a column for every finger that takes part.
    """

    key: str
    kind: type = float
    per_finger: bool = False

    def values(self, column: Any, n_fingers: int) -> Any:
        """A column of values as the field has it."""
        if self.kind in (str, tuple):
            return tuple(column)
        shape = (-1, n_fingers) if self.per_finger else (-1,)
        return np.array(column, dtype=self.kind).reshape(shape)

    @property
    def in_file(self) -> Any:
        """Its type in a file."""
        value = GenericAlias(list, _JSON[self.kind])
        return GenericAlias(list, value) if self.per_finger else value


@dataclass(frozen=True, kw_only=True, eq=False)
class Samples:
    """What was recorded over time, m samples, n fingers that take part.

    Attributes:
        time: (m,), s.
        phase: m phases.
        contacts: (m, n), number of contacts that MuJoCo reports per finger.
        palm_contacts: (m,), contacts of the object with the rest of the hand.
        normal_force: (m, n), N.
        friction_utilisation: (m, n), share of the friction cone in use, merged per finger (-); NaN
            without contact.
        closed: (m,), force closure of the contacts merged per finger.
        closed_unmerged: (m,), force closure of all contacts as they are.
        epsilon: (m,), L1 epsilon of the merged contacts (-).
        slip_mm: (m,), movement of the object relative to the palm since the end of the squeeze;
            NaN before.
        slip_deg: (m,), rotation likewise.
        moved_mm: (m,), movement of the object in the world since the start.
        turned_deg: (m,), rotation likewise.
        lift_mm: (m,), rise of the object's centre of mass.
        collision_N: (m,), largest normal force of hand on table, obstacle or itself.
        collision: m names of the pair with that force, "" without.
        saturated: m tuples with the names of actuators at their limit.
    """

    time: Annotated[FloatArray, Channel("time_s")]
    phase: Annotated[tuple[Phase, ...], Channel("phase", str)]
    contacts: Annotated[IntArray, Channel("contacts_per_finger", int, per_finger=True)]
    palm_contacts: Annotated[IntArray, Channel("palm_contacts", int)]
    normal_force: Annotated[FloatArray, Channel("normal_force_N", per_finger=True)]
    friction_utilisation: Annotated[FloatArray, Channel("friction_utilisation", per_finger=True)]
    closed: Annotated[BoolArray, Channel("closed", bool)]
    closed_unmerged: Annotated[BoolArray, Channel("closed_unmerged", bool)]
    epsilon: Annotated[FloatArray, Channel("epsilon")]
    slip_mm: Annotated[FloatArray, Channel("object_in_palm_moved_mm")]
    slip_deg: Annotated[FloatArray, Channel("object_in_palm_turned_deg")]
    moved_mm: Annotated[FloatArray, Channel("object_moved_mm")]
    turned_deg: Annotated[FloatArray, Channel("object_turned_deg")]
    lift_mm: Annotated[FloatArray, Channel("lift_mm")]
    collision_N: Annotated[FloatArray, Channel("collision_N")]
    collision: Annotated[tuple[str, ...], Channel("collision", str)]
    saturated: Annotated[tuple[tuple[str, ...], ...], Channel("actuators_at_limit", tuple)]

    @classmethod
    def of(
        cls,
        columns: Mapping[str, Any],
        n_fingers: int,
        *,
        later: Callable[[], Mapping[str, Any]] | None = None,
    ) -> Samples:
        """Samples out of columns by the names of the fields.

        Args:
            columns: A value per sample for every field, or all but those that come later.
            n_fingers: Fingers that take part.
            later: Gives the columns ``LATER``, called when one of them is asked for.
        """
        made = object.__new__(cls)
        for name, column in columns.items():
            made.__dict__[name] = CHANNELS[name].values(column, n_fingers)
        if later is not None:
            made.__dict__["_later"] = later
        return made

    if not TYPE_CHECKING:

        def __getattr__(self, name: str) -> Any:
            """Called for what is not there yet: the columns that come later."""
            later = self.__dict__.get("_later")
            if name not in LATER or later is None:
                raise AttributeError(f"{type(self).__name__!r} has no attribute {name!r}")
            for key, column in later().items():
                self.__dict__[key] = CHANNELS[key].values(column, 0)
            del self.__dict__["_later"]
            return self.__dict__[name]

    def __getstate__(self) -> dict[str, Any]:
        """How it is sent to another process: whole."""
        return {name: getattr(self, name) for name in CHANNELS}

    def to_dict(self) -> dict[str, Any]:
        """Lists by the channels' names in files; what is not a finite number becomes None."""
        return {c.key: finite(getattr(self, name)) for name, c in CHANNELS.items()}

    def __len__(self) -> int:
        """Number of samples."""
        return len(self.phase)

    def during(self, *phases: Phase) -> IntArray:
        """Numbers of the samples that belong to some phases."""
        return np.flatnonzero(np.isin(np.array(self.phase, dtype=str), phases))


CHANNELS: Mapping[str, Channel] = MappingProxyType(
    {
        name: next(part for part in get_args(hint) if isinstance(part, Channel))
        for name, hint in get_type_hints(Samples, include_extras=True).items()
    }
)
"""Name of the field -> its channel, in order."""

if TYPE_CHECKING:
    SampleData = StrictData
else:
    SampleData = create_model(
        "SampleData",
        __base__=StrictData,
        __doc__="Recorded over time; lists per finger follow ``fingers``.",
        **{channel.key: (channel.in_file, ...) for channel in CHANNELS.values()},
    )
