"""``ImpedanceLaw``: where the object is and should be -> the wrench that the hand should exert.

    w = K e - D (twist - wanted twist) + load,    e = [p* - p; log(R* R^T)]
    d load/dt = learning_rate (K e + missed)

K and D are diagonal, the same along and the same about every axis. ``missed`` is what the contact
forces give less what was asked of them, so that the load stops growing where no more can be given.
With learning_rate = 0 a constant push P leaves e = P / K; otherwise the load becomes -P and e goes
to 0. Everything is about the object's centre of mass, in the axes of the poses given.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from planner.spatial import SE3, FloatArray
from sim.controllers.gains import ImpedanceGains

__all__ = ["ImpedanceLaw"]


class ImpedanceLaw:
    """Spring, damper and learned load of one object.

    Attributes:
        gains: The gains.
        load: Wrench (6,) that was learned to be needed at rest, N and N m.
    """

    def __init__(self, gains: ImpedanceGains) -> None:
        """Start without a load."""
        self.gains = gains
        self.load = np.zeros(6)
        self._stiffness = np.repeat([gains.stiffness, gains.turning_stiffness], 3)
        self._damping = np.repeat([gains.damping, gains.turning_damping], 3)
        self._spring = np.zeros(6)

    def wrench(self, T_wanted: SE3, T_actual: SE3, twist: FloatArray) -> FloatArray:
        """The wrench (6,) that the hand should exert, without gravity.

        Args:
            T_wanted: Where the object should be.
            T_actual: Where it is.
            twist: (6,), velocity of the object relative to the wanted one: linear of the centre of
                mass and angular, m/s and rad/s.
        """
        error = np.empty(6)
        error[:3] = T_wanted.translation - T_actual.translation
        error[3:] = pin.log3(T_wanted.rotation @ T_actual.rotation.T)
        self._spring = self._stiffness * error
        return np.asarray(self._spring - self._damping * twist + self.load)

    def learn(self, elapsed: float, missed: FloatArray) -> None:
        """Let the spring's wrench go over to the load.

        Args:
            elapsed: Time since the last call, s.
            missed: (6,), what the contact forces give less the wrench that was asked of them.
        """
        self.load += elapsed * self.gains.learning_rate * (self._spring + missed)
