"""What a person sees of ``bench touch``: one table per part, with counts beside every share."""

from __future__ import annotations

from collections.abc import Iterable

from rich.table import Table

from benchmarks.statistics import median_of, quantile_of
from sim.tables import Row, grouped, number, percent, table_of


def touch_tables(result: Row) -> list[Table]:
    """A table per part that has rows."""
    by_part = {part: rows for (part,), rows in grouped(result["rows"], "part").items()}
    out = []
    for part, make in (
        ("arrays", _arrays),
        ("engines", _engines),
        ("turns", _senses),
        ("turns", _slips),
        ("slips", _slips),
        ("slips", _answers),
    ):
        rows = by_part.get(part, [])
        known = [r for r in rows if not r["error"]]
        if known:
            table = make(known)
            if lost := len(rows) - len(known):
                table.caption = f"{lost} of {len(rows)} were not planned"
            out.append(table)
    return out


def _arrays(rows: list[Row]) -> Table:
    title = "arrays: random contacts; median errors (95 % below), and time per pad"
    table = table_of(
        title,
        ("hand",),
        ("spacing mm", "noise", "dead", "place mm", "normal deg", "force", "shear/normal",
         "torsion N mm", "image us", "noise us", "estimate us"),
    )  # fmt: skip
    for row in rows:
        for c in row["cells"]:
            table.add_row(
                row["hand"],
                number(c["spacing_mm"], 0),
                percent(c["noise"], 1, 0),
                f"{c['dead']}/{c['taxels']}",
                _both(c, "place_mm", 2),
                _both(c, "normal_deg", 1),
                _both(c, "force", 1, 100.0, " %"),
                _both(c, "shear", 1, 100.0, " %"),
                _both(c, "torsion_N_mm", 2),
                *(number(c[f"{name}_us"], 0) for name in ("image", "noise", "estimate")),
            )
    return table


def _both(cell: Row, name: str, digits: int, scale: float = 1.0, unit: str = "") -> str:
    middle, most = (number(cell[key], digits, scale) for key in (name, f"{name}_p95"))
    return f"{middle}{unit} ({most})"


def _engines(rows: list[Row]) -> Table:
    title = "engines: a pad of 12 mm pressed on an object, taxels 2 mm apart, no noise"
    table = table_of(
        title, ("object", "sensor"), ("felt", "place mm", "force", "taxels", "us per pad")
    )
    for row in rows:
        times = {one["sensor"]: one["us"] for one in row["times"]}
        for one in row["sensors"]:
            table.add_row(
                one["object"],
                one["sensor"],
                f"{one['felt']}/{one['presses']}",
                number(one["place_mm"], 2),
                "-" if one["force"] is None else percent(one["force"], 1),
                number(one["taxels"], 1),
                number(times.get(one["sensor"].split(",")[0]), 1),
            )
    return table


def _senses(rows: list[Row]) -> Table:
    title = "turns: errors of each sense while objects are turned by 90 degrees; medians of trials"
    table = table_of(
        title,
        ("sense",),
        ("trials", "felt", "place mm", "normal deg", "force", "force vector", "us per step"),
    )
    flat = [one for row in rows for one in row["senses"]]
    for (name,), of_sense in grouped(flat, "sense").items():
        table.add_row(
            name,
            str(len(of_sense)),
            number(_median(of_sense, "felt"), 1, 100.0) + " %",
            number(_median(of_sense, "place_mm"), 2),
            number(_median(of_sense, "normal_deg"), 1),
            number(_median(of_sense, "force"), 1, 100.0) + " %",
            number(_median(of_sense, "force_vector"), 1, 100.0) + " %",
            number(_median(of_sense, "us"), 0),
        )
    return table


def _median(rows: Iterable[Row], name: str) -> float | None:
    return median_of(row[name] for row in rows if row.get(name) is not None)


def _slips(rows: list[Row]) -> Table:
    part = rows[0]["part"]
    title = (
        f"{part}: slips (0.1 mm within 0.1 s) noticed by taxels, time from 0.1 mm to the alarm; "
        "alarms while less than 0.1 mm was slid, and false ones, less than 0.02 mm; friction"
    )
    table = table_of(
        title,
        ("hand", "object"),
        ("trials", "s", "slips", "noticed", "share", "median ms", "90 % ms", "alarms", "early",
         "false", "mu off"),
    )  # fmt: skip
    cells = [*grouped(rows, "hand", "object").items(), (("all", ""), rows)]
    for (hand, item), members in cells:
        seen = [row["slips"] for row in members if row["slips"]]
        delays = [1e3 * d for one in seen for d in one["delays_s"]]
        slips, noticed = (sum(one[k] for one in seen) for k in ("slips", "noticed"))
        table.add_row(
            hand,
            item,
            str(len(members)),
            number(sum(one["seconds"] for one in seen), 0),
            str(slips),
            str(noticed),
            percent(noticed, slips),
            number(median_of(delays), 0),
            number(quantile_of(delays, 0.9), 0),
            *(str(sum(one[k] for one in seen)) for k in ("alarms", "early", "false")),
            number(_median(members, "friction_off"), 0, 100.0) + " %",
        )
    return table


def _answers(rows: list[Row]) -> Table:
    title = "slips: the loop with taxels: alarms, and time until the pad presses a tenth harder"
    table = table_of(title, ("hand",), ("trials", "alarms", "answered", "median ms", "lost"))
    for (hand,), members in grouped(rows, "hand").items():
        times = [1e3 * t for row in members for t in row["answers_s"]]
        table.add_row(
            hand,
            str(len(members)),
            str(sum(row["alarms_in_loop"] for row in members)),
            str(len(times)),
            number(median_of(times), 0),
            f"{sum(row['lost'] for row in members)}/{len(members)}",
        )
    return table
