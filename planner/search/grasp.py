"""``plan_grasp``: draw a start, solve, verify on the true geometry, distribute forces; repeat.

Attempts end by iteration limits, never by the clock, so that a seed gives the same plan however
fast the machine is, but for the rounding of its linear algebra; budgets stop between attempts.
Asked for are the first grasp, the best of so many independent ones, or the best that a budget gives
(``planner.search.best``).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from planner.collision.world import CollisionWorld
from planner.errors import NotFoundError, TaskError, shown
from planner.failure import Failure
from planner.plan import GraspPlan
from planner.search.attempt import (
    UNSOLVED,
    Attempt,
    best_of_made,
    check_seed,
    finished,
    nothing_found,
    run_attempts,
    search,
    true_geometry,
    true_links,
)
from planner.spatial import SE3, FloatArray
from planner.synthesis.objectives import EPSILON
from planner.synthesis.optimize import nearly, optimize_grasp
from planner.synthesis.options import (
    NO_OBJECTIVE,
    ProblemForm,
    SynthesisOptions,
    needed_options,
    with_room,
)
from planner.synthesis.problem import Candidate, GraspProblem, Problems, Start, problems_for
from planner.synthesis.seeds import seeder_for
from planner.synthesis.seeds.draw import Seeder
from planner.synthesis.terms.registry import TERMS
from planner.system.threads import made_once, stage
from planner.task import GraspTask
from planner.verification import NO_FORCES

if TYPE_CHECKING:
    from planner.search.metrics import Measure

__all__ = [
    "BEST",
    "DEFAULT_MAX_ATTEMPTS",
    "FIRST",
    "Attempt",
    "Wanted",
    "attempts",
    "plan_grasp",
    "plans",
]

FIRST = "first"
"""Name for keeping the first grasp found, or the best of the first few."""

BEST = "best"
"""Name for keeping the best grasp that a budget gives."""

DEFAULT_MAX_ATTEMPTS = 100
"""Attempts before giving up. On the shipped shapes one or two are usual; one that fails costs some
ten milliseconds."""

ONE_CAUSE = 0.8
"""Share of the attempts (-) that fail for one cause from which its meaning is told."""

SHARE_AFTER = 2
"""Attempts after which a weak hand's palm counts in the default grip: half the grip bears less of a
push, but a hand that has not the grip with two sets of contacts seldom has it with others. Two
hands try each set so often before the reserve of theirs is halved."""

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
    context = _contexts(task, options or SynthesisOptions())
    return run_attempts(lambda index: context(index, False), seed=seed)


def _contexts(task: GraspTask, options: SynthesisOptions) -> Callable[[int, bool], _GraspContext]:
    """What the attempt of a number shares with others; whether a search for the best has a grasp.

    Raises:
        TaskError: The object cannot be grasped by this hand, found out before solving.
    """
    options = needed_options(task.needed, options)
    choices = _possible(task, options.form)
    share_after = SHARE_AFTER * (len(choices) if task.hand.pair else 1)

    def context(index: int, is_found: bool) -> _GraspContext:
        task = choices[index % len(choices)]
        past = index // len(choices) - SPARE_AFTER
        spares = task.may_spare_fingers and past >= 0 and past % 2 == 0 and not is_found
        problem = (_spared_problem if spares else _problem)(task, options.form)
        true_geometry(problem.task)  # this thread's own is made before the attempt's time begins
        return _GraspContext(problem, options, shares=index >= share_after and not is_found)

    return context


def _possible(task: GraspTask, form: ProblemForm) -> tuple[GraspTask, ...]:
    """The choices of contacts with which the object can be grasped, as far as is known before.

    Raises:
        TaskError: There is none; it is what was wrong with the first.
    """
    possible, refused = [], []
    for choice in task.choices:
        try:
            _problem(choice, form)
        except TaskError as error:
            refused.append(error)
        else:
            possible.append(choice)
    if not possible:
        raise refused[0]
    return tuple(possible)


@dataclass(frozen=True, kw_only=True)
class Wanted:
    """What a search keeps and when it ends, checked.

    Attributes:
        options: Margins, weights and objectives.
        measure: By what grasps are compared; None where the first is taken.
        improving: Whether attempts build on each other.
        best_of: Grasps after which the search ends; None for the end of the budget.
        max_attempts: Budget in attempts; None for no limit.
        max_cpu_s: Budget in CPU seconds; None for no limit.
    """

    options: SynthesisOptions
    measure: Measure | None
    improving: bool
    best_of: int | None
    max_attempts: int | None
    max_cpu_s: float | None

    @classmethod
    def of(
        cls,
        *,
        max_attempts: int | None = None,
        max_cpu_s: float | None = None,
        best_of: int | None = None,
        keep: str = FIRST,
        metric: str | Mapping[str, float] | None = None,
        options: SynthesisOptions | None = None,
    ) -> Wanted:
        """From the arguments of ``plan_grasp``.

        Raises:
            NotFoundError: ``keep`` is neither "first" nor "best", or an unknown metric.
            TaskError: A budget or ``best_of`` is not positive, or they contradict each other.
        """
        for name, value in (("max_attempts", max_attempts), ("best_of", best_of)):
            whole = isinstance(value, int | np.integer) and not isinstance(value, bool)
            if value is not None and not (whole and value >= 1):
                raise TaskError(f"{name} is {shown(value)}; give an integer, at least 1")
        if max_cpu_s is not None and not max_cpu_s > 0:
            raise TaskError(f"max_cpu_s is {max_cpu_s}; give seconds > 0")
        if keep not in (FIRST, BEST):
            raise NotFoundError("way to keep a grasp", str(keep), (FIRST, BEST))
        if keep == BEST and best_of is not None:
            raise TaskError(
                f"keep is 'best' and best_of is {best_of}; leave one out: best_of ends with so "
                "many grasps, keep='best' with max_attempts or max_cpu_s"
            )
        compares = keep == BEST or best_of is not None
        if compares or metric is not None:
            from planner.search.metrics import Measure  # here: the first grasp is not measured
        if metric is not None:
            Measure.of(metric)  # an error of it speaks of a metric, not of an objective
        if metric is not None and not compares:
            raise TaskError(
                f"metric is {shown(metric)}, but the first grasp is taken, whatever it is worth; "
                "give best_of or keep='best' too"
            )
        if options is None:
            options = SynthesisOptions() if metric is None else SynthesisOptions(objective=metric)
        measure = None
        if compares:
            objective = EPSILON if options.objective == NO_OBJECTIVE else options.objective
            measure = Measure.of(objective if metric is None else metric, options.task_wrenches)
        if max_attempts is None and (keep == FIRST or max_cpu_s is None):
            max_attempts = DEFAULT_MAX_ATTEMPTS
        return cls(
            options=options,
            measure=measure,
            improving=keep == BEST,
            best_of=None if keep == BEST else best_of or 1,
            max_attempts=max_attempts,
            max_cpu_s=max_cpu_s,
        )

    def value(self, plan: GraspPlan) -> float:
        """What a plan is worth; 0 where the first is taken."""
        return 0.0 if self.measure is None else self.measure(plan)

    def recorded(self, plan: GraspPlan, made: Sequence[Attempt[GraspPlan]]) -> GraspPlan:
        """A plan with the record of the attempts that it is the best of; the first as it is."""
        if self.measure is None:
            return plan
        return best_of_made(
            plan,
            made,
            metric=self.measure.text,
            value=self.measure(plan),
            improving=self.improving,
        )


def plan_grasp(
    task: GraspTask,
    *,
    seed: int = 0,
    max_attempts: int | None = None,
    max_cpu_s: float | None = None,
    best_of: int | None = None,
    keep: str = FIRST,
    metric: str | Mapping[str, float] | None = None,
    options: SynthesisOptions | None = None,
    progress: Callable[[Attempt[GraspPlan]], object] | None = None,
    start: tuple[SE3, FloatArray] | None = None,
) -> GraspPlan:
    """A grasp that holds on the true geometry: the first one, or the best of several.

    ``start`` is a hand pose of one's own: the plan is then the nearest grasp to it
    (``planner.search.refine.refine_grasp``, which also tells how far it is), and nothing is drawn.

    ``best_of=8`` takes the best of the first eight found, which are those that eight independent
    attempts give. ``keep="best"`` spends a budget on one good grasp: attempts build on each other,
    and what would not be the best is not verified; that gives more than ``best_of`` in the same
    time.

    In counts (``best_of``, ``max_attempts``) the same seed gives the same plan, to the bit in one
    installation on one kind of processor and to rounding elsewhere. What a budget in CPU seconds
    gives depends on the machine: ``plan.record.attempts`` tells how many attempts were made, and
    the same call with ``max_attempts`` of that many, without ``max_cpu_s``, gives the same plan
    again.

    May be called from any number of threads, and from ``progress``; each call gives what it gives
    alone. Threads share the hand, the objects and the tasks, none of which ever changes. They take
    turns in Python: for speed use processes (``planner.batch``).

    Args:
        task: What to grasp, with what, where.
        seed: Same seed, same plan.
        max_attempts: Budget in attempts; None for 100, or for no limit where ``keep`` is "best" and
            ``max_cpu_s`` is given.
        max_cpu_s: Budget in CPU seconds, looked at between attempts; None for no limit.
        best_of: Grasps to find, of which the best is taken; fewer where the budget ends before.
            None for one.
        keep: "first", or "best" for the best that the budget gives.
        metric: By what plans are compared (``planner.search.metrics.METRICS``): a name, several as
            "epsilon:1,limits:0.5", or a mapping of names to weights; of a weighted sum each weight
            is in one over its metric's unit. None for the objective of ``options``.
        options: Margins, weights and objectives of the problem; None for the metric as objective.
        progress: Called after every attempt, which tells the value of the best so far; where it
            returns True the search ends with what it has.
        start: Base pose (world) and joints (nq,) to stay near to; goes without a seed, without
            budgets, ``best_of``, ``keep`` and ``metric``.

    Raises:
        NoGraspFoundError: The budget ended, or there is none near the start; carries every attempt
            and its failure.
        NotFoundError: A metric, or something to keep, that does not exist.
        TaskError: The task cannot work, a budget is not positive, ``best_of`` and ``metric`` do
            not go with ``keep``, or the start is no pose or goes with what it goes without.
        HandError: The start has not as many joints as the hand.
    """
    if start is not None:
        unused = {
            "seed": seed or None,
            "max_attempts": max_attempts,
            "max_cpu_s": max_cpu_s,
            "best_of": best_of,
            "keep": None if keep == FIRST else keep,
            "metric": metric,
        }
        from planner.search.refine.grasp import plan_near  # here: few searches have a start

        return plan_near(task, start, options, progress, unused)
    wanted = Wanted.of(
        max_attempts=max_attempts,
        max_cpu_s=max_cpu_s,
        best_of=best_of,
        keep=keep,
        metric=metric,
        options=options,
    )
    plan, made = search(
        _wanted_attempts(task, seed, wanted),
        max_attempts=wanted.max_attempts,
        max_cpu_s=max_cpu_s,
        best_of=wanted.best_of,
        merit=wanted.value,
        progress=progress,
    )
    if plan is None:
        raise nothing_found(
            f"grasp of {task.object.name} with {task.hand.name} ({', '.join(task.finger_names)})",
            made,
            f"{_one_cause(made)}Try more attempts, other fingers, another pose or size of the "
            "object, more friction or less grip",
        )
    return wanted.recorded(plan, made)


def _one_cause(made: Sequence[Attempt[GraspPlan]]) -> str:
    """What the cause of nearly all failures means, and what to change; "" if there are several."""
    kinds = Counter(a.failure.kind for a in made if a.failure is not None)
    kind, count = kinds.most_common(1)[0]
    term = TERMS.get(kind.removeprefix(UNSOLVED))
    if count < ONE_CAUSE * len(made) or term is None or not term.lacking:
        return ""
    return f"That is: {term.lacking}. "


def plans(
    task: GraspTask,
    *,
    seed: int = 0,
    max_attempts: int | None = None,
    max_cpu_s: float | None = None,
    metric: str | Mapping[str, float] | None = None,
    options: SynthesisOptions | None = None,
) -> Iterator[GraspPlan]:
    """Better and better grasps, each better than the last: those of ``keep="best"`` as they come.

    Take as many as there is time for, and the last one. The last of n attempts is what
    ``plan_grasp(task, seed=seed, keep="best", max_attempts=n)`` gives.

    Args:
        task: What to grasp, with what, where.
        seed: Same seed, same plans.
        max_attempts: Attempts after which it ends; None for no limit: it goes on for ever, and a
            next one may never come.
        max_cpu_s: CPU seconds of attempts after which it ends; None for no limit.
        metric: As in ``plan_grasp``.
        options: As in ``plan_grasp``.

    Raises:
        NotFoundError: A metric that does not exist.
        TaskError: The task cannot work, or a budget is not positive.
    """
    wanted = Wanted.of(
        max_attempts=max_attempts, max_cpu_s=max_cpu_s, keep=BEST, metric=metric, options=options
    )
    endless = _wanted_attempts(task, seed, wanted)

    def better() -> Iterator[GraspPlan]:
        made: list[Attempt[GraspPlan]] = []
        value, used = -np.inf, 0.0
        for attempt in endless:
            made.append(attempt)
            used += attempt.cpu_s
            if attempt.plan is not None and (worth := wanted.value(attempt.plan)) > value:
                value = worth
                yield wanted.recorded(attempt.plan, made)
            if len(made) == max_attempts or (max_cpu_s is not None and used >= max_cpu_s):
                return

    return better()


def _wanted_attempts(task: GraspTask, seed: int, wanted: Wanted) -> Iterator[Attempt[GraspPlan]]:
    """Independent attempts, or those that build on each other."""
    if wanted.measure is None or not wanted.improving:
        return attempts(task, seed=seed, options=wanted.options)
    from planner.search.best import improving_attempts  # here: most searches take the first

    check_seed(seed)
    contexts = _contexts(task, wanted.options)
    return improving_attempts(contexts, seed=seed, measure=wanted.measure)


@dataclass(frozen=True)
class _Problem:
    """A task with its problems and seeder: made once, for whatever thread asks.

    Two arms' task is solved with their hands on carriages, and verified as ``asked``.
    """

    asked: GraspTask
    task: GraspTask
    problems: Problems
    seeder: Seeder


@dataclass(frozen=True)
class _GraspContext:
    """What all attempts at a task with the same fingers share.

    Attributes:
        problem: Task, problems and seeder.
        options: With which it is solved.
        shares: Whether a hand too weak for its default grip may count the palm's share of it.
    """

    problem: _Problem
    options: SynthesisOptions
    shares: bool = False

    @property
    def build_s(self) -> float:
        """Time that building the problems took, s."""
        return self.problem.problems.build_s

    @property
    def task(self) -> GraspTask:
        """The task."""
        return self.problem.task

    @property
    def grasp_problem(self) -> GraspProblem:
        """Its problem."""
        return self.problem.problems.grasp

    @property
    def seeder(self) -> Seeder:
        """What draws its starts."""
        return self.problem.seeder

    @property
    def links(self) -> CollisionWorld | None:
        """The true links, where the capsules of the terms are not exactly those."""
        return true_links(self.task)

    def attempt(self, rng: np.random.Generator) -> GraspPlan | Failure:
        """Draw a start, solve, project onto the true surface, verify."""
        task, problem, options = self.task, self.grasp_problem, self.options
        with stage("seed"):
            start = self.seeder.draw(rng)
        if isinstance(start, Failure):
            return start
        roomy = with_room(options, task)
        with stage("solve"):
            candidate = self._solved(start, roomy)
            worst = problem.worst_violation(candidate.violation)[1]
            if roomy is not options and worst > nearly(task):
                candidate = self._solved(start.at(candidate), options)
        return self.verified(candidate)

    def _solved(self, start: Start, margins: SynthesisOptions) -> Candidate:
        """Where the solver comes to from a start with margins; true links keep theirs."""
        problem = self.grasp_problem
        pressed = (self.task.sharing_palm if self.shares else None) or self.task  # what is asked
        parameters = problem.parameters(pressed, start, self.seeder.posture, margins)
        return optimize_grasp(problem, self.task, start, parameters, self.options, self.links)

    def verified(self, candidate: Candidate) -> GraspPlan | Failure:
        """Project a candidate onto the true surface and verify it."""
        problem, options, asked = self.grasp_problem, self.options, self.problem.asked
        shared, found = asked.sharing_palm, finished(problem, asked, candidate, options)
        if not (self.shares and shared and isinstance(found, Failure) and found.kind == NO_FORCES):
            return found
        return finished(problem, shared, candidate, options)


@made_once(16)
def _problem(task: GraspTask, form: ProblemForm) -> _Problem:
    """Seeder and problems of a task, made once for all who ask with the same one."""
    seeder = seeder_for(task)
    true_geometry(task)  # refuses what stands in something else, before the problems are built
    return _Problem(task, seeder.task, problems_for(seeder.task, form), seeder)


@made_once(8)
def _spared_problem(task: GraspTask, form: ProblemForm) -> _Problem:
    """The same with three fingers alone; with all where three cannot do what is asked."""
    full = _problem(task, form)
    try:
        return _problem(task.with_fingers(full.seeder.tripod), form)
    except TaskError:  # a region is required of a spared finger, or three do not open as wide
        return full
