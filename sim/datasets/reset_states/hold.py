"""One hold: 2 s in MuJoCo under gravity, with position commands alone; a state, or why it is lost.

The state that is kept is the one at the END of the hold, with velocities zero. By then the drawn
errors of pose, joints and commands have settled, and the second half of the hold has shown how far
it still creeps. The state at the beginning holds the same errors as penetrations and gaps: a
simulator that loads it would have to live through the same transient.

A hold ends early once the object is lost. Its tests, with their numbers, are the constants below.

The scene in which states are held, as files that MuJoCo 3.3 and 4 load: hand and object alone.

The hand's base stands fixed at the world's origin, so that the world is the frame of the base. The
object is a free body. There is no gantry, table or picture: what does not touch only costs time.
Contacts are those of ``sim.scene.build``. MuJoCo writes 6 digits into its XML, so the states are
held in the model that is read back from the file: what is checked is what others load.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from planner.bridge import compile_spec
from planner.errors import FileFormatError, ModelError
from planner.spatial import SE3, FloatArray, IntArray
from planner.task import GraspTask
from sim.scene.build import OBJECT, add_solid_object, hand_spec
from sim.scene.export.mjcf import portable_mjcf
from sim.scene.physics import PhysicsOptions

SCENE_FILE, MESHES = "scene.xml", "meshes"
"""Name of the model in its folder, and of the folder of its mesh files."""

ROUNDING = 1e-9
"""Share by which a moment of inertia is lowered for MuJoCo's test of A + B >= C."""


def write_scene(task: GraspTask, physics: PhysicsOptions, folder: Path) -> Path:
    """Write the scene of a task with its mesh files into a folder; the XML file.

    Raises:
        ModelError: MuJoCo refuses the scene; the hand has a body called "object".
    """
    hand, item = task.hand, task.object
    what = f"the scene of {hand.name} and {item.name}"
    spec = hand_spec(hand, physics, np.zeros(3))
    spec.modelname = f"{hand.name}, {item.name}".replace("/", "-")
    if spec.body(OBJECT) is not None:
        raise ModelError(f"{hand.name} has a body called {OBJECT!r}; give it another name")
    for key in list(spec.keys):
        spec.delete(key)
    for body in spec.bodies:
        if body.explicitinertial:
            for geom in list(body.geoms):
                if not (geom.contype or geom.conaffinity):
                    spec.delete(geom)
    base = spec.body(hand.description.base_body)
    base.pos, base.quat = (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0)
    spec.worldbody.add_light(pos=(0.0, 0.0, 1.5))
    add_solid_object(spec, item, SE3.Identity(), physics)
    model = compile_spec(spec, what)
    folder.mkdir(parents=True, exist_ok=True)
    root = portable_mjcf(spec, model)
    _copy_meshes(root, spec, folder)
    _drop_pictures(root)
    for inertial in root.iter("inertial"):
        _mend_rounding(inertial)
    ET.indent(root)
    (folder / SCENE_FILE).write_text(ET.tostring(root, encoding="unicode") + "\n", encoding="utf-8")
    return folder / SCENE_FILE


def _copy_meshes(root: ET.Element, spec: Any, folder: Path) -> None:
    """Copy the mesh files that geoms use beside the model, and name them there.

    Raises:
        ModelError: A mesh file cannot be copied.
    """
    used = {geom.get("mesh") for geom in root.iter("geom")}
    home = Path(spec.modelfiledir) / spec.meshdir
    for parent in root.iter("asset"):
        for number, mesh in enumerate(list(parent.iter("mesh"))):
            file = mesh.get("file")
            if file is None:
                continue
            if mesh.get("name", Path(file).stem) not in used:
                parent.remove(mesh)
                continue
            name = f"{number}-{Path(file).name}"
            (folder / MESHES).mkdir(exist_ok=True)
            try:
                content = spec.assets.get(file) or (home / file).read_bytes()
                (folder / MESHES / name).write_bytes(content)
            except OSError as error:
                raise ModelError(f"cannot copy the mesh {home / file}: {error.strerror}") from error
            mesh.set("name", mesh.get("name", Path(file).stem))
            mesh.set("file", name)
    for compiler in root.iter("compiler"):
        compiler.set("meshdir", MESHES)


def _drop_pictures(root: ET.Element) -> None:
    """Leave out textures, whose files would have to come along."""
    for asset in root.iter("asset"):
        for texture in asset.findall("texture"):
            asset.remove(texture)
    for material in root.iter("material"):
        material.attrib.pop("texture", None)
        for layer in material.findall("layer"):
            material.remove(layer)


def _mend_rounding(inertial: ET.Element) -> None:
    """Lower the largest principal moment to the sum of the others, where 6 digits put it above."""
    moments = [float(v) for v in inertial.get("diaginertia", "").split()]
    if moments and max(moments) > sum(moments) - max(moments):
        most = moments.index(max(moments))
        moments[most] = (sum(moments) - moments[most]) * (1.0 - ROUNDING)
        inertial.set("diaginertia", " ".join(map(repr, moments)))


