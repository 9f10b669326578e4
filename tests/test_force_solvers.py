"""Every installed solver on problems with answers worked out on paper, and on one sequence."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from planner.contacts import ContactSet
from planner.errors import ContactError, NotFoundError
from planner.forces import (
    ForceLoop,
    build_force_problem,
    compare_solvers,
    cone_gaps,
    distribute_forces,
    explain_infeasibility,
    gravity_wrench,
    least_violation,
    solver_names,
    turning_wrenches,
)
from planner.forces.infeasible import outlined
from planner.numerics import qp as workspaces
from planner.numerics.qp import DenseQp, qp_workspace
from planner.spatial import FloatArray

FILE = Path(__file__).parent / "data" / "force_problems.json"
PROBLEMS: list[dict[str, Any]] = json.loads(FILE.read_text(encoding="utf-8"))["problems"]
IDS = [p["name"] for p in PROBLEMS]
MISSED = {"proxqp": {"strong enough by a hair"}}
"""Problems that a solver misses, and says so: ProxQP takes a hair for nothing."""

TOLERANCES = [1e-3, 1e-6]
LOOSE_DUAL = 20.0
"""How far the multipliers of a solver may be from stationarity, in units of its tolerance: ProxQP
judges them in units of its own."""

LOOP_TOL = 1e-6
FIRST_ORDER = 2e-3
"""Relative error of forces at ``LOOP_TOL``: residuals of 1e-6 leave the most in directions in which
the cost is flat."""


def contacts_of(problem: dict[str, Any]) -> ContactSet:
    return ContactSet.from_arrays(**problem["contacts"])


def on_ball(seed: int, n: int, **options: Any) -> ContactSet:
    """Contacts on a ball of 3 cm, with normals up to about 20 degrees off."""
    rng = np.random.default_rng(seed)
    p = rng.normal(size=(n, 3))
    p /= np.linalg.norm(p, axis=1, keepdims=True)
    normals = -p + 0.15 * rng.normal(size=(n, 3))
    return ContactSet.from_arrays(0.03 * p, normals, **{"mu": 0.5, **options})


def around(n: int = 5) -> ContactSet:
    """Contacts around the waist and one below: every force can be resisted."""
    angle = 2 * np.pi / (n - 1) * np.arange(n - 1)
    d = np.stack([np.cos(angle), np.sin(angle), 0.3 * np.ones(n - 1)], axis=1)
    d = np.vstack([d, [0.1, 0.0, -1.0]])
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    return ContactSet.from_arrays(0.03 * d, -d, mu=0.6)


# The frozen set


@pytest.mark.parametrize("problem", PROBLEMS, ids=IDS)
def test_the_answer_on_paper(problem: dict[str, Any]) -> None:
    contacts = contacts_of(problem)
    size = max(*np.abs(problem["wrench"]), *np.abs(problem.get("normal_forces", [0]))) or 1.0
    for solver in solver_names():
        answer = distribute_forces(
            contacts, wrench=problem["wrench"], solver=solver, **problem["options"]
        )
        if problem["name"] in MISSED.get(solver, ()) and not answer.found:
            assert answer.reason.startswith("forces exist, but solver"), solver
            continue
        assert answer.found == problem["found"], (solver, answer.reason)
        if answer.found:
            expected = np.array(problem["normal_forces"])
            assert answer.forces[:, 0] == pytest.approx(expected, abs=1e-4 * size), solver
            assert answer.residuals.worst <= 1e-6 * answer.problem.force_scale
        else:
            left = np.array(problem["left_over"])
            assert answer.unresisted_wrench == pytest.approx(left, abs=2e-6 * size), solver
            if "fraction" in problem:
                assert answer.fraction == pytest.approx(problem["fraction"], abs=1e-6)


@pytest.mark.parametrize("problem", PROBLEMS, ids=IDS)
def test_the_answer_on_paper_step_by_step(problem: dict[str, Any]) -> None:
    """A kept solver, at the first step and at the second, that starts from the first."""
    wrench = np.array(problem["wrench"], dtype=float)
    options = problem["options"]
    for solver in solver_names():
        if problem["name"] in MISSED.get(solver, ()):
            continue
        loop = ForceLoop(contacts_of(problem), solver=solver, tolerance=LOOP_TOL, **options)
        for _ in range(2):
            step = loop.step(wrench)
            if not problem["found"]:
                assert not step.balanced, solver
                continue
            expected = np.array(problem["normal_forces"])
            close = FIRST_ORDER * max(1.0, np.abs(expected).max())
            if problem["kind"] in ("well conditioned", "degenerate") or step.balanced:
                assert step.balanced, (solver, step.status)
                assert step.forces[:, 0] == pytest.approx(expected, abs=close), solver
    assert len(solver_names()) >= 2


def test_the_default_solver_misses_none_of_them() -> None:
    for problem in PROBLEMS:
        loop = ForceLoop(contacts_of(problem), **problem["options"])
        assert loop.step(np.array(problem["wrench"], dtype=float)).balanced == problem["found"]


# Residuals and proofs


@pytest.mark.parametrize("tolerance", TOLERANCES)
@pytest.mark.parametrize("solver", solver_names())
def test_answers_called_solved_are_within_the_tolerance_asked_for(
    solver: str, tolerance: float
) -> None:
    contacts = around()
    loop = ForceLoop(contacts, solver=solver, tolerance=tolerance, min_normal=0.1, max_normal=5.0)
    solved = answered = 0
    for wrench in turning_wrenches(1.0, 0.03, 60):
        step = loop.step(wrench)
        forces = contacts.with_forces(step.forces)
        if step.balanced:
            solved += 1
            size = max(1.0, float(np.linalg.norm(wrench / [1, 1, 1, *3 * [loop.problem.length]])))
            missed = (forces.wrench() + wrench) / [1, 1, 1, *3 * [loop.problem.length]]
            assert np.abs(missed).max() <= 1.01 * tolerance * size
            assert forces.friction_utilisation().max() <= 1 + 20 * tolerance
            if np.isnan(loop.solver.x).any():
                continue  # the solver gave up; the loop found forces by least violation
            answered += 1
            dual = loop.qp.dual_residual(loop.solver.x, loop.solver.duals)
            assert dual <= LOOSE_DUAL * tolerance
    assert solved >= 58
    assert answered >= solved - GIVEN_UP.get(solver, 0)


GIVEN_UP = {"highs": 2}
"""Of these 60 strictly convex programmes HiGHS 1.15.1 calls one unbounded and fails on another,
with any of its options and tolerances; the solution is unique, and all other solvers find it. In
the comparison it solves all 40, but twice, after thousands of other tests in one process, it did
not end; since then its steps are limited."""


def test_every_refusal_is_proven_by_a_linear_programme() -> None:
    refused = 0
    for seed in range(150):
        contacts = on_ball(seed, 3)
        wrench = np.random.default_rng(seed).normal(size=6) * [1, 1, 1, 0.01, 0.01, 0.01]
        step = ForceLoop(contacts, max_normal=20.0).step(wrench)
        problem = build_force_problem(contacts, wrench=wrench, max_normal=20.0)
        assert explain_infeasibility(problem).feasible == step.balanced
        refused += not step.balanced
    assert 20 < refused < 145


def test_multipliers_have_the_sign_of_their_limit() -> None:
    """Min x^2 / 2 with x >= 1: x - 1 = 0, multiplier -1 at the lower bound; any solver."""
    for solver in solver_names():
        qp = DenseQp(2, 1, 1)
        qp.lower[0], qp.a[:] = 1.0, [[0.0, 1.0]]
        qp.low[:] = qp.high[:] = 2.0
        kept = qp_workspace(solver, qp)
        assert kept.solve(), solver
        assert kept.x == pytest.approx([1.0, 2.0], abs=1e-6), solver
        assert kept.duals == pytest.approx([-2.0, -1.0, 0.0], abs=1e-5), solver
        assert qp.dual_residual(kept.x, kept.duals) < 1e-5
        assert qp.dual_residual(kept.x, np.array([-2.0, 1.0, 0.0])) > 0.9
        assert qp.dual_residual(kept.x, np.array([-2.0, -1.0, 0.5])) > 0.4


def test_multipliers_of_rows_with_a_lower_limit() -> None:
    """x^2 / 2 with 2 <= x <= 8 and x <= 9 as rows: multiplier -2 at the lower limit."""
    for solver in solver_names():
        qp = DenseQp(1, 2, 0)
        qp.a[:] = [[1.0], [-1.0]]
        qp.low[:], qp.high[:] = [2.0, -9.0], [8.0, np.inf]
        kept = qp_workspace(solver, qp)
        assert kept.solve(), solver
        assert kept.x == pytest.approx([2.0], abs=1e-6), solver
        assert kept.duals == pytest.approx([-2.0, 0.0, 0.0], abs=1e-5), solver


@pytest.mark.parametrize("mu_torsion", [0.0, 0.006])
def test_outlines_are_around_and_inside(mu_torsion: float) -> None:
    model: Any = "soft" if mu_torsion else "point"
    one = ContactSet.from_arrays([[0.03, 0, 0]], [[-1, 0, 0]], mu_torsion=mu_torsion, model=model)
    problem = build_force_problem(one, wrench=np.zeros(6), cone="round")
    inner, outer = (outlined(problem, inner=flag).faces for flag in (True, False))
    rng = np.random.default_rng(0)
    reached = []
    for tail in rng.normal(size=(3000, len(problem.column_names) - 1)):
        x = np.array([1.0, *(tail / np.linalg.norm(problem.cones[1:, 1:] @ tail))])  # on the cone
        assert (outer @ x).max() <= 1e-12
        assert (inner @ x).max() >= -1e-12
        assert (inner @ (x * [1, *np.full(len(tail), 0.96)])).max() <= 1e-12
        reached.append((outer @ x).max())
    assert max(reached) > -0.002  # the outline touches


def test_a_solver_that_met_the_impossible_goes_on() -> None:
    wrench = gravity_wrench(0.1, [0, 0, -9.81])
    contacts = ContactSet.from_arrays([[0.03, 0, 0], [-0.03, 0, 0]], [[-1, 0, 0], [1, 0, 0]])
    for solver in solver_names():
        loop = ForceLoop(contacts, solver=solver)
        for wanted, balanced in ((wrench, True), (wrench + np.eye(6)[3], False), (wrench, True)):
            assert loop.step(wanted).balanced == balanced, solver


# Comparison


def test_solvers_are_compared_on_one_sequence() -> None:
    wrenches = turning_wrenches(1.0, 0.03, 40)
    report = compare_solvers(around(), wrenches, tolerance=1e-5, min_normal=0.1)
    assert [r.solver for r in report.records] == list(solver_names())
    assert report.unknowns == 15
    assert report.rows == 5 + 6 + 40  # bounds of normal forces, balance, faces
    for r in report.records:
        assert (r.solved + r.failed, r.refused) == (40, 0), r.solver
        assert r.failed <= GIVEN_UP.get(r.solver, 0)
        assert 0 < r.solver_median_us < r.median_us <= r.p99_us
        assert r.primal <= 2e-5
        assert r.off < 0.02
    assert report.records[0].off < 1e-9
    assert report.records[0].solver in str(report)
    assert report.as_dict()["records"][0]["solver"] == "daqp"


def test_what_cannot_be_solved_is_told_from_what_was_missed() -> None:
    two = ContactSet.from_arrays([[0.03, 0, 0], [-0.03, 0, 0]], [[-1, 0, 0], [1, 0, 0]])
    wrenches = np.zeros((4, 6))
    wrenches[:2, 2], wrenches[2:, 3] = -1.0, 0.01
    report = compare_solvers(two, wrenches, solvers=["daqp"])
    assert (report.records[0].solved, report.records[0].refused) == (2, 2)


def test_the_sequence_turns_through_all_directions() -> None:
    wrenches = turning_wrenches(2.0, 0.05, 500)
    push = wrenches[:, 4] / 0.05
    assert push.min() >= 0
    assert push.max() == pytest.approx(1.0, abs=0.05)
    force = wrenches[:, :3] - push[:, None] * [1, 0, 0]
    assert np.linalg.norm(force, axis=1) == pytest.approx(np.full(500, 2.0))
    corners: FloatArray = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T
    octants: NDArray[np.bool_] = (np.sign(force)[:, None] == corners[None]).all(axis=2)
    assert octants.any(axis=0).all()
    with pytest.raises(ContactError, match="at least 1 step"):
        turning_wrenches(1.0, 0.03, 0)


def test_highs_gives_up_where_its_active_sets_repeat(monkeypatch: pytest.MonkeyPatch) -> None:
    """It has looped for ever on a programme of the comparison; a limit of one step stands in."""
    pytest.importorskip("highspy")
    options = workspaces._OPTIONS["highs"]
    assert 100 < options["qp_iteration_limit"] < 1e5
    loop = ForceLoop(around(), solver="highs", min_normal=0.1)
    wrench = turning_wrenches(1.0, 0.03, 1)[0]
    assert loop.step(wrench).balanced
    monkeypatch.setitem(options, "qp_iteration_limit", 1)
    assert not loop.step(wrench).balanced
    assert np.isnan(loop.solver.x).all()


def test_unknown_solver_lists_what_is_installed() -> None:
    with pytest.raises(NotFoundError, match=r"'osqq'.*daqp"):
        compare_solvers(around(), np.zeros((1, 6)), solvers=["osqq"])


# Pyramids beside the cone, and the cone itself


def test_pyramids_close_in_on_the_cone() -> None:
    pytest.importorskip("clarabel")
    gaps = cone_gaps(around(), turning_wrenches(1.0, 0.03, 12), wrench=np.zeros(6), min_normal=0.1)
    for cone, sign in (("inscribed", 1), ("circumscribed", -1)):
        mine = [g for g in gaps if g.cone == cone]
        assert all(g.compared == 12 for g in mine)
        assert all(sign * g.worst_cost >= -1e-6 for g in mine)
        worst = [g.worst_N for g in mine]
        assert worst[0] > 2 * worst[3] > 4 * worst[-1]


def answer(contacts: ContactSet, cone: Any, **options: Any) -> tuple[bool, float]:
    """Whether a solver's answer holds by our residuals, and its cost; no reasons are sought."""
    problem = build_force_problem(contacts, cone=cone, **options)
    qp = problem.dense_qp(problem.force_scale)
    workspace = qp_workspace("clarabel" if cone == "round" else "daqp", qp)
    workspace.solve()
    x = problem.force_scale * problem.column_scale * workspace.x
    return problem.residuals(x).worst <= 2e-6 * problem.force_scale, problem.value(x)


