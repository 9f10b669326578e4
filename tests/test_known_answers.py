"""Known answers in places where faults put in at random went unnoticed."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from planner.describe.report import LEAST_HEIGHT, fitting_objects
from planner.objects import parse_object
from planner.synthesis.link_capsules import closest_on_segments
from planner.synthesis.terms.fingers import nearest
from sim.sensing.touch.estimate import GRID, ContactEstimate, TaxelFrictionEstimator


def test_nearest_points_of_segments_are_those_of_least_squares() -> None:
    """Both the loops and the arrays; segments cross, overlap, and are parallel or points."""
    rng = np.random.default_rng(0)
    ends = rng.normal(size=(4, 60, 3)) * rng.choice([0.02, 0.2], (4, 60, 1))
    ends[3, :10] = ends[2, :10] + ends[1, :10] - ends[0, :10]  # parallel
    ends[3, 10:15] = ends[2, 10:15]
    one, two = closest_on_segments(*ends)
    out = np.zeros((2, 3))
    for k in range(60):
        p1, q1, p2, q2 = ends[:, k]
        best = lsq_linear(np.column_stack([q1 - p1, p2 - q2]), p2 - p1, bounds=(0, 1), tol=1e-14)
        apart = float(np.sqrt(2 * best.cost))
        nearest(np.array([p1, p2, q1, q2]), 0, 1, 2, out)
        for a, b in ((one[k], two[k]), out):
            assert np.linalg.norm(b - a) == pytest.approx(apart, abs=1e-5)
            for point, p, q in ((a, p1, q1), (b, p2, q2)):  # each is on its segment
                way = np.linalg.norm(point - p) + np.linalg.norm(q - point)
                assert way == pytest.approx(np.linalg.norm(q - p), abs=1e-9)


@pytest.mark.parametrize(("ratio", "told"), [(0.49, False), (0.51, True)])
def test_a_touch_with_little_shear_tells_nothing_of_friction(ratio: float, told: bool) -> None:
    """Below half of the least friction that is looked for, the spread of shear is noise."""
    watch = TaxelFrictionEstimator([0.002])
    before = watch.friction.copy()
    seen: Any = ContactEstimate(
        normal_force=1.0,
        place=np.zeros(2),
        point=np.zeros(3),
        normal=np.array([0.0, 0.0, 1.0]),
        force=np.array([ratio * GRID[0], 0.0, 1.0]),
        torsion=0.0,
        pressure_spread=4e-6,
        shear_spread=6e-6,
    )
    watch.step(0.002, [seen], np.array([False]))
    assert bool((watch.friction != before).any()) == told


def test_objects_that_fit_a_hand_are_half_as_tall_again_as_wide() -> None:
    rows = (SimpleNamespace(name="pinch", gap=0.02), SimpleNamespace(name="open", gap=0.12))
    check: Any = SimpleNamespace(postures=rows)
    found = [parse_object(spec).shape for spec in fitting_objects(check)]
    width = 0.02 + 0.35 * 0.1
    for k, scale in enumerate((1.0, 0.75, 1.2)):
        cylinder, sphere, box = (2 * s.half_extents for s in found[3 * k : 3 * k + 3])
        tall = max(1.5 * scale * width, LEAST_HEIGHT)
        np.testing.assert_allclose(cylinder, [scale * width, scale * width, tall], atol=2e-3)
        np.testing.assert_allclose(sphere, scale * width, atol=2e-3)
        np.testing.assert_allclose(box, [0.85 * scale * width] * 2 + [tall], atol=2e-3)
