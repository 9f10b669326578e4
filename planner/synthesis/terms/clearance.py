"""Clearances of spheres of the hand from surfaces, where they are violated: ``Clearances``.

Spheres stand for the links (``planner.synthesis.link_spheres``). Which spheres keep away from
which surface, and by how much, is said by each term (``SphereClearance``); here are those of every
problem, and what evaluates all of them. A new one is written in one file, as in
``tests/test_own_clearance.py``.

Of some hundreds of clearances few are violated at a time. CasADi computes all values and points;
derivatives are computed for the violated ones alone, from the joints' Jacobians
(``planner.synthesis.terms.hand_points``). On a mesh a sphere that was far from the object is looked
up again only when it may be near: distances change no faster than points move.

Compiled loops do the same (``clearance_rows``): each distance is a program, run for all spheres
side by side.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from planner.errors import TaskError
from planner.hands.fingers import Finger
from planner.hands.hand import Hand
from planner.numerics.kernels import loops_of_kernels
from planner.numerics.tape import Programs, Tape, programs_of, run_on_lanes, tape_of
from planner.shapes.surface import box_clearance
from planner.spatial import FloatArray, IntArray
from planner.synthesis.link_spheres import (
    SAME_POINT,
    LinkSphere,
    hull_spheres,
    link_spheres,
    margin_of,
    moving,
)
from planner.synthesis.loops.field import SplineTables, taylor_at
from planner.synthesis.mesh_surface import Field
from planner.synthesis.symbols import GraspSymbols, mrp_rates
from planner.synthesis.terms.hand_points import (
    HandAt,
    HandPoints,
    Joints,
    Placement,
    Rows,
    move,
    point_row,
    side_by_side,
)
from planner.synthesis.terms.standard import PER_METRE
from planner.synthesis.terms.term import ActiveRows, Role, Row, RowSource, SphereClearance, Term
from planner.system.threads import built

PRESSED = 0.001
"""Depth (m) of a touching pad's sphere in the smooth distance, at most: it touches at its contact,
and in a corner must not stand in the other face. On edges and in fillets the smooth distance of a
pad that touches is up to so much below the pad's radius."""

FASTEST = 1.1
"""Largest slope (-) of a mesh's smooth distance; a little more than that of the true one."""


def _from_object(g: GraspSymbols, sphere: LinkSphere) -> tuple[Any, ...] | None:
    if g.surface.field is not None and _is_round_pad(sphere, g.fingers):
        return (sphere.radius - PRESSED,)
    margin = margin_of(sphere, g.fingers)
    if margin is None:
        return None
    return (sphere.radius + g.option[margin] + g.surface.distance_error,)


def _from_surroundings(g: GraspSymbols, sphere: LinkSphere) -> tuple[Any, ...]:
    return sphere.radius, g.option["clear_table"]


def _is_round_pad(sphere: LinkSphere, fingers: Iterable[Finger]) -> bool:
    """Whether a sphere is the surface of a touching finger's pad."""
    touching = [f for f in fingers if f.name == sphere.finger]
    return sphere.is_pad and any(abs(sphere.radius - f.pad.radius) < SAME_POINT for f in touching)


OBJECT = Term(
    name="object",
    meaning="distance of link spheres less clear_object or clear_tip; of pads beside their contact",
    role=Role.INEQUALITY,
    unit="m",
    weight=PER_METRE,
    clearance=SphereClearance(
        spheres=link_spheres,
        numbers=lambda g: [g.size],
        distance=lambda g, size, point: g.surface.clearance(size, point),
        least=_from_object,
        of_object=True,
    ),
    wording="clearance of {} from the object",
    elsewhere="palm or wrist",
    judged="penetration of the true links",
    lacking="palm or links would stand in the object; a smaller one, another pose, other fingers",
)

TABLE = Term(
    name="table",
    meaning="height of the links' hull over the table, less clear_table",
    role=Role.INEQUALITY,
    unit="m",
    weight=PER_METRE,
    clearance=SphereClearance(
        spheres=hull_spheres,
        numbers=lambda g: [ca.vertcat(*g.table)],
        distance=lambda g, plane, point: ca.dot(plane[:3], point) - plane[3],
        least=_from_surroundings,
    ),
    wording="clearance of {} from the table",
    elsewhere="palm or wrist",
    judged="penetration of the true links",
    lacking="links would stand in the table; another pose, or a stand",
)

