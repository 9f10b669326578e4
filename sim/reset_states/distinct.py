"""Which states are new: of two that are near-duplicates the earlier one is kept.

Two states of a cell are near-duplicates where the object's position differs by at most 1 mm, its
orientation by at most 1 degree, and every joint by at most 1 degree (0.0175, in rad or m). What the
states differ in besides (gravity, mass, friction, commands) does not make them distinct.
"""

from __future__ import annotations

import numpy as np

from planner.spatial import FloatArray, IntArray

NEAR_POSITION, NEAR_ANGLE, NEAR_JOINT = 0.001, float(np.deg2rad(1.0)), float(np.deg2rad(1.0))
"""Tolerances: m, rad, rad (m for slides)."""


class Distinct:
    """States that were taken, and the question whether another one is new.

    They are filed by the cube of 1 mm that the object's position falls into, so that a state is
    compared with those of 27 cubes.
    """

    def __init__(self) -> None:
        """Nothing was taken."""
        self._cubes: dict[tuple[int, int, int], list[int]] = {}
        self._rows: list[FloatArray] = []

    def take(self, q: FloatArray, position: FloatArray, quaternion: FloatArray) -> bool:
        """Take a state if it is new; whether it is.

        Args:
            q: Joints (nq,).
            position: Of the object (3,), m.
            quaternion: Its orientation, a unit quaternion (4,).
        """
        x, y, z = (int(i) for i in np.floor(position / NEAR_POSITION))
        near = [
            i
            for dx in (-1, 0, 1)
            for dy in (-1, 0, 1)
            for dz in (-1, 0, 1)
            for i in self._cubes.get((x + dx, y + dy, z + dz), ())
        ]
        row = np.concatenate([position, quaternion, q])
        if near and _near(np.array([self._rows[i] for i in near]), row).size:
            return False
        self._cubes.setdefault((x, y, z), []).append(len(self._rows))
        self._rows.append(row)
        return True


def _near(others: FloatArray, row: FloatArray) -> IntArray:
    """Which rows (m, 7 + nq) are near-duplicates of a row."""
    apart = np.linalg.norm(others[:, :3] - row[:3], axis=1) <= NEAR_POSITION
    apart &= np.abs(others[:, 3:7] @ row[3:7]) >= np.cos(NEAR_ANGLE / 2)
    apart &= np.abs(others[:, 7:] - row[7:]).max(axis=1) <= NEAR_JOINT
    return np.flatnonzero(apart)
