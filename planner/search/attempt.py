"""Attempts of a search: each gives a plan or a failure; what they cost, and when they end.

Attempt i depends on the seed and on i alone, so a seed gives the same plan however fast the
machine is, but for rounding; budgets stop between attempts.

``finished`` is the second half of an attempt at a grasp: pads are put onto the true surface, then
comes the verdict. It is shared by ``planner.search.grasp``, which starts anywhere, and by
``planner.search.refine``, which starts from a given hand pose.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import count
from typing import Any, ClassVar, Generic, Protocol, TypeVar

import numpy as np

from planner.arrays import LARGEST_INT
from planner.collision.arm_path import onto_arms
from planner.collision.world import CollisionWorld
from planner.errors import NoGraspFoundError, TaskError, shown
from planner.failure import Failure
from planner.numerics.kernels import attempt_kernels, planning_time
from planner.plan import BestOf, GraspPlan, SolveRecord
from planner.spatial import SE3, FloatArray
from planner.synthesis.optimize import nearly
from planner.synthesis.options import SynthesisOptions
from planner.synthesis.problem import Candidate, GraspProblem
from planner.synthesis.symbols import GraspPoint
from planner.synthesis.terms.fingers import capsules_are_true
from planner.synthesis.terms.term import Term, first_failure
from planner.system.threads import kept_by_thread, stage
from planner.task import GraspTask
from planner.verification import (
    project_onto_surface,
    verify_grasp,
    with_palm_on_surface,
)

__all__ = [
    "UNSOLVED",
    "Attempt",
    "Built",
    "SearchContext",
    "best_of_made",
    "check_seed",
    "finished",
    "nothing_found",
    "recorded",
    "run_attempts",
    "search",
    "true_geometry",
    "true_links",
    "verified_on_surface",
]


UNSOLVED = "unsolved_"
"""Begin of the kind of a failure to satisfy a term, whose name follows."""


@kept_by_thread(8)
def true_geometry(task: GraspTask) -> CollisionWorld:
    """The true geometry of a task, of which every thread keeps its last few."""
    return CollisionWorld(task)


def true_links(task: GraspTask) -> CollisionWorld | None:
    """The true geometry, where the capsules of the terms are not exactly the hand's links."""
    return None if capsules_are_true(task.hand) else true_geometry(task)


def finished(
    problem: GraspProblem, task: GraspTask, candidate: Candidate, options: SynthesisOptions
) -> GraspPlan | Failure:
    """The plan of a candidate if it is solved and holds on the true geometry; else why not.

    Args:
        problem: The problem that was solved.
        task: Its task.
        candidate: Where the solver ended.
        options: With what it solved.
    """
    worst, weighted = problem.worst_violation(candidate.violation)
    if not weighted <= nearly(task):
        violation = candidate.violation[worst.name]
        return Failure(
            kind=f"{UNSOLVED}{worst.name}",
            text=f"not solved, term {worst.name}: violated by {violation:.1e}",
            numbers={"violation": violation},
        )
    record = SolveRecord(
        iterations=candidate.iterations,
        status=candidate.status,
        objective=str(options.objective),
    )
    q = np.clip(candidate.q, problem.hand.q_lower, problem.hand.q_upper)
    T_world_base = task.T_world_object * candidate.T_object_base
    if task.on_carriages is not task and problem.hand is not task.hand:
        found = onto_arms(true_geometry(task), T_world_base, q)
        if isinstance(found, Failure):
            return found
        T_world_base, q = SE3(task.T_world_base), found
    return verified_on_surface(task, T_world_base, q, record=record, terms=problem.own_terms)


def verified_on_surface(
    task: GraspTask,
    T_world_base: SE3,
    q: FloatArray,
    *,
    record: SolveRecord,
    terms: tuple[Term, ...] = (),
) -> GraspPlan | Failure:
    """Project onto the true surface, verify, and ask the terms that have a verdict of their own.

    Args:
        task: The task.
        T_world_base: Base pose.
        q: Joints (nq,), within their limits.
        record: Where they come from.
        terms: Terms beside the standard ones.
    """
    with stage("project"):
        T_world_base = with_palm_on_surface(task, T_world_base, q)
        q = project_onto_surface(task, T_world_base, q)
    plan = verify_grasp(task, T_world_base, q, record=record, world=true_geometry(task))
    if isinstance(plan, Failure) or not terms:
        return plan
    at = plan.contacts_in_object
    point = GraspPoint(task=task, q=plan.q, points=at.positions, inward=at.normals)
    return first_failure(terms, point) or plan


COMMONEST = 3
"""Kinds of failure that are told, the commonest first."""


class Recorded(Protocol):
    """A plan, a frozen dataclass, that keeps the record of its search."""

    __dataclass_fields__: ClassVar[dict[str, Any]]

    @property
    def record(self) -> Any:
        """A ``SearchRecord``."""


PlanT = TypeVar("PlanT")
"""What a search is for."""

RecordedT = TypeVar("RecordedT", bound=Recorded)

FoundT_co = TypeVar("FoundT_co", covariant=True)


class Built(Protocol):
    """What takes time to build, once for all attempts."""

    @property
    def build_s(self) -> float:
        """Time that building took, s."""


class SearchContext(Built, Protocol[FoundT_co]):
    """What several attempts share: problem, solver, geometry."""

    def attempt(self, rng: np.random.Generator) -> FoundT_co | Failure:
        """One attempt: a plan, or why there is none."""


