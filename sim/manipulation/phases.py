"""``Phases``: what every phase of a manipulation does and checks, but for the turn.

The base is sent to planned poses up to the turn, and then to where the measured object gets to its
target.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from planner.errors import TaskError
from planner.motion.manipulation import Ending, ManipulationPlan
from planner.quality import QualityReport, analyse
from planner.spatial import SE3
from sim.contacts import hand_contacts, merge_per_finger
from sim.manipulation.machine import PhaseCall
from sim.manipulation.regrasping import Regrasping
from sim.manipulation.results import Measured, off_target, placed, undisturbed
from sim.manipulation.simulation import ManipulationSim
from sim.manipulation.timeline import ManipulationPhase, ManipulationTimeline, SuccessCriteria
from sim.manipulation.turning import Turning

__all__ = ["Phases"]


class Phases:
    """The phases of one run.

    Attributes:
        turning: The turn.
        regrasping: Fingers that move on.
        quality: Quality of the measured contacts, of the phases that look at it.
    """

    def __init__(
        self,
        plan: ManipulationPlan,
        run: ManipulationSim,
        timeline: ManipulationTimeline,
        criteria: SuccessCriteria,
    ) -> None:
        """Prepare."""
        self._plan, self._run = plan, run
        self._timeline, self._criteria = timeline, criteria
        self.turning = Turning(plan, run, timeline, criteria)
        self.regrasping = Regrasping(plan, run, timeline)
        self.quality: dict[ManipulationPhase, QualityReport] = {}

    def perform(self, call: PhaseCall) -> Measured:
        """Run a phase; why it failed, "" if it did not, and its numbers."""
        timeline, ending = self._timeline, call.ending
        phases: dict[ManipulationPhase, Callable[[], Measured]] = {
            "stand": self._stand,
            "approach": self._approach,
            "close": self._close,
            "squeeze": self._squeeze,
            "verify": lambda: self._verify("verify"),
            "lift": self._lift,
            "turn": self.turning.turn,
            "regrasp": lambda: self._regrasp(call),
            "hold": self._hold,
            "verify again": lambda: self._verify("verify again"),
            "back": self.turning.back,
            "carry": lambda: self._carry(ending),
            "lower": lambda: self._lower(ending),
            "release": lambda: self._let_go("release", timeline.release, ending),
            "open": lambda: self._let_go("open", timeline.open, ending),
            "retreat": lambda: self._retreat(ending),
        }
        return phases[call.phase]()

    def _regrasp(self, call: PhaseCall) -> Measured:
        if call.relocation is None:
            raise TaskError("a regrasp has no relocation; give PhaseCall one")
        fault, numbers = self.regrasping.perform(call.relocation)
        return fault, numbers | self.turning.in_hand()

    def _stand(self) -> Measured:
        fault = self._run.run("stand", self._timeline.stand)
        return self._standing(fault)

    def _approach(self) -> Measured:
        self._run.mover.go(self._plan.motion.T_world_base, self._timeline.approach)
        fault = self._run.run("approach", self._timeline.approach)
        return self._standing(fault)

    def _close(self) -> Measured:
        timeline = self._timeline
        fault = self._run.run(
            "close", timeline.close, wait=timeline.close_wait, until=lambda seen: seen.all_touch
        )
        return self._standing(fault)

    def _squeeze(self) -> Measured:
        fault = self._run.run("squeeze", self._timeline.squeeze)
        self._run.recorder.mark_reference()
        reason, numbers = self._standing(fault)
        task = self._plan.task
        forces = self._run.simulation.normal_forces()
        each = list(zip(task.finger_names, forces.tolist(), strict=True))
        numbers |= {f"{finger}_N": force for finger, force in each}
        missing = [finger for finger, force in each if force == 0.0]
        touching = len(each) - len(missing)
        if not reason and touching < task.fingers_needed:
            few = f"{touching} fingers touch, {task.fingers_needed} are needed"
            reason = f"{few}; {', '.join(missing)} do not"
        return reason, numbers

    def _verify(self, phase: ManipulationPhase) -> Measured:
        """Hold on, then analyse the measured contacts by the planner's own code."""
        fault = self._run.run(phase, self._timeline.verify)
        simulation = self._run.simulation
        merged = merge_per_finger(hand_contacts(simulation.scene, simulation.data))
        if fault or len(merged) == 0:
            return fault or "nothing touches the object", {}
        shape = self._plan.task.object.shape
        quality = analyse(merged, length=shape.bounding_radius)
        self.quality[phase] = quality
        numbers = {
            "contacts": float(len(merged)),
            "min_weight": quality.closure.normalised_min_weight,
            "epsilon": quality.epsilon,
        }
        reason = "" if quality.closure.closed else f"no force closure: {quality.closure.reason}"
        return reason, numbers

    def _lift(self) -> Measured:
        timeline, simulation = self._timeline, self._run.simulation
        self._run.mover.go(_raised(self._plan.motion.T_world_base, timeline.height), timeline.lift)
        fault = self._run.run("lift", timeline.lift)
        numbers = self.turning.in_hand()
        first = float(simulation.plan.task.T_world_object.translation[2])
        numbers["rise_mm"] = 1e3 * (float(simulation.T_world_object.translation[2]) - first)
        short = 1e3 * timeline.height - numbers["rise_mm"]
        if not fault and max(numbers["shift_mm"], short) > self._criteria.slip_mm:
            fault = (
                f"the object moved {numbers['shift_mm']:.1f} mm in the hand and rose {short:.1f} "
                "mm less than the hand"
            )
        return fault, numbers

    def _hold(self) -> Measured:
        before = self.turning.in_hand()
        fault = self._run.run("hold", self._timeline.hold)
        numbers = self.turning.in_hand()
        numbers["drift_mm"] = abs(numbers["shift_mm"] - before["shift_mm"])
        numbers["drift_deg"] = abs(numbers["turn_deg"] - before["turn_deg"])
        return fault or self.turning.shortfall(numbers), numbers

    def _carry(self, ending: Ending) -> Measured:
        above = _raised(ending.T_world_target, self._timeline.height)
        self._run.mover.go(self._run.base_for(above), self._timeline.carry)
        fault = self._run.run("carry", self._timeline.carry)
        return fault, off_target(above, self._run.simulation.T_world_object)

    def _lower(self, ending: Ending) -> Measured:
        target = ending.T_world_target
        self._run.mover.go(self._run.base_for(target), self._timeline.lower)
        fault = self._run.run("lower", self._timeline.lower)
        return fault, off_target(target, self._run.simulation.T_world_object)

    def _let_go(self, phase: ManipulationPhase, duration: float, ending: Ending) -> Measured:
        fault = self._run.run(phase, duration)
        return self._standing_at_target(fault, ending)

    def _retreat(self, ending: Ending) -> Measured:
        out = self._plan.way_out(self._run.simulation.T_world_base, ending)
        self._run.mover.go(out, self._timeline.retreat)
        fault = self._run.run("retreat", self._timeline.retreat)
        if not fault and self._run.touched:
            fault = "the hand still touches the object"
        return self._standing_at_target(fault, ending)

    def _standing(self, fault: str) -> Measured:
        first = self._run.simulation.plan.task.T_world_object
        reason, numbers = undisturbed(first, self._run.simulation.T_world_object, self._criteria)
        return fault or reason, numbers

    def _standing_at_target(self, fault: str, ending: Ending) -> Measured:
        target = ending.T_world_target
        reason, numbers = placed(target, self._run.simulation.T_world_object, self._criteria)
        return fault or reason, numbers


def _raised(pose: SE3, height: float) -> SE3:
    return SE3(pose.rotation, pose.translation + np.array([0.0, 0.0, height]))
