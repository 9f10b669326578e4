"""``Episode``: one executed trial as a row of samples with its task in words and its outcome.

A report becomes an episode, whether it was just made or read from a file: states, commands and
contacts come from its ``Recording``, success and reason from its verdict. A manipulation that was
put down half-way and begun again is an episode for each run, since the hand stands elsewhere then.

``Robot``: names and units of a hand's joints, actuators and contacts in a data set.

Which samples of a recording are the frames of an episode with a fixed rate.

A data set with a frame rate has its frames at even times. They are samples as they were recorded:
nothing is interpolated, so that forces and contacts are those of the simulation.

All formats of episodes by name; a format is one module, and one registration.

A format has a writer, which takes episodes one by one into a folder of its own. ``opposable
dataset episodes --to NAME`` writes whatever is registered here.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, fields, replace
from importlib import import_module
from pathlib import Path
from typing import Any, Literal, Protocol, TypeAlias

import mujoco
import numpy as np

from planner.arrays import check_fields, checked_count
from planner.errors import FileFormatError, TaskError, shown
from planner.files.data import PlanFile
from planner.files.disk import checked_file
from planner.files.movements import MovementFile, as_movement
from planner.hands.hand import Hand
from planner.pages.page import without_folder
from planner.registry import Registry
from planner.spatial import FloatArray, IntArray
from planner.task import GraspTask
from sim.manipulation.page_parts import obstacles_of
from sim.manipulation.report import ManipulationReport
from sim.manipulation.report_file import ManipulationReportFile
from sim.recording import PALM, Recording
from sim.report import TrialReport
from sim.report_file import ReportFile
from sim.show.parts import task_of_plan

SERVO_TOL = 1e-9
"""Relative difference of gain and stiffness (-) up to which a command is the servo's target."""

NO_UNIT = "-"


@dataclass(frozen=True, kw_only=True)
class Robot:
    """What all episodes of one data set have in common.

    Attributes:
        name: Of the hand.
        joint_names: nq names, the order of ``Recording.q``.
        joint_units: "rad" or "m" per joint.
        actuator_names: nu names, the order of ``Recording.commands``.
        command_units: Per actuator: "rad" or "m" for the target of a position servo, "N m" or "N"
            for a torque or force, "-" where the model scales the command by a gain.
        contact_names: Columns of contacts: every finger of the hand, then ``PALM``.
    """

    name: str
    joint_names: tuple[str, ...]
    joint_units: tuple[str, ...]
    actuator_names: tuple[str, ...]
    command_units: tuple[str, ...]
    contact_names: tuple[str, ...]

    @classmethod
    def of(cls, hand: Hand) -> Robot:
        """Of a hand; an arm that carries it counts as part of it."""
        slide = int(mujoco.mjtJoint.mjJNT_SLIDE)
        types = [int(hand.mj_model.joint(name).type[0]) for name in hand.joint_names]
        return cls(
            name=hand.name,
            joint_names=hand.joint_names,
            joint_units=tuple("m" if kind == slide else "rad" for kind in types),
            actuator_names=hand.actuation.names,
            command_units=tuple(
                _command_unit(hand, i, [kind == slide for kind in types])
                for i in range(len(hand.actuation.names))
            ),
            contact_names=(*hand.fingers, PALM),
        )

    def refuse_unless_same(self, other: Robot, source: str) -> None:
        """Check that an episode is of this robot.

        Args:
            other: The episode's.
            source: What the error calls the episode.

        Raises:
            TaskError: Names or units differ; says the first that do.
        """
        for field in fields(self):
            ours, theirs = getattr(self, field.name), getattr(other, field.name)
            if ours != theirs:
                raise TaskError(
                    f"{source} is of another hand: its {field.name.replace('_', ' ')} are "
                    f"{_first_difference(theirs, ours)} before it; one data set "
                    "holds one hand, so write another folder for each"
                )


def _first_difference(theirs: str | tuple[str, ...], ours: str | tuple[str, ...]) -> str:
    if isinstance(theirs, str) or isinstance(ours, str) or len(theirs) != len(ours):
        return f"{shown(theirs)}, and {shown(ours)}"
    k = next(i for i, pair in enumerate(zip(theirs, ours, strict=True)) if pair[0] != pair[1])
    return f"{shown(theirs[k])} at place {k}, and {shown(ours[k])}"


