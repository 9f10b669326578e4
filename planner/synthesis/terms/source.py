"""``RowSource``: rows of terms that are computed in numbers, beside those written as expressions.

Of some hundreds of clearances few are violated at a time, and in each direction of wrench only one
contact has derivatives. As expressions all of them would be differentiated at every evaluation.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple, Protocol

from planner.spatial import FloatArray, IntArray
from planner.synthesis.field_points import Field
from planner.synthesis.terms.term import Row, Term


class ActiveRows(NamedTuple):
    """Active rows of one term.

    Attributes:
        term: The term.
        values: (k,), in the term's unit, without its weight.
        jacobian: (k, n), their derivatives by the unknowns.
        numbers: Which rows of the term they are (k,).
    """

    term: Term
    values: FloatArray
    jacobian: FloatArray
    numbers: IntArray


class RowSource(Protocol):
    """Computes rows of one or more terms.

    Attributes:
        outputs: Expressions of the unknowns and parameters whose values it needs, by name.
    """

    outputs: dict[str, Any]

    @property
    def rows(self) -> Mapping[Term, tuple[Row, ...]]:
        """The terms, and the names of all rows that each has at present."""
        ...

    def clone(self) -> RowSource:
        """The same with parameters and results of its own."""
        ...

    def receive(self, results: dict[str, FloatArray]) -> None:
        """Arrays that hold the transposed ``outputs`` after every evaluation, row by row."""
        ...

    def set_parameters(self, values: dict[str, FloatArray], field: Field | None) -> None:
        """Numbers for the calls that follow.

        Args:
            values: Parameters by name, see ``Formulation``.
            field: The distance field of a mesh.
        """
        ...

    def __call__(self, x: FloatArray) -> list[ActiveRows]:
        """The rows that count at x (n,), for which the outputs have been computed."""
        ...


def names_of(active: ActiveRows, rows: Mapping[Term, tuple[Row, ...]]) -> list[Row]:
    """The names of rows that count, of a source with these rows."""
    by_number = {row.number: row for row in rows[active.term]}
    return [by_number[k] for k in active.numbers.tolist()]
