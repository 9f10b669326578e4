"""A hand with a torque motor on every joint, from a model with servos and tendons.

A motor's force is its command, within the greatest torque that the actuators of the model can make
there: R^T F of their force ranges, summed over the actuators of a joint. Where couplings C q = d
tie joints, the one nearest to the base has the motor of all of them. With q = N u + q0 the torque
on its u is N^T R^T F, so that a tendon over two tied joints becomes a motor of twice its force.

Equalities stay, with the tendons that they hold. All other tendons go, with their stops and
springs; a stop that must remain is described as a coupling.
"""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from planner.bridge.actuation import actuation_from_mujoco
from planner.bridge.couplings import couplings_from_mujoco
from planner.bridge.load import compile_spec
from planner.errors import HandError
from planner.spatial import FloatArray

__all__ = ["motorise_spec", "tied"]

_EQ_TENDON = int(mujoco.mjtEq.mjEQ_TENDON)


def motorise_spec(spec: Any, what: str) -> None:
    """Replace the actuators and tendons of a spec of hinges and slides by motors, in place.

    A motor is called like its joint. Joints that nothing drives and no coupling ties get none.

    Args:
        spec: ``mujoco.MjSpec``, with named parts and all of its equalities.
        what: What it is called in messages.

    Raises:
        HandError: An actuator without limits of its force.
        ModelError: MuJoCo refuses the model, or it has actuators or equalities that are not linear.
    """
    model = compile_spec(spec, what)
    actuation = actuation_from_mujoco(model)
    endless = [
        name
        for name, ends in zip(actuation.names, actuation.force_range, strict=True)
        if not np.isfinite(ends).all()
    ]
    if endless:
        raise HandError(
            f"{what}: a motor needs the greatest torque of its joint, and the actuators {endless} "
            "have no limit; give each a forcerange"
        )
    ties = np.array([c.row for c in couplings_from_mujoco(model)]).reshape(-1, model.nv)
    leaders, moved = tied(ties)
    torque = np.zeros((len(leaders), 2))
    for arms, ends in zip(actuation.moment @ moved, actuation.force_range, strict=True):
        torque += np.sort(np.outer(arms, ends), axis=1)
    held = {n for e in spec.equalities if int(e.type) == _EQ_TENDON for n in (e.name1, e.name2)}
    for part in (*spec.actuators, *(t for t in spec.tendons if t.name not in held)):
        spec.delete(part)
    for joint in spec.joints:
        joint.actfrclimited = mujoco.mjtLimited.mjLIMITED_FALSE  # counted in the force ranges
    for leader, ends in zip(leaders, torque, strict=True):
        if ends.any():
            _add_motor(spec, actuation.joint_names[leader], ends)


def tied(rows: FloatArray) -> tuple[NDArray[np.int64], FloatArray]:
    """Joints (k,) that lead the others, and N (nv, k): joint rates = N times those of the leaders.

    Args:
        rows: C (m, nv) of the couplings C q = d. A joint follows if the couplings tell its rate
            from the rates of joints before it.
    """
    nv = rows.shape[1]
    ranks = [int(np.linalg.matrix_rank(rows[:, k:])) if k < nv else 0 for k in range(nv + 1)]
    leads = np.array([ranks[k] == ranks[k + 1] for k in range(nv)], dtype=bool)
    leaders = np.flatnonzero(leads)
    moved = np.zeros((nv, len(leaders)))
    moved[leaders] = np.eye(len(leaders))
    moved[~leads] = -np.linalg.pinv(rows[:, ~leads]) @ rows[:, leads]
    return leaders, moved


def _add_motor(spec: Any, joint: str, ends: FloatArray) -> None:
    motor = spec.add_actuator(name=joint, target=joint, trntype=mujoco.mjtTrn.mjTRN_JOINT)
    motor.set_to_motor()
    motor.forcelimited = motor.ctrllimited = mujoco.mjtLimited.mjLIMITED_TRUE
    motor.forcerange = motor.ctrlrange = ends
