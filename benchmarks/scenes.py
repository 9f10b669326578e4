"""Other projects' scenes, unchanged, by their own tests of success.

Each runs in its own environment, with its own MuJoCo; see ``scenes_launch``. Here the hand is read
from its scene file, the object from its geoms; a grasp is planned where its reset has put the
object, and executed through its ``step`` alone. Poses, joints and contacts are the true ones
(policies that their authors publish see pictures). ``done`` counts by their own test.

A task is one ``Task`` in a file of its project, and one name in ``TASKS``.
"""

from __future__ import annotations

import gc
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from benchmarks.bench import Options as Shared
from benchmarks.scenes_adroit import HAMMER as ADROIT_HAMMER
from benchmarks.scenes_bucket import BUCKET
from benchmarks.scenes_dexjoco import HAMMER as DEXJOCO_HAMMER
from benchmarks.scenes_glasses import GLASSES
from benchmarks.scenes_mouse import MOUSE
from benchmarks.scenes_task import Served
from benchmarks.scenes_tongs import TONGS
from benchmarks.summary import counted, of, share, summary
from planner.errors import NoGraspFoundError, NotFoundError
from sim.tables import Row

TASKS = {task.name: task for task in (DEXJOCO_HAMMER, TONGS, MOUSE, BUCKET, GLASSES, ADROIT_HAMMER)}
"""By name."""


@dataclass(frozen=True, kw_only=True)
class Options(Shared):
    """Seeds of their own randomness count from ``--seed``."""

    scene: Annotated[Path, typer.Option(help="Checkout of the project.")]
    python: Annotated[Path, typer.Option(help="Python of its environment.")]
    hand: Annotated[
        Path,
        typer.Option(help="hand.toml: opposable hands SCENE --base-body NAME --describe -o it."),
    ]
    task: Annotated[str, typer.Option(help=f"One of {', '.join(TASKS)}.")] = "hammer_nail"


@dataclass(frozen=True, kw_only=True)
class Where:
    """Where the project, its Python and the description of its hand are."""

    scene: Path
    python: Path
    hand: Path


def cases(options: Options) -> Iterator[Row]:
    """Seeds."""
    if options.task not in TASKS:
        raise NotFoundError("task", options.task, TASKS)
    where = Where(scene=options.scene, python=options.python, hand=options.hand)
    for seed in range(options.seed, options.seed + options.n):
        yield {"task": options.task, "seed": seed, "where": where}


def measure(case: Row) -> Row:
    """One start of its own, played once."""
    gc.collect()  # the models of the start before, 250 MB of DexJoCo's, are in reference cycles
    where: Where = case["where"]
    task = TASKS[case["task"]]
    served = Served(task, where.scene, where.python, case["seed"])
    try:
        return task.play(served, where.hand, case["seed"])
    except NoGraspFoundError as error:
        return {"done": False, "ended": "no plan", "detail": str(error)[:200]}
    finally:
        served.close()


def tables(result: Row) -> Iterator[Row]:
    """One line."""
    yield summary(
        "Scenes of others: by their own tests",
        result["rows"],
        ("task",),
        {
            "done": share("done"),
            "steps": of("steps"),
            "depth, mm, least": of("depth_mm", "min", digits=1),
            "slip, mm, most": of("slip_mm", "max", digits=1),
            "plan, CPU s": of("plan_s", digits=1),
            "ended": counted("ended"),
        },
    )
