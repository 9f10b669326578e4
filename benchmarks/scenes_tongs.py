"""DexJoCo's tongs: closed and opened three times, and lifted by 0.1 m, in 1000 of its steps.

Two handles on a hinge, opened by a spring of up to 0.9 N m. They are one object, frozen as they
rest, for the plan: the thumb touches one handle from outside, fingers the other. Then the fingers
press harder until the hinge has closed, and softer until the spring has opened it.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.scenes_dexjoco import CLEAR, Played
from benchmarks.scenes_task import Served, Task, outcome
from planner.errors import NoGraspFoundError
from planner.objects import Region, TouchRegion
from planner.plan import GraspPlan
from planner.spatial import SE3, shifted
from sim.controllers import GraspController, Phase
from sim.foreign import ForeignRun
from sim.scene.carrier import Timeline
from sim.tables import Row

REST = 30
"""Steps that they are left alone for after a reset: they fall by 1 cm."""

LIFT = 0.15
"""How far (m) the tongs are lifted; asked for is 0.1 m."""

CLOSED, OPENED = -0.075, 0.11
"""Angle of the hinge (rad) at which a pinch ends, and at which the next may begin: 5 and 10 mrad
beyond what its test asks for."""

WHERE = {
    "right": ((0.03, -np.inf, -0.12), (np.inf, np.inf, 0.05)),
    "left": ((-np.inf, -np.inf, -0.12), (-0.065, np.inf, 0.05)),
    "middle": ((-np.inf, -np.inf, 0.07), (np.inf, np.inf, 0.15)),
}
"""Corners (m) of boxes, in the axes of their body: the outsides of the handles, and the hinge."""

GRIP = 2.0
"""Least planned force (N) of a finger: the spring gives about 2 N at a handle."""

SOFTEST, HARDEST, RATE = -8.0, 4.0, 0.1
"""Least and most times (-) the planned forces, and change in a step: fingers pull back from where
they latched, since the tongs are closed there."""

LONGEST = 4.0
"""Longest time (s) of one closing or opening."""

PINCHES = 3
"""Pinches that its test asks for."""


class _Pinching(Played):
    """One episode."""

    def __init__(self, served: Served, hand: Path) -> None:
        """As every episode."""
        super().__init__(served, hand, "link_1", rest=REST)

    def row(self, seed: int) -> Row:
        """What came of it."""
        thumb, *others = self.scene.hand.description.default_fingers
        for near, far in (("right", "left"), ("left", "right")):
            regions = dict.fromkeys(others, self._at(far)) | {thumb: self._at(near)}
            try:
                plan = self._plan(TouchRegion(required=regions), GRIP, seed)
                break
            except NoGraspFoundError as error:
                none = error
        else:
            raise none
        fingers = GraspController(plan)
        run = self.run(plan, fingers)
        ended = self._pinch(run, fingers)
        if not ended:
            self._raise(run, "approach", 0.0)
            self.read()
            try:
                plan = self._plan(TouchRegion(allowed=(self._at("middle"),)), None, seed)
            except NoGraspFoundError as error:
                return {"done": False, "ended": "no second plan", "detail": str(error)[:200]}
            run = self.run(plan)
            ended = self._lift(run)
        told = self.served.told
        row = outcome(run, done=bool(told["succeed"]), ended=ended, steps=self.served.steps)
        return {**row, "pinches": int(told["pinch_count"])}

    def _plan(self, touch: TouchRegion, grip: float | None, seed: int) -> GraspPlan:
        """A grasp that touches only there.

        Raises:
            NoGraspFoundError: There is none.
        """
        self.scene.object = replace(self.scene.object, touch=touch)
        return self.plan(seed, grip_force=grip)

    def _pinch(self, run: ForeignRun, fingers: GraspController) -> str:
        """Pinch where the tongs lie; what went wrong."""
        plan = run.plan
        run.move(shifted(plan.T_world_base_start, [0.0, 0.0, CLEAR]), 1.0, phase="approach")
        run.move(plan.T_world_base_start, 1.0, wait=0.5, phase="approach")
        run.grasp(Timeline(close_wait=0.2, settle=0.1))
        while self.served.told["pinch_count"] < PINCHES:
            if not self._press(run, fingers, -RATE):
                return "not opened"
            if not self._press(run, fingers, RATE):
                return "not closed"
        self._press(run, fingers, -RATE)
        return ""

    def _lift(self, run: ForeignRun) -> str:
        """Grasp by the hinge and lift; where it ended."""
        run.move(run.plan.T_world_base_start, 1.0, wait=0.5, phase="approach")
        if not run.grasp():
            return "not grasped"
        self._raise(run, "hold", 1.0)
        return "lost" if run.touching() < run.plan.task.fingers_needed else "not lifted"

    def _raise(self, run: ForeignRun, phase: Phase, wait: float) -> None:
        up = shifted(run.wanted, [0.0, 0.0, LIFT])
        run.move(up, 0.8, wait=wait, phase=phase, until=lambda _: run.ended)

    def _press(self, run: ForeignRun, fingers: GraspController, rate: float) -> bool:
        """Press harder until the hinge has closed, or softer until it is open; whether it is so."""

        def there() -> bool:
            return self._hinge <= CLOSED if rate > 0.0 else self._hinge >= OPENED

        for _ in run.run("hold", LONGEST):
            if there():
                return True
            fingers.share = float(np.clip(fingers.share + rate, SOFTEST, HARDEST))
        return there()

    @property
    def _hinge(self) -> float:
        """Its angle, rad."""
        return float(self.served.data.joint("joint_0").qpos[0])

    def _at(self, part: str) -> Region:
        return self.region(WHERE[part], part)

    def route(self, plan: GraspPlan) -> list[SE3]:
        """Up."""
        return [plan.T_world_base, shifted(plan.T_world_base, [0.0, 0.0, LIFT])]


TONGS = Task(
    name="pinch_tongs",
    project="github brave-eai/dexjoco",
    model="dexjoco/dexjoco/sim/envs/xmls/arena_arm_hand_table_tongs.xml",
    play=lambda served, hand, seed: _Pinching(served, hand).row(seed),
)
