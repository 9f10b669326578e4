"""Formulas that whole plans and trials use without showing them, one by one.

Each against differences along the manifold, another library, or paper.
"""

from __future__ import annotations

from itertools import pairwise
from types import SimpleNamespace
from typing import Any

import casadi as ca
import mujoco
import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from planner.certify.robust import halved
from planner.contacts.friction import outline_faces
from planner.describe.drive import _reach, in_span
from planner.failure import Failure
from planner.files.plans import _encloses, _is_figure
from planner.forces.limits import _independent
from planner.motion.order import Lift, NoOrder
from planner.motion.path import WRIST_STEP, ObjectPath
from planner.motion.plan import standing_under
from planner.search.refine.pose import JOINT_UNIT, LENGTH_UNIT, TURN_UNIT, Movement
from planner.shapes.base import nearest_on_cylinder
from planner.shapes.vessels import ROW, closed_shell, spaced
from planner.spatial import SE3, FloatArray
from planner.synthesis.symbols import mrp_rates
from planner.synthesis.terms.fingers import between_segments, closest_on_segments
from planner.task import Obstacle
from planner.tools import _turn_between
from sim.contacts.reading import body_twist
from sim.controllers.base import CREEP, PadReading, PoseUncertainty
from sim.controllers.impedance import ImpedanceGains, ImpedanceLaw
from sim.crosscheck.compare import _times
from sim.datasets.reset_states.shards import direction_cells
from sim.manipulation.log import SPAN, wandering
from sim.protocols.shake_pushes import LEAST, PAUSE, PUSH_TIME, Shaker, _force_at, drawn_pushes
from sim.scene.carrier import _on
from sim.scene.gantry import Gantry
from sim.sensing.touch.exact import spread_with_slopes
from sim.sensing.touch.layout import _fill_of


def turn_of(s: FloatArray) -> FloatArray:
    """Rotation (3, 3) of modified Rodrigues parameters."""
    return np.asarray(Rotation.from_mrp(s).as_matrix())


@pytest.mark.parametrize("seed", range(5))
def test_rates_of_rodrigues_parameters_are_those_of_differences(seed: int) -> None:
    s = np.random.default_rng(seed).uniform(-0.8, 0.8, 3)
    differences = [
        pin.log3(turn_of(s - step).T @ turn_of(s + step)) / 2e-6 for step in 1e-6 * np.eye(3)
    ]
    np.testing.assert_allclose(mrp_rates(s), np.array(differences).T, atol=1e-8)


def test_twists_of_bodies_are_the_differences_of_their_poses() -> None:
    """In a tree of two bodies, so that MuJoCo's reference point is at neither of them."""
    model = mujoco.MjModel.from_xml_string(
        "<mujoco><worldbody><body pos='0.3 -0.2 0.5'><freejoint/><geom size='0.1' mass='1'/>"
        "<body pos='0.2 0.1 0'><joint axis='0 1 1'/><geom size='0.05' pos='0.1 0 0' mass='2'/>"
        "</body></body></worldbody></mujoco>"
    )
    data, rng = mujoco.MjData(model), np.random.default_rng(1)
    mujoco.mj_integratePos(model, data.qpos, rng.normal(size=model.nv), 1.0)
    data.qvel[:] = rng.normal(size=model.nv)
    mujoco.mj_forward(model, data)
    scene: Any = SimpleNamespace(root_of_body=model.body_rootid)
    begin = data.qpos.copy()
    for body in (1, 2):
        twist = body_twist(scene, data, body)
        poses = []
        for step in (-1e-6, 1e-6):
            other = mujoco.MjData(model)
            other.qpos[:] = begin
            mujoco.mj_integratePos(model, other.qpos, data.qvel, step)
            mujoco.mj_kinematics(model, other)
            poses.append(SE3(other.xmat[body].reshape(3, 3), other.xpos[body]))
        there = pin.log6(poses[1] * poses[0].inverse()) / 2e-6  # spatial: at the world's origin
        np.testing.assert_allclose(twist, [*there.angular, *there.linear], atol=1e-7)


