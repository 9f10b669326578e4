"""``plan_grasp``: draw a start, solve, verify on the true geometry, distribute forces; repeat.

Attempts end by iteration limits, never by the clock, so that a seed gives the same plan on any
machine; budgets stop between attempts.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from planner.attempts import Attempt, nothing_found, numbered
from planner.collision.world import CollisionWorld
from planner.errors import TaskError
from planner.plan import GraspPlan, SolveRecord
from planner.synthesis.link_capsules import capsules_are_true
from planner.synthesis.optimize import NEARLY, optimize_grasp
from planner.synthesis.options import ProblemForm, SynthesisOptions
from planner.synthesis.problem import GraspProblem
from planner.synthesis.problem_cache import Problems, problems_for
from planner.synthesis.seeds.draw import Seeder
from planner.synthesis.seeds.mesh import seeder_for
from planner.synthesis.symbols import GraspPoint
from planner.system.stage_times import stage
from planner.system.threads import kept_by_thread, made_once
from planner.task import GraspTask
from planner.verification.grasp import judge_grasp
from planner.verification.projection import settle

__all__ = [
    "Attempt",
    "attempts",
    "plan_grasp",
]

DEFAULT_MAX_ATTEMPTS = 100
"""Attempts before giving up. On the shipped shapes one or two are usual; one that fails costs some
ten milliseconds."""

SPARE_AFTER = 5
"""Attempts after which every other one is made with three fingers alone, if the choice of fingers
was left to us: on narrow faces, rims and handles four fingers find no room."""


def attempts(
    task: GraspTask,
    *,
    seed: int = 0,
    options: SynthesisOptions | None = None,
) -> Iterator[Attempt[GraspPlan]]:
    """Endless independent attempts at a task; attempt i depends on ``seed`` and i alone.

    Any number of them may go on at once, in one thread or in several, also at one task; a single
    iterator is for one thread at a time.

    Raises:
        TaskError: The object cannot be grasped by this hand, found out before solving.
    """
    if not isinstance(seed, int | np.integer) or seed < 0:
        raise TaskError(f"seed is {seed!r}; give an integer >= 0")
    options = options or SynthesisOptions()
    whole = _ground(task, options.form)

    def ground(index: int) -> _Ground:
        past = index - SPARE_AFTER
        if not task.may_spare_fingers or past < 0 or past % 2:
            return whole
        return _spared_ground(task, options.form)

    def record(plan: GraspPlan, index: int, cpu_s: float) -> GraspPlan:
        made = replace(
            plan.record,
            seed=seed,
            attempt=index,
            attempts=index + 1,
            cpu_s=cpu_s,
            build_s=ground(index).problems.build_s,
        )
        return replace(plan, record=made)

    return numbered(
        lambda index: _attempt(ground(index), np.random.default_rng([seed, index]), options),
        record,
        prepare=lambda index: ground(index).world,
    )


def plan_grasp(
    task: GraspTask,
    *,
    seed: int = 0,
    max_attempts: int = DEFAULT_MAX_ATTEMPTS,
    max_cpu_s: float | None = None,
    options: SynthesisOptions | None = None,
    progress: Callable[[Attempt[GraspPlan]], None] | None = None,
) -> GraspPlan:
    """The first grasp that holds on the true geometry.

    May be called from any number of threads, and from ``progress``; each call gives what it gives
    alone. Threads share the hand, the objects and the tasks, none of which ever changes. They take
    turns in Python: for speed use processes (``planner.batch``).

    Args:
        task: What to grasp, with what, where.
        seed: Same seed, same plan.
        max_attempts: Budget in attempts.
        max_cpu_s: Budget in CPU seconds, looked at between attempts; None for no limit.
        options: Margins and weights of the problem.
        progress: Called after every attempt.

    Raises:
        NoGraspFoundError: The budget ended; carries every attempt and its reason.
        TaskError: The task cannot work, or a budget is not positive.
    """
    if max_attempts < 1:
        raise TaskError(f"max_attempts is {max_attempts}; give at least 1")
    if max_cpu_s is not None and not max_cpu_s > 0:
        raise TaskError(f"max_cpu_s is {max_cpu_s}; give seconds > 0")
    made: list[Attempt[GraspPlan]] = []
    used = 0.0
    for attempt in attempts(task, seed=seed, options=options):
        made.append(attempt)
        used += attempt.cpu_s
        if progress is not None:
            progress(attempt)
        if attempt.plan is not None:
            return attempt.plan
        if len(made) >= max_attempts or (max_cpu_s is not None and used >= max_cpu_s):
            break
    raise nothing_found(
        f"grasp of {task.object.name} with {task.hand.name} ({', '.join(task.finger_names)})",
        made,
        "Try more attempts, other fingers, another pose or size of the object, more friction or "
        "less grip",
    )


@dataclass(frozen=True)
class _Ground:
    """What all attempts at a task share, in whatever thread they are made."""

    task: GraspTask
    problems: Problems
    seeder: Seeder

    @property
    def world(self) -> CollisionWorld:
        """The true geometry, this thread's own."""
        return _world(self.task)

    @property
    def judges_links(self) -> CollisionWorld | None:
        """The true geometry where the fingers' capsules are not it already."""
        return None if capsules_are_true(self.task.hand) else self.world


