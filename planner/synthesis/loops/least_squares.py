"""Levenberg-Marquardt on a grasp in loops: ``planner.numerics.levenberg_marquardt`` in one kernel.

The normal equations are summed up from the entries of the rows that count. Python is not entered
between the first evaluation of a run and the last.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from planner.numerics.kernels import loops_of_kernels
from planner.numerics.levenberg_marquardt import (
    FIRST_DAMPING,
    LEAST_GAIN,
    MOST_GROWTH,
    NOTHING,
    ROUNDS,
    SOLVED,
)
from planner.spatial import FloatArray, IntArray
from planner.synthesis.loops.rows import evaluate
from planner.synthesis.loops.tables import ProblemTables, Rows, RunTables, Sources

STATUS = ("out of iterations", "solved", "no step descends", "stalled")
"""Why a run ended, by number."""


@loops_of_kernels
def minimise(
    p: ProblemTables,
    run: RunTables,
    sources: Sources,
    x: FloatArray,
    lower: FloatArray,
    upper: FloatArray,
    scale: FloatArray,
    max_iterations: int,
    damping: float,
    slow: float,
    stalled: float,
    patience: int,
) -> tuple[float, int, int, float]:
    """Minimise from x (n,), which is overwritten; the last evaluation is at the x that is left.

    Arguments are those of ``levenberg_marquardt``; a damping of NaN stands for None.

    Returns:
        Largest residual of a term, number in ``STATUS``, evaluations, damping of the next step.
    """
    places = np.empty(len(x), dtype=np.int64)
    n = 0
    for k in range(len(x)):
        places[k] = -1
        if upper[k] > lower[k]:
            places[k] = n
            n += 1
    unit, least, most = np.empty(n), np.empty(n), np.empty(n)
    for k in range(len(x)):
        if places[k] >= 0:
            unit[places[k]] = scale[k]
    normal, slope, step = np.empty((n, n)), np.empty(n), np.empty(n)
    damped, held = np.empty((n, n)), np.empty(n, dtype=np.bool_)
    to = np.empty(len(x))
    copy_into(to, x)
    total, worst, gain, expected = 0.0, 0.0, 0.0, 0.0
    growth, idle, iterations, status = 2.0, 0, 0, 0
    back = False  # the last step was refused, and the run ends
    while True:
        rows, worst_to = evaluate(p, run, sources, to)
        if back:
            break
        iterations += 1
        total_to = 0.0
        for k in range(rows):
            total_to += run.rows.values[k] ** 2
        if iterations > 1:
            gain = (total - total_to) / expected if expected > 0 else -1.0
        if iterations == 1 or gain > LEAST_GAIN:
            copy_into(x, to)
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
            if status or iterations >= max_iterations:
                break
            normal_equations(run.rows, rows, places, unit, normal, slope)
            if math.isnan(damping):
                damping = 0.0
                for k in range(n):
                    damping = max(damping, FIRST_DAMPING * normal[k, k])
            for k in range(len(x)):
                if places[k] >= 0:
                    least[places[k]] = (lower[k] - x[k]) / scale[k]
                    most[places[k]] = (upper[k] - x[k]) / scale[k]
        else:
            damping, growth = damping * growth, growth * 2.0
            if iterations >= max_iterations or growth > MOST_GROWTH:
                status, back = 2, True
                copy_into(to, x)
                continue
        bounded_step(normal, slope, damping, least, most, damped, held, step)
        expected = expected_decrease(normal, slope, step)
        for k in range(len(x)):
            if places[k] >= 0:
                reached = x[k] + step[places[k]] * scale[k]
                to[k] = min(max(reached, lower[k]), upper[k])
    return worst, status, iterations, damping


@loops_of_kernels
def copy_into(out: FloatArray, values: FloatArray) -> None:
    """Copy a column; numba compiles an assignment of slices ten times as long."""
    for k in range(len(out)):
        out[k] = values[k]


@loops_of_kernels
def normal_equations(
    rows: Rows,
    n_rows: int,
    places: IntArray,
    unit: FloatArray,
    normal: FloatArray,
    slope: FloatArray,
) -> None:
    """J'J (n, n) and J'r (n,) of the free unknowns in their units, from the entries of the rows.

    ``places`` is the place of every unknown among the free ones, or -1. Entries of a row are in the
    order of the unknowns.
    """
    n = len(slope)
    for i in range(n):
        slope[i] = 0.0
        for j in range(n):
            normal[i, j] = 0.0
    at, value = np.empty(len(places), dtype=np.int64), np.empty(len(places))
    begin = 0
    for row in range(n_rows):
        r, count = rows.values[row], 0
        for k in range(begin, rows.ends[row]):
            i = places[rows.columns[k]]
            if i >= 0:
                at[count], value[count] = i, rows.entries[k] * unit[i]
                count += 1
        begin = rows.ends[row]
        for a in range(count):
            i, v = at[a], value[a]
            slope[i] += r * v
            for b in range(a + 1):
                normal[i, at[b]] += v * value[b]
    for i in range(n):
        for j in range(i):
            normal[j, i] = normal[i, j]


@loops_of_kernels
def expected_decrease(normal: FloatArray, slope: FloatArray, step: FloatArray) -> float:
    """Of the sum of squares, by a step of the linearised residuals."""
    total = 0.0
    for i in range(len(step)):
        along = 2.0 * slope[i]
        for j in range(len(step)):
            along += normal[i, j] * step[j]
        total += along * step[i]
    return -total


@loops_of_kernels
def bounded_step(
    normal: FloatArray,
    slope: FloatArray,
    damping: float,
    least: FloatArray,
    most: FloatArray,
    damped: FloatArray,
    held: NDArray[np.bool_],
    step: FloatArray,
) -> None:
    """Solve (J'J + damping I) step = -J'r with least <= step <= most, as ``_step`` does."""
    n = len(slope)
    for i in range(n):
        step[i] = 0.0
        held[i] = (least[i] >= 0 and slope[i] > 0) or (most[i] <= 0 and slope[i] < 0)
    free, target = np.empty(n, dtype=np.int64), np.empty(n)
    for _ in range(ROUNDS):
        m = 0
        for i in range(n):
            if not held[i]:
                free[m] = i
                m += 1
        if m == 0:
            break
        for a in range(m):
            i = free[a]
            target[a] = -slope[i]
            if m < n:
                for j in range(n):
                    if held[j]:
                        target[a] -= normal[i, j] * step[j]
            for b in range(a, m):
                damped[a, b] = normal[i, free[b]]
            damped[a, a] += damping
        solve_positive(damped, target, m)
        beyond = False
        for a in range(m):
            step[free[a]] = target[a]
        for i in range(n):
            if step[i] < least[i] or step[i] > most[i]:
                step[i] = min(max(step[i], least[i]), most[i])
                held[i] = beyond = True
        if not beyond:
            break


@loops_of_kernels
def solve_positive(matrix: FloatArray, target: FloatArray, n: int) -> None:
    """Solve with the first n rows of a symmetric positive definite matrix, into ``target``.

    Only the upper triangle is read; Cholesky's factor U, matrix = U'U, takes its place.
    """
    for i in range(n):
        row = matrix[i]
        pivot = 1.0 / math.sqrt(row[i])
        for k in range(i, n):
            row[k] *= pivot
        target[i] *= pivot
        for j in range(i + 1, n):
            factor, below = row[j], matrix[j]
            if factor != 0.0:
                for k in range(j, n):
                    below[k] -= factor * row[k]
                target[j] -= factor * target[i]
    for i in range(n - 1, -1, -1):
        row, value = matrix[i], target[i]
        for k in range(i + 1, n):
            value -= row[k] * target[k]
        target[i] = value / row[i]
