"""Run a script or a command as it is, film its last simulation, and keep the page of it.

    python -m benchmarks.filming FOLDER SCRIPT
    python -m benchmarks.filming FOLDER opposable ARGUMENTS...

FOLDER then holds ``film.webp`` and ``page.html`` of the last trial or manipulation; of a run that
only plans, those of its last plan, which is held in a trial of its own.
"""

from __future__ import annotations

import runpy
import sys
from collections.abc import Callable
from functools import wraps
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any

import planner.search.grasp
from sim.manipulation.run import ManipulationRun
from sim.trial import Trial, simulate

FILM, PAGE = "film.webp", "page.html"
"""Files that a run leaves."""


def watch(folder: Path, arguments: list[str]) -> None:
    """Run and film.

    Args:
        folder: Where film and page go.
        arguments: A script, or "opposable" and its arguments.
    """
    plans: list[Any] = []
    shown: list[Any] = []
    _film(Trial, "run", folder, shown)
    _film(ManipulationRun, "perform", folder, shown)
    _keep_plans(plans)
    try:
        if arguments[0] == "opposable":
            (program,) = entry_points(group="console_scripts", name="opposable")
            sys.argv = arguments
            program.load()()
        else:
            sys.argv = arguments
            sys.path.insert(0, str(Path(arguments[0]).parent))
            runpy.run_path(arguments[0], run_name="__main__")
    finally:
        if plans and not shown:
            simulate(plans[-1])
            shown[:] = plans[-1:]
        if shown:
            shown[-1].save_html(folder / PAGE)


def _film(owner: Any, method: str, folder: Path, shown: list[Any]) -> None:
    """Let a method that simulates film and leave its report."""
    original: Callable[..., Any] = getattr(owner, method)

    @wraps(original)
    def filmed(self: Any, **options: Any) -> Any:
        report = original(self, **{**options, "video": folder / FILM})
        shown.append(report)
        return report

    setattr(owner, method, filmed)


def _keep_plans(plans: list[Any]) -> None:
    """Note what ``plan_grasp`` finds."""
    home: Any = planner.search.grasp
    original = home.search

    @wraps(original)
    def noted(*arguments: Any, **options: Any) -> Any:
        plan, made = original(*arguments, **options)
        if plan is not None:
            plans.append(plan)
        return plan, made

    home.search = noted


if __name__ == "__main__":
    watch(Path(sys.argv[1]).absolute(), sys.argv[2:])
