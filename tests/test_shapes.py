"""Shapes: distances, normals and mass properties, against coal, MuJoCo and brute force."""

from __future__ import annotations

import json
from collections.abc import Callable
from functools import cache
from typing import Any

import coal
import mujoco
import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from numpy.typing import ArrayLike

from planner.errors import NotFoundError, ObjectError
from planner.objects import parse_object
from planner.shapes import (
    SIZED_SHAPES,
    Box,
    Capsule,
    Cylinder,
    Ellipsoid,
    Mesh,
    Shape,
    Sphere,
    shape_from_dict,
    shape_to_dict,
)
from planner.shapes.convex_pairs import DistancePair
from planner.spatial import SE3, FloatArray

EXAMPLES: tuple[Shape, ...] = (
    Sphere(0.035),
    Box((0.05, 0.04, 0.08)),
    Cylinder(0.03, 0.10),
    Cylinder(0.06, 0.02),
    Capsule(0.03, 0.12),
    Ellipsoid((0.09, 0.07, 0.06)),
    Ellipsoid((0.02, 0.09, 0.09)),
    Ellipsoid((0.05, 0.05, 0.05)),
)
each_shape = pytest.mark.parametrize("shape", EXAMPLES, ids=lambda s: s.spec)

SIZE = st.floats(0.004, 0.3)
SHAPE: st.SearchStrategy[Shape] = st.one_of(
    st.builds(Sphere, SIZE),
    st.builds(Box, st.tuples(SIZE, SIZE, SIZE)),
    st.builds(Cylinder, SIZE, SIZE),
    st.builds(lambda r, core: Capsule(r, 2 * r + core), SIZE, SIZE),
    st.builds(Ellipsoid, st.tuples(SIZE, SIZE, SIZE)),
)
# In units of the half extents: 0 is a symmetry plane, 1 a face, and pairs of them axes and edges.
UNIT = st.one_of(st.sampled_from([0.0, 1.0, -1.0, 0.5]), st.floats(-3, 3))
POINT = st.tuples(UNIT, UNIT, UNIT).map(lambda t: np.array(t, dtype=np.float64))


def excess(shape: Shape, p: FloatArray) -> FloatArray:
    """Left side of the inequality that defines the solid (n,): < 0 inside, 0 on the surface."""
    if isinstance(shape, Sphere):
        return np.asarray(np.linalg.norm(p, axis=1) - shape.radius)
    if isinstance(shape, Box):
        return np.asarray((np.abs(p) - np.array(shape.size) / 2).max(axis=1))
    if isinstance(shape, Cylinder):
        radial = np.hypot(p[:, 0], p[:, 1]) - shape.radius
        return np.maximum(radial, np.abs(p[:, 2]) - shape.height / 2)
    if isinstance(shape, Capsule):
        beyond = np.maximum(np.abs(p[:, 2]) - (shape.height / 2 - shape.radius), 0)
        return np.hypot(np.hypot(p[:, 0], p[:, 1]), beyond) - shape.radius
    assert isinstance(shape, Ellipsoid)
    semi = np.array(shape.size) / 2
    return np.asarray((np.linalg.norm(p / semi, axis=1) - 1) * semi.min())


@cache
def surface_samples(shape: Shape, count: int = 20000) -> FloatArray:
    """Points (n, 3) dense on the surface: where rays from the centre leave the solid."""
    k = np.arange(count) + 0.5
    polar, turn = np.arccos(1 - 2 * k / count), np.pi * (1 + 5**0.5) * k
    rays = np.column_stack(
        [np.cos(turn) * np.sin(polar), np.sin(turn) * np.sin(polar), np.cos(polar)]
    )
    low, high = np.zeros(count), np.full(count, 2 * shape.bounding_radius)
    for _ in range(45):
        middle = (low + high) / 2
        outside = excess(shape, rays * middle[:, None]) > 0
        low, high = np.where(outside, low, middle), np.where(outside, middle, high)
    return rays * low[:, None]


# --- distances ------------------------------------------------------------------------------------


