"""``GoalMoves``: single movements towards a goal rotation, each verified as it is made.

Picked up from a stable pose by a grasp of the ``Roadmap``, the object is turned by the wrist and
held, or set down on another face; or the wrist makes one part of the tilt and the fingers the rest.
``planner.motion.goals`` searches sequences of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pinocchio as pin

from planner.collision.pregrasp import Approach
from planner.collision.world import CollisionWorld
from planner.errors import NoGraspFoundError
from planner.failure import Failure
from planner.motion.ending import turned_ending
from planner.motion.path import ObjectPath
from planner.motion.plan import ManipulationPlan, MotionRecord, MovementPlan
from planner.motion.roadmap import Roadmap
from planner.motion.search import plan_motion
from planner.motion.single_stroke import TILT_TOLERANCE, merit, pivots
from planner.motion.task import SEEDS_APART, with_fingers
from planner.motion.verify import MovementVerifier
from planner.plan import SolveRecord
from planner.spatial import SE3, FloatArray, fixed_array, rotation_angle
from planner.task import GraspTask
from planner.verification import verify_grasp

TRIED = 6
"""Grasps that are verified for one movement, of which the best is taken unless one is good enough
(``planner.motion.single_stroke.merit``) before."""

USUAL_IN_FINGERS, MOST_IN_FINGERS, FARTHEST = np.deg2rad([20.0, 40.0, 90.0])
"""Tilt (rad) that is asked of the fingers first, the largest one, and the largest tilt beyond what
the wrist is counted on for at which they are asked: grasps are tilted themselves."""

FINGER_TRIES, FINGER_ROUNDS, FINGER_ATTEMPTS = 6, 3, 12
"""Seeds that turns in the fingers are planned with; turns planned with each, the next one further
by what the palm tilts too far; and attempts at each, which take some 0.2 s of CPU."""

WITHIN = np.deg2rad(2.0)
"""How far (rad) within its limit the next turn aims: the grasp is a little different then."""

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

    def left_to_fingers(self, start: SE3, goal: FloatArray) -> FloatArray | None:
        """The turn (3, 3), world, that fingers make where a palm straight down may not tilt so far.

        It is made before the wrist makes the rest. None where nothing is left to the fingers, or
        too much.
        """
        whole = goal @ start.rotation.T
        tilt = np.asarray(pin.log3(upright(whole.T @ UP, np.eye(3))))
        angle = float(np.linalg.norm(tilt))
        rest = angle - OF_LIMIT * self.goal_tilt
        if not LEAST_IN_FINGERS < rest <= FARTHEST:
            return None
        return np.asarray(pin.exp3(min(rest, USUAL_IN_FINGERS) / angle * tilt))

    def turned_in_fingers(
        self, start: SE3, goal: FloatArray, target: SE3
    ) -> ManipulationPlan | None:
        """A movement that tilts the object in the fingers where the palm may not tilt enough."""
        left = self.left_to_fingers(start, goal)
        if left is None:
            return None
        palm_of = self.task.hand.palm_normal
        for k in range(FINGER_TRIES):
            turn = left
            for _ in range(FINGER_ROUNDS):
                motion = self._planned_in_fingers(start, goal, turn, self.seed + k * SEEDS_APART)
                if motion is None:
                    break
                palm = motion.grasp.T_world_palm.rotation @ palm_of
                attitude = motion.path.attitude
                low = self._lowered(attitude @ palm)
                failure = pivots(motion) or self._tilted(motion.path, palm)
                if failure is None and rotation_angle(low) == 0.0:
                    ending = turned_ending(motion, target, None)
                    angle = motion.path.angle
                    return ManipulationPlan.of(motion, ending, angle=angle, shift=np.zeros(3))
                text = "the palm of a turn in the fingers tilts too far at the goal"
                self.failures.append(failure or Failure(kind="palm_tilts", text=text))
                turn = (low @ attitude).T @ goal @ start.rotation.T
                if failure is not None or rotation_angle(turn) > MOST_IN_FINGERS:
                    break
        return None

    def _planned_in_fingers(
        self, start: SE3, goal: FloatArray, turn: FloatArray, seed: int
    ) -> MovementPlan | None:
        """A motion that turns the object in the fingers (3, 3), world; the wrist makes the rest."""
        self.verified += 1
        rotation = pin.log3(turn)
        angle = float(np.linalg.norm(rotation))
        try:
            return plan_motion(
                replace(self.task, T_world_object=start),
                axis=rotation / angle,
                angle=angle,
                path_tolerance=TILT_TOLERANCE,
                seed=seed,
                max_attempts=FINGER_ATTEMPTS,
                attitude=goal @ start.rotation.T @ turn.T,
            )
        except NoGraspFoundError as error:
            self.failures.append(Failure(kind="no_turn_in_fingers", text=str(error)))
            return None

    def _lowered(self, palm: FloatArray) -> FloatArray:
        """The smallest rotation (3, 3), world, of a palm (3,) to within its tilt at the goal."""
        down = upright(-palm, np.eye(3))
        tilt = rotation_angle(down)
        if tilt <= self.goal_tilt:
            return np.eye(3)
        within = max(0.0, self.goal_tilt - WITHIN)
        return np.asarray(pin.exp3((1.0 - within / tilt) * pin.log3(down)))
