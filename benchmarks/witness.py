"""``run_witness``: grasps that hold in MuJoCo, held by their commands alone in Drake.

Each plan is exported (``sim.scene_export``), and the export is held for 2 s under gravity by the
check that ships with it, in MuJoCo, and in Drake (``sim.protocols.drake``).
"""

from __future__ import annotations

import statistics
import tempfile
import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from rich.table import Table

from benchmarks.objects import BenchObject
from benchmarks.requests import Setting, check_tasks, task_for
from benchmarks.run import ObjectJob, measure
from planner.errors import PlannerError, TaskError
from planner.search import plan_grasp
from sim.physics import PhysicsOptions
from sim.protocols.drake import hold_in_drake
from sim.protocols.drake_scene import drake_missing
from sim.runner import Check, Runner
from sim.scene_export import export_scene
from sim.scene_export.check import hold
from sim.tables import Row, grouped, share, table_of

FORMAT = "opposable-bench-witness"


@dataclass(frozen=True, kw_only=True)
class WitnessJob(ObjectJob):
    """One seed of a hand and an object.

    Attributes:
        seed: Seed of planning.
        physics: How MuJoCo computes; Drake takes the friction alone.
    """

    SHOWN: ClassVar = ("hand", "label", "seed")
    NOTHING: ClassVar[Row] = {"found": False, "reason": "", "plan_cpu_s": None} | {
        f"{engine}_{name}": None
        for engine in ("mujoco", "drake")
        for name in ("held", "mm", "deg", "cpu_s")
    }

    seed: int
    physics: PhysicsOptions

    def row(self, **values: object) -> Row:
        """The row: what is not given stands for a grasp that was not found."""
        return super().row(**{**self.NOTHING, **values})

    def lost(self, reason: str) -> Row:
        """The row of a seed that could not be tried."""
        return self.row(reason=reason)


def plan_and_witness(job: WitnessJob, check: Check) -> Row:
    """Plan, export and hold one seed in both engines."""
    task = task_for(job.hand, job.spec, Setting())
    if isinstance(task, str):
        return job.lost(task)
    begin = time.process_time()
    try:
        plan = plan_grasp(task, seed=job.seed, progress=lambda _: check())
        planned = time.process_time()
        with tempfile.TemporaryDirectory() as made:
            folder = Path(made) / "scene"
            export_scene(plan, folder, physics=job.physics)
            exported = time.process_time()
            held, mm, deg = hold(folder / "scene.xml")
            stepped = time.process_time()
            other = hold_in_drake(folder)
    except PlannerError as error:
        return job.lost(str(error))
    return job.row(
        found=True,
        reason="" if other.held else other.detail,
        plan_cpu_s=planned - begin,
        mujoco_held=held,
        mujoco_mm=mm,
        mujoco_deg=deg,
        mujoco_cpu_s=stepped - exported,
        drake_held=other.held,
        drake_mm=float(other.moved_mm[-1]),
        drake_deg=float(other.turned_deg[-1]),
        drake_cpu_s=time.process_time() - stepped,
    )


def run_witness(
    hands: Sequence[str],
    objects: Sequence[BenchObject],
    n: int,
    *,
    seed: int,
    physics: PhysicsOptions,
    runner: Runner,
) -> Row:
    """Plan and hold n seeds of each hand and object (``benchmarks``).

    Raises:
        TaskError: Drake is not installed.
    """
    if reason := drake_missing():
        raise TaskError(reason)
    check_tasks(hands, objects)
    cells = [(hand, item, seed + k) for hand in hands for item in objects for k in range(n)]
    jobs = [
        WitnessJob(
            index=k, hand=hand, spec=item.spec, label=item.label, seed=number, physics=physics
        )
        for k, (hand, item, number) in enumerate(cells)
    ]
    return measure(
        runner,
        plan_and_witness,
        jobs,
        kind=FORMAT,
        title="witness",
        lost=WitnessJob.lost,
        physics=physics.to_dict(),
    )


COLUMNS = ("plans", "MuJoCo", "Drake", "both", "mm", "mm Drake", "CPU s", "CPU s Drake")


def witness_tables(result: Row) -> Iterable[Table | str]:
    """Held per hand and object in each engine and in both; then every plan that Drake lost."""
    table = table_of(
        "held for 2 s by position commands alone; medians of movement and CPU",
        ("hand", "object"),
        COLUMNS,
    )
    rows = sorted(result["rows"], key=lambda r: (r["hand"], r["object"]))
    for cell, members in grouped(rows, "hand", "object").items():
        table.add_row(*cell, *_cells(members))
    table.add_section()
    table.add_row("all", "", *_cells(rows))
    yield table
    for row in rows:
        if row["reason"]:
            yield f"{row['hand']} {row['object']} seed {row['seed']}: {row['reason']}"


def _cells(rows: list[Row]) -> list[str]:
    found = [row for row in rows if row["found"]]

    def median(name: str, digits: int) -> str:
        known = [row[name] for row in found if row[name] is not None]
        return f"{statistics.median(known):.{digits}f}" if known else "-"

    return [
        f"{len(found)} of {len(rows)}",
        share(row["mujoco_held"] for row in found),
        share(row["drake_held"] for row in found),
        share(row["mujoco_held"] and row["drake_held"] for row in found),
        median("mujoco_mm", 2),
        median("drake_mm", 2),
        median("mujoco_cpu_s", 2),
        median("drake_cpu_s", 2),
    ]
