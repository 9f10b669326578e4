"""``manipulation_page``: a manipulation as a page: what happened, why, and the motion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import reduce
from typing import Any

import numpy as np

from planner.pages.blocks import Block, Facts, Folded, Heading, PlotsHere, Sentence, Table, Verdict
from planner.pages.page import Page, without_folder
from planner.pages.scene import Band, Bars, Line, Mark, Plot, Scene
from planner.spatial import FloatArray
from planner.task import GraspTask
from sim.manipulation.page_parts import (
    Part,
    obstacles_of,
    parts_of,
    planned_contacts,
    planned_forces,
)
from sim.manipulation.report_file import ManipulationReportFile
from sim.manipulation.timeline import IN_THE_AIR
from sim.recording import Recording
from sim.show.parts import (
    NO_STATES,
    Moving,
    bare_scene,
    command_plot,
    cone_plot,
    error_blocks,
    event_marks,
    events_block,
    facts_of,
    force_plot,
    measured_contacts,
    moving_stage,
    phase_blocks,
    physics_blocks,
    plan_blocks,
    quality_plot,
    quality_rows,
    shown,
    source_blocks,
    task_of_plan,
    task_rows,
)
from sim.show.trial_page import pressure_blocks

MODE_COLOURS = {
    "stick": "#3a9d5d",
    "roll": "#4a86c8",
    "slip": "#e0952b",
    "break": "#d33f3f",
    "off": "#e3e6ea",
}
"""Colour of each contact mode."""


LET_GO = ("open", "retreat")
"""Phases in which the object is in no hand."""


def manipulation_page(report: ManipulationReportFile, task: GraspTask | None = None) -> Page:
    """The page of a manipulation, from its report alone.

    Args:
        report: As read from a file, or ``ManipulationReport.to_file()``.
        task: Hand and object to draw, where they are at hand; those of the report's plan if None.

    Raises:
        PlannerError: The report's hand or object cannot be loaded, or have changed since.
    """
    parts = parts_of(report)
    recording = _states(parts)
    stage, last = None, parts[-1]
    if recording is not None and len(recording) and last.plan is not None:
        task = task or task_of_plan(last.plan.grasp)
        stage = moving_stage(task, recording, obstacles_of(last.plan, task))
    fault = _fault_time(parts)
    return Page(
        title=_title(report),
        subtitle=f"Manipulation, seed {report.seed}, {shown(report.mass_kg, 'kg')}, "
        f"{report.controller}",
        verdict=_verdict(report, fault),
        summary=_summary(parts, stage),
        scene=_scene(parts, recording, stage, task, fault) if len(last) else None,
        data=report.model_dump(mode="json"),
        kind="report",
    )


def _title(report: ManipulationReportFile) -> str:
    item = without_folder(report.object)
    if _goal_off(report) is not None:
        return f"{report.hand} brings {item} to a goal rotation"
    return f"{report.hand} turns {item} by {shown(report.asked_deg, 'degrees')}"


def _goal_off(report: ManipulationReportFile) -> float | None:
    """How far (degrees) the object is off its goal at last; None of a report without a goal."""
    return report.numbers.get("goal_off_deg")


def page_of_report(report: Any) -> Page:
    """The page of a ``sim.manipulation.ManipulationReport``; see ``manipulation_page``."""
    return manipulation_page(report.to_file(), report.plan.task)


def _states(parts: Sequence[Part]) -> Recording | None:
    """The recordings of all parts as one; None where one is missing."""
    found = [part.recording for part in parts if part.recording is not None]
    if len(found) < len(parts):
        return None
    pairs = list(zip(found, [part.shift for part in parts], strict=True))
    return reduce(lambda before, pair: before.joined(*pair), pairs[1:], found[0])


def _verdict(report: ManipulationReportFile, fault: float | None) -> Verdict:
    good = report.complete and report.success
    if not report.complete:
        text, reason = "Failed", report.reason
    elif report.earlier is not None and not report.earlier.complete:
        text, reason = "Put down half-way and begun again", report.earlier.reason
    elif not report.success:
        turned = shown(report.numbers["turned_deg"], "degrees")
        text, reason = "Put down, but not turned as asked", f"It was turned by {turned}."
    elif (off := _goal_off(report)) is not None:
        most = report.criteria["goal_deg"] or np.inf
        good = good and off <= most
        text = "Goal reached" if good else "Goal not reached"
        reason = f"The object is {off:.1f} degrees off (at most {most:g}). {report.faults}".strip()
    elif not report.success_with_closure:
        text, reason = "Turned as asked and put down, but", report.faults
    else:
        turned = shown(report.numbers["turned_deg"], "degrees")
        text, reason = "Turned as asked and put down", f"It was turned by {turned}."
    return Verdict(good=good, text=text, reason=reason, time=fault)


def _fault_time(parts: Sequence[Part]) -> float | None:
    """When it first went wrong, on the page's axis, s; None if nothing did in the end."""
    last = parts[-1].report
    if last.complete and last.success_with_closure:
        return None
    times = [p.end_s + part.shift for part in parts for p in part.report.phases if not p.passed]
    for part in parts:
        limit = part.report.criteria["collision_N"]
        struck = np.array(part.channel("collision_N"), dtype=np.float64) > (limit or np.inf)
        air = np.isin(np.array(part.channel("phase"), dtype=str), IN_THE_AIR)
        wrong = struck | (air & ~np.array(part.channel("closed"), dtype=bool))
        times += part.time[wrong][:1].tolist()
    return min(times, default=None)