OBSTACLE = Term(
    name="obstacle",
    meaning="distance of link spheres from each obstacle, less clear_table",
    role=Role.INEQUALITY,
    unit="m",
    weight=PER_METRE,
    clearance=SphereClearance(
        spheres=link_spheres,
        numbers=lambda g: [ca.vertcat(*map(ca.vec, box)) for box in g.boxes],
        distance=lambda g, box, point: box_clearance(
            box[12:], ca.reshape(box[:9], 3, 3) @ point + box[9:12]
        ),
        least=_from_surroundings,
    ),
    wording="clearance of {} from an obstacle",
    elsewhere="palm or wrist",
    judged="penetration of the true links",
    lacking="links would stand in an obstacle; more room around the object, another pose",
)


@dataclass(frozen=True, kw_only=True, eq=False)
class SurfaceRows:
    """The rows of one term about one surface, as expressions.

    Attributes:
        term: The term.
        first: Number of the first of them among the rows of the term.
        spheres: The spheres, all that the term has (n,).
        numbers: What the surface depends on (k,).
        distance: CasADi function of numbers and a point: value, gradient. None where it is looked
            up in the field of a mesh.
        least: What the distance of each sphere's centre must be (n, 2), m, in the parts that are
            taken off it; minus infinity where it has no row.
        counts: Which spheres have a row (n,).
    """

    term: Term
    first: int
    spheres: tuple[LinkSphere, ...]
    numbers: Any
    distance: Any
    least: Any
    counts: NDArray[np.bool_]

    @property
    def rows(self) -> tuple[Row, ...]:
        """Their names."""
        about = [(b.finger,) if b.finger else () for b in self.spheres]
        return tuple(
            self.term.row(about[k], self.first + k) for k in np.flatnonzero(self.counts).tolist()
        )


def surface_rows(g: GraspSymbols, terms: Iterable[Term]) -> tuple[SurfaceRows, ...]:
    """The rows of all terms that are clearances, surface by surface.

    Args:
        g: The grasp in symbols.
        terms: Terms; others than clearances are passed over.

    Raises:
        TaskError: A distance depends on more than its numbers and the point.
    """
    out: list[SurfaceRows] = []
    sets: dict[Callable[[Hand], tuple[LinkSphere, ...]], tuple[LinkSphere, ...]] = {}
    for term in terms:
        clearance = term.clearance
        if clearance is None:
            continue
        if clearance.spheres not in sets:
            sets[clearance.spheres] = moving(g.hand, clearance.spheres(g.hand))
        spheres = sets[clearance.spheres]
        asked = [clearance.least(g, sphere) for sphere in spheres]
        parts = [((-np.inf,) if a is None else a) + (0.0,) for a in asked]
        if any(a is not None and len(a) not in (1, 2) for a in asked):
            raise TaskError(
                f"least of term {term.name!r} gives {[len(a) for a in asked if a is not None]} "
                "expressions; give one or two"
            )
        surfaces = clearance.numbers(g)
        distance = None
        if surfaces and not (clearance.of_object and g.surface.field is not None):
            distance = _distance(g, term, surfaces[0].numel())
        out += [
            SurfaceRows(
                term=term,
                first=k * len(spheres),
                spheres=spheres,
                numbers=numbers,
                distance=distance,
                least=ca.vertcat(*(ca.horzcat(*p[:2]) for p in parts)),
                counts=np.array([a is not None for a in asked]),
            )
            for k, numbers in enumerate(surfaces)
        ]
    return tuple(out)


def _distance(g: GraspSymbols, term: Term, size: int) -> Any:
    """A term's distance as CasADi function of numbers (size,) and a point: value, gradient."""
    assert term.clearance is not None
    of, at = ca.SX.sym("of", size), ca.SX.sym("at", 3)
    value = term.clearance.distance(g, of, at)
    try:
        return ca.Function("distance", [of, at], [value, ca.densify(ca.gradient(value, at))])
    except RuntimeError as error:
        raise TaskError(
            f"the distance of term {term.name!r} depends on more than its numbers and the point; "
            "give what it depends on as numbers= of its SphereClearance"
        ) from error


