"""What the cameras saw through, and what may be behind the points: hypotheses of the whole object.

``Sight`` tells of a place how far it is behind the seen surface. What no view saw through is the
``shadow``, the largest solid that explains the cloud. Smaller ones are its parts that symmetry or
a straight way down to the table leave:

    mirror     shadow and its mirror image in a plane that brings no seen point into free space
    two mirrors   the same, and the image upside down, between table and top
    extrusion  what is below a seen point
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planner.clouds.cloud import PointCloud
from planner.spatial import FloatArray, IntArray, contact_frames

BoolArray = NDArray[np.bool_]

CELLS = 32
"""Cells of the grid along the longest side of what was seen."""

PIXELS, FINEST = 64, 0.0015
"""Pixels of a depth image across the object, and the least size (m) of one at the object."""

AROUND = 2.0
"""Half of an image over the half that the object takes."""

BLURRED = 1.0
"""Standard deviation (pixels) over which depths are averaged against noise."""

LATERAL = 0.004
"""Distance (m) from the nearest ray of sight beyond which a place was not looked at."""

SOME = 400
"""Seen points by which planes of symmetry are judged."""

PLACES, TURNS = 24, 9
"""Places of a plane of symmetry, and its directions within 60 degrees of the view, looked at."""

VIOLATED = 0.12
"""Share (-) of mirrored points that may lie in free space, and of seen points that may lie beside a
hypothesis: noise and edges. A mirror image beyond the grid leaves slivers."""

EXTRUDED = 0.3
"""Merit (-) of what is below a seen point, beside that of mirrors."""

SUPPORT = 0.15
"""Merit (-) of a hypothesis that is worth a factor e of plausibility."""


class Sight:
    """Free and hidden space of a cloud's views: a coarse depth image of each."""

    def __init__(self, cloud: PointCloud) -> None:
        """Draw the images."""
        self.cloud = cloud
        self.margin = 2.0 * cloud.noise + 0.001
        views = np.unique(cloud.view_of) if len(cloud.views) else ()
        self._images = [_Image.of(cloud, int(view)) for view in views]

    def behind(self, points: FloatArray) -> FloatArray:
        """How far (n,), m, points (n, 3) are behind the seen surface along the rays, at least.

        Negative where some view saw through them, -inf beside the object and under the table, 0
        where no ray went.
        """
        least = np.full(len(points), np.inf)
        for image in self._images:
            least = np.minimum(least, image.behind(points))
        if self.cloud.table is not None:
            least = np.where(points[:, 2] < self.cloud.table, -np.inf, least)
        return least


@dataclass(frozen=True, kw_only=True, eq=False)
class _Image:
    """Depths of one view: inf where it saw past the object, NaN where it has no ray.

    Attributes:
        eye: Place of the camera (3,), m.
        axes: Right, up and ahead as rows (3, 3).
        pixel: Size of a pixel, per m of distance (-).
        depth: (n, n), m, along the ray.
    """

    eye: FloatArray
    axes: FloatArray
    pixel: float
    depth: FloatArray

    @classmethod
    def of(cls, cloud: PointCloud, view: int) -> _Image:
        from scipy.ndimage import distance_transform_edt, gaussian_filter

        eye, seen = cloud.views[view], cloud.points[cloud.view_of == view]
        past = cloud.past[cloud.past_of == view]
        ahead = seen.mean(axis=0) - eye
        far = float(np.linalg.norm(ahead))
        axes = contact_frames(ahead[None])[0].T[[1, 2, 0]]
        flat = (seen - eye) @ axes.T
        reach = float(np.abs(flat[:, :2] / flat[:, 2:]).max())
        pixel = max(2.0 * reach / PIXELS, FINEST / far)
        half = int(np.ceil(AROUND * reach / pixel))
        shape = (2 * half + 1, 2 * half + 1)
        image = cls(eye=eye, axes=axes, pixel=pixel, depth=np.empty(shape))

        def drawn(points: FloatArray) -> tuple[FloatArray, FloatArray]:
            index, inside = image._pixels(points)
            away = np.linalg.norm(points - eye, axis=1)[inside]
            counts, sums = (np.bincount(index[inside], w, image.depth.size) for w in (None, away))
            return counts.astype(np.float64).reshape(shape), sums.astype(np.float64).reshape(shape)

        hits, sums = drawn(seen)
        misses = drawn(past)[0]
        hit = hits > 0 if not len(past) else hits > 0.5 * misses
        known = hit | (misses > 0)
        weight = gaussian_filter(np.where(hit, hits, 0.0), BLURRED)
        depth = gaussian_filter(np.where(hit, sums, 0.0), BLURRED) / np.maximum(weight, 1e-9)
        values = np.where(hit, depth, np.inf)
        off, nearest = distance_transform_edt(~known, return_indices=True)
        values = values[tuple(nearest)]
        beyond = off * pixel * far > LATERAL
        values[beyond] = np.nan if len(past) else np.inf
        image.depth[:] = values
        return image

    def _pixels(self, points: FloatArray) -> tuple[IntArray, BoolArray]:
        """Numbers of pixels (n,) and whether points are in the image."""
        n = len(self.depth)
        flat = (points - self.eye) @ self.axes.T
        ahead = flat[:, 2] > 1e-3  # m
        place = flat[:, :2] / np.where(ahead, flat[:, 2], 1.0)[:, None] / self.pixel
        cell = np.round(np.clip(place, -n, n)).astype(np.int64) + n // 2
        inside = ahead & ((cell >= 0) & (cell < n)).all(axis=1)
        return cell[:, 0] * n + cell[:, 1], inside

    def behind(self, points: FloatArray) -> FloatArray:
        """See ``Sight.behind``; of this view."""
        index, inside = self._pixels(points)
        depth = self.depth.ravel()[np.where(inside, index, 0)]
        away = np.linalg.norm(points - self.eye, axis=1)
        return np.where(inside, np.where(np.isnan(depth), 0.0, away - depth), -np.inf)


