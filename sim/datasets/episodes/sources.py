"""What episodes are made of on the command line: plan files, report files and batches.

All inputs are looked at before the first trial runs, so that bad input costs no work.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from planner.batch import GraspSet
from planner.errors import FileFormatError, NotFoundError, TaskError, shown
from planner.files import plan_files
from planner.files.disk import MOVEMENT_FORMATS
from planner.files.movements import manipulation_from_dict
from planner.files.plans import plan_from_dict
from planner.plan import GraspPlan
from sim.controllers import AnyController
from sim.datasets.episodes.episode import AnyReport, without_states
from sim.manipulation import manipulate
from sim.manipulation.report_file import read_manipulation_report
from sim.manipulation.run import check_turn
from sim.report_file import read_report, report_data
from sim.scene.physics import PhysicsOptions
from sim.trial import simulate

BATCH = "manifest.json"
"""File by which the folder of a batch is known."""

PLANS = ("opposable-plan", *MOVEMENT_FORMATS)
"""Formats of files in a folder that are executed."""

USUAL_RATE = 50.0
"""Samples per second of a trial, unless the frame rate asks for others: at least so many, since
the verdict sees what is recorded."""

STEP_TOL = 1e-9
"""How far (steps) a period may be from whole time steps."""


@dataclass(frozen=True, kw_only=True)
class Trials:
    """How plans are executed.

    Attributes:
        controller: What drives the hand; None for the default of a trial or a manipulation.
        physics: How MuJoCo computes.
        fps: Frames per second that are wanted; None for the usual samples.
    """

    controller: AnyController | None = None
    physics: PhysicsOptions
    fps: int | None = None

    @property
    def record_every(self) -> float:
        """Time (s) between samples of which the frames are some.

        Raises:
            TaskError: No sample can be where a frame is.
        """
        timestep = self.physics.timestep
        if self.fps is None:
            return 1.0 / USUAL_RATE
        for rate in range(self.fps, round(1.0 / timestep) + 1, self.fps):
            steps = 1.0 / (rate * timestep)
            if rate >= USUAL_RATE and _whole(steps):
                return 1.0 / rate
        fitting = [r for r in range(1, 101) if _whole(1.0 / (r * timestep))]
        raise TaskError(
            f"{self.fps} frames a second fall between the time steps of {1e3 * timestep:g} ms; "
            f"rates up to 100 that fit: {', '.join(map(str, fitting))}; give one with --fps"
        )

    def execute(self, plan: GraspPlan) -> AnyReport:
        """A trial of a grasp; Ctrl-C ends all."""
        report = simulate(
            plan,
            physics=self.physics,
            controller=self.controller,
            record_every=self.record_every,
        )
        if report.reason == "interrupted":
            raise KeyboardInterrupt
        return report

    def turn(self, data: dict[str, Any], name: str) -> AnyReport:
        """A manipulation; Ctrl-C ends all."""
        plan = manipulation_from_dict(data, name)
        report = manipulate(plan, controller=self.controller, physics=self.physics)
        if report.interrupted:
            raise KeyboardInterrupt
        return report


@dataclass(frozen=True, kw_only=True)
class Source:
    """One trial that becomes an episode.

    Attributes:
        name: What messages call it.
        hand: Name of its hand.
        report: Reads or makes its report.
    """

    name: str
    hand: str
    report: Callable[[], AnyReport]


def sources_of(
    paths: Sequence[Path], trials: Trials, *, most: int | None = None
) -> tuple[Source, ...]:
    """The trials that files and folders stand for, in order.

    Args:
        paths: Plan files of grasps and manipulations, folders of plan files, report files (JSON or
            page), and folders of batches, each of whose grasps is a trial.
        trials: How plans are executed.
        most: Trials taken of every batch, the first; None for all.

    Raises:
        NotFoundError: A path does not exist.
        FileFormatError: A file is none of these, or a report without states.
        TaskError: They are of different hands.
    """
    found: list[Source] = []
    for path in paths:
        if not path.exists():
            raise NotFoundError(
                "file", str(path), (), "give a plan, a report or a batch", is_path=True
            )
        found += _of_folder(path, trials, most) if path.is_dir() else _of_file(path, trials)
    for source in found:
        if source.hand != found[0].hand:
            raise TaskError(
                f"{found[0].name} is of {found[0].hand} and {source.name} of {source.hand}; one "
                "data set holds one hand, so write another folder for each"
            )
    return tuple(found)


def _of_folder(folder: Path, trials: Trials, most: int | None) -> Iterator[Source]:
    if (folder / BATCH).is_file():
        yield from _of_batch(folder, trials, most)
        return
    files = plan_files(folder, PLANS)
    if not files:
        raise FileFormatError(
            f"{folder} holds neither a batch, for there is no {BATCH} in it, nor plan files; give "
            "plans, reports, or the folder of a batch"
        )
    for file in files:
        yield from _of_file(file, trials)


def _of_batch(folder: Path, trials: Trials, most: int | None) -> Iterator[Source]:
    grasps = GraspSet(folder)
    numbers = [number for number, _ in grasps.found()][:most]
    for number in numbers:
        yield Source(
            name=f"{folder} row {number}",
            hand=grasps.manifest.hand,
            report=partial(_row, grasps, number, trials),
        )


def _row(grasps: GraspSet, number: int, trials: Trials) -> AnyReport:
    return trials.execute(grasps.plan(number))


def _of_file(path: Path, trials: Trials) -> Iterator[Source]:
    data, name = report_data(path), str(path)
    kind = data.get("format")
    if kind == "opposable-plan":
        plan = plan_from_dict(data, name)
        yield Source(name=name, hand=plan.task.hand.name, report=partial(trials.execute, plan))
    elif kind in MOVEMENT_FORMATS:
        movement = manipulation_from_dict(data, name)
        check_turn(movement)  # before anything is executed
        yield Source(
            name=name, hand=movement.task.hand.name, report=partial(trials.turn, data, name)
        )
    elif kind in _READERS:
        if not data.get("recording"):
            raise without_states(name)
        yield Source(name=name, hand=str(data.get("hand")), report=partial(_READERS[kind], path))
    else:
        raise FileFormatError(
            f"{path} is of format {shown(kind)}, not a plan or a report of a grasp or a "
            "manipulation"
        )


_READERS: dict[Any, Callable[[Path], AnyReport]] = {
    "opposable-report": read_report,
    "opposable-manipulation-report": read_manipulation_report,
}


def _whole(steps: float) -> bool:
    return abs(steps - round(steps)) < STEP_TOL * steps
