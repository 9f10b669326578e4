"""Clearances in compiled loops, and the field of a mesh that they look up at one point.

What ``planner.synthesis.terms.clearance`` says of surfaces and spheres is evaluated here without
leaving numba (``clearance_rows``): each distance is a program, run for all spheres side by side; on
a mesh it is looked up in the distance field (``planner.shapes.distance_field``).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from planner.numerics.kernels import loops_of_kernels
from planner.numerics.tape import Programs, Tape, programs_of, run_on_lanes, tape_of
from planner.spatial import FloatArray, IntArray
from planner.synthesis.terms.clearance import FASTEST, Clearances
from planner.synthesis.terms.hand_points import HandAt, Joints, Rows, move, point_row
from planner.synthesis.terms.term import Term

if TYPE_CHECKING:
    from planner.shapes.distance_field import DistanceField


class SplineTables(NamedTuple):
    """All levels of a field, the finest first, in flat arrays.

    Attributes:
        flat: Coefficients of all levels, m.
        first: Node at which cell 0 of each level begins (n, 3).
        inverse: 1 / spacing (n,), 1/m.
        last_cell: (n, 3).
        strides: Of each level along the axes (n, 3).
        start: Where each level begins in ``flat`` (n,).
        centre: Of the box of each level (n, 3), m.
        reach: Its half extents (n, 3), m.
        far_radius: m.
        weights: Of the coefficients by axis and derivative (36,), overwritten.
        found: Place for a result (10,), overwritten.
    """

    flat: FloatArray
    first: FloatArray
    inverse: FloatArray
    last_cell: IntArray
    strides: IntArray
    start: IntArray
    centre: FloatArray
    reach: FloatArray
    far_radius: float
    weights: FloatArray
    found: FloatArray


def spline_tables(field: DistanceField) -> SplineTables:
    """The levels of a field in flat arrays; for one run at a time."""
    t = field.tables
    return SplineTables(
        flat=t.flat,
        first=t.first,
        inverse=t.inverse[:, 0],
        last_cell=t.last_cell,
        strides=t.strides,
        start=t.start,
        centre=t.centre[:, 0],
        reach=t.reach[:, 0],
        far_radius=float(field.far_radius),
        weights=np.zeros(36),
        found=np.zeros(10),
    )


NO_FIELD = SplineTables(
    flat=np.zeros(0),
    first=np.zeros((0, 3)),
    inverse=np.zeros(0),
    last_cell=np.zeros((0, 3), dtype=np.int64),
    strides=np.zeros((0, 3), dtype=np.int64),
    start=np.zeros(0, dtype=np.int64),
    centre=np.zeros((0, 3)),
    reach=np.zeros((0, 3)),
    far_radius=0.0,
    weights=np.zeros(0),
    found=np.zeros(0),
)
"""The tables of a shape that is an expression."""


@loops_of_kernels
def taylor_at(
    tables: SplineTables, x: float, y: float, z: float, order: int, out: FloatArray, begin: int
) -> None:
    """Value and partial derivatives up to an order (1 or 2) at a point, m, into ``out`` (10).

    They begin at ``begin``.
    """
    level, n = 0, len(tables.inverse)
    while level < n and not (
        abs(x - tables.centre[level, 0]) <= tables.reach[level, 0]
        and abs(y - tables.centre[level, 1]) <= tables.reach[level, 1]
        and abs(z - tables.centre[level, 2]) <= tables.reach[level, 2]
    ):
        level += 1
    if level == n:
        far_taylor(x, y, z, tables.far_radius, out, begin)
        return
    w, inverse = tables.weights, tables.inverse[level]
    base = tables.start[level]
    for i in range(3):
        p = x if i == 0 else (y if i == 1 else z)
        u = p * inverse - tables.first[level, i]
        cell = min(int(max(u, 0.0)), tables.last_cell[level, i])
        base += cell * tables.strides[level, i]
        t = u - cell
        s = 1.0 - t
        o = 12 * i
        w[o] = s * s * s / 6.0
        w[o + 1] = (4.0 + t * t * (3.0 * t - 6.0)) / 6.0
        w[o + 2] = (1.0 + t * (3.0 + t * (3.0 - 3.0 * t))) / 6.0
        w[o + 3] = t * t * t / 6.0
        w[o + 4] = -0.5 * s * s
        w[o + 5] = t * (1.5 * t - 2.0)
        w[o + 6] = 0.5 + t * (1.0 - 1.5 * t)
        w[o + 7] = 0.5 * t * t
        w[o + 8] = s
        w[o + 9] = 3.0 * t - 2.0
        w[o + 10] = 1.0 - 3.0 * t
        w[o + 11] = t
    for i in range(10):
        out[begin + i] = 0.0
    for a in range(4):
        # along y of: value, slope and curvature along z; slopes along y
        v = vz = vzz = vy = vyz = vyy = 0.0
        for b in range(4):
            at = base + a * tables.strides[level, 0] + b * tables.strides[level, 1]
            f = fz = fzz = 0.0
            for c in range(4):
                coefficient = tables.flat[at + c]
                f += coefficient * w[24 + c]
                fz += coefficient * w[28 + c]
                fzz += coefficient * w[32 + c]
            v += w[12 + b] * f
            vy += w[16 + b] * f
            vz += w[12 + b] * fz
            vyy += w[20 + b] * f
            vyz += w[16 + b] * fz
            vzz += w[12 + b] * fzz
        out[begin] += w[a] * v
        out[begin + 1] += w[4 + a] * v
        out[begin + 2] += w[a] * vy
        out[begin + 3] += w[a] * vz
        if order == 2:
            out[begin + 4] += w[8 + a] * v
            out[begin + 5] += w[4 + a] * vy
            out[begin + 6] += w[4 + a] * vz
            out[begin + 7] += w[a] * vyy
            out[begin + 8] += w[a] * vyz
            out[begin + 9] += w[a] * vzz
    for i in range(1, 4):
        out[begin + i] *= inverse
    for i in range(4, 10):
        out[begin + i] *= inverse * inverse


@loops_of_kernels
def far_taylor(x: float, y: float, z: float, radius: float, out: FloatArray, begin: int) -> None:
    """The same of |p| - radius, away from the origin."""
    r = math.sqrt(x * x + y * y + z * z)
    out[begin] = r - radius
    out[begin + 1], out[begin + 2], out[begin + 3] = x / r, y / r, z / r
    k = begin + 4
    for i in range(1, 4):
        for j in range(i, 4):
            square = out[begin + i] * out[begin + j]
            out[k] = ((1.0 if i == j else 0.0) - square) / r
            k += 1


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