@dataclass(frozen=True, kw_only=True, eq=False)
class Grid:
    """Nodes of a grid.

    Attributes:
        lower: First node (3,), m.
        spacing: m.
        shape: Counts of nodes.
    """

    lower: FloatArray
    spacing: float
    shape: tuple[int, int, int]

    @property
    def nodes(self) -> FloatArray:
        """(n, 3), m, the last axis first."""
        axes = [
            self.lower[i] + self.spacing * np.arange(count) for i, count in enumerate(self.shape)
        ]
        return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)

    def beyond(self, points: FloatArray) -> FloatArray:
        """Distances (n,), m, of points (n, 3) from the grid, 0 in it."""
        upper = self.lower + self.spacing * (np.array(self.shape) - 1)
        return np.asarray(np.linalg.norm(points - np.clip(points, self.lower, upper), axis=1))

    def at(self, values: FloatArray, points: FloatArray) -> FloatArray:
        """Values (nx, ny, nz) of nodes at points (n, 3), linear between them, constant outside."""
        from scipy.ndimage import map_coordinates

        where = ((points - self.lower) / self.spacing).T
        return np.asarray(map_coordinates(values, where, order=1, mode="nearest"))


@dataclass(frozen=True, kw_only=True, eq=False)
class Hypothesis:
    """What the whole object may be.

    Attributes:
        name: "shadow", "mirror", "two mirrors" or "extrusion".
        distance: Signed distance at the nodes of the grid (nx, ny, nz), m, positive outside.
        weight: Plausibility, of all together 1.
    """

    name: str
    distance: FloatArray
    weight: float


Mirror = Callable[[FloatArray], FloatArray]


