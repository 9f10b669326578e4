"""One plan of a grade, executed under a condition: a sample of ``bench metrics``.

Grades make plans of mixed quality, conditions make trials in which some fail. Both are fixed
tables, so that every metric is asked the same questions.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import ClassVar

import mujoco
import numpy as np

from benchmarks.predictors import predictors_of
from benchmarks.requests import Setting, task_for
from benchmarks.run import ObjectJob
from planner.errors import NoGraspFoundError, PlannerError
from planner.plan import GraspPlan
from planner.search import plan_grasp
from planner.spatial import FloatArray
from planner.synthesis.options import SynthesisOptions
from planner.task import DEFAULT_MU
from sim.physics import PhysicsOptions
from sim.reality import Reality
from sim.report import TrialReport
from sim.simulation import Simulation
from sim.tables import Row
from sim.trial import Timeline, Trial


@dataclass(frozen=True, kw_only=True)
class Grade:
    """How a plan is made.

    Attributes:
        options: Of the search.
        mu: Friction that planning relies on (-).
    """

    options: SynthesisOptions
    mu: float = DEFAULT_MU


_LOOSE = SynthesisOptions(rounds=0, cone_share=0.95, weight_center=0.0)

GRADES = {
    "best": Grade(options=SynthesisOptions()),
    "plain": Grade(options=SynthesisOptions(rounds=0)),
    "loose": Grade(options=_LOOSE),
    "reckless": Grade(options=_LOOSE, mu=1.0),
}
"""From the planner's best to plans that accept any contacts and rely on a friction of 1, where the
trials have 0.6 or less."""


@dataclass(frozen=True, kw_only=True)
class Condition:
    """How a trial differs from the plan.

    Attributes:
        mu: Friction in simulation (-).
        mass_factor: True over planned mass (-).
        shift: Position error of the object in a random horizontal direction, m.
        push: Force that pushes the held object along six directions in turn, over its weight (-).
    """

    mu: float = 0.6
    mass_factor: float = 1.0
    shift: float = 0.0
    push: float = 0.0


CONDITIONS = {
    "as planned": Condition(),
    "slippery": Condition(mu=0.27),
    "heavy": Condition(mass_factor=3.0),
    "displaced": Condition(shift=0.015),
    "pushed": Condition(push=2.3),
}
"""All but the first make part of the grasps fail, each for another reason."""

TIMELINE = Timeline.quick(settle=0.1, hold=1.2)
"""Shorter than the default timeline: 2.8 s of simulated time instead of 5.3 s."""

RECORD_EVERY = 0.05
"""Time between samples, s: four samples for each direction of the push."""

DIRECTIONS = np.concatenate([np.eye(3), -np.eye(3)])
"""Directions of the push, world axes; each for a sixth of the hold."""

MAX_ATTEMPTS = 20
"""Attempts at a plan; a sample without one is not counted."""


@dataclass(frozen=True, kw_only=True)
class Sample(ObjectJob):
    """What is to be tried.

    Attributes:
        grade: Name out of ``GRADES``.
        condition: Name out of ``CONDITIONS``.
        seed: Seed of the measurement; what is drawn depends on it and on ``index``.
        reality: Errors of sensors, drives and object, drawn from ``index``.
    """

    SHOWN: ClassVar = ("hand", "label", "grade", "condition")

    grade: str
    condition: str
    seed: int
    reality: Reality = field(default_factory=Reality)

    def lost(self, reason: str) -> Row:
        """The row of a sample that nothing came of."""
        return self.row(found=False, success=None, reason=reason)


def try_sample(sample: Sample, check: Callable[[], None]) -> Row:
    """Plan, note the predictors, execute: a row of plain data.

    Args:
        sample: What.
        check: Called between attempts and after the trial; what it raises ends it.
    """
    rng = np.random.default_rng([sample.seed, sample.index])
    grade = GRADES[sample.grade]
    task = task_for(sample.hand, sample.spec, Setting(mu=grade.mu))
    if isinstance(task, str):
        return sample.lost(task)
    try:
        plan = plan_grasp(
            task,
            seed=int(rng.integers(2**62)),
            max_attempts=MAX_ATTEMPTS,
            options=grade.options,
            progress=lambda _: check(),
        )
    except NoGraspFoundError:
        return sample.lost("no plan")
    except PlannerError as error:
        return sample.lost(str(error))
    reality = sample.reality.seeded(sample.index)
    verdict = trial_under(plan, CONDITIONS[sample.condition], rng, reality=reality).verdict
    check()
    return sample.row(
        found=True,
        success=verdict.success,
        reason=verdict.reason,
        predictors=predictors_of(plan),
    )


def trial_under(
    plan: GraspPlan,
    condition: Condition,
    rng: np.random.Generator,
    record_every: float = RECORD_EVERY,
    reality: Reality | None = None,
) -> TrialReport:
    """A trial under a condition and a reality, with a sample every so often (s)."""
    item = plan.task.object
    heavier = replace(item, mass=condition.mass_factor * item.mass)
    changed = replace(plan, task=replace(plan.task, object=heavier))
    trial = Trial(
        changed,
        physics=PhysicsOptions(mu=condition.mu),
        timeline=TIMELINE,
        record_every=record_every,
        reality=reality,
    )
    angle = rng.uniform(0.0, 2 * np.pi)
    aside = condition.shift * np.array([np.cos(angle), np.sin(angle)])
    scene, data = trial.simulation.scene, trial.simulation.data
    data.qpos[scene.object_qpos[:2]] += aside
    mujoco.mj_forward(scene.model, data)
    weight = item.mass * float(np.linalg.norm(plan.task.gravity))
    return trial.run(on_step=_pusher(condition.push * weight * DIRECTIONS))


def _pusher(forces: FloatArray) -> Callable[[Simulation], None]:
    """Push with forces (6, 3), N, at the centre of mass, one after the other during the hold."""
    steps = 0

    def push(simulation: Simulation) -> None:
        nonlocal steps
        if simulation.phase == "hold":
            total = TIMELINE.hold / simulation.scene.physics.timestep
            k = min(len(forces) - 1, int(len(forces) * steps / total))
            simulation.data.xfrc_applied[simulation.scene.object_body, :3] = forces[k]
            steps += 1

    return push
