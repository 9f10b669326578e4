"""Epsilon and volume, exact and as certified intervals: closed forms and second engines."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.optimize import linprog

from planner.contacts import ContactModel, ContactSet
from planner.errors import ContactError
from planner.quality import (
    Interval,
    RoundCones,
    ball_interval,
    epsilon_frogger,
    epsilon_l1,
    epsilon_linf,
    epsilon_round,
    measure_hull,
    primitive_wrenches,
    volume_l1,
)
from planner.spatial import FloatArray

RADIUS = 0.03  # m
TRIANGLE = [[np.cos(a), np.sin(a), 0.0] for a in 2 * np.pi / 3 * np.arange(3)]
TETRAHEDRON = [[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]]
OCTAHEDRON = np.vstack([np.eye(3), -np.eye(3)])
OPPOSED = [[1, 0, 0], [-1, 0, 0]]
SEEDS = st.integers(0, 2**32 - 1)


def on_sphere(
    directions: object,
    model: ContactModel = "point",
    mu: float = 0.5,
    mu_torsion: float = 0.2 * RADIUS,
    radius: float = RADIUS,
) -> ContactSet:
    d = np.asarray(directions, dtype=float)
    d = d / np.linalg.norm(d, axis=1, keepdims=True)
    return ContactSet.from_arrays(radius * d, -d, model=model, mu=mu, mu_torsion=mu_torsion)


def random_grasp(seed: int, model: ContactModel = "soft") -> ContactSet:
    """Three or four contacts, normals roughly inwards, on a body of some 3 cm."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(3, 5))
    p = rng.normal(size=(n, 3))
    p -= 0.9 * p.mean(axis=0)  # spread round the centre, so that most of them close
    p /= np.linalg.norm(p, axis=1, keepdims=True)
    normals = -p + 0.2 * rng.normal(size=(n, 3))
    mu, torsion = rng.uniform(0.4, 1.0, n), rng.uniform(0.1, 0.5, n) * RADIUS
    return ContactSet.from_arrays(RADIUS * p, normals, model=model, mu=mu, mu_torsion=torsion)


def three_squares(arm: float) -> ContactSet:
    """Twelve frictionless contacts whose wrenches are squares in three planes at right angles.

    With torque over ``arm`` they are (+-1, +-1) in (f_x, tau_z), (f_y, tau_x) and (f_z, tau_y).
    """
    p, n = [], []
    for i in range(3):
        for sign in (1.0, -1.0):
            for side in (1.0, -1.0):
                n.append(sign * np.eye(3)[i])
                p.append(side * arm * np.eye(3)[(i + 1) % 3])
    return ContactSet.from_arrays(p, n, model="frictionless")


# Closed forms


@pytest.mark.parametrize("d", [2, 3, 6])
def test_cross_polytope_and_cube(d: int) -> None:
    cross = np.hstack([np.eye(d), -np.eye(d)])
    assert measure_hull(cross).epsilon == pytest.approx(1 / np.sqrt(d))
    assert measure_hull(cross).volume == pytest.approx(2.0**d / float(np.prod(np.arange(1, d + 1))))
    cube = np.array(np.meshgrid(*[[-1.0, 1.0]] * d)).reshape(d, -1)
    assert measure_hull(cube).epsilon == pytest.approx(1.0)
    assert measure_hull(cube).volume == pytest.approx(2.0**d)


@pytest.mark.parametrize("mu", [0.1, 0.5, 1.0])
def test_planar_opposed_contacts(mu: float) -> None:
    # Contacts at -+r on x, torque over r: the four edges are corners of a tetrahedron whose faces
    # are +-x +- y/mu +- z/mu = 1, at 1/sqrt(1 + 2/mu^2) from the origin.
    w = np.array([[1, 1, -1, -1], [mu, -mu, mu, -mu], [-mu, mu, mu, -mu]])
    hull = measure_hull(w)
    assert hull.epsilon == pytest.approx(mu / np.sqrt(mu**2 + 2))
    assert (hull.weakest @ w).max() == pytest.approx(hull.epsilon)


def test_three_squares_have_a_closed_form_in_both_norms() -> None:
    # L1: h(u) = max over the planes of |u_a| + |u_b| >= max |(u_a, u_b)|, so the least is 1/sqrt 3.
    # L-inf: h(u) = 2 sum max(|u_a|, |u_b|), least sqrt 2 on a diagonal of one plane.
    contacts = three_squares(0.05)
    assert epsilon_l1(contacts, length=0.05) == pytest.approx(1 / np.sqrt(3))
    l1 = epsilon_round(contacts, length=0.05)
    assert l1.lower <= 1 / np.sqrt(3) <= l1.upper + 1e-12
    assert l1.width < 0.02
    for edges in (None, 4):
        linf = epsilon_linf(contacts, length=0.05, edges=edges)
        assert linf.lower <= np.sqrt(2) <= linf.upper + 1e-12
        assert linf.width < 0.2


