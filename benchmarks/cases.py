"""``run_cases``: cases whose conditions are drawn, and their rows in a file.

Used by the measurements of turns in the hand, planned (``benchmarks.motion``) and made
(``benchmarks.manipulate``).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, Protocol, TypeVar

from benchmarks.conditions import Conditions
from benchmarks.run import measure
from planner.arrays import finite
from sim.runner import Check, Runner
from sim.tables import Row


class Case(Protocol):
    """One case, as it is sent to a worker: a number in its cell, which is a hand and a kind."""

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
        """Its number in its cell."""
        ...

    def draw(self) -> Conditions:
        """True conditions; the same at every call."""
        ...


SomeCase = TypeVar("SomeCase", bound=Case)


def row_of(case: Case, **values: Any) -> Row:
    """The row of a case, plain data: which it is, its conditions, and what came of it."""
    shown = {name: getattr(case, name) for name in ("index", "hand", "kind", "number")}
    row: Row = finite({**shown, "conditions": asdict(case.draw()), **values})
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
    """Work on the cases that a file does not have yet; ``asked`` stands in the result too.

    The arguments, the result and the errors are those of ``benchmarks.run.measure``.
    """
    header = {"format": f"{kind}-rows", "version": 1, **asked}
    return measure(
        runner,
        work,
        cases,
        kind=kind,
        title=title,
        lost=not_found,
        file=file,
        asked=header,
        **asked,
    )
