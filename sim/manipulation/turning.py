"""``Turning``: the phases "turn" and "back", and how far the object has come in the palm.

A stroke begins where the object really is. How far it has come is its signed twist in the palm
since the turn began, so what rolling adds or a regrasp loses is made up for.
"""

from __future__ import annotations

import numpy as np

from planner.motion.manipulation import ManipulationPlan
from sim.controllers import Observation
from sim.manipulation.machine import CLOSE_TO
from sim.manipulation.results import Measured
from sim.manipulation.simulation import ManipulationSim
from sim.manipulation.timeline import ManipulationPhase, ManipulationTimeline, SuccessCriteria

__all__ = ["Turning"]

STILL_SPEED = np.deg2rad(3.0)
"""Rate (rad/s) below which a turn that has reached its angle has ended."""

LEAST_OF_STROKE = 0.4
"""Least share (-) of a stroke's angle with which it makes sense to go on."""


class Turning:
    """The turn of one run."""

    def __init__(
        self,
        plan: ManipulationPlan,
        run: ManipulationSim,
        timeline: ManipulationTimeline,
        criteria: SuccessCriteria,
    ) -> None:
        """Prepare."""
        self._plan, self._run, self._timeline, self._criteria = plan, run, timeline, criteria
        self._begun = False

    @property
    def turned(self) -> float:
        """How far the object has come since the turn began, rad, with its sign."""
        return self._run.recorder.moved()[0]

    @property
    def left(self) -> float:
        """Turn that is still to be made, rad; negative beyond the goal."""
        return float(np.sign(self._plan.angle)) * (self._plan.angle - self.turned)

    def turn(self) -> Measured:
        """The turn, or its next stroke, from where the object is."""
        first, self._begun = not self._begun, True
        if first:
            self._run.recorder.mark_reference()
        if self._plan.gait is not None:
            return self._stroke()
        if not first:  # fingers went back to where the motion began
            self._run.driver.begin_stroke(self._plan.angle - self.turned)
        fault = self._follow("turn")
        numbers = self.in_hand()
        return fault or self.shortfall(numbers), numbers

    def back(self) -> Measured:
        """The motion backwards, to where it began."""
        self._run.driver.begin_back()
        fault = self._follow("back")
        numbers = self.in_hand()
        fault = fault or self._tilted(numbers)
        if not fault and abs(numbers["turn_deg"]) > self._criteria.angle_deg:
            fault = f"{numbers['turn_deg']:.1f} degrees are left of the turn: {self._obstacle()}"
        return fault, numbers

    def in_hand(self) -> dict[str, float]:
        """How the object lies in the palm, against how it lay when the turn began."""
        turn, tilt, shift = self._run.recorder.moved()
        numbers = {
            "turn_deg": float(np.rad2deg(turn)),
            "tilt_deg": float(np.rad2deg(tilt)),
            "shift_mm": 1e3 * float(np.linalg.norm(shift)),
            "fingers": float(len(self._run.touching_fingers)),
        }
        if self._plan.shift.any():
            asked = self._plan.grasp.T_world_palm.rotation.T @ self._plan.shift
            numbers["shift_off_mm"] = 1e3 * float(np.linalg.norm(shift - asked))
        return numbers

    def shortfall(self, numbers: dict[str, float]) -> str:
        """Why the turn is not what was asked for, "" if it is."""
        asked = float(np.rad2deg(self._plan.angle))
        turned = numbers["turn_deg"]
        if abs(asked - turned) > self._criteria.angle_deg:
            return f"turned {turned:.1f} of {asked:.1f} degrees: {self._obstacle()}"
        off = numbers.get("shift_off_mm", 0.0)
        fault = self._tilted(numbers)
        if not fault and off > self._criteria.shift_mm:
            fault = f"{off:.1f} mm from where it was to be moved: {self._obstacle()}"
        return fault

    def _stroke(self) -> Measured:
        before = self.turned
        asked = abs(self._run.driver.begin_stroke(self._plan.angle - before).goal)
        fault = self._follow("turn")
        numbers = self.in_hand()
        made = abs(self.turned - before)
        numbers["stroke_deg"] = float(np.rad2deg(made))
        if not fault and self.left > CLOSE_TO and made < LEAST_OF_STROKE * asked:
            fault = (
                f"turned {np.rad2deg(made):.1f} of the stroke's {np.rad2deg(asked):.1f} degrees: "
                f"{self._obstacle()}"
            )
        return fault or self._tilted(numbers), numbers

    def _follow(self, phase: ManipulationPhase) -> str:
        """Run until the reference's turn is made; what ended it early, "" if nothing."""
        reference, dt = self._run.driver.reference, self._run.simulation.timestep
        last = reference.left

        def made(_: Observation) -> bool:
            nonlocal last
            rate = (reference.left - last) / dt
            last = reference.left
            there = reference.arrived if reference.goal == 0.0 else reference.left <= CLOSE_TO
            return bool(there and abs(rate) < STILL_SPEED)

        fastest = abs(reference.goal) / self._timeline.turn_rate
        return self._run.run(phase, fastest, wait=self._timeline.turn_wait, until=made)

    def _tilted(self, numbers: dict[str, float]) -> str:
        tilt = numbers["tilt_deg"]
        if tilt <= self._criteria.tilt_deg:
            return ""
        return f"tilted by {tilt:.1f} degrees off the axis"

    def _obstacle(self) -> str:
        """What the controller says about why the object does not follow."""
        holding = self._run.driver.holding
        saturated = ", ".join(self._run.driver.saturated_actuators())
        had_no_more = f"{saturated} had no more to give" if saturated else "it did not follow"
        return holding.gave_up or had_no_more
