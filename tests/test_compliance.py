"""Active and passive internal forces, and how contacts share what no actuator commands."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.linalg import null_space
from typer.testing import CliRunner

from planner import ContactSet, GraspTask, plan_grasp
from planner.certify import breaking_along, smallest_breaking, stiffness
from planner.certify.stiffness import GraspStiffness
from planner.contacts import ContactModel
from planner.errors import ContactError
from planner.forces import GraspCompliance, build_force_problem, distribute_forces
from planner.forces.compliance import STOP, passive_forces, passive_rows
from planner.hand_loading import load_hand
from planner.hands.hand import Hand
from planner.objects import parse_object
from planner.plan import GraspPlan
from planner.spatial import FloatArray, shifted
from planner.verification import force_arguments, plan_forces
from sim.cli import app
from sim.creep import compliance_of
from sim.protocols.disturbance import DisturbanceTrial
from sim.scene.build import build_scene
from sim.scene.physics import PhysicsOptions


@pytest.fixture(scope="module")
def hand() -> Hand:
    return load_hand("allegro_hand")


@pytest.fixture(scope="module")
def inner(hand: Hand) -> GraspPlan:
    """Seven contacts: two links of two fingers each, two more fingers, and the palm."""
    item = parse_object("sphere:0.04", mass=1.0)
    links = [f"{finger}_distal" for finger in ("thumb", "middle", "ring", "index")]
    links += ["middle_proximal", "ring_proximal", "palm"]
    return plan_grasp(GraspTask.create(hand, item, fingers=links), seed=1)


def link_and_palm(contact: float, joint: float) -> GraspCompliance:
    """A link on one joint that touches at 0.1 and 0.2 m, against a palm, along one line."""
    return GraspCompliance(
        grasp_map=np.array([[1.0, 1.0, -1.0]]),
        joint_map=np.array([[0.1, 0.2, 0.0]]),
        contact=np.full(3, contact),
        joint=np.array([[joint]]),
    )


def test_a_link_that_touches_twice_commands_one_of_two_internal_forces() -> None:
    """By hand: f3 = f1 + f2, c f1 = 0.1 q - u, c f2 = 0.2 q - u, c f3 = u give f1 = 0."""
    c, flexible = 1e-3, 0.1
    grasp = link_and_palm(c, flexible)
    np.testing.assert_allclose(np.abs(grasp.passive.T @ [2.0, -1.0, 1.0]), np.sqrt(6.0))
    assert grasp.active.shape == (3, 1) and grasp.passive.shape == (3, 1)
    expected = 0.1 / (c + 0.02 * flexible) * np.array([0.0, 1.0, 1.0])
    np.testing.assert_allclose(grasp.commanded[:, 0], expected, atol=1e-9)


def test_a_push_against_the_palm_is_shared_by_compliance() -> None:
    """By hand with q / c = 100: f = (-1/3, 0, 2/3) w."""
    grasp = link_and_palm(1e-3, 0.1)
    np.testing.assert_allclose(-grasp.spread[:, 0], [-1 / 3, 0.0, 2 / 3], atol=1e-12)


def test_contacts_that_nothing_moves_have_no_active_force() -> None:
    """Pins around a ball: hyperstatic; twice as stiff a contact bears twice as much."""
    grasp = GraspCompliance(
        grasp_map=np.array([[1.0, -1.0]]),
        joint_map=np.zeros((1, 2)),
        contact=np.array([1e-5, 2e-5]),
        joint=np.eye(1),
    )
    assert grasp.active.shape == (2, 0) and not grasp.commanded.any()
    np.testing.assert_allclose(grasp.passive[:, 0], np.sqrt(0.5) * np.sign(grasp.passive[0, 0]))
    np.testing.assert_allclose(-grasp.spread[:, 0], [-2 / 3, 1 / 3])


def test_of_fingertips_every_internal_force_is_active(hand: Hand) -> None:
    plan = plan_grasp(GraspTask.create(hand, "sphere:0.035"), seed=0)
    grasp = GraspCompliance.of(plan.forces.problem, 1e-5)
    n = plan.forces.problem.n_force
    assert grasp.passive.shape == (n, 0) and grasp.active.shape == (n, n - 6)
    assert "passive force by compliance" not in plan.forces.problem.row_names


def solved(grasp: GraspCompliance, references: FloatArray, wrench: FloatArray) -> FloatArray:
    """Forces by the three equations of the module at once, nothing eliminated."""
    (n, m), nv = grasp.grasp_map.shape, len(grasp.joint_map)
    matrix = np.block(
        [
            [grasp.grasp_map, np.zeros((n, n + nv))],
            [np.diag(grasp.contact), grasp.grasp_map.T, -grasp.joint_map.T],
            [grasp.joint @ grasp.joint_map, np.zeros((nv, n)), np.eye(nv)],
        ]
    )
    return np.linalg.solve(matrix, np.concatenate([-wrench, np.zeros(m), references]))[:m]


def test_the_formula_solves_its_equations(inner: GraspPlan) -> None:
    grasp = GraspCompliance.of(inner.forces.problem, 1e-5)
    rng = np.random.default_rng(1)
    for _ in range(5):
        y, w = rng.normal(size=len(grasp.joint)), rng.normal(size=6)
        forces = grasp.commanded @ y - grasp.spread @ w
        np.testing.assert_allclose(solved(grasp, y, w), forces, atol=1e-6 * np.abs(forces).max())
        np.testing.assert_allclose(grasp.passive.T @ (grasp.contact * forces), 0.0, atol=1e-9)


def test_bases_span_all_internal_forces(inner: GraspPlan) -> None:
    """Seven contacts, 16 joints: of 15 internal forces one is passive."""
    grasp = GraspCompliance.of(inner.forces.problem, 1e-5)
    assert grasp.active.shape == (21, 14) and grasp.passive.shape == (21, 1)
    both = np.hstack([grasp.active, grasp.passive])
    assert np.linalg.matrix_rank(both) == 15
    np.testing.assert_allclose(grasp.grasp_map @ both, 0.0, atol=1e-7)
    np.testing.assert_allclose(grasp.joint_map @ grasp.passive, 0.0, atol=1e-9)


def test_it_agrees_with_the_stiffness_of_a_grasp_without_load(hand: Hand) -> None:
    """Another assembly of the same springs: over motions of object and joints, not over forces."""
    plan = plan_grasp(GraspTask.create(hand, "sphere:0.035"), seed=0)
    whole = GraspStiffness.of(plan.task, plan.forces, plan.T_world_base, plan.q)
    wrench = np.array([1.0, -2.0, 0.5, 0.01, 0.02, -0.01])
    changes, _ = whole.under(0.0, wrench[None], 0.0)
    n = len(plan.contacts)
    twisting = plan.contacts.with_friction(0.5, 0.01)
    kind: ContactModel = "soft"
    soft = replace(twisting, models=(kind,) * n)
    problem = build_force_problem(
        soft, **force_arguments(plan.task, soft, plan.T_world_base, plan.q)
    )
    given = np.tile([1 / stiffness.CONTACT] * 3 + [1 / stiffness.SPIN], n)
    unit = problem.column_scale[: problem.n_force] ** 2
    ours = -GraspCompliance.of(problem, given * unit).spread @ wrench
    np.testing.assert_allclose(ours.reshape(-1, 4), changes[0], atol=1e-6)


def three(mu: float = 0.5) -> ContactSet:
    angles = np.deg2rad([90.0, 210.0, 330.0])
    points = 0.03 * np.column_stack([np.cos(angles), np.sin(angles), np.zeros(3)])
    return ContactSet.from_arrays(points, -points / 0.03, mu=mu)


def test_friction_ends_what_contacts_bear() -> None:
    """Three contacts that press with 10 N at friction 0.5 bear 15 N along their axis, not 20."""
    contacts, pressing = three(), np.tile([10.0, 0.0, 0.0], 3)
    grasp = GraspCompliance(
        grasp_map=contacts.grasp_map(),
        joint_map=np.zeros((1, 9)),
        contact=np.full(9, 1e-5),
        joint=np.eye(1),
    )
    along = np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
    forces, share = grasp.under(contacts, pressing, 14.0 * along)
    assert share == 1.0
    np.testing.assert_allclose(contacts.grasp_map() @ forces, -14.0 * along, atol=1e-4)
    _, share = grasp.under(contacts, pressing, 20.0 * along)
    assert share == pytest.approx(0.75, abs=0.01)


def test_a_contact_that_parts_bears_nothing() -> None:
    """Pushed towards one contact, the two others let go at the force with which they press."""
    contacts, pressing = three(mu=0.0), np.tile([10.0, 0.0, 0.0], 3)
    grasp = GraspCompliance(
        grasp_map=contacts.grasp_map(),
        joint_map=np.zeros((1, 9)),
        contact=np.full(9, 1e-5),
        joint=np.eye(1),
    )
    forces, share = grasp.under(contacts, pressing, np.array([0.0, 100.0, 0.0, 0.0, 0.0, 0.0]))
    assert share == 1.0
    np.testing.assert_allclose(forces[[0, 3, 6]], [100.0, 0.0, 0.0], atol=1e-3)


def test_a_contact_that_parted_presses_again_where_it_did() -> None:
    """Away and back again in one load of two parts: the state of a gap is kept."""
    contacts, k = three(mu=0.0), 1e-5
    grasp = GraspCompliance(
        grasp_map=contacts.grasp_map(),
        joint_map=np.zeros((1, 9)),
        contact=np.full(9, k),
        joint=np.eye(1),
    )
    pressing, away = np.tile([10.0, 0.0, 0.0], 3), np.zeros(9)
    away[3] = -30.0 * k
    none, state, _ = grasp._in_cones(contacts, pressing, away)
    assert none[3] == 0.0 and state[3] == pytest.approx(-20.0)
    again, _, _ = grasp._in_cones(contacts, state, -0.5 * away)
    assert again[3] == 0.0
    back, _, _ = grasp._in_cones(contacts, state, -away)
    np.testing.assert_allclose(back, pressing)


def test_a_contact_with_a_gap_presses_once_it_is_closed() -> None:
    """By hand: one joint of 1 N m/rad, two links 0.1 m from it, the second 1 mm from the object.

    They give way by 1e-3 m/N. With 0.05 N m the first link sinks in by 0.1 q = 1e-3 f, so that
    q + 0.1 f = 0.05: f = 100 q = 0.4545 N and q = 4.5e-3, less than the 10e-3 of the gap. With
    0.5 N m both press: 0.5 = q + 0.1 (100 q + 100 q - 1), so q = 0.6 / 21.
    """
    points = [[0.01, 0.0, 0.03], [-0.01, 0.0, 0.03]]
    contacts = ContactSet.from_arrays(points, [[0.0, 0.0, -1.0]] * 2, mu=0.0)
    grasp = GraspCompliance(
        grasp_map=np.zeros((1, 6)),
        joint_map=np.array([[0.1, 0.0, 0.0, 0.1, 0.0, 0.0]]),
        contact=np.full(6, 1e-3),
        joint=np.eye(1),
    )
    gaps, nothing = np.array([0.0, 1e-3]), np.zeros(1)
    state, share = grasp.pressed(contacts, np.array([0.05]), nothing, gaps)
    assert share == 1.0 and state[0] == pytest.approx(0.05 / 0.11, rel=1e-4)
    # the gap closes by as much as the finger moves
    assert state[3] == pytest.approx(state[0] - 1.0, rel=1e-4)
    forces, _ = grasp.under(contacts, state, np.zeros(1))
    np.testing.assert_allclose(forces[[0, 3]], [state[0], 0.0], atol=1e-9)
    state, _ = grasp.pressed(contacts, np.array([0.5]), nothing, gaps)
    q = 0.6 / 21.0
    np.testing.assert_allclose(state[[0, 3]], [100.0 * q, 100.0 * q - 1.0], rtol=1e-4)
    sunk, _ = grasp.pressed(contacts, nothing, nothing, -1e-3)
    assert (sunk[[0, 3]] > 0.0).all()  # what has sunk in presses without a torque


def test_the_programme_counts_no_passive_force_that_compliance_does_not_bring(
    inner: GraspPlan,
) -> None:
    problem = inner.forces.problem
    passive = passive_forces(problem.contacts.grasp_map(), problem.joint_map)
    assert problem.row_names.count("passive force by compliance") == passive.shape[1] == 1
    assert abs(passive[:, 0] @ inner.forces.unknowns[: problem.n_force]) < 1e-6
    chosen = plan_forces(
        inner.task, inner.contacts, inner.T_world_base, inner.q, contact_compliance=None
    )
    assert abs(passive[:, 0] @ chosen.unknowns[: problem.n_force]) > 0.1
    assert chosen.cost < inner.forces.cost


def test_a_certificate_counts_it_no_more_than_the_programme(inner: GraspPlan) -> None:
    chosen = plan_forces(
        inner.task, inner.contacts, inner.T_world_base, inner.q, contact_compliance=None
    )
    rng = np.random.default_rng(0)
    ways = np.hstack([rng.normal(size=(8, 3)), np.zeros((8, 3))])
    honest = np.array([breaking_along(inner.forces.problem, way).upper for way in ways])
    bold = np.array([breaking_along(chosen.problem, way).upper for way in ways])
    assert (honest <= bold * (1.0 + 1e-3)).all() and (honest < 0.98 * bold).any()


def test_what_breaks_a_grasp_with_inner_links_is_known_from_both_sides(inner: GraspPlan) -> None:
    """Nothing was proven of it where the forces inside the cones left one contact without room."""
    found = smallest_breaking(inner.forces.problem, "force", length=0.04, rel_tol=0.05).bounds
    assert found.lower > 0.9 * found.upper > 1.0
    given: dict[str, Any] = dict(
        force_arguments(inner.task, inner.contacts, inner.T_world_base, inner.q)
    )
    given |= {"min_normal": np.zeros(len(inner.contacts)), "friction_scale": 1.0}
    for way in np.random.default_rng(1).normal(size=(8, 3)):
        push = np.append(0.9 * found.lower * way / np.linalg.norm(way), np.zeros(3))
        asked = given | {"wrench": np.asarray(given["wrench"]) + push}
        assert distribute_forces(inner.contacts, **asked).found  # another programme


def test_what_stands_in_the_way_may_be_a_passive_force() -> None:
    """Pins that nothing moves: a grip by passive forces alone does not come about."""
    contacts = three()
    still = np.zeros((3, 6, 1))
    asked: dict[str, Any] = {"wrench": np.zeros(6), "min_normal": 1.0, "jacobians": still}
    assert distribute_forces(contacts, **asked).found
    answer = distribute_forces(contacts, **asked, contact_compliance=1e-5)
    assert not answer.found and "passive force by compliance" in answer.reason
    with pytest.raises(ContactError, match="contact_compliance"):
        distribute_forces(contacts, **asked, contact_compliance=0.0)


def by_finger(plan: GraspPlan, contacts: ContactSet, forces: FloatArray) -> FloatArray:
    """Normal forces (n,) of a plan's fingers and links, N, over all contacts of each."""
    normals = forces[np.cumsum([0, *contacts.dims])[:-1]]
    of = np.array(plan.task.finger_names)[:, None] == np.array(contacts.fingers)
    return np.asarray(of @ normals)


