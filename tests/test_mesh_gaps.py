"""Distances from triangles by compiled loops: exact, and those of NumPy and of coal."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import coal
import numpy as np
import pinocchio as pin
import pytest

from planner.numerics.kernels import attempt_kernels, compile_loops, compiled_searches
from planner.objects import parse_object
from planner.proximity import gap_loops, tree_kernels
from planner.proximity.bodies import ConvexBodies
from planner.proximity.mesh import MeshPair
from planner.proximity.mesh_pairs import MeshPairs
from planner.shapes import Mesh
from planner.shapes.hulls import convex_geometry
from planner.shapes.meshes import nearest_kernels
from planner.shapes.meshes.nearest_triangle import LEAF, BallTree
from planner.spatial import SE3, FloatArray

CORNERS = np.random.default_rng(4).normal(0.0, 0.01, (30, 3)) + np.array([0.01, 0.0, 0.0])
BODIES: dict[str, Any] = {
    "box": coal.Box(0.02, 0.03, 0.05),
    "plate": coal.Box(0.04, 0.04, 0.0005),
    "ball": coal.Sphere(0.012),
    "capsule": coal.Capsule(0.01, 0.04),
    "cylinder": coal.Cylinder(0.01, 0.03),
    "ellipsoid": coal.Ellipsoid(0.01, 0.02, 0.03),
    "hull": convex_geometry(CORNERS),
}
GEOMETRIES = list(BODIES.values())


def some_mesh() -> Mesh:
    shape = parse_object("torus").shape
    assert isinstance(shape, Mesh)
    return shape


def poses(count: int, seed: int, spread: float = 0.06) -> list[SE3]:
    rng = np.random.default_rng(seed)
    return [SE3(pin.exp3(rng.normal(size=3)), rng.normal(0.0, spread, 3)) for _ in range(count)]


def arrays_of(places: list[SE3]) -> tuple[FloatArray, FloatArray]:
    return np.array([p.rotation for p in places]), np.array([p.translation for p in places])


@pytest.mark.parametrize("count", [1, LEAF, 7, 100, 1000])
def test_balls_hold_their_triangles_and_leaves_all_of_them(count: int) -> None:
    rng = np.random.default_rng(count)
    corners = rng.normal(size=(count, 1, 3)) + 0.1 * rng.normal(size=(count, 3, 3))
    tree = BallTree.of(corners)
    assert sorted(tree.numbers) == list(range(count))
    np.testing.assert_array_equal(tree.corners, corners[tree.numbers])
    leaves = len(tree.first) - 1
    assert tree.first[0] == 0 and tree.first[-1] == count and len(tree.nodes) == 2 * leaves - 1
    assert np.diff(tree.first).max() <= LEAF

    def held(ball: FloatArray, inside: FloatArray) -> bool:
        return bool((np.linalg.norm(inside - ball[:3], axis=-1) <= ball[3]).all())

    of_node = [range(0, 0)] * len(tree.nodes)
    for i in reversed(range(len(tree.nodes))):
        leaf = i - leaves + 1
        of_node[i] = (
            range(tree.first[leaf], tree.first[leaf + 1])
            if leaf >= 0
            else range(of_node[2 * i + 1].start, of_node[2 * i + 2].stop)
        )
        assert held(tree.nodes[i], tree.corners[list(of_node[i])])
    assert all(held(b, c) for b, c in zip(tree.balls, tree.corners, strict=True))


def farthest(geometry: Any, direction: FloatArray) -> float:
    """Support (m) of a body along a direction, written once more."""
    d = direction
    if isinstance(geometry, coal.Sphere):
        return float(geometry.radius)
    if isinstance(geometry, coal.Capsule):
        return float(geometry.radius + geometry.halfLength * abs(d[2]))
    if isinstance(geometry, coal.Box):
        return float(np.abs(d) @ geometry.halfSide)
    if isinstance(geometry, coal.Cylinder):
        return float(geometry.radius * np.hypot(d[0], d[1]) + geometry.halfLength * abs(d[2]))
    if isinstance(geometry, coal.Ellipsoid):
        return float(np.linalg.norm(d * geometry.radii))
    return float((np.array(geometry.points()) @ d).max())


@pytest.mark.parametrize("name", BODIES)
def test_a_plane_between_body_and_triangle_proves_the_distance(name: str) -> None:
    """The nearest points tell that it is no more, the plane across them that it is no less."""
    bodies = ConvexBodies.of([BODIES[name]])
    assert bodies is not None
    rng, middle = np.random.default_rng(2), bodies.middles[0]
    core, radius = bodies.sizes[0, :3], bodies.sizes[0, 3]
    apart = 0
    for trial in range(200):
        corners = rng.normal(0.0, 0.05, 3) + rng.normal(0.0, 10 ** rng.uniform(-4, -1), (3, 3))
        if trial % 10 == 0:
            corners[2] = (corners[0] + corners[1]) / 2  # no area
        work = np.zeros((14, 4))
        given = bodies.kinds[0], core, bodies.points, 0, len(bodies.points), corners - middle
        loops: Any = gap_loops.gap_to_triangle
        found = loops(*given, np.inf, work)
        if found - radius <= 1e-6:
            continue
        apart += 1
        on_core, on_triangle = work[8, :3] + middle, work[9, :3] + middle
        normal = (on_triangle - on_core) / found
        assert np.linalg.norm(normal) == pytest.approx(1.0, abs=1e-9)
        between = (corners @ normal).min() - farthest(BODIES[name], normal)
        assert between == pytest.approx(found - radius, abs=1e-9)
        assert loops(*given, found, work) == pytest.approx(found, abs=1e-10)
        assert loops(*given, 0.9 * found, work) == 0.9 * found
    assert apart > 60


@pytest.mark.parametrize("known", [(), (0.3,), (0.001, 0.2, np.inf)])
@pytest.mark.parametrize("limit", [np.inf, 0.1])
def test_both_forms_of_the_gaps_agree(known: tuple[float, ...], limit: float) -> None:
    bodies = ConvexBodies.of(GEOMETRIES)
    assert bodies is not None
    gaps: Any = tree_kernels.gaps_to_triangles
    tree = some_mesh().ball_tree
    which = np.arange(len(GEOMETRIES))
    told = 0
    for seed in range(3):
        turns, shifts = arrays_of(poses(len(which), seed, 0.15))
        given = *bodies.arrays, which, turns, shifts, *tree.arrays, limit, 1e-5, np.array(known)
        quick, plain = compile_loops(gaps.loops)(*given), gaps.plain(*given)
        apart = plain[:, 0] > 0.0
        assert ((quick[:, 0] > 0.0) == apart).all()
        np.testing.assert_allclose(quick[apart, 0], plain[apart, 0], atol=1e-10)
        near = apart & np.isfinite(plain[:, 0])
        np.testing.assert_allclose(quick[near], plain[near], atol=1e-5)
        told += int(near.sum())
    assert told > 1


def test_both_forms_of_the_nearest_triangles_agree() -> None:
    tree = some_mesh().ball_tree
    arrays = tree.corners, tree.numbers, tree.balls, tree.nodes, tree.first
    points = np.random.default_rng(0).normal(0.0, 0.04, (40, 3))
    points[0] = tree.corners[3, 1]  # on a vertex: of all around it the first
    points[1] = tree.corners[5, :2].mean(axis=0)
    nearest: Any = nearest_kernels.nearest_triangles
    quick, plain = compile_loops(nearest.loops)(points, *arrays), nearest.plain(points, *arrays)
    np.testing.assert_allclose(quick[0], plain[0], atol=1e-14)
    np.testing.assert_array_equal(quick[1], plain[1])
    np.testing.assert_array_equal(quick[2], plain[2])
    within: Any = nearest_kernels.triangles_within
    for radius in (0.002, 0.02):  # of the second, more than the first arrays hold
        given = plain[0], radius, *arrays
        found, all_of = compile_loops(within.loops)(*given), within.plain(*given)
        assert len(found[0]) > 100
        assert set(zip(*map(list, found), strict=True)) == set(zip(*map(list, all_of), strict=True))
        assert len(found[0]) == len(all_of[0])


def assert_same(told: FloatArray, truth: FloatArray) -> None:
    """Apart to coal's accuracy, and together where they are."""
    assert ((told > 0.0) == (truth > 0.0)).all()
    apart = truth > 0.0
    np.testing.assert_allclose(told[apart], truth[apart], atol=2e-6)


