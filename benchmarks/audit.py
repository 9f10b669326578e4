"""Judge good grasps and known faults as those of a foreign file: found, invented, time.

Grasps are planned, written as a table and read again, as those of another tool are. The good ones
must pass, and of each fault a stage that is meant must fail.

    gap           all fingers 30 % of the way back to the pre-grasp
    penetration   all fingers 10 % of that way further, as far as joint limits let them
    no closure    the first finger, which opposes the others, at the pre-grasp
    torque limit  the same grasp pressed with 1000 N per finger, which no actuator has
    wrong hand    base and joints of a right hand for the left one, or the other way round
    wrong scale   the object 20 % larger than the grasp was made for, without its table

A grasp of which no finger opposes all others alone has none without closure by the third.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import cycle, islice
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated

import numpy as np
import typer

from benchmarks.bench import HandOptions, ObjectsOption
from benchmarks.common import cells_of, seed_of, task_of
from benchmarks.summary import Cell, Frame, parts, ratio, summary
from planner.errors import NotFoundError
from planner.exchange.audit import AuditRow, scaled_object
from planner.exchange.audit.judge import Judge
from planner.exchange.formats import ImportedGrasp, Reading, Writing
from planner.exchange.table import read_table, write_table
from planner.hand_loading import load_hand
from planner.hands.hand import Hand
from planner.plan import GraspPlan
from planner.search.grasp import plan_grasp
from planner.task import GraspTask
from sim.tables import Row

OPENED, CLOSED, LARGER, GRIP = 0.3, -0.1, 1.2, 1000.0
"""Shares of the way to the pre-grasp (-), factor of the object (-), N."""


@dataclass(frozen=True, kw_only=True)
class KnownFault:
    """A fault.

    Attributes:
        name: What to call it.
        stages: Stages of which at least one must fail.
        grasp: Puts it into a grasp.
        task: Puts it into the task.
    """

    name: str
    stages: frozenset[str]
    grasp: Callable[[ImportedGrasp, GraspTask], ImportedGrasp] = lambda grasp, task: grasp
    task: Callable[[GraspTask], GraspTask] = lambda task: task


def _opened(share: float) -> Callable[[ImportedGrasp, GraspTask], ImportedGrasp]:
    def move(grasp: ImportedGrasp, task: GraspTask) -> ImportedGrasp:
        if grasp.q_pregrasp is None:
            return grasp
        q = grasp.q + share * (grasp.q_pregrasp - grasp.q)
        return replace(grasp, q=np.clip(q, task.hand.q_lower, task.hand.q_upper))

    return move


def _first_away(grasp: ImportedGrasp, task: GraspTask) -> ImportedGrasp:
    """The first finger of the task at the pre-grasp."""
    q = grasp.q.copy()
    if grasp.q_pregrasp is not None:
        index = task.fingers[0].q_index
        q[index] = grasp.q_pregrasp[index]
    return replace(grasp, q=q)


def other_hand(hand: Hand) -> Hand:
    """The left hand of a right one that comes with Opposable, or the other way round.

    Raises:
        NotFoundError: There is none.
    """
    left = "_left"
    name = hand.name.removesuffix(left) if hand.name.endswith(left) else hand.name + left
    return load_hand(name)


def _for_other_hand(task: GraspTask) -> GraspTask:
    return replace(task, hand=other_hand(task.hand))


def _larger(task: GraspTask) -> GraspTask:
    return replace(task, object=scaled_object(task.object, LARGER), table_height=None)


_ANYWHERE = frozenset({"gap", "pad", "penetration"})

FAULTS: Mapping[str, KnownFault] = {
    fault.name: fault
    for fault in (
        KnownFault(name="gap", stages=frozenset({"gap"}), grasp=_opened(OPENED)),
        KnownFault(name="penetration", stages=frozenset({"penetration"}), grasp=_opened(CLOSED)),
        KnownFault(name="no closure", stages=frozenset({"closure"}), grasp=_first_away),
        KnownFault(
            name="torque limit",
            stages=frozenset({"forces"}),
            task=lambda task: replace(task, grip_force=GRIP),
        ),
        KnownFault(name="wrong hand", stages=_ANYWHERE, task=_for_other_hand),
        KnownFault(name="wrong scale", stages=_ANYWHERE, task=_larger),
    )
}
"""All faults by name."""


def judged_with_fault(name: str, task: GraspTask, grasp: ImportedGrasp) -> tuple[AuditRow, bool]:
    """The verdict on a good grasp with a fault, and whether a stage that must fail does.

    Args:
        name: Of the fault.
        task: Of the grasp.
        grasp: A good grasp with a pre-grasp.
    """
    fault = FAULTS[name]
    row = Judge(fault.task(task)).row(fault.grasp(grasp, task))
    return row, any(row.stages[stage].passed is False for stage in fault.stages)


@dataclass(frozen=True, kw_only=True)
class Options(HandOptions):
    """Good grasps of every hand and object, and their faults."""

    objects: ObjectsOption = "sphere,box,cylinder,capsule,mug"
    faulty: Annotated[int, typer.Option(min=0, help="How many of them get each fault.")] = 10
    timed: Annotated[int, typer.Option(min=1, help="Verdicts timed for each hand and object.")] = (
        100
    )


def cases(options: Options) -> Iterator[Row]:
    """Hands and objects, each with its grasps."""
    asked = {"n": options.n, "faulty": options.faulty, "timed": options.timed}
    for cell in cells_of(options.hand_names, options.objects):
        yield {**cell, **asked, "seed": options.seed}


def measure(case: Row) -> Row:
    """Plan grasps of one hand and object, and judge them and their faults."""
    task = task_of(case["hand"], case["spec"])
    seeds = [seed_of(case["seed"], task.object.shape, k) for k in range(case["n"])]
    plans = [plan_grasp(task, seed=seed) for seed in seeds]
    grasps = _through_a_file(plans)
    judge = Judge(task)
    rows = [judge.row(grasp) for grasp in grasps]
    faults: dict[str, Row] = {}
    broken: list[ImportedGrasp] = []
    for name, fault in FAULTS.items():
        if name == "wrong hand" and not _has_other(task.hand):
            continue
        found, firsts = 0, Counter[str]()
        for plan, grasp in list(zip(plans, grasps, strict=True))[: case["faulty"]]:
            row, noticed = judged_with_fault(name, plan.task, grasp)
            found += noticed and not row.passed
            firsts[row.first_fault or "passed"] += 1
            broken.append(fault.grasp(grasp, plan.task))
        faults[name] = {"made": sum(firsts.values()), "found": found, "first": dict(firsts)}
    mixed = list(islice(cycle([*grasps, *broken]), case["timed"]))
    begin = time.process_time()
    for grasp in mixed:
        judge.row(grasp)
    return {
        "planned": len(plans),
        "passed": sum(row.passed for row in rows),
        "reasons": [row.reason for row in rows if not row.passed],
        "faults": faults,
        "timed": len(mixed),
        "cpu_s": time.process_time() - begin,
    }


def _through_a_file(plans: Sequence[GraspPlan]) -> tuple[ImportedGrasp, ...]:
    """Plans as a reader gives them."""
    with TemporaryDirectory() as folder:
        (path,) = write_table(plans, Path(folder) / "grasps.npz", Writing())
        return read_table(path, plans[0].task.hand, Reading()).grasps


def _has_other(hand: Hand) -> bool:
    try:
        other_hand(hand)
    except NotFoundError:
        return False
    return True


def tables(result: Row) -> Iterator[Row | str]:
    """Good grasps that pass, faults that are found, and time."""
    rows = [row for row in result["rows"] if not row["error"]]
    yield summary(
        "good grasps that pass; known faults that are found; CPU per verdict",
        rows,
        ("hand", "object"),
        {
            "good pass": parts("passed", "planned"),
            **{name: _noticed(name) for name in FAULTS},
            "ms each": ratio("cpu_s", "timed", 1, 1e3),
        },
        [("all", "")],
    )
    yield from (f"{r['hand']} {r['object']}: {text}" for r in rows for text in r["reasons"])


def _noticed(name: str) -> Cell:
    def cell(frame: Frame) -> str:
        faults = [row[name] for row in frame["faults"] if name in row]
        return f"{sum(f['found'] for f in faults)}/{sum(f['made'] for f in faults)}"

    return cell
