"""``GoalMoves``: single movements towards a goal rotation, each verified as it is made.

Picked up from a stable pose by a grasp of the ``Roadmap``, the object is turned by the wrist and
held, or set down on another face; or the wrist makes one part of the tilt and the fingers the rest.
``planner.motion.goals`` searches sequences of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import islice

import numpy as np
import pinocchio as pin

from planner.approach.pregrasp import Approach
from planner.collision.world import CollisionWorld
from planner.failure import Failure
from planner.kinematics.state import HandState
from planner.motion.context import finger_sets, with_rolling_pads
from planner.motion.ending import turned_ending
from planner.motion.path import ObjectPath
from planner.motion.plan import ManipulationPlan, MotionRecord, MovementPlan
from planner.motion.roadmap import Roadmap
from planner.motion.search import motion_attempts
from planner.motion.single_stroke import TILT_TOLERANCE, merit, pivots
from planner.motion.task import with_fingers
from planner.motion.verify import MovementVerifier
from planner.plan import SolveRecord
from planner.spatial import SE3, FloatArray, fixed_array
from planner.task import GraspTask
from planner.verification.grasp import verify_grasp

TRIED = 6
"""Grasps that are verified for one movement, of which the best is taken unless one is good enough
(``planner.motion.single_stroke.merit``) before."""

MOST_IN_FINGERS, FARTHEST = np.deg2rad([30.0, 90.0])
"""Largest tilt (rad) that is asked of the fingers, and largest one beyond what the wrist is counted
on for at which they are asked: the rest is for grasps that are tilted themselves."""

FINGER_ATTEMPTS = 12
"""Attempts at a turn in the fingers, with each set of them."""

OF_LIMIT = 0.5
"""Share (-) of the palm's tilt that the wrist uses where the fingers turn too: grasps from above
are tilted themselves."""

LEAST_IN_FINGERS = np.deg2rad(1.0)
"""Tilt (rad) below which nothing is left to the fingers."""

ROUNDING, STRAIGHT = 1e-9, 1e-9
"""Rounding of a cosine, and the sine of an angle between directions that count as one line."""

UP = fixed_array([0.0, 0.0, 1.0])


def upright(up: FloatArray, rotation: FloatArray) -> FloatArray:
    """The smallest rotation (3, 3), world, after which ``up`` (3,), object frame, is vertical.

    Args:
        up: A direction, unit, object frame.
        rotation: Of the object before (3, 3), world.
    """
    now = rotation @ up
    axis = np.cross(now, UP)
    sine, cosine = float(np.linalg.norm(axis)), float(now @ UP)
    if sine < STRAIGHT:
        return np.eye(3) if cosine > 0 else np.diag([1.0, -1.0, -1.0])
    return np.asarray(pin.exp3(np.arctan2(sine, cosine) * axis / sine))


class GoalMoves:
    """Movements of one task by the grasps of its roadmap.

    Attributes:
        task: Hand and object.
        roadmap: Its grasps.
        goal_tilt: How far the palm may look away from straight down at the goal, rad.
        wrist_tilt: The same wherever the wrist turns, rad.
        verified: How many movements were verified.
        failures: Why those failed that did.
    """

    def __init__(
        self, task: GraspTask, roadmap: Roadmap, *, goal_tilt: float, wrist_tilt: float, seed: int
    ) -> None:
        """Begin; the seed is that of turns in the fingers."""
        self.task, self.roadmap, self.seed = task, roadmap, seed
        self.goal_tilt, self.wrist_tilt = min(goal_tilt, wrist_tilt), wrist_tilt
        self.verified = 0
        self.failures: list[Failure] = []
        self._there: dict[tuple[object, ...], tuple[GraspTask, MovementVerifier]] = {}

    def best(
        self, start: SE3, grasps: Sequence[int], target: SE3, *, stands: bool
    ) -> ManipulationPlan | None:
        """The best movement by one of the first grasps that brings the object to a pose.

        Args:
            start: Where it stands.
            grasps: Numbers of grasps, the most promising first.
            target: Where it is to be.
            stands: Whether it is set down there.
        """
        best: ManipulationPlan | None = None
        for grasp in grasps[:TRIED]:
            made = self.movement(start, grasp, target, stands=stands)
            if isinstance(made, Failure):
                self.failures.append(made)
                continue
            if best is None or merit(made) > merit(best):
                best = made
            if merit(made) >= 1.0:
                break
        return best

    def movement(
        self, start: SE3, grasp: int, target: SE3, *, stands: bool
    ) -> ManipulationPlan | Failure:
        """A movement by one grasp, verified: picked up, turned by the wrist, held or set down."""
        self.verified += 1
        road = self.roadmap
        path = ObjectPath.of_wrist(target.rotation @ start.rotation.T)
        if failure := self._tilted(path, start.rotation @ road.palms[grasp]):
            return failure
        task, verifier = self._verifier(road.finger_names(grasp, self.task), start)
        T_object_base, q = road.T_object_base(grasp), road.joints[grasp]
        record = SolveRecord(iterations=0, status="roadmap", objective="goal")
        found = verifier.verify_held(start * T_object_base, q, path, record)
        if isinstance(found, Failure):
            return found
        taken, knots = found
        made = MotionRecord(iterations=0, worst=0.0, seed=self.seed, attempt=grasp)
        motion = MovementPlan.of_stroke(taken, path, knots, path_tolerance=0.0, record=made)
        release = None
        if stands:
            there = replace(task, T_world_object=target)
            world = CollisionWorld(there)
            put = verify_grasp(there, target * T_object_base, q, record=record, world=world)
            if isinstance(put, Failure):
                return put.at("where it is set down")
            release = Approach(
                q=put.q_pregrasp,
                pregrasp_distance=put.pregrasp_distance,
                T_world_base_start=put.T_world_base_start,
            )
        ending = turned_ending(motion, target, release)
        return ManipulationPlan.of(motion, ending, angle=0.0, shift=np.zeros(3))

    def _verifier(self, names: tuple[str, ...], start: SE3) -> tuple[GraspTask, MovementVerifier]:
        """The task with some fingers and the object at a pose, and its verifier."""
        key = (names, start.homogeneous.tobytes())
        if key not in self._there:
            own = names == self.task.finger_names
            task = self.task if own else with_fingers(self.task, names)
            task = replace(task, T_world_object=start, may_spare_fingers=False)
            self._there[key] = (task, MovementVerifier(task))
        return self._there[key]

    def _tilted(self, path: ObjectPath, palm: FloatArray) -> Failure | None:
        """Why a palm that looks along (3,), world, at the grasp tilts too far on the way."""
        least = min(float(-(path.wrist(share) @ palm)[2]) for share in path.wrist_shares)
        if least >= np.cos(self.wrist_tilt) - ROUNDING:
            return None
        tilt = float(np.rad2deg(np.arccos(np.clip(least, -1.0, 1.0))))
        text = f"the palm tilts by {tilt:.0f} degrees on the wrist's way"
        return Failure(kind="palm_tilts", text=text, numbers={"tilt_deg": tilt})

    # ---- where the palm may not tilt as far as the object

    def left_to_fingers(self, start: SE3, goal: FloatArray) -> tuple[FloatArray, FloatArray] | None:
        """The wrist's attitude (3, 3), and the tilt (3,), rad, world, that fingers make before it.

        The tilt is what the palm, straight down at the grasp, may not make. None where nothing is
        left to the fingers, or too much.
        """
        whole = goal @ start.rotation.T
        tilt = np.asarray(pin.log3(upright(whole.T @ UP, np.eye(3))))
        angle = float(np.linalg.norm(tilt))
        rest = angle - OF_LIMIT * self.goal_tilt
        if not LEAST_IN_FINGERS < rest <= FARTHEST:
            return None
        by_fingers = min(rest, MOST_IN_FINGERS) / angle * tilt
        return whole @ pin.exp3(by_fingers).T, by_fingers

    def turned_in_fingers(
        self, start: SE3, goal: FloatArray, target: SE3
    ) -> ManipulationPlan | None:
        """A movement that tilts the object in the fingers where the palm may not tilt enough."""
        left = self.left_to_fingers(start, goal)
        if left is None:
            return None
        attitude, tilt = left
        angle = float(np.linalg.norm(tilt))
        axis, task = tilt / angle, replace(self.task, T_world_object=start)
        path = ObjectPath(axis=axis, angle=angle, shift=np.zeros(3), attitude=attitude)
        least = np.cos(self.goal_tilt) - ROUNDING

        def palm_down(T_world_base: SE3, q: FloatArray) -> bool:
            palm = T_world_base * HandState(task.hand, q).T_base_palm
            return bool(-(attitude @ palm.rotation @ task.hand.palm_normal)[2] >= least)

        for one in finger_sets(with_rolling_pads(task)):
            attempts = motion_attempts(
                one, path, path_tolerance=TILT_TOLERANCE, seed=self.seed, reaches=palm_down
            )
            for attempt in islice(attempts, FINGER_ATTEMPTS):
                self.verified += 1
                motion, failure = attempt.plan, attempt.failure
                if motion is not None:
                    grasp = motion.grasp
                    palm = grasp.T_world_palm.rotation @ task.hand.palm_normal
                    failure = pivots(motion) or self._tilted(path, palm)
                    if failure is None and palm_down(grasp.T_world_base, grasp.q):
                        ending = turned_ending(motion, target, None)
                        return ManipulationPlan.of(motion, ending, angle=angle, shift=np.zeros(3))
                if failure is None or failure.kind == "out_of_reach":
                    text = "no grasp for a turn in the fingers has the palm within its tilt there"
                    failure = Failure(kind="palm_tilts", text=text)
                self.failures.append(failure)
        return None
