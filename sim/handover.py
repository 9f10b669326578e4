"""``hand_over``: execute a movement with a ``Handover`` in MuJoCo and judge it.

One hand grasps and lifts as in any trial. The other one comes, closes until it feels the object,
and takes the load along a ramp; then the first opens and goes back, and the object is held::

    report = hand_over(plan_handover(GraspTask.create("two_allegro_hands", "box:0.06x0.06x0.16")))
    print(report.success, report.reason)

Each hand is driven by the controller of its own grasp, ``GraspController``. While the load is
transferred, they press with the shares 1 - s and s of their planned forces
(``planner.motion.handover``).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any, Unpack

import numpy as np
from numpy.typing import NDArray

from planner.errors import TaskError, shown
from planner.motion.phase import Handover
from planner.motion.plan import ManipulationPlan
from planner.plan import GraspPlan
from planner.spatial import SE3, FloatArray, minimum_jerk
from sim.controllers import PHASES, Observation, Phase
from sim.controllers.base import TOUCH_FORCE
from sim.controllers.grasp import RECLOSING_TIME, GraspController
from sim.manipulation.machine import PhaseCall, StateMachine
from sim.manipulation.timeline import CONTROLLER_PHASE, Measured
from sim.recorder import Recorder
from sim.recording import Samples
from sim.report import FingerComparison, TrialReport
from sim.scene.carrier import Timeline, carrier_of
from sim.simulation import Simulation
from sim.trial import Trial, TrialKeywords, TrialOptions, felt_by, run_grasp_phase, why_not_lifted
from sim.verdict import (
    Fault,
    Reason,
    Thresholds,
    Verdict,
    ended_early,
    fault_at,
    first_collision,
    first_fault,
    no_contact,
    other_grasp,
    tipped,
)

__all__ = [
    "HANDOVER_PHASES",
    "HandoverController",
    "HandoverTimeline",
    "HandoverTrial",
    "hand_over",
]

HANDOVER_PHASES: tuple[Phase, ...] = (
    *PHASES[:-1],
    "reach",
    "take",
    "transfer",
    "open",
    "retreat",
    "hold",
)
"""Phases of a handover in order."""

GIVING = PHASES[:-1]
"""Phases before the other hand moves."""


@dataclass(frozen=True, kw_only=True)
class HandoverTimeline(Timeline):
    """How long each phase takes, in s; the height of the lift is the plan's.

    Attributes:
        reach: The taking hand's way in.
        take: Its fingers from pre-grasp to grasp; ``close_wait`` is the longest further wait.
        transfer: From the forces of one hand to those of the other.
        open: The giving hand's fingers back to their pre-grasp.
        retreat: Its way back.
    """

    reach: float = 1.5
    take: float = 0.5
    transfer: float = 0.8
    open: float = 0.5
    retreat: float = 1.0

    @property
    def duration(self) -> float:
        """Nominal duration without waiting, s."""
        return float(sum(getattr(self, phase) for phase in HANDOVER_PHASES))


class HandoverController:
    """Drives both hands, each by the controller of its own grasp: a ``Controller``."""

    def __init__(self, give: GraspPlan, handover: Handover) -> None:
        """Prepare both.

        Args:
            give: Grasp of the giving hand, while the other one waits.
            handover: How the other one takes the object.
        """
        self._handover, hand = handover, give.task.hand
        self.give, self.take = GraspController(give), GraspController(handover.take)
        n = len(give.task.finger_names)
        self.giving, self.taking = slice(0, n), slice(n, None)
        (taker,) = (side for side in hand.pair if side.name == handover.taker)
        joints = [
            *taker.carriage,
            *(hand.joint_index(taker.called(j)) for j in taker.alone.joint_names),
        ]
        self._names = np.array(hand.actuation.names)
        self._of_taker = hand.actuation.moment[:, joints].any(axis=1)
        self._left = give.q.copy()  # where the giving hand let go

    def step(self, observation: Observation) -> FloatArray:
        """Commands (nu,) for the actuators of both hands."""
        giving, taking = (_seen(observation, rows) for rows in (self.giving, self.taking))
        return np.where(self._of_taker, self._taken(taking), self._given(giving))

    def _given(self, seen: Observation) -> FloatArray:
        """Commands (nu,) by the giving hand's grasp."""
        phase, s = seen.phase, float(minimum_jerk(np.asarray(seen.progress)))
        if phase in GIVING:
            return self.give.step(seen)
        if phase in ("reach", "take", "transfer"):
            self.give.share = 1.0 - s if phase == "transfer" else 1.0
            self._left = self.give.q_ref
            return self.give.step(seen.altered(phase="hold"))
        way = np.vstack([self._left, self._handover.way_out])
        k = {"open": s, "retreat": 1.0 + s}.get(phase, 2.0)
        self.give.q_ref = _along(way, k)
        return self.give.step(seen.altered(phase="approach"))

    def _taken(self, seen: Observation) -> FloatArray:
        """Commands (nu,) by the taking hand's grasp."""
        phase, s = seen.phase, float(minimum_jerk(np.asarray(seen.progress)))
        names: dict[Phase, Phase] = {"take": "close", "transfer": "squeeze"}
        if phase in (*GIVING, "reach"):
            way = self._handover.way_in
            self.take.q_ref = _along(way, s * (len(way) - 1) if phase == "reach" else 0.0)
            return self.take.step(seen.altered(phase="approach"))
        return self.take.step(seen.altered(phase=names.get(phase, "hold")))

    def closing(self, phase: Phase) -> bool:
        """Whether the hand that closes in a phase is not yet done."""
        hand = self.give if phase == "close" else self.take
        return hand.closing

    def saturated_actuators(self) -> tuple[str, ...]:
        """Names of the actuators that could not give what the last step wanted."""
        mine = set(self._names[self._of_taker].tolist())
        given = [n for n in self.give.saturated_actuators() if n not in mine]
        return (*given, *(n for n in self.take.saturated_actuators() if n in mine))


