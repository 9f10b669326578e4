"""Adroit (gymnasium-robotics, MIT): a Shadow-type hand on a forearm with two hinges.

``HAMMER``: a hammer lies on the table; a nail, at a drawn height, is to be 81 mm deep before 200 of
its steps of 10 ms are over. Forearm, wrist and fingers are joints of one hand whose base stands
still, so a grasp is planned with all 26. The commands of the carrier's four joints are then made
here: along a line of joint angles, by its actuators' own law, with the weight and the lag added.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from scipy.optimize import least_squares

from benchmarks.scenes_task import Served, Task, outcome
from planner.errors import NoGraspFoundError, TaskError
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

ATTEMPTS, BEST_OF = 400, 1
"""Attempts, and grasps to find: the first that can be used."""

HARDER = 4.0
"""How many times (-) the planned forces the fingers press with: the nail pushes the hammer."""

RAISED = 0.12
"""How much (rad) the forearm is higher before it comes down."""

HEAD, FACE = np.array([-0.24, 0.0, -0.04]), np.array([0.0, 0.0, -1.0])
"""Middle of the head's face (m) and its normal, in the hammer's body."""

OFF, TURNED = 10.0, 45.0
"""Largest offset (mm) and angle (degrees) of the face from the nail along its way in."""

BEFORE, IN, BEYOND = 0.04, 0.09, 0.04
"""Where the face begins before the nail's head, how deep the nail goes, and how far beyond that the
face is led (m): the carrier yields to the nail, and the hammer in the hand."""

GOING = {"above": 16, "down": 26, "close": 18, "squeeze": 10, "lift": 30, "push": 64, "more": 10}
"""Steps of each part."""

LEARNS, LEARNED, STIFFER = 0.08, 0.15, 1.5
"""Share (-) of a lag that is added to the command in a step of control, at most how much (rad), and
the stiffness (-) that the commands add, over the carrier's own."""

TWICE = 2
"""Of its steps one step of control."""


class _Hammering:
    """One episode."""

    def __init__(self, served: Served, hand: Path) -> None:
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
        self._done, self._closed = False, False
        for _ in range(REST):
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
        try:
            plan = plan_use(task, self._way, seed=seed, options=options, **given)
        except NoGraspFoundError as error:
            return {"done": False, "ended": "no plan", "detail": str(error)[:200]}
        fingers, period = GraspController(plan), TWICE * self._served.period
        run = ForeignRun(plan, self.scene, self._step, period=period, controller=fingers)
        ended = self._episode(run, fingers)
        about: dict[str, Any] = {"done": self._done, "depth_mm": 1e3 * self._depth}
        row = outcome(run, ended=ended, steps=self._served.steps, **about)
        return {**row, "closed": self._closed}

    def _episode(self, run: ForeignRun, fingers: GraspController) -> str:
        """Grasp, lift, push the nail in; where it ended."""
        q = run.plan.q[self._wrist]
        raised = q - [RAISED, 0.0, 0.0, 0.0]
        self._go(run, raised, "above", "approach")
        self._go(run, q, "down", "approach")
        self._go(run, q, "close", "close")
        self._go(run, q, "squeeze", "squeeze")
        run.held, fingers.share = run.T_palm_object, HARDER
        if run.touching() < 2:
            return "not grasped"
        self._go(run, self._reach(run.T_palm_object, -BEFORE, q), "lift", "hold")
        self._closed = run.touching() > 1 and force_closure(run.contacts).closed
        deep, part = IN + BEYOND, "push"
        while not self._over:
            left = deep - max(self._depth, 0.0)
            self._go(run, self._reach(run.T_palm_object, left, self._now()), part, "hold")
            if run.touching() < 2:
                return "lost"
            deep, part = deep + BEYOND, "more"
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
            TaskError: It does not.
        """
        q = plan.q[self._wrist]
        T_palm_object = self._palm(q).inverse() * plan.task.T_world_object
        for deep in (-BEFORE, 0.0, IN):
            q = self._reach(T_palm_object, deep, q)
            off, turned = self._beside(T_palm_object, deep, q)
            far, most = 1e3 * np.linalg.norm(off), 2 * np.sin(np.deg2rad(TURNED) / 2)
            if far > OFF or np.linalg.norm(turned) > most:
                raise TaskError("forearm and wrist do not bring the hammer's face to the nail")
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
