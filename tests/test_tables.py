"""Tables and screens: blanks and dashes where there is no number."""

from __future__ import annotations

import math
from typing import Any

import pytest
from rich.console import Console, ConsoleOptions, RenderResult

from sim import screen, tables


def test_what_is_missing_is_a_dash_or_a_blank() -> None:
    assert tables.number(None, 2) == "-" and tables.number(0.0125, 1, 1e3) == "12.5"
    assert tables.percent(1, 8) == "12.5 %" and tables.percent(0, 0) == "-"
    assert screen.number(math.nan, 2) == "" and screen.number(math.inf, 2, "N") == "-"
    assert screen.number(0.01234, 2, "N") == "0.012 N"
    assert screen.percent(0.125) == "12 %" and screen.percent(math.nan) == ""


class Report(screen.Report):
    """A report with one line."""

    success = True

    def to_dict(self) -> dict[str, bool]:
        return {"success": self.success}

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        """The line."""
        yield "held: [bold]yes[/bold]"


def test_a_report_prints_as_plain_text() -> None:
    assert str(Report()) == "held: yes"


def test_a_report_without_a_verdict_is_none() -> None:
    unfinished: Any = screen.Report
    with pytest.raises(TypeError, match="success"):
        unfinished()
