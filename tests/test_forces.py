"""Contact forces: answers by hand, optimality, invariants, and an independent programme."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from numpy.typing import ArrayLike
from scipy.optimize import linprog, nnls
from scipy.spatial import HalfspaceIntersection

from planner.contacts import ContactModel, ContactSet, Pyramid, cone_edges, pyramid_faces
from planner.errors import ContactError, NotFoundError, ObjectError
from planner.forces import (
    ForceLoop,
    ForceSolution,
    QuadraticCost,
    build_force_problem,
    distribute_forces,
    gravity_wrench,
)
from planner.forces.limits import friction_part
from planner.forces.problem import torque_table
from planner.quality import primitive_wrenches
from planner.spatial import FloatArray

RADIUS = 0.03  # m
MASS, G = 0.1, 9.81
WEIGHT = gravity_wrench(MASS, [0, 0, -G])
CONES: list[Pyramid] = ["inscribed", "circumscribed"]
SEEDS = st.integers(0, 2**32 - 1)
BARELY = 50.0
"""Grasps that need normal forces above this multiple of the wrench are left out of random tests:
they are feasible by a hair."""


def on_sphere(directions: ArrayLike, **options: Any) -> ContactSet:
    d = np.asarray(directions, dtype=float)
    d = d / np.linalg.norm(d, axis=1, keepdims=True)
    return ContactSet.from_arrays(RADIUS * d, -d, **{"mu": 0.5, **options})


def opposed(**options: Any) -> ContactSet:
    """Two contacts on the x axis; vertical is along a tangent of both."""
    return on_sphere([[1, 0, 0], [-1, 0, 0]], **options)


def random_case(seed: int) -> tuple[ContactSet, FloatArray]:
    """Two to five contacts of mixed models on a ball, and a wrench."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(2, 6))
    p = rng.normal(size=(n, 3))
    p /= np.linalg.norm(p, axis=1, keepdims=True)
    models: list[ContactModel] = [
        ("frictionless", "point", "soft", "soft")[i] for i in rng.integers(0, 4, n)
    ]
    contacts = ContactSet.from_arrays(
        RADIUS * p,
        -p + 0.3 * rng.normal(size=(n, 3)),
        model=models,
        mu=rng.uniform(0.2, 1.0, n) * (rng.random(n) < 0.9),
        mu_torsion=rng.uniform(0.002, 0.02, n),
    )
    return contacts, rng.normal(size=6) * [1, 1, 1, 0.01, 0.01, 0.01]


def cone_combination(contacts: ContactSet, rng: np.random.Generator) -> FloatArray:
    """Random forces (n, 4) strictly inside the inscribed pyramids, some newtons each."""
    forces = []
    for i in range(len(contacts)):
        contact = contacts[i]
        edges = cone_edges(contact.mu, contact.mu_torsion)
        forces.append(edges @ rng.uniform(0.05, 0.5, edges.shape[1]))
    return np.array(forces)


def least_normal_sum(contacts: ContactSet, wrench: FloatArray, cone: Pyramid) -> float | None:
    """Least sum of normal forces by a programme on the cones' EDGES; None if there is none."""
    edges = primitive_wrenches(contacts, 8, cone=cone, length=RADIUS)
    scaled = wrench / [1, 1, 1, RADIUS, RADIUS, RADIUS]
    result = linprog(np.ones(edges.shape[1]), A_eq=edges, b_eq=-scaled, bounds=(0, None))
    return float(result.fun) if result.status == 0 else None


def variables(solution: ForceSolution) -> FloatArray:
    problem = solution.problem
    dims = problem.contacts.dims
    parts = [f[:d] for f, d in zip(solution.forces, dims, strict=True)]
    return np.concatenate(parts)


