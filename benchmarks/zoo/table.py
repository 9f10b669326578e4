"""What ``bench zoo`` prints: a line per hand, and how many held."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator

from rich.table import Table

from sim.tables import Row, number, table_of

SHORT = 70
"""Characters of a reason in the table; the JSON file has all of it."""


def counts(rows: list[Row]) -> str:
    """How many hands came to what: "61 hands: 50 held, 3 refused"."""
    by_status = Counter(row["status"] for row in rows)
    parts = ", ".join(f"{n} {status}" for status, n in by_status.most_common())
    described = sum(row["joints"] is not None for row in rows)
    cpu_s = sum(row["cpu_s"] or 0.0 for row in rows)
    return f"{len(rows)} hands, {described} described: {parts}; {cpu_s:.0f} s of CPU"


def zoo_tables(result: Row) -> Iterator[Table | str]:
    """A line per hand, then the counts."""
    table = table_of(
        "hands",
        ("hand", "status", "grasp, or why none"),
        ("fingers", "joints", "tries", "epsilon", "CPU s"),
    )
    for row in result["rows"]:
        grasp = row["grasp"]
        told = f"{grasp['object']}, seed {grasp['seed']}" if grasp else row["reason"][:SHORT]
        table.add_row(
            row["name"],
            row["status"],
            told,
            str(len(row["fingers"])),
            number(row["joints"], 0),
            str(len(row["tries"])),
            number(grasp["epsilon"] if grasp else None, 3),
            number(row["cpu_s"], 1),
        )
    yield table
    yield counts(result["rows"])
