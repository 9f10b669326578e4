"""The smooth distance: exact derivatives, no steps between its grids, and how near the truth."""

from __future__ import annotations

from functools import cache
from itertools import combinations_with_replacement

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from planner.errors import ObjectError
from planner.shapes import Box, Capsule, Shape, Sphere
from planner.shapes.distance_field import DistanceField, taylor_size
from planner.shapes.field_fit import FAR_REACH, RIM_STEP, fit_field, grid_nodes
from planner.spatial import FloatArray

SHAPES: tuple[Shape, ...] = (Sphere(0.04), Box((0.05, 0.06, 0.1)), Capsule(0.012, 0.25))
each_shape = pytest.mark.parametrize("shape", SHAPES, ids=lambda s: s.spec)

AXES = [a for n in range(3) for a in combinations_with_replacement(range(3), n)]
"""Axes of the derivative in each column of the Taylor rows, as the contract lists them."""


@cache
def field_of(shape: Shape) -> DistanceField:
    return fit_field(
        lambda *grid: shape.signed_distance(grid_nodes(*grid)).reshape(grid[1]),
        -shape.half_extents,
        shape.half_extents,
    )


def on_spheres(count: int, low: float, high: float) -> FloatArray:
    rng = np.random.default_rng(0)
    p = rng.normal(size=(count, 3))
    return np.asarray(p / np.linalg.norm(p, axis=1)[:, None] * rng.uniform(low, high, (count, 1)))


def test_columns_are_in_the_stated_order() -> None:
    letters = ["".join("xyz"[k] for k in axes) for axes in AXES]
    assert letters[1:10] == ["x", "y", "z", "xx", "xy", "xz", "yy", "yz", "zz"]
    assert [taylor_size(n) for n in range(3)] == [1, 4, 10] and len(letters) == 10


@each_shape
@pytest.mark.parametrize("reach", [(0.0, 0.08), (0.1, 0.2), (0.3, 0.7), (1.5, 2.0)])
def test_derivatives_are_those_of_the_value(shape: Shape, reach: tuple[float, float]) -> None:
    field, step = field_of(shape), 1e-6
    points = on_spheres(200, *reach)
    exact = field.taylor(points, 2)
    for column, axes in enumerate(AXES):
        if len(axes) == 2:
            continue
        for axis in range(3):
            shift = step * np.eye(3)[axis]
            ahead, behind = field.taylor(points + shift, 2), field.taylor(points - shift, 2)
            difference = (ahead[:, column] - behind[:, column]) / (2 * step)
            analytic = exact[:, AXES.index(tuple(sorted((*axes, axis))))]
            error = np.abs(difference - analytic)
            assert error.max() <= 1e-5 * (1 + np.abs(analytic).max())


@each_shape
def test_lower_orders_are_the_first_columns(shape: Shape) -> None:
    points = on_spheres(50, 0.0, 1.2)
    whole = field_of(shape).taylor(points, 2)
    for order in range(2):
        part = field_of(shape).taylor(points, order)
        np.testing.assert_allclose(part, whole[:, : taylor_size(order)], rtol=1e-12, atol=1e-12)
    np.testing.assert_array_equal(
        field_of(shape).value(points), field_of(shape).taylor(points, 0)[:, 0]
    )


@each_shape
def test_many_points_at_once_are_as_one_by_one(shape: Shape) -> None:
    # points of all levels and beyond, mixed
    points = np.concatenate([on_spheres(20, 0, 0.05), on_spheres(20, 0.1, 2.0)])
    together = field_of(shape).taylor(points, 2)
    alone = np.concatenate([field_of(shape).taylor(p[None], 2) for p in points])
    # rounding of values of 1e-2 m, divided by cells of 2 mm once per order
    scale = np.repeat([1e-2 / 1e-3**n for n in range(3)], [1, 3, 6])
    assert (np.abs(together - alone) <= 1e-13 * scale).all()
    assert field_of(shape).taylor(np.zeros((0, 3)), 2).shape == (0, 10)


