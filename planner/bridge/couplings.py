"""The kinematic couplings that a compiled MuJoCo model holds by itself, as rows C q = d.

Equalities between joints (URDF ``mimic`` becomes one) and between fixed tendons hold

    x1 - x1_0 = c0 + c1 (x2 - x2_0),

x a joint position or a tendon length and x_0 its value at ``qpos0`` (MuJoCo documentation, XML
reference, ``equality/joint``); without a second part, x1 - x1_0 = c0.
"""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from planner.bridge.moments import tendon_row
from planner.couplings import Coupling
from planner.errors import ModelError
from planner.spatial import FloatArray

__all__ = ["couplings_from_mujoco"]

_EQ_JOINT = int(mujoco.mjtEq.mjEQ_JOINT)
_EQ_TENDON = int(mujoco.mjtEq.mjEQ_TENDON)


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
