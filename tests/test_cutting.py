"""Where a mesh is cut, and which triangles a coarser mesh keeps: known answers and plain loops."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
import trimesh
from conftest import of_trimesh

from planner.shapes import Mesh, cutting
from planner.shapes.cutting import VOLUME_COST, Cell, Guards
from planner.shapes.hulls import Hull, hull_of
from planner.shapes.made import LBracket
from planner.shapes.meshes.triangles import clustered, simplified
from planner.shapes.pieces import TOLERANCE
from planner.spatial import FloatArray, IntArray


@pytest.fixture(scope="module")
def bracket() -> LBracket:
    return LBracket()


@pytest.fixture(scope="module")
def whole(bracket: LBracket) -> Hull:
    hull = hull_of(bracket.hull_vertices)
    assert hull is not None
    return hull


@pytest.fixture(scope="module")
def guards(bracket: LBracket, whole: Hull) -> Guards:
    return Guards(bracket, whole, TOLERANCE)


@pytest.fixture(scope="module")
def cell(bracket: LBracket, whole: Hull, guards: Guards) -> Cell:
    surface = bracket.vertices[bracket.faces]
    return Cell(surface=surface, walls=whole, hull=whole, bad=guards.within(whole))


@pytest.fixture(scope="module")
def faces(bracket: LBracket) -> FloatArray:
    """The two faces of the inner corner as planes (2, 4): along x and along z."""
    corner = bracket.vertices[0] + bracket.thickness
    return np.array([[1.0, 0.0, 0.0, corner[0]], [0.0, 0.0, 1.0, corner[2]]])


def test_guards_stand_off_the_inner_faces_only(guards: Guards, faces: FloatArray) -> None:
    """Outside of every other face there is no hull to reach into."""
    heights = guards.points @ faces[:, :3].T - faces[:, 3]
    np.testing.assert_allclose(heights.min(axis=1), TOLERANCE)
    feet = guards.feet @ faces[:, :3].T - faces[:, 3]
    np.testing.assert_allclose(feet.min(axis=1), 0.0, atol=1e-12)


def test_the_tangents_of_a_bracket_are_its_inner_faces(
    guards: Guards, cell: Cell, faces: FloatArray
) -> None:
    found = cutting._tangents(guards, cell, TOLERANCE)
    order = np.argsort(found[:, 2])
    np.testing.assert_allclose(found[order], faces, atol=1e-12)


def test_a_plane_across_stands_at_its_share_of_the_extent() -> None:
    corners = np.array([[-0.1, 0.0, 0.3], [0.3, 0.05, 0.5]])
    planes = cutting._across(corners, np.eye(3), np.array([0.25, 0.5]))
    expected = [0.0, 0.0125, 0.35, 0.1, 0.025, 0.4]
    np.testing.assert_allclose(planes[:, 3], expected)
    np.testing.assert_allclose(planes[:, :3], np.tile(np.eye(3), (2, 1)))


def test_an_inner_face_cuts_every_line_that_leaves_the_solid(
    bracket: LBracket, cell: Cell, faces: FloatArray
) -> None:
    points = cutting._spread(cell.surface)
    beside = np.array([[1.0, 0.0, 0.0, 1.0]])
    across = np.array([[0.0, 1.0, 0.0, 0.0]])  # through the middle: cuts half of all pairs
    cost = cutting._pair_cost(bracket, points, np.concatenate([faces, beside, across]), TOLERANCE)
    assert cost[2] == pytest.approx(1.0)  # all are left, none is spoilt
    assert cost[3] == pytest.approx(0.5 * (1 + cutting.STRAIGHT_COST), abs=0.05)
    # lines from one arm to the other are cut; what is spoilt is less than one pair in two
    assert (cost[:2] < 0.5 * cutting.STRAIGHT_COST).all()


def test_the_hulls_on_both_sides_of_an_inner_face_are_the_solid(
    bracket: LBracket, guards: Guards, cell: Cell, whole: Hull, faces: FloatArray
) -> None:
    points = cutting._spread(cell.surface)
    for plane in faces:
        cost = cutting._hull_cost(guards, cell, points, plane)
        assert cost == pytest.approx(VOLUME_COST * bracket.volume / whole.volume, rel=0.05)
    beside = np.array([1.0, 0.0, 0.0, 1.0])
    assert cutting._hull_cost(guards, cell, points, beside) == pytest.approx(1 + VOLUME_COST)


def test_the_best_plane_of_a_bracket_is_an_inner_face(
    bracket: LBracket, guards: Guards, cell: Cell, faces: FloatArray
) -> None:
    best = cutting._best_plane(bracket, guards, cell, TOLERANCE)
    assert best is not None
    assert np.abs(faces - best).max(axis=1).min() < 1e-9


def test_the_depth_of_a_cell_is_that_of_its_deepest_guard(guards: Guards, cell: Cell) -> None:
    depths = cell.hull.depths(guards.points[cell.bad])
    assert cutting._depth(guards, cell) == depths.max() > TOLERANCE
    none = Cell(surface=cell.surface, walls=cell.walls, hull=cell.hull, bad=cell.bad[:0])
    assert cutting._depth(guards, none) == 0.0


def plainly_clustered(mesh: Mesh, low: FloatArray, cell: float) -> tuple[FloatArray, IntArray]:
    """The same by a loop over triangles, with sets of cells as keys."""
    cells = [tuple(c) for c in np.floor((mesh.vertices - low) / cell).astype(int).tolist()]
    order = sorted(set(cells))
    number = np.array([order.index(c) for c in cells])
    means = np.array([mesh.vertices[number == k].mean(axis=0) for k in range(len(order))])
    kept: dict[frozenset[int], list[int]] = {}
    for triangle in number[mesh.faces].tolist():
        if len(set(triangle)) == 3:
            kept.setdefault(frozenset(triangle), triangle)
    return means, np.array(list(kept.values()))


@pytest.mark.parametrize("cell", [0.004, 0.013, 0.03])
def test_a_coarser_mesh_keeps_each_triangle_between_cells_once(cell: float) -> None:
    ball = of_trimesh(trimesh.creation.icosphere(subdivisions=3, radius=0.04))
    low = ball.vertices.min(axis=0)
    vertices, triangles = clustered(ball.vertices, ball.faces, low, cell)
    means, plain = plainly_clustered(ball, low, cell)
    np.testing.assert_allclose(vertices, means, atol=1e-15)
    np.testing.assert_array_equal(triangles, plain)


@pytest.mark.parametrize("most", [200, 1000])
def test_a_coarser_mesh_has_nearly_as_many_triangles_as_are_allowed(most: int) -> None:
    ball = of_trimesh(trimesh.creation.icosphere(subdivisions=4, radius=0.04))
    vertices, triangles, changed = simplified(ball.vertices, ball.faces, most)
    assert changed and 0.7 * most <= len(triangles) <= most
    corners = vertices[triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = float(np.linalg.norm(normals, axis=1).sum() / 2)
    assert area == pytest.approx(4 * np.pi * 0.04**2, rel=0.1)
    assert not simplified(ball.vertices, ball.faces, len(ball.faces))[2]


def test_triangles_of_other_corners_are_not_taken_for_doubles() -> None:
    """All 220 triples of 12 cells, and each once more, turned round."""
    vertices = np.random.default_rng(0).permutation(12)[:, None] * np.array([1.0, 0.3, 2.0])
    triples = np.array(list(combinations(range(12), 3)))
    _, kept = clustered(
        vertices, np.concatenate([triples, triples[:, ::-1]]), vertices.min(axis=0), 0.5
    )
    assert len(kept) == len({frozenset(t) for t in kept.tolist()}) == len(triples)


@pytest.mark.parametrize(("thickness", "small"), [(0.07, True), (0.02, False)])
def test_planes_are_tried_through_a_hollow_that_is_small(
    thickness: float, small: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    mesh = LBracket(length=0.1, height=0.08, width=0.03, thickness=thickness)
    hull = hull_of(mesh.hull_vertices)
    assert hull is not None
    guards = Guards(mesh, hull, TOLERANCE)
    surface = mesh.vertices[mesh.faces]
    cell = Cell(surface=surface, walls=hull, hull=hull, bad=guards.within(hull))
    tried: list[FloatArray] = []
    across = cutting._across

    def noted(points: FloatArray, axes: FloatArray, shares: FloatArray) -> FloatArray:
        tried.append(across(points, axes, shares))
        return tried[-1]

    monkeypatch.setattr(cutting, "_across", noted)
    assert cutting._best_plane(mesh, guards, cell, TOLERANCE) is not None
    assert (len(tried) == 2) == small
    if small:  # all of them pass between its guards
        heights = guards.points[cell.bad] @ tried[1][:, :3].T - tried[1][:, 3]
        assert (heights.min(axis=0) < 0).all() and (heights.max(axis=0) > 0).all()