@each_shape
def test_there_is_no_step_at_the_rims_of_the_grids(shape: Shape) -> None:
    rng = np.random.default_rng(1)
    field, step = field_of(shape), 1e-9
    for level in field.levels:
        last = level is field.levels[-1]
        for axis in range(3):
            for rim, sign in ((level.lower, -1), (level.upper, 1)):
                p = rng.uniform(level.lower, level.upper, size=(500, 3))
                p[:, axis] = rim[axis]
                shift = sign * step * np.eye(3)[axis]
                jump = np.abs(field.taylor(p + shift, 2) - field.taylor(p - shift, 2))
                assert jump[:, 0].max() < (RIM_STEP if last else 1e-8)
                assert jump[:, 1:4].max() < (1e-3 if last else 1e-6)
                assert jump[:, 4:].max() < (0.1 if last else 1e-4)


def test_where_the_coarsest_grid_ends_the_distance_is_that_of_a_ball() -> None:
    field = field_of(SHAPES[1])
    p = np.array([[0.0, 3.0, 4.0]])
    row = field.taylor(p, 2)[0]
    assert row[0] == pytest.approx(5 - field.far_radius)
    np.testing.assert_allclose(row[1:4], [0, 0.6, 0.8], atol=1e-15)
    np.testing.assert_allclose(row[4:], np.array([1, 0, 0, 0.64, -0.48, 0.36]) / 5, atol=1e-15)
    assert field.levels[-1].upper.min() >= FAR_REACH


@each_shape
def test_near_the_surface_it_is_the_distance(shape: Shape) -> None:
    # away from edges: a sphere, a capsule, and the faces of a box
    field = field_of(shape)
    rng = np.random.default_rng(2)
    surface, normals = shape.closest_point(
        rng.uniform(-1.2, 1.2, size=(3000, 3)) * shape.half_extents
    )
    if isinstance(shape, Box):
        inner = (np.abs(surface) < shape.half_extents - 0.006).sum(axis=1) >= 2
        surface, normals = surface[inner], normals[inner]
        assert len(surface) > 300
    for height, tolerance in ((0.0, 1.5e-4), (0.01, 1e-4), (0.03, 2e-4)):
        row = field.taylor(surface + height * normals, 1)
        assert np.abs(row[:, 0] - height).max() < tolerance
        aligned = np.einsum("nd,nd->n", row[:, 1:], normals)
        assert aligned.min() > 0.98 and aligned.max() < 1.01


@each_shape
def test_edges_are_rounded_by_little(shape: Shape) -> None:
    surface, _ = shape.closest_point(on_spheres(2000, 0.05, 0.1))
    assert np.abs(field_of(shape).value(surface)).max() < 1.5e-3


@each_shape
def test_it_grows_away_from_the_object_and_never_stops(shape: Shape) -> None:
    # along every outward ray, from beyond the bounding ball to far beyond the grids
    rays = on_spheres(60, 1.0, 1.0)
    reach = np.linspace(shape.bounding_radius + 0.005, 2.0, 300)
    values = field_of(shape).value((reach[:, None, None] * rays).reshape(-1, 3)).reshape(300, -1)
    assert (np.diff(values, axis=0) > 0).all()
    slope = np.linalg.norm(field_of(shape).taylor(on_spheres(4000, 0.1, 2.0), 1)[:, 1:], axis=1)
    assert slope.min() > 0.8 and slope.max() < 1.3
    assert (values[0] > 0).all()


@settings(max_examples=100, deadline=None)
@given(point=arrays(np.float64, 3, elements=st.floats(-1e3, 1e3)))
def test_every_point_of_space_has_a_finite_value(point: FloatArray) -> None:
    row = field_of(SHAPES[1]).taylor(point[None], 2)
    assert np.isfinite(row).all()
    assert row[0, 0] > -0.05


