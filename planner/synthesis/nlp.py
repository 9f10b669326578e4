"""Nonlinear programmes over a distance field: written once as expressions, bound to many fields.

A primitive's distance is an expression. A mesh has a sampled field
(``planner.shapes.field.distance_field``), a table, which no expression holds. So the programme is
written in terms of the field's Taylor coefficients at the points where it is needed: with the
coefficients a, b, H, T of phi at a point y that depends on the unknowns,

    phi(y)      = a + b . d + d'Hd/2       with d = y - y0 = 0,
    grad phi(y) = b + H d + T[d, d]/2,

the derivatives of these polynomials at d = 0 are those of phi, to the second order, exactly. All
derivatives are therefore taken symbolically, once; while IPOPT runs, the coefficients are looked up
at the present points. Programmes without such points are handed to CasADi as they are.
"""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Mapping
from typing import Any, Protocol

import casadi as ca
import numpy as np

from planner.spatial import FloatArray
from planner.system.threads import BUILDING

__all__ = ["Field", "FieldPoints", "Nlp", "Solver"]

SECOND, THIRD = 10, 20
"""Taylor coefficients of phi up to its second and third derivatives."""

INTERRUPTED = "NonIpopt_Exception_Thrown"
"""IPOPT's status when Ctrl-C ended it: CasADi swallows the exception."""

BASE_OPTIONS: dict[str, Any] = {
    "print_time": False,
    "error_on_fail": False,
    "ipopt.print_level": 0,
    "ipopt.sb": "yes",
    "ipopt.mumps_pivot_order": 0,
    "ipopt.mumps_permuting_scaling": 0,
    "ipopt.mumps_scaling": 0,
}
"""MUMPS with plain approximate-minimum-degree ordering and no scaling: for systems this small its
analysis costs more than the factorisation; measured 3.0-4.1 against 4.8-6.8 ms per iteration."""

KEPT = 4
"""Fields whose solvers are kept; making one takes tens of milliseconds."""


class Field(Protocol):
    """What a programme asks of a distance field."""

    def taylor(self, points: FloatArray, order: int) -> FloatArray:
        """Value and partial derivatives (n, 10) or (n, 20) at points (n, 3), m."""
        ...


class FieldPoints:
    """The points of a programme at which it needs a field, and the symbols of its coefficients."""

    def __init__(self) -> None:
        """Begin with none."""
        self._points: dict[int, list[Any]] = {SECOND: [], THIRD: []}
        self._symbols: dict[int, list[Any]] = {SECOND: [], THIRD: []}
        self._known: dict[tuple[Any, ...], tuple[Any, Any]] = {}

    def __len__(self) -> int:
        """Number of points."""
        return sum(len(v) for v in self._points.values())

    def value(self, point: Any) -> Any:
        """Phi (scalar expression), m, at a point (3,); twice differentiable."""
        b, d, quadratic = self._expand(point, SECOND)[:3]
        return b[0] + ca.dot(b[1:4], d) + ca.dot(d, quadratic @ d) / 2

    def on_surface(self, point: Any) -> tuple[Any, Any]:
        """Value and gradient (3,) of phi at a point (3,) made of symbols; twice differentiable."""
        key = tuple(point[k].element_hash() for k in range(3))
        if key not in self._known:
            b, d, h, third = self._expand(point, THIRD)
            value = b[0] + ca.dot(b[1:4], d) + ca.dot(d, h @ d) / 2
            gradient = b[1:4] + h @ d + ca.vertcat(*[ca.dot(d, t @ d) / 2 for t in third])
            self._known[key] = value, gradient
        return self._known[key]

    def _expand(self, point: Any, count: int) -> tuple[Any, Any, Any, list[Any]]:
        """Symbols of the coefficients, d, the matrix H, and the slices of T where asked for."""
        number = len(self._points[count])
        symbol = ca.SX.sym(f"field{count}_{number}", 3 + count)
        self._points[count].append(point)
        self._symbols[count].append(symbol)
        b = symbol[3:]
        h = _symmetric(b[4:10])
        third = []
        if count == THIRD:
            xxx, xxy, xxz, xyy, xyz, xzz, yyy, yyz, yzz, zzz = (b[k] for k in range(10, 20))
            third = [
                _symmetric(ca.vertcat(xxx, xxy, xxz, xyy, xyz, xzz)),
                _symmetric(ca.vertcat(xxy, xyy, xyz, yyy, yyz, yzz)),
                _symmetric(ca.vertcat(xxz, xyz, xzz, yyz, yzz, zzz)),
            ]
        return b, point - symbol[:3], h, third

    @property
    def points(self) -> Any:
        """All points (3, n) as an expression: first those of order two, then of order three."""
        return ca.horzcat(*self._points[SECOND], *self._points[THIRD])

    @property
    def symbols(self) -> Any:
        """All symbols, one column, in the order of ``points``."""
        return ca.vertcat(*self._symbols[SECOND], *self._symbols[THIRD])

    @property
    def counts(self) -> tuple[int, int]:
        """Number of points of order two and of order three."""
        return len(self._points[SECOND]), len(self._points[THIRD])


