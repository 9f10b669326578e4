"""Fitting a ``DistanceField`` to an exact signed distance: sample, smooth, spline, nest.

The samples of the finest grid are smoothed with a Gaussian before interpolation, because kinks of
the distance (edges, medial axis) stop a solver. ``DistanceField.error`` bounds the loss of accuracy
for queries that must know on which side of the surface a point is.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from planner.shapes.distance_field import DistanceField, Level
from planner.spatial import FloatArray, IntArray

RIM_STEP = 1e-5
"""Largest step (m) of the value at the rim of the coarsest level; measured, see the tests."""

FINEST = 0.0015
"""Smallest spacing of the finest grid, m, but for thin walls: finer costs memory and preparation,
not accuracy that counts, since contacts are corrected on the true surface."""

CELLS = 64**3
"""Largest count of nodes of the finest grid, but for thin walls."""

ACROSS, MOST_CELLS = 4.0, 128**3
"""Thickness of a wall in cells of the finest grid, and the largest number of nodes. With fewer
cells the smooth distance is less steep and its normals change back and forth along the wall, which
stops fingers that roll there."""

MIDDLE_RATIO = 4
"""How many times the finest spacing the second grid has; a power of two."""

FAR_RATIO = 8
"""How many times the second grid's spacing the coarsest has; a power of two."""

MARGIN = 0.025
"""How far (m) the finest grid reaches beyond the object at least: what a fingertip's centre needs.
Where ``TAPER`` nodes are more than that, it reaches so far: within the object nothing is tapered.
"""

MIDDLE_MARGIN = 0.12
"""How far (m) the second grid reaches at least: links of a hand around the object. In the same way
it reaches ``TAPER`` of its own nodes beyond the finest one."""

FAR_REACH = 0.8
"""Half width of the coarsest grid at least, m: a hand's base. More where the blending to |p| - r
would begin within the second grid."""

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

SETTLING = 4
"""Times that spacing and margin of the finest grid are adapted to one another; each changes the
spacing by a seventh of the time before."""

Distance = Callable[[FloatArray], FloatArray]
"""Signed distance (n,), m, of points (n, 3), m."""

GridDistance = Callable[[IntArray, tuple[int, int, int], float], FloatArray]
"""Signed distance (nx, ny, nz), m, of the nodes of a grid: first node (3,), counts, spacing (m)."""

Bracket = Callable[[IntArray, tuple[int, int, int], float], tuple[FloatArray, FloatArray]]
"""Lower and upper bounds (nx, ny, nz), m, of the signed distance of the nodes of a grid."""


def fit_field(
    on_grid: GridDistance,
    lower: FloatArray,
    upper: FloatArray,
    *,
    bracket: Bracket | None = None,
    smoothing: float = 0.0,
    wall: float = np.inf,
) -> DistanceField:
    """A field for a solid whose origin is inside its bounding box.

    Args:
        on_grid: The distance, asked for on three grids, each within the one before and with its
            spacing over a power of two. See ``on_grids``.
        lower: Lower corner (3,) of the solid's bounding box, m.
        upper: Upper corner (3,), m.
        bracket: What bounds the error at the nodes of the last grid, asked for at those around the
            bounding box. ``on_grid`` if None, which is exact then.
        smoothing: Standard deviation of the Gaussian, m, if that is more than ``SMOOTHING`` cells.
        wall: Thickness of the walls, m.
    """
    from scipy.ndimage import gaussian_filter  # here, since SciPy loads slowly

    spacing, margin = finest_spacing(lower, upper, wall)
    far_radius = float(np.mean(np.abs([lower, upper])))
    first, shape = _grid(lower - margin, upper + margin, spacing)
    h = spacing * MIDDLE_RATIO
    around = max(MIDDLE_MARGIN, margin + TAPER * h)
    reach = max(FAR_REACH, float(np.max(np.abs([lower, upper])) + around) / BLEND_FROM)
    far = _far_level(on_grid, h * FAR_RATIO, far_radius, reach)
    middle_first, middle_shape = _grid(lower - around, upper + around, h)
    middle = _corrected(far, FAR_RATIO, middle_first, on_grid(middle_first, middle_shape, h))
    samples = on_grid(first, shape, spacing)
    smooth = gaussian_filter(samples, max(SMOOTHING, smoothing / spacing), mode="nearest")
    fine = _corrected(middle, MIDDLE_RATIO, first, smooth)
    error = error_bound(fine, lower, upper, bracket or (lambda *grid: (on_grid(*grid),) * 2))
    return DistanceField(levels=(fine, middle, far), far_radius=far_radius, error=error)


def finest_spacing(lower: FloatArray, upper: FloatArray, wall: float) -> tuple[float, float]:
    """Spacing (m) of the finest grid around a box, and how far (m) it reaches beyond it.

    Args:
        lower: Lower corner (3,), m.
        upper: Upper corner (3,), m.
        wall: Thickness of the walls, m.
    """
    margin = MARGIN
    for _ in range(SETTLING):
        extent = upper - lower + 2 * margin
        volume = float(np.prod(extent))
        spacing = max(FINEST, np.cbrt(volume / CELLS))
        spacing = float(min(spacing, max(wall / ACROSS, np.cbrt(volume / MOST_CELLS))))
        margin = max(MARGIN, TAPER * spacing)
    return spacing, margin


