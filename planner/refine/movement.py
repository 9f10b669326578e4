"""``Movement``: how far a refinement moved a hand, part by part and as one number.

The one number ranks refinements of the same pose:

    distance^2 = mean |contact|^2 / (10 mm)^2 + |shift|^2 / (10 mm)^2
               + turn^2 / (0.2 rad)^2 + mean joint^2 / (0.2 rad)^2

A contact's displacement is measured from the point of the surface that its pad was nearest to, on
the side that the pad faces (``planner.refine.pads.under_pads``): a pad that only has to come
straight down to the surface, or out of it, displaces no contact.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from planner.immutable import freeze
from planner.spatial import SE3, FloatArray, rotation_angle

LENGTH_UNIT, TURN_UNIT, JOINT_UNIT = 0.01, 0.2, 0.2
"""Displacement of contacts and palm (m), turn of the palm (rad) and change of joints (rad) that
count as alike. A slide of 0.2 m is as far as that for no hand, and none that we know has one."""


@dataclass(frozen=True, kw_only=True)
class Movement:
    """How far a hand moved from the given pose.

    Attributes:
        contacts: Displacement of each finger's contact on the surface (n,), m, in the order of the
            task's fingers.
        joints: Change of each joint (nq,), rad (m for slides), order of ``hand.joint_names``.
        shift: Displacement of the palm's origin, m.
        turn: Turn of the palm, rad.
    """

    contacts: FloatArray
    joints: FloatArray
    shift: float
    turn: float

    def __post_init__(self) -> None:
        """Keep read-only copies."""
        freeze(self, arrays=("contacts", "joints"))

    @classmethod
    def between(
        cls,
        given: tuple[SE3, FloatArray, FloatArray],
        reached: tuple[SE3, FloatArray, FloatArray],
    ) -> Movement:
        """From one placement of a hand to another.

        Args:
            given: Palm pose, joints (nq,), contacts (n, 3), m, in one frame.
            reached: The same there.
        """
        (palm, q, points), (palm_to, q_to, points_to) = given, reached
        return cls(
            contacts=np.linalg.norm(points_to - points, axis=1),
            joints=q_to - q,
            shift=float(np.linalg.norm(palm_to.translation - palm.translation)),
            turn=rotation_angle(palm.rotation.T @ palm_to.rotation),
        )

    @property
    def contact(self) -> float:
        """Largest displacement of a contact, m."""
        return float(self.contacts.max())

    @property
    def joint(self) -> float:
        """Largest change of a joint, rad."""
        return float(np.abs(self.joints).max())

    @property
    def distance(self) -> float:
        """All of it as one number (-), see the module."""
        squares = (
            float((self.contacts**2).mean()) / LENGTH_UNIT**2,
            self.shift**2 / LENGTH_UNIT**2,
            self.turn**2 / TURN_UNIT**2,
            float((self.joints**2).mean()) / JOINT_UNIT**2,
        )
        return float(np.sqrt(sum(squares)))

    def __str__(self) -> str:
        """One line."""
        return (
            f"contacts {1e3 * self.contact:.1f} mm, joints {self.joint:.3f} rad, palm "
            f"{1e3 * self.shift:.1f} mm and {self.turn:.3f} rad"
        )
