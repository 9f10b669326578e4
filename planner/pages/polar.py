"""``Polar``: charts of what is resisted in each direction of a plane, as SVG without a script."""

from __future__ import annotations

from dataclasses import dataclass
from html import escape

import numpy as np

from planner.contacts import ContactSet
from planner.errors import ContactError
from planner.quality.reach import wrench_reach
from planner.spatial import FloatArray

__all__ = ["Polar", "PolarChart", "polar_html", "resisted_forces"]

SIZE, MIDDLE, REACH = 170, 85.0, 62.0
"""Of a chart: side, middle and radius of the outermost ring, pixels."""

STEPS = 72
"""Directions of a curve: 5 degrees apart."""

ROUND = (1.0, 1.2, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0)
"""Round numbers, for the outermost ring."""

PLANES = (("x", "y", 0, 1), ("x", "z", 0, 2), ("y", "z", 1, 2))
"""Planes of the charts: axis to the right, axis upwards, and their numbers."""


@dataclass(frozen=True, kw_only=True, eq=False)
class PolarChart:
    """One closed curve about an origin.

    Attributes:
        right: Name of the axis to the right.
        up: Name of the axis upwards.
        values: (m,), at m angles evenly from the axis to the right towards the axis upwards.
    """

    right: str
    up: str
    values: FloatArray


@dataclass(frozen=True, kw_only=True, eq=False)
class Polar:
    """Charts side by side on one scale.

    Attributes:
        title: What they show.
        unit: Of the values.
        charts: The charts.
    """

    title: str
    unit: str
    charts: tuple[PolarChart, ...]


def resisted_forces(contacts: ContactSet, length: float) -> Polar | None:
    """Forces without torque that contacts resist per newton of total normal force, world axes.

    None for contacts without force closure.
    """
    turn = 2 * np.pi * np.arange(STEPS) / STEPS
    directions = np.zeros((len(PLANES), STEPS, 6))
    for chart, (_, _, right, up) in zip(directions, PLANES, strict=True):
        chart[:, right], chart[:, up] = np.cos(turn), np.sin(turn)
    try:
        # a force on the object is resisted by the opposite one
        reach = wrench_reach(contacts, -directions.reshape(-1, 6), length=length)
    except ContactError:
        return None
    values = reach.reshape(len(PLANES), STEPS)
    return Polar(
        title="Force that is resisted in each direction, per newton of total normal force",
        unit="N/N",
        charts=tuple(
            PolarChart(right=right, up=up, values=row)
            for (right, up, _, _), row in zip(PLANES, values, strict=True)
        ),
    )


def polar_html(polar: Polar) -> str:
    """The charts as HTML; the outermost ring is the largest value of all, rounded up."""
    largest = max(float(c.values.max()) for c in polar.charts)
    outer = _rounded_up(largest)
    charts = "".join(_chart(c, outer) for c in polar.charts)
    caption = f"{polar.title}; outer ring {outer:g} {polar.unit}"
    return (
        f'<figure class="polar"><figcaption>{escape(caption)}</figcaption>'
        f"<div>{charts}</div></figure>"
    )


def _chart(chart: PolarChart, outer: float) -> str:
    turn = 2 * np.pi * np.arange(len(chart.values)) / len(chart.values)
    scale = REACH / outer
    x = MIDDLE + scale * chart.values * np.cos(turn)
    y = MIDDLE - scale * chart.values * np.sin(turn)
    path = "M" + "L".join(f"{a:.1f} {b:.1f}" for a, b in zip(x, y, strict=True)) + "Z"
    rings = "".join(
        f'<circle cx="{MIDDLE}" cy="{MIDDLE}" r="{REACH * share:.1f}" class="ring"/>'
        for share in (0.5, 1.0)
    )
    weakest = int(np.argmin(chart.values))
    label = (
        f"plane {chart.right} {chart.up}: least {chart.values.min():.3f}, "
        f"largest {chart.values.max():.3f}"
    )
    return (
        f'<svg viewBox="0 0 {SIZE} {SIZE}" role="img" aria-label="{escape(label)}">'
        f"<title>{escape(label)}</title>{rings}"
        f'<path d="M{MIDDLE - REACH} {MIDDLE}H{MIDDLE + REACH}M{MIDDLE} {MIDDLE - REACH}'
        f'V{MIDDLE + REACH}" class="ring"/>'
        f'<path d="{path}" class="reach"/>'
        f'<path d="M{MIDDLE} {MIDDLE}L{x[weakest]:.1f} {y[weakest]:.1f}" class="weakest"/>'
        f'<text x="{MIDDLE + REACH + 5}" y="{MIDDLE + 4}" class="tick">{escape(chart.right)}</text>'
        f'<text x="{MIDDLE}" y="{MIDDLE - REACH - 5}" class="tick middle">{escape(chart.up)}</text>'
        f'<text x="{MIDDLE}" y="{SIZE - 3}" class="tick middle">'
        f"least {chart.values.min():.3f}</text>"
        "</svg>"
    )


def _rounded_up(value: float) -> float:
    """The next of some round numbers times a power of ten."""
    power = 10.0 ** np.floor(np.log10(value))
    return float(next(s * power for s in ROUND if s * power >= value))
