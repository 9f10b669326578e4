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
from typing import TYPE_CHECKING, Any, TypeVar, get_type_hints

from rich.markup import escape

from sim.cli.common import (
    ArrowsOption,
    AttemptsOption,
    AvoidOption,
    ControllerOption,
    CpuOption,
    DensityOption,
    FingersOption,
    LoadOption,
    MassOption,
    MuOption,
    ObjectiveOption,
    PhysicsOption,
    PoseOption,
    RepairOption,
    RoundsOption,
    SeedOption,
    SimMuOption,
    TaskWrenchOption,
    TouchOption,
    VideoOption,
    ViewOption,
    check_films,
    err,
    heeding_ctrl_c,
    names,
    numbers,
    physics_of,
)

if TYPE_CHECKING:
    from planner.forces import ExpectedLoad
    from planner.hands.hand import Hand
    from planner.plan import GraspPlan
    from planner.regions import TouchRegion
    from planner.search import Attempt
    from planner.synthesis.options import SynthesisOptions
    from planner.task import GraspTask
    from sim.report import TrialReport

__all__ = ["PlanOptions", "TrialOptions", "with_options"]

Command = TypeVar("Command", bound=Callable[..., None])


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


@dataclass(frozen=True, kw_only=True)
class PlanOptions:
    """What ``run``, ``plan`` and ``batch`` are asked for: the same options make the same task."""

    fingers: FingersOption = None
    seed: SeedOption = 0
    mu: MuOption = 0.5
    mass: MassOption = None
    density: DensityOption = None
    repair: RepairOption = False
    pose: PoseOption = 0
    touch: TouchOption = None
    avoid: AvoidOption = None
    expect_load: LoadOption = None
    max_attempts: AttemptsOption = 100
    max_cpu_s: CpuOption = None
    objective: ObjectiveOption = "epsilon"
    task_wrench: TaskWrenchOption = None
    rounds: RoundsOption = None

    def task(self, hand: Hand | str, object: str) -> GraspTask:
        """The task with a hand, or its name or path, and an object as ``parse_object`` takes it.

        Raises:
            PlannerError: An unknown name, or something that cannot be.
        """
        from planner.objects import parse_object
        from planner.task import GraspTask

        item = parse_object(
            object,
            mass=self.mass,
            density=self.density,
            repair=self.repair,
            touch=self._touch_region(),
        )
        return GraspTask.create(
            hand,
            item,
            T_world_object=item.resting_pose(index=self.pose),
            mu=self.mu,
            fingers=None if self.fingers is None else names(self.fingers),
            expected_load=self._load(),
        )

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

    def plan(self, hand: str, object: str) -> GraspPlan:
        """Plan with a spinner that counts attempts on stderr.

        Raises:
            PlannerError: Bad input.
            NoGraspFoundError: No attempt found a grasp.
        """
        from planner.search import plan_grasp

        options, task = self.synthesis(), self.task(hand, object)
        title = f"planning: {task.hand.name}, {task.object.name} ..."
        with heeding_ctrl_c() as check, err.status(title) as status:

            def show(attempt: Attempt[GraspPlan]) -> None:
                check()
                outcome = escape(str(attempt.failure or "found")[:70])
                status.update(f"planning: attempt {attempt.index + 1}: {outcome}")

            return plan_grasp(
                task,
                seed=self.seed,
                max_attempts=self.max_attempts,
                max_cpu_s=self.max_cpu_s,
                options=options,
                progress=show,
            )

    def _touch_region(self) -> TouchRegion | None:
        from planner.regions import TouchRegion, parse_region

        if not self.touch and not self.avoid:
            return None
        return TouchRegion(
            allowed=tuple(parse_region(text) for text in self.touch or ()),
            forbidden=tuple(parse_region(text) for text in self.avoid or ()),
        )

    def _load(self) -> ExpectedLoad | None:
        from planner.forces import ExpectedLoad

        if self.expect_load is None:
            return None
        count = 2 if "," in self.expect_load else 1
        force, torque = (*numbers("--expect-load", self.expect_load, count), 0.0)[:2]
        return ExpectedLoad(force=force, torque=torque)


@dataclass(frozen=True, kw_only=True)
class TrialOptions:
    """How ``run`` and ``simulate`` execute a plan."""

    sim_mu: SimMuOption = None
    physics: PhysicsOption = "ours"
    controller: ControllerOption = "feedforward"
    view: ViewOption = False
    video: VideoOption = None
    arrows: ArrowsOption = False

    def trial(self) -> Callable[[GraspPlan, Path | None], TrialReport]:
        """What executes a plan, with a progress bar on stderr, and draws it.

        Raises:
            PlannerError: A controller or physics that there is not, no display to view on, or a
                video that cannot be written; bad input ends before anything is planned.
        """
        from rich.progress import Progress

        from sim.controllers import named_controller
        from sim.looking.viewer import check_display
        from sim.trial import simulate

        make, physics = named_controller(self.controller), physics_of(self.physics, self.sim_mu)
        if self.view:
            check_display()
        check_films(self.video)

        def execute(plan: GraspPlan, picture: Path | None) -> TrialReport:
            with Progress(console=err, transient=True, disable=not err.is_terminal) as progress:
                bar = progress.add_task("simulating", total=1.0)
                return simulate(
                    plan,
                    physics=physics,
                    controller=make(plan),
                    progress=lambda share: progress.update(bar, completed=share),
                    view=self.view,
                    picture=picture,
                    video=self.video,
                    arrows=self.arrows,
                )

        return execute
