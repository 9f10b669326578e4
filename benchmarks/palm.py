"""Objects in the palm: turned about the vertical and to any rotation, beside the published code.

Each case draws, from its seed alone, how the object is laid down (turned about the palm's normal by
up to 90 degrees, shifted by about 5 mm) and its goal: "yaw" is 90 degrees to either side, "any" a
rotation drawn evenly from all. With ``--published FOLDER``, a checkout of
https://github.com/asu-iris/Complementarity-Free-Dexterous-Manipulation (87b320f; it has no licence
and is no part of this project), its Allegro scene, starts and goals are run with its controller and
with ours, each by its own test (23 degrees, 2.1 s) and by that of the other cases.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from contextlib import chdir
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Annotated, Any

import mujoco
import numpy as np
import pinocchio as pin
import typer

from benchmarks.bench import Options as BenchOptions
from benchmarks.common import objects_of
from benchmarks.summary import counted, of, share, summary
from planner.errors import FileFormatError
from planner.spatial import FloatArray
from sim.cli.options import names
from sim.palm import PalmSettings, reorient_in_palm
from sim.palm.loop import angle_deg, turn
from sim.palm.model import Plant
from sim.palm.run import LONGEST_S
from sim.tables import Row

SHIFT = 0.005
"""Standard deviation (m) of where the object is laid down."""

OURS, THEIRS = (5.0, 0.5), (23.07, 2.1)
"""Tests: angle (degrees) and how long (s). Theirs is 1 - (q q*)^2 < 0.04 for 21 steps of 0.1 s."""

LONGEST = {"yaw": 30.0, "published": 50.0}
"""Simulated time of a case, s; for any rotation ``--longest``."""


@dataclass(frozen=True, kw_only=True)
class Options(BenchOptions):
    """Seeds count from ``--seed``."""

    objects: Annotated[str, typer.Option(help="Names, sizes, mesh files.")] = "box:0.05x0.05x0.05"
    goals: Annotated[str, typer.Option(help="yaw, any; none of them: -.")] = "yaw,any"
    hand: Annotated[str, typer.Option(help="Its name.")] = "allegro_hand"
    longest: Annotated[float, typer.Option(min=1.0, help="Simulated time for any rotation, s.")] = (
        LONGEST_S
    )
    published: Annotated[Path | None, typer.Option(help="Checkout of the published code.")] = None


def cases(options: Options) -> Iterator[Row]:
    """Objects x goals x seeds; then the published scene."""
    seeds = range(options.seed, options.seed + options.n)
    for label, spec in objects_of(options.objects):
        for goal in names(options.goals) if options.goals != "-" else ():
            for seed in seeds:
                yield {
                    **{"scene": "ours", "controller": "ours", "object": label, "spec": spec},
                    **{"hand": options.hand, "goal": goal, "seed": seed, "degrees": OURS[0]},
                    "longest_s": LONGEST.get(goal, options.longest),
                }
    if options.published is None:
        return
    if not (options.published / "planning").is_dir():
        raise FileFormatError(f"{options.published} is no checkout of the published code")
    folder = str(options.published.resolve())
    for controller in ("ours", "published"):
        for degrees, _ in (OURS, THEIRS):
            for seed in seeds:
                yield {
                    **{"scene": "published", "controller": controller, "object": "cube"},
                    **{"goal": "yaw", "seed": seed, "degrees": degrees, "folder": folder},
                }


def measure(case: Row) -> Row:
    """Turn one object."""
    if case["scene"] == "published":
        return _published(case)
    rng = np.random.default_rng(case["seed"])
    yaw, side = rng.uniform(-np.pi / 2, np.pi / 2), rng.choice([-1.0, 1.0])
    shift = SHIFT * rng.standard_normal(2)
    goal = _about_z(yaw + side * np.pi / 2)
    if case["goal"] == "any":
        quaternion = rng.standard_normal(4)
        goal = pin.Quaternion(*(quaternion / np.linalg.norm(quaternion))).toRotationMatrix()
    report = reorient_in_palm(
        case["hand"],
        case["spec"],
        goal,
        start_rotation=_about_z(yaw),
        shift=tuple(shift),
        seed=case["seed"],
        longest_s=case["longest_s"],
    )
    return _row(report.outcome, report.time, report.error_deg, report.solve_ms, report.look_ms)


def _about_z(angle: float) -> FloatArray:
    turned: FloatArray = pin.exp3(np.array([0.0, 0.0, angle]))
    return turned


def _row(outcome: str, times: Any, errors: Any, solve_ms: Any, look_ms: Any = ()) -> Row:
    return {
        "done": outcome == "reached",
        "outcome": outcome,
        "time_s": float(times[-1]),
        "error_deg": float(errors[-1]),
        "least_deg": float(np.min(errors)),
        "solve_ms": float(np.median(solve_ms)),
        "solve_95_ms": float(np.percentile(solve_ms, 95)),
        "look_share": 1e-3 * float(np.sum(look_ms)) / float(times[-1]),
    }


def _published(case: Row) -> Row:
    """A case of the published scene, with its controller or ours."""
    with chdir(case["folder"]):  # it names its scenes from there
        return _run_published(case)


def _run_published(case: Row) -> Row:
    theirs = _their_code(case["folder"])
    param = theirs.params(rand_seed=case["seed"], target_type="rotation")
    env = theirs.env(param)
    model, data = env.model_, env.data_
    bodies = [int(model.site(name).bodyid[0]) for name in env.fingertip_names_]
    plant = Plant(
        model=model,
        qpos=np.arange(16),
        dof=np.arange(16),
        ctrl=np.arange(16),
        moment=np.eye(16),
        coupling=np.zeros((0, 16)),
        idle=np.zeros(0, dtype=int),
        object_body=int(model.body("obj").id),
        tips=tuple(
            (body, np.array(model.site(name).pos))
            for body, name in zip(bodies, env.fingertip_names_, strict=True)
        ),
    )
    x, y, z, w = np.roll(np.ravel(param.target_q_), -1)
    goal = pin.Quaternion(float(w), float(x), float(y), float(z)).toRotationMatrix()
    degrees = case["degrees"]
    hold = dict((OURS, THEIRS))[degrees]
    data.ctrl[:] = data.qpos[:16]
    if case["controller"] == "ours":
        log = turn(
            plant,
            data,
            goal,
            np.array(param.target_p_),
            settings=PalmSettings(),
            tolerance_deg=degrees,
            hold_s=hold,
            longest_s=LONGEST["published"],
            seed=case["seed"],
        )
        solve, look = 1e3 * np.array(log.solve_s), 1e3 * np.array(log.look_s)
        return _row(log.outcome, log.time, log.error_deg, solve, look)
    contact, planner = theirs.contact(param), theirs.planner(param)
    errors, solves, held, outcome = [], [], 0.0, "not in time"
    for _ in range(round(LONGEST["published"] / param.h_)):
        state = env.get_state()
        phi, jacobian = contact.detect_once(env)
        start = time.thread_time()
        found = planner.plan_once(
            param.target_p_, param.target_q_, state, phi, jacobian, sol_guess=param.sol_guess_
        )
        solves.append(1e3 * (time.thread_time() - start))
        param.sol_guess_ = found["sol_guess"]
        env.step(found["action"])
        errors.append(angle_deg(plant, data, goal))
        held = held + param.h_ if errors[-1] <= degrees else 0.0
        if held >= hold - 1e-9:
            outcome = "reached"
            break
    return _row(outcome, [param.h_ * len(errors)], errors, solves)


def _their_code(folder: str) -> SimpleNamespace:
    """Classes of the published code, whose window is not opened."""
    from importlib import import_module

    if folder not in sys.path:
        sys.path.insert(0, folder)
        viewer = ModuleType("mujoco.viewer")
        viewer.launch_passive = lambda *_, **__: SimpleNamespace(  # type: ignore[attr-defined]
            sync=lambda: None, close=lambda: None
        )
        sys.modules["mujoco.viewer"] = mujoco.viewer = viewer
    return SimpleNamespace(
        params=import_module("examples.mpc.allegro.cube.params").ExplicitMPCParams,
        planner=import_module("planning.mpc_explicit").MPCExplicit,
        env=import_module("envs.allegro_env").MjSimulator,
        contact=import_module("contact.allegro_collision_detection").Contact,
    )


def tables(result: Row) -> Iterator[Row]:
    """A line per scene, controller, object, goal and test."""
    yield summary(
        "Turned in the palm, palm up",
        result["rows"],
        ("scene", "controller", "object", "goal", "degrees"),
        {
            "done": share("done"),
            "time, s": of("time_s", digits=1),
            "error at the end, deg": of("error_deg", digits=1),
            "solve, ms of CPU": of("solve_ms", digits=1),
            "95 %": of("solve_95_ms", digits=1),
            "looks, s of CPU a second": of("look_share", digits=2),
            "ended": counted("outcome"),
        },
    )