def check_answer(solution: ForceSolution) -> None:
    """Feasible by our own arithmetic, and a Karush-Kuhn-Tucker point."""
    problem, x = solution.problem, variables(solution)
    assert solution.found
    assert solution.reason == ""
    tolerance = 1e-6 * problem.force_scale
    assert solution.contacts.wrench() == pytest.approx(-problem.wrench, abs=tolerance)
    for i, f in enumerate(solution.forces):
        c = problem.contacts[i]
        reach = max(f[0], 0.0) / np.cos(np.pi / 8) + tolerance
        assert np.hypot(f[1], f[2]) <= c.mu * reach
        assert abs(f[3]) <= c.mu_torsion * reach
    # cost x is a combination of A's rows and, with the right sign, of the active limits' rows.
    eps = 1e-5 * problem.force_scale
    unit = problem.column_scale
    eye = np.eye(len(x))
    active = [
        -problem.faces[problem.faces @ x > -eps],
        eye[(x - problem.lower) / unit < eps],
        -eye[(problem.upper - x) / unit < eps],
        problem.rows[:6],
        -problem.rows[:6],
    ]
    rows = np.vstack(active) * unit
    rows /= np.maximum(np.linalg.norm(rows, axis=1, keepdims=True), 1e-12)
    gradient = problem.cost * x * unit
    _, residual = nnls(rows.T, gradient, maxiter=1000)
    assert residual < 1e-5 * np.linalg.norm(gradient)


# By hand


@pytest.mark.parametrize(
    ("cone", "turn", "gain"),
    [
        ("inscribed", 0.0, 1.0),  # the weight is along a corner: the whole friction
        ("inscribed", np.pi / 8, np.cos(np.pi / 8)),  # along the middle of a side
        ("circumscribed", 0.0, 1 / np.cos(np.pi / 8)),
        ("circumscribed", np.pi / 8, 1.0),
    ],
)
def test_two_opposed_contacts_hold_a_weight(cone: Pyramid, turn: float, gain: float) -> None:
    """Each carries m g / 2 by friction, so presses with m g / (2 mu gain)."""
    down = [0.0, np.sin(turn), -np.cos(turn)]
    wrench = gravity_wrench(MASS, G * np.array(down))
    solution = distribute_forces(opposed(), wrench=wrench, cone=cone)
    check_answer(solution)
    assert solution.forces[:, 0] == pytest.approx([MASS * G / (2 * 0.5 * gain)] * 2)
    assert solution.contacts.forces_in_axes()[:, 1:] == pytest.approx(
        np.tile(-MASS * G / 2 * np.array(down[1:]), (2, 1)), abs=1e-6
    )
    assert solution.unresisted_wrench == pytest.approx(np.zeros(6))
    assert solution.fraction == 1.0


def test_three_symmetric_contacts_share_a_weight() -> None:
    angle = 2 * np.pi / 3 * np.arange(3)
    contacts = on_sphere(np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1))
    solution = distribute_forces(contacts, wrench=WEIGHT)
    check_answer(solution)
    assert solution.forces[:, 0] == pytest.approx([MASS * G / 3 / 0.5] * 3)
    assert solution.contacts.forces_in_axes()[:, 2] == pytest.approx([MASS * G / 3] * 3)


def test_a_contact_below_carries_the_weight_without_friction() -> None:
    for model in ("frictionless", "point", "soft"):
        contacts = on_sphere([[0, 0, -1]], model=model, mu=0.0, mu_torsion=0.0)
        solution = distribute_forces(contacts, wrench=WEIGHT)
        assert solution.found
        assert solution.forces[0] == pytest.approx([MASS * G, 0, 0, 0], abs=1e-9)


@pytest.mark.parametrize("cone", CONES)
def test_soft_fingers_resist_torsion(cone: Pyramid) -> None:
    """Torque t about the line of two soft fingers: t / 2 each, f_n = t / (2 mu_torsion)."""
    solution = distribute_forces(
        opposed(model="soft", mu_torsion=0.005), wrench=[0, 0, 0, 0.01, 0, 0], cone=cone
    )
    check_answer(solution)
    assert solution.forces[:, 0] == pytest.approx([1.0, 1.0])
    assert solution.forces[:, 3] == pytest.approx([0.005, -0.005])


