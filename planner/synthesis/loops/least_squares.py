"""Levenberg-Marquardt on a grasp in loops: ``planner.numerics.least_squares`` in one kernel.

``evaluate`` gives the rows, as ``planner.synthesis.residuals`` in NumPy: those of each term come
from the compiled part of its own file. The normal equations are summed up from the entries of the
rows that count. Python is not entered between the first evaluation of a run and the last.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from planner.numerics.kernels import loops_of_kernels
from planner.numerics.least_squares import (
    FIRST_DAMPING,
    LEAST_GAIN,
    MOST_GROWTH,
    NOTHING,
    ROUNDS,
    SOLVED,
)
from planner.numerics.tape import Program, run_tape
from planner.spatial import FloatArray, IntArray
from planner.synthesis.loops.clearance import (
    ClearanceRun,
    ClearanceTables,
    SplineTables,
    clearance_rows,
    taylor_at,
)
from planner.synthesis.mesh_surface import COEFFICIENTS
from planner.synthesis.terms.fingers import CapsuleRun, CapsuleTables, finger_rows
from planner.synthesis.terms.hand_points import HandAt, Joints, Rows, end_row, place_hand
from planner.synthesis.terms.link_distance import LinkRun, link_rows
from planner.synthesis.terms.resistance import ContactTables, ResistanceRun, resistance_rows

TAYLOR_ROW = 3 + COEFFICIENTS
"""Numbers of a contact's Taylor row on a mesh: its point, then the coefficients there."""


class Written(NamedTuple):
    """The terms that are written as expressions; rows that must hold come first.

    Attributes:
        values_at: Of each row its value (m,).
        entries_at: Entries of their Jacobian, by rows (e,).
        entry_columns: The unknown of each entry (e,).
        entry_ends: Where each row's entries end (m,).
        both: Whether a row counts on both sides of zero (m,).
        n_required: So many of the rows must hold.
    """

    values_at: IntArray
    entries_at: IntArray
    entry_columns: IntArray
    entry_ends: IntArray
    both: NDArray[np.bool_]
    n_required: int


class ProblemTables(NamedTuple):
    """What is the same for all runs of a problem; see the parts.

    ``program`` computes written terms and kinematics from unknowns, parameters and Taylor rows.
    """

    program: Program
    written: Written
    joints: Joints
    contacts: ContactTables
    clearances: ClearanceTables
    capsules: CapsuleTables


class Kept(NamedTuple):
    """Which rows depend on the unknowns alone, and stay while these do.

    Attributes:
        x: Unknowns at the last evaluation (n,).
        counts: Those rows, or -1 if none are known; their entries (2,).
        worst: Largest of them that must hold (1,).
    """

    x: FloatArray
    counts: IntArray
    worst: FloatArray


class Scratch(NamedTuple):
    """Arrays of ``minimise`` for n unknowns, overwritten.

    Attributes:
        normal, damped: (n, n).
        columns: slope, step, unit, least, most, target, values of a row (7, n).
        to: Where the next evaluation is (n,).
        places, free, at: Numbers (3, n).
        held: (n,).
    """

    normal: FloatArray
    damped: FloatArray
    columns: FloatArray
    to: FloatArray
    numbers: IntArray
    held: NDArray[np.bool_]


class RunTables(NamedTuple):
    """Numbers of one task, and the rows of the last evaluation; see the parts.

    ``work`` is the work array of the program, with parameters and constants.
    """

    work: FloatArray
    field: SplineTables
    hand: HandAt
    clearances: ClearanceRun
    capsules: CapsuleRun
    links: LinkRun
    resistance: ResistanceRun
    rows: Rows
    kept: Kept
    scratch: Scratch


@loops_of_kernels
def evaluate(p: ProblemTables, run: RunTables, x: FloatArray) -> float:
    """The rows at x (n,); the largest of those that must hold.

    What depends on x alone is kept where x is that of the last call.
    """
    kept, rows, work = run.kept, run.rows, run.work
    same = kept.counts[0] >= 0
    for k in range(len(x)):
        same = same and x[k] == kept.x[k]
    if not same:
        for k in range(len(x)):
            kept.x[k] = work[k] = x[k]
        look_up(p.contacts, run.field, work, x)
        run_tape(p.program, work)
        for k in range(len(rows.least)):
            rows.least[k] = 0.0
        rows.filled[0] = rows.filled[1] = 0
        place_hand(p.joints, run.hand, work, x)
        clearance_rows(p.clearances, run.clearances, p.joints, run.hand, run.field, rows)
        finger_rows(p.capsules, run.capsules, p.joints, run.hand, rows)
        kept.worst[0] = largest(rows, 0)
        kept.worst[0] = written_rows(p.written, rows, work, kept.worst[0])
        kept.counts[0], kept.counts[1] = rows.filled[0], rows.filled[1]
    rows.filled[0], rows.filled[1] = kept.counts[0], kept.counts[1]
    link_rows(run.links, x, rows)
    worst: float = max(kept.worst[0], largest(rows, kept.counts[0]))
    resistance_rows(p.contacts, run.resistance, work, x, rows)
    return worst


