"""Adroit (gymnasium-robotics, MIT): a Shadow-type hand on a forearm with two hinges.

``HAMMER``: a hammer lies on the table; a nail, at a drawn height, is to be 81 mm deep before 200 of
its steps of 10 ms are over. Forearm, wrist and fingers are joints of one hand whose base stands
still, so a grasp is planned with all 26. The commands of the carrier's four joints are then made
here: along a line of joint angles, by its actuators' own law, with the weight and the lag added.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from scipy.optimize import least_squares

from benchmarks.scenes_task import Served, Task, outcome
from planner.errors import TaskError
from planner.hands.hand import Hand
from planner.plan import GraspPlan
from planner.quality import force_closure
from planner.spatial import SE3, FloatArray
from planner.synthesis.options import SynthesisOptions
from planner.tools import plan_use
from sim.controllers import GraspController, Phase
from sim.foreign import ForeignRun, ForeignScene
from sim.tables import Row

REST = 12
"""Steps with the commands' middle after a reset: the hammer falls onto the table."""

START = (0.21, -0.04, 0.13, 0.0)
"""Where forearm and wrist begin in the search (rad): palm over the handle, wrist turned away from
the nail, so that it can turn towards it."""

FINGERS = ("thumb", "index", "middle", "ring", "little")
MU, GRIP = 0.8, 1.0
"""Friction (-) that is relied on, of 1 in the scene, and least force (N) of a finger: pads must be
that strong together to hold the hammer by its handle, 0.11 m from its centre of mass."""

CLEAR_TABLE = 0.008
"""Distance (m) from the table that is asked of the links: the forearm lags by some mm."""

ATTEMPTS, BEST_OF = 1200, 1
"""Attempts, of which one in 150 finds a grasp for its use, and grasps to find: the first that can
be used."""

HARDER = 4.0
"""How many times (-) the planned forces the fingers press with: the nail pushes the hammer."""

RAISED = 0.12
"""How much (rad) the forearm is higher before it comes down."""

HEAD, FACE = np.array([-0.24, 0.0, -0.04]), np.array([0.0, 0.0, -1.0])
"""Middle of the head's face (m) and its normal, in the hammer's body."""

OFF, TURNED = 10.0, 45.0
"""Largest offset (mm) and angle (degrees) of the face from the nail along its way in."""

BEFORE, IN = 0.04, 0.09
"""How far before the nail's head the face is aimed, and how deep the nail goes (m)."""

RUN_UP, BEYOND = 0.08, 0.04
"""Where a blow begins before the nail's head, and how far beyond its depth the face is led (m): the
carrier yields to the nail, and the hammer in the hand."""

GOING = {"above": 16, "down": 26, "close": 30, "squeeze": 30, "lift": 30, "blow": 12, "back": 20}
"""Steps of each part. A blow lasts 0.12 s: pushed at a tenth of a metre per second, the head turned
out of the fingers, which creep as long as the nail resists."""

LEARNS, LEARNED, STIFFER = 0.08, 0.15, 1.5
"""Share (-) of a lag that is added to the command in a step of control, at most how much (rad), and
the stiffness (-) that the commands add, over the carrier's own."""

TWICE = 2
"""Of its steps one step of control."""

DOUBT = 0.75
"""Share (-) of the friction relied on with which a grasp must lift the hammer in a copy of the
scene: 7 of the first 22 grasps found did not, the three among them that then lost it (starts of
development)."""


class _Rehearsal:
    """In place of the task: its state as it is read, stepped here, with less friction.

    Attributes:
        model, data, told, steps, period: As of ``Served``.
    """

    def __init__(self, served: Served | _Rehearsal) -> None:
        """Begin where the task is, on a copy."""
        self.model: Any = copy(served.model)
        self.data: Any = copy(served.data)
        self.told: dict[str, Any] = served.told
        self.steps: int = served.steps
        self.period: float = served.period
        self.model.geom_friction[:, 0] *= DOUBT * MU

    def step(self, action: Sequence[float]) -> None:
        """As the task's own."""
        low, high = self.model.actuator_ctrlrange.T
        self.data.ctrl[:] = (low + high) / 2 + np.asarray(action) * (high - low) / 2
        mujoco.mj_step(self.model, self.data, round(self.period / self.model.opt.timestep))
        mujoco.mj_forward(self.model, self.data)
        self.steps += 1


