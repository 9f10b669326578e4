"""``run_exports``: plans through every format that is read and written, and what comes back.

Each cell of a hand and an object becomes one file per format, or one per grasp where a format
holds no more. What is compared is what ``GivenGrasp`` says: the pose of the hand's base in the
frame of the object's file, joints at the grasp, and joints before and after it where the format has
them. Joints without names are read in the order in which they were written.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, ClassVar

import numpy as np
from rich.table import Table

from benchmarks.objects import BenchObject
from benchmarks.requests import Setting, check_tasks, loaded_hand, task_for
from benchmarks.run import ObjectJob, measure
from planner.errors import PlannerError
from planner.exchange import GivenGrasp, Reading, export_plans
from planner.exchange.formats import FORMATS, GraspFormat, format_named, load_formats
from planner.exchange.joints import T_object_body
from planner.plan import GraspPlan
from planner.search import plan_grasp
from planner.spatial import rotation_angle
from sim.runner import Check, Runner
from sim.tables import Row, grouped, number, share, table_of

LIMIT = 1e-6
"""Largest error (m, rad) with which a grasp counts as brought back."""

ERRORS = ("position_m", "rotation_rad", "q_rad", "pregrasp_rad")
"""What is compared, with its unit; joints of slides are in m."""


@dataclass(frozen=True, kw_only=True)
class _Cell(ObjectJob):
    """Plans of one hand and object, and the formats they go through."""

    SHOWN: ClassVar = ("hand", "label")

    n: int
    seed: int
    formats: tuple[str, ...]

    def lost(self, reason: str) -> Row:
        """The row of a cell without plans."""
        return self.row(error=reason, planned=0, trips=[])


def round_trip_formats() -> tuple[str, ...]:
    """Names of the formats with a reader and a writer."""
    load_formats()
    return tuple(f.name for f in FORMATS.values() if f.read is not None and f.write is not None)


def run_exports(
    hands: Sequence[str],
    objects: Sequence[BenchObject],
    n: int,
    *,
    formats: Sequence[str],
    seed: int,
    runner: Runner,
) -> Row:
    """Send n plans, spread evenly over hands and objects, through formats and back.

    Raises:
        NotFoundError: There is no such format.
        PlannerError: A hand or an object cannot be used.
    """
    for name in formats:
        format_named(name)
    check_tasks(hands, objects)
    cells = [(hand, item) for hand in hands for item in objects]
    jobs = [
        _Cell(
            index=i,
            hand=hand,
            spec=item.spec,
            label=item.label,
            n=n // len(cells) + (i < n % len(cells)),
            seed=seed,
            formats=tuple(formats),
        )
        for i, (hand, item) in enumerate(cells)
    ]
    result = measure(
        runner,
        _measured,
        [job for job in jobs if job.n],
        kind="opposable-bench-exports",
        title="plan and export",
        lost=_Cell.lost,
        hands=list(hands),
        objects=[item.spec for item in objects],
        number=n,
        seed=seed,
        limit=LIMIT,
    )
    rows = result["rows"]
    trips = [trip for row in rows for trip in row["trips"]]
    return result | {
        "planned": sum(row["planned"] for row in rows),
        "formats": [_summary(name, t) for (name,), t in grouped(trips, "format").items()],
    }


def _measured(job: _Cell, check: Check) -> Row:
    task = task_for(job.hand, job.spec, Setting())
    if isinstance(task, str):
        return job.lost(task)
    plans = []
    for k in range(job.n):
        check()
        try:
            plans.append(plan_grasp(task, seed=job.seed + k))
        except PlannerError as error:
            return job.lost(str(error))
    trips = [_trip(format_named(name), plans) for name in job.formats]
    check()
    return job.row(error="", planned=len(plans), trips=trips) | {"hand": loaded_hand(job.hand).name}


def _trip(there: GraspFormat, plans: Sequence[GraspPlan]) -> Row:
    """Plans through one format and back: errors of each, CPU time (s) and size (bytes)."""
    trip: Row = {"format": there.name, "asked": len(plans), "refused": "", "errors": []}
    assert there.read is not None  # of round_trip_formats, or refused below
    hand = plans[0].task.hand
    with TemporaryDirectory(prefix="opposable-") as folder:
        path = Path(folder) / f"grasps{there.suffixes[0] if there.suffixes else ''}"
        begin = time.process_time()
        try:
            export_plans(plans, path, there.name)
            written = time.process_time()
            given = there.read(path, hand, Reading(by_number=True)).grasps
        except PlannerError as error:
            return trip | {"refused": str(error)}
        trip["write_s"], trip["read_s"] = written - begin, time.process_time() - written
        files = [path] if path.is_file() else [f for f in path.rglob("*") if f.is_file()]
        trip["bytes"] = sum(f.stat().st_size for f in files)
    if len(given) != len(plans):
        return trip | {"refused": f"{len(given)} grasps came back of {len(plans)}"}
    trip["errors"] = [_errors(*pair) for pair in zip(plans, given, strict=True)]
    return trip


def _errors(plan: GraspPlan, given: GivenGrasp) -> dict[str, float | None]:
    """How far what came back is from the plan."""
    wanted, found = T_object_body(plan), given.T_object_base
    opened = given.q_pregrasp
    return {
        "position_m": float(np.linalg.norm(wanted.translation - found.translation)),
        "rotation_rad": rotation_angle(wanted.rotation.T @ found.rotation),
        "q_rad": float(np.abs(plan.q - given.q).max()),
        "pregrasp_rad": None if opened is None else float(np.abs(plan.q_pregrasp - opened).max()),
    }


def _summary(name: str, trips: Sequence[Row]) -> Row:
    """What a format did over all cells; the worst of each error."""
    errors = [error for trip in trips for error in trip["errors"]]
    worst: dict[str, Any] = {
        key: max((e[key] for e in errors if e[key] is not None), default=None) for key in ERRORS
    }
    there = [trip for trip in trips if not trip["refused"]]
    count = max(len(errors), 1)
    return {
        "format": name,
        "asked": sum(trip["asked"] for trip in trips),
        "back": len(errors),
        "within": sum(all((v or 0.0) <= LIMIT for v in e.values()) for e in errors),
        **worst,
        "write_ms": 1e3 * sum(trip["write_s"] for trip in there) / count,
        "read_ms": 1e3 * sum(trip["read_s"] for trip in there) / count,
        "bytes": sum(trip["bytes"] for trip in there) / count,
        "refused": sorted({trip["refused"] for trip in trips if trip["refused"]}),
    }


def export_tables(result: Row) -> list[Table | str]:
    """A line per format; what was refused and what was not planned below."""
    table = table_of(
        f"{result['planned']} plans written and read again; largest errors; CPU per grasp",
        ("format",),
        (
            *("back", f"within {result['limit']:g}", "position m", "rotation rad", "joints rad"),
            *("pre-grasp rad", "write ms", "read ms", "bytes"),
        ),
    )
    for row in result["formats"]:
        table.add_row(
            row["format"],
            f"{row['back']}/{row['asked']}",
            share([True] * row["within"] + [False] * (row["asked"] - row["within"])),
            *("-" if row[key] is None else f"{row[key]:.1e}" for key in ERRORS),
            *(number(row[key], 2) for key in ("write_ms", "read_ms")),
            number(row["bytes"], 0),
        )
    said = [
        f"{row['format']} refused: {text}" for row in result["formats"] for text in row["refused"]
    ]
    said += [f"{r['hand']}, {r['object']}: {r['error']}" for r in result["rows"] if r["error"]]
    return [table, *said]