@loops_of_kernels
def largest(rows: Rows, begin: int) -> float:
    """Largest absolute value of the rows so far, from one on."""
    out = 0.0
    for k in range(begin, rows.filled[0]):
        out = max(out, abs(rows.values[k]))
    return out


@loops_of_kernels
def look_up(contacts: ContactTables, field: SplineTables, work: FloatArray, x: FloatArray) -> None:
    """Put the Taylor rows of a mesh at the contacts into the work array."""
    if contacts.taylor >= 0:
        for i in range(len(contacts.normals_at)):
            at, begin = contacts.first + 3 * i, contacts.taylor + TAYLOR_ROW * i
            for k in range(3):
                work[begin + k] = x[at + k]
            taylor_at(field, x[at], x[at + 1], x[at + 2], 2, work, begin + 3)


@loops_of_kernels
def written_rows(written: Written, rows: Rows, work: FloatArray, worst: float) -> float:
    """Append the written rows that count; the largest, or ``worst``, of those that must hold."""
    begin = 0
    for k in range(len(written.values_at)):
        value, end = work[written.values_at[k]], written.entry_ends[k]
        if written.both[k] or value < 0.0:
            at = rows.filled[1]
            for j in range(begin, end):
                rows.columns[at] = written.entry_columns[j]
                rows.entries[at] = work[written.entries_at[j]]
                at += 1
            end_row(rows, value, at)
            if k < written.n_required:
                worst = max(worst, abs(value))
        begin = end
    return worst


STATUS = ("out of iterations", "solved", "no step descends", "stalled")
"""Why a run ended, by number."""


@loops_of_kernels
def minimise(
    p: ProblemTables,
    run: RunTables,
    x: FloatArray,
    lower: FloatArray,
    upper: FloatArray,
    scale: FloatArray,
    limits: FloatArray,
) -> tuple[float, int, int, float]:
    """Minimise from x (n,), which is overwritten; the last evaluation is at the x that is left.

    Arguments are those of ``levenberg_marquardt``; ``limits`` are max_iterations, damping (NaN for
    None), slow, stalled and patience.

    Returns:
        Largest residual of a term, number in ``STATUS``, evaluations, damping of the next step.
    """
    max_iterations, damping, slow = int(limits[0]), limits[1], limits[2]
    stalled, patience = limits[3], int(limits[4])
    s, to = run.scratch, run.scratch.to
    places, c, normal = s.numbers, s.columns, s.normal
    n = 0
    for k in range(len(x)):
        places[0, k] = -1
        to[k] = x[k]
        if upper[k] > lower[k]:
            places[0, k] = n
            c[UNIT, n] = scale[k]
            n += 1
    total, worst, gain, expected = 0.0, 0.0, 0.0, 0.0
    growth, idle, iterations, status = 2.0, 0, 0, 0
    back = False  # the last step was refused, and the run ends
    while True:
        worst_to = evaluate(p, run, to)
        if back:
            break
        iterations += 1
        total_to = 0.0
        for k in range(run.rows.filled[0]):
            total_to += run.rows.values[k] ** 2
        if iterations > 1:
            gain = (total - total_to) / expected if expected > 0 else -1.0
        if iterations == 1 or gain > LEAST_GAIN:
            for k in range(len(x)):
                x[k] = to[k]
            if iterations > 1:
                gained = (total - total_to) / total
                damping *= max(1 / 3, 1 - (2 * min(gain, 1.0) - 1) ** 3)
                growth = 2.0
                idle = idle + 1 if gained < stalled else 0
                if worst_to < SOLVED and gained < slow:
                    status = 1
                elif idle >= patience:
                    status = 3
            total, worst = total_to, worst_to
            if status == 0 and iterations < max_iterations and total <= NOTHING:
                status = 1
            if status != 0 or iterations >= max_iterations:
                break
            normal_equations(run.rows, s, n)
            if math.isnan(damping):
                damping = 0.0
                for k in range(n):
                    damping = max(damping, FIRST_DAMPING * normal[k, k])
            for k in range(len(x)):
                i = places[0, k]
                if i >= 0:
                    c[LEAST, i] = (lower[k] - x[k]) / scale[k]
                    c[MOST, i] = (upper[k] - x[k]) / scale[k]
        else:
            damping, growth = damping * growth, growth * 2.0
            if iterations >= max_iterations or growth > MOST_GROWTH:
                status, back = 2, True
                for k in range(len(x)):
                    to[k] = x[k]
                continue
        bounded_step(s, n, damping)
        expected = expected_decrease(s, n)
        for k in range(len(x)):
            i = places[0, k]
            if i >= 0:
                reached = x[k] + c[STEP, i] * scale[k]
                to[k] = min(max(reached, lower[k]), upper[k])
    return worst, status, iterations, damping