class Clearances(RowSource):
    """The clearances of one hand, finger set and kind of shape.

    Attributes:
        surfaces: The rows, surface by surface.
        sets: The distinct sets of spheres.
        set_of: Which set each surface's spheres are.
        first: Where the spheres of each surface begin among those of all surfaces, and the end.
    """

    def __init__(
        self, symbols: GraspSymbols, terms: Iterable[Term], surfaces: tuple[SurfaceRows, ...]
    ) -> None:
        """Write the expressions.

        Args:
            symbols: Unknowns and parameters.
            terms: The terms that are clearances.
            surfaces: Their rows.
        """
        g = self._symbols = symbols
        self.surfaces = surfaces
        self.sets = list(dict.fromkeys(s.spheres for s in surfaces))
        self.set_of = [self.sets.index(s.spheres) for s in surfaces]
        self.first = np.cumsum([0, *(len(s.spheres) for s in surfaces)])
        self._points = [
            HandPoints(g.hand, g.unknowns, [b.joint_id for b in spheres]) for spheres in self.sets
        ]
        placed = [[g.place(b.joint_id, b.center) for b in spheres] for spheres in self.sets]
        self.outputs = {
            "columns": g.symbolic.joint_columns(),
            "rotation": g.rotation.T,
        }
        for k, spheres in enumerate(self.sets):
            local = [g.symbolic.point(b.joint_id, b.center) for b in spheres]
            self.outputs[f"local{k}"] = side_by_side(local)
            self.outputs[f"placed{k}"] = side_by_side(placed[k])
        for k, s in enumerate(surfaces):
            if s.distance is not None:
                found = [s.distance(s.numbers, point) for point in placed[self.set_of[k]]]
                self.outputs[f"distances{k}"] = ca.horzcat(*[v for v, _ in found])
                self.outputs[f"slopes{k}"] = ca.horzcat(*[v for _, v in found])
        self._rows = {
            term: tuple(row for s in surfaces if s.term is term for row in s.rows) for term in terms
        }

    @property
    def rows(self) -> dict[Term, tuple[Row, ...]]:
        """See ``RowSource``."""
        return self._rows

    @property
    def expressions(self) -> dict[Term, Any]:
        """All clearances (m,) as expressions, in the order of ``rows``; None on a mesh."""
        out: dict[Term, Any] = {}
        for term in self.rows:
            parts = [
                (self.outputs[f"distances{k}"].T - s.least[:, 0] - s.least[:, 1])[
                    np.flatnonzero(s.counts).tolist()
                ]
                for k, s in enumerate(self.surfaces)
                if s.term is term and s.distance is not None and s.counts.any()
            ]
            looked_up = any(s.term is term and s.distance is None for s in self.surfaces)
            out[term] = None if looked_up else ca.vertcat(*parts)
        return out

    @built
    def _settings(self) -> Any:
        """Numbers of all surfaces and least distances of all spheres, of the parameters."""
        parameters = ca.vertcat(*self._symbols.parameters.values())
        numbers = ca.vertcat(*(s.numbers for s in self.surfaces))
        least = ca.vertcat(*(s.least for s in self.surfaces))
        return ca.Function("settings", [parameters], list(map(ca.densify, (numbers, least))))

    def settings(self, values: dict[str, FloatArray]) -> tuple[FloatArray, FloatArray]:
        """Numbers (k,) of all surfaces, and least distances (n, 2), m, of all their spheres."""
        p = np.concatenate([values[name] for name in self._symbols.parameters])
        numbers, least = self._settings(p)
        return np.array(numbers).ravel(), np.ascontiguousarray(least)

    def unknown_gaps(self) -> FloatArray:
        """Gaps (n,), m, of spheres that have not been looked up: those that count at once."""
        counts = np.concatenate([np.zeros(0, dtype=bool), *(s.counts for s in self.surfaces)])
        return np.where(counts, -np.inf, np.inf)

    def set_parameters(self, values: dict[str, FloatArray], field: Field | None) -> None:
        """See ``RowSource``."""
        self._field = field
        self._least = self.settings(values)[1]
        self._seen, self._gaps = np.full((len(self._least), 3), np.inf), self.unknown_gaps()
        root = values["root"][:9]
        self._root = root.reshape(3, 3, order="F") if len(root) else None

    def __call__(self, x: FloatArray) -> list[ActiveRows]:
        """See ``RowSource``."""
        found, out = self._found, []
        placement = Placement(
            rotation=found["rotation"],
            rates=mrp_rates(x[:3]),
            columns=found["columns"],
            root=self._root,
        )
        for k, s in enumerate(self.surfaces):
            which = self.set_of[k]
            if s.distance is None:
                gaps, bad, slopes = self._looked_up(k, found[f"placed{which}"])
            else:
                radius, margin = self._least[self.first[k] : self.first[k + 1]].T
                gaps = found[f"distances{k}"][:, 0] - radius - margin
                bad = np.flatnonzero(gaps < 0.0)
                slopes = found[f"slopes{k}"][bad]
            if len(bad):
                at = found[f"local{which}"][bad]
                rows = self._points[which].rows(placement, bad, at, slopes)
                out.append(ActiveRows(s.term, gaps[bad], rows, s.first + bad))
        return out

    def _looked_up(self, k: int, centers: FloatArray) -> tuple[FloatArray, IntArray, FloatArray]:
        """Last known gaps from surface k, numbers of the violated ones, and their gradients."""
        assert self._field is not None
        mine = slice(self.first[k], self.first[k + 1])
        gaps, seen = self._gaps[mine], self._seen[mine]
        moved = centers - seen
        moved *= moved
        near = np.flatnonzero(gaps < FASTEST * np.sqrt(moved.sum(axis=1)))
        if not len(near):
            return gaps, near, np.zeros((0, 3))
        found = self._field.taylor(centers[near], 1)
        seen[near] = centers[near]
        radius, margin = self._least[mine][near].T
        gaps[near] = found[:, 0] - radius - margin
        bad = gaps[near] < 0.0
        return gaps, near[bad], found[bad, 1:4]


