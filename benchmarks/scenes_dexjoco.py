"""DexJoCo (github brave-eai/dexjoco, MIT): a Panda arm with an Allegro hand.

Its ``step`` takes where the flange is wanted and the targets of the fingers' servos. ``HAMMER``:
the nail is 40 mm deep before 1000 of its steps are over.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pinocchio as pin

from benchmarks.scenes_task import Served, Task, outcome
from planner.errors import TaskError
from planner.hand_loading import load_hand
from planner.objects import Region
from planner.plan import GraspPlan
from planner.quality import force_closure
from planner.spatial import SE3, FloatArray, minimum_jerk, pose_to_wxyz, shifted
from planner.tools import plan_use
from sim.controllers import AnyController
from sim.foreign import ForeignRun, ForeignScene
from sim.simulation import Simulation
from sim.tables import Row

PALM, FLANGE, TABLE = "allegro_palm", "attachment_site", "table_collision"
"""Body of the hand's base, site that its arm controller moves, and geom of its table."""

REST = 50
"""Steps of 20 ms that it is left alone for after a reset: the hammer falls onto the table."""

CLEAR = 0.25
"""Height (m) to which the hand goes before it comes down, and after it has grasped."""

HOVER = 0.08
"""Height (m) of the face over the nail before a blow."""

BELOW = 0.15
"""How far (m) below the nail the flange is sent in a blow: its arm controller follows with a time
constant of 0.4 s, so the face comes at about 0.4 m/s."""

BLOWS, BLOW = 6, 0.8
"""Most blows, and longest time of one, s."""

LAG = (0.4, 0.57)
"""Times (s) by which its arm follows a way and a turn: its controller's damping by its stiffness.
What is made of them in that time is added to where the hand is sent, of turns at most ``AHEAD``."""

AHEAD = 0.3
"""Most of a turn (rad) that is added: its controller's errors of large angles go astray."""

DEPTH = 0.04
"""Depth (m) that its test asks for."""

BEST_OF, ATTEMPTS = 3, 300
"""Grasps to choose from, and attempts to find them."""


