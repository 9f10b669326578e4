"""``InfeasibilityMonitor``: when a wrench that no forces give is noted, and when it is given up."""

from __future__ import annotations

from sim.controllers.events import EventKind

__all__ = ["InfeasibilityMonitor"]

MISSED_TOL = 0.05
"""A wrench counts as missed when more than this share of it, or this many N, is left over."""

GIVING_TOL = 0.002
"""The least normal forces give way when more than this share of a wrench, or this many N, is left
over: the wrench comes before the grip. Residuals of the force programme are a thousandth of it."""

LEAST_GIVEN, GIVING_TIME, TAKING_TIME = 0.1, 0.05, 0.5
"""While a wrench is missed the least normal forces give way to this share of them, as fast as all
of them would in the first time (s), and come back in the second: a finger that must press where
its force cannot be balanced is itself what is in the way. After a slip too: the larger grip that it
brought is for the time when there is force to spare."""

INFEASIBLE_TIME, PATIENCE = 0.006, 0.5
"""How long (s) a wrench must be missed to be called infeasible, and to give up."""


class InfeasibilityMonitor:
    """How long a wrench has been missed, and what follows from it.

    Attributes:
        missed: Share of the last wrench that is missed (-).
        given: Share of the least normal forces that is asked for (-).
        gave_up: Why it gave up, "" while it has not; "" again when it is over.
    """

    def __init__(self, needed: int) -> None:
        """For a grasp that this many fingers can hold."""
        self.missed, self.given, self.gave_up = 0.0, 1.0, ""
        self._needed = needed
        self._missed_for = self._few_for = 0.0

    def update(
        self, elapsed: float, *, short: float, asked: float, holding: int
    ) -> list[tuple[EventKind, str]]:
        """Take over a step; returns what is to be noted.

        Args:
            elapsed: Since the last step, s.
            short: Size of what is left over of the wrench, N.
            asked: Size of the wrench, N.
            holding: Fingers that hold.
        """
        self.missed = short / max(1.0, asked)
        wanting = self.missed > MISSED_TOL
        rate = -1.0 / GIVING_TIME if self.missed > GIVING_TOL else 1.0 / TAKING_TIME
        self.given = min(1.0, max(LEAST_GIVEN, self.given + elapsed * rate))
        before = self._missed_for
        self._missed_for = before + elapsed if wanting else 0.0
        few = holding < self._needed
        self._few_for = self._few_for + elapsed if few else 0.0
        notes: list[tuple[EventKind, str]] = []
        detail = f"{short:.2f} N of {asked:.2f} N cannot be had"
        if before < INFEASIBLE_TIME <= self._missed_for:
            notes.append(("infeasible", f"{detail}; the nearest forces are given"))
        if before >= INFEASIBLE_TIME and self._missed_for == 0.0:
            notes.append(("feasible again", f"after {before:.3f} s"))
        if self.gave_up and (wanting or few):
            return notes
        self.gave_up = ""
        if self._few_for > PATIENCE:
            self.gave_up = f"only {holding} fingers hold, for {PATIENCE} s"
        elif self._missed_for > PATIENCE:
            self.gave_up = f"{detail}, for {PATIENCE} s"
        if self.gave_up:
            notes.append(("gave up", self.gave_up))
        return notes
