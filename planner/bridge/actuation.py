"""Actuators, stops and springs of a compiled MuJoCo model, as an ``Actuation``.

Actuators count by the force that they make at rest: the lag of a filter is only in the simulation.
"""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from planner.bridge.pinocchio_model import actuator_row, couplings_from_mujoco, tendon_row
from planner.errors import ModelError
from planner.joints.actuation import STOP_TOL, Actuation
from planner.spatial import FloatArray

_TENDON = int(mujoco.mjtTrn.mjTRN_TENDON)
_FIXED_GAIN = int(mujoco.mjtGain.mjGAIN_FIXED)
_BIAS_NONE = int(mujoco.mjtBias.mjBIAS_NONE)
_BIAS_AFFINE = int(mujoco.mjtBias.mjBIAS_AFFINE)
_FILTERS = {int(mujoco.mjtDyn.mjDYN_FILTER), int(mujoco.mjtDyn.mjDYN_FILTEREXACT)}
_AT_REST = {int(mujoco.mjtDyn.mjDYN_NONE)} | _FILTERS


def actuation_from_mujoco(model: Any) -> Actuation:
    """Moment matrix, affine laws, ranges, stops and springs of a model of hinges and slides.

    Raises:
        ModelError: An actuator drives neither a joint nor a fixed tendon, follows a law that is
            not affine in ctrl, length and velocity, or runs away from where it is sent; a force
            limit or a spring is of a kind that is not read; a tendon or an equality acts on no
            joint; or an equality is not linear.
    """
    moment = np.zeros((model.nu, model.nv))
    gain, bias = np.zeros(model.nu), np.zeros((model.nu, 3))
    if model.nactuator != model.nu:
        raise ModelError(
            f"the model has {model.nactuator} actuators with {model.nu} commands; use actuators "
            "that take one command each"
        )
    for i in range(model.nu):
        name = model.actuator(i).name
        row = actuator_row(model, i)
        if row is None:
            if int(model.actuator_trntype[i]) == _TENDON:
                tendon_row(model, int(model.actuator_trnid[i, 0]))  # says which, and what to do
            raise ModelError(f"actuator {name!r} drives neither a joint nor a fixed tendon")
        moment[i] = row
        if int(model.actuator_plugin[i]) >= 0:
            raise ModelError(
                f"actuator {name!r} is driven by a plugin, whose force the planner does not know; "
                "use position servos or motors"
            )
        law = int(model.actuator_gaintype[i]), int(model.actuator_biastype[i])
        if law[0] != _FIXED_GAIN or law[1] not in (_BIAS_NONE, _BIAS_AFFINE):
            raise ModelError(f"actuator {name!r} is not affine in ctrl, length and velocity")
        if int(model.actuator_dyntype[i]) not in _AT_REST:
            raise ModelError(
                f"actuator {name!r} has dynamics of its own other than a filter (an integrator or "
                "a muscle), so that no command belongs to a force; use one whose force follows ctrl"
            )
        gain[i] = model.actuator_gainprm[i, 0]
        if law[1] == _BIAS_AFFINE:
            bias[i] = model.actuator_biasprm[i, :3]
            _check_restoring(name, bias[i])
    stops, values, names = _stops(model)
    stiffness, spring_torque = _springs(model)
    return Actuation(
        names=tuple(model.actuator(i).name for i in range(model.nu)),
        joint_names=tuple(model.joint(j).name for j in range(model.njnt)),
        moment=moment,
        length0=np.zeros(model.nu),
        gain=gain,
        bias=bias,
        force_range=_force_range(model, moment),
        ctrl_range=_ctrl_range(model),
        stop_rows=stops,
        stop_values=values,
        stop_names=names,
        stiffness=stiffness,
        spring_torque=spring_torque,
    )


def _check_restoring(name: str, bias: FloatArray) -> None:
    """See that an actuator's force does not grow with its own length or velocity.

    Raises:
        ModelError: It does: a servo of negative kp or kv runs away from where it is sent.
    """
    for slope, gain in ((float(bias[1]), "kp"), (float(bias[2]), "kv")):
        if slope > 0.0:
            raise ModelError(
                f"actuator {name!r} has {gain} = {-slope:g} (biasprm {bias.tolist()}): it drives "
                f"its joint away from where it is sent; give a {gain} of at least 0"
            )


def _ranges(ranges: FloatArray, limited: ArrayLike) -> FloatArray:
    out = np.tile([-np.inf, np.inf], (len(ranges), 1))
    active = np.asarray(limited, dtype=bool)
    out[active] = np.asarray(ranges)[active]
    return out


def _ctrl_range(model: Any) -> FloatArray:
    """Ranges (nu, 2) of ctrl; a filter's state limits it too."""
    out = _ranges(model.actuator_ctrlrange, model.actuator_ctrllimited)
    filtered = np.isin(model.actuator_dyntype, list(_FILTERS))
    limited = np.asarray(model.actuator_actlimited, dtype=bool) & filtered
    state = _ranges(model.actuator_actrange, limited)
    return np.column_stack([np.maximum(out[:, 0], state[:, 0]), np.minimum(out[:, 1], state[:, 1])])