@settings(max_examples=200, deadline=None)
@given(shape=SHAPE, unit=POINT)
def test_the_closest_point_is_on_the_surface_and_is_where_the_distance_says(
    shape: Shape, unit: FloatArray
) -> None:
    p = unit * shape.half_extents
    (surface,), (normal,) = shape.closest_point(p)
    distance = shape.signed_distance(p)[0]
    scale = shape.bounding_radius
    assert abs(excess(shape, surface[None])[0]) <= 1e-10 * scale
    assert np.linalg.norm(normal) == pytest.approx(1, abs=1e-12)
    assert abs(distance) == pytest.approx(np.linalg.norm(p - surface), abs=1e-10 * scale)
    sign = excess(shape, p[None])[0]
    if abs(sign) > 1e-9 * scale:
        assert np.sign(distance) == np.sign(sign)
    # p lies on the normal's line through the surface point, apart from rounding on the surface
    np.testing.assert_allclose(surface + distance * normal, p, rtol=0, atol=1e-9 * scale)


@settings(max_examples=100, deadline=None)
@given(shape=SHAPE, unit=POINT)
def test_the_normal_points_outwards(shape: Shape, unit: FloatArray) -> None:
    # A step along the normal leaves the convex solid; by as much as the step.
    (surface,), (normal,) = shape.closest_point(unit * shape.half_extents)
    step = 0.1 * shape.bounding_radius
    assert excess(shape, (surface + step * normal)[None])[0] > 0
    assert shape.signed_distance(surface + step * normal)[0] == pytest.approx(step, abs=1e-9)


@each_shape
def test_no_surface_point_is_nearer_than_the_closest(shape: Shape) -> None:
    # Samples are at most `gap` apart, so the nearest one is at most a little farther.
    samples = surface_samples(shape)
    rng = np.random.default_rng(0)
    gap = 4e-2 * shape.bounding_radius
    for p in rng.uniform(-2, 2, size=(40, 3)) * shape.half_extents:
        nearest = float(np.linalg.norm(samples - p, axis=1).min())
        exact = abs(shape.signed_distance(p)[0])
        assert exact <= nearest + 1e-12
        assert nearest <= exact + gap


@each_shape
def test_distance_equals_coal_s_outside(shape: Shape) -> None:
    probe = 1e-4
    rng = np.random.default_rng(1)
    points = rng.uniform(-3, 3, size=(200, 3)) * shape.half_extents
    distances = shape.signed_distance(points)
    outside = distances > 2 * probe
    assert outside.sum() > 100
    pair = DistancePair(shape.coal_geometry(), coal.Sphere(probe))
    for p, distance in zip(points[outside], distances[outside], strict=True):
        theirs = pair.query(SE3.Identity(), SE3(np.eye(3), p))
        assert theirs.distance + probe == pytest.approx(distance, abs=1e-7)


@each_shape
def test_the_gradient_of_the_distance_is_the_normal(shape: Shape) -> None:
    # Where the closest point is unique the gradient has length 1, inside and outside.
    rng = np.random.default_rng(2)
    step = 1e-7
    used = 0
    for p in rng.uniform(-2, 2, size=(100, 3)) * shape.half_extents:
        if abs(shape.signed_distance(p)[0]) < 1e-4:
            continue
        stencil = np.vstack([p + step * np.eye(3), p - step * np.eye(3)])
        _, normals = shape.closest_point(stencil)
        if np.abs(normals - normals[0]).max() > 0.1:
            continue  # the closest point jumps between the points of the stencil
        values = shape.signed_distance(stencil)
        gradient = (values[:3] - values[3:]) / (2 * step)
        _, (normal,) = shape.closest_point(p)
        np.testing.assert_allclose(gradient, normal, rtol=0, atol=1e-5)
        used += 1
    assert used > 80


@pytest.mark.parametrize(
    ("shape", "point", "distance", "normal"),
    [
        (Sphere(0.03), (0.0, 0.05, 0.0), 0.02, (0, 1, 0)),
        (Sphere(0.03), (0.0, 0.0, -0.01), -0.02, (0, 0, -1)),
        (Box((0.2, 0.4, 0.6)), (0.13, 0.24, 0.3), 0.05, (0.6, 0.8, 0)),  # an edge
        (Box((0.2, 0.4, 0.6)), (0.11, 0.22, 0.32), 0.03, (1 / 3, 2 / 3, 2 / 3)),  # a corner
        (Box((0.2, 0.4, 0.6)), (0.0, -0.15, 0.0), -0.05, (0, -1, 0)),
        (Cylinder(0.03, 0.1), (0.033, 0.0, 0.054), 0.005, (0.6, 0, 0.8)),  # the rim
        (Cylinder(0.03, 0.1), (0.0, 0.02, 0.0), -0.01, (0, 1, 0)),
        (Cylinder(0.03, 0.1), (0.01, 0.0, -0.045), -0.005, (0, 0, -1)),
        (Capsule(0.03, 0.1), (0.0, 0.03, 0.06), 0.02, (0, 0.6, 0.8)),
        (Capsule(0.03, 0.1), (-0.02, 0.0, 0.015), -0.01, (-1, 0, 0)),
        (Ellipsoid((0.2, 0.4, 0.6)), (0.0, 0.0, 0.35), 0.05, (0, 0, 1)),
        (Ellipsoid((0.2, 0.4, 0.6)), (-0.09, 0.0, 0.0), -0.01, (-1, 0, 0)),
    ],
)
def test_distances_worked_out_by_hand(
    shape: Shape, point: tuple[float, ...], distance: float, normal: tuple[float, ...]
) -> None:
    p = np.array(point)
    assert shape.signed_distance(p)[0] == pytest.approx(distance, abs=1e-14)
    np.testing.assert_allclose(shape.closest_point(p)[1][0], normal, rtol=0, atol=1e-12)


