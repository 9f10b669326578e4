"""The terms of a grasp: ``Formulation``, and weighted ``Residuals`` with their Jacobian.

A formulation holds the unknowns and parameters in symbols, and the rows of all terms.

CasADi differentiates the written terms once; each call writes into the same arrays, without
conversion of matrices. Further rows come in numbers from sources
(``planner.synthesis.terms.term``): clearances, true distances of links, resistance. Every row
has a name: ``row_names`` gives those of the last call.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from copy import copy
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from planner.hands.fingers import Finger
from planner.hands.hand import Hand
from planner.numerics.least_squares import SLOW, LMResult, levenberg_marquardt
from planner.numerics.tape import into_buffers
from planner.shapes.base import Surface
from planner.spatial import FloatArray
from planner.synthesis.mesh_surface import COEFFICIENTS, Field
from planner.synthesis.objectives import objective_rows
from planner.synthesis.options import OPTION_NAMES
from planner.synthesis.symbols import GraspSymbols, Unknowns
from planner.synthesis.terms.clearance import Clearances, SurfaceRows, surface_rows
from planner.synthesis.terms.fingers import FingerCapsules
from planner.synthesis.terms.link_distance import LinkDistances, TrueLinks
from planner.synthesis.terms.registry import STANDARD, TERMS
from planner.synthesis.terms.resistance import RESISTANCE_WEIGHT, Resistance
from planner.synthesis.terms.term import (
    ActiveRows,
    Role,
    Row,
    Rows,
    RowSource,
    Term,
    WrittenTerm,
    names_of,
)
from planner.system.threads import BUILDING, built, stage


@dataclass(frozen=True, kw_only=True, eq=False)
class Formulation:
    """Unknowns, parameters and written terms of one hand, finger set and kind of shape.

    Attributes:
        symbols: The grasp in symbols.
        parameters: Symbols of the parameters, by name in the order of ``p``.
        written: Terms that are written as expressions: equalities, inequalities, costs.
        clearances: Terms that are clearances of spheres.
        surfaces: Their rows, surface by surface.
    """

    symbols: GraspSymbols
    parameters: dict[str, Any]
    written: tuple[WrittenTerm, ...]
    clearances: tuple[Term, ...]
    surfaces: tuple[SurfaceRows, ...]

    @property
    def unknowns(self) -> Unknowns:
        """Layout of ``x``."""
        return self.symbols.unknowns

    @property
    def x(self) -> Any:
        """Unknowns, a column."""
        return self.symbols.x

    @cached_property
    def p(self) -> Any:
        """Parameters, a column."""
        return ca.vertcat(*self.parameters.values())

    @cached_property
    def places(self) -> dict[str, slice]:
        """Where each parameter stands in ``p``, by name."""
        ends = np.cumsum([0, *(v.numel() for v in self.parameters.values())])
        pairs = zip(self.parameters, ends[:-1], ends[1:], strict=True)
        return {name: slice(int(a), int(b)) for name, a, b in pairs}

    def pack(self, values: dict[str, Any]) -> FloatArray:
        """The column of parameters: numbers for every name in ``places``."""
        out = np.zeros(self.p.numel())
        for name, place in self.places.items():
            out[place] = np.asarray(values[name], dtype=np.float64).ravel()
        return out

    def unpack(self, p: FloatArray) -> dict[str, FloatArray]:
        """Views of a column of parameters, by name."""
        return {name: p[place] for name, place in self.places.items()}


def formulate(
    hand: Hand,
    fingers: tuple[Finger, ...],
    surface: Surface,
    n_obstacles: int,
    objectives: tuple[str, ...] = (),
    terms: tuple[str, ...] = (),
) -> Formulation:
    """Write the terms for a hand, the fingers that take part and the form of a shape.

    Args:
        hand: The hand.
        fingers: Fingers that take part, in order of the contacts.
        surface: Form of the shape.
        n_obstacles: Number of obstacle boxes.
        objectives: Those of ``planner.synthesis.objectives`` that have rows of their own.
        terms: Registered terms beside the standard ones, by name.
    """
    symbols = GraspSymbols(hand, fingers, surface, n_obstacles, OPTION_NAMES)
    asked = [TERMS[name] for name in (*STANDARD, *terms)]
    pairs: list[tuple[Term, Iterable[Rows]]] = [
        (term, term.write(symbols)) for term in asked if term.write is not None
    ]
    rows, parameters = objective_rows(objectives, symbols)
    pairs += [(_objective_term(name), [Rows(expression=e)]) for name, e in rows.items()]
    written = [WrittenTerm.of(term, rows) for term, rows in pairs]
    order = list(Role)
    clearances = tuple(term for term in asked if term.clearance is not None)
    surfaces = surface_rows(symbols, clearances)  # before the parameters: it may add some
    return Formulation(
        symbols=symbols,
        clearances=clearances,
        surfaces=surfaces,
        parameters={**symbols.parameters, "objectives": parameters},
        written=tuple(
            sorted((w for w in written if w.rows), key=lambda w: order.index(w.term.role))
        ),
    )


def _objective_term(name: str) -> Term:
    """An objective as a term; its rows vanish outside the rounds that work on it."""
    return Term(
        name=name,
        meaning=f"objective {name}, short of its target",
        role=Role.COST_BELOW_ZERO,
        unit="-",
        weight=RESISTANCE_WEIGHT,
        judged=f"{name} of the plan",
    )


class Residuals:
    """Active weighted residuals r(x), (m,), and their Jacobian (m, n).

    Terms that must hold come first, then costs, in this order: clearances, equalities,
    inequalities; costs, objectives, resistance. One run of least squares at a time works with them;
    another takes a ``clone``.

    Attributes:
        formulation: The written terms.
        required: The terms that must hold, by name.
        inputs: Symbols of unknowns, parameters and Taylor rows of a mesh.
        residual: Written rows (m,) as an expression, with weight and margin.
        jacobian: Theirs by the unknowns (m, n).
        rows: Their names.
        both: Whether each counts on both sides of zero (m,).
        n_required: So many of them must hold, the first.
        clearances, fingers, resistance: Rows that come in numbers.
        n_terms: After a call: how many of the first rows belong to terms that must hold.
    """

    def __init__(self, formulation: Formulation) -> None:
        """Differentiate.

        Args:
            formulation: The written terms.
        """
        self.formulation, symbols = formulation, formulation.symbols
        self.clearances = Clearances(symbols, formulation.clearances, formulation.surfaces)
        self.fingers = FingerCapsules(symbols)
        self._true_links = TrueLinks(symbols.hand)
        self.resistance = Resistance(symbols)
        points = symbols.surface.field
        self._points = points if points is not None and len(points) else None
        tau = ca.SX(0, 1) if self._points is None else self._points.symbols
        written = formulation.written
        rows = [w.term.weight * (w.expression - w.term.margin) for w in written]
        self.residual = residual = ca.densify(ca.vertcat(*rows))
        self.jacobian = jacobian = ca.jacobian(residual, symbols.x)
        self.rows = tuple(row for w in written for row in w.rows)
        self.n_required = self.n_terms = sum(not row.term.role.is_cost for row in self.rows)
        self.both: NDArray[np.bool_] = np.array([not r.term.role.one_sided for r in self.rows])
        row, column = (np.array(v) for v in jacobian.sparsity().get_triplet())
        written_terms = (r.term for r in self.rows[: self.n_required])
        required = (*written_terms, *self.in_numbers)
        self.required = {term.name: term for term in required}
        self._at, self._width = row * symbols.x.numel() + column, symbols.x.numel()
        outputs = {
            (k, name): ca.densify(value)
            for k, source in enumerate(self._sources)
            for name, value in source.outputs.items()
        }
        self._outputs = tuple(outputs)
        self.inputs = [symbols.x, formulation.p, tau]
        self._shared = _Shared(self.inputs, [residual, jacobian, *outputs.values()])
        self._call: Callable[[], None] | None = None
        self._p = np.zeros(formulation.p.numel())
        self._field: Field | None = None
        self._active: tuple[list[ActiveRows], NDArray[np.bool_], list[ActiveRows]]

    @property
    def _sources(self) -> tuple[RowSource, ...]:
        return *self._first_sources, self.resistance

    @property
    def _first_sources(self) -> tuple[Clearances, FingerCapsules, TrueLinks]:
        """Sources of terms that must hold."""
        return self.clearances, self.fingers, self._true_links

    @property
    def in_numbers(self) -> tuple[Term, ...]:
        """Terms that must hold and whose rows come in numbers, in the order of their rows."""
        return tuple(term for source in self._first_sources for term in source.rows)

    def _make_room(self) -> Callable[[], None]:
        """Arrays for arguments and results, and the call that reads and writes them."""
        f = self._shared.function
        self._x, self._tau = np.zeros(f.numel_in(0)), np.zeros(f.numel_in(2))
        self._values, self._entries = np.zeros(f.numel_out(0)), np.zeros(f.nnz_out(1))
        self._jacobian = np.zeros((len(self._values), self._width))
        # matrices are transposed: CasADi stores columns
        rest = [np.zeros(f.size_out(i)[::-1]) for i in range(2, f.n_out())]
        found = dict(zip(self._outputs, rest, strict=True))
        for k, source in enumerate(self._sources):
            source.receive({name: found[k, name] for name in source.outputs})
        arguments = [self._x, self._p, self._tau]
        return into_buffers(f, arguments, [self._values, self._entries, *rest])

    def clone(self) -> Residuals:
        """The same expressions with parameters and results of their own."""
        other = copy(self)
        other.clearances, other.fingers = self.clearances.clone(), self.fingers.clone()
        other._true_links = self._true_links.clone()
        other.resistance = self.resistance.clone()
        other._p, other._call = np.zeros_like(self._p), None
        return other

    def set_parameters(self, p: FloatArray, field: Field | None) -> None:
        """Parameters, and the distance field of a mesh, for the calls that follow.

        Directions of resistance and true distances of links start empty.
        """
        if self._points is not None and field is None:
            raise TypeError("these residuals need a distance field")
        self._p[:] = p
        self._field = field
        values = self.formulation.unpack(self._p)
        for source in self._sources:
            source.set_parameters(values, field)

    def set_directions(self, directions: FloatArray, target: float = 0.0) -> None:
        """Directions (k, 6) of wrench to work on from now on; resistance to reach in each (-)."""
        self.resistance.set_directions(directions, target)

    def set_objectives(self, values: FloatArray) -> None:
        """Parameters of the objectives' rows from now on; none switches them off."""
        self._p[self.formulation.places["objectives"]] = values if values.size else 0.0

    def keep_apart(self, distances: LinkDistances | None) -> None:
        """Constrain these distances of the true links from now on; None for none."""
        self._true_links.keep(distances)

    def __call__(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """The active residuals at x and their Jacobian: overwritten by the next call."""
        with stage("residuals"):
            return self._evaluate(x)

    def minimise(
        self,
        x: FloatArray,
        *,
        lower: FloatArray,
        upper: FloatArray,
        scale: FloatArray,
        max_iterations: int,
        damping: float | None = None,
        slow: float = SLOW,
    ) -> LMResult:
        """A run of ``levenberg_marquardt``."""
        return levenberg_marquardt(
            self,
            x,
            lower=lower,
            upper=upper,
            scale=scale,
            max_iterations=max_iterations,
            damping=damping,
            slow=slow,
        )

    def _evaluate(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        if self._call is None:
            self._call = self._make_room()
        self._x[:] = x
        if self._field is not None:
            points = self.formulation.unknowns.points(x)
            taylor = self._tau.reshape(len(points), 3 + COEFFICIENTS)
            taylor[:, :3] = points
            taylor[:, 3:] = self._field.taylor(points, 2)
        self._call()
        self._jacobian.ravel()[self._at] = self._entries
        counts = self.both | (self._values < 0.0)
        before = [rows for source in self._first_sources for rows in source(x)]
        after = self.resistance(x)
        self._active = before, counts, after
        self.n_terms = sum(len(a.values) for a in before)
        self.n_terms += int(np.count_nonzero(counts[: self.n_required]))
        return (
            np.concatenate(
                [
                    *[a.term.weight * a.values for a in before],
                    self._values[counts],
                    *[a.term.weight * a.values for a in after],
                ]
            ),
            np.vstack(
                [
                    *[a.term.weight * a.jacobian for a in before],
                    self._jacobian[counts],
                    *[a.term.weight * a.jacobian for a in after],
                ]
            ),
        )

    def row_names(self) -> list[Row]:
        """The names of the rows of the last call, in their order."""
        before, counts, after = self._active
        rows = {term: rows for source in self._sources for term, rows in source.rows.items()}
        names = [row for active in before for row in names_of(active, rows)]
        names += [self.rows[k] for k in np.flatnonzero(counts).tolist()]
        return names + [row for active in after for row in names_of(active, rows)]

    @property
    def written(self) -> tuple[WrittenTerm, ...]:
        """All terms in the order of their rows, with the names of the rows that they have now.

        Resistance, true distances of links and clearances from a mesh have no expression.
        """
        with BUILDING:
            expressions = {**self.clearances.expressions, **self.fingers.expressions}
        before, after = (
            [
                WrittenTerm(term=term, rows=rows, expression=expressions.get(term))
                for source in sources
                for term, rows in source.rows.items()
            ]
            for sources in (self._first_sources, (self.resistance,))
        )
        return (*before, *self.formulation.written, *after)

    def violations(self) -> dict[str, float]:
        """Largest violation of each term that must hold at the last x, in its unit."""
        out = self.written_violations(self._values)
        for active in self._active[0]:
            name = active.term.name
            out[name] = max(out[name], -float(active.values.min()))
        return out

    def written_violations(self, values: FloatArray) -> dict[str, float]:
        """Largest violation of each term that must hold; of written terms from their values (m,).

        Of others it is zero.
        """
        out = dict.fromkeys(self.required, 0.0)
        for value, row in zip(values[: self.n_required].tolist(), self.rows, strict=False):
            term = row.term
            short = -(value / term.weight + term.margin)
            out[term.name] = max(out[term.name], short if term.role.one_sided else abs(short))
        return out


class _Shared:
    """The function that all clones call; made at the first call, since compiled loops need none."""

    def __init__(self, inputs: list[Any], results: list[Any]) -> None:
        self._inputs, self._results = inputs, results

    @built
    def function(self) -> Any:
        """Residuals, their Jacobian and what the row sources need."""
        return ca.Function("residuals", self._inputs, self._results)
