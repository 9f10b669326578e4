"""``trial_page``: a trial as a page: what happened, why, and the motion.

``pressure_blocks`` shows what taxels felt, as a picture per finger, from the ``error_model`` of a
report; trials without taxels have nothing to show.
"""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Mapping, Sequence
from dataclasses import replace
from html import escape
from typing import Any

import numpy as np

from planner.files.data import ContactData, PlanFile
from planner.pages.blocks import (
    Block,
    Facts,
    Folded,
    Heading,
    Image,
    PlotsHere,
    Sentence,
    Table,
    Verdict,
)
from planner.pages.page import Page, without_folder
from planner.pages.scene import Contacts, Line, Mark, Plot, Scene
from planner.spatial import FloatArray
from planner.task import GraspTask
from sim.recording import Recording
from sim.report_file import PathRecord, ReportFile, UseRecord
from sim.show.parts import (
    NO_STATES,
    Moving,
    bare_scene,
    column,
    command_plot,
    cone_plot,
    error_blocks,
    event_marks,
    events_block,
    facts_of,
    force_plot,
    grasp_rows,
    measured_contacts,
    moving_stage,
    per_finger,
    phase_bands,
    phase_blocks,
    physics_blocks,
    plan_blocks,
    plan_file,
    quality_plot,
    quality_rows,
    shown,
    source_blocks,
    task_of_plan,
    task_rows,
)

CELL, MARGIN, GAP, TEXT = 10, 4, 14, 16
"""Side of a taxel, margin, distance of arrays and height of a line of text, pixels."""

DARK = np.array([13.0, 59.0, 102.0])
"""Colour of the most loaded taxel; one without load is white."""

USE_UNITS = {"deg": "degrees", "Nm": "N m", "mps": "m/s"}
"""Ends of the names of a use's channels -> their units, where these are others."""

LEAST_ARROW = 0.02
"""Shear (N) of a taxel from which on an arrow shows it."""


def pressure_blocks(error_model: Mapping[str, Any] | None) -> list[Block]:
    """Heading and picture of what taxels felt; nothing where there were none."""
    felt = None if error_model is None else error_model.get("felt")
    if not felt:
        return []
    source = b64encode(pressure_svg(felt).encode()).decode()
    text = (
        f"Force on each taxel at {felt['time_s']:.2f} s, the last moment at which most pads "
        "touched: normal force by shade, shear by arrows; rows run along the bone, its tip above"
    )
    return [
        Heading(text="Pressure on the pads"),
        Image(source=f"data:image/svg+xml;base64,{source}", text=text),
        Sentence(text="Sums of the taxels; the darkest taxel is the most loaded of its pad."),
    ]


def pressure_svg(felt: Mapping[str, Any]) -> str:
    """The arrays side by side as SVG.

    Args:
        felt: "pads", a list with "finger" and "image_N", (rows, columns, 3).
    """
    x, parts, height = MARGIN, [], 0
    for pad in felt["pads"]:
        image = np.array(pad["image_N"], dtype=np.float64)
        rows, columns = image.shape[:2]
        parts.append(f'<g transform="translate({x},{MARGIN + TEXT})">{_array(image)}</g>')
        label = f"{pad['finger']}: {image[..., 0].sum():.2f} N"
        parts.append(f'<text x="{x}" y="{MARGIN + TEXT - 5}">{escape(label)}</text>')
        x += max(columns * CELL, 11 * CELL) + GAP
        height = max(height, rows * CELL)
    width, tall = x - GAP + MARGIN, height + TEXT + 2 * MARGIN
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {tall}" width="{width}" '
        f'height="{tall}" font-family="sans-serif" font-size="11">'
        f'<rect width="{width}" height="{tall}" fill="white"/>{"".join(parts)}</svg>'
    )


