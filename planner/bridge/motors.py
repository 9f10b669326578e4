"""A hand with a torque motor on every joint, from a model with servos and tendons.

A motor's torque is its command, within what the actuators of the model can make at that joint: the
sum over them of the moment arm times the force range. A tendon over two joints becomes a motor on
each, and tied joints keep their own as well: torque at the joint itself need not pass through a
tie, which yields a little (``planner.bridge.load.RIGID_SOLREF``).

Equalities stay, with the tendons that they hold. All other tendons go, with their stops and
springs; a stop that must remain is described as a coupling.
"""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from planner.bridge.actuation import actuation_from_mujoco
from planner.bridge.load import compile_spec
from planner.errors import HandError

_EQ_TENDON = int(mujoco.mjtEq.mjEQ_TENDON)


def motorise_spec(spec: Any, what: str) -> None:
    """Replace the actuators and tendons of a spec of hinges and slides by motors, in place.

    A motor is called like its joint. A joint that nothing drives gets none.

    Args:
        spec: ``mujoco.MjSpec``, with named parts and all of its equalities.
        what: What it is called in messages.

    Raises:
        HandError: An actuator without limits of its force.
        ModelError: MuJoCo refuses the model, or it has actuators or equalities that are not linear.
    """
    actuation = actuation_from_mujoco(compile_spec(spec, what))
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
    torque = np.zeros((len(actuation.joint_names), 2))
    for arms, ends in zip(actuation.moment, actuation.force_range, strict=True):
        torque += np.sort(np.outer(arms, ends), axis=1)
    held = {n for e in spec.equalities if int(e.type) == _EQ_TENDON for n in (e.name1, e.name2)}
    for part in (*spec.actuators, *(t for t in spec.tendons if t.name not in held)):
        spec.delete(part)
    for joint in spec.joints:
        joint.actfrclimited = mujoco.mjtLimited.mjLIMITED_FALSE  # counted in the force ranges
    for name, ends in zip(actuation.joint_names, torque, strict=True):
        if not ends.any():
            continue
        motor = spec.add_actuator(name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        motor.set_to_motor()
        motor.forcelimited = motor.ctrllimited = mujoco.mjtLimited.mjLIMITED_TRUE
        motor.forcerange = motor.ctrlrange = ends
