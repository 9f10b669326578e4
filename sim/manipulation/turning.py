"""``Turning``: the turn of a manipulation, in one stroke or in several with regrasps between them.

Where a lift is refused, the fingers that are left may move on in another order, planned there and
then. The next stroke begins where the object really is. How far it has come is its signed twist in
the palm since the turn began, so what rolling adds or a regrasp loses is made up for.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from typing import TypeAlias

import numpy as np

from planner.failure import Failure
from planner.motion.gait import Relocation, plan_back, plan_others
from planner.motion.manipulation import ManipulationPlan
from sim.contacts import hand_contacts
from sim.manipulation.checks import Outcome
from sim.manipulation.pace import Bounds, Pace, Step
from sim.manipulation.regrasping import Regrasping
from sim.manipulation.stage import Stage

__all__ = ["Part", "Turning"]

Part: TypeAlias = tuple[Step, str, Callable[[], Outcome]]
"""A phase, what it is about, and what performs it."""

STILL_SPEED = np.deg2rad(3.0)
"""Rate (rad/s) below which a turn that has reached its angle has ended."""

CLOSE_TO = np.deg2rad(0.4)
"""A turn this near (rad) to its end is made."""

LEAST_OF_STROKE = 0.4
"""Least share (-) of a stroke's angle with which it makes sense to go on."""

MORE_CYCLES = 3
"""Strokes beyond those planned: what was lost in regrasps is made up for."""


