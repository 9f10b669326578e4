"""``SeenPose`` and ``PoseBelief``: when a pose was seen, and how well one is known.

Both stand in an ``Observation``, beside the pose itself.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from planner.spatial import SE3, FloatArray


@dataclass(frozen=True, kw_only=True, eq=False)
class SeenPose:
    """A measured pose of the object.

    Attributes:
        time: When it was measured, s since the start of the trial.
        T_world_object: What was measured.
    """

    time: float
    T_world_object: SE3


@dataclass(frozen=True, kw_only=True, eq=False)
class PoseBelief:
    """What an estimator knows of the error of ``Observation.T_world_object``.

    Attributes:
        covariance: (6, 6), of the position of the object's origin, m, and of its rotation vector,
            rad, true minus estimated, world axes.
        known: Whether the estimate is worth acting on.
    """

    covariance: FloatArray
    known: bool

    @property
    def position_deviation(self) -> float:
        """Root mean square of the position's error as it is believed, m."""
        return float(np.sqrt(np.trace(self.covariance[:3, :3])))

    @property
    def rotation_deviation(self) -> float:
        """Root mean square of the rotation's error as it is believed, rad."""
        return float(np.sqrt(np.trace(self.covariance[3:, 3:])))
