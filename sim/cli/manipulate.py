"""The command ``manipulate``: an object is turned in the hand, planned alone or executed too."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.markup import escape

from sim.cli.common import (
    EXIT_INTERRUPTED,
    EXIT_NO,
    check_films,
    err,
    make_folder,
    print_json,
    refuse_given,
    say,
    tell,
    told_command,
    warn_of_friction,
)
from sim.cli.execution import ExecutionOptions
from sim.cli.options import (
    HAND,
    MOVEMENT,
    NO_SHIFT,
    SEARCH,
    TRIAL,
    AttemptsOption,
    AttitudeOption,
    ControllerOption,
    JsonOption,
    MuOption,
    PictureOption,
    RotateOption,
    SeedOption,
    ShiftOption,
    argument,
    attitude_of,
    command,
    flag,
    movement,
    names,
    numbers,
    option,
)
from sim.cli.palm import IN_PALM, WITH_GOAL, PalmOptions, turn_in_palm
from sim.cli.palm import KEPT as WITH_PALM
from sim.cli.tasks import TaskOptions, object_of

if TYPE_CHECKING:
    from planner.motion.manipulation import ManipulationPlan

DEMO_HAND, DEMO_OBJECT = "allegro_hand", "cylinder:0.03x0.08"
"""What ``--demo`` shows."""

MU, MAX_ATTEMPTS = 0.45, 50
"""Friction (-) that is believed, as in the measurement ``manipulate``: a tenth below the least that
it draws, 0.5. Attempts, more than planning a motion alone makes (30): here motions are refused too
at whose end the object cannot be put down, and the best of a few is taken."""


@dataclass(frozen=True, kw_only=True)
class TurnOptions(TaskOptions):
    """What a manipulation, or a motion or gait alone, is planned with."""

    rotate: RotateOption = None
    shift: ShiftOption = NO_SHIFT
    place: Annotated[str, option("Where it is put, m; it stands at 0,0.", "X,Y", MOVEMENT)] = (
        "0.1,0.05"
    )
    attitude: AttitudeOption = "down"
    gait: Annotated[
        bool, flag("--gait", "Turn by strokes, fingers moving on between them.", MOVEMENT)
    ] = False
    goal: Annotated[
        str | None,
        option(
            "Rotation of the object at last, held in the hand: roll, pitch, yaw in degrees about "
            "the world's axes.",
            "R,P,Y",
            MOVEMENT,
        ),
    ] = None
    put_down: Annotated[
        bool, flag("--put-down", "With --goal: it stands on the table at last.", MOVEMENT)
    ] = False
    goal_tilt: Annotated[
        float,
        option(
            "With --goal: most tilt of the palm from straight down there.",
            *("DEG", MOVEMENT),
            min=0.0,
            max=180.0,
        ),
    ] = 180.0
    wrist_tilt: Annotated[
        float,
        option(
            "With --goal: the same wherever the wrist turns.",
            *("DEG", MOVEMENT),
            min=0.0,
            max=180.0,
        ),
    ] = 180.0
    seed: SeedOption = 0
    mu: MuOption = MU
    max_attempts: AttemptsOption = MAX_ATTEMPTS
    best_of: Annotated[
        int | None,
        option("With --plan-only: motions to find, the best is taken.", "N", SEARCH, min=1),
    ] = None

    def movement(self) -> dict[str, Any]:
        """Axis, angle (rad, None for the largest), shift and attitude, as planning takes them.

        Raises:
            TaskError: They hold something else.
        """
        axis, degrees, shift = movement(self.rotate, self.shift)
        angle = math.radians(degrees) if math.isfinite(degrees) else None
        asked: dict[str, Any] = {"axis": axis, "angle": angle, "shift": shift, "seed": self.seed}
        if self.attitude != "down":
            asked["attitude"] = attitude_of(self.attitude)
        return asked

    @property
    def upright(self) -> float | None:
        """Degrees of a turn about the vertical alone; None for another movement."""
        axis, degrees, shift = movement(self.rotate, self.shift)
        return degrees if axis == (0.0, 0.0, 1.0) and not any(shift) else None

    def target(self) -> tuple[float, float]:
        """Where the object is put (2,), m."""
        x, y = numbers("--place", self.place, 2)
        return x, y

    def plan_goal(self, hand: str, object: str) -> ManipulationPlan:
        """The movements to --goal, with a spinner on stderr.

        Raises:
            PlannerError: Bad input, or the goal is not reached.
        """
        import pinocchio as pin

        from planner.motion.goals import plan_reorientation

        roll, pitch, yaw = (math.radians(v) for v in numbers("--goal", str(self.goal), 3))
        item = object_of(object, mass=self.mass, repair=self.repair, strict=self.strict)
        with err.status(f"planning: {hand}, {item.name} ..."):
            return plan_reorientation(
                hand,
                item,
                pin.rpy.rpyToMatrix(roll, pitch, yaw),
                T_world_object=item.resting_pose(index=self.pose),
                place=self.target(),
                put_down=self.put_down,
                goal_tilt=math.radians(self.goal_tilt),
                wrist_tilt=math.radians(self.wrist_tilt),
                mu=self.mu,
                fingers=None if self.fingers is None else names(self.fingers),
                seed=self.seed,
                tell=lambda line: say(err, escape(line)),
            )

    def plan(self, hand: str, object: str) -> ManipulationPlan:
        """Plan with a spinner on stderr.

        Raises:
            PlannerError: Bad input, or nothing was found.
        """
        from planner.errors import NoGraspFoundError, TaskError
        from planner.motion.manipulation import manipulation_task, on_stand, plan_manipulation
        from planner.synthesis.options import SynthesisOptions
        from sim.cli.advice import advice_for_low, said_of_low
        from sim.manipulation import rests, settled

        moved = self.movement()
        if moved["angle"] is None:
            raise TaskError("--rotate max is for --plan-only; give degrees")
        task = manipulation_task(
            hand,
            object_of(object, mass=self.mass, repair=self.repair, strict=self.strict),
            mu=self.mu,
            fingers=None if self.fingers is None else names(self.fingers),
        )
        task = replace(task, joint_error=math.radians(self.joint_error or 0.0))
        task = settled(on_stand(task, self.stand) if self.stand else task)
        with err.status(f"planning: {task.hand.name}, {task.object.name} ..."):
            try:
                return plan_manipulation(
                    task,
                    **moved,
                    place=self.target(),
                    max_attempts=self.max_attempts,
                    rests=rests,
                    regrasp=self.gait,
                )
            except NoGraspFoundError as error:
                options = SynthesisOptions()
                advice = advice_for_low(task, pose=None, options=options, seed=self.seed)
                if advice is None:
                    raise
                raise said_of_low(error, task, advice) from error


@dataclass(frozen=True, kw_only=True)
class TurnExecution(ExecutionOptions):
    """How a manipulation is executed."""

    max_force: Annotated[
        float | None,
        option(
            "Largest normal force of a finger in a success with closure, N; 1.5 times the plan's "
            "largest and a quarter, at least 18, if not given.",
            "N",
            TRIAL,
            min=0.0,
        ),
    ] = None
    controller: ControllerOption = "impedance"
    via: Annotated[
        str,
        option(
            "Places, m, through which it is carried while it is turned; it stays if none.",
            "X,Y;X,Y",
            TRIAL,
        ),
    ] = ""

    def places(self) -> tuple[tuple[float, float], ...]:
        """Those of ``--via``, m.

        Raises:
            TaskError: They hold something else.
        """
        pairs = [numbers("--via", one, 2) for one in self.via.split(";") if self.via]
        return tuple((x, y) for x, y in pairs)


IN_BOTH = {
    *("hand", "object", "output", "as_json", "video", "arrows", "plan_only", "rotate", "shift"),
    *("gait", "seed", "mu", "max_attempts", "fingers", "mass", "repair", "strict", "stand"),
    *("joint_error", "attitude"),
}
"""Parameters of a manipulation and of a plan alone."""

ALONE = {f.name for f in fields(TaskOptions)} - IN_BOTH | {"best_of", "picture"}
"""Parameters of a plan alone."""

TO_GOAL = {"goal", "put_down", "goal_tilt", "wrist_tilt", "pose"}
"""Parameters of a goal rotation alone."""

GOAL = TO_GOAL | {
    *("hand", "object", "output", "as_json", "plan_only", "place", "seed", "mu", "fingers"),
    *("mass", "repair", "strict"),
}
"""Parameters of a plan to a goal rotation."""

EXECUTED = {f.name for f in fields(TurnExecution)} | {"output", "place", "as_json"}
"""Parameters that go with a plan that is read."""


@command
def manipulate(
    context: typer.Context,
    hand: Annotated[str | None, argument(HAND, "HAND")] = None,
    object: Annotated[str | None, argument("The object, as for run.", "OBJECT")] = None,
    plan_file: Annotated[
        Path | None,
        option(
            "Execute this manipulation, motion or gait instead of planning one.",
            "FILE",
            None,
            "--plan",
        ),
    ] = None,
    plan_only: Annotated[
        bool, flag("--plan-only", "Plan how it is turned on one grasp, or by --gait.")
    ] = False,
    demo: Annotated[bool, flag("--demo", "A cylinder is turned by 90 degrees.")] = False,
    *,
    request: TurnOptions,
    palm: PalmOptions,
    execution: TurnExecution,
    output: Annotated[
        Path | None,
        option(
            "Folder for plan, trajectory, report, its page, pictures; of --plan-only the file.",
            "PATH",
            None,
            "--out",
            "-o",
        ),
    ] = None,
    picture: PictureOption = None,
    as_json: JsonOption = False,
) -> None:
    """Pick an object up, turn it in the hand, put it down.

    Where one stroke is not enough, fingers move on one at a time while the others hold. A turn that
    stalls is tried again, once. An object that does not stand as it was turned, or that the hand
    could not let go of where it was moved to, is brought back in the hand before it is put down.

    With --goal the object is brought to a rotation in the world and held there, by the wrist, and
    where the palm may not tilt that far (--goal-tilt, --wrist-tilt) by setting it down on another
    face or turning it in the fingers. Grasps of all its stable poses are kept for later goals.

    With --in-palm nothing is grasped: the object lies on palm and fingers, palm up, and is turned
    there by contact-implicit control.

    With --plan-only nothing is executed: a motion on one grasp (--rotate max: as far as it goes),
    or with --gait a turn of any size, is written to motion.json or gait.json, and movements to a
    --goal to goal.json.

    Exit code 1 if a phase failed, or if the hand collided with itself, the table or the
    stand.
    """
    from planner.errors import TaskError
    from planner.objects import parse_object

    told = told_command(context)
    if demo:
        kept = {"demo", "output", "physics", "video", "arrows", "as_json"}
        refuse_given(context, "--demo shows what it shows", kept=kept)
        hand, object = DEMO_HAND, DEMO_OBJECT
    elif plan_file is not None:
        kept = EXECUTED | {"plan_file"}
        refuse_given(context, f"{plan_file} tells hand, object and movement", kept=kept)
        plan = _read(plan_file, request.target())
        execution.check_policy(plan.task.hand, lambda: plan.task.object, math.degrees(plan.angle))
        _execute(lambda: plan, plan.task.mu, execution, output, as_json, told)
        return
    if hand is None or object is None:
        raise TaskError("give HAND and OBJECT, or a file: opposable manipulate --plan FILE")
    if request.goal is not None:
        kept = GOAL if plan_only else GOAL | EXECUTED
        refuse_given(context, "--goal tells how the object is turned", kept=kept, because=WITH_GOAL)
        if plan_only:
            file = output or Path("goal.json")
            check_films(file, None)
            _goal_only(request.plan_goal(hand, object), file, as_json)
            return
        going = partial(request.plan_goal, hand, object)
        _execute(going, request.mu, execution, output, as_json, told)
        return
    refuse_given(context, "there is no --goal", of=TO_GOAL - {"pose"})
    if palm.in_palm:
        refuse_given(context, "--in-palm grasps nothing", kept=WITH_PALM, because=IN_PALM)
        parts = (request, palm, execution, output, picture)
        turn_in_palm(hand, object, *parts, as_json, told, request.seed)
        return
    if plan_only:
        refuse_given(context, "--plan-only executes nothing", kept=IN_BOTH | ALONE)
        _plan_only(hand, object, request, execution, output, picture, as_json)
        return
    refuse_given(context, "a manipulation takes fewer options than --plan-only", of=ALONE)
    refuse_given(context, "these go with --in-palm", of={"turn_to", "tilt"})
    item = object
    execution.check_policy(hand, lambda: parse_object(item, mass=request.mass), request.upright)
    reckoned = execution.reckoned(request)
    make = lambda: reckoned.plan(hand, item)  # noqa: E731
    _execute(make, request.mu, execution, output, as_json, told)


def _goal_only(plan: ManipulationPlan, file: Path, as_json: bool) -> None:
    """Write the movements to a goal."""
    from planner.files import write_manipulation
    from planner.files.movements import movement_to_dict

    write_manipulation(plan, file)
    if as_json:
        print_json(movement_to_dict(plan))
    else:
        tell(str(plan), f"written to {file}")


def _plan_only(
    hand: str,
    object: str,
    request: TurnOptions,
    drawing: ExecutionOptions,
    output: Path | None,
    picture: Path | None,
    as_json: bool,
) -> None:
    """Plan a motion or a gait and write it.

    Raises:
        PlannerError: Bad input, or nothing was found.
    """
    from planner.errors import TaskError
    from planner.files import write_movement
    from planner.files.movements import movement_to_dict
    from planner.motion import plan_motion
    from planner.motion.gait import plan_gait

    file = output or Path("gait.json" if request.gait else "motion.json")
    check_films(file, picture, drawing.video)
    moved = request.movement() | {"max_attempts": request.max_attempts}
    if request.gait and (moved["angle"] is None or request.best_of is not None):
        raise TaskError("--rotate max and --best-of are for one grasp; leave them out with --gait")
    task = request.task(hand, object)
    with err.status(f"planning: {task.hand.name}, {task.object.name} ..."):
        found = (
            plan_gait(task, **moved)
            if request.gait
            else plan_motion(task, best_of=request.best_of, **moved)
        )
    write_movement(found, file)
    drawn = ""
    if picture is not None or drawing.video is not None:
        from sim.manipulation.drawing import draw_motion

        drawn = draw_motion(found, picture=picture, video=drawing.video, arrows=drawing.arrows)
    if as_json:
        print_json(movement_to_dict(found))
    else:
        tell(str(found), f"written to {file}", *filter(None, [drawn]))


def _execute(
    make_plan: Callable[[], ManipulationPlan],
    believed_mu: float,
    execution: TurnExecution,
    out_dir: Path | None,
    as_json: bool,
    command: str,
) -> None:
    """Plan once all other options are known to be sound, execute, and report.

    Raises:
        PlannerError: Bad input, or no plan.
        Exit: A phase failed, or the hand collided.
    """
    from planner.files import write_manipulation, write_trajectory
    from sim.manipulation import SuccessCriteria
    from sim.manipulation import manipulate as simulate
    from sim.report_file import write_report

    parts = execution.parts()
    via = execution.places()
    check_films(execution.video)
    warn_of_friction(believed_mu, parts["physics"].mu)
    if out_dir is not None:
        make_folder(out_dir)
    plan = make_plan()
    if out_dir is not None:
        write_manipulation(plan, out_dir / "manipulation.json")
        for n, part in enumerate(plan.chain, start=1):
            name = "trajectory.csv" if n == 1 else f"trajectory-{n}.csv"
            write_trajectory(part.joint_trajectory(), out_dir / name)
    if not as_json:
        tell(str(plan), f"planned in {plan.cpu_s:.2f} s of CPU, {plan.attempts} attempts\n")
    with err.status("executing ..."):
        report = simulate(
            plan,
            **parts,
            criteria=SuccessCriteria(normal_N=execution.max_force),
            pictures=out_dir,
            video=execution.video,
            arrows=execution.arrows,
            retry=True,
            view=execution.view,
            via=via,
        )
    report = replace(report, command=command)
    if out_dir is not None:
        write_report(report.to_dict(), out_dir / "report.json")
        report.save_html(out_dir / "report.html")
    if as_json:
        print_json(report.to_dict())
    else:
        tell(str(report))
        if out_dir is not None:
            tell(f"written to {out_dir}: manipulation.json, trajectory.csv, report.json")
            tell(f"open in a browser: {out_dir / 'report.html'}")
        if report.drawn:
            tell(report.drawn)
    if report.interrupted:
        raise typer.Exit(EXIT_INTERRUPTED)
    if not report.complete or report.collision is not None:
        raise typer.Exit(EXIT_NO)


def _read(file: Path, place: tuple[float, float]) -> ManipulationPlan:
    """The manipulation of a file; a movement without an ending is put down at a place."""
    from planner.files import read_json
    from planner.files.movements import movement_from_dict
    from planner.motion.manipulation import ManipulationPlan, manipulation_of
    from sim.manipulation import rests

    plan = movement_from_dict(read_json(file, "plan file"), str(file))
    if isinstance(plan, ManipulationPlan):
        return plan
    return manipulation_of(plan, place=place, rests=rests)
