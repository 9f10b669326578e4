"""``class_of_turn``: why a turn is no strict success, in one of few words, to be counted."""

from __future__ import annotations

import re

from sim.manipulation import ManipulationReport

CLASSES = (
    (r"the object was dropped", "dropped"),
    (r"diverged|not finite", "diverged"),
    (r"fingers touch, \d+ are needed|nothing touches", "no contact"),
    (r"^turn.*: turned .* of .* degrees", "stalled"),
    (r"^hold.*: turned .* of .* degrees", "turned back"),
    (r"tilted by .* off the axis", "tilted"),
    (r"was moved by .* and tilted by", "knocked over"),
    (r"moved .* mm in the hand and rose", "slipped in the lift"),
    (r"no force closure", "no closure"),
)
"""What a reason of a report holds -> its class; the first that fits."""

FAULTS = (
    (r"the hand collided", "hand collided"),
    (r"samples without force closure", "closure lost at times"),
    (r"fingers touched at times", "fingers lost at times"),
    (r"pressed with", "pressed too hard"),
)
"""The same of faults of a turn that was made, the worst first."""

SHORT = "short of the angle"
"""Turned far enough to go on, and not as far as was asked for."""


def class_of_turn(report: ManipulationReport) -> str:
    """Why a turn is no success with closure, "" if it is one."""
    if report.success_with_closure:
        return ""
    if report.dropped:
        return "dropped"
    if report.success:
        return _first(FAULTS, report.faults) or report.faults
    failed = [r for r in report.results if not r.passed]
    if not failed:
        return SHORT
    last = failed[-1]
    told = _first(CLASSES, f"{last.phase}: {last.reason}")
    # an object that is not as far as was asked went on, and something later went wrong
    return told or (SHORT if len(report.log.during("hold")) else str(last.phase))


def _first(classes: tuple[tuple[str, str], ...], text: str) -> str:
    return next((name for pattern, name in classes if re.search(pattern, text)), "")
