"""``PhaseResult``: what a phase of a manipulation ended in, and the checks before and after."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from planner.spatial import SE3, FloatArray, signed_twist
from sim.manipulation.timeline import ManipulationPhase, SuccessCriteria

Measured: TypeAlias = tuple[str, dict[str, float]]
"""Why a phase failed, "" if it did not, and its numbers by name with unit."""

UP: FloatArray = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True, kw_only=True)
class PhaseResult:
    """The end of one phase.

    Attributes:
        phase: Which.
        about: Which one of several: a stroke's number, or the finger that moves on; "" of one.
        begin: When it began, s.
        end: When it ended, s.
        reason: Why it failed, "" if it did not.
        numbers: What was looked at, by name with unit.
        then: What was tried after a failure, and what came of that; "" if nothing was.
    """

    phase: ManipulationPhase
    begin: float
    end: float
    reason: str
    numbers: dict[str, float]
    about: str = ""
    then: str = ""

    @property
    def passed(self) -> bool:
        """Whether the phase ended as it should."""
        return not self.reason

    def __str__(self) -> str:
        """One line."""
        told = ", ".join(f"{name} {value:.3g}" for name, value in self.numbers.items())
        mark = "ok  " if self.passed else "FAIL"
        name = f"{self.phase} {self.about}".strip()
        line = f"{mark} {name:<15}{self.end - self.begin:5.2f} s  {told}"
        if self.reason:
            line += f"\n     {self.reason}"
        return f"{line}\n     then: {self.then}" if self.then else line


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


def tilt_between(first: SE3, now: SE3) -> float:
    """Angle (degrees) between what was vertical in an object and the vertical."""
    axis = now.rotation @ first.rotation.T @ UP
    return float(np.rad2deg(np.arccos(np.clip(axis @ UP, -1.0, 1.0))))
