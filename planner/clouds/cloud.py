"""``PointCloud``: what depth cameras saw of one object, in one frame, checked and thinned.

``PointCloud.create`` takes what a user has; ``prepared`` takes the table away, then outliers and
other things, and thins the rest to evenly spread points with normals. A cloud that is not usable is
an ``ObjectError`` that says what was given and what to do.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from planner.arrays import checked_number, float_array
from planner.errors import ObjectError
from planner.spatial import FloatArray, IntArray

FEWEST = 60
"""Points of an object below which there is no surface to speak of."""

LARGEST, SMALLEST = 0.6, 0.008
"""Longest extent (m) of an object that a hand can hold, and the shortest that a camera resolves."""

SCENE = 6.0
"""Extent (m) of a cloud above which it is taken to be in millimetres: no table is so wide."""

NOISIEST = 0.02
"""Largest noise (m) of a point with which a fingertip of that size can still be placed."""

DEFAULT_NOISE = 0.001
"""Least noise (m) that is estimated from a cloud: nearest neighbours hide what is smooth."""

KEPT = 10_000
"""Points that are kept of a cloud, about: 1 mm apart on an object of 8 cm; more are not needed."""

PATCH, PATCH_NOISE = 0.005, 3.5
"""Radius (m) of the patches to which planes are fitted, and their least radius over the noise: with
fewer than these a normal is that of the noise."""

PATCH_POINTS = 40
"""Points of a patch that are looked at, at most, drawn over all of it."""

GRAZING = 0.17
"""Cosine between normal and ray of sight below which a point is dropped: beyond 80 degrees are
edges that bleed into what is behind them."""

OUTLYING = 4.0
"""Robust standard deviations of the distance to neighbours beyond which a point is an outlier."""

BELOW_TABLE = 0.03
"""Share (-) of points that may lie below a table: outliers."""

GAP = 0.012
"""Distance (m) from which on two groups of points are two things."""

SECOND = 0.3
"""Share (-) of the largest group's points from which on a second group is a second object."""

THING = 15
"""Points of a group beside the object from which on it is a thing that a hand keeps clear of, and
no bleeding edge."""

FLAT = 1.15
"""Standard deviation across its plane, over the noise, below which a cloud is planar: a bar of 2 cm
that lies on a table has 1.4 at a noise of 2 mm."""

LEVEL = 0.95
"""Cosine of the tilt below which a plane is not horizontal: 18 degrees."""


