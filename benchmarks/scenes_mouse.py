"""DexJoCo's mouse: brought onto a pad and its left button pressed there, in 1200 of its steps.

The mouse weighs 1.1 kg and has two buttons on springs. Frozen as it lies, it is grasped at its
sides and slid over the table, which bears its weight; then the hand lets it go, and the index
finger, the others stretched out above it, comes down on the button.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.scenes_dexjoco import Played
from benchmarks.scenes_task import Served, Task, outcome
from planner.hands.hand import Hand
from planner.objects import Region, TouchRegion
from planner.plan import GraspPlan
from planner.spatial import SE3, FloatArray, shifted
from sim.controllers import GraspController, Observation
from sim.foreign import ForeignRun
from sim.tables import Row

CARRIED = 0.2
"""Mass (kg) that the grasp is to lift: the table bears the rest while the mouse slides."""

BACK = 0.0
"""Where its back ends, along its body's long axis (m): the buttons are before that, and a grip on
them would press them."""

GRIP = 4.0
"""Least force (N) of a finger: the table's friction is 11 N."""

NEAR, ON_PAD = 0.05, 0.13
"""How near (m) the pad's middle the mouse is to come, and what is enough: 0.15 m is asked for."""

POKE = {"ffj1": 1.3, "ffj2": 0.3, "ffj3": 0.3, "thj0": 0.263}
"""Joints (rad) that point the index finger down, 0.1 m below all others; the rest are zero."""

TIP, TIP_AT, TIP_RADIUS = "ff_tip", (0.0, 0.0, 0.029), 0.012
"""Body of the index finger's end, the middle of its round end in it, m, and its radius, m."""

FORWARD, ABOVE, BELOW = 0.025, 0.04, 0.04
"""Where the button is pressed: how far (m) before its middle, away from the back of the mouse; from
how far (m) above to how far below its top the finger is sent."""

UP = np.array([0.0, 0.0, 1.0])

OPENS, OPENING = -0.2, 0.6
"""Change of the pressing forces in a step (-), and time (s), when the mouse is let go."""

CLEAR = 0.12
"""How far (m) the hand rises from the mouse."""


class _Posture:
    """Keeps joints (nq,) where they are wanted."""

    def __init__(self, hand: Hand, q: FloatArray) -> None:
        """Of a hand."""
        still = np.zeros(hand.nq)
        self._commands = hand.actuation.commands(q, still, still)

    def step(self, _: Observation) -> FloatArray:
        """The same commands (nu,) always."""
        return self._commands


class _Clicking(Played):
    """One episode."""

    def __init__(self, served: Served, hand: Path) -> None:
        """As every episode."""
        super().__init__(served, hand, "link_3")
        upper = (np.inf, np.inf, BACK - float(self.scene.T_body_object.translation[2]))
        touch = TouchRegion(allowed=(Region(name="back", upper=upper),))
        self.scene.object = replace(self.scene.object, mass=CARRIED, touch=touch)

    def row(self, seed: int) -> Row:
        """What came of it."""
        plan = self.plan(seed, grip_force=GRIP)
        fingers = GraspController(plan)
        run = self.run(plan, fingers)
        ended = self._bring(run, fingers) or self._click(run)
        told = self.served.told
        return outcome(run, done=bool(told["succeed"]), ended=ended, steps=self.served.steps)

    def _bring(self, run: ForeignRun, fingers: GraspController) -> str:
        """Grasp, slide, let go; what went wrong."""
        plan = run.plan
        run.move(shifted(plan.T_world_base_start, [0.0, 0.0, CLEAR]), 1.5, phase="approach")
        run.move(plan.T_world_base_start, 1.0, wait=0.5, phase="approach")
        if not run.grasp():
            return "not grasped"
        far = self._left()
        run.move(shifted(run.wanted, [*far, 0.0]), 3.0, wait=1.5, until=lambda _: self._away < NEAR)
        for _ in run.run("hold", OPENING):
            fingers.share += OPENS
        run.wanted = run.T_world_base
        run.move(shifted(run.wanted, [0.0, 0.0, CLEAR]), 1.0, phase="approach")
        return "" if self._away < ON_PAD else "not on the pad"

    def _click(self, run: ForeignRun) -> str:
        """Press the button; where it ended."""
        q = self.posture(POKE)
        run.controller = _Posture(self.scene.hand, q)
        level = self.home.rotation
        place = self._button() - level @ self.in_base(q, TIP, TIP_AT)
        above, below = (SE3(level, place + far * UP) for far in (ABOVE, -BELOW))
        run.move(above, 2.0, wait=1.0)
        run.move(below, 2.5, wait=2.0, until=lambda _: run.ended)
        return "not clicked"

    def _button(self) -> FloatArray:
        """Where (3,), m, the middle of the finger's end is to be over the button's front."""
        model, data = self.served.model, self.served.data
        solid = next(
            g
            for g in range(model.ngeom)
            if model.geom_bodyid[g] == model.body("link_0").id and model.geom_contype[g]
        )
        middle, half = np.split(model.geom_aabb[solid], 2)
        turn = data.geom_xmat[solid].reshape(3, 3)
        at = data.geom_xpos[solid] + turn @ middle
        ahead = at - data.geom("mouse").xpos
        ahead[2] = 0.0
        at += FORWARD * ahead / np.linalg.norm(ahead)
        return np.asarray(at + (np.abs(turn[2]) @ half + TIP_RADIUS) * UP)

    def _left(self) -> FloatArray:
        """Way (2,), m, of the mouse to the pad's middle."""
        data = self.served.data
        return np.array((data.geom("mousepad").xpos - data.geom("mouse").xpos)[:2])

    @property
    def _away(self) -> float:
        return float(np.linalg.norm(self._left()))

    def route(self, plan: GraspPlan) -> list[SE3]:
        """To the pad."""
        return [plan.T_world_base, shifted(plan.T_world_base, [*self._left(), 0.0])]


MOUSE = Task(
    name="click_mouse",
    project="github brave-eai/dexjoco",
    model="dexjoco/dexjoco/sim/envs/xmls/arena_arm_hand_monitor_mouse.xml",
    play=lambda served, hand, seed: _Clicking(served, hand).row(seed),
)
