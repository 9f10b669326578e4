"""``simulate``: execute a plan in MuJoCo and judge what happened.

The trial moves the gantry, or the arm that the hand is on, along the timeline (approach, close,
squeeze, settle, lift, hold) and asks a controller for the hand's commands at every time step::

    report = simulate(plan)
    print(report.success, report.reason, report.verdict.detail)

``Trial`` is the same in two steps: its ``simulation`` is within reach in between, and whoever is
called after every step may end it::

    def on_step(simulation):
        if simulation.time > 1.5:
            simulation.stop("seen enough")

    report = simulate(plan, on_step=on_step)
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypedDict, Unpack, cast

import numpy as np

from planner.arrays import MOST_COUNT, checked_count, checked_kind, checked_number
from planner.errors import TaskError, shown
from planner.files import given_plan
from planner.plan import GraspPlan
from planner.spatial import SE3
from sim.contacts import NO_FORCE, hand_contacts, merge_per_finger
from sim.controllers import PHASES, AnyController, Phase, Refuses
from sim.controllers.grasp import (
    OPEN_TIME,
    RECLOSING_TIME,
    Opening,
    closing_ended,
    felt_contacts,
)
from sim.controllers.named import controller_name, is_controller
from sim.creep import CREEP_BUDGET, least_creep, remedies
from sim.recorder import Recorder
from sim.report import INTERRUPTED, FingerComparison, PhaseResult, TrialReport
from sim.scene.build import Truth
from sim.scene.carrier import Timeline
from sim.scene.physics import PRESETS, AnyPhysics
from sim.sensing.errors import AnyErrorModel
from sim.show.picture import check_video, draw_tape, moments_of
from sim.simulation import Simulation
from sim.verdict import Fault, Thresholds, Verdict, judge

if TYPE_CHECKING:
    from planner.search.from_cloud import CloudPlan
    from sim.sensing.estimation import AnyEstimator

__all__ = ["Timeline", "Trial", "TrialOptions", "felt_by", "run_grasp_phase", "simulate"]


TRIES = 3
"""Tries of the plans of a cloud: a person does not try more often in the same way."""

LONGEST_PERIOD = 0.1
"""Longest time (s) between samples: a slip that matters lasts longer."""


class TrialKeywords(TypedDict, total=False):
    """Fields of ``TrialOptions`` as keywords, for ``Trial`` and ``simulate``."""

    physics: AnyPhysics | None
    controller: AnyController | None
    timeline: Timeline | None
    thresholds: Thresholds | None
    record_every: float
    error_model: AnyErrorModel | None
    estimator: AnyEstimator | None
    truth: Truth | None


@dataclass(frozen=True, kw_only=True, eq=False)
class TrialOptions:
    """Under which conditions a plan is executed.

    Attributes:
        physics: How MuJoCo computes, or the name of a preset; defaults if None.
        controller: What drives the hand: a name ("feedforward", "impedance"), a controller, or a
            class or function that makes one from the plan; "feedforward" if None.
        timeline: Durations; defaults if None.
        thresholds: Where success ends; defaults if None.
        record_every: Time between samples, s.
        error_model: Errors of sensors, drives and object that the plan does not know; none if None.
        estimator: What tells the controller where the object is; see ``Simulation``.
        truth: Object and table that there really are, unknown to the plan; as planned if None.
    """

    physics: AnyPhysics | None = None
    controller: AnyController | None = None
    timeline: Timeline | None = None
    thresholds: Thresholds | None = None
    record_every: float = 0.02
    error_model: AnyErrorModel | None = None
    estimator: AnyEstimator | None = None
    truth: Truth | None = None

    def __post_init__(self) -> None:
        """Check the time between samples, timeline and thresholds.

        Raises:
            TaskError: The time is out of range, or one of the others is something else.
        """
        if self.timeline is not None:
            checked_kind("timeline", self.timeline, Timeline)
        if self.truth is not None and not isinstance(self.truth, Truth):
            raise TaskError(
                f"truth is {shown(self.truth)}; give what there really is: a Truth, the truth of a "
                "scan, or scanned_truth(FILE) of a file that a scan was written to"
            )
        if self.thresholds is not None:
            checked_kind("thresholds", self.thresholds, Thresholds)
        checked_number(
            "record_every, which is what the verdict sees,", self.record_every, above=0.0,
            most=LONGEST_PERIOD, unit="s", error=TaskError,
        )  # fmt: skip


class Trial:
    """One execution of a plan.

    Attributes:
        plan: What is executed.
        timeline: Durations.
        thresholds: Where success ends.
        simulation: Scene, data, controller and carrier; may be changed before the run.
        recorder: Who takes samples.
        not_lifted: Why the hand, by what it felt, did not lift the object; "" if it did.
        results: The phases of a movement that were run, in order; empty of a grasp.
    """

    def __init__(
        self,
        plan: GraspPlan | Path | str,
        options: TrialOptions | None = None,
        **changes: Unpack[TrialKeywords],
    ) -> None:
        """Build the scene and put hand and object at their start.

        Args:
            plan: What to execute, or the path of its file.
            options: Under which conditions; defaults if None.
            changes: Fields of ``TrialOptions`` by name that are to be others.

        Raises:
            ModelError: MuJoCo refuses the scene.
            NotFoundError: No controller has that name.
            TaskError: ``record_every`` is out of range, the controller is none, or the arm cannot
                follow the timeline.
        """
        asked = replace(options or TrialOptions(), **changes)
        self.plan = plan = given_plan(plan)
        self.timeline = asked.timeline or Timeline()
        self.thresholds = asked.thresholds or Thresholds()
        self._physics = PRESETS.given(asked.physics)
        self.simulation = Simulation(
            plan,
            physics=asked.physics,
            controller=asked.controller,
            timeline=self.timeline,
            error_model=asked.error_model,
            estimator=asked.estimator,
            truth=asked.truth,
            change=self._surroundings(),
        )
        self._truth = asked.truth
        self._object = plan.task.object if asked.truth is None else asked.truth.object
        self.recorder = Recorder(self.simulation, asked.record_every)
        self.not_lifted = ""
        self.results: list[PhaseResult] = []

    def _surroundings(self) -> Callable[[Any], None] | None:
        """What adds to the ``mujoco.MjSpec`` what else stands in the scene; None for nothing."""
        return None

    def run(
        self,
        *,
        progress: Callable[[float], None] | None = None,
        on_step: Callable[[Simulation], None] | None = None,
        view: bool = False,
        picture: Path | str | None = None,
        video: Path | str | None = None,
        arrows: bool = False,
    ) -> TrialReport:
        """Run to the end, or to where it cannot go on, and judge. Ctrl-C ends it with a report.

        Args:
            progress: Called now and then with the share done, in [0, 1].
            on_step: Called with the simulation after every time step; may stop it.
            view: Show it in MuJoCo's viewer, in real time.
            picture: Write a picture of the end here (PNG). Of a trial that failed it shows the
                moment where it went wrong, of a use of a tool the end of the use, and a second one
                (``...-end.png``) the end.
            video: Write a film here: ``.mp4``, ``.webp`` or ``.gif``.
            arrows: Draw the measured contact forces into both.

        Raises:
            TaskError: ``view`` without a display, a video that cannot be written, or the trial has
                run already.
        """
        check_video(video)
        simulation = self.simulation
        if simulation.steps:
            raise TaskError("this trial has run already; make a new Trial to run again")
        begin = time.perf_counter()
        if not self.plan.forces.found:
            fault = Fault(reason="infeasible forces", detail=self.plan.forces.reason)
            return self._report(Verdict(fault), begin)

        def after_step(simulation: Simulation) -> None:
            if progress is not None and simulation.due(self.recorder.every):
                progress(min(1.0, simulation.time / self.timeline.duration))
            if on_step is not None:
                on_step(simulation)

        simulation.on_step = after_step
        tape = simulation.record() if picture or video else None
        if view:
            simulation.show()
        interrupted = False
        try:
            self.perform()
        except KeyboardInterrupt:
            interrupted = True
        finally:
            simulation.on_step = None  # it holds this trial, and the trial what it is called by
            simulation.close()
        report = self.judged(begin, interrupted=interrupted)
        if tape is None:
            return report
        drawn = draw_tape(
            tape,
            pictures=moments_of(picture, self._moment(report)),
            video=None if video is None else Path(video),
            arrows=arrows,
        )
        made = picture is not None and Path(picture) in drawn.files
        return replace(
            report,
            picture=Path(picture) if picture is not None and made else None,
            picture_reason="" if made else drawn.reason or report.picture_reason,
            drawn=str(drawn),
        )

    def _moment(self, report: TrialReport) -> float | None:
        """When (s) there was most to be seen; None: at the end."""
        fault = report.verdict.fault
        return None if fault is None else fault.time

    def perform(self) -> None:
        """Run all phases, or up to the one after which going on makes no sense."""
        for phase in PHASES:
            if not run_grasp_phase(self.simulation, self.recorder, self.timeline, phase):
                self.not_lifted = "" if self.simulation.ended else why_not_lifted(self.simulation)
                break

    def in_hand(self) -> dict[str, float]:
        """How far the object has moved in the hand, as numbers of a phase."""
        slip_mm, slip_deg = self.recorder.slip()
        return {"moved_mm": slip_mm, "turned_deg": slip_deg}

    def run_phases(self, results: Iterable[PhaseResult]) -> None:
        """Keep the ends of the phases of a movement as they come.

        Raises:
            KeyboardInterrupt: Ctrl-C ended the last one.
        """
        for result in results:
            self.results.append(result)
        if self.results and self.results[-1].reason == INTERRUPTED:
            raise KeyboardInterrupt

    def judged(self, begin: float, *, interrupted: bool = False) -> TrialReport:
        """The verdict on what was recorded so far, and its report.

        Args:
            begin: When the run began, ``time.perf_counter()``, s.
            interrupted: Whether Ctrl-C ended it.
        """
        compared = self._comparison()
        return self._report(self._verdict(compared, interrupted), begin, compared)

    def tried_again(self, found: CloudPlan) -> tuple[CloudPlan | None, Truth | None]:
        """Open, back off, and take the next plan of a cloud after what was felt, where it is now.

        Args:
            found: The plan that was executed, with the others.

        Returns:
            The next plan, None if there is none, and what there is now, None if the plan knew it:
            the object, as planned, is where ``simulation`` has it.
        """
        simulation, task = self.simulation, self.plan.task
        seen = simulation.sensed(simulation.observe(simulation.phase, 1.0))
        felt, contacts = felt_contacts(self.plan, seen)
        places = contacts.transformed(seen.T_world_object.inverse()).positions[felt]
        simulation.controller, simulation.on_step = Opening(self.plan), None
        phases: tuple[tuple[Phase, float], ...] = (
            ("open", OPEN_TIME),
            ("retreat", self.timeline.approach),
        )
        for phase, duration in phases:
            for _ in simulation.run(phase, duration):
                pass
        seen = simulation.sensed(simulation.observe("retreat", 1.0))
        believed = task.T_world_object.inverse()
        moved, there = simulation.T_world_object * believed, self._truth
        if there is not None:
            there = replace(there, T_world_object=moved * there.T_world_object)
        return found.after(places, seen.T_world_object * believed), there

    def _comparison(self) -> tuple[FingerComparison, ...]:
        """Planned against measured contacts while holding."""
        return self.recorder.comparison()

    def _verdict(self, compared: tuple[FingerComparison, ...], interrupted: bool) -> Verdict:
        """The verdict on what was recorded so far."""
        simulation = self.simulation
        return judge(
            self.recorder.samples(),
            fingers=self.plan.task.finger_names,
            needed=self.plan.task.fingers_needed,
            lift_mm=1e3 * self.timeline.lift_height,
            thresholds=self.thresholds,
            interrupted=interrupted,
            stopped=simulation.stopped,
            diverged=simulation.diverged,
            not_lifted=self.not_lifted,
            contacts_off_mm={c.finger: c.position_error_mm for c in compared},
        )

    def _report(
        self, verdict: Verdict, begin: float, compared: tuple[FingerComparison, ...] = ()
    ) -> TrialReport:
        plan, task, simulation = self.plan, self.plan.task, self.simulation
        samples = self.recorder.samples()
        merged = merge_per_finger(hand_contacts(simulation.scene, simulation.data))
        ended_holding = len(samples) > 0 and samples.phase[-1] == "hold" and len(merged) > 0
        return TrialReport(
            verdict=verdict,
            hand=task.hand.name,
            object=self._object.shape.spec,
            mass_kg=self._object.mass,
            seed=plan.record.seed,
            fingers=task.finger_names,
            samples=samples,
            recording=self.recorder.recording(),
            plan=plan,
            comparison=compared,
            quality_mu=task.mu,
            contacts_measured=merged if ended_holding else None,
            thresholds=self.thresholds,
            physics=simulation.scene.physics.to_dict(),
            least_creep_mm_s=1e3 * least_creep(simulation.scene, task.finger_names),
            remedies=self._remedies(verdict),
            timeline={k: float(v) for k, v in asdict(self.timeline).items()},
            simulated_s=simulation.time,
            wall_s=time.perf_counter() - begin,
            supported=task.table_height is None,
            carried_by="gantry" if plan.arm is None else "arm",
            object_deviation_mm=1e3 * simulation.scene.deviation,
            controller=type(simulation.controller).__name__,
            events=simulation.events,
            error_model=simulation.senses(),
            path=self.recorder.path_errors(),
            results=tuple(self.results),
        )

    def _remedies(self, verdict: Verdict) -> tuple[str, ...]:
        """What would keep friction from giving way, if that can be why the object was lost."""
        if verdict.reason not in ("slipped", "dropped"):
            return ()
        scene, names = self.simulation.scene, self.plan.task.finger_names
        changes = remedies(scene.physics, lambda p: least_creep(scene, names, p), CREEP_BUDGET)
        return tuple(change.what for change in changes)


def run_grasp_phase(
    simulation: Simulation, recorder: Recorder, timeline: Timeline, phase: Phase
) -> bool:
    """Run one phase of grasping, lifting and holding, and take samples.

    Slip counts from the beginning of "settle"; before "lift" enough fingers must feel the object,
    and the constraint of an object without a table lets go.

    Args:
        simulation: What runs.
        recorder: Who takes its samples.
        timeline: Durations.
        phase: Which of ``PHASES``.

    Returns:
        Whether going on makes sense: too few fingers may feel it, or the simulation have ended.
    """
    wait, until = 0.0, None
    if phase == "close":
        wait = timeline.close_wait + RECLOSING_TIME
        until = closing_ended(simulation.controller, timeline.close_wait, simulation.timestep)
    if phase == "settle":
        recorder.mark_reference()
    if phase == "lift":
        if why_not_lifted(simulation):
            recorder.record()
            return False
        simulation.scene.release(simulation.data)
    careful = simulation.controller if isinstance(simulation.controller, Refuses) else None
    for _ in simulation.run(phase, getattr(timeline, phase), wait=wait, until=until):
        if simulation.due(recorder.every):
            recorder.record()
        if careful is not None and careful.refused:
            recorder.record()
            return False
    return not simulation.ended


def why_not_lifted(simulation: Simulation) -> str:
    """Why what is felt is not to be lifted: what a robot knows before it lifts; "" if it is."""
    controller, task = simulation.controller, simulation.plan.task
    if isinstance(controller, Refuses) and controller.refused:
        return controller.refused
    few = len(felt_by(simulation)) < task.fingers_needed
    return "it was felt by too few fingers to be lifted" if few else ""


def felt_by(simulation: Simulation) -> tuple[str, ...]:
    """Names of the fingers whose sensors feel the object: what a robot knows before it lifts."""
    forces = simulation.sensed(simulation.observe(simulation.phase, 1.0)).normal_forces
    names = simulation.plan.task.finger_names
    return tuple(names[i] for i in np.flatnonzero(forces > NO_FORCE))


def simulate(
    plan: GraspPlan | CloudPlan | Path | str,
    options: TrialOptions | None = None,
    *,
    progress: Callable[[float], None] | None = None,
    on_step: Callable[[Simulation], None] | None = None,
    view: bool = False,
    picture: Path | str | None = None,
    video: Path | str | None = None,
    arrows: bool = False,
    tries: int = TRIES,
    **changes: Unpack[TrialKeywords],
) -> TrialReport:
    """Execute a plan and judge it: ``Trial`` and ``Trial.run`` in one call.

    Of a ``CloudPlan`` the next plan is taken where what is felt speaks against lifting: the hand
    opens and backs off, and the object stays where it was pushed to. ``report.tries`` tells of each
    try, and the rest of the report is of the last one.

    Args:
        plan: What to execute, or the path of its file.
        options: Under which conditions; defaults if None.
        progress: See ``Trial.run``, as for the next five.
        on_step: Called with the simulation after every time step; may stop it.
        view: Show it in MuJoCo's viewer.
        picture: File of a picture.
        video: File of a film.
        arrows: Draw the measured contact forces into both.
        tries: Most tries of a ``CloudPlan``, at least 1. For more than one each plan needs a
            controller of its own: a name, class or function; with a made one there is one try.
        changes: Fields of ``TrialOptions`` by name: ``controller="impedance"``, ``physics``,
            ``timeline``, ``thresholds``, ``record_every``, ``error_model``, ``estimator``,
            ``truth``.

    Raises:
        PlannerError: See ``Trial`` and ``Trial.run``; ``tries`` is no whole number of at least 1;
            several plans may be tried and there is one controller.
    """
    checked_count("tries", tries, least=1, most=MOST_COUNT, error=TaskError)
    asked = replace(options or TrialOptions(), **changes)
    told: list[str] = []
    found: CloudPlan | None = None
    if not isinstance(plan, GraspPlan | Path | str):
        from planner.search.from_cloud import CloudPlan  # here: most plans are of known objects

        found = plan if isinstance(plan, CloudPlan) else None
    if found is not None and found.others and tries > 1 and is_controller(asked.controller):
        raise TaskError(
            f"controller is a {controller_name(asked.controller)}, made for one plan, and "
            f"{1 + len(found.others)} may be tried; give a name, or the class or function that "
            "makes one from each plan, or tries=1"
        )
    left_at: SE3 | None = None
    while True:
        trial = Trial(cast("GraspPlan | Path | str", plan) if found is None else found.plan, asked)
        if left_at is not None:
            trial.simulation.put_object(left_at)
        report = trial.run(
            progress=progress,
            on_step=on_step,
            view=view,
            picture=picture,
            video=video,
            arrows=arrows,
        )
        if found is None:
            return report
        again = trial.not_lifted if report.reason == "no contact" else ""
        told.append(f"not lifted, {again}" if again else report.reason or report.verdict.outcome)
        if not again or len(told) >= tries or is_controller(asked.controller):
            return replace(report, tries=tuple(told))
        following, truth = trial.tried_again(found)
        if following is None:
            return replace(report, tries=tuple(told))
        found, asked = following, replace(asked, truth=truth)
        left_at = None if truth is not None else trial.simulation.T_world_object