def test_soft_fingers_share_torsion_by_the_square_of_their_friction() -> None:
    """Least (t1 / a1)^2 + (t2 / a2)^2 with t1 + t2 = t, away from every cone: t1 / t2 = 4."""
    contacts = opposed(model="soft", mu_torsion=[0.01, 0.005])
    solution = distribute_forces(contacts, wrench=[0, 0, 0, 0.01, 0, 0], min_normal=10.0)
    check_answer(solution)
    assert solution.forces[:, 3] == pytest.approx([0.008, -0.002])


def test_bounds_on_the_normal_force_and_friction_scale() -> None:
    grip = distribute_forces(opposed(), wrench=WEIGHT, min_normal=[2.0, 0.0])
    assert grip.forces[:, 0] == pytest.approx([2.0, 2.0])
    margin = distribute_forces(opposed(), wrench=WEIGHT, friction_scale=0.8)
    assert margin.forces[:, 0] == pytest.approx([MASS * G / (2 * 0.4)] * 2)
    assert margin.contacts.friction_utilisation() == pytest.approx([0.8, 0.8])
    assert not distribute_forces(opposed(), wrench=WEIGHT, max_normal=[9.0, 0.9]).found


def test_a_cost_on_tangential_forces_brings_forces_nearer_the_normals() -> None:
    contacts = on_sphere([[1, 0, -0.5], [-1, 0, -0.5], [0, 1, -0.2], [0, -1, -0.2]], mu=1.0)
    tangential = np.delete(np.eye(12), [0, 3, 6, 9], axis=0)
    shares = []
    for weight in (0.0, 4.0, 19.0):
        cost = QuadraticCost.of_residual(tangential, np.zeros(8), weight=weight, name="tangential")
        solution = distribute_forces(contacts, wrench=WEIGHT, costs=[cost])
        check_answer(solution)
        shares.append(float(solution.contacts.friction_utilisation().max()))
    assert shares[0] > shares[1] > shares[2]


def test_nothing_asked_nothing_done() -> None:
    assert distribute_forces(opposed(), wrench=np.zeros(6)).forces == pytest.approx(
        np.zeros((2, 4))
    )
    nobody = ContactSet.from_arrays(np.zeros((0, 3)), np.zeros((0, 3)))
    empty = distribute_forces(nobody, wrench=np.zeros(6))
    assert empty.found
    assert empty.forces.shape == (0, 4)


# Friction pyramids


def corners(mu: float, mu_torsion: float, edges: int, cone: Pyramid) -> FloatArray:
    """Corners (m, 3) of f_t1, f_t2, tau_n at f_n = 1 that the faces have."""
    faces = pyramid_faces(mu, mu_torsion, edges, cone) / [1, 1, 1, 1]
    scaled = faces[:, 1:] * [mu, mu, mu_torsion]  # qhull likes sizes about 1
    if mu_torsion == 0:
        hull = HalfspaceIntersection(np.column_stack([scaled[:, :2], faces[:, 0]]), np.zeros(2))
        points = np.column_stack([hull.intersections, np.zeros(len(hull.intersections))])
    else:
        hull = HalfspaceIntersection(np.column_stack([scaled, faces[:, 0]]), np.zeros(3))
        points = hull.intersections
    return np.unique(np.round(points * [mu, mu, mu_torsion or 1.0], 9), axis=0)


@pytest.mark.parametrize("cone", CONES)
@pytest.mark.parametrize("edges", [3, 4, 8, 13])
@pytest.mark.parametrize("mu_torsion", [0.0, 0.01])
def test_faces_have_exactly_the_corners_of_the_edges(
    cone: Pyramid, edges: int, mu_torsion: float
) -> None:
    """Faces and edges are one polyhedron."""
    wanted = cone_edges(0.6, mu_torsion, edges, cone=cone)[1:].T
    have = corners(0.6, mu_torsion, edges, cone)
    wanted = np.unique(np.round(wanted, 9) + 0.0, axis=0)
    assert len(have) == len(wanted)
    gaps = np.linalg.norm(have[:, None] - wanted[None], axis=2)
    assert gaps.min(axis=0).max() < 1e-8
    assert gaps.min(axis=1).max() < 1e-8


