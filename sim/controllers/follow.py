"""``MotionReference``: targets along a planned motion, as fast as the object follows.

The wanted turn y* grows at a limited rate, with limited acceleration at both ends. Its advance over
the measured turn y, the signed twist of the object in the palm since the turn began, is limited:

    dy*/dt <= rate clip(2 (1 - (y* - y) / MAX_ADVANCE), 0, 1),    y* ends at the angle asked for

The measured turn counts, so that rolling is compensated. If the object lags behind the goal, as
after a push that made it slip, the reference continues slowly into the planned overshoot. If it
leads, as one that slips about its axis does, the reference stops when it is there.

The place on the planned path is y* over the planned angle. Cubic splines through the knots give the
object's pose, the pad centres in the object's frame, in which they move by rolling only, and the
joints; a velocity that jumps at a knot would act as an impact. A pose that differs from the planned
one when the turn begins is blended linearly into the planned path, except for the rotation about
the axis and, for a translation in the hand, the position: these differences persist. While the
wanted wrench is infeasible, the rate is lower.

The way back, from any place to the beginning, is the same backwards. A pure translation advances by
time alone, and y* is its length then.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin
from scipy.interpolate import CubicSpline

from planner.errors import TaskError
from planner.kinematics import HandState
from planner.spatial import SE3, FloatArray, signed_twist
from sim.controllers.base import Target

if TYPE_CHECKING:
    from planner.motion import Knot, MotionPlan

RATE = 1.1
"""Default largest rate of the turn, rad/s: 90 degrees in 1.6 s with the ramps."""

RAMP = 0.15
"""Time (s) in which the full rate is reached from rest, and left: slow beside the bandwidth."""

CREEP = 0.02
"""Least share (-) of the full rate near the end, so that the end is reached in finite time."""

MAX_ADVANCE = np.deg2rad(8.0)
"""Largest advance (rad) of the wanted turn over the measured one: an object that follows lags by
less, and a blocked one is pressed by 8 degrees of the rotational spring."""

SPEED = 0.05
"""Largest speed (m/s) of a translation in the hand."""

STOPPING, LEAST_ABLE, MISSED_TIME = 0.5, 0.3, 0.05
"""The rate falls linearly with the missed share of the wanted wrench, to zero at the first (-) but
never less than the second, a share of the full rate (-); the missed share is averaged over the
third (s). Moving slower leaves the joints more torque for the wrench."""

VELOCITY_STEP = 0.002
"""Time (s) over which the wanted velocity is taken from the path: a control step."""

OVERSHOOT_RATE, OVERSHOOT_LAG = 0.3, np.deg2rad(0.3)
"""Share (-) of the full rate in the overshoot, and the lag (rad) behind the goal from which on the
reference continues into it, or beyond the goal from which on it stops short of its own end: less
than the tolerance of a finished turn."""

ROUNDING = 1e-9
"""A turn (rad) or a length (m) that differs by less is the same."""


class MotionReference:
    """The reference of one motion; starts at the first ``advance``.

    Attributes:
        motion: What was planned.
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
            back_from: Place on the path, in (0, 1], from which the object goes back to the
                beginning; None begins at the beginning.

        Raises:
            TaskError: A rate that is not positive, an angle that was not planned for, or a way back
                from outside the path or with an angle of its own.
        """
        if back_from is not None and (angle is not None or not 0.0 < back_from <= 1.0):
            raise TaskError(
                f"a way back from {back_from} of the path by the angle {angle}; give a place in "
                "(0, 1], and no angle, which follows from it"
            )
        if not (np.isfinite(rate) and rate > 0):
            raise TaskError(f"rate is {rate}; give a finite number > 0 in rad/s")
        self.motion, path = motion, motion.path
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
        self._length = max(abs(whole) if self._turns else shift, ROUNDING)  # of one that stays
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
        """Whether the reference is at its end; the object may still lag."""
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
        wanted = begin.blended(here.T_palm_object, share)
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
        """Advance the reference as far as the object follows."""
        left, fastest = max(0.0, self._end - self._gone), self._fastest
        if self._turns and left <= ROUNDING and self.left > OVERSHOOT_LAG:
            left, fastest = self._length - self._gone, OVERSHOOT_RATE * fastest
        elif self._turns and self.left < -OVERSHOOT_LAG:  # the object leads, and is there
            left = 0.0
        self._missed += min(1.0, elapsed / MISSED_TIME) * (missed - self._missed)
        able = max(LEAST_ABLE, 1.0 - self._missed / STOPPING)
        speed = min(
            able * fastest,
            self._speed + self._acceleration * elapsed,
            float(np.sqrt(2.0 * self._acceleration * left)) + CREEP * fastest,
        )
        if self._turns:
            advance = self._gone - self._sign * self.turned
            speed *= float(np.clip(2.0 * (1.0 - advance / MAX_ADVANCE), 0.0, 1.0))
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
    """Differences from the plan when the turn began.

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

    def blended(self, planned: SE3, share: float) -> SE3:
        """The planned pose plus the initial difference, faded out along the way."""
        left = 1.0 - share
        turn = pin.exp3(left * self._tilt) @ self.about
        aside = self._shift if self._moves else left * self._shift
        return SE3(turn @ planned.rotation, planned.translation + aside)

    def tips(self, planned: FloatArray, wanted: SE3) -> FloatArray:
        """Planned pads (n, 3), object's frame, in the palm, with their initial offset."""
        seen = self.about.T @ wanted.rotation
        return np.asarray((planned + self._aside) @ seen.T + wanted.translation)


def _tips_in_object(motion: MotionPlan, knot: Knot) -> FloatArray:
    """Pad centres (n, 3) in the object's frame at a knot."""
    state = HandState(motion.grasp.task.hand, knot.q)
    T_object_base = knot.T_world_object.inverse() * motion.T_world_base
    return np.array([T_object_base.act(state.pad_center(f)) for f in motion.grasp.task.fingers])
