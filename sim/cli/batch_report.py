"""What a person sees of a batch: a bar while it runs, a table per object when it is done."""

from __future__ import annotations

import math
import statistics
import time
from typing import Any, Self

from rich import box
from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.table import Table

from planner.batch import BatchProgress, GraspSet
from sim.tables import number

__all__ = ["BatchBar", "batch_summary", "batch_table"]


DRAW_S = 0.1
"""Shortest time (s) between two drawings of the bar."""


class BatchBar:
    """A progress bar with rate and estimated end; use it as a context."""

    def __init__(self, console: Console) -> None:
        """A bar on a console; nothing is drawn where that is no terminal.

        Args:
            console: Where.
        """
        self._progress = Progress(
            TextColumn("planning"),
            BarColumn(),
            MofNCompleteColumn(),
            TextColumn("{task.fields[note]}"),
            TimeElapsedColumn(),
            TextColumn("left"),
            TimeRemainingColumn(),
            console=console,
            disable=not console.is_terminal,
            transient=True,
            auto_refresh=False,  # by a thread, beside which no worker may be forked
        )
        self._bar = self._progress.add_task("", total=None, note="")
        self._last: BatchProgress | None = None
        self._drawn = -math.inf

    def __enter__(self) -> Self:
        """Start drawing."""
        self._progress.start()
        return self

    def __exit__(self, *_: object) -> None:
        """Stop drawing."""
        self._progress.stop()

    def show(self, now: BatchProgress) -> None:
        """Show how far a batch is."""
        self._last = now
        planned = now.done - now.kept
        note = f"{now.rate:.1f}/s, found {now.found} of {planned}" if planned else ""
        draws = time.monotonic() - self._drawn >= DRAW_S or now.done == now.total
        if draws:
            self._drawn = time.monotonic()
        self._progress.update(
            self._bar, total=now.total, completed=now.done, note=note, refresh=draws
        )

    def kept(self) -> str:
        """How many grasps are kept, in words."""
        return "nothing was planned" if self._last is None else f"{self._last.done} grasps are kept"


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
    table = Table(
        title=f"{summary['hand']}: tries and CPU per found grasp; distinct: without near-"
        "duplicates; approach: share of directions, entropy; surface: share touched; "
        "posture: width over which joints are spread",
        box=box.SIMPLE_HEAD,
    )
    table.add_column("object", overflow="fold")
    for name in COLUMNS:
        table.add_column(name, justify="right", no_wrap=True)
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
