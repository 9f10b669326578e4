"""Statistics and closed forms: against samples, their definitions, or another library."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import coal
import mujoco
import numpy as np
import pinocchio as pin
import pytest
from scipy.special import kv
from scipy.stats import chi2, norm

from planner.certify.stiffness import _curvatures
from planner.clouds.belief import _matern
from planner.clouds.cloud import _area, estimated_noise
from planner.clouds.level import _turn_to_vertical
from planner.contacts.contact_set import _least_handedness
from planner.contacts.friction import cone_support, cone_utilisation, round_cone
from planner.hand_loading import load_hand
from planner.hands.hand import Hand
from planner.shapes import Capsule, Cylinder, Sphere
from planner.shapes.mesh import Mesh
from planner.spatial import SE3, FloatArray
from sim.controllers.hand_dynamics import MOTOR_DAMPING, MOTOR_FREQUENCY, motor_servo
from sim.controllers.torques import twist_of
from sim.crosscheck.reader import _half_extents
from sim.datasets.episodes.lerobot import of_all, of_pictures
from sim.datasets.reset_states.shards import NEAR_ANGLE, NEAR_JOINT, NEAR_POSITION, _near
from sim.datasets.reset_states.starts import _scaled_shape, _turned
from sim.learning.policy import _worse
from sim.manipulation.drawing import _between
from sim.manipulation.timeline import off_target, short_of
from sim.recorder import _changes
from sim.scan import DISTANCE, ELEVATION, camera_places
from sim.sensing.errors.senses import encoder_error
from sim.sensing.touch.slip import SIGMAS, _unlikely
from sim.verdict import Fault, put_down_to_actuators


def test_round_cones_their_support_and_their_use_are_of_one_cone() -> None:
    """The support is the largest product over drawn forces, is reached, and lies on the cone."""
    rng, mu, torsion = np.random.default_rng(0), 0.7, 0.004
    cone = round_cone(mu, torsion)
    assert [round_cone(*pair).shape[0] for pair in ((mu, 0.0), (0.0, torsion), (0.0, 0.0))] == [
        3,
        2,
        0,
    ]
    tails = rng.normal(size=(4000, 3))
    tails /= np.linalg.norm(tails, axis=1, keepdims=True)
    edge = np.column_stack([np.ones(4000), tails * [mu, mu, torsion]])
    head, *tail = cone @ edge.T
    np.testing.assert_allclose(np.linalg.norm(tail, axis=0), head)
    np.testing.assert_allclose(cone_utilisation(edge, np.array(mu), np.array(torsion)), 1.0)
    inside = edge * [2.0, 0.5, 0.5, 0.5]
    np.testing.assert_allclose(cone_utilisation(inside, np.array(mu), np.array(torsion)), 0.25)
    for pulled in rng.normal(size=(5, 4)) * [1.0, 1.0, 1.0, 200.0]:
        value, force = cone_support(pulled, np.array([mu, mu, torsion]))
        assert pulled @ force == pytest.approx(value)
        assert value >= (edge @ pulled).max() - 1e-9
        assert value <= (edge @ pulled).max() + 0.02 * abs(value) + 0.02
        assert cone_utilisation(force[None], np.array([mu]), np.array([torsion])) == pytest.approx(
            1
        )
    alone, force = cone_support(np.array([2.0, 0.0, 0.0, 0.0]), np.array([mu, mu, torsion]))
    assert alone == 2.0
    np.testing.assert_array_equal(force, [1.0, 0.0, 0.0, 0.0])


def test_use_of_a_cone_that_there_is_none_of() -> None:
    """Friction that is missing matters where it is asked for, and only there."""
    cases: list[tuple[list[float], float, float]] = [
        ([1.0, 0.0, 0.0, 0.0], 0.0, 0.0),
        ([0.0, 0.1, 0.0, 0.0], 0.1, np.inf),
        ([1.0, 0.0, 0.0, 0.1], np.nan, 0.0),  # torsion does not count
        ([np.nan, 0.0, 0.0, 0.0], 0.1, np.nan),
        ([1.0, 0.1, 0.0, 0.0], 0.0, 0.2),
        ([1.0, 0.1, 0.0, 0.01], 0.0, np.inf),
    ]
    forces, torsion, expected = zip(*cases, strict=True)
    used = cone_utilisation(np.array(forces), np.full(len(cases), 0.5), np.array(torsion))
    np.testing.assert_allclose(used, expected)


def test_correlations_are_those_of_the_matern_kernel() -> None:
    """By its definition with a Bessel function, of smoothness 5/2."""
    r = np.linspace(0.05, 4.0, 30)
    x = np.sqrt(5.0) * r
    np.testing.assert_allclose(_matern(r), 2**-1.5 / (0.75 * np.sqrt(np.pi)) * x**2.5 * kv(2.5, x))
    assert float(_matern(np.zeros(1))[0]) == 1.0


def test_noise_of_a_plane_is_found_whatever_way_it_lies() -> None:
    rng = np.random.default_rng(1)
    flat = np.column_stack([rng.uniform(0, 0.1, (4000, 2)), rng.normal(0, 0.0015, 4000)])
    turned = flat @ pin.exp3(np.array([0.4, 0.8, 0.1])).T
    assert estimated_noise(turned) == pytest.approx(0.0015, rel=0.1)
    cells = np.array([[0.001, 0.001], [0.009, 0.009], [-0.001, 0.001], [0.011, 0.021]])
    assert _area(cells) == pytest.approx(3e-4)


def test_the_shortest_turn_to_the_vertical() -> None:
    normal = np.array([0.2, -0.3, 0.9])
    normal /= np.linalg.norm(normal)
    turn = _turn_to_vertical(normal)
    np.testing.assert_allclose(turn @ normal, [0.0, 0.0, 1.0], atol=1e-12)
    np.testing.assert_allclose(turn @ turn.T, np.eye(3), atol=1e-12)
    assert pin.log3(turn)[2] == pytest.approx(0.0, abs=1e-12)


def test_the_least_determinant_is_that_of_numpy() -> None:
    frames = np.random.default_rng(2).normal(size=(7, 3, 3))
    assert _least_handedness(frames) == pytest.approx(np.linalg.det(frames).min())


def test_curvatures_of_round_shapes_are_one_over_their_radii() -> None:
    """Along a cylinder's line none; the sign of a shape that bends away is positive."""
    tangents = np.array([[[1.0, 0.0], [0.0, 1.0], [0.0, 0.0]]])
    top = np.array([[0.0, 0.0, 0.03]])
    ball = _curvatures(Sphere(0.03), top, tangents)[0]
    np.testing.assert_allclose(ball, np.eye(2) / 0.03, rtol=1e-3, atol=1e-6)
    turned = tangents[:, [2, 0, 1]]  # tangents y and z at a cylinder's side
    side = _curvatures(Cylinder(0.03, 0.1), np.array([[0.03, 0.0, 0.0]]), turned)[0]
    np.testing.assert_allclose(side, np.diag([1 / 0.03, 0.0]), rtol=1e-3, atol=1e-6)


