"""The part ``push``: a growing load until the object is lost, under either controller.

Feedforward control is measured twice: with the planned grip, and with the best grip that the plan's
force problem allows. Impedance control starts from the planned grip and raises it as needed. All
meet the same direction of load.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from planner.arrays import finite
from planner.plan import GraspPlan
from planner.spatial import FloatArray
from planner.verification.grasp import with_grip
from sim.controllers import CONTROLLERS
from sim.physics import PhysicsOptions
from sim.protocols.disturbance import Settings
from sim.protocols.forces import PushCase
from sim.protocols.outcome import Conditions, Outcome
from sim.reality import Reality

GRIPS = 3
"""Grips tried between the planned and the largest feasible one (-)."""

MOST_GRIP = 16.0
"""Search limit for the grip, in planned grips (-): 24 N for a planned 1.5 N, more than the fingers
of any hand in the catalogue can press."""

GRIP_TOL = 0.05
"""Relative width at which the search for the largest grip ends (-)."""


def push_row(plan: GraspPlan, rng: np.random.Generator, reality: Reality) -> dict[str, Any]:
    """A force and a torque in random directions that grow until the object is lost.

    "feedforward" presses with the planned forces, "best" with those of the grip out of
    ``tried_grips`` under which the most is borne, chosen afterwards and for each direction: no rule
    that chooses a grip beforehand does better. "impedance" presses with no less than the plan's
    grip while there is force to spare.
    """
    settings = Settings()
    grips = tried_grips(plan)
    pressed = [plan, *(with_grip(plan, grip) for grip in grips[1:])]
    pushes = []
    for kind, offset in (("force", 0), ("torque", 3)):
        direction = np.zeros(6)
        direction[offset : offset + 3] = unit(rng)
        case = PushCase(index=0, name=kind, direction=direction, settings=settings)
        opened = [case.run(tight, conditions("feedforward", reality)) for tight in pressed]
        closed = case.run(plan, conditions("impedance", reality))
        best = max(range(len(grips)), key=lambda k: opened[k].largest_load_held)
        pushes.append(
            {
                "kind": kind,
                "direction": direction.tolist(),
                "lost_mm": settings.dropped.mm,
                "lost_deg": settings.dropped.deg,
                "feedforward": _told(opened[0]),
                "best": _told(opened[best]) | {"grip_N": grips[best]},
                "impedance": _told(closed),
                **finite(
                    {"bound": closed.bound, "bound_near": closed.bound_near, "unit": closed.unit}
                ),
            }
        )
    return {"pushes": pushes, "grips_N": grips}


def tried_grips(plan: GraspPlan) -> list[float]:
    """Grips (N): the planned one, then ``GRIPS`` evenly up to the largest feasible, if any."""
    first, most = plan.task.grip_force, largest_grip(plan)
    if most <= (1.0 + GRIP_TOL) * first:
        return [first]
    return [float(g) for g in np.linspace(first, most, GRIPS + 1)]


def largest_grip(plan: GraspPlan) -> float:
    """Largest minimum normal force (N) for which the plan's force problem is feasible."""
    low = plan.task.grip_force
    high = MOST_GRIP * low
    if with_grip(plan, high).forces.found:
        return high
    while high - low > GRIP_TOL * high:
        middle = 0.5 * (low + high)
        if with_grip(plan, middle).forces.found:
            low = middle
        else:
            high = middle
    return low


def unit(rng: np.random.Generator) -> FloatArray:
    """A direction (3,), uniform on the sphere."""
    drawn = rng.normal(size=3)
    return np.asarray(drawn / np.linalg.norm(drawn))


def conditions(loop: str, reality: Reality | None = None) -> Conditions:
    """Default physics with a controller by name, under a reality."""
    return Conditions(
        physics=PhysicsOptions(), controller=CONTROLLERS[loop], reality=reality or Reality()
    )


def _told(outcome: Outcome) -> dict[str, Any]:
    return dict(
        finite(
            {
                "borne": outcome.largest_load_held,
                "broke": outcome.failure_load,
                "reason": outcome.reason,
            }
        )
    )
