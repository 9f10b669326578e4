"""``Phases``: what every phase of a manipulation does and checks, but for the turn.

The base is sent to planned poses up to the turn, and then to where the measured object gets to its
target.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from planner.motion.manipulation import ManipulationPlan
from planner.quality import QualityReport, analyse
from planner.spatial import SE3
from sim.contacts import hand_contacts, merge_per_finger, normal_forces
from sim.manipulation.checks import Outcome, off_target, placed, undisturbed
from sim.manipulation.pace import Bounds, Pace, Step
from sim.manipulation.stage import Stage
from sim.manipulation.turning import Turning

__all__ = ["Phases"]


class Phases:
    """The phases of one run.

    Attributes:
        plan: What is executed; its target and its release may be set anew.
        turning: The turn.
        quality: Quality of the measured contacts, of the phases that look at it.
    """

    def __init__(self, plan: ManipulationPlan, stage: Stage, pace: Pace, bounds: Bounds) -> None:
        """Prepare."""
        self.plan, self._stage = plan, stage
        self._pace, self._bounds = pace, bounds
        self.turning = Turning(plan, stage, pace, bounds)
        self.quality: dict[Step, QualityReport] = {}

    def of(self, step: Step) -> Callable[[], Outcome]:
        """What performs a phase."""
        phases: dict[Step, Callable[[], Outcome]] = {
            "stand": self._stand,
            "approach": self._approach,
            "close": self._close,
            "squeeze": self._squeeze,
            "verify": lambda: self._verify("verify"),
            "lift": self._lift,
            "hold": self._hold,
            "verify again": lambda: self._verify("verify again"),
            "back": self.turning.back,
            "carry": self._carry,
            "lower": self._lower,
            "release": lambda: self._let_go("release", self._pace.release),
            "open": lambda: self._let_go("open", self._pace.open),
            "retreat": self._retreat,
        }
        return phases[step]

    def _stand(self) -> Outcome:
        fault = self._stage.advance("stand", self._pace.stand)
        return self._standing(fault)

    def _approach(self) -> Outcome:
        self._stage.mover.go(self.plan.motion.T_world_base, self._pace.approach)
        fault = self._stage.advance("approach", self._pace.approach)
        return self._standing(fault)

    def _close(self) -> Outcome:
        pace = self._pace
        fault = self._stage.advance(
            "close", pace.close, wait=pace.close_wait, until=lambda touching: touching
        )
        return self._standing(fault)

    def _squeeze(self) -> Outcome:
        fault = self._stage.advance("squeeze", self._pace.squeeze)
        self._stage.watch.mark(self._stage.data)
        reason, numbers = self._standing(fault)
        task = self.plan.motion.grasp.task
        forces = normal_forces(self._stage.scene, self._stage.data, task.finger_names)
        each = list(zip(task.finger_names, forces.tolist(), strict=True))
        numbers |= {f"{finger}_N": force for finger, force in each}
        missing = [finger for finger, force in each if force == 0.0]
        touching = len(each) - len(missing)
        if not reason and touching < task.fingers_needed:
            few = f"{touching} fingers touch, {task.fingers_needed} are needed"
            reason = f"{few}; {', '.join(missing)} do not"
        return reason, numbers

    def _verify(self, step: Step) -> Outcome:
        """Hold on, then analyse the measured contacts by the planner's own code."""
        fault = self._stage.advance(step, self._pace.verify)
        merged = merge_per_finger(hand_contacts(self._stage.scene, self._stage.data))
        if fault or len(merged) == 0:
            return fault or "nothing touches the object", {}
        shape = self.plan.motion.grasp.task.object.shape
        quality = analyse(merged, length=shape.bounding_radius)
        self.quality[step] = quality
        numbers = {
            "contacts": float(len(merged)),
            "min_weight": quality.closure.normalised_min_weight,
            "epsilon": quality.epsilon,
        }
        reason = "" if quality.closure.closed else f"no force closure: {quality.closure.reason}"
        return reason, numbers

    def _lift(self) -> Outcome:
        pace, stage = self._pace, self._stage
        stage.mover.go(_raised(self.plan.motion.T_world_base, pace.height), pace.lift)
        fault = stage.advance("lift", pace.lift)
        numbers = self.turning.in_hand()
        first = float(stage.scene.task.T_world_object.translation[2])
        numbers["rise_mm"] = 1e3 * (float(stage.T_world_object.translation[2]) - first)
        short = 1e3 * pace.height - numbers["rise_mm"]
        if not fault and max(numbers["shift_mm"], short) > self._bounds.slip_mm:
            fault = (
                f"the object moved {numbers['shift_mm']:.1f} mm in the hand and rose {short:.1f} "
                "mm less than the hand"
            )
        return fault, numbers

    def _hold(self) -> Outcome:
        before = self.turning.in_hand()
        fault = self._stage.advance("hold", self._pace.hold)
        numbers = self.turning.in_hand()
        numbers["drift_mm"] = abs(numbers["shift_mm"] - before["shift_mm"])
        numbers["drift_deg"] = abs(numbers["turn_deg"] - before["turn_deg"])
        return fault or self.turning.stalled(numbers), numbers

    def _carry(self) -> Outcome:
        above = _raised(self.plan.ending.T_world_target, self._pace.height)
        self._stage.mover.go(self._stage.base_for(above), self._pace.carry)
        fault = self._stage.advance("carry", self._pace.carry)
        return fault, off_target(above, self._stage.T_world_object)

    def _lower(self) -> Outcome:
        target = self.plan.ending.T_world_target
        self._stage.mover.go(self._stage.base_for(target), self._pace.lower)
        fault = self._stage.advance("lower", self._pace.lower)
        return fault, off_target(target, self._stage.T_world_object)

    def _let_go(self, step: Step, duration: float) -> Outcome:
        fault = self._stage.advance(step, duration)
        return self._standing_at_target(fault)

    def _retreat(self) -> Outcome:
        release, planned = self.plan.ending.release, self.plan.motion.T_world_base
        now = self._stage.T_world_base
        way = release.T_world_base_start.translation - planned.translation
        turn = now.rotation @ planned.rotation.T
        out = SE3(now.rotation, now.translation + turn @ way)
        self._stage.mover.go(out, self._pace.retreat)
        fault = self._stage.advance("retreat", self._pace.retreat)
        if not fault and self._stage.touched:
            fault = "the hand still touches the object"
        return self._standing_at_target(fault)

    def _standing(self, fault: str) -> Outcome:
        first = self._stage.scene.task.T_world_object
        reason, numbers = undisturbed(first, self._stage.T_world_object, self._bounds)
        return fault or reason, numbers

    def _standing_at_target(self, fault: str) -> Outcome:
        target = self.plan.ending.T_world_target
        reason, numbers = placed(target, self._stage.T_world_object, self._bounds)
        return fault or reason, numbers


def _raised(pose: SE3, height: float) -> SE3:
    return SE3(pose.rotation, pose.translation + np.array([0.0, 0.0, height]))
