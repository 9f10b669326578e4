"""A cross-check as tables for people."""

from __future__ import annotations

import numpy as np
from rich.markup import escape
from rich.table import Table

from sim.crosscheck.quantities import QUANTITIES
from sim.crosscheck.report import Cell, Column, CrosscheckReport

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
            words = [word for cell in cells for word in _cell(cell)]
            table.add_row(title, quantity.unit, *words)
    return [table, *(_faults(c) for c in report.columns if c.faults)]


def _cell(cell: Cell | None) -> tuple[str, str]:
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


def _faults(column: Column) -> Table:
    table = Table(title=escape(f"what differs: {column.name}"))
    for title in ("quantity", "part", "reference", "there", "cause"):
        table.add_column(title, overflow="fold")
    for d in column.faults:
        cause = d.reason or ("unknown" if not column.judged else "")
        table.add_row(d.quantity, escape(d.part), d.reference, d.value, escape(cause))
    return table