# ---- the scene


def _scene(
    parts: Sequence[Part],
    recording: Recording | None,
    stage: Moving | None,
    task: GraspTask | None,
    fault: float | None,
) -> Scene:
    time = np.concatenate([part.time for part in parts])
    bands = tuple(band for part in parts for band in _bands(part))
    contacts = []
    if stage is not None and recording is not None and task is not None:
        contacts.append(measured_contacts(recording))
        if all(part.plan is not None for part in parts):
            contacts.append(planned_contacts(parts, task.mu))
    turning = next((b.begin for b in bands if b.name.startswith("turn")), time[0])
    first = time[min(int(np.searchsorted(time, turning, side="right")), len(time) - 1)]
    return replace(
        bare_scene(time) if stage is None else stage.scene,
        time=time,
        contacts=tuple(contacts),
        plots=_plots(parts, recording, task),
        bars=(_modes(parts),),
        bands=bands,
        marks=tuple(mark for part in parts for mark in _marks(part)),
        start=float(np.clip(first if fault is None else fault, time[0], time[-1])),
    )


def _bands(part: Part) -> list[Band]:
    return [
        Band(
            name=f"{p.phase} {p.about}".strip(),
            begin=p.begin_s + part.shift,
            end=p.end_s + part.shift,
        )
        for p in part.report.phases
    ]


def _marks(part: Part) -> list[Mark]:
    marks = list(event_marks(part.report.events, part.shift))
    if part.shift:
        marks.append(Mark(time=part.shift, text="begun again"))
    for p in part.report.phases:
        if not p.passed:
            text = f"{p.phase}: {p.reason}" + (f"; then: {p.then}" if p.then else "")
            marks.append(Mark(time=p.end_s + part.shift, text=text, kind="fault"))
    if part.report.collision and (part.report.earlier is None or part.shift == 0.0):
        limit = part.report.criteria["collision_N"]
        struck = np.array(part.channel("collision_N"), dtype=np.float64) > (limit or np.inf)
        text = f"hand collided: {part.report.collision}"
        marks += [Mark(time=t, text=text, kind="fault") for t in part.time[struck][:1].tolist()]
    return marks


def _plots(
    parts: Sequence[Part], recording: Recording | None, task: GraspTask | None
) -> tuple[Plot, ...]:
    fingers = parts[0].report.fingers
    planned = np.concatenate([planned_forces(part) for part in parts])
    asked = np.concatenate([np.full(len(part), part.report.asked_deg) for part in parts])
    plots = [
        Plot(
            title="Object turned in the palm",
            unit="degrees",
            lines=(
                Line(name="turned", values=_held(parts, "object_in_palm_turn_deg")),
                Line(name="asked", values=asked, dashed=True),
                Line(name="tilted", values=_held(parts, "object_in_palm_tilt_deg")),
            ),
        ),
        force_plot(fingers, _joined(parts, "normal_force_N"), planned),
        cone_plot(fingers, _joined(parts, "friction_utilisation")),
        quality_plot(
            _joined(parts, "epsilon"), None if recording is None else recording.min_weight
        ),
        _moved(parts),
    ]
    commands = None
    if recording is not None:
        commands = command_plot(recording, None if task is None else task.hand)
    return tuple(plots if commands is None else [*plots, commands])


def _moved(parts: Sequence[Part]) -> Plot:
    """Translation in the palm, and distance from the path."""
    shift = _held(parts, "object_in_palm_shift_mm")
    lines = [Line(name=f"{axis} of the palm", values=shift[:, k]) for k, axis in enumerate("xyz")]
    off = Line(name="off its path", values=_held(parts, "off_path_mm"))
    return Plot(title="Object moved in the palm", unit="mm", lines=(*lines, off))


def _joined(parts: Sequence[Part], channel: str) -> FloatArray:
    """A channel over all parts, NaN for null."""
    return np.concatenate([np.array(part.channel(channel), dtype=np.float64) for part in parts])