class ClearanceTables(NamedTuple):
    """The clearances of a problem for compiled loops.

    Attributes:
        joint: Joint that each point moves with (k,): the centres of all sets of spheres.
        at: The points in its frame (k, 3), m.
        begin: First point of each surface (s,).
        first: Where its spheres begin among those of all surfaces, and the end (s + 1,).
        place: Place of its term, see ``Rows``.
        program: Its distance among ``programs``; -1 where it is looked up in the field of a mesh.
        lanes: Where the work array of its program begins, and the end (s + 1,).
        programs: Distances of numbers and a point.
        point: Where the point is in the work array of each program.
        results: Where value and gradient are (p, 4).
    """

    joint: IntArray
    at: FloatArray
    begin: IntArray
    first: IntArray
    place: IntArray
    program: IntArray
    lanes: IntArray
    programs: Programs
    point: IntArray
    results: IntArray


class ClearanceRun(NamedTuple):
    """Numbers of one task, and what is known at the last evaluation; of n spheres.

    Attributes:
        least: What the distance of each sphere's centre must be (n, 2), m, in two parts.
        known: On a mesh: last known gap (n,), m.
        seen: On a mesh: where the centre was when it was last looked up (n, 3), m.
        gaps: Distances less ``least`` (n,), m.
        slopes: Gradients of the distances (n, 3).
        lanes: Work arrays of all programs, a lane for each sphere.
        local: The points in the frame of base, flange or root (k, 3), m.
        placed: In the object's frame (k, 3), m.
    """

    least: FloatArray
    known: FloatArray
    seen: FloatArray
    gaps: FloatArray
    slopes: FloatArray
    lanes: FloatArray
    local: FloatArray
    placed: FloatArray


@dataclass(frozen=True, kw_only=True, eq=False)
class CompiledClearances:
    """Clearances for compiled loops: what all runs share.

    Attributes:
        tables: See there.
        tapes: Of each surface; None where it is looked up.
    """

    clearances: Clearances
    tables: ClearanceTables
    tapes: tuple[Tape | None, ...]

    @classmethod
    def of(cls, clearances: Clearances, places: Mapping[Term, int]) -> CompiledClearances | None:
        """Lay out; None where a distance has instructions that loops do not know.

        Args:
            clearances: The clearances.
            places: Places of the terms in ``Rows``.
        """
        surfaces, sets = clearances.surfaces, clearances.sets
        functions = list(dict.fromkeys(s.distance for s in surfaces if s.distance is not None))
        known = [tape_of(f) for f in functions]
        tapes = [tape for tape in known if tape is not None]
        if len(tapes) < len(known):
            return None
        which = [-1 if s.distance is None else functions.index(s.distance) for s in surfaces]
        sizes = [
            0 if k < 0 else len(tapes[k].work) * len(s.spheres)
            for k, s in zip(which, surfaces, strict=True)
        ]
        begins = np.cumsum([0, *(len(spheres) for spheres in sets)])
        points = [b for spheres in sets for b in spheres]
        tables = ClearanceTables(
            joint=np.array([b.joint_id for b in points], dtype=np.int64),
            at=np.array([b.center for b in points], dtype=np.float64).reshape(-1, 3),
            begin=begins[clearances.set_of],
            first=clearances.first,
            place=np.array([places[s.term] for s in surfaces], dtype=np.int64),
            program=np.array(which, dtype=np.int64),
            lanes=np.cumsum([0, *sizes]),
            programs=programs_of(tapes),
            point=np.array([tape.arguments[1] for tape in tapes], dtype=np.int64),
            results=np.array([np.concatenate(t.results) for t in tapes]).reshape(-1, 4),
        )
        of_surfaces = tuple(None if k < 0 else tapes[k] for k in which)
        return cls(clearances=clearances, tables=tables, tapes=of_surfaces)

    def run(self, values: dict[str, FloatArray]) -> ClearanceRun:
        """Numbers of a task, from parameters by name; nothing is known yet."""
        numbers, least = self.clearances.settings(values)
        n, k = len(least), len(self.tables.joint)
        lanes, at = [np.zeros(0)], 0
        for s, tape in zip(self.clearances.surfaces, self.tapes, strict=True):
            size = s.numbers.numel()
            if tape is not None:
                work = tape.work.copy()
                work[:size] = numbers[at : at + size]
                lanes.append(np.repeat(work, len(s.spheres)))
            at += size
        return ClearanceRun(
            least=least,
            known=self.clearances.unknown_gaps(),
            seen=np.full((n, 3), np.inf),
            gaps=np.zeros(n),
            slopes=np.zeros((n, 3)),
            lanes=np.concatenate(lanes),
            local=np.zeros((k, 3)),
            placed=np.zeros((k, 3)),
        )


