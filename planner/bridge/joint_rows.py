"""Rows over the joints of a compiled MuJoCo model that are the same at every q.

They are moment arms of actuators, coefficients of fixed tendons, and the couplings C q = d that the
model holds by itself. Equalities between joints (URDF ``mimic`` becomes one) and between fixed
tendons hold

    x1 - x1_0 = c0 + c1 (x2 - x2_0),

x a joint position or a tendon length and x_0 its value at ``qpos0`` (MuJoCo documentation, XML
reference, ``equality/joint``); without a second part, x1 - x1_0 = c0.
"""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from planner.couplings import Coupling
from planner.errors import ModelError
from planner.spatial import FloatArray

_AXES = {int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE)}
_JOINTS = {int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT)}
_TENDON = int(mujoco.mjtTrn.mjTRN_TENDON)
_WRAP_JOINT = int(mujoco.mjtWrap.mjWRAP_JOINT)
_EQ_JOINT = int(mujoco.mjtEq.mjEQ_JOINT)
_EQ_TENDON = int(mujoco.mjtEq.mjEQ_TENDON)


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


def couplings_from_mujoco(model: Any) -> tuple[Coupling, ...]:
    """Every active equality of a model of hinges and slides, in the model's order.

    Raises:
        ModelError: An equality is not linear in the joints, or ties bodies instead of joints.
    """
    out = []
    for i in range(model.neq):
        if not model.eq_active0[i]:
            continue
        name, kind = model.equality(i).name, int(model.eq_type[i])
        if kind not in (_EQ_JOINT, _EQ_TENDON):
            raise ModelError(
                f"equality {name!r} closes a loop between bodies, and only couplings of joints and "
                "fixed tendons are read; replace it by a <joint> or <tendon> equality, or write "
                f"drop_couplings = [{name!r}] under [repair]"
            )
        first, second = int(model.eq_obj1id[i]), int(model.eq_obj2id[i])
        row, value = _part(model, kind, first)
        constant, slope, *higher = (float(c) for c in model.eq_data[i, :5])
        value += constant
        if second >= 0:
            if any(higher):
                raise ModelError(
                    f"equality {name!r} has polycoef {[constant, slope, *higher]}, which is not "
                    "linear; only the first two coefficients may differ from 0"
                )
            other, other_value = _part(model, kind, second)
            row, value = row - slope * other, value - slope * other_value
        out.append(Coupling(name=name, row=row, value=value, one_sided=False))
    return tuple(out)


def _part(model: Any, kind: int, number: int) -> tuple[FloatArray, float]:
    """Row (nv,) of a joint or tendon, and its value at ``qpos0``."""
    if kind == _EQ_TENDON:
        return tendon_row(model, number), float(model.tendon_length0[number])
    row = np.zeros(model.nv)
    row[int(model.jnt_dofadr[number])] = 1.0
    return row, float(model.qpos0[int(model.jnt_qposadr[number])])