def _seen(observation: Observation, rows: slice) -> Observation:
    """What is seen of some of the fingers."""
    return observation.altered(
        normal_forces=observation.normal_forces[rows],
        read_pads=lambda: observation.pads.of(rows),
    )


def _along(way: FloatArray, at: float) -> FloatArray:
    """Joints (nq,) on a way (m, nq), a number of its m - 1 straight parts from its begin."""
    k = min(int(at), len(way) - 2)
    return np.asarray(way[k] + (at - k) * (way[k + 1] - way[k]))


class _InTheBase(Recorder):
    """Takes the object's movement in the pair's base, since one palm gives it to another.

    The carriages stand still while they hold, so that it is the movement in the hands.
    """

    def _held_at(self) -> SE3:
        return self._simulation.T_world_base.inverse() * self._simulation.T_world_object


class _InTheAir:
    """The gantry of a handover, which stands still once it has lifted: a ``Carrier``."""

    def __init__(self, simulation: Simulation, timeline: Timeline) -> None:
        self._carrier = carrier_of(simulation.plan, simulation.scene, timeline)

    def drive(self, data: Any, phase: Phase, share: float) -> None:
        """Set the gantry's commands."""
        self._carrier.drive(data, phase if phase in PHASES else "hold", share)


class HandoverTrial(Trial):
    """One execution of a handover.

    Attributes:
        movement: What is executed; ``plan`` is its grasp of both hands where the object stands.
        handover: How the other hand takes the object.
    """

    def __init__(
        self,
        movement: ManipulationPlan,
        options: TrialOptions | None = None,
        **changes: Unpack[TrialKeywords],
    ) -> None:
        """Build the scene and put hands and object at their start.

        Raises:
            TaskError: The movement is no handover, or a controller or a timeline is given that is
                none of one; and as ``Trial``.
        """
        asked = replace(options or TrialOptions(), **changes)
        if not isinstance(movement, ManipulationPlan) or movement.handover is None:
            raise TaskError(f"{shown(movement)} is no handover; give what plan_handover returns")
        if asked.truth is not None:
            raise TaskError("a handover is of an object that is known; leave truth out")
        if asked.controller is not None:
            raise TaskError("a handover has its own controller, which drives both hands; give none")
        timeline = asked.timeline or HandoverTimeline()
        if not isinstance(timeline, HandoverTimeline):
            raise TaskError("a handover has more phases than a trial; give a HandoverTimeline")
        self.movement, self.handover = movement, movement.handover
        timeline = replace(timeline, lift_height=self.handover.lift_height)
        self._controller = HandoverController(movement.grasp, self.handover)
        super().__init__(
            executed(movement), replace(asked, timeline=timeline, controller=self._controller)
        )
        self.simulation.carrier = _InTheAir(self.simulation, timeline)
        self.recorder = _InTheBase(self.simulation, asked.record_every)

    def perform(self) -> None:
        """Run all phases, or up to the one after which going on makes no sense."""
        machine = StateMachine(self.movement)
        self.run_phases(machine.run(self._perform, lambda: self.simulation.time))

    def _perform(self, call: PhaseCall) -> Measured:
        """Run a phase; why it failed, "" if it did not, and its numbers."""
        phase, simulation, fingers = CONTROLLER_PHASE[call.phase], self.simulation, self._controller
        if call.phase == "stand":  # hands and object are where they begin
            return "", {}
        if phase in ("close", "take"):
            going_on = self._closed(phase, fingers.giving if phase == "close" else fingers.taking)
        elif phase in PHASES:
            going_on = run_grasp_phase(simulation, self.recorder, self.timeline, phase)
        else:
            going_on = self._run(simulation.run(phase, getattr(self.timeline, phase)))
        if not going_on:
            return simulation.why_ended or why_not_lifted(simulation), {}
        if phase == "take" and not self._felt_enough():
            return f"too few fingers of {self.handover.taker} felt the object to take it", {}
        return "", {} if phase in GIVING[:4] else self.in_hand()

    def _felt_enough(self) -> bool:
        """Whether the sensors of the taking hand feel the object: what a robot knows."""
        take = self.handover.take.task
        return len(set(felt_by(self.simulation)) & set(take.finger_names)) >= take.fingers_needed

    def _closed(self, phase: Phase, rows: slice) -> bool:
        """Run a phase until the fingers of one hand touch; whether the trial goes on."""
        simulation, timeline = self.simulation, self.timeline
        duration, wait = getattr(timeline, phase), timeline.close_wait
        latest = simulation.time + duration + wait

        def over(seen: Observation) -> bool:
            if self._controller.closing(phase):
                return False
            return bool((seen.normal_forces[rows] >= TOUCH_FORCE).all()) or seen.time > latest

        return self._run(simulation.run(phase, duration, wait=wait + RECLOSING_TIME, until=over))

    def _run(self, steps: Iterator[Observation]) -> bool:
        for _ in steps:
            if self.simulation.due(self.recorder.every):
                self.recorder.record()
        return not self.simulation.ended

    def _comparison(self) -> tuple[FingerComparison, ...]:
        """Planned against measured contacts of the taking hand, which holds at the end."""
        mine = self.handover.take.task.finger_names
        return tuple(c for c in self.recorder.comparison() if c.finger in mine)

    def _verdict(self, compared: tuple[FingerComparison, ...], interrupted: bool) -> Verdict:
        """The verdict on a handover; see ``judge_handover``."""
        samples, simulation = self.recorder.samples(), self.simulation
        early = ended_early(
            samples,
            interrupted=interrupted,
            stopped=simulation.stopped,
            diverged=simulation.diverged,
        )
        if early is not None:
            return Verdict(early)
        fault = judge_handover(samples, self.movement, self.thresholds)
        if fault is not None:
            return Verdict(fault)
        off = {c.finger: c.position_error_mm for c in compared}
        return Verdict(other_grasp=other_grasp(off, self.thresholds.contact_mm))