def test_the_way_between_segments_is_the_same_as_an_expression_and_in_arrays() -> None:
    ends = np.random.default_rng(2).normal(size=(4, 40, 3))
    one, two = closest_on_segments(*ends)
    corners = [ca.SX.sym(name, 3) for name in ("p1", "q1", "p2", "q2")]
    way = ca.Function("way", corners, [between_segments(*corners)])
    for k in range(40):
        found = np.array(way(*ends[:, k])).ravel()
        np.testing.assert_allclose(found, two[k] - one[k], atol=1e-9)


@pytest.mark.parametrize("size", [2, 3, 4])
def test_outlines_of_a_cone_lie_around_it_and_inside(size: int) -> None:
    """By the definitions: the outer one holds all of the cone, the inner one nothing beyond."""
    rng = np.random.default_rng(size)
    tails = rng.normal(size=(500, size - 1))
    tails /= np.linalg.norm(tails, axis=1, keepdims=True)
    np.testing.assert_allclose(outline_faces(size, inner=False).sum(axis=0)[1:], 0.0, atol=1e-9)
    within, beyond = (np.column_stack([np.full(500, head), tails]) for head in (1.0, 1.0 - 1e-9))
    assert (outline_faces(size, inner=False) @ within.T <= 1e-12).all()
    assert (outline_faces(size, inner=True) @ beyond.T > 0).any(axis=0).all()
    finest = {2: 1.0, 3: 0.99, 4: 0.97}[size]  # both are near the cone
    assert (outline_faces(size, inner=False) @ (within * [finest, *[1.0] * (size - 1)]).T).max(
        axis=0
    ).min() >= -0.02
    narrow = within * [1.0, *[finest**2] * (size - 1)]
    assert (outline_faces(size, inner=True) @ narrow.T <= 1e-12).all()


def test_four_parts_of_a_triangle_of_directions_fill_its_cone() -> None:
    """Solid angles add up, and every corner is a unit vector."""

    def solid_angle(t: FloatArray) -> float:
        a, b, c = t
        return float(
            2 * np.arctan2(np.linalg.det(t), 1 + a @ b + b @ c + c @ a)  # Van Oosterom, Strackee
        )

    whole = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))[0]
    whole *= np.sign(np.linalg.det(whole))
    whole[2] = (whole[0] + whole[1] + 2 * whole[2]) / np.sqrt(6)
    parts = halved(whole)
    np.testing.assert_allclose(np.linalg.norm(parts, axis=2), 1.0)
    assert all(solid_angle(part) > 0 for part in parts)
    assert sum(map(solid_angle, parts)) == pytest.approx(solid_angle(whole))


@pytest.mark.parametrize(("steps", "shares"), [(0.0, 1), (1.0, 2), (3.0, 4), (3.01, 5)])
def test_forces_of_a_turned_wrist_are_asked_for_once_per_step(steps: float, shares: int) -> None:
    path: Any = SimpleNamespace(wrist_turn=np.array([0.0, steps * WRIST_STEP, 0.0]))
    getter: Any = ObjectPath.wrist_shares
    found = getter.fget(path)
    np.testing.assert_allclose(found, np.linspace(0.0, 1.0, shares) if shares > 1 else [0.0])


def test_what_carries_the_object_stands_below_the_target_too() -> None:
    """Moved level by as far as the object is, whatever its height; nothing for the same place."""
    shelf = Obstacle(
        name="shelf",
        size=np.array([0.1, 0.1, 0.02]),
        T_world_obstacle=SE3(np.eye(3), np.array([0.3, 0.2, 0.05])),
    )
    start = SE3(np.eye(3), np.array([0.3, 0.2, 0.1]))
    task: Any = SimpleNamespace(T_world_object=start, carrying=(shelf,))
    (copy,) = standing_under(task, SE3(np.eye(3), np.array([0.1, 0.5, 0.4])))
    np.testing.assert_allclose(copy.T_world_obstacle.translation, [0.1, 0.5, 0.05])
    assert copy.name == "shelf at the target"
    assert standing_under(task, SE3(np.eye(3), np.array([0.3, 0.2, 0.4]))) == ()


