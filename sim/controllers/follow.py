"""``MotionReference``: leads object and fingers along a planned motion, as fast as they follow.

The wanted turn y* grows at a limited rate, with limited acceleration at both ends, and waits for
the measured turn y, the signed twist of the object in the palm since the turn began:

    dy*/dt <= rate clip(2 (1 - (y* - y) / LEAD), 0, 1),    y* ends at the angle asked for

so it is the measured turn that counts: what rolling adds or loses is seen and made up for. The
place on the planned path is y* over the planned angle; object pose and pad centres are interpolated
between knots there, the pads in the object's frame, in which they move by rolling only. Where the
object lay otherwise than planned when the turn began, it is led onto the planned path bit by bit;
only its turn about the axis stays its own.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from planner.errors import TaskError
from planner.kinematics import HandState
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


BRAKING = 2.0
"""How much faster (-) than it gains speed the reference loses it while the forces that are wanted
cannot be had: moving itself takes torque, a fifth of what the Allegro's thumb has at full rate."""

VELOCITY_STEP = 0.002
"""Time (s) over which the wanted velocity is taken from the path: a control step."""

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
        self, motion: MotionPlan, *, angle: float | None = None, rate: float = RATE
    ) -> None:
        """Prepare the knots.

        Args:
            motion: What was planned.
            angle: Turn that is asked for, rad; the planned one if None.
            rate: Largest rate of the turn, rad/s.

        Raises:
            TaskError: A rate that is not positive, or an angle that was not planned for.
        """
        path = motion.path
        self.goal = path.angle if angle is None else angle
        if not (np.isfinite(rate) and rate > 0):
            raise TaskError(f"rate is {rate}; give a finite number > 0 in rad/s")
        if self.goal * path.angle < 0 or abs(self.goal) > abs(path.angle) + ROUNDING:
            raise TaskError(
                f"a turn by {np.rad2deg(self.goal):.1f} degrees is asked of a motion that was "
                f"planned for {np.rad2deg(path.angle):.1f}; give at most that, or plan further"
            )
        self._motion = motion
        self._T_palm_world = motion.grasp.T_world_palm.inverse()
        self.axis: FloatArray = self._T_palm_world.rotation @ path.axis
        self._places = np.array([k.place for k in motion.knots])
        self._tips = np.array([_tips_in_object(motion, knot) for knot in motion.knots])
        self._turns = abs(path.angle) > ROUNDING
        self._sign = float(np.sign(path.angle))
        self._length = abs(path.angle) if self._turns else float(np.linalg.norm(path.shift))
        self._end = abs(self.goal) if self._turns else self._length
        self._fastest = rate if self._turns else SPEED
        self._acceleration = self._fastest / RAMP
        self._gone, self._speed = 0.0, 0.0  # along the path, rad or m
        self.turned = 0.0
        self._begin: _Begin | None = None

    @property
    def place(self) -> float:
        """Where on the planned path the reference is, 0 to 1."""
        return min(1.0, self._gone / self._length)

    @property
    def arrived(self) -> bool:
        """Whether the reference is at its end; the object may still be behind."""
        return self._gone >= self._end - ROUNDING

    @property
    def left(self) -> float:
        """Measured turn that is still to be made, rad; negative beyond the goal."""
        return self._sign * (self.goal - self.turned)

    def advance(
        self, elapsed: float, T_palm_object: SE3, tips: FloatArray, q: FloatArray, *, strained: bool
    ) -> Target:
        """Go on by one step; see ``Reference``."""
        if self._begin is None:
            self._begin = _Begin(
                self.axis, self.pose(0.0), self._motion.knots[0].q, T_palm_object, q
            )
            local = (tips - T_palm_object.translation) @ T_palm_object.rotation
            self._tips = self._tips + (local - self._tips[0])
        else:
            turn = T_palm_object.rotation @ self._begin.rotation.T
            self.turned = signed_twist(turn, self.axis, near=self.turned)
            self._go_on(elapsed, strained)
        place = self.place
        here, posture = self._motion.at(place)
        step = self._speed * VELOCITY_STEP / self._length
        there, next_posture = self._motion.at(min(1.0, place + step))
        here, there = self._T_palm_world * here, self._T_palm_world * there
        wanted = self._begin.led(here, place)
        return Target(
            T_palm_object=wanted,
            twist=np.concatenate(
                [
                    there.translation - here.translation,
                    pin.log3(there.rotation @ here.rotation.T),
                ]
            )
            / VELOCITY_STEP,
            tips=self._tips_at(place) @ wanted.rotation.T + wanted.translation,
            q=posture + (1.0 - place) * self._begin.bent,
            v=(next_posture - posture) / VELOCITY_STEP,
        )

    def pose(self, place: float) -> SE3:
        """Planned T_palm_object at a place of the path."""
        return self._T_palm_world * self._motion.at(place)[0]

    def _go_on(self, elapsed: float, strained: bool) -> None:
        """Let the reference move on as far as the object follows."""
        left = self._end - self._gone
        change = -BRAKING if strained else 1.0
        speed = min(
            self._fastest,
            max(self._speed + change * self._acceleration * elapsed, CREEP * self._fastest),
            float(np.sqrt(2.0 * self._acceleration * left)) + CREEP * self._fastest,
        )
        if self._turns:
            ahead = self._gone - self._sign * self.turned
            speed *= float(np.clip(2.0 * (1.0 - ahead / LEAD), 0.0, 1.0))
        self._speed = min(speed, left / elapsed)
        self._gone += self._speed * elapsed

    def _tips_at(self, place: float) -> FloatArray:
        """Pad centres (n, 3) in the object's frame at a place of the path."""
        i = int(np.clip(np.searchsorted(self._places, place) - 1, 0, len(self._places) - 2))
        share = (place - self._places[i]) / (self._places[i + 1] - self._places[i])
        return np.asarray(self._tips[i] + share * (self._tips[i + 1] - self._tips[i]))


class _Begin:
    """How it was when the turn began, against the plan.

    Attributes:
        rotation: (3, 3), of the object in the palm.
        bent: (nq,), joints less the planned ones, rad.
    """

    def __init__(
        self, axis: FloatArray, planned: SE3, q_planned: FloatArray, actual: SE3, q: FloatArray
    ) -> None:
        self.rotation: FloatArray = actual.rotation.copy()
        self.bent: FloatArray = q - q_planned
        turn = pin.log3(actual.rotation @ planned.rotation.T)
        self._about = (turn @ axis) * axis
        self._tilt = turn - self._about
        self._shift = actual.translation - planned.translation

    def led(self, planned: SE3, place: float) -> SE3:
        """The planned pose with what is left there of the difference."""
        left = 1.0 - place
        turn = pin.exp3(self._about + left * self._tilt)
        return SE3(turn @ planned.rotation, planned.translation + left * self._shift)


def _tips_in_object(motion: MotionPlan, knot: Knot) -> FloatArray:
    """Pad centres (n, 3) in the object's frame at a knot."""
    state = HandState(motion.grasp.task.hand, knot.q)
    T_object_base = knot.T_world_object.inverse() * motion.T_world_base
    return np.array([T_object_base.act(state.pad_center(f)) for f in motion.grasp.task.fingers])
