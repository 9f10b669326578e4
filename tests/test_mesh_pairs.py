"""Many geometries and one mesh: what is told of all is true of each; trees of triangles."""

from __future__ import annotations

from typing import Any

import coal
import numpy as np
import pinocchio as pin
import pytest

from planner.collision.mesh_distance import MeshPair
from planner.collision.mesh_pairs import MeshPairs
from planner.numerics.kernels import compile_loops
from planner.objects import parse_object
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


@pytest.mark.slow
@pytest.mark.parametrize("item", ["torus", "mug"])
def test_what_is_told_of_many_is_true_of_each(item: str) -> None:
    mesh = parse_object(item).shape
    assert isinstance(mesh, Mesh)
    many = MeshPairs(GEOMETRIES, mesh)
    alone = [MeshPair(g, mesh) for g in GEOMETRIES]
    which, deep, outer = np.arange(len(GEOMETRIES)), 0, 0
    here = poses(1, 99, 0.01)[0]
    for seed in range(8):
        places = poses(len(which), seed, 0.03 + 0.01 * (seed % 4))
        many.place(places, here)
        truth = np.array(
            [pair.distance(pose, here) for pair, pose in zip(alone, places, strict=True)]
        )
        limit = (0.005, 0.02)[seed // 4]
        assert_same(many.distances(which, limit), np.minimum(truth, limit))
        nearest = many.nearest(which, limit)
        assert (nearest is None) == (truth.min() >= limit)
        if nearest is not None:
            assert_same(np.array(nearest[1:]), truth.min(keepdims=True))
        near, apart, rows = many.near(which, limit)
        np.testing.assert_array_equal(near, np.flatnonzero(truth < limit))
        assert_same(apart, truth[near])
        off = rows[:, 3:6] - rows[:, :3] - apart[:, None] * rows[:, 6:]
        np.testing.assert_allclose(off[apart > 1e-4], 0.0, atol=2e-6)
        outer += int((apart > 1e-4).sum())
        few = many.smallest(which, np.array([0.004]), 3)
        least = np.sort(np.append(truth, 0.004))[2]
        assert_same(few[few < np.inf], truth[few < np.inf])
        assert (few[(truth < 0.0) | (truth < least - 2e-6)] < np.inf).all()
        deep += int((truth < 0.0).sum())
    assert deep > 5 and outer > 5
