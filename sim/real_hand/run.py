"""``run_controller``: the phases of a trial, on any hand.

::

    with closing(hand):
        report = run_controller(hand, GraspController(plan), plan, rate_hz=100, log="run.npz")
    print(report)
"""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path

from planner.errors import FileFormatError
from planner.plan import GraspPlan
from planner.system.process import interrupts_wait
from sim.controllers.base import PHASES, Controller
from sim.controllers.schedule import TOUCH_FORCE
from sim.real_hand.clock import Clock
from sim.real_hand.interface import HandInterface
from sim.real_hand.limits import CommandLimits
from sim.real_hand.loop import Carry, ControlLoop
from sim.real_hand.report import LoopReport
from sim.real_hand.safety import Safety
from sim.real_hand.senses import HandObservation, Observer
from sim.timeline import Timeline


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
    timeline = timeline or Timeline()
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