@settings(max_examples=20)
@given(seed=st.integers(0, 2**32 - 1))
def test_the_least_turn_between_directions(seed: int) -> None:
    """It is a rotation, puts one on the other, and turns by the angle between them."""
    rng = np.random.default_rng(seed)
    a, b = rng.normal(size=(2, 3))
    a, b = a / np.linalg.norm(a), b / np.linalg.norm(b)
    for end in (b, a, -a):
        turn = _turn_between(a, end)
        np.testing.assert_allclose(turn @ a, end, atol=1e-9)
        np.testing.assert_allclose(turn @ turn.T, np.eye(3), atol=1e-9)
        assert np.linalg.det(turn) == pytest.approx(1.0)
        angle = np.arccos(np.clip((np.trace(turn) - 1) / 2, -1, 1))
        assert angle == pytest.approx(np.arccos(np.clip(a @ end, -1, 1)), abs=1e-6)


@settings(max_examples=20)
@given(seed=st.integers(0, 2**32 - 1))
def test_products_of_quaternions_are_those_of_mujoco(seed: int) -> None:
    a, b = np.random.default_rng(seed).normal(size=(2, 4))
    theirs = np.zeros(4)
    mujoco.mju_mulQuat(theirs, a, b)
    np.testing.assert_allclose(_times(a, b), theirs, atol=1e-12)


def test_nearest_points_of_a_cylinder_are_no_farther_than_any_other() -> None:
    """Points in it, beside it, above it and off its rim against a fine net of its surface."""
    rng, radius, half = np.random.default_rng(5), 0.03, 0.05
    points = rng.uniform([-0.06, -0.06, -0.1], [0.06, 0.06, 0.1], (60, 3))
    found, normals = nearest_on_cylinder(points, radius, half)
    angle = rng.uniform(0, 2 * np.pi, 40_000)
    flat = np.column_stack([np.cos(angle), np.sin(angle)])
    side = np.column_stack([radius * flat, rng.uniform(-half, half, len(flat))])
    end = np.column_stack([radius * np.sqrt(rng.uniform(0, 1, (len(flat), 1))) * flat, side[:, 2]])
    end[:, 2] = half * np.sign(end[:, 2])
    net = np.vstack([side, end])
    least = [np.linalg.norm(net - p, axis=1).min() for p in points]
    mine = np.linalg.norm(found - points, axis=1)
    assert (mine <= np.array(least) + 1e-9).all()
    assert (mine >= np.array(least) - 6e-4).all()  # on the surface, as finely as the net is
    outside = (np.hypot(*points[:, :2].T) > radius) | (np.abs(points[:, 2]) > half)
    signs = np.where(outside, 1.0, -1.0)
    np.testing.assert_allclose(found + (signs * mine)[:, None] * normals, points, atol=1e-9)


def test_how_shares_of_a_gaussian_grow_is_what_differences_say() -> None:
    edges = np.linspace(-0.004, 0.004, 6)
    middle, deviation = np.array([[0.0007]]), np.array([[0.0015]])
    _, slopes, widths = spread_with_slopes(edges, middle, deviation)

    def logarithms(m: FloatArray, d: FloatArray) -> FloatArray:
        return spread_with_slopes(edges, m, d)[0]

    step = 1e-7
    moved = logarithms(middle + step, deviation) - logarithms(middle - step, deviation)
    np.testing.assert_allclose(slopes, moved / (2 * step) * deviation, rtol=1e-6, atol=1e-6)
    grown = logarithms(middle, deviation * (1 + 1e-5)) - logarithms(middle, deviation * (1 - 1e-5))
    np.testing.assert_allclose(widths, grown / 2e-5, rtol=1e-6, atol=1e-6)


