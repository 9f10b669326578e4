"""URDF of a compiled body and what hangs on it, and what URDF cannot say of it.

A link stands in the frame of the joint that moves it, as URDF wants; bodies with several joints get
a link without mass between them. A capsule becomes a cylinder and two balls, an ellipsoid a mesh.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np
import pinocchio as pin

from planner.shapes import Ellipsoid
from planner.shapes.mesh import surface_triangles
from planner.spatial import SE3, FloatArray, pose_from_wxyz
from sim.scene.export.mjcf import MESHES, MeshFile, plain_text

_FREE, _SLIDE, _HINGE = (
    int(getattr(mujoco.mjtJoint, f"mjJNT_{name}")) for name in ("FREE", "SLIDE", "HINGE")
)
_SPHERE, _CAPSULE, _ELLIPSOID, _CYLINDER, _BOX, _MESH = (
    int(getattr(mujoco.mjtGeom, f"mjGEOM_{name}"))
    for name in ("SPHERE", "CAPSULE", "ELLIPSOID", "CYLINDER", "BOX", "MESH")
)

_NO_EFFORT_LIMIT = 1e3
"""What URDF, which wants a number, says of a joint whose torque nothing limits, N m or N."""

_NO_SPEED_LIMIT = 1e3
"""The same of speed, rad/s or m/s: our models limit none."""


def body_urdf(
    model: Any, root: int, name: str, meshes: Sequence[MeshFile], effort: FloatArray
) -> str:
    """The text of a URDF file; its root link has the frame of the body.

    Args:
        model: Compiled ``mujoco.MjModel``.
        root: Id of the body at the root; how it is fixed or moves is left out.
        name: Of the robot.
        meshes: Files of the model's meshes, by number.
        effort: Largest force (nv,) of each degree of freedom, N m or N; infinite for none.
    """
    robot = ET.Element("robot", name=name)
    frames = {root: (_link(robot, model, root, SE3.Identity(), meshes), SE3.Identity())}
    for body in range(root + 1, model.nbody):
        parent = int(model.body_parentid[body])
        if parent not in frames:
            continue
        above, T_link_parent = frames[parent]
        placed = T_link_parent * pose_from_wxyz(model.body_pos[body], model.body_quat[body])
        below = SE3.Identity()
        first, count = int(model.body_jntadr[body]), int(model.body_jntnum[body])
        label = model.body(body).name
        for k, j in enumerate(range(first, first + count)):
            at = placed * below * SE3(np.eye(3), model.jnt_pos[j]) * _back(model, j)
            last = k == count - 1
            child = label if last else f"{label}/{k}"
            _joint(robot, model, j, above, child, at, effort)
            if not last:
                ET.SubElement(robot, "link", name=child)
            above, placed = child, SE3.Identity()
            below = SE3(np.eye(3), -np.array(model.jnt_pos[j]))
        if not count:
            _fixed(robot, above, label, placed)
        frames[body] = (_link(robot, model, body, below, meshes), below)
    ET.indent(robot)
    return ET.tostring(robot, encoding="unicode") + "\n"


def ellipsoid_files(model: Any) -> tuple[MeshFile, ...]:
    """Meshes of the ellipsoids that collide, which URDF does not have."""
    return tuple(
        MeshFile(file=_ellipsoid_name(g), vertices=vertices, faces=faces)
        for g in range(model.ngeom)
        if int(model.geom_type[g]) == _ELLIPSOID
        for vertices, faces in [
            surface_triangles(Ellipsoid(tuple((2.0 * model.geom_size[g]).tolist())))
        ]
    )


def not_in_urdf(model: Any) -> list[str]:
    """What of a hand's model a URDF cannot say, a sentence each."""
    out = ["servo gains, armature (reflected inertia) and commands: see physics.json"]
    if model.ntendon:
        out.append(
            f"{model.ntendon} tendons, which let one actuator drive several joints and stop joints "
            "against each other: see actuators and stops in physics.json"
        )
    if model.neq:
        out.append(f"{model.neq} couplings between joints: see couplings in physics.json")
    out += ["friction and stiffness of contacts: see contact in physics.json"]
    return out


def _back(model: Any, j: int) -> SE3:
    """Pose of the joint at zero relative to where the model was drawn."""
    if int(model.jnt_type[j]) not in (_HINGE, _SLIDE):
        return SE3.Identity()
    ref, axis = float(model.qpos0[int(model.jnt_qposadr[j])]), np.array(model.jnt_axis[j])
    if int(model.jnt_type[j]) == _HINGE:
        return SE3(pin.exp3(-ref * axis), np.zeros(3))
    return SE3(np.eye(3), -ref * axis)


