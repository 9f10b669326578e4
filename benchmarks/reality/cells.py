"""``cells_of``, ``numbers_of``: rows counted per cell, and their medians over objects."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import TypeAlias

from benchmarks.statistics import median_of
from sim.tables import Row

CELL = ("task", "reality", "loop", "hand", "object")
"""What a cell is named by."""

MEDIANS = (
    "off_deg",
    "tilt_deg",
    "pose_mm",
    "pose_deg",
    "within_two_sigma",
    "slip_mm",
    "slip_deg",
    "pushes_survived",
    "planning_cpu_s",
    "simulation_cpu_s",
)
"""Numbers of a row, where it has them, whose medians are kept."""

Found: TypeAlias = Sequence[tuple[Sequence[str], Row]]
"""Name of the cell and row, of every trial that was done."""


def cells_of(found: Found) -> list[Row]:
    """Counts of each cell: trials, plans, successes, and the other ones by reason."""
    return [
        {
            **dict(zip(CELL, name, strict=True)),
            "n": len(rows),
            "planned": sum(bool(row["planned"]) for row in rows),
            "success": sum(bool(row["success"]) for row in rows),
            "reasons": dict(Counter(r["reason"] for r in rows if r["reason"]).most_common()),
        }
        for name, rows in _grouped(found, len(CELL)).items()
    ]


def numbers_of(found: Found) -> list[Row]:
    """Medians over hands and objects, of all trials that have the number; None where none has."""
    wide = CELL[:3]
    return [
        {
            **dict(zip(wide, name, strict=True)),
            **{
                what: median_of(row[what] for row in rows if row.get(what) is not None)
                for what in MEDIANS
            },
        }
        for name, rows in _grouped(found, len(wide)).items()
    ]


def _grouped(found: Found, length: int) -> dict[tuple[str, ...], list[Row]]:
    """Rows by the first parts of the names of their cells, in the order of first appearance."""
    out: dict[tuple[str, ...], list[Row]] = {}
    for name, row in found:
        out.setdefault(tuple(name[:length]), []).append(row)
    return out
