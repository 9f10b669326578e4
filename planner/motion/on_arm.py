"""``OnArm``: manipulations planned for a hand alone, made by the hand on its arm.

While the hand turns the object its base stands still. So the turn is planned for the hand without
its arm, where the arm can bring the palm, and judged again with the arm and the way in, the lift,
the carry and the way out that the arm makes.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import cached_property, partial

import numpy as np
import pinocchio as pin

from planner.collision.arm_path import LIFT_HEIGHT, verify_arm_path
from planner.collision.pregrasp import way_back
from planner.collision.world import CollisionWorld
from planner.errors import HandError, TaskError
from planner.failure import Failure
from planner.hand_loading import load_hand
from planner.hands.arm import read_mount
from planner.hands.hand import Hand
from planner.kinematics import HandState, follow, palm_paths, palm_pose, reach, straight_path
from planner.motion.context import OUT_OF_REACH, Reaches
from planner.motion.ending import standing
from planner.motion.path import (
    UNTURNED,
    AnyAttitude,
    ObjectPath,
    checked_attitude,
)
from planner.motion.phase import Ending
from planner.motion.plan import MovementPlan, rise_for
from planner.motion.verify import MovementVerifier, Waypoint
from planner.plan import SolveRecord
from planner.spatial import SE3, FloatArray, rotation_angle, shifted
from planner.synthesis.problem import Start
from planner.synthesis.seeds import turning_seeder_for
from planner.task import GraspTask
from planner.verification import verify_grasp

NOMINAL = 12
"""Number of palm poses that are drawn to find the attitudes that an arm reaches."""

ARM_CLEARANCE = 5e-3
"""Distance (m) that an arm keeps from everything while it turns the wrist. With none planned a link
met the table with 3.4 N."""

HEADINGS = np.arange(4) * np.pi / 2
"""Turns (rad) about the vertical of the axis of a named attitude."""

POSTURES = 8
"""Postures of the arm at a grasp of which one is to bring the hand to its attitude."""

SHORT = 1e-4
"""How much less (rad) than half a turn an arm turns the palm up, so that it may go either way
around."""

SPARE = 0.02
"""How much farther (m) than planned the arm must reach at the target: the object lies in the hand
by some millimetres and degrees otherwise than planned, and the hand makes up for that."""


def carried_ways(
    task: GraspTask, attitude: AnyAttitude
) -> Iterator[tuple[GraspTask, FloatArray, OnArm | None, Reaches | None]]:
    """What to plan for in turn: one entry, or one for each attitude that an arm can choose from.

    Yields:
        The task of the hand alone, the attitude (3, 3), the arm, and what the arm reaches; None
        where the base is free.

    Raises:
        HandError: As ``OnArm``.
        TaskError: As ``OnArm.headed``.
    """
    asked = checked_attitude(attitude)
    if task.hand.arm is None:
        yield task, asked, None, None
        return
    on_arm = OnArm(task)
    for turned in on_arm.headed(asked, free=isinstance(attitude, str)):
        there = turned if rotation_angle(turned) > UNTURNED else None
        yield on_arm.alone, turned, on_arm, partial(on_arm.reaches, turned=there)


class OnArm:
    """The arm of one task.

    Attributes:
        alone: The task for the hand alone, whose base is free.
    """

    def __init__(self, task: GraspTask) -> None:
        """Take the hand off its arm.

        Raises:
            HandError: The hand was not loaded from a description of a hand on an arm.
        """
        mount = None if task.hand.path is None else read_mount(task.hand.path)
        if mount is None or task.T_world_base is None:
            raise HandError(
                f"{task.hand.name} is on an arm that no description tells of; load it from its "
                "hand.toml, which names the hand alone"
            )
        self._task, self._root = task, SE3(task.T_world_base)
        hand = load_hand(mount.hand_path)
        self._columns = [task.hand.joint_names.index(name) for name in hand.joint_names]
        if task.hand.rolls:
            hand = hand.rolling
        self.alone = replace(task, hand=hand, T_world_base=None)

    def reaches(self, T_world_base: SE3, q: FloatArray, turned: FloatArray | None = None) -> bool:
        """Whether the arm brings the palm there that the hand alone has at a base pose and q.

        With an attitude (3, 3) also along the way there, straight up and around the object, with
        its links clear wherever forces are verified.
        """
        return self._posture(T_world_base, q, turned) is not None

    def _posture(
        self, T_world_base: SE3, q: FloatArray, turned: FloatArray | None
    ) -> FloatArray | None:
        """All joints (nq,) with the arm where it does what ``reaches`` asks for; None if none do.

        An arm with a joint to spare has many postures for one pose of the palm; some are drawn.
        """
        wanted = self._root.inverse() * T_world_base * HandState(self.alone.hand, q).T_base_palm
        hand, whole = self._task.hand, np.array(self._first)
        whole[self._columns] = q
        found = reach(hand, wanted, whole)
        if not found.there:
            return None
        if turned is None or self._turns(found.q, turned):
            return found.q
        rng, index = np.random.default_rng(0), hand.arm_index
        for _ in range(POSTURES - 1):
            whole[index] = rng.uniform(hand.q_lower[index], hand.q_upper[index])
            found = follow(hand, wanted, whole)
            if found.there and self._turns(found.q, turned):
                return found.q
        return None

    def _turns(self, q: FloatArray, turned: FloatArray) -> bool:
        """Whether the arm goes from joints (nq,) to an attitude, with its links clear there."""
        now, path = q.copy(), ObjectPath.of_wrist(turned)
        center = self._task.T_world_object.translation
        up = np.array([0.0, 0.0, rise_for(self._task, self._root, [q], path)])
        turns = [path.wrist(share) for share in path.wrist_shares]
        stops = [SE3(turn, center - turn @ center + up) * self._root for turn in turns]
        ways = arm_way(self._task.hand, self._root, q, stops)
        for pose, way in zip(stops, ways, strict=False):  # ways end where there is none
            if way is None:
                return False
            now[self._task.hand.arm_index] = way[-1]
            held = pose * self._root.inverse() * self._task.T_world_object
            nearest = self._world.nearest_on_arm(self._root, now, T_world_object=held)
            if nearest.distance < ARM_CLEARANCE:
                return False
        return True

    def headed(self, attitude: FloatArray, *, free: bool) -> list[FloatArray]:
        """Attitudes that the arm reaches, that from most palm poses first.

        Args:
            attitude: Rotation (3, 3), world.
            free: Whether the horizontal axis of the turn may be another.

        Raises:
            TaskError: It reaches none.
        """
        if rotation_angle(attitude) <= UNTURNED:
            return [attitude]
        turns = [pin.exp3(np.array([0.0, 0.0, h])) for h in HEADINGS[: None if free else 1]]
        seeder, rng = turning_seeder_for(self.alone), np.random.default_rng(0)
        starts = [seeder.draw(rng) for _ in range(NOMINAL)]
        poses = [
            (self._task.T_world_object * start.T_object_base, start.q)
            for start in starts
            if isinstance(start, Start)
        ]
        able = [pose for pose in poses if self.reaches(*pose)]
        about = pin.log3(attitude)
        if free:
            about *= min(1.0, (np.pi - SHORT) / float(np.linalg.norm(about)))
        found = [pin.exp3(turn @ about) for turn in turns]
        reached = [sum(self.reaches(*pose, turned) for pose in able) for turned in found]
        if not any(reached):
            raise TaskError(
                f"{self._task.hand.name} does not reach the attitude: of {len(able)} palm poses "
                "over the object that it reaches it turns none there, lifted clear of the table; "
                "give another attitude, or T_world_base, the pose of the arm's root"
            )
        best_first = np.argsort(-np.array(reached), kind="stable").tolist()
        return [found[k] for k in best_first if reached[k]]

    def carried(self, motion: MovementPlan) -> MovementPlan | Failure:
        """A motion of the hand alone with the arm below it, judged again; or why it fails."""
        alone = motion.grasp.task
        turned = motion.path.attitude if motion.path.turns_wrist else None
        arm = self._posture(motion.T_world_base, motion.grasp.q, turned)
        if arm is None:
            return Failure(
                kind=OUT_OF_REACH,
                text="the arm cannot bring the palm to where the motion is and turn it there",
            )
        hand = self._task.hand.rolling if alone.hand.rolls else self._task.hand
        task = replace(alone, hand=hand, T_world_base=self._root)
        postures = np.tile(arm, (len(motion.knots), 1))
        postures[:, self._columns] = [knot.q for knot in motion.knots]
        verifier = MovementVerifier(task)
        grasp = verify_grasp(
            task,
            self._root,
            postures[0],
            record=SolveRecord(
                iterations=motion.record.iterations, status="motion", objective="motion"
            ),
        )
        if isinstance(grasp, Failure):
            return grasp.at("start, with the arm")
        waypoints = [
            Waypoint(
                path_parameter=knot.path_parameter,
                T_object_base=knot.T_world_object.inverse() * self._root,
                q=q,
            )
            for knot, q in zip(motion.knots, postures, strict=True)
        ]
        knots = verifier.verify_knots(self._root, waypoints, motion.path, motion.path_tolerance)
        if isinstance(knots, Failure):
            return knots.at("with the arm")
        stroke = replace(motion.with_knots(knots), grasp=grasp)
        height = max(LIFT_HEIGHT, stroke.rise)
        if stroke.path.turns_wrist and (stuck := lifted_blocked(stroke, height)):
            return stuck
        repeated = verifier.repeated(stroke, motion.cycles)
        return repeated.at("with the arm") if isinstance(repeated, Failure) else repeated

    def blocked(self, motion: MovementPlan, ending: Ending) -> Failure | None:
        """Why the arm cannot carry the object to where it is put down; None if it can."""
        end = motion.knots[0 if ending.back else -1]
        there = motion.grasp.task if ending.back else standing(motion)
        if isinstance(there, Failure):
            return there
        world, hand, now = CollisionWorld(there), there.hand, np.array(end.q)
        lift = max(LIFT_HEIGHT, motion.rise)
        # back from the attitude the arm is in another posture than it was lifted in
        if motion.path.turns_wrist and (stuck := lifted_blocked(motion, lift, (), ending)):
            return stuck
        to = ending.T_world_target.translation - end.T_world_object.translation
        up = np.array([0.0, 0.0, lift])
        assert ending.release is not None  # it ends on the table
        out = way_back(hand, self._root, ending.release)
        away = ending.T_world_target.translation - self._root.translation
        away[2] = 0.0
        for what, shift in (
            ("lift the object after the turn", up),
            ("carry the object to where it is put down", np.array([to[0], to[1], 0.0])),
            ("lower the object", -up),
            ("reach further than planned", SPARE * away / max(float(np.linalg.norm(away)), 1e-9)),
            ("leave the object", out),
        ):
            path = straight_path(hand, now, self._root.rotation.T @ shift)
            if path is None:
                text = f"the arm cannot {what} within its limits"
                return Failure(kind="arm_unreachable", text=text)
            if shift is not out and (
                touched := verify_arm_path(world, self._root, end.q, path, clearance=0.0, held=True)
            ):
                return touched.at(what)
            now[hand.arm_index] = path[-1]
        return None

    @cached_property
    def _world(self) -> CollisionWorld:
        return CollisionWorld(self._task)

    @cached_property
    def _first(self) -> FloatArray:
        """Joints (nq,) with the arm ready."""
        q = np.array(self._task.hand.neutral)
        arm = self._task.hand.arm
        assert arm is not None
        q[arm.index] = arm.ready
        return q


def arm_way(
    hand: Hand, root: SE3, q: FloatArray, poses: Sequence[SE3]
) -> Iterator[FloatArray | None]:
    """Arm postures (m, n) on a hand's way to each pose in turn; None, last, where there are none.

    Args:
        hand: On an arm.
        root: Pose of the arm's root.
        q: Joints (nq,) where the way begins.
        poses: Of a base that moves with the palm, and that is at the root where the way begins.
    """
    T_root_palm = palm_pose(hand, q)
    return palm_paths(hand, q, [root.inverse() * pose * T_root_palm for pose in poses])


def lifted_blocked(
    motion: MovementPlan,
    height: float,
    via: Sequence[tuple[float, float]] = (),
    ending: Ending | None = None,
) -> Failure | None:
    """Why an arm cannot turn a lifted hand to its attitude and carry it on; None if it can.

    Args:
        motion: Of a hand on an arm.
        height: How far hand and object are lifted, m.
        via: Places of the object, x and y in m, world, one after the other.
        ending: What follows at the last of them, up to above where the object is put down; nothing
            if None.
    """
    task, q, root = motion.task, motion.grasp.q, motion.grasp.T_world_base
    world = CollisionWorld(task)
    shares, there = motion.path.wrist_shares, np.array([0.0, 0.0, height])
    way = [("lift the object", 0.0, there)]
    for share in shares[1:]:
        ends = f"it ends {100 * share:.0f} % of the way there"
        way.append((f"turn the hand to the attitude: {ends}", share, there))
    held = " in the attitude" if motion.path.turns_wrist else ""
    for place in via:
        there = np.array([*place, height])
        there[:2] -= task.T_world_object.translation[:2]
        way.append((f"carry the object to {place}{held}", 1.0, there))
    if ending is not None:
        way += [("turn the hand back where it was carried", s, there) for s in shares[-2::-1]]
        end = motion.knots[0 if ending.back else -1].T_world_object.translation
        there = ending.T_world_target.translation - end + np.array([0.0, 0.0, height])
        way.append(("carry the object to where it is put down", 0.0, there))
    poses = [shifted(motion.turned_base(share), shift) for _, share, shift in way]
    paths = arm_way(task.hand, root, q, poses)
    for (what, _, _), path in zip(way, paths, strict=False):  # paths end where there is none
        if path is None:
            return Failure(kind="arm_unreachable", text=f"the arm cannot {what}")
        clearance = ARM_CLEARANCE if what.startswith("turn") else 0.0
        touched = verify_arm_path(world, root, q, path, clearance=clearance, held=True)
        if touched:
            return touched.at(what.partition(":")[0])
    return None
