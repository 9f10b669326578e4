"""What carries the hand through a trial: the scene's driven gantry, or the arm that the hand is on.

``Timeline`` says how long the phases take.

The arm follows its paths of the plan by its own actuators. Their commands solve each actuator's
affine law at the posture and the rates that are wanted now, for the torque that carries arm and
hand (MuJoCo's bias force), so that a position servo gets

    ctrl = q_wanted + (bias + kd v_wanted) / kp

and follows without lag and without sagging. Joints that are driven by motors get a spring and a
damper around that. Two arms press with their palms too, as the controller commands them: there the
motion is added to its commands.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any, Protocol

import numpy as np

from planner.arrays import check_fields
from planner.collision.arm_path import ArmPath, lift_height
from planner.errors import TaskError
from planner.plan import GraspPlan
from planner.spatial import SE3, FloatArray, minimum_jerk
from sim.controllers.base import PHASES, Phase
from sim.controllers.hand_dynamics import motor_servo
from sim.scene.build import Scene
from sim.scene.gantry import Gantry

__all__ = ["ArmCarrier", "Carrier", "GantryCarrier", "Timeline", "carrier_of"]


MOST_TURN = np.pi
"""Largest turn or tilt while lifting (rad)."""


@dataclass(frozen=True, kw_only=True)
class Timeline:
    """How long each phase takes, in s, and how far the lift goes.

    Attributes:
        approach: From the start pose straight to the grasp pose, fingers at the pre-grasp.
        close: Fingers from pre-grasp to grasp.
        close_wait: Longest further wait for fingers that do not touch yet.
        squeeze: From first touch to the planned forces.
        settle: Full forces, before the lift; slip counts from its beginning.
        lift: Upwards by ``lift_height``.
        hold: Held in the air.
        lift_height: m.
        turn: By how much the hand turns about the vertical through its base while it lifts, rad; on
            a gantry. The base of two hands is between them.
        tilt: By how much it tilts about the world's x axis meanwhile, rad.
    """

    approach: float = 1.0
    close: float = 0.5
    close_wait: float = 1.0
    squeeze: float = 0.6
    settle: float = 0.2
    lift: float = 1.0
    hold: float = 2.0
    lift_height: float = 0.1
    turn: float = 0.0
    tilt: float = 0.0

    def __post_init__(self) -> None:
        """Check that every phase has a duration."""
        check_fields(self, ("close_wait",), what="timeline: ", least=0.0)
        check_fields(self, ("turn", "tilt"), what="timeline: ", least=-MOST_TURN, most=MOST_TURN)
        others = ("close_wait", "turn", "tilt")
        phases = [field.name for field in fields(self) if field.name not in others]
        check_fields(self, phases, what="timeline: ", above=0.0)

    @classmethod
    def quick(cls, **changes: float) -> Timeline:
        """Shorter phases, for many trials that nobody looks at.

        Args:
            changes: Durations by name, s, that are to be others.
        """
        durations = {
            "approach": 0.3,
            "close": 0.3,
            "close_wait": 0.3,
            "squeeze": 0.4,
            "lift": 0.5,
            "hold": 1.0,
        }
        return cls(**(durations | changes))

    @property
    def duration(self) -> float:
        """Nominal duration without waiting, s."""
        return float(sum(getattr(self, phase) for phase in PHASES))

    @staticmethod
    def profile(share: float) -> tuple[float, float]:
        """How far a motion is at a share of its time, and the derivative: at rest at both ends."""
        return float(minimum_jerk(np.asarray(share))), 30.0 * share**2 * (1.0 - share) ** 2


class Carrier(Protocol):
    """Moves the hand as a whole.

    In the phase "open" it holds the hand where its approach ended, which may have been given up on
    the way; "retreat" goes back from there.
    """

    def drive(self, data: Any, phase: Phase, share: float) -> None:
        """Set its commands in ``data.ctrl`` for a share in [0, 1] of a phase."""
        ...


def planned_base(carrier: Carrier, phase: Phase, share: float) -> SE3 | None:
    """Where a carrier should have brought the hand's base; None of one that does not say."""
    planned = getattr(carrier, "planned_base", None)
    return None if planned is None else planned(phase, share)