def _symmetric(v: Any) -> Any:
    """Symmetric (3, 3) of xx, xy, xz, yy, yz, zz."""
    return ca.vertcat(
        ca.horzcat(v[0], v[1], v[2]), ca.horzcat(v[1], v[3], v[4]), ca.horzcat(v[2], v[4], v[5])
    )


class _Lookup(ca.Callback):
    """Points (3, n) -> base points and Taylor coefficients, one column, from a field."""

    def __init__(self, field: Field, counts: tuple[int, int]) -> None:
        ca.Callback.__init__(self)
        self._field, self._counts = field, counts
        self._size = counts[0] * (3 + SECOND) + counts[1] * (3 + THIRD)
        self._last, self._values = np.full((sum(counts), 3), np.nan), np.zeros(self._size)
        self.construct("lookup", {})

    def get_n_in(self) -> int:
        return 1

    def get_n_out(self) -> int:
        return 1

    def get_sparsity_in(self, _: int) -> Any:
        return ca.Sparsity.dense(3, sum(self._counts))

    def get_sparsity_out(self, _: int) -> Any:
        return ca.Sparsity.dense(self._size, 1)

    def has_eval_buffer(self) -> bool:
        return True

    def eval_buffer(self, arguments: Any, results: Any) -> int:
        points = np.frombuffer(arguments[0], dtype=np.float64).reshape(-1, 3)
        # IPOPT asks for f, g and their derivatives at the same point, one after the other
        if not np.array_equal(points, self._last):
            self._last = points.copy()
            second = self._counts[0]
            parts = [(points[:second], 2), (points[second:], 3)]
            self._values = np.concatenate(
                [np.hstack([p, self._field.taylor(p, k)]).ravel() for p, k in parts if len(p)]
            )
        np.frombuffer(results[0], dtype=np.float64)[:] = self._values
        return 0


class Solver:
    """A programme bound to a field, ready for IPOPT."""

    def __init__(self, solve: Any, evaluate: Any, lookup: _Lookup | None) -> None:
        """Keep the functions; the lookup too, since CasADi does not."""
        self._solve, self._evaluate, self._lookup = solve, evaluate, lookup

    def __call__(self, **arguments: Any) -> tuple[FloatArray, dict[str, Any]]:
        """Run IPOPT; arguments as for ``casadi.nlpsol``. Returns x and its statistics.

        Raises:
            KeyboardInterrupt: Ctrl-C was pressed meanwhile.
        """
        result = self._solve(**arguments)
        stats = self._solve.stats()
        if stats["return_status"] == INTERRUPTED:
            raise KeyboardInterrupt
        return np.array(result["x"]).ravel(), stats

    def evaluate(self, x: FloatArray, parameters: FloatArray) -> FloatArray:
        """The programme's constraints (m,) at x."""
        return np.array(self._evaluate(x, parameters)).ravel()


