"""``ContactEstimator``: place, normal, force and torsion of a contact from an image of taxels.

What it knows is the layout: no joint, no object, no contact of the simulator. Dead taxels, which a
driver knows, are filled with the mean of their live neighbours. The place is the centroid of the
normal force in the chart of the pad; the force is the sum over the taxels, each in its own axes;
the normal is that of the pad's sphere there. Who has the pose of the pad's body turns it all into
the world (``sim.sensing.touch.taxels``).

``TaxelFrictionEstimator``: the friction of n pads, from how far their shear spreads.

Where a share (used) of the friction cone is in use, the shear is spread wider than the pressure by
(1 - (1 - used)^(5/3)) / used, 5/3 at no load and 1 at the edge (``sim.sensing.touch.exact``). With
the measured ratio r of tangential to normal force, used = r / mu: each image makes some mu likelier
than others. Their likelihoods are kept on a grid of mu and forgotten over ``MEMORY``. What slips
has all of its friction in use: r is mu then.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planner.spatial import FloatArray
from sim.sensing.touch.layout import TaxelLayout


@dataclass(frozen=True, kw_only=True)
class ContactEstimate:
    """What an image says of the contact, in the frame of the pad's body.

    Attributes:
        normal_force: N; 0 without contact, and then nothing else means anything.
        place: (2,), centroid in the chart, m.
        point: (3,), on the pad's surface, m.
        normal: (3,), unit, outward.
        force: (3,), on what touches, N.
        torsion: On what touches, about the normal, N m.
        pressure_spread: Mean square distance of the normal force from the centroid, m2.
        shear_spread: The same of the shear along its mean direction, m2; NaN without shear.
    """

    normal_force: float
    place: FloatArray
    point: FloatArray
    normal: FloatArray
    force: FloatArray
    torsion: float
    pressure_spread: float
    shear_spread: float

    @property
    def friction_ratio(self) -> float:
        """Tangential over normal force (-)."""
        if self.normal_force <= 0:
            return 0.0
        along = float(self.force @ self.normal)
        rest = self.force - along * self.normal
        return math.sqrt(float(rest @ rest)) / self.normal_force


class ContactEstimator:
    """Estimates of one array."""

    def __init__(self, layout: TaxelLayout, least_force: float = 0.02) -> None:
        """Prepare sums.

        Args:
            layout: Geometry of the array.
            least_force: Sum (N) of the normal force below which nothing touches.
        """
        self.layout = layout
        self._least = least_force
        rows, columns = layout.shape
        self._places = np.array([np.tile(layout.u, rows), np.repeat(layout.v, columns)])
        self._ones = np.ones(rows * columns)
        self._fill = _fill_of(layout)
        none = np.full(3, np.nan)
        self._nothing = ContactEstimate(
            normal_force=0.0,
            place=none[:2],
            point=none,
            normal=none,
            force=np.zeros(3),
            torsion=0.0,
            pressure_spread=math.nan,
            shear_spread=math.nan,
        )

    def estimate(self, image: FloatArray) -> ContactEstimate:
        """What an image (rows, columns, 3) says."""
        taxels = image.reshape(-1, 3)
        if self._fill is not None:
            dead, weights = self._fill
            taxels = taxels.copy()
            taxels[dead] = weights @ taxels
        pressure = np.maximum(taxels[:, 0], 0.0)
        total = float(pressure @ self._ones)
        if total < self._least:
            return self._nothing
        place = self._places @ pressure / total
        du, dv = self._places - place[:, None]
        square = du * du + dv * dv
        frame = self.layout.frame_at(place)
        normal = frame[:, 0]
        force = taxels.reshape(-1) @ self.layout.image_axes
        along = float(force @ normal)
        _, *shear = (self._ones @ taxels).tolist()
        size = math.hypot(*shear)
        sheared = math.nan
        if size > self._least:
            # the pressure's own tilt against the neighbours' axes has no part in the sums
            sheared = float(square @ taxels @ (0.0, *shear)) / size**2
        return ContactEstimate(
            normal_force=max(along, 0.0),
            place=place,
            point=self.layout.center + self.layout.radius * normal,
            normal=normal,
            force=force,
            torsion=float(du @ taxels[:, 2] - dv @ taxels[:, 1]),
            pressure_spread=float(square @ pressure) / total,
            shear_spread=sheared,
        )


def _fill_of(layout: TaxelLayout) -> tuple[list[int], FloatArray] | None:
    """Which taxels are dead, and the weights (dead, taxels) of what stands in for them."""
    rows, columns = layout.shape
    dead = sorted({row * columns + column for row, column in layout.array.dead})
    if not dead:
        return None
    weights = np.zeros((len(dead), rows * columns))
    for row_of, k in zip(weights, dead, strict=True):
        row, column = divmod(k, columns)
        beside = [
            (row + i) * columns + column + j
            for i in (-1, 0, 1)
            for j in (-1, 0, 1)
            if 0 <= row + i < rows and 0 <= column + j < columns
        ]
        alive = [n for n in beside if n not in dead]
        row_of[alive] = 1.0 / max(len(alive), 1)
    return dead, weights


GRID = np.geomspace(0.1, 2.0, 49)
"""Frictions (-) between which is chosen; neighbours differ by 6 %."""

MEMORY = 1.0
"""Time (s) over which images are forgotten: friction differs from place to place."""

SPREAD_NOISE = 0.25
"""Standard deviation (-) of the ratio of spreads in one image, at a tangential force as large as
the normal one; it grows as the tangential force shrinks."""

MOST_OFF = 3.0
"""Standard deviations (-) beyond which an image counts no more: two patches, the array's edge."""

