"""Attempts that look for the best grasp instead of the first: each tries to beat those before it.

Where an attempt's time goes decides what comes first. A start is solved without objectives, raised
by ``planner.synthesis.optimize`` and given up as soon as it falls behind; what it is worth is
foreseen from the solver's own contacts, and only what would be better is projected and verified
(pads, collisions, closure, forces, way in). Once something was found every other start lies beside
one of the best grasps so far.

Attempt i depends on the seed and on the attempts before it, never on the clock: the first n
attempts of a seed are the same on every machine.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Protocol

import numpy as np

from planner.collision.world import CollisionWorld
from planner.contacts import ContactSet
from planner.failure import Failure
from planner.forces import ForceSolution
from planner.numerics.kernels import attempt_kernels, planning_time
from planner.numerics.least_squares import MAX_ITERATIONS
from planner.plan import GraspPlan
from planner.search.attempt import Attempt, recorded
from planner.spatial import SE3, FloatArray
from planner.synthesis.objectives import EPSILON
from planner.synthesis.optimize import NEARLY, GraspRun
from planner.synthesis.options import SynthesisOptions, with_room
from planner.synthesis.problem import Candidate, GraspProblem, Start
from planner.synthesis.seeds.draw import Seeder
from planner.system.threads import stage
from planner.task import GraspTask
from planner.verification import plan_forces

if TYPE_CHECKING:
    from planner.search.metrics import Measure

__all__ = ["FALLEN_BEHIND", "improving_attempts"]

FALLEN_BEHIND = "fallen_behind"
"""Kind of the failure of a grasp that would not have been the best: it was not verified."""

KEPT = 3
"""Grasps beside which starts are drawn: the best so far."""

BESIDE = 0.5
"""Share of the starts that lie beside one of them: the others find other kinds of grasp."""


class ClimbingContext(Protocol):
    """What attempts at a task with the same fingers share."""

    @property
    def task(self) -> GraspTask:
        """The task."""

    @property
    def grasp_problem(self) -> GraspProblem:
        """Its problem."""

    @property
    def seeder(self) -> Seeder:
        """What draws its starts."""

    @property
    def options(self) -> SynthesisOptions:
        """Margins, weights and objectives."""

    @property
    def links(self) -> CollisionWorld | None:
        """True geometry, where capsules stand for wider links."""

    @property
    def build_s(self) -> float:
        """Time that building the problem took, s."""

    def verified(self, candidate: Candidate) -> GraspPlan | Failure:
        """A plan of a candidate, if it holds on the true geometry."""


def improving_attempts(
    context: Callable[[int, bool], ClimbingContext], *, seed: int, measure: Measure
) -> Iterator[Attempt[GraspPlan]]:
    """Endless attempts, each of which tries to beat those before it by a measure.

    Args:
        context: What the attempt of a number shares with others; whether anything was found yet.
        seed: Seed of the search.
        measure: More is better.
    """
    kept: list[_Kept] = []
    total, index = 0.0, 0
    while True:
        shared = context(index, bool(kept))
        begin = planning_time()
        with attempt_kernels(index):
            outcome = _attempt(shared, np.random.default_rng([seed, index]), measure, kept)
        cpu = planning_time() - begin
        total += cpu
        yield recorded(outcome, seed=seed, index=index, cpu_s=cpu, total=total, context=shared)
        index += 1


@dataclass(frozen=True)
class _Kept:
    """A grasp beside which starts are drawn: its value verified, and as the ascent measured it."""

    value: float
    climbed: float
    context: ClimbingContext
    start: Start
    candidate: Candidate


@dataclass(frozen=True)
class _Reached:
    """A grasp as the solver left it, for the metrics; forces are planned where one needs them."""

    task: GraspTask
    T_world_base: SE3
    q: FloatArray
    contacts_in_object: ContactSet

    @cached_property
    def contacts(self) -> ContactSet:
        return self.contacts_in_object.transformed(self.task.T_world_object)

    @cached_property
    def forces(self) -> ForceSolution:
        return plan_forces(self.task, self.contacts, self.T_world_base, self.q)


def _attempt(
    context: ClimbingContext, rng: np.random.Generator, measure: Measure, kept: list[_Kept]
) -> GraspPlan | Failure:
    """Draw or vary a start, solve, climb, and verify what would be the best; ``kept`` learns."""
    from planner.synthesis.optimize import nearby_start  # here: the first grasp needs none of it

    with stage("seed"):
        if kept and rng.random() < BESIDE:
            parent = kept[int(rng.integers(len(kept)))]
            context = parent.context
            drawn: Start | Failure = nearby_start(
                context.task.hand, parent.start, parent.candidate, rng
            )
        else:
            drawn = context.seeder.draw(rng)
    if isinstance(drawn, Failure):
        return drawn
    climbed = _climbed(context, drawn, measure, kept[0] if kept else None)
    if isinstance(climbed, Failure):
        return climbed
    candidate, value = climbed
    plan = context.verified(candidate)
    if isinstance(plan, GraspPlan):
        kept.append(_Kept(measure(plan), value, context, drawn, candidate))
        kept.sort(key=lambda k: -k.value)
        del kept[KEPT:]
    return plan


def _climbed(
    context: ClimbingContext, start: Start, measure: Measure, best: _Kept | None
) -> tuple[Candidate, float] | Failure:
    """The best grasp near a start, and its value; a failure if it would not beat the best."""
    from planner.synthesis.optimize import climb, with_light_costs

    task, problem, options = context.task, context.grasp_problem, context.options
    begin = planning_time()
    posture, margins = context.seeder.posture, with_room(options, task)
    with stage("solve"):
        run = GraspRun(problem, task, start, problem.parameters(task, start, posture, margins))
        run.solve(MAX_ITERATIONS)
        if run.end.worst > NEARLY and margins is not options:
            margins = options
            run.set_parameters(problem.parameters(task, start, posture, margins))
            run.solve(MAX_ITERATIONS)
    status = run.end.status
    if run.end.worst > NEARLY:
        return run.candidate(status, begin), -np.inf

    def value(at: GraspRun) -> float:
        if tuple(measure.weights) == (EPSILON,):  # coarse pyramids, which an ascent has anyway
            return measure.weights[EPSILON] * at.least_resistance
        return measure(_reached(context, at))

    if options.weights and options.rounds:
        light = with_light_costs(options)
        light_margins = with_light_costs(margins)
        run.set_parameters(problem.parameters(task, start, posture, light_margins))
        floor = -np.inf if best is None else best.climbed
        with stage("climb"):
            raised = climb(run, light, value=value, best=floor, world=context.links)
        if raised is None and best is not None:
            return _behind(measure, best.value)
    if best is not None:
        with stage("foresee"):
            foreseen = measure(_reached(context, run))
        if foreseen <= best.value:
            return _behind(measure, best.value)
    return run.candidate(status, begin), value(run)


def _reached(context: ClimbingContext, run: GraspRun) -> _Reached:
    """The grasp at which a run stands."""
    task = context.task
    points, outward = run.contacts()
    candidate = run.candidate("", 0.0)
    return _Reached(
        task=task,
        T_world_base=task.T_world_object * candidate.T_object_base,
        q=np.clip(candidate.q, task.hand.q_lower, task.hand.q_upper),
        contacts_in_object=ContactSet.from_arrays(
            points,
            -outward,
            mu=task.mu,
            mu_torsion=task.mu_torsion,
            model=task.contact_model,
            fingers=task.finger_names,
        ),
    )


def _behind(measure: Measure, best: float) -> Failure:
    return Failure(
        kind=FALLEN_BEHIND,
        text=f"not verified: {measure.text} would be no more than the best, {best:.4g}",
        numbers={"best": best},
    )
