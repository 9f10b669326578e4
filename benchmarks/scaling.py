"""How cost grows: with grasps, workers, contacts and triangles, as curves with their exponents.

grasps     ``plan_grasps`` of a primitive in this process, 1, 10, 100 and so on.
workers    the same with 1, 2 and so on processes.
contacts   star-shaped hands of 2 to 8 fingers (``star_hand``) and a sphere, no table. Two
           fingers close a grasp only as soft contacts; the law is fitted to the others.
triangles  an ellipsoid as subdivided icosahedra of 80 to 81,920 triangles, prepared from nothing.

A law is y = factor x^exponent by least squares of the logarithms over the measured points; nothing
is extrapolated.
"""

from __future__ import annotations

import os
import resource
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import ClassVar

import trimesh
from rich.table import Table

from benchmarks.requests import (
    Request,
    RequestOutcome,
    Setting,
    loaded_hand,
    outcome_of,
    outcome_of_task,
)
from benchmarks.run import Job, measure
from benchmarks.star_hand import write_star_hand
from benchmarks.statistics import median_of, power_law, ratio
from planner.batch import plan_grasps
from planner.errors import NotFoundError, TaskError
from planner.hand_loading import load_hand
from planner.system.disk_cache import CACHE_VARIABLE
from planner.task import FINGERS_NEEDED, GraspTask
from sim.runner import Check, Runner
from sim.tables import Row, number, table_of

SOFT_TORSION = 0.01
"""Torsional friction (m) where two fingers have to do."""

SPHERE = "sphere:0.03"
"""What the star-shaped hands grasp: all their fingers reach around it."""

ELLIPSOID = (0.045, 0.035, 0.03)
"""Half axes of the mesh, m."""

GRASPS_PER_REQUEST = 10
"""How many grasps the curve of workers plans for each request of the others: enough that its rate
does not hang on the start of processes."""

CHEAP = "sphere"
"""Object of the curves of grasps and workers: what is measured there is not the solver."""

Point = Row


def _point(x: int, outcomes: Sequence[RequestOutcome]) -> Point:
    """A point of a curve out of requests.

    Raises:
        TaskError: A request could not be tried.
    """
    for o in outcomes:
        if o.error:
            raise TaskError(o.error)
    cpu, tried = sum(o.cpu_s for o in outcomes), sum(o.attempts for o in outcomes)
    found = sum(o.found for o in outcomes)
    return {
        "x": x,
        "requested": len(outcomes),
        "found": found,
        "attempts": tried,
        "cpu_s_per_attempt": ratio(cpu, tried),
        "cpu_s_per_found": ratio(cpu, found),
        "cpu_s_median": median_of(o.cpu_s for o in outcomes if o.found),
        "prepare_cpu_s": sum(o.prepare_s for o in outcomes),
    }


def _contacts(hand: str, count: int, n: int) -> Point:
    soft = count < FINGERS_NEEDED["point"]
    with tempfile.TemporaryDirectory() as folder:
        star = load_hand(write_star_hand(Path(folder), count))
    task = GraspTask.create(
        star,
        SPHERE,
        table_height=None,
        fingers=list(star.fingers),
        contact_model="soft" if soft else "point",
        mu_torsion=SOFT_TORSION if soft else 0.0,
    )
    point = _point(count, [outcome_of_task(task, k, Setting()) for k in range(n)])
    return point | {"fitted": not soft}


@lru_cache(maxsize=1)
def _build_for_meshes(hand: str) -> None:
    """Build what all meshes share, so that no point of the curve pays for it."""
    outcome_of(Request(hand=hand, spec="superquadric", k=0, setting=Setting()))


def _triangles(hand: str, count: int, n: int) -> Point:
    _build_for_meshes(hand)
    with tempfile.TemporaryDirectory() as folder, _empty_cache(folder):
        mesh = trimesh.creation.icosphere(subdivisions=count)
        mesh.apply_scale(ELLIPSOID)
        path = Path(folder) / f"ellipsoid{count}.ply"
        mesh.export(path)
        requests = [Request(hand=hand, spec=str(path), k=k, setting=Setting()) for k in range(n)]
        return _point(len(mesh.faces), [outcome_of(request) for request in requests])


@contextmanager
def _empty_cache(folder: str) -> Iterator[None]:
    """Nothing is prepared yet, and what is prepared now is forgotten."""
    before = os.environ.get(CACHE_VARIABLE)
    os.environ[CACHE_VARIABLE] = str(Path(folder) / "cache")
    try:
        yield
    finally:
        if before is None:
            del os.environ[CACHE_VARIABLE]
        else:
            os.environ[CACHE_VARIABLE] = before


def _grasps(hand: str, count: int, n: int) -> Point:
    loaded = loaded_hand(hand)
    plan_grasps(loaded, [CHEAP], 1, workers=1)  # prepares what all share
    cpu, wall = time.process_time(), time.perf_counter()
    grasps = plan_grasps(loaded, [CHEAP], count, workers=1)
    return {
        "x": count,
        "found": sum(row["found"] for row in grasps),
        "cpu_s": time.process_time() - cpu,
        "wall_s": time.perf_counter() - wall,
        "peak_memory_mb": _peak_memory_mb(),
    }


def _peak_memory_mb() -> float:
    """Most memory that this process ever had in use, MB."""
    most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return most / (1024.0**2 if sys.platform == "darwin" else 1024.0)  # bytes there, KiB elsewhere


