"""The scene in which states are held, as files that MuJoCo 3.3 and 4 load: hand and object alone.

The hand's base stands fixed at the world's origin, so that the world is the frame of the base. The
object is a free body. There is no gantry, table or picture: what does not touch only costs time.
Contacts are those of ``sim.scene``. MuJoCo writes 6 digits into its XML, so the states are held in
the model that is read back from the file: what is checked is what others load.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from planner.bridge import compile_spec
from planner.errors import FileFormatError, ModelError
from planner.spatial import SE3, FloatArray, IntArray
from planner.task import GraspTask
from sim.physics import PhysicsOptions
from sim.scene import OBJECT, add_solid_object, hand_spec
from sim.scene_export.mjcf import portable_mjcf

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
