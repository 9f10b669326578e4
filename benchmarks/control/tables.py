"""What a person sees of ``bench control``: one table per part, with counts beside every share."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from types import MappingProxyType

from rich.table import Table

from benchmarks.control.promise import MOST
from benchmarks.statistics import median_of, quantile_of, ratio, summed
from sim.tables import Columns, Row, grouped, number, percent, share, summary_table

Rows = list[Row]

ENOUGH = 0.7
"""Share of the proven bound (-) that impedance control should hold."""

KEPT, ROUNDING = 0.97, 1e-9
"""Share of a certified load (-) that impedance control should hold; rounding of sums of steps."""

STILL_MM = 0.5
"""Largest drift in ten seconds (mm) that counts as still."""


def control_tables(result: Row) -> list[Table]:
    """A table per part that has rows."""
    by_part = {part: rows for (part,), rows in grouped(result["rows"], "part").items()}
    out = []
    for part, make in _TABLES.items():
        if rows := by_part.get(part):
            known = [r for r in rows if not r["error"]]
            table = make(known)
            if lost := len(rows) - len(known):
                table.caption = f"{lost} of {len(rows)} grasps were not found"
            out.append(table)
    return out


def _flat(rows: Rows, name: str) -> Rows:
    """What rows list under a name, with their hand."""
    return [{"hand": r["hand"], **one} for r in rows for one in r[name]]


def _most(values: Iterable[float], digits: int) -> str:
    return number(max(values, default=None), digits)


def _fc(rows: Rows) -> Table:
    title = "fc: held in all six directions, and pushes held; penetration at start and grasp, mm"
    columns: Columns = {
        "held": lambda rows: share(r["held"] == r["of"] for r in rows),
        "share": lambda rows: percent(sum(r["held"] == r["of"] for r in rows), len(rows)),
        "pushes": lambda rows: f"{sum(r['held'] for r in rows)}/{sum(r['of'] for r in rows)}",
        "start": lambda rows: _most((r["start_penetration_mm"] for r in rows), 2),
        "grasp": lambda rows: _most((r["grasp_penetration_mm"] for r in rows), 2),
    }
    return summary_table(title, rows, ("hand", "object"), columns, [(None, "all"), ("all", "")])


def _push(rows: Rows) -> Table:
    flat = _flat(rows, "pushes")
    title = (
        f"push: medians of the largest load borne ({_lost(flat)}); open loop with the plan's grip "
        "and with the best of those that the plan's forces allow, closed loop; its medians by the "
        "open loop's; its share of the bound that is proven for the planned posture, and loads "
        "beyond it and beyond the bound for its neighbourhood"
    )
    columns: Columns = {
        "n": lambda rows: str(len(rows)),
        "feedforward": lambda rows: _borne(rows, "feedforward"),
        "best open": lambda rows: _borne(rows, "best"),
        "its grip": lambda rows: f"{number(median_of(p['best']['grip_N'] for p in rows), 1)} N",
        "impedance": lambda rows: _borne(rows, "impedance"),
        "by open": lambda rows: _by(rows, "feedforward"),
        "by best": lambda rows: _by(rows, "best"),
        "share": lambda rows: number(median_of(_of_bound(rows)), 2),
        "p10": lambda rows: number(quantile_of(_of_bound(rows), 0.1), 2),
        f">= {ENOUGH:g}": lambda rows: share(s >= ENOUGH for s in _of_bound(rows)),
        "beyond": lambda rows: str(sum(s > 1 for s in _of_bound(rows))),
        "near": lambda rows: str(sum(s > 1 for s in _of_bound(rows, "bound_near"))),
    }
    totals = [("all", None), ("all", "")]
    return summary_table(title, flat, ("hand", "kind"), columns, totals)


def _median_borne(pushes: Rows, loop: str) -> float | None:
    """Median of the largest load held; None where forces and torques are mixed."""
    return median_of(p[loop]["borne"] for p in pushes) if len(_units(pushes)) == 1 else None


def _units(pushes: Rows) -> list[str]:
    return sorted({p["unit"] for p in pushes})


def _borne(pushes: Rows, loop: str) -> str:
    middle = _median_borne(pushes, loop)
    return "-" if middle is None else f"{middle:.3g} {_units(pushes)[0]}"


def _by(pushes: Rows, loop: str) -> str:
    """Median load held under impedance control over that under another."""
    closed, other = _median_borne(pushes, "impedance"), _median_borne(pushes, loop)
    return number(None if closed is None else ratio(closed, other or 0.0), 2)


def _of_bound(pushes: Rows, bound: str = "bound") -> list[float]:
    """Largest load held under impedance control over a bound, where there is one."""
    return [p["impedance"]["borne"] / p[bound] for p in pushes if p[bound]]


def _promise(rows: Rows) -> Table:
    flat = _flat(rows, "loads")
    title = (
        "promise: share of what the certificate promises, for the best control, at which the "
        f"closed loop lost the object ({_lost(flat)}), {MOST:g} at most; friction as certified"
    )
    columns: Columns = {
        "n": lambda rows: str(len(rows)),
        "median": lambda rows: number(median_of(_broke_at(rows)), 2),
        "p10": lambda rows: number(quantile_of(_broke_at(rows), 0.1), 2),
        "least": lambda rows: number(min(_broke_at(rows), default=None), 2),
        f">= {KEPT:g}": lambda rows: share(s >= KEPT - ROUNDING for s in _broke_at(rows)),
        ">= 1": lambda rows: share(s >= 1 - ROUNDING for s in _broke_at(rows)),
    }
    heads = {"hand": "hand", "kind": "kind", "speed": "load"}
    return summary_table(title, flat, heads, columns, [("all", "", None)])


def _broke_at(loads: Rows) -> list[float]:
    return [MOST if load["broke_at"] is None else load["broke_at"] for load in loads]


def _lost(measured: Rows) -> str:
    """Drop criteria in words."""
    limits = {(m["lost_mm"], m["lost_deg"]) for m in measured}
    return "lost: " + (
        " or ".join(f"{mm:g} mm or {deg:g} degrees in the palm" for mm, deg in sorted(limits))
        or "nothing measured"
    )


def _drift(rows: Rows) -> Table:
    def moved(holds: Rows, name: str = "moved_mm") -> list[float]:
        return [h[name] for h in holds if not h["reason"]]

    columns: Columns = {
        "held": lambda rows: share(not h["reason"] for h in rows),
        "median mm": lambda rows: number(median_of(moved(rows)), 3),
        "p90": lambda rows: number(quantile_of(moved(rows), 0.9), 3),
        "worst": lambda rows: _most(moved(rows), 3),
        f"<= {STILL_MM:g} mm": lambda rows: (
            f"{sum(m <= STILL_MM for m in moved(rows))}/{len(rows)}"
        ),
        "worst deg": lambda rows: _most(moved(rows, "turned_deg"), 2),
    }
    title = f"drift in {rows[0]['seconds']:g} s of holding" if rows else "drift"
    return summary_table(title, _flat(rows, "holds"), ("loop", "noslip"), columns)


def _slip(rows: Rows) -> Table:
    def parts(loops: Rows, part: str, whole: str) -> str:
        total = _total(loops)
        return f"{total[part]:.0f}/{total[whole]:.0f}"

    columns: Columns = {
        "found": lambda rows: parts(rows, "found", "slips"),
        "recall": lambda rows: percent(_total(rows)["found"], _total(rows)["slips"]),
        "right": lambda rows: parts(rows, "right", "alarms"),
        "precision": lambda rows: percent(_total(rows)["right"], _total(rows)["alarms"]),
        "delay ms": lambda rows: number(
            median_of(r["delay"] for r in rows if r["delay"] is not None), 0, 1e3
        ),
        "peace s": lambda rows: number(_total(rows)["calm_s"], 0),
        "false": lambda rows: number(_total(rows)["calm_false"], 0),
        "per 100 s": lambda rows: number(
            ratio(100.0 * _total(rows)["calm_false"], _total(rows)["calm_s"]), 2
        ),
    }
    title = "slip: found within 50 ms; right alarms; delay; false alarms in peace, per 100 s of it"
    totals = [("all", None), ("all", "")]
    return summary_table(title, _flat(rows, "loops"), ("hand", "loop"), columns, totals)


def _total(loops: Rows) -> dict[str, float]:
    names = ("slips", "found", "alarms", "right", "calm_s", "calm_false")
    return dict.fromkeys(names, 0) | summed({n: loop[n] for n in names} for loop in loops)


def _robust(rows: Rows) -> Table:
    def held(trials: Rows, loop: str) -> str:
        mine = [t["held"] for t in trials if t["loop"] == loop]
        return f"{share(mine)} {percent(sum(mine), len(mine))}"

    columns: Columns = {
        "feedforward": lambda rows: held(rows, "feedforward"),
        "impedance": lambda rows: held(rows, "impedance"),
    }
    flat = _flat(rows, "trials")
    table = summary_table("robust: held over the grid", [], ("hand", "what"), columns)
    for name, unit in (("mass", "mass x"), ("friction", "friction x"), ("pose", "pose off by ")):
        for (level,), members in grouped(flat, name).items():
            table.add_row("all", f"{unit}{level}", *(cell(members) for cell in columns.values()))
        table.add_section()
    for (hand,), members in [*grouped(flat, "hand").items(), (("all",), flat)]:
        table.add_row(hand, "whole grid", *(cell(members) for cell in columns.values()))
    return table


def _rate(rows: Rows) -> Table:
    def spent(loops: Rows, name: str) -> list[float]:
        return [ms for loop in loops for ms in loop[name]]

    def above(loops: Rows) -> float:
        whole, bare = (median_of(spent(loops, name)) or 0.0 for name in ("whole_ms", "bare_ms"))
        return whole - bare

    columns: Columns = {
        "n": lambda rows: str(len(rows)),
        "whole": lambda rows: number(median_of(spent(rows, "whole_ms")), 3),
        "fastest": lambda rows: number(min(spent(rows, "whole_ms")), 3),
        "MuJoCo": lambda rows: number(median_of(spent(rows, "bare_ms")), 3),
        "above": lambda rows: number(above(rows), 3),
        "real time": lambda rows: number(
            ratio(rows[0]["step_ms"], median_of(spent(rows, "whole_ms")) or 0.0), 2
        ),
    }
    title = (
        "rate: CPU ms per step of 2 ms on one core; MuJoCo alone; what is above; times real time"
    )
    flat = [
        {"hand": r["hand"], "fingers": r["fingers"], **loop}
        for r in rows
        for loop in r["loops"]
        if not loop["reason"]
    ]
    return summary_table(title, flat, ("hand", "loop", "fingers"), columns)


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
