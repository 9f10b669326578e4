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
from planner.motion.manipulation import ManipulationPlan
from planner.motion.phase import Relocation
from planner.quality import force_closure
from planner.task import GraspTask
from planner.tolerances import CLOSURE_EDGES
from sim.contacts import hand_contacts, merge_per_finger, with_planned_friction
from sim.controllers import Observation
from sim.controllers.monitors import RAMP
from sim.manipulation.driver import FingerSwing
from sim.manipulation.simulation import ManipulationSim
from sim.manipulation.timeline import ManipulationTimeline, Measured

MEASURED_MARGIN = 0.02
"""Least normalised min-weight (-) of the measured contacts that are to hold while a finger is away;
planned is ``planner.motion.order.CLOSURE_MARGIN``."""

GATE_PERIOD = 0.05
"""Time (s) between looks at whether a finger may be lifted."""


class Regrasping:
    """Moves fingers on, one after the other.

    Attributes:
        refused: Fingers that could not be lifted since the last one that was.
    """

    def __init__(
        self, plan: ManipulationPlan, sim: ManipulationSim, timeline: ManipulationTimeline
    ) -> None:
        """Prepare."""
        self._plan, self._sim, self._timeline = plan, sim, timeline
        self._task = plan.task
        self._grip = sim.driver.holding.grip
        self.refused: tuple[str, ...] = ()

    def perform(self, move: Relocation) -> Measured:
        """Move one finger on."""
        sim, holding = self._sim, self._sim.driver.holding
        i = self._task.finger_names.index(move.finger)
        numbers: dict[str, float] = {}
        holding.keep()
        holding.grip = move.grip
        fault = self._gated(move.finger, numbers)
        if not fault:
            holding.leave(move.finger)
            fault = sim.run(
                "regrasp", RAMP, wait=RAMP, until=lambda _: not holding.schedule.holding[i]
            ) or self._gated(move.finger, numbers)
        if fault:
            holding.join(move.finger)
            holding.grip = self._grip
            if sim.touched:
                self.refused = (*self.refused, move.finger)
            return fault, numbers
        self.refused = ()
        fault = self._moved(move, i) or sim.run("regrasp", RAMP)
        holding.grip = self._grip
        if not fault:
            off = self._off_landing(move)
            if np.isnan(off):
                fault = f"{move.finger} has lost the object again"
            numbers["landed_off_mm"] = 1e3 * off
        return fault, numbers

    def _gated(self, finger: str, numbers: dict[str, float]) -> str:
        """Wait until the others hold; why they do not, "" if they do."""
        end = self._sim.simulation.time + self._timeline.lift_wait
        while (why := self._refused(finger, numbers)) and self._sim.simulation.time < end:
            fault = self._sim.run("regrasp", GATE_PERIOD)
            if fault:
                return fault
        return why and f"{finger} cannot be lifted: {why}"

    def _refused(self, finger: str, numbers: dict[str, float]) -> str:
        """Why a finger may not be lifted now, "" if it may."""
        measured = self._sim.reading.contacts()
        numbers["margin"] = margin = margin_without(measured, self._task, finger)
        if margin < MEASURED_MARGIN:
            return (
                f"the measured contacts of the others close with {margin:.3f} (at least "
                f"{MEASURED_MARGIN})"
            )
        return self._sim.driver.holding.gave_up

    def _moved(self, move: Relocation, i: int) -> str:
        """Move a finger along its way until it has landed; why it ended early, "" if it did not."""
        sim, holding = self._sim, self._sim.driver.holding
        swing = FingerSwing(self._plan.grasp, move, self._timeline.finger_rate)
        stuck = False

        def landed(_: Observation) -> bool:
            nonlocal stuck
            if not swing.over:
                return False
            if not holding.schedule.wanted[i]:
                stuck = bool(holding.schedule.touching[i])
                holding.join(move.finger)
            return stuck or bool(holding.schedule.touching[i])

        sim.driver.swing = swing
        longest = swing.duration + self._timeline.land_wait
        fault = sim.run("regrasp", 0.0, wait=longest, until=landed)
        sim.driver.swing = None
        if fault:
            return fault
        if stuck:
            return f"{move.finger} did not come off the object"
        if not holding.schedule.touching[i]:
            return f"{move.finger} did not find the object where it was to land"
        return ""

    def _off_landing(self, move: Relocation) -> float:
        """Distance (m) of a finger's measured contact from where it was to land, in the palm."""
        scene, data = self._sim.simulation.scene, self._sim.simulation.data
        merged = merge_per_finger(hand_contacts(scene, data))
        if move.finger not in merged.fingers:
            return float("nan")
        T_palm_world = scene.body_pose(data, scene.palm_body).inverse()
        there = T_palm_world.act(merged[merged.fingers.index(move.finger)].position)
        planned = self._plan.grasp.T_world_palm.inverse().act(move.landing.position)
        return float(np.linalg.norm(there - planned))


def margin_without(measured: ContactSet, task: GraspTask, finger: str) -> float:
    """Margin of closure of the fingers that stay when one is lifted.

    Args:
        measured: Contacts of hand and object, world.
        task: Whose friction and contact model are believed.
        finger: The finger that is to leave; the palm does not count either.

    Returns:
        Normalised min-weight (-), at most 0 without closure; -inf where too few fingers stay.
    """
    merged = merge_per_finger(measured)
    stay = [c for c in (merged[k] for k in range(len(merged))) if c.finger not in (finger, "")]
    if len(stay) < task.fingers_needed:
        return -np.inf
    contacts = ContactSet.from_contacts(stay, center=merged.center)
    closure = force_closure(with_planned_friction(contacts, task), edges=CLOSURE_EDGES)
    margin = closure.normalised_min_weight
    return margin if closure.closed else min(0.0, margin)
