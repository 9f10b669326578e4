"""Exports batches, has DexGraspBench evaluate them, and runs our protocol of that name on them."""

from __future__ import annotations

import hashlib
import shutil
import statistics
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.table import Table

from benchmarks.dexgraspbench.checkout import Installed
from benchmarks.run import Job, measure
from planner.batch import GraspSet
from planner.errors import PlannerError, TaskError
from planner.exchange.dexgraspbench import export_dexgraspbench
from planner.exchange.dexgraspbench.models import file_name
from sim.protocols.dexgraspbench import dexgraspbench_cases
from sim.runner import Check, Runner
from sim.tables import Row, grouped, share, table_of

SETTINGS = ("fc", "tabletop")
"""The benchmark's settings for hands without an arm."""


@dataclass(frozen=True, kw_only=True)
class _GraspJob(Job):
    """A grasp of a batch, and what the benchmark says of it.

    Attributes:
        batch: Folder of the batch.
        number: Number of its row there.
        verdict: Row of the result: "verdicts" by setting, how far the object "moved_mm" and
            "turned_deg" against what was asked, "penetration_mm" of hand in object at the grasp.
        compare: Whether our own protocol judges it as well ("ours", None if not).
    """

    batch: str
    number: int
    verdict: Row
    compare: bool

    def row(self, **values: Any) -> Row:
        """The benchmark's verdict and ours."""
        return super().row(**self.verdict, row=self.number, **values)

    def lost(self, reason: str) -> Row:
        """End: a grasp without a verdict is no disagreement."""
        raise PlannerError(f"grasp {self.number} of {self.batch} {reason}; report it")


def run_dexgraspbench(
    installed: Installed,
    batches: Sequence[Path],
    home: Path,
    *,
    settings: Sequence[str] = SETTINGS,
    compare: bool = True,
    runner: Runner,
) -> Row:
    """Evaluate batches; the same call after an end goes on, Ctrl-C keeps what is compared.

    Args:
        installed: The benchmark.
        batches: Folders of batches, whose hands have different names or are the same.
        home: Folder for the export and the benchmark's own results.
        settings: Which of ``SETTINGS``.
        compare: Whether our protocol ``dexgraspbench`` judges the same grasps.
        runner: Who works, and in how many processes.

    Raises:
        PlannerError: A batch cannot be read or exported, or the benchmark fails.
    """
    home = home.resolve()
    exports: dict[str, Row] = {}
    jobs: list[_GraspJob] = []
    for folder in batches:
        batch = GraspSet(folder)
        done = export_dexgraspbench(batch, home / "export")
        if done.hand in exports:
            raise TaskError(
                f"two batches are of the hand {done.hand}, in {exports[done.hand]['batch']} and "
                f"{folder}; give one batch with all objects"
            )
        model = installed.opened(home / "export" / "hand" / done.hand / f"{done.hand}.xml")
        exports[done.hand] = {
            "batch": str(folder),
            "written": done.written,
            "left_out": dict(done.left_out),
            "mujoco": model["mujoco"],
        }
        rows = {
            name: _evaluated(installed, home, done.hand, name, runner.workers) for name in settings
        }
        for label in batch.labels:
            for number, row in batch.found(label):
                file = f"{file_name(label)}/{row['k']}.npy"
                here = {name: rows[name][file] for name in settings if file in rows[name]}
                if len(here) < len(settings):
                    continue  # left out by the export
                verdict = {
                    "hand": done.hand,
                    "object": label,
                    "k": int(row["k"]),
                    "verdicts": {n: bool(r["succ_flag"]) for n, r in here.items()},
                    "moved_mm": {n: 1e3 * r["delta_pos"] for n, r in here.items()},
                    "turned_deg": {n: r["delta_angle"] for n, r in here.items()},
                    "penetration_mm": 1e3 * next(iter(here.values()))["ho_pene"],
                }
                job = _GraspJob(
                    index=len(jobs),
                    batch=str(folder),
                    number=number,
                    verdict=verdict,
                    compare=compare,
                )
                jobs.append(job)
    return measure(
        runner,
        _judge,
        jobs,
        kind="opposable-dexgraspbench",
        title="protocol dexgraspbench",
        lost=_GraspJob.lost,
        version=2,
        settings=list(settings),
        exports=exports,
    )


