"""``PadReading``: what tactile pads feel, one row per finger that takes part.

A pad that measures force in three axes and sees the surface move under it (optical pads do) gives
the force on the object, where it acts, along which normal, and how fast the object slides over it.
Contacts of one finger are summed; positions and velocities are means weighted by normal force.

``MeasuredPose`` and ``PoseUncertainty``: when a pose was seen, and how well one is known.

Both stand in an ``Observation``, beside the pose itself.

``TouchReading``: what arrays of taxels read, one image per finger that takes part.

Made by ``sim.sensing.touch``; read by whoever wants more than a ``PadReading``: policies, pictures.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from planner.errors import ContactError, shown
from planner.spatial import SE3, FloatArray

TOUCH_FORCE, LOST_FORCE = 0.1, 0.03
"""Normal forces (N) from which on a finger touches, and below which it has lost the object: a tenth
of what moves an object of 0.1 kg, and both far above rounding; apart, so that noise does not toggle
them."""


@dataclass(frozen=True, kw_only=True, eq=False)
class MeasuredPose:
    """A measured pose of the object.

    Attributes:
        time: When it was measured, s since the start of the trial.
        T_world_object: What was measured.
    """

    time: float
    T_world_object: SE3


@dataclass(frozen=True, kw_only=True, eq=False)
class PoseUncertainty:
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


EXACT = "exact"
"""Name of the sense of touch without error."""


@dataclass(frozen=True, kw_only=True, eq=False)
class TouchReading:
    """Images of n fingers; empty of a hand that has no taxels.

    Attributes:
        time: When each image was taken, (n,), s.
        images: n arrays (rows, columns, 3): force of each taxel on what touches it, N, in the
            taxel's own axes: outward, along the columns (around the bone), along the rows (along
            the bone).
    """

    time: FloatArray
    images: tuple[FloatArray, ...]

    @classmethod
    def nothing(cls) -> TouchReading:
        """The reading of a hand that has no taxels."""
        return cls(time=np.zeros(0), images=())


ZERO_NOISE = 0.1
"""How far (N) below 0 a pad without contact may read: pads are zeroed, and drift by some 0.03 N."""

CREEP = 0.01
"""Sliding per spin (m): a soft finger that spins under a tangential force creeps along it, far
inside its cone. With the ellipsoidal limit surface it does so by (a / mu) mu_torsion /
sqrt(1 - a^2) per radian at the share a of its sliding friction: 10 mm at a = 0.7, mu = 0.7 and
mu_torsion = 7 mm, or a = 0.7, mu = 0.5 and 5 mm."""


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
        spin: (n,), angular velocity of the object relative to the pad about the normal, rad/s, 0
            without contact; or a single 0 of pads that do not feel it.
        slipping: (n,), which pads notice by themselves that they slip; None of pads whose slip
            follows from ``sliding`` alone.
        time: When it was felt, s: the same reading told again has the same time. None of pads that
            are read anew whenever they are asked.
    """

    normal_force: FloatArray
    force: FloatArray
    position: FloatArray
    normal: FloatArray
    sliding: FloatArray
    spin: FloatArray = field(default_factory=lambda: np.zeros(1))
    slipping: NDArray[np.bool_] | None = None
    time: float | None = None

    def __post_init__(self) -> None:
        """Check shapes and signs; whether numbers are finite is for whoever reads a hand.

        A pad that was zeroed reads a little below 0 without contact (``ZERO_NOISE``): that is 0.

        Raises:
            ContactError: Another shape, or a normal force further below 0.
        """
        pressed = np.asarray(self.normal_force)
        shape = pressed.shape
        if len(shape) != 1 or np.any(pressed < -ZERO_NOISE):
            raise ContactError(
                f"the normal forces of pads are {shown(self.normal_force)}; give (n,) numbers >= 0 "
                f"in N ({ZERO_NOISE:g} N below is noise)"
            )
        object.__setattr__(self, "normal_force", np.maximum(pressed, 0.0))
        for name in ("force", "position", "normal", "sliding"):
            if np.shape(getattr(self, name)) != (*shape, 3):
                given = np.shape(getattr(self, name))
                raise ContactError(f"{name} of the pads has shape {given}; give {(*shape, 3)}")
        if np.shape(self.spin) not in ((1,), shape):
            raise ContactError(f"spin has shape {np.shape(self.spin)}; give {shape} or (1,)")

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

    def of(self, rows: slice) -> PadReading:
        """What some of the pads feel."""
        vectors = ("normal_force", "force", "position", "normal", "sliding")
        chosen = {name: getattr(self, name)[rows] for name in vectors}
        if self.spin.shape == self.normal_force.shape:
            chosen["spin"] = self.spin[rows]
        slipping = None if self.slipping is None else self.slipping[rows]
        return replace(self, **chosen, slipping=slipping)

    def moved(self, moves: Sequence[SE3]) -> PadReading:
        """The same with the vectors of each of the n pads moved."""
        turns = np.array([move.rotation for move in moves])

        def turned(rows: FloatArray) -> FloatArray:
            return np.asarray((turns @ rows[:, :, None])[:, :, 0])

        return replace(
            self,
            force=turned(self.force),
            position=turned(self.position) + np.array([move.translation for move in moves]),
            normal=turned(self.normal),
            sliding=turned(self.sliding),
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

    @property
    def creep_speed(self) -> FloatArray:
        """Speed (n,), m/s, to which spinning explains sliding: see ``CREEP``."""
        return np.asarray(CREEP * np.abs(self.spin))

    def friction_ratio(self) -> FloatArray:
        """Tangential over normal force, (n,), -: the friction in use; 0 without contact."""
        loaded = self.normal_force > 0
        return np.where(
            loaded, self.tangential_force / np.where(loaded, self.normal_force, 1.0), 0.0
        )
