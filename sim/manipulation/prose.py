"""Parts of a manipulation's report in words: contact modes, forces, and what was noticed."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from planner.spatial import IntArray
from sim.controllers import Event
from sim.manipulation.pressing import FingerForce

__all__ = ["told_events", "told_forces", "told_modes"]

MODE_LETTERS = 60
"""Letters in which the contact modes of a turn are told, about."""

AS_TOLD = ("finger leaves", "finger joins")
"""Events that a regrasp brings about, one for each phase that is told anyway."""

LETTERS = (("stick", "s"), ("roll", "r"), ("slip", "S"), ("break", "!"), ("off", "-"))
"""One for each mode."""


def told_events(events: Sequence[Event]) -> list[str]:
    """One line for each kind and finger, in order of the first; what was told to do is left out."""
    alike: dict[tuple[str, str], list[Event]] = {}
    for event in events:
        if event.kind not in AS_TOLD:
            alike.setdefault((event.kind, event.finger), []).append(event)
    lines = []
    for (kind, finger), same in alike.items():
        times = f" {len(same)} times up to {same[-1].time:.2f} s, first" if len(same) > 1 else ""
        first = f"{same[0].time:.2f} s {kind} {finger}".rstrip()
        lines.append(f"{first}{times}: {same[0].detail}")
    return lines


def told_modes(
    fingers: Sequence[str],
    planned: NDArray[np.str_],
    measured: NDArray[np.str_],
    turning: IntArray,
) -> list[str]:
    """Contact modes of each finger while the object is turned, planned above measured.

    Args:
        fingers: Names of n fingers.
        planned: (m, n), modes of all samples.
        measured: (m, n), likewise.
        turning: Numbers of the samples of the turn.
    """
    index = turning[:: max(1, len(turning) // MODE_LETTERS)]
    lines = [f"contact modes during the turn ({', '.join(f'{v} {k}' for k, v in LETTERS)}):"]
    width = max(len(f) for f in fingers)
    for i, finger in enumerate(fingers):
        for name, modes in (("planned", planned), ("measured", measured)):
            row = "".join(dict(LETTERS)[str(m)] for m in modes[index, i])
            lines.append(f"  {finger:<{width}} {name:<8} {row}")
    return lines


def told_forces(forces: Sequence[FingerForce], limit: float) -> list[str]:
    """How hard each finger pressed, and how hard it may."""
    head = f"normal forces, largest mean over 20 ms (at most {limit:.1f} N):"
    return [head, *(f"  {force}" for force in forces)]
