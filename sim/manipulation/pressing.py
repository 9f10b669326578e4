"""How hard fingers press over a whole manipulation, and how hard they may.

The force programme puts the wanted wrench first. Where friction hardly suffices, as for a torque
about the vertical by tangential forces alone, it presses as hard as allowed for the last tenths of
a newton. So the controller of a manipulation has a limit, and the verdict checks measured forces.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from planner.motion.manipulation import ManipulationPlan
from sim.manipulation.log import ManipulationLog

LEAST_LIMIT, OVER_PLAN = 18.0, 1.875
"""Normal force with which a finger may press in any case (N), and over the plan's largest (-): a
margin for pushes and pose errors, and for what springs and movement add to what is asked. The
verdict's; no constant of a controller moves it."""

ASKED_SHARE = 2.0 / 3.0
"""Share of the limit (-) that the controller asks for at most: springs and
movement add to the measured force, most where the object comes down on the table. The
controller's; tuning it leaves the verdict as it is."""


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
    """Largest normal force (N) with which a finger may press in a manipulation: the judge's.

    It follows from the plan's own largest force at any knot and while any finger moves on.
    """
    motion, gait = plan.motion, plan.gait
    planned = [knot.contacts.forces[:, 0] for knot in motion.knots]
    for move in () if gait is None else gait.relocations:
        planned += [contacts.forces[:, 0] for contacts in (move.before, move.during, move.after)]
    return max(LEAST_LIMIT, OVER_PLAN * float(np.nanmax(np.concatenate(planned))))
