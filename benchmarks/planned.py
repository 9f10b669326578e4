"""``PlannedJob``: one question to one planned grasp; the jobs of ``control`` and ``physics``."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any, TypeVar

from benchmarks.objects import BenchObject
from benchmarks.requests import Setting, check_tasks, loaded_hand, task_for
from benchmarks.run import ObjectJob, measure
from planner.errors import PlannerError
from planner.plan import GraspPlan
from planner.search import plan_grasp
from sim.reality import Reality
from sim.runner import Check, Runner
from sim.tables import Row


@dataclass(frozen=True, kw_only=True)
class PlannedJob(ObjectJob):
    """A part of a measurement for one grasp.

    Attributes:
        part: Name of the part.
        plan_seed: Seed of planning.
        reality: Errors of sensors, drives and object in trials, with the seed of the job.
    """

    part: str
    plan_seed: int = 0
    reality: Reality = field(default_factory=Reality)


SomeJob = TypeVar("SomeJob", bound=PlannedJob)


def ask(
    job: PlannedJob,
    check: Check,
    question: Callable[[GraspPlan], Mapping[str, Any]],
    *,
    whole_hand: bool = False,
) -> Row:
    """The row of a job: what a question to its grasp gives, or why there is no grasp.

    Args:
        job: Which.
        check: Called before and after the question; what it raises ends it.
        question: What is measured: plain data.
        whole_hand: Whether all fingers of the hand must take part.
    """
    plan = _plan(job.hand, job.spec, job.plan_seed, whole_hand)
    check()
    if isinstance(plan, str):
        return job.lost(plan)
    answer = question(plan)
    check()
    return job.row(**{"error": "", **answer})


@lru_cache(maxsize=2)
def _plan(hand: str, spec: str, seed: int, whole_hand: bool) -> GraspPlan | str:
    """A plan, made once for the jobs that follow each other; or why there is none."""
    fingers = tuple(loaded_hand(hand).fingers) if whole_hand else None
    task = task_for(hand, spec, Setting(fingers=fingers))
    if isinstance(task, str):
        return task
    try:
        return plan_grasp(task, seed=seed)
    except PlannerError as error:
        return str(error)


def run_parts(
    runner: Runner,
    work: Callable[[SomeJob, Check], Row],
    jobs: Sequence[SomeJob],
    hands: Sequence[str],
    objects: Sequence[BenchObject],
    *,
    kind: str,
    title: str,
    file: Path,
    drawn: Row,
    **told: Any,
) -> Row:
    """Measure what the file does not have yet; it goes on with other parts and more grasps.

    Args:
        runner: Who works.
        work: Makes the row of a job.
        jobs: All jobs; their numbers do not depend on the parts that are asked for.
        hands: Names or paths.
        objects: The objects.
        kind: Format of the result.
        title: What the progress bar says.
        file: Of the rows; made if it is not there.
        drawn: What else the file's rows follow from.
        **told: What else stands in the result.

    Raises:
        FileFormatError: The file is not one of these, or was begun with other arguments.
        PlannerError: A hand or an object that was named cannot be used.
    """
    check_tasks(hands, objects)
    asked = {"format": f"{kind}-rows", "version": 1, "hands": list(hands)}
    asked |= {"objects": [item.spec for item in objects], **drawn}
    return measure(
        runner,
        work,
        jobs,
        kind=kind,
        title=title,
        lost=PlannedJob.lost,
        file=file,
        asked=asked,
        **told,
    )
