"""Friction cones, force closure and min-weight: known answers, invariants, certificates."""

from __future__ import annotations

import json

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import linprog

from planner.contacts import ContactModel, ContactSet, cone_edges
from planner.errors import ContactError
from planner.quality import (
    ClosureResult,
    RoundCones,
    closure_of_wrenches,
    force_closure,
    measure_hull,
    min_weight,
    primitive_wrenches,
)
from planner.spatial import FloatArray

RADIUS = 0.03  # m
TRIANGLE = [[np.cos(a), np.sin(a), 0.0] for a in 2 * np.pi / 3 * np.arange(3)]
TETRAHEDRON = [[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]]
OPPOSED = [[1, 0, 0], [-1, 0, 0]]
SEEDS = st.integers(0, 2**32 - 1)


def on_sphere(
    directions: object,
    model: ContactModel = "point",
    mu: float = 0.5,
    mu_torsion: float = 0.01,
    radius: float = RADIUS,
) -> ContactSet:
    d = np.asarray(directions, dtype=float)
    d = d / np.linalg.norm(d, axis=1, keepdims=True)
    return ContactSet.from_arrays(radius * d, -d, model=model, mu=mu, mu_torsion=mu_torsion)


def random_grasp(seed: int) -> ContactSet:
    """Two to five contacts of mixed models, normals roughly inwards, on a body of some 3 cm."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(2, 6))
    p = rng.normal(size=(n, 3))
    p /= np.linalg.norm(p, axis=1, keepdims=True)
    models: list[ContactModel] = [
        ("frictionless", "point", "soft", "soft")[i] for i in rng.integers(0, 4, n)
    ]
    return ContactSet.from_arrays(
        RADIUS * p,
        -p + 0.3 * rng.normal(size=(n, 3)),
        model=models,
        mu=rng.uniform(0.2, 1.0, n),
        mu_torsion=rng.uniform(0.002, 0.02, n),
    )


def check_certificate(result: ClosureResult, w: FloatArray) -> None:
    """Whatever is decided, its certificate must prove it on W itself."""
    assert result.residual < 1e-9
    if result.weights is not None:
        assert (result.weights > 0).all()
        assert result.weights.sum() == pytest.approx(1.0)
        assert np.abs(w @ result.weights).max() < 1e-9
    assert result.closed == (result.separator is None)
    if result.separator is not None and result.unresisted_wrench is not None:
        assert (result.separator @ w >= -1e-9 * np.linalg.norm(result.separator)).all()
        # Pushing with this wrench does work that contacts can only add to.
        assert result.separator @ result.unresisted_wrench > 0


# Cones


def test_inscribed_edges_lie_on_the_cone() -> None:
    edges = cone_edges(0.5, 0.02, 7, phase=0.3)
    assert edges.shape == (4, 9)
    assert edges[0] == pytest.approx(1.0)
    used = (edges[1] ** 2 + edges[2] ** 2) / 0.5**2 + (edges[3] / 0.02) ** 2
    assert used == pytest.approx(1.0)
    assert np.arctan2(edges[2, 0], edges[1, 0]) == pytest.approx(0.3)


@pytest.mark.parametrize("model", ["frictionless", "point", "soft"])
@settings(max_examples=30, deadline=None)
@given(seed=SEEDS)
def test_inscribed_within_round_within_circumscribed(model: ContactModel, seed: int) -> None:
    rng = np.random.default_rng(seed)
    contacts = on_sphere(rng.normal(size=(1, 3)), model, mu=rng.uniform(0.1, 1.0))
    k, phase = int(rng.integers(3, 12)), float(rng.uniform(0, 6))
    u = rng.normal(size=(50, 6))
    inner = primitive_wrenches(contacts, k, length=RADIUS, phase=phase)
    outer = primitive_wrenches(contacts, k, length=RADIUS, phase=phase, cone="circumscribed")
    reach, points = RoundCones.of(contacts, RADIUS).extremes(u)
    assert ((u @ inner).max(axis=1) <= reach[:, 0] + 1e-12).all()
    assert ((u @ outer).max(axis=1) >= reach[:, 0] - 1e-12).all()
    # The closed form is attained by the point that comes with it.
    assert np.einsum("qi,qi->q", u, points[:, 0]) == pytest.approx(reach[:, 0])


def test_circumscribed_prism_is_tight_for_pure_sliding_and_pure_torsion() -> None:
    edges = cone_edges(0.5, 0.02, 4, cone="circumscribed")
    middle_of_side = np.array([np.cos(np.pi / 4), np.sin(np.pi / 4)])
    assert (middle_of_side @ edges[1:3]).max() == pytest.approx(0.5)
    assert edges[3].max() == pytest.approx(0.02)


@pytest.mark.parametrize(
    ("model", "mu", "mu_torsion", "columns"),
    [
        ("frictionless", 0.5, 0.01, 1),
        ("point", 0.0, 0.01, 1),
        ("point", 0.5, 0.01, 8),
        ("soft", 0.0, 0.0, 1),
        ("soft", 0.0, 0.01, 2),
        ("soft", 0.5, 0.0, 8),
        ("soft", 0.5, 0.01, 10),
    ],
)
def test_zero_friction_leaves_no_copies(
    model: ContactModel, mu: float, mu_torsion: float, columns: int
) -> None:
    w = primitive_wrenches(on_sphere(OPPOSED[:1], model, mu, mu_torsion))
    assert w.shape == (6, columns)
    assert len(np.unique(w.round(12), axis=1).T) == columns


def test_primitive_wrench_is_force_and_torque_over_length() -> None:
    contacts = ContactSet.from_arrays([[0.0, 0.02, 0.0]], [[1, 0, 0]], model="frictionless")
    assert primitive_wrenches(contacts, length=0.04)[:, 0] == pytest.approx([1, 0, 0, 0, 0, -0.5])


def test_edges_of_unit_length() -> None:
    contacts = on_sphere(TRIANGLE, "soft")
    w = primitive_wrenches(contacts, unit="length")
    assert np.linalg.norm(w[:3], axis=0) == pytest.approx(1.0)
    longer = primitive_wrenches(contacts)
    assert longer[:, 0] == pytest.approx(np.sqrt(1.25) * w[:, 0])


def test_bad_arguments_are_refused_with_a_remedy() -> None:
    contacts = on_sphere(OPPOSED)
    with pytest.raises(ContactError, match="from 3 to"):
        primitive_wrenches(contacts, 2)
    with pytest.raises(ContactError, match="positive number of metres"):
        primitive_wrenches(contacts, length=0.0)
    with pytest.raises(ContactError, match="use 'inscribed' or 'circumscribed'"):
        cone_edges(0.5, 0.0, cone="outer")  # type: ignore[arg-type]
    with pytest.raises(ContactError, match="use 'normal' or 'length'"):
        primitive_wrenches(contacts, unit="none")  # type: ignore[arg-type]
    with pytest.raises(ContactError, match=r"shape \(6, m\)"):
        closure_of_wrenches(np.zeros((3, 4)))
    with pytest.raises(ContactError, match="finite"):
        closure_of_wrenches(np.full((6, 4), np.nan))


# Known answers


def test_two_opposed_soft_fingers_close() -> None:
    result = force_closure(on_sphere(OPPOSED, "soft"))
    assert result.closed
    assert result.rank == 6
    assert result.normalised_min_weight == pytest.approx(1.0)
    assert "closed: rank 6" in result.reason


def test_two_opposed_point_contacts_lack_torsion() -> None:
    contacts = on_sphere(OPPOSED)
    result = force_closure(contacts)
    assert not result.closed
    assert result.rank == 5
    assert result.normalised_min_weight == pytest.approx(1.0)
    assert result.weights is not None
    # The free motion is a turn about the line through the contacts, and nothing else.
    assert result.separator is not None
    turn = np.abs(result.separator) / np.linalg.norm(result.separator)
    assert turn == pytest.approx([0, 0, 0, 1, 0, 0], abs=1e-9)
    assert "rank 5: no torque about the axis" in result.reason
    assert "(1, 0, 0)" in result.reason or "(-1, 0, 0)" in result.reason
    check_certificate(result, primitive_wrenches(contacts))


@pytest.mark.parametrize("directions", [TRIANGLE, TETRAHEDRON], ids=["three", "four"])
@pytest.mark.parametrize("edges", [3, 4, 8])
def test_symmetric_contacts_close_with_equal_weights(directions: object, edges: int) -> None:
    result = force_closure(on_sphere(directions), edges)
    assert result.closed
    assert result.normalised_min_weight == pytest.approx(1.0)


def test_min_weight_of_a_lopsided_grasp_worked_by_hand() -> None:
    # Planar balance of three frictionless pushes: a, a, b with a + a = 2 (1/4), b = 1/2, and a
    # fourth pair along z. Directions -(1, 1), -(-1, 1) over sqrt(2) and (0, 1), z, -z:
    # a sqrt(2) = b, c = d, sum 1: the least is largest at a = c = 1 / (4 + sqrt(2)).
    p = [[1, 1, 0], [-1, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]]
    result = force_closure(on_sphere(p, "frictionless"))
    assert result.min_weight == pytest.approx(1 / (4 + np.sqrt(2)))
    assert result.weights is not None
    assert result.weights[2] == pytest.approx(np.sqrt(2) / (4 + np.sqrt(2)))
    assert result.rank == 3


@pytest.mark.parametrize("n", [0, 1])
@pytest.mark.parametrize("model", ["frictionless", "point", "soft"])
def test_none_or_one_contact_never_closes(n: int, model: ContactModel) -> None:
    contacts = on_sphere(OPPOSED, model)
    few = ContactSet.from_contacts([contacts[i] for i in range(n)], center=[0, 0, 0])
    result = force_closure(few)
    assert not result.closed
    assert result.min_weight == -np.inf
    assert result.rank == (0, {"frictionless": 1, "point": 3, "soft": 4}[model])[n]
    assert f"rank {result.rank}" in result.reason
    check_certificate(result, primitive_wrenches(few))
    json.dumps(result.to_dict(), allow_nan=False)


def test_contacts_on_one_side_cannot_hold_a_push_away() -> None:
    p = [[0.03, 0.01, 0], [0.03, -0.01, 0.01], [0.03, 0, -0.01]]
    contacts = ContactSet.from_arrays(p, [[-1, 0, 0]] * 3)
    result = force_closure(contacts)
    assert result.rank == 6
    assert result.min_weight == -np.inf
    assert result.unresisted_wrench == pytest.approx(np.array([-1, 0, 0, 0, 0, 0.0]), abs=1e-9)
    assert "force (-1, 0, 0) N and torque (0, 0, 0) N m cannot be resisted" in result.reason
    check_certificate(result, primitive_wrenches(contacts))


def test_ten_collinear_contacts_do_not_close() -> None:
    x = np.linspace(-0.03, 0.03, 10)
    normals = [[0, np.cos(a), np.sin(a)] for a in np.arange(10.0)]
    contacts = ContactSet.from_arrays(np.outer(x, [1, 0, 0]), normals, mu=1.0)
    result = force_closure(contacts)
    assert result.rank == 5
    assert not result.closed
    assert result.min_weight > 0
    check_certificate(result, primitive_wrenches(contacts))


@pytest.mark.parametrize("at", [[0.0, 0, 0], [0.03, 0, 0]])
def test_coincident_contacts_have_rank_three(at: list[float]) -> None:
    contacts = ContactSet.from_arrays([at, at], [[-1, 0, 0], [1, 0, 0]])
    result = force_closure(contacts)
    assert result.rank == 3
    assert not result.closed
    check_certificate(result, primitive_wrenches(contacts))


def test_frictionless_sphere_can_always_spin() -> None:
    axes = np.vstack([np.eye(3), -np.eye(3)])
    for contacts in (on_sphere(axes, mu=0.0), on_sphere(axes, "frictionless")):
        result = force_closure(contacts)
        assert result.rank == 3
        assert result.normalised_min_weight == pytest.approx(1.0)
        assert not result.closed


def test_wrenches_with_none_against_one_of_them_do_not_close() -> None:
    """All six axes, of which five both ways: the weight of the sixth is exactly 0."""
    result = closure_of_wrenches(np.hstack([np.eye(6), -np.eye(6)[:, :5]]))
    assert result.rank == 6
    assert result.normalised_min_weight == pytest.approx(0.0, abs=1e-9)
    assert not result.closed
    assert result.weights is None and result.separator is not None
    along = result.separator / np.linalg.norm(result.separator)
    np.testing.assert_allclose(along, np.eye(6)[5], atol=1e-6)


def test_free_axis_is_reported_where_it_is() -> None:
    contacts = ContactSet.from_arrays(
        [[0.03, 0.02, 0], [-0.03, 0.02, 0]], [[-1, 0, 0], [1, 0, 0]], center=[0, 0.01, 0]
    )
    assert "through (0, 0.01, 0) m from the centre" in force_closure(contacts).reason


def test_missing_force_direction_is_named() -> None:
    w = np.eye(6)[:, [0, 1, 3, 4, 5]]
    assert "no force along (0, 0, 1)" in closure_of_wrenches(np.hstack([w, -w])).reason.replace(
        "-1)", "1)"
    )


# Invariants and second engines


@settings(max_examples=40, deadline=None)
@given(seed=SEEDS)
def test_decision_agrees_with_the_hull_and_proves_itself(seed: int) -> None:
    contacts = random_grasp(seed)
    result = force_closure(contacts, 6)
    check_certificate(result, primitive_wrenches(contacts, 6))
    hull = measure_hull(primitive_wrenches(contacts, 6, length=RADIUS))
    if abs(result.normalised_min_weight) > 1e-4:
        assert result.closed == (hull.epsilon > 0)


@settings(max_examples=25, deadline=None)
@given(seed=SEEDS)
def test_min_weight_agrees_with_the_textbook_programme(seed: int) -> None:
    w = primitive_wrenches(random_grasp(seed), 5, length=RADIUS)
    m = w.shape[1]
    result = closure_of_wrenches(w)
    rows = np.vstack([np.column_stack([w, np.zeros(6)]), np.append(np.ones(m), 0.0)])
    textbook = linprog(
        np.append(np.zeros(m), -1.0),
        A_eq=rows,
        b_eq=np.append(np.zeros(6), 1.0),
        A_ub=np.column_stack([-np.eye(m), np.ones(m)]),
        b_ub=np.zeros(m),
        bounds=[(None, None)] * (m + 1),
    )
    if textbook.status == 2:
        assert result.min_weight == -np.inf
    else:
        assert result.normalised_min_weight == pytest.approx(-textbook.fun * m, rel=1e-5, abs=1e-6)


@settings(max_examples=25, deadline=None)
@given(seed=SEEDS)
def test_closure_does_not_depend_on_frame_order_or_unit(seed: int) -> None:
    contacts = random_grasp(seed)
    rng = np.random.default_rng(seed)
    expected = force_closure(contacts, 5)
    w = primitive_wrenches(contacts, 5)
    order = rng.permutation(len(contacts))
    turn = pin.SE3(pin.exp3(rng.normal(size=3)), 0.1 * rng.normal(size=3))
    shift = np.eye(6)
    shift[3:, :3] = pin.skew(0.05 * rng.normal(size=3))
    variants = {
        "moved": force_closure(contacts.transformed(turn), 5),
        "relabelled": force_closure(
            ContactSet.from_contacts([contacts[int(i)] for i in order], center=contacts.center), 5
        ),
        "millimetres": closure_of_wrenches(w * np.array([[1.0], [1], [1], [1e3], [1e3], [1e3]])),
        "other origin of torque": closure_of_wrenches(shift @ w),
        "longer edges": closure_of_wrenches(7.0 * w),
    }
    for name, result in variants.items():
        assert result.rank == expected.rank, name
        assert result.closed == expected.closed, name
        assert result.min_weight == pytest.approx(expected.min_weight, rel=1e-6, abs=1e-8), name


def test_min_weight_is_the_normalised_one() -> None:
    contacts = on_sphere(TRIANGLE, "soft")
    result = force_closure(contacts, 6)
    assert result.weights is not None
    assert min_weight(contacts, 6) == pytest.approx(result.min_weight * len(result.weights))


def test_more_friction_can_close_what_less_does_not() -> None:
    # Two soft fingers whose normals lean 40 degrees from their line: closed iff mu > tan 40 deg.
    lean = np.radians(40)
    normals = [[-np.cos(lean), np.sin(lean), 0], [np.cos(lean), np.sin(lean), 0]]
    for mu, closed in ((0.80, False), (0.90, True)):
        contacts = ContactSet.from_arrays(
            RADIUS * np.array(OPPOSED), normals, model="soft", mu=mu, mu_torsion=0.01
        )
        result = force_closure(contacts, 32)
        assert result.closed == closed
        check_certificate(result, primitive_wrenches(contacts, 32))


@given(st.integers(0, 10_000))
def test_contacts_of_any_friction_get_an_answer(seed: int) -> None:
    """Without friction all edges of a cone are one; weights of what is not closed are huge."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 6))
    points, normals = rng.normal(0, 0.04, (n, 3)), rng.normal(size=(n, 3))
    mu = float(rng.choice([0.0, 1e-9, 1e-4, 0.5]))
    if rng.random() < 0.5:
        points[:, 2] = 0.0
        normals[:, 2] = 0.0
    contacts = ContactSet.from_arrays(points, normals, mu=mu)
    for edges in (4, 8):
        assert isinstance(force_closure(contacts, edges=edges).closed, bool)


