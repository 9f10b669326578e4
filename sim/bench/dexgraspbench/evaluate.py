"""Exports batches, has DexGraspBench evaluate them, and runs our protocol of that name on them."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from planner.batch import GraspSet
from planner.errors import PlannerError, TaskError
from planner.exchange.dexgraspbench import export_dexgraspbench
from planner.exchange.dexgraspbench.hand_file import file_name
from sim.bench.dexgraspbench.checkout import Installed
from sim.protocols.dexgraspbench import dexgraspbench_cases
from sim.runner import Runner, made_with

__all__ = ["SETTINGS", "BenchGrasp", "run_dexgraspbench"]

SETTINGS = ("fc", "tabletop")
"""The benchmark's settings for hands without an arm."""


@dataclass(frozen=True, kw_only=True)
class BenchGrasp:
    """One grasp.

    Attributes:
        hand: Name in the export.
        object: Label in the batch.
        k: Number of the grasp among those of its object.
        row: Number of its row in the batch.
        verdicts: Setting -> whether the benchmark says that it holds.
        moved_mm: Setting -> movement of the object against what was asked, mm.
        turned_deg: Setting -> its turn, degrees.
        penetration_mm: Hand in object at the grasp, mm, as the benchmark measures.
        ours: Whether ``--protocol dexgraspbench`` says that it holds; None if it was not asked.
    """

    hand: str
    object: str
    k: int
    row: int
    verdicts: dict[str, bool]
    moved_mm: dict[str, float]
    turned_deg: dict[str, float]
    penetration_mm: float
    ours: bool | None


@dataclass(frozen=True, kw_only=True)
class _Job:
    """A grasp for our own protocol."""

    batch: str
    key: tuple[str, str, int]
    row: int


def run_dexgraspbench(
    installed: Installed,
    batches: Sequence[Path],
    home: Path,
    *,
    settings: Sequence[str] = SETTINGS,
    compare: bool = True,
    runner: Runner,
) -> dict[str, Any]:
    """Evaluate batches; Ctrl-C while comparing keeps what is done.

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
    shutil.rmtree(home / "evaluation", ignore_errors=True)
    exports: dict[str, dict[str, Any]] = {}
    grasps: dict[tuple[str, str, int], BenchGrasp] = {}
    jobs: list[_Job] = []
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
                key = (done.hand, label, int(row["k"]))
                grasps[key] = BenchGrasp(
                    hand=done.hand,
                    object=label,
                    k=int(row["k"]),
                    row=number,
                    verdicts={n: bool(r["succ_flag"]) for n, r in here.items()},
                    moved_mm={n: 1e3 * r["delta_pos"] for n, r in here.items()},
                    turned_deg={n: r["delta_angle"] for n, r in here.items()},
                    penetration_mm=1e3 * next(iter(here.values()))["ho_pene"],
                    ours=None,
                )
                jobs.append(_Job(batch=str(folder), key=key, row=number))
    whole = True
    if compare:
        whole = runner.run(
            _judge,
            jobs,
            title="protocol dexgraspbench",
            keep=lambda pair: grasps.update(
                {pair[0]: BenchGrasp(**{**asdict(grasps[pair[0]]), "ours": pair[1]})}
            ),
            given_up=_given_up,
        )
    return {
        "format": "opposable-dexgraspbench",
        "version": 1,
        **made_with(),
        "settings": list(settings),
        "exports": exports,
        "interrupted": not whole,
        "grasps": [asdict(grasp) for grasp in grasps.values()],
    }


def _evaluated(
    installed: Installed, home: Path, hand: str, setting: str, workers: int
) -> dict[str, dict[str, Any]]:
    """The benchmark's rows of an export by file: OBJECT/K.npy."""
    export = home / "export"
    out = home / "evaluation" / setting / hand
    installed.evaluate(
        [
            "--config-dir",
            str(export),
            "task=eval",
            f"hand={hand}",
            f"setting={setting}",
            f"n_worker={workers}",
            "skip=False",
            "task.analytic_fc_metrics=null",
            f"grasp_dir={export / 'graspdata' / hand}",
            f"eval_dir={out}",
            f"succ_dir={home / 'evaluation' / 'success' / setting / hand}",
            f"log_dir={home / 'evaluation' / 'log' / setting / hand}",
        ]
    )
    rows = {row["file"]: row for row in installed.results(out)}
    there = len(list((export / "graspdata" / hand).glob("*/*.npy")))
    if len(rows) != there:
        raise TaskError(
            f"DexGraspBench evaluated {len(rows)} of {there} grasps by {hand} in its setting "
            f"{setting}; its log is in {home / 'evaluation' / 'log' / setting / hand}"
        )
    return rows


def _judge(job: _Job, check: Callable[[], None]) -> tuple[tuple[str, str, int], bool]:
    """Our verdict on a grasp: held in all six directions; it ends at the first that fails."""
    plan = GraspSet(job.batch).plan(job.row)
    held = True
    for case in dexgraspbench_cases():
        held = held and case.run(plan).held
        check()
        if not held:
            break
    return job.key, held


def _given_up(job: _Job, reason: str) -> tuple[tuple[str, str, int], bool]:
    """End: a grasp without a verdict is no disagreement."""
    raise PlannerError(f"grasp {job.row} of {job.batch} {reason}; report it")
