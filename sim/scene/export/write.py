"""``export_scene``: a plan becomes a folder from which another simulator starts in the same state.

scene.xml      MJCF: hand, object, key frames pregrasp, grasp and squeeze
hand.urdf      the hand alone, from its base; without servos, tendons and couplings
object.urdf    the object alone
meshes/        Wavefront OBJ, m
physics.json   gains, limits, friction, contact model, integrator, joints and commands by name
check.py       loads scene.xml in MuJoCo alone and says whether the object is held

``physics.json``: what decides whether an exported grasp holds, in words and numbers, by name.

Units are m, kg, s, N, rad (N m and rad of a hinge are N and m of a slide); quaternions are w, x, y,
z. Names are those of ``scene.xml`` and ``hand.urdf``; ``joint`` of a joint is its name in the
hand's own model.
"""

from __future__ import annotations

import json
import os
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

import sim.scene.export.check as check_script
from planner.arrays import finite
from planner.errors import FileFormatError
from planner.exchange.formats import GraspFormat, Writing, register_format
from planner.files import write_json
from planner.hands.hand import Hand
from planner.plan import GraspPlan
from planner.spatial import SE3, FloatArray, pose_to_wxyz
from planner.system.package import written_by
from sim.scene.build import HAND_PREFIX, OBJECT, Scene
from sim.scene.export.check import MOST_DEG, MOST_MM, SECONDS
from sim.scene.export.mjcf import MESHES, KeyFrame, key_frames, mesh_files, plain_scene, scene_mjcf
from sim.scene.export.urdf import body_urdf, ellipsoid_files, not_in_urdf
from sim.scene.physics import PRESETS, AnyPhysics

PHYSICS_FORMAT, PHYSICS_VERSION = "opposable-scene", 1


def physics_data(
    plan: GraspPlan, scene: Scene, keys: Sequence[KeyFrame], urdf: dict[str, Any]
) -> dict[str, Any]:
    """The contents of the file, plain data; infinite limits are None.

    Args:
        plan: What is exported.
        scene: Of the export.
        keys: Its key frames.
        urdf: What is said of the URDF files.
    """
    task, physics = plan.task, scene.physics
    data = {
        "format": PHYSICS_FORMAT,
        "version": PHYSICS_VERSION,
        "written_by": written_by(),
        "units": "m, kg, s, N, N m, rad; quaternions w x y z; per m instead of per rad for slides",
        "hand": {
            "name": task.hand.name,
            "base_body": HAND_PREFIX + task.hand.description.base_body,
            "T_world_base": _pose(plan.T_world_base),
            "carrier": "the root of the arm stands fixed; the arm's servos carry the hand"
            if task.hand.on_arm
            else "the base stands fixed in the world",
        },
        "object": {
            "body": OBJECT,
            "shape": task.object.shape.spec,
            "mass": task.object.mass,
            "inertia": task.object.shape.inertia(task.object.mass),
            "T_world_object": _pose(task.T_world_object),
            "reaches_out_of_true_shape_m": scene.deviation,
        },
        "left_out": {
            "table_height": task.table_height,
            "obstacles": [
                {"name": o.name, "T_world": _pose(o.T_world_obstacle), "size": o.size}
                for o in task.obstacles
            ],
        },
        "gravity": task.gravity,
        "engine": {
            "name": "MuJoCo",
            "version": mujoco.__version__,
            "timestep": physics.timestep,
            "integrator": physics.integrator,
            "solver": "newton",
            "jacobian": "dense",
            "cone": physics.cone,
            "impratio": physics.impratio,
            "noslip_iterations": physics.noslip_iterations,
        },
        "contact": {
            "friction": physics.mu,
            "torsional_friction_m": physics.mu_torsion,
            "rolling_friction_m": physics.mu_rolling,
            "condim": physics.condim,
            "solref": physics.solref,
            "solimp": physics.solimp,
            "combination": "the object's numbers count in every contact (geom priority 1)",
            "planned_with_friction": task.mu,
        },
        "planned_contacts": {
            "finger": plan.contacts.fingers,
            "position_world": plan.contacts.positions,
            "normal_world_into_object": plan.contacts.normals,
            "normal_force": plan.forces.forces[:, 0],
        },
        "joints": _joints(scene),
        "actuators": _actuators(task.hand),
        "stops": _stops(task.hand),
        "couplings": _couplings(task.hand),
        "springs": {
            "law": "torque = torque_at_zero - stiffness q",
            "stiffness": task.hand.actuation.stiffness,
            "torque_at_zero": task.hand.actuation.spring_torque,
        },
        "key_frames": {key.name: _key(task.hand, key) for key in keys},
        "check": {
            "starts_at": "grasp",
            "commands_of": "squeeze",
            "seconds": SECONDS,
            "most_mm": MOST_MM,
            "most_deg": MOST_DEG,
        },
        "urdf": urdf,
    }
    out: dict[str, Any] = finite(data)
    return out


