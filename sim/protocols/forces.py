"""``forces``: gravity from six sides, then forces and torques that grow until the object is lost.

Each load lasts for ``Settings.step_s`` and is ``Settings.growth`` times the one before. The largest
under which the object came to rest and the one under which it was lost are the two ends of the
breaking magnitude. The plan's own weight acts as well. Random directions are uniform on the sphere
of (force, torque / length), the length being the radius of the object's bounding sphere.

``planner.certify`` bounds what contacts can balance with the hand's actuators. A simulation has its
own friction and soft contacts, so each load is compared with two bounds computed with these:
``proven_bound`` holds for the planned posture and its contacts alone; a hand yields and contacts
roll, and the posture that results may bear more. ``near_bound`` holds for all grasps of a
neighbourhood of the planned one, and ``distance_from_plan`` tells whether a hold is in it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from planner.certify import NearBound, Neighbourhood, bound_nearby, breaking_along
from planner.kinematics import HandState
from planner.plan import GraspPlan
from planner.quality import Interval
from planner.spatial import SE3, FloatArray, rotation_angle
from planner.task import GRAVITY
from planner.verification import plan_forces
from sim.creep import with_friction_of
from sim.protocols.disturbance import DisturbanceTrial, Settings
from sim.protocols.outcome import AXES, Conditions, Outcome, axis_of
from sim.scene.physics import PhysicsOptions
from sim.verdict import Fault

G = -GRAVITY[2]
"""Gravity (m/s2) of a task that has none, and what weights are reckoned with."""


@dataclass(frozen=True, kw_only=True)
class GravityCase:
    """A hold with gravity along one of the world's axes.

    Attributes:
        index: Number of the trial.
        axis: Number of the direction in ``AXES``.
        settings: Durations and thresholds.
    """

    index: int
    axis: int
    settings: Settings

    @property
    def name(self) -> str:
        """The direction."""
        return f"gravity {AXES[self.axis]}"

    def run(self, plan: GraspPlan, conditions: Conditions) -> Outcome:
        """Distribute the forces for this gravity, then hold."""
        turned = replace(
            plan.task, gravity=axis_of(self.axis) * (np.linalg.norm(plan.task.gravity) or G)
        )
        forces = plan_forces(turned, plan.contacts, plan.T_world_base, plan.q)
        other = replace(plan, task=turned, forces=forces, contacts=forces.contacts)
        hold = DisturbanceTrial.under(conditions, other, self.settings)
        fault = hold.close_and_squeeze() or hold.hold_for(self.settings.hold_s)
        return hold.outcome(self, fault)


@dataclass(frozen=True, kw_only=True, eq=False)
class PushCase:
    """A load that grows along one direction.

    Attributes:
        index: Number of the trial.
        name: The direction.
        direction: (6,), force and torque over the length, of length 1, world axes.
        settings: Loads and thresholds.
    """

    index: int
    name: str
    direction: FloatArray
    settings: Settings

    def run(self, plan: GraspPlan, conditions: Conditions) -> Outcome:
        """Grip, then load until the object is lost."""
        settings = self.settings
        length = plan.task.object.shape.bounding_radius
        wrench = self.direction * np.array([1.0, 1.0, 1.0, length, length, length])
        only_torque = not self.direction[:3].any()
        unit = length if only_torque else 1.0
        hold = DisturbanceTrial.under(conditions, plan, settings)
        held, failed, before = 0.0, np.inf, 0.0
        stood = None
        fault = hold.close_and_squeeze()
        if fault is None:
            weight = plan.task.object.mass * G
            level = settings.first_load * weight
            while fault is None and level <= settings.most_load * weight:
                fault = _load(hold, wrench, before, level, settings.step_s, unit)
                if fault is not None:
                    failed = level
                elif hold.at_rest():
                    held = level
                    stood = distance_from_plan(
                        plan, hold.simulation.q, hold.simulation.T_base_object
                    )
                before, level = level, settings.growth * level
        else:
            failed = 0.0
        return hold.outcome(
            self,
            fault,
            unit="N m" if only_torque else "N",
            largest_load_held=unit * held,
            failure_load=unit * failed,
            bound=unit * proven_bound(plan, conditions.physics, wrench).upper,
            bound_near=unit * near_bound(plan, conditions.physics, wrench).factor,
            stood=stood,
            wrench=wrench / unit,
        )


def forces_cases(settings: Settings, seed: int) -> tuple[GravityCase | PushCase, ...]:
    """Six of gravity, six of force, six of torque, and the random ones."""
    n = len(AXES)
    gravity = [GravityCase(index=i, axis=i, settings=settings) for i in range(n)]
    named = {}
    for offset, kind in ((0, "force"), (3, "torque")):
        for i, axis in enumerate(AXES):
            named[f"{kind} {axis}"] = np.roll(np.append(axis_of(i), np.zeros(3)), offset)
    rng = np.random.default_rng(seed)
    for k in range(settings.random):
        drawn = rng.normal(size=6)
        named[f"wrench {k}"] = drawn / np.linalg.norm(drawn)
    pushes = [
        PushCase(index=n + i, name=name, direction=direction, settings=settings)
        for i, (name, direction) in enumerate(named.items())
    ]
    return (*gravity, *pushes)


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
    contacts = with_friction_of(plan, physics)
    problem = plan_forces(plan.task, contacts, plan.T_world_base, plan.q).problem
    return breaking_along(problem, np.asarray(wrench))


def near_bound(plan: GraspPlan, physics: PhysicsOptions, wrench: FloatArray) -> NearBound:
    """How many times a wrench any grasp near the planned one can bear, at most.

    Args:
        plan: The grasp; its weight is balanced too.
        physics: Gives friction, sliding and torsional.
        wrench: (6,), N and N m, world axes about the centre of mass; not zero.
    """
    return bound_nearby(plan, np.asarray(wrench), contacts=with_friction_of(plan, physics))


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


def _load(
    hold: DisturbanceTrial,
    wrench: FloatArray,
    before: float,
    level: float,
    duration: float,
    unit: float,
) -> Fault | None:
    """One load: up to it from the one before in half the time, then at rest."""

    def grow(time: float) -> None:
        share = min(1.0, 2.0 * time / duration)
        now = before + share * (level - before)
        hold.load = unit * now
        hold.push(now * wrench)

    return hold.hold_for(duration, each_step=grow)