def _array(image: Any) -> str:
    rows, columns = image.shape[:2]
    most = max(float(image[..., 0].max()), 1e-9)
    longest = max(float(np.hypot(image[..., 1], image[..., 2]).max()), 1e-9)
    cells, arrows = [], []
    for row in range(rows):
        y = (rows - 1 - row) * CELL
        for place in range(columns):
            normal, across, along = image[row, place].tolist()
            share = float(np.clip(normal / most, 0.0, 1.0)) ** 0.5
            red, green, blue = (255.0 + share * (DARK - 255.0)).round().astype(int).tolist()
            cells.append(
                f'<rect x="{place * CELL}" y="{y}" width="{CELL - 1}" height="{CELL - 1}" '
                f'fill="rgb({red},{green},{blue})" stroke="#c9d2da" stroke-width="0.5"/>'
            )
            if float(np.hypot(across, along)) >= LEAST_ARROW:
                scale = 1.8 * CELL / longest
                x0, y0 = (place + 0.45) * CELL, y + 0.45 * CELL
                x1, y1 = x0 + scale * across, y0 - scale * along
                arrows.append(
                    f'<path d="M{x0:.1f} {y0:.1f}L{x1:.1f} {y1:.1f}" stroke="#d55e00" '
                    f'stroke-width="1.3"/><circle cx="{x0:.1f}" cy="{y0:.1f}" r="1.3" '
                    'fill="#d55e00"/>'
                )
    return "".join([*cells, *arrows])


def trial_page(report: ReportFile, task: GraspTask | None = None) -> Page:
    """The page of a trial, from its report alone.

    Args:
        report: As read from a file, or ``TrialReport.to_file()``.
        task: Hand and object to draw, where they are at hand; those of the report's plan if None.

    Raises:
        PlannerError: The report's hand or object cannot be loaded, or have changed since.
    """
    plan = None if report.plan is None else plan_file(report.plan)
    recording = None if report.recording is None else Recording.from_data(report.recording)
    stage = None
    if recording is not None and len(recording):
        if task is None and plan is not None:
            task = task_of_plan(plan)
        stage = None if task is None else moving_stage(task, recording)
    return Page(
        title=f"{report.hand} {_does(report)} {without_folder(report.object)}",
        subtitle=f"Trial, seed {report.seed}, {shown(report.mass_kg, 'kg')}, {report.controller}",
        verdict=_verdict(report),
        summary=_summary(report, plan, stage),
        scene=_scene(report, plan, recording, stage, task),
        data=report.model_dump(mode="json"),
        kind="report",
    )


def page_of_report(report: Any) -> Page:
    """The page of a ``sim.report.TrialReport``; see ``trial_page``."""
    return trial_page(report.to_file(), report.plan.task)


def _does(report: ReportFile) -> str:
    """What the hand does with the object, by the phases that were run."""
    if report.use is not None:
        return "uses"
    return "hands over" if any(p.phase == "reach" for p in report.phases) else "grasps"


def _verdict(report: ReportFile) -> Verdict:
    if not report.success:
        text = f"Not {'held' if report.use is None else 'done'}: {report.reason}"
        return Verdict(good=False, text=text, reason=report.detail, time=report.reason_time_s)
    reason = (
        f"The object moved {shown(report.largest_slip_mm, 'mm')} and "
        f"{shown(report.largest_slip_deg, 'degrees')} in the hand after the squeeze."
    )
    if report.other_grasp:
        reason = f"Not the planned grasp: {report.other_grasp}. {reason}"
        return Verdict(good=False, text="Held, by another grasp", reason=reason)
    return Verdict(good=True, text="Held" if report.use is None else "Done", reason=reason)


# ---- the scene


