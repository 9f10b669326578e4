"""What pages of reports have in common: words and numbers, plots, the task, the moving stage.

Numbers of the report are shown as text; nothing is computed anew.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from typing import Any

import numpy as np

from planner.errors import FileFormatError
from planner.files.data import PlanFile, TaskData, task_from_data
from planner.files.disk import checked_file
from planner.hand_loading import load_hand
from planner.hands.hand import Hand
from planner.pages.blocks import Block, Command, Facts, Folded, Heading, Sentence, Table
from planner.pages.plan_scene import Stage
from planner.pages.scene import Band, Contacts, Line, Mark, Motion, Plot, Scene
from planner.spatial import FloatArray
from planner.task import GraspTask, Obstacle
from sim.controllers.base import COMMANDED
from sim.recording import Recording
from sim.report_file import EventData, PhaseData
from sim.screen import error_lines

DIGITS = 3
"""Significant digits of a number."""


def shown(value: Any, unit: str = "") -> str:
    """A value of the report with its unit, or several; "unknown" where there is none."""
    if value is None:
        return "unknown"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, Mapping):
        return ", ".join(f"{in_words(name)} {shown(one)}" for name, one in value.items())
    if isinstance(value, str):
        return value
    if isinstance(value, Sequence):
        return " ".join([", ".join(shown(v) for v in value), unit]).rstrip()
    text = str(value) if isinstance(value, int) else f"{value:.{DIGITS}g}"
    return f"{text} {unit}".rstrip()


UNITS = {
    "mm_s": "mm/s",
    "rad_s": "rad/s",
    "deg": "degrees",
    "mm": "mm",
    "kg": "kg",
    "N": "N",
    "m": "m",
    "s": "s",
}
"""Ending of a name in files -> the unit that it says; the longer endings first."""


def in_words(name: str) -> str:
    """A name in files as people read it: ``time_to_angle_s`` is "time to angle (s)"."""
    for ending, unit in UNITS.items():
        if name.endswith(f"_{ending}"):
            return f"{name.removesuffix(f'_{ending}').replace('_', ' ')} ({unit})"
    return name.replace("_", " ")


def facts_of(values: Mapping[str, Any]) -> Facts:
    """All of a table of the report."""
    return Facts(rows=tuple((in_words(name), shown(value)) for name, value in values.items()))


def task_rows(task: TaskData) -> tuple[tuple[str, str], ...]:
    """What was asked, as far as the plan tells it."""
    table = "none" if task.table_height_m is None else f"at {shown(task.table_height_m, 'm')}"
    rows = [
        ("fingers", ", ".join(task.fingers)),
        ("friction relied on", f"mu {shown(task.mu)}, torsion {shown(task.mu_torsion_m, 'm')}"),
        ("contact model", task.contact_model),
        ("grip", shown(task.grip_force_N, "N")),
        ("table", table),
    ]
    if task.joint_error_rad:
        rows.append(("joints may be off by", shown(task.joint_error_rad, "rad")))
    if task.obstacles:
        rows.append(("obstacles", ", ".join(o.name for o in task.obstacles)))
    return tuple(rows)


def grasp_rows(plan: PlanFile) -> tuple[tuple[str, str], ...]:
    """Where a grasp comes from."""
    record = plan.record
    return (
        ("seed", shown(record.seed)),
        ("attempts", shown(record.attempts)),
        ("planned in", shown(record.cpu_s, "s of CPU")),
        ("objective", record.objective),
    )


def plan_blocks(plan: PlanFile, origin: Sequence[tuple[str, str]]) -> tuple[Block, ...]:
    """Where a plan comes from, and how good its grasp is.

    Args:
        plan: The grasp, or that with which a manipulation begins.
        origin: Seed, attempts and so on.
    """
    quality = plan.quality
    weight = shown(quality["closure"]["normalised_min_weight"])
    rows = (*origin, ("min-weight, normalised", weight), *quality_rows(quality))
    contacts = Table(
        columns=("finger", "x (m)", "y (m)", "z (m)", "normal force (N)"),
        rows=tuple(
            (c.finger, *(shown(v) for v in c.position_world_m), shown(c.force_normal_N))
            for c in plan.contacts
        ),
        fingers=True,
    )
    return (Facts(rows=rows), Folded(title="Planned contacts, world", blocks=(contacts,)))


def quality_rows(quality: Mapping[str, Any]) -> tuple[tuple[str, str], ...]:
    """Epsilon of a quality report."""
    lower, upper = quality["epsilon_round"]
    return (("epsilon of the true cones", f"{shown(lower)} to {shown(upper)}"),)


def physics_blocks(
    physics: Mapping[str, Any], rows: Sequence[tuple[str, str]]
) -> tuple[Block, ...]:
    """The physics by its name, what else there is to say, and all of its numbers on demand."""
    first = (("physics", shown(physics["name"])), ("friction, mu", shown(physics["mu"])))
    every = Folded(title="All numbers of the physics", blocks=(facts_of(physics),))
    return (Heading(text="Simulation"), Facts(rows=(*first, *rows)), every)


def error_blocks(error_model: Mapping[str, Any] | None) -> tuple[Block, ...]:
    """Which errors the trial had, and what was drawn of them; nothing where there were none."""
    lines = error_lines(error_model)
    return tuple(Sentence(text=f"{line[:1].upper()}{line[1:]}.") for line in lines)


def events_block(events: Sequence[EventData]) -> tuple[Block, ...]:
    """What the controller noticed, on demand; nothing if it noticed nothing."""
    if not events:
        return ()
    rows = tuple((shown(e.time_s), e.kind, e.finger, e.detail) for e in events)
    table = Table(columns=("time (s)", "what", "finger", "detail"), rows=rows)
    return (Folded(title="Events of the controller", blocks=(table,)),)


def phase_blocks(phases: Sequence[PhaseData], title: str = "Phases") -> tuple[Block, ...]:
    """The phases that were run, on demand; nothing where none are told."""
    if not phases:
        return ()
    rows = []
    for p in phases:
        told = ", ".join(f"{in_words(name)} {shown(value)}" for name, value in p.numbers.items())
        outcome = "passed" if p.passed else "; ".join(filter(None, (p.reason, p.then)))
        rows.append((f"{p.phase} {p.about}".strip(), shown(p.end_s), outcome, told))
    table = Table(columns=("phase", "ended at (s)", "outcome", "numbers"), rows=tuple(rows))
    return (Folded(title=title, blocks=(table,)),)


def source_blocks(written_by: str, command: str) -> tuple[Block, ...]:
    """Which version wrote it, and what makes it again."""
    again: Block = Command(text=command)
    if not command:
        again = Sentence(text="Made by a script; the page holds the plan that was executed.")
    return (Heading(text="Made by"), Facts(rows=(("version", written_by),)), again)


def column(values: Sequence[float | None]) -> FloatArray:
    """Numbers of a file (m,), NaN for null."""
    return np.array(values, dtype=np.float64)


def per_finger(rows: Sequence[Sequence[float | None]], fingers: Sequence[str]) -> FloatArray:
    """Numbers of a file (m, n) with a column per finger, NaN for null."""
    return np.array(rows, dtype=np.float64).reshape(-1, len(fingers))


def force_plot(fingers: Sequence[str], measured: FloatArray, planned: FloatArray) -> Plot:
    """Normal forces.

    Args:
        fingers: n names.
        measured: (m, n), N.
        planned: (1, n) or (m, n), N; (0, n) for none.
    """
    lines = []
    for i, name in enumerate(fingers):
        lines.append(Line(name=name, values=measured[:, i], group=name))
        if len(planned):
            lines.append(
                Line(name=f"{name}, planned", values=planned[:, i], dashed=True, group=name)
            )
    return Plot(title="Normal force on the object", unit="N", lines=tuple(lines))


def cone_plot(fingers: Sequence[str], used: FloatArray) -> Plot:
    """Share (m, n) of the friction cone that tangential force and torsion use; 1 is its edge."""
    lines = [Line(name=name, values=used[:, i], group=name) for i, name in enumerate(fingers)]
    edge = Line(name="edge of the cone", values=np.ones(1), dashed=True)
    return Plot(title="Tangential use of the friction cone", unit="", lines=(*lines, edge))


def quality_plot(epsilon: FloatArray, min_weight: FloatArray | None) -> Plot:
    """Epsilon and normalised min-weight (m,) of the measured contacts; 0 is no closure.

    A negative min-weight is drawn as 0: without closure it has no lower bound, and its size says
    nothing.
    """
    lines = [Line(name="epsilon (L1)", values=epsilon)]
    if min_weight is not None:
        name = "min-weight, normalised, 0 if negative"
        lines.append(Line(name=name, values=np.maximum(min_weight, 0.0)))
    return Plot(title="Force closure of the measured contacts", unit="", lines=tuple(lines))


def command_plot(recording: Recording, hand: Hand | None) -> Plot | None:
    """Commands as shares of the actuators' ranges; None where no actuator has a range."""
    low, high = recording.control_range.T
    limited = np.flatnonzero(np.isfinite(low) & np.isfinite(high) & (high > low))
    if not len(limited):
        return None
    low, high = low[limited], high[limited]
    share = (recording.commands[:, limited] - low) / (high - low)
    lines = [
        Line(name=recording.actuator_names[k], values=values, group=_finger_of(hand, int(k)))
        for k, values in zip(limited, share.T, strict=True)
    ]
    limits = [
        Line(name=name, values=np.array([value]), dashed=True)
        for name, value in (("lower limit", 0.0), ("upper limit", 1.0))
    ]
    return Plot(title="Commands within their limits", unit="", lines=(*lines, *limits))


