"""The residuals of a grasp with their derivatives, in loops: what ``Residuals`` does in NumPy.

``planner.synthesis.residuals`` and its row sources say what the rows are. Here a row has the
entries that can differ from zero, and no others: a tenth of all.
"""

from __future__ import annotations

import math

import numpy as np

from planner.numerics.kernels import loops_of_kernels
from planner.numerics.tape import run_tape
from planner.spatial import FloatArray
from planner.synthesis.contact_wrenches import TINY
from planner.synthesis.loops.clearances import clearance_rows, cross, dot, gather
from planner.synthesis.loops.field import SplineTables, taylor_at
from planner.synthesis.loops.tables import (
    LINKS_PLACE,
    TAYLOR_ROW,
    Contacts,
    ProblemTables,
    Rows,
    RunTables,
    Sources,
    Written,
)
from planner.synthesis.resistance import TIE
from planner.synthesis.terms.link_distance import LINKS, ROUNDING
from planner.synthesis.terms.resistance import RESISTANCE_WEIGHT

LINKS_WEIGHT = LINKS.weight


@loops_of_kernels
def evaluate(
    p: ProblemTables, run: RunTables, sources: Sources, x: FloatArray
) -> tuple[int, float]:
    """The rows at x (n,): how many, and the largest of those that must hold.

    What depends on x alone is kept where x is that of the last call.
    """
    kept, rows, work = run.kept, run.rows, run.work
    same = kept.counts[0] >= 0
    for k in range(len(x)):
        same = same and x[k] == kept.x[k]
    if not same:
        for k in range(len(x)):
            kept.x[k] = work[k] = x[k]
        if p.contacts.taylor >= 0:
            look_up(p.contacts, run.object.field, work, x)
        run_tape(p.program, work)
        for k in range(len(rows.least)):
            rows.least[k] = 0.0
        n, at = clearance_rows(
            p.joints, p.spheres, p.hull, p.capsules, p.object, p.obstacle, run.object, run.around,
            rows, work, x, p.contacts.taylor >= 0,
        )  # fmt: skip
        worst = largest(rows.values[:n])
        n, at, worst = written_rows(p.written, rows, work, n, at, worst)
        kept.counts[0], kept.counts[1], kept.worst[0] = n, at, worst
    n, at, worst = kept.counts[0], kept.counts[1], kept.worst[0]
    begin = n
    n, at = link_rows(rows, sources, x, n, at)
    worst = max(worst, largest(rows.values[begin:n]))
    if len(sources.directions):
        n, at = resistance_rows(
            p.contacts, rows, work, sources.directions, sources.target, run.mu, run.length, x, n, at
        )
    return n, worst


@loops_of_kernels
def largest(values: FloatArray) -> float:
    """Largest absolute value."""
    out = 0.0
    for value in values:
        out = max(out, abs(value))
    return out


@loops_of_kernels
def look_up(contacts: Contacts, field: SplineTables, work: FloatArray, x: FloatArray) -> None:
    """Put the Taylor rows of a mesh at the contacts into the work array."""
    for i in range(len(contacts.normals_at)):
        point = x[contacts.first + 3 * i : contacts.first + 3 * i + 3]
        begin = contacts.taylor + TAYLOR_ROW * i
        for k in range(3):
            work[begin + k] = point[k]
        taylor_at(field, point, 2, work[begin + 3 : begin + TAYLOR_ROW])


@loops_of_kernels
def written_rows(
    written: Written, rows: Rows, work: FloatArray, n: int, at: int, worst: float
) -> tuple[int, int, float]:
    """Append the written rows that count."""
    entries_at, entry_columns = written.entries_at, written.entry_columns
    columns, entries = rows.columns, rows.entries
    begin = 0
    for k in range(len(written.values_at)):
        value, end = work[written.values_at[k]], written.entry_ends[k]
        if written.both[k] or value < 0.0:
            for j in range(begin, end):
                columns[at], entries[at] = entry_columns[j], work[entries_at[j]]
                at += 1
            rows.values[n], rows.ends[n] = value, at
            n += 1
            if k < written.n_required:
                worst = max(worst, abs(value))
        begin = end
    return n, at, worst


