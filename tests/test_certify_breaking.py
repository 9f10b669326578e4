"""The smallest breaking disturbance: worked by hand, against another solver, and its two sides."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import linprog

from planner.certify import Breaking, breaking_along, smallest_breaking
from planner.certify.breaking import Resistance, without_grip
from planner.contacts import ContactSet, cone_edges
from planner.errors import ContactError
from planner.forces import ForceProblem, build_force_problem
from planner.spatial import FloatArray

ARM, MU, TWIST = 0.05, 0.5, 0.01
"""Of the two soft fingers: half their distance (m), sliding (-) and torsional (m) friction."""

PRESS, WEIGHT = 10.0, 1.0
"""Greatest normal force of each finger and the object's weight, N."""


def two_fingers(model: str = "soft") -> ContactSet:
    """Two fingers that hold an object from both sides, along x."""
    return ContactSet.from_arrays(
        [[-ARM, 0, 0], [ARM, 0, 0]],
        [[1, 0, 0], [-1, 0, 0]],
        mu=0.0 if model == "frictionless" else MU,
        mu_torsion=TWIST,
        model=model,  # type: ignore[arg-type]
    )


def held(contacts: ContactSet, weight: float = WEIGHT, press: float = PRESS) -> ForceProblem:
    return build_force_problem(contacts, wrench=[0, 0, -weight, 0, 0, 0], max_normal=press)


def bears(problem: ForceProblem, wrench: FloatArray, *, edges: int) -> bool:
    """Whether forces on inscribed edges balance the problem's wrench and one more: by SciPy.

    Built from contacts and edges, with none of the code that is tested.
    """
    contacts = problem.contacts
    grasp_map, at = contacts.grasp_map(), 0
    columns, unit_normal = [], []
    for i, dim in enumerate(contacts.dims):
        twist = float(contacts.mu_torsion[i]) if dim == 4 else 0.0
        edge = cone_edges(float(contacts.mu[i]), twist, edges)[:dim]
        block = np.zeros((grasp_map.shape[1], edge.shape[1]))
        block[at : at + dim] = edge
        columns.append(block)
        unit_normal.append(at)
        at += dim
    generators = np.hstack(columns)
    n = problem.n_force
    torques = slice(6 + problem.n_faces, None)
    balance, limited = (
        np.hstack([table[:, :n] @ generators, table[:, n:]])
        for table in (problem.rows[:6], problem.rows[torques])
    )
    normals = np.pad(generators[unit_normal], ((0, 0), (0, len(problem.lower) - n)))
    tables = [normals, limited, -limited]
    most = [np.minimum(problem.upper[unit_normal], 1e6), problem.high[torques]]
    ends = np.concatenate([*most, -problem.low[torques]])
    bounded = np.isfinite(ends)
    result = linprog(
        np.zeros(balance.shape[1]),
        A_ub=np.vstack(tables)[bounded],
        b_ub=ends[bounded],
        A_eq=balance,
        b_eq=problem.low[:6] - wrench,
        bounds=[
            *[(0, None)] * generators.shape[1],
            *zip(problem.lower[n:], problem.upper[n:], strict=True),
        ],
    )
    return bool(result.status == 0)


def bisected(problem: ForceProblem, wrench: FloatArray, *, edges: int = 128) -> float:
    """Largest multiple of a wrench that is borne, by bisection."""
    low, high = 0.0, 2.0
    for _ in range(12):
        middle = 0.5 * (low + high)
        low, high = (
            (middle, high) if bears(problem, wrench * middle, edges=edges) else (low, middle)
        )
    return 0.5 * (low + high)


@pytest.fixture(scope="module")
def force() -> Breaking:
    return smallest_breaking(held(two_fingers()), "force", length=ARM)


def test_smallest_force_against_two_fingers_is_the_one_worked_by_hand(force: Breaking) -> None:
    # No torque: both fingers carry half the load L, and the weaker has mu (F - |x|) of friction,
    # so L + 2 mu |x| <= 2 mu F with L the downward load, W + z. The nearest point of that line is
    # at (2 mu F - W) / sqrt(1 + 4 mu^2), down and along x.
    exact = (2 * MU * PRESS - WEIGHT) / np.sqrt(1 + 4 * MU**2)
    assert force.bounds.lower <= exact <= force.bounds.upper
    assert force.bounds.width <= 0.01 * force.bounds.upper
    assert np.abs(force.wrench[[0, 2]] / exact) == pytest.approx([0.707, 0.707], abs=0.1)
    assert force.wrench[2] < 0


def test_torque_about_the_line_between_two_fingers_is_torsion_beside_the_load() -> None:
    # (load / mu)^2 + (torsion / mu_torsion)^2 <= F^2 for each finger, half the load each
    exact = 2 * TWIST * np.sqrt(PRESS**2 - (WEIGHT / 2 / MU) ** 2)
    found = breaking_along(held(two_fingers()), [0, 0, 0, 1.0, 0, 0])
    assert found.lower <= exact <= found.upper
    assert found.width <= 2e-3 * exact


def test_what_breaks_a_grasp_is_not_borne_and_less_is(force: Breaking) -> None:
    problem = held(two_fingers())
    at_break = breaking_along(problem, force.wrench)
    assert at_break.upper <= 1.0 + 1e-6
    assert at_break.lower >= force.bounds.lower / force.bounds.upper - 2e-3
    rng = np.random.default_rng(3)
    for direction in rng.normal(size=(40, 3)):
        wrench = np.append(force.bounds.lower * direction / np.linalg.norm(direction), np.zeros(3))
        assert breaking_along(problem, wrench).upper >= 1.0


