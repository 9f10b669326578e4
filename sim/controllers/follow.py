"""``MotionReference``: leads object and fingers along a planned motion, as fast as they follow.

The wanted turn y* grows at a limited rate, with limited acceleration at both ends, and waits for
the measured turn y, the signed twist of the object in the palm since the turn began:

    dy*/dt <= rate clip(2 (1 - (y* - y) / LEAD), 0, 1),    y* ends at the angle asked for

so it is the measured turn that counts: what rolling adds or loses is seen and made up for. An
object that stays short of its goal, as after a push that made it slip, is led on slowly along what
was planned beyond the goal. The
place on the planned path is y* over the planned angle. Cubic splines through the knots give the
object's pose, the pad centres in the object's frame, in which they move by rolling only, and the
joints: a velocity that jumps at a knot would be felt as a blow. Where the object lay otherwise than
planned when the turn began, it is led onto the planned path bit by bit; only its turn about the
axis stays its own, and its place where it is to be moved, from where it is. While the wanted forces
cannot be had, the rate is lower.

The way back, from any place to the beginning, is the same backwards. A pure translation is led by
time alone, which y* stands for then.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from scipy.interpolate import CubicSpline

from planner.errors import TaskError
from planner.kinematics.state import HandState
from planner.motion import Knot, MotionPlan
from planner.spatial import SE3, FloatArray, signed_twist
from sim.controllers.reference import Target

__all__ = ["LEAD", "RATE", "MotionReference"]

RATE = 1.1
"""Default largest rate of the turn, rad/s: 90 degrees in 1.6 s with the ramps."""

RAMP = 0.15
"""Time (s) in which the full rate is reached from rest, and left: slow beside the bandwidth."""

CREEP = 0.02
"""Least share (-) of the full rate near the end, so that the end is reached in finite time."""

LEAD = np.deg2rad(8.0)
"""Most (rad) that the wanted turn is ahead of the measured one: with a learned load a following
object lags by 1 to 3 degrees, and a blocked one is then pressed by 8 degrees of the spring."""

SPEED = 0.05
"""Largest speed (m/s) of a translation in the hand."""


STOPPING, LEAST_ABLE, MISSED_TIME = 0.5, 0.3, 0.05
"""The rate falls with the share of the wanted wrench that cannot be had (averaged over a time, s),
to the least share of the full rate: moving itself takes torque, a fifth of what the Allegro's thumb
has at full rate."""

VELOCITY_STEP = 0.002
"""Time (s) over which the wanted velocity is taken from the path: a control step."""

FURTHER, SHORT = 0.3, np.deg2rad(0.3)
"""Share (-) of the full rate with which the reference goes on beyond its goal, and by how much
(rad) the measured turn is short of it then: less than what a turn that is made may lack."""

ROUNDING = 1e-9
"""A turn (rad) or a length (m) that differs by less is the same."""


class MotionReference:
    """The reference of one motion; starts when first asked.

    Attributes:
        axis: (3,), of the turn, palm.
        goal: Turn that is asked for, rad, with its sign; of a pure translation 0.
        turned: Turn that was measured last, rad, counted beyond half turns too.
    """

    def __init__(
        self,
        motion: MotionPlan,
        *,
        angle: float | None = None,
        rate: float = RATE,
        back_from: float | None = None,
    ) -> None:
        """Prepare the knots.

        Args:
            motion: What was planned.
            angle: Turn that is asked for, rad; the planned one if None.
            rate: Largest rate of the turn, rad/s.
            back_from: Place on the path, in (0, 1], from which the object is led back to the
                beginning; None leads it from the beginning on.

        Raises:
            TaskError: A rate that is not positive, an angle that was not planned for, or a way back
                from nowhere or by another angle than the place tells.
        """
        if back_from is not None and (angle is not None or not 0.0 < back_from <= 1.0):
            raise TaskError(
                f"a way back from {back_from} of the path by the angle {angle}; give a place in "
                "(0, 1], and no angle, which follows from it"
            )
        if not (np.isfinite(rate) and rate > 0):
            raise TaskError(f"rate is {rate}; give a finite number > 0 in rad/s")
        path = motion.path
        self._path = _Path(motion, back_from)
        whole = path.angle if back_from is None else -back_from * path.angle
        self.goal = whole if angle is None else angle
        if self.goal * whole < 0 or abs(self.goal) > abs(whole) + ROUNDING:
            raise TaskError(
                f"a turn by {np.rad2deg(self.goal):.1f} degrees is asked of a motion that was "
                f"planned for {np.rad2deg(whole):.1f}; give at most that, or plan further"
            )
        self.axis: FloatArray = motion.grasp.T_world_palm.rotation.T @ path.axis
        self._turns, self._moves = abs(whole) > ROUNDING, bool(path.shift.any())
        self._sign = float(np.sign(whole))
        shift = float(np.linalg.norm(path.shift)) * (1.0 if back_from is None else back_from)
        self._length = abs(whole) if self._turns else shift
        self._end = abs(self.goal) if self._turns else self._length
        self._fastest = rate if self._turns else SPEED
        self._acceleration = self._fastest / RAMP
        self._gone, self._speed = 0.0, 0.0  # along the way, rad or m
        self._missed = 0.0
        self.turned = 0.0
        self._begin: _Begin | None = None

    @property
    def place(self) -> float:
        """Where on the planned path the reference is, 0 to 1."""
        return self._path.place(self._share)

    @property
    def arrived(self) -> bool:
        """Whether the reference is at its end; the object may still be behind."""
        return self._gone >= self._end - ROUNDING

    @property
    def left(self) -> float:
        """Measured turn that is still to be made, rad; negative beyond the goal."""
        return self._sign * (self.goal - self.turned)

    def advance(
        self, elapsed: float, T_palm_object: SE3, tips: FloatArray, q: FloatArray, *, missed: float
    ) -> Target:
        """Go on by one step; see ``Reference``."""
        if self._begin is None:
            self._begin = _Begin(
                self.axis, self._path.at(0.0), T_palm_object, tips, q, moves=self._moves
            )
        else:
            turn = T_palm_object.rotation @ self._begin.rotation.T
            self.turned = signed_twist(turn, self.axis, near=self.turned)
            self._go_on(elapsed, missed)
        share, begin = self._share, self._begin
        here = self._path.at(share)
        there = self._path.at(min(1.0, share + self._speed * VELOCITY_STEP / self._length))
        wanted = begin.led(here.T_palm_object, share)
        turn = pin.log3(there.T_palm_object.rotation @ here.T_palm_object.rotation.T)
        shift = there.T_palm_object.translation - here.T_palm_object.translation
        return Target(
            T_palm_object=wanted,
            twist=np.concatenate([shift, turn]) / VELOCITY_STEP,
            tips=begin.tips(here.tips, wanted),
            q=here.q + (1.0 - share) * begin.bent,
            v=(there.q - here.q) / VELOCITY_STEP,
        )

    @property
    def _share(self) -> float:
        """How much of the way is gone, 0 to 1; a way back has ended where the path begins."""
        return min(1.0, self._gone / self._length)

    def _go_on(self, elapsed: float, missed: float) -> None:
        """Let the reference move on as far as the object follows."""
        left, fastest = max(0.0, self._end - self._gone), self._fastest
        if self._turns and left <= ROUNDING and self.left > SHORT:
            left, fastest = self._length - self._gone, FURTHER * fastest
        self._missed += min(1.0, elapsed / MISSED_TIME) * (missed - self._missed)
        able = max(LEAST_ABLE, 1.0 - self._missed / STOPPING)
        speed = min(
            able * fastest,
            self._speed + self._acceleration * elapsed,
            float(np.sqrt(2.0 * self._acceleration * left)) + CREEP * fastest,
        )
        if self._turns:
            ahead = self._gone - self._sign * self.turned
            speed *= float(np.clip(2.0 * (1.0 - ahead / LEAD), 0.0, 1.0))
        self._speed = min(speed, left / elapsed)
        self._gone += self._speed * elapsed


@dataclass(frozen=True, kw_only=True, eq=False)
class _Place:
    """A place of a path: pose, pads (n, 3) in the object's frame, joints (nq,)."""

    T_palm_object: SE3
    tips: FloatArray
    q: FloatArray


