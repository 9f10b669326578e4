"""``TrajectoryBuilder``: joint positions and base poses over time, for a real hand.

Joints follow given postures by a monotone cubic (PCHIP), which stays between neighbouring postures,
so within joint limits if the postures are. Time follows the minimum-jerk profile, slowly enough for
the largest joint rate and the largest rate of the object's turn.

Joints between two knots: the pads roll evenly from contact to contact over the object's surface.

With joints interpolated linearly the pads would leave the surface by up to a millimetre, and slide.
Here every pad's centre follows a path one radius off the object's surface, and the joints follow by
least-norm inverse-kinematics steps (``planner.numerics.least_squares``),

    min |dq|  s.t.  J_i dq = wanted_i - c_i,   C dq = d - C q.

The first path is linear from knot to knot. The distance that the tips roll along it
(``planner.motion.terms``) gives the next path, until both agree: a fixed-point iteration with
Anderson mixing.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin
from scipy.interpolate import CubicSpline, PchipInterpolator

from planner.errors import TaskError
from planner.kinematics import MovingHand, palm_paths, palm_pose, posture_times
from planner.numerics.least_squares import Task, ik_step
from planner.plan import GraspPlan, JointTrajectory
from planner.spatial import SE3, FloatArray, IntArray, interpolate_path, minimum_jerk
from planner.task import GraspTask

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
            duration: s; longer where a joint of an arm would be too fast (``posture_times``).

        Raises:
            TaskError: The arm cannot go there.
        """
        self.move_along(phase, [T_world_base], duration)

    def move_along(self, phase: str, poses: Sequence[SE3], duration: float) -> None:
        """The base moves through poses evenly and without a stop, as by ``move_base``."""
        hand, q, begin = self._grasp.task.hand, self._positions[-1][-1], self._bases[-1]
        if hand.arm is not None:
            T_root_palm, whole = palm_pose(hand, self._grasp.q), [q[None, hand.arm_index]]
            for path in palm_paths(hand, q, [begin.inverse() * p * T_root_palm for p in poses]):
                if path is None:
                    raise TaskError(f"the arm cannot {phase} within its limits; plan again")
                whole.append(path[1:])
            arm = np.concatenate(whole)
            times = posture_times(arm, duration)
            share = self._shares(times[-1])
            joints = np.tile(q, (len(share), 1))
            index = np.interp(share, times / times[-1], np.linspace(0.0, 1.0, len(arm)))
            joints[:, hand.arm_index] = interpolate_path(arm, index)
            self._add(phase, float(times[-1]), joints, [begin] * len(share))
            return
        way, last, share = [begin, *poses], len(poses) - 1, self._shares(duration)
        joints = np.tile(q, (len(share), 1))
        at = share * len(poses)
        before = np.minimum(at.astype(int), last).tolist()
        bases = [_between(way[k], way[k + 1], s - k) for k, s in zip(before, at, strict=True)]
        if last:  # straight from pose to pose the velocity would jump at each
            places = CubicSpline(np.arange(len(way)), [pose.translation for pose in way])(at)
            bases = [SE3(b.rotation, p) for b, p in zip(bases, places, strict=True)]
        self._add(phase, duration, joints, bases)

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


STEPS = 6
"""Most inverse-kinematics steps at a sample."""

ARRIVED = 1e-6
"""Distance (m) of a pad from its target, and error of a coupling, that end the steps."""

RCOND = 1e-3
"""Singular values below this share of the largest count as zero: a stretched finger cannot follow
exactly."""

STEADY_TOL, MOST_LAPS = 2e-5, 10
"""Change of the path (m) that ends the iteration, and most iterations. Without Anderson mixing a
thumb with a redundant joint converges slowly, because it turns another way each time."""


