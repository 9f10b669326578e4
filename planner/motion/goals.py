"""``plan_reorientation``: an object from the table to any goal rotation, held there or put down.

    plan = plan_reorientation("allegro_hand", parse_object("box"), R_world_goal)
    manipulate(plan).goal_reached

The result is a ``ManipulationPlan``, or a chain of them (``then``): pick the object up from a
stable pose, turn hand and object by the wrist, and hold it there, turn it further in the fingers,
or set it down on another face, from where the next one picks it up.

The search goes through stable poses from the cheapest on: every movement costs 1, and as much more
as its grasp is worse. Which grasps there are, and which serve two poses, the ``Roadmap`` tells;
each movement is verified when it is its turn, as any movement is: on the table as a grasp, at the
knots with gravity as it is every ``WRIST_STEP`` of the wrist's way, and where it sets down as a
grasp again, whose approach is the way out.
"""

from __future__ import annotations

import heapq
import itertools
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from planner.arrays import checked_number
from planner.errors import TaskError, UnreachableError
from planner.hands.hand import Hand
from planner.motion.ending import FLAT
from planner.motion.goal_moves import ROUNDING, GoalMoves, upright
from planner.motion.path import check_place, checked_rotation
from planner.motion.plan import ManipulationPlan
from planner.motion.roadmap import LEAST_TILT_DEG, ROADMAP_S, poses_of, roadmap_for
from planner.motion.single_stroke import GOOD_MARGIN
from planner.motion.task import manipulation_task
from planner.motion.verify import MOST_PRESS
from planner.numerics.kernels import planning_time
from planner.objects import GraspObject
from planner.search.attempt import check_seed
from planner.spatial import SE3, FloatArray, rotation_angle
from planner.task import GraspTask

__all__ = ["plan_reorientation"]

MU = 0.45
"""Friction (-) that is believed, as of other manipulations on the command line."""

ANY_TILT = float(np.pi)
"""Tilt (rad) of the palm from straight down that excludes nothing."""

STANDS, LOWEST = np.deg2rad(3.0), 0.005
"""Largest angle (rad) of a given start from its stable pose, and largest distance (m) of its lowest
point from the table: a pose that was read is off by less, and an object farther off topples."""

FORCE_COST, WRIST_COST, MARGIN_COST = 0.3, 0.2, 0.4
"""What a movement costs more (-) if a finger presses with ``MOST_PRESS``, if the wrist turns by
half a turn, and if the grasp closes without a margin: together less than another movement."""

FINGER_COST = 1.0
"""What a turn in the fingers costs (-) beside the movement that it is part of: as much as another
one, since it takes longer to plan and to make."""

NEAR_STEP, NEAR_TURNS, NEAREST_TRIED = np.deg2rad(5.0), 64, 4
"""Angles (rad) and number of axes at which rotations near a goal that is not reached are looked at,
and how many of them are planned."""


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
        max_cpu_s: CPU time (s) after which building the roadmap ends, once per hand and object; one
            that was cut short is not kept.
        tell: Called with one line where the roadmap is built.

    Returns:
        The first movement; ``chain`` are all of them. The last ends in the attitude in which it
        reaches the goal (``Ending.turned``).

    Raises:
        UnreachableError: No sequence reaches the goal; tells the nearest rotation that one does,
            or, of a goal to put down in which the object topples, the nearest in which it stands.
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
    if put_down and _stable(poses, rotation) is None:
        raise _topples(task, poses, rotation)
    roadmap = roadmap_for(task, seed=seed, max_cpu_s=max_cpu_s, tell=tell)
    begin = planning_time()
    moves = GoalMoves(task, roadmap, goal_tilt=goal_tilt, wrist_tilt=wrist_tilt, seed=seed)
    search = _Search(moves, poses, put_down=put_down)
    x, y = start.translation[:2] if place is None else place
    found = search.chain(k, rotation, np.array([x, y]))
    if found is None:
        raise search.unreachable(k, rotation)
    spent = planning_time() - begin
    record = replace(found[0].record, seed=seed, attempts=moves.verified, cpu_s=spent)
    found[0] = replace(found[0], record=record)
    plan = found.pop()
    while found:
        plan = replace(found.pop(), then=plan)
    return plan


