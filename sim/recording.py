"""What is recorded over time: ``Samples``, which are judged, and a ``Recording`` of the states.

Both are tables of named channels. A channel is one field and one column that ``sim.recorder``
makes: its name in files, which says the unit, its type or decimals, and its columns stand with it;
arrays, JSON and the schema of the file follow from that. Whoever reads a report can show the motion
of a recording, or compute it again with any engine: joints by name, poses of base and object,
contacts and commands.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, fields, replace
from functools import cached_property, lru_cache
from itertools import islice
from types import GenericAlias, MappingProxyType
from typing import TYPE_CHECKING, Annotated, Any, Self, TypeAlias, get_args, get_type_hints

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import create_model

from planner.arrays import LARGEST_FLOAT, finite
from planner.contacts import ContactSet
from planner.errors import FileFormatError
from planner.quality import closure_of_wrenches
from planner.quality.closure import contact_wrenches
from planner.schema import StrictData
from planner.spatial import SE3, FloatArray, IntArray, pose_from_wxyz
from planner.tolerances import CLOSURE_EDGES
from sim.controllers.base import Phase

__all__ = [
    "PALM",
    "Channel",
    "ChannelTable",
    "Recording",
    "RecordingData",
    "SampleData",
    "Samples",
]

BoolArray: TypeAlias = NDArray[np.bool_]

LATER = ("closed", "closed_unmerged", "epsilon")
"""Fields that may be computed when one of them is first asked for: 1 to 3 ms per sample."""

_JSON: dict[type, Any] = {float: float | None, int: int, bool: bool, str: str, tuple: list[str]}
"""Type of a channel -> type of one of its values in a file."""


@dataclass(frozen=True)
class Channel:
    """What belongs to a field of a ``ChannelTable``.

    Attributes:
        key: Its name in files, which says the unit.
        kind: float (NaN where unknown), int and bool are arrays; str and tuple stay as they are.
        shape: Shape of a sample, after the fingers.
        per_finger: Whether a sample has a value for every finger that takes part.
        scale: What its values are multiplied by for a file.
    """

    key: str
    kind: type = float
    shape: tuple[int, ...] = ()
    per_finger: bool = False
    scale: float = 1.0

    def values(self, column: Any, n_fingers: int) -> Any:
        """A column of values as the field has it."""
        if self.kind in (str, tuple):
            return tuple(column)
        fingers = (n_fingers,) if self.per_finger else ()
        return np.array(column, dtype=self.kind).reshape(-1, *fingers, *self.shape)

    def to_file(self, values: Any) -> Any:
        """The field's values as a file has them; what is not a finite number becomes None."""
        return finite(values if self.scale == 1.0 else self.scale * values)

    @property
    def in_file(self) -> Any:
        """Its type in a file."""
        kind = _JSON[self.kind]
        for _ in range(1 + self.per_finger + len(self.shape)):
            kind = GenericAlias(list, kind)
        return kind


class ChannelTable:
    """What is recorded over time: m samples of named channels.

    A subclass is a dataclass whose every field is annotated with its ``Channel``, ``phase`` among
    them.
    """

    phase: Annotated[tuple[Any, ...], Channel("phase", str)]

    @classmethod
    @lru_cache
    def channels(cls) -> Mapping[str, Channel]:
        """Name of the field -> its channel, in the order of the fields."""
        hints = get_type_hints(cls, include_extras=True)
        return MappingProxyType(
            {
                one.name: next(p for p in get_args(hints[one.name]) if isinstance(p, Channel))
                for one in fields(cls)  # type: ignore[arg-type]
            }
        )

    @classmethod
    def of(
        cls,
        columns: Mapping[str, Any],
        n_fingers: int,
        *,
        later: Callable[[], Mapping[str, Any]] | None = None,
    ) -> Self:
        """A table out of columns by the names of the fields.

        Args:
            columns: A value per sample for every field, or all but those that come later.
            n_fingers: Fingers that take part.
            later: Gives the columns ``LATER``, called when one of them is asked for.
        """
        made, channels = object.__new__(cls), cls.channels()
        for name, column in columns.items():
            made.__dict__[name] = channels[name].values(column, n_fingers)
        if later is not None:
            made.__dict__["_later"] = later
        return made

    if not TYPE_CHECKING:

        def __getattr__(self, name: str) -> Any:
            """Called for what is not there yet: the columns that come later."""
            later = self.__dict__.get("_later")
            if name not in LATER or later is None:
                raise AttributeError(f"{type(self).__name__!r} has no attribute {name!r}")
            channels = self.channels()
            for key, column in later().items():
                self.__dict__[key] = channels[key].values(column, 0)
            del self.__dict__["_later"]
            return self.__dict__[name]

    def __getstate__(self) -> dict[str, Any]:
        """How it is sent to another process: whole."""
        return {name: getattr(self, name) for name in self.channels()}

    def to_dict(self) -> dict[str, Any]:
        """Lists by the channels' names in files; what is not a finite number becomes None."""
        return {c.key: c.to_file(getattr(self, name)) for name, c in self.channels().items()}

    def __len__(self) -> int:
        """Number of samples."""
        return len(self.phase)

    def during(self, *phases: str) -> IntArray:
        """Numbers of the samples that belong to some phases."""
        return np.flatnonzero(np.isin(np.array(self.phase, dtype=str), phases))

    @classmethod
    def data_model(cls, name: str, meaning: str, **more: Any) -> Any:
        """The pydantic model of a table in a file.

        Args:
            name: Of the model.
            meaning: Its docstring.
            more: Types of further columns by their names.
        """
        columns: dict[str, Any] = {c.key: (c.in_file, ...) for c in cls.channels().values()}
        columns |= {key: (kind, ...) for key, kind in more.items()}
        return create_model(name, __base__=StrictData, __doc__=meaning, **columns)


