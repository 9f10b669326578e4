"""What ``plan -n N`` writes and shows: numbered files, and a table of how the grasps differ."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.table import Table

    from planner.plan import GraspPlan


def numbered(file: Path, n: int) -> list[Path]:
    """Names for n files: plan.json gives plan-1.json and so on, with as many digits as n has."""
    width = len(str(n))
    return [file.with_name(f"{file.stem}-{k:0{width}}{file.suffix}") for k in range(1, n + 1)]


def plans_table(plans: Sequence[GraspPlan], files: Sequence[Path]) -> Table:
    """A row per plan: file, attempt, epsilon, and how far the nearest other one is."""
    from planner.batch import separations
    from sim.tables import number, table_of

    table = table_of(
        "distance to the nearest other grasp: near-duplicates are at most 1",
        ("file", "fingers"),
        ("attempt", "epsilon", "distance"),
    )
    for plan, file, apart in zip(plans, files, separations(plans), strict=True):
        table.add_row(
            str(file),
            ", ".join(plan.task.finger_names),
            str(plan.record.attempt + 1),
            number(plan.quality.epsilon, 4),
            "-" if len(plans) == 1 else number(float(apart), 1),
        )
    return table
