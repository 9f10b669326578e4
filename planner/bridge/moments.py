"""Moment arms of actuators and coefficients of fixed tendons: rows that are the same at every q."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from planner.errors import ModelError
from planner.spatial import FloatArray

__all__ = ["actuator_row", "is_fixed_tendon", "tendon_row"]

_AXES = {int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE)}
_JOINTS = {int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT)}
_TENDON = int(mujoco.mjtTrn.mjTRN_TENDON)
_WRAP_JOINT = int(mujoco.mjtWrap.mjWRAP_JOINT)


def actuator_row(model: Any, actuator: int) -> FloatArray | None:
    """Moment arms (nv,) of an actuator, m/rad or -: joint torque = row * its force.

    Of gears on hinges and slides (in the parent's axes or the child's: the same for one axis) and
    of fixed tendons. None if the arms depend on q.
    """
    kind, target = int(model.actuator_trntype[actuator]), int(model.actuator_trnid[actuator, 0])
    gear = float(model.actuator_gear[actuator, 0])
    if kind in _JOINTS and int(model.jnt_type[target]) in _AXES:
        row = np.zeros(model.nv)
        row[int(model.jnt_dofadr[target])] = gear
        return row
    if kind == _TENDON and is_fixed_tendon(model, target):
        return gear * tendon_row(model, target)
    return None


def is_fixed_tendon(model: Any, tendon: int) -> bool:
    """Whether a tendon is a sum over joints, and does not run through space."""
    start, count = int(model.tendon_adr[tendon]), int(model.tendon_num[tendon])
    return all(int(kind) == _WRAP_JOINT for kind in model.wrap_type[start : start + count])


def tendon_row(model: Any, tendon: int) -> FloatArray:
    """Coefficients (nv,) of a fixed tendon: length = row @ q.

    Raises:
        ModelError: The tendon runs through space.
    """
    if not is_fixed_tendon(model, tendon):
        name = model.tendon(tendon).name
        raise ModelError(
            f"tendon {name!r} runs through space; only fixed tendons, which are linear in the "
            f"joints, are read: write drop_couplings = [{name!r}] under [repair] if the hand "
            "works without it"
        )
    row = np.zeros(model.nv)
    start = int(model.tendon_adr[tendon])
    for w in range(start, start + int(model.tendon_num[tendon])):
        row[int(model.jnt_dofadr[int(model.wrap_objid[w])])] += float(model.wrap_prm[w])
    return row
