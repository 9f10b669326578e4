"""``manipulate``: execute a ``ManipulationPlan`` in MuJoCo, phase by phase, each with its check.

    stand, approach, close, squeeze, verify, lift, turn, hold, verify again, carry, lower, release,
    open, retreat

It ends at the first phase that fails. What really is there may differ from what was planned for:
friction, mass and the object's pose; the controller knows of it only what it measures. The base is
sent to planned poses up to the turn, and then to where the measured object gets to its target.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import mujoco
import numpy as np

from planner.quality import QualityReport, analyse
from planner.spatial import SE3
from planner.task import GraspTask
from sim.contacts import hand_contacts, merge_per_finger, normal_forces
from sim.controllers import Sensing
from sim.manipulation.checks import Outcome, off_target, placed, undisturbed
from sim.manipulation.modes import measured_modes, planned_modes, planned_points
from sim.manipulation.pace import STEPS, Bounds, Pace, Step
from sim.manipulation.plan import ManipulationPlan
from sim.manipulation.report import Check, ManipulationReport
from sim.manipulation.stage import Push, Stage
from sim.manipulation.turning import Part, Turning
from sim.physics import PhysicsOptions
from sim.picture import save_picture

__all__ = ["ManipulationRun", "manipulate"]


class ManipulationRun:
    """One execution of a plan.

    Attributes:
        plan: What is executed.
        stage: Where.
        checks: The phases that were run.
        turning: The turn.
    """

    def __init__(
        self,
        plan: ManipulationPlan,
        *,
        really: GraspTask | None = None,
        physics: PhysicsOptions | None = None,
        sensing: Sensing | None = None,
        pace: Pace | None = None,
        bounds: Bounds | None = None,
        push: Push | None = None,
    ) -> None:
        """Build the scene and put hand and object at their start; see ``manipulate``."""
        self.plan = plan
        self._pace, self._bounds = pace or Pace(), bounds or Bounds()
        self.stage = Stage(
            plan, really=really, physics=physics, sensing=sensing, pace=self._pace, push=push
        )
        self.turning = Turning(plan, self.stage, self._pace, self._bounds)
        self.checks: list[Check] = []
        self._quality: dict[Step, QualityReport] = {}

    def perform(self, *, pictures: Path | None = None) -> ManipulationReport:
        """Run all phases, or up to the first that fails.

        Args:
            pictures: Folder for a picture at the end of each phase; it must exist.
        """
        taken: dict[str, str] = {}
        no_picture = ""
        # divergence is told by the report; MuJoCo would also write a log file
        mujoco.set_mju_user_warning(lambda _: None)
        try:
            for k, (step, about, perform) in enumerate(self._parts(), start=1):
                begin = float(self.stage.data.time)
                reason, numbers = perform()
                end = float(self.stage.data.time)
                self.checks.append(
                    Check(
                        step=step, about=about, begin=begin, end=end, reason=reason, numbers=numbers
                    )
                )
                if pictures is not None and not no_picture:
                    name = f"{step} {about}".strip().replace(" ", "-")
                    file = pictures / f"{k:02d}-{name}.png"
                    made = save_picture(self.stage.scene.model, self.stage.data, file)
                    no_picture = made.reason
                    if made.path is not None:
                        taken[f"{step} {about}".strip()] = str(made.path)
                if reason:
                    break
        finally:
            mujoco.set_mju_user_warning(None)
        return self._told(taken, no_picture)

    def _parts(self) -> Iterator[Part]:
        """All phases in order; the turn may have several."""
        for step in STEPS:
            if step == "turn":
                yield from self.turning.parts()
            else:
                yield step, "", self._phases[step]

    @property
    def _phases(self) -> dict[Step, Callable[[], Outcome]]:
        return {
            "stand": self._stand,
            "approach": self._approach,
            "close": self._close,
            "squeeze": self._squeeze,
            "verify": lambda: self._verify("verify"),
            "lift": self._lift,
            "hold": self._hold,
            "verify again": lambda: self._verify("verify again"),
            "carry": self._carry,
            "lower": self._lower,
            "release": lambda: self._let_go("release", self._pace.release),
            "open": lambda: self._let_go("open", self._pace.open),
            "retreat": self._retreat,
        }

    def _stand(self) -> Outcome:
        fault = self.stage.advance("stand", self._pace.stand)
        return self._standing(fault)

    def _approach(self) -> Outcome:
        self.stage.mover.go(self.plan.motion.T_world_base, self._pace.approach)
        fault = self.stage.advance("approach", self._pace.approach)
        return self._standing(fault)

    def _close(self) -> Outcome:
        pace = self._pace
        fault = self.stage.advance(
            "close", pace.close, wait=pace.close_wait, until=lambda touching: touching
        )
        return self._standing(fault)

    def _squeeze(self) -> Outcome:
        fault = self.stage.advance("squeeze", self._pace.squeeze)
        self.stage.watch.mark(self.stage.data)
        reason, numbers = self._standing(fault)
        task = self.plan.motion.grasp.task
        forces = normal_forces(self.stage.scene, self.stage.data, task.finger_names)
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
        fault = self.stage.advance(step, self._pace.verify)
        merged = merge_per_finger(hand_contacts(self.stage.scene, self.stage.data))
        if fault or len(merged) == 0:
            return fault or "nothing touches the object", {}
        shape = self.plan.motion.grasp.task.object.shape
        quality = analyse(merged, length=shape.bounding_radius)
        self._quality[step] = quality
        numbers = {
            "contacts": float(len(merged)),
            "min_weight": quality.closure.normalised_min_weight,
            "epsilon": quality.epsilon,
        }
        reason = "" if quality.closure.closed else f"no force closure: {quality.closure.reason}"
        return reason, numbers

    def _lift(self) -> Outcome:
        pace, stage = self._pace, self.stage
        stage.mover.go(_raised(self.plan.motion.T_world_base, pace.height), pace.lift)
        fault = stage.advance("lift", pace.lift)
        numbers = self.turning.in_hand()
        first = float(stage.scene.task.T_world_object.translation[2])
        numbers["rise_mm"] = 1e3 * (float(stage.T_world_object.translation[2]) - first)
        short = 1e3 * pace.height - numbers["rise_mm"]
        if not fault and max(numbers["shift_mm"], short) > self._bounds.slip_mm:
            fault = (
                f"the object moved {numbers['shift_mm']:.1f} mm in the hand and rose {short:.1f} "
                "mm less than it"
            )
        return fault, numbers

    def _hold(self) -> Outcome:
        before = self.turning.in_hand()
        fault = self.stage.advance("hold", self._pace.hold)
        numbers = self.turning.in_hand()
        numbers["drift_mm"] = abs(numbers["shift_mm"] - before["shift_mm"])
        numbers["drift_deg"] = abs(numbers["turn_deg"] - before["turn_deg"])
        return fault or self.turning.stalled(numbers), numbers

    def _carry(self) -> Outcome:
        above = _raised(self.plan.T_world_target, self._pace.height)
        self.stage.mover.go(self.stage.base_for(above), self._pace.carry)
        fault = self.stage.advance("carry", self._pace.carry)
        return fault, off_target(above, self.stage.T_world_object)

    def _lower(self) -> Outcome:
        target = self.plan.T_world_target
        self.stage.mover.go(self.stage.base_for(target), self._pace.lower)
        fault = self.stage.advance("lower", self._pace.lower)
        return fault, off_target(target, self.stage.T_world_object)

    def _let_go(self, step: Step, duration: float) -> Outcome:
        fault = self.stage.advance(step, duration)
        return self._standing_at_target(fault)

    def _retreat(self) -> Outcome:
        release, planned = self.plan.release, self.plan.motion.T_world_base
        now = self.stage.T_world_base
        way = release.T_world_base_start.translation - planned.translation
        turn = now.rotation @ planned.rotation.T
        out = SE3(now.rotation, now.translation + turn @ way)
        self.stage.mover.go(out, self._pace.retreat)
        fault = self.stage.advance("retreat", self._pace.retreat)
        if not fault and self.stage.touched:
            fault = "the hand still touches the object"
        return self._standing_at_target(fault)

    def _standing(self, fault: str) -> Outcome:
        first = self.stage.scene.task.T_world_object
        reason, numbers = undisturbed(first, self.stage.T_world_object, self._bounds)
        return fault or reason, numbers

    def _standing_at_target(self, fault: str) -> Outcome:
        target = self.plan.T_world_target
        reason, numbers = placed(target, self.stage.T_world_object, self._bounds)
        return fault or reason, numbers

    def _told(self, pictures: dict[str, str], no_picture: str) -> ManipulationReport:
        track = self.stage.watch.track()
        points = planned_points(self.plan.motion, track.place, track.step, track.away)
        wanted = np.isfinite(points[..., 0])
        return ManipulationReport(
            checks=tuple(self.checks),
            complete=self.checks[-1].step == STEPS[-1] and self.checks[-1].passed,
            fingers=self.plan.motion.grasp.task.finger_names,
            asked=self.plan.angle,
            track=track,
            planned_modes=planned_modes(track.time, points),
            measured_modes=measured_modes(track.time, track.points, track.sliding, wanted),
            before=self._quality.get("verify"),
            after=self._quality.get("verify again"),
            bounds=self._bounds,
            events=self.stage.driver.events,
            pictures=pictures,
            picture_reason=no_picture,
        )


def manipulate(
    plan: ManipulationPlan,
    *,
    really: GraspTask | None = None,
    physics: PhysicsOptions | None = None,
    sensing: Sensing | None = None,
    pace: Pace | None = None,
    bounds: Bounds | None = None,
    push: Push | None = None,
    pictures: Path | None = None,
) -> ManipulationReport:
    """Execute a plan and judge it.

    Args:
        plan: What to execute.
        really: The task as it really is, where mass or pose differ from the plan's.
        physics: How MuJoCo computes, with the true friction; defaults if None.
        sensing: How well the object is known; exactly and at once if None.
        pace: Durations; defaults if None.
        bounds: Where phases fail; defaults if None.
        push: A disturbance during the turn.
        pictures: Folder for a picture at the end of each phase; it must exist.
    """
    run = ManipulationRun(
        plan,
        really=really,
        physics=physics,
        sensing=sensing,
        pace=pace,
        bounds=bounds,
        push=push,
    )
    return run.perform(pictures=pictures)


def _raised(pose: SE3, height: float) -> SE3:
    return SE3(pose.rotation, pose.translation + np.array([0.0, 0.0, height]))
