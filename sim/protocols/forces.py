"""``forces``: gravity from six sides, then forces and torques that grow until the object is lost.

Each load lasts for ``Settings.step_s`` and is ``Settings.growth`` times the one before. The largest
under which the object came to rest and the one under which it was lost are the two ends of the
breaking magnitude. The plan's own weight acts as well. Random directions are uniform on the sphere
of (force, torque / length), the length being the radius of the object's bounding sphere.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from planner.plan import GraspPlan
from planner.spatial import FloatArray
from planner.task import GRAVITY
from planner.verification.grasp import plan_forces
from sim.protocols.bounds import distance_from_plan, near_bound, proven_bound
from sim.protocols.cases import AXES, Conditions, axis_of
from sim.protocols.disturbance import DisturbanceTrial
from sim.protocols.outcome import Outcome
from sim.protocols.settings import Settings
from sim.verdict import Fault

__all__ = ["GravityCase", "PushCase", "forces_cases"]

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
        hold = DisturbanceTrial(
            other,
            controller=conditions.controller(other),
            physics=conditions.physics,
            dropped=self.settings.dropped,
        )
        fault = hold.close_and_squeeze() or hold.hold_for(self.settings.hold_s)
        return _outcome(self.index, self.name, hold, fault)


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
        hold = DisturbanceTrial(
            plan,
            controller=conditions.controller(plan),
            physics=conditions.physics,
            dropped=settings.dropped,
        )
        borne, broke, before = 0.0, np.inf, 0.0
        stood = None
        fault = hold.close_and_squeeze()
        if fault is None:
            weight = plan.task.object.mass * G
            level = settings.first_load * weight
            while fault is None and level <= settings.most_load * weight:
                fault = _load(hold, wrench, before, level, settings.step_s, unit)
                if fault is not None:
                    broke = level
                elif hold.at_rest():
                    borne = level
                    stood = distance_from_plan(
                        plan, hold.simulation.q, hold.simulation.T_base_object
                    )
                before, level = level, settings.growth * level
        else:
            broke = 0.0
        return replace(
            _outcome(self.index, self.name, hold, fault),
            unit="N m" if only_torque else "N",
            borne=unit * borne,
            broke=unit * broke,
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


def _outcome(index: int, name: str, hold: DisturbanceTrial, fault: Fault | None) -> Outcome:
    return Outcome(
        index=index,
        name=name,
        held=fault is None,
        fault=fault,
        fingers=hold.plan.task.finger_names,
        samples=hold.samples,
        load=hold.loads,
        events=hold.simulation.events,
    )
