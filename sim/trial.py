"""``simulate``: execute a plan in MuJoCo and judge what happened.

The trial moves the mount, or the arm that the hand is on, along the timeline (approach, close,
squeeze, settle, lift, hold) and asks a controller for the hand's commands at every time step::

    report = simulate(plan)
    print(report.success, report.reason, report.verdict.detail)

``Trial`` is the same in two steps, with scene and data within reach.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path

import mujoco
import numpy as np

from planner.errors import TaskError
from planner.plan import GraspPlan
from planner.quality import analyse
from planner.spatial import FloatArray
from sim.carrier import Carrier, carrier_of
from sim.contacts import NO_FORCE, hand_contacts, merge_per_finger, normal_forces
from sim.controllers import (
    PHASES,
    Controller,
    GraspController,
    Observation,
    Phase,
    ReportsEvents,
    ReportsLimits,
)
from sim.controllers.schedule import TOUCH_FORCE
from sim.creep import CREEP_BUDGET, least_creep, remedies
from sim.looking.picture import save_picture
from sim.looking.viewer import Viewer
from sim.pads import read_pads
from sim.recorder import Recorder
from sim.report import TrialReport
from sim.scene import PhysicsOptions, Scene, build_scene
from sim.timeline import Timeline
from sim.verdict import Thresholds, Verdict, judge

__all__ = ["Timeline", "Trial", "simulate"]


LONGEST_PERIOD = 0.1
"""Longest time (s) between samples: a slip that matters lasts longer."""


class Trial:
    """One execution of a plan.

    Attributes:
        plan: What is executed.
        scene: The scene with its compiled model and index maps.
        data: ``mujoco.MjData``, as it is now.
        timeline: Durations.
        controller: What drives the hand.
        carrier: What moves the hand as a whole; may be set.
        recorder: Who takes samples.
        steps: Time steps made so far.
        phase: The phase that it is in.
    """

    def __init__(
        self,
        plan: GraspPlan,
        *,
        physics: PhysicsOptions | None = None,
        controller: Controller | None = None,
        timeline: Timeline | None = None,
        thresholds: Thresholds | None = None,
        record_every: float = 0.02,
        scene: Scene | None = None,
        carrier: Carrier | None = None,
    ) -> None:
        """Build the scene and put hand and object at their start.

        Args:
            plan: What to execute.
            physics: How MuJoCo computes; defaults if None.
            controller: What drives the hand; a ``GraspController`` if None.
            timeline: Durations; defaults if None.
            thresholds: Where success ends; defaults if None.
            record_every: Time between samples, s.
            scene: The scene of the plan's task, if it is not to be built with ``physics``.
            carrier: What moves the hand as a whole; the scene's mount or the arm if None.
        """
        if not 0 < record_every <= LONGEST_PERIOD:
            raise TaskError(
                f"record_every is {record_every}; give seconds in (0, {LONGEST_PERIOD}]: the "
                "verdict sees what is recorded"
            )
        self.plan = plan
        self.timeline = timeline or Timeline()
        self.thresholds = thresholds or Thresholds()
        self.controller: Controller = controller or GraspController(plan)
        self.scene: Scene = scene or build_scene(
            plan.task, T_world_base=plan.T_world_base, q=plan.q, physics=physics
        )
        self.data = self.scene.start(plan.q_start, plan.T_world_base_start)
        self.carrier: Carrier = carrier or carrier_of(plan, self.scene, self.timeline)
        self._every = max(1, round(record_every / self.scene.physics.timestep))
        self.recorder = Recorder(plan, self.scene)
        self.steps = 0
        self.phase: Phase = PHASES[0]

    def run(
        self,
        *,
        progress: Callable[[float], None] | None = None,
        on_step: Callable[[Trial], None] | None = None,
        view: bool = False,
        picture: Path | str | None = None,
    ) -> TrialReport:
        """Run to the end, or to where it cannot go on, and judge. Ctrl-C ends it with a report.

        Args:
            progress: Called now and then with the share done, in [0, 1].
            on_step: Called after every time step.
            view: Show it in MuJoCo's viewer, in real time.
            picture: Write a picture of the end here (PNG).

        Raises:
            TaskError: ``view`` without a display, or the trial has run already.
        """
        if self.steps:
            raise TaskError("this trial has run already; make a new Trial to run again")
        begin = time.perf_counter()
        if not self.plan.forces.found:
            verdict = Verdict(
                success=False, reason="infeasible forces", detail=self.plan.forces.reason, time=0.0
            )
            return self._report(verdict, begin)
        viewer = Viewer(self.scene.model, self.data) if view else None
        interrupted = False
        try:
            for phase in PHASES:
                if not self.run_phase(phase, progress, on_step, viewer):
                    break
        except KeyboardInterrupt:
            interrupted = True
        finally:
            if viewer is not None:
                viewer.close()
        verdict = judge(
            self.recorder.samples(),
            fingers=self.plan.task.finger_names,
            needed=self.plan.task.fingers_needed,
            lift_mm=1e3 * self.timeline.lift_height,
            thresholds=self.thresholds,
            interrupted=interrupted,
            diverged=self.divergence(),
        )
        report = self._report(verdict, begin)
        if picture is None:
            return report
        made = save_picture(self.scene.model, self.data, Path(picture))
        return replace(report, picture=made.path, picture_reason=made.reason)

    def run_phase(
        self,
        phase: Phase,
        progress: Callable[[float], None] | None = None,
        on_step: Callable[[Trial], None] | None = None,
        viewer: Viewer | None = None,
    ) -> bool:
        """Run one phase.

        Args:
            phase: Which.
            progress: As for ``run``.
            on_step: As for ``run``.
            viewer: Where it is shown; nowhere if None.

        Returns:
            Whether going on makes sense: too few fingers may touch, or numbers be bad.
        """
        self.phase = phase
        dt = self.scene.physics.timestep
        steps = max(1, round(getattr(self.timeline, phase) / dt))
        longest = steps
        if phase == "close":
            longest += round(self.timeline.close_wait / dt)
        if phase == "settle":
            self.recorder.mark_reference(self.data)
        if phase == "lift":
            if not self._held_by_enough():
                self.recorder.record(self.data, "settle", self.limited_actuators())
                return False
            self.scene.release(self.data)
        for k in range(longest):
            touching = self.step(phase, min(1.0, k / steps))
            if self.sample_due:
                self.recorder.record(self.data, phase, self.limited_actuators())
                if progress is not None:
                    progress(min(1.0, self.data.time / self.timeline.duration))
            if on_step is not None:
                on_step(self)
            if viewer is not None:
                viewer.show(self.data.time)
            if self.divergence():
                return False
            if phase == "close" and k + 1 >= steps and touching:
                break
        return True

    def step(self, phase: Phase, share: float) -> bool:
        """Make one time step.

        Args:
            phase: What the controller is told.
            share: How much of it has passed, in [0, 1].

        Returns:
            Whether every finger touched at the beginning of the step.
        """
        scene, data = self.scene, self.data
        observation = self.observe(phase, share)
        data.ctrl[scene.hand_ctrl] = self._commands(observation)
        self.carrier.drive(data, phase, share)
        self._ctrl = data.ctrl[scene.hand_ctrl].copy()
        mujoco.mj_step(scene.model, data)
        self.steps += 1
        return bool((observation.normal_forces >= TOUCH_FORCE).all())

    def _commands(self, observation: Observation) -> FloatArray:
        ctrl = np.asarray(self.controller.step(observation), dtype=np.float64)
        expected = self.scene.hand_ctrl.shape
        if ctrl.shape != expected:
            raise TaskError(
                f"the controller returned commands of shape {ctrl.shape}; the hand needs "
                f"{expected}, one per actuator in the order of hand.actuation.names"
            )
        return ctrl

    def observe(self, phase: Phase, share: float) -> Observation:
        """What a controller is told now, in a phase of which a share in [0, 1] has passed."""
        scene, data = self.scene, self.data
        return Observation(
            time=float(data.time),
            phase=phase,
            progress=share,
            q=data.qpos[scene.hand_qpos],
            v=data.qvel[scene.hand_dof],
            T_world_base=scene.body_pose(data, scene.base_body),
            T_world_object=scene.body_pose(data, scene.object_body),
            read_twist=self._object_twist,
            normal_forces=normal_forces(scene, data, self.plan.task.finger_names),
            read_contacts=partial(hand_contacts, scene, data),
            read_pads=partial(read_pads, scene, data, self.plan.task.finger_names),
        )

    def _object_twist(self) -> FloatArray:
        """Linear and angular velocity (6,) of the object, world axes."""
        linear, angular = np.split(self.data.qvel[self.scene.object_dof], 2)
        rotation = self.data.xmat[self.scene.object_body].reshape(3, 3)
        return np.concatenate([linear, rotation @ angular])

    def _held_by_enough(self) -> bool:
        """Whether as many fingers touch as can hold the object."""
        forces = normal_forces(self.scene, self.data, self.plan.task.finger_names)
        return int((forces > NO_FORCE).sum()) >= self.plan.task.fingers_needed

    @property
    def sample_due(self) -> bool:
        """Whether a sample is to be taken after this step."""
        return self.steps % self._every == 0

    def limited_actuators(self) -> tuple[str, ...]:
        """Names of the hand's actuators that could not do what was asked in the last step."""
        actuation = self.plan.task.hand.actuation
        force = self.data.actuator_force[self.scene.hand_ctrl]
        low, high = actuation.force_range.T
        at_limit = (force >= high - LIMIT_MARGIN) | (force <= low + LIMIT_MARGIN)
        low, high = actuation.ctrl_range.T
        at_limit |= (self._ctrl >= high - LIMIT_MARGIN) | (self._ctrl <= low + LIMIT_MARGIN)
        names = {actuation.names[i] for i in np.flatnonzero(at_limit)}
        if isinstance(self.controller, ReportsLimits):
            names.update(self.controller.limited_actuators())
        return tuple(sorted(names))

    def divergence(self) -> str:
        """What MuJoCo warns of, "" if nothing: numbers that are not finite or huge."""
        for what, index in _BAD_NUMBERS.items():
            if self.data.warning[index].number:
                return f"{what} are not finite or huge at {self.data.time:.3f} s"
        return ""

    def _report(self, verdict: Verdict, begin: float) -> TrialReport:
        plan, task = self.plan, self.plan.task
        samples = self.recorder.samples()
        merged = merge_per_finger(hand_contacts(self.scene, self.data))
        # under the plan's own friction, so that the two can be compared
        measured = replace(
            merged.with_friction(task.mu, task.mu_torsion),
            models=(task.contact_model,) * len(merged),
        )
        length = task.object.shape.bounding_radius
        ended_holding = len(samples) > 0 and samples.phase[-1] == "hold" and len(measured) > 0
        return TrialReport(
            verdict=verdict,
            hand=task.hand.name,
            object=task.object.shape.spec,
            mass_kg=task.object.mass,
            seed=plan.record.seed,
            fingers=task.finger_names,
            samples=samples,
            comparison=self.recorder.comparison(),
            quality_planned=plan.quality,
            quality_measured=analyse(measured, length=length) if ended_holding else None,
            quality_mu=task.mu,
            contacts_measured=merged if ended_holding else None,
            thresholds=self.thresholds,
            physics=self.scene.physics.to_dict(),
            least_creep_mm_s=1e3 * least_creep(self.scene, task.finger_names),
            remedies=self._remedies(verdict),
            timeline={k: float(v) for k, v in asdict(self.timeline).items()},
            simulated_s=float(self.data.time),
            wall_s=time.perf_counter() - begin,
            supported=task.table_height is None,
            carried_by="mount" if plan.arm is None else "arm",
            object_deviation_mm=1e3 * self.scene.deviation,
            controller=type(self.controller).__name__,
            events=self.controller.events if isinstance(self.controller, ReportsEvents) else (),
        )

    def _remedies(self, verdict: Verdict) -> tuple[str, ...]:
        """What would keep friction from giving way, if that can be why the object was lost."""
        if verdict.reason not in ("slipped", "dropped"):
            return ()
        names = self.plan.task.finger_names
        changes = remedies(
            self.scene.physics, lambda p: least_creep(self.scene, names, p), CREEP_BUDGET
        )
        return tuple(change.what for change in changes)


