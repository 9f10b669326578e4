"""``Belief``: the surface of a cloud as a Gaussian process over hypotheses of the whole object.

Hypothesis k gives a signed distance F_k on a grid (``planner.clouds.sight``). The surface is the
zero level of

    f_k(p) = F_k(p) + g(p),    g ~ GP(0, s(p) s(q) Matern52(|p - q| / l)),

conditioned on f_k = 0, with the standard deviation that the cloud's own scatter gives, at a few
hundred places where a quadric was fitted to the points around, and on f_k = ``BEFORE`` so far
before each, so that f_k rises as a distance does and its deviation is one in metres. The prior's s
is small where all hypotheses agree and as large as they differ elsewhere: so is the standard
deviation behind.
Where a camera saw through, f_k is positive whatever the process says.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from planner.clouds.cloud import PointCloud, prepared
from planner.clouds.hollow import lidded
from planner.clouds.sight import Grid, Hypothesis, Sight, hypotheses
from planner.errors import ObjectError
from planner.shapes import Mesh
from planner.spatial import SE3, FloatArray, IntArray, contact_frames

CONDITIONS = 320
"""Places at which the process is conditioned, about."""

CLOSEST, WINDOW = 0.0035, 1.4
"""Least distance (m) of these places, and radius of the fit around each over their distance."""

CORRELATED = 1.4
"""Deviation of a fit over that of independent points (-): pixels of a stereo camera share matching
windows. Set on scans; without it 60 % of the seen surface are within one deviation."""

FLOOR = 0.0004
"""Least standard deviation (m) of a place: what a quadric of some millimetres leaves out."""

BEFORE = 0.004
"""Distance (m) before a place at which the level is this distance: within what the ray of a camera
went through, and far enough that the scatter of places does not tilt it."""

AGREED = 0.003
"""Prior standard deviation (m) of the surface where all hypotheses agree."""

DIFFER = 0.015
"""Largest spread (m) of hypotheses that counts."""

LENGTH, SHORTEST = 0.28, 0.012
"""Length scale of the process over the longest side of what was seen (-), and the least (m)."""

BAND = 2.0
"""Cells of the mesh on both sides of a surface in which the process is evaluated."""

CERTAIN = 0.0045
"""Standard deviation (m) of the surface up to which a finger may touch it: half of its pad."""

ON_LID = 0.004
"""Distance (m) from points of a lid within which a finger would touch it: its points are as dense
as those of a camera."""

SHIFT_STEPS, LEAST_SHIFT = 3, 1e-6
"""Gauss-Newton steps (-) to the shift that touches tell: over some millimetres a surface is nearly
flat, so that a step leaves little; and least deviation (m) of a shift, for a finite weight."""

TOUCH = 0.002
"""Standard deviation (m) of the place of a touch: of a tip 10 cm from joints that are off by 1
degree each."""

LEAST_SLOPE = 0.5
"""Slope (-) of the mean below which it tells of no distance any more: between two surfaces."""

STEP = 0.003
"""Distance (m) over which slopes of the surface are taken: half of a fingertip's contact."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Belief:
    """What is known of a surface and how well; positions are in the object's frame.

    Attributes:
        cloud: The points, as they were used, in the cloud's frame.
        offset: Origin of the object's frame, its centre of mass, in the cloud's frame (3,), m.
        grid: Of the hypotheses; in the cloud's frame.
        sight: Free and hidden space; in the cloud's frame.
        hypotheses: What the object may be, the most plausible first.
        chosen: Which of them the object's mesh has.
        places: Conditions (m, 3), m, in the cloud's frame.
        deviations: Their standard deviations (m,), m.
        before: Points (m, 3), m, ``BEFORE`` before the places, NaN where there is none.
        lid: Points (k, 3), m, on the mouth of a hollow, where nothing is to be touched.
        length: Length scale of the process, m.
    """

    cloud: PointCloud
    offset: FloatArray
    grid: Grid
    sight: Sight
    hypotheses: tuple[Hypothesis, ...]
    chosen: int
    places: FloatArray
    deviations: FloatArray
    before: FloatArray
    lid: FloatArray
    length: float

    @classmethod
    def of(cls, cloud: PointCloud) -> Belief:
        """The belief that a cloud gives, with the origin of the cloud's frame.

        Raises:
            ObjectError: The cloud is not usable (``planner.clouds.cloud.prepared``), or explains no
                solid.
        """
        used, lid = lidded(prepared(cloud))
        grid, sight, found = hypotheses(used)
        if not found:
            raise ObjectError(
                "no solid explains the cloud: its views see through one another's points; check "
                "that the views are in one frame, or give a larger noise"
            )
        places, deviations, before = fitted_places(used)
        longest = float(np.ptp(used.points, axis=0).max())
        return cls(
            cloud=used,
            offset=np.zeros(3),
            grid=grid,
            sight=sight,
            hypotheses=found,
            chosen=0,
            places=places,
            deviations=deviations,
            before=before,
            lid=lid,
            length=max(LENGTH * longest, SHORTEST),
        )

    def of_hypothesis(self, number: int) -> tuple[Belief, Mesh]:
        """The same about another hypothesis, and its mesh, which has the belief's frame.

        Raises:
            ObjectError: Its surface bounds no solid.
        """
        mesh = _level_mesh(self.grid, self._levels[number])
        return replace(self, chosen=number, offset=np.array(mesh.offset)), mesh

    @property
    def T_world_object(self) -> SE3:
        """Pose of the object in the cloud's frame."""
        return SE3(np.eye(3), self.offset)

    @property
    def hypothesis(self) -> Hypothesis:
        """The chosen one."""
        return self.hypotheses[self.chosen]

    def mean(self, points: FloatArray, hypothesis: int | None = None) -> FloatArray:
        """Mean signed distance (n,), m, of points (n, 3), about; positive outside."""
        k = self.chosen if hypothesis is None else hypothesis
        return self._mean(points + self.offset, k)

    def means(self, points: FloatArray) -> FloatArray:
        """``mean`` of every hypothesis (k, n), m."""
        return self._means(points + self.offset)

    def gradient(self, points: FloatArray, hypothesis: int | None = None) -> FloatArray:
        """Gradient (n, 3) of the mean, by central differences of ``STEP``."""
        steps = STEP * np.concatenate([np.eye(3), -np.eye(3)])
        around = (points[:, None] + steps).reshape(-1, 3)
        values = self.mean(around, hypothesis).reshape(-1, 6)
        return (values[:, :3] - values[:, 3:]) / (2.0 * STEP)

    def deviation(self, points: FloatArray) -> FloatArray:
        """Standard deviation (n,), m, of the surface at points (n, 3) on it.

        Of the process, and of what the hypotheses differ there, over the slope of the mean: at
        walls thinner than ``STEP`` the level rises less than a distance.
        """
        p = points + self.offset
        scale = self._scale(p)
        reduced = self._solved(scale[:, None] * self._correlation(p) * self._scales)
        own = np.maximum(scale**2 - (reduced**2).sum(axis=0), 0.0)
        means = self._means(p)
        off = np.clip(means - means[self.chosen], -DIFFER, DIFFER)
        between = (self._weights[:, None] * off**2).sum(axis=0)
        slope = np.linalg.norm(self.gradient(points), axis=1)
        return np.asarray(np.sqrt(own + between) / np.clip(slope, LEAST_SLOPE, 1.0))

    def certain(self, points: FloatArray) -> FloatArray:
        """Whether a finger may touch there, (n,): ``deviation`` is at most ``CERTAIN``, no lid."""
        p = np.asarray(points, dtype=np.float64)
        good = self.deviation(p) <= CERTAIN
        if len(self.lid):
            good &= _distances(p + self.offset, self.lid).min(axis=1) > ON_LID
        return np.asarray(good)

    def samples(self, points: FloatArray, count: int, rng: np.random.Generator) -> FloatArray:
        """Errors (count, n) of the process at points (n, 3), m, with their correlation."""
        p = points + self.offset
        scale = self._scale(p)
        prior = scale[:, None] * _matern(_distances(p, p) / self.length) * scale
        reduced = self._solved(scale[:, None] * self._correlation(p) * self._scales)
        values, axes = np.linalg.eigh(prior - reduced.T @ reduced)
        root = axes * np.sqrt(np.maximum(values, 0.0))
        return np.asarray(rng.normal(size=(count, len(p))) @ root.T)

    def with_felt(self, points: FloatArray, shift: float) -> tuple[Belief, FloatArray]:
        """The belief once a hand has felt the surface at points (m, 3), and how it is shifted (3,).

        The shift, along the table, m, is what brings the believed surface to the points within its
        deviation and ``TOUCH``; beside it the points are conditions, and weigh hypotheses.

        Args:
            points: Where it was felt, m, in the object's frame as it was believed.
            shift: Standard deviation of the object's place along each axis, m.
        """
        if not len(points):
            return self, np.zeros(3)
        moved = np.zeros(3)
        axes = np.eye(3)[:, : 2 if self.cloud.table is not None else 3]
        variance = self.deviation(points) ** 2 + TOUCH**2
        gram = np.eye(axes.shape[1]) / max(shift, LEAST_SHIFT) ** 2
        for _ in range(SHIFT_STEPS):
            at = points - moved
            rows = self.gradient(at) @ axes
            left = self.mean(at) + rows @ (axes.T @ moved)
            normal = gram + (rows / variance[:, None]).T @ rows
            moved = axes @ np.linalg.solve(normal, rows.T @ (left / variance))
        at = points - moved
        sure = np.sqrt(TOUCH**2 + np.einsum("mi,ij,mj->m", rows, np.linalg.inv(normal), rows))
        off = self.means(at)
        weights = self._weights * np.exp(-0.5 * (off**2 / (sure**2 + AGREED**2)).sum(axis=1))
        weights = weights / weights.sum() if weights.sum() > 0.0 else self._weights
        others = tuple(
            replace(h, weight=float(w)) for h, w in zip(self.hypotheses, weights, strict=True)
        )
        return replace(
            self,
            hypotheses=others,
            places=np.vstack([self.places, at + self.offset]),
            deviations=np.concatenate([self.deviations, sure]),
            before=np.vstack([self.before, np.full(at.shape, np.nan)]),
        ), moved

    @cached_property
    def _weights(self) -> FloatArray:
        return np.array([h.weight for h in self.hypotheses])

    @cached_property
    def _spread(self) -> FloatArray:
        """Standard deviation (nx, ny, nz), m, of the hypotheses, which are cut off far away."""
        cut = np.stack([np.clip(h.distance, -DIFFER, DIFFER) for h in self.hypotheses])
        weights = self._weights[:, None, None, None]
        mean = (weights * cut).sum(axis=0)
        return np.asarray(np.sqrt((weights * (cut - mean) ** 2).sum(axis=0)))

    def _scale(self, p: FloatArray) -> FloatArray:
        """Prior standard deviation s (n,), m."""
        return np.hypot(AGREED, np.minimum(self.grid.at(self._spread, p), DIFFER))

    @cached_property
    def _with_before(self) -> IntArray:
        """Numbers of the places before which there is a point."""
        return np.flatnonzero(np.isfinite(self.before).all(axis=1))

    @cached_property
    def _conditions(self) -> FloatArray:
        """Places and the points before them, (c, 3)."""
        return np.vstack([self.places, self.before[self._with_before]])

    @cached_property
    def _scales(self) -> FloatArray:
        return self._scale(self._conditions)

    def _correlation(self, p: FloatArray) -> FloatArray:
        return _matern(_distances(p, self._conditions) / self.length)

    @cached_property
    def _root(self) -> FloatArray:
        """Lower Cholesky factor (c, c) of the conditions' covariance.

        A point before a place is off by the same as the place, and ``FLOOR``.
        """
        prior = self._scales[:, None] * self._correlation(self._conditions) * self._scales
        own = np.concatenate([np.arange(len(self.places)), self._with_before])
        same = own[:, None] == own
        noise = np.where(same, self.deviations[own] ** 2, 0.0)
        noise += np.diag(np.where(np.arange(len(own)) < len(self.places), 0.0, FLOOR**2))
        return np.asarray(np.linalg.cholesky(prior + noise), np.float64)

    def _solved(self, cross: FloatArray) -> FloatArray:
        """L^-1 C' (c, n) of cross covariances C (n, c)."""
        from scipy.linalg import solve_triangular

        return np.asarray(solve_triangular(self._root, cross.T, lower=True, check_finite=False))

    @cached_property
    def _alphas(self) -> FloatArray:
        """Weights (k, c) of the conditions for each hypothesis, times their scales."""
        from scipy.linalg import cho_solve

        level = np.where(np.arange(len(self._conditions)) < len(self.places), 0.0, BEFORE)
        at = [self.grid.at(h.distance, self._conditions) for h in self.hypotheses]
        off = np.stack([level - here for here in at], axis=1)
        solved = cho_solve((self._root, True), off, check_finite=False)
        return np.asarray(solved.T * self._scales)

    def _mean(self, p: FloatArray, k: int) -> FloatArray:
        scaled = self._scale(p) * (self._correlation(p) @ self._alphas[k])
        return np.asarray(self._prior(p, k) + scaled)

    def _means(self, p: FloatArray) -> FloatArray:
        prior = np.stack([self._prior(p, k) for k in range(len(self.hypotheses))])
        return np.asarray(prior + self._scale(p) * (self._alphas @ self._correlation(p).T))

    def _prior(self, p: FloatArray, k: int) -> FloatArray:
        prior = self.grid.at(self.hypotheses[k].distance, p)
        beyond = self.grid.beyond(p)  # every hypothesis is in the grid
        return np.where(beyond > 0.0, np.hypot(prior, beyond), prior)

    @cached_property
    def _levels(self) -> tuple[FloatArray, ...]:
        """Mean (nx, ny, nz), m, of each hypothesis at every ``COARSER``-th node of the grid."""
        every = (slice(None, None, COARSER),) * 3
        nodes = self.grid.nodes.reshape(*self.grid.shape, 3)[every]
        shape, nodes = nodes.shape[:3], nodes.reshape(-1, 3)
        distances = np.stack([h.distance[every].ravel() for h in self.hypotheses])
        step = COARSER * self.grid.spacing
        near = np.flatnonzero((np.abs(distances) < BAND * step).any(axis=0))
        levels = distances.copy()
        p = nodes[near]
        levels[:, near] += self._scale(p) * (self._alphas @ self._correlation(p).T)
        free = self.sight.behind(nodes) < -3.0 * self.cloud.noise - step
        levels[:, free] = np.maximum(levels[:, free], 0.15 * step)
        if self.cloud.table is not None:  # on it, not in it: a hand keeps clear of where it is
            levels = np.maximum(levels, self.cloud.table - nodes[:, 2])
        return tuple(level.reshape(shape) for level in levels)