def _pose(pose: SE3) -> dict[str, Any]:
    position, quaternion = pose_to_wxyz(pose)
    return {"position": position, "quaternion_wxyz": quaternion}


def _joints(scene: Scene) -> list[dict[str, Any]]:
    model = scene.model
    out = []
    for name, qpos, dof in zip(
        scene.task.hand.joint_names, scene.hand_qpos, scene.hand_dof, strict=True
    ):
        joint = int(model.dof_jntid[dof])
        hinge = int(model.jnt_type[joint]) == int(mujoco.mjtJoint.mjJNT_HINGE)
        out.append(
            {
                "name": HAND_PREFIX + name,
                "joint": name,
                "type": "hinge" if hinge else "slide",
                "qpos_index": int(qpos),
                "range": model.jnt_range[joint] if model.jnt_limited[joint] else [None, None],
                "damping": model.dof_damping[dof],
                "armature": model.dof_armature[dof],
                "dry_friction": model.dof_frictionloss[dof],
            }
        )
    return out


def _by_joint(hand: Hand, row: FloatArray) -> dict[str, float]:
    names = zip(hand.joint_names, row, strict=True)
    return {HAND_PREFIX + name: float(x) for name, x in names if x}


def _actuators(hand: Hand) -> list[dict[str, Any]]:
    a = hand.actuation
    return [
        {
            "name": HAND_PREFIX + name,
            "ctrl_index": i,
            "law": "force = gain ctrl + bias0 + bias1 length + bias2 rate, clipped",
            "length": _by_joint(hand, a.moment[i]),
            "length_at_zero": a.length0[i],
            "gain": a.gain[i],
            "bias": a.bias[i],
            "force_range": a.force_range[i],
            "ctrl_range": a.ctrl_range[i],
        }
        for i, name in enumerate(a.names)
    ]


def _stops(hand: Hand) -> list[dict[str, Any]]:
    """Stops that tie joints; limits of single joints are with the joints."""
    a = hand.actuation
    rows = zip(a.stop_names, a.stop_rows, a.stop_values, strict=True)
    return [
        {"name": name, "row": _by_joint(hand, row), "at_least": value}
        for name, row, value in rows
        if np.count_nonzero(row) > 1 and np.isfinite(value)
    ]


def _couplings(hand: Hand) -> list[dict[str, Any]]:
    return [
        {"name": c.name, "row": _by_joint(hand, c.row), "equals": c.value}
        for c in hand.couplings
        if not c.one_sided
    ]


def _key(hand: Hand, key: KeyFrame) -> dict[str, Any]:
    joints = zip(hand.joint_names, key.q, strict=True)
    commands = zip(hand.actuation.names, key.ctrl, strict=True)
    return {
        "joints": {HAND_PREFIX + name: float(x) for name, x in joints},
        "commands": {HAND_PREFIX + name: float(x) for name, x in commands},
    }


SCENE, PHYSICS, CHECK, HAND_URDF, OBJECT_URDF = (
    "scene.xml",
    "physics.json",
    "check.py",
    "hand.urdf",
    "object.urdf",
)
"""Names of the files."""


