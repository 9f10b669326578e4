"""Small programmes: known answers, scipy and OSQP as second solvers, and what has no solution."""

from __future__ import annotations

import json
import subprocess
import sys
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import qpsolvers
from hypothesis import given as drawn
from hypothesis import settings
from hypothesis import strategies as st
from scipy.optimize import linprog
from scipy.sparse import csc_matrix

from planner.certify.breaking import Resistance
from planner.contacts import ContactSet
from planner.errors import PlannerError
from planner.forces import build_force_problem, distribute_forces
from planner.numerics.lp import NOT_KNOWN, LpAnswer, LpSolution, solve_lp
from planner.numerics.qp import solve_qp
from planner.spatial import FloatArray

INF = np.inf
DATA = Path(__file__).parent / "data"


def quadratic(rng: np.random.Generator) -> dict[str, FloatArray]:
    """A random strictly convex programme of 6 unknowns, 2 equalities and 5 inequalities."""
    factor, inside = rng.normal(size=(6, 6)), rng.normal(size=6)
    a = rng.normal(size=(7, 6))
    least = a @ inside - np.append(np.zeros(2), rng.uniform(0.0, 1.0, 5))
    return {
        "p": factor.T @ factor + 0.1 * np.eye(6),
        "q": rng.normal(size=6),
        "a": a,
        "low": least,
        "high": np.append(least[:2], np.full(5, INF)),
        "lower": inside - 0.5,
        "upper": inside + 0.5,
    }


def linear(given: dict[str, FloatArray]) -> LpAnswer:
    """Solve it without its P."""
    limits = np.column_stack([given["low"], given["high"]])
    bounds = np.column_stack([given["lower"], given["upper"]])
    return solve_lp(given["q"], given["a"], limits, bounds)


def test_a_projection_by_hand() -> None:
    # the point of x + y >= 2, x <= 0.5 that is nearest to the origin
    found = solve_qp(
        np.eye(2),
        np.zeros(2),
        np.ones((1, 2)),
        low=np.array([2.0]),
        high=np.array([INF]),
        lower=np.array([-INF, -INF]),
        upper=np.array([0.5, INF]),
    )
    assert found is not None
    np.testing.assert_allclose(found, [0.5, 1.5], rtol=0, atol=1e-12)


@pytest.mark.parametrize("seed", range(8))
def test_the_quadratic_solver_agrees_with_osqp(seed: int) -> None:
    given = quadratic(np.random.default_rng(seed))
    found = solve_qp(**given)
    problem = qpsolvers.Problem(
        csc_matrix(given["p"]),
        given["q"],
        G=csc_matrix(-given["a"][2:]),
        h=-given["low"][2:],
        A=csc_matrix(given["a"][:2]),
        b=given["low"][:2],
        lb=given["lower"],
        ub=given["upper"],
    )
    exact: Any = {"eps_abs": 1e-9, "eps_rel": 1e-9, "polishing": True}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # osqp announces another default
        theirs = qpsolvers.solve_problem(problem, solver="osqp", **exact)
    assert found is not None
    np.testing.assert_allclose(found, theirs.x, rtol=0, atol=1e-6)


