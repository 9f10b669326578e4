"""DexJoCo's bucket: a box put into it, and lifted by its handle by 0.15 m, in 1200 of its steps.

The box weighs 0.6 kg and the bucket 1.7 kg. A grasp of the box is planned. The handle, a flat bar
between two arms on a hinge, lies beside the rim: three fingers, curled in a posture that is given
and not planned, press on its inner side, raise it by friction past the vertical until it falls
into the hook that they are, and lift.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin

from benchmarks.scenes_dexjoco import CLEAR, Ahead
from benchmarks.scenes_task import Served, Task, outcome
from planner.errors import TaskError
from planner.plan import GraspPlan
from planner.spatial import SE3, FloatArray, rotation_angle, shifted
from sim.foreign import ForeignRun
from sim.tables import Row

REST = 20
"""Steps that it is left alone for after a reset: the box rises out of the table by 7 mm."""

DROP = 0.06
"""How far (m) above where it stood the box is let go: the bucket's floor is 4 mm thick."""

MOST_TURN = 1.6
"""Most (rad) that a grasp of the box turns the hand from how it is held at first: beyond it the arm
ended at a stop, 13 mm and 16 degrees from the grasp, in 1 of 5 starts."""

OPENING = 0.4
"""Time (s) in which the fingers open, to where they were before they touched."""

HOOK = {
    f"{finger}j{k}": q for finger in ("ff", "mf", "rf") for k, q in ((1, 0.6), (2, 1.2), (3, 1.2))
}
"""Joints (rad) of the hook: ends of the fingers 30 degrees above the level as the hand is held."""

PITCH = (0.4, 1.1)
"""Angle (rad) between flange and vertical, towards the arm's own base, as the handle lies and when
it is raised: so fingers roll less on the bar."""

TIP, TIP_AT, TIP_RADIUS = "mf_tip", (0.0, 0.0, 0.029), 0.012
"""Body of the middle finger's end, the middle of its round end in it, m, and its radius, m."""

PRESSED, BELOW = 0.008, 0.014
"""How far (m) beyond the bar's inner side the fingers are sent, some 1 N of each, and below its
middle: they roll upwards on it."""

OVER, RAISING = 1.95, 4.0
"""Angle of the handle (rad) to which it is raised, and the time that this takes, s."""

LIFT = 0.25
"""How far (m) the hand then rises; asked for is 0.15 m of every corner of the floor."""

REACHED_X = -0.38
"""Where (m) along the table the hand is then: nearer to its base its arm reaches higher."""


class _Filling(Ahead):
    """One episode."""

    def __init__(self, served: Served, hand: Path) -> None:
        """As every episode."""
        super().__init__(served, hand, "boxed_food_0", rest=REST)

    def row(self, seed: int) -> Row:
        """What came of it."""
        run = self.run(self.plan(seed))
        ended = self._fill(run) or self._hook()
        done = bool(self.served.told["succeed"])
        return outcome(run, done=done, ended=ended, steps=self.served.steps)

    def _fill(self, run: ForeignRun) -> str:
        """Put the box into the bucket; what went wrong."""
        plan = run.plan
        run.move(shifted(plan.T_world_base_start, [0.0, 0.0, CLEAR]), 1.0, phase="approach")
        run.move(plan.T_world_base_start, 0.8, wait=0.5, phase="approach")
        if not run.grasp():
            return "not grasped"
        for pose in self.route(plan):
            run.move(pose, 1.2, wait=0.6)
        if run.touching() < plan.task.fingers_needed:
            return "lost"
        # no wider: a finger beside the box would catch the handle from below on its way out
        self.move(plan.q_pregrasp, self.sent, OPENING)
        self.move(plan.q_pregrasp, shifted(self.sent, [0.0, 0.0, CLEAR]), 1.0)
        return ""

    def _hook(self) -> str:
        """Raise the handle and lift; where it ended."""
        q = self.posture(HOOK)
        end = self.in_base(q, TIP, TIP_AT)
        # the way that it came: another can end at a stop of its arm
        self.move(q, SE3(self.home.rotation, self.sent.translation), 1.2)
        for back, up, time in ((0.05, 0.15, 1.2), (0.03, 0.0, 1.0), (-PRESSED, 0.0, 0.5)):
            self.move(q, shifted(self._inside(end, 0.0, back), [0.0, 0.0, up]), time)
        self.follow(q, lambda share: self._inside(end, share * OVER, -PRESSED), RAISING)
        far = REACHED_X - self.sent.translation[0]
        self.move(q, shifted(self.sent, [far, 0.0, LIFT]), 3.0)
        self.move(q, self.sent, 2.0)
        return "not lifted"

    def _inside(self, end: FloatArray, angle: float, back: float) -> SE3:
        """Where the base has fingers at the bar's inner side.

        Args:
            end: Middle (3,) of the middle finger's end, base axes, m.
            angle: Of the handle, rad.
            back: Distance from the bar, m.
        """
        hinge, bar = self.served.data.joint("bucket_joint_0"), self.served.data.geom("handle1")
        along = hinge.xaxis * np.sign(hinge.xaxis[1])
        yaw = np.arctan2(-along[0], along[1])
        pitch = np.interp(angle, (0.0, OVER), PITCH)
        turn = pin.rpy.rpyToMatrix(0.0, pitch, yaw) @ self.home.rotation
        arm = pin.exp3((angle - float(hinge.qpos[0])) * hinge.xaxis) @ (bar.xpos - hinge.xanchor)
        out = arm / np.linalg.norm(arm)
        half = float(self.served.model.geom("handle1").size[0])
        at = hinge.xanchor + arm - (half + TIP_RADIUS + back) * out
        return SE3(turn, at - BELOW * np.cross(hinge.xaxis, out) - turn @ end)

    def route(self, plan: GraspPlan) -> list[SE3]:
        """Up, over the bucket's middle, and down.

        Raises:
            TaskError: The hand is turned too far.
        """
        if rotation_angle(self.home.rotation.T @ plan.T_world_base.rotation) > MOST_TURN:
            raise TaskError("its arm does not turn the hand so far")
        up = [0.0, 0.0, CLEAR]
        across = self.served.data.geom("bucket_bottom").xpos - self.scene.T_world_object.translation
        low = np.array([*across[:2], DROP])
        return [shifted(plan.T_world_base, by) for by in (up, low + up, low)]


BUCKET = Task(
    name="pick_bucket",
    project="github brave-eai/dexjoco",
    model="dexjoco/dexjoco/sim/envs/xmls/arena_arm_hand_bucket_pick.xml",
    play=lambda served, hand, seed: _Filling(served, hand).row(seed),
)
