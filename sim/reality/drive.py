"""``RealDrive``: what becomes of a controller's commands before they reach the actuators.

Commands are taken over at a rate, held in between, and act late. A drive clips them to its range.
A position servo then closes its loop on its own encoder: it brings the reading to the command, so
the joint itself comes to rest off by the encoder's error. In the simulator, where servos know the
true lengths, the command is shifted by that error through the transmission:

    ctrl = clip(command) - k R (reading - q),   k = -bias1 / gain,

and backlash is a dead band of the servo about its joint, of a motor side without inertia that moves
to where it is wanted as far as the band lets it:

    ctrl = c0 + dead_band(ctrl - c0, k b / 2),   c0 = where the servo gives no force at q.

The encoder sits on the motor's side: it reads how far that has gone ahead of the joint too. Between
the stops the servo's damping still acts on the joint, and within a time step its spring.

Here F = gain ctrl + bias0 + bias1 length (``planner.joints.actuation``). k is 1 for a position
servo and 0 for a motor, which gives its torque whatever the encoder says. Scale errors act
explicitly, once a time step. Encoder noise is left out of the servo: it closes its loop many times
per time step.
"""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from planner.joints.actuation import Actuation
from planner.spatial import FloatArray
from sim.reality.drawn import Drawn
from sim.reality.errors import Reality
from sim.reality.senses import TIME_TOL, encoder_error


class RealDrive:
    """Commands to ctrl; call ``drive`` once a time step."""

    def __init__(self, reality: Reality, drawn: Drawn, actuation: Actuation) -> None:
        """Nothing has been commanded yet."""
        self._reality, self._drawn = reality, drawn
        self._low, self._high = actuation.ctrl_range.T
        servo = -actuation.bias[:, 1] / actuation.gain
        self._shift = servo[:, None] * actuation.moment
        self._actuation, self._servo = actuation, servo
        widest = np.abs(actuation.moment).max(axis=1, initial=0.0)
        self._half_band = 0.5 * reality.backlash * widest * (servo > 0)
        self._ahead: FloatArray = np.zeros(actuation.moment.shape[1])
        self._to_joints = np.linalg.pinv(actuation.moment * (servo > 0)[:, None])
        self._under_way: deque[tuple[float, FloatArray]] = deque()
        self._next = 0.0

    def drive(self, time: float, commands: FloatArray, q: FloatArray) -> FloatArray:
        """What the actuators do at a time (s): ctrl (nu,).

        Args:
            time: s.
            commands: The controller's (nu,), of now.
            q: True joints (nq,).
        """
        acting = np.clip(self._arrived(time, commands), self._low, self._high)
        acting -= self._shift @ encoder_error(self._drawn, q)
        return acting if not self._half_band.any() else self._in_gear(acting, q)

    @property
    def ahead(self) -> FloatArray:
        """How far (nq,) the motors' sides have gone ahead of the joints, rad or m."""
        return self._ahead

    def _in_gear(self, acting: FloatArray, q: FloatArray) -> FloatArray:
        """What is left of the commands (nu,) beyond the lost motion at joints (nq,)."""
        a = self._actuation
        length = a.moment @ q + a.length0
        idle = -(a.bias[:, 0] + a.bias[:, 1] * length) / a.gain
        pull = acting - idle
        band = self._servo * self._half_band
        lost = np.clip(pull, -band, band)
        self._ahead = self._to_joints @ (lost / np.where(self._servo > 0, self._servo, 1.0))
        return np.asarray(idle + pull - lost)

    def _arrived(self, time: float, commands: FloatArray) -> FloatArray:
        """The newest commands that act; before any does, the first ones."""
        rate = self._reality.command_rate
        if time >= self._next - TIME_TOL:
            if rate > 0:
                self._next = (math.floor(time * rate + TIME_TOL) + 1) / rate
            self._under_way.append((time, commands.copy()))
        due = time - self._reality.command_delay + TIME_TOL
        while len(self._under_way) > 1 and self._under_way[1][0] <= due:
            self._under_way.popleft()
        return self._under_way[0][1]