def test_mujoco_shares_a_push_as_predicted(inner: GraspPlan) -> None:
    """Normal forces of all contacts while 5 to 15 N push from the side; median error below 10 %.

    From the posture in which the fingers closed it is half of that, and no link that MuJoCo says
    bears nothing is told to bear 1 N.
    """
    hold = DisturbanceTrial(inner, physics=PhysicsOptions())
    assert hold.run_phases("close") is None
    closed = hold.simulation.data.qpos.copy()
    assert hold.run_phases("squeeze", "settle", "lift") is None
    scene = hold.simulation.scene
    ways = {0.1: compliance_of(inner, scene), 0.05: compliance_of(inner, scene, closed)}
    errors: dict[float, list[float]] = {limit: [] for limit in ways}
    for force in (5.0, 10.0, 15.0):
        wrench = np.array([0.6 * force, 0.0, -0.8 * force, 0.0, 0.0, 0.0])
        hold.push(wrench)
        assert hold.hold_for(0.3) is None
        measured = hold.simulation.normal_forces()
        for limit, (grasp, contacts, pressed) in ways.items():
            predicted, share = grasp.under(contacts, pressed, wrench)
            assert share == 1.0
            normals = by_finger(inner, contacts, predicted)
            errors[limit] += (np.abs(measured - normals) / np.maximum(normals, 1.0)).tolist()
            assert limit == 0.1 or (normals[measured == 0.0] < 1.0).all()
    for limit, found in errors.items():
        assert np.median(found) < limit