@dataclass(frozen=True, eq=False)
class PointCloud:
    """Points on an object as cameras saw them, all in one frame (z up; the world of a task).

    Attributes:
        points: (n, 3), m.
        normals: Outward unit normals (n, 3); None where nobody has estimated them.
        views: Places of the cameras (v, 3), m; empty where they are not known.
        view_of: Index of the view that saw each point, (n,).
        noise: Standard deviation of a point, m.
        table: Height (z, m) of the table's top; None where there is no table.
        past: Ends (k, 3), m, of rays of sight that met no point of the object: on the table, the
            wall or 2 m away. All between camera and end is free.
        past_of: Index of the view of each such ray, (k,).
        notes: What ``prepared`` took away, a sentence each.
        one: Whether all large groups of points are parts of one object, as a mask tells.
    """

    points: FloatArray
    normals: FloatArray | None
    views: FloatArray
    view_of: IntArray
    noise: float
    table: float | None
    past: FloatArray
    past_of: IntArray
    notes: tuple[str, ...] = ()
    one: bool = False

    def __len__(self) -> int:
        """Number of points."""
        return len(self.points)

    @classmethod
    def create(
        cls,
        points: Any,
        *,
        normals: Any = None,
        views: Any = (),
        view_of: Any = None,
        noise: float | None = None,
        table: float | Literal["find"] | None = "find",
        past: Any = (),
        past_of: Any = None,
        one: bool = False,
    ) -> PointCloud:
        """A cloud of arrays, checked; rows with NaN, which are pixels without depth, are left out.

        Args:
            points: (n, 3), m.
            normals: (n, 3), of any length, outward.
            views: Places of the cameras (v, 3) or one (3,), m.
            view_of: View of each point (n,); the first if there is only one.
            noise: Standard deviation of a point, m; None to estimate it.
            table: Height of the table's top, m; None for no table; "find" to look for one.
            past: Ends (k, 3) of rays that met nothing of the object, m.
            past_of: View of each such ray (k,); the first if there is only one.
            one: Whether all large groups of points are parts of one object, as a mask tells.

        Raises:
            ObjectError: Wrong shapes, too few points, millimetres; says what to do.
        """
        p = _rows("points", points)
        eyes, ends = _places("views", views), _places("past", past)
        seen_by = _index("view_of", view_of, len(p), len(eyes))
        past_by = _index("past_of", past_of, len(ends), len(eyes))
        n = None if normals is None else _rows("normals", normals)
        if n is not None and n.shape != p.shape:
            raise ObjectError(f"normals have shape {n.shape}, points {p.shape}; give one a point")
        if not np.isfinite(eyes).all() or (len(ends) and not len(eyes)):
            raise ObjectError("views hold NaN, or rays are given without views; give finite places")
        good = np.isfinite(p).all(axis=1)
        if n is not None and not (np.isfinite(n[good]).all() and np.any(n[good], axis=1).all()):
            n = None  # estimated again
        if good.sum() < FEWEST:
            raise ObjectError(
                f"the cloud has {len(p)} points, of which {good.sum()} are finite; give at least "
                f"{FEWEST} of the object"
            )
        reach = float(np.ptp(p[good], axis=0).max())
        if reach > SCENE:
            raise ObjectError(
                f"the cloud is {reach:.4g} m wide, more than {SCENE:g} m; are its numbers in "
                "millimetres? Multiply by 0.001 (of depth images: "
                "scale), or cut out the object's surroundings"
            )
        if noise is not None:
            noise = checked_number("noise", noise, above=0, most=NOISIEST, unit="m",
                                   error=ObjectError)  # fmt: skip
        seen = np.isfinite(ends).all(axis=1)
        notes = [] if good.all() else [f"{(~good).sum()} points without a depth left out"]
        out = cls(
            points=p[good],
            normals=None if n is None else n[good] / np.linalg.norm(n[good], axis=1)[:, None],
            views=eyes,
            view_of=seen_by[good],
            noise=noise or 0.0,
            table=None,
            past=ends[seen],
            past_of=past_by[seen],
            notes=tuple(notes),
            one=bool(one),
        )
        if table == "find":
            height = find_table(out.points)
        else:
            height = None if table is None else checked_number("table", table, unit="m",
                                                              error=ObjectError)  # fmt: skip
        return replace(out, table=height, noise=noise or estimated_noise(out.points))

    @property
    def towards_camera(self) -> FloatArray | None:
        """Unit vectors (n, 3) from each point to the camera that saw it; None without views."""
        if not len(self.views):
            return None
        ray = self.views[self.view_of] - self.points
        return np.asarray(ray / np.linalg.norm(ray, axis=1)[:, None])

    def only(self, kept: NDArray[Any], note: str = "") -> PointCloud:
        """The cloud of some of the points, an index or mask; what is said of the others."""
        return replace(
            self,
            points=self.points[kept],
            normals=None if self.normals is None else self.normals[kept],
            view_of=self.view_of[kept],
            notes=(*self.notes, note) if note else self.notes,
        )


def prepared(cloud: PointCloud) -> PointCloud:
    """One object's points, evenly spread, with normals: no table, outliers or second object.

    Raises:
        ObjectError: Nothing but a table, several objects, a plane that bounds nothing, an object
            that is too large or too small, too few points.
    """
    cloud = _thinned(_without_table(cloud), KEPT)
    cloud = _one_object(_without_outliers(cloud))
    _check_size(cloud)
    if cloud.normals is None:
        cloud = replace(cloud, normals=estimated_normals(cloud))
    _check_flat(cloud)
    towards = cloud.towards_camera
    if towards is None or cloud.normals is None:
        return cloud
    seen = np.einsum("nd,nd->n", cloud.normals, towards) > GRAZING
    return cloud.only(seen) if seen.sum() >= FEWEST else cloud


def find_table(points: FloatArray) -> float | None:
    """Height (m) of a horizontal plane under everything else and wider than it; None without one.

    The lowest dense layer counts as a table where it is twice as wide as what is above it: where an
    object hides most of its table, the height has to be given.
    """
    z = points[:, 2]
    low, high = np.percentile(z, (0.2, 99.8))
    layer = 0.002  # m: as thick as the noise of a usual camera
    counts, edges = np.histogram(z, np.arange(low - 2 * layer, high + 4 * layer, layer))
    dense = np.convolve(counts, np.ones(5), mode="same")
    first = int(np.flatnonzero(dense > max(0.1 * len(z), 0.3 * dense.max(initial=0.0)))[:1].sum())
    peak = first + int(dense[first : first + 6].argmax())
    middle = 0.5 * (edges[peak] + edges[peak + 1])
    if dense[peak] < 0.1 * len(z) or np.mean(z < middle - 6 * layer) > BELOW_TABLE:
        return None
    height = float(np.median(z[np.abs(z - middle) < 3 * layer]))
    above = z > height + 6 * layer
    if above.sum() < FEWEST:
        return height if high - low < 12 * layer else None
    wide = _area(points[np.abs(z - height) < 3 * layer, :2])
    return height if wide > 2.0 * _area(points[above, :2]) else None