def _workers(hand: str, count: int, n: int) -> Point:
    times: list[float] = []
    batch = n * GRASPS_PER_REQUEST
    plan_grasps(
        loaded_hand(hand),
        [CHEAP],
        batch,
        workers=count,
        progress=lambda now: times.append(now.elapsed_s),
    )
    half = len(times) // 2
    return {
        "x": count,
        "grasps": batch,
        "wall_s": times[-1],
        "first_s": times[1],
        "grasps_per_s": (len(times) - 1 - half) / (times[-1] - times[half]),
    }


def points_of(name: str, most_grasps: int, cores: int) -> list[int]:
    """Where a curve is measured: contacts, subdivisions, grasps or workers.

    Args:
        name: Out of ``CURVES``.
        most_grasps: Where the curve of grasps ends.
        cores: Where that of workers ends.
    """
    tens = [10**k for k in range(len(str(most_grasps))) if 10**k < most_grasps]
    return {
        "contacts": list(range(2, 9)),
        "triangles": list(range(1, 7)),
        "grasps": [*tens, most_grasps],
        "workers": list(range(1, cores + 1)),
    }[name]


_MEASURED: dict[str, tuple[Callable[[str, int, int], Point], tuple[str, ...]]] = {
    "grasps": (_grasps, ("cpu_s", "wall_s", "peak_memory_mb")),
    "workers": (_workers, ("grasps_per_s",)),
    "contacts": (_contacts, ("cpu_s_per_attempt", "cpu_s_per_found", "prepare_cpu_s")),
    "triangles": (_triangles, ("cpu_s_per_attempt", "cpu_s_per_found", "prepare_cpu_s")),
}
"""How a point of each curve is measured, and of what in it a law is fitted. Grasps come first: the
peak of memory is the process's since it began."""

CURVES = tuple(_MEASURED)
"""Names of the curves."""


def curve(name: str, points: Sequence[Point]) -> Row:
    """A curve with its laws, as plain data.

    Args:
        name: Out of ``CURVES``.
        points: Its points. Those of workers are given their efficiency: the rate over that of as
            many times the one worker alone.
    """
    points = [dict(p) for p in points]
    if name == "workers":
        alone = next((p["grasps_per_s"] for p in points if p["x"] == 1), None)
        for p in points:
            p["efficiency"] = None if alone is None else p["grasps_per_s"] / (p["x"] * alone)
    laws = {}
    for value in _MEASURED[name][1]:
        known = [p for p in points if p.get("fitted", True) and p[value] is not None]
        law = power_law([p["x"] for p in known], [p[value] for p in known])
        laws[value] = None if law is None else asdict(law)
    return {"name": name, "points": points, "laws": laws}


def run_scaling(
    hand: str,
    curves: Sequence[str],
    n: int,
    *,
    most_grasps: int,
    runner: Runner,
) -> Row:
    """Measure curves point by point, in this process, whose memory and time are asked for.

    Args:
        hand: Name or path; the curve of contacts has hands of its own.
        curves: Names out of ``CURVES``.
        n: Requests per point of contacts and triangles; workers plan ten times as many.
        most_grasps: Where the curve of grasps ends.
        runner: Who works.

    Raises:
        NotFoundError: There is no such curve.
        PlannerError: The hand cannot be used, or a batch needs a library that is missing.
    """
    for name in curves:
        if name not in CURVES:
            raise NotFoundError("curve", name, CURVES)
    loaded_hand(hand)
    cores = os.cpu_count() or 1
    every = [(name, x) for name in curves for x in points_of(name, most_grasps, cores)]
    jobs = [_PointJob(index=i, curve=c, x=x, hand=hand, n=n) for i, (c, x) in enumerate(every)]
    result = measure(
        replace(runner, workers=1),
        _made,
        jobs,
        kind="opposable-bench-scaling",
        title="measure",
        lost=_PointJob.lost,
        hand=hand,
        requests=n,
    )
    points: dict[str, list[Point]] = {name: [] for name in curves}
    for row in result.pop("rows"):
        points[row["curve"]].append(row["point"])
    return result | {"curves": [curve(name, points[name]) for name in points]}


@dataclass(frozen=True, kw_only=True)
class _PointJob(Job):
    """A point of a curve."""

    SHOWN: ClassVar = ("curve",)

    curve: str
    x: int
    hand: str
    n: int


def _made(job: _PointJob, check: Check) -> Row:
    point = _MEASURED[job.curve][0](job.hand, job.x, job.n)
    check()
    return job.row(point=point)


def scaling_tables(result: Row) -> list[Table]:
    """One table per curve: its points, and the exponents below."""
    return [_table(item) for item in result["curves"] if item["points"]]


def _table(item: Row) -> Table:
    columns = tuple(k for k in item["points"][0] if k not in ("x", "fitted"))
    table = table_of(item["name"], (), ("x", *columns))
    for point in item["points"]:
        table.add_row(
            str(point["x"]) + ("" if point.get("fitted", True) else " soft"),
            *(_shown(point[c]) for c in columns),
        )
    table.add_section()
    laws = [item["laws"].get(c) for c in columns]
    table.add_row("exponent", *("" if law is None else f"{law['exponent']:.2f}" for law in laws))
    table.add_row("spread", *("" if law is None else f"{law['spread']:.2f}" for law in laws))
    return table


def _shown(value: float | None) -> str:
    """A count as it is, another number with three digits after the point."""
    return str(value) if isinstance(value, int) else number(value, 3)