def test_points_of_a_body_give_its_twist_back() -> None:
    rng = np.random.default_rng(3)
    arms, twist = rng.normal(size=(4, 3)), rng.normal(size=6)
    velocities = twist[:3] + np.cross(twist[3:], arms)
    np.testing.assert_allclose(twist_of(velocities, arms), twist, atol=1e-6)


def test_a_motor_without_servo_is_given_a_damped_spring(allegro: Hand) -> None:
    """Of its own frequency at least, with the damping ratio; a joint with a servo gets none."""
    assert not any(gain.any() for gain in motor_servo(allegro, allegro.neutral))
    hand = load_hand("shadow_hand_torque")
    stiffness, damping = motor_servo(hand, hand.neutral)
    driven = stiffness > 0
    assert driven.sum() >= 20
    inertia = np.diag(pin.crba(hand.pin_model, hand.pin_model.createData(), hand.neutral))[driven]
    frequency = np.sqrt(stiffness[driven] / inertia)
    assert (frequency >= MOTOR_FREQUENCY * (1 - 1e-9)).all()
    ratio = damping[driven] / (2 * np.sqrt(stiffness[driven] * inertia))
    np.testing.assert_allclose(ratio, MOTOR_DAMPING)


@pytest.mark.parametrize(
    "geometry",
    [
        coal.Sphere(0.02),
        coal.Capsule(0.02, 0.05),
        coal.Cylinder(0.02, 0.05),
        coal.Box(0.02, 0.04, 0.07),
        coal.Ellipsoid(0.02, 0.03, 0.05),
    ],
)
def test_boxes_about_turned_geometry_are_those_of_its_surface(geometry: Any) -> None:
    rotation = pin.exp3(np.array([0.3, -0.7, 0.4]))
    found = _half_extents(geometry, rotation)
    assert found is not None
    d = rotation.T  # column k: axis k in the geometry's frame
    n = 20_000
    unit = np.random.default_rng(4).normal(size=(n, 3))
    unit /= np.linalg.norm(unit, axis=1, keepdims=True)
    if isinstance(geometry, coal.Sphere):
        points = geometry.radius * unit
    elif isinstance(geometry, coal.Capsule):
        points = geometry.radius * unit + np.outer(np.sign(unit[:, 2]), [0, 0, geometry.halfLength])
    elif isinstance(geometry, coal.Cylinder):
        flat = unit[:, :2] / np.linalg.norm(unit[:, :2], axis=1, keepdims=True)
        points = np.column_stack(
            [geometry.radius * flat, geometry.halfLength * np.sign(unit[:, 2])]
        )
    elif isinstance(geometry, coal.Box):
        points = np.sign(unit) * geometry.halfSide
    else:
        points = unit * geometry.radii
    np.testing.assert_allclose(found, (points @ d).max(axis=0), atol=2e-4)


