"""Small programmes: known answers, scipy and OSQP as second solvers, and what has no solution."""

from __future__ import annotations

import warnings
from typing import Any, Literal

import numpy as np
import pytest
import qpsolvers
from scipy.optimize import linprog
from scipy.sparse import csc_matrix

from planner.programme import ScipyProgramme, programme
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


@pytest.mark.parametrize("seed", range(8))
def test_both_linear_solvers_agree_on_rows_limited_on_both_sides(seed: int) -> None:
    given = quadratic(np.random.default_rng(seed))
    del given["h"]
    given["uba"] = given["lba"] + np.append(np.zeros(2), np.full(5, 0.3))
    one, other = programme("highs", 6, 7), ScipyProgramme()
    mine, theirs = one.solve(**given), other.solve(**given)
    assert (mine is None) == (theirs is None) == other.infeasible
    if mine is not None and theirs is not None:
        assert given["g"] @ mine == pytest.approx(given["g"] @ theirs, abs=1e-9)
        np.testing.assert_allclose(one.row_prices, other.row_prices, rtol=0, atol=1e-8)
        np.testing.assert_allclose(one.bound_prices, other.bound_prices, rtol=0, atol=1e-8)


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


def test_beside_a_second_library_of_the_same_name_scipy_is_asked(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("planner.programme.find_spec", lambda name: name)
    assert isinstance(programme("highs", 5, 41), ScipyProgramme)
    assert not isinstance(programme("daqp", 5, 41), ScipyProgramme)
    programme.cache_clear()


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