def interpolate_rolling(
    task: GraspTask, bases: Sequence[SE3], first: FloatArray, last: FloatArray
) -> list[FloatArray]:
    """Joints (nq,) at m samples from one knot to the next, both knots included.

    Args:
        task: Hand, fingers and object.
        bases: Pose of the base in the object's frame at the m samples, equally spaced.
        first: Joints (nq,) at the first knot.
        last: Joints (nq,) at the last one.
    """
    moving, index = MovingHand(task.hand, first), _moved_joints(task)
    shares = np.linspace(0.0, 1.0, len(bases))
    postures = [first + s * (last - first) for s in shares]
    ends = [_tips(task, moving, bases[k], postures[k])[0] for k in (0, -1)]
    straight = ends[0] + shares[:, None, None] * (ends[1] - ends[0])  # (m, n, 3)
    wanted = straight
    last_rolled, last_miss = straight, np.zeros_like(straight)
    for _ in range(MOST_LAPS):
        postures = [
            first,
            *(
                _follow(task, moving, index, base, q, centers)
                for base, q, centers in zip(bases[1:-1], postures[1:-1], wanted[1:-1], strict=True)
            ),
            last,
        ]
        gone = _rolled(task, moving, bases, postures)
        rolled = straight + gone - shares[:, None, None] * gone[-1]
        miss = rolled - wanted
        if np.abs(miss).max() <= STEADY_TOL:
            break
        wanted, last_rolled, last_miss = _mixed(rolled, miss, last_rolled, last_miss), rolled, miss
    return postures


def _mixed(
    value: FloatArray, miss: FloatArray, last_value: FloatArray, last_miss: FloatArray
) -> FloatArray:
    """The next iterate of a fixed-point iteration (Anderson 1965, one step of memory).

    It mixes in the last value by the share that minimises the linearised residual.
    """
    change = (miss - last_miss).ravel()
    if not last_miss.any() or not change.any():
        return value
    share = float(miss.ravel() @ change) / float(change @ change)
    return value - share * (value - last_value)


def _tips(
    task: GraspTask, moving: MovingHand, base: SE3, q: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Centres (n, 3) of the pads and orientations (n, 3, 3) of the tips, object frame."""
    moving.move(q)
    poses = [base * moving.joint_pose(f.pad.joint_id) for f in task.fingers]
    centers = [pose.act(f.pad.center) for pose, f in zip(poses, task.fingers, strict=True)]
    return np.array(centers), np.array([pose.rotation for pose in poses])


def _rolled(
    task: GraspTask, moving: MovingHand, bases: Sequence[SE3], postures: Sequence[FloatArray]
) -> FloatArray:
    """Displacements (m, n, 3) of the centres since the first sample if the tips roll."""
    tips = [_tips(task, moving, base, q) for base, q in zip(bases, postures, strict=True)]
    centers, turned = np.array([c for c, _ in tips]), np.array([r for _, r in tips])
    middle = (centers[:-1] + centers[1:]) / 2
    normals = task.object.shape.closest_point(middle.reshape(-1, 3))[1].reshape(middle.shape)
    steps = turned[1:] @ turned[:-1].swapaxes(-1, -2)
    turns = np.array([pin.log3(r) for r in steps.reshape(-1, 3, 3)]).reshape(middle.shape)
    radii = np.array([f.pad.radius for f in task.fingers])
    out = np.zeros_like(centers)
    np.cumsum(radii[:, None] * np.cross(turns, normals), axis=0, out=out[1:])
    return out


def _moved_joints(task: GraspTask) -> IntArray:
    """Joints of the fingers in contact, and joints coupled to any other."""
    matrix, _ = task.hand.coupling_matrix
    coupled = np.flatnonzero(np.abs(matrix).sum(axis=0))
    index = np.union1d(coupled, np.concatenate([f.q_index for f in task.fingers]))
    return np.setdiff1d(index, task.hand.wrist_index).astype(np.int64)


def _follow(
    task: GraspTask,
    moving: MovingHand,
    index: IntArray,
    base: SE3,
    q: FloatArray,
    centers: FloatArray,
) -> FloatArray:
    """Joints (nq,) near q with the pads' centres over these (n, 3), one radius off the surface."""
    hand = task.hand
    points, outward = task.object.shape.closest_point(centers)
    radii = np.array([f.pad.radius for f in task.fingers])
    to_base = base.inverse()
    wanted = np.array([to_base.act(c) for c in points + radii[:, None] * outward])
    matrix, value = hand.coupling_matrix
    q = q.copy()
    for _ in range(STEPS):
        moving.move(q)
        now = np.array([moving.pad_center(f) for f in task.fingers])
        missing = np.concatenate([(wanted - now).ravel(), value - matrix @ q])
        if np.abs(missing).max() <= ARRIVED:
            break
        rows = [
            moving.point_jacobian(f.pad.joint_id, c)[:3]
            for f, c in zip(task.fingers, now, strict=True)
        ]
        reach = Task(np.vstack([*rows, matrix])[:, index], missing)
        q[index] = ik_step(reach, q[index], hand.q_lower[index], hand.q_upper[index], rcond=RCOND)
    return q