def test_the_inside_is_negative() -> None:
    for shape in SHAPES:
        assert field_of(shape).value(np.zeros((1, 3)))[0] < -0.8 * shape.half_extents.min()


@pytest.mark.parametrize(
    ("points", "message"),
    [
        (np.zeros(3), r"points have shape \(3,\); give an array of shape \(n, 3\)"),
        (np.zeros((2, 2)), r"points have shape \(2, 2\)"),
        (np.array([[np.nan, 0, 0]]), "NaN or infinity"),
        (np.array([[0, np.inf, 0], [0, 0, 0]]), "NaN or infinity"),
    ],
)
def test_points_that_are_none_are_refused(points: FloatArray, message: str) -> None:
    with pytest.raises(ObjectError, match=message):
        field_of(SHAPES[0]).taylor(points)


def test_an_order_beyond_the_second_is_refused() -> None:
    with pytest.raises(ObjectError, match="order is 3; give the order of a derivative"):
        field_of(SHAPES[0]).taylor(np.zeros((1, 3)), 3)


@pytest.mark.parametrize(
    "shape",
    [*SHAPES, Box((1.0, 1.0, 1.0)), Box((2.0, 0.05, 0.05)), Capsule(0.1, 1.5)],
    ids=lambda s: s.spec,
)
def test_its_error_within_the_bounding_box_is_bounded(shape: Shape) -> None:
    field = field_of(shape)
    rng = np.random.default_rng(3)
    points = rng.uniform(-1, 1, size=(20_000, 3)) * shape.half_extents
    error = np.abs(field.value(points) - shape.signed_distance(points))
    assert error.max() <= field.error
    assert field.error < 5 * field.spacing  # useful: smoothing, rounding and the spacing itself


def test_a_large_shape_has_a_field_too() -> None:
    # a grid of coarse nodes has room for the tapering of corrections around it
    shape = Box((2.0, 0.05, 0.05))
    field = field_of(shape)
    normals = np.vstack([np.eye(3), -np.eye(3)])
    on_faces = normals * shape.half_extents
    np.testing.assert_allclose(field.value(on_faces), 0, atol=5e-4)
    np.testing.assert_allclose(field.value(on_faces + 0.02 * normals), 0.02, atol=1e-3)


def test_it_is_the_same_after_a_file() -> None:
    field = field_of(SHAPES[0])
    again = DistanceField.from_arrays(field.to_arrays())
    points = on_spheres(100, 0.0, 2.0)
    np.testing.assert_array_equal(again.taylor(points, 2), field.taylor(points, 2))
    assert again.spacing == field.spacing and again.error == field.error


@pytest.mark.parametrize("missing", ["coefficients0", "error", "far_radius", "place0"])
def test_arrays_of_another_form_are_told(missing: str) -> None:
    arrays_of = dict(field_of(SHAPES[0]).to_arrays())
    del arrays_of[missing]
    with pytest.raises((KeyError, ValueError)):
        DistanceField.from_arrays(arrays_of)


@each_shape
def test_rough_values_are_near_the_true_ones_everywhere(shape: Shape) -> None:
    field = field_of(shape)
    for reach, level in (((0.0, 0.05), 0), ((0.3, 2.0), -1)):
        points = on_spheres(300, *reach)
        off = np.abs(field.rough_value(points) - field.value(points))
        assert off.max() <= 1.2 * field.levels[level].spacing
        assert off.max() > 0.0


@each_shape
def test_points_near_the_surface_do_not_depend_on_what_is_asked_beside_them(shape: Shape) -> None:
    field = field_of(shape)
    near, far = on_spheres(50, 0.0, 0.04), np.array([[1.5, 0.0, 0.0]])
    alone = field.taylor(near, 2)  # all in the finest level
    beside = field.taylor(np.vstack([near, far]), 2)[:-1]  # levels are told apart
    np.testing.assert_allclose(alone, beside, rtol=0, atol=1e-12 * np.abs(beside).max())
