"""``manipulate_table``: what ``bench manipulate`` measured, counted per hand and kind of object."""

from __future__ import annotations

from typing import Any

from rich.table import Table

from benchmarks.run import by_cell
from benchmarks.statistics import median_of
from sim.tables import number, table_of

COLUMNS = (
    "planned",
    "closed",
    "success",
    "complete",
    "drops",
    "hits",
    "turned in s",
    "error deg",
    "tilt deg",
    "off path mm",
    "fingers",
    "force N",
    "placed mm",
    "placed deg",
    "planning s",
)

NOW = {"strict": "success_with_closure", "loose": "success", "not_strict": "faults"}
"""Names in rows written by version 1.0 and before -> names now."""

SHIFT_COLUMN = "shift off mm"
"""Last column where the object is to be moved in the hand."""


def manipulate_table(result: dict[str, Any]) -> Table:
    """Counts out of all trials, and medians, per hand and kind of object."""
    moves = "shift" in result
    table = table_of(
        f"{_movement(result)}: counts out of all trials (closed: successes with closure; a "
        "turn counts from the asked angle on, complete runs are off by 5 degrees at most); "
        "medians of successes: time until they had turned, how far the turn was off, "
        "largest tilt off the planned attitude, "
        "largest distance off the path; fewest fingers and largest force (N) of a finger in any; "
        "then of those placed; hits are runs in which the hand collided"
        + ("; last, how far the translation was off, of successes" if moves else ""),
        ("hand", "object"),
        (*COLUMNS, SHIFT_COLUMN) if moves else COLUMNS,
    )
    for (hand, kind), rows in by_cell(result["rows"]).items():
        named = [{NOW.get(name, name): v for name, v in row.items()} for row in rows]
        cells = _cells(named, result["angle_deg"])
        table.add_row(hand, kind, *(cells if moves else cells[:-1]))
    return table


def _movement(result: dict[str, Any]) -> str:
    """What was asked for, in words; a turn about the vertical names no axis."""
    parts = []
    if result["angle_deg"]:
        turn = f"turns by {result['angle_deg']:g} degrees"
        if "axis" in result:
            turn += f" about ({', '.join(f'{v:g}' for v in result['axis'])})"
        parts.append(turn)
    if "shift" in result:
        parts.append(f"translations by ({', '.join(f'{1e3 * v:g}' for v in result['shift'])}) mm")
    return " with ".join(parts)


def _cells(rows: list[dict[str, Any]], asked: float) -> list[str]:
    def count(name: str) -> str:
        return f"{sum(bool(row.get(name)) for row in rows)}/{len(rows)}"

    def median(name: str, members: list[dict[str, Any]], less: float = 0.0) -> float | None:
        return median_of(abs(m[name] - less) for m in members if m.get(name) is not None)

    turned = [row for row in rows if row.get("success")]
    found = [row for row in rows if row["found"]]
    least = [row["least_fingers"] for row in turned]
    hardest = [row["largest_force_N"] for row in turned if "largest_force_N" in row]
    counted = ("found", "success_with_closure", "success", "complete", "dropped", "collided")
    return [
        *(count(name) for name in counted),
        number(median("time_to_angle_s", turned), 2),
        number(median("turned_deg", turned, asked), 2),
        number(median("largest_tilt_deg", turned), 1),
        number(median("largest_off_path_mm", turned), 1),
        f"{min(least):.0f}" if least else "-",
        f"{max(hardest):.1f}" if hardest else "-",
        number(median("place_off_mm", rows), 1),
        number(median("place_heading_deg", rows), 1),
        number(median("planning_cpu_s", found), 2),
        number(median("shift_off_mm", turned), 2),
    ]
