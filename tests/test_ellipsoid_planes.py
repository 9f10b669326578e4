"""Ellipsoid next to its planes of symmetry."""

from __future__ import annotations

import numpy as np
import pytest

from planner.shapes import Ellipsoid


@pytest.mark.parametrize("nudge", [0.0, 1e-300, 1e-20, 1e-16, 1e-12, 1e-10, 1e-9])
def test_ellipsoid_is_exact_next_to_its_planes_of_symmetry(nudge: float) -> None:
    """Centre and short axis, where the nearest point jumps; the focal curve, where it is unsure."""
    ellipsoid = Ellipsoid((0.09, 0.07, 0.06))
    a, _, c = ellipsoid.half_extents
    focal = (a**2 - c**2) / a
    points = np.array([[0, 0, 0], [0, 0, 0.01], [0.001, 0, 0], [focal, 0, 0], [0.04, 0, 0]]) + nudge
    # in the plane y = 0: x < focal goes to (a^2 x/(a^2 - c^2), 0, z), beyond it to the vertex
    x = points[2, 0]
    expected = [-c, -(c - 0.01), -c * np.sqrt(1 - x**2 / (a**2 - c**2)), -(a - focal), -(a - 0.04)]
    distance = ellipsoid.signed_distance(points)
    np.testing.assert_allclose(distance, expected, rtol=0, atol=4 * nudge + 1e-16)
    surface, normals = ellipsoid.closest_point(points)
    np.testing.assert_allclose(points, surface + distance[:, None] * normals, rtol=0, atol=2e-17)
