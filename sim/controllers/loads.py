"""``HandLoads``: Jacobians of a moving hand and the torque of its weight, by one call per step.

Pinocchio computes the joints' Jacobian on the way to that of the centre of mass; ``MovingHand``
computes it a second time. Contact forces become torques in one product for all fingers.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin
from pinocchio import SE3

from planner.hands.fingers import Finger
from planner.hands.hand import Hand
from planner.spatial import FloatArray

_NEXT, _AFTER = np.array([1, 2, 0]), np.array([2, 0, 1])


class HandLoads:
    """A hand that moves from one posture to the next, seen by forces at some fingers' pads.

    Attributes:
        jacobian: (6, nq), twist of the point at the base's origin per joint rate, if every joint
            moved the pad.
        moved_by: (n, nq), which joints move the pad of each finger.
    """

    def __init__(self, hand: Hand, fingers: Sequence[Finger]) -> None:
        """Prepare memory; call ``move`` next."""
        self._model, self._data = hand.pin_model, hand.pin_model.createData()
        self._palm = hand.palm_frame_id
        self.jacobian: FloatArray = np.zeros((6, hand.nq))
        self.moved_by = np.array(hand.moved_by[[finger.pad.joint_id for finger in fingers]])

    def move(self, q: FloatArray, gravity: FloatArray) -> FloatArray:
        """Go to joints q (nq,); returns the torques (nq,), N m, that hold the hand's weight.

        Args:
            q: Joints, rad or m.
            gravity: (3,), m/s2, base axes.
        """
        of_mass_centre = pin.jacobianCenterOfMass(self._model, self._data, q)
        self.jacobian[:] = self._data.J
        return np.array(-float(self._data.mass[0]) * of_mass_centre.T @ gravity)

    @property
    def T_base_palm(self) -> SE3:
        """Pose of the palm's body in the base."""
        return SE3(pin.updateFramePlacement(self._model, self._data, self._palm))

    def at(self, joint_id: int, point: FloatArray) -> FloatArray:
        """A point (3,) of a joint's frame in the base, m."""
        placed: FloatArray = self._data.oMi[joint_id].act(point)
        return placed

    def torque(self, forces: FloatArray, moments: FloatArray) -> FloatArray:
        """Joint torques (nq,), N m, that exert forces at the pads.

        Args:
            forces: (n, 3), on the object, base axes, N.
            moments: (n, 3), about the base's origin, N m.
        """
        both = np.array([forces, moments])[:, :, None]  # (2, n, 1, 3)
        of_forces, of_moments = (both @ self.jacobian.reshape(2, 1, 3, -1))[:, :, 0]
        out: FloatArray = np.where(self.moved_by, of_forces + of_moments, 0.0).sum(axis=0)
        return out


def crossed(a: FloatArray, b: FloatArray) -> FloatArray:
    """Cross products (n, 3) of rows: what ``np.cross`` gives, in a tenth of its time."""
    return np.asarray(
        a.take(_NEXT, axis=1) * b.take(_AFTER, axis=1)
        - a.take(_AFTER, axis=1) * b.take(_NEXT, axis=1)
    )
