"""What a person sees of ``bench dexgraspbench``."""

from __future__ import annotations

import statistics
from typing import Any

from rich.table import Table

from sim.bench.tables import table_of

__all__ = ["dexgraspbench_table"]


def dexgraspbench_table(result: dict[str, Any]) -> Table:
    """Shares that hold, penetration and agreement per hand and object, and per hand."""
    table = table_of(
        "DexGraspBench: grasps that hold; mm of hand in object, median and worst; same verdict as "
        "our --protocol dexgraspbench",
        ("hand", "object"),
        ("grasps", *(f"{name} %" for name in result["settings"]), "mm", "worst", "same"),
    )
    cells: dict[tuple[str, str], list[dict[str, Any]]] = {}
    for grasp in result["grasps"]:
        cells.setdefault((grasp["hand"], grasp["object"]), []).append(grasp)
    for hand in dict.fromkeys(hand for hand, _ in cells):
        for (_, label), members in ((c, m) for c, m in cells.items() if c[0] == hand):
            table.add_row(hand, label, *_numbers(members, result["settings"]))
        mine = [grasp for grasp in result["grasps"] if grasp["hand"] == hand]
        table.add_row(hand, "all", *_numbers(mine, result["settings"]), end_section=True)
    return table


def _numbers(members: list[dict[str, Any]], settings: list[str]) -> list[str]:
    """Cells of one row."""
    depths = [grasp["penetration_mm"] for grasp in members]
    shares = [
        f"{100 * statistics.mean(grasp['verdicts'][name] for grasp in members):.1f}"
        for name in settings
    ]
    compared = [grasp for grasp in members if grasp["ours"] is not None and "fc" in settings]
    same = sum(grasp["ours"] == grasp["verdicts"]["fc"] for grasp in compared)
    return [
        str(len(members)),
        *shares,
        f"{statistics.median(depths):.2f}",
        f"{max(depths):.2f}",
        f"{same}/{len(compared)}" if compared else "-",
    ]