@pytest.mark.parametrize(("torsion", "mu"), [(0.2, 0.5), (0.8, 0.5), (0.1, 0.1)])
def test_two_soft_fingers_have_a_closed_form_for_true_cones(torsion: float, mu: float) -> None:
    # Torque over the radius: weakest is either pure torsion, mu_torsion/r, or force along the line
    # of the contacts with the turn that one contact cannot feel, mu/sqrt(mu^2 + 2).
    contacts = on_sphere(OPPOSED, "soft", mu, torsion * RADIUS)
    exact = min(torsion, mu / np.sqrt(mu**2 + 2))
    interval = epsilon_round(contacts, length=RADIUS)
    assert interval.lower <= exact <= interval.upper
    assert interval.width < 0.05 * exact


@pytest.mark.parametrize("mu", [0.2, 0.5])
def test_octahedron_is_weakest_against_torque_about_a_diagonal(mu: float) -> None:
    interval = epsilon_round(on_sphere(OCTAHEDRON, mu=mu), length=RADIUS)
    assert interval.lower <= mu * np.sqrt(2 / 3) <= interval.upper + 1e-9
    assert interval.width < 0.02 * interval.upper


def test_ball_interval_of_a_shifted_ball() -> None:
    # Radius 0.7 about a point 0.2 away: the largest ball about the origin has radius 0.5.
    shift = np.array([0.0, 0.12, 0.16])

    def support(u: FloatArray) -> tuple[FloatArray, FloatArray]:
        return u @ shift + 0.7, (shift + 0.7 * u)[:, None]

    interval = ball_interval(support, np.zeros((0, 3)), rel_tol=1e-3, max_points=100)
    assert interval.lower <= 0.5 <= interval.upper
    assert interval.width <= 1e-3


def test_ball_interval_where_the_origin_is_outside_or_the_body_flat() -> None:
    far = np.array([0.0, 0.0, 1.0])

    def outside(u: FloatArray) -> tuple[FloatArray, FloatArray]:
        return u @ far + 0.7, (far + 0.7 * u)[:, None]

    def flat(u: FloatArray) -> tuple[FloatArray, FloatArray]:
        disc = u * np.array([1.0, 1.0, 0.0])
        norm = np.linalg.norm(disc, axis=1, keepdims=True)
        return norm[:, 0], (disc / np.maximum(norm, 1e-300))[:, None]

    for body in (outside, flat):
        interval = ball_interval(body, np.zeros((0, 3)), rel_tol=1e-3, max_points=100)
        assert interval == Interval(lower=0.0, upper=0.0)


# No closure: zero, never an exception


def test_full_hull_beside_the_origin_has_volume_and_no_ball() -> None:
    cube = np.array(np.meshgrid(*[[-1.0, 1.0]] * 3)).reshape(3, -1) + np.array([[3.0], [0], [0]])
    hull = measure_hull(cube)
    assert hull.epsilon == 0.0
    assert hull.volume == pytest.approx(8.0)
    # All of it lies on one side: its reach along the weakest direction is negative.
    assert hull.weakest == pytest.approx(np.array([-1.0, 0, 0]))


@pytest.mark.parametrize(
    "contacts",
    [
        ContactSet.from_arrays([], []),
        on_sphere(OPPOSED[:1], "soft"),
        on_sphere(OPPOSED),
        on_sphere(OCTAHEDRON, mu=0.0),
        ContactSet.from_arrays([[0.01, 0, 0]] * 2, [[-1, 0, 0], [1, 0, 0]], model="soft"),
        ContactSet.from_arrays(np.outer([-1, 0, 2], [0.01, 0, 0]), np.eye(3), mu=1.0),
        ContactSet.from_arrays(np.eye(3)[[0, 0, 0]] + 0.1 * np.eye(3), [[-1, 0, 0]] * 3),
    ],
    ids=["none", "one", "two points", "frictionless", "coincident", "collinear", "one side"],
)
def test_grasps_without_closure_have_epsilon_zero(contacts: ContactSet) -> None:
    assert epsilon_l1(contacts, length=RADIUS) == 0.0
    assert epsilon_frogger(contacts, half_longest_side=RADIUS) == 0.0
    assert epsilon_round(contacts, length=RADIUS) == Interval(lower=0.0, upper=0.0)
    linf = epsilon_linf(contacts, length=RADIUS)
    assert linf.lower == 0.0
    assert linf.upper < 1e-3


