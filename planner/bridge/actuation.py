"""The actuators and stops of a compiled MuJoCo model as a ``planner.actuation.Actuation``."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from planner.actuation import Actuation
from planner.errors import ModelError
from planner.spatial import FloatArray

__all__ = ["actuation_from_mujoco"]

_JOINT = int(mujoco.mjtTrn.mjTRN_JOINT)
_TENDON = int(mujoco.mjtTrn.mjTRN_TENDON)
_FIXED_GAIN = int(mujoco.mjtGain.mjGAIN_FIXED)
_BIAS_NONE = int(mujoco.mjtBias.mjBIAS_NONE)
_BIAS_AFFINE = int(mujoco.mjtBias.mjBIAS_AFFINE)
_NO_DYNAMICS = int(mujoco.mjtDyn.mjDYN_NONE)
_WRAP_JOINT = int(mujoco.mjtWrap.mjWRAP_JOINT)


def actuation_from_mujoco(model: Any) -> Actuation:
    """Moment matrix, affine laws, ranges and one-sided stops of a model of hinges and slides.

    Raises:
        ModelError: An actuator drives neither a joint nor a fixed tendon, or follows a law that is
            not affine in ctrl, length and velocity.
    """
    moment = np.zeros((model.nu, model.nv))
    gain, bias = np.zeros(model.nu), np.zeros((model.nu, 3))
    for i in range(model.nu):
        name = model.actuator(i).name
        target, gear = int(model.actuator_trnid[i, 0]), float(model.actuator_gear[i, 0])
        kind = int(model.actuator_trntype[i])
        if kind == _JOINT:
            moment[i, int(model.jnt_dofadr[target])] = gear
        elif kind == _TENDON:
            moment[i] = gear * _tendon_row(model, target)
        else:
            raise ModelError(f"actuator {name!r} drives neither a joint nor a fixed tendon")
        law = int(model.actuator_gaintype[i]), int(model.actuator_biastype[i])
        if law[0] != _FIXED_GAIN or law[1] not in (_BIAS_NONE, _BIAS_AFFINE):
            raise ModelError(f"actuator {name!r} is not affine in ctrl, length and velocity")
        if int(model.actuator_dyntype[i]) != _NO_DYNAMICS:
            raise ModelError(
                f"actuator {name!r} has dynamics of its own (a filter or an integrator); use one "
                "whose force follows ctrl at once"
            )
        gain[i] = model.actuator_gainprm[i, 0]
        if law[1] == _BIAS_AFFINE:
            bias[i] = model.actuator_biasprm[i, :3]
    stops, values, names = _stops(model)
    return Actuation(
        names=tuple(model.actuator(i).name for i in range(model.nu)),
        joint_names=tuple(model.joint(j).name for j in range(model.njnt)),
        moment=moment,
        length0=np.zeros(model.nu),
        gain=gain,
        bias=bias,
        force_range=_ranges(model.actuator_forcerange, model.actuator_forcelimited),
        ctrl_range=_ranges(model.actuator_ctrlrange, model.actuator_ctrllimited),
        stop_rows=stops,
        stop_values=values,
        stop_names=names,
    )


def _ranges(ranges: FloatArray, limited: FloatArray) -> FloatArray:
    out = np.tile([-np.inf, np.inf], (len(ranges), 1))
    active = np.asarray(limited, dtype=bool)
    out[active] = np.asarray(ranges)[active]
    return out


def _tendon_row(model: Any, tendon: int) -> FloatArray:
    """Coefficients (nv,) of a fixed tendon: length = row @ q."""
    row = np.zeros(model.nv)
    start = int(model.tendon_adr[tendon])
    for w in range(start, start + int(model.tendon_num[tendon])):
        if int(model.wrap_type[w]) != _WRAP_JOINT:
            name = model.tendon(tendon).name
            raise ModelError(f"tendon {name!r} runs through space; only fixed tendons are read")
        row[int(model.jnt_dofadr[int(model.wrap_objid[w])])] = float(model.wrap_prm[w])
    return row


def _stops(model: Any) -> tuple[FloatArray, FloatArray, tuple[str, ...]]:
    """One-sided stops S q >= s of limited joints and tendons."""
    rows: list[FloatArray] = []
    values: list[float] = []
    names: list[str] = []
    limited = [
        (f"joint {model.joint(j).name}", np.eye(model.nv)[int(model.jnt_dofadr[j])], range_)
        for j, range_ in enumerate(model.jnt_range)
        if model.jnt_limited[j]
    ] + [
        (f"tendon {model.tendon(t).name}", _tendon_row(model, t), range_)
        for t, range_ in enumerate(model.tendon_range)
        if model.tendon_limited[t]
    ]
    for name, row, (low, high) in limited:
        rows += [row, -row]
        values += [float(low), -float(high)]
        names += [f"{name} lower", f"{name} upper"]
    return np.array(rows).reshape(-1, model.nv), np.array(values), tuple(names)
