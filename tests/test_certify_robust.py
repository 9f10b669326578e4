"""Errors that closure tolerates: worked by hand, exact cases, invariances, promises sampled."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import nnls
from scipy.spatial.transform import Rotation

from planner.certify import (
    PoseErrors,
    Tolerance,
    closure_survives,
    contact_tolerances,
    pose_tolerances,
    sampled,
)
from planner.certify.robust import halved, icosphere, weakest_motion
from planner.certify.tolerance import largest_turn, random_errors, worst_errors
from planner.contacts import ContactSet
from planner.errors import ContactError
from planner.quality import force_closure, primitive_wrenches
from planner.shapes import Box, Capsule, Cylinder, Ellipsoid, Mesh, Shape, Sphere

ARM, MU = 0.04, 0.5


def opposed(mu: float = MU, mu_torsion: float = 0.01) -> ContactSet:
    """Two soft fingers opposite each other."""
    return ContactSet.from_arrays(
        [[-ARM, 0, 0], [ARM, 0, 0]],
        [[1, 0, 0], [-1, 0, 0]],
        mu=mu,
        mu_torsion=mu_torsion,
        model="soft",
    )


def around(mu: float = MU, lift: float = 0.3) -> ContactSet:
    """Four point contacts around a sphere, the first above the others."""
    angles = np.deg2rad([0.0, 100.0, 180.0, 260.0])
    points = np.column_stack([np.cos(angles), np.sin(angles), [lift, 0, 0, 0]])
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    return ContactSet.from_arrays(ARM * points, -points, mu=mu)


def by_kind(tolerances: tuple[Tolerance, ...]) -> dict[str, Tolerance]:
    return {t.kind: t for t in tolerances}


def closed(contacts: ContactSet, edges: int = 8) -> bool:
    """Closure by nonnegative least squares on inscribed edges; in doubt, by linear programme."""
    w = primitive_wrenches(contacts, edges)
    w = w / np.repeat([1.0, ARM], 3)[:, None]
    extra, left = nnls(w, -w.sum(axis=1))
    if left < 1e-9 and extra.max() < 1e4 and np.linalg.matrix_rank(w, tol=1e-4) == 6:
        return True
    return force_closure(contacts, edges).closed


# ------------------------------------------------------------------------------- known answers


@pytest.fixture(scope="module")
def of_two() -> dict[str, Tolerance]:
    return by_kind(contact_tolerances(opposed(), edges=64))


def test_two_fingers_tolerate_shifts_until_their_line_leaves_a_cone(
    of_two: dict[str, Tolerance],
) -> None:
    # The line between them turns by asin(r / arm) at worst, and must stay inside both cones.
    exact = 1e3 * ARM * MU / np.sqrt(1 + MU**2)
    position = of_two["position"]
    assert position.promised is not None
    assert position.broken_at is not None
    assert 0.85 * exact <= position.promised <= exact
    assert exact <= position.broken_at <= 1.05 * exact


def test_normals_of_point_contacts_may_tilt_until_the_narrowed_cones_do_not_close() -> None:
    contacts = around()
    exact = next(
        tilt
        for tilt in np.arange(0.25, 30, 0.25)
        if not force_closure(
            contacts.with_friction(max(np.tan(np.arctan(MU) - np.deg2rad(tilt)), 0.0)), 64
        ).closed
    )
    normal = by_kind(contact_tolerances(contacts, edges=64))["normal"]
    assert normal.promised is not None
    assert normal.broken_at is not None
    assert 0.95 * exact - 0.25 <= normal.promised <= exact
    assert exact - 0.25 <= normal.broken_at <= 1.05 * exact + 0.25


def test_friction_may_drop_until_the_linear_programme_refuses() -> None:
    contacts = around(lift=0.5)
    friction = by_kind(contact_tolerances(contacts, edges=64))["friction"]
    assert friction.promised is not None
    assert friction.broken_at is not None
    assert force_closure(contacts.with_friction(MU * (1 - friction.promised / 100)), 64).closed
    assert not force_closure(contacts.with_friction(MU * (1 - friction.broken_at / 100)), 64).closed
    assert friction.broken_at - friction.promised <= 4.0


def test_soft_fingers_keep_a_promise_about_tilts_too(of_two: dict[str, Tolerance]) -> None:
    normal = of_two["normal"]
    assert normal.promised is not None
    assert normal.broken_at is not None
    # the line between the fingers must stay inside the tilted cones
    assert 0.5 * np.rad2deg(np.arctan(MU)) <= normal.promised <= np.rad2deg(np.arctan(MU))
    assert normal.promised <= normal.broken_at <= 1.1 * np.rad2deg(np.arctan(MU))


# --------------------------------------------------------------------------------- invariances


@pytest.mark.slow
def test_promises_do_not_change_with_frame_order_or_phase_and_scale_with_size() -> None:
    contacts = around()
    want = by_kind(contact_tolerances(contacts))
    turn = Rotation.from_rotvec([0.3, -0.8, 0.5]).as_matrix()
    order = [2, 0, 3, 1]
    turned = replace(
        contacts,
        positions=3 * contacts.positions[order] @ turn.T,
        frames=turn @ contacts.frames[order],
        mu=contacts.mu[order],
    )
    got = by_kind(contact_tolerances(turned))
    for kind, scale in (("position", 3.0), ("normal", 1.0), ("friction", 1.0)):
        a, b = want[kind].promised, got[kind].promised
        assert a is not None
        assert b == pytest.approx(scale * a, rel=0.06)


def test_more_error_never_survives_where_less_did_not() -> None:
    contacts, none = around(), np.zeros(4)
    survived = [
        closure_survives(contacts, none + r, none).survives for r in np.linspace(0, 0.03, 9)
    ]
    assert survived[0]
    assert not survived[-1]
    assert survived == sorted(survived, reverse=True)


# ------------------------------------------------------------------------------------- promises


@pytest.mark.slow
@pytest.mark.parametrize(
    ("contacts", "draws"), [(around(), 300), (opposed(), 60)], ids=["four points", "two soft"]
)
def test_no_sampled_error_within_a_promise_loses_closure(contacts: ContactSet, draws: int) -> None:
    rng = np.random.default_rng(1)
    for tolerance in contact_tolerances(contacts):
        assert tolerance.promised
        drawn = (tolerance.draw(tolerance.promised, rng) for _ in range(draws))
        assert all(closed(c) for c in drawn), tolerance.kind


def test_shifts_and_tilts_together_keep_their_common_promise() -> None:
    contacts, rng = opposed(), np.random.default_rng(2)
    shifts, tilts = np.full(2, 0.005), np.full(2, np.deg2rad(8.0))
    verdict = closure_survives(contacts, shifts, tilts)
    assert verdict.survives
    assert all(closed(random_errors(contacts, shifts, tilts, rng)) for _ in range(200))
    worst = worst_errors(contacts, shifts, tilts, weakest_motion(contacts, shifts, tilts))
    assert closed(worst)
    assert not closure_survives(contacts, 2.5 * shifts, 2.5 * tilts).survives


def test_an_error_that_breaks_closure_does(of_two: dict[str, Tolerance]) -> None:
    contacts = opposed()
    size = np.full(2, 1e-3 * (of_two["position"].broken_at or 0.0))
    motion = weakest_motion(contacts, size, np.zeros(2))
    assert not closed(worst_errors(contacts, 1.05 * size, np.zeros(2), motion))


def test_sampling_counts_what_is_lost(of_two: dict[str, Tolerance]) -> None:
    position = of_two["position"]
    assert sampled(position, 50).lost == 0
    assert sampled(position, 50).samples == 50
    greedy = replace(position, promised=3 * (position.promised or 0.0))
    assert sampled(greedy, 50).lost > 0
    assert sampled(replace(position, promised=None), 50).samples == 0


def test_errors_are_of_the_sizes_they_are_said_to_be() -> None:
    contacts, rng = around(), np.random.default_rng(0)
    shifts, tilts = np.array([0, 1e-3, 2e-3, 3e-3]), np.deg2rad([0.0, 2.0, 4.0, 6.0])
    motion = rng.normal(size=6) * [0.05, 0.05, 0.05, 1, 1, 1]
    many = [random_errors(contacts, shifts, tilts, rng) for _ in range(50)]
    for c in [*many, worst_errors(contacts, shifts, tilts, motion)]:
        moved = np.linalg.norm(c.positions - contacts.positions, axis=1)
        cosine = np.einsum("ij,ij->i", c.normals, contacts.normals)
        assert (moved <= shifts + 1e-12).all()
        assert (np.arccos(np.minimum(cosine, 1.0)) <= tilts + 1e-7).all()
    assert np.linalg.norm(many[0].positions - contacts.positions, axis=1).max() > 5e-4


# ------------------------------------------------------------------------------- no and nothing


@pytest.mark.parametrize(
    "contacts",
    [
        opposed(mu=0.0),
        opposed(mu_torsion=0.0),
        around(mu=0.0),
        ContactSet.from_arrays(np.zeros((0, 3)), np.zeros((0, 3))),
    ],
    ids=["no friction", "no torsion", "frictionless sphere", "no contacts"],
)
def test_what_is_not_closed_survives_nothing(contacts: ContactSet) -> None:
    none = np.zeros(len(contacts))
    assert not closure_survives(contacts, none, none).survives


def test_bad_sizes_are_refused() -> None:
    for bad in (np.zeros(3), np.full(2, -1e-3), np.full(2, np.nan)):
        with pytest.raises(ContactError, match="2 numbers"):
            closure_survives(opposed(), bad, np.zeros(2))


# --------------------------------------------------------------------------------------- sphere


@pytest.mark.parametrize("halvings", [0, 1, 2])
def test_triangles_fill_the_sphere_once(halvings: int) -> None:
    vertices, faces = icosphere(halvings)
    assert len(faces) == 20 * 4**halvings
    assert np.linalg.norm(vertices, axis=1) == pytest.approx(np.ones(len(vertices)))
    rng = np.random.default_rng(0)
    corners = np.swapaxes(vertices[faces], 1, 2)  # columns
    for direction in rng.normal(size=(200, 3)):
        shares = np.linalg.solve(corners, np.tile(direction, (len(corners), 1))[:, :, None])
        assert int((shares[:, :, 0] > 0).all(axis=1).sum()) == 1
    parts = halved(vertices[faces[0]])
    inside = rng.random((50, 3)) @ vertices[faces[0]]
    for direction in inside:
        shares = np.linalg.solve(np.swapaxes(parts, 1, 2), np.tile(direction, (4, 1))[:, :, None])
        assert int((shares[:, :, 0] > 0).all(axis=1).sum()) == 1


# ----------------------------------------------------------------------------------------- pose

SHAPES: tuple[tuple[Shape, list[list[float]]], ...] = (
    (Sphere(0.03), [[0.03, 0, 0]]),
    (Box((0.06, 0.05, 0.08)), [[0.03, 0.01, 0.0], [0.03, 0.023, 0.035], [0.03, 0.025, 0.0]]),
    (Cylinder(0.03, 0.1), [[0.03, 0, 0.02], [0, 0.03, 0.047], [0.01, 0, 0.05], [0.028, 0, 0.05]]),
    (Capsule(0.03, 0.12), [[0.03, 0, 0.0], [0, 0.03, 0.03], [0.0, 0, 0.06]]),
    (Ellipsoid((0.09, 0.07, 0.06)), [[0.045, 0, 0], [0, 0, 0.03], [0.02, 0.02, 0.02]]),
)


@pytest.mark.parametrize(("shape", "near"), SHAPES, ids=lambda x: getattr(x, "kind", ""))
def test_contacts_of_a_moved_ball_stay_within_their_bounds(
    shape: Shape, near: list[list[float]]
) -> None:
    rng = np.random.default_rng(0)
    beside = np.asarray(near) * 1.001
    points, normals = shape.closest_point(beside)
    rho = np.full(len(points), 0.01)
    for way in (0.002, 0.005, 0.0095):
        bound = largest_turn(shape, points, normals, rho, np.full(len(points), way))
        assert (bound <= np.arcsin(way / 0.01) + 1e-12).all()
        largest = np.zeros(len(points))
        for _ in range(400):
            step = rng.normal(size=(len(points), 3))
            step *= way / np.linalg.norm(step, axis=1, keepdims=True)
            moved, turned = shape.closest_point(points + 0.01 * normals + step)
            angle = np.arccos(np.minimum(np.einsum("ij,ij->i", normals, turned), 1.0))
            largest = np.maximum(largest, angle)
            assert (np.linalg.norm(moved - points, axis=1) <= way + 1e-9).all()
        assert (largest <= bound + 1e-7).all()


def test_normals_above_a_wide_face_do_not_turn() -> None:
    points, normals = np.array([[0.03, 0.0, 0.0]]), np.array([[1.0, 0.0, 0.0]])
    box = Box((0.06, 0.05, 0.08))
    assert largest_turn(box, points, normals, np.array([0.01]), np.array([0.009]))[0] == 0.0
    assert largest_turn(box, points, normals, np.array([0.01]), np.array([0.01]))[0] > 1.5


@pytest.fixture(scope="module")
def on_a_sphere() -> PoseErrors:
    return PoseErrors.of(Sphere(ARM), around(), np.full(4, 0.01))


def test_the_pose_of_a_sphere_may_be_wrong_by_millimetres(on_a_sphere: PoseErrors) -> None:
    tolerances = by_kind(pose_tolerances(on_a_sphere))
    rng = np.random.default_rng(5)
    for tolerance in tolerances.values():
        assert tolerance.promised
        assert tolerance.promised > 1.0
        draws = [tolerance.draw(tolerance.promised, rng) for _ in range(200)]
        assert all(closed(c) for c in draws)


def test_a_shifted_object_meets_the_pads_elsewhere_and_a_turned_sphere_does_not_care(
    on_a_sphere: PoseErrors,
) -> None:
    shift = np.array([0.002, 0.0, 0.0])
    moved = on_a_sphere.at(shift, np.zeros(3))
    centers = on_a_sphere.centers - shift
    assert moved.positions == pytest.approx(
        ARM * centers / np.linalg.norm(centers, axis=1, keepdims=True)
    )
    turned = on_a_sphere.at(np.zeros(3), np.array([0.0, 0.0, 0.3]))
    # seen from an object that turned to the left, the pads went to the right
    back = Rotation.from_rotvec([0.0, 0.0, -0.3]).as_matrix()
    assert turned.positions == pytest.approx(on_a_sphere.contacts.positions @ back.T)
    assert force_closure(turned).closed


def test_nothing_is_promised_of_meshes_and_of_contacts_off_the_surface() -> None:
    from planner.shapes import Torus

    torus = Torus(0.035, 0.015)
    assert isinstance(torus, Mesh)
    points, normals = torus.closest_point(np.array([[0.06, 0, 0], [-0.06, 0, 0], [0, 0.06, 0]]))
    contacts = ContactSet.from_arrays(points, -normals)
    poses = PoseErrors.of(torus, contacts, np.full(3, 0.01))
    assert "concave" in poses.reason
    assert all(t.promised is None and t.note for t in pose_tolerances(poses))
    off = replace(around(), positions=1.1 * around().positions)
    assert "normal" in PoseErrors.of(Sphere(ARM), off, np.full(4, 0.01)).reason
