"""``Reference``: where object and fingers should be while a motion is executed, at every step.

``ObjectImpedance.reference`` may hold anything with ``advance``; it is asked in the phase "turn".
``sim.controllers.follow`` has the one that follows a planned motion.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from planner.spatial import SE3, FloatArray


@dataclass(frozen=True, kw_only=True, eq=False)
class Target:
    """Where object and fingers should be now, in the palm.

    Attributes:
        T_palm_object: Pose of the object.
        twist: (6,), its velocity, of the centre of mass and angular, m/s and rad/s, palm axes.
        tips: (n, 3), pad centres of the fingers that take part, m. Only how they lie to each other
            is pursued for those that hold; one that leaves stays off its own.
        q: (nq,), posture that redundant fingers keep to.
        v: (nq,), its rates.
    """

    T_palm_object: SE3
    twist: FloatArray
    tips: FloatArray
    q: FloatArray
    v: FloatArray


class Reference(Protocol):
    """What gives a target at every step."""

    def advance(
        self, elapsed: float, T_palm_object: SE3, tips: FloatArray, q: FloatArray, *, missed: float
    ) -> Target:
        """Go on by one step.

        Args:
            elapsed: Time since the last call, s; in the first call it does not matter.
            T_palm_object: Measured pose of the object.
            tips: Pad centres (n, 3) where they are, palm, m.
            q: Joints (nq,) where they are.
            missed: Share (-) of the last step's wrench that could not be had, at least of 1 N.
        """
        ...
