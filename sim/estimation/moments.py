"""``Moment``: what the senses said at one time; and ``Look``: a pose that a camera saw then."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planner.spatial import SE3, FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Look:
    """A measured pose of the object in the hand's base.

    Attributes:
        T_base_object: What was measured.
        camera: Number of this measurement, from 0: errors of neighbours are alike.
        period: Time since the one before, s.
    """

    T_base_object: SE3
    camera: int
    period: float


@dataclass(frozen=True, slots=True, eq=False)
class Moment:
    """Senses at one time; n fingers that take part, in the frames of their pads' joints.

    Attributes:
        time: s.
        q: (nq,), joints as read, rad or m.
        T_world_base: Pose of the hand's base.
        standing: Whether the object stands in the world; else the hand carries it.
        touching: (n,), which fingers touch.
        points: (n, 3), contacts, m; zeros where nothing is felt, or not where.
        normals: (n, 3), into the object; zeros there.
        sliding: (n, 3), velocity of the object over the pad, m/s; zeros there.
    """

    time: float
    q: FloatArray
    T_world_base: SE3
    standing: bool
    touching: NDArray[np.bool_]
    points: FloatArray
    normals: FloatArray
    sliding: FloatArray