def _joint(
    robot: ET.Element,
    model: Any,
    j: int,
    parent: str,
    child: str,
    at: SE3,
    effort: FloatArray,
) -> None:
    hinge, dof = int(model.jnt_type[j]) == _HINGE, int(model.jnt_dofadr[j])
    limited = bool(model.jnt_limited[j])
    kind = ("revolute" if limited else "continuous") if hinge else "prismatic"
    joint = ET.SubElement(robot, "joint", name=model.joint(j).name, type=kind)
    _origin(joint, at)
    ET.SubElement(joint, "parent", link=parent)
    ET.SubElement(joint, "child", link=child)
    ET.SubElement(joint, "axis", xyz=plain_text(model.jnt_axis[j]))
    most = float(effort[dof])
    limit = {
        "effort": repr(most if np.isfinite(most) else _NO_EFFORT_LIMIT),
        "velocity": repr(_NO_SPEED_LIMIT),
    }
    if kind != "continuous":
        low, high = model.jnt_range[j] if limited else (-_NO_EFFORT_LIMIT, _NO_EFFORT_LIMIT)
        limit |= {"lower": repr(float(low)), "upper": repr(float(high))}
    ET.SubElement(joint, "limit", limit)
    ET.SubElement(
        joint,
        "dynamics",
        damping=repr(float(model.dof_damping[dof])),
        friction=repr(float(model.dof_frictionloss[dof])),
    )


def _fixed(robot: ET.Element, parent: str, child: str, at: SE3) -> None:
    joint = ET.SubElement(robot, "joint", name=f"{child}/fixed", type="fixed")
    _origin(joint, at)
    ET.SubElement(joint, "parent", link=parent)
    ET.SubElement(joint, "child", link=child)


def _link(
    robot: ET.Element,
    model: Any,
    body: int,
    T_link_body: SE3,
    meshes: Sequence[MeshFile],
) -> str:
    """Add the link of a body; its name."""
    name: str = model.body(body).name
    link = ET.SubElement(robot, "link", name=name)
    if model.body_mass[body] > 0:
        inertial = ET.SubElement(link, "inertial")
        _origin(
            inertial, T_link_body * pose_from_wxyz(model.body_ipos[body], model.body_iquat[body])
        )
        ET.SubElement(inertial, "mass", value=repr(float(model.body_mass[body])))
        ixx, iyy, izz = (repr(float(x)) for x in model.body_inertia[body])
        ET.SubElement(inertial, "inertia", ixx=ixx, iyy=iyy, izz=izz, ixy="0", ixz="0", iyz="0")
    for g in np.flatnonzero(model.geom_bodyid == body).tolist():
        collides = bool(model.geom_contype[g] or model.geom_conaffinity[g])
        at = T_link_body * pose_from_wxyz(model.geom_pos[g], model.geom_quat[g])
        for place, shape, attributes in _parts(model, g, meshes):
            for tag in ("visual", "collision") if collides else ("visual",):
                part = ET.SubElement(link, tag)
                _origin(part, at * place)
                ET.SubElement(ET.SubElement(part, "geometry"), shape, attributes)
    return name


def _parts(model: Any, g: int, meshes: Sequence[MeshFile]) -> list[tuple[SE3, str, dict[str, str]]]:
    """Pose in the geom, element and attributes of each shape that stands for a geom."""
    kind, (a, b, _) = int(model.geom_type[g]), model.geom_size[g].tolist()
    here = SE3.Identity()
    if kind == _MESH:
        return [(here, "mesh", {"filename": meshes[int(model.geom_dataid[g])].file})]
    if kind == _ELLIPSOID:
        return [(here, "mesh", {"filename": _ellipsoid_name(g)})]
    if kind == _BOX:
        return [(here, "box", {"size": plain_text(2.0 * model.geom_size[g])})]
    if kind == _SPHERE:
        return [(here, "sphere", {"radius": repr(a)})]
    if kind not in (_CAPSULE, _CYLINDER):
        return []
    out = [(here, "cylinder", {"radius": repr(a), "length": repr(2.0 * b)})]
    if kind == _CAPSULE:
        for end in (-b, b):
            out.append((SE3(np.eye(3), np.array([0.0, 0.0, end])), "sphere", {"radius": repr(a)}))
    return out


def _ellipsoid_name(g: int) -> str:
    return f"{MESHES}/ellipsoid-{g}.obj"


def _origin(element: ET.Element, pose: SE3) -> None:
    rpy = pin.rpy.matrixToRpy(pose.rotation)
    ET.SubElement(element, "origin", xyz=plain_text(pose.translation), rpy=plain_text(rpy))
