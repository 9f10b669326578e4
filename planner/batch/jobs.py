"""The requests of a batch, each with its own seed, and the function that plans one.

A request's seed follows from the batch's seed, the object's shape and the grasp's number alone.
It does not depend on the worker, the order, or the rest of the batch.
"""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from planner.batch.recipe import recipe_of, task_of
from planner.batch.rows import failed_row, found_row
from planner.errors import NoGraspFoundError, PlannerError
from planner.numerics.kernels import compiled_searches
from planner.plan import GraspPlan
from planner.search import Attempt, plan_grasp
from planner.shapes import Mesh, shape_key
from planner.synthesis.options import SynthesisOptions
from planner.system.environment import on_interrupt
from planner.task import GraspTask


@dataclass(frozen=True, kw_only=True)
class BatchObject:
    """One object of a batch.

    Attributes:
        label: Its name, unique in the batch.
        recipe: Its task as text (``planner.batch.recipe``).
        key: Identity of its shape, hexadecimal (``planner.shapes.shape_key``).
    """

    label: str
    recipe: str
    key: str

    @classmethod
    def of(cls, label: str, task: GraspTask) -> BatchObject:
        """The object of a task."""
        return cls(label=label, recipe=recipe_of(task), key=shape_key(task.object.shape))


@dataclass(frozen=True, kw_only=True)
class Job:
    """One requested grasp, as it is sent to a worker.

    Attributes:
        index: Its number in the batch; rows are sorted by it.
        object: Which object.
        k: Number of the grasp among those of its object.
        seed: Seed of its search.
        max_attempts: Attempts before giving up.
        options: Margins, weights and objectives of the search.
        parent: Process that started the batch.
        max_cpu_s: CPU seconds before giving up; None for no limit.
    """

    index: int
    object: BatchObject
    k: int
    seed: int
    max_attempts: int
    options: SynthesisOptions | None
    parent: int
    max_cpu_s: float | None = None


def grasp_seed(seed: int, key: str, k: int) -> int:
    """Seed of grasp k of the shape with a key: 63 bits from ``numpy.random.SeedSequence``.

    Of a million grasps two share a seed with a chance of 5e-8.
    """
    words = [int(key[i : i + 8], 16) for i in range(0, len(key), 8)]
    state = np.random.SeedSequence(seed, spawn_key=(*words, k)).generate_state(1, np.uint64)
    return int(state[0] >> np.uint64(1))


def batch_jobs(
    objects: Sequence[BatchObject],
    n: int,
    seed: int,
    wanted: Callable[[int], bool],
    max_attempts: int,
    options: SynthesisOptions | None,
    max_cpu_s: float | None = None,
) -> Iterator[Job]:
    """The requests of a batch that are still wanted, object by object, one at a time.

    Args:
        objects: The objects.
        n: Grasps per object.
        seed: Seed of the batch.
        wanted: Whether a request's number is still to be planned.
        max_attempts: Attempts before giving up.
        options: Margins, weights and objectives of the search.
        max_cpu_s: CPU seconds before giving up; None for no limit.
    """
    for number, item in enumerate(objects):
        for k in range(n):
            index = number * n + k
            if wanted(index):
                yield Job(
                    index=index,
                    object=item,
                    k=k,
                    seed=grasp_seed(seed, item.key, k),
                    max_attempts=max_attempts,
                    max_cpu_s=max_cpu_s,
                    options=options,
                    parent=os.getpid(),
                )


def warm_up(job: Job) -> None:
    """Load and compile what planning a job takes, by one attempt at a convex object.

    That is the job's own object or, if that is a mesh, a ball: whatever a job may do to its
    process, it is not done here.
    """
    try:
        task = task_of(job.object.recipe)
        if isinstance(task.object.shape, Mesh):
            task = GraspTask.create(task.hand, "sphere")
        with compiled_searches():
            plan_grasp(task, seed=0, max_attempts=1, options=job.options)
    except PlannerError:
        return  # what was loaded is loaded; the jobs' rows have their own reasons


def plan_row(job: Job) -> dict[str, Any]:
    """Plan one request; a row of ``planner.batch.rows`` whether or not a grasp was found.

    A refusal by the planner (an object too large for the hand) is a row with that reason; only
    faults of the program are raised.
    """
    made: list[Attempt[GraspPlan]] = []
    end_with(job.parent)
    with _undisturbed(job.parent) as check:

        def note(attempt: Attempt[GraspPlan]) -> None:
            made.append(attempt)
            check()

        try:
            task = task_of(job.object.recipe)
            with compiled_searches():
                plan = plan_grasp(
                    task,
                    seed=job.seed,
                    max_attempts=job.max_attempts,
                    max_cpu_s=job.max_cpu_s,
                    options=job.options,
                    progress=note,
                )
        except NoGraspFoundError:
            return failed_row(
                job.index, job.object.label, job.k, job.seed, str(made[-1].failure), made
            )
        except PlannerError as error:
            return failed_row(job.index, job.object.label, job.k, job.seed, str(error), made)
        return found_row(job.index, job.object.label, job.k, plan, made)


@lru_cache(maxsize=1)
def end_with(parent: int) -> None:
    """End this worker when the process that started it is killed.

    By hand: joblib's workers wait for their next job until they time out, minutes later.
    """

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(WATCH_S)
        os._exit(1)

    if os.getppid() == parent:
        threading.Thread(target=watch, daemon=True).start()


WATCH_S = 0.2
"""Period (s) of the check whether that process is alive."""


@contextmanager
def _undisturbed(parent: int) -> Iterator[Callable[[], None]]:
    """Keep Ctrl-C out of a solver, which would call it a failed attempt and go on with the next.

    A worker ignores Ctrl-C: the process that started the batch ends it. That process itself
    notes it and is interrupted between attempts, by the function given here.
    """
    pressed: list[bool] = []

    def check() -> None:
        if pressed:
            raise KeyboardInterrupt

    ours = os.getpid() == parent
    with on_interrupt((lambda *_: pressed.append(True)) if ours else signal.SIG_IGN):
        yield check
    check()
