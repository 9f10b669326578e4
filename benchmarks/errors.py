"""Compare loops under errors: the same trials with truth, readings, estimates, open loop.

hold    pick five shapes up and hold them, as ``grasps``
turn    turn cylinders and blocks by 90 degrees in the hand, as ``manipulate``, with its drawn
        sizes, masses, frictions, places and pushes; successes with closure count
pushes  hold ten shapes in the air for a minute under random pushes, as the protocol ``pushes``

Verdicts are those of the trials and read the truth, whatever a loop is told. Trial k of a task and
a hand has object k modulo their number and the draw k over it.
"""

from __future__ import annotations

import re
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from types import MappingProxyType
from typing import Annotated, Any

import numpy as np
import typer
from scipy.stats import binomtest

from benchmarks.bench import HandOptions
from benchmarks.common import Setting, checked_hand, known, task_of
from benchmarks.loops import LOOPS, Loop, named_loop, register_loop
from benchmarks.manipulate import Turn, believed, execute_turn, plan_turn
from benchmarks.summary import Cell, Frame, counted, of, summary
from planner.errors import HandError, NotFoundError, PlannerError, TaskError
from planner.motion.manipulation import ManipulationPlan
from planner.plan import GraspPlan
from planner.search.grasp import plan_grasp
from sim.cli.execution import error_model_of
from sim.cli.options import names
from sim.manipulation import ManipulationReport
from sim.protocols.disturbance import Settings
from sim.protocols.outcome import Conditions
from sim.protocols.shake_pushes import PushesCase
from sim.scene.physics import PhysicsOptions
from sim.sensing.errors import ErrorModel
from sim.sensing.estimation import EstimateLog
from sim.tables import Row
from sim.trial import simulate

__all__ = ["LOOPS", "Loop", "register_loop"]

CLASSES = (
    (r"the object was dropped", "dropped"),
    (r"diverged|not finite", "diverged"),
    (r"fingers touch, \d+ are needed|nothing touches", "no contact"),
    (r"^turn.*: turned .* of .* degrees", "stalled"),
    (r"^hold.*: turned .* of .* degrees", "turned back"),
    (r"tilted by .* off the axis", "tilted"),
    (r"was moved by .* and tilted by", "knocked over"),
    (r"moved .* mm in the hand and rose", "slipped in the lift"),
    (r"no force closure", "no closure"),
)
"""What a reason of a report holds -> its class; the first that fits."""

FAULTS = (
    (r"the hand collided", "hand collided"),
    (r"samples without force closure", "closure lost at times"),
    (r"fingers touched at times", "fingers lost at times"),
    (r"pressed with", "pressed too hard"),
)
"""The same of faults of a turn that was made, the worst first."""

SHORT = "short of the angle"
"""Turned far enough to go on, and not as far as was asked for."""

SHAPES = ("sphere", "box", "cylinder", "capsule", "ellipsoid")
TURNED = ("cylinder", "block")
PUSHED = (*SHAPES, "mug", "lbracket", "torus", "hammer", "superquadric")

HEIGHT = 0.08
"""Height of cylinders and blocks that are turned, m, that of ``manipulate``."""


def class_of_turn(report: ManipulationReport) -> str:
    """Why a turn is no success with closure, "" if it is one."""
    if report.success_with_closure:
        return ""
    if report.dropped:
        return "dropped"
    if report.success:
        return _first(FAULTS, report.faults) or report.faults
    failed = [r for r in report.results if not r.passed]
    if not failed:
        return SHORT
    last = failed[-1]
    told = _first(CLASSES, f"{last.phase}: {last.reason}")
    # an object that is not as far as was asked went on, and something later went wrong
    return told or (SHORT if len(report.log.during("hold")) else str(last.phase))


def _first(classes: tuple[tuple[str, str], ...], text: str) -> str:
    return next((name for pattern, name in classes if re.search(pattern, text)), "")


@dataclass(frozen=True, kw_only=True)
class ComparedTask:
    """One task.

    Attributes:
        about: What is tried and what counts, in one line.
        objects: Which take turns.
        plan: Plans a trial: hand, object, seed, and the error model, of which it knows how well
            joints are calibrated; raises ``PlannerError`` where there is no plan.
        execute: Executes a plan: hand, object, seed, plan, loop, error model with its seed. The
            row has "success", and "reason", the class of what went wrong, "" if nothing did.
    """

    about: str
    objects: tuple[str, ...]
    plan: Callable[[str, str, int, ErrorModel], Any] = field(repr=False)
    execute: Callable[[str, str, int, Any, Loop, ErrorModel], Row] = field(repr=False)

    def only(self, objects: Sequence[str]) -> tuple[str, ...]:
        """Those of its objects that are named, or all if none are.

        Raises:
            NotFoundError: One is no object of this task.
        """
        for name in objects:
            if name not in self.objects:
                raise NotFoundError("object of the task", name, self.objects)
        return tuple(name for name in self.objects if not objects or name in objects)


