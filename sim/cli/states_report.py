"""What a person sees of ``opposable states``: a bar while it runs, a table when it is done."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Self

from rich import box
from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.table import Table

if TYPE_CHECKING:
    from sim.reset_states import StatesProgress

__all__ = ["StatesBar", "states_table"]


class StatesBar:
    """A progress bar with rate and time left; use it as a context."""

    def __init__(self, console: Console) -> None:
        """A bar on a console; nothing is drawn where that is no terminal."""
        self._progress = Progress(
            TextColumn("{task.fields[phase]} {task.fields[cell]}"),
            BarColumn(),
            MofNCompleteColumn(),
            TextColumn("{task.fields[note]}"),
            TimeElapsedColumn(),
            TextColumn("left"),
            TimeRemainingColumn(),
            console=console,
            disable=not console.is_terminal,
            transient=True,
        )
        self._bar: Any = None
        self._at: tuple[str, str] | None = None
        self._states: dict[str, int] = {}

    def __enter__(self) -> Self:
        """Start drawing."""
        self._progress.start()
        return self

    def __exit__(self, *_: object) -> None:
        """Stop drawing."""
        self._progress.stop()

    def show(self, now: StatesProgress) -> None:
        """Show how far a run is; every phase has its own bar."""
        note = ""
        if now.phase == "holding":
            self._states[now.cell] = now.done
            fresh = now.done - now.before
            rate = fresh / now.elapsed_s if now.elapsed_s > 0 else 0.0
            note = f"{rate:.1f}/s, kept {100 * now.done / max(1, now.tried):.0f} %"
        if self._at != (now.cell, now.phase):
            if self._bar is not None:
                self._progress.remove_task(self._bar)
            self._at = now.cell, now.phase
            self._bar = self._progress.add_task(
                "", total=now.total, cell=now.cell, phase=now.phase, note=note
            )
        self._progress.update(self._bar, completed=now.done, note=note)

    def kept(self) -> str:
        """How much is kept, in words."""
        if not self._states:
            return "what was planned is kept"
        return f"{sum(self._states.values())} states are kept"


def states_table(summary: dict[str, Any]) -> Table:
    """A row per object and size, of the content of ``summary.json``."""
    table = Table(box=box.SIMPLE, title=f"{summary['hand']}: stable states")
    for name in ("object", "states", "kept", "commonest loss", "CPU ms/state"):
        table.add_column(name, justify="left" if name in ("object", "commonest loss") else "right")
    for name in ("orientations", "gravity"):
        table.add_column(f"{name} covered", justify="right")
    for cell in summary["cells"]:
        row = [cell["name"], f"{cell['states']}/{cell['asked']}"]
        if not cell["tried"]:
            reasons = cell["plans"]["reasons"]
            table.add_row(*row, "", next(iter(reasons), ""), "", "", "")
            continue
        lost = next(iter(cell["lost"].items()), ("", 0))
        covered = cell.get("coverage", {})
        shares = [
            f"{covered[key]['reached']}/{covered[key]['cells']}" if covered else ""
            for key in ("orientations_of_object_in_palm", "directions_of_gravity_in_palm")
        ]
        table.add_row(
            *row,
            f"{100 * cell['rate_kept']:.1f} %",
            f"{lost[1]} {lost[0].split(':')[0]}" if lost[1] else "",
            f"{1e3 * cell['hold_cpu_s_per_state']:.1f}",
            *shares,
        )
    return table
