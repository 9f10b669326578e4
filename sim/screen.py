"""Reports as a screen that a person reads: the one place of their numbers."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from io import StringIO
from typing import Any

from rich.console import Console

from planner.arrays import short_repr

__all__ = ["Report", "error_lines", "number", "percent"]

WIDTH = 100
"""Characters of a line of a report that is printed as text."""


class Report(ABC):
    """What every report has: a verdict, a form as plain data, and a screen.

    ``__rich_console__`` says what stands on the screen.
    """

    @property
    @abstractmethod
    def success(self) -> bool:
        """Whether what was asked for was reached."""

    @abstractmethod
    def to_dict(self) -> dict[str, Any]:
        """Plain data for JSON; what is not a finite number becomes None."""

    def __str__(self) -> str:
        """The screen as plain text."""
        console = Console(width=WIDTH, file=StringIO(), color_system=None, highlight=False)
        with console.capture() as captured:
            console.print(self)
        return "\n".join(line.rstrip() for line in captured.get().splitlines())

    def __repr__(self) -> str:
        """One line: the kind, and the first line of the screen."""
        return short_repr(self)


def number(value: float, digits: int, unit: str = "") -> str:
    """Significant digits and unit; "" for NaN, "-" for what is infinite."""
    if math.isnan(value):
        return ""
    return f"{value:.{digits}g} {unit}".rstrip() if math.isfinite(value) else "-"


def percent(value: float) -> str:
    """A share in percent; "" for NaN."""
    return "" if math.isnan(value) else f"{100 * value:.0f} %"


def error_lines(error_model: Mapping[str, Any] | None) -> list[str]:
    """The error model of a report in lines: name, seed, estimator, pads; and what was drawn.

    Args:
        error_model: ``error_model`` of a report; None where all was as believed.
    """
    if error_model is None:
        return []
    touch = error_model.get("touch", "exact")
    pads = "" if touch == "exact" else f", pads: {touch}"
    lines = [
        f"error model: {error_model['name']}, seed {error_model['seed']}, "
        f"estimator: {error_model.get('estimator', 'none')}{pads}"
    ]
    if drawn := error_model.get("drawn_in_words"):
        lines.append(f"drawn: {drawn}")
    return lines
