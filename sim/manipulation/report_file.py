"""``ManipulationReportFile``: a ``ManipulationReport`` as versioned JSON, and its reader."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from pydantic import create_model, model_validator

from planner.files.json_csv import checked_file
from planner.schema import StrictData
from sim.manipulation.log import ManipulationLog
from sim.manipulation.timeline import ManipulationPhase
from sim.recording import RecordingData
from sim.report_file import REPORT_VERSION, EventData, check_lengths, report_data, upgraded


class PhaseData(StrictData):
    """The end of a phase."""

    phase: ManipulationPhase
    about: str
    begin_s: float
    end_s: float
    passed: bool
    reason: str
    then: str
    numbers: dict[str, float | None]


class ForceData(StrictData):
    """Normal force of one finger on the object."""

    finger: str
    peak_N: float
    sustained_N: float
    mean_N: float
    time_s: float


def _channels() -> dict[str, Any]:
    """Types of all channels of a log, by their names in files."""
    types: dict[str, Any] = {}
    for one in fields(ManipulationLog):
        kind: Any = one.metadata["kind"]
        kind = float | None if kind is float else kind
        for _ in (*one.metadata["shape"], *[0] * one.metadata["per_finger"]):
            kind = list[kind]
        types[one.metadata["in_file"]] = (list[kind], ...)
    for name in ("contact_mode_planned", "contact_mode_measured"):
        types[name] = (list[list[str]], ...)
    return types


if TYPE_CHECKING:
    ManipulationSamples = StrictData
else:
    ManipulationSamples = create_model(
        "ManipulationSamples",
        __base__=StrictData,
        __doc__="Recorded over time, every 20 ms; lists per finger follow ``fingers``.",
        **_channels(),
    )


class ManipulationReportFile(StrictData):
    """A manipulation report as JSON; ``plan``, ``recording`` and ``command`` as in ``ReportFile``.

    The plan is that of its own file (``opposable export --schema manipulation``).
    """

    format: Literal["opposable-manipulation-report"] = "opposable-manipulation-report"
    version: Literal[3] = REPORT_VERSION
    written_by: str
    command: str = ""
    success: bool
    success_with_closure: bool
    complete: bool
    put_down_half_way: bool
    dropped: bool
    reason: str
    faults: str
    collision: str
    hand: str
    object: str
    mass_kg: float
    seed: int
    controller: str
    fingers: list[str]
    asked_deg: float
    asked_shift_mm: list[float]
    shifted_mm: list[float | None]
    made_backwards_because: str
    numbers: dict[str, float | None]
    phases: list[PhaseData]
    forces: list[ForceData]
    contact_modes: dict[str, dict[str, dict[str, int]]]
    quality_before: dict[str, Any] | None
    quality_after: dict[str, Any] | None
    criteria: dict[str, float | None]
    timeline: dict[str, float]
    physics: dict[str, float | str | list[float]]
    reality: dict[str, Any] | None
    events: list[EventData]
    pictures: dict[str, str]
    picture_reason: str
    samples: ManipulationSamples
    plan: dict[str, Any] | None
    recording: RecordingData | None
    earlier: ManipulationReportFile | None

    @model_validator(mode="after")
    def _one_length(self) -> ManipulationReportFile:
        check_lengths(self.samples, self.recording)
        return self


def read_manipulation_report(path: Path | str) -> ManipulationReportFile:
    """Read a report of a manipulation, from its JSON file or out of its page.

    Files of versions 1 and 2 are read too: they have no reality, those of version 1 neither plan
    nor recording.

    Raises:
        FileFormatError: Missing, damaged, of another format or another version.
    """
    return checked_file(ManipulationReportFile, _upgraded(report_data(path)), str(path))


def _upgraded(data: dict[str, Any]) -> dict[str, Any]:
    """Data of an older version as the newest: what it did not have is unknown, earlier runs too."""
    new, earlier = upgraded(data), data.get("earlier")
    if isinstance(earlier, dict):
        new = {**new, "earlier": _upgraded(earlier)}
    samples, fingers = data.get("samples"), data.get("fingers")
    if data.get("version") != 1 or not (isinstance(samples, dict) and isinstance(fingers, list)):
        return new
    m = len(samples.get("time_s", ()))
    unknown = {"friction_utilisation": [[None] * len(fingers)] * m, "epsilon": [None] * m}
    return {**new, "samples": {**samples, **unknown}}