def _standing(task: GraspTask, poses: Sequence[SE3]) -> int:
    """Number of the stable pose that a task's object stands in.

    Raises:
        TaskError: It stands in none, or not on the table.
    """
    start = task.T_world_object
    off = [rotation_angle(upright(pose.rotation[2], start.rotation)) for pose in poses]
    k = int(np.argmin(off))
    lowest = task.lowest_point(start)
    if off[k] > STANDS or abs(lowest - (task.table_height or 0.0)) > LOWEST:
        raise TaskError(
            f"{task.object.name} does not stand on the table as it is given: it is turned by "
            f"{np.rad2deg(off[k]):.1f} degrees from its nearest stable pose, and its lowest point "
            f"is at {1e3 * lowest:.1f} mm; give T_world_object in one of its {len(poses)} poses "
            f"that do not fall at a tilt of {LEAST_TILT_DEG:g} degrees, as resting_pose of the "
            "object gives it"
        )
    return k


def _stable(poses: Sequence[SE3], goal: FloatArray) -> int | None:
    """Number of the stable pose that a rotation is, whatever its heading; None for none."""
    level = [float(pose.rotation[2] @ goal[2]) for pose in poses]
    k = int(np.argmax(level))
    return k if level[k] > FLAT else None


def _standing_near(poses: Sequence[SE3], goal: FloatArray) -> list[FloatArray]:
    """Rotations in which an object stands, one per stable pose, the nearest to a goal first."""
    turns = [upright(pose.rotation[2], goal) for pose in poses]
    return [turn @ goal for turn in sorted(turns, key=rotation_angle)]


def _topples(task: GraspTask, poses: Sequence[SE3], goal: FloatArray) -> UnreachableError:
    """The error of a goal to put down in which the object does not stand, whatever grasps it."""
    near = _standing_near(poses, goal)[0]
    off = float(np.rad2deg(rotation_angle(near.T @ goal)))
    return UnreachableError(
        f"{task.object.name} does not stand as it is turned there, and would topple when it is put "
        f"down; the nearest rotation in which it stands is {off:.0f} degrees off ({_rpy(near)}). "
        "Give that one, or have it held at the goal instead",
        near,
        off,
    )


def _rpy(rotation: FloatArray) -> str:
    """A rotation as a message tells it."""
    rpy = np.rint(np.rad2deg(pin.rpy.matrixToRpy(rotation))) + 0.0
    return f"roll, pitch, yaw {', '.join(f'{v:g}' for v in rpy)} degrees"


@dataclass(frozen=True, kw_only=True)
class _Node:
    """The object standing in a stable pose, by movements made before."""

    pose: int
    T_world_object: SE3
    before: tuple[ManipulationPlan, ...] = ()


@dataclass(order=True)
class _Edge:
    """A movement that is not made yet, and the pose that it sets down in; None of the last one."""

    cost: float
    number: int
    make: Callable[[], ManipulationPlan | None]
    node: _Node
    after: tuple[int, SE3] | None


