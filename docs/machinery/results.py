"""Tables of measurements, from the files that ``python -m benchmarks ... --out FILE`` writes.

In a page a table is::

    ```{measured} grasps.json
    ```

with a file of ``docs/results/data``. It is the table that the command prints, below a line that
says command, date, commit and machine. The command that stands in a file measures it again.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, ClassVar

from docutils import nodes
from rich.table import Table
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

from benchmarks.audit import audit_tables
from benchmarks.best import best_tables
from benchmarks.control.tables import control_tables
from benchmarks.dexgraspbench.evaluate import dexgraspbench_table
from benchmarks.episodes import episodes_table
from benchmarks.exports import export_tables
from benchmarks.forces import force_tables
from benchmarks.grasps import grasps_table
from benchmarks.metrics import metrics_table
from benchmarks.motion import motion_table
from benchmarks.objectives import objective_tables
from benchmarks.physics import physics_tables
from benchmarks.reality import reality_tables
from benchmarks.refine import refine_tables
from benchmarks.scaling import scaling_tables
from benchmarks.synthesis_tables import synthesis_tables
from benchmarks.touch.tables import touch_tables
from benchmarks.trial_cost import trial_cost_table
from benchmarks.turn_table import manipulate_table
from benchmarks.walls import walls_tables
from benchmarks.witness import witness_tables
from machinery.commands import shown

DATA = Path(__file__).parent.parent / "results" / "data"
LARGEST_KB = 200
"""Largest file of a measurement (kB)."""

Tables = Callable[[dict[str, Any]], Table | str | Iterable[Table | str]]
TABLES: dict[str, Tables] = {
    "opposable-bench-audit": audit_tables,
    "opposable-bench-best": best_tables,
    "opposable-bench-control": control_tables,
    "opposable-bench-exports": export_tables,
    "opposable-bench-forces": force_tables,
    "opposable-bench-grasps": grasps_table,
    "opposable-bench-manipulate": manipulate_table,
    "opposable-bench-metrics-summary": metrics_table,
    "opposable-bench-motion": motion_table,
    "opposable-bench-objectives": objective_tables,
    "opposable-bench-physics": physics_tables,
    "opposable-bench-reality": reality_tables,
    "opposable-bench-refine": refine_tables,
    "opposable-bench-scaling": scaling_tables,
    "opposable-bench-synthesis": synthesis_tables,
    "opposable-bench-touch": touch_tables,
    "opposable-bench-trials": trial_cost_table,
    "opposable-bench-walls": walls_tables,
    "opposable-bench-witness": witness_tables,
    "opposable-dexgraspbench": dexgraspbench_table,
    "opposable-episodes-check": episodes_table,
}
"""Format of a result -> what makes tables of it, as the command does."""


def made_with(result: dict[str, Any]) -> str:
    """One sentence that says how a result was measured."""
    parts = [
        f"``{result['command']}``",
        f"{result['date']}, commit ``{result['commit']}``, {result['written_by']}",
        f"{result['machine']}, {result['cores']} cores, {result['workers']} of them used, "
        f"load average {result['load_average']} when it began",
    ]
    return "; ".join(parts) + "."


def text_of(cell: object) -> str:
    """A cell of a table as a terminal shows it."""
    return shown(str(getattr(cell, "plain", cell)))


def as_markdown(table: Table) -> list[str]:
    """A table of the terminal as one of a page."""
    rows = list(zip(*(list(column.cells) for column in table.columns), strict=True))
    head = [column.header for column in table.columns]
    lines = [f"| {' | '.join(text_of(cell) for cell in row)} |" for row in [head, *rows]]
    lines.insert(1, "|" + " --- |" * len(head))
    title = [f"**{text_of(table.title)}**", ""] if table.title else []
    caption = [text_of(table.caption), ""] if table.caption else []
    return [*title, *lines, "", *caption]


def as_page(result: dict[str, Any]) -> list[str]:
    """How a result was measured, and its tables, in Markdown."""
    made = TABLES[result["format"]](result)
    lines = [made_with(result), ""]
    for one in (made,) if isinstance(made, Table | str) else made:
        lines += as_markdown(one) if isinstance(one, Table) else [shown(one), ""]
    return lines


class Measured(SphinxDirective):
    """``measured FILE``: a table of a measurement."""

    required_arguments: ClassVar[int] = 1

    def run(self) -> list[nodes.Node]:
        """Read the file and make its tables."""
        path = DATA / self.arguments[0]
        if not path.is_file():
            raise self.error(f"{path.name} is not in docs/results/data; measure it with --out")
        self.env.note_dependency(str(path))
        self.env.note_dependency(__file__)
        result = json.loads(path.read_text(encoding="utf-8"))
        return self.parse_text_to_nodes("\n".join(as_page(result)))


def setup(app: Sphinx) -> dict[str, Any]:
    """Register the directive."""
    app.add_directive("measured", Measured)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
