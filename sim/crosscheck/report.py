"""What a cross-check found: verdicts, differences with causes; tables and data for machines."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from rich.markup import escape
from rich.table import Table

from planner.arrays import finite, short_repr
from sim.crosscheck.parts import QUANTITIES, Difference, Quantity, Tally, Tolerances

SCHEMA = 1
"""Version of the JSON that ``CrosscheckReport.to_dict`` gives."""


SHOWN = 8
"""Faults and causes of a side that ``print`` shows."""


@dataclass(frozen=True, kw_only=True)
class Cell:
    """One quantity of one side.

    Attributes:
        quantity: Its title.
        verdict: "agrees", "differs", or "reported" for what is not judged.
        error: Largest error, in the quantity's unit.
        where: The part with the largest error.
        state: Number of its configuration; -1 if that does not matter.
        compared: How many comparisons were made.
        tolerance: What was allowed.
    """

    quantity: str
    verdict: str
    error: float
    where: str
    state: int
    compared: int
    tolerance: float


@dataclass(frozen=True, kw_only=True)
class Column:
    """One side against the reference.

    Attributes:
        name: The side.
        cells: One for each quantity that was compared.
        differences: The worst difference of each quantity and part, those that name a part at
            fault (structure, parameters) before their consequences.
        failure: Why there is nothing to compare, or "".
        judged: Whether the side counts for ``CrosscheckReport.ok``.
        notes: What was not compared, and why.
    """

    name: str
    cells: tuple[Cell, ...]
    differences: tuple[Difference, ...]
    failure: str = ""
    judged: bool = True
    notes: tuple[str, ...] = ()

    @property
    def ok(self) -> bool:
        """Whether the side could be compared and nothing differs."""
        return not self.failure and all(cell.verdict != "differs" for cell in self.cells)

    @property
    def faults(self) -> tuple[Difference, ...]:
        """Differences of single parts (not their consequences in poses, forces and distances)."""
        groups = ("structure", "parameters", "couplings")
        return tuple(d for d in self.differences if QUANTITIES[d.quantity].group in groups)

    @property
    def causes(self) -> dict[str, str]:
        """Key of each known cause that was found -> the cause in words."""
        return {d.cause: d.reason for d in self.differences if d.cause}

    def lines(self) -> list[str]:
        """The side in a few lines: verdict, first faults, causes, notes."""
        name = self.name if self.judged else f"{self.name} (not judged)"
        if self.failure:
            return [f"{name}: {self.failure}"]
        wrong = [cell.quantity for cell in self.cells if cell.verdict == "differs"]
        if not wrong:
            return [f"{name}: {len(self.cells)} quantities agree", *_indented(self.notes)]
        faults = [str(fault) for fault in self.faults if not fault.cause]
        known = [f"{key}: {reason}" for key, reason in self.causes.items()]
        head = f"{name}: {len(wrong)} of {len(self.cells)} quantities differ: {', '.join(wrong)}"
        return [
            head,
            *_first(faults, "faults"),
            *_first(known, "causes"),
            *_indented(self.notes),
        ]

    @property
    def unexplained(self) -> tuple[Difference, ...]:
        """Faults without a known cause."""
        return tuple(d for d in self.faults if not d.cause)


@dataclass(frozen=True, kw_only=True)
class CrosscheckReport:
    """What was compared with what, and how it came out.

    Attributes:
        model: What was checked.
        reference: What the columns are compared with.
        columns: The sides.
        seed: Of the random configurations.
        n_configurations: How many.
        tolerances: What counted as equal.
        notes: What was not compared, and why.
    """

    model: str
    reference: str
    columns: tuple[Column, ...]
    seed: int
    n_configurations: int
    tolerances: Tolerances
    notes: tuple[str, ...] = ()

    @property
    def ok(self) -> bool:
        """Whether every side that is judged agrees."""
        return all(column.ok for column in self.columns if column.judged)

    @property
    def faults(self) -> tuple[str, ...]:
        """What differs in the sides that are judged, in words; faults of parts come first."""
        return tuple(str(d) for c in self.columns if c.judged for d in c.differences)

    def __repr__(self) -> str:
        """One line."""
        return short_repr(self)

    def __str__(self) -> str:
        """A screen: the verdict on each side, its first faults and known causes, and notes."""
        verdict = "all judged quantities agree" if self.ok else "differs"
        head = f"{self.model} against {self.reference}: {verdict}"
        lines = [f"{head} ({self.n_configurations} configurations, seed {self.seed})"]
        for column in self.columns:
            lines += column.lines()
        return "\n".join([*lines, *self.notes])

    def column(self, name: str) -> Column:
        """The side of that name.

        Raises:
            KeyError: There is none.
        """
        return {column.name: column for column in self.columns}[name]

    def to_dict(self) -> dict[str, Any]:
        """For JSON; an infinite error becomes None."""
        columns = [
            {
                "name": c.name,
                "ok": c.ok,
                "judged": c.judged,
                "failure": c.failure,
                "cells": [finite(asdict(cell)) for cell in c.cells],
                "differences": [finite(asdict(d)) for d in c.differences],
                "causes": c.causes,
                "notes": list(c.notes),
            }
            for c in self.columns
        ]
        return {
            "kind": "crosscheck",
            "schema": SCHEMA,
            "model": self.model,
            "reference": self.reference,
            "ok": self.ok,
            "seed": self.seed,
            "n_configurations": self.n_configurations,
            "tolerances": asdict(self.tolerances),
            "notes": list(self.notes),
            "columns": columns,
        }


def _indented(lines: Iterable[str]) -> list[str]:
    return [f"  {line}" for line in lines]


def _first(lines: list[str], where: str) -> list[str]:
    """The first ones, and how many more there are."""
    more = len(lines) - SHOWN
    return _indented([*lines[:SHOWN], *([f"{more} more in .{where}"] if more > 0 else [])])


def column_from(
    name: str, tally: Tally, *, judged: bool = True, notes: tuple[str, ...] = ()
) -> Column:
    """Verdicts from what was measured."""
    cells = []
    for title, quantity in QUANTITIES.items():
        if title in tally.worst:
            error, where, state = tally.worst[title]
            cells.append(
                Cell(
                    quantity=title,
                    verdict=_verdict(quantity, error, tally.allowed(title)),
                    error=error,
                    where=where,
                    state=state,
                    compared=tally.count[title],
                    tolerance=tally.allowed(title),
                )
            )
    order = list(QUANTITIES)
    differences = sorted(
        (d for d in tally.differences.values() if QUANTITIES[d.quantity].group != "overlap"),
        key=lambda d: order.index(d.quantity),
    )
    return Column(
        name=name, cells=tuple(cells), differences=tuple(differences), judged=judged, notes=notes
    )


def _verdict(quantity: Quantity, error: float, tolerance: float) -> str:
    if quantity.group == "overlap":
        return "reported"
    return "agrees" if error <= tolerance else "differs"


_STYLE = {"agrees": "green", "differs": "red", "reported": "dim"}


def crosscheck_tables(report: CrosscheckReport) -> list[Table]:
    """The table of quantities, and one of faults for each side that has some."""
    title = f"{report.model}, {report.n_configurations} configurations, seed {report.seed}"
    table = Table(title=escape(title), caption=f"largest differences from {report.reference}")
    table.add_column("quantity")
    table.add_column("unit")
    for column in report.columns:
        table.add_column(escape(column.name), justify="right")
        table.add_column("where", overflow="fold")
    sides = [{cell.quantity: cell for cell in column.cells} for column in report.columns]
    for title, quantity in QUANTITIES.items():
        cells = [side.get(title) for side in sides]
        if any(cells):
            words = [word for cell in cells for word in _cell_words(cell)]
            table.add_row(title, quantity.unit, *words)
    return [table, *(_fault_table(c) for c in report.columns if c.faults)]


def _cell_words(cell: Cell | None) -> tuple[str, str]:
    if cell is None:
        return "-", ""
    style = _STYLE[cell.verdict]
    error = "missing" if not np.isfinite(cell.error) else f"{cell.error:.1e}"
    if not QUANTITIES[cell.quantity].unit:
        error = "all" if cell.error == 0 else "not all"
    if cell.verdict == "agrees":
        return f"[{style}]{error}[/]", ""
    at = f" #{cell.state}" if cell.state >= 0 else ""
    return f"[{style}]{error}[/]", escape(f"{cell.where}{at}")


def _fault_table(column: Column) -> Table:
    table = Table(title=escape(f"what differs: {column.name}"))
    for title in ("quantity", "part", "reference", "there", "cause"):
        table.add_column(title, overflow="fold")
    for d in column.faults:
        cause = d.reason or ("unknown" if not column.judged else "")
        table.add_row(d.quantity, escape(d.part), d.reference, d.value, escape(cause))
    return table