class _Search:
    """A search for a sequence of movements."""

    def __init__(self, moves: GoalMoves, poses: Sequence[SE3], *, put_down: bool) -> None:
        self._moves, self._poses, self._put_down = moves, poses, put_down
        self._road = moves.roadmap
        self._reached: set[int] = set()

    def chain(self, k: int, goal: FloatArray, place: FloatArray) -> list[ManipulationPlan] | None:
        """The cheapest chain from a stable pose to a goal at a place (2,); None for none."""
        numbers, reached = itertools.count(), {k}
        self._reached = reached
        first = _Node(pose=k, T_world_object=self._moves.task.T_world_object)
        heap = list(self._edges(first, goal, place, 0.0, numbers))
        heapq.heapify(heap)
        while heap:
            edge = heapq.heappop(heap)
            if edge.after is not None and edge.after[0] in reached:
                continue
            made = edge.make()
            if made is None:
                continue
            before = (*edge.node.before, made)
            if edge.after is None:
                return list(before)
            j, there = edge.after
            reached.add(j)
            node = _Node(pose=j, T_world_object=there, before=before)
            for further in self._edges(node, goal, place, edge.cost, numbers):
                heapq.heappush(heap, further)
        return None

    def _edges(
        self,
        node: _Node,
        goal: FloatArray,
        place: FloatArray,
        cost: float,
        numbers: Iterator[int],
    ) -> Iterator[_Edge]:
        """All movements from a stable pose: to the goal, and to other poses."""
        moves, start = self._moves, node.T_world_object
        target = self._target(start, goal, place)
        if len(able := self._to_goal(node, goal)):
            make = partial(moves.best, start, able, target, stands=self._put_down)
            whole = cost + self._cost(start, able[0], goal)
            yield _Edge(whole, next(numbers), make, node, None)
        if not self._put_down and moves.left_to_fingers(start, goal) is not None:
            make = partial(moves.turned_in_fingers, start, goal, target)
            yield _Edge(cost + 1.0 + FINGER_COST, next(numbers), make, node, None)
        for j, pose in enumerate(self._poses):
            there = _set_down(start, pose)
            limit = moves.wrist_tilt
            able = self._able(node, there.rotation, limit, self._road.stands[:, j])
            if j != node.pose and len(able):
                make = partial(moves.best, start, able, there, stands=True)
                whole = cost + self._cost(start, able[0], there.rotation)
                yield _Edge(whole, next(numbers), make, node, (j, there))

    def _target(self, start: SE3, goal: FloatArray, place: FloatArray) -> SE3:
        """Pose of the object at its goal, on the table or at the height of the grasp."""
        j = _stable(self._poses, goal) if self._put_down else None
        if j is None:
            return SE3(goal, np.array([*place, start.translation[2]]))
        pose = self._poses[j]
        return SE3(upright(pose.rotation[2], goal) @ goal, np.array([*place, pose.translation[2]]))

    # ---- grasps for a movement, the most promising first

    def _to_goal(self, node: _Node, goal: FloatArray) -> list[int]:
        """Grasps that reach the goal from a stable pose, as far as the roadmap knows."""
        j = _stable(self._poses, goal) if self._put_down else node.pose
        return self._able(node, goal, self._moves.goal_tilt, self._road.stands[:, j])

    def _able(
        self, node: _Node, turned: FloatArray, tilt: float, among: NDArray[np.bool_]
    ) -> list[int]:
        """Grasps ``among`` (m,) that pick up in a pose, and bear the weight with the object turned.

        The palm may tilt by ``tilt`` (rad) then, and by the wrist's limit at the grasp.
        """
        road, moves, start = self._road, self._moves, node.T_world_object
        here, there = (road.palms @ -turn[2] for turn in (start.rotation, turned))
        able = among & road.stands[:, node.pose] & (there >= np.cos(tilt) - ROUNDING)
        able &= here >= np.cos(moves.wrist_tilt) - ROUNDING
        able &= road.forces_towards(-turned[2]) <= MOST_PRESS
        cost = {int(g): self._cost(start, int(g), turned) for g in np.flatnonzero(able)}
        return sorted(cost, key=lambda g: cost[g])

    def _cost(self, start: SE3, grasp: int, turned: FloatArray) -> float:
        """Cost (-) of a movement by a grasp to a rotation of the object."""
        road = self._road
        downs = (-start.rotation[2], -turned[2])
        force = max(float(road.forces_towards(down)[grasp]) for down in downs) / MOST_PRESS
        wrist = rotation_angle(turned @ start.rotation.T) / np.pi
        lacks = 1.0 - min(1.0, float(road.margins[grasp]) / GOOD_MARGIN)
        return 1.0 + FORCE_COST * min(force, 1.0) + WRIST_COST * wrist + MARGIN_COST * lacks

    # ---- unreachable goals

    def unreachable(self, k: int, goal: FloatArray) -> UnreachableError:
        """The error of a goal that is not reached, with the nearest that is."""
        task, place = self._moves.task, self._moves.task.T_world_object.translation[:2]
        on_reached = np.asarray(self._road.stands[:, sorted(self._reached)].any(axis=1))
        why = Counter(f.text for f in self._moves.failures).most_common(1)
        limits = [self._limit(goal, on_reached), *(f"{n} x {text}" for text, n in why)]
        near = next((r for r in self._near(goal, on_reached) if self.chain(k, r, place)), None)
        off = None if near is None else float(np.rad2deg(rotation_angle(near.T @ goal)))
        told = "none near it is reached"
        if near is not None:
            told = f"the nearest that is reached is {off:.0f} degrees off ({_rpy(near)})"
        return UnreachableError(
            f"{task.hand.name} does not bring {task.object.name} to this goal: "
            f"{'; '.join(limits)}; {told}. Give another goal, a larger tilt of the palm, more "
            "friction or other fingers",
            near,
            off,
        )

    def _limit(self, goal: FloatArray, on_reached: NDArray[np.bool_]) -> str:
        """How many grasps what kind of limit keeps from a goal."""
        road, moves, poses = self._road, self._moves, self._poses
        down, tilts = -goal[2], np.rad2deg([moves.wrist_tilt, moves.goal_tilt])
        least_here, least = np.cos(np.deg2rad(tilts)) - ROUNDING
        here = np.column_stack(
            [
                road.stands[:, j] & (road.palms @ -poses[j].rotation[2] >= least_here)
                for j in sorted(self._reached)
            ]
        ).any(axis=1)
        left = on_reached.copy()
        told: list[str] = []
        for kept, what in (
            (here, f"have the palm tilted by more than {tilts[0]:.0f} degrees at the table"),
            (
                road.palms @ down >= least,
                f"have the palm tilted too far there, by over {tilts[1]:.0f}",
            ),
            (road.forces_towards(down) <= MOST_PRESS, "do not bear the weight there"),
        ):
            if n := int((left & ~kept).sum()):
                told.append(f"{n} {'more ' * bool(told)}{what}")
            left &= kept
        if left.any():
            told.append(f"movements by {'the others' if told else 'all'} fail")
        return (
            f"of {int(on_reached.sum())} grasps on the {len(self._reached)} of {len(poses)} stable "
            f"poses that are reached, {', '.join(told)}"
        )

    def _near(self, goal: FloatArray, on_reached: NDArray[np.bool_]) -> Iterator[FloatArray]:
        """Rotations near a goal for which the roadmap has grasps, the nearest first; a few."""
        if self._put_down:
            yield from _standing_near(self._poses, goal)
            return
        road, least = self._road, np.cos(self._moves.goal_tilt) - ROUNDING
        axes = np.random.default_rng(0).normal(size=(NEAR_TURNS, 3))
        axes /= np.linalg.norm(axes, axis=1, keepdims=True)
        angles = np.arange(NEAR_STEP, np.pi + NEAR_STEP / 2, NEAR_STEP)
        near = (pin.exp3(angle * axis) @ goal for angle in angles for axis in axes)

        def able(turn: FloatArray) -> bool:
            borne = road.forces_towards(-turn[2]) <= MOST_PRESS
            return bool((on_reached & (road.palms @ -turn[2] >= least) & borne).any())

        yield from itertools.islice(filter(able, near), NEAREST_TRIED)


def _set_down(now: SE3, there: SE3) -> SE3:
    """Pose of an object turned the shortest way onto the face of a stable pose, where it was."""
    turn = upright(there.rotation[2], now.rotation)
    x, y, _ = now.translation
    return SE3(turn @ now.rotation, np.array([x, y, there.translation[2]]))
