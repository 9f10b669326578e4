"""``TaxelSlipDetector``: which pads slip, from the shiver of their taxels.

While a pad sticks or rolls, the texture under its taxels stays the same, whatever the force does
(``GainTracker``). When the object slides, another texture comes under them. Gains are
averaged over blocks of time up to now, and neighbouring blocks are compared: the mean square of the
difference over the loaded taxels, less that of noise, summed over some neighbours, grows with the
way that was slid (``sim.sensing.touch.layout``). The pad slips when one of these sums exceeds
``ALARM`` and is larger than noise alone would make it once in some millions of looks (``SIGMAS``);
it has stopped ``HOLD`` after the last of them. Short blocks see fast slips, long ones slow slips, a
single difference a jerk, many a creep.

``GainTracker``: how much more or less each taxel reads than a smooth patch would give it.

These gains are the texture under the taxels (``sim.sensing.touch.layout``). While a pad sticks or
rolls they stay what they are, whatever the force does. ``TaxelSlipDetector`` asks once per image
and pad.

Place, force and width of the patch are fitted so that the known gains explain the image best
(``fit_patches``). What the fit cannot explain is a change of the gains. They are known from
a slow average; a taxel that has just been loaded takes part once it is known.

``fit_patches``: place, force and width of patches in some images, and what they do not explain.

A patch is that of ``sim.sensing.touch.exact``: Gauss-Newton steps on the logarithms of the forces.
All pads of a hand are fitted together, because calling NumPy costs more than a dozen taxels do.
Called by ``TaxelSlipDetector`` once per time step, with what each ``GainTracker`` knows.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planner.spatial import FloatArray
from sim.sensing.touch.exact import contact_deviation, spread_with_slopes
from sim.sensing.touch.layout import ContactEstimate, TaxelLayout

BLOCK = 0.004
"""Length of the shortest blocks, s: neighbours are compared this often."""

SCALES: tuple[tuple[int, tuple[int, ...]], ...] = (
    (2, (1, 2, 6)),
    (4, (1, 2, 6)),
    (8, (1, 2)),
)
"""Lengths of blocks in shortest ones, and over how many differences is summed: up to 0.1 s."""

MOST = 28
"""Shortest blocks that are remembered."""

ALARM = 0.008
"""Sum of squared changes of the gains' logarithms (-) that is a slip. A texture of 10 %
that changes over 0.1 mm gives 0.0036 per 0.02 mm at first: the alarm is raised at some 0.05 mm. A
smoother object must slide further, one of 5 % four times as far."""

HOLD = 0.05
"""How long (s) a slip lasts after the last sum that tells of it."""

SIGMAS = 5.0
"""How unlikely noise alone must be, in standard deviations of a normal distribution: 3e-7."""

SHARED = 1.5
"""By how much the variance of a sum of squares exceeds that of as many independent ones (-):
neighbouring differences share a block, and are correlated by one half."""

LEAST_FORCE = 0.25
"""Normal force (N) below which a pad is too lightly loaded to tell."""

LEAST_NOISE = 0.01
"""Noise (-) that is expected of the best array."""

LONGEST = 0.1
"""Time (s) between images beyond which nothing is remembered of the one before."""

TIME_TOL = 1e-9
"""Times that differ by less (s) are the same: rounding of sums of time steps."""


class TaxelSlipDetector:
    """Slips of n pads over time.

    Attributes:
        gain_change: (n,), largest sum of squared changes beyond noise (-); see ``ALARM``.
        slipping: (n,), which pads slip now.
    """

    def __init__(self, layouts: Sequence[TaxelLayout]) -> None:
        """Nothing slips yet.

        Args:
            layouts: Arrays of the pads.
        """
        n = len(layouts)
        self._pads = [_Pad(layout) for layout in layouts]
        self._taken, self._alarmed = np.full((2, n), -np.inf)
        self.gain_change = np.zeros(n)
        self.slipping: NDArray[np.bool_] = np.zeros(n, dtype=bool)

    def step(
        self, times: FloatArray, images: Sequence[FloatArray], seen: Sequence[ContactEstimate]
    ) -> None:
        """Take over images; one that has come before is left aside.

        Args:
            times: When they were taken, (n,), s.
            images: n arrays (rows, columns, 3), N.
            seen: The contact of each.
        """
        elapsed, self._taken = times - self._taken, times.copy()
        new = np.flatnonzero(elapsed > 0.0).tolist()
        patches = [self._pads[k].patch(float(elapsed[k]), images[k], seen[k]) for k in new]
        shown = [one for one in patches if one is not None]
        changes = iter(fit_patches(shown))
        for k, patch in zip(new, patches, strict=True):
            pad = self._pads[k]
            if patch is not None:
                pad.learn(float(elapsed[k]), patch, next(changes))
            self.gain_change[k] = pad.blocks.gain_change
            if pad.blocks.alarm:
                self._alarmed[k] = times[k]
            self.slipping[k] = times[k] - self._alarmed[k] <= HOLD


class _Pad:
    """Gains and blocks of one pad."""

    def __init__(self, layout: TaxelLayout) -> None:
        self._gains = GainTracker(layout)
        taxels = layout.array.rows * layout.array.columns
        self.blocks = _Blocks(taxels, max(layout.array.noise, LEAST_NOISE) ** 2)

    def patch(self, elapsed: float, image: FloatArray, seen: ContactEstimate) -> Patch | None:
        """What of an image is to be fitted; None where it tells nothing."""
        unloaded = seen.normal_force < LEAST_FORCE
        if unloaded or elapsed > LONGEST:
            self._gains.reset()
            self.blocks.reset()
        patch = None if unloaded else self._gains.patch(image, seen)
        if patch is None and not unloaded:
            self.blocks.add(min(elapsed, LONGEST))
        return patch

    def learn(self, elapsed: float, patch: Patch, change: FloatArray | None) -> None:
        """Take over what the fit left of an image; None of no fit."""
        elapsed = min(elapsed, LONGEST)
        known = None if change is None else self._gains.learn(elapsed, patch, change)
        self.blocks.add(elapsed, known)


class _Blocks:
    """Gains of one pad by blocks of ``BLOCK``, the newest last.

    Attributes:
        gain_change: Largest sum of squared changes beyond noise (-).
        alarm: Whether one of the sums is a slip.
    """

    def __init__(self, taxels: int, noise: float) -> None:
        self._noise = noise
        self._sums, self._loaded = np.zeros((2, MOST, taxels))
        self._images = np.zeros(MOST)
        self._time, self._filled = 0.0, 0
        self.gain_change, self.alarm = 0.0, False

    def reset(self) -> None:
        """The contact is another one from now on."""
        self._sums[:] = self._loaded[:] = self._images[:] = 0.0
        self._time, self._filled = 0.0, 0
        self.gain_change, self.alarm = 0.0, False

    def add(self, elapsed: float, known: tuple[NDArray[np.intp], FloatArray] | None = None) -> None:
        """Take over an image: its loaded taxels (n,) and their gains (n,), if any is known."""
        if known is not None:
            taxels, gains = known
            self._sums[-1, taxels] += gains
            self._loaded[-1, taxels] += 1.0
        self._images[-1] += 1.0
        self._time += elapsed
        if self._time < BLOCK - TIME_TOL:
            return
        self._filled = min(self._filled + 1, MOST)
        self._judge()
        for part in (self._sums, self._loaded, self._images):
            part[:-1] = part[1:]
            part[-1] = 0.0
        self._time = 0.0

    def _judge(self) -> None:
        self.gain_change, self.alarm = 0.0, False
        used = np.flatnonzero(self._loaded[-1])
        sums, loaded = self._sums[:, used], self._loaded[:, used]
        for length, counts in SCALES:
            n = min(max(counts) + 1, self._filled // length)
            if n < 2:
                return
            shape = (n, length, -1)
            images = self._images[-n * length :].reshape(n, length).sum(axis=1)
            count = loaded[-n * length :].reshape(shape).sum(axis=1)
            mean = sums[-n * length :].reshape(shape).sum(axis=1) / np.maximum(count, 1.0)
            whole = count >= images[:, None]
            both = whole[1:] & whole[:-1]
            freedom = np.maximum(both.sum(axis=1) - FITTED, 0)
            square = (np.diff(mean, axis=0) ** 2 * both).sum(axis=1) / np.maximum(freedom, 1)
            noise = self._noise * (1.0 / images[1:] + 1.0 / images[:-1])
            enough = freedom > 0
            self._sum_up(counts, freedom, (square - noise) * enough, noise * enough)

    def _sum_up(
        self, counts: tuple[int, ...], freedom: FloatArray, excess: FloatArray, noise: FloatArray
    ) -> None:
        """Judge the newest of some squared changes (n,), oldest first."""
        free, beyond, usual = freedom.tolist(), excess.tolist(), noise.tolist()  # few: no NumPy
        for count in counts:
            known = sum(free[-count:]) / (SHARED if count > 1 else 1.0)
            if known < 1.0:
                continue
            change, expected = sum(beyond[-count:]), sum(usual[-count:])
            self.gain_change = max(self.gain_change, change)
            self.alarm |= change > max(ALARM, expected * (_unlikely(known) - 1.0))


def _unlikely(freedom: float) -> float:
    """What noise hardly ever exceeds: chi squared over its degrees of freedom at ``SIGMAS``.

    E. B. Wilson and M. M. Hilferty, The distribution of chi-square, PNAS 17, 1931.
    """
    part = 2.0 / (9.0 * freedom)
    return (1.0 - part + SIGMAS * math.sqrt(part)) ** 3


SLOW = 0.08
"""Time constant (s) of the average by which gains are known."""

YOUNG = 8
"""Images until the gain of a taxel is known well enough to fit by it, and to judge by it: the fit
magnifies noise at taxels that it leaves out."""

LEAST_SHARE, LEAST_LOAD = 0.004, 1.4
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

    def reset(self) -> None:
        """The contact is another one from now on."""
        self._age[:] = 0.0

    def patch(self, image: FloatArray, seen: ContactEstimate) -> Patch | None:
        """What is to be fitted to an image; None where too few taxels are loaded.

        Args:
            image: (rows, columns, 3), N.
            seen: Its contact.
        """
        array = self._layout.array
        # along the contact's normal, not along each taxel's: of that the shear has no part
        along = self._layout.image_axes @ seen.normal
        pressure = (along * image.reshape(-1)).reshape(-1, 3) @ np.ones(3)
        least = max(LEAST_SHARE * seen.normal_force, LEAST_LOAD * array.threshold)
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
            patch: What was fitted: the result of the last ``patch``.
            change: (taxels,), what was left.
        """
        taxels = patch.taxels
        age = self._age[taxels]
        old = age > YOUNG
        before = np.where(age > 1.0, self.known[taxels], 0.0)
        part = np.maximum(elapsed / (SLOW + elapsed), 1.0 / age)
        self.known[taxels] = before + part * change
        return taxels[old], (before + change)[old]


