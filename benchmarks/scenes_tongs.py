"""DexJoCo's tongs: closed and opened three times, and lifted by 0.1 m, in 1000 of its steps.

Two handles on a hinge, opened by a spring of up to 0.9 N m. They are one object, frozen as they
rest, for the plan: the thumb touches one handle from outside, fingers the other. Then the fingers
press harder until the hinge has closed, and softer until the spring has opened it.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.scenes_dexjoco import ATTEMPTS, CLEAR, Played
from benchmarks.scenes_task import Served, Task, outcome
from planner.errors import NoGraspFoundError
from planner.objects import Region, TouchRegion
from planner.plan import GraspPlan
from planner.spatial import SE3, shifted
from planner.tools import plan_use
from sim.controllers import GraspController
from sim.foreign import ForeignRun
from sim.tables import Row

LIFT = 0.15
"""How far (m) the tongs are lifted; asked for is 0.1 m."""

CLOSED, OPENED = -0.075, 0.11
"""Angle of the hinge (rad) at which a pinch ends, and at which the next may begin: 5 and 10 mrad
beyond what its test asks for."""

OUTSIDE = {
    "right": ((0.03, -np.inf, -0.12), (np.inf, np.inf, 0.05)),
    "left": ((-np.inf, -np.inf, -0.12), (-0.065, np.inf, 0.05)),
}
"""Corners (m) of boxes, in the axes of their body, with the outsides of the two handles."""

GRIP = 2.0
"""Least planned force (N) of a finger: the spring gives about 2 N at a handle."""

SOFTEST, HARDEST, RATE = -8.0, 8.0, 0.25
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
        super().__init__(served, hand, "link_1")
        self._whole = self.scene.object

    def row(self, seed: int) -> Row:
        """What came of it."""
        thumb, *others = self.scene.hand.description.default_fingers
        for near, far in (("right", "left"), ("left", "right")):
            regions = dict.fromkeys(others, self._region(far)) | {thumb: self._region(near)}
            self.scene.object = replace(self._whole, touch=TouchRegion(required=regions))
            task = self.scene.task(grip_force=GRIP)
            try:
                plan = plan_use(task, self._way, seed=seed, max_attempts=ATTEMPTS, best_of=1)
                break
            except NoGraspFoundError as error:
                said = str(error)
        else:
            return {"done": False, "ended": "no plan", "detail": said[:200]}
        fingers = GraspController(plan)
        run = self.run(plan, fingers)
        ended = self._episode(run, fingers)
        told = self.served.told
        row = outcome(run, done=bool(told["succeed"]), ended=ended, steps=self.served.steps)
        return {**row, "pinches": int(told["pinch_count"])}

    def _episode(self, run: ForeignRun, fingers: GraspController) -> str:
        """Grasp, pinch, lift; where it ended."""
        plan = run.plan
        run.move(shifted(plan.T_world_base_start, [0.0, 0.0, CLEAR]), 1.0, phase="approach")
        run.move(plan.T_world_base_start, 1.0, wait=0.5, phase="approach")
        run.grasp()
        while True:
            if not self._press(run, fingers, RATE):
                return "not closed"
            if self.served.told["pinch_count"] >= PINCHES:
                break
            if not self._press(run, fingers, -RATE):
                return "not opened"
        run.move(shifted(run.wanted, [0.0, 0.0, LIFT]), 1.5, wait=3.0, until=lambda _: run.ended)
        return "lost" if run.touching() < plan.task.fingers_needed else "not lifted"

    def _press(self, run: ForeignRun, fingers: GraspController, rate: float) -> bool:
        """Press harder until the hinge has closed, or softer until it has opened; whether it has."""

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

    def _region(self, handle: str) -> Region:
        lower, upper = np.array(OUTSIDE[handle]) - self.scene.T_body_object.translation
        return Region(name=handle, lower=tuple(lower), upper=tuple(upper))

    def _way(self, plan: GraspPlan) -> list[SE3]:
        """Up; the arm must reach it."""
        way = [plan.T_world_base, shifted(plan.T_world_base, [0.0, 0.0, LIFT])]
        self.check_reach([plan.T_world_base_start, *way])
        return way


TONGS = Task(
    name="pinch_tongs",
    project="github brave-eai/dexjoco",
    model="dexjoco/dexjoco/sim/envs/xmls/arena_arm_hand_table_tongs.xml",
    play=lambda served, hand, seed: _Pinching(served, hand).row(seed),
)
