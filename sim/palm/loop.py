"""``turn``: the loop that turns an object in the palm of a plant to a rotation, and what it saw.

When there is no progress for a while, the fingers open to a posture near the one in which they
began, drawn by the seed, and the controller begins anew: its horizon is too short to see that a
finger has to go round the object. Within ``still_deg`` of the goal the commands stay.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import mujoco
import numpy as np
import pinocchio as pin

from planner.spatial import FloatArray
from sim.palm.control import PalmController
from sim.palm.model import Plant
from sim.palm.report import Outcome
from sim.palm.settings import PalmSettings

STILL_SHARE = 0.7
"""Largest share (-) of the tolerance at which the commands stay: 3.5 of 5 degrees."""

SINK = 0.06
"""How far (m) below where it began an object is dropped: the thickness of a palm and a finger."""


@dataclass(kw_only=True, eq=False)
class TurnLog:
    """What happened, a row per period.

    Attributes:
        time: s, at the end of each period.
        error_deg: Angle to the goal.
        phase: "turn", "open" or "still".
        qpos: States (nqpos,) of the model.
        solve_s: CPU time of each solve, s.
        outcome: How it ended.
    """

    time: list[float] = field(default_factory=list)
    error_deg: list[float] = field(default_factory=list)
    phase: list[str] = field(default_factory=list)
    qpos: list[FloatArray] = field(default_factory=list)
    solve_s: list[float] = field(default_factory=list)
    outcome: Outcome = "not in time"


class _Strategy:
    """Which phase it is: by the error, and by how long nothing was gained."""

    def __init__(self, settings: PalmSettings, tolerance_deg: float) -> None:
        self._asked, self._tolerance = settings, tolerance_deg
        self._best, self._since, self._opens_until = np.inf, 0.0, -np.inf
        self.phase = "turn"

    def next(self, now: float, error: float) -> str:
        """The phase from a time (s) on, at an error (degrees)."""
        asked = self._asked
        within = min(asked.still_deg, STILL_SHARE * self._tolerance)
        if self.phase == "still":
            within = max(within, 0.5 * (within + self._tolerance))
        if now < self._opens_until:
            self._best, self._since = np.inf, now
            return self.phase
        if error <= within:
            self._best, self._since = error, now
            self.phase = "still"
            return self.phase
        if error < self._best - asked.progress_deg:
            self._best, self._since = error, now
        self.phase = "turn"
        if now - self._since > asked.stall_s:
            self._opens_until, self.phase = now + asked.open_s, "open"
        return self.phase


def turn(
    plant: Plant,
    data: Any,
    goal: FloatArray,
    place: FloatArray,
    *,
    settings: PalmSettings,
    tolerance_deg: float,
    hold_s: float,
    longest_s: float,
    seed: int,
    on_step: Callable[[], None] | None = None,
) -> TurnLog:
    """Turn the object until it has stayed at the goal, was dropped, or the time is over.

    Args:
        plant: Hand and object; its servos have the commands of ``data.ctrl``.
        data: ``mujoco.MjData``; moved on.
        goal: Rotation (3, 3) of the object, world.
        place: Where its centre is to be (3,), m, world.
        settings: Of the controller.
        tolerance_deg: Largest angle to the goal that counts as there.
        hold_s: How long it has to be there in one go, s.
        longest_s: Simulated time after which it has failed, s.
        seed: Of the postures to which stuck fingers open.
        on_step: Called after every step of the simulation.
    """
    model, log, rng = plant.model, TurnLog(), np.random.default_rng(seed)
    controller, strategy = PalmController(plant, settings), _Strategy(settings, tolerance_deg)
    begun, began_at = data.ctrl[plant.ctrl].copy(), float(data.time)
    low = float(data.xpos[plant.object_body][2]) - SINK
    steps = max(1, round(settings.period_s / model.opt.timestep))
    share = settings.period_s / settings.step_s
    away, held = begun, 0.0
    phase = strategy.next(0.0, angle_deg(plant, data, goal))
    while data.time - began_at < longest_s:
        command = data.ctrl[plant.ctrl].copy()
        if phase == "turn":
            # from where the servos are: a squeeze that is stored throws the object out
            command = plant.moment @ data.qpos[plant.qpos]
            command[plant.idle] = begun[plant.idle]  # a wrist that sags would sag further
            start = time.thread_time()
            new = controller.command(data.qpos, command, goal, place)
            log.solve_s.append(time.thread_time() - start)
            new = controller.held_back(new, command)
            new[plant.idle] = begun[plant.idle]
            command = new
        elif phase == "open":
            most = share * settings.command_rad
            new = command + np.clip(away - command, -most, most)
        else:
            new = command
        for k in range(steps):
            data.ctrl[plant.ctrl] = command + (k + 1) / steps * (new - command)
            mujoco.mj_step(model, data)
            if on_step is not None:
                on_step()
        error = angle_deg(plant, data, goal)
        log.time.append(float(data.time) - began_at)
        log.error_deg.append(error)
        log.phase.append(phase)
        log.qpos.append(data.qpos.copy())
        held = held + settings.period_s if error <= tolerance_deg else 0.0
        if not np.isfinite(data.qpos).all():
            log.outcome = "diverged"
        elif data.xpos[plant.object_body][2] < low:
            log.outcome = "dropped"
        elif held >= hold_s - 0.5 * model.opt.timestep:
            log.outcome = "reached"
        if log.outcome != "not in time":
            break
        was, phase = phase, strategy.next(log.time[-1], error)
        if phase == "open" and was != "open":
            away = begun + settings.scatter_rad * rng.standard_normal(len(begun))
            away[plant.idle] = begun[plant.idle]
            controller.forget()
    return log


def angle_deg(plant: Plant, data: Any, goal: FloatArray) -> float:
    """Angle (degrees) of the object to a rotation (3, 3)."""
    now = data.xmat[plant.object_body].reshape(3, 3)
    return float(np.degrees(np.linalg.norm(pin.log3(goal @ now.T))))
