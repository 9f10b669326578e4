"""Options that several commands share: a dataclass per group, one option for each of its fields.

A command that takes such a group as a parameter stands under ``@with_options``::

    @errors_for_people()
    @with_options
    def plan(hand: HandArgument, *, request: PlanOptions) -> None: ...
"""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import dataclass, fields, is_dataclass, replace
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeVar, get_type_hints

import typer
from rich.markup import escape

from sim.cli.common import (
    SEARCH_PANEL,
    ArrowsOption,
    ControllerOption,
    EstimateOption,
    PadsOption,
    PhysicsOption,
    RealityOption,
    RealitySeedOption,
    SeedOption,
    SimMuOption,
    VerboseOption,
    VideoOption,
    ViewOption,
    check_films,
    controller_of,
    err,
    estimate_of,
    heeding_ctrl_c,
    numbers,
    out,
    physics_of,
    reality_of,
    say,
)
from sim.cli.task_options import TaskOptions

if TYPE_CHECKING:
    from planner.plan import GraspPlan
    from planner.search import Attempt
    from planner.synthesis.options import SynthesisOptions
    from sim.report import TrialReport

Command = TypeVar("Command", bound=Callable[..., None])

AttemptsOption = Annotated[
    int,
    typer.Option(
        min=1, help="Attempts before giving up.", metavar="N", rich_help_panel=SEARCH_PANEL
    ),
]
GraspAttemptsOption = Annotated[
    int | None,
    typer.Option(
        min=1,
        help="Attempts before giving up; 100 if not given.",
        metavar="N",
        rich_help_panel=SEARCH_PANEL,
    ),
]
ObjectiveOption = Annotated[
    str,
    typer.Option(
        help="epsilon, min_weight, task, robustness, torque, manipulability, limits; several "
        "with weights: epsilon:1,torque:0.5; or none.",
        metavar="NAMES",
        rich_help_panel=SEARCH_PANEL,
    ),
]
RoundsOption = Annotated[
    int | None,
    typer.Option(
        min=0,
        help="Rounds of work on the objectives.",
        metavar="N",
        rich_help_panel=SEARCH_PANEL,
    ),
]


def with_options(command: Command) -> Command:
    """A command for Typer: a parameter of a dataclass type becomes an option for each field."""
    parameters: list[inspect.Parameter] = []
    groups: dict[str, type] = {}
    for parameter in inspect.signature(command, eval_str=True).parameters.values():
        group = parameter.annotation
        if not (isinstance(group, type) and is_dataclass(group)):
            parameters.append(parameter.replace(kind=inspect.Parameter.KEYWORD_ONLY))
            continue
        groups[parameter.name] = group
        hints = get_type_hints(group, include_extras=True)
        parameters += [
            inspect.Parameter(
                field.name,
                inspect.Parameter.KEYWORD_ONLY,
                default=field.default,
                annotation=hints[field.name],
            )
            for field in fields(group)
        ]

    @wraps(command)
    def called(**given: Any) -> None:
        for name, group in groups.items():
            given[name] = group(**{f.name: given.pop(f.name) for f in fields(group)})
        command(**given)

    stated: Any = called
    stated.__signature__ = inspect.Signature(parameters)
    stated.__annotations__ = {p.name: p.annotation for p in parameters}
    stated_as: Command = stated
    return stated_as


def _refuse_our_file(object: str) -> None:
    """Say which command takes a plan or report that was given as the object.

    Raises:
        TaskError: It is one.
    """
    if not object.lower().endswith(".json"):
        return
    from planner.errors import TaskError, shown
    from sim.viewing.kinds import Target

    kind = Target(object).format
    if kind == "opposable-plan":
        raise TaskError(f"{object} is a plan file, not an object: opposable simulate {object}")
    if kind.startswith("opposable-"):
        raise TaskError(
            f"{object} is of format {shown(kind)}, not an object: opposable view {object}"
        )