@pytest.mark.slow
def test_many_problems_are_as_theory_says() -> None:
    """Inscribed implies round implies circumscribed; costs fall in that order."""
    pytest.importorskip("clarabel")
    between = held = 0
    for seed in range(150):
        rng = np.random.default_rng(seed)
        contacts = on_ball(seed, int(rng.integers(2, 5)), mu=float(rng.uniform(0.3, 1.0)))
        wrench = rng.normal(size=6) * [1, 1, 1, 0.01, 0.01, 0.01]
        edges = int(rng.integers(3, 9))
        options: dict[str, Any] = {"wrench": wrench, "max_normal": 30.0, "edges": edges}
        inner, most = answer(contacts, "inscribed", **options)
        cone, between_both = answer(contacts, "round", **options)
        outer, least = answer(contacts, "circumscribed", **options)
        assert cone or not inner, seed
        assert outer or not cone, seed
        between += inner != outer
        held += inner
        if cone:
            assert least <= between_both * (1 + 1e-5) + 1e-9
        if inner:
            assert between_both <= most * (1 + 1e-5) + 1e-9
    assert between > 5
    assert held > 25


@pytest.mark.parametrize("turn", [0.0, 0.1, np.pi / 8])
def test_the_round_cone_has_no_corners(turn: float) -> None:
    """Two opposed contacts hold a weight from any side with W / (2 mu); no pyramid does."""
    pytest.importorskip("clarabel")
    contacts = ContactSet.from_arrays([[0.03, 0, 0], [-0.03, 0, 0]], [[-1, 0, 0], [1, 0, 0]])
    wrench = np.array([0, np.sin(turn), -np.cos(turn), 0, 0, 0])
    answer = distribute_forces(contacts, wrench=wrench, cone="round")
    assert answer.solver == "clarabel"
    assert answer.forces[:, 0] == pytest.approx([1.0, 1.0], abs=1e-6)