def test_deviations_of_a_believed_pose_are_of_place_and_of_turn() -> None:
    covariance = np.diag([1.0, 4.0, 4.0, 16.0, 16.0, 4.0])
    belief = PoseUncertainty(covariance=covariance, known=True)
    assert belief.position_deviation == pytest.approx(3.0)
    assert belief.rotation_deviation == pytest.approx(6.0)


def test_the_distance_of_a_movement_adds_its_four_parts_in_their_units() -> None:
    contacts, joints = np.array([0.003, 0.004]), np.array([0.1, -0.3])
    values: dict[str, Any] = {
        "contacts": contacts,
        "shift": 0.005,
        "turn": 0.2,
        "joints": joints,
    }
    squares = (
        (9e-6 + 16e-6) / 2 / LENGTH_UNIT**2
        + 25e-6 / LENGTH_UNIT**2
        + 0.04 / TURN_UNIT**2
        + (0.01 + 0.09) / 2 / JOINT_UNIT**2
    )
    moved = Movement(**values)
    assert moved.distance == pytest.approx(np.sqrt(squares))
    assert moved.joint == pytest.approx(0.3)


def test_contacts_that_move_evenly_wander_at_their_speed() -> None:
    """Also at both ends, where there is only one side to look to."""
    time = np.linspace(0.0, 0.07, 3 * SPAN + 2)
    points = time[:, None, None] * np.array([[[0.03, 0.0, 0.04], [0.0, 0.0, 0.0]]])
    np.testing.assert_allclose(wandering(time, points), np.tile([0.05, 0.0], (len(time), 1)))
    assert np.isnan(wandering(time[:1], points[:1])).all()


def test_a_path_is_followed_through_its_postures_at_the_rate_of_its_differences() -> None:
    path = np.random.default_rng(6).normal(size=(4, 3))
    for k in range(4):
        np.testing.assert_allclose(_on(path, k / 3, 1.0)[0], path[k], atol=1e-12)
    for share in (0.1, 0.5, 0.9):
        ahead, behind = _on(path, share + 1e-6, 1.0)[0], _on(path, share - 1e-6, 1.0)[0]
        np.testing.assert_allclose(_on(path, share, 0.7)[1], 0.7 * (ahead - behind) / 2e-6)


