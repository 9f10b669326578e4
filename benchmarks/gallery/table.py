"""What ``bench gallery`` prints: a line per entry."""

from __future__ import annotations

from rich.table import Table

from sim.tables import Row, number, table_of


def gallery_table(result: Row) -> Table:
    """Whether each entry ran, and what it left."""
    table = table_of("gallery", ("entry", "ran", "picture", "page"), ("CPU s",))
    for row in result["rows"]:
        ran = "yes" if row["ok"] else f"no: {row['output'].splitlines()[-1:]}"
        table.add_row(
            row["name"], ran, row["picture"] or "-", row["page"] or "-", number(row["cpu_s"], 1)
        )
    return table