def test_statistics_of_parts_add_up_to_those_of_the_whole() -> None:
    """Parts of unlike length; mean, deviation, least and largest are of all numbers."""
    rng = np.random.default_rng(5)
    parts = [rng.normal(k, 1 + k, (n, 2)) for k, n in enumerate((10, 40, 150))]
    names = [name for name in of_all([described(part) for part in parts]) if name[0] == "q"]
    whole = np.concatenate(parts)
    found = of_all([described(part) for part in parts])
    np.testing.assert_allclose(found["mean"], whole.mean(axis=0))
    np.testing.assert_allclose(found["std"], whole.std(axis=0))
    np.testing.assert_array_equal(found["min"], whole.min(axis=0))
    np.testing.assert_array_equal(found["max"], whole.max(axis=0))
    assert found["count"].tolist() == [200]
    for name in names:
        share = np.array([10, 40, 150]) / 200
        expected = share @ np.array([described(part)[name] for part in parts])
        np.testing.assert_allclose(found[name], expected)


def described(values: FloatArray) -> dict[str, Any]:
    quantiles = {f"q{k:02}": np.quantile(values, k / 100, axis=0) for k in (1, 10, 50, 90, 99)}
    return {
        "min": values.min(axis=0),
        "max": values.max(axis=0),
        "mean": values.mean(axis=0),
        "std": values.std(axis=0),
        "count": np.array([len(values)]),
        **quantiles,
    }


def test_statistics_of_pictures_are_those_of_their_levels() -> None:
    rng = np.random.default_rng(6)
    pictures = [rng.integers(20 * k, 60 + 20 * k, (8, 6, 3), dtype=np.uint8) for k in (1, 2, 5)]
    found, levels = of_pictures(pictures), np.array(pictures) / 255.0
    for name, function in (("min", np.min), ("max", np.max), ("mean", np.mean), ("std", np.std)):
        values: Any = function(levels, axis=(0, 1, 2))
        np.testing.assert_allclose(found[name].ravel(), values, atol=1e-12)
        assert found[name].shape == (3, 1, 1)
    flat = np.sort(levels.reshape(-1, 3), axis=0)
    np.testing.assert_allclose(found["q50"].ravel(), flat[len(flat) // 2 - 1], atol=1e-12)
    assert found["count"].tolist() == [3]


def test_an_orientation_is_turned_in_the_objects_own_axes() -> None:
    rng = np.random.default_rng(7)
    start = rng.normal(size=4)
    start /= np.linalg.norm(start)
    for turn in (rng.normal(size=3), np.zeros(3)):
        first, after = np.zeros(9), np.zeros(9)
        mujoco.mju_quat2Mat(first, start)
        mujoco.mju_quat2Mat(after, _turned(start, turn))
        expected = first.reshape(3, 3) @ pin.exp3(turn)
        np.testing.assert_allclose(after.reshape(3, 3), expected, atol=1e-9)


def test_near_duplicates_are_near_in_place_turn_and_joints() -> None:
    """Just within and just beyond each; a quaternion and its negative are one turn."""
    row = np.array([0.1, 0.2, 0.3, 1.0, 0.0, 0.0, 0.0, 0.5, 0.6])

    def other(shift: float = 0.0, turn: float = 0.0, joint: float = 0.0) -> FloatArray:
        out = row.copy()
        out[1] += shift
        out[3:7] = -np.cos(turn / 2), 0.0, -np.sin(turn / 2), 0.0
        out[8] -= joint
        return out

    rows = [
        other(),
        other(shift=0.99 * NEAR_POSITION),
        other(shift=1.01 * NEAR_POSITION),
        other(turn=0.99 * NEAR_ANGLE),
        other(turn=1.01 * NEAR_ANGLE),
        other(joint=0.99 * NEAR_JOINT),
        other(joint=1.01 * NEAR_JOINT),
    ]
    assert _near(np.array(rows), row).tolist() == [0, 1, 3, 5]


def test_scaled_shapes_are_as_many_times_as_large() -> None:
    capsule = _scaled_shape(Capsule(0.02, 0.1), 1.5)
    assert isinstance(capsule, Capsule)
    assert (capsule.radius, capsule.height) == pytest.approx((0.03, 0.15))
    corners = np.array([[0.0, 0, 0], [0.1, 0, 0], [0, 0.1, 0], [0, 0, 0.1]])
    mesh = Mesh.from_triangles(corners, np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]]))
    np.testing.assert_allclose(_scaled_shape(mesh, 2.0).half_extents, 2.0 * mesh.half_extents)