def test_sliding_takes_from_torsion() -> None:
    """Weight W and torque t on two soft fingers: f_n = hypot(W/2/mu, t/2/gamma), or their sum."""
    pytest.importorskip("clarabel")
    contacts = ContactSet.from_arrays(
        [[0.03, 0, 0], [-0.03, 0, 0]], [[-1, 0, 0], [1, 0, 0]], mu_torsion=0.005, model="soft"
    )
    wrench = np.array([0, 0, -1.0, 0.01, 0, 0])
    cones: list[tuple[Any, float]] = [("round", np.hypot(1.0, 1.0)), ("inscribed", 2.0)]
    for cone, expected in cones:
        answer = distribute_forces(contacts, wrench=wrench, cone=cone)
        assert answer.forces[:, 0] == pytest.approx([expected] * 2, rel=1e-5), cone


def test_round_cones_that_cannot_hold_say_why() -> None:
    pytest.importorskip("clarabel")
    contacts = ContactSet.from_arrays([[0.03, 0, 0], [-0.03, 0, 0]], [[-1, 0, 0], [1, 0, 0]])
    answer = distribute_forces(contacts, wrench=[0, 0, -1.0, 0, 0, 0], max_normal=0.5, cone="round")
    assert not answer.found
    assert answer.fraction == pytest.approx(0.5, rel=2e-3)
    assert any("friction of" in name for name in answer.limits)
    with pytest.raises(ContactError, match="cannot do round cones"):
        distribute_forces(contacts, wrench=np.zeros(6), cone="round", solver="osqp")
    with pytest.raises(ContactError, match="a loop takes"):
        ForceLoop(contacts, cone="round")


