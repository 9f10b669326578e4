"""``plan_several``: a few grasps of one task as plans, the first found or as different as can be.

Diverse ones are chosen among more that were found, by farthest-point selection: the best comes
first, then again and again the grasp that is farthest from all chosen ones. The distance is that of
``planner.batch.thinning``: the largest difference of base position, base rotation, contacts and
joints, each divided by the tolerance within which grasps are near-duplicates (10 mm, 10 degrees,
5 mm, 10 degrees). Base and contacts are compared in the object's frame, and near-duplicates of a
chosen grasp are never chosen.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from planner.attempt import Attempt, nothing_found, search
from planner.batch.features import GraspFeatures
from planner.batch.thinning import distances
from planner.best.wanted import DEFAULT_MAX_ATTEMPTS, Wanted
from planner.errors import TaskError, shown
from planner.plan import GraspPlan
from planner.search import attempts
from planner.spatial import FloatArray, IntArray
from planner.synthesis.options import SynthesisOptions
from planner.task import GraspTask

FOUND_PER_CHOSEN = 4
"""Grasps that are found for each diverse one that is chosen."""


def plan_several(
    task: GraspTask,
    n: int,
    *,
    diverse: bool = False,
    seed: int = 0,
    max_attempts: int | None = None,
    max_cpu_s: float | None = None,
    metric: str | Mapping[str, float] | None = None,
    options: SynthesisOptions | None = None,
    progress: Callable[[Attempt[GraspPlan]], object] | None = None,
) -> list[GraspPlan]:
    """Up to n grasps of a task, fewer where the budget gives no more; many are ``plan_grasps``'.

    The attempts are those of ``plan_grasp`` with the same seed, one after the other.

    Args:
        task: What to grasp, with what, where.
        n: How many.
        diverse: Whether they are chosen to differ, among four times as many that are found; the
            best by the metric is the first. Otherwise they are the first n found.
        seed: Same seed, same grasps, unless ``max_cpu_s`` ends the search.
        max_attempts: Budget in attempts; None for 100 for each grasp to be found.
        max_cpu_s: Budget in CPU seconds, looked at between attempts; None for no limit.
        metric: By what the first of diverse grasps is chosen, as in ``plan_grasp``.
        options: Margins, weights and objectives of the problem.
        progress: Called after every attempt; where it returns True the search ends with what it
            has.

    Returns:
        At least one plan, in the order in which they were chosen or found.

    Raises:
        NoGraspFoundError: Not one was found.
        NotFoundError: A metric that does not exist.
        TaskError: n is below 1, or below 2 for diverse ones; the task cannot work; a budget is not
            positive; a metric where the first are taken.
    """
    if isinstance(n, bool) or not isinstance(n, int | np.integer) or n < 1:
        raise TaskError(f"n is {shown(n)}; give an integer, at least 1")
    if diverse and n == 1:
        raise TaskError("one grasp cannot be diverse; give n of at least 2, or leave diverse out")
    if metric is not None and not diverse:
        raise TaskError(
            f"metric is {shown(metric)}, but the first {n} grasps are taken, whatever they are "
            "worth; give diverse=True too, or leave it out"
        )
    found_at_most = n * FOUND_PER_CHOSEN if diverse else n
    wanted = Wanted.of(
        max_attempts=max_attempts or DEFAULT_MAX_ATTEMPTS * found_at_most,
        max_cpu_s=max_cpu_s,
        best_of=found_at_most,
        metric=metric,
        options=options,
    )
    best, made = search(
        attempts(task, seed=seed, options=wanted.options),
        max_attempts=wanted.max_attempts,
        max_cpu_s=max_cpu_s,
        best_of=found_at_most,
        progress=progress,
    )
    if best is None:
        raise nothing_found(
            f"grasp of {task.object.name} with {task.hand.name}", made, "Try more attempts"
        )
    found = [attempt.plan for attempt in made if attempt.plan is not None]
    if not diverse:
        return found
    first = int(np.argmax([wanted.value(plan) for plan in found]))
    return [found[i] for i in farthest_points(GraspFeatures.of_plans(found), n, first)]


def farthest_points(grasps: GraspFeatures, n: int, first: int) -> IntArray:
    """Numbers of up to n grasps (m,), each the farthest from those before it; no near-duplicates.

    Args:
        grasps: What is chosen from.
        n: How many.
        first: Number of the first one.
    """
    chosen = [first]
    everything = np.arange(len(grasps))
    nearest = distances(grasps, first, everything)
    while len(chosen) < n:
        farthest = int(nearest.argmax())  # of equal ones the first
        if nearest[farthest] <= 1.0:
            break
        chosen.append(farthest)
        nearest = np.minimum(nearest, distances(grasps, farthest, everything))
    return np.array(chosen, dtype=np.int64)


def separations(plans: Sequence[GraspPlan]) -> FloatArray:
    """Distance of every plan (n,) from the nearest other one, in tolerances; inf for a single one.

    Raises:
        TaskError: There is none, or they are of different tasks.
    """
    grasps, everything = GraspFeatures.of_plans(plans), np.arange(len(plans))
    apart = np.array([distances(grasps, i, everything) for i in range(len(plans))])
    np.fill_diagonal(apart, np.inf)
    nearest: FloatArray = apart.min(axis=1)
    return nearest
