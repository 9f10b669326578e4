"""``TrialErrors``: the error model of one trial, between a simulation and its controller.

truth -> read -> controller -> drive -> ctrl

``change_world``: the errors of object, joints and actuators in the scene, before it is compiled.

The object is larger or smaller, heavier or lighter, off balance, more slippery or less; joints have
dry friction, and actuators give more or less than they are asked for. What the plan believes stays.

Dry friction is MuJoCo's ``frictionloss``: a torque against the motion, up to the given one. It is a
soft constraint, so a joint that sticks creeps a little under load. It is the same at rest and in
motion (no Stribeck effect).

``RealDrive``: what becomes of a controller's commands before they reach the actuators.

Commands are taken over at a rate, held in between, and act late. A drive clips them to its range.
A position servo then closes its loop on its own encoder: it brings the reading to the command, so
the joint itself comes to rest off by the encoder's error. In the simulator, where servos know the
true lengths, the command is shifted by that error through the transmission:

    ctrl = clip(command) - k R (reading - q),   k = -bias1 / gain,

and backlash is a dead band of the servo about its joint, of a motor side without inertia that moves
to where it is wanted as far as the band lets it:

    ctrl = c0 + dead_band(ctrl - c0, k b / 2),   c0 = where the servo gives no force at q.

The encoder sits on the motor's side: it reads how far that has gone ahead of the joint too. Between
the stops the servo's damping still acts on the joint, and within a time step its spring.

Here F = gain ctrl + bias0 + bias1 length (``planner.joints.actuation``). k is 1 for a position
servo and 0 for a motor, which gives its torque whatever the encoder says. Scale errors act
explicitly, once a time step. Encoder noise is left out of the servo: it closes its loop many times
per time step.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import mujoco
import numpy as np

from planner.joints.actuation import Actuation
from planner.plan import GraspPlan
from planner.spatial import FloatArray
from planner.task import GraspTask
from sim.controllers import Observation
from sim.scene.build import HAND_PREFIX, OBJECT, Scene
from sim.sensing.errors.model import Drawn, ErrorModel, drawn_numbers, drawn_text, hand_actuators
from sim.sensing.errors.senses import RealSenses, encoder_error
from sim.sensing.touch import TaxelSense, TouchContext, TouchSense, make_sense
from sim.sensing.touch.layout import Delayed


class TrialErrors:
    """Errors as drawn, with what applies them.

    Attributes:
        error_model: How large errors are.
        drawn: What was drawn of them.
        task: What there is without errors.
    """

    def __init__(
        self, error_model: ErrorModel, task: GraspTask, drawn: Drawn | None = None
    ) -> None:
        """Draw the errors of a trial.

        Args:
            error_model: How large they are.
            task: What there is without them.
            drawn: What stays the same, if it is not to be drawn: that of a report, say.

        Raises:
            TaskError: Links or palm touch, of which nobody has sensors.
        """
        task.require_fingertips("a trial with sensor errors")
        self.error_model, self.task = error_model, task
        self.drawn = drawn or Drawn.of(error_model, task.hand)
        self._senses = RealSenses(error_model, self.drawn, task)
        self._drive = RealDrive(error_model, self.drawn, task.hand.actuation)
        self._touch: TouchSense | None = None
        self._last: Observation | None = None

    @property
    def change(self) -> Callable[[Any], None]:
        """Changes a scene's specification to what there really is; for ``build_scene``."""
        return change_world(self.error_model, self.drawn, self.task)

    def attach_touch(self, scene: Scene, data: Any, plan: GraspPlan) -> None:
        """Feel touch in a scene from now on.

        Args:
            scene: The scene.
            data: ``mujoco.MjData``, as it is at every step.
            plan: What is executed.
        """
        context = TouchContext(
            scene=scene,
            data=data,
            plan=plan,
            seed=self.error_model.seed,
            dry_friction=self.error_model.dry_friction,
        )
        self._touch = make_sense(self.error_model.touch, context)

    def place(self, scene: Scene, data: Any) -> None:
        """Let the object, larger or smaller than believed, stand on what carries it."""
        up = lifted_by(self.drawn, self.task)
        if up:
            data.qpos[scene.object_qpos[2]] += up
            mujoco.mj_forward(scene.model, data)

    def read(self, truth: Observation) -> Observation:
        """What sensors say of the truth; asked again at the same time they say the same."""
        last = self._last
        if last is None or last.time != truth.time:
            felt = truth if self._touch is None else self._touch.read(truth)
            self._last = last = self._senses.read(felt, self._drive.ahead)
        if (last.phase, last.progress) == (truth.phase, truth.progress):
            return last
        return replace(last, phase=truth.phase, progress=truth.progress)

    @property
    def touch(self) -> TouchSense | None:
        """The sense of touch; None before the trial has its scene."""
        return self._touch

    def drive(self, time: float, commands: FloatArray, q: FloatArray) -> FloatArray:
        """What the actuators do at a time (s) for commands (nu,), at true joints q (nq,)."""
        return self._drive.drive(time, commands, q)

    @property
    def numbers(self) -> dict[str, float]:
        """What was drawn as few numbers; see ``sim.sensing.errors.drawn_numbers``."""
        return drawn_numbers(self.drawn, self.task.hand)

    def to_dict(self) -> dict[str, Any]:
        """The error model's fields, what was drawn, and what taxels felt ("felt"), as plain data.

        "drawn_in_words" is a line for people, "" if nothing was drawn that lasts.
        """
        data = {
            **self.error_model.to_dict(),
            "drawn": self.drawn.to_dict(),
            "drawn_in_words": drawn_text([self.numbers]),
        }
        if isinstance(self._touch, TaxelSense):
            data["felt"] = self._touch.felt()
        return data