SLOPE, STEP, UNIT, LEAST, MOST, TARGET, VALUE = range(7)
"""Rows of ``Scratch.columns``."""


@loops_of_kernels
def normal_equations(rows: Rows, s: Scratch, n: int) -> None:
    """J'J (n, n) and J'r (n,) of the free unknowns in their units, from the entries of the rows.

    Entries of a row are in the order of the unknowns.
    """
    normal, c, numbers = s.normal, s.columns, s.numbers
    for i in range(n):
        c[SLOPE, i] = 0.0
        for j in range(n):
            normal[i, j] = 0.0
    begin = 0
    for row in range(rows.filled[0]):
        r, count = rows.values[row], 0
        for k in range(begin, rows.ends[row]):
            i = numbers[0, rows.columns[k]]
            if i >= 0:
                numbers[2, count], c[VALUE, count] = i, rows.entries[k] * c[UNIT, i]
                count += 1
        begin = rows.ends[row]
        for a in range(count):
            i, v = numbers[2, a], c[VALUE, a]
            c[SLOPE, i] += r * v
            for b in range(a + 1):
                normal[i, numbers[2, b]] += v * c[VALUE, b]
    for i in range(n):
        for j in range(i):
            normal[j, i] = normal[i, j]


@loops_of_kernels
def expected_decrease(s: Scratch, n: int) -> float:
    """Of the sum of squares, by a step of the linearised residuals."""
    total = 0.0
    for i in range(n):
        along = 2.0 * s.columns[SLOPE, i]
        for j in range(n):
            along += s.normal[i, j] * s.columns[STEP, j]
        total += along * s.columns[STEP, i]
    return -total


@loops_of_kernels
def bounded_step(s: Scratch, n: int, damping: float) -> None:
    """Solve (J'J + damping I) step = -J'r with least <= step <= most, as ``_step`` does."""
    c, held, free, damped, normal = s.columns, s.held, s.numbers, s.damped, s.normal
    for i in range(n):
        c[STEP, i] = 0.0
        held[i] = (c[LEAST, i] >= 0 and c[SLOPE, i] > 0) or (c[MOST, i] <= 0 and c[SLOPE, i] < 0)
    for _ in range(ROUNDS):
        m = 0
        for i in range(n):
            if not held[i]:
                free[1, m] = i
                m += 1
        if m == 0:
            break
        for a in range(m):
            i = free[1, a]
            c[TARGET, a] = -c[SLOPE, i]
            if m < n:
                for j in range(n):
                    if held[j]:
                        c[TARGET, a] -= normal[i, j] * c[STEP, j]
            for b in range(a, m):
                damped[a, b] = normal[i, free[1, b]]
            damped[a, a] += damping
        solve_positive(damped, c, m)
        beyond = False
        for a in range(m):
            c[STEP, free[1, a]] = c[TARGET, a]
        for i in range(n):
            if c[STEP, i] < c[LEAST, i] or c[STEP, i] > c[MOST, i]:
                c[STEP, i] = min(max(c[STEP, i], c[LEAST, i]), c[MOST, i])
                held[i] = beyond = True
        if not beyond:
            break


@loops_of_kernels
def solve_positive(matrix: FloatArray, c: FloatArray, n: int) -> None:
    """Solve with the first n rows of a symmetric positive definite matrix, into ``c[TARGET]``.

    Only the upper triangle is read; Cholesky's factor U, matrix = U'U, takes its place.
    """
    for i in range(n):
        pivot = 1.0 / math.sqrt(matrix[i, i])
        for k in range(i, n):
            matrix[i, k] *= pivot
        c[TARGET, i] *= pivot
        for j in range(i + 1, n):
            factor = matrix[i, j]
            if factor != 0.0:
                for k in range(j, n):
                    matrix[j, k] -= factor * matrix[i, k]
                c[TARGET, j] -= factor * c[TARGET, i]
    for i in range(n - 1, -1, -1):
        value = c[TARGET, i]
        for k in range(i + 1, n):
            value -= matrix[i, k] * c[TARGET, k]
        c[TARGET, i] = value / matrix[i, i]