def export_scene(
    plan: GraspPlan, folder: Path | str, *, physics: AnyPhysics | None = None
) -> tuple[Path, ...]:
    """Write the scene of a plan, whole or not at all.

    Args:
        plan: The grasp.
        folder: Made; an earlier export in it is replaced.
        physics: How MuJoCo computes, or the name of a preset; defaults if None.

    Returns:
        The files.

    Raises:
        TaskError: The hand has actuators that follow no position, or the plan has no forces.
        ModelError: The scene has parts that cannot be written: tendons through space, ties between
            bodies.
        FileFormatError: The folder holds something else, or cannot be written.
    """
    target = Path(folder)
    keys = key_frames(plan)
    scene, spec = plain_scene(plan, PRESETS.given(physics))
    meshes = mesh_files(scene.model)
    hand, about = plan.task.hand, "hand.urdf is rooted at the hand's base"
    texts = {mesh.file: mesh.text for mesh in (*meshes, *ellipsoid_files(scene.model))}
    texts[SCENE] = scene_mjcf(scene, spec, keys, meshes)
    effort = _effort(scene)
    for name, body, title in (
        (HAND_URDF, scene.base_body, hand.name),
        (OBJECT_URDF, scene.object_body, OBJECT),
    ):
        texts[name] = body_urdf(scene.model, body, title, meshes, effort)
    texts[CHECK] = Path(check_script.__file__).read_text(encoding="utf-8")
    urdf = {"frames": about, "cannot_say": not_in_urdf(scene.model)}
    data = physics_data(plan, scene, keys, urdf)
    with _replaced(target) as home:
        (home / MESHES).mkdir()
        for name, text in texts.items():
            (home / name).write_text(text, encoding="utf-8")
        write_json(data, home / PHYSICS)
    return _files_in(target)


@contextmanager
def _replaced(target: Path) -> Iterator[Path]:
    """A new folder to be filled, which then takes the place of one that ``_need_ours`` lets go."""
    _need_ours(target)
    try:
        with tempfile.TemporaryDirectory(dir=target.absolute().parent, prefix=".export-") as made:
            home = Path(made) / "new"
            home.mkdir()
            yield home
            if target.exists():
                os.replace(target, Path(made) / "old")
            os.replace(home, target)
    except OSError as error:
        raise FileFormatError(f"cannot write {target}: {error.strerror}") from error


def _files_in(folder: Path) -> tuple[Path, ...]:
    return tuple(sorted(path for path in folder.rglob("*") if path.is_file()))


def _effort(scene: Scene) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Largest torque (nv,) of the actuators on each degree of freedom, force ranges alone."""
    hand = scene.task.hand
    most = np.abs(hand.actuation.force_range).max(axis=1)
    with np.errstate(invalid="ignore"):
        of_joint = np.where(hand.actuation.moment, np.abs(hand.actuation.moment) * most[:, None], 0)
    out = np.zeros(scene.model.nv)
    out[scene.hand_dof] = of_joint.sum(axis=0)
    return out


def _need_ours(folder: Path) -> None:
    """A folder is only replaced if it is empty or an earlier export, with nothing beside it."""
    if not folder.exists():
        if not folder.absolute().parent.is_dir():
            raise FileFormatError(f"there is no folder {folder.parent}; make it, or name another")
        return
    if folder.is_dir() and not any(folder.iterdir()):
        return
    try:
        ours = json.loads((folder / PHYSICS).read_text(encoding="utf-8"))["format"]
    except (OSError, ValueError, KeyError, TypeError):
        ours = ""
    if ours != PHYSICS_FORMAT:
        raise FileFormatError(
            f"{folder} is no earlier export of a scene; name another folder, or empty it"
        )
    own = {SCENE, HAND_URDF, OBJECT_URDF, MESHES, PHYSICS, CHECK}
    if others := sorted(entry.name for entry in folder.iterdir() if entry.name not in own):
        raise FileFormatError(
            f"{folder} holds an earlier export and {', '.join(others)}, which would be lost; name "
            "another folder, or move them"
        )


def _write(plans: Sequence[GraspPlan], path: Path, writing: Writing) -> tuple[Path, ...]:
    """One plan to the folder itself, several to numbered folders in it."""
    del writing
    if len(plans) == 1:
        return export_scene(plans[0], path)
    if path.exists() and not (path.is_dir() and not any(path.iterdir())):
        raise FileFormatError(
            f"{path} exists already; several scenes are written into a new folder: name another"
        )
    with _replaced(path) as home:
        for k, plan in enumerate(plans):
            export_scene(plan, home / f"{k:03d}")
    return _files_in(path)


MJCF_SCENE = register_format(
    GraspFormat(
        name="mjcf-scene",
        title="a folder with MJCF, key frames, URDF, meshes and the physics beside it",
        suffixes=(),
        loses="the way to the grasp; table and obstacles are left out",
        recognises=lambda path: False,
        write=_write,
    )
)
"""Another simulator starts from it; see the module."""