@kept_by_thread(8)
def _world(task: GraspTask) -> CollisionWorld:
    """The true geometry of a task, of which every thread keeps its last few."""
    return CollisionWorld(task)


@made_once(8)
def _ground(task: GraspTask, form: ProblemForm) -> _Ground:
    """Seeder and programmes of a task, made once for all who ask with the same one."""
    seeder = seeder_for(task)
    _world(task)  # refuses what stands in something else, before the programmes are built
    return _Ground(task, problems_for(task, form), seeder)


@made_once(8)
def _spared_ground(task: GraspTask, form: ProblemForm) -> _Ground:
    """The same with three fingers alone; with all where three cannot do what is asked."""
    whole = _ground(task, form)
    try:
        return _ground(task.with_fingers(whole.seeder.tripod), form)
    except TaskError:  # a region is required of a spared finger, or three do not open as wide
        return whole


def _attempt(
    ground: _Ground, rng: np.random.Generator, options: SynthesisOptions
) -> GraspPlan | str:
    """One attempt: a plan, or why not."""
    task, problems, seeder = ground.task, ground.problems, ground.seeder
    with stage("seed"):
        start = seeder.draw(rng)
    if isinstance(start, str):
        return start
    parameters = problems.grasp.parameters(task, start, seeder.posture, options)
    with stage("solve"):
        candidate = optimize_grasp(
            problems.grasp, task, start, parameters, options, ground.judges_links
        )
    worst, weighted = problems.grasp.worst_violation(candidate.violation)
    if not weighted <= NEARLY:
        return f"not solved, term {worst.name}: violated by {candidate.violation[worst.name]:.1e}"
    record = SolveRecord(
        seed=0,
        attempt=0,
        attempts=1,
        iterations=candidate.iterations,
        status=candidate.status,
        cpu_s=0.0,
        build_s=0.0,
        objective=str(options.objective),
    )
    q = np.clip(candidate.q, task.hand.q_lower, task.hand.q_upper)
    T_world_base = task.T_world_object * candidate.T_object_base
    with stage("settle"):
        q = settle(task, T_world_base, q)
    plan = judge_grasp(task, T_world_base, q, record=record, world=ground.world)
    return plan if isinstance(plan, str) else _judged_by_own_terms(plan, problems.grasp)


def _judged_by_own_terms(plan: GraspPlan, problem: GraspProblem) -> GraspPlan | str:
    """The plan if the terms of users that judge grasps are content, else the first one's reason."""
    contacts = plan.contacts_in_object
    point = GraspPoint(task=plan.task, q=plan.q, points=contacts.positions, inward=contacts.normals)
    for term in problem.own_terms:
        failure = term.judge(point) if term.judge is not None else None
        if failure is not None:
            return str(failure)
    return plan