SIDES, TILT, WITHIN = 32, 0.01, 0.9
"""Directions (-) in which what an object stands on is measured, the tilt (rad) at which its extent
is read off the support function, and the share (-) of it that the centre of mass stays within."""


def change_world(error_model: ErrorModel, drawn: Drawn, task: GraspTask) -> Callable[[Any], None]:
    """What changes the ``mujoco.MjSpec`` of a task's scene to what there really is.

    Args:
        error_model: Its errors.
        drawn: What was drawn of them.
        task: As it is believed.
    """

    def change(spec: Any) -> None:
        _change_object(spec, drawn, task)
        _change_hand(spec, error_model.dry_friction, drawn, task)

    return change


def lifted_by(drawn: Drawn, task: GraspTask) -> float:
    """How much higher (m) the object's frame stands for its true size; 0 if nothing carries it."""
    if task.table_height is None:
        return 0.0
    down = -task.T_world_object.rotation[2]
    return (drawn.size - 1.0) * task.object.shape.support(down)


def center_offset(drawn: Drawn, task: GraspTask) -> FloatArray:
    """How far (3,), m, object's axes, the true centre of mass is from the believed one.

    An object on a table is known to stand there at rest. So its centre of mass stays above what it
    stands on: sideways that of a box may be off, that of a ball is not, or it would roll away.
    """
    shape = task.object.shape
    offset = np.asarray(drawn.center * drawn.size * shape.half_extents)
    if task.table_height is None or not offset.any():
        return offset
    R = task.T_world_object.rotation
    there = R @ offset
    down, most = np.array([0.0, 0.0, -1.0]), 1.0
    for angle in np.linspace(0.0, 2.0 * np.pi, SIDES, endpoint=False):
        side = np.array([np.cos(angle), np.sin(angle), 0.0])
        tilted = np.cos(TILT) * down + np.sin(TILT) * side
        beyond = shape.support(R.T @ tilted) - np.cos(TILT) * shape.support(R.T @ down)
        extent = drawn.size * beyond / np.sin(TILT)
        aside = float(there @ side)
        if aside > WITHIN * extent:
            most = min(most, WITHIN * extent / aside)
    there[:2] *= most
    return np.asarray(R.T @ there)