@pytest.mark.parametrize("kind", ["force", "torque", "wrench"])
def test_an_independent_linear_programme_agrees_within_one_percent(kind: str) -> None:
    # three point contacts, not symmetric, so that friction and normal limits both matter
    angles = np.deg2rad([90.0, 205.0, 330.0])
    around = np.column_stack([np.cos(angles), np.sin(angles), [0.1, 0.0, -0.1]])
    contacts = ContactSet.from_arrays(0.04 * around, -around, mu=[0.5, 0.6, 0.7])
    problem = held(contacts, press=7.0)
    found = smallest_breaking(problem, kind, length=0.04)  # type: ignore[arg-type]
    assert found.bounds.width <= 0.011 * found.bounds.upper
    multiple = bisected(problem, found.wrench)
    assert multiple == pytest.approx(1.0, abs=0.01)
    # no direction does it with less, the least of many at random least of all
    rng = np.random.default_rng(0)
    scale = np.array([1.0, 1, 1, 0.04, 0.04, 0.04])
    used = {"force": slice(0, 3), "torque": slice(3, 6), "wrench": slice(0, 6)}[kind]
    for _ in range(25):
        direction = np.zeros(6)
        direction[used] = rng.normal(size=len(direction[used]))
        size = found.bounds.lower / (0.04 if kind == "torque" else 1.0)
        wrench = 0.99 * size * scale * direction / np.linalg.norm(direction)
        assert bears(problem, wrench, edges=128)


def test_a_disturbance_is_seen_from_the_object_too(force: Breaking) -> None:
    turn = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    seen = force.in_frame(turn)
    assert turn @ seen[:3] == pytest.approx(force.wrench[:3])


def test_turning_the_world_turns_the_wrench_and_keeps_its_size(force: Breaking) -> None:
    turn = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    contacts = two_fingers()
    turned = ContactSet.from_arrays(
        contacts.positions @ turn.T,
        contacts.normals @ turn.T,
        mu=MU,
        mu_torsion=TWIST,
        model="soft",
    )
    other = smallest_breaking(held(turned), "force", length=ARM)
    assert other.bounds.upper == pytest.approx(force.bounds.upper, rel=0.011)


def test_forces_scale_with_all_limits() -> None:
    one = smallest_breaking(held(two_fingers()), "torque", length=ARM)
    ten = smallest_breaking(held(two_fingers(), 10 * WEIGHT, 10 * PRESS), "torque", length=ARM)
    assert ten.bounds.lower == pytest.approx(10 * one.bounds.lower, rel=0.011)


def test_a_weight_that_is_not_held_breaks_at_nothing() -> None:
    found = smallest_breaking(held(two_fingers(), weight=11.0), "force", length=ARM)
    assert (found.bounds.lower, found.bounds.upper) == (0.0, 0.0)
    assert breaking_along(held(two_fingers(), weight=11.0), [1.0, 0, 0, 0, 0, 0]).upper == 0.0


def test_a_hand_without_limits_bears_any_force_but_not_what_no_contact_resists() -> None:
    free = build_force_problem(two_fingers(), wrench=[0, 0, -WEIGHT, 0, 0, 0])
    found = smallest_breaking(free, "force", length=ARM)
    assert found.bounds.upper == np.inf
    assert found.bounds.lower > 900 * WEIGHT
    assert found.as_dict()["upper"] is None
    points = build_force_problem(two_fingers("point"), wrench=[0, 0, -WEIGHT, 0, 0, 0])
    assert smallest_breaking(points, "torque", length=ARM).bounds.upper < 1e-6


def test_without_friction_or_contacts_nothing_is_held() -> None:
    assert (
        smallest_breaking(held(two_fingers("frictionless")), "force", length=ARM).bounds.upper == 0
    )
    none = ContactSet.from_arrays(np.zeros((0, 3)), np.zeros((0, 3)))
    assert smallest_breaking(held(none), "wrench", length=ARM).bounds.upper == 0


def test_a_grip_that_the_problem_asks_for_is_not_kept() -> None:
    gripped = build_force_problem(
        two_fingers(), wrench=[0, 0, -WEIGHT, 0, 0, 0], max_normal=PRESS, min_normal=8.0
    )
    free = without_grip(gripped)
    assert (free.lower[[0, 4]] == 0.0).all()
    assert gripped.lower[0] == 8.0
    kept = smallest_breaking(gripped, "force", length=ARM).bounds
    assert kept.upper == pytest.approx(
        smallest_breaking(held(two_fingers()), "force", length=ARM).bounds.upper, rel=0.011
    )


@pytest.mark.parametrize("direction", np.vstack([np.eye(3), -np.eye(3), [[1, 2, -3]]]))
def test_the_two_sides_of_a_support_value_enclose_the_truth(direction: FloatArray) -> None:
    problem = held(two_fingers())
    oracle = Resistance(problem, np.eye(6)[:, :3], gap=1e-3)
    assert oracle.held
    bound, point = oracle.support(direction)
    assert direction @ point <= bound
    assert direction @ point >= (1 - 2e-3) * bound
    wrench = np.append(point, np.zeros(3))
    assert bears(problem, 0.99 * wrench, edges=128)


def test_bad_questions_are_refused() -> None:
    with pytest.raises(ContactError, match="force"):
        smallest_breaking(held(two_fingers()), "push", length=ARM)  # type: ignore[arg-type]
    with pytest.raises(ContactError, match="positive"):
        smallest_breaking(held(two_fingers()), "force", length=0.0)
    for bad in (np.zeros(6), np.ones(3), np.full(6, np.nan)):
        with pytest.raises(ContactError, match="six finite numbers"):
            breaking_along(held(two_fingers()), bad)
