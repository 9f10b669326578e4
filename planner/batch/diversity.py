"""How different the grasps of one object are from each other, as four numbers.

- Approach: over how many of 192 cells of equal area on the sphere (HEALPix, resolution 4, about 15
  degrees across; Gorski et al. 2005) the directions spread in which the palm faces, and the entropy
  of that histogram.
- Contact: the share of the object's surface within 5 mm of a contact.
- Posture: the differential entropy of the joints by their nearest neighbours (Kozachenko and
  Leonenko 1987, in the form of Kraskov, Stoegbauer and Grassberger 2004, equation 20).
- What is left without near-duplicates (``planner.batch.thinning``).

The first three grow with the number of grasps, so compare sets of the same size.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.special import digamma

from planner.batch.features import GraspFeatures
from planner.batch.thinning import thin
from planner.shapes import Shape
from planner.shapes.mesh import surface_points
from planner.spatial import FloatArray, IntArray

N_SIDE = 4
"""Resolution: cells along the edge of each of the twelve base cells."""

N_CELLS = 12 * N_SIDE**2
"""Cells on the sphere: 192, each 0.065 sr, about 15 degrees across."""

TOUCHED = 0.005
"""Distance (m) from a contact within which surface counts as touched: a pad's contact patch."""

SURFACE_POINTS = 2000
"""Points, evenly spread by area, that stand for the surface: the share is right to 0.01."""

NEIGHBOUR = 3
"""Which nearest neighbour estimates the density: a further one has less variance, more bias."""

FINEST = 1e-3
"""Distance (rad) below which postures count as this far apart: a servo does not resolve them,
and equal ones would have an entropy of minus infinity."""


@dataclass(frozen=True, kw_only=True)
class Diversity:
    """How different n grasps are from each other; see the module.

    Attributes:
        n: Grasps.
        n_distinct: Grasps left without near-duplicates.
        approach_share: Share of the cells of approach directions that are taken (-).
        approach_entropy: Entropy of the cells, nats; at most log(192) = 5.26.
        surface_share: Share of the surface that is touched (-).
        posture_entropy: Entropy of the d joints of the fingers, nats (of rad^d); None for fewer
            grasps than it takes. It may be negative.
        posture_width_rad: Width (rad) over which each joint would be spread evenly and by itself
            for this entropy H, exp(H / d); None likewise.
    """

    n: int
    n_distinct: int
    approach_share: float
    approach_entropy: float
    surface_share: float
    posture_entropy: float | None
    posture_width_rad: float | None

    def to_dict(self) -> dict[str, Any]:
        """As plain data."""
        return asdict(self)


def diversity(grasps: GraspFeatures, shape: Shape) -> Diversity:
    """Measure grasps of a shape."""
    entropy = posture_entropy(grasps.q)
    counts = np.bincount(cell_of(grasps.approach), minlength=N_CELLS)
    return Diversity(
        n=len(grasps),
        n_distinct=len(thin(grasps)),
        approach_share=float((counts > 0).mean()),
        approach_entropy=_entropy(counts),
        surface_share=_touched(grasps.contacts.reshape(-1, 3), shape),
        posture_entropy=entropy,
        posture_width_rad=None if entropy is None else float(np.exp(entropy / grasps.q.shape[1])),
    )


def posture_entropy(q: FloatArray) -> float | None:
    """Differential entropy of postures (n, d), nats, distances by the largest difference.

    H = psi(n) - psi(k) + d mean(log 2 r_k), with r_k the distance to the k-th neighbour.
    """
    n, d = q.shape
    if n <= NEIGHBOUR or d == 0:
        return None
    radius = cKDTree(q).query(q, k=[NEIGHBOUR + 1], p=np.inf)[0][:, 0]
    spread = np.log(2.0 * np.maximum(radius, FINEST)).mean()
    return float(digamma(n) - digamma(NEIGHBOUR) + d * spread)


def _entropy(counts: NDArray[np.int_]) -> float:
    """Of a histogram, nats; 0 if it is empty."""
    shares = counts[counts > 0] / max(1, counts.sum())
    return float(-(shares * np.log(shares)).sum())


def _touched(contacts: FloatArray, shape: Shape) -> float:
    """Share of the surface within reach of a contact."""
    contacts = contacts[~np.isnan(contacts).any(axis=1)]
    if len(contacts) == 0:
        return 0.0
    points = surface_points(shape, SURFACE_POINTS)
    distance = cKDTree(contacts).query(points, distance_upper_bound=TOUCHED)[0]
    return float(np.isfinite(distance).mean())


def cell_of(directions: FloatArray) -> IntArray:
    """Number of the HEALPix cell (n,), from 0 at the north pole, that each direction (n, 3) is in.

    In ring order: Gorski et al., "HEALPix: a framework for high-resolution discretization and fast
    analysis of data distributed on the sphere", The Astrophysical Journal 622 (2005), section 5.
    """
    x, y, z = np.asarray(directions, dtype=np.float64).reshape(-1, 3).T
    z = z / np.sqrt(x * x + y * y + z * z)
    quarter = np.mod(np.arctan2(y, x), 2 * np.pi) / (np.pi / 2)  # azimuth, [0, 4)
    cells: IntArray = np.where(np.abs(z) <= 2 / 3, _belt(z, quarter), _cap(z, quarter))
    return cells


def _belt(z: FloatArray, quarter: FloatArray) -> IntArray:
    """Cells of the equatorial belt, where all rings have 4 N cells."""
    rising = np.floor(N_SIDE * (0.5 + quarter - 0.75 * z)).astype(np.int64)
    falling = np.floor(N_SIDE * (0.5 + quarter + 0.75 * z)).astype(np.int64)
    ring = N_SIDE + 1 + rising - falling  # 1 .. 2 N + 1
    place = ((rising + falling - N_SIDE + 1) // 2) % (4 * N_SIDE)
    cells: IntArray = 2 * N_SIDE * (N_SIDE - 1) + (ring - 1) * 4 * N_SIDE + place
    return cells


def _cap(z: FloatArray, quarter: FloatArray) -> IntArray:
    """Cells of the polar caps, where the ring i from the pole has 4 i cells."""
    share = quarter - np.floor(quarter)
    out = N_SIDE * np.sqrt(np.maximum(0.0, 3.0 * (1.0 - np.abs(z))))
    rising = np.floor(share * out).astype(np.int64)
    falling = np.floor((1.0 - share) * out).astype(np.int64)
    ring = np.minimum(rising + falling + 1, N_SIDE)
    place = np.floor(quarter * ring).astype(np.int64) % (4 * ring)
    north = 2 * ring * (ring - 1) + place
    cells: IntArray = np.where(z > 0, north, N_CELLS - 2 * ring * (ring + 1) + place)
    return cells
