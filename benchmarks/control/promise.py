"""The part ``promise``: the share of a certified load that the impedance controller holds.

A certificate says which load hand and contacts can hold under the best control. Here the impedance
controller is the control. Friction is the certified one; the load acts in the weakest direction of
the certificate:

slow    grows by 1 % of the certified load every 0.1 s;
sudden  switched on for ``SUDDEN_S`` and off again, each time 10 % of the certified load larger.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from planner.certify import smallest_breaking
from planner.plan import GraspPlan
from planner.spatial import FloatArray
from sim.controllers import ObjectImpedance
from sim.physics import PhysicsOptions
from sim.protocols.disturbance import DROPPED, DisturbanceTrial
from sim.reality import Reality
from sim.verdict import Fault

SLOW_FIRST, SLOW_STEP, SLOW_S = 0.7, 0.01, 0.1
"""Slow load: share of the certified load reached in the first second, and increments from there
(-); duration of each increment (s)."""

SUDDEN_FIRST, SUDDEN_STEP, SUDDEN_S, PAUSE_S = 0.3, 0.1, 0.3, 0.2
"""Sudden load: first size and increments, shares of the certified load (-); duration of the load,
and of the pause after it (s)."""

MOST = 1.2
"""Share of the certified load (-) at which a trial ends."""

LEAD_STEPS = 20
"""Increments of the slow load up to ``SLOW_FIRST`` (-)."""


def promise_row(plan: GraspPlan, rng: np.random.Generator, reality: Reality) -> dict[str, Any]:
    """Shares of certified force and torque at which the object was lost; draws nothing."""
    del rng
    length = plan.task.object.shape.bounding_radius
    loads: list[dict[str, Any]] = []
    for kind in ("force", "torque"):
        breaking = smallest_breaking(plan.forces.problem, kind, length=length)
        promised, size = breaking.bounds.lower, float(np.linalg.norm(breaking.wrench))
        if not (promised > 0 and np.isfinite(size)):
            continue
        wrench = promised / size * breaking.wrench
        for speed, run in (("slow", _slow), ("sudden", _sudden)):
            share, fault = run(plan, wrench, reality)
            loads.append(
                {
                    "kind": kind,
                    "speed": speed,
                    "promised": promised,
                    "unit": breaking.unit,
                    "broke_at": share if fault is not None else None,
                    "reason": "" if fault is None else fault.reason,
                    "lost_mm": DROPPED.mm,
                    "lost_deg": DROPPED.deg,
                }
            )
    return {"loads": loads}


def _slow(plan: GraspPlan, wrench: FloatArray, reality: Reality) -> tuple[float, Fault | None]:
    """Share of a slowly growing wrench (6,) at which the grasp failed."""
    hold = _hold(plan, reality)
    share, fault = 0.0, hold.close_and_squeeze()
    while fault is None and share < MOST:
        share += SLOW_FIRST / LEAD_STEPS if share < SLOW_FIRST else SLOW_STEP
        hold.push(share * wrench)
        fault = hold.hold_for(1.0 / LEAD_STEPS if share < SLOW_FIRST else SLOW_S)
    return share, fault


def _sudden(plan: GraspPlan, wrench: FloatArray, reality: Reality) -> tuple[float, Fault | None]:
    """Share of a sudden wrench (6,) at which the grasp failed."""
    hold = _hold(plan, reality)
    share, fault = SUDDEN_FIRST - SUDDEN_STEP, hold.close_and_squeeze()
    while fault is None and share < MOST:
        share += SUDDEN_STEP
        hold.push(share * wrench)
        fault = hold.hold_for(SUDDEN_S)
        if fault is None:
            hold.push(np.zeros(6))
            fault = hold.hold_for(PAUSE_S)
    return share, fault


def _hold(plan: GraspPlan, reality: Reality) -> DisturbanceTrial:
    """Impedance control at the certified friction."""
    task = plan.task
    torsion = task.mu_torsion if task.contact_model == "soft" else 0.0
    return DisturbanceTrial(
        plan,
        controller=ObjectImpedance(plan),
        physics=PhysicsOptions(mu=task.mu, mu_torsion=torsion),
        reality=reality,
    )
