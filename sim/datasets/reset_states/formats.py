"""Formats that caches of states are written in, each a function and an entry of ``_FORMATS``.

``npz``: all columns as NumPy arrays by name; what the check of a cache reads. ``parquet``: one row
per state, one list column per array, names in the metadata.

``playground``: reset arrays of an environment of MuJoCo Playground (MJX) or any MuJoCo model.
``reset`` of ``CubeReorient`` (google-deepmind/mujoco_playground, commit d5e6b47,
``_src/manipulation/leap_hand/reorient.py``) makes its data out of qpos (joints of the hand, then
position and quaternion w, x, y, z of the object), qvel and ctrl. These arrays are the same in the
order of the scene's XML file; ``joint_names`` and ``actuator_names`` say by name what stands where,
for ``get_qpos_ids`` of a model with another order.

``isaac_lab``: reset arrays of an in-hand environment of Isaac Lab. ``_reset_idx`` of
``InHandManipulationEnv`` (isaac-sim/IsaacLab, commit 032e26b,
``source/isaaclab_tasks/isaaclab_tasks/direct/inhand_manipulation/inhand_manipulation_env.py``)
writes joint positions and velocities with ``write_joint_state_to_sim``, the same positions as
targets with ``set_joint_position_target``, and the object with ``write_root_pose_to_sim``. An
articulation orders its joints breadth first: match them by name with ``find_joints(names,
preserve_order=True)``. Quaternions are w, x, y, z up to Isaac Lab 2 and x, y, z, w from 3.0 on:
both are here, called so.

``hora``: grasp caches of HORA (HaozhiQi/hora, commit 410d958), which start its in-hand turns. A
file is an array (n, 23) of float32: 16 joints, then position (m) and quaternion x, y, z, w of the
object's root. ``hora/tasks/allegro_hand_hora.py`` loads one per entry of ``randomizeScaleList``,
under ``cache/{grasp_cache_name}_grasp_50k_s{scale without its point}.npy``, whatever the number of
rows, and draws rows at random. At a reset it takes the joints as position targets, too. Joints are
in the order in which Isaac Gym walks ``assets/allegro/allegro.urdf``: index, thumb, middle, ring,
as ``_obs_allegro2hora`` of ``hora/algo/deploy/deploy.py`` has it. That URDF and our allegro_hand
have the same joints, limits and base frame. Poses are in the world of HORA, where the hand stands
0.5 m high, turned by -90 degrees about y after 90 degrees about x: palm up. Its gravity is -z
there, which is -x of the base. Only states that were held within 10 degrees of that are written.

``StateSet``: stable states of a hand with one object in one size, as arrays by name.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, Self

import numpy as np

from planner.batch.rows import arrow
from planner.errors import FileFormatError, PlannerError, TaskError
from planner.exchange.array_files import OWN_BYTES, checked_small, read_npz
from planner.files.disk import whole_file
from planner.registry import Registry
from planner.spatial import SE3, FloatArray, IntArray, pose_from_wxyz, pose_to_wxyz
from planner.system.package import written_by

FORMAT, VERSION = "opposable-states", 1
"""Name and version of the file that ``StateSet.write`` makes."""

KEYS: Mapping[str, str] = {
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


STATES_FILE, PARQUET_FILE = "states.npz", "states.parquet"
ISAAC_FILE, PLAYGROUND_FILE = "isaac_lab.npz", "playground.npz"
"""Names of files in the folder of their object and size."""

_FINGERS = ("index", "thumb", "middle", "ring")

HORA_JOINTS = tuple(f"{finger}_{k}" for finger in _FINGERS for k in range(4))
"""Our names of HORA's joints in its order: joint_0.0 to 3.0, 12.0 to 15.0, 4.0 to 7.0, 8.0 to
11.0."""

T_WORLD_BASE = SE3(
    np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]]), np.array([0.0, 0.0, 0.5])
)
"""Pose of the hand's base in HORA's world (``_init_object_pose``)."""

CACHE_NAME = "public_allegro"
"""Its name of the hand of ``assets/allegro/allegro.urdf`` (``PublicAllegroHandHora.yaml``)."""

TILT = float(np.deg2rad(10.0))
"""Most that a state's gravity may differ from HORA's, rad."""

DOWN = T_WORLD_BASE.rotation.T @ np.array([0.0, 0.0, -1.0])
"""Direction of HORA's gravity in the hand's base."""


@dataclass(frozen=True, kw_only=True)
class StateFormat:
    """A format of states of one hand, object and size.

    Attributes:
        name: Its name on the command line.
        title: What it is, in one line.
        lost: What of a state it does not hold, in one line; "" if it holds all.
        write: Writes states into a folder, the root of all of a cache; the file.
        refuses: Why it cannot hold these states; "" if it can.
    """

    name: str
    title: str
    lost: str
    write: Callable[[StateSet, str, Path], Path]
    refuses: Callable[[StateSet], str] = lambda states: ""


def _write_npz(states: StateSet, name: str, folder: Path) -> Path:
    path = folder / name / STATES_FILE
    states.write(path)
    return path


def _write_parquet(states: StateSet, name: str, folder: Path) -> Path:
    pa = arrow()
    columns: dict[str, Any] = {"scale": pa.array(np.full(len(states), states.scale))}
    for attribute, key in KEYS.items():
        rows = np.asarray(getattr(states, attribute))
        flat = pa.array(rows.ravel().tolist() if rows.dtype.kind == "U" else rows.ravel())
        wide = rows.ndim == 2
        columns[key] = pa.FixedSizeListArray.from_arrays(flat, rows.shape[1]) if wide else flat
    about = {
        "format": FORMAT,
        "version": VERSION,
        "hand": states.hand,
        "object": states.object,
        "scene": states.scene,
        "joint_names": states.joint_names,
        "actuator_names": states.actuator_names,
    }
    table = pa.table(columns).replace_schema_metadata({FORMAT: json.dumps(about)})
    path = folder / name / PARQUET_FILE
    with whole_file(path) as stream:
        pa.parquet.write_table(table, stream)
    return path


def _without_arrow(_: StateSet) -> str:
    try:
        arrow()
    except TaskError as error:
        return str(error)
    return ""


def _write_playground(states: StateSet, name: str, folder: Path) -> Path:
    return _arrays(
        folder / name / PLAYGROUND_FILE,
        states,
        qpos=np.hstack([states.q, states.position, states.quaternion]),
        qvel=np.zeros((len(states), len(states.joint_names) + 6)),
        ctrl=states.commands,
        gravity=states.gravity,
    )


def _write_isaac_lab(states: StateSet, name: str, folder: Path) -> Path:
    return _arrays(
        folder / name / ISAAC_FILE,
        states,
        joint_pos=states.q,
        joint_vel=np.zeros_like(states.q),
        joint_pos_target=states.targets,
        object_pos_b=states.position,
        object_quat_b_wxyz=states.quaternion,
        object_quat_b_xyzw=np.roll(states.quaternion, -1, axis=1),
        object_vel=np.zeros((len(states), 6)),
        gravity_b=states.gravity,
    )


def _arrays(path: Path, states: StateSet, **arrays: Any) -> Path:
    """Write arrays as float32 with mass, friction and the names of joints and actuators."""
    arrays |= {"mass": states.mass, "friction": states.friction}
    content: dict[str, Any] = {key: value.astype(np.float32) for key, value in arrays.items()}
    content |= {n: np.array(getattr(states, n)) for n in ("joint_names", "actuator_names")}
    with whole_file(path) as stream:
        np.savez(stream, **content)
    return path


def _upright(states: StateSet) -> Any:
    """Which states (n,) were held under HORA's gravity."""
    along = states.gravity @ DOWN / np.linalg.norm(states.gravity, axis=1)
    return along >= np.cos(TILT)


