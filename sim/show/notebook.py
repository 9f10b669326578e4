"""What a notebook shows of reports: a table, and a picture of the moment that decided.

``planner.showing.in_notebook`` calls these; see ``planner.pages.notebook``.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from planner.pages.notebook import grasp_picture, notebook_html

__all__ = ["manipulation_html", "trial_html"]


def trial_html(report: Any) -> str:
    """A ``sim.report.TrialReport``: verdict, planned and measured contacts; the end of the hold."""
    moved, turned = report.largest_slip
    verdict = (
        f"{report.verdict.other_grasp or 'held'}: the object moved {moved:.2f} mm and "
        f"{turned:.2f} degrees in the hand"
        if report.success
        else f"not held, {report.reason}: {report.verdict.detail}"
    )
    rows = [
        (
            c.finger,
            _number(c.position_error_mm, 2),
            f"{c.planned_normal_force:.2f}",
            f"{c.measured_normal_force:.2f}",
        )
        for c in report.comparison
    ]
    return notebook_html(
        f"{report.hand}, {report.object}: {report.verdict.outcome}",
        ("finger", "contact off by (mm)", "planned (N)", "measured (N)"),
        rows,
        notes=(
            verdict,
            f"{1e3 * report.mass_kg:.0f} g, seed {report.seed}, control {report.controller}, "
            f"physics {report.physics['name']}, {report.simulated_s:.1f} s simulated",
        ),
        picture=_picture(report),
    )


def manipulation_html(report: Any) -> str:
    """A ``sim.manipulation.ManipulationReport``: phases and the turn; how it ended."""
    rows = [
        (r.phase, "passed" if r.passed else "failed", "" if r.passed else r.reason)
        for r in report.results
    ]
    asked, turned = np.rad2deg(report.asked), np.rad2deg(report.turned)
    return notebook_html(
        f"{report.hand}, {report.object}: {'complete' if report.complete else 'failed'}",
        ("phase", "outcome", "reason"),
        rows,
        notes=(
            f"turned {_number(float(turned), 2)} of {asked:.1f} degrees",
            report.reason
            or f"success {'with' if report.success_with_closure else 'without'} closure",
        ),
        picture=_picture(report),
    )


def _picture(report: Any) -> bytes | None:
    """The recorded state that matters; None where nothing was recorded."""
    recording = report.recording
    if not len(recording):
        return None
    held = [i for i, phase in enumerate(recording.phase) if phase == "hold"]
    i = held[-1] if held else len(recording) - 1
    base, item = recording.poses(i)
    return grasp_picture(report.plan.task, base, recording.q[i], item, recording.contacts(i))


def _number(value: float, digits: int) -> str:
    return "-" if np.isnan(value) else f"{value:.{digits}f}"
