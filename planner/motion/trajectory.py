"""``TrajectoryBuilder``: joint positions and base poses over time, for a real hand.

Joints follow given postures by a monotone cubic (PCHIP), which stays between neighbouring postures,
so within joint limits if the postures are. Time follows the minimum-jerk profile, slowly enough for
the largest joint rate and the largest rate of the object's turn.
"""

from __future__ import annotations

import numpy as np
from scipy.interpolate import PchipInterpolator

from planner.errors import TaskError
from planner.kinematics.arm_ik import palm_path, palm_pose
from planner.plan import GraspPlan, JointTrajectory
from planner.spatial import SE3, FloatArray, interpolate_path, minimum_jerk

JOINT_RATE = 4.0
"""Default largest rate of a joint, rad/s (m/s for slides)."""

TURN_RATE = 1.1
"""Default largest rate of the object's turn, rad/s, as ``sim.controllers.follow.RATE``."""

PEAK = 1.875
"""Peak rate of the minimum-jerk profile over its mean rate (-)."""

LOOKS = 400
"""Samples at which the joint rates along the postures are evaluated."""


class TrajectoryBuilder:
    """Appends phases to a trajectory that begins with approach and closing of a grasp."""

    def __init__(
        self,
        grasp: GraspPlan,
        *,
        approach_s: float = 1.5,
        close_s: float = 1.0,
        joint_rate: float = JOINT_RATE,
        turn_rate: float = TURN_RATE,
        rate_hz: float = 50.0,
    ) -> None:
        """Begin with the approach and the closing of a grasp.

        Args:
            grasp: The grasp.
            approach_s: Duration of the straight approach, s.
            close_s: Duration of closing from the pre-grasp to the grasp, s.
            joint_rate: Largest rate of any joint after the closing, rad/s or m/s.
            turn_rate: Largest rate of the object's turn, rad/s.
            rate_hz: Samples per second.

        Raises:
            TaskError: A duration or a rate that is not positive.
        """
        for name, value in (
            ("approach_s", approach_s),
            ("close_s", close_s),
            ("joint_rate", joint_rate),
            ("turn_rate", turn_rate),
            ("rate_hz", rate_hz),
        ):
            if not (np.isfinite(value) and value > 0):
                raise TaskError(f"{name} of a trajectory is {value}; give a finite number > 0")
        self._joint_rate, self._turn_rate, self._rate_hz = joint_rate, turn_rate, rate_hz
        first = grasp.joint_trajectory(approach_s=approach_s, close_s=close_s, rate_hz=rate_hz)
        self._grasp, self._names = grasp, first.joint_names
        self._times, self._positions = [first.times], [first.positions]
        self._phases, self._bases = list(first.phases), list(first.T_world_base)

    def turn(
        self, phase: str, postures: FloatArray, parameters: FloatArray, angle: float = 0.0
    ) -> None:
        """Joints follow postures, the base stays.

        Args:
            phase: Name of the phase.
            postures: Joints (m, nq), at least two; the first is where the trajectory is now.
            parameters: Path parameter (m,) of each posture, increasing.
            angle: Turn of the object meanwhile, rad.
        """
        arm = self._grasp.task.hand.arm_index
        postures = np.array(postures)
        postures[:, arm] = self._positions[-1][-1][arm]  # it stands still
        way = PchipInterpolator(parameters, postures)
        at = np.linspace(parameters[0], parameters[-1], LOOKS)
        steps = np.abs(np.diff(way(at), axis=0)).max() * (LOOKS - 1)
        duration = PEAK * max(float(steps) / self._joint_rate, abs(angle) / self._turn_rate)
        share = self._shares(duration)
        here = way(parameters[0] + share * (parameters[-1] - parameters[0]))
        self._add(phase, duration, here, [self._bases[-1]] * len(share))

    def move_base(self, phase: str, T_world_base: SE3, duration: float) -> None:
        """The base moves straight to a pose, joints stay.

        Args:
            phase: Name of the phase.
            T_world_base: Its pose at the end. Of an arm, whose root stands, that of a base that
                moves with the palm and was at the root in the grasp; the arm's joints move.
            duration: s.

        Raises:
            TaskError: The arm cannot go there.
        """
        share, begin = self._shares(duration), self._bases[-1]
        hand, q = self._grasp.task.hand, self._positions[-1][-1]
        if hand.arm is not None:
            goal = begin.inverse() * T_world_base * palm_pose(hand, self._grasp.q)
            path = palm_path(hand, q, goal)
            if path is None:
                raise TaskError(f"the arm cannot {phase} within its limits; plan again")
            joints = np.tile(q, (len(share), 1))
            joints[:, hand.arm_index] = interpolate_path(path, share)
            self._add(phase, duration, joints, [begin] * len(share))
            return
        bases = [_between(begin, T_world_base, s) for s in share.tolist()]
        self._add(phase, duration, np.tile(self._positions[-1][-1], (len(share), 1)), bases)

    def built(self) -> JointTrajectory:
        """All phases so far as one trajectory."""
        return JointTrajectory(
            joint_names=self._names,
            times=np.concatenate(self._times),
            positions=np.vstack(self._positions),
            phases=tuple(self._phases),
            T_world_base=tuple(self._bases),
        )

    def _shares(self, duration: float) -> FloatArray:
        """Progress (k,), 0 to 1, at the samples of a phase, without its beginning."""
        n = max(1, int(np.ceil(duration * self._rate_hz)))
        return minimum_jerk(np.linspace(0.0, 1.0, n + 1)[1:])

    def _add(self, phase: str, duration: float, q: FloatArray, bases: list[SE3]) -> None:
        end = float(self._times[-1][-1])
        self._times.append(end + duration * np.linspace(0.0, 1.0, len(q) + 1)[1:])
        self._positions.append(np.asarray(q))
        self._phases += [phase] * len(q)
        self._bases += bases


def _between(begin: SE3, end: SE3, share: float) -> SE3:
    """A pose interpolated between two, the origin on a straight line."""
    turned = SE3.Interpolate(begin, end, share).rotation
    return SE3(turned, begin.translation + share * (end.translation - begin.translation))
