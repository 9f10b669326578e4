"""What a hand of the zoo is to grasp: simple objects that fit between its pads."""

from __future__ import annotations

from planner.describe import CheckReport

SHARE = 0.35
"""Where the width of an object lies between the widths of the hand's postures pinch and open."""

LEAST, MOST = 0.015, 0.14
"""Smallest and largest width, m."""

LEAST_HEIGHT = 0.06
"""Least height (m) of what stands on the table, so that fingers have room beside it."""


def fitting_width(check: CheckReport) -> float:
    """Width (m) of an object that the hand can take, in whole millimetres."""
    gaps = {row.name: float(row.gap) for row in check.postures}
    pinch = gaps.get("pinch", LEAST)
    width = pinch + SHARE * max(0.0, gaps.get("open", pinch) - pinch)
    return round(min(max(width, LEAST), MOST), 3)


def fitting_objects(width: float) -> list[str]:
    """Specifications of objects of about a width, the likeliest first."""
    found = []
    for scale in (1.0, 0.75, 1.2):
        wide = scale * width
        tall = max(1.5 * wide, LEAST_HEIGHT)
        found += [
            f"cylinder:{wide / 2:.3f}x{tall:.3f}",
            f"sphere:{wide / 2:.3f}",
            f"box:{0.85 * wide:.3f}x{0.85 * wide:.3f}x{tall:.3f}",
        ]
    return found
