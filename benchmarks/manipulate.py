"""``run_manipulate``: pick, turn, place, under conditions that the planner ignores.

A trial draws what there is: size, mass, friction, where the object really stands, and a push while
it is turned or moved. The planner knows the size. Of mass and friction it knows the bounds, the
largest mass and the least friction less a margin, of the pose where the object ought to stand; the
controller measures the pose once it holds the object.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeAlias
from zlib import crc32

import numpy as np
import pinocchio as pin

from benchmarks.cases import not_found, row_of, run_cases
from benchmarks.conditions import (
    BELIEVED_MU,
    KINDS,
    MASS,
    PUSH_TIME,
    PUSH_UNTIL,
    REGRASP_FRICTION,
    REGRASP_MASS,
    REGRASP_RATE,
    Conditions,
)
from benchmarks.meshes import standing
from benchmarks.objects import BenchObject, bench_objects
from benchmarks.run import stated
from planner.errors import NotFoundError, PlannerError
from planner.motion.manipulation import (
    ONE_STROKE,
    ManipulationPlan,
    manipulation_task,
    on_stand,
    plan_manipulation,
)
from planner.motion.path import LARGEST_TURN, ObjectPath
from planner.objects import object_names, parse_object
from planner.spatial import SE3
from planner.task import GraspTask
from sim.controllers.follow import RATE, SPEED
from sim.learning import PolicyMaker, named_driver
from sim.manipulation import ManipulationReport, Push, manipulate, rests, settled
from sim.manipulation.in_hand import AnyTurningController
from sim.physics import PhysicsOptions
from sim.reality import Reality
from sim.runner import Check, Runner
from sim.simulation import Simulation
from sim.tables import Row

FORMAT = "opposable-bench-manipulate"

ANGLE = np.pi / 2
"""Turn that is asked for, rad, if nothing else is."""

Vector: TypeAlias = tuple[float, float, float]

VERTICAL: Vector = (0.0, 0.0, 1.0)
"""Axis of turns if no other is asked for, world."""

NO_SHIFT: Vector = (0.0, 0.0, 0.0)
"""No translation, m."""


OURS = PhysicsOptions()
"""How MuJoCo computes if nothing else is asked for."""

EXACT = Reality()
"""No errors beside the drawn conditions."""


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
        axis: Axis of the turn that is asked for (3,), world.
        angle: The turn, rad; beyond ``ONE_STROKE`` about the vertical it is made by regrasps.
        shift: Translation in the hand that is asked for with it (3,), m, world.
        spec: Specification of an object that is of no kind in ``KINDS``.
        physics: How MuJoCo computes; friction is drawn.
        reality: Errors of sensors, drives and object, drawn from the seed and the number; those of
            mass and friction come on top of what ``draw`` gives.
        estimator: Name of what tells the controller where the object is; see ``Simulation``.
        controller: What drives the fingers, as ``sim.learning.named_driver`` takes it; the closed
            loop if "".
    """

    index: int
    hand: str
    kind: str
    number: int
    height: float
    fingers: tuple[str, ...] | None
    stand: float
    seed: int
    axis: Vector = VERTICAL
    angle: float = ANGLE
    shift: Vector = NO_SHIFT
    spec: str = ""
    physics: PhysicsOptions = OURS
    reality: Reality = EXACT
    estimator: str | None = None
    controller: str = ""

    @property
    def regrasps(self) -> bool:
        """Whether fingers are to move on."""
        turns = self.axis == VERTICAL and not any(self.shift)
        return abs(self.angle) > (ONE_STROKE if turns else LARGEST_TURN)

    def draw(self) -> Conditions:
        """What there really is."""
        kinds: tuple[str, ...] = KINDS
        of = crc32(self.kind.encode()) if self.spec else kinds.index(self.kind)
        rng, drawn = np.random.default_rng([self.seed, of, self.number]), self.spec or self.kind
        if self.regrasps:
            until = abs(self.angle) / REGRASP_RATE
            return Conditions.draw(drawn, self.height, rng, REGRASP_FRICTION, until)
        if self.axis == VERTICAL and not any(self.shift):
            return Conditions.draw(drawn, self.height, rng)
        # tilts and translations may be over long before PUSH_UNTIL
        moving = abs(self.angle) / RATE if self.angle else float(np.linalg.norm(self.shift)) / SPEED
        return Conditions.draw(drawn, self.height, rng, push_until=min(PUSH_UNTIL, moving))


def plan_turn(turn: Turn, task: GraspTask) -> ManipulationPlan:
    """The plan of a trial.

    Args:
        turn: The trial.
        task: As the planner has it: ``believed``.

    Raises:
        PlannerError: There is none.
    """
    return plan_manipulation(
        task,
        axis=turn.axis,
        angle=turn.angle,
        shift=turn.shift,
        place=turn.draw().place,
        seed=turn.seed + turn.number,
        rests=rests,
    )


