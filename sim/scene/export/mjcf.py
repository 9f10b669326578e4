"""The MJCF of an exported scene: explicit, portable, and with the numbers of the trial's scene.

The text is made from the compiled scene: no defaults, classes, frames or includes that another
reader may not follow, every mass explicit, every mesh a Wavefront file. Numbers that place or move
something have all their digits, where MuJoCo's own writer gives six.

The hand's base stands fixed at the pose of the grasp. Table and obstacles are left out: what holds
the object is the hand alone.

Key frames of an exported scene: states of hand and object, and the commands that belong to them.

    pregrasp   fingers open; commands that hold the hand's own weight there
    grasp      fingers on the object; the same commands at that posture: nothing presses yet
    squeeze    the state of ``grasp``; commands that make the planned forces

The commands are those of position servos and do not depend on the state: at the planned posture
each servo's own law gives exactly the torque that the planned contact forces and the weight of
hand and object need, and elsewhere its stiffness pulls back (``sim.controllers.grasp``).
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import mujoco
import numpy as np

from planner.bridge import compile_spec, spec_from_model
from planner.errors import TaskError
from planner.exchange.dexgraspbench.export import without_servos
from planner.files import plain_name
from planner.kinematics import moving_hand
from planner.plan import GraspPlan
from planner.spatial import FloatArray
from sim.scene.build import SUPPORT, Scene, index_scene, scene_spec
from sim.scene.gantry import GANTRY
from sim.scene.physics import PhysicsOptions


@dataclass(frozen=True, kw_only=True, eq=False)
class KeyFrame:
    """A state at rest and the commands of the hand's actuators.

    Attributes:
        name: "pregrasp", "grasp" or "squeeze".
        q: Joints (nq,), rad or m, order of ``hand.joint_names``.
        ctrl: Commands (nu,), order of ``hand.actuation.names``.
    """

    name: str
    q: FloatArray
    ctrl: FloatArray


def key_frames(plan: GraspPlan) -> tuple[KeyFrame, ...]:
    """The key frames of a plan.

    Raises:
        TaskError: The hand has actuators that follow no position, or the plan has no forces.
    """
    hand = plan.task.hand
    if reason := without_servos(hand):
        raise TaskError(
            f"{reason}; an exported scene is held by position commands: plan with a hand that has "
            "position servos"
        )
    if not plan.forces.found:
        raise TaskError(
            f"the plan has no contact forces: {plan.forces.reason}; plan again with a smaller grip"
        )
    gravity = plan.T_world_base.rotation.T @ plan.task.gravity

    def resting(q: FloatArray) -> FloatArray:
        weight = moving_hand(hand).move(q).gravity_torque(gravity)
        return hand.actuation.commands(q, np.zeros(hand.nq), np.asarray(weight))

    q, opened = np.array(plan.q), np.array(plan.q_pregrasp)
    pressing = hand.actuation.commands(q, np.zeros(hand.nq), np.array(plan.forces.joint_torques))
    return (
        KeyFrame(name="pregrasp", q=opened, ctrl=resting(opened)),
        KeyFrame(name="grasp", q=q, ctrl=resting(q)),
        KeyFrame(name="squeeze", q=q, ctrl=pressing),
    )


MESHES = "meshes"
"""Folder of the meshes beside the model."""

MOUNT = "mount"
"""Name of the fixed body that carries the hand."""

_EXACT: Mapping[str, Mapping[str, str]] = {
    "body": {"pos": "body_pos", "quat": "body_quat"},
    "geom": {"pos": "geom_pos", "quat": "geom_quat", "size": "geom_size"},
    "joint": {"pos": "jnt_pos", "axis": "jnt_axis", "range": "jnt_range"},
    "inertial": {
        "pos": "body_ipos",
        "quat": "body_iquat",
        "mass": "body_mass",
        "diaginertia": "body_inertia",
    },
}
"""Element -> attribute -> array of the compiled model that it stands for."""

_OF_A_LAW = ("biastype", "gaintype", "gainprm", "biasprm", "actlimited", "input")
"""Attributes of <general> that <position> says by kp and kv. MuJoCo 3 refuses the last, a note."""


@dataclass(frozen=True, kw_only=True, eq=False)
class MeshFile:
    """A mesh of the scene and its file.

    Attributes:
        file: Path below the folder of the export.
        vertices: (n, 3), m, in the frame of the geoms that show it.
        faces: (m, 3), indices from 0.
    """

    file: str
    vertices: FloatArray
    faces: Any

    @property
    def text(self) -> str:
        """Wavefront OBJ."""
        lines = [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in self.vertices.tolist()]
        lines += [f"f {a} {b} {c}" for a, b, c in (self.faces + 1).tolist()]
        return "\n".join(lines) + "\n"


def plain_scene(plan: GraspPlan, physics: PhysicsOptions) -> tuple[Scene, Any]:
    """The scene of a trial without gantry, table, obstacles and what is only looked at.

    Returns:
        The scene, and the ``mujoco.MjSpec`` that it was compiled from.

    Raises:
        ModelError: MuJoCo refuses the scene, or it has parts that cannot be written.
    """
    task = replace(plan.task, table_height=None, obstacles=())
    spec = scene_spec(task, plan.T_world_base, physics, with_gantry=False)
    for equality in spec.equalities:
        if equality.name == SUPPORT:
            spec.delete(equality)
    what = f"the scene of {spec.modelname}"
    compiled = compile_spec(spec, what)
    plain = spec_from_model(compiled)
    plain.body(GANTRY).name = MOUNT
    physics.apply(plain, task.gravity)
    if not task.hand.on_arm:
        _keep_neighbours_apart(plain, compiled)
    for pair in range(compiled.npair):
        _add_pair(plain, compiled, pair)
    model = compile_spec(plain, what)
    return index_scene(task, physics, plan.T_world_base, model, None), plain


def _keep_neighbours_apart(spec: Any, model: Any) -> None:
    """Exclude contacts of the fixed base with the links on it.

    MuJoCo lets no body touch the one that it hangs on, unless that one stands fixed in the world,
    as the base does here and does not on its gantry.
    """
    welded = model.body_weldid
    fixed = [b for b in range(1, model.nbody) if welded[b] == 0]
    known = {int(signature) for signature in model.exclude_signature[: model.nexclude]}
    for body in range(1, model.nbody):
        root = int(welded[body])
        if root == 0 or int(model.body_parentid[root]) not in fixed:
            continue
        for base in fixed:
            if (base << 16) + body not in known and (body << 16) + base not in known:
                names = (model.body(b).name for b in (base, body))
                first, second = (MOUNT if name == GANTRY else name for name in names)
                spec.add_exclude(bodyname1=first, bodyname2=second)


def _add_pair(spec: Any, model: Any, k: int) -> None:
    """Read back a pair of geoms that the model lists as touching."""
    pair = spec.add_pair(name=model.pair(k).name)
    pair.geomname1 = model.geom(int(model.pair_geom1[k])).name
    pair.geomname2 = model.geom(int(model.pair_geom2[k])).name
    pair.condim = int(model.pair_dim[k])
    pair.margin, pair.gap = float(model.pair_margin[k]), float(model.pair_gap[k])
    for name in ("friction", "solref", "solreffriction", "solimp"):
        setattr(pair, name, getattr(model, f"pair_{name}")[k])


def mesh_files(model: Any) -> tuple[MeshFile, ...]:
    """The meshes of a compiled model, by number; each is named after the first geom with it."""
    out = []
    for k in range(model.nmesh):
        is_mesh = model.geom_type == int(mujoco.mjtGeom.mjGEOM_MESH)
        shown = np.flatnonzero(is_mesh & (model.geom_dataid == k))
        label = model.geom(int(shown[0])).name if len(shown) else f"mesh{k}"
        start, count = int(model.mesh_vertadr[k]), int(model.mesh_vertnum[k])
        first, faces = int(model.mesh_faceadr[k]), int(model.mesh_facenum[k])
        out.append(
            MeshFile(
                file=f"{MESHES}/{k:02d}-{plain_name(label)}.obj",
                vertices=np.array(model.mesh_vert[start : start + count], dtype=float),
                faces=np.array(model.mesh_face[first : first + faces]),
            )
        )
    return tuple(out)


def scene_mjcf(
    scene: Scene, spec: Any, keys: Sequence[KeyFrame], meshes: Sequence[MeshFile]
) -> str:
    """The text of the file.

    Args:
        scene: Compiled from ``spec``.
        spec: ``mujoco.MjSpec``.
        keys: Key frames; the object stands at its place in all of them.
        meshes: Files of the meshes, by number.
    """
    model = scene.model
    root = portable_mjcf(spec, model)
    for mesh in root.iter("mesh"):
        number = model.mesh(mesh.attrib["name"]).id
        mesh.attrib.pop("vertex", None)
        mesh.attrib.pop("face", None)
        mesh.set("file", meshes[number].file)
    for body in root.iter("body"):
        _write_exactly(body, model, model.body(body.attrib["name"]).id)
    frames = ET.SubElement(root, "keyframe")
    for key in keys:
        qpos = scene.posed(key.q, scene.T_world_base, scene.task.T_world_object)
        ctrl = np.zeros(model.nu)
        ctrl[scene.hand_ctrl] = key.ctrl
        ET.SubElement(frames, "key", name=key.name, qpos=plain_text(qpos), ctrl=plain_text(ctrl))
    ET.indent(root)
    return ET.tostring(root, encoding="unicode") + "\n"


def portable_mjcf(spec: Any, model: Any) -> ET.Element:
    """What MuJoCo writes of a spec and its compiled model, in words that MuJoCo 3.3 reads too."""
    root = ET.fromstring(spec.to_xml())
    for actuator in root.findall("actuator/general"):
        _as_servo(actuator, model, model.actuator(actuator.attrib["name"]).id)
    for element in root.iter("general"):
        element.attrib.pop("input", None)
    return root


def _as_servo(element: ET.Element, model: Any, number: int) -> None:
    """Say <position>, which more readers know, for an actuator whose law is kp (ctrl - length)."""
    gain, bias = model.actuator_gainprm[number], model.actuator_biasprm[number]
    constant = int(model.actuator_gaintype[number]) == int(mujoco.mjtGain.mjGAIN_FIXED)
    affine = int(model.actuator_biastype[number]) == int(mujoco.mjtBias.mjBIAS_AFFINE)
    direct = int(model.actuator_dyntype[number]) == int(mujoco.mjtDyn.mjDYN_NONE)
    if not (constant and affine and direct and bias[0] == 0.0 and bias[1] == -gain[0]):
        return
    element.tag = "position"
    for name in _OF_A_LAW:
        element.attrib.pop(name, None)
    element.set("kp", repr(float(gain[0])))
    if bias[2]:
        element.set("kv", repr(-float(bias[2])))


def _write_exactly(body: ET.Element, model: Any, number: int) -> None:
    """Give the numbers of a body and its parts all their digits."""
    for element in (body, *body):
        arrays = _EXACT.get(element.tag)
        if arrays is None or (element.tag == "body" and element is not body):
            continue
        row = number
        if element.tag in ("geom", "joint"):
            row = getattr(model, element.tag)(element.attrib["name"]).id
        for attribute, array in arrays.items():
            if attribute in element.attrib:
                element.set(
                    attribute, _digits(element.attrib[attribute], getattr(model, array)[row])
                )


def _digits(written: str, value: Any) -> str:
    """As many numbers as are written, with all their digits."""
    return plain_text(np.atleast_1d(value)[: len(written.split())])


def plain_text(numbers: FloatArray) -> str:
    """Numbers with all of their digits, a space between them."""
    return " ".join(repr(x) for x in np.asarray(numbers, dtype=float).tolist())