# Second engines


@settings(max_examples=12, deadline=None)
@given(seed=SEEDS)
def test_epsilon_agrees_with_a_linear_programme_and_with_sampling(seed: int) -> None:
    rng = np.random.default_rng(seed)
    w = primitive_wrenches(random_grasp(seed), 5, length=RADIUS)
    hull = measure_hull(w)
    assume(hull.epsilon > 0.0)

    def reach(direction: FloatArray) -> float:
        """Furthest t with t * direction in the hull."""
        solved = linprog(
            np.append(np.zeros(w.shape[1]), -1.0),
            A_eq=np.vstack([np.column_stack([w, -direction]), np.append(np.ones(w.shape[1]), 0)]),
            b_eq=np.append(np.zeros(6), 1.0),
        )
        return float(-solved.fun)

    u = rng.normal(size=(2000, 6))
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    u = np.vstack([u, hull.weakest + 0.05 * u])
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    assert (u @ w).max(axis=1).min() >= hull.epsilon - 1e-9
    assert reach(hull.weakest) == pytest.approx(hull.epsilon, rel=1e-6)
    assert min(reach(direction) for direction in u[::400]) >= hull.epsilon - 1e-9


@settings(max_examples=12, deadline=None)
@given(seed=SEEDS, model=st.sampled_from(["point", "soft"]))
def test_intervals_hold_and_are_ordered(seed: int, model: ContactModel) -> None:
    contacts = random_grasp(seed, model)
    rng = np.random.default_rng(seed)
    inner = epsilon_l1(contacts, length=RADIUS, edges=5)
    outer = epsilon_l1(contacts, length=RADIUS, edges=5, cone="circumscribed")
    exact = epsilon_round(contacts, length=RADIUS, max_points=70)
    linf = epsilon_linf(contacts, length=RADIUS, max_points=40)
    linf_inner = epsilon_linf(contacts, length=RADIUS, edges=5, max_points=40)
    assert inner <= exact.upper + 1e-9
    assert exact.lower <= outer + 1e-9
    assert linf_inner.lower <= linf.upper + 1e-9
    # Forces that sum to 1 are each in [0, 1], and n forces in [0, 1] sum to n at most.
    assert exact.lower <= linf.upper + 1e-9
    assert linf.lower <= len(contacts) * exact.upper + 1e-9
    # No direction may show a support below a lower bound.
    u = rng.normal(size=(5000, 6))
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    reach, _ = RoundCones.of(contacts, RADIUS).extremes(u)
    assert exact.lower <= max(reach.max(axis=1).min(), 0.0) + 1e-9
    assert linf.lower <= np.maximum(reach, 0.0).sum(axis=1).min() + 1e-9


@pytest.mark.parametrize("model", ["point", "soft"])
def test_linf_of_the_discretised_cone_against_every_corner(model: ContactModel) -> None:
    # Two soft or three point contacts with three edges: the Minkowski sum can be listed in full.
    directions = TRIANGLE if model == "point" else OPPOSED
    contacts = on_sphere(directions, model)
    k = 3
    columns = np.split(primitive_wrenches(contacts, k, length=RADIUS), len(contacts), axis=1)
    corners = np.zeros((6, 1))
    for group in columns:
        options = np.hstack([np.zeros((6, 1)), group])
        corners = (corners[:, :, None] + options[:, None, :]).reshape(6, -1)
    exact = measure_hull(corners).epsilon
    interval = epsilon_linf(contacts, length=RADIUS, edges=k)
    assert exact > 0.1
    assert interval.lower <= exact <= interval.upper + 1e-9
    assert interval.width < 0.06 * exact


@pytest.mark.parametrize("max_points", [30, 60, 150])
def test_more_points_narrow_the_interval_and_never_break_it(max_points: int) -> None:
    contacts = on_sphere(TETRAHEDRON, "soft")
    fine = epsilon_round(contacts, length=RADIUS, rel_tol=0.0, max_points=160)
    coarse = epsilon_round(contacts, length=RADIUS, rel_tol=0.0, max_points=max_points)
    assert coarse.lower <= fine.upper
    assert fine.lower <= coarse.upper
    assert coarse.width >= fine.width
    assert fine.width < 0.07 * fine.upper