def _command_unit(hand: Hand, i: int, slides: list[bool]) -> str:
    """Unit of the command of actuator i, by its law F = gain ctrl + bias1 length + ...."""
    actuation = hand.actuation
    gain, stiffness = float(actuation.gain[i]), -float(actuation.bias[i, 1])
    driven = [slides[k] for k in range(len(slides)) if actuation.moment[i, k]]
    linear = bool(driven) and all(driven)
    if abs(gain - stiffness) <= SERVO_TOL * abs(gain):
        return "m" if linear else "rad"
    if stiffness == 0.0 and gain == 1.0:
        return "N" if linear else "N m"
    return NO_UNIT


AnyReport: TypeAlias = TrialReport | ReportFile | ManipulationReport | ManipulationReportFile
"""Reports of which episodes are made."""

INTERRUPTED = "interrupted"
"""Reason of a trial that Ctrl-C ended: half an episode."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Episode:
    """One executed trial.

    Attributes:
        robot: Names and units.
        kind: "grasp", or "manipulation" for an object that is turned in the hand.
        sentence: The task in words, such as "grasp the box with allegro_hand and hold it".
        object: Specification of the object's shape, without folders.
        mass_kg: Its mass.
        success: The report's verdict.
        reason: Why not, "" for success.
        seed: Seed of the plan.
        controller: Name of the class that drove the hand.
        fingers: Fingers that take part.
        source: Where it is from, such as a file's name; for messages.
        recording: States, commands and contacts; its columns of contacts are those of the robot.
        task: Hand, object and surroundings to be drawn; None where they were not kept.
    """

    robot: Robot
    kind: Literal["grasp", "manipulation"]
    sentence: str
    object: str
    mass_kg: float
    success: bool
    reason: str
    seed: int
    controller: str
    fingers: tuple[str, ...]
    source: str
    recording: Recording
    task: GraspTask | None = None

    def __len__(self) -> int:
        """Number of samples."""
        return len(self.recording)

    @property
    def interrupted(self) -> bool:
        """Whether Ctrl-C ended it."""
        return self.reason == INTERRUPTED

    @property
    def fault(self) -> str:
        """Why it cannot be a part of a data set, "" if it can.

        No samples, times that do not increase, or numbers that are not finite. A contact is NaN
        where there is none.
        """
        states = self.recording
        if not len(states):
            return "no sample was recorded"
        touching = np.isfinite(states.points[..., 0])
        quantities = {
            "time": states.time,
            "a joint": states.q,
            "the base's pose": states.T_world_base,
            "the object's pose": states.T_world_object,
            "a command": states.commands,
            "a contact's place": np.where(touching[..., None], states.points, 0.0),
            "a contact's normal": np.where(touching[..., None], states.normals, 0.0),
            "a contact's force": np.where(touching[..., None], states.forces, 0.0),
        }
        for what, values in quantities.items():
            bad = ~np.isfinite(values.reshape(len(states), -1)).all(axis=1)
            if bad.any():
                return f"{what} is not finite in sample {int(np.argmax(bad))}"
        late = np.diff(states.time) <= 0
        if late.any():
            return f"time does not increase after sample {int(np.argmax(late))}"
        return ""

    def taken(self, samples: Sequence[int] | Any) -> Episode:
        """The same with some of its samples, by number."""
        states = self.recording
        few = replace(
            states,
            **{name: getattr(states, name)[samples] for name in _ROWS},
            phase=tuple(states.phase[i] for i in samples),
        )
        if "min_weight" in states.__dict__:
            few.__dict__["min_weight"] = states.min_weight[samples]
        return replace(self, recording=few)


_ROWS = (
    "time",
    "q",
    "T_world_base",
    "T_world_object",
    "points",
    "normals",
    "forces",
    "friction",
    "commands",
)
"""Arrays of a recording with a row per sample."""


def episodes_of(report: AnyReport, source: str = "the report") -> tuple[Episode, ...]:
    """The episodes of a report: one, or one per run of a manipulation that was begun again.

    Args:
        report: Of a trial or a manipulation, as it was made or as a file holds it.
        source: What messages call it, such as the file's name.

    Raises:
        FileFormatError: It holds no states or no plan, or the hand's files have changed since.
        PlannerError: Its hand or object cannot be loaded.
    """
    if isinstance(report, TrialReport | ReportFile):
        return (_of_trial(report, source),)
    return tuple(_of_runs(report, source))


def _of_trial(report: TrialReport | ReportFile, source: str) -> Episode:
    if isinstance(report, TrialReport):
        task, recording = report.plan.task, report.recording
    else:
        recording = _states(report, source)
        plan = _plan(report, source)
        task = task_of_plan(checked_file(PlanFile, plan, f"{source}'s plan"), f"{source}'s plan")
    name = task.object.name
    return _episode(
        report,
        task,
        recording,
        source,
        kind="grasp",
        sentence=f"grasp the {name} with {report.hand} and hold it",
        reason=report.reason,
    )


def _of_runs(report: ManipulationReport | ManipulationReportFile, source: str) -> Iterator[Episode]:
    if report.earlier is not None:
        yield from _of_runs(report.earlier, source)
    if isinstance(report, ManipulationReport):
        task, recording = report.plan.task, report.recording
        task = replace(task, obstacles=(*task.obstacles, *report.plan.under_target))
        angle, shift = np.rad2deg(report.asked), 1e3 * report.asked_shift
    else:
        recording = _states(report, source)
        whose = f"{source}'s plan"
        plan = checked_file(MovementFile, as_movement(_plan(report, source), whose), whose)
        task = task_of_plan(plan.grasp, whose)
        task = replace(task, obstacles=obstacles_of(plan, task))
        angle, shift = report.asked_deg, np.array(report.asked_shift_mm)
    told = [f"turn it by {angle:g} degrees"] if angle else []
    if shift.any():
        told.append(f"move it by ({', '.join(f'{v:g}' for v in shift + 0.0)}) mm")
    reason = "" if report.success else report.reason or report.faults or "not turned as asked"
    yield _episode(
        report,
        task,
        recording,
        source,
        kind="manipulation",
        sentence=f"pick up the {task.object.name} with {report.hand}, "
        f"{' and '.join(told)} in the hand and put it down",
        reason=reason,
    )


def _episode(
    report: AnyReport,
    task: GraspTask,
    recording: Recording,
    source: str,
    *,
    kind: Literal["grasp", "manipulation"],
    sentence: str,
    reason: str,
) -> Episode:
    task.require_fingertips("an episode")
    robot = Robot.of(task.hand)
    states = (recording.joint_names, recording.actuator_names)
    if states != (robot.joint_names, robot.actuator_names):
        raise FileFormatError(
            f"{source}: the recorded joints and actuators are not those of {robot.name}; the "
            "report is damaged"
        )
    return Episode(
        robot=robot,
        kind=kind,
        sentence=sentence,
        object=without_folder(report.object),
        mass_kg=report.mass_kg,
        success=report.success,
        reason=reason,
        seed=report.seed,
        controller=report.controller,
        fingers=tuple(report.fingers),
        source=source,
        recording=recording.with_columns(robot.contact_names),
        task=task,
    )


def _states(report: ReportFile | ManipulationReportFile, source: str) -> Recording:
    if report.recording is None:
        raise without_states(source)
    return Recording.from_data(report.recording)


def without_states(source: str) -> FileFormatError:
    """The error about a report that has no recorded states."""
    return FileFormatError(
        f"{source} has no recorded states: it was written without them or by an older version; "
        "simulate its plan again"
    )


def _plan(report: ReportFile | ManipulationReportFile, source: str) -> dict[str, Any]:
    if report.plan is None:
        raise FileFormatError(
            f"{source} holds no plan, so that its hand is unknown: no file can name a hand that "
            "was made in Python; write the episode from Python, where the report has its plan"
        )
    return report.plan


TIME_TOL = 2e-6
"""How far (s) a sample may lie from its frame's time: report files round times to 1e-6 s."""


