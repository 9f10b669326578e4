"""``StopCorrection``: where joints are, by their encoders and by the stops that they must lean on.

An encoder is off by a degree or three. Where a tendon drives two joints, a stop carries what the
tendon cannot, and a controller that takes the stop for open can exert no force: 0.01 rad decide.
Called by controllers before they turn torques into commands.

A stop carries (its gap counts as closed) if the reading says so within ``STOP_TOL``, as in a plan;
or if the plan leans on it and the reading is within ``MOST_OFF``: a load that presses on an open
stop closes it. The plan's verdict keeps ``STOP_TOL``. Effort confirms it: a joint that
rests although the forces felt press on its stop by more than friction and springs hold has the stop
there, and what the encoder says then is its offset, from then on.

No joint is beyond its stop: a reading there is off as well.

Corrections are the least change of joints, in equal parts where a stop ties two of them, so the
length of a tendon that adds them up stays as it was read.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planner.joints.actuation import STOP_TOL, Actuation
from planner.spatial import FloatArray

MOST_OFF = 0.22
"""Largest error (rad) of a stop's reading: three standard deviations of the sum of two joints that
are off by 3 degrees each, 3 sqrt(2) 3 degrees."""

LEAST_EFFORT = 0.006
"""Torque (N m) onto a stop that only the stop can bear: three times the dry friction of a small
finger joint (0.002 N m), and more than its spring of 0.08 N m/rad makes within 0.05 rad."""

STILL_RATE, STILL_TIME = 0.1, 0.03
"""Rate (rad/s) below which a loaded joint rests, and how long (s) it must: without a stop the least
effort moves a distal link of 1e-5 kg m^2 by a radian in that time."""


class StopCorrection:
    """Corrects readings by stops; exact readings it leaves as they are.

    Attributes:
        offset: (ns,), confirmed reading of each stop's gap where it is closed, rad; NaN if unknown.
    """

    def __init__(self, actuation: Actuation, planned: FloatArray) -> None:
        """Take as closed the stops that a planned posture (nq,) leans on."""
        self._rows, self._values = actuation.stop_rows, actuation.stop_values
        self._carrying = np.zeros(len(self._values), dtype=bool)
        self._carrying[actuation.carrying_stops] = True
        self._carrying &= np.isfinite(self._values)
        self.offset = np.full(len(self._values), np.nan)
        self._planned: NDArray[np.bool_] = self._carrying.copy()
        self._rested = np.zeros(len(self._values))
        self._idle = not self._carrying.any()
        self.set_posture(planned)

    @property
    def acts(self) -> bool:
        """Whether the hand has stops that carry what no actuator can."""
        return not self._idle

    def set_posture(self, planned: FloatArray) -> None:
        """Go on to another planned posture (nq,)."""
        if not self._idle:
            self._planned = self._carrying & (self._gaps(planned) <= STOP_TOL)

    def remove_offset(self, offset: FloatArray) -> None:
        """From now on readings come without an offset (nq,), rad."""
        self.offset = self.offset - self._rows @ offset

    def corrected(self, q: FloatArray) -> FloatArray:
        """Joints (nq,) that agree with the stops; the same array if readings do already."""
        if self._idle:
            return q
        gaps = self._gaps(q)
        known = np.isfinite(self.offset)
        gap = gaps - np.where(known, self.offset, 0.0)
        closed = self._planned & ~known & (gap <= MOST_OFF) | self._carrying & (gap <= STOP_TOL)
        # a known offset is subtracted; without one the whole remaining gap is
        change = np.where(closed & (np.abs(gap) > STOP_TOL), gap, 0.0)
        change += np.where(known, self.offset, 0.0)
        moved = np.flatnonzero(change)
        if not len(moved):
            return q
        rows = self._rows[moved]
        return np.asarray(q - np.linalg.lstsq(rows, change[moved], rcond=None)[0])

    def update(self, elapsed: float, q: FloatArray, v: FloatArray, pressing: FloatArray) -> None:
        """Take over what effort says of the stops.

        Args:
            elapsed: Time since the last call, s.
            q: Joints as read (nq,).
            v: Their rates (nq,).
            pressing: Torque onto each stop (ns,), N m, if it carries: the multipliers of
                ``Actuation.split_torque`` for the contact forces that are felt.
        """
        if self._idle:
            return
        rests = np.abs(self._rows @ v) < STILL_RATE
        shown = self._planned & (pressing > LEAST_EFFORT) & rests
        self._rested = np.where(shown, self._rested + elapsed, 0.0)
        gaps = self._gaps(q)
        off = np.abs(gaps) > STOP_TOL
        learn = (self._rested >= STILL_TIME) & np.isnan(self.offset) & off & (gaps <= MOST_OFF)
        self.offset = np.where(learn, gaps, self.offset)

    def _gaps(self, q: FloatArray) -> FloatArray:
        return np.asarray(self._rows @ q - self._values)


def servo_commands(
    actuation: Actuation, read: FloatArray, corrected: FloatArray, v: FloatArray, torque: FloatArray
) -> FloatArray:
    """Commands (nu,) for joint torques (nq,) at corrected joints, for servos that read others.

    Args:
        actuation: The hand's.
        read: Joints (nq,) as the servos' encoders have them.
        corrected: Joints (nq,) where the stops are looked at.
        v: Rates (nq,).
        torque: Wanted (nq,), N m.
    """
    ctrl = actuation.commands(corrected, v, torque)
    if corrected is read:
        return ctrl
    servo = -actuation.bias[:, 1] / actuation.gain
    ctrl = ctrl + servo * (actuation.moment @ (read - corrected))
    low, high = actuation.ctrl_range.T
    return np.asarray(np.clip(ctrl, low, high))