_BAD_NUMBERS = {
    "positions": int(mujoco.mjtWarning.mjWARN_BADQPOS),
    "velocities": int(mujoco.mjtWarning.mjWARN_BADQVEL),
    "accelerations": int(mujoco.mjtWarning.mjWARN_BADQACC),
    "the controller's commands": int(mujoco.mjtWarning.mjWARN_BADCTRL),
}

LIMIT_MARGIN = 1e-6
"""How near (N, N m, rad) to its limit an actuator counts as standing at it: rounding."""


def simulate(
    plan: GraspPlan,
    *,
    physics: PhysicsOptions | None = None,
    controller: Controller | None = None,
    timeline: Timeline | None = None,
    thresholds: Thresholds | None = None,
    record_every: float = 0.02,
    progress: Callable[[float], None] | None = None,
    on_step: Callable[[Trial], None] | None = None,
    view: bool = False,
    picture: Path | str | None = None,
) -> TrialReport:
    """Execute a plan and judge it; see ``Trial`` and ``Trial.run`` for the arguments."""
    trial = Trial(
        plan,
        physics=physics,
        controller=controller,
        timeline=timeline,
        thresholds=thresholds,
        record_every=record_every,
    )
    return trial.run(progress=progress, on_step=on_step, view=view, picture=picture)
