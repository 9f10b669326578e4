"""``Regrasping``: one finger moves on while the others hold the object still.

gate      the measured contacts of the others close with a margin, under the friction and the
contact model that are believed, and the controller has not given up; until then the finger stays
leave     its force goes over to the others; asked again before it is lifted
move      the finger goes along its planned way; the force programme no longer knows it
land      it goes on until it feels the object, and takes its share again
settle    all fingers hold
"""

from __future__ import annotations

import numpy as np

from planner.contacts import ContactSet
from planner.motion.gait import Relocation
from planner.motion.manipulation import ManipulationPlan
from planner.quality import force_closure
from planner.tolerances import CLOSURE_EDGES
from sim.contacts import as_believed, hand_contacts, merge_per_finger
from sim.controllers.schedule import RAMP
from sim.manipulation.away import FingerAway
from sim.manipulation.checks import Outcome
from sim.manipulation.pace import Pace
from sim.manipulation.stage import Stage

__all__ = ["Regrasping"]

MEASURED_MARGIN = 0.02
"""Least normalised min-weight (-) of the measured contacts that are to hold while a finger is away;
planned is ``planner.motion.gait.order.CLOSURE_MARGIN``."""

GATE_PERIOD = 0.05
"""Time (s) between looks at whether a finger may be lifted."""


class Regrasping:
    """Moves fingers on, one after the other.

    Attributes:
        refused: Fingers that could not be lifted since the last one that was.
    """

    def __init__(self, plan: ManipulationPlan, stage: Stage, pace: Pace) -> None:
        """Prepare."""
        self._plan, self._stage, self._pace = plan, stage, pace
        self._task = plan.motion.grasp.task
        self._grip = stage.driver.holding.grip
        self.refused: tuple[str, ...] = ()

    def perform(self, move: Relocation) -> Outcome:
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
            holding.grip = self._grip
            if stage.touched:
                self.refused = (*self.refused, move.finger)
            return fault, numbers
        self.refused = ()
        fault = self._moved(move, i) or stage.advance("regrasp", RAMP)
        holding.grip = self._grip
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
        closure = force_closure(as_believed(contacts, self._task), edges=CLOSURE_EDGES)
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