def judge_handover(
    samples: Samples, movement: ManipulationPlan, thresholds: Thresholds
) -> Fault | None:
    """What went wrong first; None if the object was handed over.

    Nothing may collide, the object may not move before the lift, enough fingers of each hand must
    touch it when they have closed and as long as they hold, it may not move in the hands by more
    than ``thresholds.slip_mm`` and ``slip_deg``, and the giving hand must have let go in the end.

    Args:
        samples: What was recorded; the giving hand's fingers come first.
        movement: What was executed, with a handover.
        thresholds: Where success ends.
    """
    handover = movement.handover
    assert handover is not None
    give, take = movement.grasp.task, handover.take.task
    n = len(give.finger_names)
    phase = np.array(samples.phase)
    touching = samples.contacts > 0
    giving, taking = touching[:, :n].sum(axis=1), touching[:, n:].sum(axis=1)
    holding = np.isin(phase, ("lift", "reach", "take")) & (giving < give.fingers_needed)
    holding |= np.isin(phase, ("open", "retreat", "hold")) & (taking < take.fingers_needed)
    slipped = (samples.slip_mm > thresholds.slip_mm) | (samples.slip_deg > thresholds.slip_deg)
    still = (phase == "hold") & (giving > 0)
    faults = [
        first_collision(
            samples.time, samples.collision_N, samples.collision, thresholds.collision_N
        ),
        tipped(samples, thresholds),
        no_contact(samples, give.finger_names, give.fingers_needed, columns=slice(0, n)),
        no_contact(
            samples, take.finger_names, take.fingers_needed, ("take", "transfer"), slice(n, None)
        ),
        _first(samples, holding, "dropped", "too few fingers touched the object"),
        _first(samples, slipped, "slipped", "the object moved in the hands"),
        _first(samples, still, "hand collided", f"{handover.giver} still touched the object"),
    ]
    found = [fault for fault in faults if fault is not None]
    if not found and not len(samples.during("hold")):
        if not len(samples.during("take")):
            return ended_early(samples, interrupted=True)
        detail = f"too few fingers of {handover.taker} felt the object to take it"
        return fault_at(samples, len(samples) - 1, "no contact", detail)
    return first_fault(found, samples, thresholds) if found else None


