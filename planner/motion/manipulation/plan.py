"""``ManipulationPlan``: pick an object up, turn or move it in the hand, put it down.

A plan is a motion on one grasp, or a gait of several strokes, with its approach, and an ending: the
final pose of the object and the way out.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from planner.approach.pregrasp import way_back
from planner.immutable import freeze
from planner.motion.gait import GaitPlan
from planner.motion.manipulation.ending import Ending, standing_under
from planner.motion.plan import MotionPlan
from planner.motion.trajectory import JOINT_RATE, TURN_RATE, TrajectoryBuilder
from planner.plan import GraspPlan, JointTrajectory
from planner.showing import Shown
from planner.spatial import SE3, FloatArray
from planner.synthesis.objectives.joint import driving
from planner.task import GraspTask, Obstacle

LIFT_S, CARRY_S, LOWER_S, OPEN_S, RETREAT_S = 0.7, 0.8, 0.6, 0.4, 0.6
"""Durations (s) of the pieces of a trajectory in which the base moves or the fingers open."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ManipulationPlan(Shown):
    """Pick, turn, place.

    Attributes:
        motion: The turn in the hand with its grasp, overshoot beyond ``angle`` included; of a gait
            the first stroke.
        angle: Requested turn, rad, with its sign.
        shift: Requested translation in the hand (3,), m, world.
        ending: Final pose of the object, and how the hand lets go of it.
        reserve: Share of its limit that the most loaded actuator keeps at the worst knot, with the
            forces that bear the weight.
        attempts: Attempts made.
        cpu_s: CPU time of planning without building, s.
        gait: Strokes and the relocations of fingers between them, where one stroke is not enough.
    """

    motion: MotionPlan
    angle: float
    ending: Ending
    reserve: float
    attempts: int
    cpu_s: float
    shift: FloatArray = field(default_factory=lambda: np.zeros(3))
    gait: GaitPlan | None = None

    def __post_init__(self) -> None:
        """Keep copies that nobody changes."""
        freeze(self, arrays=("shift",))

    @property
    def grasp(self) -> GraspPlan:
        """The grasp with which it begins."""
        return self.motion.grasp

    @property
    def task(self) -> GraspTask:
        """The task, with the chosen fingers."""
        return self.motion.grasp.task

    @property
    def under_target(self) -> tuple[Obstacle, ...]:
        """Obstacles that carry the object at another target above the table, as at its start."""
        return standing_under(self.task, self.ending.T_world_target)

    def joint_trajectory(
        self,
        *,
        approach_s: float = 1.5,
        close_s: float = 1.0,
        lift_m: float = 0.08,
        joint_rate: float = JOINT_RATE,
        turn_rate: float = TURN_RATE,
        rate_hz: float = 50.0,
    ) -> JointTrajectory:
        """Joint positions by name and poses of the base, for a real hand on any carrier.

        Phases are approach, close, lift, turn (or strokes and regrasps), back where the plan has
        one, carry, lower, open and retreat. Contact forces are not part of it. The turn ends at
        ``angle``, short of the planned overshoot.

        Args:
            approach_s: As for ``GraspPlan.joint_trajectory``.
            close_s: As there.
            lift_m: How far the hand is lifted, m.
            joint_rate: Largest rate of a joint after the closing, rad/s or m/s.
            turn_rate: Largest rate of the object's turn, rad/s.
            rate_hz: Samples per second.

        Raises:
            TaskError: A duration or a rate that is not positive.
        """
        builder = TrajectoryBuilder(
            self.grasp,
            approach_s=approach_s,
            close_s=close_s,
            joint_rate=joint_rate,
            turn_rate=turn_rate,
            rate_hz=rate_hz,
        )
        base, up = self.motion.T_world_base, np.array([0.0, 0.0, lift_m])
        builder.move_base("lift", _moved(base, up), LIFT_S)
        T_world_object, q = self._turn(builder)
        to_target = self.ending.T_world_target * T_world_object.inverse() * base
        builder.move_base("carry", _moved(to_target, up), CARRY_S)
        builder.move_base("lower", to_target, LOWER_S)
        builder.turn("open", np.array([q, self.ending.release.q]), np.array([0.0, 1.0]), OPEN_S)
        builder.move_base("retreat", self.way_out(to_target), RETREAT_S)
        return builder.built()

    def way_out(self, T_world_base: SE3, ending: Ending | None = None) -> SE3:
        """Pose of the base at the end of the straight way out.

        Args:
            T_world_base: Pose of the base when the fingers have opened.
            ending: How the object is put down; the plan's if None.
        """
        planned, release = self.motion.T_world_base, (ending or self.ending).release
        way = way_back(self.task.hand, planned, release)
        return _moved(T_world_base, T_world_base.rotation @ planned.rotation.T @ way)

    def turned_object(self) -> tuple[SE3, FloatArray]:
        """Planned pose of the object and joints (nq,) when it has turned by ``angle``.

        Hand and object are at the grasp, not lifted.
        """
        motion, gait = self.motion, self.gait
        now, q = motion.at(self.final_parameter)
        if gait is None:
            return now, q
        last = next(s for s in gait.strokes if s.cycle == gait.cycles - 1)
        begin, first = last.knots[0].T_world_object, motion.knots[0].T_world_object
        turned = now.rotation @ first.rotation.T @ begin.rotation
        return SE3(turned, begin.translation + now.translation - first.translation), q

    @property
    def final_parameter(self) -> float:
        """Path parameter in (0, 1] at which the last stroke has turned the object by ``angle``."""
        strokes = 1 if self.gait is None else self.gait.cycles
        if not self.angle:
            return 1.0
        return min(1.0, self.angle / self.motion.path.angle - (strokes - 1))

    def _turn(self, builder: TrajectoryBuilder) -> tuple[SE3, FloatArray]:
        """Append the turn, and the way back; object, before any lift, and joints at its end."""
        motion, end = self.motion, self.final_parameter
        if self.gait is not None:
            self.gait.add_to(builder, end)
            return self.turned_object()
        motion.add_to(builder, "turn", end)
        if not self.ending.back:
            return self.turned_object()
        before = [k.path_parameter for k in motion.knots if k.path_parameter < end]
        parameters = np.array([*before, end])[::-1]
        way = np.array([motion.at(s)[1] for s in parameters])
        builder.turn("back", way, end - parameters, end * motion.path.angle)
        return motion.knots[0].T_world_object, motion.knots[0].q

    def __repr__(self) -> str:
        """One line."""
        return f"<ManipulationPlan of {self.task!r}: {np.rad2deg(self.angle):.1f} degrees>"

    def __str__(self) -> str:
        """The motion or gait, and the ending."""
        target = ", ".join(f"{v:.3f}" for v in self.ending.T_world_target.translation)
        lines = [
            str(self.gait or self.motion),
            f"  requested: {np.rad2deg(self.angle):.1f} degrees, ({_mm(self.shift)}) mm; put down "
            f"at ({target}) m",
            f"  the most loaded actuator keeps {100 * self.reserve:.0f} % of its limit",
        ]
        if self.ending.back:
            lines.append(f"  made backwards before it is put down: {self.ending.back}")
        return "\n".join(lines)


def torque_reserve(motion: MotionPlan) -> float:
    """Least share of its limit that an actuator of the fingers keeps, over all knots."""
    task = motion.grasp.task
    actuation, used = task.hand.actuation, driving(task.hand, task.fingers)
    left = 1.0
    for knot in motion.knots:
        low, high = actuation.force_limits(knot.q)[used].T
        force = knot.forces.actuator_forces[used]
        limit = np.where(force > 0, high, -low)
        left = min(left, float((1.0 - np.abs(force) / np.maximum(limit, NO_LIMIT)).min()))
    return left


NO_LIMIT = 1e-9
"""Least limit (N m, N) that divides a force."""


def _moved(pose: SE3, by: FloatArray) -> SE3:
    return SE3(pose.rotation, pose.translation + by)


def _mm(shift: FloatArray) -> str:
    return ", ".join(f"{v:.1f}" for v in 1e3 * shift + 0.0)
