"""``StateMachine``: which phase of a movement comes next, all transitions in one place.

    state      phases                                          passed            failed, with retry
    ---------  ----------------------------------------------  ----------------  ------------------
    pick       stand, approach, close, squeeze, verify, lift,  turn, hold, use,  end
               wrist                                           hand over
    use        engage, use, withdraw                           hold              end
    hand over  reach, take, transfer, open, retreat            hold              end
    turn       turn                                            regrasp, hold     regrasp, put down
    regrasp    regrasp, once for each finger                   turn              regrasp, put down
    hold       hold                                            place             put down
    place      verify again, back, wrist back, carry, lower,   end               end
               release, open, retreat
    put down   back, wrist back, lower, release, open,         end               end
               retreat

A turn by strokes (a gait) goes on to "regrasp" until the object has turned as far as was asked. A
failure ends the run unless a retry is asked for and the hand still touches the object:

- a turn on one grasp that stalled: the fingers go back to where the motion began, once ("regrasp"),
  and the rest is turned;
- a finger of a gait that could not be lifted: the fingers that are left move on in another order;
- else the object is put down where it is, if it stands there; ``manipulate`` then plans and
  executes the rest of the turn anew;
- else the run ends.

"back" is run only where the ending says that the motion is made backwards, "wrist" where the motion
is made in another attitude of the hand than the grasp, "wrist back" if it is not put down or held
in that one, and "turn" if the object is moved in the fingers. Held at last, it is brought to its
target, and "verify again" is the last phase. A tool that is used is not lifted; it and what was
handed over are held at last, and "hold" is the last phase.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Literal, Protocol, TypeAlias

import numpy as np

from planner.failure import Failure
from planner.motion.manipulation import ManipulationPlan
from planner.motion.phase import Ending, Relocation
from sim.manipulation.timeline import ManipulationPhase, Measured
from sim.report import INTERRUPTED, PhaseResult

State: TypeAlias = Literal[
    "pick", "use", "hand over", "turn", "regrasp", "hold", "place", "put down", "end"
]

PICK: tuple[ManipulationPhase, ...] = ("stand", "approach", "close", "squeeze", "verify", "lift")
DOWN: tuple[ManipulationPhase, ...] = ("lower", "release", "open", "retreat")
USE: tuple[ManipulationPhase, ...] = ("engage", "use", "withdraw")
HAND_OVER: tuple[ManipulationPhase, ...] = ("reach", "take", "transfer", "open", "retreat")
HALF_WAY = "half-way"

CLOSE_TO = float(np.deg2rad(0.4))
"""A turn this near (rad) to its end is made."""

MORE_STROKES = 3
"""Strokes beyond those planned: what was lost in regrasps is made up for."""


@dataclass(frozen=True, kw_only=True)
class PhaseCall:
    """A phase to be run.

    Attributes:
        phase: Which.
        about: Which one of several: a stroke's number, or the finger that moves on; "" of one.
        relocation: How the finger of a regrasp moves on.
        ending: How the object is put down, as far as that is known now.
    """

    phase: ManipulationPhase
    ending: Ending
    about: str = ""
    relocation: Relocation | None = None


class Situation(Protocol):
    """What the machine asks of a run when it chooses a transition."""

    @property
    def left(self) -> float:
        """Turn that is still to be made, rad; negative beyond the goal."""
        ...

    @property
    def touched(self) -> bool:
        """Whether the hand touches the object."""
        ...

    def fingers_back(self) -> tuple[Relocation, ...] | Failure:
        """How all fingers go back to where the motion began; or why they cannot."""
        ...

    def other_order(self, moved: Iterable[str]) -> tuple[Relocation, ...] | Failure:
        """How the fingers that have not moved go on in another order; or why they cannot."""
        ...

    def put_down(self) -> Ending | Failure:
        """How the object is put down where it is; or why it cannot be."""
        ...


class StateMachine:
    """The course of one run.

    Attributes:
        state: Where it is.
        ending: How the object is put down.
        complete: Whether the object was placed as planned.
        put_down: Whether it was put down half-way.
    """

    def __init__(
        self, plan: ManipulationPlan, situation: Situation | None = None, *, retry: bool = False
    ) -> None:
        """Begin with picking.

        Args:
            plan: What is executed.
            situation: Asked when a transition is chosen; None for a use by the hand as a whole, or
                a handover, in which nothing is made up for.
            retry: Whether failures of the turn are made up for.
        """
        self.state: State = "pick"
        self.ending = plan.ending
        self.complete = self.put_down = False
        self._plan, self._situation, self._retry = plan, situation, retry
        self._stroke = 0
        self._went_back = False
        self._moved: list[str] = []
        self._queue: deque[tuple[ManipulationPhase, str, Relocation | None]] = deque()
        pick = PICK if plan.tool is None else PICK[:-1]
        self._enter("pick", *pick, *(("wrist",) if plan.path.turns_wrist else ()))

    def run(
        self, perform: Callable[[PhaseCall], Measured], now: Callable[[], float]
    ) -> Iterator[PhaseResult]:
        """Run all phases, or up to the first that fails and is not made up for.

        Ctrl-C ends it: the last result then has ``INTERRUPTED`` as its reason.

        Args:
            perform: Runs a phase; why it failed, "" if it did not, and its numbers.
            now: Time, s.

        Yields:
            The end of each phase.
        """
        while (call := self.next) is not None:
            begin = now()
            try:
                reason, numbers = perform(call)
            except KeyboardInterrupt:
                reason, numbers = INTERRUPTED, {}
            end = now()
            then = self.failed() if reason not in ("", INTERRUPTED) else ""
            if not reason:
                self.passed()
            yield PhaseResult(
                phase=call.phase,
                about=call.about,
                begin=begin,
                end=end,
                reason=reason,
                numbers=numbers,
                then=then,
            )
            if reason == INTERRUPTED:
                return

    @property
    def next(self) -> PhaseCall | None:
        """The phase to be run now; None at the end."""
        if not self._queue:
            return None
        phase, about, relocation = self._queue[0]
        return PhaseCall(phase=phase, about=about, relocation=relocation, ending=self.ending)

    def passed(self) -> None:
        """The phase was run and passed."""
        _, about, _ = self._queue.popleft()
        if self.state == "regrasp":
            self._moved.append(about)
        if self._queue:
            return
        plan = self._plan
        if self.state == "pick" and plan.tool_use is not None:
            self._enter("use", *USE)
        elif self.state == "pick" and plan.handover is not None:
            self._enter("hand over", *HAND_OVER)
        elif self.state in ("use", "hand over") or (self.state == "pick" and plan.path.stays):
            self._enter("hold", "hold")
        elif self.state in ("pick", "regrasp"):
            self._turn()
        elif self.state == "turn":
            if self._turned:
                self._enter("hold", "hold")
            else:
                self._moved = []
                self._regrasp(self._cycle)
        elif self.state == "hold" and plan.tool is None and plan.handover is None:
            if self.ending.release is None:
                self._enter("place", "carry", "verify again")
            else:
                self._enter("place", "verify again", *self._back, "carry", *DOWN)
        else:
            self.complete = self.state in ("place", "hold")
            self.put_down = self.state == "put down"
            self._enter("end")

    def failed(self) -> str:
        """The phase was run and failed; tells what is done about it, "" if nothing."""
        situation, state = self._situation, self.state
        over = situation is None or not self._retry or state not in ("turn", "regrasp", "hold")
        if situation is None or over or not situation.touched:
            self._enter("end")
            return ""
        moves: tuple[Relocation, ...] | Failure = Failure(kind="turn_over", text="the turn is over")
        if state == "turn":
            moves = self._fingers_back(situation)
        elif state == "regrasp" and self._plan.cycles > 1:
            moves = situation.other_order(self._moved)
        if not isinstance(moves, Failure):
            self._regrasp(moves)
            if state == "turn":
                return "the fingers move on, and it is turned again"
            return "the fingers move on in another order"
        ending = situation.put_down()
        if isinstance(ending, Failure):
            self._enter("end")
            return f"no regrasp ({moves}); it cannot be put down either: {ending}"
        self.ending = ending
        self._enter("put down", *self._back, *DOWN, about=HALF_WAY)
        return f"no regrasp ({moves}); it is put down"

    @property
    def _back(self) -> tuple[ManipulationPhase, ...]:
        back: tuple[ManipulationPhase, ...] = ("back",) if self.ending.back else ()
        returns = self._plan.path.turns_wrist and not self.ending.turned
        return (*back, "wrist back") if returns else back

    @property
    def _cycle(self) -> tuple[Relocation, ...]:
        """How the fingers of a gait move on after a stroke."""
        return self._plan.regrasps

    @property
    def _turned(self) -> bool:
        """Whether no stroke follows: the turn is made, or there were enough of them."""
        cycles = self._plan.cycles
        if self._situation is None or cycles == 1 or self._stroke == cycles + MORE_STROKES:
            return True
        return self._situation.left <= CLOSE_TO

    def _turn(self) -> None:
        self._stroke += 1
        if self._plan.cycles > 1:
            about = f"stroke {self._stroke}"
        else:
            about = "again" if self._went_back else ""
        self._enter("turn", "turn", about=about)

    def _fingers_back(self, situation: Situation) -> tuple[Relocation, ...] | Failure:
        if self._plan.cycles > 1 or self._went_back:
            return Failure(kind="regrasped", text="regrasps were made already")
        if self._plan.ending.back or self._plan.shift.any():
            return Failure(kind="not_repeatable", text="it is to be moved, or turned back")
        moves = situation.fingers_back()
        self._went_back = not isinstance(moves, Failure)
        return moves

    def _regrasp(self, moves: tuple[Relocation, ...]) -> None:
        self.state = "regrasp"
        self._queue = deque(("regrasp", move.finger, move) for move in moves)

    def _enter(self, state: State, *phases: ManipulationPhase, about: str = "") -> None:
        self.state = state
        self._queue = deque((phase, about, None) for phase in phases)
