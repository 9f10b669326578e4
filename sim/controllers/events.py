"""``Event``: what a controller noticed or did, and when; and many of them in words."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, TypeAlias

EventKind: TypeAlias = Literal[
    "contact lost",
    "contact found",
    "slip",
    "infeasible",
    "feasible again",
    "finger leaves",
    "finger joins",
    "gave up",
    "pose lost",
    "pose known again",
]
"""What there is to notice. "infeasible" means that no contact forces give the wanted wrench; "pose
lost" that an estimator no longer knows where the object is."""


@dataclass(frozen=True, kw_only=True)
class Event:
    """One thing that a controller noticed, and what it did.

    Attributes:
        time: When, s since the start of the trial.
        kind: What.
        finger: Whose, "" if it concerns the whole grasp.
        detail: The numbers, and the reaction, in words.
    """

    time: float
    kind: EventKind
    finger: str = ""
    detail: str = ""


AS_TOLD: tuple[EventKind, ...] = ("finger leaves", "finger joins")
"""Events that a caller brings about: it knows of them anyway."""


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