@dataclass(frozen=True, kw_only=True)
class PlanOptions(TaskOptions):
    """What ``run``, ``plan`` and ``batch`` are asked for: the same options make the same task."""

    seed: SeedOption = 0
    max_attempts: GraspAttemptsOption = None
    max_cpu_s: Annotated[
        float | None,
        typer.Option(
            help="CPU seconds before giving up.", metavar="S", rich_help_panel=SEARCH_PANEL
        ),
    ] = None
    objective: ObjectiveOption = "epsilon"
    task_wrench: Annotated[
        list[str] | None,
        typer.Option(
            help="For objective task: fx,fy,fz,tx,ty,tz, N and N m, object's axes; repeatable.",
            metavar="W",
            rich_help_panel=SEARCH_PANEL,
        ),
    ] = None
    rounds: RoundsOption = None

    def synthesis(self) -> SynthesisOptions:
        """Options of synthesis.

        Raises:
            TaskError: A wrench is not made of six numbers, or they are not those of an objective.
            NotFoundError: An objective that does not exist.
        """
        from planner.synthesis.options import SynthesisOptions

        wrenches = [numbers("--task-wrench", text, 6) for text in self.task_wrench or ()]
        options = SynthesisOptions(
            objective=self.objective, task_wrenches=tuple(tuple(row) for row in wrenches)
        )
        return options if self.rounds is None else replace(options, rounds=self.rounds)


@dataclass(frozen=True, kw_only=True)
class BestOptions(PlanOptions):
    """What ``run`` and ``plan`` are asked for beside that: which of several grasps."""

    best_of: Annotated[
        int | None,
        typer.Option(
            min=1,
            help="Grasps to find, of which the best is taken.",
            metavar="N",
            rich_help_panel=SEARCH_PANEL,
        ),
    ] = None
    keep: Annotated[
        str,
        typer.Option(
            help="first, or best: the best within --max-attempts or --max-cpu-s.",
            metavar="NAME",
            rich_help_panel=SEARCH_PANEL,
        ),
    ] = "first"
    metric: Annotated[
        str | None,
        typer.Option(
            help="By what the best is chosen, as --objective; that one if not given.",
            metavar="NAMES",
            rich_help_panel=SEARCH_PANEL,
        ),
    ] = None

    def plan(self, hand: str, object: str) -> GraspPlan:
        """Plan with a spinner that counts attempts, and tells the best value, on stderr.

        Raises:
            PlannerError: Bad input; a file of ours in place of the object is told what takes it.
            NoGraspFoundError: No attempt found a grasp.
            KeyboardInterrupt: Ctrl-C before anything was found; later it ends a search for the best
                with what it has.
        """
        from planner.errors import NoGraspFoundError
        from planner.search import DEFAULT_MAX_ATTEMPTS, plan_grasp
        from sim.cli.low_objects import advice_for_low, advice_for_size, said_of_low

        _refuse_our_file(object)
        options, task = self.synthesis(), self.task(hand, object)
        compares = self.best_of is not None or self.keep != "first"
        title = f"planning: {task.hand.name}, {task.object.name} ..."
        with heeding_ctrl_c(at_once=not compares) as check, err.status(title) as status:

            def show(attempt: Attempt[GraspPlan]) -> bool:
                outcome = escape(str(attempt.failure or "found")[:70])
                best = "" if attempt.best is None or not compares else f", best {attempt.best:.4g}"
                status.update(f"planning: attempt {attempt.index + 1}{best}: {outcome}")
                if check.pressed and compares and attempt.best is not None:
                    return True
                check()
                return False

            try:
                plan = plan_grasp(
                    task,
                    seed=self.seed,
                    max_attempts=self.max_attempts,
                    max_cpu_s=self.max_cpu_s,
                    best_of=self.best_of,
                    keep=self.keep,
                    metric=self.metric,
                    options=options,
                    progress=show,
                )
            except NoGraspFoundError as error:
                standing = None if self.at is not None and self.at.count(",") > 1 else self.pose
                if self.stand or standing is None:
                    raise
                status.update("planning: whether it would be found if the object stood higher ...")
                advice = advice_for_low(
                    task,
                    pose=standing,
                    options=options,
                    seed=self.seed,
                    max_attempts=self.max_attempts or DEFAULT_MAX_ATTEMPTS,
                    progress=show,
                )
                if advice is not None:
                    raise said_of_low(error, task, advice) from error
                if task.object.touch is not None or self.max_cpu_s is not None:
                    raise
                status.update("planning: whether another pose or size would be grasped ...")
                advice = advice_for_size(
                    task,
                    pose=standing,
                    options=options,
                    seed=self.seed,
                    max_attempts=self.max_attempts or DEFAULT_MAX_ATTEMPTS,
                    progress=show,
                )
                if advice is None:
                    raise
                raise NoGraspFoundError(f"{error}. {advice}", error.attempts) from error
        best = plan.record.best
        if check.pressed and best is not None:
            say(
                err,
                f"interrupted: the best of {best.found} found in {plan.record.attempts} attempts "
                "is kept",
            )
        return plan

    def several(self, hand: str, object: str, n: int, *, diverse: bool) -> list[GraspPlan]:
        """Plan several grasps, with a spinner; Ctrl-C ends it with what was found.

        Raises:
            PlannerError: Bad input, or options of a single grasp.
            NoGraspFoundError: No attempt found a grasp.
            KeyboardInterrupt: Ctrl-C before anything was found.
        """
        from planner.batch import plan_several
        from planner.errors import TaskError

        _refuse_our_file(object)
        if self.best_of is not None or self.keep != "first":
            raise TaskError(
                f"--best-of and --keep choose one grasp, and {n} are asked for; leave one out"
            )
        options, task = self.synthesis(), self.task(hand, object)
        title = f"planning: {task.hand.name}, {task.object.name} ..."
        found = 0
        with heeding_ctrl_c(at_once=False) as check, err.status(title) as status:

            def show(attempt: Attempt[GraspPlan]) -> bool:
                nonlocal found
                found += attempt.plan is not None
                if check.pressed and not found:
                    check()
                status.update(f"planning: attempt {attempt.index + 1}: {found} found")
                return check.pressed

            return plan_several(
                task,
                n,
                diverse=diverse,
                seed=self.seed,
                max_attempts=self.max_attempts,
                max_cpu_s=self.max_cpu_s,
                metric=self.metric,
                options=options,
                progress=show,
            )


