"""Faces of the hull of wrenches: the walk against Qhull, and against what a face is."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planner.contacts import ContactSet
from planner.numerics.kernels import attempt_kernels, compiled_searches
from planner.quality import primitive_wrenches, weakest
from planner.quality.weakest import (
    _SHIFTS,
    EDGES,
    distinct_faces,
    hull_faces,
    pyramid_wrenches,
    sides_of,
    walked_faces,
    wrench_faces,
)
from planner.spatial import FloatArray

LENGTH = 0.05
SIDES = sides_of(EDGES)


@pytest.fixture(autouse=True, scope="module")
def _compiled() -> Iterator[None]:
    """The walk, which runs where kernels are compiled; else Qhull answers."""
    with compiled_searches(), attempt_kernels(0):
        yield


def contacts(seed: int) -> tuple[FloatArray, FloatArray, float]:
    """Points, normals and friction: on a ball, a box or two parallel planes."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(2, 9))
    points = rng.normal(size=(n, 3))
    inward = -points + rng.normal(0, 0.2, (n, 3))
    kind = seed % 3
    if kind:  # normals along the axes; of two planes along x only
        axis = rng.integers(0, 3, n) if kind == 1 else np.zeros(n, dtype=int)
        sign = rng.choice([-1.0, 1.0], n)
        points = rng.uniform(-1, 1, (n, 3))
        points[np.arange(n), axis] = sign
        inward = -sign[:, None] * np.eye(3)[axis]
    points *= 0.04 / np.linalg.norm(points, axis=1, keepdims=True)
    inward /= np.linalg.norm(inward, axis=1, keepdims=True)
    return points, inward, float(rng.choice([0.0, 0.3, 1.0]))


def wrenches_of(seed: int) -> FloatArray:
    points, inward, mu = contacts(seed)
    return pyramid_wrenches(points, inward, mu, LENGTH, SIDES)


def by_qhull(wrenches: FloatArray) -> FloatArray:
    faces = weakest._qhull_faces(wrenches)
    return weakest._distinct(faces[np.argsort(-faces[:, 6], kind="stable")], weakest._TIES)


@settings(max_examples=150, deadline=None)
@given(st.integers(0, 100_000))
def test_the_walk_finds_what_qhull_finds(seed: int) -> None:
    wrenches = wrenches_of(seed)
    assert walked_faces(wrenches, _SHIFTS)[1]
    found, expected = hull_faces(wrenches), by_qhull(wrenches)
    assert found.shape == expected.shape
    np.testing.assert_allclose(found, expected, atol=1e-9)


@pytest.mark.parametrize("seed", [0, 1, 2, 10])
def test_the_walk_is_the_same_without_a_compiler(seed: int) -> None:
    wrenches = wrenches_of(seed)
    faces, whole = walked_faces.loops(wrenches, _SHIFTS)  # type: ignore[attr-defined]
    assert whole
    faces = faces[np.argsort(-faces[:, 6], kind="stable")]
    found = distinct_faces.loops(faces, weakest._TIES)  # type: ignore[attr-defined]
    np.testing.assert_allclose(found, by_qhull(wrenches), atol=1e-9)


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 100_000))
def test_a_face_has_all_wrenches_behind_it_and_six_on_it(seed: int) -> None:
    wrenches = wrenches_of(seed)
    faces = hull_faces(wrenches)
    ahead = wrenches @ faces[:, :6].T + faces[:, 6]
    assert ahead.max(initial=0.0) < 1e-9
    np.testing.assert_allclose(np.linalg.norm(faces[:, :6], axis=1), 1.0, atol=1e-12)
    for column in ahead.T:
        on = wrenches[column > -1e-7]
        assert np.linalg.matrix_rank(on[1:] - on[0], tol=1e-6) == 5
    cosines = faces[:, :6] @ faces[:, :6].T
    assert (cosines[np.triu_indices(len(faces), 1)] <= 1 - weakest.SAME).all()
    assert (np.diff(faces[:, 6]) < 1e-6).all()  # nearest first


def test_the_hull_of_a_cross_has_a_face_for_every_choice_of_signs() -> None:
    wrenches = np.vstack([np.eye(6), -np.eye(6)])
    faces = hull_faces(wrenches)
    assert len(faces) == 64
    np.testing.assert_allclose(np.abs(faces), 1 / np.sqrt(6), atol=1e-12)


@pytest.mark.parametrize("flat", [0.0, 1e-9])
def test_wrenches_that_span_no_volume_have_no_faces(flat: float) -> None:
    wrenches = np.random.default_rng(0).normal(size=(16, 6))
    wrenches[:, 4] = wrenches[:, 0] - 2 * wrenches[:, 1] + flat * wrenches[:, 4]
    assert hull_faces(wrenches).shape == weakest._qhull_faces(wrenches).shape == (0, 7)
    assert hull_faces(wrenches[:6]).shape == (0, 7)
    assert hull_faces(np.zeros((16, 6))).shape == (0, 7)


@pytest.mark.parametrize("n", [4, 9])
def test_qhull_answers_where_the_walk_goes_astray_or_is_too_long(
    n: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    rng = np.random.default_rng(n)
    wrenches = rng.normal(size=(4 * n, 6))
    expected = by_qhull(wrenches)
    monkeypatch.setattr(weakest, "walked_faces", lambda w, s: (np.zeros((0, 7)), False))
    np.testing.assert_allclose(hull_faces(wrenches), expected, atol=1e-9)


def test_symmetrical_faces_come_in_one_order_whatever_finds_them() -> None:
    points = 0.04 * np.array([[1, 0.5, 0.2], [1, -0.5, 0.2], [-1, 0.5, 0.2], [-1, -0.5, 0.2]])
    inward = np.array([[-1.0, 0, 0], [-1, 0, 0], [1, 0, 0], [1, 0, 0]])
    wrenches = pyramid_wrenches(points, inward, 0.5, LENGTH, SIDES)
    faces = hull_faces(wrenches)
    assert (np.abs(np.diff(faces[:, 6])) < 1e-9).sum() > 4  # there are ties
    np.testing.assert_allclose(faces, by_qhull(wrenches), atol=1e-9)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 100_000))
def test_wrenches_are_those_of_the_contacts_edges(seed: int) -> None:
    points, inward, mu = contacts(seed)
    found = pyramid_wrenches(points, inward, mu, LENGTH, SIDES)
    known = ContactSet.from_arrays(points, inward, mu=mu)
    if mu:
        columns = primitive_wrenches(known, EDGES, length=LENGTH)
        expected = columns.T.reshape(len(points), EDGES, 6).transpose(1, 0, 2).reshape(-1, 6)
        np.testing.assert_allclose(found, expected, atol=1e-12)


def test_nearest_faces_are_the_weakest_directions() -> None:
    points, inward, _ = contacts(3)
    faces = wrench_faces(points, inward, 0.5, LENGTH)
    assert len(faces)
    assert -faces[0, 6] == pytest.approx((-faces[:, 6]).min(), abs=1e-9)
