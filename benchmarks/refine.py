"""Perturb our own plans and refine them: share brought back, distance, CPU, truth.

The hand is moved by a shift in a random direction and turned about a random axis through the middle
of its contacts; each joint of its fingers is moved by a random amount of at most half of the turn,
within its limits. The wrist stays. Fingers are not named: those whose pads are near take part.

A grasp counts as brought back where there is a plan, and as near where all its contacts lie within
``NEAR`` of the points of the surface that the perturbed pads were nearest to, on the side that they
face. Every plan is verified again from its base and joints alone (``verify_grasp``). CPU is that of
``refine_grasp`` without building the problem, which happens once per hand, fingers and kind of
shape.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
import pinocchio as pin
import typer

from benchmarks.bench import HandOptions, NumberOption, ObjectsOption
from benchmarks.common import MESHES, PRIMITIVES, cells_of, seed_of, task_of
from benchmarks.summary import of, parts, ratio, share, spread, summary
from planner.errors import TaskError
from planner.failure import Failure
from planner.plan import GraspPlan
from planner.search.grasp import plan_grasp
from planner.search.refine import refine_grasp
from planner.spatial import SE3, FloatArray
from planner.verification import verify_grasp
from sim.cli.options import numbers
from sim.tables import Row

NEAR = 0.012
"""Displacement (m) of every contact up to which a grasp counts as near."""

JOINT_SHARE = 0.5
"""Largest change of a joint over the turn (-)."""

MOST = 6
"""Most amounts of one measurement."""


@dataclass(frozen=True, kw_only=True)
class Options(HandOptions):
    """Plans of every hand and object, perturbed by every amount."""

    n: NumberOption = 50
    objects: ObjectsOption = f"{PRIMITIVES},{MESHES}"
    shifts: Annotated[
        str, typer.Option(help="How far hands are moved, mm, comma separated.", metavar="MM")
    ] = "5,10,20"
    turns: Annotated[
        str, typer.Option(help="How much they are turned each time, rad.", metavar="RAD")
    ] = "0.1,0.2,0.3"


def cases(options: Options) -> Iterator[Row]:
    """Plans of every hand, object and amount.

    Raises:
        TaskError: A shift or turn that is negative.
    """
    count = min(options.shifts.count(",") + 1, MOST)
    shifts = numbers("--shifts", options.shifts, count)
    levels = list(zip(shifts, numbers("--turns", options.turns, count), strict=True))
    if any(not (a >= 0 and b >= 0) for a, b in levels):
        raise TaskError(f"amounts are {levels}; give shifts and turns >= 0")
    for cell in cells_of(options.hand_names, options.objects):
        for shift, turn in levels:
            for k in range(options.n):
                amount = {"shift_mm": shift, "turn_rad": turn}
                yield {**cell, **amount, "k": k, "seed": options.seed}


def perturbed(
    plan: GraspPlan, shift: float, turn: float, rng: np.random.Generator
) -> tuple[SE3, FloatArray]:
    """Base pose and joints (nq,) of a plan's hand, moved as the module says.

    Args:
        plan: The plan.
        shift: How far, m.
        turn: How much, rad.
        rng: Random numbers.
    """
    along, axis = (v / np.linalg.norm(v) for v in rng.normal(size=(2, 3)))
    hand, T, middle = plan.task.hand, plan.T_world_base, plan.contacts.positions.mean(axis=0)
    rotation = np.array(pin.exp3(turn * axis))
    place = middle + rotation @ (T.translation - middle) + shift * along
    most = JOINT_SHARE * turn
    change = rng.uniform(-most, most, hand.nq)
    change[np.concatenate([hand.wrist_index, hand.arm_index])] = 0.0
    q = np.clip(plan.q + change, hand.q_lower, hand.q_upper)
    return SE3(rotation @ T.rotation, place), q


def measure(case: Row) -> Row:
    """Plan, perturb and refine one grasp."""
    task = replace(task_of(case["hand"], case["spec"]))
    seed = seed_of(case["seed"], task.object.shape, case["k"])
    plan = plan_grasp(task, seed=seed)
    shift = 1e-3 * case["shift_mm"]
    rng = np.random.default_rng([seed % 2**32, round(1e6 * shift)])
    base, q = perturbed(plan, shift, case["turn_rad"], rng)
    if case["k"] == 0:
        refine_grasp(task, base, q)  # builds the problem, and loads the kernels
    result = refine_grasp(task, base, q)
    failure, moved, refined = result.failure, result.movement, result.plan
    row = {
        "tried": 1,
        "found": result.found,
        "back": int(result.found),
        "reason": "" if failure is None else failure.kind,
        "text": "" if failure is None else failure.text,
        "tries": len(result.attempts),
        "cpu_s": result.cpu_s,
        "build_s": result.build_s,
        "fingers": list(result.task.finger_names),
        "again": None,
    }
    if moved is not None and refined is not None:
        row |= {"contact_mm": 1e3 * moved.contact, "joint_rad": moved.joint}
        row |= {"palm_mm": 1e3 * moved.shift, "palm_rad": moved.turn}
        row["near"] = int(moved.contact <= NEAR)
        fresh = replace(refined.task)  # nothing that was prepared for the task is used again
        again = verify_grasp(fresh, refined.T_world_base, refined.q, record=refined.record)
        row |= {"again": not isinstance(again, Failure)}
        row["untrue"] = again.text if isinstance(again, Failure) else ""
    return row


def tables(result: Row) -> Iterator[Row | str]:
    """Shares brought back and near, distances and CPU; then what was untrue, and why not found."""
    rows = [row for row in result["rows"] if not row["error"]]
    back, near = (ratio(name, "tried", 1, 100.0) for name in ("back", "near"))
    yield summary(
        "perturbed plans brought back (median / 90 % of what was found; CPU of all)",
        rows,
        {"hand": "hand", "object": "object", "shift_mm": "shift mm", "turn_rad": "turn rad"},
        {
            "brought back": lambda frame: f"{parts('back', 'tried')(frame)} = {back(frame)} %",
            f"within {1e3 * NEAR:g} mm": lambda frame: (
                f"{parts('near', 'tried')(frame)} = {near(frame)} %"
            ),
            "contact mm": spread("contact_mm", 1),
            "joint rad": spread("joint_rad", 2),
            "palm mm": spread("palm_mm", 1),
            "palm rad": spread("palm_rad", 2),
            "tries": of("tries", "mean"),
            "CPU ms": spread("cpu_s", 1, 1e3),
            "again true": share("again", known="again"),
        },
        [(None, "all", None, None), ("all", "all", None, None)],
    )
    reasons = Counter(row["reason"] for row in rows if row["reason"])
    if reasons:
        yield "not found: " + ", ".join(f"{name} {n}" for name, n in reasons.most_common())
    untrue = [row for row in rows if row.get("untrue")]
    yield from (f"{r['hand']} {r['object']} {r['k']}: {r['untrue']}" for r in untrue)
