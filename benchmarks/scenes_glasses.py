"""DexJoCo's glasses: both temples folded, then laid into a box for 1 s, in 1200 of its steps.

They are 0.24 m wide and stand on the table. The index finger, in a posture that is given and not
planned, sweeps one temple inwards about its hinge and then the other, so slowly that the table's
friction holds the frame. A grasp of the folded glasses, read again, is planned and carries them.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from benchmarks.scenes_dexjoco import Ahead
from benchmarks.scenes_mouse import POKE, TIP, TIP_AT, TIP_RADIUS
from benchmarks.scenes_task import Served, Task, outcome
from planner.objects import TouchRegion
from planner.plan import GraspPlan
from planner.spatial import SE3, FloatArray, shifted
from sim.controllers import GraspController
from sim.foreign import ForeignRun
from sim.scene.carrier import Timeline
from sim.tables import Row

REST = 20
"""Steps that they are left alone for after a reset: they fall by 3 mm."""

ALONG, BELOW = 0.185, 0.018
"""Where a temple is pushed: distances (m) along it and downwards from its hinge, to the middle of
its end, so that it takes little force."""

BESIDE, ABOVE = 0.03, 0.12
"""Distance (m) from the temple at which the finger comes down, and from how far above."""

FOLDED, SWEEP = 1.4, 3.0
"""Angle (rad) to which each temple is sent, and the time of it, s: asked is 1.1, and the frame
gives way by a few cm."""

FRONT, BACK = (
    ((-0.06, -np.inf, 0.0535), (0.06, np.inf, np.inf)),
    (
        (-0.06, -np.inf, -np.inf),
        (0.06, np.inf, 0.045),
    ),
)
"""Corners (m) of boxes, in the axes of their body: the middle of the front, and what of the folded
temples is behind it."""

GRIP, HARDER, HARDENING = 2.0, 3.0, 0.4
"""Least planned force (N) of a finger, how many times (-) the planned forces they then press with,
and the time (s) until the temples have yielded to them up to their stops."""

CLEAR = 0.13
"""How far (m) the folded glasses are lifted: the box is 0.1 m high."""

FLOOR = 0.008
"""How far (m) above where they stood they are laid down: the box's floor is 5 mm thick."""


class _Folding(Ahead):
    """One episode."""

    def __init__(self, served: Served, hand: Path) -> None:
        """As every episode."""
        super().__init__(served, hand, "glass", rest=REST)

    def row(self, seed: int) -> Row:
        """What came of it."""
        self._fold()
        self.read()
        thumb, *others = self.scene.hand.description.default_fingers
        regions = dict.fromkeys(others, self.region(BACK)) | {thumb: self.region(FRONT)}
        touch = TouchRegion(required=regions)
        self.scene.object = replace(self.scene.object, touch=touch)
        plan = self.plan(seed, grip_force=GRIP)
        fingers = GraspController(plan)
        run = self.run(plan, fingers)
        ended = self._lay(run, fingers)
        done = bool(self.served.told["succeed"])
        return outcome(run, done=done, ended=ended, steps=self.served.steps)

    def _fold(self) -> None:
        """Sweep one temple, then the other."""
        q = self.posture(POKE)
        end = self.in_base(q, TIP, TIP_AT)
        for number in (0, 1):
            self._sweep(q, end, self.served.data.joint(f"glass_joint_{number}"))

    def _sweep(self, q: FloatArray, end: FloatArray, hinge: Any) -> None:
        """Sweep a temple inwards about its hinge, as the frame stands now.

        Args:
            q: Joints (nq,) of the posture, rad.
            end: Middle (3,) of the finger's end, base axes, m.
            hinge: Joint of the temple.
        """
        frame = self.served.data.body("glass").xmat.reshape(3, 3).copy()
        anchor, axis, first = hinge.xanchor.copy(), hinge.xaxis.copy(), float(hinge.qpos[0])
        level = self.home.rotation

        def beside(angle: float, gap: float, up: float = 0.0) -> SE3:
            along = pin.exp3(angle * axis) @ -frame[:, 2]
            at = (
                anchor
                + ALONG * along
                - BELOW * frame[:, 1]
                + (TIP_RADIUS + gap) * np.cross(along, axis)
            )
            return shifted(SE3(level, at - level @ end), [0.0, 0.0, up])

        self.move(q, beside(first, BESIDE, ABOVE), 1.2)
        self.move(q, beside(first, BESIDE), 0.6)
        self.move(q, beside(first, 0.0), 0.3)
        self.follow(q, lambda share: beside(first + share * (FOLDED - first), 0.0), SWEEP)
        self.move(q, beside(FOLDED, BESIDE), 0.3)
        self.move(q, beside(FOLDED, BESIDE, ABOVE), 0.6)

    def _lay(self, run: ForeignRun, fingers: GraspController) -> str:
        """Lift, carry and lower them; where it ended."""
        plan = run.plan
        run.move(shifted(plan.T_world_base_start, [0.0, 0.0, 0.1]), 1.0, phase="approach")
        run.move(plan.T_world_base_start, 0.6, wait=0.3, phase="approach")
        run.grasp(Timeline(approach=0.6, close=0.4, close_wait=0.4, squeeze=0.4))
        fingers.share = HARDER
        run.move(run.wanted, HARDENING)
        if run.touching() < 2:
            return "not grasped"
        run.held = run.T_palm_object
        for pose, time in zip(self.route(plan), (1.0, 1.5, 1.0), strict=True):
            run.move(pose, time, wait=0.3)
        run.move(run.wanted, 3.0)
        return "not folded in the box"

    def route(self, plan: GraspPlan) -> list[SE3]:
        """Up, over the box, and down, in line with it."""
        data = self.served.data
        floor = data.geom("box_bottom")
        wide, deep = data.body("glass").xmat.reshape(3, 3)[:, 0], floor.xmat.reshape(3, 3)[:, 1]
        angle = np.arctan2(deep[1], deep[0]) - np.arctan2(wide[1], wide[0])
        turn = pin.exp3(np.array([0.0, 0.0, (angle + np.pi / 2) % np.pi - np.pi / 2]))
        middle, base = self.scene.T_world_object.translation, plan.T_world_base
        place = floor.xpos + turn @ (base.translation - middle)
        place[2] = base.translation[2] + FLOOR
        down = SE3(turn @ base.rotation, place)
        up = [0.0, 0.0, CLEAR]
        return [shifted(base, up), shifted(down, up), down]


GLASSES = Task(
    name="fold_glasses",
    project="github brave-eai/dexjoco",
    model="dexjoco/dexjoco/sim/envs/xmls/arena_arm_hand_glass_v2.xml",
    play=lambda served, hand, seed: _Folding(served, hand).row(seed),
)
