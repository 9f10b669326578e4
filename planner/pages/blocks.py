"""What a page says in words and tables, as plain data, and its HTML."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from typing import TypeAlias

from planner.pages.polar import Polar, polar_html

__all__ = [
    "PLOTS",
    "Block",
    "Command",
    "Facts",
    "Folded",
    "Heading",
    "Image",
    "PlotsHere",
    "Sentence",
    "Table",
    "Verdict",
    "block_html",
]


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