def test_the_quick_programme_and_the_sure_one_agree(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(0)
    cases = []
    for _ in range(20):
        points = rng.normal(0, 0.04, (4, 3))
        cases.append(ContactSet.from_arrays(points, -points + rng.normal(0, 0.01, (4, 3)), mu=0.6))
    quick = [force_closure(c, edges=8).min_weight for c in cases]
    monkeypatch.setattr("planner.numerics.lp.run_daqp", lambda *given, **settings: None)
    sure = [force_closure(c, edges=8).min_weight for c in cases]
    np.testing.assert_allclose(quick, sure, rtol=0, atol=1e-9)


@pytest.mark.parametrize("seed", range(6))
def test_forces_that_cancel_in_huge_amounts_only_have_a_large_negative_weight(seed: int) -> None:
    # all push one way but for a ten-thousandth: sum a = 1 and W a = 0 hardly go together
    rng = np.random.default_rng(seed)
    wrenches = rng.normal(size=(6, 18))
    wrenches[0] = 1.0 + 1e-4 * rng.normal(size=18)
    result = closure_of_wrenches(wrenches)
    assert not result.closed
    assert -1e5 < result.min_weight < -10.0
    separator = result.separator
    assert separator is not None
    assert (separator @ wrenches).min() > -1e-6
