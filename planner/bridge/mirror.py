"""A hand of the other side: a model reflected through a coordinate plane.

With M = diag(signs) the reflection, every frame of the model goes to the frame that the mirror
shows, conjugated so that it stays right-handed: position p -> M p, rotation R -> M R M, with the
same M in the coordinates of every body. A pose T of a body in any other then becomes M T M, at the
same joint positions. An axis of rotation is an axial vector, a -> -M a; a direction of sliding is a
polar one, a -> M a. Names, joint ranges, actuators, tendons, masses and materials stay.

M is a coordinate reflection, because each primitive and each principal inertia is symmetric about
the coordinate planes of its own frame; so M R M places its mirror image, and nothing is rounded.
"""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from planner.bridge.load import compile_spec
from planner.bridge.mesh_files import HIDDEN_GROUP
from planner.errors import HandError
from planner.spatial import FloatArray

_SYMMETRIC = {
    int(mujoco.mjtGeom.mjGEOM_SPHERE),
    int(mujoco.mjtGeom.mjGEOM_CAPSULE),
    int(mujoco.mjtGeom.mjGEOM_CYLINDER),
    int(mujoco.mjtGeom.mjGEOM_BOX),
    int(mujoco.mjtGeom.mjGEOM_ELLIPSOID),
}
_PLACED_EQUALITIES = {
    int(mujoco.mjtEq.mjEQ_CONNECT),
    int(mujoco.mjtEq.mjEQ_WELD),
}
_HINGE = int(mujoco.mjtJoint.mjJNT_HINGE)
_QUATERNION = mujoco.mjtOrientation.mjORIENTATION_QUAT
_IDENTITY = (1.0, 0.0, 0.0, 0.0)


def mirror_spec(spec: Any, signs: FloatArray, what: str) -> None:
    """Reflect a ``mujoco.MjSpec`` of hinges and slides, in place.

    A spec can hold a pose in many ways (Euler angles, end points, nested frames, inertia from
    geometry). It is therefore compiled first, and the compiled poses are written back, reflected.
    Cameras and lights are removed: a scene brings its own. So are meshes that are only shown; what
    collides is drawn in their place.

    Args:
        spec: The model; afterwards its mirror image, ready to be compiled or attached.
        signs: Diagonal of M, (3,): one -1 for the normal of the mirror plane, two +1.
        what: What is being mirrored, for messages.

    Raises:
        ModelError: MuJoCo refuses the model.
        HandError: The model has a part whose mirror image is not supported: a mesh, a plane or a
            height field, or an equality that ties two bodies at given points.
    """
    for geom in [g for g in spec.geoms if g.meshname and _is_only_shown(g)]:
        for other in geom.parent.geoms:
            other.group = 0 if other.group == HIDDEN_GROUP else other.group
        spec.delete(geom)
    model = compile_spec(spec, what)
    _check(spec, what)
    for element in (*spec.cameras, *spec.lights):
        spec.delete(element)
    turn = np.array([1.0, *-signs])  # of a quaternion w, x, y, z under R -> M R M
    for frame in spec.frames:  # the compiled poses below include them
        frame.pos, frame.quat, frame.alt.type = np.zeros(3), _IDENTITY, _QUATERNION
    for body in spec.bodies[1:]:
        i = body.id
        _place(body, signs * model.body_pos[i], turn * model.body_quat[i])
        if model.body_mass[i] > 0:  # as compiled: not to be derived or scaled once more
            body.explicitinertial = True
            body.mass, body.inertia = model.body_mass[i], model.body_inertia[i]
            body.fullinertia = np.full(6, np.nan)
            body.ipos, body.iquat = signs * model.body_ipos[i], turn * model.body_iquat[i]
            body.ialt.type = _QUATERNION
    for geom in spec.geoms:
        i = geom.id
        _place(geom, signs * model.geom_pos[i], turn * model.geom_quat[i])
        geom.fromto, geom.size = np.full(6, np.nan), model.geom_size[i]
    for site in spec.sites:
        i = site.id
        _place(site, signs * model.site_pos[i], turn * model.site_quat[i])
        site.fromto, site.size = np.full(6, np.nan), model.site_size[i]
    for joint in spec.joints:
        i = joint.id
        polar = -1.0 if int(model.jnt_type[i]) == _HINGE else 1.0
        joint.pos, joint.axis = signs * model.jnt_pos[i], polar * signs * model.jnt_axis[i]


def _is_only_shown(geom: Any) -> bool:
    return not (geom.contype or geom.conaffinity) and 0.0 in (geom.density, geom.mass)


def _place(element: Any, position: FloatArray, quaternion: FloatArray) -> None:
    """Set a pose as position and quaternion; the other ways to give an orientation are dropped."""
    element.pos, element.quat, element.alt.type = position, quaternion, _QUATERNION


def _check(spec: Any, what: str) -> None:
    for element in (*spec.geoms, *spec.sites):
        if int(element.type) not in _SYMMETRIC or element.meshname:
            raise HandError(
                f"{what}: {element.name or 'a geom without name'!r} is a mesh, a plane or a height "
                "field, and mirroring a mesh is not supported; use spheres, capsules, cylinders, "
                "boxes or ellipsoids, or give the other hand a model of its own"
            )
    for equality in spec.equalities:
        if int(equality.type) in _PLACED_EQUALITIES:
            raise HandError(
                f"{what}: equality {equality.name!r} ties two bodies at points, and mirroring that "
                "is not supported; couple joints or tendons, or give the other hand a model of its "
                "own"
            )
