"""``LoopResiduals``: a run of least squares in compiled loops, with the numbers of ``Residuals``.

Where kernels are compiled, ``GraspProblem.least_squares`` gives these in place of ``Residuals``.
Both read the same expressions and tables; here CasADi's functions are tapes
(``planner.numerics.tape``), and clearances come from the placements of the joints.
"""

from __future__ import annotations

import math

import numpy as np

from planner.numerics.kernels import compile_loops
from planner.numerics.levenberg_marquardt import PATIENCE, SLOW, STALLED, LMResult
from planner.shapes.field.distance_field import DistanceField
from planner.shapes.surface import SIZE_DIM
from planner.spatial import FloatArray
from planner.synthesis.field_points import Field
from planner.synthesis.loops.build import LoopProblem
from planner.synthesis.loops.field import NO_FIELD, spline_tables
from planner.synthesis.loops.least_squares import STATUS, minimise
from planner.synthesis.loops.tables import (
    SOURCES,
    Kept,
    ObjectRoom,
    Rows,
    RunTables,
    Sources,
    Surroundings,
)
from planner.synthesis.terms.clearance import OBSTACLE_DIM
from planner.synthesis.terms.link_distance import LinkDistances
from planner.synthesis.terms.resistance import N_DIRECTIONS, checked_directions

LINK_ROWS = 64
"""True distances for which there is room at first."""


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
        n = len(self._run.kept.x)
        self._sources = Sources(
            link_values=np.zeros(0),
            link_rows=np.zeros((0, n)),
            link_x=np.zeros(n),
            directions=np.zeros((0, 6)),
            target=0.0,
        )

    def set_directions(self, directions: FloatArray, target: float = 0.0) -> None:
        """See ``Residuals.set_directions``."""
        kept = np.ascontiguousarray(checked_directions(directions))
        self._sources = self._sources._replace(directions=kept, target=float(target))

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
        n = len(self._run.kept.x)
        d = distances
        self._sources = self._sources._replace(
            link_values=np.zeros(0) if d is None else d.values,
            link_rows=np.zeros((0, n)) if d is None else np.ascontiguousarray(d.rows),
            link_x=np.zeros(n) if d is None else d.x,
        )
        if d is not None and len(d.values) > LINK_ROWS:
            rows = _rows(self._problem, len(self._run.around.lanes), len(d.values))
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
        worst, status, iterations, damping_next = compile_loops(minimise)(
            self._problem.tables,
            self._run,
            self._sources,
            x,
            lower,
            upper,
            scale,
            max_iterations,
            math.nan if damping is None else damping,
            float(slow),
            STALLED,
            PATIENCE,
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
        for term, least in zip(SOURCES, self._run.rows.least.tolist(), strict=True):
            out[term.name] = max(out[term.name], -least)
        return out


def _run_tables(problem: LoopProblem, p: FloatArray, field: Field | None) -> RunTables:
    """The numbers of a task; no rows yet."""
    clearances = problem.residuals.clearances
    values = problem.residuals.formulation.unpack(p)
    on_mesh = problem.tables.contacts.taylor >= 0
    if on_mesh != isinstance(field, DistanceField):
        raise TypeError("these residuals need a distance field, or have no place for one")
    n = len(clearances.radii)
    work = problem.tape.work.copy()
    work[problem.tape.arguments[1] :][: len(p)] = p
    boxes = values["obstacles"].reshape(-1, OBSTACLE_DIM)
    lanes = np.repeat(problem.clearance.work[:, None], n, axis=1)
    if not on_mesh:
        lanes[:SIZE_DIM] = values["size"][:, None]
    box_lanes = np.tile(problem.box.work[None, :, None], (len(boxes), 1, n))
    box_lanes[:, :OBSTACLE_DIM] = boxes[:, :, None]
    root = values["root"] if len(values["root"]) else np.zeros(12)
    return RunTables(
        work=work,
        object=ObjectRoom(
            reach=clearances.reach(values),
            known=clearances.unknown_gaps(),
            seen=np.full((n, 3), np.inf),
            lanes=lanes,
            field=spline_tables(field) if isinstance(field, DistanceField) else NO_FIELD,
        ),
        around=Surroundings(
            lanes=box_lanes,
            reach=clearances.radii + values["clear_table"][0],
            normal=values["table"][:3].copy(),
            height=clearances.heights(values),
            apart=clearances.squared_distances(values),
            root=np.ascontiguousarray(root[:9].reshape(3, 3, order="F")),
            root_origin=root[9:].copy(),
        ),
        rows=_rows(problem, len(boxes), LINK_ROWS),
        kept=Kept(
            x=np.zeros(problem.residuals.formulation.unknowns.size),
            counts=np.full(2, -1),
            worst=np.zeros(1),
        ),
        mu=float(values["mu"][0]),
        length=float(values["length"][0]),
    )


def _rows(problem: LoopProblem, n_obstacles: int, n_links: int) -> Rows:
    """Room for all rows that there can be."""
    t, size = problem.tables, problem.residuals.formulation.unknowns.size
    n_joints, n_pairs = len(t.joints.twists_at), len(t.capsules.pairs)
    points = len(t.spheres.joint) * (1 + n_obstacles) + len(t.hull.joint)
    rows = points + n_pairs + len(t.written.values_at) + n_links + N_DIRECTIONS
    entries = points * (6 + n_joints) + n_pairs * n_joints + len(t.written.entries_at)
    entries += n_links * size + 3 * N_DIRECTIONS
    return Rows(
        values=np.empty(rows),
        ends=np.empty(rows, dtype=np.int64),
        columns=np.empty(entries, dtype=np.int64),
        entries=np.empty(entries),
        least=np.zeros(len(SOURCES)),
    )