def _scene(
    report: ReportFile,
    plan: PlanFile | None,
    recording: Recording | None,
    stage: Moving | None,
    task: GraspTask | None,
) -> Scene | None:
    samples = report.samples.model_dump()
    time, phase = samples["time_s"], samples["phase"]
    if not time:
        return None
    contacts = []
    if stage is not None and recording is not None:
        contacts.append(measured_contacts(recording))
    if stage is not None and plan is not None:
        contacts.append(planned_in_object(plan))
    marks = event_marks(report.events)
    if report.reason_time_s is not None:
        text = f"{report.reason}: {report.detail}"
        marks = (*marks, Mark(time=report.reason_time_s, text=text, kind="fault"))
    return replace(
        bare_scene(column(time)) if stage is None else stage.scene,
        time=column(time),
        contacts=tuple(contacts),
        plots=_plots(report, plan, recording, task),
        bands=phase_bands(time, phase),
        marks=marks,
        start=_start(report, time, phase),
    )


def _start(report: ReportFile, time: Sequence[float], phase: Sequence[str]) -> float:
    """Where the page opens: where it went wrong, or at the beginning of the hold."""
    if report.reason_time_s is not None:
        return float(np.clip(report.reason_time_s, time[0], time[-1]))
    return time[phase.index("hold")] if "hold" in phase else time[0]


def _plots(
    report: ReportFile,
    plan: PlanFile | None,
    recording: Recording | None,
    task: GraspTask | None,
) -> tuple[Plot, ...]:
    samples, fingers, limits = report.samples.model_dump(), report.fingers, report.thresholds
    planned = np.zeros((0, len(fingers)))
    if plan is not None:
        planned = np.array([[c.force_normal_N for c in plan.contacts]])
    plots = [
        force_plot(fingers, per_finger(samples["normal_force_N"], fingers), planned),
        cone_plot(fingers, per_finger(samples["friction_utilisation"], fingers)),
        quality_plot(
            column(samples["epsilon"]), None if recording is None else recording.min_weight
        ),
        _slip_plot("moved", "mm", samples["object_in_palm_moved_mm"], limits["slip_mm"]),
        _slip_plot("turned", "degrees", samples["object_in_palm_turned_deg"], limits["slip_deg"]),
    ]
    if report.path is not None:
        plots = [*_path_plots(report.path), *plots]
    if report.use is not None:
        plots = [*_use_plots(report.use), *plots]
    commands = None
    if recording is not None:
        commands = command_plot(recording, None if task is None else task.hand)
    return tuple(plots if commands is None else [*plots, commands])


def _use_plots(use: UseRecord) -> list[Plot]:
    """What was measured of the use of a tool."""
    return [
        Plot(
            title=use.titles[name],
            unit=USE_UNITS.get(name.rpartition("_")[2], name.rpartition("_")[2]),
            lines=(Line(name=use.tool, values=column(values)),),
        )
        for name, values in use.channels.items()
    ]


def _path_plots(path: PathRecord) -> list[Plot]:
    """How well two hands keep the object on its planned path."""
    turns = (("turned", path.turned_deg), ("tilted", path.tilted_deg))
    return [
        Plot(
            title="Object off its planned path",
            unit="mm",
            lines=(Line(name="distance", values=column(path.off_mm)),),
        ),
        Plot(
            title="Object turned off its planned path",
            unit="degrees",
            lines=tuple(Line(name=name, values=column(values)) for name, values in turns),
        ),
    ]


def _slip_plot(what: str, unit: str, values: Sequence[float | None], limit: float) -> Plot:
    lines = (
        Line(name=what, values=column(values)),
        Line(name="success ends here", values=np.array([limit]), dashed=True),
    )
    return Plot(title=f"Object {what} in the palm since the squeeze", unit=unit, lines=lines)


def planned_in_object(plan: PlanFile) -> Contacts:
    """The planned contacts, which move with the object."""
    T_object_world = plan.task.T_world_object.pose().inverse()
    turn = T_object_world.rotation
    points = np.array([c.position_world_m for c in plan.contacts]) @ turn.T
    normals = np.array([c.normal_into_object_world for c in plan.contacts]) @ turn.T
    forces = np.array([force_of(c) for c in plan.contacts]) @ turn.T
    return Contacts(
        name="planned",
        layer="planned contacts",
        fingers=tuple(c.finger for c in plan.contacts),
        points=(points + T_object_world.translation)[None],
        normals=normals[None],
        forces=forces[None],
        mu=plan.task.mu,
        actor="object",
    )


