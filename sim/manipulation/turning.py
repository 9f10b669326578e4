"""``Turning``: the turn of a manipulation, in one stroke or in several with regrasps between them.

A regrasp moves one finger on while the others hold the object still:

    gate      the measured contacts of the others close with a margin, under the friction that is
              believed, and the controller has not given up; until then the finger stays
    leave     its force goes over to the others; asked again before it is lifted
    move      the finger goes along its planned way; the force programme no longer knows it
    land      it goes on until it feels the object, and takes its share again
    settle    all fingers hold

The next stroke begins where the object really is. How far it has come is its signed twist in the
palm since the turn began, so what rolling adds or a regrasp loses is made up for.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from typing import TypeAlias

import numpy as np

from planner.contacts import ContactSet
from planner.gait import Relocation, plan_back
from planner.gait.order import CLOSURE_EDGES
from planner.quality import force_closure
from sim.contacts import hand_contacts, merge_per_finger
from sim.controllers.schedule import RAMP
from sim.manipulation.away import FingerAway
from sim.manipulation.checks import Outcome
from sim.manipulation.pace import Bounds, Pace, Step
from sim.manipulation.plan import ManipulationPlan
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

MEASURED_MARGIN = 0.02
"""Least normalised min-weight (-) of the measured contacts that are to hold while a finger is away;
planned is ``planner.gait.order.LIFT_MARGIN``."""


class Turning:
    """The parts of one turn.

    Attributes:
        turned: How far the object has come since the turn began, rad, with its sign.
    """

    def __init__(self, plan: ManipulationPlan, stage: Stage, pace: Pace, bounds: Bounds) -> None:
        """Prepare; see ``parts``."""
        self._plan, self._stage, self._pace, self._bounds = plan, stage, pace, bounds
        self._task = plan.motion.grasp.task
        self._grip = stage.driver.holding.grip
        self._back: tuple[Relocation, ...] = ()

    def parts(self) -> Iterator[Part]:
        """Strokes and regrasps in turn; which ones depends on how far the earlier ones came."""
        self._stage.watch.mark(self._stage.data)
        gait = self._plan.gait
        if gait is None:
            yield "turn", "", self._whole
            for move in self._back:
                yield "regrasp", move.finger, partial(self._regrasp, move)
            if self._back:
                yield "turn", "again", self._rest
            return
        moves = [r for r in gait.relocations if r.cycle == 0]
        most = gait.cycles + MORE_CYCLES
        for cycle in range(1, most + 1):
            yield "turn", f"stroke {cycle}", self._stroke
            if self._left <= CLOSE_TO or cycle == most:
                return
            for move in moves:
                yield "regrasp", move.finger, partial(self._regrasp, move)

    def regrasps_on(self) -> str:
        """Let ``parts`` go on with a regrasp after a turn that stalled; why it cannot, "" if so."""
        if self._plan.gait is not None or self._back:
            return "regrasps were made already"
        if self._plan.back or self._plan.shift.any():
            return "it is to be moved, or turned back"
        found = plan_back(self._plan.motion, self._stage.driver.reference.place)
        if isinstance(found, str):
            return found
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
        limited = ", ".join(driver.limited_actuators())
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

    def _regrasp(self, move: Relocation) -> Outcome:
        """Move one finger on."""
        stage, holding = self._stage, self._stage.driver.holding
        i = self._task.finger_names.index(move.finger)
        numbers: dict[str, float] = {}
        holding.keep()
        holding.grip = move.grip
        fault = self._gated(move.finger, numbers)
        if not fault:
            holding.leave(move.finger)
            fault = stage.advance(
                "regrasp", RAMP, wait=RAMP, until=lambda _: not holding.schedule.holding[i]
            ) or self._gated(move.finger, numbers)
        if fault:
            holding.join(move.finger)
            return fault, numbers | self.in_hand()
        fault = self._moved(move, i) or stage.advance("regrasp", RAMP)
        holding.grip = self._grip
        numbers |= self.in_hand()
        if not fault:
            off = self._off_landing(move)
            if np.isnan(off):
                fault = f"{move.finger} has lost the object again"
            numbers["landed_off_mm"] = 1e3 * off
        return fault, numbers

    def _gated(self, finger: str, numbers: dict[str, float]) -> str:
        """Wait until the others hold; why they do not, "" if they do."""
        end = self._stage.data.time + self._pace.lift_wait
        while (why := self._refused(finger, numbers)) and self._stage.data.time < end:
            fault = self._stage.advance("regrasp", GATE_PERIOD)
            if fault:
                return fault
        return why and f"{finger} cannot be lifted: {why}"

    def _refused(self, finger: str, numbers: dict[str, float]) -> str:
        """Why a finger may not be lifted now, "" if it may."""
        numbers["margin"] = margin = self._margin(finger)
        if margin < MEASURED_MARGIN:
            return (
                f"the measured contacts of the others close with {margin:.3f} (at least "
                f"{MEASURED_MARGIN})"
            )
        return self._stage.driver.holding.gave_up

    def _margin(self, without: str) -> float:
        """Normalised min-weight (-) of the measured contacts without one finger; -inf for none."""
        merged = merge_per_finger(hand_contacts(self._stage.scene, self._stage.data))
        rest = [c for c in (merged[k] for k in range(len(merged))) if c.finger not in (without, "")]
        if len(rest) < self._task.fingers_needed:
            return -np.inf
        contacts = ContactSet.from_contacts(rest, center=merged.center)
        closure = force_closure(contacts.with_friction(self._task.mu), edges=CLOSURE_EDGES)
        return (
            closure.normalised_min_weight
            if closure.closed
            else min(0.0, closure.normalised_min_weight)
        )

    def _moved(self, move: Relocation, i: int) -> str:
        """Lead a finger along its way until it has landed; what ended it early, "" if nothing."""
        stage, holding = self._stage, self._stage.driver.holding
        away = FingerAway(self._plan.motion.grasp, move, self._pace.finger_rate)
        stuck = False

        def landed(_: bool) -> bool:
            nonlocal stuck
            if not away.over:
                return False
            if not holding.schedule.wanted[i]:
                stuck = bool(holding.schedule.touching[i])
                holding.join(move.finger)
            return stuck or bool(holding.schedule.touching[i])

        stage.driver.away = away
        longest = away.duration + self._pace.land_wait
        fault = stage.advance("regrasp", 0.0, wait=longest, until=landed)
        stage.driver.away = None
        if fault:
            return fault
        if stuck:
            return f"{move.finger} did not come off the object"
        if not holding.schedule.touching[i]:
            return f"{move.finger} did not find the object where it was to land"
        return ""

    def _off_landing(self, move: Relocation) -> float:
        """Distance (m) of a finger's measured contact from where it was to land, in the palm."""
        stage = self._stage
        merged = merge_per_finger(hand_contacts(stage.scene, stage.data))
        if move.finger not in merged.fingers:
            return float("nan")
        T_palm_world = stage.scene.body_pose(stage.data, stage.scene.palm_body).inverse()
        there = T_palm_world.act(merged[merged.fingers.index(move.finger)].position)
        planned = self._plan.motion.grasp.T_world_palm.inverse().act(move.landing.position)
        return float(np.linalg.norm(there - planned))


GATE_PERIOD = 0.05
"""Time (s) between looks at whether a finger may be lifted."""
