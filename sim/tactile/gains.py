"""``GainTracker``: how much more or less each taxel reads than a smooth patch would give it.

These gains are the texture under the taxels (``sim.tactile.texture``). While a pad sticks or rolls
they stay what they are, whatever the force does. Called by ``SlipWatch`` once per image and pad.

Place, force and width of the patch are fitted so that the known gains explain the image best
(``sim.tactile.patches``). What the fit cannot explain is a change of the gains. They are known from
a slow average; a taxel that has just been loaded takes part once it is known.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planner.spatial import FloatArray
from sim.tactile.estimate import ContactEstimate
from sim.tactile.layout import TaxelLayout
from sim.tactile.patches import FITTED, Patch
from sim.tactile.pressure import contact_deviation

SLOW = 0.08
"""Time constant (s) of the average by which gains are known."""

YOUNG = 8
"""Images until the gain of a taxel is known well enough to fit by it, and to judge by it: the fit
magnifies noise at taxels that it leaves out."""

LEAST_SHARE, LEAST_FORCE = 0.004, 1.4
"""Share of the normal force (-), and force in thresholds of the array (-), from which on a taxel is
loaded: with noise of 5 % it then does not fall below the threshold by chance."""


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
        self._age = np.zeros(count)

    def forget(self) -> None:
        """The contact is another one from now on."""
        self._age[:] = 0.0

    def look(self, image: FloatArray, seen: ContactEstimate) -> Patch | None:
        """What is to be fitted to an image; None where too few taxels are loaded.

        Args:
            image: (rows, columns, 3), N.
            seen: Its contact.
        """
        array = self._layout.array
        # along the contact's normal, not along each taxel's: of that the shear has no part
        along = self._layout.image_axes @ seen.normal
        pressure = (along * image.reshape(-1)).reshape(-1, 3) @ np.ones(3)
        least = max(LEAST_SHARE * seen.normal_force, LEAST_FORCE * array.threshold)
        loaded = pressure > least
        self._age = np.where(loaded, self._age + 1.0, 0.0)
        taxels = np.flatnonzero(loaded)
        if len(taxels) <= FITTED:
            return None
        age = self._age[taxels]
        old = age > YOUNG
        return Patch(
            layout=self._layout,
            taxels=taxels,
            forces=np.log(pressure[taxels]) - np.where(age > 1.0, self.known[taxels], 0.0),
            fitting=old if old.sum() > FITTED else np.ones(len(taxels), dtype=bool),
            place=seen.place,
            deviation=contact_deviation(seen.normal_force, self._layout.radius),
        )

    def learn(
        self, elapsed: float, patch: Patch, change: FloatArray
    ) -> tuple[NDArray[np.intp], FloatArray]:
        """Take over what the fit left; taxels (n,) that are known, and logarithms of their gains.

        Args:
            elapsed: Since the last image, s.
            patch: What was fitted: the result of the last ``look``.
            change: (taxels,), what was left.
        """
        taxels = patch.taxels
        age = self._age[taxels]
        old = age > YOUNG
        before = np.where(age > 1.0, self.known[taxels], 0.0)
        part = np.maximum(elapsed / (SLOW + elapsed), 1.0 / age)
        self.known[taxels] = before + part * change
        return taxels[old], (before + change)[old]
