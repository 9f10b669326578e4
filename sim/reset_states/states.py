"""``StateSet``: stable states of a hand with one object in one size, as arrays by name."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from types import MappingProxyType
from typing import Any, Self

import numpy as np

from planner.errors import FileFormatError, PlannerError, TaskError
from planner.exchange.array_files import OWN_BYTES, checked_small, read_npz
from planner.files.json_csv import whole_file
from planner.spatial import FloatArray, IntArray
from planner.version import written_by

FORMAT, VERSION = "opposable-states", 1
"""Name and version of the file that ``StateSet.write`` makes."""

KEYS: Mapping[str, str] = MappingProxyType(
    {
        "q": "joint_position",
        "commands": "command",
        "targets": "joint_target",
        "position": "object_position_m",
        "quaternion": "object_quaternion_wxyz",
        "gravity": "gravity_m_s2",
        "mass": "mass_kg",
        "friction": "friction",
        "kind": "source_kind",
        "plan": "source_plan",
        "pose": "source_pose",
    }
)
"""Attribute -> key in the file, of the columns."""

_TEXTS = ("hand", "object", "scene")
_NAMES = ("joint_names", "actuator_names")


@dataclass(frozen=True, kw_only=True, eq=False)
class StateSet:
    """Stable states; all velocities are zero. Poses are in the frame of the hand's base.

    Attributes:
        hand: Name of the hand.
        object: Specification of the object before it was scaled.
        scene: Path of the scene's XML file, relative to the file of the states.
        scale: Size relative to the specification (-).
        joint_names: nq names.
        actuator_names: nu names.
        q: Joints (n, nq), rad (m for slides).
        commands: Position commands (n, nu) of the actuators that hold the state, rad or m: for an
            actuator that drives a tendon the length of that.
        targets: Joint targets (n, nq) with those commands; for coupled joints those nearest to q.
        position: Of the object's frame, its centre of mass, (n, 3), m.
        quaternion: Its orientation (n, 4), w, x, y, z, w >= 0.
        gravity: (n, 3), m/s2, under which the state was held.
        mass: Of the object (n,), kg.
        friction: Sliding friction between object and hand (n,), -.
        kind: What the planned pose is from (n,): grasp, motion or gait.
        plan: Number of that plan (n,).
        pose: Number of the pose along it (n,).
    """

    hand: str
    object: str
    scene: str
    scale: float
    joint_names: tuple[str, ...]
    actuator_names: tuple[str, ...]
    q: FloatArray
    commands: FloatArray
    targets: FloatArray
    position: FloatArray
    quaternion: FloatArray
    gravity: FloatArray
    mass: FloatArray
    friction: FloatArray
    kind: Any
    plan: IntArray
    pose: IntArray

    def __post_init__(self) -> None:
        """Check shapes.

        Raises:
            TaskError: A column that does not fit the names or the number of states.
        """
        n, nq, nu = len(self.mass), len(self.joint_names), len(self.actuator_names)
        widths = {"q": nq, "targets": nq, "commands": nu, "position": 3, "quaternion": 4}
        for name in KEYS:
            shape = np.shape(getattr(self, name))
            width = {**widths, "gravity": 3}.get(name)
            expected = (n,) if width is None else (n, width)
            if shape != expected:
                raise TaskError(f"{name} of {n} states has shape {shape}; give {expected}")

    def __len__(self) -> int:
        """Number of states."""
        return len(self.mass)

    def __getitem__(self, rows: Any) -> Self:
        """Some of the states: a slice, an array of numbers, or a mask (n,)."""
        columns = {name: getattr(self, name)[rows] for name in KEYS}
        rest = {f.name: getattr(self, f.name) for f in fields(self) if f.name not in KEYS}
        return type(self)(**rest, **columns)

    def named(self, names: tuple[str, ...], what: str = "q") -> FloatArray:
        """Joints or targets (n, len(names)) in another order, by name.

        Args:
            names: Names of joints.
            what: "q" or "targets".

        Raises:
            TaskError: A name that the hand does not have.
        """
        if unknown := [name for name in names if name not in self.joint_names]:
            raise TaskError(
                f"{self.hand} has no joint {', '.join(unknown)}; it has "
                f"{', '.join(self.joint_names)}"
            )
        columns: FloatArray = getattr(self, what)
        return columns[:, [self.joint_names.index(name) for name in names]]

    def write(self, path: Path) -> None:
        """Write an ``.npz`` file of plain arrays, which ``numpy.load`` reads without pickles.

        Raises:
            FileFormatError: It cannot be written.
        """
        content: dict[str, Any] = {"format": FORMAT, "version": VERSION, "written_by": written_by()}
        content |= {name: getattr(self, name) for name in (*_TEXTS, "scale")}
        content |= {name: np.array(getattr(self, name)) for name in _NAMES}
        content |= {key: getattr(self, name) for name, key in KEYS.items()}
        with whole_file(path) as stream:
            np.savez(stream, **content)

    @classmethod
    def read(cls, path: Path | str) -> Self:
        """Read what ``write`` wrote.

        Raises:
            FileFormatError: It cannot be read, is something else, or of another version.
        """
        try:
            content = read_npz(Path(path), OWN_BYTES)
            for name in (*_TEXTS, *_NAMES, "format", "version", "scale"):
                if name in content:
                    checked_small(content[name], name)
        except PlannerError as error:
            raise FileFormatError(f"cannot read the states {path}: {error}") from error
        if str(content.get("format")) != FORMAT:
            raise FileFormatError(f"{path} holds no states: its format is not {FORMAT!r}")
        if int(content["version"]) != VERSION:
            raise FileFormatError(
                f"{path} has version {content['version']} of {FORMAT}; this is for {VERSION}"
            )
        wanted = {*_TEXTS, *_NAMES, "scale", *KEYS.values()}
        if missing := sorted(wanted - set(content)):
            raise FileFormatError(f"{path} lacks {', '.join(missing)}; write it again")
        texts: dict[str, Any] = {name: str(content[name]) for name in _TEXTS}
        names: dict[str, Any] = {name: tuple(content[name].tolist()) for name in _NAMES}
        columns: dict[str, Any] = {name: content[key] for name, key in KEYS.items()}
        try:
            return cls(scale=float(content["scale"]), **texts, **names, **columns)
        except TaskError as error:
            raise FileFormatError(f"the states {path} are damaged: {error}") from error