def test_edges_converge_on_the_true_cone() -> None:
    contacts = random_grasp(4, "point")
    exact = epsilon_round(contacts, length=RADIUS, rel_tol=0.005)
    values = [epsilon_l1(contacts, length=RADIUS, edges=k) for k in (3, 6, 12)]
    assert values[0] < values[1] < values[2] <= exact.upper
    assert values[2] == pytest.approx(exact.upper, rel=0.03)


# Invariants


def test_edges_begin_at_the_phase_that_is_asked_for() -> None:
    """With k edges a phase of 2 pi / k changes nothing, and half of it puts edges between them."""
    contacts = random_grasp(4, "point")
    step = 2 * np.pi / 3

    def found(phase: float) -> float:
        return epsilon_l1(contacts, length=RADIUS, edges=3, phase=phase)

    assert found(step) == pytest.approx(found(0.0), rel=1e-9)
    turned = primitive_wrenches(contacts, 3, length=RADIUS, phase=step / 2)
    assert found(step / 2) == pytest.approx(measure_hull(turned).epsilon, rel=1e-12)
    assert abs(found(step / 2) - found(0.0)) > 1e-3 * found(0.0)


@settings(max_examples=15, deadline=None)
@given(seed=SEEDS)
def test_epsilon_and_volume_do_not_depend_on_frame_order_or_size(seed: int) -> None:
    contacts = random_grasp(seed)
    rng = np.random.default_rng(seed)
    hull = measure_hull(primitive_wrenches(contacts, 4, length=RADIUS))
    turn = pin.SE3(pin.exp3(rng.normal(size=3)), 0.1 * rng.normal(size=3))
    order = rng.permutation(len(contacts))
    relabelled = ContactSet.from_contacts([contacts[int(i)] for i in order], center=contacts.center)
    scale = 3.0
    larger = ContactSet(
        positions=scale * contacts.positions,
        frames=contacts.frames,
        models=contacts.models,
        mu=contacts.mu,
        mu_torsion=scale * contacts.mu_torsion,
        forces=contacts.forces,
        fingers=contacts.fingers,
        center=scale * contacts.center,
    )
    for other, length in (
        (contacts.transformed(turn), RADIUS),
        (relabelled, RADIUS),
        (larger, scale * RADIUS),
    ):
        assert epsilon_l1(other, length=length, edges=4) == pytest.approx(hull.epsilon, abs=1e-9)
        assert volume_l1(other, length=length, edges=4) == pytest.approx(hull.volume, rel=1e-6)


def test_torque_counts_less_with_a_longer_length() -> None:
    contacts = on_sphere(OPPOSED, "soft")
    # Torsion is the weakest here and is all torque.
    one = epsilon_l1(contacts, length=RADIUS, edges=16)
    double = epsilon_l1(contacts, length=2 * RADIUS, edges=16)
    assert double == pytest.approx(one / 2, rel=0.05)
    volume = volume_l1(contacts, length=RADIUS)
    assert volume_l1(contacts, length=2 * RADIUS) == pytest.approx(volume / 8)


def test_frogger_is_the_l1_metric_with_edges_of_unit_length() -> None:
    contacts = on_sphere(TRIANGLE, mu=0.7)
    ours = epsilon_l1(contacts, length=0.05, edges=16)
    theirs = epsilon_frogger(contacts, half_longest_side=0.05)
    assert ours == pytest.approx(np.sqrt(1 + 0.7**2) * theirs)
    assert theirs > 0
    soft = on_sphere(TRIANGLE, "soft", mu=0.7)
    assert epsilon_frogger(soft, half_longest_side=0.05) == pytest.approx(theirs)


def test_bad_arguments_are_refused_with_a_remedy() -> None:
    contacts = on_sphere(TRIANGLE)
    for call in (epsilon_l1, epsilon_round, epsilon_linf, volume_l1):
        with pytest.raises(ContactError, match="positive number of metres"):
            call(contacts, length=-1.0)
    with pytest.raises(ContactError, match="positive number of metres"):
        epsilon_frogger(contacts, half_longest_side=float("nan"))
    with pytest.raises(ContactError, match="from 3 to"):
        epsilon_linf(contacts, length=RADIUS, edges=0)
    with pytest.raises(ContactError, match="finite numbers"):
        measure_hull(np.full((6, 8), np.inf))
    with pytest.raises(ContactError, match="lower <= upper"):
        Interval(lower=1.0, upper=0.0)