def _finger_of(hand: Hand | None, actuator: int) -> str:
    """The finger that an actuator moves, "" for none or several."""
    if hand is None:
        return ""
    moved = np.flatnonzero(hand.actuation.moment[actuator])
    names = [f.name for f in hand.fingers.values() if np.isin(moved, f.q_index).all()]
    return names[0] if len(names) == 1 else ""


def phase_bands(time: Sequence[float], phase: Sequence[str]) -> tuple[Band, ...]:
    """Phases as spans of time: each begins where the one before ended."""
    bands: list[Band] = []
    begin, at = 0.0, 0
    for name, samples in groupby(phase):
        at += len(list(samples))
        bands.append(Band(name=name, begin=begin, end=time[at - 1]))
        begin = time[at - 1]
    return tuple(bands)


def event_marks(events: Sequence[EventData], shift: float = 0.0) -> tuple[Mark, ...]:
    """What a controller noticed, on an axis on which its time begins at ``shift``, s.

    What it was told to do is left out: phases show it.
    """
    return tuple(
        Mark(
            time=e.time_s + shift,
            text=f"{e.kind} {e.finger}".rstrip() + (f": {e.detail}" if e.detail else ""),
        )
        for e in events
        if e.kind not in COMMANDED
    )


def plan_file(plan: dict[str, Any]) -> PlanFile:
    """A plan that a report holds, with its format checked but not its claims.

    Raises:
        FileFormatError: Damaged, or of another version.
    """
    return checked_file(PlanFile, plan, "the report's plan")