def test_what_has_moved_away_from_the_palm_presses_on_it_less(inner: GraspPlan) -> None:
    """Half a millimetre from where it was planned takes a third of the palm's force: 7.4 to 4.7 N.

    Without gaps both are 6.1 N.
    """
    scene = build_scene(inner.task, T_world_base=inner.T_world_base, q=inner.q)
    palm = inner.task.finger_names.index("palm")
    forces = []
    for off in (0.0, 5e-4):
        there = shifted(inner.task.T_world_object, off * inner.contacts.normals[palm])
        qpos = scene.posed(inner.q, inner.T_world_base, there)
        _, contacts, pressed = compliance_of(inner, scene, qpos)
        forces.append(by_finger(inner, contacts, pressed)[palm])
    assert forces[1] < forces[0] - 1.0, forces


def test_the_problem_of_links_is_shown_and_solvers_are_compared_on_it(
    inner: GraspPlan, tmp_path: Path
) -> None:
    inner.save(file := tmp_path / "inner.json")
    shown = CliRunner().invoke(app, ["analyse", str(file), "--forces"])
    assert shown.exit_code == 0 and "1 of passive forces" in shown.output
    asked = ["analyse", str(file), "--forces", "--solvers", "daqp", "--steps", "5", "--json"]
    assert json.loads(CliRunner().invoke(app, asked).output)["solvers"]["records"]


