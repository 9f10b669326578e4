"""Fitting a ``DistanceField`` to an exact signed distance: sample, smooth, spline, nest.

The samples of the finest grid are smoothed with a Gaussian before they are interpolated: kinks of
the distance (edges, medial axis) are what a solver stumbles over, and it costs little accuracy.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.ndimage import gaussian_filter, spline_filter

from planner.shapes.field import DistanceField, Level
from planner.spatial import FloatArray, IntArray

__all__ = ["RIM_STEP", "Distance", "GridDistance", "fit_field", "grid_nodes"]

RIM_STEP = 1e-5
"""Largest step (m) of the value at the rim of the coarsest level; measured, see the tests."""

FINEST = 0.0015
"""Smallest spacing of the finest grid, m: finer costs memory and preparation, not accuracy that
counts, since contacts are corrected on the true surface."""

CELLS = 64**3
"""Largest count of nodes of the finest grid."""

MIDDLE_RATIO = 4
"""How many times the finest spacing the second grid has; a power of two."""

FAR_RATIO = 8
"""How many times the second grid's spacing the coarsest has; a power of two."""

MARGIN = 0.025
"""How far (m) the finest grid reaches beyond the object: what a fingertip's centre needs."""

MIDDLE_MARGIN = 0.12
"""How far (m) the second grid reaches: links of a hand around the object."""

FAR_REACH = 0.8
"""Half width of the coarsest grid, m: a hand's base."""

BLEND_FROM = 0.35
"""Fraction of the coarsest grid's half width from which its samples are blended to |p| - r."""

SETTLE = 10
"""Nodes beyond the coarsest grid that are fitted and dropped: a spline's ends matter by a factor
of 0.27 per node (de Boor), here 2e-6."""

SMOOTHING = 0.7
"""Smallest standard deviation of the Gaussian, in cells of the finest grid."""

RIM = 3
"""Outermost coefficients of a correction that are zero: those that act at the rim."""

TAPER = 5
"""Nodes over which a correction is brought to zero inside of these."""

Distance = Callable[[FloatArray], FloatArray]
"""Signed distance (n,), m, of points (n, 3), m."""

GridDistance = Callable[[IntArray, tuple[int, int, int], float], FloatArray]
"""Signed distance (nx, ny, nz), m, of the nodes of a grid: first node (3,), counts, spacing (m)."""


def fit_field(
    distance: Distance,
    lower: FloatArray,
    upper: FloatArray,
    *,
    on_grid: GridDistance | None = None,
    smoothing: float = 0.0,
) -> DistanceField:
    """A field for a solid whose origin is inside its bounding box.

    Args:
        distance: Used for the coarser grids; near the surface it need not be exact.
        lower: Lower corner (3,) of the solid's bounding box, m.
        upper: Upper corner (3,), m.
        on_grid: Used for the finest grid, and called first; exact. ``distance`` if None.
        smoothing: Standard deviation of the Gaussian, m, if that is more than ``SMOOTHING`` cells.
    """
    extent = upper - lower + 2 * MARGIN
    spacing = max(FINEST, float(np.cbrt(np.prod(extent) / CELLS)))
    far_radius = float(np.mean(np.abs([lower, upper])))
    first, shape = _grid(lower - MARGIN, upper + MARGIN, spacing)
    if on_grid is None:
        samples = distance(grid_nodes(first, shape, spacing)).reshape(shape)
    else:
        samples = on_grid(first, shape, spacing)
    h = spacing * MIDDLE_RATIO
    far = _far_level(distance, h * FAR_RATIO, far_radius)
    middle_first, middle_shape = _grid(lower - MIDDLE_MARGIN, upper + MIDDLE_MARGIN, h)
    middle_samples = distance(grid_nodes(middle_first, middle_shape, h)).reshape(middle_shape)
    middle = _corrected(far, FAR_RATIO, middle_first, middle_samples)
    smooth = gaussian_filter(samples, max(SMOOTHING, smoothing / spacing), mode="nearest")
    fine = _corrected(middle, MIDDLE_RATIO, first, smooth)
    return DistanceField(levels=(fine, middle, far), far_radius=far_radius)


