"""Expressions over a distance field: the same as over the formula that the field tabulates."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import pytest

from planner.spatial import FloatArray
from planner.synthesis.mesh_surface import FieldPoints

RADII = np.array([1.0, 0.7, 0.5])

ORDER = [(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)]


def level(p: Any) -> Any:
    """A smooth function whose derivatives of every order matter."""
    return ca.sqrt(ca.sumsqr(p / RADII)) - 1 + 0.1 * ca.sin(p[0] + 2 * p[1] - p[2])


class Tabulated:
    """The field of ``level``; its derivatives by CasADi."""

    def __init__(self) -> None:
        """Differentiate."""
        p = ca.SX.sym("p", 3)
        gradient = ca.gradient(level(p), p)
        second = ca.jacobian(gradient, p)
        rows = [level(p), *[gradient[i] for i in range(3)], *[second[i, j] for i, j in ORDER]]
        self.function = ca.Function("second", [p], [ca.vertcat(*rows)])

    def taylor(self, points: FloatArray, order: int) -> FloatArray:
        assert order == 2
        return np.array([np.array(self.function(p)).ravel() for p in points])


def rows_of(x: Any, at: Any) -> Any:
    """Two points on the surface and their normals; a third one that moves on a circle."""
    first, second = x[:3], x[3:6]
    third = ca.vertcat(1.5 * ca.cos(x[6]), 1.5 * ca.sin(x[6]), x[7])
    normals = [at(y)[1] / ca.norm_2(at(y)[1]) for y in (first, second)]
    values = [at(y)[0] for y in (first, second, third)]
    return ca.vertcat(*values, *normals, ca.dot(*normals))


@pytest.mark.parametrize("seed", range(5))
def test_values_and_derivatives_are_those_of_the_formula(seed: int) -> None:
    x, points = ca.SX.sym("x", 8), FieldPoints()

    def by_formula(y: Any) -> tuple[Any, Any]:
        p = ca.SX.sym("p", 3)
        return level(y), ca.substitute(ca.gradient(level(p), p), p, y)

    over_field, over_formula = rows_of(x, points.at), rows_of(x, by_formula)
    assert len(points) == 3, "a point is looked up once for all that is asked there"
    numbers = np.random.default_rng(seed).normal(size=8)
    where = np.array(ca.Function("points", [x], [points.points])(numbers)).T
    tau = points.coefficients(Tabulated(), where)
    field = ca.Function("f", [x, points.symbols], [over_field, ca.jacobian(over_field, x)])
    formula = ca.Function("g", [x], [over_formula, ca.jacobian(over_formula, x)])
    for mine, theirs in zip(field(numbers, tau), formula(numbers), strict=True):
        np.testing.assert_allclose(np.array(ca.DM(mine)), np.array(ca.DM(theirs)), atol=1e-10)
