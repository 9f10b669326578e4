"""``physics.json``: what decides whether an exported grasp holds, in words and numbers, by name.

Units are m, kg, s, N, rad (N m and rad of a hinge are N and m of a slide); quaternions are w, x, y,
z. Names are those of ``scene.xml`` and ``hand.urdf``; ``joint`` of a joint is its name in the
hand's own model.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np

from planner.arrays import finite
from planner.hands.hand import Hand
from planner.plan import GraspPlan
from planner.spatial import SE3, FloatArray, pose_to_wxyz
from planner.version import written_by
from sim.scene import HAND_PREFIX, OBJECT, Scene
from sim.scene_export.check import MOST_DEG, MOST_MM, SECONDS
from sim.scene_export.keyframes import KeyFrame

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
            "carrier": "the base stands fixed in the world"
            if task.hand.arm is None
            else "the root of the arm stands fixed; the arm's servos carry the hand",
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
