"""The objective epsilon: resistance of a grasp in its weakest directions of wrench.

A round of least squares works on up to ``N_DIRECTIONS`` directions
(``planner.synthesis.resistance``); outside rounds there are none, and no rows.
"""

from __future__ import annotations

from copy import copy
from typing import Any

import casadi as ca
import numpy as np

from planner.spatial import FloatArray
from planner.synthesis.field_points import Field
from planner.synthesis.resistance import missing_resistance
from planner.synthesis.symbols import GraspSymbols
from planner.synthesis.terms.source import ActiveRows
from planner.synthesis.terms.term import Role, Row, Term

N_DIRECTIONS = 64
"""Most directions of wrench in one round: with few of them a round makes other directions weak."""

RESISTANCE_WEIGHT = 25.0
"""Weight of missing resistance: enough to move contacts by centimetres."""

RESISTANCE = Term(
    name="resistance",
    meaning="wrench resisted in each direction of a round, short of its target",
    role=Role.COST_BELOW_ZERO,
    unit="-",
    weight=RESISTANCE_WEIGHT,
    judged="epsilon of the plan",
)


class Resistance:
    """Rows of resistance in given directions of wrench: a ``RowSource``.

    Attributes:
        outputs: See ``RowSource``: normals at the contact points, and their Jacobians.
    """

    def __init__(self, symbols: GraspSymbols) -> None:
        """Write the expressions.

        Args:
            symbols: Unknowns and parameters.
        """
        pairs = zip(symbols.outward, symbols.points, strict=True)
        self.outputs: dict[str, Any] = {
            "normals": ca.horzcat(*symbols.outward),
            # each transposed: columns are stored
            "normal_jacobians": ca.horzcat(*[ca.jacobian(n, p).T for n, p in pairs]),
        }
        self._unknowns = symbols.unknowns
        self._directions, self._target = _NONE, 0.0

    @property
    def rows(self) -> dict[Term, tuple[Row, ...]]:
        """See ``RowSource``."""
        return {RESISTANCE: tuple(RESISTANCE.row((), k) for k in range(len(self._directions)))}

    def clone(self) -> Resistance:
        """See ``RowSource``."""
        return copy(self)

    def receive(self, results: dict[str, FloatArray]) -> None:
        """See ``RowSource``."""
        self._outward = results["normals"]
        self._normal_jacobians = results["normal_jacobians"].reshape(-1, 3, 3)

    def set_parameters(self, values: dict[str, FloatArray], field: Field | None) -> None:
        """See ``RowSource``."""
        self._mu, self._length = float(values["mu"][0]), float(values["length"][0])
        self._directions, self._target = _NONE, 0.0

    def set_directions(self, directions: FloatArray, target: float = 0.0) -> None:
        """Directions (k, 6) of wrench from now on, and the resistance to reach in each (-).

        Raises:
            ValueError: More than ``N_DIRECTIONS``.
        """
        self._directions, self._target = checked_directions(directions), target

    def __call__(self, x: FloatArray) -> list[ActiveRows]:
        """See ``RowSource``."""
        if not len(self._directions):
            return []
        values, slopes, short = missing_resistance(
            self._directions,
            self._unknowns.points(x),
            self._outward,
            self._normal_jacobians,
            mu=self._mu,
            length=self._length,
            target=self._target,
        )
        rows = np.zeros((len(values), len(x)))
        rows[:, self._unknowns.point_columns] = slopes
        return [ActiveRows(RESISTANCE, values, rows, short)]


def checked_directions(directions: FloatArray) -> FloatArray:
    """Those of the directions (k, 6) that are not zero.

    Raises:
        ValueError: More than ``N_DIRECTIONS``.
    """
    if len(directions) > N_DIRECTIONS:
        raise ValueError(f"there are {len(directions)} directions; give up to {N_DIRECTIONS}")
    kept: FloatArray = directions[directions.any(axis=1)]
    return kept


_NONE = np.zeros((0, 6))
