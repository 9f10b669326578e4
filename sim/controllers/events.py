"""``Event``: what a controller noticed or did, and when."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, TypeAlias

__all__ = ["Event", "EventKind"]

EventKind: TypeAlias = Literal[
    "contact lost",
    "contact found",
    "slip",
    "infeasible",
    "feasible again",
    "finger leaves",
    "finger joins",
    "gave up",
]
"""What there is to notice. "infeasible" means that no contact forces give the wanted wrench."""


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