def _plan_grasp(hand: str, kind: str, seed: int, error_model: ErrorModel) -> GraspPlan:
    task = task_of(hand, kind, Setting(joint_error=error_model.encoder_offset))
    return plan_grasp(task, seed=seed)


def _hold(
    hand: str, kind: str, seed: int, plan: GraspPlan, loop: Loop, error_model: ErrorModel
) -> Row:
    del hand, kind, seed
    report = simulate(
        plan, controller=loop.holding(plan), error_model=error_model, estimator=loop.estimator
    )
    slip_mm, slip_deg = report.largest_slip
    return {
        "success": report.success,
        "reason": report.reason,
        "detail": report.verdict.detail,
        "slip_mm": slip_mm,
        "slip_deg": slip_deg,
    }


def _turn(hand: str, kind: str, seed: int, error_model: ErrorModel) -> Turn:
    """The trial ``seed`` of ``manipulate --seed 0``, so that both measure the same ones."""
    return Turn(
        hand=hand,
        kind=kind,
        number=seed,
        height=HEIGHT,
        fingers=None,
        stand=0.0,
        seed=0,
        error_model=error_model,
    )


def _plan_turn(hand: str, kind: str, seed: int, error_model: ErrorModel) -> ManipulationPlan:
    turn = _turn(hand, kind, seed, error_model)
    return plan_turn(turn, believed(turn))


def _execute_turn(
    hand: str, kind: str, seed: int, plan: ManipulationPlan, loop: Loop, error_model: ErrorModel
) -> Row:
    turn = replace(_turn(hand, kind, seed, error_model), estimator=loop.estimator)
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


