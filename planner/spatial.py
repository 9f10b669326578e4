"""Frames and wrenches: thin helpers over ``pinocchio.SE3``.

Conventions used throughout the package:
  - SI units, radians, z up. A pose is a ``pinocchio.SE3`` named as a sentence: ``T_world_object``
    maps coordinates in the object's frame to coordinates in the world's.
  - A flat quaternion (files, MuJoCo) is w, x, y, z.
  - A wrench is [force; torque], on the object, about its centre of mass, in world axes unless the
    name says otherwise.
  - A contact normal points INTO the object; a contact frame's columns are
    [normal, tangent1, tangent2], right-handed.
"""

from __future__ import annotations

from importlib import import_module
from math import isfinite
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from planner.errors import ContactError, shown

__all__ = [
    "SE3",
    "FloatArray",
    "IntArray",
    "contact_frames",
    "cross",
    "fixed_array",
    "interpolate_path",
    "minimum_jerk",
    "pose_change",
    "pose_from_wxyz",
    "pose_to_wxyz",
    "rotation_angle",
    "shifted",
    "signed_twist",
    "skew",
]

FloatArray: TypeAlias = NDArray[np.float64]
"""An array of float64; docstrings say its shape and unit."""
IntArray: TypeAlias = NDArray[np.int64]
"""An array of int64: indices, mostly."""
if TYPE_CHECKING:
    SE3: TypeAlias = Any  # Pinocchio ships no types
    """A pose, ``pinocchio.SE3``: ``T_a_b`` maps coordinates in b to those in a."""
else:

    def __getattr__(name: str) -> Any:
        """``SE3`` is Pinocchio's, which is loaded when the first pose is asked for."""
        if name != "SE3":
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        return _pinocchio().SE3


def _pinocchio() -> Any:
    """Pinocchio, loaded at the first call: contacts on bare arrays work without it."""
    return import_module("pinocchio")


_AXES = np.eye(3)


def fixed_array(values: ArrayLike) -> FloatArray:
    """A read-only copy of numbers, of any shape."""
    array: FloatArray = np.array(values, dtype=np.float64)
    array.flags.writeable = False
    return array


def skew(v: FloatArray) -> FloatArray:
    """Cross-product matrix: ``skew(a) @ b == np.cross(a, b)``.

    Args:
        v: Vectors, shape (..., 3).

    Returns:
        Matrices, shape (..., 3, 3).
    """
    v = np.asarray(v, dtype=np.float64)
    out = np.zeros((*v.shape[:-1], 3, 3))
    out[..., 0, 1], out[..., 0, 2] = -v[..., 2], v[..., 1]
    out[..., 1, 0], out[..., 1, 2] = v[..., 2], -v[..., 0]
    out[..., 2, 0], out[..., 2, 1] = -v[..., 1], v[..., 0]
    return out


def cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """Cross products of vectors (..., 3): as ``np.cross``, in a fifth of its 30 us for a few."""
    out = np.empty(np.broadcast_shapes(a.shape, b.shape))
    a0, a1, a2 = a[..., 0], a[..., 1], a[..., 2]
    b0, b1, b2 = b[..., 0], b[..., 1], b[..., 2]
    out[..., 0] = a1 * b2 - a2 * b1
    out[..., 1] = a2 * b0 - a0 * b2
    out[..., 2] = a0 * b1 - a1 * b0
    return out


