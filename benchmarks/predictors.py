"""What can be said about a plan beforehand, each as a number that should be large.

All are taken at one friction, so that plans made for different ones compare; a grasp that is not
closed there has epsilon 0 and a min-weight of at most 0.
"""

from __future__ import annotations

import numpy as np

from benchmarks.requests import clearance_of, half_longest_side
from planner.plan import GraspPlan
from planner.quality import analyse
from planner.quality.ball import epsilon_frogger
from planner.task import DEFAULT_MU

PREDICTORS = {
    "min_weight": "normalised min-weight, 8 edges",
    "epsilon": "L1 epsilon, 8 edges, torque over the bounding radius",
    "epsilon_round": "L1 epsilon of the true cones, proven part",
    "epsilon_linf": "L-infinity epsilon of the true cones, proven part",
    "epsilon_frogger": "L1 epsilon, 16 edges of unit length, torque over half the longest side",
    "volume": "volume of the hull of primitive wrenches",
    "least_singular_value": "of the scaled grasp map",
    "isotropy": "least over largest singular value of the scaled grasp map",
    "near_center": "mean contact point's nearness to the centre of mass",
    "n_fingers": "fingers that take part",
    "friction_margin": "share of the friction cone that the planned forces leave free, least",
    "torque_margin": "share of the actuators' limits that the planned forces leave free, least",
    "grip": "least planned normal force over the object's weight",
    "joint_margin": "distance from the nearest joint limit over the joint's range",
    "pad_margin": "angle between contact and edge of the pad, least",
    "clearance": "least distance of what must not touch",
}
"""Names and what they mean."""

LEAST = -1e3
"""What stands for minus infinity, which JSON does not have (-)."""


def predictors_of(plan: GraspPlan) -> dict[str, float]:
    """Every predictor of a plan (-, m or rad), larger is better."""
    task = plan.task
    contacts = plan.contacts.with_friction(DEFAULT_MU)
    radius = task.object.shape.bounding_radius
    report = analyse(contacts, length=radius)
    weight = task.object.mass * float(np.linalg.norm(task.gravity))
    off = np.linalg.norm(contacts.positions.mean(axis=0) - contacts.center)
    half_angles = np.array([f.pad.half_angle for f in task.fingers])
    values = {
        "min_weight": max(LEAST, report.closure.normalised_min_weight),
        "epsilon": report.epsilon,
        "epsilon_round": report.epsilon_round.lower,
        "epsilon_linf": report.epsilon_linf.lower,
        "epsilon_frogger": epsilon_frogger(
            contacts, half_longest_side=half_longest_side(task.object.shape)
        ),
        "volume": report.volume,
        "least_singular_value": report.smallest_singular_value,
        "isotropy": report.isotropy,
        "near_center": 1.0 - off / radius,
        "n_fingers": len(task.fingers),
        "friction_margin": 1.0 - contacts.friction_utilisation().max(),
        "torque_margin": _torque_margin(plan),
        "grip": contacts.forces[:, 0].min() / weight,
        "joint_margin": _joint_margin(plan),
        "pad_margin": (half_angles - plan.verification.pad_angles).min(),
        "clearance": clearance_of(plan),
    }
    return {name: float(values[name]) for name in PREDICTORS}


def _torque_margin(plan: GraspPlan) -> float:
    """1 - max |force / limit on its side|, over the hand's actuators."""
    low, high = plan.task.hand.actuation.force_limits(plan.q).T
    force = plan.forces.actuator_forces
    limit = np.where(force >= 0, high, low)
    with np.errstate(divide="ignore", invalid="ignore"):
        used = np.where(force == 0, 0.0, force / limit)
    return max(LEAST, float(1.0 - used.max()))


def _joint_margin(plan: GraspPlan) -> float:
    """Least distance of a finger's joint from its limits over its range."""
    hand = plan.task.hand
    index = np.concatenate([f.q_index for f in plan.task.fingers])
    q, low, high = plan.q[index], hand.q_lower[index], hand.q_upper[index]
    free = high > low
    return float((np.minimum(q - low, high - q)[free] / (high - low)[free]).min())
