"""What pages of reports say in words: numbers of the report as text, nothing computed anew."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from planner.files.data import PlanFile, TaskData
from planner.pages.blocks import Block, Command, Facts, Folded, Heading, Sentence, Table
from sim.report_file import EventData
from sim.screen import reality_lines

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


def reality_blocks(reality: Mapping[str, Any] | None) -> tuple[Block, ...]:
    """Which errors the trial had, and what was drawn of them; nothing where there were none."""
    lines = reality_lines(reality)
    return tuple(Sentence(text=f"{line[:1].upper()}{line[1:]}.") for line in lines)


def events_block(events: Sequence[EventData]) -> tuple[Block, ...]:
    """What the controller noticed, on demand; nothing if it noticed nothing."""
    if not events:
        return ()
    rows = tuple((shown(e.time_s), e.kind, e.finger, e.detail) for e in events)
    table = Table(columns=("time (s)", "what", "finger", "detail"), rows=rows)
    return (Folded(title="Events of the controller", blocks=(table,)),)


def source_blocks(written_by: str, command: str) -> tuple[Block, ...]:
    """Which version wrote it, and what makes it again."""
    again: Block = Command(text=command)
    if not command:
        again = Sentence(text="Made by a script; the page holds the plan that was executed.")
    return (Heading(text="Made by"), Facts(rows=(("version", written_by),)), again)
