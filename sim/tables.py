"""Tables for people: numbers, shares, and rows summed up group by group."""

from __future__ import annotations

from collections.abc import Callable, Container, Iterable, Mapping, Sequence
from typing import Any, TypeAlias

from rich import box
from rich.table import Table

__all__ = [
    "Columns",
    "Row",
    "grouped",
    "number",
    "percent",
    "share",
    "summary_table",
    "table",
    "table_of",
]

Row: TypeAlias = dict[str, Any]
"""Plain data by name."""

Columns: TypeAlias = Mapping[str, Callable[[list[Row]], str]]
"""Header of a column -> its cell for the rows of a group."""


def number(value: float | None, digits: int, scale: float = 1.0) -> str:
    """A number, or a dash for none."""
    return "-" if value is None else f"{scale * value:.{digits}f}"


def percent(part: float, whole: float, digits: int = 1) -> str:
    """A part of a whole in percent, or a dash where there is no whole."""
    return f"{100 * part / whole:.{digits}f} %" if whole else "-"


def share(chosen: Iterable[Any]) -> str:
    """How many of all are true: "3/4"."""
    every = [bool(one) for one in chosen]
    return f"{sum(every)}/{len(every)}"


def grouped(rows: Iterable[Row], *names: str) -> dict[tuple[Any, ...], list[Row]]:
    """Rows that agree in some values, by these values, in the order of first appearance."""
    out: dict[tuple[Any, ...], list[Row]] = {}
    for row in rows:
        out.setdefault(tuple(row[name] for name in names), []).append(row)
    return out


def table(
    title: str | None,
    columns: Iterable[str],
    rows: Iterable[Sequence[str]] = (),
    *,
    left: Container[str] = (),
    **more: Any,
) -> Table:
    """A table whose columns are flush right, except some; those break their words.

    Args:
        title: Above it.
        columns: Their headers.
        rows: A cell for each column.
        left: Headers of the columns that are flush left.
        more: Further arguments of ``rich.table.Table``.
    """
    made = Table(title=title, **{"box": box.SIMPLE_HEAD, **more})
    for name in columns:
        if name in left:
            made.add_column(name, overflow="fold")
        else:
            made.add_column(name, justify="right", no_wrap=True)
    for row in rows:
        made.add_row(*row)
    return made


def table_of(title: str, texts: Sequence[str], numbers: Sequence[str]) -> Table:
    """An empty table with columns of text, then columns of numbers."""
    return table(title, [*texts, *numbers], left=texts, title_justify="left")


def summary_table(
    title: str,
    rows: Iterable[Row],
    by: Mapping[str, str] | Sequence[str],
    columns: Columns,
    totals: Sequence[Sequence[str | None]] = (),
) -> Table:
    """A line for the rows that agree in some values, then lines of totals.

    Args:
        title: Of the table.
        rows: All rows.
        by: Names of those values, with their headers if these are other words.
        columns: What follows them.
        totals: Each one a set of lines below all others. Where it has a text for a value, that
            text is shown and the value does not divide the rows; None divides them.
    """
    heads = dict(by) if isinstance(by, Mapping) else {name: name for name in by}
    every = list(rows)
    made = table_of(title, list(heads.values()), list(columns))

    def add(shown: Sequence[str | None]) -> None:
        names = [n for n, text in zip(heads, shown, strict=True) if text is None]
        for values, members in grouped(every, *names).items() if names else [((), every)]:
            left = iter(values)
            first = [str(next(left)) if text is None else text for text in shown]
            made.add_row(*first, *(cell(members) for cell in columns.values()))

    add([None] * len(heads))
    if totals:
        made.add_section()
    for shown in totals:
        add(shown)
    return made