class Nlp:
    """min cost(x, p) s.t. bounds on g(x, p), as CasADi SX expressions.

    Attributes:
        x, p: Unknowns and parameters, columns.
        cost: Scalar.
        g: Constraints, a column.
    """

    def __init__(
        self,
        name: str,
        *,
        x: Any,
        p: Any,
        cost: Any,
        g: Any,
        options: Mapping[str, Any],
        points: FieldPoints | None = None,
    ) -> None:
        """Take the derivatives, where a field is needed; else CasADi does.

        Args:
            name: For CasADi.
            x: Unknowns.
            p: Parameters.
            cost: Objective.
            g: Constraints.
            options: CasADi's and IPOPT's, on top of ``BASE_OPTIONS``.
            points: Where the expressions need a field.
        """
        self.name, self.x, self.p, self.cost, self.g = name, x, p, cost, g
        self._options = {**BASE_OPTIONS, **options}
        self._points = points if points is not None and len(points) else None
        self._own = threading.local()
        if self._points is not None:
            self._functions = self._differentiate(self._points)

    def bind(self, field: Field | None) -> Solver:
        """The solver for a field; None for a programme that needs none.

        Of solvers, which remember their last run, every thread keeps its last few.
        """
        if self._points is not None and field is None:
            raise TypeError(f"the programme {self.name!r} needs a distance field")
        key = id(field) if self._points is not None else 0
        kept: OrderedDict[int, tuple[Field | None, Solver]]
        kept = self._own.__dict__.setdefault("kept", OrderedDict())
        if key not in kept:
            with BUILDING:
                solver = self._plain() if self._points is None else self._with_lookup(field)
            kept[key] = field, solver  # the field is kept: its id stays its own
            while len(kept) > KEPT:
                kept.popitem(last=False)
        kept.move_to_end(key)
        return kept[key][1]

    def _plain(self) -> Solver:
        problem = {"x": self.x, "p": self.p, "f": self.cost, "g": self.g}
        solve = ca.nlpsol(self.name, "ipopt", problem, self._options)
        return Solver(solve, ca.Function("evaluate", [self.x, self.p], [self.g]), None)

    def _differentiate(self, points: FieldPoints) -> dict[str, Any]:
        x, p, tau = self.x, self.p, points.symbols
        weight, multipliers = ca.SX.sym("lam_f"), ca.SX.sym("lam_g", self.g.numel())
        lagrangian = weight * self.cost + ca.dot(multipliers, self.g)
        expressions = {
            "points": ([x, p], [points.points]),
            "nlp": ([x, p, tau], [self.cost, self.g]),
            "grad_f": ([x, p, tau], [self.cost, ca.gradient(self.cost, x)]),
            "jac_g": ([x, p, tau], [self.g, ca.jacobian(self.g, x)]),
            "hess_lag": (
                [x, p, weight, multipliers, tau],
                [ca.triu(ca.hessian(lagrangian, x)[0])],
            ),
        }
        return {key: ca.Function(key, *parts) for key, parts in expressions.items()}

    def _with_lookup(self, field: Any) -> Solver:
        assert self._points is not None
        lookup = _Lookup(field, self._points.counts)
        call = self._functions
        x, p = ca.MX.sym("x", self.x.numel()), ca.MX.sym("p", self.p.numel())
        weight, multipliers = ca.MX.sym("lam_f"), ca.MX.sym("lam_g", self.g.numel())
        tau = lookup(call["points"](x, p))
        f, g = call["nlp"](x, p, tau)
        xp = ["x", "p"]
        options = {
            **self._options,
            # the lookup has no derivative of its own: nothing may be differentiated further
            "calc_lam_p": False,
            "no_nlp_grad": True,
            "grad_f": ca.Function(
                "nlp_grad_f", [x, p], call["grad_f"](x, p, tau), xp, ["f", "grad_f_x"]
            ),
            "jac_g": ca.Function(
                "nlp_jac_g", [x, p], call["jac_g"](x, p, tau), xp, ["g", "jac_g_x"]
            ),
            "hess_lag": ca.Function(
                "nlp_hess_l",
                [x, p, weight, multipliers],
                [call["hess_lag"](x, p, weight, multipliers, tau)],
                [*xp, "lam_f", "lam_g"],
                ["triu_hess_gamma_x_x"],
            ),
        }
        solve = ca.nlpsol(self.name, "ipopt", {"x": x, "p": p, "f": f, "g": g}, options)
        return Solver(solve, ca.Function("evaluate", [x, p], [g]), lookup)
