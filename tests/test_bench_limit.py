"""The best epsilon without a hand: on a sphere it is known."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from benchmarks.limit import best_contacts, measure, surface_points, tables
from planner.contacts import ContactSet
from planner.quality.ball import epsilon_l1
from planner.shapes import Box, Mesh, Sphere
from planner.shapes.base import EDGE_MARGIN

RADIUS, MU = 0.03, 0.5
TETRAHEDRON = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1.0]]) / np.sqrt(3)


def test_four_contacts_of_a_tetrahedron_on_a_sphere_have_mu_over_the_root_of_two() -> None:
    contacts = ContactSet.from_arrays(RADIUS * TETRAHEDRON, -TETRAHEDRON, mu=MU)
    low = epsilon_l1(contacts, length=RADIUS, edges=24)
    high = epsilon_l1(contacts, length=RADIUS, edges=24, cone="circumscribed")
    assert low <= MU / np.sqrt(2) <= high
    assert high - low < 0.005


@pytest.mark.slow
def test_the_search_comes_near_the_best_on_a_sphere_and_not_beyond() -> None:
    found = best_contacts(Sphere(RADIUS), 4, MU, 4.0, np.random.default_rng(0))
    assert 0.96 * MU / np.sqrt(2) < epsilon_l1(found, length=RADIUS, edges=16)
    assert epsilon_l1(found, length=RADIUS, edges=24) < MU / np.sqrt(2)


@pytest.mark.parametrize("of_triangles", [False, True])
def test_points_lie_on_the_surface_and_off_edges(of_triangles: bool) -> None:
    shape: Box | Mesh = Box((0.04, 0.06, 0.08))
    if of_triangles:
        cuboid = trimesh.creation.box((0.04, 0.06, 0.08))
        shape = Mesh(np.array(cuboid.vertices), np.array(cuboid.faces))
    points, normals = surface_points(shape, 300, np.random.default_rng(1))
    assert len(points) > 100
    np.testing.assert_allclose(shape.signed_distance(points), 0.0, atol=1e-9)
    # from the next face: the margin of patches; of triangles, what their normals differ by
    second = np.sort(np.array([0.02, 0.03, 0.04]) - np.abs(points), axis=1)[:, 1]
    assert second.min() >= (0.0005 if of_triangles else EDGE_MARGIN - 1e-9)
    np.testing.assert_allclose(np.abs(normals).max(axis=1), 1.0, atol=1e-9)


def test_a_table_says_which_share_of_the_limit_a_grasp_has() -> None:
    case = {"object": "ball", "spec": "sphere:0.03", "contacts": 4, "mu": MU}
    row = case | {"cpu_s": 0.3, "seed": 0, "ours": 0.1, "error": ""}
    row |= measure(row) | {"theirs": 0.05, "limit": 0.2}
    [table] = tables({"rows": [row], "setting": {"n": 4, "mu": MU}})
    assert table["rows"] == [["ball", "0.200", "0.100", "50", "0.050", "25"]]
