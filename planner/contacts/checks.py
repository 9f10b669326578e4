"""What a ``ContactSet`` refuses: numbers that are not finite, too large, or no contact's.

A set is made at every attempt of a search and at every step of a controller, so each check is one
or two calls; only where that fails is there a look at every number.
"""

from __future__ import annotations

import math

import numpy as np

from planner.errors import ContactError
from planner.spatial import FloatArray

FARTHEST = 1e6
"""Largest coordinate (m): beyond it torques lose the digits that a verdict needs."""

MOST_FRICTION = 1e3
"""Largest sliding friction (-) and torsional friction (m): a force may be 89.94 degrees off the
normal. Beyond it the normal parts drown in the tangential ones, and rank is misjudged."""

_IDENTITY = np.eye(3)

_ORTHONORMAL_TOL = 1e-6
"""How far a given frame may be from a rotation matrix (-)."""


def check_frames(frames: FloatArray, name: str = "frames") -> None:
    """Refuse contact frames (n, 3, 3) that are not right-handed rotation matrices.

    Raises:
        ContactError: So, or they hold NaN.
    """
    if len(frames) == 0:
        return
    if np.shape(frames)[1:] != (3, 3):
        raise ContactError(f"{name} has shape {np.shape(frames)}; give (n, 3, 3)")
    if not math.isfinite(float(np.vdot(frames, frames))):
        _check_finite(frames, name)
    error = frames.transpose(0, 2, 1) @ frames
    error -= _IDENTITY
    # the sum of squares is the larger; where it is small, none needs a look of its own
    size = float(np.vdot(error, error))
    fits = size <= _ORTHONORMAL_TOL**2 or max(error.max(), -error.min()) <= _ORTHONORMAL_TOL
    if not (fits and _least_handedness(frames) > 0.0):
        raise ContactError(
            "a contact frame is not a right-handed rotation matrix; give [normal, tangent1, "
            "tangent2] in its columns, as contact_frames makes them"
        )


def _least_handedness(frames: FloatArray) -> float:
    """Least determinant of frames (n, 3, 3) that are orthonormal: 1 or, left-handed, -1."""
    least: float = min(
        a * (e * i - f * h) + b * (f * g - d * i) + c * (d * h - e * g)
        for (a, b, c), (d, e, f), (g, h, i) in frames.tolist()
    )
    return least


def check_positions(value: FloatArray, name: str) -> None:
    """Refuse what is not finite, or too far away."""
    # one product instead of a look at every number; it is infinite or NaN where one of them is
    size = float(np.vdot(value, value))
    if not math.isfinite(size):
        _check_finite(value, name)
    if not size <= FARTHEST**2 and np.abs(value).max() > FARTHEST:
        raise ContactError(f"a position is farther than {FARTHEST:g} m away; give metres")


def check_friction(value: FloatArray, name: str) -> None:
    """Refuse friction that is not finite, negative or out of proportion."""
    numbers = value.tolist()
    if not math.isfinite(sum(numbers)):
        _check_finite(value, name)
    if min(numbers, default=0.0) < 0.0:
        raise ContactError("friction is negative; mu and mu_torsion must be >= 0")
    if max(numbers, default=0.0) > MOST_FRICTION:
        raise ContactError(f"friction is above {MOST_FRICTION:g}; give mu and mu_torsion below")


def check_forces(value: FloatArray, name: str) -> None:
    """Refuse infinite forces; NaN stands for unknown ones."""
    if not math.isfinite(float(np.vdot(value, value))) and np.isinf(value).any():
        raise ContactError("forces hold infinity; give finite numbers, NaN where unknown")


def _check_finite(value: FloatArray, name: str) -> None:
    """Refuse NaN and infinity."""
    if not np.isfinite(value).all():
        raise ContactError(f"{name} holds NaN or infinity; give finite numbers")
