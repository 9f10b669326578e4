"""``ManipulationReportFile``: a ``ManipulationReport`` as versioned JSON, and its reader."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from planner.files.disk import checked_file
from planner.schema import StrictData
from sim.manipulation.log import ManipulationLog
from sim.manipulation.timeline import ManipulationPhase
from sim.report_file import EventData, ExecutionFile, PhaseData, report_data, upgraded


class ManipulationPhaseData(PhaseData):
    """The end of a phase of a manipulation."""

    phase: ManipulationPhase


class ForceData(StrictData):
    """Normal force of one finger on the object."""

    finger: str
    peak_N: float
    sustained_N: float
    mean_N: float
    time_s: float


if TYPE_CHECKING:
    ManipulationSamples = StrictData
else:
    ManipulationSamples = ManipulationLog.data_model(
        "ManipulationSamples",
        "Recorded over time, every 20 ms; lists per finger follow ``fingers``.",
        contact_mode_planned=list[list[str]],
        contact_mode_measured=list[list[str]],
    )


class ManipulationReportFile(ExecutionFile):
    """A manipulation report as JSON.

    The plan is that of its own file (``opposable export --schema movement``).
    """

    format: Literal["opposable-manipulation-report"] = "opposable-manipulation-report"
    success_with_closure: bool
    complete: bool
    put_down_half_way: bool
    dropped: bool
    faults: str
    collision: str
    controller: str
    events: list[EventData]
    asked_deg: float
    asked_shift_mm: list[float]
    shifted_mm: list[float | None]
    made_backwards_because: str
    numbers: dict[str, float | None]
    phases: Sequence[ManipulationPhaseData]
    forces: list[ForceData]
    contact_modes: dict[str, dict[str, dict[str, int]]]
    quality_before: dict[str, Any] | None
    quality_after: dict[str, Any] | None
    criteria: dict[str, float | None]
    pictures: dict[str, str]
    samples: ManipulationSamples
    earlier: ManipulationReportFile | None


def read_manipulation_report(path: Path | str) -> ManipulationReportFile:
    """Read a report of a manipulation, from its JSON file or out of its page.

    Files of versions 1 to 3 are read too: those of 1 and 2 have no error model, those of 1 neither
    plan nor recording.

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