def test_torsion_alone_and_no_friction_at_all() -> None:
    assert pyramid_faces(0.0, 0.01, 8, "inscribed") @ [1, 0, 0, 0.01] == pytest.approx([0, -2])
    assert pyramid_faces(0.0, 0.0, 8, "inscribed").shape == (0, 4)


# Optimality, invariance, and the second programme


@settings(max_examples=40, deadline=None)
@given(seed=SEEDS, cone=st.sampled_from(CONES))
def test_found_if_and_only_if_the_edges_can_balance_the_wrench(seed: int, cone: Pyramid) -> None:
    contacts, wrench = random_case(seed)
    least = least_normal_sum(contacts, wrench, cone)
    size = np.linalg.norm(wrench / [1, 1, 1, RADIUS, RADIUS, RADIUS])
    assume(least is None or least < BARELY * size)
    solution = distribute_forces(contacts, wrench=wrench, cone=cone)
    assert solution.found == (least is not None)
    if solution.found and least is not None:
        check_answer(solution)
        assert solution.forces[:, 0].sum() >= least - 1e-5
    else:
        assert np.isnan(solution.forces).all()
        assert solution.fraction == pytest.approx(0.0, abs=1e-9)  # cones: all or nothing


@settings(max_examples=15, deadline=None)
@given(seed=SEEDS)
def test_what_the_inscribed_pyramid_holds_the_circumscribed_holds_with_less(seed: int) -> None:
    contacts, _ = random_case(seed)
    within = cone_combination(contacts, np.random.default_rng(seed + 1))
    wrench = -contacts.with_forces(within).wrench()
    inner, outer = (distribute_forces(contacts, wrench=wrench, cone=c) for c in CONES)
    assert inner.found
    assert outer.found
    cost_in, cost_out = (float((s.problem.cost * variables(s) ** 2).sum()) for s in (inner, outer))
    assert cost_out <= cost_in * (1 + 1e-6)


@pytest.mark.parametrize("scale", [1e-3, 1e3])
def test_forces_scale_with_the_wrench(scale: float) -> None:
    contacts = on_sphere([[1, 0.2, 0], [-1, 0.5, 0], [0, -1, 0.3]], model="soft", mu_torsion=0.01)
    base = distribute_forces(contacts, wrench=WEIGHT)
    big = distribute_forces(contacts, wrench=scale * WEIGHT)
    check_answer(big)
    assert big.forces == pytest.approx(scale * base.forces, abs=scale * 1e-6)


def test_forces_turn_with_everything() -> None:
    contacts = on_sphere([[1, 0.2, 0], [-1, 0.5, 0], [0, -1, 0.3]], model="soft", mu_torsion=0.01)
    base = distribute_forces(contacts, wrench=WEIGHT)
    pose = pin.SE3(pin.exp3(np.array([0.4, -1.0, 2.0])), np.array([1.0, -2.0, 0.5]))
    turned = np.concatenate([pose.rotation @ WEIGHT[:3], np.zeros(3)])
    moved = distribute_forces(contacts.transformed(pose), wrench=turned)
    assert moved.forces == pytest.approx(base.forces, abs=1e-6)


# Bad input, and what a person reads


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"wrench": [0, 0, np.nan, 0, 0, 0]}, "wrench holds NaN"),
        ({"wrench": [0, 0, 1]}, r"wrench has shape \(3,\); give \(6,\)"),
        ({"edges": 2}, "from 3 to 512"),
        ({"cone": "flat"}, "use 'inscribed', 'circumscribed' or 'round'"),
        ({"min_normal": -1.0}, "0 <= min_normal <= max_normal"),
        ({"min_normal": 2.0, "max_normal": 1.0}, "0 <= min_normal <= max_normal"),
        ({"max_normal": np.nan}, "max_normal holds NaN"),
        ({"max_normal": [1.0, 2.0, 3.0]}, r"give a number or \(2,\)"),
        ({"friction_scale": 0.0}, r"factor in \(0, 1\]"),
        ({"gravity_torque": [0.0]}, "without jacobians"),
        ({"jacobians": np.zeros((2, 4, 1))}, r"give \(2, 3 or 6, nv\)"),
        ({"jacobians": np.full((2, 3, 1), np.nan)}, "jacobians hold NaN"),
        ({"q": [0.0]}, "q is given without an actuation"),
    ],
)
def test_bad_input_says_what_to_give(options: dict[str, Any], message: str) -> None:
    with pytest.raises(ContactError, match=message):
        build_force_problem(opposed(), **{"wrench": WEIGHT, **options})