def test_rows_of_soft_contacts_are_those_of_compliance_in_its_own_units() -> None:
    """P' C f = 0 with C = c of forces, m/N, and c / (0.01 m)^2 of torsions, rad/(N m)."""
    positions, c, unit = 0.05 * np.eye(3), 1e-4, 0.01
    contacts = ContactSet.from_arrays(
        positions, -np.eye(3), mu=0.5, mu_torsion=0.01, model="soft", center=[0, 0, 0]
    )
    scale = np.tile([1.0, 1.0, 1.0, unit], 3)
    rows = passive_rows(contacts, np.zeros((2, 12)), None, c, scale)
    null = null_space(contacts.grasp_map())
    expected = null.T * (c / scale**2)
    assert rows.shape == expected.shape == (6, 12)
    # the same rows up to their combination
    assert np.linalg.matrix_rank(np.vstack([rows, expected / np.abs(expected).max()])) == 6


def test_joints_that_a_tie_holds_together_feel_one_force_less() -> None:
    contacts = three()
    levers = np.zeros((2, 9))
    null = null_space(contacts.grasp_map())
    levers[:] = 0.05 * null[:, :2].T  # each joint feels one internal force
    unit = np.ones(9)
    tied: Any = SimpleNamespace(stop_values=np.array([np.inf]), stop_rows=np.array([[1.0, -1.0]]))
    assert len(passive_rows(contacts, levers, None, 1e-4, unit)) == null.shape[1] - 2
    assert len(passive_rows(contacts, levers, tied, 1e-4, unit)) == null.shape[1] - 1