@each_shape
def test_the_centre_is_as_deep_as_the_shape_is_thin(shape: Shape) -> None:
    assert shape.signed_distance(np.zeros(3))[0] == pytest.approx(-shape.half_extents.min())


@each_shape
def test_many_points_at_once_are_as_one_by_one(shape: Shape) -> None:
    points = np.random.default_rng(3).uniform(-0.1, 0.1, size=(50, 3))
    together = shape.signed_distance(points)
    assert together.shape == (50,)
    alone = [shape.signed_distance(p)[0] for p in points]
    np.testing.assert_allclose(together, alone, rtol=0, atol=1e-16)
    assert shape.signed_distance(np.zeros((0, 3))).shape == (0,)


@each_shape
@pytest.mark.parametrize(
    ("points", "message"),
    [
        (np.zeros((4, 2)), r"points have shape \(4, 2\); give an array of shape \(n, 3\)"),
        (np.zeros((1, 2, 3)), r"points have shape \(1, 2, 3\); give an array"),
        ([np.nan, 0, 0], "points hold NaN or infinity; give finite coordinates in metres"),
        ([np.inf, 0, 0], "points hold NaN or infinity"),
    ],
)
def test_points_that_are_none_are_refused(shape: Shape, points: Any, message: str) -> None:
    with pytest.raises(ObjectError, match=message):
        shape.closest_point(points)
    with pytest.raises(ObjectError, match=message):
        shape.signed_distance(points)


# --- extent and mass ------------------------------------------------------------------------------


@each_shape
def test_support_half_extents_and_bounding_ball_by_brute_force(shape: Shape) -> None:
    samples = surface_samples(shape)
    rng = np.random.default_rng(4)
    for direction in (*np.eye(3), *rng.normal(size=(20, 3))):
        unit = direction / np.linalg.norm(direction)
        reach = float((samples @ unit).max())
        assert reach <= shape.support(unit) + 1e-12
        assert reach >= shape.support(unit) - 2e-2 * shape.bounding_radius
        assert shape.support(unit) == pytest.approx(shape.support(-unit), abs=1e-15)
    for axis, half in zip(np.eye(3), shape.half_extents, strict=True):
        assert shape.support(axis) == pytest.approx(half, abs=1e-15)
    farthest = float(np.linalg.norm(samples, axis=1).max())
    assert farthest <= shape.bounding_radius + 1e-12
    assert farthest >= 0.98 * shape.bounding_radius


@settings(max_examples=60, deadline=None)
@given(shape=SHAPE, density=st.floats(100, 5000))
def test_volume_and_inertia_are_those_of_mujoco(shape: Shape, density: float) -> None:
    geom = shape.mujoco_geom()
    assert geom is not None
    kind, size = geom
    model = mujoco.MjModel.from_xml_string(
        f'<mujoco><worldbody><body><freejoint/><geom type="{kind}" density="{density!r}"'
        f' size="{" ".join(map(repr, size))}"/></body></worldbody></mujoco>'
    )
    mass = density * shape.volume
    assume(mass > 1e-6)
    assert model.body_mass[1] == pytest.approx(mass, rel=1e-9)
    turn = np.zeros(9)
    mujoco.mju_quat2Mat(turn, model.body_iquat[1])
    axes = turn.reshape(3, 3)
    theirs = axes @ np.diag(model.body_inertia[1]) @ axes.T
    np.testing.assert_allclose(
        shape.inertia(mass), theirs, rtol=1e-9, atol=1e-9 * float(np.trace(theirs))
    )
    np.testing.assert_array_equal(model.body_ipos[1], 0)