def test_cells_of_directions_are_of_one_size() -> None:
    """Directions fall into 72 cells evenly, and the poles belong to some."""
    directions = np.random.default_rng(7).normal(size=(200_000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    counts = np.bincount(direction_cells(directions), minlength=72)
    assert len(counts) == 72
    np.testing.assert_allclose(counts, len(directions) / 72, rtol=0.1)
    poles = direction_cells(np.array([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0], [1.0, -1e-18, 0.0]]))
    assert ((poles >= 0) & (poles < 72)).all()


@pytest.mark.parametrize(
    ("claimed", "agrees"),
    [
        ([0.2, 0.3], True),
        ([0.15, 0.35], True),  # as far off as the true one is wide
        ([0.05, 0.3], False),
        ([0.2, 0.45], False),
        ([0.31, 0.32], False),  # beside it
        ([0.1, 0.19], False),
        ([0.3, 0.2], False),
        ([0.2], False),
        (None, False),
    ],
)
def test_claimed_intervals_agree_with_the_true_one(claimed: Any, agrees: bool) -> None:
    assert _encloses(claimed, np.array([0.2, 0.3])) == agrees


@pytest.mark.parametrize(
    ("value", "is_one"),
    [
        (1, True),
        (-0.5, True),
        (True, False),
        ("1", False),
        (None, False),
        (10**400, False),
        (float("inf"), False),
        (float("nan"), False),
    ],
)
def test_figures_are_finite_numbers(value: Any, is_one: bool) -> None:
    assert _is_figure(value) == is_one


def test_sliding_that_spinning_explains_grows_with_the_spin() -> None:
    reading: Any = SimpleNamespace(spin=np.array([0.0, 2.0, -4.0]))
    getter: Any = PadReading.creep_speed
    np.testing.assert_allclose(getter.fget(reading), CREEP * np.array([0.0, 2.0, 4.0]))


def test_a_shake_begins_and_ends_at_rest_and_reaches_its_amplitude_between() -> None:
    gantry: Any = None
    shaker = Shaker(gantry, 2, amplitude=0.02, frequency=4.0, duration=2.0)
    for end in (0.0, 2.0):
        assert shaker.coordinate(end) == pytest.approx(0.0, abs=1e-12)
        assert shaker.coordinate(end + 1e-3) - shaker.coordinate(end - 1e-3) == pytest.approx(
            0.0, abs=1e-6
        )
    found = np.array([shaker.coordinate(t) for t in np.linspace(0.3, 1.7, 1401)])
    assert found.max() == pytest.approx(0.02, rel=1e-4)
    assert found.min() == pytest.approx(-0.02, rel=1e-4)
    assert np.count_nonzero(np.diff(np.sign(found)) > 0) == 5  # at 0.5, 0.75 ... 1.5 s
    assert shaker.coordinate(0.25 + 1 / 16) == pytest.approx(0.02)


def test_pushes_do_not_overlap_and_are_as_strong_as_drawn() -> None:
    pushes = drawn_pushes(60.0, 3.0, np.random.default_rng(8))
    begins = np.array([p.begin for p in pushes])
    sizes = np.array([np.linalg.norm(p.force) for p in pushes])
    gaps = np.diff(np.append(-PUSH_TIME, begins)) - PUSH_TIME
    assert gaps.min() >= PAUSE[0] - 1e-9
    assert gaps.max() <= PAUSE[1] + 1e-9
    assert begins[-1] + PUSH_TIME < 60.0
    assert 3.0 * LEAST <= sizes.min() < 3.0 * LEAST + 0.3 < 2.7 < sizes.max() <= 3.0
    middle, gap = begins[4] + PUSH_TIME / 2, begins[4] - gaps[4] / 2
    assert np.linalg.norm(_force_at(pushes, gap)) == 0.0
    np.testing.assert_array_equal(_force_at(pushes, middle), pushes[4].force)


@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=20)
def test_where_a_gantry_puts_the_hand_and_what_puts_it_there_are_inverse(seed: int) -> None:
    """Turned hinges too; the second one by less than 90 degrees."""
    rng = np.random.default_rng(seed)
    numbers = np.zeros(6, dtype=np.int64)
    gantry = Gantry(
        T_world_base=SE3(pin.exp3(rng.normal(size=3)), rng.normal(size=3)),
        qpos=numbers,
        dof=numbers,
        ctrl=numbers,
        gains=np.zeros((2, 6)),
        hinges=pin.exp3(rng.normal(size=3)),
    )
    coordinates = np.append(rng.normal(size=3), rng.uniform(-1.4, 1.4, 3))
    np.testing.assert_allclose(gantry.coordinates(gantry.pose(coordinates)), coordinates, atol=1e-9)
    alone = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.7])
    turn = gantry.pose(alone).rotation @ gantry.T_world_base.rotation.T
    np.testing.assert_allclose(pin.log3(turn), 0.7 * gantry.hinges[:, 2], atol=1e-9)


