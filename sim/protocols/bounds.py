"""What the certificate says of a simulated disturbance: the most that any control could bear.

``planner.certify`` bounds what a plan's contacts can balance with the hand's actuators under the
friction that was planned with. A simulation has its own friction and soft contacts, so the bound
here is worked out with these. It holds for the planned contacts: where a hand yields, contacts
move, and what moved is another grasp.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from planner.certify import breaking_along
from planner.contacts import ContactModel
from planner.judge import plan_forces
from planner.plan import GraspPlan
from planner.quality import Interval
from planner.spatial import FloatArray
from sim.physics import PhysicsOptions

__all__ = ["proven_bound"]


def proven_bound(plan: GraspPlan, physics: PhysicsOptions, wrench: FloatArray) -> Interval:
    """How many times a wrench the planned contacts can bear under a simulation's friction.

    Args:
        plan: The grasp; its weight is balanced too.
        physics: Gives friction, sliding and torsional.
        wrench: (6,), N and N m, world axes about the centre of mass; not zero.

    Returns:
        Bounds of the largest factor (-): no control bears more than the upper end.
    """
    soft: ContactModel = "soft"  # MuJoCo's condim 4
    contacts = replace(
        plan.contacts.with_friction(physics.mu, physics.mu_torsion),
        models=(soft,) * len(plan.contacts),
    )
    problem = plan_forces(plan.task, contacts, plan.T_world_base, plan.q).problem
    return breaking_along(problem, np.asarray(wrench))
