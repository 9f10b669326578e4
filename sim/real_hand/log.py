"""``HandLog``: readings and commands of a run, a row per tick, in one ``.npz`` file by names.

The file holds plain arrays (``allow_pickle`` is not needed) and a JSON text ``meta`` with format,
version, names, units and rate. A run that is interrupted or fails writes what it has.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planner.errors import FileFormatError, NotFoundError
from planner.exchange.array_files import OWN_BYTES, checked_small, read_npz
from planner.files.json_csv import whole_file
from planner.spatial import FloatArray, pose_to_wxyz
from sim.controllers.readings import PadReading
from sim.real_hand.interface import HandReading, PlanMark

FORMAT, VERSION = "opposable-hand-log", 2

READ = (1, 2)
"""Versions that are read; the first does not say which plan a log is of."""

PAD_WIDTH = 14
"""Numbers per finger in ``pads``: normal force, force, position, normal, sliding, spin."""

UNITS = {
    "time_s": "s, the loop's clock, when the reading was measured",
    "begin_s": "s, when the tick began",
    "write_s": "s, when its command was found",
    "end_s": "s, when its command was written",
    "joints": "rad or m",
    "velocities": "rad/s or m/s",
    "efforts": "N m or N",
    "touch": "N",
    "T_world_base": "m, quaternion w x y z",
    "T_world_object": "m, quaternion w x y z",
    "object_twist": "m/s, rad/s, world",
    "pads": "N, N x3, m x3, -x3, m/s x3, rad/s, world",
    "wanted": "rad or N m, what the controller gave",
    "commands": "rad or N m, what was written; NaN where nothing was",
    "progress": "-",
}
"""Array -> unit and meaning. NaN stands for what was not read."""


@dataclass(frozen=True, kw_only=True, eq=False)
class HandLog:
    """A run of m ticks; arrays by name as in ``UNITS``, NaN for what was not read.

    Attributes:
        joint_names: nq names, order of the interface.
        actuator_names: nu names.
        finger_names: n names of the fingers whose touch was read.
        rate_hz: Rate of the loop, Hz.
        plan: Which plan was executed; None where there was none, and in logs of version 1.
        phase: m phases.
        progress: (m,), share of the phase.
        time_s, begin_s, write_s, end_s: (m,).
        joints, velocities: (m, nq).
        efforts, wanted, commands: (m, nu).
        touch: (m, n).
        T_world_base, T_world_object: (m, 7).
        object_twist: (m, 6).
        pads: (m, n, 14).
    """

    joint_names: tuple[str, ...]
    actuator_names: tuple[str, ...]
    finger_names: tuple[str, ...]
    rate_hz: float
    plan: PlanMark | None
    phase: tuple[str, ...]
    progress: FloatArray
    time_s: FloatArray
    begin_s: FloatArray
    write_s: FloatArray
    end_s: FloatArray
    joints: FloatArray
    velocities: FloatArray
    efforts: FloatArray
    touch: FloatArray
    T_world_base: FloatArray
    T_world_object: FloatArray
    object_twist: FloatArray
    pads: FloatArray
    wanted: FloatArray
    commands: FloatArray

    def __len__(self) -> int:
        """Number of ticks."""
        return len(self.time_s)

    def shapes(self) -> dict[str, tuple[int, ...]]:
        """Shape that each array has for the names and the number of ticks."""
        m, nq = len(self.time_s), len(self.joint_names)
        nu, n = len(self.actuator_names), len(self.finger_names)
        widths: dict[str, tuple[int, ...]] = {
            "joints": (nq,),
            "velocities": (nq,),
            "efforts": (nu,),
            "wanted": (nu,),
            "commands": (nu,),
            "touch": (n,),
            "pads": (n, PAD_WIDTH),
            "T_world_base": (7,),
            "T_world_object": (7,),
            "object_twist": (6,),
        }
        return {name: (m, *widths.get(name, ())) for name in UNITS}

    def write(self, path: Path | str) -> None:
        """Write it as a ``.npz`` file, whole or not at all.

        Raises:
            FileFormatError: The file cannot be written.
        """
        meta = {
            "format": FORMAT,
            "version": VERSION,
            "rate_hz": self.rate_hz,
            "plan": None if self.plan is None else self.plan.to_dict(),
            "joint_names": self.joint_names,
            "actuator_names": self.actuator_names,
            "finger_names": self.finger_names,
            "units": UNITS,
        }
        arrays: dict[str, Any] = {name: getattr(self, name) for name in UNITS}
        arrays["phase"] = np.array(self.phase, dtype=np.str_)
        arrays["meta"] = np.array(json.dumps(meta))
        with whole_file(Path(path)) as stream:
            np.savez_compressed(stream, **arrays)


class LogWriter:
    """Collects the rows of a ``HandLog`` while a loop runs."""

    def __init__(
        self,
        joint_names: tuple[str, ...],
        actuator_names: tuple[str, ...],
        finger_names: tuple[str, ...],
        rate_hz: float,
        plan: PlanMark | None = None,
    ) -> None:
        """Start empty; arguments as in ``HandLog``."""
        self._names = (joint_names, actuator_names, finger_names)
        self._rate_hz, self._plan = rate_hz, plan
        self._rows: list[dict[str, Any]] = []

    def add(
        self,
        reading: HandReading,
        *,
        phase: str,
        progress: float,
        begin_s: float,
        write_s: float,
        end_s: float,
        wanted: FloatArray,
        commands: FloatArray | None,
    ) -> None:
        """Take a tick; ``commands`` is None where nothing was written."""
        row = dict(
            time_s=reading.time,
            phase=phase,
            progress=progress,
            begin_s=begin_s,
            write_s=write_s,
            end_s=end_s,
            wanted=wanted,
            commands=commands,
            T_world_base=None if reading.T_world_base is None else _numbers(reading.T_world_base),
            T_world_object=(
                None if reading.T_world_object is None else _numbers(reading.T_world_object)
            ),
            pads=None if reading.pads is None else _pad_rows(reading.pads),
        )
        for name in ("joints", "velocities", "efforts", "touch", "object_twist"):
            value = getattr(reading, name)
            row[name] = None if value is None else np.array(value, dtype=np.float64)
        self._rows.append(row)

    def log(self) -> HandLog:
        """Everything taken so far."""
        joints, actuators, fingers = self._names
        zero = np.zeros(0)
        empty = HandLog(
            joint_names=joints,
            actuator_names=actuators,
            finger_names=fingers,
            rate_hz=self._rate_hz,
            plan=self._plan,
            phase=tuple(row["phase"] for row in self._rows),
            **dict.fromkeys(UNITS, zero) | {"time_s": np.zeros(len(self._rows))},
        )
        arrays: dict[str, Any] = {}
        for name, shape in empty.shapes().items():
            array = np.full(shape, np.nan)
            for i, row in enumerate(self._rows):
                if row[name] is not None:
                    array[i] = row[name]
            arrays[name] = array
        kept = {f.name: getattr(empty, f.name) for f in fields(empty) if f.name not in arrays}
        return HandLog(**kept, **arrays)


def read_log(path: Path | str) -> HandLog:
    """Read a log.

    Raises:
        FileFormatError: The file is missing, damaged, none of ours, or of another version.
    """
    path = Path(path)
    try:
        arrays: dict[str, NDArray[Any]] = read_npz(path, OWN_BYTES)
    except NotFoundError as error:
        raise FileFormatError(f"{path} does not exist; give a log of a hand (.npz)") from error
    except FileFormatError as error:
        raise FileFormatError(
            f"{path} cannot be read as a log of a hand; it is damaged or something else ({error}): "
            "give a file of opposable drive --log"
        ) from error
    try:
        meta = json.loads(str(checked_small(arrays.pop("meta"), f"{path}, meta")))
        if not isinstance(meta, dict) or meta.get("format") != FORMAT:
            raise FileFormatError(
                f"{path} is no log of a hand; give a file of opposable drive --log"
            )
        if meta.get("version") not in READ:
            raise FileFormatError(
                f"{path} is a log of version {meta.get('version')}; this reads version "
                f"{' and '.join(map(str, READ))}"
            )
        marked = meta.get("plan")
        numbers: Any = {name: arrays[name] for name in UNITS}
        if any(array.dtype.kind != "f" for array in numbers.values()):
            raise TypeError("numbers of another type")
        numbers = {name: array.astype(np.float64) for name, array in numbers.items()}
        phase = arrays.pop("phase")
        if phase.shape != numbers["time_s"].shape:
            raise FileFormatError(
                f"{path} has {phase.size} phases for {numbers['time_s'].size} ticks; damaged"
            )
        log = HandLog(
            joint_names=tuple(map(str, meta["joint_names"])),
            actuator_names=tuple(map(str, meta["actuator_names"])),
            finger_names=tuple(map(str, meta["finger_names"])),
            rate_hz=float(meta["rate_hz"]),
            plan=None if marked is None else PlanMark(**{k: str(v) for k, v in marked.items()}),
            phase=tuple(map(str, phase)),
            **numbers,
        )
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise FileFormatError(
            f"{path} cannot be read as a log of a hand; it is damaged or something else: give a "
            "file of opposable drive --log"
        ) from error
    for name, shape in log.shapes().items():
        found = getattr(log, name).shape
        if found != shape:
            raise FileFormatError(f"{path}: {name} has shape {found}; its names need {shape}")
    return log


def _numbers(pose: Any) -> FloatArray:
    return np.concatenate(pose_to_wxyz(pose))


def _pad_rows(pads: PadReading) -> FloatArray:
    """The numbers (n, 14) of the pads, as in ``PAD_WIDTH``."""
    n = len(pads.normal_force)
    parts = (pads.force, pads.position, pads.normal, pads.sliding)
    spin = np.broadcast_to(pads.spin, (n,))
    return np.column_stack([pads.normal_force, *parts, spin])
