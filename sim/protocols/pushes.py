"""``pushes``: the object is held in the air and pushed again and again, each time from elsewhere.

Pushes act on the centre of mass, last ``PUSH_TIME``, and follow each other after random pauses.
Their directions are random, and so are their forces, up to a share of the object's weight. Nobody
tells the controller of them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from planner.arrays import check_fields
from planner.plan import GraspPlan
from planner.spatial import FloatArray
from planner.task import GRAVITY
from sim.protocols.cases import Conditions
from sim.protocols.disturbance import DisturbanceTrial
from sim.protocols.outcome import Outcome
from sim.protocols.settings import Settings

PUSH_TIME = 0.3
"""Duration of a push, s."""

PAUSE = (0.2, 1.0)
"""Time between pushes, s: about 65 pushes a minute."""

LEAST = 0.3
"""Weakest push, as a share of the strongest (-)."""


@dataclass(frozen=True, kw_only=True)
class Push:
    """One push.

    Attributes:
        begin: s, since the hold began.
        force: (3,), N, world.
    """

    begin: float
    force: tuple[float, float, float]

    def __post_init__(self) -> None:
        """Check every number."""
        check_fields(self, ("begin",), least=0.0, unit="s")
        check_fields(self, ("force",), unit="N")


def drawn_pushes(seconds: float, strongest: float, rng: np.random.Generator) -> tuple[Push, ...]:
    """Pushes that are over before a time.

    Args:
        seconds: That time, s.
        strongest: Largest force, N.
        rng: Draws.
    """
    pushes = []
    begin = float(rng.uniform(*PAUSE))
    while begin + PUSH_TIME < seconds:
        direction = rng.normal(size=3)
        direction *= rng.uniform(LEAST, 1.0) * strongest / np.linalg.norm(direction)
        x, y, z = direction.tolist()
        pushes.append(Push(begin=begin, force=(x, y, z)))
        begin += PUSH_TIME + float(rng.uniform(*PAUSE))
    return tuple(pushes)


@dataclass(frozen=True, kw_only=True)
class PushesCase:
    """One hold.

    Attributes:
        index: Its number; added to the reality's seed.
        settings: Duration, force and threshold.
        seed: Of the pushes, with the number.
    """

    index: int
    settings: Settings
    seed: int

    @property
    def name(self) -> str:
        """Which."""
        return f"pushes {self.index}"

    def run(self, plan: GraspPlan, conditions: Conditions) -> Outcome:
        """Grip, then hold on while it is pushed."""
        settings, reality = self.settings, conditions.reality
        hold = DisturbanceTrial(
            plan,
            controller=conditions.controller(plan),
            physics=conditions.physics,
            dropped=settings.dropped,
            reality=reality.seeded(reality.seed + self.index),
            estimator=conditions.estimator,
        )
        drawn = hold.simulation.reality
        strongest = -GRAVITY[2] * settings.push_load * plan.task.object.mass
        rng = np.random.default_rng([self.seed, self.index])
        pushes = drawn_pushes(settings.pushes_s, strongest, rng)
        survived = 0
        fault = hold.close_and_squeeze()
        if fault is None:
            begin = hold.simulation.time

            def push(since: float) -> None:
                force = _force_at(pushes, since)
                hold.load = float(np.linalg.norm(force))
                hold.push(np.append(force, np.zeros(3)))

            fault = hold.hold_for(settings.pushes_s, each_step=push)
            held_s = hold.simulation.time - begin
            survived = sum(one.begin + PUSH_TIME <= held_s for one in pushes)
        return Outcome(
            index=self.index,
            name=self.name,
            held=fault is None,
            fault=fault,
            fingers=plan.task.finger_names,
            samples=hold.samples,
            recording=hold.recording,
            load=hold.loads,
            unit="N",
            events=hold.simulation.events,
            conditions={
                "pushes": float(len(pushes)),
                "pushes_survived": float(survived),
                "strongest_N": strongest,
                **({} if drawn is None else drawn.numbers),
            },
        )


def pushes_cases(settings: Settings, seed: int) -> tuple[PushesCase, ...]:
    """As many holds as the settings say."""
    return tuple(PushesCase(index=k, settings=settings, seed=seed) for k in range(settings.pushes))


def _force_at(pushes: tuple[Push, ...], time: float) -> FloatArray:
    """Force (3,), N, at a time since the hold began, s."""
    for push in pushes:
        if push.begin <= time < push.begin + PUSH_TIME:
            return np.array(push.force)
    return np.zeros(3)