def _corrected(coarse: Level, ratio: int, first: IntArray, samples: FloatArray) -> Level:
    """The next finer level: the coarse one plus what it misses, which is zero at the rim."""
    shape = samples.shape
    refined, taper = _refined(coarse, ratio, first, shape), _taper(shape)
    correction = spline_filter((samples - _at_nodes(refined)) * taper, order=3)
    return Level(
        first=first,
        spacing=coarse.spacing / ratio,
        coefficients=refined + np.where(taper > 0, correction, 0.0),
    )


def _far_level(distance: Distance, h: float, far_radius: float) -> Level:
    """The coarsest level: its samples become |p| - r towards the rim."""
    box = np.full(3, FAR_REACH)
    first, shape = _grid(-box, box, h)
    # a spline filter assumes a mirror at its ends: let it die out in nodes that are dropped again
    wide = shape[0] + 2 * SETTLE, shape[1] + 2 * SETTLE, shape[2] + 2 * SETTLE
    nodes = grid_nodes(first - SETTLE, wide, h)
    share = np.abs(nodes).max(axis=1) / FAR_REACH
    t = np.clip((share - BLEND_FROM) / (1.0 - BLEND_FROM), 0.0, 1.0)
    weight = t**3 * (10 - 15 * t + 6 * t**2)  # two continuous derivatives
    samples = weight * (np.linalg.norm(nodes, axis=1) - far_radius)
    near = weight < 1
    samples[near] += (1 - weight[near]) * distance(nodes[near])
    coefficients = spline_filter(samples.reshape(wide), order=3)
    inner = slice(SETTLE, -SETTLE)
    return Level(first=first, spacing=h, coefficients=coefficients[inner, inner, inner].copy())


def _grid(lower: FloatArray, upper: FloatArray, h: float) -> tuple[IntArray, tuple[int, int, int]]:
    """First node (3,) and count of nodes of a grid that covers a box, its rim included."""
    first = np.floor(lower / h).astype(np.int64) - RIM
    last = np.ceil(upper / h).astype(np.int64) + RIM
    x, y, z = (int(v) for v in last - first + 1)
    return first, (x, y, z)


def grid_nodes(first: IntArray, shape: tuple[int, ...], h: float) -> FloatArray:
    """Nodes (nx ny nz, 3) of a grid, m: first node (3,), counts (3,), spacing (m)."""
    axes = [(f + np.arange(s)) * h for f, s in zip(first, shape, strict=True)]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)


def _taper(shape: tuple[int, ...]) -> FloatArray:
    """0 in the ``RIM`` outermost nodes, rising to 1 over ``TAPER`` nodes."""
    parts = []
    for s in shape:
        k = np.arange(s)
        t = np.clip((np.minimum(k, s - 1 - k) - RIM + 1) / TAPER, 0.0, 1.0)
        parts.append(t * t * (3 - 2 * t))
    out: FloatArray = parts[0][:, None, None] * parts[1][:, None] * parts[2]
    return out


def _at_nodes(coefficients: FloatArray) -> FloatArray:
    """Values of a spline at its nodes; in the outermost nodes, where it is undefined, a copy."""
    out = np.pad(coefficients, 1, mode="edge")
    for axis in range(3):
        a = np.moveaxis(out, axis, 0)
        out = np.moveaxis((a[:-2] + 4 * a[1:-1] + a[2:]) / 6, 0, axis)
    return out


def _refined(level: Level, ratio: int, first: IntArray, shape: tuple[int, ...]) -> FloatArray:
    """The coefficients of a coarser level on a part of a grid of 1 / ``ratio`` of its spacing.

    beta(x) = sum_k comb(4, k) / 8 beta(2 x - k + 2): one refinement by two along each axis, and
    again until the spacing is reached.
    """
    start = first // ratio - 2  # two more on either side act on the part
    stop = (first + np.array(shape)) // ratio + 4
    inner = [slice(a, b) for a, b in zip(start - level.first, stop - level.first, strict=True)]
    c = level.coefficients[tuple(inner)]
    while ratio > 1:
        for axis in range(3):
            a = np.moveaxis(c, axis, 0)
            fine = np.zeros((2 * len(a) + 3, *a.shape[1:]))
            for k, w in enumerate((1, 4, 6, 4, 1)):
                fine[k : k + 2 * len(a) : 2] += w / 8 * a
            c = np.moveaxis(fine, 0, axis)
        start, ratio = 2 * start - 2, ratio // 2
    box = tuple(slice(a, a + s) for a, s in zip(first - start, shape, strict=True))
    return np.ascontiguousarray(c[box])