def hypotheses(cloud: PointCloud) -> tuple[Grid, Sight, tuple[Hypothesis, ...]]:
    """What the object may be, the most plausible first, with the grid they are on."""
    sight = Sight(cloud)
    grid = _grid(cloud)
    nodes = grid.nodes
    shadow = sight.behind(nodes).reshape(grid.shape)
    shadow[[0, -1]] = shadow[:, [0, -1]] = shadow[:, :, [0, -1]] = -np.inf
    filled = np.where(np.isfinite(shadow), shadow, -1.0)
    solid = shadow > 0.0
    found: list[tuple[str, BoolArray, float]] = [("shadow", solid, 0.0)]
    some = cloud.points[:: max(1, len(cloud) // SOME)]
    table = cloud.table
    for mirror, merit in _mirrors(cloud, sight, some)[:2] if len(cloud.views) else ():
        image = solid & (grid.at(filled, mirror(nodes)).reshape(grid.shape) > 0.0)
        found.append(("mirror", image, merit))
        if table is None:
            continue
        top = float(np.percentile(cloud.points[:, 2], 99.5))
        over = _reflection(np.array([0.0, 0.0, 1.0]), 0.5 * (table + top))
        violated, support = _judged(sight, over(some))
        if violated <= VIOLATED:
            both = image & (grid.at(filled, over(nodes)).reshape(grid.shape) > 0.0)
            both &= grid.at(filled, over(mirror(nodes))).reshape(grid.shape) > 0.0
            found.append(("two mirrors", both, merit + support - 2.0 * violated))
    if table is not None:
        found.append(("extrusion", solid & _below_seen(cloud, grid), EXTRUDED))
    solids = [
        (name, _distance(cells, grid.spacing), merit)
        for name, cells, merit in sorted(found, key=lambda h: -h[2])
        if cells.sum() > LEAST_CELLS
    ]
    near = sight.margin + grid.spacing
    kept = [h for h in solids if np.mean(grid.at(h[1], some) > near) <= VIOLATED][:MOST]
    weights = np.exp(np.array([merit for _, _, merit in kept]) / SUPPORT)
    out = [
        Hypothesis(name=name, distance=distance, weight=float(weight))
        for (name, distance, _), weight in zip(kept, weights / weights.sum(), strict=True)
    ]
    return grid, sight, tuple(out)


MOST = 4
"""Hypotheses that are kept."""

LEAST_CELLS = 30
"""Cells of a solid below which there is none."""

SMOOTHED = 0.8
"""Standard deviation, in cells, by which the distance of cells is smoothed."""


def _distance(cells: BoolArray, spacing: float) -> FloatArray:
    """Signed distance (nx, ny, nz), m, of cells, smoothed."""
    from scipy.ndimage import distance_transform_edt, gaussian_filter

    outside, inside = distance_transform_edt(~cells), distance_transform_edt(cells)
    signed = np.where(cells, 0.5 - inside, outside - 0.5)
    return spacing * np.asarray(gaussian_filter(signed, SMOOTHED))


def _grid(cloud: PointCloud) -> Grid:
    """Around what was seen and what it may hide."""
    lower, upper = cloud.points.min(axis=0), cloud.points.max(axis=0)
    size = upper - lower
    spacing = max(float(size.max()) / CELLS, 0.0012)
    for eye in cloud.views:
        away = cloud.points.mean(axis=0) - eye
        away /= np.linalg.norm(away)
        across = np.ptp(cloud.points - (cloud.points @ away)[:, None] * away, axis=0).max()
        deep = across * away
        lower = np.minimum(lower, cloud.points.min(axis=0) + np.minimum(deep, 0.0) * HIDDEN)
        upper = np.maximum(upper, cloud.points.max(axis=0) + np.maximum(deep, 0.0) * HIDDEN)
    if cloud.table is not None:
        lower[2] = cloud.table
        upper[2] = cloud.points[:, 2].max()
    lower, upper = lower - 3.5 * spacing, upper + 3.5 * spacing
    x, y, z = (np.ceil((upper - lower) / spacing).astype(int) + 1).tolist()
    return Grid(lower=lower, spacing=spacing, shape=(x, y, z))


HIDDEN = 0.8
"""Depth behind what was seen that is looked at, over its width across the view."""


def _reflection(normal: FloatArray, place: float) -> Mirror:
    return lambda p: p - 2.0 * (p @ normal - place)[:, None] * normal


def _judged(sight: Sight, points: FloatArray) -> tuple[float, float]:
    """Shares of mirrored points that lie in free space and on the seen surface."""
    behind = sight.behind(points)
    free = behind < -sight.margin
    return float(free.mean()), float((np.abs(behind) <= sight.margin).mean())


def _mirrors(cloud: PointCloud, sight: Sight, some: FloatArray) -> list[tuple[Mirror, float]]:
    """Reflections that the views allow, with their merits, the best first: of each direction one.

    A plane's merit is the share of mirrored points on the seen surface less twice the share in free
    space; of equals the nearest plane counts.
    """
    view = np.mean(cloud.views[np.unique(cloud.view_of)], axis=0) - cloud.points.mean(axis=0)
    view /= np.linalg.norm(view)
    normals = [] if cloud.table is not None else [view]
    if np.linalg.norm(view[:2]) > FROM_ABOVE:
        turns = np.arctan2(view[1], view[0]) + np.linspace(-np.pi / 3, np.pi / 3, TURNS)
        normals += [np.array([np.cos(t), np.sin(t), 0.0]) for t in turns]
    width = float(np.ptp(cloud.points, axis=0).max())
    out = []
    for normal in normals:
        high, low = np.percentile(cloud.points @ normal, (98, 2))
        best = (-np.inf, 1.0, 0.0)
        step = (high - low + 0.5 * width) / PLACES
        for place in np.arange(high, low - 0.5 * width, -step):
            violated, support = _judged(sight, _reflection(normal, float(place))(some))
            best = max(best, (support - 2.0 * violated, -violated, float(place)))
        merit, free, place = best
        if -free <= VIOLATED:
            out.append((_reflection(normal, place), merit))
    return sorted(out, key=lambda item: -item[1])


FROM_ABOVE = 0.17
"""Horizontal part of the view's direction (-) below which it is from above: 10 degrees."""


def _below_seen(cloud: PointCloud, grid: Grid) -> BoolArray:
    """Nodes (nx, ny, nz) below a seen point of their column or of one beside it."""
    from scipy.ndimage import maximum_filter

    where = np.round((cloud.points - grid.lower) / grid.spacing).astype(int)
    top = np.full(grid.shape[:2], -1)
    np.maximum.at(top, (where[:, 0], where[:, 1]), where[:, 2])
    top = maximum_filter(top, 3)
    return np.asarray(np.arange(grid.shape[2]) <= top[:, :, None])
