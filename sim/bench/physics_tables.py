"""What a person sees of ``bench physics``: what holds under which physics, and creep."""

from __future__ import annotations

from collections import Counter
from typing import Any

from rich.table import Table

from sim.bench.physics import NO_SUCH_GRIP
from sim.bench.statistics import median_of, quantile_of
from sim.bench.tables import number, table_of

__all__ = ["physics_tables"]

TITLES = {
    "holds": "held in the open loop, by physics",
    "closed": "held in the closed loop, by physics",
    "remedies": "held under mujoco-default with one change",
}


def physics_tables(result: dict[str, Any]) -> list[Table]:
    """A table per part that has rows."""
    out = []
    for part in TITLES:
        rows = [r for r in result["rows"] if r["part"] == part]
        if rows:
            out += [_counts(TITLES[part], rows), _each(TITLES[part], rows)]
    if rows := [r for r in result["rows"] if r["part"] == "creep"]:
        out.append(_creep(rows))
    return out


def _counts(title: str, rows: list[dict[str, Any]]) -> Table:
    table = table_of(title, ("physics",), ("held", "slip mm", "p90", "reasons"))
    for case, members in _by_case(rows).items():
        tried = [r for r in members if not r["error"]]
        held = [r for r in tried if r["held"]]
        slips = [r["slip_mm"] for r in held]
        reasons = Counter(r["reason"] for r in tried if not r["held"])
        table.add_row(
            case,
            f"{len(held)}/{len(tried)}",
            number(median_of(slips), 2),
            number(quantile_of(slips, 0.9), 2),
            ", ".join(f"{n} {reason}" for reason, n in reasons.most_common()),
        )
    return table


def _each(title: str, rows: list[dict[str, Any]]) -> Table:
    """Every grasp: its slip in mm where it is held, why not where it is not."""
    cases = _by_case(rows)
    table = table_of(f"{title}: slip in mm, or why not", ("hand", "object"), tuple(cases))
    cells: dict[tuple[str, str], dict[str, str]] = {}
    for r in rows:
        told = r["error"] or (number(r["slip_mm"], 2) if r["held"] else r["reason"])
        cells.setdefault((r["hand"], r["object"]), {})[r["case"]] = told
    for (hand, item), told_by_case in cells.items():
        table.add_row(hand, item, *(told_by_case.get(case, "-") for case in cases))
    return table


def _creep(rows: list[dict[str, Any]]) -> Table:
    table = table_of(
        "creep of the held object, medians in mm/s: measured; by the formula; by it however firm "
        "the grip; noslip is not in it",
        ("physics",),
        ("n", "measured", "formula", "least", "measured / formula", "lost", "no such grip"),
    )
    for case, members in _by_case(rows).items():
        known = [r for r in members if not r["error"]]
        ratios = [r["creep_mm_s"] / r["predicted_mm_s"] for r in known if r["predicted_mm_s"]]
        table.add_row(
            case,
            str(len(known)),
            *(
                number(median_of(r[name] for r in known if r[name] is not None), 3)
                for name in ("creep_mm_s", "predicted_mm_s", "least_mm_s")
            ),
            number(median_of(ratios), 2),
            str(sum(r["error"] not in ("", NO_SUCH_GRIP) for r in members)),
            str(sum(r["error"] == NO_SUCH_GRIP for r in members)),
        )
    return table


def _by_case(rows: list[dict[str, Any]]) -> dict[str, list[dict[str, Any]]]:
    out: dict[str, list[dict[str, Any]]] = {}
    for r in rows:
        out.setdefault(r["case"], []).append(r)
    return out