def test_between_the_outlines_a_problem_is_called_by_a_hair() -> None:
    """0.06 % more friction than there is: pyramids around allow it, those inside do not."""
    contacts = ContactSet.from_arrays([[0.03, 0, 0], [-0.03, 0, 0]], [[-1, 0, 0], [1, 0, 0]])
    turn = np.pi / 64  # where the outer outline has a corner
    wrench = 1.0006 * np.array([0, np.sin(turn), -np.cos(turn), 0, 0, 0])
    problem = build_force_problem(contacts, wrench=wrench, max_normal=1.0, cone="round")
    assert "by a hair or not at all" in explain_infeasibility(problem).reason
    easier = build_force_problem(contacts, wrench=0.99 * wrench, max_normal=1.0, cone="round")
    assert explain_infeasibility(easier).feasible


@pytest.mark.parametrize("cone", ["inscribed", "round"])
def test_what_is_left_over_is_least(cone: Any) -> None:
    """Half the friction that the weight needs: half of it is left over, and the grip is full."""
    if cone == "round":
        pytest.importorskip("clarabel")
    contacts = ContactSet.from_arrays([[0.03, 0, 0], [-0.03, 0, 0]], [[-1, 0, 0], [1, 0, 0]])
    wrench = np.array([0, 0, -1.0, 0, 0, 0])
    problem = build_force_problem(contacts, wrench=wrench, max_normal=0.5, cone=cone)
    best = least_violation(problem)
    assert best.solution.found
    assert best.left_over == pytest.approx([0, 0, -0.5, 0, 0, 0], abs=1e-6)
    assert best.size == pytest.approx(0.5, abs=1e-6)
    assert best.solution.forces[:, 0] == pytest.approx([0.5, 0.5], abs=1e-5)
    assert best.solution.contacts.wrench() == pytest.approx(best.left_over - wrench, abs=1e-5)


def test_the_first_priority_is_the_euclidean_norm_and_the_second_the_cost() -> None:
    """Pull (0, 0.6, -0.8) of 2 N against 1 N of friction: what is left over points along it."""
    pytest.importorskip("clarabel")
    contacts = ContactSet.from_arrays([[0.03, 0, 0], [-0.03, 0, 0]], [[-1, 0, 0], [1, 0, 0]])
    wrench = 2.0 * np.array([0, 0.6, -0.8, 0, 0, 0])
    arguments: dict[str, Any] = {"wrench": wrench, "max_normal": 1.0, "cone": "round"}
    best = least_violation(build_force_problem(contacts, **arguments))
    assert best.left_over == pytest.approx(wrench / 2, abs=1e-5)
    # nothing can be met: no force is the cheapest
    twist = build_force_problem(contacts, wrench=[0, 0, 0, 0.01, 0, 0])
    none = least_violation(twist)
    assert none.left_over == pytest.approx([0, 0, 0, 0.01, 0, 0], abs=1e-7)
    assert none.solution.forces == pytest.approx(np.zeros((2, 4)), abs=1e-6)
    # what can be met is met
    assert least_violation(build_force_problem(contacts, wrench=wrench)).size == 0.0
