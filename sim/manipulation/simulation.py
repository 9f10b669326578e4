"""``ManipulationSim``: a simulation with a driver, a moving base, samples and a push.

``Reading``: where the object is, how far it has turned and what touches it, as a robot knows it.

What a robot decides by is read here: whether a turn is made, where the hand must carry the object,
which fingers may be lifted. What a run is judged by is the truth (``ManipulationRecorder``).
Without an error model both are the same, to the last bit.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any, TypedDict, Unpack

import numpy as np

from planner.arrays import check_fields, checked_kind, finite_array, float_array
from planner.contacts import ContactSet
from planner.errors import TaskError
from planner.kinematics import MovingHand
from planner.motion.manipulation import ManipulationPlan
from planner.motion.path import check_place
from planner.spatial import SE3, FloatArray, signed_twist
from planner.task import GraspTask
from sim.contacts import hand_contacts
from sim.controllers import Observation
from sim.manipulation.driver import ManipulationDriver, mover_of
from sim.manipulation.in_hand import AnyTurningController, InHandController
from sim.manipulation.log import ManipulationRecorder
from sim.manipulation.timeline import (
    CONTROLLER_PHASE,
    IN_THE_AIR,
    ManipulationPhase,
    ManipulationTimeline,
    SuccessCriteria,
)
from sim.scene.physics import AnyPhysics
from sim.sensing.errors import AnyErrorModel
from sim.sensing.estimation import AnyEstimator
from sim.simulation import Simulation
from sim.verdict import LossCriteria, lost

SAMPLE_EVERY = 0.02
"""Time between samples, s: that at which closure and forces are judged."""

DROPPED = LossCriteria(fewest=1)
"""In the air an object is dropped when no finger touches it, be it on the palm."""


@dataclass(frozen=True, kw_only=True)
class Push:
    """A force on the object's centre of mass while it is turned, once.

    Attributes:
        force: (3,), N, world.
        after: When, since the beginning of the turn, s.
        duration: How long, s.
    """

    force: FloatArray
    after: float
    duration: float

    def __post_init__(self) -> None:
        """Check every number."""
        finite_array("the force of a push", self.force, (3,), error=TaskError)
        check_fields(self, ("after", "duration"), what="push: ", least=0.0, unit="s")


class ManipulationKeywords(TypedDict, total=False):
    """Fields of ``ManipulationOptions`` as keywords, for ``ManipulationRun`` and ``manipulate``."""

    controller: AnyTurningController | None
    true_task: GraspTask | None
    physics: AnyPhysics | None
    timeline: ManipulationTimeline | None
    criteria: SuccessCriteria | None
    push: Push | None
    error_model: AnyErrorModel | None
    estimator: AnyEstimator | None
    via: tuple[tuple[float, float], ...]


@dataclass(frozen=True, kw_only=True, eq=False)
class ManipulationOptions:
    """Under which conditions a plan is executed.

    Attributes:
        controller: What drives the fingers until they open: a name, a controller, or a class or
            function that makes one from ``plan.grasp``; ``ObjectImpedance`` if None. What one of
            your own sees is told in ``sim.manipulation.in_hand``.
        true_task: The task as it really is, where mass or pose differ from the plan's.
        physics: How MuJoCo computes, with the true friction; defaults if None.
        timeline: Durations.
        criteria: Where phases fail.
        push: A disturbance during the turn.
        error_model: Errors of sensors, drives and object that the plan does not know; none if None.
        estimator: What tells the controller where the object is: a name, or what makes one; see
            ``sim.simulation.Simulation``.
        via: Places, x and y in m, world, through which the hand carries the object while it turns
            it, the last at the end; it stays meanwhile if empty.
    """

    controller: AnyTurningController | None = None
    true_task: GraspTask | None = None
    physics: AnyPhysics | None = None
    timeline: ManipulationTimeline = field(default_factory=ManipulationTimeline)
    criteria: SuccessCriteria = field(default_factory=SuccessCriteria)
    push: Push | None = None
    error_model: AnyErrorModel | None = None
    estimator: AnyEstimator | None = None
    via: tuple[tuple[float, float], ...] = ()

    def __post_init__(self) -> None:
        """Check that timeline, criteria, push, true task and places are such.

        Raises:
            TaskError: One of them is something else.
        """
        if self.push is not None:
            checked_kind("push", self.push, Push)
        if self.true_task is not None:
            checked_kind("true_task", self.true_task, GraspTask)
        checked_kind("timeline", self.timeline, ManipulationTimeline)
        checked_kind("criteria", self.criteria, SuccessCriteria)
        count = len(np.atleast_1d(float_array("via", self.via, error=TaskError)))
        if count:
            places = finite_array("via", self.via, (count, 2), error=TaskError).tolist()
            for place in places:
                check_place(place)
            object.__setattr__(self, "via", tuple((x, y) for x, y in places))

    def with_changes(self, **changes: Unpack[ManipulationKeywords]) -> ManipulationOptions:
        """The same with other fields; None for timeline or criteria gives their defaults."""
        given: dict[str, Any] = dict(changes)
        for name, default in (("timeline", ManipulationTimeline), ("criteria", SuccessCriteria)):
            if name in given and given[name] is None:
                given[name] = default()
        return replace(self, **given)


class ManipulationSim:
    """Runs phases of one manipulation and records them.

    Attributes:
        simulation: Scene, data and the loop.
        driver: Drives the fingers.
        mover: Moves the base, or the arm.
        recorder: Takes samples, of the truth.
        reading: What the robot knows of the object.
    """

    def __init__(
        self,
        plan: ManipulationPlan,
        holding: InHandController,
        options: ManipulationOptions,
        simulation: Simulation | None = None,
    ) -> None:
        """Build the scene and put hand and object at their start.

        Args:
            plan: What is executed.
            holding: What holds and turns the object: the controller of the options, made.
            options: Under which conditions.
            simulation: Of another scene with the plan's hand, which is then driven; built if None.
        """
        grasp = plan.grasp
        there = options.true_task or grasp.task
        there = replace(there, obstacles=(*there.obstacles, *plan.under_target))
        self.driver = ManipulationDriver(plan, holding, rate=options.timeline.turn_rate)
        self.simulation = simulation or Simulation(
            replace(grasp, task=there),
            physics=options.physics,
            controller=self.driver,
            error_model=options.error_model,
            estimator=options.estimator or getattr(holding, "estimator", None),
            hinges=_hinges(plan.path.wrist_turn) if plan.path.turns_wrist else None,
        )
        self.mover = mover_of(grasp, self.simulation.scene)
        self.simulation.controller, self.simulation.carrier = self.driver, self.mover
        axis = self.driver.reference.axis
        self.recorder = ManipulationRecorder(self.simulation, axis)
        self.reading = Reading(self.simulation, self.recorder, axis)
        self._push = options.push
        self._turn_began: float | None = None

    def run(
        self,
        phase: ManipulationPhase,
        duration: float,
        *,
        wait: float = 0.0,
        until: Callable[[Observation], bool] | None = None,
    ) -> str:
        """Run a phase for its duration, and longer where something is waited for.

        Args:
            phase: Which phase.
            duration: s.
            wait: Longest further time, s.
            until: Whether the phase may end after ``duration``, asked after every step with what
                the controller saw; at once if None.

        Returns:
            Why it ended early, "" if it did not: diverged, stopped, or the object fell.
        """
        simulation, recorder, driver = self.simulation, self.recorder, self.driver
        if self.mover.fault:
            return self.mover.fault
        if phase == "turn" and self._turn_began is None:
            self._turn_began = simulation.time
        pushed = self._push if phase in ("turn", "regrasp") else None
        before = None if pushed is None else lambda _: self._push_object(pushed)
        fault = ""
        for observation in simulation.run(
            CONTROLLER_PHASE[phase], duration, wait=wait, until=until, before=before
        ):
            recorder.note_forces(observation.normal_forces)
            due = simulation.due(SAMPLE_EVERY)
            fault = simulation.diverged or (self._dropped(phase) if due else "")
            if fault or due:
                recorder.record(
                    phase,
                    path_parameter=driver.reference.place,
                    wanted=driver.holding.T_palm_wanted,
                    away=driver.off,
                )
                self.reading.note()
            if fault:
                break
        simulation.data.xfrc_applied[simulation.scene.object_body] = 0.0
        self.mover.stay()
        return fault or simulation.why_ended

    @property
    def touched(self) -> bool:
        """Whether anything of the hand presses on the object."""
        return self.simulation.touching() > 0

    @property
    def touching_fingers(self) -> set[str]:
        """Names of the fingers that press on the object, the palm left out."""
        return set(hand_contacts(self.simulation.scene, self.simulation.data).fingers) - {""}

    @property
    def T_world_base(self) -> SE3:
        """Pose of the hand's base; on an arm of one that moves with the palm, see ``ArmMover``."""
        return self.mover.T_world_base(self.simulation)

    def base_for(self, T_world_object: SE3) -> SE3:
        """Where the base must be for the object, as it is read now, to be at a pose."""
        now = self.reading.T_world_object()
        return T_world_object * now.inverse() * self.T_world_base

    def _push_object(self, push: Push) -> None:
        """Push while it is time to."""
        since = self.simulation.time - (self._turn_began or 0.0)
        force = push.force if 0.0 <= since - push.after < push.duration else np.zeros(3)
        self.simulation.data.xfrc_applied[self.simulation.scene.object_body, :3] = force

    def _dropped(self, phase: ManipulationPhase) -> str:
        """Why the object counts as dropped, "" if it does not."""
        if phase not in IN_THE_AIR or not lost(DROPPED, touching=len(self.touching_fingers)):
            return ""
        gave_up = self.driver.holding.gave_up
        return "the object was dropped" + (f": {gave_up}" if gave_up else "")