def task_of_plan(file: PlanFile, source: str = "the report's plan") -> GraspTask:
    """The task of a plan, with its hand loaded.

    Raises:
        FileFormatError: The hand's files have changed since.
        PlannerError: The hand or the object cannot be loaded.
    """
    given = file.task.hand
    hand = load_hand(given.description_path or given.name, download=False)
    hand = hand.rolling if given.rolling else hand
    if hand.digest != given.sha256:
        raise FileFormatError(
            f"{source} is of another {given.name!r} than {hand.reference or hand.name}: the hand's "
            "files have changed since, so that the motion cannot be shown; run it again"
        )
    return task_from_data(file.task, hand)


NO_STATES = (
    "This report has no recorded states (it is of an older version, or they were left out), so "
    "there is no motion to show; run it again for a page with the motion."
)
"""What a page without states says."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Moving:
    """What stands in a scene and how it moves.

    Attributes:
        scene: Models, actors, motions and the camera; without plots, contacts and phases.
        note: What the picture leaves out, "" for nothing.
    """

    scene: Scene
    note: str


def moving_stage(
    task: GraspTask, recording: Recording, obstacles: Sequence[Obstacle] | None = None
) -> Moving:
    """The stage of a recording, the camera placed for the moment at which most fingers touch.

    The camera goes along with the hand, with the object where the hand is on an arm.

    Args:
        task: Whose hand, object, table and obstacles are shown.
        recording: The motion; of at least one sample.
        obstacles: What stands about instead of the task's obstacles, if something else does.

    Raises:
        FileFormatError: The recording is of another hand.
    """
    hand = task.hand
    if recording.joint_names != hand.joint_names:
        raise FileFormatError(
            f"the recorded joints are not those of {hand.name}; the report is damaged"
        )
    if obstacles is not None:
        task = replace(task, obstacles=tuple(obstacles))
    grip = int(np.isfinite(recording.points[:, :, 0]).sum(axis=1).argmax())
    base, item = recording.poses(grip)
    stage = Stage(task, base, recording.q[grip], item)
    followed = "object" if hand.on_arm else "hand"
    way = recording.T_world_object if hand.on_arm else recording.T_world_base
    scene = Scene(
        models=stage.models,
        actors=tuple(stage.actors),
        focus=stage.focus - (way[grip, :3] - way[0, :3]),
        radius=stage.radius,
        time=recording.time,
        motions=(
            Motion(actor="hand", pose=recording.T_world_base, q=recording.q),
            Motion(actor="object", pose=recording.T_world_object, q=np.zeros((len(recording), 0))),
        ),
        views=stage.views(recording.contacts(grip)),
        follow=followed,
    )
    return Moving(scene=scene, note=stage.shown.note)


def bare_scene(time: FloatArray) -> Scene:
    """A scene of plots only, for a report without states."""
    return Scene(models={}, actors=(), focus=np.zeros(3), radius=0.1, time=time)


def measured_contacts(recording: Recording) -> Contacts:
    """The recorded contacts, with cones of the sliding friction that most of them have."""
    friction = recording.friction[..., 0]
    known = friction[np.isfinite(friction)]
    return Contacts(
        name="measured",
        layer="measured contacts",
        fingers=recording.contact_names,
        points=recording.points,
        normals=recording.normals,
        forces=recording.forces,
        mu=float(np.median(known)) if len(known) else 0.0,
    )
