"""Tables and screens: every number in its place, and blanks where there is none."""

from __future__ import annotations

import math

from rich.console import Console, ConsoleOptions, RenderResult

from sim import screen, tables

ROWS = [
    {"hand": "a", "object": "box", "held": True, "mm": 1.0},
    {"hand": "a", "object": "ball", "held": False, "mm": 3.0},
    {"hand": "b", "object": "box", "held": True, "mm": 5.0},
]


def lines(table: object) -> list[list[str]]:
    console = Console(width=80, color_system=None)
    with console.capture() as captured:
        console.print(table)
    return [line.split() for line in captured.get().splitlines() if line.strip()]


def test_a_summary_counts_each_group_and_the_total() -> None:
    columns: tables.Columns = {
        "held": lambda rows: tables.share(row["held"] for row in rows),
        "mm": lambda rows: tables.number(sum(row["mm"] for row in rows), 1),
    }
    found = lines(tables.summary_table("title", ROWS, ["hand"], columns, [["all"]]))
    assert ["a", "1/2", "4.0"] in found
    assert ["b", "1/1", "5.0"] in found
    assert found[-1] == ["all", "2/3", "9.0"]


def test_what_is_missing_is_a_dash_or_a_blank() -> None:
    assert tables.number(None, 2) == "-" and tables.number(0.0125, 1, 1e3) == "12.5"
    assert tables.percent(1, 8) == "12.5 %" and tables.percent(0, 0) == "-"
    assert screen.number(math.nan, 2) == "" and screen.number(math.inf, 2, "N") == "-"
    assert screen.number(0.01234, 2, "N") == "0.012 N"
    assert screen.percent(0.125) == "12 %" and screen.percent(math.nan) == ""


class Report(screen.Report):
    """A report with one line."""

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        """The line."""
        yield "held: [bold]yes[/bold]"


def test_a_report_prints_as_plain_text() -> None:
    assert str(Report()) == "held: yes"