@dataclass(frozen=True, kw_only=True)
class Attempt(Generic[PlanT]):
    """One attempt: a plan, or why there is none.

    Attributes:
        index: Its number, from 0, among those of one task and path.
        plan: The plan if it was found.
        failure: Why not, None if found.
        cpu_s: CPU time of this attempt, s.
        best: Value of the best plan up to this attempt, as its search compares plans; None before
            the first one, and outside a search.
    """

    index: int
    plan: PlanT | None
    failure: Failure | None
    cpu_s: float
    best: float | None = None


def check_seed(seed: int) -> None:
    """Refuse anything but an integer in [0, 2^128].

    Raises:
        TaskError: Not an integer, negative, or larger than a file may hold.
    """
    if not isinstance(seed, int | np.integer) or not 0 <= seed <= LARGEST_INT:
        raise TaskError(f"seed is {shown(seed)}; give an integer >= 0, at most 2^128")


def run_attempts(
    context: Callable[[int], SearchContext[RecordedT]], *, seed: int
) -> Iterator[Attempt[RecordedT]]:
    """Endless attempts; those of one number and seed are the same.

    Args:
        context: What the attempt of a number shares with others; the time it takes does not count.
        seed: Seed of the search.
    """
    total = 0.0
    for index in count():
        shared = context(index)
        begin = planning_time()
        with attempt_kernels(index):
            outcome = shared.attempt(np.random.default_rng([seed, index]))
        cpu = planning_time() - begin
        total += cpu
        yield recorded(outcome, seed=seed, index=index, cpu_s=cpu, total=total, context=shared)


def recorded(
    outcome: RecordedT | Failure,
    *,
    seed: int,
    index: int,
    cpu_s: float,
    total: float,
    context: Built,
) -> Attempt[RecordedT]:
    """An attempt; its plan, if it is one, with the record of the search so far.

    Args:
        outcome: What the attempt gave.
        seed: Seed of the search.
        index: Number of the attempt.
        cpu_s: CPU time of the attempt, s.
        total: The same of all so far, s.
        context: What attempts share.
    """
    if isinstance(outcome, Failure):
        return Attempt(index=index, plan=None, failure=outcome, cpu_s=cpu_s)
    record = replace(
        outcome.record,
        seed=seed,
        attempt=index,
        attempts=index + 1,
        cpu_s=total,
        build_s=context.build_s,
    )
    return Attempt(index=index, plan=replace(outcome, record=record), failure=None, cpu_s=cpu_s)


def search(
    attempts: Iterable[Attempt[PlanT]],
    *,
    max_attempts: int | None,
    max_cpu_s: float | None = None,
    best_of: int | None = 1,
    merit: Callable[[PlanT], float] = lambda plan: 0.0,
    progress: Callable[[Attempt[PlanT]], object] | None = None,
) -> tuple[PlanT | None, list[Attempt[PlanT]]]:
    """The best of the first ``best_of`` plans that are found; and all attempts made.

    Args:
        attempts: One after the other.
        max_attempts: Budget in attempts; None for no limit.
        max_cpu_s: Budget in CPU seconds, looked at between attempts; None for no limit.
        best_of: Plans after which the search ends; None for the best within the budget.
        merit: The larger the better; of equals the first is taken.
        progress: Called after every attempt, which tells the best value so far; the search ends
            with what it has where this returns True.
    """
    made: list[Attempt[PlanT]] = []
    best: PlanT | None = None
    value, found, used = -np.inf, 0, 0.0
    for attempt in attempts:
        used += attempt.cpu_s
        if attempt.plan is not None:
            found += 1
            worth = merit(attempt.plan)
            if best is None or worth > value:
                best, value = attempt.plan, worth
        made.append(replace(attempt, best=None if best is None else value))
        stop = progress is not None and progress(made[-1]) is True
        spent = max_attempts is not None and len(made) >= max_attempts
        spent = spent or (max_cpu_s is not None and used >= max_cpu_s)
        if stop or spent or (best_of is not None and found >= best_of):
            break
    return best, made


def nothing_found(what: str, made: Sequence[Attempt[PlanT]], remedy: str) -> NoGraspFoundError:
    """The error of an exhausted budget, with the commonest kinds of failure, each by an example.

    The example is the first of its kind; only the commonest is told beyond a semicolon.

    Args:
        what: What was asked for, after "no".
        made: All attempts.
        remedy: What to try, a sentence without its full stop.
    """
    failures = [a.failure for a in made if a.failure is not None]
    example = {f.kind: f.text for f in reversed(failures)}
    common = Counter(f.kind for f in failures).most_common(COMMONEST)
    whole = [f"{n} x {example[kind]}" for kind, n in common]
    told = whole[:1] + [text.split(";")[0] for text in whole[1:]]
    return NoGraspFoundError(
        f"no {what} in {len(made)} attempts: {'; '.join(told)}. {remedy}", tuple(made)
    )


def best_of_made(
    plan: GraspPlan,
    made: Sequence[Attempt[GraspPlan]],
    *,
    metric: str,
    value: float,
    improving: bool = False,
) -> GraspPlan:
    """A plan with the record of the attempts that it is the best of.

    Args:
        plan: The best.
        made: All attempts.
        metric: By what.
        value: What it is worth by that.
        improving: Whether attempts built on each other.
    """
    found = sum(attempt.plan is not None for attempt in made)
    best = BestOf(found=found, metric=metric, value=value, improving=improving)
    spent = sum(attempt.cpu_s for attempt in made)
    return replace(plan, record=replace(plan.record, attempts=len(made), cpu_s=spent, best=best))