def rates_of(time: FloatArray) -> tuple[int, ...]:
    """Whole frame rates (1/s) whose frames are samples, highest first; none if none is.

    Args:
        time: Times of the samples (m,), s, at least two.
    """
    period = float(np.median(np.diff(time)))
    rates = []
    for rate in range(int(1.0 / period + 0.5), 0, -1):
        steps = round(1.0 / (rate * period))
        if abs(steps * period - 1.0 / rate) <= steps * TIME_TOL:
            rates.append(rate)
    return tuple(rates)


def frames_at(time: FloatArray, fps: int | None, source: str) -> tuple[int, IntArray]:
    """The frame rate, and the numbers of the samples that are its frames.

    Frames begin at the first sample. Samples after the last frame are left out.

    Args:
        time: Times of the samples (m,), s, increasing.
        fps: Wanted rate, 1/s; the highest that fits if None.
        source: What errors call the episode.

    Raises:
        TaskError: There are too few samples, or no sample lies where a frame is.
    """
    if len(time) < 2:
        raise TaskError(f"{source}: an episode needs two samples or more, and has {len(time)}")
    fitting = rates_of(time)
    allowed = ", ".join(map(str, fitting)) or "none"
    if not fitting or (fps is not None and fps not in fitting):
        period = float(np.median(np.diff(time)))
        wanted = "no whole number of frames a second" if fps is None else f"{fps} frames a second"
        raise TaskError(
            f"{source}: {wanted} cannot be had of samples every {1e3 * period:g} ms without "
            f"inventing states; rates that fit: {allowed}; give one with --fps"
        )
    rate = fitting[0] if fps is None else fps
    count = int((time[-1] - time[0] + TIME_TOL) * rate) + 1
    wanted_times = time[0] + np.arange(count) / rate
    after = np.minimum(np.searchsorted(time, wanted_times - TIME_TOL), len(time) - 1)
    off = np.abs(time[after] - wanted_times) > TIME_TOL
    if off.any():
        raise TaskError(
            f"{source}: there is no sample at {wanted_times[np.argmax(off)]:.4f} s, where a frame "
            f"of {rate} a second is; rates that fit the other samples: {allowed}"
        )
    if count < 2:
        raise TaskError(f"{source}: at {rate} frames a second it has one frame; give a higher rate")
    frames: IntArray = after.astype(np.int64)
    return rate, frames


