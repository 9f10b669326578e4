"""``run_cases``: cases whose conditions are drawn, their rows in a journal, and what comes of them.

Used by the measurements of turns in the hand, planned (``sim.bench.motion``) and made
(``sim.bench.manipulate``).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, Protocol, TypeVar

from planner.plain import finite
from sim.bench.conditions import Conditions
from sim.bench.journal import Row, run_with_journal
from sim.runner import Check, Runner, made_with

__all__ = ["Case", "by_cell", "not_found", "row_of", "run_cases"]


class Case(Protocol):
    """One case, as it is sent to a worker."""

    @property
    def index(self) -> int:
        """Its number among all."""
        ...

    @property
    def hand(self) -> str:
        """Name or path of the hand."""
        ...

    @property
    def kind(self) -> str:
        """Kind of object."""
        ...

    @property
    def number(self) -> int:
        """Its number in its cell, which is a hand and a kind."""
        ...

    def draw(self) -> Conditions:
        """What there is; the same at every call."""
        ...


SomeCase = TypeVar("SomeCase", bound=Case)


def row_of(case: Case, **values: Any) -> Row:
    """The row of a case, plain data: which it is, its conditions, and what came of it."""
    row: Row = finite(
        {
            "index": case.index,
            "hand": case.hand,
            "kind": case.kind,
            "number": case.number,
            "conditions": asdict(case.draw()),
            **values,
        }
    )
    return row


def not_found(case: Case, reason: str) -> Row:
    """The row of a case that there is no plan of."""
    return row_of(case, found=False, reason=reason)


def run_cases(
    runner: Runner,
    work: Callable[[SomeCase, Check], Row],
    cases: Sequence[SomeCase],
    *,
    kind: str,
    asked: Row,
    file: Path,
    title: str,
) -> Row:
    """Work on the cases that a file does not have yet.

    Args:
        runner: Who works on them.
        work: Makes the row of a case.
        cases: All of them.
        kind: What kind of measurement it is; stands in file and result as their format.
        asked: What the cases follow from, plain data.
        file: Of the rows; made if it is not there.
        title: What the progress bar says.

    Returns:
        Plain data: all rows that the file has then, and what they were made with.

    Raises:
        FileFormatError: The file is not one of these, or was begun with other arguments.
    """
    rows, whole = run_with_journal(
        runner,
        work,
        cases,
        file=file,
        asked={"format": f"{kind}-rows", "version": 1, **asked},
        title=title,
        given_up=not_found,
    )
    return {
        "format": kind,
        "version": 1,
        **made_with(),
        **asked,
        "workers": runner.workers,
        "interrupted": not whole,
        "rows": sorted(rows, key=lambda row: int(row["index"])),
    }


def by_cell(rows: Iterable[Row]) -> dict[tuple[str, str], list[Row]]:
    """Rows by hand and kind of object, in the order of the first of each."""
    cells: dict[tuple[str, str], list[Row]] = {}
    for row in rows:
        cells.setdefault((row["hand"], row["kind"]), []).append(row)
    return cells