def _hinges(wrist_turn: FloatArray) -> FloatArray:
    """Axes (3, 3) of the gantry's hinges, the first that of the wrist's turn (3,)."""
    first = wrist_turn / np.linalg.norm(wrist_turn)
    second = np.cross(first, np.eye(3)[np.abs(first).argmin()])
    second /= np.linalg.norm(second)
    return np.column_stack([first, second, np.cross(first, second)])


class Reading:
    """What is read of one simulation, for ``ManipulationSim``."""

    def __init__(
        self, simulation: Simulation, recorder: ManipulationRecorder, axis: FloatArray
    ) -> None:
        """Begin.

        Args:
            simulation: What is read.
            recorder: Knows the truth, which is read where nothing stands between.
            axis: Axis of the turn (3,), unit, palm.
        """
        self._simulation, self._recorder, self._axis = simulation, recorder, axis
        task = simulation.plan.task
        self._fingers = task.finger_names
        self._hand = MovingHand(task.hand, simulation.plan.q)
        self._reference: SE3 | None = None
        self._turn = 0.0

    def mark_reference(self) -> None:
        """From now on movement is counted from how the object lies in the palm now."""
        self._recorder.mark_reference()
        seen = self._seen()
        self._turn, self._reference = 0.0, None if seen is None else self._in_palm(seen)

    def note(self) -> None:
        """Follow the turn, which is counted beyond half turns; call it now and then."""
        if self._reference is not None:
            self.turned()

    def turned(self) -> float:
        """Turn in the palm since the mark, rad."""
        seen = self._seen()
        if seen is None or self._reference is None:
            return self._recorder.moved()[0]
        turn = self._in_palm(seen).rotation @ self._reference.rotation.T
        self._turn = signed_twist(turn, self._axis, near=self._turn)
        return self._turn

    def deviation(self) -> float:
        """Believed standard deviation of the object's rotation about the turn's axis now, rad.

        0 where no estimator tells it.
        """
        seen = self._seen()
        if seen is None or seen.uncertainty is None:
            return 0.0
        turn = (seen.T_world_base * self._hand.move(seen.q).T_base_palm).rotation
        axis = turn @ self._axis
        return float(np.sqrt(max(0.0, axis @ seen.uncertainty.covariance[3:, 3:] @ axis)))

    def T_world_object(self) -> SE3:
        """Pose of the object."""
        seen = self._seen()
        return self._simulation.T_world_object if seen is None else seen.T_world_object

    def normal_forces(self) -> FloatArray:
        """Normal force (n,) that each finger feels, N."""
        seen = self._seen()
        return self._simulation.normal_forces() if seen is None else seen.normal_forces

    def contacts(self) -> ContactSet:
        """Contacts of the hand with the object, world, with their forces along the normals.

        Of pads that are read there is one for each finger that takes part; what else touches the
        object they do not feel.
        """
        seen = self._seen()
        if seen is None:
            return hand_contacts(self._simulation.scene, self._simulation.data)
        pads = seen.pads
        felt = np.flatnonzero(pads.normal_force > 0)
        forces = np.zeros((len(felt), 4))
        forces[:, 0] = pads.normal_force[felt]
        return ContactSet.from_arrays(
            pads.position[felt],
            pads.normal[felt],
            center=seen.T_world_object.translation,
            forces=forces,
            fingers=[self._fingers[i] for i in felt],
        )

    def _seen(self) -> Observation | None:
        """What the sensors say now; None where they say the truth."""
        simulation = self._simulation
        truth = simulation.observe(simulation.phase, 1.0)
        seen = simulation.sensed(truth)
        return None if seen is truth else seen

    def _in_palm(self, seen: Observation) -> SE3:
        """Pose of the object in the palm, by the joints that were read."""
        T_world_palm = seen.T_world_base * self._hand.move(seen.q).T_base_palm
        return T_world_palm.inverse() * seen.T_world_object