@dataclass(frozen=True, kw_only=True, eq=False)
class HoldScene:
    """A loaded scene with its index maps; for one thread at a time.

    Attributes:
        model: ``mujoco.MjModel``; mass, friction and gravity are set for every state.
        data: ``mujoco.MjData`` of it.
        qpos: (nq,), where the hand's joints stand in ``data.qpos``.
        qvel: (nq,), where they stand in ``data.qvel``.
        ctrl: (nu,), where the hand's actuators stand in ``data.ctrl``.
        object_qpos: (7,), the object's pose.
        object_qvel: (6,), its velocity.
        body: Body id of the object.
        geoms: Ids of its geoms.
        finger_of_geom: Name of the finger of every geom of the hand; "" for the palm.
        mass: Mass that the file has, kg.
        inertia: Principal inertia (3,) that the file has, kg m2.
    """

    model: Any
    data: Any
    qpos: IntArray
    qvel: IntArray
    ctrl: IntArray
    object_qpos: IntArray
    object_qvel: IntArray
    body: int
    geoms: frozenset[int]
    finger_of_geom: Mapping[int, str]
    mass: float
    inertia: FloatArray

    def draw(self, mass: float, friction: float, gravity: FloatArray) -> None:
        """Set mass (kg), sliding friction (-) and gravity (3,), m/s2."""
        model = self.model
        model.body_mass[self.body] = mass
        model.body_inertia[self.body] = self.inertia * (mass / self.mass)
        model.geom_friction[sorted(self.geoms), 0] = friction
        model.opt.gravity[:] = gravity

    def put(
        self, q: FloatArray, position: FloatArray, quaternion: FloatArray, commands: FloatArray
    ) -> None:
        """Put hand (nq,) and object (3,), (4,) at rest, with commands (nu,)."""
        mujoco.mj_resetData(self.model, self.data)
        self.data.qpos[self.qpos] = q
        self.data.qpos[self.object_qpos] = np.concatenate([position, quaternion])
        self.data.ctrl[self.ctrl] = commands


@lru_cache(maxsize=4)
def load_scene(
    path: Path,
    joint_names: tuple[str, ...],
    actuator_names: tuple[str, ...],
    fingers: tuple[tuple[str, str], ...],
) -> HoldScene:
    """Load a scene file.

    Args:
        path: The XML file.
        joint_names: Of the hand (nq).
        actuator_names: Of the hand (nu).
        fingers: Pairs of body and finger name; other bodies are the palm's.

    Raises:
        FileFormatError: MuJoCo cannot read it.
    """
    try:
        model = mujoco.MjModel.from_xml_path(str(path))
    except ValueError as error:
        raise FileFormatError(f"MuJoCo cannot read {path}: {error}") from error
    joints = [model.joint(name) for name in joint_names]
    free, body = model.joint(OBJECT), int(model.body(OBJECT).id)
    finger_of_body = dict(fingers)
    names = [finger_of_body.get(model.body(b).name, "") for b in model.geom_bodyid.tolist()]
    geoms = frozenset(np.flatnonzero(model.geom_bodyid == body).tolist())
    return HoldScene(
        model=model,
        data=mujoco.MjData(model),
        qpos=np.array([int(j.qposadr[0]) for j in joints]),
        qvel=np.array([int(j.dofadr[0]) for j in joints]),
        ctrl=np.array([model.actuator(name).id for name in actuator_names]),
        object_qpos=int(free.qposadr[0]) + np.arange(7),
        object_qvel=int(free.dofadr[0]) + np.arange(6),
        body=body,
        geoms=geoms,
        finger_of_geom={g: name for g, name in enumerate(names) if g not in geoms},
        mass=float(model.body_mass[body]),
        inertia=np.array(model.body_inertia[body]),
    )


HOLD_S = 2.0
"""Duration of a hold, s."""

LOOKS = (0.025, 0.05, 0.1, 0.15, 0.25, 0.4, 0.6, 0.8, 1.0, 1.5, 2.0)
"""Shares of half a hold (s of its 2 s) after which the object is looked at, so that a hold that has
failed ends."""

HALF = 1.0
"""When the second half begins, in the unit of ``LOOKS``."""

FAR = 0.03
"""Distance (m) from the start beyond which the object counts as dropped."""

SLIP, SLIP_ANGLE = 0.001, float(np.deg2rad(2.0))
"""Most that the object may move (m) and turn (rad) in the second half: a fifth and two fifths of
what counts as lost afterwards, over half of that time."""

SPEED, SPIN, JOINT_SPEED = 0.005, 0.1, 0.1
"""Most that may be left at the end, m/s, rad/s, and rad/s or m/s."""

DEEPEST = 0.001
"""Deepest penetration (m) between object and hand, or hand and hand."""

BEYOND = 0.02
"""How far (rad or m) a joint may be pressed beyond its limit, which MuJoCo holds softly."""