def _first(samples: Samples, bad: NDArray[np.bool_], reason: Reason, what: str) -> Fault | None:
    """A fault at the first bad sample; None if there is none."""
    where = np.flatnonzero(bad)
    if len(where) == 0:
        return None
    i = int(where[0])
    return fault_at(samples, i, reason, f"{what}, in phase {samples.phase[i]}")


def hand_over(
    plan: ManipulationPlan, options: TrialOptions | None = None, **changes: Unpack[TrialKeywords]
) -> TrialReport:
    """Execute a handover and judge it; ``HandoverTrial`` and its ``run`` make pictures and films.

    Args:
        plan: What to execute.
        options: Under which conditions; defaults if None.
        changes: Fields of ``TrialOptions`` by name; a timeline is a ``HandoverTimeline``.

    Raises:
        PlannerError: See ``HandoverTrial``.
    """
    return HandoverTrial(plan, options, **changes).run()


def executed(movement: ManipulationPlan) -> GraspPlan:
    """The grasp of all fingers at the start of a trial, with each hand's planned forces."""
    handover, give = movement.handover, movement.grasp
    assert handover is not None
    both, forces = handover.both, [give.contacts.forces, handover.take.contacts.forces]
    return replace(
        both,
        task=replace(both.task, table_height=give.task.table_height, obstacles=give.task.obstacles),
        T_world_base_start=give.T_world_base_start,
        q_pregrasp=give.q_pregrasp,
        pregrasp_distance=give.pregrasp_distance,
        contacts=replace(both.contacts, forces=np.vstack(forces)),
    )