def _not_of_hora(states: StateSet) -> str:
    if set(states.joint_names) != set(HORA_JOINTS):
        return f"HORA's hand has the 16 joints of allegro_hand, and {states.hand} has others"
    if not _upright(states).any():
        return (
            "no state was held within 10 degrees of HORA's gravity, which points along -x of the "
            "hand's base; give --gravity=-1,0,0"
        )
    return ""


def _write_hora(states: StateSet, name: str, folder: Path) -> Path:
    some = states[_upright(states)]
    poses = [
        T_WORLD_BASE * pose_from_wxyz(p, w)
        for p, w in zip(some.position, some.quaternion, strict=True)
    ]
    placed = np.array([np.concatenate(pose_to_wxyz(pose)) for pose in poses]).reshape(-1, 7)
    rows = np.hstack([some.named(HORA_JOINTS), placed[:, :3], placed[:, 4:], placed[:, 3:4]])
    scale = str(float(states.scale)).replace(".", "")
    # caches of several objects differ in their folder: HORA's name has no place for the object
    path = folder / "hora" / name.rsplit("-s", 1)[0] / f"{CACHE_NAME}_grasp_50k_s{scale}.npy"
    path.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(path) as stream:
        np.save(stream, rows.astype(np.float32))
    return path


_FORMATS: Registry[StateFormat] = Registry("format of states")


def register_state_format(made: StateFormat) -> StateFormat:
    """Make a format known by its name, and return it.

    Raises:
        TaskError: Another format has that name.
    """
    return _FORMATS.add(made.name, made)


def state_formats() -> tuple[str, ...]:
    """Names of all formats."""
    return tuple(_FORMATS)


def state_format(name: str) -> StateFormat:
    """A format by its name.

    Raises:
        NotFoundError: There is none of that name.
    """
    return _FORMATS.named(name)


register_state_format(
    StateFormat(name="npz", title="NumPy arrays by name", lost="", write=_write_npz)
)
register_state_format(
    StateFormat(
        name="parquet",
        title="one row per state",
        lost="",
        write=_write_parquet,
        refuses=_without_arrow,
    )
)
register_state_format(
    StateFormat(
        name="hora",
        title="HORA's grasp cache",
        lost="joint targets, gravity, mass and friction; states under another gravity than HORA's",
        write=_write_hora,
        refuses=_not_of_hora,
    )
)
register_state_format(
    StateFormat(
        name="playground",
        title="qpos, qvel, ctrl for MuJoCo Playground",
        lost="digits beyond float32",
        write=_write_playground,
    )
)
register_state_format(
    StateFormat(
        name="isaac_lab",
        title="joint and root states for Isaac Lab",
        lost="commands of tendons, which become joint targets; digits beyond float32",
        write=_write_isaac_lab,
    )
)
