"""The part ``promise``: the share of what a certificate promises that the closed loop bears.

A certificate says that hand and contacts can bear any load up to a size, if the control is the
best there is. Here the closed loop is the control. Friction is what the certificate reckons with,
and the load acts along the direction that the certificate finds weakest:

slow    it grows by a hundredth of the promise every 0.1 s;
sudden  it comes at once, lasts for ``SUDDEN_S`` and goes at once, by a tenth of the promise more
        each time.
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
from sim.verdict import Fault

__all__ = ["MOST", "promise_row"]

SLOW_FIRST, SLOW_STEP, SLOW_S = 0.7, 0.01, 0.1
"""Share of the promise up to which the slow load comes within a second, and by which it grows from
there (-); time (s) that each lasts."""

SUDDEN_FIRST, SUDDEN_STEP, SUDDEN_S, PAUSE_S = 0.3, 0.1, 0.3, 0.2
"""First sudden load and what each is more than the one before, shares of the promise (-); how long
it acts, and how long nothing does after it (s)."""

MOST = 1.2
"""Share of the promise (-) at which a load ends that nothing broke."""

LEAD_STEPS = 20
"""Steps in which the slow load comes to ``SLOW_FIRST`` (-)."""


def promise_row(plan: GraspPlan, rng: np.random.Generator) -> dict[str, Any]:
    """Shares of promised force and torque at which the object was lost; it draws nothing."""
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
            share, fault = run(plan, wrench)
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


def _slow(plan: GraspPlan, wrench: FloatArray) -> tuple[float, Fault | None]:
    """Share of a wrench (6,) at which a slowly growing one broke the grasp."""
    hold = _hold(plan)
    share, fault = 0.0, hold.close_and_squeeze()
    while fault is None and share < MOST:
        share += SLOW_FIRST / LEAD_STEPS if share < SLOW_FIRST else SLOW_STEP
        hold.push(share * wrench)
        fault = hold.hold_for(1.0 / LEAD_STEPS if share < SLOW_FIRST else SLOW_S)
    return share, fault


def _sudden(plan: GraspPlan, wrench: FloatArray) -> tuple[float, Fault | None]:
    """The same of one that comes and goes at once."""
    hold = _hold(plan)
    share, fault = SUDDEN_FIRST - SUDDEN_STEP, hold.close_and_squeeze()
    while fault is None and share < MOST:
        share += SUDDEN_STEP
        hold.push(share * wrench)
        fault = hold.hold_for(SUDDEN_S)
        if fault is None:
            hold.push(np.zeros(6))
            fault = hold.hold_for(PAUSE_S)
    return share, fault


def _hold(plan: GraspPlan) -> DisturbanceTrial:
    """The closed loop with the friction that the certificate reckons with."""
    task = plan.task
    torsion = task.mu_torsion if task.contact_model == "soft" else 0.0
    return DisturbanceTrial(
        plan,
        controller=ObjectImpedance(plan),
        physics=PhysicsOptions(mu=task.mu, mu_torsion=torsion),
    )