def test_a_spring_gives_its_wrench_over_to_the_load_without_a_change() -> None:
    """A load is learned at the rate that the gains say, and what was missed is added to it."""
    gains = ImpedanceGains(
        stiffness=100.0, turning_stiffness=2.0, damping=5.0, turning_damping=0.5, learning_rate=4.0
    )
    law, wanted = ImpedanceLaw(gains), SE3(np.eye(3), np.array([0.01, 0.0, 0.0]))
    actual = SE3(pin.exp3(np.array([0.0, 0.0, -0.1])), np.zeros(3))
    spring = np.array([1.0, 0.0, 0.0, 0.0, 0.0, 0.2])
    np.testing.assert_allclose(law.wrench(wanted, actual, np.zeros(6)), spring)
    damped = spring - np.array([0.0, 5.0, 0.0, 0.5, 0.0, 0.0])
    twist = np.array([0.0, 1.0, 0.0, 1.0, 0.0, 0.0])
    np.testing.assert_allclose(law.wrench(wanted, actual, twist), damped)
    missed = np.array([0.0, 0.5, 0.0, 0.0, 0.0, 0.0])
    law.learn(0.01, missed)
    np.testing.assert_allclose(law.load, 0.04 * (spring + missed))
    np.testing.assert_allclose(law.wrench(wanted, actual, np.zeros(6)), spring + law.load)


