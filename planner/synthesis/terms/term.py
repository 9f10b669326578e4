"""``Term``: one named residual of the grasp or motion problem.

A term has a meaning, a unit, a role (equality, inequality or cost), a weight per unit, rows, and a
verdict after the solver has finished. It is added by ``planner.synthesis.register_term``; nothing
else has to know of it.

Rows are expressions (``write``), or clearances of spheres of the hand from surfaces
(``clearance``). NumPy and compiled loops evaluate both from what is said here. Rows that are
neither come from a ``RowSource``: of some hundreds of clearances few are violated at a time, and in
each direction of wrench only one contact has derivatives; as expressions all of them would be
differentiated at every evaluation.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from copy import copy
from dataclasses import dataclass
from enum import Enum
from typing import Any, NamedTuple, Self

import casadi as ca

from planner.failure import Failure
from planner.hands.hand import Hand
from planner.spatial import FloatArray, IntArray
from planner.synthesis.link_spheres import LinkSphere
from planner.synthesis.mesh_surface import Field
from planner.synthesis.symbols import GraspPoint, GraspSymbols


class Role(Enum):
    """Role of a term in the problem; the value is how it is printed."""

    EQUALITY = "= 0"
    INEQUALITY = ">= 0"
    COST = "cost"
    COST_BELOW_ZERO = "cost < 0"

    @property
    def is_cost(self) -> bool:
        """Whether the term ranks grasps and need not hold."""
        return self in (Role.COST, Role.COST_BELOW_ZERO)

    @property
    def one_sided(self) -> bool:
        """Whether only negative values count."""
        return self in (Role.INEQUALITY, Role.COST_BELOW_ZERO)


@dataclass(frozen=True, kw_only=True)
class Rows:
    """Some rows of a term that concern the same fingers, joints or links.

    Attributes:
        expression: CasADi expression (m,), in the term's unit.
        about: Names of what the rows concern; empty for the whole grasp.
    """

    expression: Any
    about: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True)
class SphereClearance:
    """Spheres of the hand that keep away from surfaces: the rows of a term.

    One row per sphere and surface: the signed distance of the sphere's centre from the surface less
    what that must be at least. It counts while it is negative.

    Attributes:
        spheres: The spheres: ``link_spheres`` fill the links, ``hull_spheres`` span them.
        numbers: What each surface depends on at a grasp in symbols: a column (k,) of expressions of
            parameters for each surface; all of one length.
        distance: Signed distance (m) of a point (3,), object frame, from the surface with numbers
            (k,), as an expression of the two alone.
        least: What the distance of a sphere's centre must be at least, m: one or two expressions of
            parameters that are taken off it one after the other, usually the radius and a margin.
            None for a sphere that has no row.
        of_object: Whether the surface is that of the object. On a mesh its distance is looked up in
            the field of the mesh, in place of ``distance``.
    """

    spheres: Callable[[Hand], tuple[LinkSphere, ...]]
    numbers: Callable[[GraspSymbols], Sequence[Any]]
    distance: Callable[[GraspSymbols, Any, Any], Any]
    least: Callable[[GraspSymbols, LinkSphere], tuple[Any, ...] | None]
    of_object: bool = False


@dataclass(frozen=True, kw_only=True)
class Term:
    """One named residual.

    Attributes:
        name: One word, unique.
        meaning: Its definition in one line, for print.
        role: Whether it must vanish, must not be negative, or is a cost.
        unit: Unit of the residual, "-" for none; forces are over the mean normal force.
        weight: Weighted residual per unit; one millimetre weighs 1. Where no length is involved,
            some 0.05 of a normal force, of a cosine or of a radian weighs as much.
        margin: Added to the requirement for the solver, in the unit: least squares end slightly on
            the wrong side of an inequality.
        write: The rows at a grasp in symbols. None for terms whose rows come from a ``RowSource``.
        clearance: The rows as clearances of spheres, in place of ``write``; of an inequality.
        wording: One row in words; ``{}`` stands for what it concerns, ``elsewhere`` if nothing.
        elsewhere: See ``wording``.
        lacking: What it says of hand and object if no attempt satisfies it, and what to change: a
            clause after "that is:". Shown in docs/how/problem.md.
        judged: How the verdict on the true geometry judges it, for print.
        judge: A verdict of its own on a grasp, or on a knot of a motion, that all others have
            passed: None, or why it fails. The task of a knot is that of the motion's start.
    """

    name: str
    meaning: str
    role: Role
    unit: str
    weight: float
    margin: float = 0.0
    write: Callable[[GraspSymbols], Iterable[Rows]] | None = None
    clearance: SphereClearance | None = None
    wording: str = ""
    elsewhere: str = "the grasp"
    lacking: str = ""
    judged: str = "not judged"
    judge: Callable[[GraspPoint], Failure | None] | None = None

    def row(self, about: tuple[str, ...] = (), number: int = 0, knot: int = 0) -> Row:
        """The name of one row.

        Args:
            about: What the row concerns.
            number: Its number among the rows of the term.
            knot: In a motion, the number of its knot.
        """
        return Row(term=self, about=about, number=number, knot=knot)

    def words(self, about: tuple[str, ...]) -> str:
        """One row in words."""
        if not self.wording:
            return f"{self.name} of {' and '.join(about)}" if about else self.name
        return self.wording.format(" and ".join(about) or self.elsewhere)


@dataclass(frozen=True, kw_only=True)
class Row:
    """The name of one scalar row of the residuals.

    Attributes:
        term: The term.
        about: Names of what it concerns: fingers, actuators; empty for the whole grasp.
        number: Its number among the rows of the term.
        knot: In a motion, the number of its knot.
    """

    term: Term
    about: tuple[str, ...] = ()
    number: int = 0
    knot: int = 0

    def __str__(self) -> str:
        """The row in words."""
        return self.term.words(self.about)


@dataclass(frozen=True, kw_only=True, eq=False)
class WrittenTerm:
    """A term with its rows in one problem.

    Attributes:
        term: The term.
        rows: The names of its rows.
        expression: Its rows (m,) as CasADi expression, in the term's unit and without weight and
            margin; None where they exist in numbers alone.
    """

    term: Term
    rows: tuple[Row, ...]
    expression: Any = None

    @classmethod
    def of(cls, term: Term, rows: Iterable[Rows]) -> WrittenTerm:
        """Stack the rows of a term."""
        rows = tuple(rows)
        about = [r.about for r in rows for _ in range(r.expression.numel())]
        return cls(
            term=term,
            rows=tuple(term.row(a, k) for k, a in enumerate(about)),
            expression=ca.vertcat(*[r.expression for r in rows]),
        )

    def __str__(self) -> str:
        """One line of the table that a problem prints."""
        t = self.term
        margin = f"{t.margin:g}" if t.margin else ""
        return (
            f"{t.name:14s} {len(self.rows):5d}  {t.role.value:8s} {t.unit:4s} {t.weight:9.4g} "
            f"{margin:>6s}  {t.meaning}; {t.judged}"
        )


HEADER = (
    f"{'term':14s} {'rows':>5s}  {'role':8s} {'unit':4s} {'weight':>9s} {'margin':>6s}  "
    "meaning; how it is judged"
)
"""Head of the table of terms."""


def first_failure(terms: Iterable[Term], point: GraspPoint) -> Failure | None:
    """Why the first term with a verdict of its own refuses a grasp; None if all accept it."""
    verdicts = (term.judge(point) for term in terms if term.judge is not None)
    return next((failure for failure in verdicts if failure is not None), None)


def table_of(terms: Iterable[WrittenTerm]) -> str:
    """Terms as a table, one line each."""
    return "\n".join(f"  {line}" for line in (HEADER, *terms))


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


class RowSource(ABC):
    """Computes rows of one or more terms.

    Attributes:
        outputs: Expressions of the unknowns and parameters whose values it needs, by name.
    """

    outputs: dict[str, Any]

    @property
    @abstractmethod
    def rows(self) -> Mapping[Term, tuple[Row, ...]]:
        """The terms, and the names of all rows that each has at present."""

    def clone(self) -> Self:
        """The same with parameters and results of its own."""
        return copy(self)

    def receive(self, results: dict[str, FloatArray]) -> None:
        """Arrays that hold the transposed ``outputs`` after every evaluation, row by row."""
        self._found = results

    @abstractmethod
    def set_parameters(self, values: dict[str, FloatArray], field: Field | None) -> None:
        """Numbers for the calls that follow.

        Args:
            values: Parameters by name, see ``Formulation``.
            field: The distance field of a mesh.
        """

    @abstractmethod
    def __call__(self, x: FloatArray) -> list[ActiveRows]:
        """The rows that count at x (n,), for which the outputs have been computed."""


def names_of(active: ActiveRows, rows: Mapping[Term, tuple[Row, ...]]) -> list[Row]:
    """The names of rows that count, of a source with these rows."""
    by_number = {row.number: row for row in rows[active.term]}
    return [by_number[k] for k in active.numbers.tolist()]