def test_unknown_solver_lists_what_is_installed() -> None:
    with pytest.raises(NotFoundError, match=r"no installed QP solver is called 'osqq'.*osqp"):
        distribute_forces(opposed(), wrench=WEIGHT, solver="osqq")


def test_gravity_wrench() -> None:
    assert gravity_wrench(2.0, [0, 1, -3]) == pytest.approx([0, 2, -6, 0, 0, 0])
    with pytest.raises(ObjectError, match="mass is -1"):
        gravity_wrench(-1.0, [0, 0, -G])
    with pytest.raises(ObjectError, match="gravity"):
        gravity_wrench(1.0, [0, 0, np.nan])


def test_a_problem_prints_its_rows_and_columns() -> None:
    problem = build_force_problem(opposed(fingers=["thumb", "index"]), wrench=WEIGHT, max_normal=7)
    text = str(problem)
    assert (
        "2 contacts, 6 columns (6 contact, 0 excess, 0 repeated actuator or stop), 6 rows" in text
    )
    assert "0 <= thumb f_n <= 7" in text
    assert "force x: -1 thumb f_n +1 index f_n = 0" in text
    assert "friction of index: 8 faces" in text
    assert len(problem.column_names) == problem.rows.shape[1] == problem.faces.shape[1]


@pytest.mark.parametrize("n", [2, 24])
def test_answers_print_as_a_screen(n: int) -> None:
    at = np.linspace(0, 2 * np.pi, n, endpoint=False)
    places = 0.03 * np.stack([np.cos(at), np.sin(at), 0 * at], axis=1)
    contacts = ContactSet.from_arrays(
        places, -places, model="soft", mu_torsion=0.01, fingers=["a finger"] * n
    )
    found = distribute_forces(contacts, wrench=WEIGHT)
    refused = distribute_forces(contacts, wrench=WEIGHT, max_normal=0.01)
    texts = [str(found), str(refused), str(found.problem)]
    assert all(0 < len(text) < 3000 for text in texts)
    assert all(len(repr(x)) < 200 for x in (found, refused, found.problem))
    assert "found by daqp" in texts[0]
    used = 100 * found.contacts.friction_utilisation()[0]
    words = next(line for line in texts[0].splitlines() if "contact 0 (a finger)" in line).split()
    assert words[4] == f"{found.forces[0, 0]:.3f}" and words[-2:] == [f"{used:.0f}", "%"]
    assert texts[1].startswith("contact forces: not found") and refused.reason in texts[1]


def test_torques_print_beside_their_limits() -> None:
    shown = torque_table(
        ["strong", "weak", "open"],
        np.array([1.0, -0.9, 5.0]),
        np.array([[-10.0, 10.0], [-1.0, 2.0], [-np.inf, np.inf]]),
        ["stop", "idle stop"],
        np.array([0.2, 0.0]),
    )
    assert [row.split()[0] for row in shown[1:4]] == ["weak", "strong", "open"]
    assert shown[1].split()[1:] == ["-0.9000", "-1", "2", "90", "%"]
    assert shown[4] == "  stops that carry (N m): stop 0.2000"


def test_a_loop_prints_its_last_step() -> None:
    loop = ForceLoop(opposed(fingers=["thumb", "index"]))
    assert "no step yet" in str(loop)
    loop.step(np.array(WEIGHT))
    for text in (str(loop), str(loop.result)):
        assert text.startswith("contact forces: balanced") and len(text) < 3000
    assert "thumb" in str(loop) and "friction used" in str(loop)
    loop.step(np.array(WEIGHT), max_normal=0.1)
    assert "left over: force" in str(loop)


