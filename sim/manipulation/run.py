"""``manipulate``: execute a ``ManipulationPlan`` in MuJoCo, phase by phase, each with its check.

    stand, approach, close, squeeze, verify, lift, turn, hold, verify again, carry, lower, release,
    open, retreat

A turn by several strokes is "turn" several times, with "regrasp" once per finger between two of
them. An object that does not stand as it lies in the hand in the end, or that the hand cannot let
go of there, is brought back in the hand ("back") before it is carried to its target.

It ends at the first phase that fails, unless a retry is asked for: a turn that stalls then goes on
after a regrasp if there is one from the present contacts, and where a lift is refused another
finger moves on first if that holds; otherwise the object is put down where it
is, and the rest of the turn is planned and made anew, once. What really is there may differ from
what was planned for: friction, mass and the object's pose; the controller knows of it only what it
measures.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from planner.errors import PlannerError
from planner.failure import Failure
from planner.motion.gait import cut_motion
from planner.motion.manipulation import ManipulationPlan, plan_manipulation
from planner.motion.manipulation.ending import Ending, backwards, object_at_target, stands
from planner.motion.release import find_release
from planner.spatial import SE3, signed_twist
from planner.task import GraspTask
from sim.controllers import Sensing
from sim.looking.picture import save_picture
from sim.manipulation.checks import Check
from sim.manipulation.modes import measured_modes, planned_modes, planned_points
from sim.manipulation.pace import STEPS, TURNING, Bounds, Pace, Step
from sim.manipulation.phases import Phases
from sim.manipulation.pressing import ASKED_SHARE, force_limit
from sim.manipulation.report import ManipulationReport
from sim.manipulation.samples import Track
from sim.manipulation.stage import Push, Stage
from sim.manipulation.standing import rests
from sim.manipulation.turning import Part
from sim.physics import PhysicsOptions

__all__ = ["ManipulationRun", "manipulate"]

DOWN: tuple[Step, ...] = ("lower", "release", "open", "retreat")
"""Phases in which an object is put down."""


class ManipulationRun:
    """One execution of a plan.

    Attributes:
        plan: What is executed.
        stage: Where.
        checks: The phases that were run.
        put_down: Whether the object is put down half-way.
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
        pace, self._bounds = pace or Pace(), bounds or Bounds()
        self._force_limit = self._bounds.normal_N or force_limit(plan)
        self.stage = Stage(
            plan,
            really=really,
            physics=physics,
            sensing=sensing,
            pace=pace,
            push=push,
            max_normal=ASKED_SHARE * self._force_limit,
        )
        self.put_down = False
        self._goes_on = False
        self._phases = Phases(plan, self.stage, pace, self._bounds)
        self.checks: list[Check] = []

    def perform(self, *, pictures: Path | None = None, retry: bool = False) -> ManipulationReport:
        """Run all phases, or up to the first that fails.

        Args:
            pictures: Folder for a picture at the end of each phase; it must exist.
            retry: Whether a turn that stalls goes on after a regrasp, where there is one, and
                whether an object that cannot be turned further is put down.
        """
        taken: dict[str, str] = {}
        no_picture = ""
        for k, (step, about, perform) in enumerate(self._parts(), start=1):
            begin = float(self.stage.data.time)
            reason, numbers = perform()
            end = float(self.stage.data.time)
            then = self._after(step) if reason and retry else ""
            goes_on = not reason or (retry and self._goes_on)
            self.checks.append(
                Check(
                    step=step,
                    about=about,
                    begin=begin,
                    end=end,
                    reason=reason,
                    numbers=numbers,
                    then=then,
                )
            )
            if pictures is not None and not no_picture:
                name = f"{step} {about}".strip().replace(" ", "-")
                file = pictures / f"{k:02d}-{name}.png"
                made = save_picture(self.stage.scene.model, self.stage.data, file)
                no_picture = made.reason
                if made.path is not None:
                    taken[file.stem if about else step] = str(made.path)
            if not goes_on:
                break
        return self._told(taken, no_picture)

    def _parts(self) -> Iterator[Part]:
        """All phases in order; the turn may have several."""
        for step in STEPS:
            if step == "carry" and self.plan.ending.back:
                yield "back", "", self._phases.of("back")
            if step != "turn":
                yield step, "", self._phases.of(step)
                continue
            for part in self._phases.turning.parts():
                yield part
                if self.put_down:
                    break
            if self.put_down:
                break
        if self.put_down:
            down: tuple[Step, ...] = ("back", *DOWN) if self._phases.plan.ending.back else DOWN
            for step in down:
                yield step, "half-way", self._phases.of(step)

    def _after(self, step: Step) -> str:
        """What is done after a phase that failed: a regrasp, or putting down; or why nothing is.

        "" where nothing is to be done: the object was not to be turned yet, or is lost.
        """
        self._goes_on = False
        if step not in TURNING or not self.stage.touched:
            return ""
        no_regrasp, turning = "the turn is over", self._phases.turning
        if step == "turn":
            no_regrasp = turning.regrasps_on()
        elif step == "regrasp":
            no_regrasp = turning.another_order()
        self._goes_on = not no_regrasp
        if self._goes_on and step == "turn":
            return "the fingers move on, and it is turned again"
        if self._goes_on:
            return "the fingers move on in another order"
        why = self._put_down()
        self._goes_on = not why
        down = f"it cannot be put down either: {why}" if why else "it is put down"
        return f"no regrasp ({no_regrasp}); {down}"

    def _put_down(self) -> str:
        """Let the phases put the object down where it is; why they cannot, "" if they can."""
        plan, stage = self.plan, self.stage
        axis = plan.motion.path.axis
        first, now = stage.scene.task.T_world_object, stage.T_world_object
        turned = signed_twist(now.rotation @ first.rotation.T, axis)
        x, y = now.translation[:2].tolist()
        task = replace(plan.motion.grasp.task, T_world_object=first)
        if plan.ending.back or not stands(task, axis, turned, rests=rests):
            if plan.gait is not None:
                return "it would not stand"
            ending = backwards(
                plan.motion, (x, y), plan.ending.back or "half-way it does not stand"
            )
        else:
            found = find_release(cut_motion(plan.motion, stage.driver.reference.place))
            if isinstance(found, Failure):
                return found.text
            target = object_at_target(task, axis, turned, (x, y))
            ending = Ending(T_world_target=target, release=found, back="")
        self._phases.plan = replace(plan, ending=ending)
        self.put_down = True
        return ""

    def _told(self, pictures: dict[str, str], no_picture: str) -> ManipulationReport:
        track = self.stage.watch.track()
        points = planned_points(self.plan.motion, track.place, track.step, track.away)
        wanted = np.isfinite(points[..., 0])
        last = self.checks[-1]
        return ManipulationReport(
            checks=tuple(self.checks),
            complete=last.step == STEPS[-1] and last.passed and not self.put_down,
            fingers=self.plan.motion.grasp.task.finger_names,
            asked=self.plan.angle,
            asked_shift=self.plan.shift,
            back=self._phases.plan.ending.back,
            R_world_palm=self.plan.motion.grasp.T_world_palm.rotation,
            track=track,
            planned_modes=planned_modes(track.time, points),
            measured_modes=measured_modes(track.time, track.points, track.sliding, wanted),
            before=self._phases.quality.get("verify"),
            after=self._phases.quality.get("verify again"),
            bounds=self._bounds,
            force_limit=self._force_limit,
            events=self.stage.driver.events,
            physics=self.stage.scene.physics.to_dict(),
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
    retry: bool = False,
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
        retry: Whether a turn that stalls is tried again, once; the push is not. The hand's way
            from where it let go to where it begins anew is not simulated.
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
    report = run.perform(pictures=pictures, retry=retry)
    if not (run.put_down and report.checks[-1].passed):
        return report
    try:
        rest = _rest_of(plan, report.track, run.stage.T_world_object)
    except PlannerError as error:
        last = replace(report.checks[-1], then=f"no plan for the rest of the turn: {error}")
        return replace(report, checks=(*report.checks[:-1], last))
    again = ManipulationRun(
        rest,
        really=replace(run.stage.scene.task, T_world_object=rest.motion.grasp.task.T_world_object),
        physics=physics,
        sensing=sensing,
        pace=pace,
        bounds=bounds,
    )
    return replace(again.perform(), earlier=report)


def _rest_of(plan: ManipulationPlan, track: Track, T_world_object: SE3) -> ManipulationPlan:
    """A plan for what is left of a turn, from where the object stands now.

    Raises:
        PlannerError: There is none.
    """
    motion = plan.motion
    task = motion.grasp.task
    first = task.T_world_object
    axis = motion.path.axis
    counted = float(track.turn[track.during(*TURNING)[-1]])  # whole turns too
    made = signed_twist(T_world_object.rotation @ first.rotation.T, axis, near=counted)
    if plan.ending.back:  # it stands as at first
        made = 0.0
    x, y = T_world_object.translation[:2].tolist()
    upright = object_at_target(task, axis, made, (x, y))
    at_x, at_y = plan.ending.T_world_target.translation[:2].tolist()
    return plan_manipulation(
        replace(task, T_world_object=upright),
        axis=axis,
        angle=plan.angle - made,
        shift=plan.shift,
        place=(at_x, at_y),
        seed=motion.record.seed + 1,
        regrasp=plan.gait is not None,
        rests=rests,
    )
