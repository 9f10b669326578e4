"""``fit_patches``: place, force and width of patches in some images, and what they do not explain.

A patch is that of ``sim.tactile.pressure``: Gauss-Newton steps on the logarithms of the forces. All
pads of a hand are fitted together, because calling NumPy costs more than a dozen taxels do. Called
by ``SlipWatch`` once per time step, with what each ``GainTracker`` knows.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planner.spatial import FloatArray
from sim.tactile.layout import TaxelLayout
from sim.tactile.pressure import spread_with_slopes

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