def force_of(contact: ContactData) -> FloatArray:
    """Force of a planned contact on the object (3,), N, world."""
    axes = np.array(
        [contact.normal_into_object_world, contact.tangent1_world, contact.tangent2_world]
    )
    parts = [contact.force_normal_N, contact.force_tangent1_N, contact.force_tangent2_N]
    return np.asarray(np.array(parts) @ axes)


# ---- the words


def _summary(report: ReportFile, plan: PlanFile | None, stage: Moving | None) -> tuple[Block, ...]:
    blocks: list[Block] = []
    if report.use is not None:
        blocks.append(Sentence(text=f"Use: {report.use.summary}."))
    if report.path is not None and (said := str(report.path)):
        blocks.append(Sentence(text=f"{said[0].upper()}{said[1:]}."))
    if report.recording is None:
        blocks.append(Sentence(text=NO_STATES, kind="warning"))
    elif stage is None and report.recording.time_s:
        text = "This report names no hand that can be loaded, so that only its numbers are shown."
        blocks.append(Sentence(text=text, kind="warning"))
    elif stage is not None and stage.note:
        blocks.append(Sentence(text=stage.note, kind="warning"))
    if report.remedies:
        blocks.append(Sentence(text="Each of these keeps the object from creeping:"))
        blocks += [Sentence(text=remedy) for remedy in report.remedies]
    blocks += [*error_blocks(report.error_model), PlotsHere()]
    blocks += phase_blocks(report.phases)
    blocks += [*pressure_blocks(report.error_model), *_comparison(report)]
    blocks += events_block(report.events)
    rows = [("hand", report.hand), ("object", report.object), ("mass", shown(report.mass_kg, "kg"))]
    blocks += [Heading(text="Task")]
    blocks += [Facts(rows=(*rows, *(() if plan is None else task_rows(plan.task))))]
    if plan is not None:
        blocks += [Heading(text="Plan"), *plan_blocks(plan, grasp_rows(plan))]
    blocks += physics_blocks(
        report.physics,
        (
            ("controller", report.controller),
            ("carried by", report.carried_by),
            ("friction gives way by", shown(report.least_creep_mm_s, "mm/s before noslip")),
            ("simulated", shown(report.simulated_s, "s")),
            ("took", shown(report.wall_s, "s")),
        ),
    )
    blocks += [
        Folded(title="Where success ends", blocks=(facts_of(report.thresholds),)),
        Folded(title="Durations (s) and heights (m)", blocks=(facts_of(report.timeline),)),
        *source_blocks(report.written_by, report.command),
    ]
    return tuple(blocks)


def _comparison(report: ReportFile) -> list[Block]:
    """Planned against measured contacts while holding."""
    if not report.comparison:
        return []
    rows = tuple(
        (
            c.finger,
            shown(c.position_error_mm),
            shown(c.planned_normal_force_N),
            shown(c.measured_normal_force_N),
            shown(c.force_error_percent),
        )
        for c in report.comparison
    )
    columns = ("finger", "off by (mm)", "planned (N)", "measured (N)", "error (%)")
    blocks: list[Block] = [
        Heading(text="Planned and measured contacts while holding"),
        Table(columns=columns, rows=rows, fingers=True),
    ]
    both = (("planned", report.quality_planned), ("measured", report.quality_measured))
    if report.quality_measured is not None:
        facts = [
            (f"{name}, {when}", value)
            for when, quality in both
            if quality is not None
            for name, value in quality_rows(quality)
        ]
        note = f"Both with the plan's friction, mu {shown(report.quality_mu)}."
        blocks += [Facts(rows=tuple(facts)), Sentence(text=note)]
    return blocks