def contact_frames(normals: FloatArray) -> FloatArray:
    """Right-handed frames [normal, tangent1, tangent2] from normals.

    tangent1 is normal x e, where e is the coordinate axis least aligned with the normal (the first
    of equals), so that the frame is well conditioned for every normal. It jumps where e changes:
    keep a frame once it is made, and turn it with its contact.

    Args:
        normals: Directions into the object, shape (n, 3), of any positive length.

    Returns:
        Rotation matrices, shape (n, 3, 3), columns [normal, tangent1, tangent2].

    Raises:
        ContactError: A normal is not finite or has no length.
    """
    try:
        n = np.atleast_2d(np.asarray(normals, dtype=np.float64))
    except (TypeError, ValueError, OverflowError) as fault:
        raise ContactError(
            f"normals are {shown(normals)} ({fault}); give numbers (n, 3)"
        ) from fault
    if n.ndim != 2 or n.shape[1] != 3:
        raise ContactError(f"normals have shape {n.shape}; give an array of shape (n, 3)")
    if not isfinite(np.vdot(n, n)):
        raise ContactError("normals hold NaN, infinity or 1e154; give finite directions")
    length = np.sqrt((n * n).sum(axis=1))
    if length.min(initial=np.inf) < 1e-9:
        bad = int(length.argmin())
        raise ContactError(f"normal {bad} has no direction: {n[bad].tolist()}; give a unit vector")
    frames = np.empty((len(n), 3, 3))
    normal = frames[:, :, 0] = n / length[:, None]
    tangent = cross(normal, _AXES[np.abs(normal).argmin(axis=1)])
    tangent /= np.sqrt((tangent * tangent).sum(axis=1))[:, None]
    frames[:, :, 1], frames[:, :, 2] = tangent, cross(normal, tangent)
    return frames


def pose_from_wxyz(position: FloatArray, quat_wxyz: FloatArray) -> SE3:
    """Pose from a position (3,) in m and a quaternion w, x, y, z (4,), normalised here."""
    w, x, y, z = np.asarray(quat_wxyz, dtype=np.float64) / np.linalg.norm(quat_wxyz)
    pin = _pinocchio()
    return pin.SE3(pin.Quaternion(w, x, y, z).toRotationMatrix(), np.asarray(position, dtype=float))


def pose_to_wxyz(pose: SE3) -> tuple[FloatArray, FloatArray]:
    """Position (3,) in m and unit quaternion w, x, y, z (4,) with w >= 0 of a pose."""
    quat = _pinocchio().Quaternion(pose.rotation)
    wxyz = np.array([quat.w, quat.x, quat.y, quat.z])
    return np.array(pose.translation), wxyz if wxyz[0] >= 0 else -wxyz


def rotation_angle(rotation: FloatArray) -> float:
    """Angle in rad, in [0, pi], by which a rotation matrix (3, 3) turns."""
    return float(np.linalg.norm(_pinocchio().log3(np.asarray(rotation, dtype=np.float64))))


def shifted(pose: SE3, by: ArrayLike) -> SE3:
    """A pose moved by (3,), m, in the axes that it is seen in."""
    return _pinocchio().SE3(pose.rotation, pose.translation + np.asarray(by))


def pose_change(before: SE3, after: SE3) -> tuple[float, float]:
    """How far a pose has moved: distance of the origins, mm, and angle of the rotation, degrees."""
    moved = 1e3 * float(np.linalg.norm(after.translation - before.translation))
    return moved, float(np.rad2deg(rotation_angle(before.rotation.T @ after.rotation)))


def signed_twist(rotation: FloatArray, axis: FloatArray, *, near: float = 0.0) -> float:
    """Turn of a rotation about an axis, with its sign, whatever it tilts beside that.

    The rotation is split into a swing, whose axis is perpendicular to ``axis``, after a turn about
    ``axis`` (swing-twist decomposition): with the quaternion w, v the turn is 2 atan2(v . a, w).

    Args:
        rotation: (3, 3).
        axis: (3,), unit.
        near: The turn is told up to whole turns; the one nearest to this is taken, rad. A turn
            that is followed step by step so counts beyond half a turn.

    Returns:
        rad; within pi of ``near``. A swing by 180 degrees leaves it undetermined.
    """
    quat = _pinocchio().Quaternion(np.asarray(rotation, dtype=np.float64))
    turn = 2.0 * float(np.arctan2(axis @ np.array([quat.x, quat.y, quat.z]), quat.w))
    return turn + 2.0 * np.pi * round((near - turn) / (2.0 * np.pi))


def interpolate_path(path: FloatArray, share: FloatArray) -> FloatArray:
    """Joints (k, n) at shares (k,) in [0, 1] of a path (m, n) of evenly spaced postures."""
    at = np.linspace(0.0, 1.0, len(path))
    return np.column_stack([np.interp(share, at, column) for column in path.T])


def minimum_jerk(s: FloatArray) -> FloatArray:
    """Minimum-jerk profile 10 s^3 - 15 s^4 + 6 s^5 of s in [0, 1]: at rest at both ends."""
    return s**3 * (10 + s * (6 * s - 15))