def test_what_pads_feel_goes_along_with_the_frame_and_is_split_by_the_normal() -> None:
    rng = np.random.default_rng(9)
    normals = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    tangents = np.roll(normals, 1, axis=0)
    felt = PadReading(
        normal_force=np.array([2.0, 4.0, 0.0]),
        force=np.array([[2.0], [4.0], [0.0]]) * normals + np.array([[1.0], [1.0], [0]]) * tangents,
        position=rng.normal(size=(3, 3)),
        normal=normals,
        sliding=0.3 * tangents,
        spin=np.array([1.0, 2.0, 3.0]),
    )
    np.testing.assert_allclose(felt.tangential_force, [1.0, 1.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(felt.friction_ratio(), [0.5, 0.25, 0.0], atol=1e-12)
    np.testing.assert_allclose(felt.sliding_speed, 0.3)
    moves = [SE3(pin.exp3(rng.normal(size=3)), rng.normal(size=3)) for _ in range(3)]
    there = felt.moved(moves)
    np.testing.assert_allclose(there.friction_ratio(), felt.friction_ratio(), atol=1e-12)
    for k, move in enumerate(moves):
        np.testing.assert_allclose(there.position[k], move.act(felt.position[k]))
        for name in ("force", "normal", "sliding"):
            vector = getattr(felt, name)[k]
            np.testing.assert_allclose(getattr(there, name)[k], move.rotation @ vector)
    some = felt.of(slice(1, 3))
    np.testing.assert_array_equal(some.spin, [2.0, 3.0])
    np.testing.assert_array_equal(some.force, felt.force[1:])


def test_the_inner_side_of_a_wall_is_everywhere_as_far_as_the_wall_is_thick() -> None:
    wall, outer = 0.003, np.array([[0.0, 0.0], [0.03, 0.0], [0.05, 0.03], [0.05, 0.08]])
    outline = closed_shell(outer, wall)
    np.testing.assert_array_equal(outline[: len(outer)], outer)
    inner = outline[-len(outer) :][::-1]
    np.testing.assert_allclose(inner[0], [0.0, wall], atol=1e-12)
    for (a, b), (c, d) in zip(pairwise(outer), pairwise(inner), strict=True):
        along = (b - a) / np.linalg.norm(b - a)
        left = np.array([-along[1], along[0]])
        np.testing.assert_allclose([(c - a) @ left, (d - a) @ left], wall)
    rim = outline[len(outer) : -len(outer)]
    middle = np.array([0.05 - wall / 2, 0.08])
    np.testing.assert_allclose(np.linalg.norm(rim - middle, axis=1), wall / 2)
    assert (rim[:, 1] > 0.08).all()
    points = spaced(outline)
    gaps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    assert gaps.max() <= ROW + 1e-9
    assert len(spaced(np.array([[0.0, 0.0], [0.0, 3 * ROW]]))) == 4
    assert gaps.sum() == pytest.approx(np.linalg.norm(np.diff(outline, axis=0), axis=1).sum())


def test_fingers_are_stuck_that_no_lift_frees_and_a_proof_covers_all_of_one() -> None:
    fails = Failure(kind="open", text="open")

    def lift(finger: int, *, holds: bool = False, proven: bool = False) -> Lift:
        return Lift(
            finger=finger,
            moved=frozenset(),
            margin=0.1,
            failure=None if holds else fails,
            proven=proven,
        )

    def order(*lifts: Lift) -> NoOrder:
        return NoOrder(names=("a", "b", "c"), lifts=lifts, spans=(1.0, 2.0, 3.0), needed=3.1)

    found = order(lift(2), lift(0), lift(1, holds=True), lift(0, holds=True), lift(1))
    assert found.stuck == (2,)
    assert not found.proven
    assert not order(lift(2, proven=True), lift(2)).proven
    assert order(lift(2, proven=True), lift(2, proven=True), lift(0)).proven
    assert order(lift(2), lift(1)).stuck == (1, 2)


def test_movements_are_between_the_two_placements() -> None:
    turn = pin.exp3(np.array([0.0, 0.0, 0.3]))
    given = SE3.Identity(), np.array([0.1, 0.2]), np.zeros((2, 3))
    reached = (
        SE3(turn, np.array([0.0, 0.03, 0.04])),
        np.array([0.3, 0.1]),
        np.array([[0.0, 0.0, 0.002], [0.003, 0.004, 0.0]]),
    )
    moved = Movement.between(given, reached)
    np.testing.assert_allclose(moved.contacts, [0.002, 0.005])
    np.testing.assert_allclose(moved.joints, [0.2, -0.1])
    assert moved.shift == pytest.approx(0.05)
    assert moved.turn == pytest.approx(0.3)


@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=20)
def test_independent_columns_are_as_many_as_the_rank_and_span_the_others(seed: int) -> None:
    rng = np.random.default_rng(seed)
    rank = int(rng.integers(1, 4))
    columns = rng.normal(size=(6, rank)) @ rng.normal(size=(rank, 5))
    order = rng.permutation(6).tolist()
    chosen, others = _independent(columns, order)
    assert len(chosen) == rank
    assert sorted(chosen + others) == list(range(6))
    assert chosen == order[: len(chosen)]  # those of a random matrix come first
    for j in others:
        assert in_span(columns[j], list(columns[chosen]))
    assert not in_span(rng.normal(size=5), list(columns[chosen]))
    assert not in_span(columns[0], [])


def test_a_tendon_reaches_from_the_sum_of_its_shortest_to_that_of_its_longest_parts() -> None:
    row, lower, upper = np.array([2.0, -1.0, 0.0]), np.array([-1, 1, 5.0]), np.array([3, 4, 6.0])
    assert _reach(row, lower, upper) == (-6.0, 5.0)


def test_dead_taxels_read_what_those_around_them_do() -> None:
    """The mean of up to eight neighbours that live; nothing where none does."""

    def fill(dead: set[tuple[int, int]]) -> tuple[list[int], FloatArray]:
        layout: Any = SimpleNamespace(shape=(3, 4), array=SimpleNamespace(dead=tuple(dead)))
        found = _fill_of(layout)
        assert found is not None
        return found

    image = np.arange(12.0)
    numbers, weights = fill({(1, 1)})
    assert numbers == [5]
    assert float(weights[0] @ image) == pytest.approx(5.0)
    numbers, weights = fill({(0, 0), (0, 1)})
    assert numbers == [0, 1]
    np.testing.assert_allclose(weights @ image, [(4 + 5) / 2, (2 + 4 + 5 + 6) / 4])
    every = {(i, j) for i in range(3) for j in range(4)}
    assert (fill(every)[1] == 0.0).all()
    living: Any = SimpleNamespace(shape=(3, 4), array=SimpleNamespace(dead=()))
    assert _fill_of(living) is None