@each_shape
def test_coal_s_box_about_the_shape_is_ours(shape: Shape) -> None:
    geometry = shape.coal_geometry()
    geometry.computeLocalAABB()
    np.testing.assert_allclose(geometry.aabb_local.max_, shape.half_extents, rtol=0, atol=1e-12)
    np.testing.assert_allclose(geometry.aabb_local.min_, -shape.half_extents, rtol=0, atol=1e-12)


@each_shape
@pytest.mark.parametrize("height", [0.0, 0.37])
def test_a_resting_shape_touches_the_table(shape: Shape, height: float) -> None:
    pose = shape.resting_pose(height)
    assert np.linalg.det(pose.rotation) == pytest.approx(1)
    np.testing.assert_allclose(pose.rotation @ pose.rotation.T, np.eye(3), atol=1e-15)
    np.testing.assert_array_equal(pose.translation[:2], 0)
    table = SE3(np.eye(3), np.array([0.0, 0.0, height - 0.5]))
    pair = DistancePair(shape.coal_geometry(), coal.Box(4, 4, 1))
    assert pair.query(pose, table).distance == pytest.approx(0, abs=1e-7)


@each_shape
def test_a_resting_shape_is_stable(shape: Shape) -> None:
    # Tilted a little, no shape's centre of mass comes lower than it rests.
    pose = shape.resting_pose()
    rng = np.random.default_rng(5)
    for axis in rng.normal(size=(50, 3)):
        axis[2] = 0
        tilt = rotation_about(0.05 * axis / np.linalg.norm(axis))
        rotation = tilt @ pose.rotation
        assert shape.support(-rotation[2]) >= pose.translation[2] - 1e-12


def rotation_about(vector: FloatArray) -> FloatArray:
    """Rotation matrix of a rotation vector (rad)."""
    quat, matrix = np.zeros(4), np.zeros(9)
    angle = float(np.linalg.norm(vector))
    mujoco.mju_axisAngle2Quat(quat, vector / angle, angle)
    mujoco.mju_quat2Mat(matrix, quat)
    return matrix.reshape(3, 3)


def test_resting_poses_of_the_long_ones() -> None:
    np.testing.assert_array_equal(Capsule(0.03, 0.12).resting_rotation @ [0, 0, 1], [1, 0, 0])
    lying = Ellipsoid((0.06, 0.07, 0.09))
    np.testing.assert_array_equal(lying.resting_rotation @ [1, 0, 0], [0, 0, 1])  # shortest
    np.testing.assert_array_equal(lying.resting_rotation @ [0, 0, 1], [1, 0, 0])  # longest
    assert lying.resting_pose().translation[2] == pytest.approx(0.03)


# --- specification and plain data -----------------------------------------------------------------


@settings(deadline=None)
@given(shape=SHAPE)
def test_a_specification_reads_back_to_the_same_shape(shape: Shape) -> None:
    assert parse_object(shape.spec).shape == shape
    assert type(shape).from_sizes(shape.sizes) == shape


@settings(deadline=None)
@given(shape=SHAPE)
def test_plain_data_reads_back_to_the_same_shape_through_json(shape: Shape) -> None:
    assert shape_from_dict(json.loads(json.dumps(shape_to_dict(shape)))) == shape


def test_plain_data_is_named_with_units() -> None:
    assert shape_to_dict(Box((0.05, 0.05, 0.08))) == {"kind": "box", "size_m": [0.05, 0.05, 0.08]}
    capsule = {"kind": "capsule", "radius_m": 0.03, "height_m": 0.12}
    assert shape_to_dict(Capsule(0.03, 0.12)) == capsule


@pytest.mark.parametrize(
    ("data", "message"),
    [
        ([1, 2], r"a shape is \[1, 2\]; give an object such as"),
        ({}, r"a shape has kind None; give \"kind\" as one of \['bowl', 'box', "),
        ({"kind": 3}, "a shape has kind 3; give"),
        ({"kind": "box"}, r"a box has \[\]; it needs \['size_m'\] and no others"),
        ({"kind": "sphere", "radius_m": 1, "x": 2}, r"it needs \['radius_m'\] and no others"),
        ({"kind": "sphere", "radius_m": "wide"}, "sphere: radius is 'wide', not a number"),
        ({"kind": "box", "size_m": [1, 2]}, r"box: size is \[1, 2\]; give three full extents"),
        ({"kind": "box", "size_m": "abc"}, "box: size is 'abc'; give three full extents"),
        (
            {"kind": "box", "size_m": [1, 1, None]},
            "box: z is None, not a number; give a finite number > 0 in m",
        ),
    ],
)
def test_faulty_plain_data_is_refused(data: object, message: str) -> None:
    with pytest.raises(ObjectError, match=message):
        shape_from_dict(data)


