"""``plan_reorientation``: an object from the table to any goal rotation, held there or put down.

    plan = plan_reorientation("allegro_hand", parse_object("box"), R_world_goal)
    manipulate(plan).goal_reached

The result is a ``ManipulationPlan``, or a chain of them (``then``): pick the object up from a stable
pose, turn hand and object by the wrist, and hold it there, turn it further in the fingers, or set
it down on another face, from where the next one picks it up.

The search goes through stable poses from the cheapest on: every movement costs 1, and as much more
as its grasp is worse. Which grasps there are, and which serve two poses, the ``Roadmap`` tells;
each movement is verified as it is taken, as any movement is: on the table as a grasp, at the knots
with gravity as it is every ``WRIST_STEP`` of the wrist's way, and where it sets down as a grasp
again, whose approach is the way out.
"""

from __future__ import annotations

import heapq
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pinocchio as pin

from planner.approach.pregrasp import Approach
from planner.arrays import checked_number
from planner.attempt import check_seed
from planner.collision.world import CollisionWorld
from planner.errors import NoGraspFoundError, TaskError, UnreachableError
from planner.failure import Failure
from planner.hands.hand import Hand
from planner.motion.ending import FLAT, turned_ending
from planner.motion.path import ObjectPath, check_place, checked_rotation
from planner.motion.plan import ManipulationPlan, MotionRecord, MovementPlan
from planner.motion.roadmap import ROADMAP_S, Roadmap, poses_of, roadmap_for
from planner.motion.search import plan_motion
from planner.motion.single_stroke import TILT_TOLERANCE, merit, pivots
from planner.motion.task import manipulation_task, with_fingers
from planner.motion.verify import MOST_PRESS, MovementVerifier
from planner.numerics.kernels import planning_time
from planner.objects import GraspObject
from planner.plan import SolveRecord
from planner.spatial import SE3, FloatArray, rotation_angle
from planner.task import GraspTask
from planner.verification.grasp import verify_grasp

__all__ = ["plan_reorientation"]

MU = 0.45
"""Friction (-) that is believed, as of other manipulations on the command line."""

ANY_TILT = float(np.pi)
"""Tilt (rad) of the palm from straight down that excludes nothing."""

STANDS = np.deg2rad(3.0)
"""Largest angle (rad) of a given start from the stable pose that it stands in: read poses are off
by less, and what is farther off topples."""

TRIED = 6
"""Grasps that are verified for one movement, of which the best is taken unless one is good enough
(``planner.motion.single_stroke.merit``) before."""

FORCE_COST, WRIST_COST = 0.3, 0.2
"""What a movement costs more if a finger presses with ``MOST_PRESS``, and if the wrist turns by half
a turn (-): together less than another movement."""

MOST_IN_FINGERS = np.deg2rad(40.0)
"""Largest tilt (rad) that is asked of the fingers: beyond it hardly any grasp has one."""

FINGER_COST, FINGER_ATTEMPTS = 1.0, 12
"""What a turn in the fingers costs beside the movement that it is part of (-), as much as another
one: it takes longer to plan and to make. And attempts at planning one."""

NEAR_STEP, NEAR_TURNS = np.deg2rad(5.0), 64
"""Angles (rad) and number of axes at which rotations near a goal are tried that is not reached."""

NEAREST_TRIED = 4
"""Rotations near a goal that are verified."""


@dataclass(frozen=True, kw_only=True)
class _Node:
    """The object standing in a stable pose, and how it came there."""

    pose: int
    T_world_object: SE3
    before: tuple[ManipulationPlan, ...]


