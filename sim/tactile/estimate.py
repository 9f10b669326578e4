"""``estimate_contact``: place, normal, force and torsion of a contact from an image of taxels.

What it knows is the layout: no joint, no object, no contact of the simulator. Dead taxels, which a
driver knows, are filled with the mean of their live neighbours. The place is the centroid of the
normal force in the chart of the pad; the force is the sum over the taxels, each in its own axes;
the normal is that of the pad's sphere there. Who has the pose of the pad's body turns it all into
the world (``sim.tactile.taxels``).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from planner.spatial import FloatArray
from sim.tactile.layout import TaxelLayout


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
