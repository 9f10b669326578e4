"""``refine_grasp``: the nearest grasp to a given hand pose, by a short ladder of tries.

The first try takes the pose as it is, with pads put onto the true surface by the fingers alone,
where no pad is farther from it than ``AS_GIVEN``. Then come the rungs of
``planner.search.refine.rungs``, from strong to weak nearness. Where the task leaves the fingers
open, other sets are tried after
that: if there is no plan, one finger less and one more; if there is, but not near enough, all but
the finger that moved farthest. The ladder ends at the first plan whose contacts moved by at most
``NEAR_ENOUGH``; otherwise the nearest of all plans counts.

Tries are bounded by iterations, never by the clock: the same pose gives the same plan, but
for rounding on another kind of processor.

``RefinedGrasp``: what became of a given hand pose.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from planner.collision.pad_contact import pad_contacts
from planner.errors import NoGraspFoundError, TaskError, shown
from planner.failure import Failure
from planner.immutable import freeze
from planner.numerics.kernels import attempt_kernels
from planner.plan import GraspPlan, SolveRecord
from planner.search.attempt import Attempt, true_geometry, verified_on_surface
from planner.search.refine.pose import (
    GivenPose,
    Movement,
    UnderPads,
    fingers_near,
    palm_pose,
    under_pads,
)
from planner.search.refine.rungs import BOUNDED, RUNGS, Rung, climb_rung, near_options, start_at
from planner.spatial import SE3, FloatArray
from planner.synthesis.options import SynthesisOptions
from planner.synthesis.problem import Problems, problems_for
from planner.system.threads import made_once
from planner.task import GraspTask


@dataclass(frozen=True, kw_only=True)
class RefinedGrasp:
    """The nearest grasp to a given pose that passes the whole verdict, or why there is none near.

    Attributes:
        task: The task, with the fingers that take part.
        T_world_base: Base pose as given.
        q: Joints as given (nq,).
        plan: The grasp; None where none was found.
        failure: Why there is none, that of the try that came farthest; None where one was found.
        movement: How far the hand moved to the plan, or to the nearest that was reached; None where
            nothing was tried.
        T_world_base_reached: Base pose of the plan, or of the nearest that was reached.
        q_reached: Its joints (nq,).
        attempts: All tries, the nearest first.
        notes: What was changed of the given pose before it began, a sentence each.
        cpu_s: CPU time of all tries, s.
        build_s: Time that building the problem took, s: once per hand, fingers and kind of shape.
    """

    task: GraspTask
    T_world_base: SE3
    q: FloatArray
    plan: GraspPlan | None
    failure: Failure | None
    movement: Movement | None
    T_world_base_reached: SE3
    q_reached: FloatArray
    attempts: tuple[Attempt[GraspPlan], ...]
    notes: tuple[str, ...]
    cpu_s: float
    build_s: float

    def __post_init__(self) -> None:
        """Keep read-only copies."""
        freeze(self, poses=("T_world_base", "T_world_base_reached"), arrays=("q", "q_reached"))

    @classmethod
    def untried(
        cls, task: GraspTask, T_world_base: SE3, q: FloatArray, failure: Failure
    ) -> RefinedGrasp:
        """The result of a pose from which nothing was tried.

        Args:
            task: The task.
            T_world_base: Base pose as given.
            q: Joints as given.
            failure: Why not.
        """
        return cls(
            task=task,
            T_world_base=T_world_base,
            q=q,
            plan=None,
            failure=failure,
            movement=None,
            T_world_base_reached=T_world_base,
            q_reached=q,
            attempts=(),
            notes=(),
            cpu_s=0.0,
            build_s=0.0,
        )

    @property
    def found(self) -> bool:
        """Whether there is a plan."""
        return self.plan is not None

    def __str__(self) -> str:
        """What became of it, and how far the hand moved, in a few lines."""
        head = (
            f"brought back with {', '.join(self.task.finger_names)} at try {len(self.attempts)}"
            if self.failure is None
            else f"not brought back: {self.failure}"
        )
        moved = []
        if self.movement is not None:
            moved = [f"{'moved' if self.found else 'nearest reached, moved'}: {self.movement}"]
        return "\n".join([head, *moved, *(f"note: {note}" for note in self.notes)])


AS_GIVEN = 0.002
"""Largest gap (m) of a pad, either sign, with which the given pose itself is tried."""

NEAR_ENOUGH = 0.012
"""Displacement (m) of all contacts up to which the first plan ends the ladder: half a fingertip."""


@attempt_kernels(0)
def refine_grasp(
    task: GraspTask,
    T_world_base: SE3,
    q: FloatArray,
    *,
    clamp: bool = False,
    options: SynthesisOptions | None = None,
) -> RefinedGrasp:
    """From a hand pose to the nearest grasp that passes the whole verdict.

    Pads come onto the true surface, penetration goes, closure and forces are found, a pre-grasp
    and a way in are added, and the hand moves as little as it can
    (``planner.search.refine.Movement.distance``). The plan is one like those of ``plan_grasp``.

    Fingers that take part are those of the task where it names them
    (``GraspTask.create(fingers=...)``); else those whose pads are near the object in this pose.
    The same arguments give the same result.

    Args:
        task: What to grasp, with what, where; in its world the pose is given.
        T_world_base: Pose of the hand's base.
        q: Joints (nq,), rad (m for slides), order of ``hand.joint_names``. Beyond their limits
            they are brought within, which is part of the movement.
        clamp: Whether such joints count as given at their limits instead.
        options: Margins, weights and own terms of the problem. Objectives and rounds are not used:
            the nearest grasp is looked for, not the strongest.

    Returns:
        The plan, or why there is none near: the failing term and its numbers, and what was reached.

    Raises:
        TaskError: The pose is no pose, not finite, or not where the task fixes the base.
        HandError: Not as many joints as the hand has, or not finite.
    """
    pose = GivenPose.of(task, T_world_base, q, clamp=clamp)
    asked = near_options(options or SynthesisOptions())
    begin = time.process_time()
    sets = (
        fingers_near(task, pose.T_world_base, pose.q)
        if task.may_spare_fingers
        else (task.finger_names,)
    )
    ladder = _Ladder(task, pose, T_world_base, np.asarray(q, dtype=np.float64))
    if isinstance(sets, Failure):
        spent = time.process_time() - begin
        untried = RefinedGrasp.untried(task, T_world_base, ladder.q, sets)
        return replace(untried, notes=pose.notes, cpu_s=spent)
    run = _Run(pose, asked, spent=time.process_time() - begin)
    for names in sets:
        run.climb(with_fingers(task, names), RUNGS, as_given=names is sets[0])
        if run.ended or run.found:
            break
    spared = _without_the_farthest(run.best) if task.may_spare_fingers else None
    if run.found and not run.ended and spared is not None:
        run.climb(spared, RUNGS[:BOUNDED])
    return ladder.result(run.tries, run.spent, run.build_s)


class _Run:
    """The tries so far, and what they cost.

    Attributes:
        tries: In the order in which they were made.
        spent: CPU time, s, without building problems.
        build_s: Time that building the problem took, s; the longest of several.
    """

    def __init__(self, pose: GivenPose, options: SynthesisOptions, spent: float) -> None:
        self._pose, self._options = pose, options
        self.tries: list[_Try] = []
        self.spent, self.build_s = spent, 0.0

    @property
    def best(self) -> _Try:
        """The nearest plan; else the failure that came farthest."""
        return max(self.tries, key=lambda one: one.merit)

    @property
    def found(self) -> bool:
        """Whether there is a plan."""
        return self.best.plan is not None

    @property
    def ended(self) -> bool:
        """Whether a plan is as near as is asked."""
        return self.found and self.best.movement.contact <= NEAR_ENOUGH

    def climb(self, task: GraspTask, rungs: Sequence[Rung], as_given: bool = False) -> None:
        """Try rungs with some fingers, until a plan is as near as is asked."""
        problems = problems_for(task, self._options.form)
        true_geometry(task)  # this thread's own is made before the time begins
        self.build_s = max(self.build_s, problems.build_s)
        begin = time.process_time()
        for one in _tries(task, problems, self._pose, self._options, rungs, as_given=as_given):
            now = time.process_time()
            self.tries.append(replace(one, cpu_s=now - begin))
            self.spent, begin = self.spent + now - begin, now
            if one.plan is not None and one.movement.contact <= NEAR_ENOUGH:
                return


def _without_the_farthest(best: _Try) -> GraspTask | None:
    """The task of a plan without the finger whose contact moved farthest; None if it is needed."""
    task, touch = best.task, best.task.object.touch
    far = task.finger_names[int(best.movement.contacts.argmax())]
    if len(task.finger_names) <= task.fingers_needed or (touch and far in touch.required):
        return None
    return with_fingers(task, tuple(name for name in task.finger_names if name != far))


def with_fingers(task: GraspTask, names: tuple[str, ...]) -> GraspTask:
    """A task with these fingers: itself if it has them; made once, as what is prepared for it."""
    return task if set(names) == set(task.finger_names) else _with_fingers(task, names)


@made_once(64)
def _with_fingers(task: GraspTask, names: tuple[str, ...]) -> GraspTask:
    return task.with_fingers(names)


@dataclass(frozen=True, kw_only=True)
class _Try:
    """One try: what came of it and how far the hand moved."""

    task: GraspTask
    outcome: GraspPlan | Failure
    movement: Movement
    T_world_base: SE3
    q: FloatArray
    cpu_s: float = 0.0

    @property
    def plan(self) -> GraspPlan | None:
        return None if isinstance(self.outcome, Failure) else self.outcome

    @property
    def merit(self) -> tuple[float, ...]:
        """The larger the better: a plan, the nearest; then the failure that came farthest."""
        if not isinstance(self.outcome, Failure):
            return 1.0, -self.movement.distance
        unsolved = self.outcome.kind.startswith("unsolved_")
        return 0.0, -float(unsolved), -self.movement.distance


def _tries(
    task: GraspTask,
    problems: Problems,
    pose: GivenPose,
    options: SynthesisOptions,
    rungs: Sequence[Rung],
    *,
    as_given: bool,
) -> Iterator[_Try]:
    """The tries with one set of fingers."""
    problem = problems.grasp
    under = under_pads(task, pose.T_world_base, pose.q, task.fingers)
    if as_given and float(np.abs(under.gaps).max()) <= AS_GIVEN:
        record = SolveRecord(iterations=0, status="as given", objective=str(options.objective))
        outcome = verified_on_surface(
            task, pose.T_world_base, pose.q, record=record, terms=problem.own_terms
        )
        yield _tried(task, pose, under, outcome, pose.T_world_base, pose.q)
    for rung in rungs:
        if rung.faced and task.object.shape.flat_sides is None:
            continue
        start = start_at(task, problem.surface, pose, under, rung)
        outcome, candidate = climb_rung(problem, task, start, pose, under, options, rung)
        base = task.T_world_object * candidate.T_object_base
        yield _tried(task, pose, under, outcome, base, candidate.q)


def _tried(
    task: GraspTask,
    pose: GivenPose,
    under: UnderPads,
    outcome: GraspPlan | Failure,
    T_world_base: SE3,
    q: FloatArray,
) -> _Try:
    """A try, and how far the hand moved: to the plan if there is one, else to where it ended."""
    if isinstance(outcome, Failure):
        points = np.array([t.point for t in pad_contacts(task, T_world_base, q)])
    else:
        T_world_base, q = outcome.T_world_base, outcome.q
        points = outcome.contacts_in_object.positions
    movement = Movement.between(
        (pose.T_world_palm, pose.q_given, under.points),
        (palm_pose(task, T_world_base, q), q, points),
    )
    return _Try(task=task, outcome=outcome, movement=movement, T_world_base=T_world_base, q=q)


@dataclass(frozen=True)
class _Ladder:
    """What was asked, from which results are made."""

    task: GraspTask
    pose: GivenPose
    T_world_base: SE3
    q: FloatArray

    def result(self, tries: list[_Try], cpu_s: float, build_s: float) -> RefinedGrasp:
        """The best of the tries."""
        number = max(range(len(tries)), key=lambda i: tries[i].merit)
        best, plan = tries[number], tries[number].plan
        if plan is not None:
            record = replace(
                plan.record, attempt=number, attempts=len(tries), cpu_s=cpu_s, build_s=build_s
            )
            plan = replace(plan, record=record)
        return RefinedGrasp(
            task=best.task,
            T_world_base=self.T_world_base,
            q=self.q,
            plan=plan,
            failure=best.outcome if isinstance(best.outcome, Failure) else None,
            movement=best.movement,
            T_world_base_reached=best.T_world_base,
            q_reached=best.q,
            attempts=tuple(
                Attempt(
                    index=i,
                    plan=one.plan,
                    failure=one.outcome if isinstance(one.outcome, Failure) else None,
                    cpu_s=one.cpu_s,
                )
                for i, one in enumerate(tries)
            ),
            notes=self.pose.notes,
            cpu_s=cpu_s,
            build_s=build_s,
        )


def plan_near(
    task: GraspTask,
    start: tuple[SE3, FloatArray],
    options: SynthesisOptions | None,
    progress: Callable[[Attempt[GraspPlan]], object] | None,
    unused: Mapping[str, object],
) -> GraspPlan:
    """The nearest grasp to a start, for ``planner.search.grasp.plan_grasp``.

    Args:
        task: The task.
        start: Base pose (world) and joints (nq,) to stay near to.
        options: Margins and weights of the problem.
        progress: Called with every attempt.
        unused: Other arguments of the search by name, which have no meaning here.

    Raises:
        TaskError: The start is no pair, or one of the others was given.
        NoGraspFoundError: There is none near the start; carries every attempt and its failure.
    """
    given = [f"{name}={value!r}" for name, value in unused.items() if value is not None]
    if given:
        raise TaskError(
            f"a start is given, and {', '.join(given)}; the plan is the nearest grasp to the start "
            "and nothing is searched for: leave these out, or the start"
        )
    if not (isinstance(start, tuple) and len(start) == 2):
        raise TaskError(f"start is {shown(start)}; give a pair of base pose and joints")
    found = refine_grasp(task, *start, options=options)
    if progress is not None:
        for attempt in found.attempts:
            progress(attempt)
    if found.plan is None:
        raise NoGraspFoundError(
            f"no grasp of {task.object.name} with {task.hand.name} near the start: {found.failure}."
            " Try another start, other fingers, or a search without a start",
            found.attempts,
        )
    return found.plan