@dataclass(frozen=True, kw_only=True)
class TrialOptions:
    """How ``run`` and ``simulate`` execute a plan."""

    sim_mu: SimMuOption = None
    physics: PhysicsOption = "ours"
    reality: RealityOption = "ideal"
    reality_seed: RealitySeedOption = None
    estimate: EstimateOption = None
    pads: PadsOption = None
    controller: ControllerOption = "feedforward"
    view: ViewOption = False
    video: VideoOption = None
    arrows: ArrowsOption = False
    verbose: VerboseOption = False

    def show(self, report: TrialReport, *, picture: bool = False) -> None:
        """Print a report: verdict and contacts, with ``--verbose`` what explains them too.

        Args:
            report: What happened.
            picture: Whether a picture was asked for by name, so that its file is told.
        """
        out.print(report)
        if self.verbose:
            for line in report.details():
                out.print(line)
        if report.drawn and (self.verbose or self.video or picture):
            say(out, escape(report.drawn))

    def trial(self) -> Callable[[GraspPlan, Path | None], TrialReport]:
        """What executes a plan, with a progress bar on stderr, and draws it.

        Raises:
            PlannerError: A controller or physics that there is not, no display to view on, or a
                video that cannot be written; bad input ends before anything is planned.
        """
        from rich.progress import Progress

        from sim.looking.viewer import check_display
        from sim.trial import simulate

        driver = controller_of(self.controller)
        physics = physics_of(self.physics, self.sim_mu)
        reality = reality_of(self.reality, self.reality_seed, self.pads)
        estimator = estimate_of(self.estimate)
        if self.view:
            check_display()
        check_films(self.video)

        def execute(plan: GraspPlan, picture: Path | None) -> TrialReport:
            with Progress(console=err, transient=True, disable=not err.is_terminal) as progress:
                bar = progress.add_task("simulating", total=1.0)
                return simulate(
                    plan,
                    physics=physics,
                    reality=reality,
                    estimator=estimator,
                    controller=driver,
                    progress=lambda share: progress.update(bar, completed=share),
                    view=self.view,
                    picture=picture,
                    video=self.video,
                    arrows=self.arrows,
                )

        return execute