def test_contacts_of_one_finger_are_told_apart() -> None:
    problem = build_force_problem(opposed(fingers=["thumb", "thumb"]), wrench=WEIGHT)
    assert problem.contact_names == ("contact 0 (thumb)", "contact 1 (thumb)")


def test_problem_and_answer_can_be_built_and_solved_apart() -> None:
    problem = build_force_problem(opposed(), wrench=WEIGHT)
    x = np.array([1.0, 0.0, 0.0, 0.7, 0.0, 0.0])
    residuals = problem.residuals(x)
    assert residuals.wrench == pytest.approx([-0.3, 0, -MASS * G, 0, 0, 0])
    assert residuals.worst == pytest.approx(MASS * G)
    assert problem.residuals(np.array([-1.0, 0, 0, 0, 0, 0])).bounds == pytest.approx(1.0)
    # f_t1 = 0.6 on f_n = 1 leaves the side at angle pi/8 by (0.6 - 0.5) cos(pi/8).
    x[1] = 0.6
    assert problem.residuals(x).cone == pytest.approx(0.1 * np.cos(np.pi / 8))
    assert problem.residuals(x * np.nan).worst == np.inf


def test_the_layout_of_friction_is_shared_and_cannot_be_written() -> None:
    contacts = ContactSet.from_arrays(np.eye(3), -np.eye(3), mu=0.5, fingers=["a", "b", "c"])
    moved = ContactSet.from_arrays(2 * np.eye(3), -np.eye(3), mu=0.5, fingers=["a", "b", "c"])
    rough = contacts.with_friction(0.6)
    part, same, other = (
        friction_part(c.models, c.fingers, c.friction.tobytes(), 8, "inscribed", 0.0)
        for c in (contacts, moved, rough)
    )
    assert part is same
    assert part is not other
    with pytest.raises(ValueError, match="read-only"):
        part.faces[0, 0] = 1.0
    first = build_force_problem(contacts, wrench=np.zeros(6), min_normal=1.0)
    second = build_force_problem(contacts, wrench=np.zeros(6), min_normal=2.0)
    assert first.lower.max() == 1.0
    assert second.lower.max() == 2.0
    steeper = build_force_problem(rough, wrench=np.zeros(6))
    assert np.abs(steeper.faces - first.faces).max() > 0.05
    with pytest.raises(ContactError, match="edges"):
        build_force_problem(contacts, wrench=np.zeros(6), edges=8.0)  # type: ignore[arg-type]


@given(st.integers(0, 10_000))
def test_the_sum_of_forces_is_the_grasp_map_times_them(seed: int) -> None:
    rng = np.random.default_rng(seed)
    n = int(rng.integers(0, 6))
    kinds: list[ContactModel] = ["frictionless", "point", "soft"]
    models = [kinds[k] for k in rng.integers(0, 3, n)]
    contacts = ContactSet.from_arrays(
        rng.normal(size=(n, 3)),
        rng.normal(size=(n, 3)),
        model=models,
        mu_torsion=0.01,
        center=rng.normal(size=3),
    )
    forces = rng.normal(size=(n, 4))
    carried = [f[:d] for f, d in zip(forces, contacts.dims, strict=True)]
    expected = contacts.grasp_map() @ np.concatenate([np.zeros(0), *carried])
    np.testing.assert_allclose(contacts.wrench_of(forces), expected, atol=1e-12)
    np.testing.assert_allclose(contacts.with_forces(forces).wrench(), expected, atol=1e-12)
    # torques by hand, about the centre
    torque = np.zeros(3)
    for i, dim in enumerate(contacts.dims):
        in_axes = contacts.frames[i, :, : min(dim, 3)] @ forces[i, : min(dim, 3)]
        torque += np.cross(contacts.positions[i] - contacts.center, in_axes)
        torque += (forces[i, 3] if dim == 4 else 0.0) * contacts.normals[i]
    np.testing.assert_allclose(contacts.wrench_of(forces)[3:], torque, atol=1e-12)
