"""``run_refine``: our own plans, perturbed, and what share of them a refinement brings back.

The hand is moved by a shift in a random direction and turned about a random axis through the middle
of its contacts; each joint of its fingers is moved by a random amount of at most half of the turn,
within its limits. The wrist stays. Fingers are not named: those whose pads are near take part.

A grasp counts as brought back where there is a plan, and as near where all its contacts lie within
``NEAR`` of the points of the surface that the perturbed pads were nearest to, on the side that they
face. Every plan is verified again from its base and joints alone (``verify_grasp``), and asked for
``benchmarks.plain_check``'s second opinion. "Either side" is the share that is near by the nearest
points whatever their side, by the second opinion's distances. CPU is that of ``refine_grasp``
without building the problem, which happens once per hand, fingers and kind of shape.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
import pinocchio as pin
from rich.table import Table

from benchmarks.objects import BenchObject
from benchmarks.plain_check import doubts, nearest_on
from benchmarks.requests import check_tasks, loaded_hand
from benchmarks.run import ObjectJob, measure
from benchmarks.statistics import median_of, quantile_of, summed
from planner.batch.pool import grasp_seed
from planner.errors import NoGraspFoundError, PlannerError, TaskError
from planner.failure import Failure
from planner.kinematics.state import HandState
from planner.objects import parse_object
from planner.plan import GraspPlan
from planner.refine import RefinedGrasp, refine_grasp
from planner.search import plan_grasp
from planner.shapes import shape_key
from planner.spatial import SE3, FloatArray
from planner.task import GraspTask
from planner.verification.grasp import verify_grasp
from sim.runner import Check, Runner
from sim.tables import Row, number, percent, share, summary_table

NEAR = 0.012
"""Displacement (m) of every contact up to which a grasp counts as near."""

LEVELS = ((0.005, 0.1), (0.01, 0.2), (0.02, 0.3))
"""Shift (m) and turn (rad) of the hand."""

JOINT_SHARE = 0.5
"""Largest change of a joint over the turn (-)."""


@dataclass(frozen=True, kw_only=True)
class _RefineJob(ObjectJob):
    """A plan of one seed, perturbed by one amount."""

    SHOWN: ClassVar = ("hand", "label", "k", "shift_mm", "turn_rad")

    k: int
    seed: int
    shift: float
    turn_rad: float
    checked: bool

    @property
    def shift_mm(self) -> float:
        """The shift in mm."""
        return 1e3 * self.shift

    def lost(self, reason: str) -> Row:
        """The row of a job without a plan to perturb."""
        return self.row(error=reason, found=False)


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


def _made(job: _RefineJob, check: Check) -> Row:
    try:
        item = parse_object(job.spec)
        task = GraspTask.create(loaded_hand(job.hand), item)
        seed = grasp_seed(job.seed, shape_key(item.shape), job.k)
        plan = plan_grasp(task, seed=seed)
    except (PlannerError, NoGraspFoundError) as error:
        return job.lost(str(error))
    check()
    rng = np.random.default_rng([seed % 2**32, round(1e6 * job.shift)])
    base, q = perturbed(plan, job.shift, job.turn_rad, rng)
    if job.k == 0:
        refine_grasp(task, base, q)  # builds the problem, and loads the kernels
    result = refine_grasp(task, base, q)
    check()
    return job.row(
        error="",
        found=result.found,
        reason="" if result.failure is None else result.failure.kind,
        text="" if result.failure is None else result.failure.text,
        tries=len(result.attempts),
        cpu_s=result.cpu_s,
        build_s=result.build_s,
        fingers=list(result.task.finger_names),
        same_fingers=set(result.task.finger_names) == set(plan.task.finger_names),
        **_moved(result),
        plain_mm=_plain_mm(result),
        **_truth(result, job.checked),
    )


def _moved(result: RefinedGrasp) -> Row:
    moved = result.movement
    if moved is None:
        return {"contact_mm": None, "joint_rad": None, "palm_mm": None, "palm_rad": None}
    return {
        "contact_mm": 1e3 * moved.contact,
        "joint_rad": moved.joint,
        "palm_mm": 1e3 * moved.shift,
        "palm_rad": moved.turn,
    }


def _plain_mm(result: RefinedGrasp) -> float | None:
    """The largest displacement of a contact from the point nearest to the given pad, by formula.

    Whatever side that point is on: of a pad beyond the edge of a face it is on another one.
    """
    plan, task = result.plan, result.task
    if plan is None:
        return None
    state = HandState(task.hand, result.q)
    base = task.T_world_object.inverse() * result.T_world_base
    pads = np.array([base.act(state.pad_center(finger)) for finger in task.fingers])
    points = nearest_on(task.object.shape, pads)[1]
    moved = plan.contacts_in_object.positions - points
    return 1e3 * float(np.linalg.norm(moved, axis=1).max())


def _truth(result: RefinedGrasp, checked: bool) -> Row:
    """What verdicts from scratch say of a plan: of ours, and of the second opinion."""
    plan = result.plan
    if plan is None:
        return {"again": None, "doubts": None}
    fresh = replace(plan.task)  # nothing that was prepared for the task is used again
    again = verify_grasp(fresh, plan.T_world_base, plan.q, record=plan.record)
    return {
        "again": again.text if isinstance(again, Failure) else "",
        "doubts": doubts(plan) if checked else None,
    }


def run_refine(
    hands: Sequence[str],
    objects: Sequence[BenchObject],
    n: int,
    *,
    levels: Sequence[tuple[float, float]] = LEVELS,
    checks: int,
    seed: int,
    runner: Runner,
) -> Row:
    """Perturb and refine n plans of every hand and object by every amount (``benchmarks``).

    Args:
        hands: Names or paths.
        objects: What is grasped.
        n: Plans for each hand and object.
        levels: Shift (m) and turn (rad) of each amount.
        checks: How many of each hand, object and amount get the second opinion.
        seed: Of the measurement.
        runner: Who works.

    Raises:
        TaskError: A shift or turn that is negative.
    """
    if any(not (a >= 0 and b >= 0) for a, b in levels):
        raise TaskError(f"amounts are {list(levels)}; give shifts and turns >= 0")
    check_tasks(hands, objects)
    cells = [(hand, item, level) for hand in hands for item in objects for level in levels]
    jobs = [
        _RefineJob(
            index=number * n + k,
            hand=hand,
            spec=item.spec,
            label=item.label,
            k=k,
            seed=seed,
            shift=shift,
            turn_rad=turn,
            checked=k < checks,
        )
        for number, (hand, item, (shift, turn)) in enumerate(cells)
        for k in range(n)
    ]
    return measure(
        runner,
        _made,
        jobs,
        kind="opposable-bench-refine",
        title="refine",
        lost=_RefineJob.lost,
        seed=seed,
        near_mm=1e3 * NEAR,
    )


def refine_tables(result: Row) -> list[Table | str]:
    """Shares brought back and near, distances and CPU; then what was untrue, and why not found."""
    rows = [row for row in result["rows"] if not row["error"]]
    near = result["near_mm"]
    columns = {
        "brought back": lambda rs: _part(rs, [r for r in rs if r["found"]]),
        f"within {near:g} mm": lambda rs: _part(
            rs, [r for r in rs if r["found"] and r["contact_mm"] <= near]
        ),
        "either side": lambda rs: _part(
            rs, [r for r in rs if r["found"] and r["plain_mm"] <= near]
        ),
        "contact mm": lambda rs: _spread(rs, "contact_mm", 1),
        "joint rad": lambda rs: _spread(rs, "joint_rad", 2),
        "palm mm": lambda rs: _spread(rs, "palm_mm", 1),
        "palm rad": lambda rs: _spread(rs, "palm_rad", 2),
        "tries": lambda rs: number(float(np.mean([r["tries"] for r in rs])), 2),
        "CPU ms": lambda rs: _spread(rs, "cpu_s", 1, scale=1e3, found=False),
        "again true": lambda rs: share(r["again"] == "" for r in rs if r["again"] is not None),
        "no doubts": lambda rs: share(r["doubts"] == [] for r in rs if r["doubts"] is not None),
    }
    heads = {"hand": "hand", "object": "object", "shift_mm": "shift mm", "turn_rad": "turn rad"}
    table = summary_table(
        "perturbed plans brought back (median / 90 % of what was found; CPU of all)",
        rows,
        heads,
        columns,
        totals=[(None, "all", None, None), ("all", "all", None, None)],
    )
    reasons = summed({r["reason"]: 1} for r in rows if r["reason"])
    untrue = [
        f"{r['hand']} {r['object']} {r['k']}: {r['again'] or '; '.join(r['doubts'] or [])}"
        for r in rows
        if r["again"] or r["doubts"]
    ]
    refused = {f"{r['object']}: {r['error']}": None for r in result["rows"] if r["error"]}
    said = ["not found: " + ", ".join(f"{k} {v:g}" for k, v in reasons.items())] if reasons else []
    return [table, *said, *untrue, *refused]


def _part(rows: list[Row], some: list[Row]) -> str:
    return f"{len(some)}/{len(rows)} = {percent(len(some), len(rows), 1)}"


def _spread(
    rows: list[Row], name: str, digits: int, *, scale: float = 1.0, found: bool = True
) -> str:
    values = [r[name] for r in rows if r["found"] or not found]
    return f"{number(median_of(values), digits, scale)} / " + number(
        quantile_of(values, 0.9), digits, scale
    )