class GantryCarrier:
    """Moves the hand by the gantry: a ``Carrier``."""

    def __init__(self, plan: GraspPlan, gantry: Gantry, timeline: Timeline) -> None:
        """Note where the approach begins."""
        self._gantry, self._timeline = gantry, timeline
        self._start = gantry.coordinates(plan.T_world_base_start)
        turns = (timeline.tilt, 0.0, timeline.turn)
        self._lifted = np.array([0.0, 0.0, timeline.lift_height, *turns])
        self._low, self._still = np.zeros((2, 6))
        self._approached = 1.0

    def drive(self, data: Any, phase: Phase, share: float) -> None:
        """Set the gantry's commands."""
        if phase == "approach":
            self._approached = self._timeline.profile(share)[0]
        target, velocity = self.motion(phase, share)
        data.ctrl[self._gantry.ctrl] = self._gantry.command(data, target, velocity)

    def planned_base(self, phase: Phase, share: float) -> SE3:
        """Where the hand's base should be at a share in [0, 1] of a phase."""
        return self._gantry.pose(self.motion(phase, share)[0])

    def motion(self, phase: Phase, share: float) -> tuple[FloatArray, FloatArray]:
        """Gantry joints (6,) and their rates at a share in [0, 1] of a phase; at rest at its ends.

        Those of the grasp are zero.
        """
        timeline = self._timeline
        if phase == "approach":
            s, rate = timeline.profile(share)
            return (1.0 - s) * self._start, -rate / timeline.approach * self._start
        if phase in ("open", "retreat"):
            s, rate = timeline.profile(share if phase == "retreat" else 0.0)
            back = self._approached * self._start
            return self._start - (1.0 - s) * back, rate / timeline.approach * back
        if phase == "lift":
            s, rate = timeline.profile(share)
            return s * self._lifted, rate / timeline.lift * self._lifted
        return (self._lifted if phase == "hold" else self._low), self._still


class ArmCarrier:
    """The arm that the hand is on."""

    def __init__(self, plan: GraspPlan, path: ArmPath, scene: Scene, timeline: Timeline) -> None:
        """Prepare the paths.

        Raises:
            TaskError: The timeline lifts higher than the plan, or turns.
        """
        if timeline.turn or timeline.tilt:
            raise TaskError(
                f"{plan.task.hand.name} is on an arm, whose plan lifts without turning; leave turn "
                "and tilt at 0"
            )
        most = lift_height(plan.task.hand)
        if timeline.lift_height > most:
            raise TaskError(
                f"the timeline lifts by {timeline.lift_height:g} m; with an arm a plan lifts by "
                f"{most:g} m: give at most that"
            )
        self._hand, self._path = plan.task.hand, path
        self._scene, self._timeline = scene, timeline
        self._lift_share = timeline.lift_height / most
        self._dof = scene.hand_dof[self._hand.arm_index]
        self._qpos = scene.hand_qpos[self._hand.arm_index]
        self._rows = np.isin(scene.hand_ctrl, scene.arm_ctrl)
        self._along = self._hand.actuation.moment[np.ix_(self._rows, self._hand.arm_index)]
        self._force_of = np.linalg.pinv(self._along.T)  # joint torques to actuator forces
        self._q = plan.q_start
        self._approached = 1.0
        self._stiffness, self._damping = (
            gain[self._hand.arm_index] for gain in motor_servo(self._hand, plan.q)
        )

    def drive(self, data: Any, phase: Phase, share: float) -> None:
        """Set the commands of the arm's actuators."""
        if phase == "approach":
            self._approached = self._timeline.profile(share)[0]
        target, velocity = self.motion(phase, share)
        if self._hand.pair:
            self._add_motion(data, phase, target, velocity)
            return
        index = self._hand.arm_index
        v, torque = np.zeros(self._hand.nq), np.zeros(self._hand.nq)
        self._q[index], v[index] = target, velocity
        torque[index] = data.qfrc_bias[self._dof]
        torque[index] += self._stiffness * (target - data.qpos[self._qpos])
        torque[index] += self._damping * (velocity - data.qvel[self._dof])
        ctrl = self._hand.actuation.commands(self._q, v, torque)
        data.ctrl[self._scene.arm_ctrl] = ctrl[self._rows]

    def _add_motion(
        self, data: Any, phase: Phase, target: FloatArray, velocity: FloatArray
    ) -> None:
        """Move the postures about which the controller holds both arms along their paths.

        Their actuators' law is linear: what moves a posture by dq at rates v is, for a position
        servo, ctrl + dq + (kd / kp) v. The torques that press stay as commanded.

        Args:
            data: ``mujoco.MjData`` with the controller's commands.
            phase: Which.
            target: Arm joints (n,).
            velocity: Their rates (n,).
        """
        a, path = self._hand.actuation, self._path
        coming = phase in ("approach", "open", "retreat")
        moved = target - (path.approach[-1] if coming else path.lift[0])
        force = self._force_of @ (self._stiffness * moved + self._damping * velocity)
        force -= a.bias[self._rows, 1] * (self._along @ moved)
        force -= a.bias[self._rows, 2] * (self._along @ velocity)
        ctrl = data.ctrl[self._scene.arm_ctrl] + force / a.gain[self._rows]
        data.ctrl[self._scene.arm_ctrl] = np.clip(ctrl, *a.ctrl_range[self._rows].T)

    def motion(self, phase: Phase, share: float) -> tuple[FloatArray, FloatArray]:
        """Arm joints (n,) and their rates (n,) at a share in [0, 1] of a phase."""
        s, rate = self._timeline.profile(share)
        if phase == "approach":
            return _on(self._path.approach, s, rate / self._timeline.approach)
        if phase in ("open", "retreat"):
            s, rate = (s, rate) if phase == "retreat" else (0.0, 0.0)
            left = self._approached
            return _on(
                self._path.approach, left * (1.0 - s), -left * rate / self._timeline.approach
            )
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
