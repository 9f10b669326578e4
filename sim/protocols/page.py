"""``outcome_page``: one trial of a protocol as a page: the motion, the disturbance, the verdict."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from planner.errors import TaskError
from planner.pages.blocks import Block, Facts, Folded, Heading, PlotsHere, Verdict
from planner.pages.page import Page
from planner.pages.plan_scene import planned_contacts
from planner.pages.scene import Line, Mark, Plot
from planner.plan import GraspPlan
from planner.system.package import written_by
from sim.protocols.outcome import Outcome
from sim.protocols.report import ASKED, ProtocolReport
from sim.report_file import EventData
from sim.show.parts import (
    cone_plot,
    event_marks,
    events_block,
    facts_of,
    force_plot,
    measured_contacts,
    moving_stage,
    phase_bands,
    physics_blocks,
    quality_plot,
    shown,
    source_blocks,
)

ON_THE_TABLE = ("robust",)
"""Protocols that begin as a trial does; in the others the object is held in the air."""


def outcome_page(
    report: ProtocolReport, outcome: Outcome, plan: GraspPlan, command: str = ""
) -> Page:
    """The page of one trial of a protocol.

    Args:
        report: Of the protocol.
        outcome: One of its outcomes.
        plan: The plan that was tested.
        command: What the command line was told, "" of a script.

    Raises:
        TaskError: The trial has no recorded states: nothing moved.
    """
    recording = outcome.recording
    if recording is None or not len(recording):
        raise TaskError(f"the trial {outcome.name!r} has no recorded states, so it has no page")
    task = plan.task
    if report.protocol not in ON_THE_TABLE:
        task = replace(task, table_height=None, obstacles=())
    stage = moving_stage(task, recording)
    data = {
        "format": "opposable-protocol-trial",
        "version": 1,
        "written_by": written_by(),
        "command": command,
        **{name: getattr(report, name) for name in ASKED if name != "plan"},
        "physics": dict(report.physics),
        "settings": dict(report.settings),
        **outcome.to_dict(),
        "recording": recording.to_dict(),
    }
    fault = outcome.fault
    time = outcome.samples.time
    events = [
        EventData(time_s=e.time, kind=e.kind, finger=e.finger, detail=e.detail)
        for e in outcome.events
    ]
    marks = event_marks(events)
    if fault is not None:
        text = f"{fault.reason}: {fault.detail}"
        marks = (*marks, Mark(time=fault.time, text=text, kind="fault"))
    scene = replace(
        stage.scene,
        contacts=(
            measured_contacts(recording),
            planned_contacts([plan.contacts_in_object], actor="object"),
        ),
        plots=_plots(outcome, plan),
        bands=phase_bands(time.tolist(), outcome.samples.phase),
        marks=marks,
        start=float(np.clip(time[0] if fault is None else fault.time, time[0], time[-1])),
    )
    return Page(
        title=f"{report.hand} holds {report.object}: {outcome.name}",
        subtitle=f"Protocol {report.protocol}, {report.controller}",
        verdict=_verdict(outcome),
        summary=_summary(data, events, stage.note),
        scene=scene,
        data=data,
        kind="trial",
    )


def _verdict(outcome: Outcome) -> Verdict:
    fault = outcome.fault
    if fault is not None:
        text = "Lost under a growing load" if outcome.grows else f"Not held: {fault.reason}"
        return Verdict(good=outcome.grows, text=text, reason=fault.detail, time=fault.time)
    if outcome.other_grasp:
        return Verdict(good=False, text="Held, by another grasp", reason=outcome.other_grasp)
    return Verdict(good=True, text="Held")


def _plots(outcome: Outcome, plan: GraspPlan) -> tuple[Plot, ...]:
    samples, fingers = outcome.samples, outcome.fingers
    assert outcome.recording is not None
    plots = [
        force_plot(fingers, samples.normal_force, plan.contacts.forces[None, :, 0]),
        cone_plot(fingers, samples.friction_utilisation),
        quality_plot(samples.epsilon, outcome.recording.min_weight),
        _line("Object moved in the palm", "mm", samples.slip_mm),
        _line("Object turned in the palm", "degrees", samples.slip_deg),
    ]
    if outcome.unit:
        plots.insert(0, _line("Disturbance", outcome.unit, outcome.load))
    return tuple(plots)


def _line(title: str, unit: str, values: Any) -> Plot:
    return Plot(title=title, unit=unit, lines=(Line(name="measured", values=values),))


HEAD = ("protocol", "trial", "hand", "object", "mass_kg", "controller", "seed", "unit")
OVER_TIME = ("over_time", "recording", "events", "physics", "settings")


def _summary(data: dict[str, Any], events: list[EventData], note: str) -> tuple[Block, ...]:
    """What was done, what came of it, and how it was computed."""
    facts = {
        name: value
        for name, value in data.items()
        if name not in (*HEAD, *OVER_TIME, "format", "version", "written_by", "command")
        and not isinstance(value, list)
        and value not in (None, "")
    }
    friction = {**data["physics"], "mu": data["physics"]["friction"]}
    return (
        PlotsHere(),
        Facts(rows=tuple((name, shown(data[name])) for name in HEAD if data[name] != "")),
        Heading(text="What came of it"),
        facts_of(facts),
        *events_block(events),
        *physics_blocks(friction, [("note", note)] if note else []),
        Folded(title="Numbers of the protocol", blocks=(facts_of(data["settings"]),)),
        *source_blocks(data["written_by"], data["command"]),
    )
