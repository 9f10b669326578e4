"""``TrialReport``: what happened in a trial; ``sim.report_file`` has its form in files."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from rich.console import Console, ConsoleOptions, RenderResult
from rich.markup import escape
from rich.table import Table
from rich.text import Text

from planner.arrays import finite
from planner.contacts import ContactSet
from planner.files import plan_from_dict, plan_to_dict
from planner.files.disk import MOVEMENT_FORMATS
from planner.plan import GraspPlan
from planner.quality import QualityReport, analyse
from planner.showing import Shown, in_notebook
from planner.spatial import FloatArray
from planner.system.package import written_by
from sim.controllers.base import Event
from sim.recording import Recording, SampleData, Samples
from sim.report_file import ComparisonData, ExecutionFile, PathRecord, ReportFile, UseRecord
from sim.screen import Report, error_lines
from sim.tables import table
from sim.verdict import Reason, Thresholds, Verdict, largest

if TYPE_CHECKING:
    from planner.motion import MovementPlan

__all__ = ["ExecutionReport", "FingerComparison", "TrialReport"]

MOST_EVENTS = 8
"""Events of the controller on the screen; the file has all of them."""


@dataclass(frozen=True, kw_only=True, eq=False)
class FingerComparison:
    """Planned against measured contact of one finger, while holding.

    Attributes:
        finger: Its name.
        planned_position: (3,), in the object's frame, m.
        measured_position: (3,), mean over the hold; NaN without contact.
        position_error_mm: Distance between the two.
        planned_normal_force: N.
        measured_normal_force: Mean over the hold, N; 0 without contact.
        force_error_N: Mean over the hold of the absolute difference.
        force_error_percent: The same as a share of the planned force.
    """

    finger: str
    planned_position: FloatArray
    measured_position: FloatArray
    position_error_mm: float
    planned_normal_force: float
    measured_normal_force: float
    force_error_N: float
    force_error_percent: float


INTERRUPTED = "interrupted"
"""Why a phase failed that Ctrl-C ended."""


@dataclass(frozen=True, kw_only=True)
class PhaseResult:
    """The end of one phase.

    Attributes:
        phase: Which.
        about: Which one of several: a stroke's number, or the finger that moves on; "" of one.
        begin: When it began, s.
        end: When it ended, s.
        reason: Why it failed, "" if it did not.
        numbers: What was looked at, by name with unit.
        then: What was tried after a failure, and what came of that; "" if nothing was.
    """

    phase: str
    begin: float
    end: float
    reason: str
    numbers: dict[str, float]
    about: str = ""
    then: str = ""

    @property
    def passed(self) -> bool:
        """Whether the phase ended as it should."""
        return not self.reason

    def __str__(self) -> str:
        """One line."""
        told = ", ".join(f"{name} {value:.3g}" for name, value in self.numbers.items())
        mark = "ok  " if self.passed else "FAIL"
        name = f"{self.phase} {self.about}".strip()
        line = f"{mark} {name:<15}{self.end - self.begin:5.2f} s  {told}"
        if self.reason:
            line += f"\n     {self.reason}"
        return f"{line}\n     then: {self.then}" if self.then else line


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class ExecutionReport(Report, Shown):
    """What the reports of all executions of a plan have.

    Attributes:
        hand: Name of the hand.
        object: Specification of the object's shape.
        mass_kg: Its true mass.
        seed: Seed of the plan.
        fingers: Names of the fingers that take part, order of the columns over time.
        recording: States at the times of the samples.
        plan: What was executed.
        physics: Name and numbers of ``PhysicsOptions``, as plain data.
        error_model: Fields of ``sim.sensing.errors.ErrorModel``, and under "drawn" what was drawn
            of them; None where sensors, drives and object were as believed.
        controller: Name of the controller's class.
        events: What the controller noticed and did, in order; empty for one that notices nothing.
        picture_reason: Why there is no picture, "" where there is one.
        command: What the command line was told, "" of a script.
        drawn: Files of pictures and film that were drawn, and how, in one line; not in the file.
        results: The phases of a movement that were run, in order; empty of the trial of a grasp.
    """

    hand: str
    object: str
    mass_kg: float
    seed: int
    fingers: tuple[str, ...]
    recording: Recording
    plan: GraspPlan | MovementPlan
    physics: dict[str, Any]
    error_model: dict[str, Any] | None = None
    controller: str = ""
    events: tuple[Event, ...] = ()
    picture_reason: str = "none was asked for"
    command: str = ""
    drawn: str = ""
    results: tuple[PhaseResult, ...] = ()

    def __getstate__(self) -> dict[str, Any]:
        """How it is sent to another process: its plan as a file has it."""
        return {**vars(self), "plan": data_of_plan(self.plan)}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """How it arrives there."""
        vars(self).update(state, plan=plan_of_data(state["plan"], "a report's plan"))

    def _repr_html_(self) -> str:
        """What a notebook shows of it: a table and a picture, made once."""
        return in_notebook(self)

    def to_dict(self, *, states: bool = True) -> dict[str, Any]:
        """Plain data that follows ``to_file``; what is not a finite number becomes None.

        Args:
            states: Whether plan and recorded states are part of it: a few hundred kilobytes to some
                megabytes, from which a page can be made.
        """
        return self.to_file(states=states).model_dump(mode="json")

    @abstractmethod
    def to_file(self, *, states: bool = True) -> ExecutionFile:
        """The same as the data of a file, which pages are made of."""

    def _shared(self, *, states: bool) -> dict[str, Any]:
        """Fields of a file that all have."""
        return {
            "written_by": written_by(),
            "command": self.command,
            "success": self.success,
            "hand": self.hand,
            "object": self.object,
            "mass_kg": self.mass_kg,
            "seed": self.seed,
            "fingers": list(self.fingers),
            "physics": self.physics,
            "error_model": self.error_model,
            "controller": self.controller,
            "events": [
                {"time_s": e.time, "kind": e.kind, "finger": e.finger, "detail": e.detail}
                for e in self.events
            ],
            "phases": [
                {
                    "phase": r.phase,
                    "about": r.about,
                    "begin_s": r.begin,
                    "end_s": r.end,
                    "passed": r.passed,
                    "reason": r.reason,
                    "then": r.then,
                    "numbers": finite(r.numbers),
                }
                for r in self.results
            ],
            "picture_reason": self.picture_reason,
            "plan": self._plan_in_file() if states else None,
            "recording": self.recording.to_dict() if states else None,
        }

    def _plan_in_file(self) -> dict[str, Any] | None:
        """The plan as its file has it; None where there can be no file.

        None can name a hand that was made in Python, and none holds a plan without forces.
        """
        plan = self.plan
        held = not isinstance(plan, GraspPlan) or plan.forces.found
        return data_of_plan(plan) if held and plan.task.hand.reference is not None else None


def data_of_plan(plan: GraspPlan | MovementPlan) -> dict[str, Any]:
    """A plan as its file has it."""
    if isinstance(plan, GraspPlan):
        return plan_to_dict(plan)
    from planner.files.movements import movement_to_dict  # trials of grasps need no movements

    return movement_to_dict(plan)


def plan_of_data(data: dict[str, Any], source: str) -> GraspPlan | MovementPlan:
    """The plan that plain data hold, checked like a file; ``source`` is what errors call it."""
    if data.get("format") not in MOVEMENT_FORMATS:
        return plan_from_dict(data, source)
    from planner.files.movements import movement_from_dict

    return movement_from_dict(data, source)


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class TrialReport(ExecutionReport):
    """A trial from beginning to end; see ``ExecutionReport`` for what all executions report.

    Attributes:
        verdict: Success or the reason why not.
        samples: What was judged, over time.
        plan: What was executed.
        comparison: Planned against measured contacts, one per finger; empty without a hold.
        quality_mu: Sliding friction (-) of both analyses of quality: the plan's, not that of the
            simulation.
        contacts_measured: Those contacts, merged per finger, in the world's axes, with their forces
            and the simulation's friction; None without contacts. For an analysis with another
            friction: ``analyse(report.contacts_measured, length=...)``.
        thresholds: Where success ends.
        least_creep_mm_s: Speed at which the object sinks through the fingers under this physics
            without noslip iterations, however firm the grip (``sim.creep``).
        remedies: Of an object that was lost: what to write into a scene so that this creep is
            small, each enough by itself; empty if it is small.
        timeline: Durations of the phases, as plain data.
        simulated_s: Simulated time.
        wall_s: Time it took.
        supported: Whether the object was held by a constraint until the lift, for want of a table.
        carried_by: What carried the hand: "gantry", six driven axes, or "arm".
        object_deviation_mm: How far convex pieces that stood for a mesh reach out of it at most.
        picture: Picture of the held object, None if there is none.
        tries: Of a ``CloudPlan``, how each try ended; the report is of the last.
        use: Of a tool: what it is, what was done, and what was measured at the times of the
            samples, as plain data of ``sim.report_file.UseRecord``; None of other trials.
        path: Of two hands on carriages: how far the object is from its planned path, at the times
            of the samples; None of others.
    """

    verdict: Verdict
    samples: Samples
    plan: GraspPlan
    comparison: tuple[FingerComparison, ...]
    quality_mu: float
    contacts_measured: ContactSet | None
    thresholds: Thresholds
    least_creep_mm_s: float
    remedies: tuple[str, ...]
    timeline: dict[str, float]
    simulated_s: float
    wall_s: float
    supported: bool
    carried_by: Literal["gantry", "arm"] = "gantry"
    object_deviation_mm: float = 0.0
    picture: Path | None = None
    tries: tuple[str, ...] = ()
    use: dict[str, Any] | None = None
    path: PathRecord | None = None

    @property
    def quality_planned(self) -> QualityReport:
        """Analysis of the planned contacts."""
        return self.plan.quality

    @cached_property
    def quality_measured(self) -> QualityReport | None:
        """The same of where the contacts were at the end of the hold; None without contacts.

        They are merged per finger, with the plan's friction and contact model, so that the two can
        be compared; the closure in ``samples`` has the simulation's own friction. Computed when it
        is first read.
        """
        if self.contacts_measured is None:
            return None
        task = self.plan.task
        measured = replace(
            self.contacts_measured.with_friction(task.mu, task.mu_torsion),
            models=(task.contact_model,) * len(self.contacts_measured),
        )
        return analyse(measured, length=task.object.shape.bounding_radius)

    @property
    def success(self) -> bool:
        """Whether the object was held, by the planned grasp or another (``as_planned``)."""
        return self.verdict.success

    @property
    def as_planned(self) -> bool:
        """Whether the object was held by the grasp that was planned."""
        return self.verdict.as_planned

    @property
    def reason(self) -> Reason:
        """Why not held; "" if it was."""
        return self.verdict.reason

    @property
    def largest_slip(self) -> tuple[float, float]:
        """Largest movement (mm) and rotation (degrees) of the object relative to the palm."""
        return largest(self.samples.slip_mm), largest(self.samples.slip_deg)

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        """One line of verdict, and planned against measured contacts; ``details`` has the rest."""
        moved, turned = self.largest_slip
        slip = f"the object moved {moved:.2f} mm and {turned:.2f} degrees in the hand"
        other = escape(self.verdict.other_grasp)
        failed = "not held" if self.use is None else "not done"
        line = {
            "held": f"[bold green]held[/]: {slip}",
            "held, another grasp": f"[bold yellow]held, but by another grasp[/]: {other}; {slip}",
            "not held": f"[bold red]{failed}, {self.reason}[/]: {escape(self.verdict.detail)}",
        }[self.verdict.outcome]
        yield Text.from_markup(f"{escape(self.hand)}, {escape(self.object)}: {line}")
        if self.path is not None and self.success and (said := str(self.path)):
            yield Text(said)
        for number, told in enumerate(self.tries if len(self.tries) > 1 else (), 1):
            yield Text(f"try {number}: {told}")
        if self.use is not None:
            yield Text(f"use: {self.use['summary']}")
        if self.remedies:
            yield Text("each of these keeps the object from creeping:")
        for remedy in self.remedies:
            yield Text(f"  {remedy}", no_wrap=True, overflow="ignore")
        if self.comparison:
            yield self._comparison_table()

    def details(self) -> Iterator[Text]:
        """Lines that explain the verdict: conditions, events of the controller, quality."""
        carrier = "an arm" if self.carried_by == "arm" else "six driven axes (no arm)"
        yield Text(
            f"{1e3 * self.mass_kg:.0f} g, hand carried by {carrier}, controller {self.controller}, "
            f"{self.simulated_s:.1f} s simulated in {self.wall_s:.1f} s"
        )
        yield Text(
            f"physics: {self.physics['name']}; the object creeps at {self.least_creep_mm_s:.2g} "
            "mm/s in MuJoCo's friction whatever the grip, before "
            f"{self.physics['noslip_iterations']} noslip iterations"
        )
        yield from (Text(line) for line in error_lines(self.error_model))
        for event in self.events[:MOST_EVENTS]:
            who = f" {event.finger}" if event.finger else ""
            yield Text(f"  {event.time:.3f} s: {event.kind}{who}: {event.detail}")
        if len(self.events) > MOST_EVENTS:
            yield Text(f"  and {len(self.events) - MOST_EVENTS} more events of the controller")
        holding = self.samples.during("hold")
        if not len(holding):
            return
        yield Text(
            f"force closure of the measured contacts in {self.samples.closed[holding].sum()} of "
            f"{len(holding)} samples of the hold"
        )
        if self.quality_measured is not None:
            yield Text(
                f"epsilon of the round friction cones: planned {self.quality_planned.epsilon_round}"
                f", measured {self.quality_measured.epsilon_round} (both with the plan's friction, "
                f"mu {self.quality_mu:g})"
            )

    def _comparison_table(self) -> Table:
        made = table(
            "planned and measured contacts while holding",
            ("finger", "off by (mm)", "planned (N)", "measured (N)", "error"),
            left=("finger",),
        )
        for c in self.comparison:
            made.add_row(
                c.finger,
                f"{c.position_error_mm:.2f}",
                f"{c.planned_normal_force:.2f}",
                f"{c.measured_normal_force:.2f}",
                f"{c.force_error_percent:.1f} %",
            )
        return made

    def to_file(self, *, states: bool = True) -> ReportFile:
        """The same as the data of a file, which pages are made of."""
        return ReportFile(
            **self._shared(states=states),
            reason=self.reason,
            detail=self.verdict.detail,
            reason_time_s=finite(self.verdict.time),
            other_grasp=self.verdict.other_grasp,
            largest_slip_mm=finite(self.largest_slip[0]),
            largest_slip_deg=finite(self.largest_slip[1]),
            comparison=[
                ComparisonData(
                    finger=c.finger,
                    planned_position_object_m=finite(c.planned_position),
                    measured_position_object_m=finite(c.measured_position),
                    position_error_mm=finite(c.position_error_mm),
                    planned_normal_force_N=c.planned_normal_force,
                    measured_normal_force_N=finite(c.measured_normal_force),
                    force_error_N=finite(c.force_error_N),
                    force_error_percent=finite(c.force_error_percent),
                )
                for c in self.comparison
            ],
            quality_planned=self.quality_planned.to_dict(),
            quality_measured=(
                None if self.quality_measured is None else self.quality_measured.to_dict()
            ),
            quality_mu=self.quality_mu,
            thresholds=asdict(self.thresholds),
            least_creep_mm_s=finite(self.least_creep_mm_s),
            remedies=list(self.remedies),
            timeline=self.timeline,
            simulated_s=self.simulated_s,
            wall_s=self.wall_s,
            supported_until_lift=self.supported,
            carried_by=self.carried_by,
            object_deviation_mm=self.object_deviation_mm,
            picture=None if self.picture is None else self.picture.name,
            tries=list(self.tries),
            samples=SampleData.model_validate(self.samples.to_dict()),
            use=None if self.use is None else UseRecord(**finite(self.use)),
            path=self.path,
        )
