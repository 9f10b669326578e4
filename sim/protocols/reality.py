"""``reality``: the whole trial again and again, each time with other errors drawn.

Sensors, drives and object are off as a ``Reality`` says, and neither plan nor controller knows how.
The verdict is that of every trial (``sim.verdict``), on the truth.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from planner.plan import GraspPlan
from sim.carrier import Timeline
from sim.protocols.cases import Conditions
from sim.protocols.outcome import Outcome
from sim.protocols.settings import Settings
from sim.reality import LAB, Drawn, Reality, drawn_numbers
from sim.tactile import EXACT
from sim.trial import Trial

RECORD_EVERY = 0.05
"""Time between samples, s."""


@dataclass(frozen=True, kw_only=True)
class RealityCase:
    """One draw.

    Attributes:
        index: Number of the trial; added to the reality's seed.
    """

    index: int

    @property
    def name(self) -> str:
        """Which draw."""
        return f"draw {self.index}"

    def run(self, plan: GraspPlan, conditions: Conditions) -> Outcome:
        """Execute it all."""
        asked = with_errors(conditions.reality)
        reality = asked.seeded(asked.seed + self.index)
        trial = Trial(
            plan,
            physics=conditions.physics,
            controller=conditions.controller(plan),
            timeline=Timeline.quick(),
            record_every=RECORD_EVERY,
            reality=reality,
            estimator=conditions.estimator,
        )
        report = trial.run()
        drawn = Drawn.of(reality, plan.task.hand)
        return Outcome(
            index=self.index,
            name=self.name,
            held=report.success,
            fault=report.verdict.fault,
            other_grasp=report.verdict.other_grasp,
            fingers=report.fingers,
            samples=report.samples,
            recording=report.recording,
            load=np.zeros(len(report.samples)),
            events=report.events,
            conditions={"reality_seed": reality.seed, **drawn_numbers(drawn, plan.task.hand)},
        )


def with_errors(reality: Reality) -> Reality:
    """What the protocol draws from: a laboratory where no errors were asked for.

    Pads are no error: a sense of touch that was chosen is kept.
    """
    if replace(reality, touch=EXACT).ideal:
        return replace(LAB, touch=reality.touch, seed=reality.seed)
    return reality


def reality_cases(settings: Settings, seed: int) -> tuple[RealityCase, ...]:
    """As many draws as the settings say."""
    return tuple(RealityCase(index=k) for k in range(settings.realities))
