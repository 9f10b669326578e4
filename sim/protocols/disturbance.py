"""``DisturbanceTrial``: an object held in the air, to which a protocol then does what it likes.

Table and obstacles are left out. It begins at the grasp with open fingers, a constraint holds the
object until the fingers press, and then nothing but the hand does::

    trial = DisturbanceTrial(plan, controller="impedance")
    fault = trial.close_and_squeeze() or trial.hold_for(2.0)

Movement is the object's in the palm, since the fingers press.

``Settings``: the numbers of the protocols that are ours, each with its reason.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from planner.arrays import check_fields, checked_number, finite_array
from planner.errors import TaskError
from planner.plan import GraspPlan
from planner.spatial import SE3, FloatArray
from sim.controllers import AnyController, Phase
from sim.controllers.monitors import SLIP_SPEED
from sim.protocols.outcome import Case, Conditions, Outcome
from sim.recorder import Recorder
from sim.recording import Recording, Samples
from sim.scene.build import Scene
from sim.scene.carrier import Carrier, Timeline, planned_base
from sim.scene.physics import PhysicsOptions
from sim.sensing.errors import AnyErrorModel, ErrorModel
from sim.sensing.estimation import AnyEstimator
from sim.simulation import Simulation
from sim.trial import felt_by, run_grasp_phase
from sim.verdict import Fault, LossCriteria, Reason, lost, put_down_to_actuators

GRIP = Timeline.quick(approach=0.1, close_wait=0.5, lift=0.4)
"""Durations; there is no approach, and "lift" is the time to come to rest when the object is let
go."""

CHECK_EVERY = 0.01
"""Time between looks at whether the object is lost, s."""

RECORD_EVERY = 0.1
"""Time between samples, s."""

BLAME_WINDOW = 0.2
"""Time (s) before a failure in which half of the looks at a saturated actuator make it the reason.
"""

REST_SPEED = SLIP_SPEED
"""Speed (m/s), of the centre of mass or by the turn on the bounding sphere, below which an object
is at rest: the speed from which on a contact is said to slip."""

DROPPED = LossCriteria(fewest=1, mm=10.0, deg=15.0)
"""The turn is that of DexGraspBench, the distance a fifth of its 50 mm: a servo yields by some
millimetres before anything slips. The palm counts as a finger."""


class DisturbanceTrial:
    """A grasp in the air.

    Attributes:
        plan: What is executed: the plan, without table and obstacles.
        simulation: Scene, data, controller and carrier.
        load: Size of the disturbance at present, written down with every sample.
    """

    def __init__(
        self,
        plan: GraspPlan,
        *,
        controller: AnyController | None = None,
        physics: PhysicsOptions | None = None,
        dropped: LossCriteria | None = DROPPED,
        timeline: Timeline = GRIP,
        scene: Scene | None = None,
        carrier: Carrier | None = None,
        error_model: AnyErrorModel | None = None,
        estimator: AnyEstimator | None = None,
    ) -> None:
        """Put the hand, fingers open, where it grasps.

        Args:
            plan: What to execute.
            controller: What drives the hand; see ``Simulation``.
            physics: How MuJoCo computes; defaults if None.
            dropped: When the object counts as lost; None for someone else's rule.
            timeline: Durations up to the hold.
            scene: Another scene than that of the plan's task in the air.
            carrier: What carries the hand in it.
            error_model: Errors of sensors, drives and object that the plan does not know; none if
                None.
            estimator: What tells the controller where the object is; see ``Simulation``.

        Raises:
            ModelError: MuJoCo refuses the scene.
            NotFoundError: No controller has that name.
            TaskError: The controller is none.
        """
        self.plan = replace(plan, task=replace(plan.task, table_height=None, obstacles=()))
        self.simulation = Simulation(
            self.plan,
            physics=physics,
            controller=controller,
            timeline=timeline,
            scene=scene,
            carrier=carrier,
            q=plan.q_pregrasp,
            T_world_base=plan.T_world_base,
            error_model=error_model,
            estimator=estimator,
        )
        self.simulation.carrier = _Still(self.simulation.carrier)
        self._recorder = Recorder(self.simulation, RECORD_EVERY)
        self._timeline = timeline
        self._dropped = dropped
        self._looks: deque[tuple[str, ...]] = deque(maxlen=round(BLAME_WINDOW / CHECK_EVERY))
        self._loads: list[float] = []
        self.load = 0.0

    @classmethod
    def under(
        cls,
        conditions: Conditions,
        plan: GraspPlan,
        settings: Settings,
        error_model: ErrorModel | None = None,
    ) -> DisturbanceTrial:
        """A trial of a plan under the conditions of a run.

        Args:
            conditions: Of the run.
            plan: What to execute, and what the controller is made from.
            settings: Say when the object is lost.
            error_model: Errors of this trial; those of all trials if None.
        """
        return cls(
            plan,
            controller=conditions.controller(plan),
            physics=conditions.physics,
            error_model=conditions.error_model if error_model is None else error_model,
            estimator=conditions.estimator,
            dropped=settings.dropped,
        )

    def outcome(self, case: Case, fault: Fault | None, **more: Any) -> Outcome:
        """What became of a case.

        Args:
            case: It.
            fault: Why the object was not held; None if it was.
            more: Fields of ``Outcome`` beside those that were recorded.
        """
        return Outcome(
            index=case.index,
            name=case.name,
            held=fault is None,
            fault=fault,
            fingers=self.plan.task.finger_names,
            samples=self.samples,
            recording=self.recording,
            load=self.loads,
            events=self.simulation.events,
            **more,
        )

    def close_and_squeeze(self) -> Fault | None:
        """Close, press, and let go of the object; what went wrong, None if nothing did."""
        if not self.plan.forces.found:
            return self.fault("infeasible forces", self.plan.forces.reason)
        if fault := self.run_phases("close", "squeeze", "settle", "lift"):
            return fault
        self.begin_hold()
        return None

    def run_phases(self, *phases: Phase) -> Fault | None:
        """Run phases of grasping; what went wrong, None if nothing did."""
        task, simulation = self.plan.task, self.simulation
        for phase in phases:
            if run_grasp_phase(simulation, self._recorder, self._timeline, phase):
                continue
            if simulation.ended:
                return self._ending()
            felt = felt_by(simulation)
            missing = [finger for finger in task.finger_names if finger not in felt]
            detail = f"after the squeeze {', '.join(missing)} did not touch"
            return self.fault("no contact", f"{detail}; {task.fingers_needed} are needed")
        return None

    def begin_hold(self) -> None:
        """From now on it is a hold, and the object's movement in the palm counts."""
        self._recorder.mark_reference()
        self.simulation.phase = "hold"
        self.record()

    def hold_for(
        self, duration: float, *, each_step: Callable[[float], None] | None = None
    ) -> Fault | None:
        """Hold on, and look whether the object is lost.

        Args:
            duration: s.
            each_step: Called before every time step with the time since this call began, s.

        Returns:
            What went wrong; None if the object is still held.
        """
        simulation = self.simulation
        for _ in simulation.run("hold", duration, before=each_step):
            if simulation.due(RECORD_EVERY):
                self.record()
            if not simulation.diverged and simulation.due(CHECK_EVERY):
                self._looks.append(simulation.saturated_actuators())
                if fault := self._look():
                    self.record()
                    return fault
        return self._ending() if simulation.ended else None

    def push(self, wrench: FloatArray) -> None:
        """Disturb the object from now on by a wrench (6,), N and N m, about its centre of mass."""
        simulation = self.simulation
        simulation.data.xfrc_applied[simulation.scene.object_body] = wrench

    def record(self) -> None:
        """Take a sample."""
        self._recorder.record()
        self._loads.append(self.load)

    def at_rest(self) -> bool:
        """Whether the object hardly moves, in a hand that stands still."""
        linear, angular = np.split(self.simulation.object_twist(), 2)
        length = self.plan.task.object.shape.bounding_radius
        fastest = max(np.linalg.norm(linear), length * np.linalg.norm(angular))
        return bool(fastest < REST_SPEED)

    @property
    def samples(self) -> Samples:
        """What was recorded so far."""
        return self._recorder.samples()

    @property
    def recording(self) -> Recording:
        """The states at the same times."""
        return self._recorder.recording()

    @property
    def loads(self) -> FloatArray:
        """The load at each sample, (m,); none while the fingers close."""
        loads = np.zeros(len(self.samples))
        if self._loads:
            loads[-len(self._loads) :] = self._loads
        return loads

    def put_down(self, reason: Reason, detail: str) -> Fault:
        """A fault of this moment, put down to actuators that had no more to give."""
        return put_down_to_actuators(self.fault(reason, detail), self._looks)

    def fault(self, reason: Reason, detail: str) -> Fault:
        """A fault of this moment."""
        return Fault(reason=reason, detail=detail, time=self.simulation.time)

    def _ending(self) -> Fault:
        """Why the simulation ended."""
        if self.simulation.diverged:
            return self.fault("diverged", self.simulation.diverged)
        return self.fault("stopped", f"stopped by the caller: {self.simulation.stopped}")

    def _look(self) -> Fault | None:
        """Whether the object is lost now."""
        if self._dropped is None:
            return None
        touching, moved = self.simulation.touching(), self._recorder.slip()
        where = (
            f"the object had moved {moved[0]:.1f} mm and turned {moved[1]:.1f} degrees in the hand"
        )
        reason = lost(self._dropped, touching=touching, moved=moved)
        if reason == "dropped":
            return self.put_down(reason, f"nothing touched it any more; {where}")
        return self.put_down(reason, f"{where}; {touching} fingers touched") if reason else None


