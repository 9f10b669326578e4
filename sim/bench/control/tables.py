"""What a person sees of ``bench control``: one table per part, with counts beside every share."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from types import MappingProxyType
from typing import Any, TypeAlias

from rich.table import Table

from sim.bench.control.promise import MOST
from sim.bench.statistics import median_of, quantile_of, ratio, summed
from sim.bench.tables import number, table_of

__all__ = ["control_tables"]

Rows: TypeAlias = list[dict[str, Any]]

ENOUGH = 0.7
"""Share of the bound (-) that a closed loop should reach."""

KEPT, ROUNDING = 0.97, 1e-9
"""Share of a promise (-) that a closed loop should bear, and what sums of steps are off."""

STILL_MM = 0.5
"""Drift in ten seconds (mm) that a hold should stay below."""


def control_tables(result: dict[str, Any]) -> list[Table]:
    """A table per part that has rows."""
    out = []
    for part, make in _TABLES.items():
        rows = [r for r in result["rows"] if r["part"] == part]
        known = [r for r in rows if not r["error"]]
        if rows:
            table = make(known)
            if lost := len(rows) - len(known):
                table.caption = f"{lost} of {len(rows)} grasps were not found"
            out.append(table)
    return out


def _fc(rows: Rows) -> Table:
    table = table_of(
        "fc: held in all six directions, and pushes held; penetration at start and grasp, mm",
        ("hand", "object"),
        ("held", "share", "pushes", "start", "grasp"),
    )
    for (hand, item), members in _grouped(rows, "hand", "object"):
        table.add_row(hand, item, *_fc_cells(members))
    table.add_section()
    for (hand,), members in _grouped(rows, "hand"):
        table.add_row(hand, "all", *_fc_cells(members))
    table.add_row("all", "", *_fc_cells(rows))
    return table


def _fc_cells(rows: Rows) -> list[str]:
    good = sum(r["held"] == r["of"] for r in rows)
    return [
        f"{good}/{len(rows)}",
        _percent(good, len(rows)),
        f"{sum(r['held'] for r in rows)}/{sum(r['of'] for r in rows)}",
        number(max((r["start_penetration_mm"] for r in rows), default=None), 2),
        number(max((r["grasp_penetration_mm"] for r in rows), default=None), 2),
    ]


def _push(rows: Rows) -> Table:
    flat = [push | {"hand": r["hand"]} for r in rows for push in r["pushes"]]
    table = table_of(
        f"push: medians of the largest load borne ({_lost(flat)}); open loop with the plan's grip "
        "and with the best of those that the plan's forces allow, closed loop; its medians by the "
        "open loop's; its share of the bound that is proven for the planned posture, and loads "
        "beyond it and beyond the bound for its neighbourhood",
        ("hand", "kind"),
        (
            "n",
            "feedforward",
            "best open",
            "its grip",
            "impedance",
            "by open",
            "by best",
            "share",
            "p10",
            f">= {ENOUGH:g}",
            "beyond",
            "near",
        ),
    )
    for (hand, kind), members in _grouped(flat, "hand", "kind"):
        table.add_row(hand, kind, *_push_cells(members))
    table.add_section()
    for (kind,), members in _grouped(flat, "kind"):
        table.add_row("all", kind, *_push_cells(members))
    table.add_row("all", "", *_push_cells(flat))
    return table


def _push_cells(pushes: Rows) -> list[str]:
    units = {p["unit"] for p in pushes}
    middle = {
        k: median_of(p[k]["borne"] for p in pushes) for k in ("feedforward", "best", "impedance")
    }
    bounded = [p for p in pushes if p["bound"]]
    shares = [p["impedance"]["borne"] / p["bound"] for p in bounded]
    beyond = [p for p in pushes if p["bound_near"] and p["impedance"]["borne"] > p["bound_near"]]
    # medians over newtons and newton metres together would say nothing
    alone = units.pop() if len(units) == 1 else ""
    told = {k: f"{v:.3g} {alone}" if alone and v is not None else "-" for k, v in middle.items()}
    return [
        str(len(pushes)),
        told["feedforward"],
        told["best"],
        f"{number(median_of(p['best']['grip_N'] for p in pushes), 1)} N",
        told["impedance"],
        *(
            number(ratio(middle["impedance"] or 0.0, middle[k] or 0.0) if alone else None, 2)
            for k in ("feedforward", "best")
        ),
        number(median_of(shares), 2),
        number(quantile_of(shares, 0.1), 2),
        f"{sum(s >= ENOUGH for s in shares)}/{len(shares)}",
        str(sum(s > 1 for s in shares)),
        str(len(beyond)),
    ]


def _promise(rows: Rows) -> Table:
    flat = [load | {"hand": r["hand"]} for r in rows for load in r["loads"]]
    table = table_of(
        "promise: share of what the certificate promises, for the best control, at which the "
        f"closed loop lost the object ({_lost(flat)}), {MOST:g} at most; friction as certified",
        ("hand", "kind", "load"),
        ("n", "median", "p10", "least", f">= {KEPT:g}", ">= 1"),
    )
    for (hand, kind, speed), members in _grouped(flat, "hand", "kind", "speed"):
        table.add_row(hand, kind, speed, *_promise_cells(members))
    table.add_section()
    for (speed,), members in _grouped(flat, "speed"):
        table.add_row("all", "", speed, *_promise_cells(members))
    return table


def _promise_cells(loads: Rows) -> list[str]:
    shares = [MOST if load["broke_at"] is None else load["broke_at"] for load in loads]
    return [
        str(len(shares)),
        *(
            number(value, 2)
            for value in (median_of(shares), quantile_of(shares, 0.1), min(shares, default=None))
        ),
        f"{sum(s >= KEPT - ROUNDING for s in shares)}/{len(shares)}",
        f"{sum(s >= 1 - ROUNDING for s in shares)}/{len(shares)}",
    ]


def _lost(measured: Rows) -> str:
    """When the object counts as lost, in words."""
    limits = {(m["lost_mm"], m["lost_deg"]) for m in measured}
    return "lost: " + (
        " or ".join(f"{mm:g} mm or {deg:g} degrees in the palm" for mm, deg in sorted(limits))
        or "nothing measured"
    )


def _drift(rows: Rows) -> Table:
    table = table_of(
        f"drift in {rows[0]['seconds']:g} s of holding" if rows else "drift",
        ("loop", "noslip"),
        ("held", "median mm", "p90", "worst", f"<= {STILL_MM:g} mm", "worst deg"),
    )
    flat = [h for r in rows for h in r["holds"]]
    for (loop, noslip), members in _grouped(flat, "loop", "noslip"):
        held = [h for h in members if not h["reason"]]
        moved = [h["moved_mm"] for h in held]
        table.add_row(
            loop,
            str(noslip),
            f"{len(held)}/{len(members)}",
            number(median_of(moved), 3),
            number(quantile_of(moved, 0.9), 3),
            number(max(moved, default=None), 3),
            f"{sum(m <= STILL_MM for m in moved)}/{len(members)}",
            number(max((h["turned_deg"] for h in held), default=None), 2),
        )
    return table


def _slip(rows: Rows) -> Table:
    table = table_of(
        "slip: found within 50 ms; right alarms; delay; false alarms in peace, per 100 s of it",
        ("hand", "loop"),
        ("found", "recall", "right", "precision", "delay ms", "peace s", "false", "per 100 s"),
    )
    flat = [loop | {"hand": r["hand"]} for r in rows for loop in r["loops"]]
    for (hand, loop), members in _grouped(flat, "hand", "loop"):
        table.add_row(hand, loop, *_slip_cells(members))
    table.add_section()
    for (loop,), members in _grouped(flat, "loop"):
        table.add_row("all", loop, *_slip_cells(members))
    table.add_row("all", "", *_slip_cells(flat))
    return table


def _slip_cells(loops: Rows) -> list[str]:
    names = ("slips", "found", "alarms", "right", "calm_s", "calm_false")
    total = summed({name: loop[name] for name in names} for loop in loops)
    delays = [loop["delay"] for loop in loops if loop["delay"] is not None]
    rate = ratio(100.0 * total["calm_false"], total["calm_s"])
    return [
        f"{total['found']:.0f}/{total['slips']:.0f}",
        _percent(total["found"], total["slips"]),
        f"{total['right']:.0f}/{total['alarms']:.0f}",
        _percent(total["right"], total["alarms"]),
        number(median_of(delays), 0, 1e3),
        number(total["calm_s"], 0),
        number(total["calm_false"], 0),
        number(rate, 2),
    ]


def _robust(rows: Rows) -> Table:
    table = table_of("robust: held over the grid", ("hand", "what"), ("feedforward", "impedance"))
    flat = [t | {"hand": r["hand"]} for r in rows for t in r["trials"]]
    for name, unit in (("mass", "mass x"), ("friction", "friction x"), ("pose", "pose off by ")):
        for (level,), members in _grouped(flat, name):
            table.add_row("all", f"{unit}{level}", *_robust_cells(members))
        table.add_section()
    for (hand,), members in _grouped(flat, "hand"):
        table.add_row(hand, "whole grid", *_robust_cells(members))
    table.add_row("all", "whole grid", *_robust_cells(flat))
    return table


def _robust_cells(trials: Rows) -> list[str]:
    cells = []
    for loop in ("feedforward", "impedance"):
        held = [t["held"] for t in trials if t["loop"] == loop]
        cells.append(f"{sum(held)}/{len(held)} {_percent(sum(held), len(held))}")
    return cells


def _rate(rows: Rows) -> Table:
    table = table_of(
        "rate: CPU ms per step of 2 ms on one core; MuJoCo alone; what is above; times real time",
        ("hand", "loop"),
        ("fingers", "n", "whole", "fastest", "MuJoCo", "above", "real time"),
    )
    flat = [
        loop | {"hand": r["hand"], "fingers": r["fingers"]}
        for r in rows
        for loop in r["loops"]
        if not loop["reason"]
    ]
    for (hand, loop, fingers), members in _grouped(flat, "hand", "loop", "fingers"):
        whole = [ms for m in members for ms in m["whole_ms"]]
        bare = [ms for m in members for ms in m["bare_ms"]]
        middle, alone = median_of(whole) or 0.0, median_of(bare) or 0.0
        table.add_row(
            hand,
            loop,
            str(fingers),
            str(len(members)),
            number(middle, 3),
            number(min(whole), 3),
            number(alone, 3),
            number(middle - alone, 3),
            number(ratio(members[0]["step_ms"], middle), 2),
        )
    return table


_TABLES: Mapping[str, Callable[[Rows], Table]] = MappingProxyType(
    {
        "fc": _fc,
        "push": _push,
        "drift": _drift,
        "slip": _slip,
        "robust": _robust,
        "rate": _rate,
        "promise": _promise,
    }
)


def _grouped(rows: Iterable[dict[str, Any]], *names: str) -> list[tuple[tuple[Any, ...], Rows]]:
    """Rows that agree in some values, with these values, in the order of first appearance."""
    out: dict[tuple[Any, ...], Rows] = {}
    for row in rows:
        out.setdefault(tuple(row[name] for name in names), []).append(row)
    return list(out.items())


def _percent(part: float, whole: float) -> str:
    return f"{100 * part / whole:.1f} %" if whole else "-"
