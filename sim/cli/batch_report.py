"""What a person sees of a batch: a bar while it runs, a table per object when it is done."""

from __future__ import annotations

import math
import statistics
from typing import Any

from rich.table import Table

from planner.batch import BatchProgress, GraspSet
from sim.progress import ProgressBar
from sim.tables import number, table_of


class BatchBar(ProgressBar):
    """The bar of a batch, with its rate and what was found; use it as a context."""

    def told(self, now: BatchProgress) -> None:
        """Show how far a batch is."""
        planned = now.done - now.kept
        note = f"{now.rate:.1f}/s, found {now.found} of {planned}" if planned else ""
        self.show("planning", now.done, now.total, note)

    def kept(self) -> str:
        """How many grasps are kept, in words."""
        return f"{self.done} grasps are kept" if self.done else "nothing was planned"


def batch_summary(grasps: GraspSet) -> dict[str, Any]:
    """Figures of a batch as plain data: what was found, its cost, and how diverse it is."""
    columns = ("found", "attempts", "cpu_s", "epsilon", "reason")
    rows: dict[str, dict[str, list[Any]]] = {
        label: {name: [] for name in columns} for label in grasps.labels
    }
    for row in grasps:  # checked, which tables are not
        for name in columns:
            rows[row["object"]][name].append(row[name])
    return {
        "format": "opposable-batch-summary",
        "version": 1,
        "written_by": grasps.manifest.written_by,
        "hand": grasps.manifest.hand,
        "objects": [_object(grasps, label, rows[label]) for label in grasps.labels],
    }


def _object(grasps: GraspSet, label: str, rows: dict[str, list[Any]]) -> dict[str, Any]:
    found = sum(rows["found"])
    reasons = [r.split(":")[0] for r in rows["reason"] if r]
    return {
        "object": label,
        "requested": len(rows["found"]),
        "found": found,
        "attempts_per_found": sum(rows["attempts"]) / found if found else None,
        "cpu_s_per_found": sum(rows["cpu_s"]) / found if found else None,
        "epsilon_median": (
            statistics.median(e for e in rows["epsilon"] if e is not None) if found else None
        ),
        "commonest_reason": statistics.mode(reasons) if reasons else "",
        "diversity": grasps.diversity(label).to_dict(),
    }


COLUMNS = ("found", "tries", "CPU s", "epsilon", "distinct", "approach", "surface", "posture")
"""Found of requested; attempts and CPU per found; medians; diversity as in ``Diversity``."""


def batch_table(summary: dict[str, Any]) -> Table:
    """The summary as a table."""
    table = table_of(
        f"{summary['hand']}: tries and CPU per found grasp; distinct: without near-"
        "duplicates; approach: share of directions, entropy; surface: share touched; "
        "posture: width over which joints are spread",
        ("object",),
        COLUMNS,
    )
    for item in summary["objects"]:
        spread = item["diversity"]
        width = spread["posture_width_rad"]
        table.add_row(
            item["object"],
            f"{item['found']}/{item['requested']}",
            number(item["attempts_per_found"], 1),
            number(item["cpu_s_per_found"], 3),
            number(item["epsilon_median"], 3),
            str(spread["n_distinct"]),
            f"{100 * spread['approach_share']:.0f} %, {spread['approach_entropy']:.1f}",
            f"{100 * spread['surface_share']:.0f} %",
            "-" if width is None else f"{math.degrees(width):.1f} deg",
        )
    return table