@dataclass(frozen=True, kw_only=True, eq=False)
class Samples(ChannelTable):
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


if TYPE_CHECKING:
    SampleData = StrictData
else:
    SampleData = Samples.data_model(
        "SampleData", "Recorded over time; lists per finger follow ``fingers``."
    )


PALM = "palm"
"""Column of the contacts with what belongs to no finger."""

LENGTH, ANGLE, FORCE, SHARE = 6, 5, 3, 6
"""Decimals in files: 1e-6 m, 1e-5 rad, 1e-3 N, 1e-6 of what has no unit."""

Numbers = list[list[float | None]]
Vectors = list[list[list[float | None]]]


class RecordingData(StrictData):
    """A recording in a file: a row per sample; null where there is no contact or no limit.

    Poses are x, y, z (m) and a quaternion w, x, y, z. Joints and commands are in rad, m or N m, as
    the hand's model has them. Columns of contacts follow ``contact_names``: those of a finger are
    merged into one. What the controller read stands beside the truth where it was something else.
    """

    joint_names: list[str]
    actuator_names: list[str]
    actuator_control_range: Numbers
    contact_names: list[str]
    time_s: list[float]
    phase: list[str]
    q_rad: Numbers
    T_world_base_m: Numbers
    T_world_object_m: Numbers
    contact_position_world_m: Vectors
    contact_normal_into_object_world: Vectors
    contact_force_on_object_world_N: Vectors
    contact_mu: Numbers
    contact_mu_torsion_m: Numbers
    commands: Numbers
    normalised_min_weight: list[float | None]
    read_q_rad: Numbers | None = None
    read_T_world_object_m: Numbers | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class Recording:
    """States over time: m samples, k columns of contacts.

    Contacts and forces are those of the time step that ended at the sample's time. Poses are
    (x, y, z, qw, qx, qy, qz), m, world.

    Attributes:
        joint_names: nq names, the order of ``q``.
        actuator_names: nu names, the order of ``commands``.
        control_range: (nu, 2), smallest and largest command; infinite without a limit.
        contact_names: Fingers that take part, then whatever else touched: other fingers, ``PALM``.
        time: (m,), s.
        phase: m phases.
        q: (m, nq), rad, m for slides.
        T_world_base: (m, 7).
        T_world_object: (m, 7).
        points: (m, k, 3), contacts merged per finger, m, world; NaN without contact.
        normals: (m, k, 3), unit, into the object.
        forces: (m, k, 3), on the object, N, world.
        friction: (m, k, 2), sliding (-) and torsional (m) friction of the contact.
        commands: (m, nu), to the hand's actuators.
        read_q: (m, nq), what the controller read of the joints at the beginning of the time step
            that ended at the sample's time; NaN before the first. None where it read the truth.
        read_T_world_object: (m, 7), the same of the object's pose: a reading or an estimate.
    """

    joint_names: tuple[str, ...]
    actuator_names: tuple[str, ...]
    control_range: FloatArray
    contact_names: tuple[str, ...]
    time: FloatArray
    phase: tuple[str, ...]
    q: FloatArray
    T_world_base: FloatArray
    T_world_object: FloatArray
    points: FloatArray
    normals: FloatArray
    forces: FloatArray
    friction: FloatArray
    commands: FloatArray
    read_q: FloatArray | None = None
    read_T_world_object: FloatArray | None = None

    def __post_init__(self) -> None:
        """Check that shapes fit.

        Raises:
            FileFormatError: They do not.
        """
        m, k = len(self.time), len(self.contact_names)
        sizes = {"nq": len(self.joint_names), "nu": len(self.actuator_names), "k": k}
        nq, nu = sizes["nq"], sizes["nu"]
        wanted = {"control_range": (nu, 2), "friction": (m, k, 2)}
        wanted |= {name: (m, *state.shape(sizes)) for name, state in STATES.items()}
        if self.read_q is None and self.read_T_world_object is None:
            del wanted["read_q"], wanted["read_T_world_object"]
        for name, shape in wanted.items():
            found = np.shape(getattr(self, name))
            if found != shape:
                raise FileFormatError(
                    f"the recording's {name} has shape {found}; {m} samples of {nq} joints, "
                    f"{nu} actuators and {k} contacts need {shape}; it is damaged"
                )
        if len(self.phase) != m:
            raise FileFormatError(
                f"the recording has {len(self.phase)} phases for {m} samples; it is damaged"
            )

    def __len__(self) -> int:
        """Number of samples."""
        return len(self.phase)

    def poses(self, i: int) -> tuple[SE3, SE3]:
        """Poses of hand base and object in sample i, world."""
        base, item = self.T_world_base[i], self.T_world_object[i]
        return pose_from_wxyz(base[:3], base[3:]), pose_from_wxyz(item[:3], item[3:])

    def contacts(self, i: int) -> ContactSet:
        """Contacts of sample i, world, merged per finger, with the simulation's friction.

        Their tangents are those of ``contact_frames``, not the simulator's; the object's centre of
        mass is the origin of its frame.
        """
        return self._contacts(np.arange(len(self)) == i, center=self.T_world_object[i, :3])

    @cached_property
    def min_weight(self) -> FloatArray:
        """Normalised min-weight (m,), at most 1, of the contacts of each sample; > 0 is closure.

        That of ``force_closure`` with the edges of plans; -inf where nothing touches. Takes about
        0.2 ms per sample, when first asked for.
        """
        # all contacts about the object they touch, so that their wrenches are made at once
        relative = replace(self, points=self.points - self.T_world_object[:, None, :3])
        every = relative._contacts(np.ones(len(self), dtype=bool), center=np.zeros(3))
        wrenches = iter(contact_wrenches(every, CLOSURE_EDGES))
        counts = np.isfinite(self.points[..., 0]).sum(axis=1)
        none = np.zeros((6, 0))
        return np.array(
            [
                closure_of_wrenches(np.hstack([none, *islice(wrenches, n)])).normalised_min_weight
                for n in counts.tolist()
            ]
        )

    def _contacts(self, samples: NDArray[np.bool_], center: FloatArray) -> ContactSet:
        """The contacts of some samples (m,) in one set."""
        touching = np.isfinite(self.points[..., 0]) & samples[:, None]
        mu, torsion = self.friction[touching].T
        return ContactSet.from_arrays(
            self.points[touching],
            self.normals[touching],
            mu=mu,
            mu_torsion=torsion,
            model=["soft" if t > 0 else "point" for t in torsion],
            center=center,
            fingers=[self.contact_names[k] for k in np.nonzero(touching)[1]],
        )

    def to_dict(self) -> dict[str, Any]:
        """Plain data that follows ``RecordingData``, rounded."""
        return {
            "joint_names": list(self.joint_names),
            "actuator_names": list(self.actuator_names),
            "actuator_control_range": finite(self.control_range),
            "contact_names": list(self.contact_names),
            "phase": list(self.phase),
            "contact_mu": _rounded(self.friction[..., 0], SHARE),
            "contact_mu_torsion_m": _rounded(self.friction[..., 1], LENGTH),
            "normalised_min_weight": _rounded(self.min_weight, SHARE),
            **{s.key: _rounded(getattr(self, n), s.decimals) for n, s in STATES.items()},
        }

    @classmethod
    def from_data(cls, data: RecordingData) -> Recording:
        """From a file.

        Raises:
            FileFormatError: Rows differ in length.
        """
        m, k = len(data.time_s), len(data.contact_names)
        sizes = {"nq": len(data.joint_names), "nu": len(data.actuator_names), "k": k}
        unlimited = _array(data.actuator_control_range, (sizes["nu"], 2))
        unlimited[:, 0] = np.nan_to_num(unlimited[:, 0], nan=-np.inf, neginf=-np.inf)
        unlimited[:, 1] = np.nan_to_num(unlimited[:, 1], nan=np.inf, posinf=np.inf)
        over_time: dict[str, Any] = {}
        for name, state in STATES.items():
            rows = getattr(data, state.key)
            over_time[name] = None if rows is None else _array(rows, (m, *state.shape(sizes)))
        made = cls(
            joint_names=tuple(data.joint_names),
            actuator_names=tuple(data.actuator_names),
            control_range=unlimited,
            contact_names=tuple(data.contact_names),
            phase=tuple(data.phase),
            friction=np.stack(
                [_array(v, (m, k)) for v in (data.contact_mu, data.contact_mu_torsion_m)], axis=-1
            ),
            **over_time,
        )
        weight = _array(data.normalised_min_weight, (m,))
        # what the file says, not computed again from rounded contacts
        made.__dict__["min_weight"] = np.where(np.isnan(weight), -np.inf, weight)
        return made

    def joined(self, later: Recording, shift: float) -> Recording:
        """This recording and a later one of the same hand and fingers, one after the other.

        Args:
            later: What follows; its time counts from its own beginning.
            shift: Time (s) that its beginning has on this one's axis.

        Raises:
            FileFormatError: They are of different hands.
        """
        if (self.joint_names, self.actuator_names) != (later.joint_names, later.actuator_names):
            raise FileFormatError("two recordings of different hands cannot be joined")
        names = tuple(dict.fromkeys((*self.contact_names, *later.contact_names)))
        both = [one.with_columns(names) for one in (self, later)]
        whole = {
            f.name: np.concatenate([getattr(one, f.name) for one in both])
            for f in fields(self)
            if f.name == "friction" or (f.name in STATES and f.default is not None)
        }
        for name in ("read_q", "read_T_world_object"):
            parts = [getattr(one, name) for one in both]
            if any(part is not None for part in parts):  # one that read the truth has no readings
                width = next(part.shape[1] for part in parts if part is not None)
                nothing = [np.full((len(one), width), np.nan) for one in both]
                whole[name] = np.concatenate(
                    [n if part is None else part for part, n in zip(parts, nothing, strict=True)]
                )
        whole["time"] = np.concatenate([self.time, later.time + shift])
        made = Recording(
            joint_names=self.joint_names,
            actuator_names=self.actuator_names,
            control_range=self.control_range,
            contact_names=names,
            phase=(*self.phase, *later.phase),
            **whole,
        )
        made.__dict__["min_weight"] = np.concatenate([self.min_weight, later.min_weight])
        return made

    def with_columns(self, names: Iterable[str]) -> Recording:
        """The same with these columns of contacts; NaN for those that it does not have."""
        names = tuple(names)
        where = [names.index(name) for name in self.contact_names]
        wider = {}
        for key in ("points", "normals", "forces", "friction"):
            old = getattr(self, key)
            wider[key] = np.full((len(self), len(names), old.shape[2]), np.nan)
            wider[key][:, where] = old
        same = {f.name: getattr(self, f.name) for f in fields(self)}
        made = Recording(**{**same, **wider, "contact_names": names})
        if "min_weight" in self.__dict__:
            made.__dict__["min_weight"] = self.min_weight
        return made


