"""The parts ``turns`` and ``slips``: senses that look on while a hand turns or loses an object."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from benchmarks.touch.watch import TouchWatch
from planner.errors import PlannerError
from planner.motion.manipulation import manipulation_task, plan_manipulation
from planner.objects import parse_object
from planner.plan import GraspPlan
from planner.search import plan_grasp
from planner.spatial import FloatArray
from planner.task import GRAVITY, GraspTask
from sim.controllers import Event
from sim.manipulation.run import ManipulationRun
from sim.protocols.disturbance import DisturbanceTrial
from sim.reality import Reality
from sim.simulation import Simulation

ANGLE = math.pi / 2
"""Turn, rad."""

MASS = 0.1
"""Of the objects that are turned, kg."""

PUSHES, GROW_S, MOST_WEIGHTS, REST_S = 4, 1.0, 60.0, 0.3
"""Pushes per trial; time (s) over which each grows, and the largest, in weights of the object; rest
after each (s)."""

SLIDING, SLIDING_S = 0.005, 0.05
"""Sliding speed (m/s) and how long (s) it lasts when a push has done enough."""

RISE, ANSWER_S = 1.1, 0.2
"""A pad has answered when its normal force has risen by a tenth, within this time (s)."""


def turn_trial(hand: str, spec: str, seed: int) -> dict[str, Any]:
    """An object turned by 90 degrees by the closed loop, which knows the truth."""
    try:
        task = manipulation_task(hand, parse_object(spec, mass=MASS), mu=0.5)
        plan = plan_manipulation(task, angle=ANGLE, seed=seed)
    except PlannerError as error:
        return {"error": str(error)}
    run = ManipulationRun(plan)
    simulation = run.sim.simulation
    watch = TouchWatch(simulation, seed)
    simulation.on_step = lambda _: watch.look()
    report = run.perform()
    mu = simulation.scene.physics.mu
    return {"error": "", "turned": report.success, **watch.result(mu)}


def slip_trial(hand: str, spec: str, seed: int) -> dict[str, Any]:
    """Pushes that grow until pads slip: noticed by a sense that looks on, and answered by a loop.

    The same pushes twice: the loop that knows the truth is watched; then one with taxels answers.
    """
    try:
        plan = plan_grasp(GraspTask.create(hand, parse_object(spec)), seed=seed)
    except PlannerError as error:
        return {"error": str(error)}
    pushes = np.random.default_rng(seed).normal(size=(PUSHES, 3))
    pushes /= np.linalg.norm(pushes, axis=1, keepdims=True)
    trial = DisturbanceTrial(plan, controller="impedance")
    watch = TouchWatch(trial.simulation, seed, ("taxels",))
    _provoke(trial, pushes, watch)
    watched = watch.result(trial.simulation.scene.physics.mu)
    return {"error": "", **watched, **_answers(plan, pushes, seed)}


def _provoke(trial: DisturbanceTrial, pushes: FloatArray, watch: TouchWatch) -> None:
    if trial.close_and_squeeze() is not None:
        return
    simulation = trial.simulation
    simulation.on_step = lambda _: watch.look()
    for push in pushes:
        if _push(trial, push):
            return


def _push(trial: DisturbanceTrial, push: FloatArray) -> bool:
    """Push until a pad slides; whether the object was lost."""
    simulation = trial.simulation
    weight, dt = -GRAVITY[2] * trial.plan.task.object.mass, simulation.timestep
    slid = 0.0
    for k in range(round(GROW_S / dt)):
        size = k * dt / GROW_S * MOST_WEIGHTS * weight
        trial.push(size * np.append(push, np.zeros(3)))
        if trial.hold_for(dt) is not None:
            return True
        pads = simulation.observe("hold", 0.0).pads
        fast = (pads.sliding_speed > SLIDING) & (pads.normal_force > 0)
        slid = slid + dt if fast.any() else 0.0
        if slid > SLIDING_S:
            break
    trial.push(np.zeros(6))
    return trial.hold_for(REST_S) is not None


def _answers(plan: GraspPlan, pushes: FloatArray, seed: int) -> dict[str, Any]:
    """Times (s) from the beginning of a slip to its alarm, and to a normal force that has risen."""
    reality = Reality(name="taxels", touch="taxels", seed=seed)
    trial = DisturbanceTrial(plan, controller="impedance", reality=reality)
    names = plan.task.finger_names
    noted: list[tuple[float, int]] = []
    times: list[float] = []
    forces: list[FloatArray] = []

    def look(simulation: Simulation) -> None:
        times.append(simulation.time)
        forces.append(simulation.normal_forces())
        noted.extend(_told(event, names) for event in simulation.events[len(noted) :])

    if trial.close_and_squeeze() is not None:
        return {"answers_s": [], "answered": 0, "alarms_in_loop": 0, "lost": True}
    noted.extend(_told(event, names) for event in trial.simulation.events)
    earlier = len(noted)
    trial.simulation.on_step = look
    lost = any(_push(trial, push) for push in pushes)
    clock, pressed = np.array(times), np.array(forces)
    told = [(at, k) for at, k in noted[earlier:] if k >= 0]
    answers = []
    for at, k in told:
        row = int(np.searchsorted(clock, at))
        if row >= len(clock):
            continue
        later = pressed[row : row + round(ANSWER_S / trial.simulation.timestep), k]
        risen = np.flatnonzero(later >= RISE * later[0])
        if len(risen):
            answers.append(float(clock[row + risen[0]] - at))
    return {
        "answers_s": answers,
        "answered": len(answers),
        "alarms_in_loop": len(told),
        "lost": lost,
    }


def _told(event: Event, names: Sequence[str]) -> tuple[float, int]:
    """Time (s) of an event and the finger that slipped; -1 if the event is no slip."""
    return event.time, names.index(event.finger) if event.kind == "slip" else -1