class Turning:
    """The parts of one turn.

    Attributes:
        turned: How far the object has come since the turn began, rad, with its sign.
    """

    def __init__(self, plan: ManipulationPlan, stage: Stage, pace: Pace, bounds: Bounds) -> None:
        """Prepare; see ``parts``."""
        self._plan, self._stage, self._pace, self._bounds = plan, stage, pace, bounds
        self._task = plan.motion.grasp.task
        self._regrasping = Regrasping(plan, stage, pace)
        self._back: tuple[Relocation, ...] = ()
        self._left_to_move: list[Relocation] = []
        self._have_moved: list[str] = []

    def parts(self) -> Iterator[Part]:
        """Strokes and regrasps in turn; which ones depends on how far the earlier ones came."""
        self._stage.watch.mark(self._stage.data)
        gait = self._plan.gait
        if gait is None:
            yield "turn", "", self._whole
            for move in self._back:
                yield "regrasp", move.finger, partial(self._moved_on, move)
            if self._back:
                yield "turn", "again", self._rest
            return
        moves = tuple(r for r in gait.relocations if r.cycle == 0)
        most = gait.cycles + MORE_CYCLES
        for cycle in range(1, most + 1):
            yield "turn", f"stroke {cycle}", self._stroke
            if self._left <= CLOSE_TO or cycle == most:
                return
            self._left_to_move, self._have_moved = list(moves), []
            while self._left_to_move:
                move = self._left_to_move.pop(0)
                yield "regrasp", move.finger, partial(self._moved_on, move)

    def another_order(self) -> str:
        """Let ``parts`` go on with another finger after a lift was refused; why not, "" if so."""
        refused = self._regrasping.refused
        if self._plan.gait is None or not refused:
            return "the turn is over"
        found = plan_others(self._plan.gait.motion, self._have_moved, refused)
        if isinstance(found, Failure):
            return found.text
        self._left_to_move = list(found)
        return ""

    def regrasps_on(self) -> str:
        """Let ``parts`` go on with a regrasp after a turn that stalled; why it cannot, "" if so."""
        if self._plan.gait is not None or self._back:
            return "regrasps were made already"
        if self._plan.ending.back or self._plan.shift.any():
            return "it is to be moved, or turned back"
        found = plan_back(self._plan.motion, self._stage.driver.reference.place)
        if isinstance(found, Failure):
            return found.text
        self._back = found
        return ""

    @property
    def turned(self) -> float:
        """See the class."""
        return self._stage.watch.moved(self._stage.data)[0]

    @property
    def _left(self) -> float:
        """Turn that is still to be made, rad; negative beyond the goal."""
        return float(np.sign(self._plan.angle)) * (self._plan.angle - self.turned)

    def back(self) -> Outcome:
        """Make the motion backwards, to where it began."""
        stage = self._stage
        stage.driver.begin_back()
        fault = self._led("back")
        numbers = self.in_hand()
        if not fault and numbers["tilt_deg"] > self._bounds.tilt_deg:
            fault = f"tilted by {numbers['tilt_deg']:.1f} degrees off the axis"
        if not fault and abs(numbers["turn_deg"]) > self._bounds.angle_deg:
            fault = f"{numbers['turn_deg']:.1f} degrees are left of the turn: {self._obstacle()}"
        return fault, numbers

    def in_hand(self) -> dict[str, float]:
        """How the object lies in the palm, against how it lay when the turn began."""
        turn, tilt, shift = self._stage.watch.moved(self._stage.data)
        fingers = set(hand_contacts(self._stage.scene, self._stage.data).fingers)
        numbers = {
            "turn_deg": float(np.rad2deg(turn)),
            "tilt_deg": float(np.rad2deg(tilt)),
            "shift_mm": 1e3 * float(np.linalg.norm(shift)),
            "fingers": float(len(fingers - {""})),
        }
        if self._plan.shift.any():
            asked = self._plan.motion.grasp.T_world_palm.rotation.T @ self._plan.shift
            numbers["shift_off_mm"] = 1e3 * float(np.linalg.norm(shift - asked))
        return numbers

    def stalled(self, numbers: dict[str, float]) -> str:
        """Why the turn is not what was asked for, "" if it is."""
        asked = float(np.rad2deg(self._plan.angle))
        turned, tilt = numbers["turn_deg"], numbers["tilt_deg"]
        if abs(asked - turned) > self._bounds.angle_deg:
            return f"turned {turned:.1f} of {asked:.1f} degrees: {self._obstacle()}"
        if tilt > self._bounds.tilt_deg:
            return f"tilted by {tilt:.1f} degrees off the axis"
        off = numbers.get("shift_off_mm", 0.0)
        if off > self._bounds.shift_mm:
            return f"{off:.1f} mm from where it was to be moved: {self._obstacle()}"
        return ""

    def _obstacle(self) -> str:
        """What the controller says about why the object does not follow."""
        driver = self._stage.driver
        limited = ", ".join(driver.saturated_actuators())
        why = driver.holding.gave_up
        return why or (f"{limited} had no more to give" if limited else "it did not follow")

    def _whole(self) -> Outcome:
        fault = self._led()
        numbers = self.in_hand()
        return fault or self.stalled(numbers), numbers

    def _rest(self) -> Outcome:
        self._stage.driver.begin_stroke(self._plan.angle - self.turned)
        return self._whole()

    def _stroke(self) -> Outcome:
        stage, before = self._stage, self.turned
        asked = abs(stage.driver.begin_stroke(self._plan.angle - before).goal)
        fault = self._led()
        numbers = self.in_hand()
        made = abs(self.turned - before)
        numbers["stroke_deg"] = float(np.rad2deg(made))
        last = self._left <= CLOSE_TO
        if not fault and not last and made < LEAST_OF_STROKE * asked:
            fault = (
                f"turned {np.rad2deg(made):.1f} of the stroke's {np.rad2deg(asked):.1f} degrees: "
                f"{self._obstacle()}"
            )
        if not fault and numbers["tilt_deg"] > self._bounds.tilt_deg:
            fault = f"tilted by {numbers['tilt_deg']:.1f} degrees off the axis"
        return fault, numbers

    def _led(self, step: Step = "turn") -> str:
        """Let the reference lead until its turn is made; what ended it early, "" if nothing."""
        reference, dt = self._stage.driver.reference, self._stage.scene.physics.timestep
        last = reference.left

        def made(_: bool) -> bool:
            nonlocal last
            rate = (reference.left - last) / dt
            last = reference.left
            there = reference.arrived if reference.goal == 0.0 else reference.left <= CLOSE_TO
            return bool(there and abs(rate) < STILL_SPEED)

        fastest = abs(reference.goal) / self._pace.turn_rate
        return self._stage.advance(step, fastest, wait=self._pace.turn_wait, until=made)

    def _moved_on(self, move: Relocation) -> Outcome:
        """Move one finger on."""
        fault, numbers = self._regrasping.perform(move)
        if not fault:
            self._have_moved.append(move.finger)
        return fault, numbers | self.in_hand()
