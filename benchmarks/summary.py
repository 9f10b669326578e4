"""``summary``: rows grouped by some of their values, and cells that sum up what a group measured.

A column is its header and a function from a group, a data frame, to the text of its cell. Those
made here take the name of a value; a value may be a list, whose members count one by one, and a row
that does not have it does not count.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, TypeAlias

import numpy as np
import pandas as pd

from sim.tables import Row, number, percent

Frame: TypeAlias = Any
"""A data frame of pandas, which has no types."""

Cell: TypeAlias = Callable[[Frame], str]
Columns: TypeAlias = Mapping[str, Cell]
How: TypeAlias = str | float
"""Name of a method of a series, such as "max", or a quantile in [0, 1]."""

MEDIAN = 0.5


def summary(
    title: str,
    rows: Iterable[Row],
    by: Mapping[str, str] | Sequence[str],
    columns: Columns,
    totals: Sequence[Sequence[str | None]] = (),
) -> Row:
    """A table as plain data: a line for the rows that agree in some values, then lines of totals.

    Args:
        title: Of the table.
        rows: All rows.
        by: Names of those values, with their headers if these are other words.
        columns: What follows them.
        totals: Each one a set of lines below all others. Where it has a text for a value, that
            text is shown and the value does not divide the rows; None divides them.

    Returns:
        "title", "columns" and "rows" of texts, and "left", the columns that are flush left.
    """
    heads = dict(by) if isinstance(by, Mapping) else {name: name for name in by}
    frame = pd.DataFrame(list(rows))
    lines: list[list[str]] = []
    for shown in [[None] * len(heads), *totals] if len(frame) else []:
        names = [n for n, text in zip(heads, shown, strict=True) if text is None]
        whole: list[tuple[Any, Frame]] = [((), frame)]
        groups = frame.groupby(names, sort=False, dropna=False) if names else whole
        for values, group in groups:
            left = iter(values)
            first = [_head(next(left)) if text is None else text for text in shown]
            lines.append([*first, *(cell(group) for cell in columns.values())])
    return table_data(title, list(heads.values()), list(columns), lines)


def table_data(
    title: str, texts: Sequence[str], numbers: Sequence[str], rows: Sequence[Sequence[str]]
) -> Row:
    """A table as plain data: columns of text, then columns of numbers."""
    lines = [list(row) for row in rows]
    return {"title": title, "left": list(texts), "columns": [*texts, *numbers], "rows": lines}


def _head(value: Any) -> str:
    """What a group is called."""
    return f"{value:g}" if isinstance(value, float) else str(value)


def flat(rows: Iterable[Row], name: str) -> list[Row]:
    """What rows list under a name, each with the other values of its row."""
    return [{**row, **one} for row in rows for one in row.get(name) or ()]


def values(frame: Frame, name: str, where: str = "") -> Frame:
    """Known numbers under a name, of the rows in which another value is true."""
    if name not in frame:
        return pd.Series(dtype=float)
    chosen = frame[_true(frame, where)] if where else frame
    return pd.to_numeric(chosen[name].explode()).dropna()


def _true(frame: Frame, name: str) -> Frame:
    """Which rows have a value that is true."""
    if name not in frame:
        return pd.Series(False, index=frame.index)
    return frame[name].map(lambda value: value is True or value is np.True_)


def of(
    name: str,
    how: How = MEDIAN,
    digits: int = 2,
    scale: float = 1.0,
    where: str = "",
    unit: str = "",
) -> Cell:
    """A number that sums up a value: its median unless told otherwise; a dash for none.

    Args:
        name: Of the value.
        how: See ``How``.
        digits: After the point.
        scale: What it is multiplied by.
        where: Of what must be true in a row that counts.
        unit: Behind it.
    """

    def cell(frame: Frame) -> str:
        return number(amount(frame, name, how, where), digits, scale) + unit

    return cell


def amount(frame: Frame, name: str, how: How = MEDIAN, where: str = "") -> float | None:
    """The number that ``of`` shows; None for none."""
    known = values(frame, name, where)
    if not len(known):
        return None
    return float(getattr(known, how)() if isinstance(how, str) else known.quantile(how))


def largest(name: str) -> Cell:
    """The largest, as a power of ten."""

    def cell(frame: Frame) -> str:
        value = amount(frame, name, "max")
        return "-" if value is None else f"{value:.1e}"

    return cell


def spread(name: str, digits: int, scale: float = 1.0) -> Cell:
    """Median and 90 % quantile."""
    middle, most = (of(name, q, digits, scale) for q in (MEDIAN, 0.9))
    return lambda frame: f"{middle(frame)} / {most(frame)}"


def share(name: str, where: str = "", known: str = "") -> Cell:
    """How many of all are true: "3/4".

    Args:
        name: Of the value.
        where: Of what must be true in a row that counts.
        known: Of what must be known in a row that counts.
    """

    def cell(frame: Frame) -> str:
        part, whole = _parts(frame, name, where, known)
        return f"{part}/{whole}"

    return cell


def percentage(name: str, digits: int = 1, known: str = "") -> Cell:
    """How many are true, in percent; see ``share``."""
    return lambda frame: percent(*_parts(frame, name, "", known), digits)


def _parts(frame: Frame, name: str, where: str, known: str) -> tuple[int, int]:
    if where:
        frame = frame[_true(frame, where)]
    if known:
        frame = frame[frame[known].notna()] if known in frame else frame[:0]
    return int(_true(frame, name).sum()), len(frame)


def parts(part: str, whole: str) -> Cell:
    """Sums of two values: "3/4"."""
    return lambda frame: (
        f"{amount(frame, part, 'sum') or 0:.0f}/{amount(frame, whole, 'sum') or 0:.0f}"
    )


def ratio(above: str, below: str, digits: int = 2, scale: float = 1.0) -> Cell:
    """The sum of a value over that of another; a dash where that is 0."""

    def cell(frame: Frame) -> str:
        total = amount(frame, below, "sum")
        return number(
            (amount(frame, above, "sum") or 0.0) / total if total else None, digits, scale
        )

    return cell


def share_of(name: str, good: Callable[[Frame], Frame]) -> Cell:
    """How many known values are good: "3/4".

    Args:
        name: Of the value.
        good: Which of a series are.
    """

    def cell(frame: Frame) -> str:
        known = values(frame, name)
        return f"{int(good(known).sum())}/{len(known)}"

    return cell


def count(frame: Frame) -> str:
    """How many rows there are."""
    return str(len(frame))


def counted(name: str) -> Cell:
    """What there is how often, the most frequent first: "slipped 3, dropped 1".

    The value is a text, "" for none, or a dictionary of counts.
    """
    return lambda frame: ", ".join(f"{what} {n:g}" for what, n in counts(frame, name).items())


def counts(frame: Frame, name: str) -> dict[str, float]:
    """What ``counted`` shows, as numbers."""
    total: dict[str, float] = {}
    for value in frame.get(name, ()):
        for what, n in (value if isinstance(value, dict) else {value: 1}).items():
            if isinstance(what, str) and what:
                total[what] = total.get(what, 0) + n
    return dict(sorted(total.items(), key=lambda item: -item[1]))
