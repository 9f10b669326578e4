"""``plan_grasps``: many grasps of many objects, on all cores, into a folder."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from shutil import rmtree
from tempfile import mkdtemp
from typing import Any
from weakref import finalize

from planner.batch.dataset import GraspSet
from planner.batch.jobs import BatchObject, batch_jobs
from planner.batch.manifest import Manifest, ManifestObject
from planner.batch.pool import check_backend, default_backend, planned_rows
from planner.batch.recipe import Recipe, label_of, recipe_of, task_of
from planner.batch.rows import grasp_schema
from planner.batch.store import Store
from planner.errors import TaskError, shown
from planner.hand_loading import load_hand
from planner.hands.hand import Hand
from planner.objects import GraspObject
from planner.search import DEFAULT_MAX_ATTEMPTS
from planner.synthesis.options import SynthesisOptions
from planner.task import GraspTask
from planner.version import written_by


@dataclass(frozen=True, kw_only=True)
class BatchProgress:
    """How far a batch is.

    Attributes:
        total: Requested grasps.
        done: Planned grasps, found or not.
        kept: Grasps planned by earlier runs.
        found: Grasps that this run found.
        elapsed_s: Time since this run began, s.
    """

    total: int
    done: int
    kept: int
    found: int
    elapsed_s: float

    @property
    def rate(self) -> float:
        """Requests of this run per second of time, 1/s."""
        return (self.done - self.kept) / self.elapsed_s if self.elapsed_s > 0 else 0.0


def plan_grasps(
    hand: Hand | str | Path,
    objects: Sequence[str | GraspObject | GraspTask],
    n: int,
    *,
    seed: int = 0,
    workers: int = -1,
    backend: str | None = None,
    out: Path | str | None = None,
    options: SynthesisOptions | None = None,
    max_attempts: int = DEFAULT_MAX_ATTEMPTS,
    max_cpu_s: float | None = None,
    progress: Callable[[BatchProgress], None] | None = None,
) -> GraspSet:
    """Plan n grasps of each object; grasp k of an object depends on seed, its shape and k alone.

    Args:
        hand: The hand, its name, or the path of its description.
        objects: Objects, specifications such as "box:0.05x0.05x0.08", or whole tasks with this
            hand, for other friction, fingers or surroundings. A request is searched for as
            ``plan_grasp`` does, compiled from the first attempt: its row's seed gives the same plan
            there, to the bit within ``planner.compiled_searches``.
        n: Grasps per object.
        seed: Same seed, same grasps, for any number of workers.
        workers: Processes (or what the backend has); -1 for one per core, 1 for this process.
        backend: joblib's name of a backend, or "fork": workers begin as copies of this process, in
            milliseconds. None for "fork" on Linux while no other thread runs Python, else "loky".
            Threads take turns, so they are no faster than one.
        out: Folder of the dataset; a batch that is there goes on. A temporary one if None, which
            lives as long as the result.
        options: Margins, weights and objectives of the search.
        max_attempts: Attempts per grasp before it counts as not found.
        max_cpu_s: CPU seconds per grasp before it counts as not found, looked at between attempts;
            which grasps are found then depends on the machine. None for no limit.
        progress: Called at the beginning and after every grasp.

    Returns:
        The grasps, read from disk as they are asked for.

    Raises:
        PlannerError: Bad input; no Parquet library; a folder with another batch.
        KeyboardInterrupt: Ctrl-C; what was planned is kept, and the same call goes on.
    """
    tasks = _tasks(hand, objects)
    for name, value, least in (("n", n, 1), ("seed", seed, 0), ("max_attempts", max_attempts, 1)):
        if isinstance(value, bool) or not isinstance(value, int) or value < least:
            raise TaskError(f"{name} is {shown(value)}; give an integer >= {least}")
    if max_cpu_s is not None and not max_cpu_s > 0:
        raise TaskError(f"max_cpu_s is {max_cpu_s}; give seconds > 0, or None for no limit")
    if isinstance(workers, bool) or not isinstance(workers, int) or workers == 0:
        raise TaskError(f"workers is {shown(workers)}; give their number, or -1 for one per core")
    items = [BatchObject.of(label, task) for label, task in tasks.items()]
    loaded = next(iter(tasks.values())).hand
    schema = grasp_schema(loaded)
    manifest = Manifest(
        written_by=written_by(),
        hand=loaded.name,
        joint_names=list(loaded.joint_names),
        n=n,
        seed=seed,
        max_attempts=max_attempts,
        max_cpu_s=max_cpu_s,
        options=(options or SynthesisOptions()).to_dict(),
        objects=[
            ManifestObject(label=label, **dict(Recipe.of(task))) for label, task in tasks.items()
        ],
    )
    backend = default_backend(workers) if backend is None else backend
    check_backend(backend, workers)
    folder = Path(mkdtemp(prefix="opposable-")) if out is None else Path(out)
    try:
        with Store(folder, manifest, schema) as store:
            jobs = batch_jobs(
                items, n, seed, lambda i: not store.has(i), max_attempts, options, max_cpu_s
            )
            _fill(store, planned_rows(jobs, workers, backend), progress)
        grasps = GraspSet(folder)
    except BaseException:
        if out is None:
            rmtree(folder)
        raise
    if out is None:
        finalize(grasps, rmtree, folder)
    return grasps


def _fill(
    store: Store,
    rows: Iterable[dict[str, Any]],
    progress: Callable[[BatchProgress], None] | None,
) -> None:
    """Store rows as they come, and report progress."""
    kept, found, begin = len(store), 0, time.monotonic()

    def report() -> None:
        if progress is not None:
            progress(
                BatchProgress(
                    total=store.manifest.total,
                    done=len(store),
                    kept=kept,
                    found=found,
                    elapsed_s=time.monotonic() - begin,
                )
            )

    report()
    for row in rows:
        store.add(row)
        found += row["found"]
        report()


def _tasks(
    hand: Hand | str | Path, objects: Sequence[str | GraspObject | GraspTask]
) -> dict[str, GraspTask]:
    """The tasks by the labels of their objects.

    They are made from their own text, as workers make them, so that a task without a text is
    refused here.
    """
    if isinstance(objects, str | GraspObject | GraspTask):
        raise TaskError(f"objects is {shown(objects)}; give a list, even of one")
    hand = hand if isinstance(hand, Hand) else load_hand(hand)
    tasks: dict[str, GraspTask] = {}
    for item in objects:
        task = item if isinstance(item, GraspTask) else GraspTask.create(hand, item)
        if task.hand.digest != hand.digest:
            raise TaskError(
                f"the task {task!r} is for another hand than {hand.name}; a batch has one hand"
            )
        label = label_of(task)
        if label in tasks:
            raise TaskError(
                f"two objects are called {label!r}; give a GraspObject another name, or ask for "
                "more grasps of one"
            )
        tasks[label] = task_of(recipe_of(task))
    if not tasks:
        raise TaskError("there are no objects; name at least one")
    return tasks