FEWEST = 2
"""Fewest parts of the hand that touch the object, the palm counted as one finger."""

BAD_NUMBERS = (
    mujoco.mjtWarning.mjWARN_BADQPOS,
    mujoco.mjtWarning.mjWARN_BADQVEL,
    mujoco.mjtWarning.mjWARN_BADQACC,
)
"""MuJoCo's warnings of numbers that are not finite or huge."""

DIVERGED, DROPPED, SLIPPED, MOVING, PENETRATES, LIMITS, LOOSE = (
    "numbers not finite",
    f"dropped: the object went over {1e3 * FAR:g} mm from where it began",
    f"slipped over {1e3 * SLIP:g} mm or {np.degrees(SLIP_ANGLE):g} degrees in the second half",
    f"still moving: over {1e3 * SPEED:g} mm/s or {SPIN:g} rad/s",
    f"penetrates by over {1e3 * DEEPEST:g} mm",
    f"hits limits: a joint over {BEYOND:g} rad beyond its end",
    f"touched by fewer than {FEWEST} fingers",
)
REASONS = (DIVERGED, DROPPED, SLIPPED, MOVING, PENETRATES, LIMITS, LOOSE)
"""Why a hold is lost, in the order in which they are looked for."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Held:
    """The end of a hold.

    Attributes:
        reason: One of ``REASONS``; "" if it was held.
        q: Joints (nq,), rad or m.
        position: Of the object (3,), m.
        quaternion: Its orientation, w, x, y, z.
        steps: Time steps that were made.
    """

    reason: str
    q: FloatArray
    position: FloatArray
    quaternion: FloatArray
    steps: int


def hold(scene: HoldScene) -> Held:
    """Hold the state that was put into a scene.

    Args:
        scene: With mass, friction, gravity, and the state at rest with its commands.
    """
    model, data = scene.model, scene.data
    half = HOLD_S / 2.0 / model.opt.timestep
    begin = np.array(data.qpos[scene.object_qpos])
    middle, reason, made = begin, "", 0
    for since, until in pairwise((0.0, *LOOKS)):
        steps = round(until * half) - round(since * half)
        mujoco.mj_step(model, data, steps)
        made += steps
        now = np.array(data.qpos[scene.object_qpos])
        reason = _lost(data, begin, now)
        if reason:
            break
        if until == HALF:
            middle = now
    if not reason:
        reason = _doubtful(scene, middle, now)
    quaternion = now[3:] / np.linalg.norm(now[3:])
    return Held(
        reason=reason,
        q=np.array(data.qpos[scene.qpos]),
        position=now[:3],
        quaternion=quaternion if quaternion[0] >= 0 else -quaternion,
        steps=made,
    )


def _lost(data: Any, begin: FloatArray, now: FloatArray) -> str:
    """Why a hold need not go on; "" if it may."""
    if any(data.warning[what].number for what in BAD_NUMBERS) or not np.isfinite(now).all():
        return DIVERGED
    return DROPPED if np.linalg.norm(now[:3] - begin[:3]) > FAR else ""


def _doubtful(scene: HoldScene, middle: FloatArray, end: FloatArray) -> str:
    """Why a hold that came to its end is no stable state; "" if it is one."""
    model, data = scene.model, scene.data
    turned = 2.0 * np.arccos(min(1.0, abs(float(middle[3:] @ end[3:]))))
    if np.linalg.norm(end[:3] - middle[:3]) > SLIP or turned > SLIP_ANGLE:
        return SLIPPED
    twist, joints = data.qvel[scene.object_qvel], data.qvel[scene.qvel]
    moving = np.linalg.norm(twist[:3]) > SPEED or np.linalg.norm(twist[3:]) > SPIN
    if moving or np.abs(joints).max() > JOINT_SPEED:
        return MOVING
    mujoco.mj_forward(model, data)  # contacts of the pose that is kept
    if data.ncon and data.contact.dist[: data.ncon].min() < -DEEPEST:
        return PENETRATES
    if _beyond_limits(scene):
        return LIMITS
    return LOOSE if len(_touching(scene)) < FEWEST else ""


def _beyond_limits(scene: HoldScene) -> bool:
    model, q = scene.model, scene.data.qpos[scene.qpos]
    joints = model.dof_jntid[scene.qvel]
    low, high = model.jnt_range[joints].T
    outside = np.maximum(low - q, q - high)[model.jnt_limited[joints].astype(bool)]
    return bool(outside.size and outside.max() > BEYOND)


def _touching(scene: HoldScene) -> set[str]:
    """Fingers that press on the object, "" for the palm."""
    found = set()
    for contact in scene.data.contact[: scene.data.ncon]:
        pair = [int(g) for g in contact.geom]
        if len(scene.geoms.intersection(pair)) == 1 and contact.efc_address >= 0:
            other = pair[0] if pair[1] in scene.geoms else pair[1]
            found.add(scene.finger_of_geom[other])
    return found