def _pushed(
    hand: str, kind: str, seed: int, plan: GraspPlan, loop: Loop, error_model: ErrorModel
) -> Row:
    del hand, kind
    case = PushesCase(index=0, settings=Settings(), seed=seed)
    conditions = Conditions(
        physics=PhysicsOptions(),
        controller=loop.holding,
        error_model=error_model,
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


TASKS: Mapping[str, ComparedTask] = MappingProxyType(
    {
        "hold": ComparedTask(
            about="five shapes picked up and held for 2 s; the verdict of every trial",
            objects=SHAPES,
            plan=_plan_grasp,
            execute=_hold,
        ),
        "turn": ComparedTask(
            about="cylinders and blocks turned by 90 degrees or more; successes with closure",
            objects=TURNED,
            plan=_plan_turn,
            execute=_execute_turn,
        ),
        "pushes": ComparedTask(
            about="ten shapes held for 60 s under random pushes",
            objects=PUSHED,
            plan=_plan_grasp,
            execute=_pushed,
        ),
    }
)
"""Tasks by their names."""


@dataclass(frozen=True, kw_only=True)
class Options(HandOptions):
    """Trials of every hand, task, error model and loop."""

    tasks: Annotated[
        str, typer.Option(help="Comma separated: hold, turn, pushes (a minute each).")
    ] = "hold,turn"
    error_models: Annotated[
        str, typer.Option(help="Comma separated: ideal, lab, rough, or TOML or JSON files.")
    ] = "ideal,lab,rough"
    loops: Annotated[
        str,
        typer.Option(
            help="Comma separated: truth, readings, estimates, touch, contact, open, blind, "
            "policy:FILE; the first six if not given."
        ),
    ] = ""
    objects: Annotated[
        str, typer.Option(help="Comma separated: those of the tasks' objects; all if not given.")
    ] = ""


def cases(options: Options) -> Iterator[Row]:
    """All trials, those of one draw one after the other, so that a plan serves them all.

    Raises:
        NotFoundError: A hand, a task, a loop or an object of a task that does not exist.
        TaskError: A loop that cannot run here, two error models of one name, or nothing that is
            asked for can be done.
    """
    error_models = {r: r.name for r in map(error_model_of, names(options.error_models))}
    for name, count in Counter(error_models.values()).items():
        if count > 1:
            raise TaskError(
                f"{count} error models are called {name!r}; give each a name of its own"
            )
    usual = [name for name, loop in LOOPS.items() if loop.usual and not loop.why_not()]
    loops = [named_loop(name) for name in (names(options.loops) if options.loops else usual)]
    tasks = known("task", options.tasks, list(TASKS))
    if not any(loop.does(task) for loop in loops for task in tasks):
        raise TaskError(
            f"no trial to run: {', '.join(loop.name for loop in loops)} cannot do "
            f"{', '.join(tasks)}; name another loop"
        )
    only = names(options.objects) if options.objects else ()
    for hand in options.hand_names:
        checked_hand(hand)
    for k in range(options.n):
        for task in tasks:
            objects = TASKS[task].only(only)
            draw = options.seed + k // len(objects)
            for hand in options.hand_names:
                for error_model, name in error_models.items():
                    for loop in loops:
                        if loop.does(task):
                            of_ = {"task": task, "under": name, "loop": loop.name, "hand": hand}
                            what = {"object": objects[k % len(objects)], "draw": draw}
                            run = {"driver": loop.driver, "estimator": loop.estimator}
                            yield {**of_, **what, **run, "error_model": error_model}


def measure(case: Row) -> Row:
    """Plan and execute one trial of one loop."""
    task, loop, error_model = TASKS[case["task"]], named_loop(case["loop"]), case["error_model"]
    hand, item, draw = case["hand"], case["object"], case["draw"]
    # error models with the same encoders have the same plans
    encoders = ErrorModel(encoder_offset=error_model.encoder_offset)
    plan, planning_cpu_s = _planned(case["task"], hand, item, draw, encoders)
    row: Row = {"planning_cpu_s": planning_cpu_s, "planned": not isinstance(plan, str)}
    if isinstance(plan, str):
        return row | {"success": False, "reason": "no plan", "detail": plan}
    begin = time.process_time()
    told = loop.told(error_model).seeded(draw)
    try:
        came = task.execute(hand, item, draw, plan, loop, told)
    except HandError as error:  # a policy of another hand
        return row | {"success": False, "reason": "refused", "detail": str(error)}
    return row | {"simulation_cpu_s": time.process_time() - begin, **came}


@lru_cache(maxsize=2)
def _planned(task: str, hand: str, item: str, draw: int, encoders: ErrorModel) -> tuple[Any, float]:
    """A plan, or why there is none, and its CPU time, s; made once for the loops that follow."""
    begin = time.process_time()
    try:
        plan: Any = TASKS[task].plan(hand, item, draw, encoders)
    except PlannerError as error:
        plan = str(error)
    return plan, time.process_time() - begin


def tables(result: Row) -> Iterator[Row | str]:
    """A table of rates for each task, then the reasons, then the numbers."""
    rows = [row for row in result["rows"] if not row["error"]]
    loops = [named_loop(name) for name in dict.fromkeys(row["loop"] for row in rows)]
    yield from (f"{loop.name}: {loop.about}." for loop in loops)
    for task, members in TASKS.items():
        mine = [row for row in rows if row["task"] == task]
        if mine:
            title = f"{members.about}: successes out of all trials, in percent the 95 % interval"
            columns = {loop.name: _rate(loop.name) for loop in loops}
            several = len({row["hand"] for row in mine}) > 1
            totals = [(None, "all")] if several else []
            heads = {"under": "error model", "hand": "hand"}
            yield summary(f"{title} of Wilson", mine, heads, columns, totals)
    by = {"task": "task", "under": "error model", "loop": "loop"}
    yield summary(
        "reasons of failures, counted",
        [row for row in rows if row["reason"]],
        by,
        {"reasons": counted("reason")},
    )
    yield summary(
        "medians over all trials, also those that failed; CPU of one core",
        rows,
        by,
        {
            "off deg": of("off_deg", digits=1),
            "tilt deg": of("tilt_deg", digits=1),
            "estimate off mm": of("pose_mm", digits=1),
            "estimate off deg": of("pose_deg", digits=1),
            "within 2 sigma": of("within_two_sigma"),
            "slip mm": of("slip_mm", digits=1),
            "slip deg": of("slip_deg", digits=1),
            "pushes": of("pushes_survived", digits=0),
            "planning CPU s": of("planning_cpu_s", digits=1),
            "trial CPU s": of("simulation_cpu_s", digits=1),
        },
    )


def _rate(loop: str) -> Cell:
    def cell(frame: Frame) -> str:
        tried = frame[frame["loop"] == loop]["success"]
        if not len(tried):
            return "-"
        held, n = int(tried.sum()), len(tried)
        interval = binomtest(held, n).proportion_ci(method="wilson")
        return f"{held}/{n} ({100 * interval.low:.0f}-{100 * interval.high:.0f})"

    return cell