class _Path:
    """A planned motion between its knots, from its beginning or from a place back to it."""

    def __init__(self, motion: MotionPlan, back_from: float | None) -> None:
        self._back_from = back_from
        T_palm_world = motion.grasp.T_world_palm.inverse()
        poses = [T_palm_world * k.T_world_object for k in motion.knots]
        self._first: FloatArray = poses[0].rotation
        rows = [
            np.concatenate(
                [
                    pin.log3(pose.rotation @ self._first.T),
                    pose.translation,
                    _tips_in_object(motion, knot).ravel(),
                    knot.q,
                ]
            )
            for pose, knot in zip(poses, motion.knots, strict=True)
        ]
        self._n = 3 * len(motion.grasp.task.fingers)
        self._spline = CubicSpline([k.path_parameter for k in motion.knots], rows)

    def place(self, share: float) -> float:
        """Where on the path a share of the way is."""
        return share if self._back_from is None else self._back_from * (1.0 - share)

    def at(self, share: float) -> _Place:
        row = self._spline(self.place(share))
        return _Place(
            T_palm_object=SE3(pin.exp3(row[:3]) @ self._first, row[3:6]),
            tips=row[6 : 6 + self._n].reshape(-1, 3),
            q=row[6 + self._n :],
        )


class _Begin:
    """How it was when the turn began, against the plan.

    Attributes:
        rotation: (3, 3), of the object in the palm.
        bent: (nq,), joints less the planned ones, rad.
        about: (3, 3), the object's rotation about the axis less the planned one, of any size: an
            object that was regrasped is planned for as it stood before the first stroke.
    """

    def __init__(
        self,
        axis: FloatArray,
        planned: _Place,
        actual: SE3,
        tips: FloatArray,
        q: FloatArray,
        *,
        moves: bool,
    ) -> None:
        pose = planned.T_palm_object
        self.rotation: FloatArray = actual.rotation.copy()
        self.bent: FloatArray = q - planned.q
        turned = actual.rotation @ pose.rotation.T
        self.about: FloatArray = pin.exp3(signed_twist(turned, axis) * axis)
        self._tilt = pin.log3(turned @ self.about.T)
        self._shift, self._moves = actual.translation - pose.translation, moves
        seen = self.about.T @ actual.rotation
        self._aside: FloatArray = (tips - actual.translation) @ seen - planned.tips

    def led(self, planned: SE3, share: float) -> SE3:
        """The planned pose with what is left of the difference after a share of the way."""
        left = 1.0 - share
        turn = pin.exp3(left * self._tilt) @ self.about
        aside = self._shift if self._moves else left * self._shift
        return SE3(turn @ planned.rotation, planned.translation + aside)

    def tips(self, planned: FloatArray, wanted: SE3) -> FloatArray:
        """Planned pads (n, 3), object's frame, in the palm, as far beside them as at the start."""
        seen = self.about.T @ wanted.rotation
        return np.asarray((planned + self._aside) @ seen.T + wanted.translation)


def _tips_in_object(motion: MotionPlan, knot: Knot) -> FloatArray:
    """Pad centres (n, 3) in the object's frame at a knot."""
    state = HandState(motion.grasp.task.hand, knot.q)
    T_object_base = knot.T_world_object.inverse() * motion.T_world_base
    return np.array([T_object_base.act(state.pad_center(f)) for f in motion.grasp.task.fingers])
