"""``run_manipulate``: pick, turn, place, under conditions that the planner ignores.

A trial draws what there is: size, mass, friction, where the object really stands, and a push while
it is turned. The planner knows the size. Of mass and friction it knows the bounds, the largest mass
and the least friction less a margin, of the pose where the object ought to stand; the controller
measures the pose once it holds the object.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any
from zlib import crc32

import numpy as np
import pinocchio as pin
from rich.table import Table

from planner.errors import NotFoundError, PlannerError
from planner.motion.path import LARGEST_TURN
from planner.objects import OBJECT_NAMES, parse_object
from planner.plain import finite
from planner.spatial import SE3
from planner.task import GraspTask
from sim.bench.conditions import (
    BELIEVED_MU,
    KINDS,
    MASS,
    PUSH_TIME,
    REGRASP_FRICTION,
    REGRASP_MASS,
    REGRASP_RATE,
    Conditions,
)
from sim.bench.journal import run_with_journal
from sim.bench.meshes import standing
from sim.bench.objects import BenchObject, bench_objects
from sim.bench.statistics import median_of
from sim.bench.tables import number, table_of
from sim.manipulation import Push, manipulate, manipulation_task, plan_turning
from sim.manipulation.stand import on_stand
from sim.physics import PhysicsOptions
from sim.runner import Check, Runner, made_with

__all__ = ["Turn", "manipulate_table", "run_manipulate", "run_turn"]

FORMAT = "opposable-bench-manipulate"

ANGLE = np.pi / 2
"""Turn that is asked for, rad, if nothing else is."""


@dataclass(frozen=True, kw_only=True)
class Turn:
    """One trial, as it is sent to a worker.

    Attributes:
        index: Its number among all.
        hand: Name or path of the hand.
        kind: Kind of object, or what another one is called.
        number: Its number in its cell.
        height: Height of cylinder, block and ellipsoid, m.
        fingers: Fingers that take part; the hand's default set if None.
        stand: Height of the stand that carries the object, m; 0 for none.
        seed: Of all that is drawn.
        angle: Turn that is asked for, rad; beyond a half turn it is made by regrasps.
        spec: Specification of an object that is of no kind in ``KINDS``.
    """

    index: int
    hand: str
    kind: str
    number: int
    height: float
    fingers: tuple[str, ...] | None
    stand: float
    seed: int
    angle: float = ANGLE
    spec: str = ""

    @property
    def regrasps(self) -> bool:
        """Whether fingers are to move on."""
        return abs(self.angle) > LARGEST_TURN

    def draw(self) -> Conditions:
        """What there really is."""
        kinds: tuple[str, ...] = KINDS
        of = crc32(self.kind.encode()) if self.spec else kinds.index(self.kind)
        rng, drawn = np.random.default_rng([self.seed, of, self.number]), self.spec or self.kind
        if not self.regrasps:
            return Conditions.draw(drawn, self.height, rng)
        until = abs(self.angle) / REGRASP_RATE
        return Conditions.draw(drawn, self.height, rng, REGRASP_FRICTION, until)


def run_turn(turn: Turn, check: Check) -> dict[str, Any]:
    """Plan and execute one trial; its row, as plain data."""
    there = turn.draw()
    task = _believed(turn, there)
    try:
        seed = turn.seed + turn.number
        plan = plan_turning(task, angle=turn.angle, place=there.place, seed=seed)
    except PlannerError as error:
        return _row(turn, there, found=False, reason=str(error))
    check()
    task = plan.motion.grasp.task  # with the fingers that were chosen
    pose = task.T_world_object
    turned = pin.exp3(np.array([0.0, 0.0, there.heading])) @ pose.rotation
    aside = np.array([*there.shift, 0.0])
    really = replace(
        task,
        object=replace(task.object, mass=there.mass),
        T_world_object=SE3(turned, pose.translation + aside),
        obstacles=tuple(o.moved(aside) for o in task.obstacles),  # its stand is off as well
    )
    begin = time.process_time()
    report = manipulate(
        plan,
        really=really,
        physics=PhysicsOptions(mu=there.mu),
        push=Push(force=np.array([*there.push, 0.0]), after=there.push_after, duration=PUSH_TIME),
    )
    check()
    last = report.checks[-1].numbers
    return _row(
        turn,
        there,
        found=True,
        attempts=plan.attempts,
        planning_cpu_s=plan.cpu_s,
        simulation_cpu_s=time.process_time() - begin,
        strict=report.strict,
        loose=report.loose,
        complete=report.complete,
        dropped=report.dropped,
        reason=report.reason,
        place_off_mm=last.get("off_mm") if report.complete else None,
        place_heading_deg=last.get("heading_deg") if report.complete else None,
        events=[f"{e.time:.2f} {e.kind} {e.finger} {e.detail}" for e in report.events],
        **report.numbers(),
    )


def _believed(turn: Turn, there: Conditions) -> GraspTask:
    """The task as the planner has it."""
    item = parse_object(there.spec, mass=REGRASP_MASS if turn.regrasps else MASS[1])
    mu = REGRASP_FRICTION[0] if turn.regrasps else BELIEVED_MU
    task = manipulation_task(turn.hand, item, mu=mu, fingers=turn.fingers)
    if turn.spec:
        task = replace(task, T_world_object=standing(item.shape))
    return on_stand(task, turn.stand) if turn.stand else task


def _objects(given: str) -> list[BenchObject]:
    """What is called so: a kind, or other objects, which are looked at once."""
    if given in KINDS:
        return [BenchObject(label=given, spec=given)]
    found = bench_objects([given])
    for item in found:
        try:
            parse_object(item.spec)
        except NotFoundError as error:
            raise NotFoundError("object", given, (*KINDS, *OBJECT_NAMES)) from error
    return found


def _row(turn: Turn, there: Conditions, **values: Any) -> dict[str, Any]:
    row: dict[str, Any] = finite(
        {
            "index": turn.index,
            "hand": turn.hand,
            "kind": turn.kind,
            "number": turn.number,
            "conditions": asdict(there),
            **values,
        }
    )
    return row


def _given_up(turn: Turn, reason: str) -> dict[str, Any]:
    return _row(turn, turn.draw(), found=False, reason=reason)


def run_manipulate(
    hands: Sequence[str],
    kinds: Sequence[str],
    n: int,
    *,
    height: float,
    fingers: tuple[str, ...] | None,
    stand: float,
    seed: int,
    file: Path,
    runner: Runner,
    angle: float = ANGLE,
) -> dict[str, Any]:
    """Run the trials that the file does not have yet.

    Args:
        hands: Names or paths.
        kinds: Kinds of objects out of ``KINDS``, and specifications, mesh files and folders.
        n: Trials for each hand and kind.
        height: Height of cylinder, block and ellipsoid, m.
        fingers: Fingers that take part; each hand's default set if None.
        stand: Height of the stand that carries the object, m; 0 for none.
        seed: Of all that is drawn.
        file: Of the rows; made if it is not there.
        runner: Who works on them.
        angle: Turn that is asked for, rad.

    Returns:
        Plain data: all rows that the file has then, and what they were made with.

    Raises:
        FileFormatError: The file is not one of these, or was begun with other arguments.
        NotFoundError: A kind, an object or a hand that does not exist.
        ObjectError: A mesh that cannot be read, or sizes that are none.
    """
    objects = [item for kind in kinds for item in _objects(kind)]
    for hand in hands:
        GraspTask.create(hand, "cylinder", fingers=fingers)
    cells = [(hand, item, k) for hand in hands for item in objects for k in range(n)]
    jobs = [
        Turn(
            index=i,
            hand=hand,
            kind=item.label,
            number=k,
            height=height,
            fingers=fingers,
            stand=stand,
            seed=seed,
            angle=angle,
            spec="" if item.label in KINDS else item.spec,
        )
        for i, (hand, item, k) in enumerate(cells)
    ]
    asked = {
        "format": f"{FORMAT}-rows",
        "version": 1,
        "hands": list(hands),
        "kinds": list(kinds),
        "n": n,
        "height": height,
        "fingers": None if fingers is None else list(fingers),
        "stand": stand,
        "seed": seed,
        "angle_deg": math.degrees(angle),
    }
    rows, whole = run_with_journal(
        runner,
        run_turn,
        jobs,
        file=file,
        asked=asked,
        title="pick, turn, place",
        given_up=_given_up,
    )
    return {
        "format": FORMAT,
        "version": 1,
        **made_with(),
        **{k: v for k, v in asked.items() if k not in ("format", "version")},
        "workers": runner.workers,
        "interrupted": not whole,
        "rows": sorted(rows, key=lambda row: int(row["index"])),
    }


COLUMNS = (
    "planned",
    "strict",
    "loose",
    "complete",
    "drops",
    "turned in s",
    "error deg",
    "tilt deg",
    "off path mm",
    "fingers",
    "placed mm",
    "placed deg",
    "planning s",
)


def manipulate_table(result: dict[str, Any]) -> Table:
    """Counts out of all trials, and medians, per hand and kind of object."""
    table = table_of(
        f"turns by {result['angle_deg']:.0f} degrees: counts out of all trials; medians of those "
        "that turned: time until then, how far the turn was off, "
        "largest tilt, largest distance off the path; fewest fingers in any; then of those placed",
        ("hand", "object"),
        COLUMNS,
    )
    cells: dict[tuple[str, str], list[dict[str, Any]]] = {}
    for row in result["rows"]:
        cells.setdefault((row["hand"], row["kind"]), []).append(row)
    for (hand, kind), rows in cells.items():
        table.add_row(hand, kind, *_cells(rows, result["angle_deg"]))
    return table


def _cells(rows: list[dict[str, Any]], asked: float) -> list[str]:
    def count(name: str) -> str:
        return f"{sum(bool(row.get(name)) for row in rows)}/{len(rows)}"

    def median(name: str, members: list[dict[str, Any]], less: float = 0.0) -> float | None:
        return median_of(abs(m[name] - less) for m in members if m.get(name) is not None)

    turned = [row for row in rows if row.get("loose")]
    found = [row for row in rows if row["found"]]
    least = [row["least_fingers"] for row in turned]
    return [
        *(count(name) for name in ("found", "strict", "loose", "complete", "dropped")),
        number(median("time_to_angle_s", turned), 2),
        number(median("turned_deg", turned, asked), 2),
        number(median("largest_tilt_deg", turned), 1),
        number(median("largest_off_path_mm", turned), 1),
        f"{min(least):.0f}" if least else "-",
        number(median("place_off_mm", rows), 1),
        number(median("place_heading_deg", rows), 1),
        number(median("planning_cpu_s", found), 2),
    ]
