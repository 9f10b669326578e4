"""Hold exported grasps in MuJoCo and in Drake: held here, there, in both.

Each plan is exported (``sim.scene.export``), and the export is held for 2 s under gravity by the
check that ships with it, in MuJoCo, and in Drake (``sim.protocols.drake``); with --pushes six times
more, pushed as the protocol pushes, in both. Of --physics Drake takes the friction alone.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from benchmarks.bench import HandOptions, ObjectsOption
from benchmarks.common import PRIMITIVES, Setting, cells_of, task_of
from benchmarks.summary import Columns, of, share, summary
from planner.errors import TaskError
from planner.search.grasp import plan_grasp
from sim.cli.execution import physics_of
from sim.cli.options import MassOption, PhysicsOption, SimMuOption, TypeOption
from sim.protocols.drake import drake_cases, holds_in_drake
from sim.protocols.drake_scene import drake_missing
from sim.scene.export import export_scene
from sim.scene.export.check import hold
from sim.tables import Row


@dataclass(frozen=True, kw_only=True)
class Options(HandOptions):
    """Seeds of every hand and object."""

    objects: ObjectsOption = PRIMITIVES
    sim_mu: SimMuOption = None
    physics: PhysicsOption = "ours"
    type: TypeOption = None
    mass: MassOption = None
    pushes: Annotated[
        bool, typer.Option("--pushes", help="Also push from six sides; 7 times the time.")
    ] = False


def cases(options: Options) -> Iterator[Row]:
    """Seeds of every hand and object.

    Raises:
        TaskError: Drake is not installed.
    """
    if reason := drake_missing():
        raise TaskError(reason)
    physics = physics_of(options.physics, options.sim_mu)
    setting = Setting(grasp_type=options.type, mass=options.mass)
    for cell in cells_of(options.hand_names, options.objects):
        for k in range(options.n):
            seed = options.seed + k
            told = {"seed": seed, "physics": physics, "pushes": options.pushes}
            yield {**cell, **told, "setting": setting}


def measure(case: Row) -> Row:
    """Plan, export and hold one seed in both engines; the worst of its holds counts."""
    begin = time.process_time()
    plan = plan_grasp(task_of(case["hand"], case["spec"], case["setting"]), seed=case["seed"])
    planned = time.process_time()
    tests = drake_cases() if case["pushes"] else drake_cases()[:1]
    with tempfile.TemporaryDirectory() as made:
        folder = Path(made) / "scene"
        export_scene(plan, folder, physics=case["physics"])
        exported = time.process_time()
        here = [hold(folder / "scene.xml", push=test.push(plan)) for test in tests]
        stepped = time.process_time()
        there = list(holds_in_drake(folder, [test.push(plan) for test in tests]))
    lost = [f"{test.name}: {o.detail}" for test, o in zip(tests, there, strict=True) if not o.held]
    held, other = all(h for h, _, _ in here), not lost
    return {
        "found": True,
        "reason": "; ".join(lost),
        "plan_cpu_s": planned - begin,
        "mujoco_held": held,
        "mujoco_mm": max(mm for _, mm, _ in here),
        "mujoco_deg": max(deg for _, _, deg in here),
        "mujoco_cpu_s": stepped - exported,
        "drake_held": other,
        "drake_mm": max(float(o.moved_mm[-1]) for o in there),
        "drake_deg": max(float(o.turned_deg[-1]) for o in there),
        "drake_cpu_s": time.process_time() - stepped,
        "both": held and other,
    }


COLUMNS: Columns = {
    "plans": share("found"),
    "MuJoCo": share("mujoco_held", where="found"),
    "Drake": share("drake_held", where="found"),
    "both": share("both", where="found"),
    "mm": of("mujoco_mm"),
    "mm Drake": of("drake_mm"),
    "CPU s": of("mujoco_cpu_s"),
    "CPU s Drake": of("drake_cpu_s"),
}


def tables(result: Row) -> Iterator[Row | str]:
    """Held per hand and object in each engine and in both; then every plan that Drake lost."""
    pushed = ", then pushed by half of the weight from six sides" * result["setting"]["pushes"]
    title = f"held for 2 s by position commands alone{pushed}; medians of movement and CPU"
    rows = sorted(result["rows"], key=lambda r: (r["hand"], r["object"]))
    yield summary(title, rows, ("hand", "object"), COLUMNS, [("all", "")])
    for row in rows:
        if row.get("reason"):
            yield f"{row['hand']} {row['object']} seed {row['seed']}: {row['reason']}"
