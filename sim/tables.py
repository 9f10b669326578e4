"""Tables for people: numbers, percentages, and columns that are flush left or right."""

from __future__ import annotations

from collections.abc import Container, Iterable, Sequence
from typing import Any, TypeAlias

from rich import box
from rich.table import Table

__all__ = ["Row", "number", "percent", "table", "table_of"]

Row: TypeAlias = dict[str, Any]
"""Plain data by name."""


def number(value: float | None, digits: int, scale: float = 1.0) -> str:
    """A number, or a dash for none."""
    return "-" if value is None else f"{scale * value:.{digits}f}"


def percent(part: float, whole: float, digits: int = 1) -> str:
    """A part of a whole in percent, or a dash where there is no whole."""
    return f"{100 * part / whole:.{digits}f} %" if whole else "-"


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
