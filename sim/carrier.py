"""What carries the hand through a trial: the scene's driven gantry, or the arm that the hand is on.

The arm follows its paths of the plan by its own actuators. Their commands solve each actuator's
affine law at the posture and the rates that are wanted now, for the torque that carries arm and
hand (MuJoCo's bias force), so that a position servo gets

    ctrl = q_wanted + (bias + kd v_wanted) / kp

and follows without lag and without sagging. Joints that are driven by motors get a spring and a
damper around that.
"""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np

from planner.approach.arm_path import LIFT_HEIGHT, ArmPath
from planner.errors import TaskError
from planner.plan import GraspPlan
from planner.spatial import FloatArray
from sim.controllers.base import Phase
from sim.controllers.motors import motor_servo
from sim.gantry import GantryCarrier
from sim.scene import Scene
from sim.timeline import Timeline

__all__ = ["ArmCarrier", "Carrier", "carrier_of"]


class Carrier(Protocol):
    """Moves the hand as a whole."""

    def drive(self, data: Any, phase: Phase, share: float) -> None:
        """Set its commands in ``data.ctrl`` for a share in [0, 1] of a phase."""
        ...


class ArmCarrier:
    """The arm that the hand is on."""

    def __init__(self, plan: GraspPlan, path: ArmPath, scene: Scene, timeline: Timeline) -> None:
        """Prepare the paths.

        Raises:
            TaskError: The timeline lifts higher than the plan.
        """
        if timeline.lift_height > LIFT_HEIGHT:
            raise TaskError(
                f"the timeline lifts by {timeline.lift_height:g} m; with an arm a plan lifts by "
                f"{LIFT_HEIGHT:g} m: give at most that"
            )
        self._hand, self._path = plan.task.hand, path
        self._scene, self._timeline = scene, timeline
        self._lift_share = timeline.lift_height / LIFT_HEIGHT
        self._dof = scene.hand_dof[self._hand.arm_index]
        self._qpos = scene.hand_qpos[self._hand.arm_index]
        self._rows = np.isin(scene.hand_ctrl, scene.arm_ctrl)
        self._q = plan.q_start
        self._stiffness, self._damping = (
            gain[self._hand.arm_index] for gain in motor_servo(self._hand, plan.q)
        )

    def drive(self, data: Any, phase: Phase, share: float) -> None:
        """Set the commands of the arm's actuators."""
        target, velocity = self.motion(phase, share)
        index = self._hand.arm_index
        v, torque = np.zeros(self._hand.nq), np.zeros(self._hand.nq)
        self._q[index], v[index] = target, velocity
        torque[index] = data.qfrc_bias[self._dof]
        torque[index] += self._stiffness * (target - data.qpos[self._qpos])
        torque[index] += self._damping * (velocity - data.qvel[self._dof])
        ctrl = self._hand.actuation.commands(self._q, v, torque)
        data.ctrl[self._scene.arm_ctrl] = ctrl[self._rows]

    def motion(self, phase: Phase, share: float) -> tuple[FloatArray, FloatArray]:
        """Arm joints (n,) and their rates (n,) at a share in [0, 1] of a phase."""
        s, rate = self._timeline.profile(share)
        if phase == "approach":
            return _on(self._path.approach, s, rate / self._timeline.approach)
        if phase == "lift":
            top = self._lift_share
            return _on(self._path.lift, top * s, top * rate / self._timeline.lift)
        return _on(self._path.lift, self._lift_share if phase == "hold" else 0.0, 0.0)


def carrier_of(plan: GraspPlan, scene: Scene, timeline: Timeline) -> Carrier:
    """What carries the hand of a plan."""
    if scene.gantry is not None:
        return GantryCarrier(plan, scene.gantry, timeline)
    if plan.arm is None:
        raise TaskError(f"the plan holds no way of the arm of {plan.task.hand.name}; plan again")
    return ArmCarrier(plan, plan.arm, scene, timeline)


def _on(path: FloatArray, share: float, rate: float) -> tuple[FloatArray, FloatArray]:
    """Posture (n,) at a share of a path (m, n) and its rate, with d share / dt = ``rate``."""
    last = len(path) - 1
    k = min(int(share * last), last - 1)
    step = path[k + 1] - path[k]
    return path[k] + (share * last - k) * step, rate * last * step