@pytest.mark.parametrize(
    ("name", "now", "trained", "worse"),
    [
        ("latency_s", 0.02, 0.01, True),
        ("latency_s", 0.01, 0.02, False),
        ("touch_rate", 50.0, 100.0, True),
        ("touch_rate", 100.0, 50.0, False),
        ("touch_rate", 100.0, 0.0, True),
        ("touch_rate", 0.0, 50.0, False),
    ],
)
def test_errors_are_worse_where_they_are_larger_and_rates_where_they_are_lower(
    name: str, now: float, trained: float, worse: bool
) -> None:
    """A rate of 0 is that of no limit."""
    assert _worse(name, now, trained) == worse


def test_between_two_rows_is_the_straight_way_and_the_ends_are_the_rows() -> None:
    rows = np.array([[0.0, 1.0], [2.0, 5.0], [3.0, 3.0]])
    for place, expected in ((0.0, [0.0, 1.0]), (1.25, [2.25, 4.5]), (2.0, [3.0, 3.0])):
        np.testing.assert_allclose(_between(rows, place), expected)


def test_a_turn_is_short_by_what_is_missing_on_its_own_side() -> None:
    assert float(short_of(1.0, 0.8)) == pytest.approx(0.2)
    assert float(short_of(-1.0, -0.8)) == pytest.approx(0.2)
    assert float(short_of(-1.0, -1.3)) == pytest.approx(-0.3)
    target = SE3(np.eye(3), np.array([0.1, 0.2, 0.3]))
    now = SE3(pin.exp3(np.array([0.0, 0.0, -0.1])), np.array([0.103, 0.196, 0.29]))
    assert off_target(target, now) == pytest.approx(
        {"off_mm": 5.0, "above_mm": -10.0, "heading_deg": -np.rad2deg(0.1), "tilt_deg": 0.0},
        abs=1e-6,
    )
    tilted = SE3(pin.exp3(np.array([0.2, 0.0, 0.0])), target.translation)
    assert off_target(target, tilted)["tilt_deg"] == pytest.approx(np.rad2deg(0.2))
    np.testing.assert_allclose(
        _changes(target, [now, tilted]),
        [[1e3 * np.sqrt(25e-6 + 1e-4), np.rad2deg(0.1)], [0.0, np.rad2deg(0.2)]],
        atol=1e-9,
    )
    assert _changes(target, []).shape == (0, 2)


def test_cameras_stand_around_the_target_and_look_at_it() -> None:
    target = np.array([0.1, -0.2, 0.05])
    places = camera_places(5, target, np.random.default_rng(8))
    headings = []
    for place in places:
        away = place.translation - target
        distance = float(np.linalg.norm(away))
        assert DISTANCE[0] <= distance <= DISTANCE[1]
        up = np.rad2deg(np.arcsin(away[2] / distance))
        assert ELEVATION[0] <= up <= ELEVATION[1]
        headings.append(np.arctan2(away[1], away[0]))
        axes = np.abs(place.rotation.T @ away / distance)
        np.testing.assert_allclose(np.sort(axes), [0.0, 0.0, 1.0], atol=1e-9)
    gaps = np.diff(np.unwrap(headings))
    np.testing.assert_allclose(gaps, 2 * np.pi / 5)


def test_encoders_are_off_by_an_offset_and_a_share() -> None:
    drawn: Any = SimpleNamespace(encoder_offset=np.array([0.1, 0.0]), encoder_scale=0.5)
    np.testing.assert_allclose(encoder_error(drawn, np.array([0.2, -0.4])), [0.2, -0.2])


@pytest.mark.parametrize("freedom", [5.0, 30.0])
def test_what_noise_hardly_exceeds_is_a_quantile_of_chi_squared(freedom: float) -> None:
    quantile = chi2.ppf(norm.cdf(SIGMAS), freedom) / freedom
    assert _unlikely(freedom) == pytest.approx(quantile, rel=0.06)


def test_a_fault_is_put_down_to_actuators_that_were_full_half_of_the_time() -> None:
    fault = Fault(reason="dropped", detail="on the table", time=1.5)
    looks = [("a", "b"), ("b",), ("c", "c"), ("b", "a")]
    told = put_down_to_actuators(fault, looks)
    assert (told.reason, told.time) == ("torque limit reached", 1.5)
    assert told.detail == "a, b stood at the limit; then: dropped, on the table"
    assert put_down_to_actuators(fault, looks, share=0.8) == fault
    assert put_down_to_actuators(fault, []) == fault
