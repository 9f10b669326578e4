"""``PadReading``: what tactile pads feel, one row per finger that takes part.

A pad that measures force in three axes and sees the surface move under it (optical pads do) gives
the force on the object, where it acts, along which normal, and how fast the object slides over it.
Contacts of one finger are summed; positions and velocities are means weighted by normal force.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from planner.spatial import FloatArray

__all__ = ["PadReading"]


@dataclass(frozen=True, kw_only=True, eq=False)
class PadReading:
    """What the pads of n fingers feel, world axes.

    Attributes:
        normal_force: (n,), sum of the normal forces, N; 0 without contact.
        force: (n, 3), force on the object, N.
        position: (n, 3), where it acts, m; NaN without contact.
        normal: (n, 3), unit, into the object; NaN without contact.
        sliding: (n, 3), velocity of the object relative to the pad along the surface, m/s; NaN
            without contact.
    """

    normal_force: FloatArray
    force: FloatArray
    position: FloatArray
    normal: FloatArray
    sliding: FloatArray

    @classmethod
    def nothing(cls, n: int = 0) -> PadReading:
        """The reading of n pads that touch nothing."""
        none = np.full((n, 3), np.nan)
        return cls(
            normal_force=np.zeros(n),
            force=np.zeros((n, 3)),
            position=none,
            normal=none.copy(),
            sliding=none.copy(),
        )

    @property
    def tangential_force(self) -> FloatArray:
        """Size of the force along the surface, (n,), N; 0 without contact."""
        normal = np.nan_to_num(self.normal)
        along = (self.force * normal).sum(axis=1)
        return np.asarray(np.linalg.norm(self.force - along[:, None] * normal, axis=1))

    @property
    def sliding_speed(self) -> FloatArray:
        """Size of ``sliding``, (n,), m/s; 0 without contact."""
        return np.asarray(np.linalg.norm(np.nan_to_num(self.sliding), axis=1))

    def friction_ratio(self) -> FloatArray:
        """Tangential over normal force, (n,), -: the friction in use; 0 without contact."""
        loaded = self.normal_force > 0
        return np.where(
            loaded, self.tangential_force / np.where(loaded, self.normal_force, 1.0), 0.0
        )
