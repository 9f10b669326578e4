"""Measure touch: contacts and slips from taxels, motor effort and binary contact.

arrays  random contacts on arrays of several spacings and noises
turns   senses watch objects that are turned by 90 degrees
slips   pushes that grow until pads slip
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
import typer

from benchmarks.bench import HandOptions
from benchmarks.common import checked_hand, known
from benchmarks.summary import Cell, count, flat, of, parts, ratio, summary
from benchmarks.watch import TouchWatch
from planner.motion.manipulation import manipulation_task, plan_manipulation
from planner.objects import parse_object
from planner.plan import GraspPlan
from planner.search.grasp import plan_grasp
from planner.spatial import FloatArray
from planner.task import GRAVITY, GraspTask
from sim.controllers import Event
from sim.manipulation.run import ManipulationRun
from sim.protocols.disturbance import DisturbanceTrial
from sim.sensing.errors import ErrorModel
from sim.sensing.touch import ContactEstimator, PadContact, TaxelArray, TaxelLayout, contact_image
from sim.simulation import Simulation
from sim.tables import Row

OBJECTS = {
    "arrays": ("",),
    "turns": ("cylinder:0.03x0.08", "box:0.05x0.05x0.1"),
    "slips": ("box", "cylinder", "sphere"),
}
"""Part -> what is turned, or pushed until it slips."""

FORCES = (0.5, 5.0)
"""Normal forces (N), drawn evenly."""

REACH = 0.7
"""Share of the array, from its middle, in which contacts lie (-)."""

MU, MU_TORSION = 0.6, 0.0005
"""Friction (-, m) of the contacts; a pad of soft rubber resists turning by about 0.5 mm."""

CONTACTS = 500
"""Contacts per row."""

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


@dataclass(frozen=True, kw_only=True)
class Options(HandOptions):
    """Trials of every hand and object in turns and slips."""

    parts: Annotated[str, typer.Option(help="Comma separated: arrays, turns, slips.")] = "all"


def cases(options: Options) -> Iterator[Row]:
    """Trials of every part."""
    for part in known("part", options.parts, list(OBJECTS)):
        for hand in options.hand_names:
            checked_hand(hand)
            for spec in OBJECTS[part]:
                for k in range(options.n if spec else 1):
                    where = {"part": part, "hand": hand, "object": spec}
                    yield {**where, "seed": options.seed + k}


def measure(case: Row) -> Row:
    """One trial of one part."""
    hand, spec, seed = case["hand"], case["object"], case["seed"]
    if case["part"] == "arrays":
        return array_row(hand, seed)
    return (turn_trial if case["part"] == "turns" else slip_trial)(hand, spec, seed)


def array_layout(hand: str, spacing: float, **changes: Any) -> TaxelLayout:
    """The array of a hand's first finger with another spacing (m), over the same part of the pad.

    Args:
        hand: Name or path.
        spacing: m.
        **changes: Fields of ``TaxelDescription``.
    """
    finger = checked_hand(hand).description.fingers[0]
    pad = finger.pad
    half = math.radians(pad.rolling_half_angle_deg or pad.half_angle_deg)
    count = 2 * max(1, round(pad.radius * half / spacing)) + 1
    layout = TaxelLayout.of(finger)
    array = layout.array.model_copy(
        update={"rows": count, "columns": count, "spacing": spacing, "latency": 0.0, **changes}
    )
    described = finger.model_copy(update={"pad": pad.model_copy(update={"taxels": array})})
    return TaxelLayout.of(described)


def random_contact(layout: TaxelLayout, rng: np.random.Generator) -> PadContact:
    """A contact somewhere on an array, with a force within the friction cone."""
    place = rng.uniform(-REACH, REACH, 2) * [layout.u[-1], layout.v[-1]]
    frame = layout.frame_at(place)
    force, used, angle = rng.uniform(*FORCES), rng.uniform(0.0, 1.0), rng.uniform(0.0, 2 * np.pi)
    shear = used * MU * force * (np.cos(angle) * frame[:, 1] + np.sin(angle) * frame[:, 2])
    return PadContact(
        point=layout.point(place),
        normal=frame[:, 0],
        normal_force=force,
        shear=np.asarray(shear),
        torsion=float(rng.uniform(-1.0, 1.0)) * MU_TORSION * force,
        used=used,
    )


def array_row(hand: str, seed: int) -> dict[str, Any]:
    """Errors and times for several spacings and noises, and with dead taxels; all on one hand."""
    cells = []
    for spacing in (0.001, 0.002, 0.003, 0.004):
        for noise in (0.0, 0.05, 0.1):
            layout = array_layout(hand, spacing, noise=noise)
            cells.append(_errors(layout, np.random.default_rng(seed)))
    rng = np.random.default_rng([seed, 1])
    whole = array_layout(hand, 0.002)
    count = whole.array.rows
    dead = rng.choice(count * count, size=round(0.05 * count * count), replace=False)
    broken = tuple((int(k) // count, int(k) % count) for k in dead)
    cells.append(_errors(array_layout(hand, 0.002, dead=broken), np.random.default_rng(seed)))
    return {"cells": cells}


def _errors(layout: TaxelLayout, rng: np.random.Generator) -> dict[str, Any]:
    array, estimator = TaxelArray(layout, rng), ContactEstimator(layout)
    errors: dict[str, list[float]] = {
        name: [] for name in ("place_mm", "normal_deg", "force", "shear", "torsion_N_mm")
    }
    spent = np.zeros(3)
    for _ in range(CONTACTS):
        contact = random_contact(layout, rng)
        t0 = time.process_time()
        exact = contact_image(layout, contact)
        t1 = time.process_time()
        image = array.measured(exact)
        t2 = time.process_time()
        seen = estimator.estimate(image)
        spent += t1 - t0, t2 - t1, time.process_time() - t2
        shear = seen.force - seen.normal_force * seen.normal
        errors["place_mm"].append(1e3 * _size(seen.point - contact.point))
        cosine = float(np.clip(seen.normal @ contact.normal, -1.0, 1.0))
        errors["normal_deg"].append(math.degrees(math.acos(cosine)))
        errors["force"].append(abs(seen.normal_force / contact.normal_force - 1.0))
        errors["shear"].append(_size(shear - contact.shear) / contact.normal_force)
        errors["torsion_N_mm"].append(1e3 * abs(seen.torsion - contact.torsion))
    return {
        "spacing_mm": 1e3 * layout.array.spacing,
        "noise": layout.array.noise,
        "dead": len(layout.array.dead),
        "taxels": layout.array.rows * layout.array.columns,
        "contacts": CONTACTS,
        **{name: float(np.median(v)) for name, v in errors.items()},
        **{f"{name}_p95": float(np.quantile(v, 0.95)) for name, v in errors.items()},
        "image_us": 1e6 * spent[0] / CONTACTS,
        "noise_us": 1e6 * spent[1] / CONTACTS,
        "estimate_us": 1e6 * spent[2] / CONTACTS,
    }


def _size(vector: FloatArray) -> float:
    return float(np.linalg.norm(vector))


def turn_trial(hand: str, spec: str, seed: int) -> dict[str, Any]:
    """An object turned by 90 degrees by the closed loop, which knows the truth."""
    task = manipulation_task(hand, parse_object(spec, mass=MASS), mu=0.5)
    plan = plan_manipulation(task, angle=ANGLE, seed=seed)
    run = ManipulationRun(plan)
    simulation = run.sim.simulation
    watch = TouchWatch(simulation, seed)
    simulation.on_step = lambda _: watch.look()
    report = run.perform()
    mu = simulation.scene.physics.mu
    return {"turned": report.success, **watch.result(mu)}


def slip_trial(hand: str, spec: str, seed: int) -> dict[str, Any]:
    """Pushes that grow until pads slip: noticed by a sense that looks on, and answered by a loop.

    The same pushes twice: the loop that knows the truth is watched; then one with taxels answers.
    """
    plan = plan_grasp(GraspTask.create(hand, parse_object(spec)), seed=seed)
    pushes = np.random.default_rng(seed).normal(size=(PUSHES, 3))
    pushes /= np.linalg.norm(pushes, axis=1, keepdims=True)
    trial = DisturbanceTrial(plan, controller="impedance")
    watch = TouchWatch(trial.simulation, seed, ("taxels",))
    _provoke(trial, pushes, watch)
    watched = watch.result(trial.simulation.scene.physics.mu)
    return {**watched, **_answers(plan, pushes, seed)}


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
    error_model = ErrorModel(name="taxels", touch="taxels", seed=seed)
    trial = DisturbanceTrial(plan, controller="impedance", error_model=error_model)
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


def tables(result: Row) -> Iterator[Row]:
    """A table per part that has rows."""
    by = {
        part: [r for r in result["rows"] if r["part"] == part and not r["error"]]
        for part in OBJECTS
    }
    if by["arrays"]:
        yield _arrays(by["arrays"])
    if by["turns"]:
        yield summary(
            "turns: errors of each sense while objects are turned by 90 degrees; medians of trials",
            flat(by["turns"], "senses"),
            ("sense",),
            {
                "trials": count,
                "felt": of("felt", digits=1, scale=100.0, unit=" %"),
                "place mm": of("place_mm"),
                "normal deg": of("normal_deg", digits=1),
                "force": of("force", digits=1, scale=100.0, unit=" %"),
                "force vector": of("force_vector", digits=1, scale=100.0, unit=" %"),
                "us per step": of("us", digits=0),
            },
        )
        yield _slips(by["turns"])
    if by["slips"]:
        yield _slips(by["slips"])
        yield summary(
            "slips: the loop with taxels: alarms, and time until the pad presses a tenth harder",
            [{**r, "lost": int(r["lost"]), "one": 1} for r in by["slips"]],
            ("hand",),
            {
                "trials": count,
                "alarms": of("alarms_in_loop", "sum", 0),
                "answered": of("answered", "sum", 0),
                "median ms": of("answers_s", digits=0, scale=1e3),
                "lost": parts("lost", "one"),
            },
        )


def _arrays(rows: list[Row]) -> Row:
    by = {"hand": "hand", "spacing_mm": "spacing mm", "noise": "noise", "dead": "dead"}
    return summary(
        "arrays: random contacts; median errors (95 % below), and time per pad",
        flat(rows, "cells"),
        by,
        {
            "place mm": _both("place_mm", 2),
            "normal deg": _both("normal_deg", 1),
            "force %": _both("force", 1, 100.0),
            "shear/normal %": _both("shear", 1, 100.0),
            "torsion N mm": _both("torsion_N_mm", 2),
            **{f"{name} us": of(f"{name}_us", digits=0) for name in ("image", "noise", "estimate")},
        },
    )


def _both(name: str, digits: int, scale: float = 1.0) -> Cell:
    middle, most = (of(key, digits=digits, scale=scale) for key in (name, f"{name}_p95"))
    return lambda frame: f"{middle(frame)} ({most(frame)})"


def _slips(rows: list[Row]) -> Row:
    part = rows[0]["part"]
    return summary(
        f"{part}: slips (0.1 mm within 0.1 s) noticed by taxels, time from 0.1 mm to the alarm; "
        "alarms while less than 0.1 mm was slid, and false ones, less than 0.02 mm; friction",
        [{**row, **(row["slips"] or {})} for row in rows],
        ("hand", "object"),
        {
            "trials": count,
            "s": of("seconds", "sum", 0),
            "slips": of("slips", "sum", 0),
            "noticed": of("noticed", "sum", 0),
            "share %": ratio("noticed", "slips", 1, 100.0),
            "median ms": of("delays_s", digits=0, scale=1e3),
            "90 % ms": of("delays_s", 0.9, 0, 1e3),
            **{name: of(name, "sum", 0) for name in ("alarms", "early", "false")},
            "mu off": of("friction_off", digits=0, scale=100.0, unit=" %"),
        },
        [("all", "")],
    )
