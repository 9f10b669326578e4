"""Write plans in every format of other tools, read them again, and measure the errors.

Each cell of a hand and an object becomes one file per format, or one per grasp where a format holds
no more. What is compared is what ``ImportedGrasp`` says: the pose of the hand's base in the frame
of the object's file, joints at the grasp, and joints before and after it where the format has them.
Joints without names are read in the order in which they were written.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated

import numpy as np
import typer

from benchmarks.bench import HandOptions, ObjectsOption
from benchmarks.common import cells_of, known, task_of
from benchmarks.summary import flat, largest, parts, ratio, summary
from planner.errors import PlannerError
from planner.exchange import ImportedGrasp, Reading, export_plans
from planner.exchange.formats import FORMATS, format_named, load_formats
from planner.exchange.joints import T_object_body
from planner.plan import GraspPlan
from planner.search.grasp import plan_grasp
from planner.spatial import rotation_angle
from sim.tables import Row

LIMIT = 1e-6
"""Largest error (m, rad) with which a grasp counts as brought back."""


@dataclass(frozen=True, kw_only=True)
class Options(HandOptions):
    """Plans, spread evenly over hands and objects."""

    n: Annotated[
        int, typer.Option("-n", "--number", min=1, help="Plans in all, spread evenly.")
    ] = 100
    objects: ObjectsOption = "sphere,box,cylinder,mug,lbracket"
    formats: Annotated[
        str, typer.Option(help="Formats, comma separated; all that are read and written.")
    ] = "all"


def cases(options: Options) -> Iterator[Row]:
    """Hands and objects, each with its plans and all formats."""
    load_formats()
    able = [f.name for f in FORMATS.values() if f.read is not None and f.write is not None]
    chosen = known("format that is read and written", options.formats, able)
    cells = list(cells_of(options.hand_names, options.objects))
    for i, cell in enumerate(cells):
        n = options.n // len(cells) + (i < options.n % len(cells))
        if n:
            yield {**cell, "n": n, "seed": options.seed, "formats": chosen}


def measure(case: Row) -> Row:
    """Plans of one hand and object, through each format and back."""
    task = task_of(case["hand"], case["spec"])
    plans = [plan_grasp(task, seed=case["seed"] + k) for k in range(case["n"])]
    trips = [_trip(name, plans) for name in case["formats"]]
    return {"planned": len(plans), "trips": trips}


def _trip(name: str, plans: Sequence[GraspPlan]) -> Row:
    """Plans through one format and back: errors of each, CPU time (s) and size (bytes)."""
    load_formats()
    there = format_named(name)
    trip: Row = {"format": name, "asked": len(plans), "back": 0, "within": 0, "refused": ""}
    assert there.read is not None  # of those that are asked for
    with TemporaryDirectory(prefix="opposable-") as folder:
        path = Path(folder) / f"grasps{there.suffixes[0] if there.suffixes else ''}"
        begin = time.process_time()
        try:
            export_plans(plans, path, name)
            written = time.process_time()
            given = there.read(path, plans[0].task.hand, Reading(by_number=True)).grasps
        except PlannerError as error:
            return trip | {"refused": str(error)}
        trip["write_s"], trip["read_s"] = written - begin, time.process_time() - written
        files = [path] if path.is_file() else [f for f in path.rglob("*") if f.is_file()]
        trip["bytes"] = sum(f.stat().st_size for f in files)
    if len(given) != len(plans):
        return trip | {"refused": f"{len(given)} grasps came back of {len(plans)}"}
    errors = [_errors(*pair) for pair in zip(plans, given, strict=True)]
    worst = {key: [e[key] for e in errors if e[key] is not None] for key in errors[0]}
    trip["within"] = sum(all((v or 0.0) <= LIMIT for v in e.values()) for e in errors)
    return trip | {"back": len(errors), **worst}


def _errors(plan: GraspPlan, given: ImportedGrasp) -> dict[str, float | None]:
    """How far what came back is from the plan, m and rad; joints of slides are in m."""
    wanted, found = T_object_body(plan), given.T_object_base
    opened = given.q_pregrasp
    return {
        "position_m": float(np.linalg.norm(wanted.translation - found.translation)),
        "rotation_rad": rotation_angle(wanted.rotation.T @ found.rotation),
        "q_rad": float(np.abs(plan.q - given.q).max()),
        "pregrasp_rad": None if opened is None else float(np.abs(plan.q_pregrasp - opened).max()),
    }


def tables(result: Row) -> Iterator[Row | str]:
    """A line per format; what was refused below."""
    trips = flat(result["rows"], "trips")
    yield summary(
        f"{sum(row.get('planned', 0) for row in result['rows'])} plans written and read again; "
        "largest errors; CPU per grasp",
        trips,
        ("format",),
        {
            "back": parts("back", "asked"),
            f"within {LIMIT:g}": parts("within", "asked"),
            "position m": largest("position_m"),
            "rotation rad": largest("rotation_rad"),
            "joints rad": largest("q_rad"),
            "pre-grasp rad": largest("pregrasp_rad"),
            "write ms": ratio("write_s", "back", 2, 1e3),
            "read ms": ratio("read_s", "back", 2, 1e3),
            "bytes": ratio("bytes", "back", 0),
        },
    )
    refused = {f"{t['format']} refused: {t['refused']}": None for t in trips if t["refused"]}
    yield from refused
