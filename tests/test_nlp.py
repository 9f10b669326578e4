"""Programmes over a distance field: the same as over the formula that the field tabulates."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from typing import Any

import casadi as ca
import numpy as np
import pytest

from planner.spatial import FloatArray
from planner.synthesis.nlp import KEPT, FieldPoints, Nlp

RADII = np.array([1.0, 0.7, 0.5])

ORDER = [(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)]
THIRD = [(i, j, k) for i in range(3) for j in range(i, 3) for k in range(j, 3)]


def level(p: Any) -> Any:
    """A smooth function whose derivatives of every order matter."""
    return ca.sqrt(ca.sumsqr(p / RADII)) - 1 + 0.1 * ca.sin(p[0] + 2 * p[1] - p[2])


class Tabulated:
    """The field of ``level``; its derivatives by CasADi, and it counts how often it is asked."""

    def __init__(self) -> None:
        """Differentiate."""
        p = ca.SX.sym("p", 3)
        gradient = ca.gradient(level(p), p)
        second = ca.jacobian(gradient, p)
        third = [ca.jacobian(second[:, k], p) for k in range(3)]
        rows = [level(p), *[gradient[i] for i in range(3)], *[second[i, j] for i, j in ORDER]]
        self.functions = {
            2: ca.Function("second", [p], [ca.vertcat(*rows)]),
            3: ca.Function(
                "third", [p], [ca.vertcat(*rows, *[third[k][i, j] for i, j, k in THIRD])]
            ),
        }
        self.asked: list[FloatArray] = []

    def taylor(self, points: FloatArray, order: int) -> FloatArray:
        self.asked.append(points.copy())
        return np.array([np.array(self.functions[order](p)).ravel() for p in points])


def programme(
    on: Callable[[Any], Any],
    near: Callable[[Any], Any],
    gradient: Callable[[Any], Any],
    points: Any,
) -> Nlp:
    """Two points on the surface, far apart, normals opposed; a third one off it, on a circle."""
    x, p = ca.SX.sym("x", 8), ca.SX.sym("p", 2)
    first, second = x[:3], x[3:6]
    third = ca.vertcat(p[0] * ca.cos(x[6]), p[0] * ca.sin(x[6]), x[7])
    normals = [gradient(y) / ca.norm_2(gradient(y)) for y in (first, second)]
    return Nlp(
        "test",
        x=x,
        p=p,
        cost=-ca.sumsqr(first - second) + ca.dot(*normals) + ca.sumsqr(x[6:] - p[1]),
        g=ca.vertcat(on(first), on(second), near(third)),
        options={},
        points=points,
    )


@pytest.fixture
def over_field() -> Nlp:
    points = FieldPoints()
    return programme(
        lambda y: points.on_surface(y)[0],
        points.value,
        lambda y: points.on_surface(y)[1],
        points,
    )


@pytest.fixture
def over_formula() -> Nlp:
    def gradient(y: Any) -> Any:
        p = ca.SX.sym("p", 3)
        return ca.substitute(ca.gradient(level(p), p), p, y)

    return programme(level, level, gradient, None)


def functions(solve: Any) -> dict[str, Any]:
    return {name: solve.get_function(name) for name in ("nlp_jac_g", "nlp_hess_l", "nlp_grad_f")}


@pytest.mark.parametrize("seed", range(5))
def test_values_and_derivatives_are_those_of_the_formula(
    over_field: Nlp, over_formula: Nlp, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    x, p = rng.normal(size=8), np.array([1.5, 0.3])
    weights = rng.normal(size=4)
    field, formula = over_field.bind(Tabulated()), over_formula.bind(None)
    np.testing.assert_allclose(field.evaluate(x, p), formula.evaluate(x, p), atol=1e-12)
    a, b = functions(field._solve), functions(formula._solve)
    for name, arguments in (
        ("nlp_grad_f", (x, p)),
        ("nlp_jac_g", (x, p)),
        ("nlp_hess_l", (x, p, weights[0], weights[1:])),
    ):
        for m, t in zip(a[name].call(arguments), b[name].call(arguments), strict=True):
            np.testing.assert_allclose(np.array(ca.DM(m)), np.array(ca.DM(t)), atol=1e-10)


def test_ipopt_finds_the_same_solution(over_field: Nlp, over_formula: Nlp) -> None:
    start = {"x0": np.array([1.0, 0.2, 0.1, -1.0, 0.1, 0.0, 0.1, 0.2]), "p": [1.5, 0.3]}
    bounds = {"lbg": [0.0, 0.0, 0.1], "ubg": [0.0, 0.0, np.inf]}
    x, stats = over_field.bind(Tabulated())(**start, **bounds)
    y, reference = over_formula.bind(None)(**start, **bounds)
    assert stats["success"]
    assert reference["success"]
    assert stats["iter_count"] == reference["iter_count"]
    np.testing.assert_allclose(x, y, atol=1e-6)


def test_a_point_is_looked_up_once_for_all_that_is_asked_there(over_field: Nlp) -> None:
    field = Tabulated()
    solver = over_field.bind(field)
    solver(x0=np.full(8, 0.4), p=[1.5, 0.3], lbg=0.0, ubg=0.0)
    both = zip(field.asked[::2], field.asked[1::2], strict=True)  # second order, then third
    asked = [second.tobytes() + third.tobytes() for second, third in both]
    assert len(asked) > 10
    assert all(one != other for one, other in pairwise(asked))


def test_solvers_of_the_last_fields_are_kept_and_belong_to_their_field(over_field: Nlp) -> None:
    fields = [Tabulated() for _ in range(KEPT + 1)]
    first = over_field.bind(fields[0])
    assert over_field.bind(fields[0]) is first
    for field in fields[1:]:
        over_field.bind(field)
    assert over_field.bind(fields[0]) is not first
    over_field.bind(fields[2]).evaluate(np.ones(8), np.ones(2))
    assert [bool(f.asked) for f in fields] == [False, False, True, *[False] * (KEPT - 2)]


def test_a_programme_over_a_field_wants_one(over_field: Nlp) -> None:
    with pytest.raises(TypeError, match="distance field"):
        over_field.bind(None)