class Played(ABC):
    """One episode of one of its tasks.

    Attributes:
        served: The task.
        scene: As it was read last.
        home: Where the hand's base was when it was read first.
    """

    def __init__(
        self, served: Served, hand: Path, object: str, *, rest: int = REST, **given: Any
    ) -> None:
        """Let everything come to rest, and read the scene.

        Args:
            served: The task.
            hand: Description of the hand.
            object: As ``ForeignScene``.
            rest: Steps that it is left alone for.
            given: As ``ForeignScene``.
        """
        self.served = served
        model, data = served.model, served.data
        site, palm = model.site(FLANGE).id, model.body(PALM).id
        T_world_palm = SE3(data.xmat[palm].reshape(3, 3), data.xpos[palm])
        T_world_flange = SE3(data.site_xmat[site].reshape(3, 3), data.site_xpos[site])
        self._T_base_flange = T_world_palm.inverse() * T_world_flange
        hand_now = load_hand(hand)
        joints = [int(model.joint(name).qposadr[0]) for name in hand_now.joint_names]
        still = np.zeros(hand_now.nq)
        home = hand_now.actuation.commands(data.qpos[joints], still, still)
        for _ in range(rest):
            self.send(T_world_flange, home)
        self._given = {"hand": hand_now, "object": object, "table": TABLE, **given}
        self.read()
        self.home = self.scene.T_world_base

    def read(self, **changes: Any) -> None:
        """Read the scene as it is now, with other arguments of ``ForeignScene`` if given."""
        given = self._given | changes
        self.scene = ForeignScene(self.served.model, self.served.data, **given)

    def run(self, plan: GraspPlan, controller: AnyController | None = None) -> ForeignRun:
        """A run of a plan by its steps, which ends with the episode."""
        period = self.served.period
        run = ForeignRun(plan, self.scene, self._step, period=period, controller=controller)
        run.on_step = self._end
        return run

    def plan(self, seed: int, *, best_of: int = 1, **given: Any) -> GraspPlan:
        """A grasp from which its arm reaches the approach and all of the route.

        Args:
            seed: Same seed, same plan.
            best_of: As ``plan_use``.
            given: As ``ForeignScene.task``.

        Raises:
            NoGraspFoundError: There is none.
        """

        def way(plan: GraspPlan) -> list[SE3]:
            route = self.route(plan)
            for pose in (plan.T_world_base_start, *route):
                if not self.scene.reaches(pose):
                    raise TaskError(f"its arm does not reach {pose.translation.round(3)} m")
            return route

        task = self.scene.task(**given)
        return plan_use(task, way, seed=seed, max_attempts=ATTEMPTS, best_of=best_of)

    @abstractmethod
    def route(self, plan: GraspPlan) -> list[SE3]:
        """Where the base takes the object after the grasp."""

    def region(self, corners: tuple[Sequence[float], Sequence[float]], name: str = "") -> Region:
        """A box of the object's surface by two corners (m), in the axes of its body."""
        lower, upper = np.array(corners) - self.scene.T_body_object.translation
        return Region(name=name, lower=tuple(lower), upper=tuple(upper))

    def posture(self, given: Mapping[str, float]) -> FloatArray:
        """Joints (nq,), rad, of the hand, by name; the rest are zero."""
        return np.array([given.get(name, 0.0) for name in self.scene.hand.joint_names])

    def in_base(self, q: FloatArray, body: str, point: Sequence[float]) -> FloatArray:
        """Where (3,), m, base axes, a point of a body of the hand is with its joints at q (nq,)."""
        copy = mujoco.MjData(self.served.model)
        copy.qpos[:] = self.served.data.qpos
        for name, value in zip(self.scene.hand.joint_names, q, strict=True):
            copy.joint(name).qpos = value
        mujoco.mj_kinematics(self.served.model, copy)
        part, palm = copy.body(body), copy.body(PALM)
        end = part.xpos + part.xmat.reshape(3, 3) @ point - palm.xpos
        return np.asarray(palm.xmat.reshape(3, 3).T @ end)

    def send(self, T_world_flange: SE3, targets: FloatArray) -> None:
        """One of its steps: where the flange is wanted, and targets of the fingers' servos."""
        self.served.step(np.concatenate([*pose_to_wxyz(T_world_flange), targets]).tolist())

    def _step(self, T_world_base: SE3, targets: FloatArray) -> None:
        self.send(T_world_base * self._T_base_flange, targets)

    def _end(self, run: Simulation) -> None:
        """Make no further step after its last one."""
        if self.served.told["ended"]:
            run.stop("its test or its steps ended it")


class Ahead(Played):
    """One whose arm is sent ahead, by as far as it lags.

    Attributes:
        sent: Where the hand's base was wanted last.
    """

    def __init__(self, *args: Any, **given: Any) -> None:
        """As every episode."""
        super().__init__(*args, **given)
        self.sent = self.home

    def run(self, plan: GraspPlan, controller: AnyController | None = None) -> ForeignRun:
        """A run that goes on from where the base was wanted last."""
        run = super().run(plan, controller)
        run.wanted = self.sent
        return run

    def move(self, q: FloatArray, T_world_base: SE3, duration: float) -> None:
        """Bring the base to a pose, straight, while the fingers keep q (nq,)."""
        begin, turn = self.sent, pin.log3(self.sent.rotation.T @ T_world_base.rotation)
        way = T_world_base.translation - begin.translation

        def between(part: float) -> SE3:
            share = float(minimum_jerk(np.asarray(part)))
            return SE3(begin.rotation @ pin.exp3(share * turn), begin.translation + share * way)

        self.follow(q, between, duration)

    def follow(self, q: FloatArray, way: Callable[[float], SE3], duration: float) -> None:
        """Bring the base along a way, while the fingers keep q (nq,).

        Args:
            q: Those joints, rad.
            way: Where the base is wanted at a share of the duration.
            duration: Of the way, s.
        """
        still = np.zeros_like(q)
        targets = self.scene.hand.actuation.commands(q, still, still)
        steps = round(duration / self.served.period)
        for k in range(steps):
            if self.served.told["ended"]:
                return
            self._step(way((k + 1) / steps), targets)

    def _step(self, T_world_base: SE3, targets: FloatArray) -> None:
        """Ahead of where the base is wanted."""
        turned = pin.log3(T_world_base.rotation @ self.sent.rotation.T)
        turned *= LAG[1] / self.served.period
        turned *= AHEAD / max(float(np.linalg.norm(turned)), AHEAD)
        way = (T_world_base.translation - self.sent.translation) * LAG[0] / self.served.period
        turn = pin.exp3(turned) @ T_world_base.rotation
        self.sent = T_world_base
        super()._step(SE3(turn, T_world_base.translation + way), targets)