class _Still:
    """Keeps the hand where the grasp is, whatever carries it."""

    def __init__(self, carrier: Carrier) -> None:
        """Wrap what would lift it."""
        self._carrier = carrier

    def drive(self, data: Any, phase: Phase, share: float) -> None:
        """Command the pose of the grasp."""
        del phase, share
        self._carrier.drive(data, "settle", 0.0)

    def planned_base(self, phase: Phase, share: float) -> SE3 | None:
        """The pose of the grasp, of a carrier that says it."""
        del phase, share
        return planned_base(self._carrier, "settle", 0.0)


@dataclass(frozen=True, kw_only=True)
class Settings:
    """Numbers of the protocols but ``dexgraspbench``, which has its own.

    Attributes:
        hold_s: How long each direction of gravity is held, s: as long as DexGraspBench's push.
        growth: Factor from one load to the next (-): the resolution of a breaking magnitude.
        step_s: How long each load lasts, s, the first half of which leads up to it: a servo comes
            to rest in 0.1 s.
        first_load: Of the object's weight under 9.81 m/s2, the first load (-).
        most_load: The same, the last one (-): nothing that fingers hold bears more.
        random: Random directions of wrench.
        shake_mm: Amplitude of shaking along an axis, mm; with 5 Hz it is 1 g.
        shake_deg: Amplitude about an axis, degrees; 0.9 g at 0.1 m from the hand's base.
        shake_hz: Frequency, 1/s.
        shake_s: Duration, s.
        mass_factors: Of the object's mass (-).
        friction_factors: Of the friction in simulation (-).
        pose_errors: How far the object is from where the plan has it, pairs of mm and degrees, in a
            random direction each.
        error_draws: Draws of the protocol ``errors``.
        pushes: Holds of the protocol ``pushes``.
        pushes_s: Duration of each, s.
        push_load: Of the object's weight under 9.81 m/s2, the strongest push (-).
        dropped: When an object counts as lost.
    """

    hold_s: float = 2.0
    growth: float = 1.1
    step_s: float = 0.15
    first_load: float = 0.5
    most_load: float = 200.0
    random: int = 20
    shake_mm: float = 10.0
    shake_deg: float = 5.0
    shake_hz: float = 5.0
    shake_s: float = 2.0
    mass_factors: tuple[float, ...] = (0.5, 1.0, 2.0)
    friction_factors: tuple[float, ...] = (0.7, 1.0, 1.3)
    pose_errors: tuple[tuple[float, float], ...] = ((0.0, 0.0), (2.5, 2.5), (5.0, 5.0))
    error_draws: int = 10
    pushes: int = 3
    pushes_s: float = 60.0
    push_load: float = 1.5
    dropped: LossCriteria = DROPPED

    def __post_init__(self) -> None:
        """Check every number."""
        numbers = [f.name for f in fields(self) if str(f.type).startswith(("float", "tuple[float"))]
        check_fields(self, numbers, above=0.0)
        check_fields(self, ("growth",), above=1.0)
        check_fields(self, ("random",))
        check_fields(self, ("error_draws", "pushes"), least=1)
        if not self.mass_factors or not self.friction_factors:
            raise TaskError("there are no factors of mass or friction; give at least one of each")
        for errors in self.pose_errors:
            for size in finite_array("pose_errors", errors, (2,), error=TaskError).tolist():
                checked_number("pose_errors", size, least=0.0, unit="mm, deg", error=TaskError)
