"""``plan_grasp``: draw a start, solve, verify on the true geometry, distribute forces; repeat.

Attempts end by iteration limits, never by the clock, so that a seed gives the same plan on any
machine; budgets stop between attempts.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from planner.attempt import Attempt, check_seed, nothing_found, run_attempts, search
from planner.collision.world import CollisionWorld
from planner.errors import TaskError
from planner.failure import Failure
from planner.plan import GraspPlan, SolveRecord
from planner.synthesis.link_capsules import capsules_are_true
from planner.synthesis.optimize import NEARLY, optimize_grasp
from planner.synthesis.options import ProblemForm, SynthesisOptions
from planner.synthesis.problem_cache import Problems, problems_for
from planner.synthesis.seeds.draw import Seeder
from planner.synthesis.seeds.mesh import seeder_for
from planner.synthesis.symbols import GraspPoint
from planner.synthesis.terms.term import first_failure
from planner.system.stage_times import stage
from planner.system.threads import kept_by_thread, made_once
from planner.task import GraspTask
from planner.verification.grasp import verify_grasp
from planner.verification.projection import project_onto_surface

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
    check_seed(seed)
    options = options or SynthesisOptions()
    _problem(task, options.form)

    def context(index: int) -> _GraspContext:
        past = index - SPARE_AFTER
        spares = task.may_spare_fingers and past >= 0 and past % 2 == 0
        problem = (_spared_problem if spares else _problem)(task, options.form)
        _world(problem.task)  # this thread's own is made before the attempt's time begins
        return _GraspContext(problem, options)

    return run_attempts(context, seed=seed)


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
        NoGraspFoundError: The budget ended; carries every attempt and its failure.
        TaskError: The task cannot work, or a budget is not positive.
    """
    if max_attempts < 1:
        raise TaskError(f"max_attempts is {max_attempts}; give at least 1")
    if max_cpu_s is not None and not max_cpu_s > 0:
        raise TaskError(f"max_cpu_s is {max_cpu_s}; give seconds > 0")
    plan, made = search(
        attempts(task, seed=seed, options=options),
        max_attempts=max_attempts,
        max_cpu_s=max_cpu_s,
        progress=progress,
    )
    if plan is None:
        raise nothing_found(
            f"grasp of {task.object.name} with {task.hand.name} ({', '.join(task.finger_names)})",
            made,
            "Try more attempts, other fingers, another pose or size of the object, more friction "
            "or less grip",
        )
    return plan


@dataclass(frozen=True)
class _Problem:
    """A task with its problems and seeder: made once, for whatever thread asks."""

    task: GraspTask
    problems: Problems
    seeder: Seeder


@dataclass(frozen=True)
class _GraspContext:
    """What all attempts at a task with the same fingers share."""

    problem: _Problem
    options: SynthesisOptions

    @property
    def build_s(self) -> float:
        """Time that building the problems took, s."""
        return self.problem.problems.build_s

    def attempt(self, rng: np.random.Generator) -> GraspPlan | Failure:
        """Draw a start, solve, project onto the true surface, verify."""
        task, problem, seeder = self.problem.task, self.problem.problems.grasp, self.problem.seeder
        options, world = self.options, _world(task)
        with stage("seed"):
            start = seeder.draw(rng)
        if isinstance(start, Failure):
            return start
        parameters = problem.parameters(task, start, seeder.posture, options)
        with stage("solve"):
            # the true links where the capsules of the terms are not exactly those
            links = None if capsules_are_true(task.hand) else world
            candidate = optimize_grasp(problem, task, start, parameters, options, links)
        worst, weighted = problem.worst_violation(candidate.violation)
        if not weighted <= NEARLY:
            violation = candidate.violation[worst.name]
            return Failure(
                kind=f"unsolved_{worst.name}",
                text=f"not solved, term {worst.name}: violated by {violation:.1e}",
                numbers={"violation": violation},
            )
        record = SolveRecord(
            iterations=candidate.iterations,
            status=candidate.status,
            objective=str(options.objective),
        )
        q = np.clip(candidate.q, task.hand.q_lower, task.hand.q_upper)
        T_world_base = task.T_world_object * candidate.T_object_base
        with stage("project"):
            q = project_onto_surface(task, T_world_base, q)
        plan = verify_grasp(task, T_world_base, q, record=record, world=world)
        if isinstance(plan, Failure) or not problem.own_terms:
            return plan
        at = plan.contacts_in_object
        point = GraspPoint(task=task, q=plan.q, points=at.positions, inward=at.normals)
        return first_failure(problem.own_terms, point) or plan


@kept_by_thread(8)
def _world(task: GraspTask) -> CollisionWorld:
    """The true geometry of a task, of which every thread keeps its last few."""
    return CollisionWorld(task)


@made_once(8)
def _problem(task: GraspTask, form: ProblemForm) -> _Problem:
    """Seeder and problems of a task, made once for all who ask with the same one."""
    seeder = seeder_for(task)
    _world(task)  # refuses what stands in something else, before the problems are built
    return _Problem(task, problems_for(task, form), seeder)


@made_once(8)
def _spared_problem(task: GraspTask, form: ProblemForm) -> _Problem:
    """The same with three fingers alone; with all where three cannot do what is asked."""
    full = _problem(task, form)
    try:
        return _problem(task.with_fingers(full.seeder.tripod), form)
    except TaskError:  # a region is required of a spared finger, or three do not open as wide
        return full
