"""What the certificate says of a simulated disturbance: the most that any control could bear.

``planner.certify`` bounds what a plan's contacts can balance with the hand's actuators under the
friction that was planned with. A simulation has its own friction and soft contacts, so the bounds
here are worked out with these. There are two: ``proven_bound`` holds for the planned posture and
its contacts, and for no other. A hand yields and contacts roll, and what stands there in the end
may bear more. ``near_bound`` holds for all grasps of a neighbourhood of the planned one, and
``distance_from_plan`` tells whether a hold is in it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from planner.certify import NearBound, Neighbourhood, bound_nearby, breaking_along
from planner.contacts import ContactModel, ContactSet
from planner.kinematics.state import HandState
from planner.plan import GraspPlan
from planner.quality import Interval
from planner.spatial import SE3, FloatArray, rotation_angle
from planner.verification.grasp import plan_forces
from sim.physics import PhysicsOptions

__all__ = ["distance_from_plan", "near_bound", "proven_bound"]


def proven_bound(plan: GraspPlan, physics: PhysicsOptions, wrench: FloatArray) -> Interval:
    """How many times a wrench the planned contacts can bear under a simulation's friction.

    Args:
        plan: The grasp; its weight is balanced too.
        physics: Gives friction, sliding and torsional.
        wrench: (6,), N and N m, world axes about the centre of mass; not zero.

    Returns:
        Bounds of the largest factor (-): in the planned posture no control bears more than the
        upper end.
    """
    contacts = _with_friction(plan, physics)
    problem = plan_forces(plan.task, contacts, plan.T_world_base, plan.q).problem
    return breaking_along(problem, np.asarray(wrench))


def near_bound(plan: GraspPlan, physics: PhysicsOptions, wrench: FloatArray) -> NearBound:
    """How many times a wrench any grasp near the planned one can bear, at most.

    Args:
        plan: The grasp; its weight is balanced too.
        physics: Gives friction, sliding and torsional.
        wrench: (6,), N and N m, world axes about the centre of mass; not zero.
    """
    return bound_nearby(plan, np.asarray(wrench), contacts=_with_friction(plan, physics))


def distance_from_plan(plan: GraspPlan, q: FloatArray, T_base_object: SE3) -> Neighbourhood:
    """The smallest neighbourhood of a plan that a posture is in.

    Args:
        plan: The grasp.
        q: Joints (nq,) of the posture; those of fingers that take part count.
        T_base_object: Where the object is in the hand's base.
    """
    hand, fingers = plan.task.hand, plan.task.fingers
    planned = plan.T_world_base.inverse() * plan.task.T_world_object
    now, then = HandState(hand, q), HandState(hand, plan.q)
    mine = np.concatenate([finger.q_index for finger in fingers])
    tips = [np.linalg.norm(now.pad_center(f) - then.pad_center(f)) for f in fingers]
    return Neighbourhood(
        shift=float(np.linalg.norm(T_base_object.translation - planned.translation)),
        turn=float(rotation_angle(planned.rotation.T @ T_base_object.rotation)),
        tips=float(max(tips)),
        joints=float(np.abs(q - plan.q)[mine].max()),
    )


def _with_friction(plan: GraspPlan, physics: PhysicsOptions) -> ContactSet:
    """The planned contacts with the friction of a simulation."""
    soft: ContactModel = "soft"  # MuJoCo's condim 4
    return replace(
        plan.contacts.with_friction(physics.mu, physics.mu_torsion),
        models=(soft,) * len(plan.contacts),
    )
