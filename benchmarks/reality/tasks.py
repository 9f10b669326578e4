"""``ComparedTask``: a task of the comparison, and its verdict.

hold    pick five shapes up and hold them, as ``bench grasps``
turn    turn cylinders and blocks by 90 degrees in the hand, as ``bench manipulate``, with its drawn
        sizes, masses, frictions, places and pushes; strict successes count
pushes  hold ten shapes in the air for a minute under random pushes, as the protocol ``pushes``

Verdicts are those of the trials and read the truth, whatever a loop is told.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from benchmarks.manipulate import Turn, believed, execute_turn, plan_turn
from benchmarks.reality.loops import Loop
from benchmarks.reality.reasons import class_of_turn
from benchmarks.requests import Setting, task_for
from planner.errors import NotFoundError, TaskError
from planner.motion.manipulation import ManipulationPlan
from planner.plan import GraspPlan
from planner.search import plan_grasp
from sim.estimation import EstimateLog
from sim.physics import PhysicsOptions
from sim.protocols.disturbance import Settings
from sim.protocols.outcome import Conditions
from sim.protocols.shake_pushes import PushesCase
from sim.reality import Reality
from sim.tables import Row
from sim.trial import simulate

SHAPES = ("sphere", "box", "cylinder", "capsule", "ellipsoid")
TURNED = ("cylinder", "block")
PUSHED = (*SHAPES, "mug", "lbracket", "torus", "hammer", "superquadric")

HEIGHT = 0.08
"""Height of cylinders and blocks that are turned, m, that of ``bench manipulate``."""


@dataclass(frozen=True, kw_only=True)
class ComparedTask:
    """One task.

    Attributes:
        name: In tables and on the command line.
        about: What is tried and what counts, in one line.
        objects: Which take turns.
        plan: Plans a trial: hand, object, seed, and the reality, of which it knows how well joints
            are calibrated; raises ``PlannerError`` where there is no plan.
        execute: Executes a plan: hand, object, seed, plan, loop, reality with its seed. The row has
            "success", and "reason", the class of what went wrong, "" if nothing did.
    """

    name: str
    about: str
    objects: tuple[str, ...]
    plan: Callable[[str, str, int, Reality], Any] = field(repr=False)
    execute: Callable[[str, str, int, Any, Loop, Reality], Row] = field(repr=False)

    def only(self, objects: Sequence[str]) -> tuple[str, ...]:
        """Those of its objects that are named, or all if none are.

        Raises:
            NotFoundError: One is no object of this task.
        """
        for name in objects:
            if name not in self.objects:
                raise NotFoundError(f"object of the task {self.name}", name, self.objects)
        return tuple(name for name in self.objects if not objects or name in objects)


_TASKS: dict[str, ComparedTask] = {}

TASKS: Mapping[str, ComparedTask] = _TASKS
"""Tasks by their names."""


def register_task(task: ComparedTask) -> ComparedTask:
    """Make a task known by its name, and return it.

    Raises:
        TaskError: Another one has that name.
    """
    if _TASKS.setdefault(task.name, task) is not task:
        raise TaskError(f"there is a task {task.name!r} already; give another name")
    return task


def named_task(name: str) -> ComparedTask:
    """A registered task.

    Raises:
        NotFoundError: There is none of that name.
    """
    if name not in TASKS:
        raise NotFoundError("task", name, TASKS)
    return TASKS[name]


def _plan_grasp(hand: str, kind: str, seed: int, reality: Reality) -> GraspPlan:
    task = task_for(hand, kind, Setting(joint_error=reality.encoder_offset))
    if isinstance(task, str):
        raise TaskError(task)
    return plan_grasp(task, seed=seed)


def _hold(hand: str, kind: str, seed: int, plan: GraspPlan, loop: Loop, reality: Reality) -> Row:
    del hand, kind, seed
    report = simulate(
        plan, controller=loop.holding(plan), reality=reality, estimator=loop.estimator
    )
    slip_mm, slip_deg = report.largest_slip
    return {
        "success": report.success,
        "reason": report.reason,
        "detail": report.verdict.detail,
        "slip_mm": slip_mm,
        "slip_deg": slip_deg,
    }


def _turn(hand: str, kind: str, seed: int, reality: Reality) -> Turn:
    """The trial ``seed`` of ``bench manipulate --seed 0``, so that both measure the same ones."""
    return Turn(
        index=0,
        hand=hand,
        kind=kind,
        number=seed,
        height=HEIGHT,
        fingers=None,
        stand=0.0,
        seed=0,
        reality=reality,
    )


def _plan_turn(hand: str, kind: str, seed: int, reality: Reality) -> ManipulationPlan:
    turn = _turn(hand, kind, seed, reality)
    return plan_turn(turn, believed(turn))


def _execute_turn(
    hand: str, kind: str, seed: int, plan: ManipulationPlan, loop: Loop, reality: Reality
) -> Row:
    turn = replace(_turn(hand, kind, seed, reality), estimator=loop.estimator)
    estimate = EstimateLog()
    report = execute_turn(turn, plan, loop.turning, on_step=estimate)
    numbers = report.numbers()
    off = abs(numbers["turned_deg"] - float(np.rad2deg(turn.angle)))
    return {
        "success": report.success_with_closure,
        "reason": class_of_turn(report),
        "detail": report.reason or report.faults,
        "turned": report.success,
        "complete": report.complete,
        "off_deg": off,
        "tilt_deg": numbers["largest_tilt_deg"],
        **_estimated(estimate),
    }


def _estimated(log: EstimateLog) -> Row:
    """How far the estimate was off when the turn ended, and how well it knew that during it."""
    turning = [k for k, phase in enumerate(log.phase) if phase == "turn"]
    if not turning:
        return {}
    error, deviation = log.error[turning], log.deviation[turning]
    return {
        "pose_mm": 1e3 * float(np.linalg.norm(error[-1, :3])),
        "pose_deg": float(np.rad2deg(np.linalg.norm(error[-1, 3:]))),
        "within_two_sigma": float((np.abs(error) < 2.0 * deviation).mean()),
    }


def _pushed(hand: str, kind: str, seed: int, plan: GraspPlan, loop: Loop, reality: Reality) -> Row:
    del hand, kind
    case = PushesCase(index=0, settings=Settings(), seed=seed)
    conditions = Conditions(
        physics=PhysicsOptions(),
        controller=loop.holding,
        reality=reality,
        estimator=loop.estimator,
    )
    outcome = case.run(plan, conditions)
    moved, turned = outcome.drift
    return {
        "success": outcome.held,
        "reason": outcome.reason,
        "detail": "" if outcome.fault is None else outcome.fault.detail,
        "slip_mm": moved,
        "slip_deg": turned,
        "pushes_survived": outcome.conditions["pushes_survived"],
    }


register_task(
    ComparedTask(
        name="hold",
        about="five shapes picked up and held for 2 s; the verdict of every trial",
        objects=SHAPES,
        plan=_plan_grasp,
        execute=_hold,
    )
)
register_task(
    ComparedTask(
        name="turn",
        about="cylinders and blocks turned by 90 degrees or more; successes with closure",
        objects=TURNED,
        plan=_plan_turn,
        execute=_execute_turn,
    )
)
register_task(
    ComparedTask(
        name="pushes",
        about="ten shapes held for 60 s under random pushes",
        objects=PUSHED,
        plan=_plan_grasp,
        execute=_pushed,
    )
)
