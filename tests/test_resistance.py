"""Resistance in many directions at once against the expression, paper and steps."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planner.contacts import ContactSet
from planner.quality import epsilon_l1
from planner.spatial import FloatArray, IntArray
from planner.synthesis.symbols import support
from planner.synthesis.terms.resistance import SAMPLE, least_resisted, missing_resistance

MU, LENGTH = 0.7, 1.3


def on_sphere(points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Normals (n, 3) about a unit sphere, not of unit length off it, and their derivatives."""
    radii = np.linalg.norm(points, axis=1)[:, None]
    normals = points / np.sqrt(radii)
    unit = points / radii
    slopes = (np.eye(3) - unit[:, :, None] * unit[:, None, :] / 2) / np.sqrt(radii)[:, :, None]
    return normals, slopes


def missing(
    points: FloatArray, directions: FloatArray, aim: float
) -> tuple[FloatArray, FloatArray, IntArray]:
    """Rows at contacts about a sphere."""
    normals, slopes = on_sphere(points)
    return missing_resistance(directions, points, normals, slopes, mu=MU, length=LENGTH, target=aim)


@settings(max_examples=60)
@given(st.integers(0, 10_000))
def test_values_are_those_of_the_expression_and_derivatives_those_of_steps(seed: int) -> None:
    rng = np.random.default_rng(seed)
    points, directions = rng.normal(size=(4, 3)), rng.normal(size=(9, 6))
    far = 100.0  # so that every direction counts
    values, rows, which = missing(points, directions, far)
    assert which.tolist() == list(range(9))
    normals, _ = on_sphere(points)
    told = [
        float(
            support(ca.DM(u), [ca.DM(p) for p in points], [ca.DM(n) for n in normals], MU, LENGTH)
        )
        for u in directions
    ]
    np.testing.assert_allclose(
        values + far * np.linalg.norm(directions, axis=1), told, rtol=1e-9, atol=1e-9
    )
    step = 1e-6
    by_steps = np.array(
        [
            (missing(points + e, directions, far)[0] - missing(points - e, directions, far)[0])
            / (2 * step)
            for e in step * np.eye(12).reshape(12, 4, 3)
        ]
    ).T
    # where two contacts resist alike the largest of them has no derivative
    smooth = np.abs(by_steps - rows).max(axis=1) < 1e-5
    assert np.count_nonzero(smooth) >= 8


def test_only_what_is_missing_counts() -> None:
    """Two contacts face each other along x: mu times the press across, one along the axis."""
    points = np.array([[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0]])
    along, across = np.eye(6)[0], np.eye(6)[1]
    values, rows, which = missing(points, np.array([along, across]), 0.9)
    assert len(which) == len(values)
    assert values.shape == (1,)
    assert rows.shape == (1, 6)
    np.testing.assert_allclose(values, [MU - 0.9], atol=1e-6)


@pytest.mark.slow
@settings(max_examples=60)
@given(st.integers(0, 10_000))
def test_the_least_over_a_sample_is_that_of_the_rows_and_no_less_than_epsilon(seed: int) -> None:
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(3, 4, 3))
    outward = points / np.linalg.norm(points, axis=2, keepdims=True)
    told = least_resisted(points, outward, mu=MU, length=LENGTH)
    for value, at, n in zip(told, points, outward, strict=True):
        flat = np.zeros((4, 3, 3))
        rows = missing_resistance(SAMPLE, at, n, flat, mu=MU, length=LENGTH, target=100.0)[0]
        assert abs(value - rows.min() - 100.0) < 1e-5
        contacts = ContactSet.from_arrays(at, -n, mu=MU)
        assert max(value, 0.0) >= epsilon_l1(contacts, length=LENGTH) - 1e-9
