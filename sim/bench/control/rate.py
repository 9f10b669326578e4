"""How long a step of the closed loop takes, physics included, beside MuJoCo's step alone.

CPU time of this process, in the median over short stretches of a hold. Two rates of control are not
needed: the loop runs at every time step of 2 ms, which is 500 Hz.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np

from planner.plan import GraspPlan
from sim.controllers import CONTROLLERS
from sim.protocols.disturbance import DisturbanceTrial

__all__ = ["rate_row"]

STRETCHES, STEPS = 20, 100
"""Stretches of so many time steps each: 0.2 s simulated, long beside the clock's 1 us."""

WARM_S = 0.2
"""Held before the clock runs (s): what is made on first use is made by then."""


def rate_row(plan: GraspPlan, rng: np.random.Generator) -> dict[str, Any]:
    """Milliseconds per step of each loop, and of MuJoCo alone; it draws nothing."""
    del rng
    loops: list[dict[str, Any]] = []
    for loop, make in CONTROLLERS.items():
        hold = DisturbanceTrial(plan, controller=make(plan))
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
