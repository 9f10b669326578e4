"""``HandLog``: readings and commands of a run, a row per tick, in one ``.npz`` file by names.

The file holds plain arrays (``allow_pickle`` is not needed) and a JSON text ``meta`` with format,
version, names, units and rate. A run that is interrupted or fails writes what it has.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planner.errors import FileFormatError, NotFoundError
from planner.exchange.array_files import OWN_BYTES, checked_small, read_npz
from planner.files.disk import whole_file
from planner.spatial import FloatArray, pose_from_wxyz, pose_to_wxyz
from sim.controllers.base import PadReading
from sim.real_hand.interface import HandReading, PlanMark

FORMAT, VERSION = "opposable-hand-log", 2

READ = (1, 2)
"""Versions that are read; the first does not say which plan a log is of."""

PAD_WIDTH = 14
"""Numbers per finger in ``pads``: normal force, force, position, normal, sliding, spin."""

CHANNELS = {
    "time_s": ("", "s, the loop's clock, when the reading was measured"),
    "begin_s": ("", "s, when the tick began"),
    "write_s": ("", "s, when its command was found"),
    "end_s": ("", "s, when its command was written"),
    "joints": ("joints", "rad or m"),
    "velocities": ("joints", "rad/s or m/s"),
    "efforts": ("actuators", "N m or N"),
    "touch": ("fingers", "N"),
    "T_world_base": ("pose", "m, quaternion w x y z"),
    "T_world_object": ("pose", "m, quaternion w x y z"),
    "object_twist": ("twist", "m/s, rad/s, world"),
    "pads": ("pads", "N, N x3, m x3, -x3, m/s x3, rad/s, world"),
    "wanted": ("actuators", "rad or N m, what the controller gave"),
    "commands": ("actuators", "rad or N m, what was written; NaN where nothing was"),
    "progress": ("", "-"),
}
"""Array -> what a tick has of it, and unit and meaning. NaN stands for what was not read."""


@dataclass(frozen=True, kw_only=True, eq=False)
class HandLog:
    """A run of m ticks; arrays by name as in ``CHANNELS``, NaN for what was not read.

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
        return _shapes(len(self), self.joint_names, self.actuator_names, self.finger_names)

    def reading(self, tick: int) -> HandReading:
        """What was read in a tick."""
        row = {name: getattr(self, name)[tick] for name in CHANNELS}
        # what was not read is NaN in its first number
        known = {k: v for k, v in row.items() if np.size(v) and not np.isnan(np.ravel(v)[0])}
        poses = ("T_world_base", "T_world_object")
        return HandReading(
            time=float(self.time_s[tick]),
            joints=row["joints"].copy(),
            velocities=row["velocities"].copy(),
            **{k: known[k].copy() for k in ("efforts", "touch", "object_twist") if k in known},
            **{k: pose_from_wxyz(known[k][:3], known[k][3:]) for k in poses if k in known},
            pads=_pads_of(known["pads"]) if "pads" in known else None,
        )

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
            "units": {name: unit for name, (_, unit) in CHANNELS.items()},
        }
        arrays: dict[str, Any] = {name: getattr(self, name) for name in CHANNELS}
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
        row: dict[str, Any] = dict(
            time_s=reading.time,
            phase=phase,
            progress=progress,
            begin_s=begin_s,
            write_s=write_s,
            end_s=end_s,
            wanted=wanted,
            commands=commands,
        )
        for name in ("joints", "velocities", "efforts", "touch", "object_twist"):
            value = getattr(reading, name)
            row[name] = None if value is None else np.array(value, dtype=np.float64)
        for name in ("T_world_base", "T_world_object"):
            pose = getattr(reading, name)
            row[name] = None if pose is None else np.concatenate(pose_to_wxyz(pose))
        row["pads"] = None if reading.pads is None else _pad_rows(reading.pads)
        self._rows.append(row)

    def log(self) -> HandLog:
        """Everything taken so far."""
        arrays: dict[str, Any] = {}
        for name, shape in _shapes(len(self._rows), *self._names).items():
            arrays[name] = np.full(shape, np.nan)
            for i, row in enumerate(self._rows):
                if row[name] is not None:
                    arrays[name][i] = row[name]
        joints, actuators, fingers = self._names
        return HandLog(
            joint_names=joints,
            actuator_names=actuators,
            finger_names=fingers,
            rate_hz=self._rate_hz,
            plan=self._plan,
            phase=tuple(row["phase"] for row in self._rows),
            **arrays,
        )


GIVE = "give a file of opposable drive --log"


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
            f"{GIVE}"
        ) from error
    try:
        meta = json.loads(str(checked_small(arrays.pop("meta"), f"{path}, meta")))
        if not isinstance(meta, dict) or meta.get("format") != FORMAT:
            raise FileFormatError(f"{path} is no log of a hand; {GIVE}")
        if meta.get("version") not in READ:
            raise FileFormatError(
                f"{path} is a log of version {meta.get('version')}; this reads version "
                f"{' and '.join(map(str, READ))}"
            )
        marked = meta.get("plan")
        numbers: Any = {name: arrays[name] for name in CHANNELS}
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
            f"{path} cannot be read as a log of a hand; it is damaged or something else: {GIVE}"
        ) from error
    for name, shape in log.shapes().items():
        found = getattr(log, name).shape
        if found != shape:
            raise FileFormatError(f"{path}: {name} has shape {found}; its names need {shape}")
    return log


def _shapes(
    ticks: int, joints: tuple[str, ...], actuators: tuple[str, ...], fingers: tuple[str, ...]
) -> dict[str, tuple[int, ...]]:
    """Shape of each array for some names and a number of ticks."""
    sizes: dict[str, tuple[int, ...]] = {
        "": (),
        "joints": (len(joints),),
        "actuators": (len(actuators),),
        "fingers": (len(fingers),),
        "pads": (len(fingers), PAD_WIDTH),
        "pose": (7,),
        "twist": (6,),
    }
    return {name: (ticks, *sizes[each]) for name, (each, _) in CHANNELS.items()}


def _pad_rows(pads: PadReading) -> FloatArray:
    """The numbers (n, 14) of the pads, as in ``PAD_WIDTH``."""
    n = len(pads.normal_force)
    parts = (pads.force, pads.position, pads.normal, pads.sliding)
    spin = np.broadcast_to(pads.spin, (n,))
    return np.column_stack([pads.normal_force, *parts, spin])


def _pads_of(rows: FloatArray) -> PadReading:
    """What ``_pad_rows`` was made of."""
    force, position, normal, sliding = rows[:, 1:13].reshape(len(rows), 4, 3).transpose(1, 0, 2)
    return PadReading(
        normal_force=rows[:, 0].copy(),
        force=force,
        position=position,
        normal=normal,
        sliding=sliding,
        spin=rows[:, 13].copy(),
    )