def _change_object(spec: Any, drawn: Drawn, task: GraspTask) -> None:
    body = spec.body(OBJECT)
    for geom in body.geoms:
        geom.friction = drawn.friction * np.array(geom.friction)
        geom.pos = drawn.size * np.array(geom.pos)
        if geom.type == mujoco.mjtGeom.mjGEOM_MESH:
            mesh = spec.mesh(geom.meshname)
            mesh.uservert = drawn.size * np.array(mesh.uservert)
        else:
            geom.size = drawn.size * np.array(geom.size)
    body.mass *= drawn.mass
    body.fullinertia = drawn.mass * drawn.size**2 * np.array(body.fullinertia)
    body.ipos = np.array(body.ipos) + center_offset(drawn, task)


def _change_hand(spec: Any, dry_friction: float, drawn: Drawn, task: GraspTask) -> None:
    hand = task.hand
    of_arm = set(hand.arm_index.tolist())
    for k, name in enumerate(hand.joint_names):
        if k not in of_arm:
            spec.joint(HAND_PREFIX + name).frictionloss += dry_friction
    for k in np.flatnonzero(hand_actuators(hand)).tolist():
        actuator = spec.actuator(HAND_PREFIX + hand.actuation.names[k])
        actuator.ctrllimited = int(mujoco.mjtLimited.mjLIMITED_FALSE)  # the drive clips
        factor = 1.0 + float(drawn.torque_constant[k])
        actuator.gainprm = factor * np.array(actuator.gainprm)
        actuator.biasprm = factor * np.array(actuator.biasprm)
        actuator.forcerange = factor * np.array(actuator.forcerange)


class RealDrive:
    """Commands to ctrl; call ``drive`` once a time step."""

    def __init__(self, error_model: ErrorModel, drawn: Drawn, actuation: Actuation) -> None:
        """Nothing has been commanded yet."""
        self._error_model, self._drawn = error_model, drawn
        self._low, self._high = actuation.ctrl_range.T
        servo = -actuation.bias[:, 1] / actuation.gain
        self._shift = servo[:, None] * actuation.moment
        self._actuation, self._servo = actuation, servo
        widest = np.abs(actuation.moment).max(axis=1, initial=0.0)
        self._half_band = 0.5 * error_model.backlash * widest * (servo > 0)
        self._ahead: FloatArray = np.zeros(actuation.moment.shape[1])
        self._to_joints = np.linalg.pinv(actuation.moment * (servo > 0)[:, None])
        self._commands: Delayed[FloatArray] = Delayed(
            error_model.command_rate, error_model.command_delay
        )

    def drive(self, time: float, commands: FloatArray, q: FloatArray) -> FloatArray:
        """What the actuators do at a time (s): ctrl (nu,).

        Args:
            time: s.
            commands: The controller's (nu,), of now.
            q: True joints (nq,).
        """
        if self._commands.due(time):
            self._commands.add(time, commands.copy())
        acting = np.clip(self._commands.newest(time)[1], self._low, self._high)
        acting -= self._shift @ encoder_error(self._drawn, q)
        return acting if not self._half_band.any() else self._in_gear(acting, q)

    @property
    def ahead(self) -> FloatArray:
        """How far (nq,) the motors' sides have gone ahead of the joints, rad or m."""
        return self._ahead

    def _in_gear(self, acting: FloatArray, q: FloatArray) -> FloatArray:
        """What is left of the commands (nu,) beyond the lost motion at joints (nq,)."""
        a = self._actuation
        length = a.moment @ q + a.length0
        idle = -(a.bias[:, 0] + a.bias[:, 1] * length) / a.gain
        pull = acting - idle
        band = self._servo * self._half_band
        lost = np.clip(pull, -band, band)
        self._ahead = self._to_joints @ (lost / np.where(self._servo > 0, self._servo, 1.0))
        return np.asarray(idle + pull - lost)
