"""``Recording``: states of a hand and an object over time, as numbers that need no simulator.

Whoever reads a report can show the motion, or compute it again with any engine: joints by name,
poses of base and object, contacts and commands. Its form in files is ``RecordingData``.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, fields, replace
from functools import cached_property
from itertools import islice
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planner.arrays import LARGEST_FLOAT, finite
from planner.contacts import ContactSet
from planner.errors import FileFormatError
from planner.quality import closure_of_wrenches
from planner.quality.cones import contact_wrenches
from planner.schema import StrictData
from planner.spatial import FloatArray
from planner.tolerances import CLOSURE_EDGES

__all__ = ["PALM", "Recording", "RecordingData"]

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
        nq, nu = len(self.joint_names), len(self.actuator_names)
        wanted = {
            "control_range": (nu, 2),
            "time": (m,),
            "q": (m, nq),
            "T_world_base": (m, 7),
            "T_world_object": (m, 7),
            "points": (m, k, 3),
            "normals": (m, k, 3),
            "forces": (m, k, 3),
            "friction": (m, k, 2),
            "commands": (m, nu),
        }
        if self.read_q is not None or self.read_T_world_object is not None:
            wanted |= {"read_q": (m, nq), "read_T_world_object": (m, 7)}
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
            "time_s": _rounded(self.time, LENGTH),
            "phase": list(self.phase),
            "q_rad": _rounded(self.q, ANGLE),
            "T_world_base_m": _rounded(self.T_world_base, LENGTH),
            "T_world_object_m": _rounded(self.T_world_object, LENGTH),
            "contact_position_world_m": _rounded(self.points, LENGTH),
            "contact_normal_into_object_world": _rounded(self.normals, LENGTH),
            "contact_force_on_object_world_N": _rounded(self.forces, FORCE),
            "contact_mu": _rounded(self.friction[..., 0], SHARE),
            "contact_mu_torsion_m": _rounded(self.friction[..., 1], LENGTH),
            "commands": _rounded(self.commands, ANGLE),
            "normalised_min_weight": _rounded(self.min_weight, SHARE),
            "read_q_rad": _rounded_or_none(self.read_q, ANGLE),
            "read_T_world_object_m": _rounded_or_none(self.read_T_world_object, LENGTH),
        }

    @classmethod
    def from_data(cls, data: RecordingData) -> Recording:
        """From a file.

        Raises:
            FileFormatError: Rows differ in length.
        """
        m, k = len(data.time_s), len(data.contact_names)
        nq, nu = len(data.joint_names), len(data.actuator_names)
        unlimited = _array(data.actuator_control_range, (nu, 2))
        unlimited[:, 0] = np.nan_to_num(unlimited[:, 0], nan=-np.inf, neginf=-np.inf)
        unlimited[:, 1] = np.nan_to_num(unlimited[:, 1], nan=np.inf, posinf=np.inf)
        made = cls(
            joint_names=tuple(data.joint_names),
            actuator_names=tuple(data.actuator_names),
            control_range=unlimited,
            contact_names=tuple(data.contact_names),
            time=np.array(data.time_s, dtype=np.float64),
            phase=tuple(data.phase),
            q=_array(data.q_rad, (m, nq)),
            T_world_base=_array(data.T_world_base_m, (m, 7)),
            T_world_object=_array(data.T_world_object_m, (m, 7)),
            points=_array(data.contact_position_world_m, (m, k, 3)),
            normals=_array(data.contact_normal_into_object_world, (m, k, 3)),
            forces=_array(data.contact_force_on_object_world_N, (m, k, 3)),
            friction=np.stack(
                [_array(v, (m, k)) for v in (data.contact_mu, data.contact_mu_torsion_m)], axis=-1
            ),
            commands=_array(data.commands, (m, nu)),
            read_q=_array_or_none(data.read_q_rad, (m, nq)),
            read_T_world_object=_array_or_none(data.read_T_world_object_m, (m, 7)),
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
            if f.name in _OVER_TIME
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


_OVER_TIME = {
    "time",
    "q",
    "T_world_base",
    "T_world_object",
    "points",
    "normals",
    "forces",
    "friction",
    "commands",
}
"""Fields that are arrays with a row per sample."""


def _rounded(values: FloatArray, decimals: int) -> Any:
    """Lists of rounded numbers, None for what is not finite; no negative zero."""
    rounded = np.round(values, decimals) + 0.0
    known = np.isfinite(rounded)
    rounded = np.clip(rounded, -LARGEST_FLOAT, LARGEST_FLOAT)  # as ``finite``
    if known.all():
        return rounded.tolist()
    out = rounded.astype(object)
    out[~known] = None
    return out.tolist()


def _rounded_or_none(values: FloatArray | None, decimals: int) -> Any:
    """The same, None for none at all."""
    return None if values is None else _rounded(values, decimals)


def _array_or_none(rows: Any, shape: tuple[int, ...]) -> FloatArray | None:
    """``_array``, None for none at all."""
    return None if rows is None else _array(rows, shape)


def _array(rows: ArrayLike | Any, shape: tuple[int, ...]) -> FloatArray:
    """Numbers of a file, None as NaN, in a shape.

    Raises:
        FileFormatError: They have another.
    """
    try:
        return np.array(rows, dtype=np.float64).reshape(shape)
    except (ValueError, TypeError) as error:
        raise FileFormatError(f"the recording's rows differ in length: {error}") from error
