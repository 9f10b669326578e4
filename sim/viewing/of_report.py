"""A report of a trial or a manipulation, JSON or page, and the folder of a run that holds one."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from planner.pages.page import Page
from sim.manipulation import read_manipulation_report
from sim.manipulation.page import manipulation_page
from sim.pages import trial_page
from sim.report_file import read_report
from sim.viewing.kinds import Kind, ViewOptions
from sim.viewing.target import Target

PAGES: dict[str, Callable[[Path], Page]] = {
    "opposable-report": lambda path: trial_page(read_report(path)),
    "opposable-manipulation-report": lambda path: manipulation_page(read_manipulation_report(path)),
}
"""Format of a report -> what makes its page."""

REPORTS = ("report.json", "report.html")
"""Names of a report in the folder of a run."""


def _report(target: Target) -> Target:
    """The report of a folder; the target itself if it is a file."""
    names = (name for name in REPORTS if target.holds(name))
    name = next(names, None)
    return target if name is None else Target(f"{target.path}/{name}")


def _shown(target: Target, options: ViewOptions) -> Page:
    report = _report(target)
    assert report.path is not None
    return PAGES[report.format](report.path)


KIND = Kind(
    name="a report of a trial or manipulation (JSON, HTML, or the folder of the run)",
    recognises=lambda target: _report(target).format in PAGES,
    shown=_shown,
)
"""See ``sim.viewing.kinds``."""
