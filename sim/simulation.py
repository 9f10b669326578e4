"""``Simulation``: a plan's scene, hand, controller and carrier, run one phase after the other.

A script composes it and keeps what is the script's own, durations, samples and verdict::

    simulation = Simulation(plan, controller="impedance")
    for phase in PHASES:
        for observation in simulation.run(phase, 0.5):
            if simulation.due(0.02):
                print(simulation.time, observation.normal_forces)

Whoever looks on may end it: ``simulation.stop("seen enough")``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np

from planner.errors import TaskError
from planner.plan import GraspPlan
from planner.spatial import SE3, FloatArray, pose_to_wxyz
from sim.contacts import hand_contacts, normal_forces
from sim.contacts.reading import read_pads
from sim.controllers import (
    PHASES,
    AnyController,
    Controller,
    Event,
    Observation,
    Phase,
    ReportsEvents,
    ReportsLimits,
    controller_for,
)
from sim.scene.build import Scene, Truth, build_scene
from sim.scene.carrier import Carrier, Timeline, carrier_of, planned_base
from sim.scene.physics import AnyPhysics
from sim.sensing.errors import ERROR_MODELS, AnyErrorModel, ErrorModel
from sim.show.painter import Viewer
from sim.show.picture import FRAME_RATE, Tape, draw_tape

if TYPE_CHECKING:
    from sim.controllers.base import TouchReading
    from sim.sensing.errors import TrialErrors
    from sim.sensing.estimation import AnyEstimator, Estimator

__all__ = ["Simulation", "filmed"]

LIMIT_MARGIN = 1e-6
"""Distance (N, N m, rad) to its limit at which an actuator counts as saturated: rounding."""

_tapes: ContextVar[list[Tape] | None] = ContextVar("tapes", default=None)
"""Tapes of the simulations that are made while ``filmed``."""

_BAD_NUMBERS = {
    "positions": int(mujoco.mjtWarning.mjWARN_BADQPOS),
    "velocities": int(mujoco.mjtWarning.mjWARN_BADQVEL),
    "accelerations": int(mujoco.mjtWarning.mjWARN_BADQACC),
    "the controller's commands": int(mujoco.mjtWarning.mjWARN_BADCTRL),
}


class Simulation:
    """One plan in MuJoCo, as it is now.

    Attributes:
        plan: What is executed.
        scene: The scene with its compiled model and index maps.
        data: ``mujoco.MjData``, as it is now.
        controller: What drives the hand's actuators.
        carrier: What moves the hand as a whole; may be replaced between steps.
        error_model: What stands between truth and controller; None if nothing does.
        estimator: What tells the controller where the object is; None if it reads the sensors.
        told: The truth and what the estimator told of it, of the last time step; None without one.
        phase: The phase that it is in.
        seen: What the controller saw in the last time step; None if it was the truth.
        steps: Time steps made so far.
        stopped: Why the caller ended it, "" if not.
        on_step: Called with the simulation after every time step of a phase; may be set.
        tape: What pictures and films are drawn from; None unless ``record`` was called.
    """

    def __init__(
        self,
        plan: GraspPlan,
        *,
        physics: AnyPhysics | None = None,
        controller: AnyController | None = None,
        timeline: Timeline | None = None,
        scene: Scene | None = None,
        carrier: Carrier | None = None,
        q: FloatArray | None = None,
        T_world_base: SE3 | None = None,
        error_model: AnyErrorModel | None = None,
        estimator: AnyEstimator | None = None,
        truth: Truth | None = None,
        hinges: FloatArray | None = None,
        change: Callable[[Any], None] | None = None,
    ) -> None:
        """Build the scene and put hand and object at their start.

        Args:
            plan: What to execute.
            physics: How MuJoCo computes, or the name of a preset; defaults if None.
            controller: What drives the hand: a name, a controller, or what makes one from the
                plan; "feedforward" if None.
            timeline: Durations of the carrier's approach and lift; defaults if None.
            scene: The scene of the plan's task, if it is not to be built with ``physics``.
            carrier: What moves the hand as a whole; the scene's gantry or the arm if None.
            q: Joints (nq,) at the start, rad or m; the plan's start if None.
            T_world_base: Base pose at the start; the plan's start if None.
            error_model: Errors of sensors, drives and object that the plan does not know, or their
                name as ``--error-model`` takes it; none if None.
            estimator: What tells the controller where the object is: a name, or what makes one of
                task and sensor errors; if None, that with all senses where the pose that is read
                has errors, and none else.
            truth: Object and table that there really are, unknown to the plan; as planned if None.
            hinges: Axes (3, 3) of the gantry's hinges in its columns, world; the world's if None.
            change: Changes the ``mujoco.MjSpec`` of the scene that is built, before an error model
                does: what else stands in it.

        Raises:
            ModelError: MuJoCo refuses the scene.
            NotFoundError: No controller, estimator or error model has that name.
            TaskError: The controller is none, the error model is none, the plan has no path for an
                arm, or a ``scene`` is given together with an error model or truth that changes it.
        """
        self.plan = plan
        self.error_model: TrialErrors | None = None
        error_model = ERROR_MODELS.given(error_model)
        if truth is not None and (scene or error_model.object_size or error_model.object_center):
            raise TaskError(
                "a truth tells object and table, and so does a scene, or object_size and "
                "object_center of an error model; leave one out"
            )
        if not error_model.ideal:
            if scene is not None:
                raise TaskError(
                    "give a scene or an error model: an error model changes the scene it builds"
                )
            from sim.sensing.errors import TrialErrors

            self.error_model = TrialErrors(error_model, plan.task)
        self.estimator: Estimator | None = None
        self._estimator_name = "none"
        if estimator is not None or error_model.has_pose_errors:
            from sim.sensing.estimation import estimator_for, estimator_name

            self.estimator = estimator_for(plan.task, estimator, error_model)
            self._estimator_name = estimator_name(estimator, error_model)
        self.told: tuple[Observation, Observation] | None = None
        self.controller: Controller = controller_for(plan, controller)
        self.scene: Scene = scene or build_scene(
            plan.task,
            T_world_base=plan.T_world_base,
            q=plan.q,
            physics=physics,
            change=_one_after_the_other(change, self.error_model),
            truth=truth,
            hinges=hinges,
        )
        self.data: Any = self.scene.start(
            plan.q_start if q is None else q,
            plan.T_world_base_start if T_world_base is None else T_world_base,
        )
        if self.error_model is not None:
            self.error_model.place(self.scene, self.data)
            self.error_model.attach_touch(self.scene, self.data, plan)
        self.carrier: Carrier = carrier or carrier_of(plan, self.scene, timeline or Timeline())
        self.phase: Phase = PHASES[0]
        self._began: tuple[Phase, float] = self.phase, 0.0  # phase and share of the last step
        self.steps = 0
        self.seen: Observation | None = None
        self._told: Observation | None = None
        self.stopped = ""
        self.on_step: Callable[[Simulation], None] | None = None
        self.tape: Tape | None = None
        self._viewer: Viewer | None = None
        self._warnings = self.data.warning.number  # MuJoCo's own counters
        self._asked: object = None
        self._knows_limits: ReportsLimits | None = None
        self._ctrl: FloatArray = self.data.ctrl[self.scene.hand_ctrl].copy()
        actuation = plan.task.hand.actuation
        ranges = np.concatenate([actuation.force_range.T, actuation.ctrl_range.T])
        if self.error_model is not None:
            ranges[:2] *= 1.0 + self.error_model.drawn.torque_constant
        self._limits = ranges + LIMIT_MARGIN * np.array([[1.0], [-1.0], [1.0], [-1.0]])
        tapes = _tapes.get()
        if tapes is not None:
            tapes.append(self.record())

    # ---- running

    def run(
        self,
        phase: Phase,
        duration: float,
        *,
        wait: float = 0.0,
        until: Callable[[Observation], bool] | None = None,
        before: Callable[[float], None] | None = None,
    ) -> Iterator[Observation]:
        """Run a phase, step by step: the one loop of every script.

        It ends after ``duration``, later if ``until`` says so, and early if the simulation
        diverges or is stopped; of a simulation that has ended so, no step is made.

        Args:
            phase: What the controller is told.
            duration: Nominal duration, s: at least one time step is made.
            wait: Longest further time, s.
            until: Whether the phase may end once ``duration`` is over, asked after every step with
                what the controller saw; at once if None.
            before: Called before every step with the time since the phase began, s.

        Yields:
            After every step, the truth at its beginning; what the controller saw is ``sensed`` of
            it.
        """
        self.phase = phase
        dt = self.timestep
        steps = max(1, round(duration / dt))
        for k in range(max(steps, round((duration + wait) / dt))):
            if self.ended:
                return
            if before is not None:
                before(k * dt)
            observation = self.step(phase, min(1.0, k / steps))
            yield observation
            if self.on_step is not None:
                self.on_step(self)
            if self.tape is not None and self.due(1.0 / FRAME_RATE):
                self._keep()
            if self._viewer is not None:
                self._viewer.show(self.time)
            # not sensed anew: whoever looked on may have read the time after it by now
            if k + 1 >= steps and (until is None or until(self._told or observation)):
                return

    def due(self, period: float) -> bool:
        """Whether this step completes a period (s): when a sample is to be taken."""
        return self.steps % max(1, round(period / self.timestep)) == 0

    def step(self, phase: Phase, share: float) -> Observation:
        """Make one time step.

        Args:
            phase: What the controller is told.
            share: How much of it has passed, in [0, 1].

        Returns:
            The truth at the beginning of the step; what the controller saw is ``sensed`` of it.

        Raises:
            TaskError: The controller's commands have the wrong shape.
        """
        scene, data = self.scene, self.data
        observation = self.observe(phase, share)
        self._began = phase, share
        told = self.sensed(observation)
        self._told, self.seen = told, None if told is observation else told
        commands = self._commands(told)
        data.ctrl[scene.hand_ctrl] = self._driven(commands, observation)
        self.carrier.drive(data, phase, share)
        self._ctrl = data.ctrl[scene.hand_ctrl] if self.error_model is None else commands
        mujoco.mj_step(scene.model, data)
        self.steps += 1
        return observation

    def put_object(self, T_world_object: SE3) -> None:
        """Put the object elsewhere before the first step, where an earlier trial left it."""
        scene, data = self.scene, self.data
        data.qpos[scene.object_qpos] = np.concatenate(pose_to_wxyz(T_world_object))
        mujoco.mj_forward(scene.model, data)

    def observe(self, phase: Phase, share: float) -> Observation:
        """The truth of now, in a phase of which a share in [0, 1] has passed."""
        scene, data = self.scene, self.data
        fingers = self.plan.task.finger_names
        return Observation(
            time=self.time,
            phase=phase,
            progress=share,
            q=data.qpos[scene.hand_qpos],
            v=data.qvel[scene.hand_dof],
            T_world_base=self.T_world_base,
            T_world_object=self.T_world_object,
            normal_forces=self.normal_forces(),
            read_twist=partial(scene.object_twist, data),
            read_contacts=partial(hand_contacts, scene, data),
            read_pads=partial(read_pads, scene, data, fingers),
            read_touch=partial(_read_touch, scene, data, fingers),
            read_planned=partial(planned_base, self.carrier, *self._began),
        )

    def planned_base(self) -> SE3 | None:
        """Where the carrier should have brought the hand's base; None if it does not say.

        At the beginning of the last time step, which poses that are read are of.
        """
        return planned_base(self.carrier, *self._began)

    def sensed(self, truth: Observation) -> Observation:
        """What a controller sees of the truth: by sensors with errors, then by ``estimator``.

        Asked again at the same time, it is the same.
        """
        read = truth if self.error_model is None else self.error_model.read(truth)
        if self.estimator is None:
            return read
        last = None if self.told is None else self.told[1]
        if last is None or last.time != read.time:
            last = self.estimator.step(read)
            self.told = truth, last
        if (last.phase, last.progress) == (read.phase, read.progress):
            return last
        return replace(last, phase=read.phase, progress=read.progress)

    def _driven(self, commands: FloatArray, truth: Observation) -> FloatArray:
        """What the hand's drives make of commands (nu,): ctrl (nu,)."""
        if self.error_model is None:
            return commands
        return self.error_model.drive(truth.time, commands, truth.q)

    def _commands(self, observation: Observation) -> FloatArray:
        ctrl = np.asarray(self.controller.step(observation), dtype=np.float64)
        expected = self.scene.hand_ctrl.shape
        if ctrl.shape != expected:
            raise TaskError(
                f"the controller returned commands of shape {ctrl.shape}; the hand needs "
                f"{expected}, one per actuator in the order of hand.actuation.names"
            )
        return ctrl

    # ---- ending

    def stop(self, reason: str) -> None:
        """End it after this step; a report says that it was stopped, and why.

        Raises:
            TaskError: The reason is empty.
        """
        if not reason:
            raise TaskError('stop needs a reason for the report, such as "seen enough"')
        self.stopped = self.stopped or reason

    @property
    def diverged(self) -> str:
        """What MuJoCo warns of, "" if nothing: numbers that are not finite or huge."""
        if not any(self._warnings.tolist()):
            return ""
        for what, index in _BAD_NUMBERS.items():
            if self.data.warning[index].number:
                return f"{what} are not finite or huge at {self.time:.3f} s"
        return ""

    @property
    def ended(self) -> bool:
        """Whether it was stopped or has diverged: no further step is made."""
        return bool(self.why_ended)

    @property
    def why_ended(self) -> str:
        """Why no further step is made, "" if there may be one."""
        return self.diverged or (f"stopped: {self.stopped}" if self.stopped else "")

    def show(self) -> None:
        """Show every further step in MuJoCo's viewer, in real time.

        Raises:
            TaskError: There is no display.
        """
        self._viewer = Viewer(self.scene.model, self.data)

    def record(self) -> Tape:
        """Keep a state from time to time from now on, from which pictures and films are drawn."""
        self.tape = Tape(self.scene.model, self.scene.subject)
        self._keep()
        return self.tape

    def _keep(self) -> None:
        if self.tape is not None:
            self.tape.keep(self.time, self.data.qpos, hand_contacts(self.scene, self.data))

    def close(self) -> None:
        """Close the viewer, if it is open."""
        if self._viewer is not None:
            self._viewer.close()
            self._viewer = None

    # ---- what can be seen

    @property
    def time(self) -> float:
        """Simulated time, s."""
        return float(self.data.time)

    @property
    def timestep(self) -> float:
        """Length of a time step, s."""
        return self.scene.physics.timestep

    @property
    def q(self) -> FloatArray:
        """The hand's joints (nq,), rad or m."""
        return np.array(self.data.qpos[self.scene.hand_qpos])

    @property
    def T_world_base(self) -> SE3:
        """Pose of the hand's base."""
        return self.scene.body_pose(self.data, self.scene.base_body)

    @property
    def T_world_object(self) -> SE3:
        """Pose of the object."""
        return self.scene.body_pose(self.data, self.scene.object_body)

    @property
    def T_base_object(self) -> SE3:
        """Pose of the object in the hand's base."""
        return self.T_world_base.inverse() * self.T_world_object

    @property
    def T_palm_object(self) -> SE3:
        """Pose of the object in the palm, in which slip is measured."""
        return self.scene.T_palm_object(self.data)

    def object_twist(self) -> FloatArray:
        """Velocity (m/s) of the object's centre and angular velocity (rad/s), (6,), world."""
        return self.scene.object_twist(self.data)

    def normal_forces(self) -> FloatArray:
        """Sum of normal forces on the object per finger that takes part, (n,), N."""
        return normal_forces(self.scene, self.data, self.plan.task.finger_names)

    def touching(self) -> int:
        """How many fingers press on the object, the palm counted as one."""
        return len(set(hand_contacts(self.scene, self.data).fingers))

    def saturated_actuators(self) -> tuple[str, ...]:
        """Names of the hand's actuators that could not do what was asked in the last step."""
        low, high, ctrl_low, ctrl_high = self._limits
        force, ctrl = self.data.actuator_force[self.scene.hand_ctrl], self._ctrl
        at_limit = (force >= high) | (force <= low) | (ctrl >= ctrl_high) | (ctrl <= ctrl_low)
        names = set()
        if at_limit.any():
            all_names = self.plan.task.hand.actuation.names
            names = {all_names[i] for i in np.flatnonzero(at_limit)}
        asked: object = self.controller
        if asked is not self._asked:  # whether it keeps the protocol takes long to find out
            self._asked = asked
            self._knows_limits = asked if isinstance(asked, ReportsLimits) else None
        if self._knows_limits is not None:
            names.update(self._knows_limits.saturated_actuators())
        return tuple(sorted(names))

    def senses(self) -> dict[str, Any] | None:
        """Errors and what was drawn of them, with the estimator's name; None where all is exact."""
        if self.error_model is None and self.estimator is None:
            return None
        told = ErrorModel().to_dict() if self.error_model is None else self.error_model.to_dict()
        return told | {"estimator": self._estimator_name}

    @property
    def events(self) -> tuple[Event, ...]:
        """What controller and estimator noticed so far, in order of time."""
        events = self.controller.events if isinstance(self.controller, ReportsEvents) else ()
        if self.estimator is None or not self.estimator.events:
            return events
        return tuple(sorted((*events, *self.estimator.events), key=lambda event: event.time))


@contextmanager
def filmed(video: Path | None) -> Iterator[None]:
    """Draw a film of the first simulation that is made and run meanwhile; nothing without a file.

    Args:
        video: File of the film; see ``sim.show.picture.FORMATS``. It is missing afterwards where
            this machine cannot draw.
    """
    if video is None:
        yield
        return
    tapes: list[Tape] = []
    token = _tapes.set(tapes)
    try:
        yield
    finally:
        _tapes.reset(token)
    for tape in tapes[:1]:
        draw_tape(tape, video=video)


def _one_after_the_other(
    change: Callable[[Any], None] | None, error_model: TrialErrors | None
) -> Callable[[Any], None] | None:
    """A caller's change of the scene, then that of an error model; None where there is neither."""
    steps = [step for step in (change, None if error_model is None else error_model.change) if step]
    if len(steps) < 2:
        return steps[0] if steps else None

    def both(spec: Any) -> None:
        for step in steps:
            step(spec)

    return both


def _read_touch(scene: Scene, data: Any, fingers: Sequence[str]) -> TouchReading:
    """As ``sim.sensing.touch.read_touch``, which is loaded for those that feel."""
    from sim.sensing.touch import read_touch

    return read_touch(scene, data, fingers)
