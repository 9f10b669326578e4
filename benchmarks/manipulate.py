"""Pick, turn or move in the hand, place: randomised trials, rates of success and closure.

A trial draws what there is: size, mass, friction (whatever --physics says), where the object really
stands, and a push while it is turned or moved. The planner knows the size. Of mass and friction it
knows the bounds, the largest mass and the least friction less a margin, of the pose where the
object ought to stand; the controller measures the pose once it holds the object.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, replace
from typing import Annotated, TypeAlias
from zlib import crc32

import numpy as np
import typer

from benchmarks.bench import HandOptions, NumberOption
from benchmarks.common import objects_of
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
    HeightOption,
    standing,
)
from benchmarks.summary import of, share, summary
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
from planner.task import GraspTask
from sim.cli.execution import error_model_of, estimate_of, physics_of
from sim.cli.options import (
    NO_SHIFT,
    AttitudeOption,
    ErrorModelOption,
    EstimateOption,
    FingersOption,
    PhysicsOption,
    RotateOption,
    ShiftOption,
    StandOption,
    attitude_of,
    movement,
    names,
)
from sim.controllers.follow import RATE, SPEED
from sim.learning import PolicyMaker, named_driver
from sim.learning.trials import true_task
from sim.manipulation import ManipulationReport, Push, manipulate, rests, settled
from sim.manipulation.in_hand import AnyTurningController
from sim.scene.physics import PhysicsOptions
from sim.sensing.errors import ErrorModel
from sim.simulation import Simulation
from sim.tables import Row

ANGLE = np.pi / 2
"""Turn that is asked for, rad, if nothing else is."""

Vector: TypeAlias = tuple[float, float, float]

VERTICAL: Vector = (0.0, 0.0, 1.0)
"""Axis of turns if no other is asked for, world."""

STILL: Vector = (0.0, 0.0, 0.0)
"""No translation, m."""

OURS, EXACT = PhysicsOptions(), ErrorModel()
"""How MuJoCo computes if nothing else is asked for; no errors beside the drawn conditions."""


@dataclass(frozen=True, kw_only=True)
class Options(HandOptions):
    """Trials of every hand and object."""

    n: NumberOption = 50
    objects: Annotated[
        str,
        typer.Option(
            help="Comma separated: cylinder, block, sphere, ellipsoid; superquadric or another "
            "mesh by name, as wide as those; mesh files, folders of them or sizes, as they are."
        ),
    ] = "cylinder"
    height: HeightOption = 0.08
    rotate: RotateOption = None
    shift: ShiftOption = NO_SHIFT
    attitude: AttitudeOption = "down"
    carry: Annotated[bool, typer.Option(help="Carried to its place while it is turned.")] = False
    fingers: FingersOption = None
    stand: StandOption = 0.0
    physics: PhysicsOption = "ours"
    error_model: ErrorModelOption = "ideal"
    estimate: EstimateOption = None
    controller: Annotated[
        str,
        typer.Option(
            help="feedforward, impedance, or policy:FILE; the closed loop if not given.",
            metavar="NAME",
        ),
    ] = ""


@dataclass(frozen=True, kw_only=True)
class Turn:
    """One trial.

    Attributes:
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
        error_model: Errors of sensors, drives and object, drawn from the seed and the number;
            those of mass and friction come on top of what ``draw`` gives.
        estimator: Name of what tells the controller where the object is; see ``Simulation``.
        controller: What drives the fingers, as ``sim.learning.named_driver`` takes it; the closed
            loop if "".
        attitude: Of the hand meanwhile, as ``--attitude`` takes it.
        carry: Whether it is carried to its place meanwhile, by the corner before it.
    """

    hand: str
    kind: str
    number: int
    height: float
    fingers: tuple[str, ...] | None
    stand: float
    seed: int
    axis: Vector = VERTICAL
    angle: float = ANGLE
    shift: Vector = STILL
    spec: str = ""
    physics: PhysicsOptions = OURS
    error_model: ErrorModel = EXACT
    estimator: str | None = None
    controller: str = ""
    attitude: str = "down"
    carry: bool = False

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
        attitude=attitude_of(turn.attitude),
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
    return manipulate(
        plan,
        controller=controller,
        true_task=true_task(task, there.mass, there.shift, there.heading),
        physics=replace(turn.physics, mu=there.mu),
        push=Push(force=np.array([*there.push, 0.0]), after=there.push_after, duration=PUSH_TIME),
        error_model=turn.error_model.seeded(turn.seed + turn.number),
        estimator=turn.estimator,
        on_step=on_step,
        via=((there.place[0], 0.0), there.place) if turn.carry else (),
    )


def believed(turn: Turn) -> GraspTask:
    """The task as the planner has it."""
    item = parse_object(turn.draw().spec, mass=REGRASP_MASS if turn.regrasps else MASS[1])
    mu = REGRASP_FRICTION[0] if turn.regrasps else BELIEVED_MU
    task = manipulation_task(turn.hand, item, mu=mu, fingers=turn.fingers)
    task = replace(task, joint_error=turn.error_model.encoder_offset)
    if turn.spec:
        task = replace(task, T_world_object=standing(item.shape))
    return settled(on_stand(task, turn.stand) if turn.stand else task)


def cases(options: Options) -> Iterator[Row]:
    """Draws of every hand and object.

    Raises:
        HandError: A hand that a policy was not trained for.
        NotFoundError: A kind, an object, a hand or a controller that does not exist.
        ObjectError: A mesh that cannot be read, or sizes that are none.
        TaskError: Neither a turn nor a translation, or a translation with more than half a turn.
    """
    axis, degrees, shift = movement(options.rotate, options.shift)
    angle = math.radians(degrees)
    if any(shift) or not abs(angle) > LARGEST_TURN:
        ObjectPath(axis=np.array(axis), angle=angle, shift=np.array(shift))  # tells what is wrong
    try:
        objects = objects_of(options.objects, KINDS)
    except NotFoundError as error:
        raise NotFoundError("object", options.objects, (*KINDS, *object_names())) from error
    fingers = None if options.fingers is None else tuple(names(options.fingers))
    driver = named_driver(options.controller)
    for hand in options.hand_names:
        task = GraspTask.create(hand, "cylinder", fingers=fingers)
        if isinstance(driver, PolicyMaker):
            driver.policy.about.check(task.hand)
        for label, spec in objects:
            for k in range(options.n):
                turn = Turn(
                    hand=hand,
                    kind=label,
                    number=k,
                    height=options.height,
                    fingers=fingers,
                    stand=options.stand,
                    seed=options.seed,
                    axis=axis,
                    angle=angle,
                    shift=shift,
                    spec=spec,
                    physics=physics_of(options.physics),
                    error_model=error_model_of(options.error_model),
                    estimator=estimate_of(options.estimate),
                    controller=options.controller,
                    attitude=options.attitude,
                    carry=options.carry,
                )
                yield {"hand": hand, "object": label, "number": k, "turn": turn}


def measure(case: Row) -> Row:
    """Plan and execute one trial."""
    turn: Turn = case["turn"]
    row: Row = {"conditions": asdict(turn.draw()), "found": False}
    try:
        plan = plan_turn(turn, believed(turn))
    except PlannerError as error:
        return row | {"reason": str(error)}
    begin = time.process_time()
    report = execute_turn(turn, plan, named_driver(turn.controller))
    last, numbers = report.results[-1].numbers if report.complete else {}, report.numbers()
    heading, turned = last.get("heading_deg"), numbers.get("turned_deg")
    return row | {
        "found": True,
        "attempts": plan.attempts,
        "planning_cpu_s": plan.cpu_s,
        "simulation_cpu_s": time.process_time() - begin,
        "success_with_closure": report.success_with_closure,
        "success": report.success,
        "complete": report.complete,
        "dropped": report.dropped,
        "reason": report.reason,
        "faults": report.faults,
        "collided": report.collision is not None,
        "regrasps": plan.cycles > 1,
        "place_off_mm": last.get("off_mm"),
        "place_heading_deg": None if heading is None else abs(heading),
        "angle_off_deg": None if turned is None else abs(turned - math.degrees(turn.angle)),
        "events": [f"{e.time:.2f} {e.kind} {e.finger} {e.detail}" for e in report.events],
        **numbers,
    }


def tables(result: Row) -> Iterator[Row]:
    """Counts out of all trials, and medians, per hand and kind of object."""
    setting = result["setting"]
    axis, degrees, shift = movement(setting["rotate"], setting["shift"])
    moved = any(shift)
    columns = {
        "planned": share("found"),
        "closed": share("success_with_closure"),
        "success": share("success"),
        "complete": share("complete"),
        "drops": share("dropped"),
        "hits": share("collided"),
        "turned in s": of("time_to_angle_s", where="success"),
        "error deg": of("angle_off_deg", where="success"),
        "tilt deg": of("largest_tilt_deg", digits=1, where="success"),
        "off path mm": of("largest_off_path_mm", digits=1, where="success"),
        "fingers": of("least_fingers", "min", 0, where="success"),
        "force N": of("largest_force_N", "max", 1, where="success"),
        "placed mm": of("place_off_mm", digits=1),
        "placed deg": of("place_heading_deg", digits=1),
        "planning s": of("planning_cpu_s", where="found"),
        **({"shift off mm": of("shift_off_mm", where="success")} if moved else {}),
    }
    asked = []
    if degrees:
        about = "" if axis == VERTICAL else f" about ({', '.join(f'{v:g}' for v in axis)})"
        asked.append(f"turns by {degrees:g} degrees{about}")
    if moved:
        asked.append(f"translations by ({', '.join(f'{1e3 * v:g}' for v in shift)}) mm")
    yield summary(
        f"{' with '.join(asked)}: counts out of all trials (closed: successes with closure; a turn "
        "counts from the asked angle on, complete runs are off by 5 degrees at most); medians of "
        "successes: time until they had turned, how far the turn was off, largest tilt off the "
        "planned attitude, largest distance off the path; fewest fingers and largest force (N) of "
        "a finger in any; then of those placed; hits are runs in which the hand collided"
        + ("; last, how far the translation was off, of successes" if moved else ""),
        result["rows"],
        ("hand", "object"),
        columns,
    )
