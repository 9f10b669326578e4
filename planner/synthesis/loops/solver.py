"""``LoopResiduals``: a run of least squares in compiled loops, with the numbers of ``Residuals``.

Where numba is installed, ``GraspProblem.least_squares`` gives these in place of ``Residuals``. Both
read the same expressions and tables; here CasADi's functions are tapes
(``planner.numerics.tape``), and clearances come from the placements of the joints.
"""

from __future__ import annotations

import math

import numpy as np

from planner.numerics.kernels import compile_loops
from planner.numerics.levenberg_marquardt import PATIENCE, SLOW, STALLED, LMResult
from planner.shapes.field.distance_field import DistanceField
from planner.spatial import FloatArray
from planner.synthesis.field_points import Field
from planner.synthesis.loops.build import LoopProblem
from planner.synthesis.loops.field import NO_FIELD, spline_tables
from planner.synthesis.loops.least_squares import STATUS, minimise
from planner.synthesis.loops.tables import RunTables, Sources
from planner.synthesis.terms.clearance import FINGERS, OBJECT, OBSTACLE, OBSTACLE_DIM, TABLE
from planner.synthesis.terms.link_distance import LINKS, LinkDistances
from planner.synthesis.terms.resistance import N_DIRECTIONS, checked_directions

__all__ = ["LoopResiduals"]

SOURCES = OBJECT, TABLE, OBSTACLE, FINGERS, LINKS
"""The terms of ``RunTables.least``, in its order."""

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
        n = len(self._run.kept_x)
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
            self._run.kept[0] = -1

    def keep_apart(self, distances: LinkDistances | None) -> None:
        """See ``Residuals.keep_apart``."""
        n = len(self._run.kept_x)
        d = distances
        self._sources = self._sources._replace(
            link_values=np.zeros(0) if d is None else d.values,
            link_rows=np.zeros((0, n)) if d is None else np.ascontiguousarray(d.rows),
            link_x=np.zeros(n) if d is None else d.x,
        )
        if d is not None and len(d.values) > LINK_ROWS:
            self._run = _with_rows(self._run, self._problem, len(d.values))

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
        values = self._run.work[self._problem.tables.values_at]
        out = self._problem.residuals.written_violations(values)
        for term, least in zip(SOURCES, self._run.least.tolist(), strict=True):
            out[term.name] = max(out[term.name], -least)
        return out


def _run_tables(problem: LoopProblem, p: FloatArray, field: Field | None) -> RunTables:
    """The numbers of a task; no rows yet."""
    t, clearances = problem.tables, problem.residuals.clearances
    values = problem.residuals.formulation.unpack(p)
    if (t.taylor_begin >= 0) != isinstance(field, DistanceField):
        raise TypeError("these residuals need a distance field, or an expression has none")
    n_spheres = len(t.sphere_joint)
    work = problem.tape.work.copy()
    work[problem.tape.arguments[1] :][: len(p)] = p
    lanes = np.repeat(problem.clearance.work[:, None], n_spheres, axis=1)
    lanes[: len(values["size"])] = values["size"][:, None]
    boxes = values["obstacles"].reshape(-1, OBSTACLE_DIM)
    box_lanes = np.repeat(problem.box.work[None, :, None], len(boxes), axis=0)
    box_lanes = np.repeat(box_lanes, n_spheres, axis=2)
    box_lanes[:, :OBSTACLE_DIM] = boxes[:, :, None]
    root = values["root"] if len(values["root"]) else np.zeros(12)
    size = problem.residuals.formulation.unknowns.size
    nothing = np.zeros(0)
    return _with_rows(
        RunTables(
            work=work,
            reach=clearances.reach(values),
            gaps=clearances.unknown_gaps(),
            seen=np.full((n_spheres, 3), np.inf),
            lanes=lanes,
            box_lanes=box_lanes,
            obstacle_reach=clearances.radii + values["clear_table"][0],
            root=np.ascontiguousarray(root[:9].reshape(3, 3, order="F")),
            root_origin=root[9:].copy(),
            normal=values["table"][:3].copy(),
            height=clearances.heights(values),
            apart=clearances.squared_distances(values),
            field=spline_tables(field) if isinstance(field, DistanceField) else NO_FIELD,
            mu=float(values["mu"][0]),
            length=float(values["length"][0]),
            residuals=nothing,
            row_ends=np.zeros(0, dtype=np.int64),
            columns=np.zeros(0, dtype=np.int64),
            entries=nothing,
            least=np.zeros(len(SOURCES)),
            kept=np.full(2, -1),
            kept_x=np.zeros(size),
            kept_worst=np.zeros(1),
        ),
        problem,
        LINK_ROWS,
    )


def _with_rows(run: RunTables, problem: LoopProblem, n_links: int) -> RunTables:
    """With room for all rows that there can be, and none of them known."""
    t, size = problem.tables, len(run.kept_x)
    n_joints = len(t.twists_at)
    points = len(run.reach) * (1 + len(run.box_lanes)) + len(t.hull_joint)
    rows = points + len(t.pairs) + len(t.values_at) + n_links + N_DIRECTIONS
    entries = points * (6 + n_joints) + len(t.pairs) * n_joints + len(t.entries_at)
    entries += n_links * size + 3 * N_DIRECTIONS
    return run._replace(
        residuals=np.empty(rows),
        row_ends=np.empty(rows, dtype=np.int64),
        columns=np.empty(entries, dtype=np.int64),
        entries=np.empty(entries),
        kept=np.full(2, -1),
    )