RATIO_NOISE = 0.03
"""Standard deviation (-) of r, as a share of it."""


class TaxelFrictionEstimator:
    """Friction of n pads over time.

    Attributes:
        friction: (n,), believed friction (-).
        deviation: (n,), its standard deviation (-).
        used: (n,), share of it in use (-), 0 to 1.
    """

    def __init__(self, spacings: Sequence[float]) -> None:
        """Nothing is known: all of the grid is as likely.

        Args:
            spacings: Of the taxels of each pad, m.
        """
        n = len(spacings)
        self._cell = np.array(spacings) ** 2 / 6.0  # spread of a cell itself, m2
        self._log = np.zeros((n, len(GRID)))
        self.used = np.zeros(n)
        self._believe()

    def step(
        self, elapsed: float, seen: Sequence[ContactEstimate], slipping: NDArray[np.bool_]
    ) -> None:
        """Take over the images of a time step.

        Args:
            elapsed: Since the last step, s.
            seen: One contact per pad.
            slipping: (n,), which of them slip.
        """
        ratio = np.array([one.friction_ratio for one in seen])
        shear = np.array([one.shear_spread for one in seen]) - self._cell
        pressure = np.array([one.pressure_spread for one in seen]) - self._cell
        self._log *= 1.0 - min(1.0, elapsed / MEMORY)
        known = np.isfinite(shear) & (pressure > 0) & (ratio > GRID[0] / 2)
        if known.any():
            share = ratio[:, None] / GRID
            used = np.clip(share, 1e-3, 1.0)
            wider = np.where(known, shear, 1.0) / np.where(known, pressure, 1.0)
            expected = (1.0 - (1.0 - used) ** (5.0 / 3.0)) / used
            off = (wider[:, None] - expected) * (ratio / SPREAD_NOISE)[:, None]
            over = np.where(slipping[:, None], share - 1.0, np.maximum(share - 1.0, 0.0))
            over = np.minimum(np.abs(over) / RATIO_NOISE, MOST_OFF)
            off = np.minimum(np.abs(off), MOST_OFF)
            self._log -= np.where(known[:, None], 0.5 * (off * off + over * over), 0.0)
            self._believe()
        self.used = np.clip(ratio / self.friction, 0.0, 1.0)

    def _believe(self) -> None:
        weight = np.exp(self._log - self._log.max(axis=1, keepdims=True))
        weight /= weight.sum(axis=1, keepdims=True)
        self.friction = weight @ GRID
        self.deviation = np.sqrt(np.maximum(weight @ GRID**2 - self.friction**2, 0.0))