def test_a_joint_at_its_stop_hardly_gives_way(inner: GraspPlan) -> None:
    task, q = inner.task, inner.q.copy()
    joint = 0
    q[joint] = task.hand.q_upper[joint]
    assert task.hand.actuation.active_stops(q).any()
    free, stopped = (
        GraspCompliance.of(
            build_force_problem(
                inner.contacts, **force_arguments(task, inner.contacts, inner.T_world_base, at)
            ),
            1e-5,
        ).joint[joint, joint]
        for at in (inner.q, q)
    )
    assert stopped < free / 2.0 and stopped < 1.05 / STOP


def test_forces_that_compliance_does_not_bring_about_are_a_residual(inner: GraspPlan) -> None:
    problem = inner.forces.problem
    grasp = GraspCompliance.of(problem, 1e-5)
    assert grasp.passive.shape[1] > 0
    forces = np.zeros(problem.rows.shape[1])
    forces[: problem.n_force] = [f for row in np.nan_to_num(inner.contacts.forces) for f in row[:3]]
    before = problem.residuals(forces).worst
    forces[: problem.n_force] += 1e-3 * grasp.passive[:, 0]  # balance and torques stay
    assert problem.residuals(forces).worst > before + 1e-5


def test_contacts_are_stiffer_across_than_along_by_impratio(
    inner: GraspPlan,
) -> None:
    hold = DisturbanceTrial(inner)
    grasp, contacts, _ = compliance_of(inner, hold.simulation.scene)
    each = grasp.contact.reshape(len(contacts), -1)
    assert np.allclose(each[:, 1:3] / each[:, :1], 1.0 / hold.simulation.scene.physics.impratio)