class _Hammering(Played):
    """One episode."""

    def __init__(self, served: Served, hand: Path) -> None:
        """As every episode."""
        super().__init__(
            served, hand, "hammer_body", obstacles=("wood_collision",), touch=("handle",)
        )
        self._closed = False
        self._face, self._nail = served.model.geom("face").id, served.model.body("nail").id

    def row(self, seed: int) -> Row:
        """What came of it."""
        run = self.run(self.plan(seed, best_of=BEST_OF))
        ended = self._episode(run)
        told = self.served.told
        about: dict[str, Any] = {
            "done": bool(told["succeed"]),
            "depth_mm": 1e3 * told["nail_depth"],
        }
        row = outcome(run, ended=ended, steps=self.served.steps, **about)
        return {**row, "closed": self._closed}

    def _episode(self, run: ForeignRun) -> str:
        """Grasp, lift, strike; where it ended."""
        plan = run.plan
        above = shifted(plan.T_world_base_start, [0.0, 0.0, CLEAR])
        run.move(above, 1.5, wait=1.0, phase="approach")
        run.move(plan.T_world_base_start, 1.0, wait=0.5, phase="approach")
        if not run.grasp():
            return "not grasped"
        run.move(shifted(plan.T_world_base, [0.0, 0.0, CLEAR]), 1.5, wait=0.5)
        self._closed = run.touching() > 1 and force_closure(run.contacts).closed
        for _ in range(BLOWS):
            run.move(shifted(run.wanted, self._over()), 1.2, wait=0.6)
            if run.touching() < plan.task.fingers_needed:
                return "lost"
            below = shifted(run.wanted, [0.0, 0.0, -BELOW - HOVER])
            run.move(below, 0.2, wait=BLOW, until=self._met)
            run.wanted = run.T_world_base  # no longer pressed down
            if run.ended:
                break
        return "nail not in"

    def _met(self, _: Any) -> bool:
        return bool(self.served.told["hammer_hit"])

    def _over(self) -> FloatArray:
        """Way (3,), m, of the face to its place over the nail."""
        data = self.served.data
        return np.array(data.xpos[self._nail] + [0.0, 0.0, HOVER] - data.geom_xpos[self._face])

    def route(self, plan: GraspPlan) -> list[SE3]:
        """Over and into the nail."""
        low = self._over() - [0.0, 0.0, HOVER + DEPTH]
        up = [0.0, 0.0, CLEAR]
        return [shifted(plan.T_world_base, by) for by in (np.zeros(3), up, low + up, low)]


HAMMER = Task(
    name="hammer_nail",
    project="github brave-eai/dexjoco",
    model="dexjoco/dexjoco/sim/envs/xmls/arena_arm_hand_hammer_nail.xml",
    play=lambda served, hand, seed: _Hammering(served, hand).row(seed),
)
