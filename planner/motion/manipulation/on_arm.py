"""``OnArm``: manipulations planned for a hand alone, made by the hand on its arm.

While the hand turns the object its base stands still. So the turn is planned for the hand without
its arm, where the arm can bring the palm, and judged again with the arm and the way in, the lift,
the carry and the way out that the arm makes.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property

import numpy as np

from planner.approach.arm_path import LIFT_HEIGHT, verify_arm_path
from planner.approach.pregrasp import way_back
from planner.collision.world import CollisionWorld
from planner.errors import HandError
from planner.failure import Failure
from planner.hand_loading import load_hand
from planner.hands.arm import read_mount
from planner.kinematics.arm_ik import reach, straight_path
from planner.kinematics.state import HandState
from planner.motion.manipulation.ending import Ending
from planner.motion.plan import MotionPlan
from planner.motion.release import standing
from planner.motion.verify import MotionVerifier, Waypoint
from planner.plan import SolveRecord
from planner.spatial import SE3, FloatArray
from planner.task import GraspTask
from planner.verification.grasp import verify_grasp

SPARE = 0.02
"""How much farther (m) than planned the arm must reach at the target: the object lies in the hand
by some millimetres and degrees otherwise than planned, and the hand makes up for that."""


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

    def reaches(self, T_world_base: SE3, q: FloatArray) -> bool:
        """Whether the arm brings the palm there that the hand alone has at a base pose and q."""
        return self._reached(self.alone, T_world_base, q) is not None

    def carried(self, motion: MotionPlan) -> MotionPlan | Failure:
        """A motion of the hand alone with the arm below it, judged again; or why it fails."""
        alone = motion.grasp.task
        arm = self._reached(alone, motion.T_world_base, motion.grasp.q)
        if arm is None:
            return Failure(
                kind="out_of_reach", text="the arm cannot bring the palm to where the motion is"
            )
        hand = self._task.hand.rolling if alone.hand.rolls else self._task.hand
        task = replace(alone, hand=hand, T_world_base=self._root)
        postures = np.tile(arm, (len(motion.knots), 1))
        postures[:, self._columns] = [knot.q for knot in motion.knots]
        verifier = MotionVerifier(task)
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
        return replace(motion, grasp=grasp, knots=knots)

    def blocked(self, motion: MotionPlan, ending: Ending) -> Failure | None:
        """Why the arm cannot carry the object to where it is put down; None if it can."""
        end = motion.knots[0 if ending.back else -1]
        there = motion.grasp.task if ending.back else standing(motion)
        if isinstance(there, Failure):
            return there
        world, hand, now = CollisionWorld(there), there.hand, np.array(end.q)
        to = ending.T_world_target.translation - end.T_world_object.translation
        up = np.array([0.0, 0.0, LIFT_HEIGHT])
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

    def _reached(self, task: GraspTask, T_world_base: SE3, q: FloatArray) -> FloatArray | None:
        """All joints (nq,) with the arm where it brings the palm there; None if it cannot."""
        T_world_palm = T_world_base * HandState(task.hand, q).T_base_palm
        whole = np.array(self._first)
        whole[self._columns] = q
        reached = reach(self._task.hand, self._root.inverse() * T_world_palm, whole)
        return reached.q if reached.there else None

    @cached_property
    def _first(self) -> FloatArray:
        """Joints (nq,) with the arm ready."""
        q = np.array(self._task.hand.neutral)
        arm = self._task.hand.arm
        assert arm is not None
        q[arm.index] = arm.ready
        return q
