"""What a page says in words and tables, as plain data, and its HTML.

``Polar``: charts of what is resisted in each direction of a plane, as SVG without a script.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from typing import TypeAlias

import numpy as np

from planner.contacts import ContactSet
from planner.errors import ContactError
from planner.quality.ball import wrench_reach
from planner.spatial import FloatArray


@dataclass(frozen=True, kw_only=True)
class Heading:
    """A heading within the page."""

    text: str


@dataclass(frozen=True, kw_only=True)
class Sentence:
    """One or more sentences; ``kind`` "warning" stands out."""

    text: str
    kind: str = "plain"


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """What a person reads first.

    Attributes:
        good: Whether it went well.
        text: A few words: "Held".
        reason: Why, a sentence or nothing.
        time: Moment that the reason is about, s; the page offers to go there. None for none.
    """

    good: bool
    text: str
    reason: str = ""
    time: float | None = None


@dataclass(frozen=True, kw_only=True)
class Facts:
    """Names with values, one row each; values are text with units."""

    rows: tuple[tuple[str, str], ...]


@dataclass(frozen=True, kw_only=True)
class Table:
    """A table; all cells are text.

    Attributes:
        columns: Heads, with units.
        rows: Each as long as ``columns``.
        fingers: Whether the first column names fingers, whose colours the page shows there.
    """

    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    fingers: bool = False


@dataclass(frozen=True, kw_only=True)
class Command:
    """A command to copy."""

    text: str


@dataclass(frozen=True, kw_only=True)
class Image:
    """A picture out of the page itself.

    Attributes:
        source: A data URI, ``data:image/png;base64,...``.
        text: What it shows.
    """

    source: str
    text: str


@dataclass(frozen=True, kw_only=True)
class PlotsHere:
    """The place of the scene's plots among the blocks; without it they stand after the last."""


@dataclass(frozen=True, kw_only=True)
class Folded:
    """Blocks under a title that a person opens."""

    title: str
    blocks: tuple[Block, ...]


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


Block: TypeAlias = (
    Heading | Sentence | Verdict | Facts | Table | Command | Image | PlotsHere | Folded | Polar
)
"""What a column of a page is made of."""


PLOTS = '<div id="plots"></div>'
"""Where the page's script draws the plots."""


def block_html(block: Block) -> str:
    """A block as HTML; every text is escaped."""
    match block:
        case Heading(text=text):
            return f"<h2>{escape(text)}</h2>"
        case Sentence(text=text, kind=kind):
            return f'<p class="{escape(kind)}">{escape(text)}</p>'
        case Verdict():
            return _verdict(block)
        case Facts(rows=rows):
            body = "".join(f"<dt>{escape(k)}</dt><dd>{escape(v)}</dd>" for k, v in rows)
            return f'<dl class="facts">{body}</dl>'
        case Table():
            return _table(block)
        case Command(text=text):
            return (
                f'<div class="command"><code>{escape(text)}</code>'
                '<button type="button" data-copy>Copy</button></div>'
            )
        case Image(source=source, text=text):
            return (
                f'<figure><img src="{escape(source)}" alt="{escape(text)}">'
                f"<figcaption>{escape(text)}</figcaption></figure>"
            )
        case PlotsHere():
            return PLOTS
        case Polar():
            return polar_html(block)
        case Folded(title=title, blocks=blocks):
            inner = "".join(block_html(b) for b in blocks)
            return f"<details><summary>{escape(title)}</summary>{inner}</details>"


def _verdict(verdict: Verdict) -> str:
    where = ""
    if verdict.time is not None:
        where = (
            f' <button type="button" data-seek="{verdict.time!r}">'
            f"show the moment ({verdict.time:.2f} s)</button>"
        )
    reason = f'<span class="reason">{escape(verdict.reason)}</span>' if verdict.reason else ""
    kind = "good" if verdict.good else "bad"
    return (
        f'<p class="verdict {kind}" role="status"><strong>{escape(verdict.text)}</strong>'
        f"{reason}{where}</p>"
    )


def _table(table: Table) -> str:
    head = "".join(f'<th scope="col">{escape(c)}</th>' for c in table.columns)
    rows = "".join(_row(row, table.fingers) for row in table.rows)
    return (
        '<div class="wide"><table>'
        f"<thead><tr>{head}</tr></thead><tbody>{rows}</tbody></table></div>"
    )


def _row(row: Sequence[str], fingers: bool) -> str:
    first = f' data-finger="{escape(row[0])}"' if fingers and row else ""
    cells = "".join(f"<td>{escape(c)}</td>" for c in row[1:])
    return f'<tr><th scope="row"{first}>{escape(row[0])}</th>{cells}</tr>' if row else ""


SIZE, MIDDLE, REACH = 170, 85.0, 62.0
"""Of a chart: side, middle and radius of the outermost ring, pixels."""
