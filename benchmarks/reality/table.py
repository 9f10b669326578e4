"""``reality_tables``: rates with their intervals, reasons of failures, and numbers."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator

from rich.table import Table

from benchmarks.statistics import wilson
from sim.tables import Row, grouped, number, table_of

NUMBERS = {
    "off_deg": ("off deg", 1),
    "tilt_deg": ("tilt deg", 1),
    "pose_mm": ("estimate off mm", 1),
    "pose_deg": ("estimate off deg", 1),
    "within_two_sigma": ("within 2 sigma", 2),
    "slip_mm": ("slip mm", 1),
    "slip_deg": ("slip deg", 1),
    "pushes_survived": ("pushes", 0),
    "planning_cpu_s": ("planning CPU s", 1),
    "simulation_cpu_s": ("trial CPU s", 1),
}
"""Name of a number -> its column and its digits."""


def reality_tables(result: Row) -> Iterator[Table | str]:
    """A table of rates for each task, then the reasons, then the numbers."""
    for name, about in result["loops"].items():
        yield f"{name}: {about}."
    for task, about in result["tasks"].items():
        cells = [cell for cell in result["cells"] if cell["task"] == task]
        if cells:
            yield _rates(about, cells, list(result["loops"]))
    yield _reasons(result["cells"])
    yield _numbers(result["numbers"])


def _rates(about: str, cells: list[Row], loops: list[str]) -> Table:
    title = f"{about}: successes out of all trials, in percent the 95 % interval of Wilson"
    table = table_of(title, ("reality", "hand"), loops)
    for (reality,), of_reality in grouped(cells, "reality").items():
        hands = grouped(of_reality, "hand")
        for (hand,), members in hands.items():
            table.add_row(reality, hand, *_columns(members, loops))
        if len(hands) > 1:
            table.add_row(reality, "all", *_columns(of_reality, loops))
        table.add_section()
    return table


def _columns(cells: list[Row], loops: Iterable[str]) -> list[str]:
    return [_rate([cell for cell in cells if cell["loop"] == loop]) for loop in loops]


def _rate(cells: list[Row]) -> str:
    n = sum(cell["n"] for cell in cells)
    if n == 0:
        return "-"
    held = sum(cell["success"] for cell in cells)
    low, high = wilson(held, n)
    return f"{held}/{n} ({100 * low:.0f}-{100 * high:.0f})"


def _reasons(cells: list[Row]) -> Table:
    """What the other trials came to; a trial without a plan stands there too."""
    table = table_of("reasons of failures, counted", ("task", "reality", "loop", "reasons"), ())
    for name, members in grouped(cells, "task", "reality", "loop").items():
        counts: Counter[str] = Counter()
        for cell in members:
            counts.update(cell["reasons"])
        if counts:
            told = ", ".join(f"{reason} {count}" for reason, count in counts.most_common())
            table.add_row(*name, told)
    return table


def _numbers(rows: list[Row]) -> Table:
    """Medians over all trials, failures included."""
    table = table_of(
        "medians over all trials, also those that failed; CPU of one core",
        ("task", "reality", "loop"),
        [head for head, _ in NUMBERS.values()],
    )
    for row in rows:
        shown = [number(row.get(what), digits) for what, (_, digits) in NUMBERS.items()]
        table.add_row(row["task"], row["reality"], row["loop"], *shown)
    return table
