"""The fast distances for fields: near the exact ones, never below, and of the right sign."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
import trimesh
from conftest import of_trimesh
from scipy.spatial import cKDTree

from planner.shapes import Cup, LBracket, Mesh, Mug, Torus
from planner.shapes.field_fit import grid_nodes
from planner.shapes.mesh_field import NEAR, Pyramid, SurfaceWalk, within_cells
from planner.spatial import FloatArray

STEP = 0.0015
"""Spacing (m) of the points from which walks begin."""


@cache
def example(name: str) -> Mesh:
    if name == "crowded":  # triangles much smaller than a step
        return of_trimesh(trimesh.creation.icosphere(subdivisions=5, radius=0.01))
    return {"mug": Mug, "torus": Torus, "lbracket": LBracket}[name]()


each_mesh = pytest.mark.parametrize("name", ["mug", "torus", "lbracket", "crowded"])


def points_about(mesh: Mesh) -> FloatArray:
    """Points all around, next to the surface, and far away."""
    rng = np.random.default_rng(0)
    surface, normals = mesh.surface_samples(1000, rng)
    return np.concatenate(
        [
            rng.uniform(-1.3, 1.3, (1000, 3)) * mesh.half_extents,
            surface + rng.normal(size=(1000, 1)) * 1e-3 * normals,
            rng.normal(size=(100, 3)) * 0.5,
        ]
    )


@each_mesh
@pytest.mark.parametrize("near", [True, False])
def test_walked_distances_are_almost_the_exact_ones(name: str, near: bool) -> None:
    mesh = example(name)
    points = points_about(mesh)
    exact = mesh.signed_distance(points)
    walk = SurfaceWalk(mesh._surface, STEP)
    walked, least = walk.signed(points, near=near)
    more = np.abs(walked) - np.abs(exact)
    assert more.min() > -1e-9  # a distance of a point of the surface
    # at a concave edge the walk may end on the farther of two faces
    assert more.max() < (1e-3 if near else 2e-3) and np.quantile(more, 0.95) < 5e-5
    told = np.abs(exact) > 1e-7
    np.testing.assert_array_equal(walked[told] < 0, exact[told] < 0)
    assert (least <= np.abs(exact) + 1e-9).all()
    if near:
        assert (np.abs(exact) - least).max() < walk.gap + 1e-9


@each_mesh
def test_no_point_of_the_surface_is_far_from_all_points(name: str) -> None:
    mesh = example(name)
    walk = SurfaceWalk(mesh._surface, STEP)
    surface, _ = mesh.surface_samples(2000, np.random.default_rng(1))
    away, _ = cKDTree(walk.points).query(surface)
    assert away.max() <= walk.gap
    if name == "crowded":
        assert len(walk.points) < len(mesh.faces) / 4


def test_nodes_next_to_cells_are_marked() -> None:
    rng = np.random.default_rng(2)
    shape, reach = (9, 7, 8), 2
    cells = rng.integers(-4, 12, (6, 3))
    marks = within_cells(cells, shape, reach)
    for node in np.ndindex(*shape):
        # cell k spans from k to k + 1
        steps = np.maximum(cells - node, np.array(node) - cells - 1).max(axis=1) + 1
        assert marks[node] == (steps.min() <= reach)


def test_a_pyramid_measures_near_the_surface_and_interpolates_the_rest() -> None:
    radius, h = 0.02, 0.002
    ball = of_trimesh(trimesh.creation.icosphere(subdivisions=4, radius=radius))
    asked: list[int] = []

    def measure(points: FloatArray, near: bool) -> FloatArray:
        asked.append(len(points))
        return np.asarray(np.linalg.norm(points, axis=1) - radius)

    pyramid = Pyramid(measure, SurfaceWalk(ball._surface, h).points, h)
    for first, count, times in ((-20, 41, 8), (-30, 60, 2), (-25, 51, 1)):
        corner, shape = np.full(3, first), (count,) * 3
        values = pyramid.sample(corner, shape, times * h)
        true = np.linalg.norm(grid_nodes(corner, shape, times * h), axis=1) - radius
        off = np.abs(values.ravel() - true)
        measured = pyramid.measured.ravel()
        assert off[measured].max() < 1e-12
        assert measured[np.abs(true) < (NEAR[0] - 1) * times * h].all()
        # what is interpolated is a small share of the spacing off
        outside = true > 0
        assert off[outside].max() < 0.2 * times * h and np.median(off) < 0.02 * times * h
    assert asked[-1] == pyramid.measured.sum() < 0.2 * pyramid.measured.size


def test_far_in_front_of_a_thin_wall_is_outside() -> None:
    """Walks end on the back of a wall, in front of which points were inside by up to 28 mm."""
    cup = Cup()
    around = np.random.default_rng(0).uniform(-1.5, 1.5, (3000, 3)) * cup.half_extents
    exact = cup.signed_distance(around)
    walked, _ = SurfaceWalk(cup._surface, STEP).signed(around, near=False)
    np.testing.assert_allclose(walked, exact, atol=2.1e-3)
    told = np.abs(exact) > 1e-7
    np.testing.assert_array_equal(walked[told] < 0, exact[told] < 0)