@pytest.mark.parametrize("proven", [True, False])
@pytest.mark.parametrize("seed", range(8))
def test_the_linear_solver_and_its_duals_agree_with_scipy(
    seed: int, proven: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    if not proven:  # everything goes to HiGHS
        monkeypatch.setattr("planner.numerics.lp.run_daqp", lambda *given, **settings: None)
    given = quadratic(np.random.default_rng(seed))
    found = linear(given)
    assert isinstance(found, LpSolution)
    theirs = linprog(
        given["q"],
        A_ub=-given["a"][2:],
        b_ub=-given["low"][2:],
        A_eq=given["a"][:2],
        b_eq=given["low"][:2],
        bounds=np.column_stack([given["lower"], given["upper"]]),
    )
    assert found.value == given["q"] @ found.x == pytest.approx(theirs.fun, abs=1e-9)
    rows = np.append(theirs.eqlin.marginals, -theirs.ineqlin.marginals)
    np.testing.assert_allclose(found.row_duals, rows, rtol=0, atol=1e-8)
    bounds = theirs.lower.marginals + theirs.upper.marginals
    np.testing.assert_allclose(found.bound_duals, bounds, rtol=0, atol=1e-8)


@pytest.mark.parametrize("seed", range(8))
def test_duals_of_rows_limited_on_both_sides_prove_the_least_cost(seed: int) -> None:
    given = quadratic(np.random.default_rng(seed))
    given["high"] = given["low"] + np.append(np.zeros(2), np.full(5, 0.3))
    found = linear(given)
    limits = np.column_stack([given["low"], given["high"]])
    bounds = np.column_stack([given["lower"], given["upper"]])
    theirs = linprog(
        given["q"],
        A_ub=np.vstack([given["a"], -given["a"]]),
        b_ub=np.concatenate([given["high"], -given["low"]]),
        bounds=bounds,
    )
    assert (found is None) == (theirs.status == 2)
    if not isinstance(found, LpSolution):
        return
    # duality: what the duals say of the limits is the least cost, and stationarity holds
    stationary = given["q"] - given["a"].T @ found.row_duals - found.bound_duals
    np.testing.assert_allclose(stationary, 0.0, rtol=0, atol=1e-9)
    worth = 0.0
    for duals, (low, high) in ((found.row_duals, limits.T), (found.bound_duals, bounds.T)):
        paid = np.abs(duals) > 1e-12
        worth += float((duals * np.where(duals > 0.0, low, high))[paid].sum())
    assert worth == pytest.approx(found.value, abs=1e-8)


@settings(max_examples=100, deadline=None, derandomize=True)
@drawn(seed=st.integers(0, 2**31), n=st.integers(1, 120), m=st.integers(0, 8))
def test_programmes_of_any_shape_agree_with_scipy(seed: int, n: int, m: int) -> None:
    """Many unknowns and few rows are solved by their duals, infeasible ones by Farkas' lemma."""
    rng = np.random.default_rng(seed)
    a, x = rng.normal(size=(m, n)), rng.uniform(0.0, 1.0, n)
    meets = a @ x if rng.random() < 0.7 else rng.normal(size=m)
    kind = rng.integers(0, 3, m)
    limits = np.column_stack(
        [np.where(kind == 0, -INF, meets), np.where(kind == 1, INF, meets)]
    ).reshape(m, 2)
    bounds = np.column_stack([np.where(rng.random(n) < 0.1, -INF, 0.0), np.full(n, INF)])
    total, one = np.ones((1, n)), np.array([[0.0, max(1.0, x.sum())]])
    rows, limits = np.vstack([a, total]), np.vstack([limits, one[:, [1, 1]]])
    bounds[:, 0] = 0.0 if rng.random() < 0.9 else bounds[:, 0]
    cost = rng.normal(size=n)
    up, down = np.isfinite(limits[:, 1]), np.isfinite(limits[:, 0])
    theirs = linprog(
        cost,
        A_ub=np.vstack([rows[up], -rows[down]]),
        b_ub=np.concatenate([limits[up, 1], -limits[down, 0]]),
        bounds=bounds,
    )
    if theirs.status == 3:  # unbounded
        with pytest.raises(PlannerError, match="no least cost"):
            solve_lp(cost, rows, limits, bounds)
        return
    found = solve_lp(cost, rows, limits, bounds)
    assert (found is None) == (theirs.status == 2)
    if found is not None:
        assert isinstance(found, LpSolution)
        assert found.value == pytest.approx(theirs.fun, rel=1e-7, abs=1e-7)


def undecided() -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Cost, rows, their limits and bounds of an infeasible programme that HiGHS cannot decide."""
    told = json.loads((DATA / "undecided_programme.json").read_text(encoding="utf-8"))
    # None is no limit, below or above
    limits, bounds = (
        np.array([[-INF if a is None else a, INF if b is None else b] for a, b in told[name]])
        for name in ("row_limits", "bounds")
    )
    return np.array(told["cost"], dtype=float), np.array(told["rows"]), limits, bounds


def test_a_programme_that_highs_leaves_undecided_is_proven_infeasible() -> None:
    assert solve_lp(*undecided()) is None


def test_infeasible_programmes_are_proven_so_without_highs(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise AssertionError("HiGHS was asked")

    monkeypatch.setattr("planner.numerics.lp._by_highs", refuse)
    cost, rows, limits, bounds = undecided()
    assert solve_lp(cost, rows, limits, bounds) is None
    # x + y <= 1 and x + y >= 1 + gap, both free
    for gap in (1e-5, 1.0):
        sides = np.array([[-INF, 1.0], [1.0 + gap, INF]])
        assert solve_lp(np.zeros(2), np.ones((2, 2)), sides, np.tile([-INF, INF], (2, 1))) is None


@pytest.mark.parametrize("seed", range(4))
def test_an_undecided_programme_is_scaled_and_asked_of_the_other_methods(
    seed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    given = quadratic(np.random.default_rng(seed))
    wanted = linear(given)
    asked = []

    def only_inner_point(*args: Any, method: str, **more: Any) -> Any:
        asked.append(method)
        return linprog(*args, method=method, **more) if method == "highs-ipm" else Undecided()

    monkeypatch.setattr("planner.numerics.lp.run_daqp", lambda *given, **settings: None)
    monkeypatch.setattr("scipy.optimize.linprog", only_inner_point)
    found = linear(given | {name: 1e4 * given[name] for name in ("a", "low", "high")})
    assert asked == ["highs-ds", "highs-ipm"]
    assert isinstance(found, LpSolution) and isinstance(wanted, LpSolution)
    assert found.value == pytest.approx(wanted.value, abs=1e-8)
    np.testing.assert_allclose(1e4 * found.row_duals, wanted.row_duals, rtol=0, atol=1e-7)
    np.testing.assert_allclose(found.bound_duals, wanted.bound_duals, rtol=0, atol=1e-7)


class Undecided:
    """What HiGHS answers where it gives up."""

    status, message = 4, "model_status is Unknown"


def test_what_no_solver_decides_is_not_known_and_ends_nothing(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    pinch = ContactSet.from_arrays(
        0.02 * np.array([[1.0, 0, 0], [-1.0, 0, 0]]), [[-1.0, 0, 0], [1.0, 0, 0]], mu=0.1
    )
    ask: Any = {"wrench": [0, 0, -1.0, 0, 0, 0], "max_normal": 1.0}
    decided = distribute_forces(pinch, **ask)
    assert not decided.found and decided.fraction == pytest.approx(0.2, rel=0.02)
    monkeypatch.setattr("planner.numerics.lp.run_daqp", lambda *given, **settings: None)
    monkeypatch.setattr("scipy.optimize.linprog", lambda *args, **more: Undecided())
    assert linear(quadratic(np.random.default_rng(0))) is NOT_KNOWN
    left = distribute_forces(pinch, **ask)
    assert not left.found and "not known" in left.reason and np.isnan(left.fraction)
    with pytest.raises(PlannerError, match="not known"):
        left.raise_if_infeasible()
    # bounds of what a grasp resists stay bounds: wider, never below the true value
    problem = build_force_problem(pinch, wrench=np.zeros(6), max_normal=1.0)
    oracle = Resistance(problem, np.eye(6)[:, 2:3], gap=0.01)
    monkeypatch.undo()
    true = Resistance(problem, np.eye(6)[:, 2:3], gap=0.01).support(np.ones(1))[0]
    monkeypatch.setattr("planner.certify.breaking.solve_lp", lambda *given: NOT_KNOWN)
    assert oracle.held is None and oracle.support(np.ones(1))[0] >= true > 0.0


@pytest.mark.parametrize("name", ["q", "a", "low", "high", "lower", "upper"])
def test_what_is_no_number_is_refused(name: str) -> None:
    given = quadratic(np.random.default_rng(0))
    given[name] = given[name].copy()
    given[name].flat[0] = np.nan
    assert solve_qp(**given) is None
    with pytest.raises(PlannerError, match="holds NaN"):
        linear(given)


CLOSE = """
import numpy as np
from planner import ContactSet, force_closure
from planner.certify import certify_contacts
from planner.forces import ForceLoop
angles = np.arange(3) * 2 * np.pi / 3
normals = -np.column_stack([np.cos(angles), np.sin(angles), np.zeros(3)])
contacts = ContactSet.from_arrays(-0.03 * normals, normals, mu=0.5)
print(type(ForceLoop(contacts).solver).__name__, force_closure(contacts).min_weight.hex())
print(certify_contacts(contacts, length=0.03, width=0.5, max_points=20).epsilon.lower.hex())
"""
HIDE = """
import sys
class Hidden:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in ("highspy", "quadprog", "clarabel", "piqp", "proxsuite"):
            raise ModuleNotFoundError(name)
sys.meta_path.insert(0, Hidden())
import importlib.util
true = importlib.util.find_spec
importlib.util.find_spec = lambda name, *more: None if name == "highspy" else true(name, *more)
"""


@pytest.mark.slow
def test_what_else_is_installed_does_not_choose_the_solver(
    capsys: pytest.CaptureFixture[str],
) -> None:
    command = [sys.executable, "-c", HIDE + CLOSE]
    hidden = subprocess.run(command, capture_output=True, text=True, check=False, timeout=300)
    assert hidden.returncode == 0, hidden.stderr[-2000:]
    exec(CLOSE, {})
    assert hidden.stdout == capsys.readouterr().out


def test_what_contradicts_itself_has_no_solution_and_leaves_nothing_behind() -> None:
    given = {
        "p": np.eye(2),
        "q": np.ones(2),
        "a": np.ones((1, 2)),
        "low": np.array([3.0]),
        "high": np.array([INF]),
        "lower": np.zeros(2),
        "upper": np.ones(2),
    }
    assert solve_qp(**given) is None
    assert linear(given) is None
    given["low"] = np.array([1.5])
    found, best = solve_qp(**given), linear(given)
    assert found is not None
    assert isinstance(best, LpSolution)
    assert found.sum() == pytest.approx(1.5)
    assert best.x.sum() == pytest.approx(1.5)


def test_answers_are_not_overwritten_by_the_next() -> None:
    given = quadratic(np.random.default_rng(1))
    first = solve_qp(**given)
    assert first is not None
    kept = first.copy()
    solve_qp(**(given | {"q": -given["q"]}))
    np.testing.assert_array_equal(first, kept)
