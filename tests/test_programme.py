"""Small programmes: known answers, scipy and OSQP as second solvers, and what has no solution."""

from __future__ import annotations

import subprocess
import sys
import warnings
from typing import Any, Literal

import numpy as np
import pytest
import qpsolvers
from scipy.optimize import linprog
from scipy.sparse import csc_matrix

from planner.numerics.programme import ScipyProgramme, programme
from planner.spatial import FloatArray

INF = np.inf


def quadratic(rng: np.random.Generator) -> dict[str, FloatArray]:
    """A random strictly convex programme of 6 unknowns, 2 equalities and 5 inequalities."""
    factor, inside = rng.normal(size=(6, 6)), rng.normal(size=6)
    a = rng.normal(size=(7, 6))
    least = a @ inside - np.append(np.zeros(2), rng.uniform(0.0, 1.0, 5))
    return {
        "h": factor.T @ factor + 0.1 * np.eye(6),
        "g": rng.normal(size=6),
        "a": a,
        "lba": least,
        "uba": np.append(least[:2], np.full(5, INF)),
        "lbx": inside - 0.5,
        "ubx": inside + 0.5,
    }


def test_a_projection_by_hand() -> None:
    # the point of x + y >= 2, x <= 0.5 that is nearest to the origin
    found = programme("daqp", 2, 1).solve(
        h=np.eye(2),
        g=np.zeros(2),
        a=np.ones((1, 2)),
        lba=np.array([2.0]),
        uba=np.array([INF]),
        lbx=np.array([-INF, -INF]),
        ubx=np.array([0.5, INF]),
    )
    assert found is not None
    np.testing.assert_allclose(found, [0.5, 1.5], rtol=0, atol=1e-12)


@pytest.mark.parametrize("seed", range(8))
def test_the_quadratic_solver_agrees_with_osqp(seed: int) -> None:
    given = quadratic(np.random.default_rng(seed))
    found = programme("daqp", 6, 7).solve(**given)
    problem = qpsolvers.Problem(
        csc_matrix(given["h"]),
        given["g"],
        G=csc_matrix(-given["a"][2:]),
        h=-given["lba"][2:],
        A=csc_matrix(given["a"][:2]),
        b=given["lba"][:2],
        lb=given["lbx"],
        ub=given["ubx"],
    )
    exact: Any = {"eps_abs": 1e-9, "eps_rel": 1e-9, "polishing": True}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # osqp announces another default
        theirs = qpsolvers.solve_problem(problem, solver="osqp", **exact)
    assert found is not None
    np.testing.assert_allclose(found, theirs.x, rtol=0, atol=1e-6)


@pytest.mark.parametrize("seed", range(8))
def test_the_linear_solver_and_its_prices_agree_with_scipy(seed: int) -> None:
    given = quadratic(np.random.default_rng(seed))
    del given["h"]
    solver = programme("highs", 6, 7)
    found = solver.solve(**given)
    assert found is not None
    theirs = linprog(
        given["g"],
        A_ub=-given["a"][2:],
        b_ub=-given["lba"][2:],
        A_eq=given["a"][:2],
        b_eq=given["lba"][:2],
        bounds=np.column_stack([given["lbx"], given["ubx"]]),
    )
    assert given["g"] @ found == pytest.approx(theirs.fun, abs=1e-9)
    rows = np.append(theirs.eqlin.marginals, -theirs.ineqlin.marginals)
    np.testing.assert_allclose(solver.row_prices, rows, rtol=0, atol=1e-8)
    bounds = theirs.lower.marginals + theirs.upper.marginals
    np.testing.assert_allclose(solver.bound_prices, bounds, rtol=0, atol=1e-8)


