"""How hard fingers press over a whole manipulation, and how hard they may.

The force programme gives a wanted wrench before anything else. Where friction hardly has it, as
with a torque about the vertical that only tangential forces give, it presses as hard as it may for
the last tenths of a newton: a thumb with 32 N on a soup can of 78 g that the plan holds with 7. So
the controller of a manipulation is told what it may press with, and the verdict looks at what it
pressed with.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from planner.motion.manipulation import ManipulationPlan
from sim.manipulation.log import ManipulationLog

__all__ = ["ASKED_SHARE", "FingerForce", "finger_forces", "force_limit"]

LEAST_ASKED, OVER_PLAN = 12.0, 1.25
"""What the controller may ask of a finger in any case (N), and over the largest planned force (-):
for what was not planned for, pushes and an object beside its place. Plans for 300 g at friction
0.45 press with 4 to 10 N, some of blocks with 16. Of 3 turns of a soup can on a stand by the
Shadow-type hand, asked for 40, 20 and 12 N at most, all held, with peaks of 32, 24 and 15 N."""

ASKED_SHARE = 2.0 / 3.0
"""Share of the limit (-) that the controller asks for at most: what is measured is more by what
springs and movement add, up to 4.5 N of 12 where the object comes down on the table."""


@dataclass(frozen=True, kw_only=True)
class FingerForce:
    """Normal force of one finger on the object.

    Attributes:
        finger: Its name.
        peak: Largest of all time steps, N; 0 if it never touched.
        sustained: Largest mean over the 20 ms between two samples, N.
        mean: Mean over the samples in which it pressed, N.
        peak_time: When the largest sustained force was, s.
    """

    finger: str
    peak: float
    sustained: float
    mean: float
    peak_time: float

    def __str__(self) -> str:
        """One finger in words."""
        return (
            f"{self.finger} {self.sustained:.1f} N at {self.peak_time:.2f} s (mean "
            f"{self.mean:.1f}, one time step {self.peak:.1f})"
        )


def finger_forces(log: ManipulationLog, fingers: tuple[str, ...]) -> tuple[FingerForce, ...]:
    """Forces of all fingers, in the order of the log's columns."""
    out = []
    for i, finger in enumerate(fingers):
        force = log.normal_force[:, i]
        pressed = force[force > 0.0]
        if not len(pressed):
            out.append(FingerForce(finger=finger, peak=0.0, sustained=0.0, mean=0.0, peak_time=0.0))
            continue
        hardest = int(force.argmax())
        out.append(
            FingerForce(
                finger=finger,
                peak=float(log.peak_force[:, i].max()),
                sustained=float(force[hardest]),
                mean=float(np.mean(pressed)),
                peak_time=float(log.time[hardest]),
            )
        )
    return tuple(out)


def force_limit(plan: ManipulationPlan) -> float:
    """Largest normal force (N) that a finger should press with in a manipulation.

    It follows from what the controller may ask for, the plan's own largest force at any knot and
    while any finger moves on, and a quarter more, and never less than 12 N: half as much again.
    """
    motion, gait = plan.motion, plan.gait
    planned = [knot.contacts.forces[:, 0] for knot in motion.knots]
    for move in () if gait is None else gait.relocations:
        planned += [contacts.forces[:, 0] for contacts in (move.before, move.during, move.after)]
    asked = max(LEAST_ASKED, OVER_PLAN * float(np.nanmax(np.concatenate(planned))))
    return asked / ASKED_SHARE