def _held(parts: Sequence[Part], channel: str) -> FloatArray:
    """A channel about the object in the palm, NaN once the hand has let go of it."""
    values = _joined(parts, channel)
    phases = [phase for part in parts for phase in part.channel("phase")]
    values[np.isin(np.array(phases, dtype=str), LET_GO)] = np.nan
    return values


def _modes(parts: Sequence[Part]) -> Bars:
    """Contact modes of every finger, planned above measured."""
    rows = {}
    for i, finger in enumerate(parts[0].report.fingers):
        for name in ("planned", "measured"):
            modes = (row for part in parts for row in part.channel(f"contact_mode_{name}"))
            rows[f"{finger}, {name}"] = tuple(row[i] for row in modes)
    return Bars(title="Contact modes", rows=rows, colours=MODE_COLOURS)


# ---- the words


def _summary(parts: Sequence[Part], stage: Moving | None) -> tuple[Block, ...]:
    report, plan = parts[-1].report, parts[-1].plan
    blocks: list[Block] = []
    if any(part.recording is None for part in parts):
        blocks.append(Sentence(text=NO_STATES, kind="warning"))
    elif stage is None:
        text = "This report names no hand that can be loaded, so that only its numbers are shown."
        blocks.append(Sentence(text=text, kind="warning"))
    elif stage.note:
        blocks.append(Sentence(text=stage.note, kind="warning"))
    if len(parts) > 1:
        planned = all(part.report.complete for part in parts)
        text = (
            "The goal takes several movements, each from where the one before has set the object "
            "down; names of later pictures and films tell the movement."
            if planned
            else "The object was put down half-way and all was begun again: both runs are shown, "
            "one after the other."
        )
        text += " The numbers below are those of the last one."
        blocks.append(Sentence(text=text))
    if report.made_backwards_because:
        text = f"Made backwards before it was put down: {report.made_backwards_because}."
        blocks.append(Sentence(text=text))
    blocks += [*error_blocks(report.error_model), PlotsHere(), *pressure_blocks(report.error_model)]
    for part in parts:
        title = "Phases" if not part.shift else "Phases of the second run"
        blocks += phase_blocks(part.report.phases, title)
    numbers = dict(report.numbers)
    if not any(report.asked_shift_mm):
        numbers.pop("shift_off_mm", None)
    blocks += [Heading(text="Numbers"), facts_of(numbers)]
    blocks += [*_forces(report), *_qualities(report)]
    blocks += events_block([event for part in parts for event in part.report.events])
    rows = [
        ("hand", report.hand),
        ("object", report.object),
        ("mass", shown(report.mass_kg, "kg")),
        ("turn asked for", shown(report.asked_deg, "degrees")),
        ("shift asked for", shown(report.asked_shift_mm, "mm")),
    ]
    grasp = None if plan is None else plan.grasp
    more = () if grasp is None else task_rows(grasp.task)
    blocks += [Heading(text="Task"), Facts(rows=(*rows, *more))]
    if plan is not None and grasp is not None:
        origin = [
            ("attempts", shown(plan.record.attempts)),
            ("planned in", shown(plan.record.cpu_s, "s of CPU")),
            ("torque in reserve, as a share", shown(plan.torque_reserve)),
        ]
        if plan.cycles > 1:
            origin.append(("strokes", shown(plan.cycles)))
        blocks += [Heading(text="Plan"), *plan_blocks(grasp, origin)]
    blocks += physics_blocks(report.physics, (("controller", report.controller),))
    blocks += [
        Folded(title="Where phases fail", blocks=(facts_of(report.criteria),)),
        Folded(title="Durations (s) and heights (m)", blocks=(facts_of(report.timeline),)),
        *source_blocks(report.written_by, report.command),
    ]
    return tuple(blocks)


def _forces(report: ManipulationReportFile) -> list[Block]:
    """How hard each finger pressed."""
    rows = tuple(
        (f.finger, shown(f.peak_N), shown(f.sustained_N), shown(f.mean_N)) for f in report.forces
    )
    columns = ("finger", "peak (N)", "sustained (N)", "mean (N)")
    return [Heading(text="Normal forces"), Table(columns=columns, rows=rows, fingers=True)]


def _qualities(report: ManipulationReportFile) -> list[Block]:
    """Quality of the measured contacts before the lift and after the turn."""
    rows = [
        (f"{name}, {when}", value)
        for when, quality in (
            ("before the lift", report.quality_before),
            ("after the turn", report.quality_after),
        )
        if quality is not None
        for name, value in quality_rows(quality)
    ]
    return [Facts(rows=tuple(rows))] if rows else []
