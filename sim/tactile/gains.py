"""``GainTracker``: how much more or less each taxel reads than a smooth patch would give it.

These gains are the texture under the taxels (``sim.tactile.texture``). While a pad sticks or rolls
they stay what they are, whatever the force does. Called by ``SlipWatch`` once per image and pad.

Gains and the place of the patch are found together: place and total force are fitted so that the
known gains explain the image best, by Gauss-Newton steps on the logarithm of the forces, with the
patch of ``sim.tactile.pressure``. What the fit cannot explain is a change of the gains. They are
known from a slow average; a taxel that has just been loaded takes part once it is known.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from planner.spatial import FloatArray
from sim.tactile.estimate import ContactEstimate
from sim.tactile.layout import TaxelLayout
from sim.tactile.pressure import contact_deviation, spread_with_slopes

__all__ = ["FITTED", "GainTracker"]

FITTED = 4
"""Numbers that each image determines besides gains: force, place and width of the patch."""

SLOW = 0.08
"""Time constant (s) of the average by which gains are known."""

YOUNG = 8
"""Images until the gain of a taxel is known well enough to fit by it, and to judge by it: the fit
magnifies noise at taxels that it leaves out."""

LEAST_SHARE, LEAST_FORCE = 0.004, 1.4
"""Share of the normal force (-), and force in thresholds of the array (-), from which on a taxel is
loaded: with noise of 5 % it then does not fall below the threshold by chance."""

STEPS, LONGEST_STEP = 3, 0.5
"""Corrections per image, and the longest, in deviations of the patch along each axis and in
logarithms of the force: the centroid is off by a tenth of a deviation where taxels are coarse."""

CONVERGED = 0.1
"""Correction, in the same units, that is left where a fit has not converged: a patch that is much
smaller than a taxel, at light loads. The image then says nothing of the gains."""

RIDGE = 1e-9
"""Added to the normal equations (-): taxels in a row leave the place across it open."""


class GainTracker:
    """Gains of one array over time.

    Attributes:
        known: (taxels,), logarithm of each gain by its slow average (-).
    """

    def __init__(self, layout: TaxelLayout) -> None:
        """Nothing is known."""
        count = layout.array.rows * layout.array.columns
        self.known = np.zeros(count)
        self._layout = layout
        self._axes = layout.frames.reshape(-1, 3, 3).transpose(0, 2, 1)
        self._age = np.zeros(count)

    def forget(self) -> None:
        """The contact is another one from now on."""
        self._age[:] = 0.0

    def look(
        self, elapsed: float, image: FloatArray, seen: ContactEstimate
    ) -> tuple[NDArray[np.intp], FloatArray]:
        """Take over an image; taxels (n,) that are known, and the logarithms of their gains (n,).

        Nothing where too few are loaded.

        Args:
            elapsed: Since the last image, s.
            image: (rows, columns, 3), N.
            seen: Its contact.
        """
        array = self._layout.array
        # along the contact's normal, not along each taxel's: of that the shear has no part
        pressure = ((self._axes @ seen.normal) * image.reshape(-1, 3)).sum(axis=1)
        least = max(LEAST_SHARE * seen.normal_force, LEAST_FORCE * array.threshold)
        loaded = pressure > least
        self._age = np.where(loaded, self._age + 1.0, 0.0)
        rows = np.flatnonzero(loaded)
        if len(rows) <= FITTED:
            return rows[:0], np.zeros(0)
        age = self._age[rows]
        before = np.where(age > 1.0, self.known[rows], 0.0)
        old = age > YOUNG
        fitting = old if old.sum() > FITTED else np.ones(len(rows), dtype=bool)
        change = self._unexplained(rows, np.log(pressure[rows]) - before, seen, fitting)
        if change is None:
            return rows[:0], np.zeros(0)
        part = np.maximum(elapsed / (SLOW + elapsed), 1.0 / age)
        self.known[rows] = before + part * change
        return rows[old], (before + change)[old]

    def _unexplained(
        self,
        rows: NDArray[np.intp],
        pressures: FloatArray,
        seen: ContactEstimate,
        fitting: NDArray[np.bool_],
    ) -> FloatArray | None:
        """What the best place and force leave of the logarithms of forces (n,); None of no fit."""
        across, along = self._layout.edges
        i, j = np.divmod(rows, self._layout.array.columns)
        deviation = contact_deviation(seen.normal_force, self._layout.radius)
        u, v = seen.place.tolist()
        basis = np.ones((FITTED, len(rows)))
        for step in range(STEPS + 1):
            in_columns, slopes_u, widths_u = spread_with_slopes(across, u, deviation)
            in_rows, slopes_v, widths_v = spread_with_slopes(along, v, deviation)
            left = pressures - np.log(in_columns[j] * in_rows[i])
            basis[1], basis[2], basis[3] = slopes_u[j], slopes_v[i], widths_u[j] + widths_v[i]
            part = basis[:, fitting]
            gram = part @ part.T + RIDGE * np.eye(FITTED)
            fit = np.linalg.solve(gram, part @ left[fitting])
            if step < STEPS:
                move = np.clip(fit[1:], -LONGEST_STEP, LONGEST_STEP)
                u, v = u + deviation * float(move[0]), v + deviation * float(move[1])
                deviation *= math.exp(move[2])
        if np.abs(fit[1:]).max() > CONVERGED:
            return None
        return np.asarray(left - fit @ basis)
