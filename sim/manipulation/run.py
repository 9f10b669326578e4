"""``manipulate``: execute a ``ManipulationPlan`` in MuJoCo, phase by phase, each with its checks.

Which phase comes next is decided by ``sim.manipulation.machine``, what a phase does is in
``phases`` and ``regrasping``. The true friction, mass and object pose may differ from the planned
ones; the controller knows of that only what it measures.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any, TypedDict, Unpack

import numpy as np

from planner.errors import PlannerError, TaskError
from planner.failure import Failure
from planner.files import given_manipulation
from planner.motion.ending import backwards, find_release, object_at_target, stands
from planner.motion.gait import cut_motion, plan_back, plan_others
from planner.motion.manipulation import ManipulationPlan, plan_manipulation
from planner.motion.on_arm import lifted_blocked
from planner.motion.phase import Ending, Relocation
from planner.motion.verify import ASKED_SHARE
from planner.spatial import SE3, pose_from_wxyz, signed_twist
from sim.manipulation.in_hand import GuidedController, in_hand_controller
from sim.manipulation.log import (
    ManipulationLog,
    force_limit,
    measured_modes,
    planned_modes,
    planned_points,
)
from sim.manipulation.machine import StateMachine
from sim.manipulation.phases import Phases
from sim.manipulation.report import ManipulationReport
from sim.manipulation.simulation import (
    ManipulationKeywords,
    ManipulationOptions,
    ManipulationSim,
)
from sim.manipulation.standing import rests
from sim.manipulation.timeline import TURNING, UP
from sim.report import PhaseResult
from sim.show.picture import Drawn, check_video, draw_tape
from sim.simulation import Simulation


class Drawing(TypedDict):
    """What is drawn of a movement, see ``manipulate``."""

    pictures: Path | None
    video: Path | None
    arrows: bool


def check_turn(plan: ManipulationPlan) -> None:
    """Refuse a movement that is no turn in the hand.

    Raises:
        TaskError: It is a handover or the use of a tool.
    """
    if plan.handover is not None or plan.tool is not None:
        raise TaskError(
            f"{plan!r} hands over or uses a tool; execute it by hand_over, UseTrial or "
            "FingersTrial, or by opposable test FILE"
        )


class ManipulationRun:
    """One execution of a plan; the ``Situation`` of its state machine.

    Attributes:
        plan: What is executed.
        sim: Scene, driver and samples.
        results: The phases that were run.
        options: Under which conditions.
    """

    def __init__(
        self,
        plan: ManipulationPlan,
        options: ManipulationOptions | None = None,
        **changes: Unpack[ManipulationKeywords],
    ) -> None:
        """Build the scene and put hand and object at their start.

        Args:
            plan: What to execute.
            options: Under which conditions; defaults if None.
            changes: Fields of ``ManipulationOptions`` by name that are to be others.

        Raises:
            TaskError: The plan is a handover or the use of a tool, or an arm cannot carry the
                object through the places.
        """
        check_turn(plan)
        self.plan = plan
        self.options = options = (options or ManipulationOptions()).with_changes(**changes)
        self.results: list[PhaseResult] = []
        self._force_limit = options.criteria.normal_N or force_limit(plan)
        most = ASKED_SHARE * self._force_limit
        holding = in_hand_controller(plan.grasp, options.controller, max_normal=most)
        self.sim = ManipulationSim(plan, holding, options)
        parts = (options.timeline, options.criteria, options.via)
        self._phases = Phases(plan, self.sim, *parts)
        if options.via and plan.task.hand.arm is not None:
            height = self._phases.height
            blocked = lifted_blocked(plan.motion, height, options.via, plan.ending)
            if blocked is not None:
                raise TaskError(f"{blocked}; give other places")

    def perform(
        self,
        *,
        pictures: Path | None = None,
        video: Path | None = None,
        arrows: bool = False,
        retry: bool = False,
        view: bool = False,
        number: int = 1,
    ) -> ManipulationReport:
        """Run all phases, or up to the first that fails and is not made up for, or to Ctrl-C.

        Args:
            pictures: Folder for a picture at the end of each phase, which is where it went wrong if
                it failed; it must exist.
            video: Write a film here: ``.mp4``, ``.webp`` or ``.gif``.
            arrows: Draw the measured contact forces into both.
            retry: Whether failures of the turn are made up for; see ``machine``.
            view: Show it in MuJoCo's viewer, in real time.
            number: Which movement of a chain it is; from 2 on it stands in the names of the files.

        Raises:
            TaskError: ``view`` without a display, or a video that cannot be written.
        """
        if video is not None and number > 1:
            video = video.with_stem(f"{video.stem}-{number}")
        check_video(video)
        machine = StateMachine(self.plan, self, retry=retry)
        tape = self.sim.simulation.record() if pictures or video else None
        if view:
            self.sim.simulation.show()
        try:
            for result in machine.run(self._phases.perform, lambda: self.sim.simulation.time):
                self.results.append(result)
        finally:
            self.sim.simulation.close()
        report = self._report(machine)
        if tape is None:
            return report
        wanted = {} if pictures is None else _pictures(pictures, self.results, number)
        times = {path: result.end for path, result in wanted.items()}
        drawn = draw_tape(tape, pictures=times, video=video, arrows=arrows)
        return replace(report, **_told(wanted, drawn))

    # ---- the situation, for the state machine

    @property
    def left(self) -> float:
        """Turn that is still to be made, rad; negative beyond the goal."""
        return self._phases.left

    @property
    def touched(self) -> bool:
        """Whether the hand touches the object."""
        return self.sim.touched

    def fingers_back(self) -> tuple[Relocation, ...] | Failure:
        """How all fingers go back to where the motion began; or why they cannot."""
        return plan_back(self.plan, self.sim.driver.reference.place)

    def other_order(self, moved: Iterable[str]) -> tuple[Relocation, ...] | Failure:
        """How the fingers that have not moved go on in another order; or why they cannot."""
        refused = self._phases.regrasping.refused
        if self.plan.cycles == 1 or not refused:
            return Failure(kind="turn_over", text="the turn is over")
        return plan_others(self.plan, tuple(moved), refused)

    def put_down(self) -> Ending | Failure:
        """How the object is put down where it is; or why it cannot be."""
        plan, simulation = self.plan, self.sim.simulation
        axis, back = plan.path.axis, plan.ending.back
        first, now = simulation.plan.task.T_world_object, self.sim.reading.T_world_object()
        if plan.path.turns_wrist:  # as it will be when the wrist has turned back
            lowered = now.translation - np.array([0.0, 0.0, self._phases.height])
            center, turn = plan.task.T_world_object.translation, plan.path.attitude.T
            now = SE3(turn @ now.rotation, center + turn @ (lowered - center))
        turned = signed_twist(now.rotation @ first.rotation.T, axis)
        x, y = now.translation[:2].tolist()
        task = replace(plan.task, T_world_object=first)
        if back or not stands(task, axis, turned, rests=rests):
            if plan.cycles > 1:
                return Failure(kind="falls", text="it would not stand")
            return backwards(plan, (x, y), back or "half-way it does not stand")
        release = find_release(cut_motion(plan, self.sim.driver.reference.place))
        if isinstance(release, Failure):
            return release
        target = object_at_target(task, axis, turned, (x, y))
        return Ending(T_world_target=target, release=release, back="")

    def _report(self, machine: StateMachine) -> ManipulationReport:
        plan, log = self.plan, self.sim.recorder.log()
        points = planned_points(plan, log.path_parameter, log.phase, log.away)
        wanted = np.isfinite(points[..., 0])
        simulation = self.sim.simulation
        true_task, holding = simulation.plan.task, self.sim.driver.holding
        driving = holding.controller if isinstance(holding, GuidedController) else holding
        return ManipulationReport(
            hand=plan.task.hand.name,
            object=plan.task.object.shape.spec,
            mass_kg=true_task.object.mass,
            seed=plan.record.seed,
            controller=type(driving).__name__,
            fingers=plan.task.finger_names,
            results=tuple(self.results),
            complete=machine.complete,
            put_down=machine.put_down,
            asked=plan.angle,
            asked_shift=plan.shift,
            back=machine.ending.back,
            R_world_palm=plan.grasp.T_world_palm.rotation,
            log=log,
            recording=self.sim.recorder.recording(),
            plan=plan,
            planned_modes=planned_modes(log.time, points),
            measured_modes=measured_modes(log.time, log.points, log.sliding, wanted),
            before=self._phases.quality.get("verify"),
            after=self._phases.quality.get("verify again"),
            criteria=self.options.criteria,
            timeline=self.options.timeline,
            force_limit=self._force_limit,
            events=simulation.events,
            physics=simulation.scene.physics.to_dict(),
            error_model=simulation.senses(),
            pictures={},
            picture_reason="",
        )


def _pictures(folder: Path, results: Iterable[PhaseResult], part: int) -> dict[Path, PhaseResult]:
    """File of the picture at the end of each phase of a part of a chain, from 1."""
    of = f"{part}-" if part > 1 else ""
    names = [f"{r.phase} {r.about}".strip().replace(" ", "-") for r in results]
    files = [folder / f"{of}{number:02d}-{name}.png" for number, name in enumerate(names, start=1)]
    return dict(zip(files, results, strict=True))


def _told(wanted: dict[Path, PhaseResult], drawn: Drawn) -> dict[str, Any]:
    """What a report says of pictures and film."""
    there = {path: result for path, result in wanted.items() if path in drawn.files}
    return {
        "pictures": {p.stem if r.about else r.phase: str(p) for p, r in there.items()},
        "picture_reason": drawn.reason,
        "drawn": str(drawn),
    }


def manipulate(
    plan: ManipulationPlan | Path | str,
    options: ManipulationOptions | None = None,
    *,
    on_step: Callable[[Simulation], None] | None = None,
    pictures: Path | None = None,
    video: Path | None = None,
    arrows: bool = False,
    retry: bool = False,
    view: bool = False,
    **changes: Unpack[ManipulationKeywords],
) -> ManipulationReport:
    """Execute a plan and judge it.

    Args:
        plan: What to execute, or the path of its file.
        options: Under which conditions; defaults if None.
        on_step: Called with the simulation after every time step; may stop it.
        pictures: Folder for a picture at the end of each phase, which is where it went wrong if it
            failed; it must exist. Those of the second movement of a chain begin with "2-".
        video: Write a film here: ``.mp4``, ``.webp`` or ``.gif``; of a chain one per movement, the
            second one's name ends with "-2".
        arrows: Draw the measured contact forces into both.
        retry: Whether a turn that fails is made up for, once; the push is not repeated. The way of
            the hand from where it let go to where it begins anew is not simulated, nor where a plan
            follows on another (``plan.then``). Parts of such a chain are not tried again.
        view: Show it in MuJoCo's viewer, in real time.
        changes: Fields of ``ManipulationOptions`` by name: ``controller="impedance"``,
            ``true_task``, ``physics``, ``timeline``, ``criteria``, ``push``, ``error_model``,
            ``estimator``, ``via``.

    Raises:
        NotFoundError: No controller has that name.
        TaskError: The controller is none, ``view`` without a display, a video that cannot be
            written, or places through which an arm cannot carry the object.
    """
    plan = given_manipulation(plan)
    options = (options or ManipulationOptions()).with_changes(**changes)
    retry = retry and not plan.ending.turned
    more = retry or plan.then is not None
    fresh = copy.deepcopy(options.controller) if more else None  # as it is before the first run
    run = ManipulationRun(plan, options)
    run.sim.simulation.on_step = on_step
    drawing: Drawing = {"pictures": pictures, "video": video, "arrows": arrows}
    report = run.perform(**drawing, retry=retry, view=view)
    if report.complete and plan.then is not None:
        later = options.with_changes(controller=fresh)
        return _followed(plan.then, later, report, drawing, on_step=on_step, view=view)
    if not report.put_down:
        return report
    standing = run.sim.simulation.T_world_object
    try:
        rest = _rest_of(plan, report.log, run.sim.reading.T_world_object())
    except PlannerError as error:
        last = replace(report.results[-1], then=f"no plan for the rest of the turn: {error}")
        return replace(report, results=(*report.results[:-1], last))
    there = run.sim.simulation.plan.task
    there = replace(there, T_world_object=_stood(plan, report.log, standing)[0])
    options = options.with_changes(push=None, via=())
    again = ManipulationRun(rest, options, controller=fresh, true_task=there)
    again.sim.simulation.on_step = on_step
    return replace(again.perform(view=view), earlier=report)


def _followed(
    plan: ManipulationPlan,
    options: ManipulationOptions,
    before: ManipulationReport,
    drawing: Drawing,
    *,
    on_step: Callable[[Simulation], None] | None,
    view: bool,
    number: int = 2,
) -> ManipulationReport:
    """Execute a chain, its movement ``number`` on, from where the run before has put the object."""
    states = before.recording.T_world_object[-1]
    now, target = pose_from_wxyz(states[:3], states[3:]), plan.task.T_world_object
    heading = signed_twist(now.rotation @ target.rotation.T, UP)
    x, y = now.translation[:2].tolist()
    there = options.true_task or plan.task
    pose = object_at_target(plan.task, UP, heading, (x, y))
    there = replace(there, finger_names=plan.task.finger_names, T_world_object=pose)
    fresh = copy.deepcopy(options.controller)
    once = options.with_changes(controller=fresh, true_task=there, push=None, via=())
    run = ManipulationRun(plan, once)
    run.sim.simulation.on_step = on_step
    report = replace(run.perform(**drawing, view=view, number=number), earlier=before)
    report = replace(report, drawn="\n".join(filter(None, (before.drawn, report.drawn))))
    if not report.complete or plan.then is None:
        return report
    return _followed(
        plan.then, options, report, drawing, on_step=on_step, view=view, number=number + 1
    )


def _rest_of(plan: ManipulationPlan, log: ManipulationLog, T_world_object: SE3) -> ManipulationPlan:
    """A plan for what is left of a turn, from where the object stands now, as it is read.

    Raises:
        PlannerError: There is none.
    """
    task = plan.task
    standing, made = _stood(plan, log, T_world_object)
    at_x, at_y = plan.ending.T_world_target.translation[:2].tolist()
    return plan_manipulation(
        replace(task, T_world_object=standing),
        axis=plan.path.axis,
        angle=plan.angle - made,
        shift=plan.shift,
        place=(at_x, at_y),
        seed=plan.record.seed + 1,
        regrasp=plan.cycles > 1,
        rests=rests,
        attitude=plan.path.attitude,
    )


def _stood(plan: ManipulationPlan, log: ManipulationLog, T_world_object: SE3) -> tuple[SE3, float]:
    """Upright pose of an object that was put down, and the turn (rad) that was made of it."""
    task, axis = plan.task, plan.path.axis
    made = 0.0  # brought back in the hand it stands as at first
    if not plan.ending.back:
        counted = float(log.turn[log.during(*TURNING)[-1]])  # whole turns too
        turned = T_world_object.rotation @ task.T_world_object.rotation.T
        made = signed_twist(turned, axis, near=counted)
    x, y = T_world_object.translation[:2].tolist()
    return object_at_target(task, axis, made, (x, y)), made
