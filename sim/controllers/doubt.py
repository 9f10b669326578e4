"""``Doubt``: what an estimate takes back is no motion of the object.

Called by ``ObjectImpedance`` at every step while it only holds. A carried object moves with the
fingertips, which the joints tell to hundredths of a millimetre, and against them as the pads feel
it slide; one that still stands does not move. An estimate changes by more than that: it learns from
a camera of millimetres and degrees where the object has been all the time. A loop that brought the
object back by as much would move it in the hand, against contacts that stick, with forces that grow
until they slip. So the wanted pose goes along with the estimate, as far as the estimate was in
doubt. A larger change counts as a motion of the object.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from planner.spatial import SE3, FloatArray
from sim.controllers.belief import PoseBelief

DEVIATIONS = 3.0
"""How many standard deviations of the estimate, the largest so far, it may take back (-)."""


class Doubt:
    """What an estimate has taken back since the wanted pose was set."""

    def __init__(self) -> None:
        """Nothing yet."""
        self._last: SE3 | None
        self.forget()

    def forget(self) -> None:
        """Begin anew, at another wanted pose."""
        self._last = None
        self._taken, self._most = np.zeros((2, 3)), np.zeros(2)

    def gone_along(
        self, wanted: SE3, estimate: SE3, twist: FloatArray, elapsed: float, belief: PoseBelief
    ) -> SE3:
        """The wanted pose, moved as the estimate has moved without the object.

        Args:
            wanted: Where the object is to be kept, in the palm.
            estimate: Where it is taken to be, in the palm.
            twist: (6,), of the object as its contacts tell it, about its centre, palm axes, m/s and
                rad/s.
            elapsed: Since the last step, s.
            belief: How well the estimate is known.
        """
        last, self._last = self._last, estimate
        if last is None:
            return wanted
        deviations = np.array([belief.position_deviation, belief.rotation_deviation])
        self._most = np.maximum(self._most, deviations)
        shift = estimate.translation - last.translation - elapsed * twist[:3]
        turn = pin.log3(estimate.rotation @ last.rotation.T @ pin.exp3(-elapsed * twist[3:]))
        taken = self._taken + np.array([shift, turn])
        size = np.linalg.norm(taken, axis=1)
        most = DEVIATIONS * self._most
        taken *= np.minimum(1.0, most / np.maximum(size, np.maximum(most, TINY)))[:, None]
        (shift, turn), self._taken = taken - self._taken, taken
        return SE3(pin.exp3(turn) @ wanted.rotation, wanted.translation + shift)


TINY = 1e-12
"""Length (m) or angle (rad) that is nothing."""
