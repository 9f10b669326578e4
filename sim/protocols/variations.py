"""Protocols ``robust`` and ``errors``: whole trials where things differ from what was planned.

``robust``: the whole trial again with another mass, friction and object pose than planned.

The object is where the plan does not have it, heavier or lighter, more slippery or less; the
controller knows nothing of that. On a table it is moved and turned on the table, in a random
direction; without one in space. The verdict is that of every trial (``sim.verdict``): approach,
closing, lift and hold.

``errors``: the whole trial again and again, each time with other errors drawn.

Sensors, drives and object are off as an ``ErrorModel`` says, and neither plan nor controller knows
how. The verdict is that of every trial (``sim.verdict``), on the truth.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin

from planner.plan import GraspPlan
from planner.spatial import SE3, FloatArray
from sim.protocols.disturbance import Settings
from sim.protocols.outcome import Case, Conditions, Outcome
from sim.report import TrialReport
from sim.scene.carrier import Timeline
from sim.sensing.errors import LAB, Drawn, ErrorModel, drawn_numbers
from sim.sensing.touch import EXACT
from sim.trial import TrialOptions, simulate

RECORD_EVERY = 0.05
"""Time between samples, s."""


@dataclass(frozen=True, kw_only=True)
class RobustCase:
    """One cell of the grid.

    Attributes:
        index: Number of the trial.
        mass: Of the planned one (-).
        friction: Of the simulation's, sliding and torsional (-).
        shift_mm: How far the object is from its place.
        turn_deg: How far it is turned, either way.
        seed: Of the direction of the pose error.
    """

    index: int
    mass: float
    friction: float
    shift_mm: float
    turn_deg: float
    seed: int

    @property
    def name(self) -> str:
        """What differs."""
        return (
            f"mass x{self.mass:g}, friction x{self.friction:g}, "
            f"pose {self.shift_mm:g} mm {self.turn_deg:g} deg"
        )

    def run(self, plan: GraspPlan, conditions: Conditions) -> Outcome:
        """Execute it all."""
        physics, task = conditions.physics, plan.task
        rng = np.random.default_rng([self.seed, self.index])
        true_task = replace(
            task,
            object=replace(task.object, mass=self.mass * task.object.mass),
            T_world_object=displaced(
                task.T_world_object,
                1e-3 * self.shift_mm,
                np.deg2rad(self.turn_deg),
                rng,
                on_table=task.table_height is not None,
            ),
        )
        options = replace(
            _options(plan, conditions),
            physics=replace(
                physics,
                mu=self.friction * physics.mu,
                mu_torsion=self.friction * physics.mu_torsion,
            ),
        )
        changed = {
            "mass_factor": self.mass,
            "friction_factor": self.friction,
            "shift_mm": self.shift_mm,
            "turn_deg": self.turn_deg,
        }
        return _outcome(self, simulate(replace(plan, task=true_task), options), changed)


def robust_cases(settings: Settings, seed: int) -> tuple[RobustCase, ...]:
    """The whole grid."""
    cells = [
        (mass, friction, *error)
        for mass in settings.mass_factors
        for friction in settings.friction_factors
        for error in settings.pose_errors
    ]
    return tuple(
        RobustCase(index=i, mass=m, friction=f, shift_mm=mm, turn_deg=deg, seed=seed)
        for i, (m, f, mm, deg) in enumerate(cells)
    )


def displaced(
    pose: SE3, shift: float, turn: float, rng: np.random.Generator, *, on_table: bool
) -> SE3:
    """A pose shifted (m) and turned (rad) by given amounts in random directions.

    Args:
        pose: In the world.
        shift: m.
        turn: rad, about the origin of ``pose``.
        rng: Gives the directions.
        on_table: Shift horizontally and turn about the vertical only.
    """
    along, about = (_unit(rng) for _ in range(2))
    if on_table:
        angle = rng.uniform(0.0, 2.0 * np.pi)
        along = np.array([np.cos(angle), np.sin(angle), 0.0])
        about = np.array([0.0, 0.0, rng.choice([-1.0, 1.0])])
    return SE3(pin.exp3(turn * about) @ pose.rotation, pose.translation + shift * along)


def _unit(rng: np.random.Generator) -> FloatArray:
    drawn = rng.normal(size=3)
    return np.asarray(drawn / np.linalg.norm(drawn))


@dataclass(frozen=True, kw_only=True)
class ErrorsCase:
    """One draw.

    Attributes:
        index: Number of the trial; added to the error model's seed.
    """

    index: int

    @property
    def name(self) -> str:
        """Which draw."""
        return f"draw {self.index}"

    def run(self, plan: GraspPlan, conditions: Conditions) -> Outcome:
        """Execute it all."""
        asked = with_errors(conditions.error_model)
        error_model = asked.seeded(asked.seed + self.index)
        report = simulate(plan, replace(_options(plan, conditions), error_model=error_model))
        drawn = drawn_numbers(Drawn.of(error_model, plan.task.hand), plan.task.hand)
        return _outcome(self, report, {"error_seed": error_model.seed, **drawn})


def with_errors(error_model: ErrorModel) -> ErrorModel:
    """What the protocol draws from: a laboratory where no errors were asked for.

    Pads are no error: a sense of touch that was chosen is kept.
    """
    if replace(error_model, touch=EXACT).ideal:
        return replace(LAB, touch=error_model.touch, seed=error_model.seed)
    return error_model


def error_cases(settings: Settings, seed: int) -> tuple[ErrorsCase, ...]:
    """As many draws as the settings say."""
    return tuple(ErrorsCase(index=k) for k in range(settings.error_draws))


def _options(plan: GraspPlan, conditions: Conditions) -> TrialOptions:
    """How the whole trial of a plan is run; the controller knows the plan as it is."""
    return TrialOptions(
        physics=conditions.physics,
        controller=conditions.controller(plan),
        timeline=Timeline.quick(),
        record_every=RECORD_EVERY,
        error_model=conditions.error_model,
        estimator=conditions.estimator,
    )


def _outcome(case: Case, report: TrialReport, conditions: Mapping[str, float]) -> Outcome:
    """What became of a whole trial."""
    return Outcome(
        index=case.index,
        name=case.name,
        held=report.success,
        fault=report.verdict.fault,
        other_grasp=report.verdict.other_grasp,
        fingers=report.fingers,
        samples=report.samples,
        recording=report.recording,
        load=np.zeros(len(report.samples)),
        events=report.events,
        conditions=conditions,
    )
