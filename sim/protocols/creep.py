"""Creep of a held object: measured, beside the formula, and changes of a scene that are enough.

``sim.creep`` says what friction gives way by. Here a plan is gripped in the air and watched, and
the changes that the formula proposes are tried: where fingers that only press on each other add
creep of their own, a change is made larger until what is measured keeps to the budget.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import mujoco
import numpy as np

from planner.plan import GraspPlan
from sim.creep import CREEP_BUDGET, Remedy, least_creep, predicted_creep, remedies
from sim.protocols.disturbance import DisturbanceTrial
from sim.scene.build import build_scene
from sim.scene.physics import PhysicsOptions

CALM_S, WATCHED_S = 0.3, 1.0
"""Time (s) after the grip is there that is left out, and in which creep is measured then."""

ROUNDS = 4
"""How often a change is made larger before it is given up."""

SAFETY = 0.9
"""Share of the budget that a larger change aims at (-)."""


@dataclass(frozen=True, kw_only=True)
class CreepMeasured:
    """Creep of one held object, m/s.

    Attributes:
        measured: Movement of the object in the palm per time; infinite if it was lost.
        predicted: By the formula, of the contacts that there were; NaN if it was lost before.
        least: By the formula, however firm the grip. Neither knows of noslip iterations.
        lost: Why the object was lost, "" if it was not.
    """

    measured: float
    predicted: float
    least: float
    lost: str = ""


@dataclass(frozen=True, kw_only=True)
class Tried:
    """A change of a scene, and the creep with it.

    Attributes:
        remedy: What was changed.
        creep: What came of it.
        enough: Whether it keeps to the budget.
    """

    remedy: Remedy
    creep: CreepMeasured
    enough: bool


def measure_creep(plan: GraspPlan, physics: PhysicsOptions) -> CreepMeasured:
    """Grip as planned in the air, and watch the object for a second.

    Args:
        plan: What to execute.
        physics: How MuJoCo computes.
    """
    names = plan.task.finger_names
    hold = DisturbanceTrial(plan, physics=physics, dropped=None)
    scene, data = hold.simulation.scene, hold.simulation.data
    least = least_creep(scene, names)
    if fault := hold.close_and_squeeze() or hold.hold_for(CALM_S):
        return CreepMeasured(measured=math.inf, predicted=math.nan, least=least, lost=fault.reason)
    mujoco.mj_forward(scene.model, data)
    predicted = predicted_creep(scene, data)
    begin = hold.simulation.T_palm_object.translation.copy()
    fault = hold.hold_for(WATCHED_S)
    lost: str = "" if fault is None else fault.reason
    if not lost and hold.simulation.touching() < len(names):
        lost = "fingers lost the object"
    moved = float(np.linalg.norm(hold.simulation.T_palm_object.translation - begin))
    return CreepMeasured(
        measured=math.inf if lost else moved / WATCHED_S,
        predicted=predicted,
        least=least,
        lost=lost,
    )


def sized_remedies(
    plan: GraspPlan, physics: PhysicsOptions, seen: CreepMeasured, budget: float = CREEP_BUDGET
) -> tuple[Tried, ...]:
    """Changes of a physics that keep the creep of a plan's object within a budget, each alone.

    Args:
        plan: What is held.
        physics: As a scene has it.
        seen: What was measured under it.
        budget: Largest creep that is wanted, m/s.

    Returns:
        What was tried, sized so that the measured creep keeps to the budget where that can be;
        empty if it does so already.

    Raises:
        TaskError: A budget that is not positive.
    """
    scene = build_scene(plan.task, T_world_base=plan.T_world_base, q=plan.q, physics=physics)
    names = plan.task.finger_names

    def creep(changed: PhysicsOptions) -> float:
        return least_creep(scene, names, changed)

    if seen.measured <= budget:
        return ()
    # what fingers that press on each other add to the formula is there from the beginning
    extra = seen.least / seen.measured if math.isfinite(seen.measured) else 1.0
    begin = budget * min(1.0, extra)
    out = []
    for first in remedies(physics, creep, begin):
        change, aim = first, begin
        for _ in range(ROUNDS):
            now = measure_creep(plan, change.physics)
            enough = now.measured <= budget
            if enough or first.kind == "noslip" or not math.isfinite(now.measured):
                break
            aim *= SAFETY * budget / now.measured
            larger = {c.kind: c for c in remedies(physics, creep, aim)}.get(first.kind)
            if larger is None:
                break
            change = larger
        out.append(Tried(remedy=change, creep=now, enough=enough))
    return tuple(out)
