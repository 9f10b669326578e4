"""``LoopResiduals``: a run of least squares in compiled loops, with the numbers of ``Residuals``.

Where kernels are compiled, ``GraspProblem.least_squares`` gives these in place of ``Residuals``.
Both read the same terms; here CasADi's functions are tapes (``planner.numerics.tape``), and
clearances come from the placements of the joints.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import casadi as ca
import numpy as np

from planner.numerics.kernels import compile_loops
from planner.numerics.least_squares import PATIENCE, SLOW, STALLED, LMResult
from planner.numerics.tape import Tape, tape_of
from planner.shapes.distance_field import DistanceField
from planner.spatial import FloatArray
from planner.synthesis.loops.clearance import NO_FIELD, CompiledClearances, spline_tables
from planner.synthesis.loops.least_squares import (
    STATUS,
    Kept,
    ProblemTables,
    RunTables,
    Scratch,
    Written,
    minimise,
)
from planner.synthesis.mesh_surface import Field
from planner.synthesis.residuals import Residuals
from planner.synthesis.terms.fingers import capsule_run, capsule_tables
from planner.synthesis.terms.hand_points import Rows, hand_at, joint_outputs, joints_of
from planner.synthesis.terms.link_distance import LINKS, LinkDistances, link_run
from planner.synthesis.terms.resistance import (
    N_DIRECTIONS,
    ContactTables,
    ResistanceRun,
    checked_directions,
)
from planner.synthesis.terms.term import Term

LINK_ROWS = 64
"""True distances for which there is room at first."""


@dataclass(frozen=True, kw_only=True, eq=False)
class LoopProblem:
    """What all runs of a problem share.

    Attributes:
        residuals: The rows and their names.
        places: Of terms that must hold and whose rows are numbers, see ``Rows``.
        tables: For the loops.
        tape: Written terms and kinematics; of unknowns, parameters and Taylor rows.
        clearances: The clearances.
    """

    residuals: Residuals
    places: Mapping[Term, int]
    tables: ProblemTables
    tape: Tape
    clearances: CompiledClearances


def loop_problem(residuals: Residuals) -> LoopProblem | None:
    """Tapes and tables of a problem; None where a term has instructions that loops do not know."""
    g, jacobian, contacts = (
        residuals.formulation.symbols,
        residuals.jacobian,
        residuals.resistance.outputs,
    )
    results = [*joint_outputs(g), contacts["normals"], contacts["normal_jacobians"]]
    dense = [residuals.residual, jacobian, *(ca.densify(r) for r in results)]
    tape = tape_of(ca.Function("residuals", residuals.inputs, dense))
    places = {term: place for place, term in enumerate(residuals.in_numbers)}
    clearances = CompiledClearances.of(residuals.clearances, places)
    if tape is None or clearances is None:
        return None
    values, entries, twists, rotation, frames, normals, slopes = tape.results
    row, column = (np.array(v, dtype=np.int64) for v in jacobian.sparsity().get_triplet())
    by_rows, n = np.lexsort((column, row)), len(g.fingers)
    (fingers,) = residuals.fingers.rows
    tables = ProblemTables(
        program=tape.program,
        written=Written(
            values_at=values,
            entries_at=entries[by_rows],
            entry_columns=column[by_rows],
            entry_ends=np.cumsum(np.bincount(row, minlength=len(values))),
            both=residuals.both,
            n_required=residuals.n_required,
        ),
        joints=joints_of(g.hand, twists, rotation, frames),
        contacts=ContactTables(
            normals_at=normals.reshape(n, 3),
            slopes_at=slopes.reshape(n, 9),
            first=residuals.formulation.unknowns.point_columns.start,
            taylor=tape.arguments[2] if g.surface.field is not None else -1,
        ),
        clearances=clearances.tables,
        capsules=capsule_tables(residuals.fingers, places[fingers]),
    )
    return LoopProblem(
        residuals=residuals, places=places, tables=tables, tape=tape, clearances=clearances
    )


class LoopResiduals:
    """The residuals of one run of least squares, see ``Residuals`` for what they are."""

    def __init__(self, problem: LoopProblem, p: FloatArray, field: Field | None) -> None:
        """Set the parameters.

        Args:
            problem: What all runs share.
            p: Parameters.
            field: The distance field of a mesh.
        """
        self._problem = problem
        self._run = _run_tables(problem, p, field)

    def set_directions(self, directions: FloatArray, target: float = 0.0) -> None:
        """See ``Residuals.set_directions``."""
        kept = np.ascontiguousarray(checked_directions(directions))
        resistance = self._run.resistance._replace(directions=kept, target=float(target))
        self._run = self._run._replace(resistance=resistance)

    def set_objectives(self, values: FloatArray) -> None:
        """See ``Residuals.set_objectives``."""
        place = self._problem.residuals.formulation.places["objectives"]
        begin = self._problem.tape.arguments[1]
        now = self._run.work[begin + place.start : begin + place.stop]
        new = values if values.size else 0.0
        if np.any(now != new):
            now[:] = new
            self._run.kept.counts[0] = -1

    def keep_apart(self, distances: LinkDistances | None) -> None:
        """See ``Residuals.keep_apart``."""
        links = link_run(distances, len(self._run.kept.x), self._problem.places[LINKS])
        self._run = self._run._replace(links=links)
        if len(links.values) > LINK_ROWS:
            rows = _rows(self._problem, len(links.values))
            rows.least[:] = self._run.rows.least
            self._run = self._run._replace(rows=rows)
            self._run.kept.counts[0] = -1

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
        x = x.copy()
        first = math.nan if damping is None else damping
        limits = np.array([max_iterations, first, slow, STALLED, PATIENCE], dtype=np.float64)
        worst, status, iterations, damping_next = compile_loops(minimise)(
            self._problem.tables, self._run, x, lower, upper, scale, limits
        )
        return LMResult(
            x=x,
            worst=worst,
            status=STATUS[status],
            iterations=iterations,
            damping=None if math.isnan(damping_next) else damping_next,
        )

    def violations(self) -> dict[str, float]:
        """See ``Residuals.violations``."""
        values = self._run.work[self._problem.tables.written.values_at]
        out = self._problem.residuals.written_violations(values)
        for term, place in self._problem.places.items():
            out[term.name] = max(out[term.name], -float(self._run.rows.least[place]))
        return out


def _run_tables(problem: LoopProblem, p: FloatArray, field: Field | None) -> RunTables:
    """The numbers of a task; no rows yet."""
    residuals, tables = problem.residuals, problem.tables
    values = residuals.formulation.unpack(p)
    if (tables.contacts.taylor >= 0) != isinstance(field, DistanceField):
        raise TypeError("these residuals need a distance field, or have no place for one")
    n = residuals.formulation.unknowns.size
    work = problem.tape.work.copy()
    work[problem.tape.arguments[1] :][: len(p)] = p
    return RunTables(
        work=work,
        field=spline_tables(field) if isinstance(field, DistanceField) else NO_FIELD,
        hand=hand_at(tables.joints, values["root"]),
        clearances=problem.clearances.run(values),
        capsules=capsule_run(residuals.fingers, values, residuals.formulation.symbols.hand.nq),
        links=link_run(None, n, problem.places[LINKS]),
        resistance=ResistanceRun(
            directions=np.zeros((0, 6)),
            target=0.0,
            mu=float(values["mu"][0]),
            length=float(values["length"][0]),
            resisted=np.zeros(len(tables.contacts.normals_at)),
            work=np.zeros((2, 3)),
        ),
        rows=_rows(problem, LINK_ROWS),
        kept=Kept(x=np.zeros(n), counts=np.full(2, -1), worst=np.zeros(1)),
        scratch=Scratch(
            normal=np.zeros((n, n)),
            damped=np.zeros((n, n)),
            columns=np.zeros((7, n)),
            to=np.zeros(n),
            numbers=np.zeros((3, n), dtype=np.int64),
            held=np.zeros(n, dtype=np.bool_),
        ),
    )


def _rows(problem: LoopProblem, n_links: int) -> Rows:
    """Room for all rows that there can be."""
    t, size = problem.tables, problem.residuals.formulation.unknowns.size
    n_joints, n_pairs = len(t.joints.twists_at) // 6, len(t.capsules.pairs)
    points = int(t.clearances.first[-1])
    rows = points + n_pairs + len(t.written.values_at) + n_links + N_DIRECTIONS
    entries = points * (6 + n_joints) + n_pairs * n_joints + len(t.written.entries_at)
    entries += n_links * size + 3 * N_DIRECTIONS
    return Rows(
        values=np.empty(rows),
        ends=np.empty(rows, dtype=np.int64),
        columns=np.empty(entries, dtype=np.int64),
        entries=np.empty(entries),
        least=np.zeros(len(problem.places)),
        weights=np.array([term.weight for term in problem.places]),
        filled=np.zeros(2, dtype=np.int64),
    )