def plan_reorientation(
    hand: Hand | str | Path,
    object: GraspObject,
    goal: Sequence[Sequence[float]] | FloatArray,
    *,
    T_world_object: SE3 | None = None,
    place: tuple[float, float] | None = None,
    put_down: bool = False,
    goal_tilt: float = ANY_TILT,
    wrist_tilt: float = ANY_TILT,
    mu: float = MU,
    fingers: Sequence[str] | None = None,
    table_height: float | None = 0.0,
    seed: int = 0,
    max_cpu_s: float = ROADMAP_S,
    tell: Callable[[str], object] = lambda line: None,
) -> ManipulationPlan:
    """Bring an object that stands on a table to a goal rotation, by as few movements as there are.

    Args:
        hand: A hand whose base is free, its name, or the path of its description.
        object: The object.
        goal: Rotation (3, 3), world from object, of the object at last.
        T_world_object: Where it stands, in one of its stable poses; in the first one if None.
        place: Where it is at last, x and y in m, world; where it was if None.
        put_down: Whether it is to stand on the table at last, not to be held; the goal is a stable
            pose then.
        goal_tilt: How far (rad) the palm may look away from straight down when the object is held
            at its goal.
        wrist_tilt: The same in every attitude and on every way of the wrist.
        mu: Sliding friction (-), the least that there may be.
        fingers: Finger names; the hand's default set, some of which may be spared, if None.
        table_height: Height of the table's top, m.
        seed: Same seed, same plan.
        max_cpu_s: CPU time (s) after which building the roadmap ends, once per hand and object.
        tell: Called with one line where the roadmap is built.

    Returns:
        The first movement; ``chain`` are all of them. The last ends in the attitude in which it
        reaches the goal (``Ending.turned``).

    Raises:
        UnreachableError: No sequence reaches the goal; tells the nearest rotation that one does.
        TaskError: The goal is no rotation, there is no table, the object does not stand where it
            is, or the hand is on an arm or cannot grasp it.
    """
    wanted = "a matrix with orthonormal columns and determinant 1, world from object"
    rotation = checked_rotation("goal", goal, wanted)
    for name, tilt in (("goal_tilt", goal_tilt), ("wrist_tilt", wrist_tilt)):
        checked_number(name, tilt, least=0.0, most=ANY_TILT, unit="rad", error=TaskError)
    check_place(place)
    check_seed(seed)
    task = manipulation_task(hand, object, mu=mu, fingers=fingers)
    task.hand.require_one("a goal rotation")
    if task.hand.arm is not None:
        raise TaskError(
            f"{task.hand.name} is on an arm; goal rotations are planned for hands whose base is "
            "free: take the hand alone"
        )
    poses = poses_of(object, table_height)
    start = poses[0] if T_world_object is None else T_world_object
    task = replace(task, table_height=table_height, T_world_object=start)
    k = _standing(task, poses)
    roadmap = roadmap_for(task, seed=seed, max_cpu_s=max_cpu_s, tell=tell)
    begin = planning_time()
    search = _Search(task, roadmap, poses, min(goal_tilt, wrist_tilt), wrist_tilt, put_down, seed)
    x, y = start.translation[:2] if place is None else place
    found = search.chain(k, rotation, np.array([x, y]))
    if found is None:
        raise search.unreachable(k, rotation)
    spent = planning_time() - begin
    record = replace(found[0].record, attempts=search.verified, cpu_s=spent, seed=seed)
    plan = replace(found[0], record=record) if len(found) == 1 else found[-1]
    for one in found[-2::-1]:
        first = one is found[0]
        plan = replace(one, then=plan, **({"record": record} if first else {}))
    return plan


def _standing(task: GraspTask, poses: Sequence[SE3]) -> int:
    """Number of the stable pose that a task's object stands in.

    Raises:
        TaskError: It stands in none, or not on the table.
    """
    start = task.T_world_object
    off = [rotation_angle(_upright(pose.rotation[2], start.rotation)) for pose in poses]
    k = int(np.argmin(off))
    lowest = task.lowest_point(start)
    if off[k] > STANDS or task.carrying or abs(lowest - (task.table_height or 0.0)) > LOWEST:
        raise TaskError(
            f"{task.object.name} does not stand on the table as it is given: it is turned by "
            f"{np.rad2deg(off[k]):.1f} degrees from its nearest stable pose, and its lowest point "
            f"is at {1e3 * lowest:.1f} mm; give T_world_object in a stable pose, as resting_pose "
            "of the object gives it"
        )
    return k