def _area(flat: FloatArray) -> float:
    """Area (m2) of the cells of 1 cm that points (n, 2) lie in."""
    return 1e-4 * len(np.unique(np.floor(flat / 0.01), axis=0))


def estimated_noise(points: FloatArray) -> float:
    """Standard deviation (m) of points from planes through their patches: the median of patches."""
    values, _, count = _patches(points, points[:: max(1, len(points) // 300)], 1.6 * PATCH)
    full = count >= 8
    if not full.any():
        return DEFAULT_NOISE
    spread = values[full, 0] * count[full] / (count[full] - 3)
    return min(max(float(np.sqrt(np.median(spread))), DEFAULT_NOISE), NOISIEST)


def estimated_normals(cloud: PointCloud) -> FloatArray:
    """Outward unit normals (n, 3) of planes through patches, towards the camera.

    Without views they look away from the cloud's middle, which only a convex object bears.
    """
    radius = max(PATCH, PATCH_NOISE * cloud.noise)
    normals = _patches(cloud.points, cloud.points, radius)[1][:, :, 0]
    towards = cloud.towards_camera
    if towards is None:
        towards = cloud.points - cloud.points.mean(axis=0)
    return np.where(np.einsum("nd,nd->n", normals, towards)[:, None] < 0, -normals, normals)


def _patches(
    points: FloatArray, at: FloatArray, radius: float
) -> tuple[FloatArray, FloatArray, IntArray]:
    """Of the points around places (n, 3): variances (n, 3), m2, ascending, axes (n, 3, 3), count.

    Points of a patch are as many as ``PATCH_POINTS``, all over it; five where it has fewer.
    """
    from scipy.spatial import cKDTree  # here: SciPy loads slowly

    share = 1
    tree = cKDTree(points)
    usual = np.median(
        tree.query_ball_point(at[:: max(1, len(at) // 50)], radius, return_length=True)
    )
    if usual > PATCH_POINTS:
        share = int(np.ceil(usual / PATCH_POINTS))
        points = points[::share]
        tree = cKDTree(points)
    k = min(2 * PATCH_POINTS, len(points))
    off, near = tree.query(at, k=k)
    within = (off < radius) | (np.arange(k) < 5)
    count = within.sum(axis=1)
    weight = (within / count[:, None])[:, :, None]
    around = points[near]
    around = around - (weight * around).sum(axis=1, keepdims=True)
    values, axes = np.linalg.eigh(np.einsum("nki,nkj->nij", weight * around, around))
    return np.maximum(values, 0.0), axes, count


def _without_table(cloud: PointCloud) -> PointCloud:
    """Without the points on the table, which become rays past the object, and below it."""
    if cloud.table is None:
        return cloud
    clear = max(3.0 * cloud.noise, 0.003)
    above = cloud.points[:, 2] > cloud.table + clear
    if above.sum() < FEWEST:
        raise ObjectError(
            f"{above.sum()} of {len(cloud)} points are more than {1e3 * clear:.0f} mm above the "
            f"table (z = {1e3 * cloud.table:.0f} mm): there is only a table; give a cloud with an "
            f"object of {FEWEST} points, or the table's height"
        )
    if above.all():
        return cloud
    on = ~above & (cloud.points[:, 2] > cloud.table - 2.0 * clear)
    if len(cloud.views):
        cloud = replace(
            cloud,
            past=np.concatenate([cloud.past, cloud.points[on]]),
            past_of=np.concatenate([cloud.past_of, cloud.view_of[on]]),
        )
    return cloud.only(above, f"{(~above).sum()} points of the table left out")


def _without_outliers(cloud: PointCloud) -> PointCloud:
    """Without points whose neighbours are far: drops of stereo, bleeding edges."""
    from scipy.spatial import cKDTree

    k = min(9, len(cloud))
    far = cKDTree(cloud.points).query(cloud.points, k=k)[0][:, 1:].mean(axis=1)
    middle = float(np.median(far))
    spread = 1.4826 * float(np.median(np.abs(far - middle))) + 0.1 * middle
    good = far < middle + OUTLYING * spread
    note = "" if good.all() else f"{(~good).sum()} outliers left out"
    return cloud.only(good, note)


def _one_object(cloud: PointCloud) -> PointCloud:
    """The largest group of points, or all large ones of one; what is much smaller is left out.

    Raises:
        ObjectError: A second group is large too, or the largest has too few points.
    """
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree

    spacing = float(np.median(cKDTree(cloud.points).query(cloud.points, k=2)[0][:, 1]))
    gap = max(GAP, 4.0 * spacing)
    cells, cell = np.unique(np.floor(2.0 * cloud.points / gap), axis=0, return_inverse=True)
    pairs = cKDTree(cells).query_pairs(2.01, output_type="ndarray")
    ones = np.ones(len(pairs))
    graph = coo_matrix((ones, (pairs[:, 0], pairs[:, 1])), shape=(len(cells), len(cells)))
    group = connected_components(graph, directed=False)[1][cell.ravel()]
    sizes = np.bincount(group)
    first, *others = np.argsort(-sizes)
    mine = sizes > SECOND * sizes[first]
    places = [
        f"{sizes[g]} points at {np.round(1e3 * cloud.points[group == g].mean(axis=0)).tolist()} mm"
        for g in (first, *others[: max(1, mine.sum() - 1)])
    ]
    if mine.sum() > 1 and not cloud.one:
        raise ObjectError(
            f"the cloud has two objects, {places[0]} and {places[1]}; cut out the points of the "
            "one to grasp and give the other as an obstacle"
        )
    if sizes[first] < FEWEST:
        raise ObjectError(
            f"the largest group of points has {sizes[first]}, {len(sizes)} groups in all, none "
            f"nearer than {1e3 * gap:.0f} mm; give at least {FEWEST} of an object"
        )
    taken = f"took {' and '.join(places[: mine.sum()])}"
    if mine.all():
        apart = f"{taken}, which lie apart, as one object, as its mask tells"
        return cloud.only(np.ones(len(cloud), dtype=bool), apart) if mine.sum() > 1 else cloud
    things = np.flatnonzero(~mine[group] & (sizes[group] >= THING))
    note = f"{taken}, left out {sizes[~mine].sum()} points of other things"
    return replace(
        cloud,
        past=np.concatenate([cloud.past, cloud.points[things]]),
        past_of=np.concatenate([cloud.past_of, cloud.view_of[things]]),
    ).only(mine[group], note)


def _check_size(cloud: PointCloud) -> None:
    """Refuse what no hand holds."""
    size = float(np.ptp(cloud.points, axis=0).max())
    if not SMALLEST < size < LARGEST:
        raise ObjectError(
            f"the object is {1e3 * size:.4g} mm long; {1e3 * SMALLEST:.0f} to {1e3 * LARGEST:.0f} "
            "mm can be grasped from a cloud: are the numbers in metres, and is it one object?"
        )


def _check_flat(cloud: PointCloud) -> None:
    """Refuse a plane, which bounds nothing but above a table."""
    centred = cloud.points - cloud.points.mean(axis=0)
    values, axes = np.linalg.eigh(centred.T @ centred / len(cloud))
    across = float(np.sqrt(max(values[0], 0.0)))
    if across < FLAT * cloud.noise and (cloud.table is None or abs(axes[2, 0]) < LEVEL):
        raise ObjectError(
            f"the points lie in one plane ({1e3 * across:.1f} mm across, noise "
            f"{1e3 * cloud.noise:.1f} mm), which bounds nothing; give another view, or, of a plane "
            "seen from above, the table's height"
        )


def _thinned(cloud: PointCloud, most: int) -> PointCloud:
    """At most ``most`` points, drawn at random: cells of a grid would favour far noise."""
    if len(cloud) <= most:
        return cloud
    drawn = np.random.default_rng(0).choice(len(cloud), most, replace=False)
    return cloud.only(np.sort(drawn))


def _places(name: str, value: Any) -> FloatArray:
    """Places (k, 3), none or several.

    Raises:
        ObjectError: Something else.
    """
    numbers = float_array(name, value, error=ObjectError)
    one = numbers[None] if numbers.shape == (3,) else numbers
    return _rows(name, one if numbers.size else np.zeros((0, 3)))


def _rows(what: str, value: Any) -> FloatArray:
    """Numbers (n, 3)."""
    array = float_array(what, value, error=ObjectError, wanted="an array of numbers (n, 3), m")
    if array.size == 0 and what == "points":
        raise ObjectError(f"the cloud is empty; give at least {FEWEST} points (n, 3) in m")
    if array.ndim != 2 or array.shape[1] != 3:
        raise ObjectError(f"{what} have shape {array.shape}; give (n, 3), m")
    return array


def _index(what: str, value: Any, n: int, views: int) -> IntArray:
    """Indices of views (n,)."""
    if value is None and n and views > 1:
        raise ObjectError(
            f"there are {views} views; say which saw what with {what}, ({n},) indices"
        )
    index = np.zeros(n, dtype=np.int64) if value is None else np.asarray(value)
    if index.shape != (n,) or index.dtype.kind not in "iu":
        raise ObjectError(f"{what} has shape {index.shape}; give {n} whole numbers")
    if n and not 0 <= index.min() <= index.max() < max(views, 1):
        raise ObjectError(f"{what} runs to {index.max()}; there are {views} views, from 0 on")
    return index.astype(np.int64)