def compiled(answer: Callable[..., Any]) -> Callable[..., Any]:
    """The same with compiled kernels."""

    def call(*given: Any) -> Any:
        with compiled_searches(), attempt_kernels(0):
            return answer(*given)

    return call


@pytest.mark.parametrize("item", ["torus", "mug"])
def test_meshes_are_as_far_as_coal_says(item: str) -> None:
    mesh = parse_object(item).shape
    assert isinstance(mesh, Mesh)
    quick = MeshPairs(GEOMETRIES, mesh)
    singles = [MeshPair(g, mesh) for g in GEOMETRIES]
    by_coal = MeshPairs(GEOMETRIES, mesh)
    alone = [MeshPair(g, mesh) for g in GEOMETRIES]
    which, deep, near, off = np.arange(len(GEOMETRIES)), 0, 0, 0
    here = poses(1, 99, 0.01)[0]
    for seed in range(12):
        places = poses(len(which), seed, 0.03 + 0.01 * (seed % 4))
        quick.place(places, here)
        by_coal.place(places, here)
        truth = np.array(
            [pair.distance(pose, here) for pair, pose in zip(alone, places, strict=True)]
        )
        told = np.array(
            [compiled(one.distance)(pose, here) for one, pose in zip(singles, places, strict=True)]
        )
        assert_same(told, truth)
        for limit in (0.005, 0.02):
            found = compiled(quick.distances)(which, limit)
            assert_same(found, np.minimum(truth, limit))
            nearest, real = compiled(quick.nearest)(which, limit), by_coal.nearest(which, limit)
            assert (nearest is None) == (real is None)
            if nearest is not None and real is not None:
                assert_same(np.array(nearest[1:]), np.array(real[1:]))
            places_near, apart, rows = compiled(quick.near)(which, limit)
            same, real_apart, real_rows = by_coal.near(which, limit)
            np.testing.assert_array_equal(places_near, same)
            assert_same(apart, real_apart)
            outside = apart > 1e-4
            np.testing.assert_allclose(
                rows[outside, 3:6] - rows[outside, :3],
                apart[outside, None] * rows[outside, 6:],
                atol=1e-9,
            )
            np.testing.assert_allclose(rows[outside, 6:], real_rows[outside, 6:], atol=0.02)
            near += int(outside.sum())
        few = compiled(quick.smallest)(which, np.array([0.004]), 3)
        least = np.sort(np.append(truth, 0.004))[2]
        expected = np.where((truth < 0.0) | (truth <= least), truth, np.inf)
        kept = (few < np.inf) & (few > 1e-5 + 5e-6)
        assert_same(few[few < np.inf], truth[few < np.inf])
        assert (kept <= (expected < np.inf)).all() and (few[expected < 0.0] < 0.0).all()
        inside = truth < 0.0
        deep += int(inside.sum())
        off += int((np.abs(told - truth)[inside] > 5e-6 - 0.01 * truth[inside]).sum())
    assert deep > 5 and near > 5
    assert off <= 0.1 * deep  # the descent to a short way out may end at another one