class _Hammering:
    """One episode."""

    def __init__(self, served: Served | _Rehearsal, hand: Hand | Path) -> None:
        """Let the hammer come to rest, and read the scene."""
        self._served, model = served, served.model
        self.scene = ForeignScene(
            model, served.data, hand, "Object", table="table", touch=("handle",)
        )
        self._low, self._high = model.actuator_ctrlrange.T
        self._wrist = wrist = self.scene.hand.wrist_index
        joints = [model.joint(self.scene.hand.joint_names[i]) for i in wrist]
        self._at = np.array([joint.qposadr[0] for joint in joints])
        self._dof = np.array([joint.dofadr[0] for joint in joints])
        self._range = np.array([joint.range for joint in joints]).T
        drives = [model.actuator(f"A_{joint.name}") for joint in joints]
        self._gain = np.array([drive.gainprm[0] for drive in drives])
        self._stiff = -np.array([drive.biasprm[1] for drive in drives])
        self._copy = mujoco.MjData(model)
        self._done = False
        while served.steps < REST:
            self._send((self._low + self._high) / 2)
        self._goal, self._rate, self._lag = self._now(), np.zeros(4), np.zeros(4)
        board = served.data.body("nail_board").xmat.reshape(3, 3)
        self._inwards = -np.array(board[:, 2])

    def row(self, seed: int) -> Row:
        """What came of it."""
        task = self.scene.task(
            T_world_base=self.scene.T_world_base,
            fingers=FINGERS,
            mu=MU,
            grip_force=GRIP,
            wrist_free=True,
            wrist_q=START,
        )
        options = SynthesisOptions(clear_table=CLEAR_TABLE)
        given: dict[str, Any] = {"max_attempts": ATTEMPTS, "best_of": BEST_OF}
        plan = plan_use(task, self._way, seed=seed, options=options, **given)
        run = self._lifted(plan)
        closed = self._closed(run)
        ended = self._driven(run) if run.touching() > 1 else "not grasped"
        about: dict[str, Any] = {"done": self._done, "depth_mm": 1e3 * self._depth}
        row = outcome(run, ended=ended, steps=self._served.steps, **about)
        return {**row, "closed": closed}

    def _lifted(self, plan: GraspPlan) -> ForeignRun:
        """Grasp the hammer and lift it to where the first blow begins."""
        fingers, period = GraspController(plan), TWICE * self._served.period
        run = ForeignRun(plan, self.scene, self._step, period=period, controller=fingers)
        q = plan.q[self._wrist]
        raised = q - [RAISED, 0.0, 0.0, 0.0]
        self._go(run, raised, "above", "approach")
        self._go(run, q, "down", "approach")
        self._go(run, q, "close", "close")
        self._go(run, q, "squeeze", "squeeze")
        run.held, fingers.share = run.T_palm_object, HARDER
        self._go(run, self._reach(run.T_palm_object, -RUN_UP, q), "lift", "hold")
        return run

    @staticmethod
    def _closed(run: ForeignRun) -> bool:
        """Whether the contacts measured now close."""
        return run.touching() > 1 and force_closure(run.contacts).closed

    def _driven(self, run: ForeignRun) -> str:
        """Strike the nail until it is in; where it ended."""
        while not self._over:
            left = IN + BEYOND - max(self._depth, 0.0)
            self._go(run, self._reach(run.T_palm_object, left, self._now()), "blow", "hold")
            if run.touching() < 2:
                return "lost"
            self._go(run, self._reach(run.T_palm_object, -RUN_UP, self._now()), "back", "hold")
        return "nail not in"

    def _go(self, run: ForeignRun, q: FloatArray, part: str, phase: Phase) -> None:
        """Take the carrier's joints (4,), rad, to ``q``."""
        begin, steps = self._goal, GOING[part] // TWICE
        for k in range(1, steps + 1):
            if self._over:
                break
            s = k / steps
            self._goal = begin + (q - begin) * s * s * (3 - 2 * s)
            duration = steps * TWICE * self._served.period
            self._rate = (q - begin) * 6 * s * (1 - s) / duration
            run.step(phase, s)
        self._rate = np.zeros(4)

    def _step(self, _: SE3, ctrl: FloatArray) -> None:
        """Steps with a command for fingers, and one of the carrier's made here."""
        data, model = self._served.data, self._served.model
        late = self._goal - self._now()
        self._lag = np.clip(self._lag + LEARNS * late, -LEARNED, LEARNED)
        torque = data.qfrc_bias[self._dof] + model.dof_damping[self._dof] * self._rate
        torque += self._stiff * (self._goal + self._lag + STIFFER * late)
        ctrl = ctrl.copy()
        ctrl[self._wrist] = torque / self._gain
        for _ in range(TWICE):
            self._send(np.clip(ctrl, self._low, self._high))

    def _send(self, ctrl: FloatArray) -> None:
        middle, half = (self._low + self._high) / 2, (self._high - self._low) / 2
        self._served.step(((ctrl - middle) / half).tolist())
        self._done |= bool(self._served.told["succeed"])

    def _now(self) -> FloatArray:
        """The carrier's joints (4,), rad."""
        return np.array(self._served.data.qpos[self._at])

    @property
    def _over(self) -> bool:
        return self._done or bool(self._served.told["ended"])

    @property
    def _depth(self) -> float:
        return float(self._served.data.joint("nail_dir").qpos[0])

    def _way(self, plan: GraspPlan) -> list[SE3]:
        """Nothing that the base does; the face must come to the nail all along its way in.

        Raises:
            TaskError: It does not, or the hammer is not held in a rehearsal of the lift.
        """
        q = plan.q[self._wrist]
        T_palm_object = self._palm(q).inverse() * plan.task.T_world_object
        for deep in (-BEFORE, 0.0, IN):
            q = self._reach(T_palm_object, deep, q)
            off, turned = self._beside(T_palm_object, deep, q)
            far, most = 1e3 * np.linalg.norm(off), 2 * np.sin(np.deg2rad(TURNED) / 2)
            if far > OFF or np.linalg.norm(turned) > most:
                raise TaskError("forearm and wrist do not bring the hammer's face to the nail")
        copied = _Hammering(_Rehearsal(self._served), self.scene.hand)
        if not self._closed(copied._lifted(plan)):
            raise TaskError("lifted in a copy of the scene, with less friction, it is not held")
        return []

    def _reach(self, T_palm_object: SE3, deep: float, q: FloatArray) -> FloatArray:
        """Joints (4,) that bring the face as deep (m) as wanted from the nail's head of now."""

        def left(q: FloatArray) -> FloatArray:
            off, turned = self._beside(T_palm_object, deep, q)
            return np.concatenate([off / 0.01, turned, 0.05 * (q - begin)])

        begin = np.clip(q, self._range[0] + 1e-4, self._range[1] - 1e-4)
        return np.asarray(least_squares(left, begin, bounds=self._range).x)

    def _beside(
        self, T_palm_object: SE3, deep: float, q: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """How far (3,), m, the face is from where it is wanted, and its normal from the way in."""
        nail = self._served.data.site("S_target").xpos + deep * self._inwards
        body = self._palm(q) * T_palm_object * self.scene.T_body_object.inverse()
        return body.act(HEAD) - nail, body.rotation @ FACE - self._inwards

    def _palm(self, q: FloatArray) -> SE3:
        """Pose of the palm with the carrier's joints at q (4,)."""
        self._copy.qpos[:] = self._served.data.qpos
        self._copy.qpos[self._at] = q
        mujoco.mj_kinematics(self._served.model, self._copy)
        palm = self._copy.body(self.scene.hand.description.palm_body)
        return SE3(palm.xmat.reshape(3, 3), palm.xpos)


HAMMER = Task(
    name="adroit_hammer",
    project="gymnasium-robotics",
    model="gymnasium_robotics/envs/assets/adroit_hand/adroit_hammer.xml",
    play=lambda served, hand, seed: _Hammering(served, hand).row(seed),
)