LOWEST = 0.005
"""How far (m) the lowest point of an object that stands may be from the table."""


def _upright(up: FloatArray, rotation: FloatArray) -> FloatArray:
    """The smallest rotation (3, 3), world, after which ``up`` (3,), object frame, is vertical."""
    now, vertical = rotation @ up, np.array([0.0, 0.0, 1.0])
    axis = np.cross(now, vertical)
    sine, cosine = float(np.linalg.norm(axis)), float(now @ vertical)
    if sine < STRAIGHT:
        return np.eye(3) if cosine > 0 else np.diag([1.0, -1.0, -1.0])
    return np.asarray(pin.exp3(np.arctan2(sine, cosine) * axis / sine))


STRAIGHT = 1e-9
"""Sine of an angle between directions that count as one line."""


class _Search:
    """One search: what is asked, what was verified, and why movements failed."""

    def __init__(
        self,
        task: GraspTask,
        roadmap: Roadmap,
        poses: Sequence[SE3],
        goal_tilt: float,
        wrist_tilt: float,
        put_down: bool,
        seed: int,
    ) -> None:
        self._task, self._roadmap, self._poses = task, roadmap, poses
        self._goal_cos, self._wrist_cos = np.cos(goal_tilt) - ROUNDING, np.cos(wrist_tilt) - ROUNDING
        self._goal_tilt, self._put_down, self._seed = goal_tilt, put_down, seed
        self._tasks: dict[tuple[object, ...], tuple[GraspTask, MovementVerifier]] = {}
        self.verified = 0
        self.failures: list[Failure] = []

    # ---- the sequence

    def chain(self, k: int, goal: FloatArray, place: FloatArray) -> list[ManipulationPlan] | None:
        """The cheapest chain from a stable pose to a goal; None if there is none."""
        first = _Node(pose=k, T_world_object=self._task.T_world_object, before=())
        heap: list[tuple[float, int, str, _Node, int]] = []
        count = 0

        def push(cost: float, kind: str, node: _Node, to: int = -1) -> None:
            nonlocal count
            count += 1
            heapq.heappush(heap, (cost, count, kind, node, to))

        push(0.0, "stands", first)
        expanded: set[int] = set()
        while heap:
            cost, _, kind, node, to = heapq.heappop(heap)
            if kind == "stands":
                if node.pose in expanded:
                    continue
                expanded.add(node.pose)
                if len(ends := self._goal_grasps(node, goal)):
                    push(cost + self._cost(node, ends[0], goal), "goal", node)
                if not self._put_down and self._in_fingers(node, goal) is not None:
                    push(cost + 1.0 + FINGER_COST, "fingers", node)
                for j in set(range(len(self._poses))) - expanded:
                    if len(moves := self._moving_grasps(node, j)):
                        turned = self._set_down(node, j).rotation
                        push(cost + self._cost(node, moves[0], turned), "moves", node, j)
                continue
            if kind == "moves":
                target = self._set_down(node, to)
                made = self._best(node, self._moving_grasps(node, to), target, down=to)
                if made is not None:
                    after = _Node(pose=to, T_world_object=target, before=(*node.before, made))
                    push(cost, "stands", after)
                continue
            if kind == "goal":
                target, down = self._target(node, goal, place)
                made = self._best(node, self._goal_grasps(node, goal), target, down=down)
            else:
                made = self._turned_in_fingers(node, goal, place)
            if made is not None:
                return [*node.before, made]
        return None

    def _target(
        self, node: _Node, goal: FloatArray, place: FloatArray
    ) -> tuple[SE3, int | None]:
        """Pose of the object at its goal, and the number of the pose it stands in if put down."""
        if not self._put_down:
            height = node.T_world_object.translation[2]
            return SE3(goal, np.array([*place, height])), None
        j = self._stable(goal)
        assert j is not None  # there are no grasps for a goal that does not stand
        upright = _upright(self._poses[j].rotation[2], goal) @ goal
        return SE3(upright, np.array([*place, self._poses[j].translation[2]])), j

    def _set_down(self, node: _Node, j: int) -> SE3:
        """Pose of the object when it is turned the shortest way onto another face, where it was."""
        now, there = node.T_world_object, self._poses[j]
        turn = _upright(there.rotation[2], now.rotation)
        x, y, _ = now.translation
        return SE3(turn @ now.rotation, np.array([x, y, there.translation[2]]))

    def _stable(self, goal: FloatArray) -> int | None:
        """Number of the stable pose that a rotation is, whatever its heading; None for none."""
        level = [float(pose.rotation[2] @ goal[2]) for pose in self._poses]
        k = int(np.argmax(level))
        return k if level[k] > FLAT else None

    # ---- grasps for a movement, best first

    def _goal_grasps(self, node: _Node, goal: FloatArray) -> list[int]:
        """Grasps that pick the object up in a pose and reach the goal, as far as is known."""
        road = self._roadmap
        able = self._able(node, goal, self._goal_cos)
        if self._put_down:
            j = self._stable(goal)
            able &= False if j is None else road.stands[:, j]
        return self._sorted(node, able, goal)

    def _moving_grasps(self, node: _Node, j: int) -> list[int]:
        """Grasps that pick the object up in a pose and set it down in another."""
        turned = self._set_down(node, j).rotation
        able = self._able(node, turned, self._wrist_cos) & self._roadmap.stands[:, j]
        return self._sorted(node, able, turned)

    def _able(self, node: _Node, turned: FloatArray, cosine: float) -> np.ndarray:
        """Which grasps (m,) have the palm within its tilt here and there, and bear the weight."""
        road = self._roadmap
        down_here, down = -node.T_world_object.rotation[2], -turned[2]
        palms = (road.palms @ down >= cosine) & (road.palms @ down_here >= self._wrist_cos)
        strong = road.forces_towards(down) <= MOST_PRESS
        return road.stands[:, node.pose] & palms & strong

    def _sorted(self, node: _Node, able: np.ndarray, turned: FloatArray) -> list[int]:
        cost = {int(g): self._cost(node, int(g), turned) for g in np.flatnonzero(able)}
        return sorted(cost, key=lambda g: cost[g])

    def _cost(self, node: _Node, grasp: int, turned: FloatArray) -> float:
        """Cost (-) of a movement by a grasp to a rotation of the object."""
        road = self._roadmap
        downs = (-node.T_world_object.rotation[2], -turned[2])
        force = max(float(road.forces_towards(down)[grasp]) for down in downs)
        wrist = rotation_angle(turned @ node.T_world_object.rotation.T)
        margin = min(1.0, float(road.margins[grasp]) / GOOD_MARGIN)
        return 1.0 + FORCE_COST * force / MOST_PRESS + WRIST_COST * wrist / np.pi + 1.0 - margin

    # ---- movements, verified

    def _best(
        self, node: _Node, grasps: Sequence[int], target: SE3, *, down: int | None
    ) -> ManipulationPlan | None:
        """The best movement by one of the first grasps that brings the object to a pose."""
        best: ManipulationPlan | None = None
        for grasp in grasps[:TRIED]:
            made = self._movement(node, grasp, target, down=down)
            if isinstance(made, Failure):
                self.failures.append(made)
                continue
            if best is None or merit(made) > merit(best):
                best = made
            if merit(made) >= 1.0:
                break
        return best

    def _movement(
        self, node: _Node, grasp: int, target: SE3, *, down: int | None
    ) -> ManipulationPlan | Failure:
        """A movement by a grasp, verified: picked up, turned by the wrist, held or set down."""
        self.verified += 1
        start, road = node.T_world_object, self._roadmap
        path = ObjectPath.of_wrist(target.rotation @ start.rotation.T)
        palm = start.rotation @ road.palms[grasp]
        if failure := self._tilted(path, palm):
            return failure
        task, verifier = self._there(road.finger_names(grasp, self._task), start)
        base, q = start * road.T_object_base(grasp), road.joints[grasp]
        record = SolveRecord(iterations=0, status="roadmap", objective="goal")
        found = verifier.verify_held(base, q, path, record)
        if isinstance(found, Failure):
            return found
        taken, knots = found
        made = MotionRecord(iterations=0, worst=0.0, seed=self._seed, attempt=grasp)
        motion = MovementPlan.of_stroke(taken, path, knots, path_tolerance=0.0, record=made)
        release = None
        if down is not None:
            there = replace(task, T_world_object=target)
            put = verify_grasp(
                there, target * road.T_object_base(grasp), q, record=record,
                world=CollisionWorld(there),
            )
            if isinstance(put, Failure):
                return put.at("where it is set down")
            release = Approach(
                q=put.q_pregrasp,
                pregrasp_distance=put.pregrasp_distance,
                T_world_base_start=put.T_world_base_start,
            )
        ending = turned_ending(motion, target, release)
        return ManipulationPlan.of(motion, ending, angle=0.0, shift=np.zeros(3))

    def _there(self, names: tuple[str, ...], start: SE3) -> tuple[GraspTask, MovementVerifier]:
        """The task with some fingers and the object at a pose, and its verifier."""
        key = (names, start.homogeneous.tobytes())
        if key not in self._tasks:
            own = names == self._task.finger_names
            task = self._task if own else with_fingers(self._task, names)
            task = replace(task, T_world_object=start, may_spare_fingers=False)
            self._tasks[key] = (task, MovementVerifier(task))
        return self._tasks[key]

    def _tilted(self, path: ObjectPath, palm: FloatArray) -> Failure | None:
        """Why the palm, looking along (3,), world, at the grasp, tilts too far on the wrist's way."""
        least = min(float(-(path.wrist(share) @ palm)[2]) for share in path.wrist_shares)
        if least >= self._wrist_cos:
            return None
        tilt = float(np.rad2deg(np.arccos(np.clip(least, -1.0, 1.0))))
        text = f"the palm tilts by {tilt:.0f} degrees on the wrist's way"
        return Failure(kind="palm_tilts", text=text, numbers={"tilt_deg": tilt})

    # ---- the rest of a turn in the fingers

    def _in_fingers(self, node: _Node, goal: FloatArray) -> tuple[FloatArray, FloatArray] | None:
        """The wrist's attitude (3, 3), and the tilt (3,), rad, world, left to the fingers before.

        The tilt is what the palm, straight down at the grasp, may not make. None where nothing is
        left to the fingers, or too much.
        """
        whole = goal @ node.T_world_object.rotation.T
        upright = _upright(whole.T @ np.array([0.0, 0.0, 1.0]), np.eye(3))
        tilt = pin.log3(upright)
        angle = float(np.linalg.norm(tilt))
        rest = angle - IN_FINGERS_OF_LIMIT * self._goal_tilt
        if not (SMALLEST_TURN < rest <= MOST_IN_FINGERS) or angle < SMALLEST_TURN:
            return None
        by_fingers = rest / angle * tilt
        return whole @ pin.exp3(by_fingers).T, by_fingers

    def _turned_in_fingers(
        self, node: _Node, goal: FloatArray, place: FloatArray
    ) -> ManipulationPlan | None:
        """A movement that tilts the object in the fingers where the palm may not tilt enough."""
        left = self._in_fingers(node, goal)
        assert left is not None
        attitude, tilt = left
        angle = float(np.linalg.norm(tilt))
        task = replace(self._task, T_world_object=node.T_world_object)
        try:
            motion = plan_motion(
                task,
                axis=tilt / angle,
                angle=angle,
                path_tolerance=TILT_TOLERANCE,
                seed=self._seed,
                max_attempts=FINGER_ATTEMPTS,
                attitude=attitude,
            )
        except NoGraspFoundError as error:
            self.failures.append(Failure(kind="no_turn_in_fingers", text=str(error)))
            return None
        palm = motion.grasp.T_world_palm.rotation @ task.hand.palm_normal
        failure = pivots(motion) or self._tilted(motion.path, palm)
        if failure is None and -(attitude @ palm)[2] < self._goal_cos:
            failure = Failure(kind="palm_tilts", text="the palm tilts too far at the goal")
        if failure is not None:
            self.failures.append(failure)
            return None
        target = SE3(goal, np.array([*place, node.T_world_object.translation[2]]))
        ending = turned_ending(motion, target, None)
        return ManipulationPlan.of(motion, ending, angle=angle, shift=np.zeros(3))

    # ---- what is not reached

    def unreachable(self, k: int, goal: FloatArray) -> UnreachableError:
        """The error of a goal that is not reached, with the nearest that is."""
        place = self._task.T_world_object.translation[:2]
        failures, nearest, off = list(self.failures), None, None
        for near in self._near(goal):
            if self.chain(k, near, place) is not None:
                nearest, off = near, float(np.rad2deg(rotation_angle(near.T @ goal)))
                break
        why = Counter(f.text for f in failures).most_common(1)
        limits = [self._why_not(k, goal), *(f"{n} x {text}" for text, n in why)]
        told = "none near it is" if nearest is None else f"the nearest that is reached is {off:.0f} degrees off"
        if nearest is not None:
            rpy = ", ".join(f"{v:.0f}" for v in np.rad2deg(pin.rpy.matrixToRpy(nearest)))
            told += f" (roll, pitch, yaw {rpy} degrees)"
        return UnreachableError(
            f"{self._task.hand.name} does not bring {self._task.object.name} to this goal: "
            f"{'; '.join(filter(None, limits))}; {told}. Give another goal, a larger tilt of the "
            "palm, more friction or other fingers",
            nearest,
            off,
        )

    def _why_not(self, k: int, goal: FloatArray) -> str:
        """How many grasps what kind of limit keeps from a goal."""
        road, down = self._roadmap, -goal[2]
        if self._put_down and self._stable(goal) is None:
            return "the object does not stand as it is turned there"
        weak = road.forces_towards(down) > MOST_PRESS
        tilted = road.palms @ down < self._goal_cos
        return (
            f"of {len(road)} grasps {int(tilted.sum())} have the palm tilted too far there, "
            f"{int((weak & ~tilted).sum())} more do not bear the weight, and the stable poses of "
            "the others are not reached or their movements fail"
        )

    def _near(self, goal: FloatArray) -> Iterator[FloatArray]:
        """Rotations near a goal for which the roadmap has grasps, the nearest first; a few."""
        if self._put_down:
            ups = [_upright(pose.rotation[2], goal) for pose in self._poses]
            yield from (up @ goal for up in sorted(ups, key=rotation_angle)[:NEAREST_TRIED])
            return
        rng, road, tried = np.random.default_rng(0), self._roadmap, 0
        axes = rng.normal(size=(NEAR_TURNS, 3))
        axes /= np.linalg.norm(axes, axis=1, keepdims=True)
        for angle in np.arange(NEAR_STEP, np.pi + NEAR_STEP / 2, NEAR_STEP):
            for axis in axes:
                near = pin.exp3(angle * axis) @ goal
                able = road.palms @ -near[2] >= self._goal_cos
                if (able & (road.forces_towards(-near[2]) <= MOST_PRESS)).any():
                    yield near
                    tried += 1
                    break
            if tried == NEAREST_TRIED:
                return


ROUNDING = 1e-9
"""Rounding of a cosine."""

SMALLEST_TURN = np.deg2rad(1.0)
"""Tilt (rad) below which nothing is left to the fingers."""

IN_FINGERS_OF_LIMIT = 0.5
"""Share (-) of the palm's tilt that the wrist uses where the fingers turn too: grasps from above are
tilted themselves."""

GOOD_MARGIN = 0.15
"""Margin of closure (-) from which on a grasp costs nothing more, as in ``single_stroke``."""