@loops_of_kernels
def clearance_rows(
    t: ClearanceTables, run: ClearanceRun, p: Joints, hand: HandAt, field: SplineTables, rows: Rows
) -> None:
    """Append the violated clearances: what ``Clearances`` does."""
    for k in range(len(t.joint)):
        joint = t.joint[k]
        move(hand, joint, t.at, k, run.local)
        f = p.carried[joint]
        for i in range(3):
            run.placed[k, i] = (
                hand.frames[f, 3 * i] * run.local[k, 0]
                + hand.frames[f, 3 * i + 1] * run.local[k, 1]
                + hand.frames[f, 3 * i + 2] * run.local[k, 2]
                + hand.frames[f, 9 + i]
            )
    for s in range(len(t.place)):
        if t.program[s] < 0:
            from_field(t, run, s, field)
        else:
            by_program(t, run, s)
        shift = t.begin[s] - t.first[s]
        for k in range(t.first[s], t.first[s + 1]):
            if run.gaps[k] < 0.0:
                point = k + shift
                point_row(
                    p, hand, rows, t.place[s], t.joint[point], run.local, point, run.gaps[k],
                    run.slopes, k,
                )  # fmt: skip


@loops_of_kernels
def by_program(t: ClearanceTables, run: ClearanceRun, s: int) -> None:
    """Gaps and gradients of the spheres of surface s by its program, a lane for each."""
    which, first, lanes = t.program[s], t.first[s], run.lanes
    n, base, begin = t.first[s + 1] - first, t.lanes[s], t.begin[s]
    for i in range(3):
        at = base + (t.point[which] + i) * n
        for k in range(n):
            lanes[at + k] = run.placed[begin + k, i]
    run_on_lanes(t.programs, which, lanes, base, n)
    at = base + t.results[which, 0] * n
    for k in range(n):
        run.gaps[first + k] = lanes[at + k] - run.least[first + k, 0] - run.least[first + k, 1]
    for i in range(3):
        at = base + t.results[which, 1 + i] * n
        for k in range(n):
            run.slopes[first + k, i] = lanes[at + k]


@loops_of_kernels
def from_field(t: ClearanceTables, run: ClearanceRun, s: int, field: SplineTables) -> None:
    """The same from a mesh, of the spheres that may be near since they were last looked up.

    Where they were ``seen``, what is ``known`` of them; others are far.
    """
    shift = t.begin[s] - t.first[s]
    for k in range(t.first[s], t.first[s + 1]):
        run.gaps[k] = 1.0
        far = 0.0
        for i in range(3):
            far += (run.placed[k + shift, i] - run.seen[k, i]) ** 2
        if run.known[k] < FASTEST * math.sqrt(far):
            for i in range(3):
                run.seen[k, i] = run.placed[k + shift, i]
            x, y, z = run.seen[k, 0], run.seen[k, 1], run.seen[k, 2]
            taylor_at(field, x, y, z, 1, field.found, 0)
            run.known[k] = run.gaps[k] = field.found[0] - run.least[k, 0] - run.least[k, 1]
            for i in range(3):
                run.slopes[k, i] = field.found[1 + i]
