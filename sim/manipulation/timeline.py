"""Phases of a movement; how long they take in a manipulation, and where each one fails there."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np
import pinocchio as pin

from planner.arrays import check_fields
from planner.motion.plan import WRIST_RATE
from planner.spatial import SE3, FloatArray, rotation_angle, signed_twist
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
    "wrist",
    "wrist back",
    "engage",
    "use",
    "withdraw",
    "reach",
    "take",
    "transfer",
]
"""A phase of a movement."""

PHASES: tuple[ManipulationPhase, ...] = ManipulationPhase.__args__[:14]  # type: ignore[attr-defined]
"""Phases of a manipulation in order, of one stroke that goes as planned. What else may happen is in
``sim.manipulation.machine``."""

TURNING: tuple[ManipulationPhase, ...] = ("turn", "regrasp", "hold")
"""Phases of the turn."""

IN_THE_AIR: tuple[ManipulationPhase, ...] = (
    *("lift", "wrist", *TURNING),
    *("verify again", "back", "wrist back", "carry"),
)
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
    "wrist": "carry",
    "wrist back": "carry",
    "engage": "engage",
    "use": "use",
    "withdraw": "withdraw",
    "reach": "reach",
    "take": "take",
    "transfer": "transfer",
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
        height: How far the object is lifted, m; further where the wrist turns, and longer as much.
        wrist_rate: Mean rate at which the wrist turns to another attitude and back, rad/s.
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
    wrist_rate: float = WRIST_RATE

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
            (``sim.manipulation.timeline.short_of``); and how far heading and tilt may be off at
            last. Success asks for all of the angle.
        tilt_deg: Tilt off the axis of the turn, and before the grip, degrees.
        shift_mm: How far from where it was to be moved in the hand the object may be, mm; asked
            only where it was to be moved.
        place_mm: How far from the target the object may stand at last, mm.
        goal_deg: How far from a goal rotation the object may be at last, degrees.
        fingers: Fewest fingers that must touch in the air for a success with closure.
        collision_N: Normal force of the hand on itself, table or obstacle from which on it has
            collided, N, as in trials of grasps.
        normal_N: Largest normal force, N, with which a finger may press on the object for a
            success with closure, as a mean over 20 ms; the controller asks for two thirds of it at
            most. If None it follows from the plan (``sim.manipulation.log.force_limit``).
    """

    disturbed_mm: float = 20.0
    slip_mm: float = 5.0
    angle_deg: float = 5.0
    tilt_deg: float = 15.0
    shift_mm: float = 3.0
    place_mm: float = 10.0
    goal_deg: float = 5.0
    fingers: int = 3
    collision_N: float = COLLISION_N
    normal_N: float | None = None

    def __post_init__(self) -> None:
        """Check that every criterion is positive."""
        check_fields(self, what="success criteria: ", above=0.0, infinite=True)
        check_fields(self, ("fingers",), what="success criteria: ", least=1)


Measured: TypeAlias = tuple[str, dict[str, float]]
"""Why a phase failed, "" if it did not, and its numbers by name with unit."""

UP: FloatArray = np.array([0.0, 0.0, 1.0])


def short_of(asked: float, turned: FloatArray | float) -> FloatArray:
    """By how much a turn is short of the asked one, in its unit; negative where it went beyond.

    The one rule of all phases and of the verdict: a turn is made from the asked angle on, however
    far it goes beyond, since the hand brings the object to its target from where it is then.
    """
    return np.asarray(np.sign(asked) * (asked - np.asarray(turned)))


def too_short(asked_deg: float, turned_deg: float, criteria: SuccessCriteria) -> str:
    """Why a run does not go on after a turn, in degrees, "" if it does; see ``short_of``.

    Where no turn is asked for, any turn is off by its size.
    """
    short = float(short_of(asked_deg, turned_deg)) if asked_deg else abs(turned_deg)
    if short <= criteria.angle_deg:
        return ""
    told = f"turned {turned_deg:.1f} of {asked_deg:.1f} degrees"
    return f"{told}, {short:.1f} {'short' if asked_deg else 'off'} (at most {criteria.angle_deg:g})"


def undisturbed(first: SE3, now: SE3, criteria: SuccessCriteria) -> Measured:
    """Whether an object that is not held yet stands where it stood."""
    moved = 1e3 * float(np.linalg.norm(now.translation - first.translation))
    tilted = tilt_between(first, now)
    reason = ""
    if moved > criteria.disturbed_mm or tilted > criteria.tilt_deg:
        reason = f"the object was moved by {moved:.1f} mm and tilted by {tilted:.1f} degrees"
    return reason, {"moved_mm": moved, "tilt_deg": tilted}


def off_target(target: SE3, now: SE3) -> dict[str, float]:
    """How far an object is from a target pose."""
    off = now.translation - target.translation
    return {
        "off_mm": 1e3 * float(np.linalg.norm(off[:2])),
        "above_mm": 1e3 * float(off[2]),
        "heading_deg": float(np.rad2deg(signed_twist(now.rotation @ target.rotation.T, UP))),
        "tilt_deg": tilt_between(target, now),
    }


def placed(target: SE3, now: SE3, criteria: SuccessCriteria) -> Measured:
    """Whether an object is where it was to be put."""
    numbers = off_target(target, now)
    reason = ""
    if max(numbers["off_mm"], abs(numbers["above_mm"])) > criteria.place_mm:
        reason = (
            f"the object is {numbers['off_mm']:.1f} mm beside and {numbers['above_mm']:.1f} mm "
            "above its target"
        )
    elif max(abs(numbers["heading_deg"]), numbers["tilt_deg"]) > criteria.angle_deg:
        reason = (
            f"the object is {numbers['heading_deg']:.1f} degrees off its heading and tilted by "
            f"{numbers['tilt_deg']:.1f}"
        )
    return reason, numbers


def at_goal(target: SE3, now: SE3, criteria: SuccessCriteria) -> Measured:
    """Whether an object is turned to its goal."""
    off = float(np.rad2deg(rotation_angle(target.rotation.T @ now.rotation)))
    far = off > criteria.goal_deg
    told = f"the object is {off:.1f} degrees off its goal (at most {criteria.goal_deg:g})"
    return told if far else "", {"goal_off_deg": off}


def where_it_stands(target: SE3, now: SE3) -> SE3:
    """A target where an object is and as it is turned about the vertical, upright and as high.

    An object that is put down half-way is turned further from there.
    """
    heading = signed_twist(now.rotation @ target.rotation.T, UP)
    place = np.array([*now.translation[:2], target.translation[2]])
    return SE3(pin.exp3(heading * UP) @ target.rotation, place)


def tilt_between(first: SE3, now: SE3) -> float:
    """Angle (degrees) between what was vertical in an object and the vertical."""
    axis = now.rotation @ first.rotation.T @ UP
    return float(np.rad2deg(np.arccos(np.clip(axis @ UP, -1.0, 1.0))))
