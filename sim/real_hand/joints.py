"""``check_joints``: moves every actuator a little, one after the other, and says what moved.

To be run before the first closing, with nothing within the fingers' reach: it finds a sign that is
wrong, two cables that are swapped, a gear ratio, a joint that does not move. Position servos only.

``run_controller``: the phases of a trial, on any hand.

::

    with closing(hand):
        report = run_controller(hand, GraspController(plan), plan, rate_hz=100, log="run.npz")
    print(report)
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rich.table import Table

from planner.arrays import checked_kind, checked_number
from planner.errors import FileFormatError, HandError, TaskError
from planner.hands.hand import Hand
from planner.plan import GraspPlan
from planner.spatial import FloatArray
from planner.system.threads import interrupts_wait
from sim.controllers.base import PHASES, TOUCH_FORCE, Controller, Observation, Sense
from sim.real_hand.interface import Clock, HandInterface, HandObservation, Observer
from sim.real_hand.loop import Carry, ControlLoop, LoopReport
from sim.real_hand.safety import CommandLimits, Safety
from sim.scene.carrier import Timeline
from sim.tables import table_of


def run_controller(
    interface: HandInterface,
    controller: Controller,
    plan: GraspPlan,
    *,
    rate_hz: float = 100.0,
    timeline: Timeline | None = None,
    clock: Clock | None = None,
    limits: CommandLimits | None = None,
    safety: Safety | None = None,
    carry: Carry | None = None,
    assume: Collection[str] = (),
    least_touch: float = TOUCH_FORCE,
    log: Path | str | None = None,
) -> LoopReport:
    """Run the phases of a trial on a hand: approach, close, squeeze, settle, lift, hold.

    The hand is not lifted where fewer fingers touch than the task needs. At the end it holds its
    last command.

    Args:
        interface: The hand.
        controller: What drives it, made for the plan.
        plan: What is executed.
        rate_hz: Rate, Hz.
        timeline: Durations; defaults if None.
        clock: Tells the time and waits; the system's monotonic clock if None.
        limits: How far and how fast commands may move; defaults if None.
        safety: What ends the run at once; defaults if None.
        carry: Moves the hand as a whole; nobody if None.
        assume: Senses for which planned values stand in: "object_pose", "touch".
        least_touch: Normal force (N) from which on a finger counts as touching before the lift.
        log: Write readings and commands here (``.npz``), whatever happens.

    Raises:
        HandError: Names do not match, or the hand lacks a sense that the controller needs. Nothing
            was written.
        NotFoundError: Something is named that there is not.
        TaskError: A rate or a limit out of range.
        FileFormatError: The log cannot be written.
    """
    timeline = Timeline() if timeline is None else checked_kind("timeline", timeline, Timeline)
    task = plan.task
    if log is not None and not Path(log).parent.is_dir():
        raise FileFormatError(f"cannot write {log}: there is no folder {Path(log).parent}; make it")
    loop = ControlLoop(
        interface,
        controller,
        task.hand,
        Observer(interface, task.hand, plan, assume),
        rate_hz=rate_hz,
        clock=clock,
        limits=limits,
        safety=safety,
        carry=carry,
        keep_log=log is not None,
    )

    def too_few(observation: HandObservation) -> str:
        touching = int((observation.normal_forces > least_touch).sum()) if observation.feels else -1
        if touching < 0 or touching >= task.fingers_needed:
            return ""
        return f"before the lift {touching} touch; {task.fingers_needed} are needed"

    def phases(loop: ControlLoop) -> None:
        for phase in PHASES:
            closes = phase == "close"
            loop.phase(
                phase,
                getattr(timeline, phase),
                wait=timeline.close_wait if closes else 0.0,
                until=_all_touch if closes else None,
                refuse=too_few if phase == "lift" else None,
            )

    try:
        return loop.run(phases)
    finally:
        if log is not None:
            with interrupts_wait():
                loop.log.log().write(log)


def _all_touch(observation: HandObservation) -> bool:
    """Whether every finger touches, or none is felt at all: then waiting is of no use."""
    return not observation.feels or observation.all_touch


AMPLITUDE = 0.1
"""How far each actuator is moved, rad: 10 mm at the tip of a finger of 10 cm."""

SETTLE, EACH = 0.5, 1.0
"""Time (s) at rest before the first, and for each."""

UP, DOWN = 0.35, 0.65
"""Shares of that time at which the amplitude is reached, and left again."""

LEAST, MOST = 0.5, 1.5
"""Movement over command (-) of an actuator that follows: weight and dry friction take the rest."""

STILL = 0.2
"""Share of the amplitude (-) up to which an actuator or a joint of another one stands still."""


@dataclass(frozen=True, kw_only=True)
class JointCheck:
    """What one actuator did.

    Attributes:
        actuator: Its name.
        joints: Joints that it drives, by the hand's model.
        commanded: Change of its command, rad.
        moved: Change of its length as the joints were read, rad; NaN if it was not moved.
        other: Joint of another actuator that moved the most.
        other_moved: How far, rad.
    """

    actuator: str
    joints: tuple[str, ...]
    commanded: float
    moved: float
    other: str
    other_moved: float

    @property
    def fault(self) -> str:
        """What is wrong, "" if nothing."""
        if not np.isfinite(self.moved):
            return "was not moved: the run ended before"
        ratio = self.moved / self.commanded
        swapped = ratio < LEAST and abs(self.other_moved) > STILL * abs(self.commanded)
        if ratio < -STILL:
            return "moves the wrong way: turn its sign"
        if swapped:
            return f"moves {self.other} instead: is it another motor?"
        if ratio < STILL:
            return "does not move: power, cable, or something in the way?"
        if not LEAST <= ratio <= MOST:
            return f"moves by {ratio:.2f} of what was asked: gear, unit, or something in the way?"
        return ""


class _Probe:
    """A controller that moves one actuator after the other and notes where the joints went."""

    needs: tuple[Sense, ...] = ()

    def __init__(self, hand: Hand, amplitude: float) -> None:
        self._actuation = hand.actuation
        self._amplitude = amplitude
        self._begin: FloatArray | None = None
        of_arm = np.abs(hand.actuation.moment[:, hand.arm_index]).sum(axis=1) > 0
        self.actuators = np.flatnonzero(~of_arm)
        self.steps: FloatArray = np.zeros(len(of_arm))
        self.at_rest: dict[int, FloatArray] = {}
        self.moved: dict[int, FloatArray] = {}

    @property
    def duration(self) -> float:
        """How long it takes, s."""
        return SETTLE + EACH * len(self.actuators)

    def step(self, observation: Observation) -> FloatArray:
        """Commands (nu,) of this moment."""
        if self._begin is None:
            still = np.zeros(len(observation.q))
            self._begin = self._actuation.commands(observation.q, still, still)
            # towards the middle of the range: there is room
            above = self._begin > self._actuation.ctrl_range.mean(axis=1)
            self.steps = np.where(above, -self._amplitude, self._amplitude)
        commands = self._begin.copy()
        since = observation.time - SETTLE
        number = int(since // EACH)
        if 0 <= number < len(self.actuators):
            i = int(self.actuators[number])
            share = since / EACH - number
            self.at_rest.setdefault(i, observation.q)
            if share <= DOWN:
                self.moved[i] = observation.q
            shape = np.interp(share, (0.0, UP, DOWN, 1.0), (0.0, 1.0, 1.0, 0.0))
            commands[i] += self.steps[i] * float(shape)
        return commands


def check_joints(
    interface: HandInterface,
    hand: Hand,
    *,
    amplitude: float = AMPLITUDE,
    rate_hz: float = 50.0,
    clock: Clock | None = None,
    limits: CommandLimits | None = None,
    safety: Safety | None = None,
) -> tuple[list[JointCheck], LoopReport]:
    """Move every actuator of the hand but those of an arm, one after the other, and back.

    Args:
        interface: The hand.
        hand: Its model.
        amplitude: How far, rad.
        rate_hz: Rate, Hz.
        clock: Tells the time and waits; the system's monotonic clock if None.
        limits: How far and how fast commands may move; defaults if None.
        safety: What ends the run at once; defaults if None.

    Returns:
        What each actuator did, and how the loop went. One that the loop did not come to, since it
        was ended before, has a fault too.

    Raises:
        HandError: Names that do not match, or actuators that are no position servos.
        TaskError: An amplitude or a rate out of range.
    """
    checked_number("the amplitude", amplitude, above=0.0, error=TaskError)
    actuation = hand.actuation
    probe = _Probe(hand, amplitude)
    motors = [i for i in probe.actuators if actuation.bias[i, 1] >= 0.0]
    if motors:
        raise HandError(
            f"actuator {actuation.names[motors[0]]} is no position servo; only those can be moved "
            "by a little"
        )
    loop = ControlLoop(
        interface,
        probe,
        hand,
        Observer(interface, hand),
        rate_hz=rate_hz,
        clock=clock,
        limits=limits,
        safety=safety,
    )
    report = loop.run(lambda loop: loop.phase("approach", probe.duration))
    return [_judged(hand, probe, int(i)) for i in probe.actuators], report


def checks_table(checks: Sequence[JointCheck]) -> Table:
    """A line per actuator."""
    table = table_of("what moved", ("actuator", "joints", "fault"), ("asked (rad)", "moved (rad)"))
    for check in checks:
        numbers = f"{check.commanded:+.3f}", f"{check.moved:+.3f}"
        table.add_row(check.actuator, ", ".join(check.joints), check.fault or "-", *numbers)
    return table


def _judged(hand: Hand, probe: _Probe, i: int) -> JointCheck:
    actuation = hand.actuation
    unknown = np.full(hand.nq, np.nan)
    change = probe.moved.get(i, unknown) - probe.at_rest.get(i, unknown)
    row = actuation.moment[i]
    others = np.where(row != 0, 0.0, change)
    k = int(np.argmax(np.abs(others)))
    return JointCheck(
        actuator=actuation.names[i],
        joints=tuple(hand.joint_names[j] for j in np.flatnonzero(row)),
        commanded=float(probe.steps[i]),
        moved=float(row @ change),
        other=hand.joint_names[k],
        other_moved=float(others[k]),
    )