@dataclass(frozen=True)
class State:
    """What belongs to a field of ``Recording`` that is an array with a row per sample.

    Attributes:
        key: Its name in files, which says the unit.
        decimals: Of its numbers in files.
        columns: Sizes of a row; "nq", "nu" and "k" are those of joints, actuators and contacts.
    """

    key: str
    decimals: int
    columns: tuple[int | str, ...] = ()

    def shape(self, sizes: Mapping[str, int]) -> tuple[int, ...]:
        """Sizes of a row of one recording."""
        return tuple(size if isinstance(size, int) else sizes[size] for size in self.columns)


STATES: Mapping[str, State] = MappingProxyType(
    {
        "time": State("time_s", LENGTH),
        "q": State("q_rad", ANGLE, ("nq",)),
        "T_world_base": State("T_world_base_m", LENGTH, (7,)),
        "T_world_object": State("T_world_object_m", LENGTH, (7,)),
        "points": State("contact_position_world_m", LENGTH, ("k", 3)),
        "normals": State("contact_normal_into_object_world", LENGTH, ("k", 3)),
        "forces": State("contact_force_on_object_world_N", FORCE, ("k", 3)),
        "commands": State("commands", ANGLE, ("nu",)),
        "read_q": State("read_q_rad", ANGLE, ("nq",)),
        "read_T_world_object": State("read_T_world_object_m", LENGTH, (7,)),
    }
)
"""Name of the field -> what belongs to it; friction has two names in files, one per number."""


def _rounded(values: FloatArray | None, decimals: int) -> Any:
    """Lists of rounded numbers, None for what is not finite or not there; no negative zero."""
    if values is None:
        return None
    rounded = np.round(values, decimals) + 0.0
    known = np.isfinite(rounded)
    rounded = np.clip(rounded, -LARGEST_FLOAT, LARGEST_FLOAT)  # as ``finite``
    if known.all():
        return rounded.tolist()
    out = rounded.astype(object)
    out[~known] = None
    return out.tolist()


def _array(rows: ArrayLike | Any, shape: tuple[int, ...]) -> FloatArray:
    """Numbers of a file, None as NaN, in a shape.

    Raises:
        FileFormatError: They have another.
    """
    try:
        return np.array(rows, dtype=np.float64).reshape(shape)
    except (ValueError, TypeError) as error:
        raise FileFormatError(f"the recording's rows differ in length: {error}") from error
