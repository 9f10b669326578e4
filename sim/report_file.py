"""``ReportFile``: a trial report as versioned JSON; how report files are written and read.

A report is a JSON file, or a page (HTML) that holds the same JSON.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal, Self

from pydantic import Field, SerializerFunctionWrapHandler, model_serializer, model_validator

from planner.files.disk import checked_file, read_json, whole_file
from planner.pages.page import read_page_data
from planner.schema import StrictData
from sim.controllers.base import EventKind
from sim.recording import RecordingData, SampleData
from sim.verdict import Reason

__all__ = [
    "REPORT_VERSION",
    "ComparisonData",
    "EventData",
    "ExecutionFile",
    "PathRecord",
    "ReportFile",
    "UseRecord",
    "check_lengths",
    "read_report",
    "report_data",
    "upgraded",
    "write_report",
    "write_report_of",
]

REPORT_VERSION: Literal[4] = 4
"""Version of ``ReportFile``; another number means another schema. Version 1 had no states, versions
1 and 2 no error model, version 3 had it under ``reality``."""


class ComparisonData(StrictData):
    """Planned against measured contact of one finger, means over the hold, object frame."""

    finger: str
    planned_position_object_m: list[float | None]
    measured_position_object_m: list[float | None]
    position_error_mm: float | None
    planned_normal_force_N: float
    measured_normal_force_N: float | None
    force_error_N: float | None
    force_error_percent: float | None


class EventData(StrictData):
    """What a controller noticed and did."""

    time_s: float
    kind: EventKind
    finger: str
    detail: str


class PhaseData(StrictData):
    """The end of a phase."""

    phase: str
    about: str
    begin_s: float
    end_s: float
    passed: bool
    reason: str
    then: str
    numbers: dict[str, float | None]


class ExecutionFile(StrictData):
    """What the reports of all executions have as JSON.

    ``phases`` are those of a movement that were run; none of the trial of a grasp. ``plan`` is the
    plan as its file has it, null for a hand that no file can name. ``recording`` are the states,
    null where they were left out and in files of version 1. ``command`` is what the command line
    was told, "" of a script. ``error_model`` has the errors that the plan did not know, as given
    and as drawn; null where there were none.
    """

    format: str
    version: Literal[4] = REPORT_VERSION
    written_by: str
    command: str = ""
    success: bool
    reason: str
    hand: str
    object: str
    mass_kg: float
    seed: int
    fingers: list[str]
    timeline: dict[str, float]
    physics: dict[str, float | str | list[float]]
    error_model: dict[str, Any] | None
    controller: str = ""
    events: list[EventData] = Field(default_factory=list)
    phases: Sequence[PhaseData] = Field(default_factory=list)
    picture_reason: str
    samples: StrictData
    plan: dict[str, Any] | None
    recording: RecordingData | None

    @model_validator(mode="after")
    def _one_length(self) -> Self:
        check_lengths(self.samples, self.recording)
        return self


class UseRecord(StrictData):
    """What a tool did: its kind of use with its numbers, a sentence, and channels over time.

    ``yaw_rad`` is the turn of tool and fixture about the vertical; ``friction_factor`` is what the
    fixture's dry friction was multiplied by, unknown to the plan. ``titles`` say what the channels
    are; their names end with the unit.
    """

    tool: str
    kind: str
    summary: str
    yaw_rad: float
    friction_factor: float
    numbers: dict[str, float]
    needed_margin: float
    titles: dict[str, str]
    channels: dict[str, list[float | None]]

    @model_validator(mode="after")
    def _all_have_titles(self) -> Self:
        if self.titles.keys() != self.channels.keys():
            named = ", ".join(sorted(self.titles.keys() ^ self.channels.keys()))
            raise ValueError(f"titles and channels of the use differ: {named}")
        return self


class PathRecord(StrictData):
    """How far an object between two hands is from its planned path; null before the lift.

    ``tilted_deg`` is the part of ``turned_deg`` that is not about the vertical: what a tray is not
    to have.
    """

    off_mm: list[float | None]
    turned_deg: list[float | None]
    tilted_deg: list[float | None]

    @property
    def largest(self) -> tuple[float, float, float]:
        """Of distance (mm), rotation and tilt (degrees) the largest; NaN where none is known."""
        found = (self.off_mm, self.turned_deg, self.tilted_deg)
        off, turned, tilted = (
            max((v for v in c if v is not None), default=math.nan) for c in found
        )
        return off, turned, tilted

    def __str__(self) -> str:
        """In words; "" before the lift."""
        off, turned, tilted = self.largest
        if math.isnan(off):
            return ""
        return (
            f"the object stayed on its planned path to {off:.2f} mm and {turned:.2f} degrees, "
            f"level to {tilted:.2f} degrees"
        )


class ReportFile(ExecutionFile):
    """A trial report as JSON.

    ``other_grasp`` says which finger touched elsewhere where the object was held by another grasp
    than was planned, "" otherwise.
    """

    format: Literal["opposable-report"] = "opposable-report"
    reason: Reason
    detail: str
    reason_time_s: float | None
    other_grasp: str = ""
    largest_slip_mm: float | None
    largest_slip_deg: float | None
    comparison: list[ComparisonData]
    quality_planned: dict[str, Any]
    quality_measured: dict[str, Any] | None
    quality_mu: float | None = None
    thresholds: dict[str, float]
    least_creep_mm_s: float | None = None
    remedies: list[str] = Field(default_factory=list)
    simulated_s: float
    wall_s: float
    supported_until_lift: bool
    carried_by: Literal["gantry", "mount", "arm"] = "gantry"
    object_deviation_mm: float = 0.0
    picture: str | None
    tries: list[str] = Field(default_factory=list)
    samples: SampleData
    use: UseRecord | None = None
    path: PathRecord | None = None

    @model_validator(mode="after")
    def _further_of_one_length(self) -> Self:
        channels = {} if self.use is None else self.use.channels
        path = {} if self.path is None else self.path.model_dump()
        check_lengths(self.samples, None, channels | path)
        return self

    @model_serializer(mode="wrap")
    def _without_what_is_absent(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """All fields; reports of trials of one hand that use no tool stay as they were."""
        data: dict[str, Any] = handler(self)
        for name in ("use", "path", "phases"):
            if not getattr(self, name):
                del data[name]
        return data


def check_lengths(
    samples: StrictData,
    recording: RecordingData | None,
    further: Mapping[str, list[float | None]] = MappingProxyType({}),
) -> None:
    """Refuse channels of different lengths.

    Args:
        samples: Their channels.
        recording: Of the same times, if there is one.
        further: Channels of the same times.

    Raises:
        ValueError: There are such, as pydantic wants to be told.
    """
    channels: dict[str, list[Any]] = samples.model_dump()
    lengths = {len(values) for values in (*channels.values(), *further.values())}
    if recording is not None:
        lengths.add(len(recording.time_s))
    if len(lengths) > 1:
        raise ValueError(f"channels over time have different lengths, {sorted(lengths)}")


def read_report(path: Path | str) -> ReportFile:
    """Read a trial report, from its JSON file or out of its page.

    Files of versions 1 to 3 are read too: those of 1 and 2 have no error model, those of 1 neither
    plan nor recording.

    Raises:
        FileFormatError: Missing, damaged, of another format or another version.
    """
    return checked_file(ReportFile, upgraded(report_data(path)), str(path))


def report_data(path: Path | str) -> dict[str, Any]:
    """The plain data of a report of any kind, from its JSON file or out of its page.

    Raises:
        FileFormatError: Missing, damaged, or neither.
    """
    if Path(path).suffix.lower() in PAGE_SUFFIXES:
        return read_page_data(path)[1]
    return read_json(path, "report")


PAGE_SUFFIXES = (".html", ".htm")
"""How names of pages end."""


def upgraded(data: dict[str, Any]) -> dict[str, Any]:
    """Data of an older version as the newest: what it did not have is None."""
    missing: dict[int, dict[str, Any]] = {1: {"plan": None, "recording": None}, 2: {}, 3: {}}
    version = data.get("version")
    if not isinstance(version, int) or version not in missing:
        return data
    new = {**data, "version": REPORT_VERSION, **missing[version]}
    new["error_model"] = new.pop("reality", None) if version == 3 else None
    return new


def write_report(report: dict[str, Any], path: Path | str) -> None:
    """Write a report whole or not at all: a line per field, so that long channels stay short.

    Args:
        report: Plain data, as ``to_dict`` of a report gives it.
        path: The file.

    Raises:
        FileFormatError: The folder does not exist or cannot be written.
    """
    with whole_file(Path(path)) as stream:
        stream.write((compact_json(report) + "\n").encode())


def write_report_of(report: Any, path: Path | str) -> None:
    """Write a report of any kind with its plan and states; see ``write_report``."""
    write_report(report.to_dict(), path)


LONG_FIELDS = ("samples", "recording", "earlier")
"""Fields of a report that get a line per field of their own."""


def compact_json(data: dict[str, Any], indent: str = "") -> str:
    """An object as JSON with a line per field; ``LONG_FIELDS`` likewise."""
    inner = indent + " "
    lines = [
        f"{inner}{json.dumps(key)}: "
        + (
            compact_json(value, inner)
            if key in LONG_FIELDS and isinstance(value, dict)
            else json.dumps(value, allow_nan=False, separators=(", ", ": "))
        )
        for key, value in data.items()
    ]
    return "{\n" + ",\n".join(lines) + f"\n{indent}}}"