def fitted_places(cloud: PointCloud) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Places (m, 3) on quadrics through the points around them, and their deviations (m,), m.

    Also the points ``BEFORE`` each along the normal (m, 3), NaN where another part is nearer.
    """
    from scipy.spatial import cKDTree

    points, normals = cloud.points, cloud.normals
    assert normals is not None, "a prepared cloud has normals"
    tree = cKDTree(points)
    area = float(np.median(tree.query(points, k=min(9, len(points)))[0][:, -1])) ** 2 * np.pi / 8
    apart = max(np.sqrt(area * len(points) / CONDITIONS), CLOSEST)
    centers = points[_spread_out(points, apart)]
    radius = max(WINDOW * apart, 3.0 * cloud.noise)
    k = min(len(points), MOST_FITTED)
    off, near = tree.query(centers, k=k)
    weight = np.exp(-0.5 * (off / (0.6 * radius)) ** 2) * (off < radius)
    enough = (weight > 0).sum(axis=1) >= FEWEST_FITTED
    centers, weight, near = centers[enough], weight[enough], near[enough]
    inward = -(weight[:, :, None] * normals[near]).sum(axis=1)
    frames = contact_frames(inward)
    local = np.einsum("nkd,nde->nke", points[near] - centers[:, None], frames)
    height, u, v = local[..., 0], local[..., 1], local[..., 2]
    rows = np.stack([np.ones_like(u), u, v, u * u, u * v, v * v], axis=-1)
    size = np.array([1.0, radius, radius, radius**2, radius**2, radius**2])
    rows = rows / size
    normal = np.einsum("nki,nk,nkj->nij", rows, weight, rows) + 1e-6 * np.eye(6)
    inverse = np.linalg.inv(normal)
    fit = np.einsum("nij,nkj,nk,nk->ni", inverse, rows, weight, height)
    left = height - np.einsum("nki,ni->nk", rows, fit)
    total = weight.sum(axis=1)
    scatter = (weight * left**2).sum(axis=1) / total
    own = np.maximum(scatter, 0.25 * cloud.noise**2)
    # each point takes part in several fits, whose errors are then not independent
    shared = (np.pi * (0.6 * radius) ** 2 * 2.0) / (np.pi * apart**2 / 4.0)
    doubled = np.einsum("nki,nk,nkj->nij", rows, weight**2, rows)
    leverage = np.einsum("ni,nij,nj->n", inverse[:, 0], doubled, inverse[:, 0])
    variance = own * leverage * max(shared, 1.0)
    deviations = np.sqrt(CORRELATED**2 * variance + FLOOR**2)
    moved = fit[:, :1] * frames[:, :, 0]
    good = np.linalg.norm(moved, axis=1) < radius
    places, deviations = (centers + moved)[good], deviations[good]
    slope = fit[good, 1:3] / radius
    outward = -frames[good, :, 0] + np.einsum("nij,nj->ni", frames[good][:, :, 1:], slope)
    before = places + BEFORE * outward / np.linalg.norm(outward, axis=1)[:, None]
    before[tree.query(before)[0] < NEARER * BEFORE] = np.nan
    return places, deviations, before


NEARER = 0.75
"""Share (-) of ``BEFORE`` within which a point before a place has another part of the surface."""


MOST_FITTED, FEWEST_FITTED = 160, 8
"""Points to which a quadric is fitted, at most and at least."""


def _spread_out(points: FloatArray, apart: float) -> Any:
    """Numbers of points none of which are nearer to each other than so much (m)."""
    from scipy.spatial import cKDTree

    tree = cKDTree(points)
    open_, kept = np.ones(len(points), dtype=bool), []
    for number in np.random.default_rng(0).permutation(len(points)):
        if open_[number]:
            kept.append(number)
            open_[tree.query_ball_point(points[number], apart)] = False
    return np.array(kept)


def _distances(a: FloatArray, b: FloatArray) -> FloatArray:
    from scipy.spatial.distance import cdist

    return np.asarray(cdist(a, b))


def _matern(r: FloatArray) -> FloatArray:
    """Matern correlation of smoothness 5/2 at distances over the length scale."""
    x = 5.0**0.5 * r
    return np.asarray((1.0 + x + x * x / 3.0) * np.exp(-x))


def _level_mesh(grid: Grid, level: FloatArray) -> Mesh:
    """The largest part of the zero level of ``Belief._levels``, in the grid's frame.

    Marching tetrahedra: closed and without crossings, whatever the values are.
    """
    import trimesh

    some = np.pad(level, 1, constant_values=grid.spacing)  # closed at the border too
    shape, h = np.array(some.shape), COARSER * grid.spacing
    values, stride = some.ravel(), np.array([shape[1] * shape[2], shape[2], 1])
    solid = np.lib.stride_tricks.sliding_window_view(some < 0, (2, 2, 2)).sum(axis=(3, 4, 5))
    base = np.argwhere((solid > 0) & (solid < 8)) @ stride
    tets = np.concatenate([base[:, None] + np.cumsum(stride[list(path)]) for path in PATHS])
    tets = np.concatenate([np.tile(base, len(PATHS))[:, None], tets], axis=1)
    # inside corners first, so that three cases are left
    tets = np.take_along_axis(tets, np.argsort(values[tets] >= 0, axis=1, kind="stable"), axis=1)
    count = (values[tets] < 0).sum(axis=1)
    ends, owner = [], []
    for n, triangles in CASES.items():
        for triangle in triangles:
            ends.append(tets[count == n][:, np.array(triangle)])
            owner.append(tets[count == n])
    edges, tet = np.sort(np.concatenate(ends), axis=2), np.concatenate(owner)
    keys, faces = np.unique(edges[..., 0] * values.size + edges[..., 1], return_inverse=True)
    faces = faces.reshape(-1, 3)
    low, high = keys // values.size, keys % values.size

    def place(node: Any) -> FloatArray:
        return np.stack(np.unravel_index(node, some.shape), axis=-1).astype(np.float64)

    share = np.clip(values[low] / (values[low] - values[high]), *SLIVER)[:, None]
    vertices = (1.0 - share) * place(low) + share * place(high)
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    inside = (values[tet] < 0)[..., None]
    at = place(tet)
    outward = np.where(inside, 0.0, at).sum(axis=1) / (~inside).sum(axis=1)
    outward -= np.where(inside, at, 0.0).sum(axis=1) / inside.sum(axis=1)
    wrong = np.einsum("nd,nd->n", np.cross(b - a, c - a), outward) < 0
    faces[wrong] = faces[wrong][:, ::-1]
    whole = trimesh.Trimesh(grid.lower + h * (vertices - 1.0), faces, process=False)
    parts = whole.split(only_watertight=True)
    if not len(parts):
        raise ObjectError("the believed surface bounds no solid; give more views or less noise")
    largest = max(parts, key=lambda part: part.volume)
    return Mesh.from_triangles(np.array(largest.vertices), np.array(largest.faces))


COARSER = 2
"""Nodes of the hypotheses' grid from one node of the mesh's to the next."""

SLIVER = (0.04, 0.96)
"""Shares of an edge between which a vertex lies: no triangle is a sliver."""

PATHS = ((0, 1, 2), (0, 2, 1), (1, 0, 2), (1, 2, 0), (2, 0, 1), (2, 1, 0))
"""The six tetrahedra of a cell: paths along the axes from its first corner to its last."""

CASES = {
    1: (((0, 1), (0, 2), (0, 3)),),
    2: (((0, 2), (0, 3), (1, 3)), ((0, 2), (1, 3), (1, 2))),
    3: (((0, 3), (1, 3), (2, 3)),),
}
"""Corners inside, which come first -> triangles, each of three edges between corners."""
