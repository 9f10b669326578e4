"""Options of planning a grasp, and planning with them: a spinner, Ctrl-C, advice where none is."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from rich.markup import escape

from sim.cli.common import err, heeding_ctrl_c, say
from sim.cli.options import (
    SEARCH,
    ObjectiveOption,
    RoundsOption,
    SeedOption,
    numbers,
    option,
)
from sim.cli.tasks import TaskOptions, error_of, is_cloud, table_of

if TYPE_CHECKING:
    from rich.status import Status
    from rich.table import Table

    from planner.errors import NoGraspFoundError
    from planner.motion.plan import ManipulationPlan
    from planner.plan import GraspPlan
    from planner.search.from_cloud import CloudPlan
    from planner.search.grasp import Attempt
    from planner.synthesis.options import SynthesisOptions
    from planner.task import GraspTask

    Progress = Callable[[Attempt[GraspPlan]], bool]


NOT_OF_HANDOVERS = (
    "max_attempts",
    "max_cpu_s",
    "objective",
    "task_wrench",
    "rounds",
    "best_of",
    "keep",
    "metric",
    "fingers",
    "type",
    "grip_force",
    "base",
    "wrist",
)
"""Options of the search for one grasp, which ``--handover-to`` does not go with."""


def _refuse_our_file(object: str) -> None:
    """Say which command takes a plan or report that was given as the object.

    Raises:
        TaskError: It is one.
    """
    if not object.lower().endswith(".json"):
        return
    from planner.errors import TaskError, shown
    from sim.show.targets import Target

    kind = Target(object).format
    if kind == "opposable-plan":
        raise TaskError(f"{object} is a plan file, not an object: opposable test {object}")
    if kind.startswith("opposable-"):
        raise TaskError(
            f"{object} is of format {shown(kind)}, not an object: opposable view {object}"
        )


@dataclass(frozen=True, kw_only=True)
class PlanOptions(TaskOptions):
    """What ``run``, ``plan`` and ``batch`` are asked for: the same options make the same task."""

    seed: SeedOption = 0
    max_attempts: Annotated[
        int | None, option("Attempts before giving up; 100 if not given.", "N", SEARCH, min=1)
    ] = None
    max_cpu_s: Annotated[float | None, option("CPU seconds before giving up.", "S", SEARCH)] = None
    objective: ObjectiveOption = "epsilon"
    task_wrench: Annotated[
        list[str] | None,
        option(
            "For objective task: fx,fy,fz,tx,ty,tz, N and N m, object's axes; repeatable.",
            "W",
            SEARCH,
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
        int | None, option("Grasps to find, of which the best is taken.", "N", SEARCH, min=1)
    ] = None
    keep: Annotated[
        str,
        option("first, or best: the best within --max-attempts or --max-cpu-s.", "NAME", SEARCH),
    ] = "first"
    metric: Annotated[
        str | None,
        option(
            "By what the best is chosen, as --objective; that one if not given.", "NAMES", SEARCH
        ),
    ] = None

    @property
    def _compares(self) -> bool:
        """Whether more grasps are searched than one."""
        return self.best_of is not None or self.keep != "first"

    def _search(self, options: SynthesisOptions, progress: Progress) -> dict[str, Any]:
        """Arguments that every search of these options has."""
        return {
            "seed": self.seed,
            "max_attempts": self.max_attempts,
            "max_cpu_s": self.max_cpu_s,
            "metric": self.metric,
            "options": options,
            "progress": progress,
        }

    def handover(self, hand: str, object: str, to: str) -> ManipulationPlan:
        """Plan a handover, with a spinner on stderr.

        Args:
            hand: The hand that grasps, or two hands.
            object: What.
            to: The hand that takes it, or the name of that one of two hands.

        Raises:
            PlannerError: Bad input, options that a handover does not have, or nothing was found.
        """
        from planner.errors import TaskError
        from planner.hand_loading import load_hand
        from planner.hands.catalog import JOINED_NAMES
        from planner.motion.handover import plan_handover

        _refuse_our_file(object)
        unused = [
            f"--{name.replace('_', '-')}"
            for name in NOT_OF_HANDOVERS
            if getattr(self, name) != getattr(type(self), name)
        ]
        if unused:
            raise TaskError(
                f"{', '.join(unused)} is for one grasp, and a handover has three; leave it out"
            )
        if is_cloud(object):
            raise TaskError("a handover is planned for an object that is known; give no cloud")
        pair = load_hand(hand)
        if not pair.pair:
            pair, to = load_hand(f"{hand}+{to}"), JOINED_NAMES[-1]
        task = self.task(pair, object)
        with heeding_ctrl_c(at_once=True), err.status(f"handing over {task.object.name}"):
            return plan_handover(task, to=to, seed=self.seed)

    def plan(self, hand: str, object: str) -> GraspPlan:
        """Plan with a spinner that counts attempts, and tells the best value, on stderr.

        Raises:
            PlannerError: Bad input; a file of ours in place of the object is told what takes it.
            NoGraspFoundError: No attempt found a grasp.
            KeyboardInterrupt: Ctrl-C before anything was found; later it ends a search for the best
                with what it has.
        """
        from planner.errors import NoGraspFoundError
        from planner.search.grasp import plan_grasp

        if is_cloud(object):
            return self.of_cloud(hand, object).plan
        _refuse_our_file(object)
        options, task, compares = self.synthesis(), self.task(hand, object), self._compares
        with heeding_ctrl_c(at_once=not compares) as check, err.status(_title(task)) as status:

            def show(attempt: Attempt[GraspPlan]) -> bool:
                outcome = escape(str(attempt.failure or "found")[:70])
                best = "" if attempt.best is None or not compares else f", best {attempt.best:.4g}"
                status.update(f"planning: attempt {attempt.index + 1}{best}: {outcome}")
                if check.pressed and compares and attempt.best is not None:
                    return True
                check()
                return False

            search = self._search(options, show)
            try:
                plan = plan_grasp(task, best_of=self.best_of, keep=self.keep, **search)
            except NoGraspFoundError as error:
                self._advise(error, task, search, status)
                raise
        best = plan.record.best
        if check.pressed and best is not None:
            say(
                err,
                f"interrupted: the best of {best.found} found in {plan.record.attempts} attempts "
                "is kept",
            )
        return plan

    def of_cloud(self, hand: str, file: str) -> CloudPlan:
        """Plans on what cameras saw; how the rest is completed is printed on stderr.

        Raises:
            TaskError: Options that mean nothing for a cloud.
            ObjectError: A cloud that is not usable.
            UncertainError: No grasp survives enough of what may be true.
        """
        from planner.clouds.cloud import find_table
        from planner.clouds.files import read_cloud
        from planner.errors import TaskError
        from planner.hand_loading import load_hand
        from planner.objects import DEFAULT_MASS
        from planner.search.from_cloud import plan_from_cloud

        idle = {
            **{"--at": self.at, "--pose": self.pose, "--density": self.density},
            **{"--touch": self.touch, "--avoid": self.avoid, "--stand": self.stand},
            **{"--repair": self.repair, "--best-of": self.best_of, "--metric": self.metric},
            **{"--keep": self.keep != "first", "--max-cpu-s": self.max_cpu_s},
        }
        if given := [name for name, value in idle.items() if value]:
            raise TaskError(f"{', '.join(given)} means nothing for a cloud; leave it out")
        loaded, found = load_hand(hand), self.table.strip().lower() == "find"
        plain = self.objective == "epsilon" and self.rounds is None and not self.task_wrench
        shift, turn = error_of("--cloud-error", self.cloud_error)
        more = {} if self.max_attempts is None else {"max_attempts": self.max_attempts}
        cloud = read_cloud(file, table="find" if found else table_of(self.table))
        if cloud.table is None and not found and (height := find_table(cloud.points)) is not None:
            raise TaskError(
                f"{file} shows a table at z = {1e3 * height:.0f} mm, and --table is none: its "
                "points would be planned on as part of the object; leave --table out, or take "
                "these points away"
            )
        with err.status(f"planning: {loaded.name}, {file} ..."):
            plan = plan_from_cloud(
                loaded,
                cloud,
                seed=self.seed,
                mass=DEFAULT_MASS if self.mass is None else self.mass,
                name=Path(file).stem,
                pose_error=(shift / math.sqrt(3.0), turn / math.sqrt(3.0)),
                options=None if plain else self.synthesis(),
                **more,
                **self.told_of_grasp(loaded),
            )
        belief = plan.belief
        for note in (
            *belief.cloud.notes,
            f"{plan.survival:.0%} of {plan.samples} samples of what may be true are survived; the "
            f"surface at the contacts is known to {1e3 * plan.position_std.max():.1f} mm; what no "
            f"camera saw: {belief.hypothesis.name}",
        ):
            say(err, escape(note))
        return plan

    def _advise(
        self, error: NoGraspFoundError, task: GraspTask, search: dict[str, Any], status: Status
    ) -> None:
        """Try what would do instead, and say it.

        Raises:
            NoGraspFoundError: The error with what was found.
        """
        from planner.errors import NoGraspFoundError
        from planner.search.grasp import DEFAULT_MAX_ATTEMPTS
        from sim.cli.advice import advice_for_low, advice_for_size, said_of_low

        standing = None if self.at is not None and self.at.count(",") > 1 else self.pose
        if self.stand or standing is None:
            return
        budget: dict[str, Any] = {
            "pose": standing,
            "options": search["options"],
            "seed": self.seed,
            "max_attempts": self.max_attempts or DEFAULT_MAX_ATTEMPTS,
            "progress": search["progress"],
        }
        status.update("planning: whether it would be found if the object stood higher ...")
        if (advice := advice_for_low(task, **budget)) is not None:
            raise said_of_low(error, task, advice) from error
        if task.object.touch is not None or self.max_cpu_s is not None:
            return
        status.update("planning: whether another pose or size would be grasped ...")
        if (advice := advice_for_size(task, **budget)) is not None:
            raise NoGraspFoundError(f"{error}. {advice}", error.attempts) from error

    def several(self, hand: str, object: str, n: int, *, diverse: bool) -> list[GraspPlan]:
        """Plan several grasps, with a spinner; Ctrl-C ends it with what was found.

        Raises:
            PlannerError: Bad input, or options of a single grasp.
            NoGraspFoundError: No attempt found a grasp.
            KeyboardInterrupt: Ctrl-C before anything was found.
        """
        from planner.batch import plan_several
        from planner.errors import TaskError

        if is_cloud(object):
            raise TaskError(f"{object} is a cloud, of which one grasp is planned; leave -n out")
        _refuse_our_file(object)
        if self._compares:
            raise TaskError(
                f"--best-of and --keep choose one grasp, and {n} are asked for; leave one out"
            )
        options, task = self.synthesis(), self.task(hand, object)
        found = 0
        with heeding_ctrl_c(at_once=False) as check, err.status(_title(task)) as status:

            def show(attempt: Attempt[GraspPlan]) -> bool:
                nonlocal found
                found += attempt.plan is not None
                if check.pressed and not found:
                    check()
                status.update(f"planning: attempt {attempt.index + 1}: {found} found")
                return check.pressed

            return plan_several(task, n, diverse=diverse, **self._search(options, show))


def _title(task: GraspTask) -> str:
    return f"planning: {task.hand.name}, {task.object.name} ..."


def numbered(file: Path, n: int) -> list[Path]:
    """Names for n files: plan.json gives plan-1.json and so on, with as many digits as n has."""
    width = len(str(n))
    return [file.with_name(f"{file.stem}-{k:0{width}}{file.suffix}") for k in range(1, n + 1)]


def plans_table(plans: Sequence[GraspPlan], files: Sequence[Path]) -> Table:
    """A row per plan: file, attempt, epsilon, and how far the nearest other one is."""
    from planner.batch import separations
    from sim.tables import number, table_of

    table = table_of(
        "distance to the nearest other grasp: near-duplicates are at most 1",
        ("file", "fingers"),
        ("attempt", "epsilon", "distance"),
    )
    for plan, file, apart in zip(plans, files, separations(plans), strict=True):
        table.add_row(
            str(file),
            ", ".join(plan.task.finger_names),
            str(plan.record.attempt + 1),
            number(plan.quality.epsilon, 4),
            "-" if len(plans) == 1 else number(float(apart), 1),
        )
    return table
