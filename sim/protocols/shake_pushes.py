"""Protocols ``shake`` and ``pushes``: a held object is disturbed by its carrier or from outside.

``shake``: the gantry is shaken along and about three axes, one after the other.

    x(t) = e(t) A sin(2 pi f t),    e from 0 to 1 within the first period and back within the last

along the world's axes, or about them through the origin of the hand's base. Gravity stays on. The
servos of the gantry are told rate and acceleration too, so that they follow; what they reached is
reported.

``pushes``: the object is held in the air and pushed again and again, each time from elsewhere.

Pushes act on the centre of mass, last ``PUSH_TIME``, and follow each other after random pauses.
Their directions are random, and so are their forces, up to a share of the object's weight. Nobody
tells the controller of them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from planner.arrays import check_fields
from planner.errors import TaskError
from planner.hands.hand import Hand
from planner.plan import GraspPlan
from planner.spatial import FloatArray, minimum_jerk
from planner.task import GRAVITY
from sim.controllers import Phase
from sim.protocols.disturbance import DisturbanceTrial, Settings
from sim.protocols.outcome import Conditions, Outcome
from sim.scene.gantry import GANTRY_AXES, GANTRY_FREQUENCY, Gantry

TINY = 1e-4
"""Step (s) of the differences that rate and acceleration are taken by."""


@dataclass(frozen=True, kw_only=True)
class ShakeCase:
    """Shaking of one axis of the gantry.

    Attributes:
        index: Number of the axis in ``GANTRY_AXES``.
        settings: Amplitudes, frequency and thresholds.
    """

    index: int
    settings: Settings

    @property
    def name(self) -> str:
        """The axis."""
        return f"shake {GANTRY_AXES[self.index]}"

    def run(self, plan: GraspPlan, conditions: Conditions) -> Outcome:
        """Grip, then shake.

        Raises:
            TaskError: The hand is on an arm and has no gantry.
        """
        settings = self.settings
        hold = DisturbanceTrial.under(conditions, plan, settings)
        gantry = hold.simulation.scene.gantry
        if gantry is None:
            raise TaskError(on_an_arm(plan.task.hand))
        linear = self.index < 3
        asked = 1e-3 * settings.shake_mm if linear else np.deg2rad(settings.shake_deg)
        shaker = Shaker(gantry, self.index, asked, settings.shake_hz, settings.shake_s)
        fault = hold.close_and_squeeze()
        if fault is None:
            hold.simulation.carrier = shaker
            shaker.start(float(hold.simulation.data.time))
            fault = hold.hold_for(settings.shake_s)
        unit, factor = ("mm", 1e3) if linear else ("deg", float(np.rad2deg(1.0)))
        return hold.outcome(
            self,
            fault,
            conditions={
                f"asked_{unit}": factor * asked,
                f"reached_{unit}": factor * shaker.reached,
                "frequency_Hz": settings.shake_hz,
            },
        )


def shake_cases(settings: Settings) -> tuple[ShakeCase, ...]:
    """One for every axis of the gantry."""
    return tuple(ShakeCase(index=i, settings=settings) for i in range(len(GANTRY_AXES)))


def on_an_arm(hand: Hand) -> str:
    """Why a hand's gantry cannot be shaken; "" if it can."""
    if not hand.on_arm:
        return ""
    return (
        f"protocol shake shakes the gantry, and {hand.name} is on an arm; plan with the hand "
        "without its arm"
    )


class Shaker:
    """Moves the gantry to and fro: a ``sim.scene.carrier.Carrier``.

    Attributes:
        reached: Largest coordinate of the shaken axis so far, m or rad.
    """

    def __init__(
        self, gantry: Gantry, axis: int, amplitude: float, frequency: float, duration: float
    ) -> None:
        """Prepare.

        Args:
            gantry: What is shaken.
            axis: Number in ``GANTRY_AXES``.
            amplitude: m or rad.
            frequency: 1/s.
            duration: s.
        """
        self._gantry, self._axis = gantry, axis
        self._amplitude, self._frequency, self._duration = amplitude, frequency, duration
        self._begin = 0.0
        self.reached = 0.0

    def start(self, time: float) -> None:
        """Begin at a time, s."""
        self._begin = time

    def drive(self, data: Any, phase: Phase, share: float) -> None:
        """Set the gantry's commands."""
        del phase, share
        time = float(data.time) - self._begin
        target, velocity = np.zeros(6), np.zeros(6)
        before, now, after = (self.coordinate(time + d) for d in (-TINY, 0.0, TINY))
        acceleration = (after - 2.0 * now + before) / TINY**2
        # servos have the stiffness inertia * GANTRY_FREQUENCY^2
        target[self._axis] = now + acceleration / GANTRY_FREQUENCY**2
        velocity[self._axis] = (after - before) / (2.0 * TINY)
        data.ctrl[self._gantry.ctrl] = self._gantry.command(data, target, velocity)
        self.reached = max(self.reached, abs(float(data.qpos[self._gantry.qpos[self._axis]])))

    def coordinate(self, time: float) -> float:
        """Wanted coordinate (m or rad) at a time since the beginning, s."""
        periods, left = time * self._frequency, (self._duration - time) * self._frequency
        envelope = minimum_jerk(np.clip(min(periods, left), 0.0, 1.0))
        return float(self._amplitude * envelope * np.sin(2.0 * np.pi * periods))


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
        index: Its number; added to the error model's seed.
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
        settings, error_model = self.settings, conditions.error_model
        drawn_anew = error_model.seeded(error_model.seed + self.index)
        hold = DisturbanceTrial.under(conditions, plan, settings, drawn_anew)
        drawn = hold.simulation.error_model
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
        return hold.outcome(
            self,
            fault,
            unit="N",
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