FITTED = 4
"""Numbers that each image determines besides gains: force, place and width of the patch."""

STEPS, LONGEST_STEP = 3, 0.5
"""Corrections per image, and the longest, in deviations of the patch along each axis and in
logarithms of the force: the centroid is off by a tenth of a deviation where taxels are coarse."""

CONVERGED = 0.1
"""Correction, in the same units, that is left where a fit has not converged: a patch that is much
smaller than a taxel, at light loads. The image then says nothing of the gains."""

RIDGE = 1e-9 * np.eye(FITTED)
"""Added to the normal equations (-): taxels in a row leave the place across it open."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Patch:
    """What one image shows, and where the fit begins.

    Attributes:
        layout: The array.
        taxels: (n,), which are loaded, counted along rows.
        forces: (n,), logarithms of their normal forces, less those of the gains that are known.
        fitting: (n,), which of them are fitted; at least ``FITTED``.
        place: (2,), first guess of the place in the chart, m.
        deviation: First guess of the standard deviation of the pressure, m.
    """

    layout: TaxelLayout
    taxels: NDArray[np.intp]
    forces: FloatArray
    fitting: NDArray[np.bool_]
    place: FloatArray
    deviation: float


def fit_patches(patches: Sequence[Patch]) -> list[FloatArray | None]:
    """What the best place, force and width leave of the forces (n,) of each; None of no fit."""
    if not patches:
        return []
    k, most = len(patches), max(len(one.taxels) for one in patches)
    cells = np.array([one.layout.shape[::-1] for one in patches])
    spacing = np.array([one.layout.array.spacing for one in patches])
    width = int(cells.max())
    edges = (np.arange(width + 1) - 0.5 * cells[:, :, None]) * spacing[:, None, None]
    forces, weights = np.zeros((2, k, most))
    # place of each taxel's column and row among all logarithms of shares; the rest weighs nothing
    pick = np.zeros((2, k, most), dtype=np.intp)
    for i, one in enumerate(patches):
        n = len(one.taxels)
        forces[i, :n], weights[i, :n] = one.forces, one.fitting
        rows, columns = np.divmod(one.taxels, cells[i, 0])
        pick[0, i, :n] = columns + 2 * i * width
        pick[1, i, :n] = rows + (2 * i + 1) * width
    place = np.array([one.place for one in patches])[:, :, None]
    deviation = np.array([one.deviation for one in patches])[:, None, None]
    basis = np.ones((k, FITTED, most))
    for step in range(STEPS + 1):
        logs, slopes, widths = (
            part.reshape(-1)[pick] for part in spread_with_slopes(edges, place, deviation)
        )
        left = forces - logs[0] - logs[1]
        basis[:, 1], basis[:, 2], basis[:, 3] = slopes[0], slopes[1], widths[0] + widths[1]
        weighted = basis * weights[:, None]
        gram = weighted @ basis.swapaxes(1, 2) + RIDGE
        fit = np.linalg.solve(gram, weighted @ left[:, :, None])
        if step < STEPS:
            move = np.minimum(np.maximum(fit[:, 1:], -LONGEST_STEP), LONGEST_STEP)
            place = place + deviation * move[:, :2]
            deviation = deviation * np.exp(move[:, 2:])
    left -= (fit * basis).sum(axis=1)
    converged: list[bool] = (np.abs(fit[:, 1:, 0]).max(axis=1) <= CONVERGED).tolist()
    return [
        row[: len(one.taxels)] if fits else None
        for one, row, fits in zip(patches, left, converged, strict=True)
    ]