@pytest.mark.parametrize(
    ("seed", "feasible"), [(seed, seed in (1, 2, 4, 6, 8)) for seed in range(10)]
)
def test_prices_of_rows_limited_on_both_sides_prove_the_least_cost(
    seed: int, feasible: bool
) -> None:
    given = quadratic(np.random.default_rng(seed))
    del given["h"]
    given["uba"] = given["lba"] + np.append(np.zeros(2), np.full(5, 0.3))
    solver = ScipyProgramme()
    x = solver.solve(**given)
    assert solver.infeasible != feasible
    if not feasible:
        assert x is None
        return
    assert x is not None
    # duality: what the prices say of the limits is the least cost, and stationarity holds
    stationary = given["g"] - given["a"].T @ solver.row_prices - solver.bound_prices
    np.testing.assert_allclose(stationary, 0.0, rtol=0, atol=1e-9)
    worth = 0.0
    for prices, low, high in (
        (solver.row_prices, given["lba"], given["uba"]),
        (solver.bound_prices, given["lbx"], given["ubx"]),
    ):
        paid = np.abs(prices) > 1e-12
        worth += float((prices * np.where(prices > 0.0, low, high))[paid].sum())
    assert worth == pytest.approx(float(given["g"] @ x), abs=1e-8)


@pytest.mark.parametrize("name", ["g", "a", "lba", "uba", "lbx", "ubx"])
def test_what_is_no_number_has_no_solution_by_either(name: str) -> None:
    given = quadratic(np.random.default_rng(0))
    del given["h"]
    given[name] = given[name].copy()
    given[name].flat[0] = np.nan
    other = ScipyProgramme()
    assert programme("highs", 6, 7).solve(**given) is None
    assert other.solve(**given) is None
    assert not other.infeasible


CLOSE = """
import numpy as np
from planner import ContactSet, force_closure
from planner.certify import certify_contacts
from planner.numerics.programme import programme
angles = np.arange(3) * 2 * np.pi / 3
normals = -np.column_stack([np.cos(angles), np.sin(angles), np.zeros(3)])
contacts = ContactSet.from_arrays(-0.03 * normals, normals, mu=0.5)
print(type(programme("highs", 5, 41)).__name__, force_closure(contacts).min_weight.hex())
print(certify_contacts(contacts, length=0.03, width=0.5, max_points=20).epsilon.lower.hex())
"""
HIDE = """
import sys
class Hidden:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in ("highspy", "daqp", "clarabel"):
            raise ModuleNotFoundError(name)
sys.meta_path.insert(0, Hidden())
import importlib.util
true = importlib.util.find_spec
importlib.util.find_spec = lambda name, *more: None if name == "highspy" else true(name, *more)
"""


@pytest.mark.slow
def test_what_else_is_installed_does_not_choose_the_solver() -> None:
    # CasADi's HiGHS and that of highspy bear one name, and a process with both dies
    told = [
        subprocess.run(
            [sys.executable, "-c", code], capture_output=True, text=True, check=False, timeout=300
        )
        for code in (CLOSE, HIDE + CLOSE)
    ]
    assert [t.returncode for t in told] == [0, 0], told[1].stderr[-2000:]
    assert told[0].stdout == told[1].stdout


@pytest.mark.parametrize("solver", ["daqp", "highs"])
def test_what_contradicts_itself_has_no_solution_and_leaves_nothing_behind(
    solver: Literal["daqp", "highs"],
) -> None:
    given = {
        "g": np.ones(2),
        "a": np.ones((1, 2)),
        "lba": np.array([3.0]),
        "uba": np.array([INF]),
        "lbx": np.zeros(2),
        "ubx": np.ones(2),
    }
    if solver == "daqp":
        given["h"] = np.eye(2)
    assert programme(solver, 2, 1).solve(**given) is None
    given["lba"] = np.array([1.5])
    found = programme(solver, 2, 1).solve(**given)
    assert found is not None
    assert found.sum() == pytest.approx(1.5)
    given["lba"] = np.array([np.nan])
    assert programme(solver, 2, 1).solve(**given) is None
    given["lba"], given["g"] = np.array([1.5]), np.array([np.nan, 1.0])
    assert programme(solver, 2, 1).solve(**given) is None


def test_answers_are_not_overwritten_by_the_next() -> None:
    given = quadratic(np.random.default_rng(1))
    solver = programme("daqp", 6, 7)
    first = solver.solve(**given)
    assert first is not None
    kept = first.copy()
    solver.solve(**(given | {"g": -given["g"]}))
    np.testing.assert_array_equal(first, kept)