def _force_range(model: Any, moment: FloatArray) -> FloatArray:
    """Ranges (nu, 2) of actuator force, with those of joints and tendons.

    Raises:
        ModelError: A joint or tendon with a limit is driven by several actuators.
    """
    out = _ranges(model.actuator_forcerange, model.actuator_forcelimited)
    dofs = model.jnt_dofadr
    limited = [
        (f"joint {model.joint(j).name!r}", moment[:, int(dofs[j])], model.jnt_actfrcrange[j])
        for j in range(model.njnt)
        if model.jnt_actfrclimited[j]
    ]
    on_tendon = np.asarray(model.actuator_trntype) == _TENDON
    for t in range(model.ntendon):
        if model.tendon_actfrclimited[t]:
            mine = on_tendon & (np.asarray(model.actuator_trnid)[:, 0] == t)
            arms = np.where(mine, 1.0, 0.0)  # MuJoCo clips the actuator's force before its gear
            limited.append((f"tendon {model.tendon(t).name!r}", arms, model.tendon_actfrcrange[t]))
    for what, arms, range_ in limited:
        drivers = np.flatnonzero(arms)
        if len(drivers) > 1:
            names = [model.actuator(int(i)).name for i in drivers]
            raise ModelError(
                f"{what} limits the sum of the actuators {names} (actuatorfrcrange); limit each "
                "actuator by its own forcerange instead"
            )
        for i in drivers:
            low, high = np.sort(np.asarray(range_) / arms[i])
            out[i] = max(out[i, 0], low), min(out[i, 1], high)
    return out


def _stops(model: Any) -> tuple[FloatArray, FloatArray, tuple[str, ...]]:
    """Stops S q >= s of limited joints and tendons, and a pair that is always active per equality.

    The largest coefficient of each row is 1, so that its value is in rad of a joint. Limits of
    tendons that the joint ranges keep out of reach are left out.
    """
    rows: list[FloatArray] = []
    values: list[float] = []
    names: list[str] = []

    def add(name: str, row: FloatArray, value: float) -> None:
        size = float(np.abs(row).max(initial=0.0))
        if size == 0.0:
            raise ModelError(
                f"{name.rpartition(' ')[0]} acts on no joint: all its coefficients are 0; give "
                "coefficients, or leave it out"
            )
        rows.append(row / size)
        values.append(value / size)
        names.append(name)

    for j, (low, high) in enumerate(model.jnt_range):
        if model.jnt_limited[j]:
            row = np.eye(model.nv)[int(model.jnt_dofadr[j])]
            add(f"joint {model.joint(j).name} lower", row, float(low))
            add(f"joint {model.joint(j).name} upper", -row, -float(high))
    free = np.asarray(model.jnt_limited) == 0
    ends = np.where(free[:, None], [-np.inf, np.inf], model.jnt_range)
    for t, (low, high) in enumerate(model.tendon_range):
        if not model.tendon_limited[t]:
            continue
        row = tendon_row(model, t)
        used = row != 0
        reach = row[used, None] * ends[used]
        margin = STOP_TOL * float(np.abs(row).max(initial=0.0))
        if reach.min(axis=1).sum() < low + margin:
            add(f"tendon {model.tendon(t).name} lower", row, float(low))
        if reach.max(axis=1).sum() > high - margin:
            add(f"tendon {model.tendon(t).name} upper", -row, -float(high))
    for coupling in couplings_from_mujoco(model):
        add(f"equality {coupling.name} up", coupling.row, np.inf)
        add(f"equality {coupling.name} down", -coupling.row, np.inf)
    return np.array(rows).reshape(-1, model.nv), np.array(values), tuple(names)


def _springs(model: Any) -> tuple[FloatArray, FloatArray]:
    """K (nv, nv) and t0 (nv,) of the springs of joints and fixed tendons: torque = t0 - K q.

    Raises:
        ModelError: A spring that is not linear, or a tendon that is slack over a range of lengths.
    """
    bent = [
        *(f"joint {model.joint(j).name!r}" for j in np.flatnonzero(model.jnt_stiffnesspoly.any(1))),
        *(
            f"tendon {model.tendon(t).name!r}"
            for t in np.flatnonzero(model.tendon_stiffnesspoly.any(1))
        ),
    ]
    stiffness, torque = np.zeros((model.nv, model.nv)), np.zeros(model.nv)
    for j in np.flatnonzero(model.jnt_stiffness):
        k, dof = float(model.jnt_stiffness[j]), int(model.jnt_dofadr[j])
        stiffness[dof, dof] += k
        torque[dof] += k * float(model.qpos_spring[int(model.jnt_qposadr[j])])
    for t in np.flatnonzero(model.tendon_stiffness):
        shortest, longest = (float(v) for v in model.tendon_lengthspring[t])
        if shortest != longest:
            bent.append(f"tendon {model.tendon(int(t)).name!r}")
        row, k = tendon_row(model, int(t)), float(model.tendon_stiffness[t])
        stiffness += k * np.outer(row, row)
        torque += k * shortest * row
    if bent:
        raise ModelError(
            f"springs of {', '.join(bent)} are not linear; give each one stiffness and one rest "
            "length, or drop them"
        )
    return stiffness, torque
