"""The grasp problem as expressions: unknowns, parameters, and the rows of all terms."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from planner.hands.fingers import Finger
from planner.hands.hand import Hand
from planner.shapes.surface import Surface
from planner.spatial import FloatArray
from planner.synthesis.objectives.registry import objective_rows
from planner.synthesis.options import OPTION_NAMES
from planner.synthesis.symbols import GraspSymbols
from planner.synthesis.terms.clearance import SurfaceRows, surface_rows
from planner.synthesis.terms.registry import STANDARD, TERMS
from planner.synthesis.terms.resistance import RESISTANCE_WEIGHT
from planner.synthesis.terms.term import Role, Rows, Term, WrittenTerm
from planner.synthesis.unknowns import Unknowns


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
        objectives: Those of ``planner.synthesis.objectives.registry`` that have rows of their own.
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