MOST_FPS = 10_000
"""Most frames per second: recordings have one per time step at most, 0.1 ms."""

MOST_PIXELS = 8192
"""Longest side of a film, pixels."""


@dataclass(frozen=True, kw_only=True)
class Asked:
    """What a data set is asked to be.

    Attributes:
        fps: Frames per second; None for what the recordings have.
        video: Whether it is to have a film of every episode.
        size: Width and height of the film, pixels.
    """

    fps: int | None = None
    video: bool = False
    size: tuple[int, int] = (320, 240)

    def __post_init__(self) -> None:
        """Check every number."""
        check_fields(self, ("fps",), least=1, most=MOST_FPS)
        pair = isinstance(self.size, tuple | list) and len(self.size) == 2
        width, height = self.size if pair else "??"
        for name, pixels in (("width", width), ("height", height)):
            checked_count(f"the film's {name}", pixels, least=1, most=MOST_PIXELS, error=TaskError)


class EpisodeWriter(Protocol):
    """Writes one data set; made for a new folder."""

    def add(self, episode: Episode) -> int:
        """Add an episode whole, or leave the data set as it was; the number of its frames.

        Raises:
            TaskError: Its sample times do not fit the frame rate.
            OSError: The folder cannot be written; then the data set is lost.
        """
        ...

    def finish(self) -> None:
        """Write what is known only now, and close all files; called once, after an episode."""
        ...

    def abandon(self) -> None:
        """Close all files; called instead of ``finish`` where something failed."""
        ...


@dataclass(frozen=True, kw_only=True)
class EpisodeFormat:
    """A format of data sets of episodes.

    Attributes:
        name: Lower case, as ``--to`` takes it.
        title: What it is, in a few words, with its version.
        loses: What of a recording it does not hold, a sentence; "" for nothing.
        films: Whether it can hold videos.
        writer: Makes the writer of a folder that exists and is empty.
    """

    name: str
    title: str
    loses: str
    films: bool
    writer: Callable[[Path, Asked], EpisodeWriter]


FORMATS: Registry[EpisodeFormat] = Registry("format of episodes")
"""All formats by name; those of others once their authors registered them."""


def register_format(episode_format: EpisodeFormat) -> EpisodeFormat:
    """Register a format under its name.

    Raises:
        TaskError: The name is taken.
    """
    return FORMATS.add(episode_format.name, episode_format)


def format_named(name: str) -> EpisodeFormat:
    """The format of a name.

    Raises:
        NotFoundError: There is none.
    """
    import_module("sim.datasets.episodes.lerobot")  # which registers itself
    return FORMATS.named(name)