def error_bound(level: Level, lower: FloatArray, upper: FloatArray, bracket: Bracket) -> float:
    """How far (m) a level is from the true distance at most, at any point of a box.

    With I the trilinear interpolation between the nodes around a point, f the level, d the
    distance: f - d = (f - I f) + I (f - d) + (I d - d). The first is at most an eighth of the
    spacing squared times the sum of the largest second derivatives along the axes, which are
    averages of second differences of the coefficients. The second is at most what is found at the
    nodes. The third is at most the mean distance from the nodes, with their weights: sqrt(3) / 2
    of the spacing, since d changes by 1 m per m at most.

    Args:
        level: Grid that reaches a node beyond the box.
        lower: Lower corner (3,) of the box, m.
        upper: Upper corner (3,), m.
        bracket: Bounds of the distance, asked for at the nodes around the box.
    """
    h = level.spacing
    first = np.floor(lower / h).astype(np.int64)
    x, y, z = (int(v) for v in np.ceil(upper / h).astype(np.int64) - first + 1)
    at = first - level.first
    box = tuple(slice(a, a + s) for a, s in zip(at, (x, y, z), strict=True))
    values = _at_nodes(level.coefficients)[box]
    low, high = bracket(first, (x, y, z), h)
    at_nodes = float(np.maximum(values - low, high - values).max())
    near = level.coefficients[tuple(slice(b.start - 1, b.stop + 1) for b in box)]
    bend = sum(float(np.abs(np.diff(near, n=2, axis=axis)).max()) for axis in range(3)) / 8
    return at_nodes + bend + float(np.sqrt(3) / 2 * h)


def _corrected(coarse: Level, ratio: int, first: IntArray, samples: FloatArray) -> Level:
    """The next finer level: the coarse one plus what it misses, which is zero at the rim."""
    from scipy.ndimage import spline_filter  # here, since SciPy loads slowly

    shape = samples.shape
    refined, taper = _refined(coarse, ratio, first, shape), _taper(shape)
    correction = spline_filter((samples - _at_nodes(refined)) * taper, order=3)
    return Level(
        first=first,
        spacing=coarse.spacing / ratio,
        coefficients=refined + np.where(taper > 0, correction, 0.0),
    )


def _far_level(on_grid: GridDistance, h: float, far_radius: float, reach: float) -> Level:
    """The coarsest level, of a half width: its samples become |p| - r towards the rim."""
    from scipy.ndimage import spline_filter  # here, since SciPy loads slowly

    box = np.full(3, reach)
    first, shape = _grid(-box, box, h)
    # a spline filter assumes a mirror at its ends: let it die out in nodes that are dropped again
    wide = shape[0] + 2 * SETTLE, shape[1] + 2 * SETTLE, shape[2] + 2 * SETTLE
    squares = [((f - SETTLE + np.arange(s)) * h) ** 2 for f, s in zip(first, wide, strict=True)]
    x, y, z = squares[0][:, None, None], squares[1][:, None], squares[2]
    share = np.sqrt(np.maximum(np.maximum(x, y), z)) / reach
    t = np.clip((share - BLEND_FROM) / (1.0 - BLEND_FROM), 0.0, 1.0)
    weight = t**3 * (10 - 15 * t + 6 * t**2)  # two continuous derivatives
    samples = weight * (np.sqrt(x + y + z) - far_radius)
    inner = (slice(SETTLE, -SETTLE),) * 3
    samples[inner] += (1 - weight[inner]) * on_grid(first, shape, h)
    coefficients = spline_filter(samples, order=3)
    return Level(first=first, spacing=h, coefficients=coefficients[inner].copy())


def _grid(lower: FloatArray, upper: FloatArray, h: float) -> tuple[IntArray, tuple[int, int, int]]:
    """First node (3,) and count of nodes of a grid that covers a box, its rim included."""
    first = np.floor(lower / h).astype(np.int64) - RIM
    last = np.ceil(upper / h).astype(np.int64) + RIM
    x, y, z = (int(v) for v in last - first + 1)
    return first, (x, y, z)


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
            fine = np.empty((2 * len(a) - 4, *a.shape[1:]))
            np.add(a[:-2], a[2:], out=fine[::2])
            fine[::2] += 6 * a[1:-1]
            fine[::2] /= 8
            np.add(a[1:-1], a[2:], out=fine[1::2])
            fine[1::2] /= 2
            c = np.moveaxis(fine, 0, axis)
        start, ratio = 2 * (start + 1), ratio // 2
    box = tuple(slice(a, a + s) for a, s in zip(first - start, shape, strict=True))
    return np.ascontiguousarray(c[box])


def grid_nodes(first: IntArray, shape: tuple[int, ...], h: float) -> FloatArray:
    """Nodes (nx ny nz, 3) of a grid, m: first node (3,), counts (3,), spacing (m)."""
    axes = [(f + np.arange(s)) * h for f, s in zip(first, shape, strict=True)]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
