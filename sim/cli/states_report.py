"""What a person sees of ``opposable states``: a bar while it runs, a table when it is done."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.table import Table

from sim.progress import ProgressBar
from sim.tables import table_of

if TYPE_CHECKING:
    from sim.reset_states import StatesProgress


class StatesBar(ProgressBar):
    """The bar of each phase, with rate and share kept; use it as a context."""

    def __init__(self, console: Console) -> None:
        """A bar on a console."""
        super().__init__(console)
        self._states: dict[str, int] = {}

    def told(self, now: StatesProgress) -> None:
        """Show how far a run is."""
        note = ""
        if now.phase == "holding":
            self._states[now.cell] = now.done
            fresh = now.done - now.before
            rate = fresh / now.elapsed_s if now.elapsed_s > 0 else 0.0
            note = f"{rate:.1f}/s, kept {100 * now.done / max(1, now.tried):.0f} %"
        self.show(f"{now.phase} {now.cell}", now.done, now.total, note)

    def kept(self) -> str:
        """How much is kept, in words."""
        if not self._states:
            return "what was planned is kept"
        return f"{sum(self._states.values())} states are kept"


def states_table(summary: dict[str, Any]) -> Table:
    """A row per object and size, of the content of ``summary.json``."""
    table = table_of(
        f"{summary['hand']}: stable states",
        ("object", "commonest loss"),
        ("states", "kept", "CPU ms/state", "orientations covered", "gravity covered"),
    )
    for cell in summary["cells"]:
        states = f"{cell['states']}/{cell['asked']}"
        if not cell["tried"]:
            reasons = cell["plans"]["reasons"]
            table.add_row(cell["name"], next(iter(reasons), ""), states, "", "", "", "")
            continue
        lost = next(iter(cell["lost"].items()), ("", 0))
        covered = cell.get("coverage", {})
        shares = [
            f"{covered[key]['reached']}/{covered[key]['cells']}" if covered else ""
            for key in ("orientations_of_object_in_palm", "directions_of_gravity_in_palm")
        ]
        table.add_row(
            cell["name"],
            f"{lost[1]} {lost[0].split(':')[0]}" if lost[1] else "",
            states,
            f"{100 * cell['rate_kept']:.1f} %",
            f"{1e3 * cell['hold_cpu_s_per_state']:.1f}",
            *shares,
        )
    return table
