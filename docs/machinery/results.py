"""Tables of measurements, from the files that ``python -m benchmarks ... --out FILE`` writes.

In a page a table is::

    ```{measured} grasps.json
    ```

with a file of ``docs/results/data``. It is the summary that the command prints and writes, below a
line that says command, date, commit and machine. The command that stands in a file measures it
again.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, ClassVar

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

from machinery.commands import shown

DATA = Path(__file__).parent.parent / "results" / "data"
LARGEST_KB = 200
"""Largest file of a measurement (kB)."""


def made_with(result: dict[str, Any]) -> str:
    """One sentence that says how a result was measured."""
    parts = [
        f"``{result['command']}``",
        f"{result['date']}, commit ``{result['commit']}``, {result['written_by']}",
        f"{result['machine']}, {result['cores']} cores, {result['workers']} of them used, "
        f"load average {result['load_average']} when it began",
    ]
    return "; ".join(parts) + "."


def as_markdown(table: dict[str, Any]) -> list[str]:
    """A table of a summary as one of a page."""
    rows = [table["columns"], ["---"] * len(table["columns"]), *table["rows"]]
    lines = [f"| {' | '.join(map(shown, row))} |" for row in rows]
    lines[1] = "|" + " --- |" * len(table["columns"])
    title = [f"**{shown(table['title'])}**", ""] if table["title"] else []
    caption = [shown(table["caption"]), ""] if table.get("caption") else []
    return [*title, *lines, "", *caption]


def as_page(result: dict[str, Any]) -> list[str]:
    """How a result was measured, and its summary, in Markdown."""
    lines = [made_with(result), ""]
    for one in result["summary"]:
        lines += [shown(one), ""] if isinstance(one, str) else as_markdown(one)
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
