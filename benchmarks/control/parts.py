"""Parts that run the protocols: ``fc``, drift, the grid and the time of a step.

Every function takes a plan, a random generator and a reality, and gives plain data. Feedforward and
impedance control meet the same directions and errors.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np

from benchmarks.control.push import conditions
from planner.plan import GraspPlan
from sim.controllers import CONTROLLERS
from sim.physics import PhysicsOptions
from sim.protocols.dexgraspbench import dexgraspbench_cases
from sim.protocols.disturbance import DisturbanceTrial, Settings
from sim.protocols.variations import robust_cases
from sim.reality import Reality

DRIFT_S = 10.0
"""How long an object is held for its drift to be seen, s."""

NOSLIP = (10, 0)
"""Noslip iterations (-) with which drift is measured: the simulation's own, and none."""

STRETCHES, STEPS = 20, 100
"""Timed stretches, and time steps of each: 0.2 s simulated, long compared with the clock's 1 us."""

WARM_S = 0.2
"""Hold before the measurement (s), so that first-use costs are over."""


def fc_row(plan: GraspPlan, rng: np.random.Generator, reality: Reality) -> dict[str, Any]:
    """The six pushes of DexGraspBench's test, which are exact; it draws nothing."""
    del rng, reality
    outcomes = [case.run(plan, conditions("feedforward")) for case in dexgraspbench_cases()]
    return {
        "held": sum(o.held for o in outcomes),
        "of": len(outcomes),
        "reasons": [o.reason for o in outcomes if o.reason],
        "start_penetration_mm": max(o.conditions["start_penetration_mm"] for o in outcomes),
        "grasp_penetration_mm": max(o.conditions["grasp_penetration_mm"] for o in outcomes),
    }


def drift_row(plan: GraspPlan, rng: np.random.Generator, reality: Reality) -> dict[str, Any]:
    """How far an object moves in the hand while nothing happens; it draws nothing."""
    del rng
    holds = []
    for loop, make in CONTROLLERS.items():
        for noslip in NOSLIP:
            hold = DisturbanceTrial(
                plan,
                controller=make(plan),
                physics=PhysicsOptions(noslip_iterations=noslip),
                reality=reality,
            )
            fault = hold.close_and_squeeze() or hold.hold_for(DRIFT_S)
            seen = hold.samples.during("hold")
            moved, turned = hold.samples.slip_mm[seen], hold.samples.slip_deg[seen]
            holds.append(
                {
                    "loop": loop,
                    "noslip": noslip,
                    "reason": "" if fault is None else fault.reason,
                    "moved_mm": float(moved[-1]) if len(seen) else None,
                    "turned_deg": float(turned[-1]) if len(seen) else None,
                }
            )
    return {"seconds": DRIFT_S, "holds": holds}


def robust_row(plan: GraspPlan, rng: np.random.Generator, reality: Reality) -> dict[str, Any]:
    """A third of the grid of masses, frictions and pose errors, by each loop.

    A Latin square: every mass, friction and error three times, every pair of them once. Three
    grasps cover the whole grid on average.
    """
    seed, shift = int(rng.integers(2**31)), int(rng.integers(3))
    settings = Settings()
    grid = settings.mass_factors, settings.friction_factors, settings.pose_errors
    trials = []
    for case in robust_cases(settings, seed):
        error = (case.shift_mm, case.turn_deg)
        m, f, e = (
            level.index(value)
            for level, value in zip(grid, (case.mass, case.friction, error), strict=True)
        )
        if (m + f + e + shift) % len(settings.pose_errors):
            continue
        for loop in CONTROLLERS:
            outcome = case.run(plan, conditions(loop, reality))
            trials.append(
                {
                    "loop": loop,
                    "mass": case.mass,
                    "friction": case.friction,
                    "pose": f"{case.shift_mm:g} mm {case.turn_deg:g} deg",
                    "held": outcome.held,
                    "reason": outcome.reason,
                }
            )
    return {"trials": trials}


def rate_row(plan: GraspPlan, rng: np.random.Generator, reality: Reality) -> dict[str, Any]:
    """CPU time (ms) of a step of each loop, physics included, and of MuJoCo alone; draws nothing.

    In the median over short stretches of a hold. The loop runs at every time step.
    """
    del rng
    loops: list[dict[str, Any]] = []
    for loop, make in CONTROLLERS.items():
        hold = DisturbanceTrial(plan, controller=make(plan), reality=reality)
        fault = hold.close_and_squeeze() or hold.hold_for(WARM_S)
        if fault is not None:
            loops.append({"loop": loop, "reason": fault.reason})
            continue
        whole = _milliseconds(lambda hold=hold: hold.simulation.step("hold", 1.0))  # type: ignore[misc]
        model, data = hold.simulation.scene.model, hold.simulation.data
        bare = _milliseconds(lambda model=model, data=data: mujoco.mj_step(model, data))  # type: ignore[misc]
        loops.append(
            {
                "loop": loop,
                "reason": "",
                "step_ms": 1e3 * hold.simulation.scene.physics.timestep,
                "whole_ms": whole,
                "bare_ms": bare,
            }
        )
    return {"fingers": len(plan.task.fingers), "loops": loops}


def _milliseconds(step: Callable[[], object]) -> list[float]:
    """CPU time per step of every stretch, ms."""
    spent = []
    for _ in range(STRETCHES):
        begin = time.process_time()
        for _ in range(STEPS):
            step()
        spent.append(1e3 * (time.process_time() - begin) / STEPS)
    return spent
