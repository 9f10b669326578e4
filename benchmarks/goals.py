"""Goal poses: random rotations reached from the table by each hand with each object.

A case draws, from its seed and number alone, the goal, uniform over all rotations, and what
planner and controller do not know: mass, friction, and where the object really stands
(``benchmarks.conditions``). Planned for are the largest mass and the least friction less a margin.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Annotated
from zlib import crc32

import numpy as np
import pinocchio as pin
import typer

from benchmarks.bench import HandOptions, ObjectsOption
from benchmarks.common import MESHES, PRIMITIVES, cells_of
from benchmarks.conditions import BELIEVED_MU, MASS, Conditions
from benchmarks.summary import counted, of, share, summary
from planner.errors import PlannerError
from planner.motion.goals import plan_reorientation
from planner.motion.roadmap import ROADMAP_S
from planner.motion.task import manipulation_task
from planner.numerics.kernels import planning_time
from planner.objects import parse_object
from planner.spatial import SE3
from sim.manipulation import manipulate, settled
from sim.scene.physics import PhysicsOptions
from sim.tables import Row


@dataclass(frozen=True, kw_only=True)
class Options(HandOptions):
    """Goals of every hand and object."""

    objects: ObjectsOption = f"{PRIMITIVES},{MESHES}"
    goal_tilt: Annotated[
        float, typer.Option(help="Most tilt of the palm from straight down at the goal, degrees.")
    ] = 180.0


def cases(options: Options) -> Iterator[Row]:
    """Hands x objects x goals."""
    for cell in cells_of(options.hand_names, options.objects):
        for number in range(options.n):
            drawn = {"number": number, "seed": options.seed, "goal_tilt": options.goal_tilt}
            yield {**cell, **drawn}


def measure(case: Row) -> Row:
    """Plan and reach one goal."""
    rng = np.random.default_rng([case["seed"], crc32(case["spec"].encode()), case["number"]])
    goal = pin.Quaternion(*_unit(rng.normal(size=4))).toRotationMatrix()
    there = Conditions.draw(case["spec"], 0.0, rng)
    item = parse_object(case["spec"], mass=MASS[1])
    built: list[str] = []
    row: Row = {"reached": False, "dropped": False, "planned": False}
    try:
        stands = settled(manipulation_task(case["hand"], item, mu=BELIEVED_MU)).T_world_object
        begin = planning_time()
        plan = plan_reorientation(
            case["hand"],
            item,
            goal,
            T_world_object=stands,
            goal_tilt=math.radians(case["goal_tilt"]),
            mu=BELIEVED_MU,
            tell=built.append,
        )
    except PlannerError as error:
        return {**row, "reason": f"no plan: {str(error)[:200]}"}
    whole = planning_time() - begin
    task, pose = plan.task, plan.task.T_world_object
    turn = pin.exp3(np.array([0.0, 0.0, there.heading]))
    at = SE3(turn @ pose.rotation, pose.translation + np.array([*there.shift, 0.0]))
    true = replace(task, object=replace(task.object, mass=there.mass), T_world_object=at)
    begin = time.process_time()
    report = manipulate(plan, true_task=true, physics=PhysicsOptions(name="drawn", mu=there.mu))
    parts = [report]
    while parts[-1].earlier is not None:
        parts.append(parts[-1].earlier)
    return {
        **row,
        "planned": True,
        "reached": report.goal_reached,
        "strict": report.success_with_closure,
        "dropped": any(part.dropped for part in parts),
        "reason": report.reason or ("reached" if report.goal_reached else "off the goal"),
        "faults": report.faults,
        "off_deg": report.numbers()["goal_off_deg"],
        "movements": len(plan.chain),
        "in_fingers": any(not one.path.stays for one in plan.chain),
        "plan_s": plan.cpu_s,
        "roadmap_s": whole - plan.cpu_s if built else None,
        "simulation_s": time.process_time() - begin,
    }


def _unit(drawn: np.ndarray) -> np.ndarray:
    """Four normal numbers as a quaternion, uniform over all rotations."""
    unit: np.ndarray = drawn / np.linalg.norm(drawn)
    return unit


def tables(result: Row) -> Iterator[Row]:
    """Counts out of all goals, and medians, for each hand and object."""
    tilt = result["setting"]["goal_tilt"]
    yield summary(
        f"Goal rotations, held, the palm tilted by {tilt:g} degrees there at most: counts out of "
        f"all (reached: within 5 degrees; strict: with closure, no collision, forces within their "
        f"limit); medians; roadmaps built once per hand and object, in at most {ROADMAP_S:g} s",
        result["rows"],
        ("hand", "object"),
        {
            "planned": share("planned"),
            "reached": share("reached"),
            "strict": share("strict"),
            "drops": share("dropped"),
            "off deg": of("off_deg", where="reached"),
            "movements": of("movements", "max", 0, where="planned"),
            "planning s": of("plan_s", where="planned"),
            "most s": of("plan_s", "max", where="planned"),
            "roadmap s": of("roadmap_s", "max", 0, where="planned"),
            "ended": counted("reason"),
        },
    )