@loops_of_kernels
def link_rows(rows: Rows, sources: Sources, x: FloatArray, n: int, at: int) -> tuple[int, int]:
    """Append the linearised distances of true links that are too small."""
    rates, link_x = sources.link_rows, sources.link_x
    rows.least[LINKS_PLACE] = 0.0
    for k in range(len(rates)):
        value = sources.link_values[k]
        for j in range(len(x)):
            value += rates[k, j] * (x[j] - link_x[j])
        if value < -ROUNDING:
            rows.least[LINKS_PLACE] = min(rows.least[LINKS_PLACE], value)
            for j in range(len(x)):
                if rates[k, j] != 0.0:
                    rows.columns[at], rows.entries[at] = j, LINKS_WEIGHT * rates[k, j]
                    at += 1
            rows.values[n], rows.ends[n] = LINKS_WEIGHT * value, at
            n += 1
    return n, at


@loops_of_kernels
def resistance_rows(
    contacts: Contacts,
    rows: Rows,
    work: FloatArray,
    directions: FloatArray,
    target: float,
    mu: float,
    length: float,
    x: FloatArray,
    n: int,
    at: int,
) -> tuple[int, int]:
    """Append the directions of wrench in which resistance falls short of its target."""
    g, t, z, w, slope = np.empty(3), np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    normals, slopes = np.empty(contacts.normals_at.shape), np.empty(contacts.slopes_at.shape)
    resisted, first = np.empty(len(normals)), contacts.first
    gather(work, contacts.normals_at, normals)
    gather(work, contacts.slopes_at, slopes)
    for k in range(len(directions)):
        u = directions[k]
        highest = -math.inf
        for i in range(len(normals)):
            pressed, across = part(u, x[first + 3 * i :], normals[i], length, g, t)
            resisted[i] = pressed + mu * across
            highest = max(highest, resisted[i])
        best, size = 0, 0.0
        while resisted[best] < highest - TIE:
            best += 1
        for i in range(6):
            size += u[i] * u[i]
        value = resisted[best] - target * math.sqrt(size)
        if value < 0.0:
            normal = normals[best]
            pressed, across = part(u, x[first + 3 * best :], normal, length, g, t)
            c = 1.0 + mu / across * dot(t, normal)
            for i in range(3):
                along = mu / across * t[i]
                w[i], z[i] = along - c * normal[i], pressed * along - c * g[i]
            cross(w, u[3:], slope)
            for j in range(3):
                slope[j] /= length
                for i in range(3):
                    slope[j] += z[i] * slopes[best, 3 * i + j]
                rows.columns[at] = first + 3 * best + j
                rows.entries[at] = RESISTANCE_WEIGHT * slope[j]
                at += 1
            rows.values[n], rows.ends[n] = RESISTANCE_WEIGHT * value, at
            n += 1
    return n, at


@loops_of_kernels
def part(
    u: FloatArray,
    point: FloatArray,
    normal: FloatArray,
    length: float,
    g: FloatArray,
    t: FloatArray,
) -> tuple[float, float]:
    """The force g (3,) of a wrench at a contact, its part t across the normal; sizes of both.

    The contact point is the first three of ``point``.
    """
    g[0] = u[0] + (u[4] * point[2] - u[5] * point[1]) / length
    g[1] = u[1] + (u[5] * point[0] - u[3] * point[2]) / length
    g[2] = u[2] + (u[3] * point[1] - u[4] * point[0]) / length
    pressed = -dot(g, normal)
    for i in range(3):
        t[i] = g[i] + pressed * normal[i]
    return pressed, math.sqrt(dot(t, t) + TINY)