def _evaluated(
    installed: Installed, home: Path, hand: str, setting: str, workers: int
) -> dict[str, Row]:
    """The benchmark's rows of an export by file, OBJECT/K.npy; those that are there are kept."""
    export = home / "export"
    out = home / "evaluation" / setting / hand
    note, stamp = out / "export.sha256", _digest(export, hand)
    if not (note.is_file() and note.read_text(encoding="utf-8") == stamp):
        shutil.rmtree(out, ignore_errors=True)
        out.mkdir(parents=True)
        note.write_text(stamp, encoding="utf-8")
    there = len(list((export / "graspdata" / hand).glob("*/*.npy")))
    rows = {row["file"]: row for row in installed.results(out)}
    if len(rows) == there:
        return rows
    installed.evaluate(
        [
            "--config-dir",
            str(export),
            "task=eval",
            f"hand={hand}",
            f"setting={setting}",
            f"n_worker={workers}",
            "skip=True",  # what is in eval_dir already
            "task.analytic_fc_metrics=null",
            f"grasp_dir={export / 'graspdata' / hand}",
            f"eval_dir={out}",
            f"succ_dir={home / 'evaluation' / 'success' / setting / hand}",
            f"log_dir={home / 'evaluation' / 'log' / setting / hand}",
        ]
    )
    rows = {row["file"]: row for row in installed.results(out)}
    if len(rows) != there:
        raise TaskError(
            f"DexGraspBench evaluated {len(rows)} of {there} grasps by {hand} in its setting "
            f"{setting}; its log is in {home / 'evaluation' / 'log' / setting / hand}"
        )
    return rows


def _digest(export: Path, hand: str) -> str:
    """Of the grasps by a hand, their objects and the hand."""
    grasps = export / "graspdata" / hand
    folders = [grasps, export / "hand" / hand]
    folders += [export / "object" / item.name for item in grasps.iterdir()]
    files = sorted(path for folder in folders for path in folder.rglob("*") if path.is_file())
    whole = hashlib.sha256()
    for path in [export / "hand" / f"{hand}.yaml", *files]:
        whole.update(f"{path.relative_to(export)}\n".encode() + path.read_bytes())
    return whole.hexdigest()


def _judge(job: _GraspJob, check: Check) -> Row:
    """Our verdict on a grasp: held in all six directions; it ends at the first that fails."""
    if not job.compare:
        return job.row(ours=None)
    plan = GraspSet(job.batch).plan(job.number)
    held = True
    for case in dexgraspbench_cases():
        held = held and case.run(plan).held
        check()
        if not held:
            break
    return job.row(ours=held)


def dexgraspbench_table(result: Row) -> Table:
    """Shares that hold, penetration and agreement per hand and object, and per hand."""
    settings = result["settings"]
    table = table_of(
        "DexGraspBench: grasps that hold; mm of hand in object, median and worst; same verdict as "
        "our --protocol dexgraspbench",
        ("hand", "object"),
        ("grasps", *(f"{name} %" for name in settings), "mm", "worst", "same"),
    )
    for (hand,), mine in grouped(result["rows"], "hand").items():
        for (label,), members in grouped(mine, "object").items():
            table.add_row(hand, label, *_cells(members, settings))
        table.add_row(hand, "all", *_cells(mine, settings), end_section=True)
    return table


def _cells(rows: list[Row], settings: list[str]) -> list[str]:
    """Cells of one line."""
    depths = [row["penetration_mm"] for row in rows]
    compared = [row for row in rows if row["ours"] is not None and "fc" in settings]
    same = share(row["ours"] == row["verdicts"]["fc"] for row in compared)
    return [
        str(len(rows)),
        *(f"{100 * statistics.mean(r['verdicts'][name] for r in rows):.1f}" for name in settings),
        f"{statistics.median(depths):.2f}",
        f"{max(depths):.2f}",
        same if compared else "-",
    ]