def test_plain_data_of_an_unknown_kind() -> None:
    with pytest.raises(NotFoundError, match=r"no shape is called 'boxx'\. Did you mean 'box'"):
        shape_from_dict({"kind": "boxx", "size_m": [1, 1, 1]})


# --- sizes that are refused -----------------------------------------------------------------------

MAKERS: dict[str, Callable[[Any], Shape]] = {
    "sphere: radius": Sphere,
    "cylinder: radius": lambda v: Cylinder(v, 0.1),
    "cylinder: height": lambda v: Cylinder(0.1, v),
    "capsule: radius": lambda v: Capsule(v, 0.1),
    "capsule: height": lambda v: Capsule(0.01, v),
    "box: y": lambda v: Box((0.1, v, 0.1)),
    "ellipsoid: z": lambda v: Ellipsoid((0.1, 0.1, v)),
}


@pytest.mark.parametrize("what", MAKERS)
@pytest.mark.parametrize(
    ("value", "remedy"),
    [
        (0.0, "is 0.0; give a finite number > 0 in m"),
        (-0.05, "is -0.05; give a finite number > 0 in m"),
        (float("nan"), "is nan; give a finite number > 0 in m"),
        (float("inf"), "is inf; give a finite number > 0 in m"),
        (50.0, "sizes are in metres, was it given in millimetres by mistake"),
        (1e-6, "less than 0.0001 m; sizes are in metres, give more"),
        ("0.05", "is '0.05', not a number; give a finite number > 0 in m"),
        (None, "is None, not a number; give a finite number > 0 in m"),
        (True, "is True, not a number; give a finite number > 0 in m"),
        (1 + 2j, "not a number; give a finite number > 0 in m"),
    ],
)
def test_a_size_that_cannot_be_is_refused_with_the_remedy(
    what: str, value: object, remedy: str
) -> None:
    with pytest.raises(ObjectError, match=f"^{what} ") as caught:
        MAKERS[what](value)
    assert remedy in str(caught.value)


@pytest.mark.parametrize("height", [0.04, 0.06])
def test_a_capsule_that_is_not_longer_than_its_caps_is_refused(height: float) -> None:
    with pytest.raises(ObjectError, match=r"more than twice the radius 0\.03 m; give a larger"):
        Capsule(0.03, height)


@pytest.mark.parametrize("size", [0.05, (0.1, 0.1), (0.1,) * 4, None, "0.1", {"x": 1}])
def test_extents_that_are_not_three_are_refused(size: Any) -> None:
    for kind in (Box, Ellipsoid):
        with pytest.raises(ObjectError, match="give three full extents x, y, z in metres"):
            kind(size)


@pytest.mark.parametrize("size", [[0.1, 0.2, 0.3], np.array([0.1, 0.2, 0.3]), (0.1, 0.2, 0.3)])
def test_extents_are_kept_as_plain_floats(size: Any) -> None:
    assert Box(size).size == (0.1, 0.2, 0.3)
    assert all(type(v) is float for v in Ellipsoid(size).size)
    assert hash(Box(size)) == hash(Box((0.1, 0.2, 0.3)))


def test_integers_and_numpy_numbers_are_sizes() -> None:
    for value in (1, np.float32(0.5), np.int64(1)):
        radius: ArrayLike = Sphere(value).radius  # type: ignore[arg-type]
        assert radius == float(value)


def test_every_kind_is_registered_under_its_name() -> None:
    assert {kind: cls.kind for kind, cls in SIZED_SHAPES.items()} == {k: k for k in SIZED_SHAPES}
    made = {s for s in SIZED_SHAPES.values() if issubclass(s, Mesh)}  # see test_mesh and test_made
    assert {type(s) for s in EXAMPLES} == set(SIZED_SHAPES.values()) - made
    assert Cylinder.form() == "cylinder:RADIUSxHEIGHT"
    assert Box.form() == "box:XxYxZ"
