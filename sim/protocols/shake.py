"""``shake``: the gantry is shaken along and about three axes, one after the other.

    x(t) = e(t) A sin(2 pi f t),    e from 0 to 1 within the first period and back within the last

along the world's axes, or about them through the origin of the hand's base. Gravity stays on. The
servos of the gantry are told rate and acceleration too, so that they follow; what they reached is
reported.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from planner.errors import TaskError
from planner.hands.hand import Hand
from planner.plan import GraspPlan
from planner.spatial import minimum_jerk
from sim.controllers import Phase
from sim.gantry import GANTRY_AXES, GANTRY_FREQUENCY, Gantry
from sim.protocols.cases import Conditions
from sim.protocols.disturbance import DisturbanceTrial
from sim.protocols.outcome import Outcome
from sim.protocols.settings import Settings

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
        hold = DisturbanceTrial(
            plan,
            controller=conditions.controller(plan),
            physics=conditions.physics,
            reality=conditions.reality,
            estimator=conditions.estimator,
            dropped=settings.dropped,
        )
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
        return Outcome(
            index=self.index,
            name=self.name,
            held=fault is None,
            fault=fault,
            fingers=plan.task.finger_names,
            samples=hold.samples,
            recording=hold.recording,
            load=hold.loads,
            events=hold.simulation.events,
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
    if hand.arm is None:
        return ""
    return (
        f"protocol shake shakes the gantry, and {hand.name} is on an arm; plan with the hand "
        "without its arm"
    )


class Shaker:
    """Moves the gantry to and fro: a ``sim.carrier.Carrier``.

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