def execute_turn(
    turn: Turn,
    plan: ManipulationPlan,
    controller: AnyTurningController | None = None,
    on_step: Callable[[Simulation], None] | None = None,
) -> ManipulationReport:
    """Execute a plan of a trial under what there really is.

    Args:
        turn: The trial.
        plan: Its plan.
        controller: What drives the fingers; the closed loop if None.
        on_step: Called with the simulation after every time step.
    """
    there = turn.draw()
    task = plan.grasp.task  # with the fingers that were chosen
    pose = task.T_world_object
    turned = pin.exp3(np.array([0.0, 0.0, there.heading])) @ pose.rotation
    aside = np.array([*there.shift, 0.0])
    true_task = replace(
        task,
        object=replace(task.object, mass=there.mass),
        T_world_object=SE3(turned, pose.translation + aside),
        obstacles=tuple(o.moved(aside) for o in task.obstacles),  # its stand is off as well
    )
    return manipulate(
        plan,
        controller=controller,
        true_task=true_task,
        physics=replace(turn.physics, mu=there.mu),
        push=Push(force=np.array([*there.push, 0.0]), after=there.push_after, duration=PUSH_TIME),
        reality=turn.reality.seeded(turn.seed + turn.number),
        estimator=turn.estimator,
        on_step=on_step,
    )


def run_turn(turn: Turn, check: Check) -> dict[str, Any]:
    """Plan and execute one trial; its row, as plain data."""
    task = believed(turn)
    try:
        plan = plan_turn(turn, task)
    except PlannerError as error:
        return not_found(turn, str(error))
    check()
    begin = time.process_time()
    report = execute_turn(turn, plan, named_driver(turn.controller))
    check()
    last = report.results[-1].numbers
    return row_of(
        turn,
        found=True,
        attempts=plan.attempts,
        planning_cpu_s=plan.cpu_s,
        simulation_cpu_s=time.process_time() - begin,
        success_with_closure=report.success_with_closure,
        success=report.success,
        complete=report.complete,
        dropped=report.dropped,
        reason=report.reason,
        faults=report.faults,
        collided=report.collision is not None,
        regrasps=plan.cycles > 1,
        place_off_mm=last.get("off_mm") if report.complete else None,
        place_heading_deg=last.get("heading_deg") if report.complete else None,
        events=[f"{e.time:.2f} {e.kind} {e.finger} {e.detail}" for e in report.events],
        **report.numbers(),
    )


def believed(turn: Turn) -> GraspTask:
    """The task as the planner has it."""
    item = parse_object(turn.draw().spec, mass=REGRASP_MASS if turn.regrasps else MASS[1])
    mu = REGRASP_FRICTION[0] if turn.regrasps else BELIEVED_MU
    task = manipulation_task(turn.hand, item, mu=mu, fingers=turn.fingers)
    task = replace(task, joint_error=turn.reality.encoder_offset)
    if turn.spec:
        task = replace(task, T_world_object=standing(item.shape))
    return settled(on_stand(task, turn.stand) if turn.stand else task)


def _objects(given: str) -> list[BenchObject]:
    """What is called so: a kind, or other objects, which are looked at once."""
    if given in KINDS:
        return [BenchObject(label=given, spec=given)]
    found = bench_objects([given])
    for item in found:
        try:
            parse_object(item.spec)
        except NotFoundError as error:
            raise NotFoundError("object", given, (*KINDS, *object_names())) from error
    return found


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
    axis: Vector = VERTICAL,
    angle: float = ANGLE,
    shift: Vector = NO_SHIFT,
    physics: PhysicsOptions = OURS,
    reality: Reality = EXACT,
    estimator: str | None = None,
    controller: str = "",
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
        axis: Axis of the turn (3,), world.
        angle: Turn that is asked for, rad.
        shift: Translation in the hand that is asked for with it (3,), m, world.
        physics: How MuJoCo computes; friction is drawn.
        reality: Errors of sensors, drives and object; see ``Turn``.
        estimator: What tells the controller where the object is; see ``Turn``.
        controller: What drives the fingers; see ``Turn``.

    Returns:
        Plain data: all rows that the file has then, and what they were made with.

    Raises:
        FileFormatError: The file is not one of these, or was begun with other arguments.
        HandError: A hand that a policy was not trained for.
        NotFoundError: A kind, an object, a hand or a controller that does not exist.
        ObjectError: A mesh that cannot be read, or sizes that are none.
        TaskError: Neither a turn nor a translation, or a translation with more than half a turn.
    """
    if any(shift) or not abs(angle) > LARGEST_TURN:
        ObjectPath(axis=np.array(axis), angle=angle, shift=np.array(shift))  # tells what is wrong
    objects = [item for kind in kinds for item in _objects(kind)]
    driver = named_driver(controller)
    for hand in hands:
        task = GraspTask.create(hand, "cylinder", fingers=fingers)
        if isinstance(driver, PolicyMaker):
            driver.policy.about.check(task.hand)
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
            axis=axis,
            angle=angle,
            shift=shift,
            spec="" if item.label in KINDS else item.spec,
            physics=physics,
            reality=reality,
            estimator=estimator,
            controller=controller,
        )
        for i, (hand, item, k) in enumerate(cells)
    ]
    asked: Row = {
        "hands": list(hands),
        "kinds": list(kinds),
        "n": n,
        "height": height,
        "fingers": None if fingers is None else list(fingers),
        "stand": stand,
        "seed": seed,
        "angle_deg": math.degrees(angle),
    }
    # left out where none is asked for, so that files go on that were begun before there were any
    if axis != VERTICAL:
        asked["axis"] = list(axis)
    if any(shift):
        asked["shift"] = list(shift)
    if physics != OURS:
        asked["physics"] = {k: v for k, v in physics.to_dict().items() if k != "mu"}
    asked |= stated(reality, estimator)
    if controller:
        asked["controller"] = controller
        if isinstance(driver, PolicyMaker):
            asked["policy"] = driver.policy.digest
    return run_cases(
        runner, run_turn, jobs, kind=FORMAT, asked=asked, file=file, title="pick, turn, place"
    )
