"""Phases of a manipulation, how long they take, and where each one fails."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, TypeAlias

from planner.arrays import check_fields
from sim.controllers import Phase
from sim.verdict import COLLISION_N

ManipulationPhase: TypeAlias = Literal[
    "stand",
    "approach",
    "close",
    "squeeze",
    "verify",
    "lift",
    "turn",
    "hold",
    "verify again",
    "carry",
    "lower",
    "release",
    "open",
    "retreat",
    "regrasp",
    "back",
]
"""A phase of a manipulation."""

PHASES: tuple[ManipulationPhase, ...] = ManipulationPhase.__args__[:-2]  # type: ignore[attr-defined]
"""Phases of a manipulation in order, of one stroke that goes as planned. What else may happen is in
``sim.manipulation.machine``."""

TURNING: tuple[ManipulationPhase, ...] = ("turn", "regrasp", "hold")
"""Phases of the turn."""

IN_THE_AIR: tuple[ManipulationPhase, ...] = ("lift", *TURNING, "verify again", "back", "carry")
"""Phases in which the hand alone carries the object, from the lift to the table."""

CONTROLLER_PHASE: dict[ManipulationPhase, Phase] = {
    "stand": "approach",
    "approach": "approach",
    "close": "close",
    "squeeze": "squeeze",
    "verify": "settle",
    "lift": "lift",
    "turn": "turn",
    "hold": "hold",
    "verify again": "hold",
    "carry": "carry",
    "lower": "lower",
    "release": "release",
    "open": "open",
    "retreat": "retreat",
    "regrasp": "hold",
    "back": "turn",
}
"""What each phase is to a controller."""


@dataclass(frozen=True, kw_only=True)
class ManipulationTimeline:
    """How long each phase takes, s, and how fast and how high it goes.

    Attributes:
        stand: The object stands, the hand waits.
        approach: From the start pose straight to the grasp.
        close: Fingers from pre-grasp to grasp.
        close_wait: Longest further wait for fingers that do not touch yet.
        squeeze: From first touch to the planned forces.
        verify: Full forces, before the lift and after the turn.
        lift: Upwards by ``height``.
        turn_rate: Largest rate of the turn, rad/s.
        turn_wait: Longest wait for the turn beyond the time that the rate takes.
        lift_wait: Longest wait until a finger may be lifted.
        finger_rate: Largest rate of the joints of a finger on its way to where it lands, rad/s.
        land_wait: Longest wait for it to touch there.
        hold: Held still after the turn.
        carry: To above the target.
        lower: Down to the table.
        release: Forces down.
        open: Fingers open.
        retreat: Out.
        height: How far the object is lifted, m.
    """

    stand: float = 0.1
    approach: float = 0.8
    close: float = 0.4
    close_wait: float = 1.0
    squeeze: float = 0.5
    verify: float = 0.2
    lift: float = 0.7
    turn_rate: float = 1.1
    turn_wait: float = 2.5
    lift_wait: float = 0.5
    finger_rate: float = 4.0
    land_wait: float = 0.5
    hold: float = 0.3
    carry: float = 0.8
    lower: float = 0.6
    release: float = 0.3
    open: float = 0.4
    retreat: float = 0.6
    height: float = 0.08

    def __post_init__(self) -> None:
        """Check that every number is positive."""
        check_fields(self, what="timeline: ", above=0.0)


@dataclass(frozen=True, kw_only=True)
class SuccessCriteria:
    """Where a phase fails, and what a success with closure asks for.

    Attributes:
        disturbed_mm: Movement of the object before it is held, mm.
        slip_mm: Movement in the palm while it is lifted, mm.
        angle_deg: How short the turn may be for the run to go on, degrees
            (``sim.manipulation.results.short_of``); and how far heading and tilt may be off at
            last. Success asks for all of the angle.
        tilt_deg: Tilt off the axis of the turn, and before the grip, degrees.
        shift_mm: How far from where it was to be moved in the hand the object may be, mm; asked
            only where it was to be moved.
        place_mm: How far from the target the object may stand at last, mm.
        fingers: Fewest fingers that must touch in the air for a success with closure.
        collision_N: Normal force of the hand on itself, table or obstacle from which on it has
            collided, N, as in trials of grasps.
        normal_N: Largest normal force, N, with which a finger may press on the object for a
            success with closure, as a mean over 20 ms; the controller asks for two thirds of it at
            most. If None it follows from the plan (``sim.manipulation.pressing.force_limit``).
    """

    disturbed_mm: float = 20.0
    slip_mm: float = 5.0
    angle_deg: float = 5.0
    tilt_deg: float = 15.0
    shift_mm: float = 3.0
    place_mm: float = 10.0
    fingers: int = 3
    collision_N: float = COLLISION_N
    normal_N: float | None = None

    def __post_init__(self) -> None:
        """Check that every criterion is positive."""
        check_fields(self, what="success criteria: ", above=0.0, infinite=True)
        check_fields(self, ("fingers",), what="success criteria: ", least=1)
