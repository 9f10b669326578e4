"""Pages of reports: the recorded motion in three dimensions, plots over time, and the summary."""

from __future__ import annotations

from sim.pages.trial_page import page_of_report, trial_page

__all__ = ["page_of_report", "trial_page"]
