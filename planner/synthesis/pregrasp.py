"""The pre-grasp and the way to it: fingers opened along the contact normals, then straight in.

Both are part of a plan: a grasp that cannot be reached without touching is no plan. The opened
fingers are the solution of a small NLP over the joints alone:

    min  sum |c_i(q) - (c_i - opening n_i)|^2 / opening^2 + POSTURE_WEIGHT |q - q_grasp|^2
    s.t. every pad opened by OPENED_SHARE of the opening at least; couplings; joint limits;
         links clear of object, table, obstacles and of each other

with c_i the pad centres of the grasp and n_i the normals into the object. Fingers that stand close
to each other may have to move sideways as well while they open.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from planner.collision import CollisionWorld
from planner.hand import Finger, Hand
from planner.kinematics import HandState
from planner.shapes import Shape
from planner.spatial import SE3, FloatArray
from planner.symbolic import SymbolicHand
from planner.synthesis.carried import (
    ArmPath,
    approach_line_fault,
    find_lift,
    lift_fault,
    path_fault,
    retreats,
)
from planner.synthesis.clearance import ClearanceTerms
from planner.synthesis.nlp import Nlp
from planner.synthesis.surfaces import SIZE_DIM, surface_of
from planner.synthesis.surroundings import Surroundings, obstacles_in_object, table_in_object
from planner.task import GraspTask

__all__ = ["Approach", "PregraspProblem", "approach_fault", "find_approach"]

OPENINGS = (0.025, 0.02, 0.015, 0.01)
"""Distances (m) by which pads are opened along the normals, tried in this order. More room absorbs
a larger error of the object's pose; less is easier to reach."""

OPENED_SHARE = 0.7
"""Share of the opening that every pad must really reach within its joint limits (-)."""

STANDOFF = 0.12
"""Length (m) of the straight approach: outside the reach of most objects for a hand."""

APPROACH_CLEARANCE = 0.001
"""Smallest distance (m) to object, table and obstacles on the way in."""

LEAST_STEP = 5e-4
"""Shortest step (m) of the check along the approach: less than the clearance it asks, so that
nothing is jumped over."""

CLOSING_SAMPLES = 12
"""Configurations checked along the closing motion: pads move about 2 mm between two of them."""

JOINT_TOL = 1e-6
"""How far (rad) couplings and joint limits may be violated: the solver's accuracy."""

POSTURE_WEIGHT = 0.05
"""Cost of moving a joint by one radian against missing the opening by all of it (-)."""

OPEN_CLEARANCE = 0.003
"""Distance (m) that links keep from object, table and obstacles at the pre-grasp."""

FINGER_CLEARANCE = 0.002
"""Distance (m) that fingers keep from each other at the pre-grasp."""

MAX_ITERATIONS = 40


@dataclass(frozen=True, kw_only=True)
class Approach:
    """How the hand gets to a grasp.

    Attributes:
        q: Pre-grasp joints (nq,), pads opened along the normals.
        opening: By how much, m.
        T_world_base_start: Base pose from which it moves straight to the grasp with ``q``.
        arm: The way in and the lift of the arm that carries the hand; its root stays.
    """

    q: FloatArray
    opening: float
    T_world_base_start: SE3
    arm: ArmPath | None = None


class PregraspProblem:
    """The NLP of the opened fingers: built once per hand, fingers and kind of shape."""

    def __init__(
        self, hand: Hand, fingers: Sequence[Finger], kind_of: Shape, n_obstacles: int = 0
    ) -> None:
        """Build it; arguments as in ``build_problem``."""
        self.hand, self.fingers = hand, tuple(fingers)
        self.surface = surface_of(kind_of)
        n = len(self.fingers)
        q, q_grasp = ca.SX.sym("q", hand.nq), ca.SX.sym("q_grasp", hand.nq)
        rotation, shift = ca.SX.sym("R", 3, 3), ca.SX.sym("t", 3)
        size = ca.SX.sym("size", SIZE_DIM)
        surroundings = Surroundings(n_obstacles)
        begin, inward = ca.SX.sym("c", 3, n), ca.SX.sym("n", 3, n)
        opening = ca.SX.sym("opening")
        symbolic = SymbolicHand(hand, q)
        moved = [
            rotation @ symbolic.point(f.pad.joint_id, f.pad.center) + shift - begin[:, i]
            for i, f in enumerate(self.fingers)
        ]
        miss = [m + opening * inward[:, i] for i, m in enumerate(moved)]
        cost = sum(ca.sumsqr(m) for m in miss) / opening**2
        cost += POSTURE_WEIGHT * ca.sumsqr(q - q_grasp)
        matrix, value = hand.coupling_matrix
        equal = [ca.DM(matrix) @ q - value] if len(value) else []
        links = ClearanceTerms(symbolic, rotation, shift)
        above = [-ca.dot(m, inward[:, i]) / opening - OPENED_SHARE for i, m in enumerate(moved)]
        above += links.from_object(self.surface, size, [], OPEN_CLEARANCE, OPEN_CLEARANCE)
        above += surroundings.from_table(links, OPEN_CLEARANCE)
        above += surroundings.from_obstacles(links, OPEN_CLEARANCE)
        above += links.between_fingers(FINGER_CLEARANCE)
        self._upper = np.concatenate([np.zeros(len(value)), np.full(len(above), np.inf)])
        self.nlp = Nlp(
            "pregrasp",
            x=q,
            p=ca.vertcat(
                q_grasp,
                ca.vec(rotation),
                shift,
                size,
                surroundings.symbols,
                ca.vec(begin),
                ca.vec(inward),
                opening,
            ),
            cost=cost,
            g=ca.vertcat(*equal, *above),
            options={
                "ipopt.max_iter": MAX_ITERATIONS,
                "ipopt.tol": 1e-3,
                "ipopt.constr_viol_tol": 1e-6,
                "ipopt.mu_init": 1e-3,
            },
            points=self.surface.field,
        )

    def solve(
        self,
        task: GraspTask,
        T_world_base: SE3,
        q: FloatArray,
        normals: FloatArray,
        opening: float,
    ) -> FloatArray | None:
        """Joints (nq,) with the pads ``opening`` (m) back along the normals (n, 3, world).

        None where the limits or something in the way forbid it.
        """
        hand = self.hand
        to_object = task.T_world_object.inverse()
        T = to_object * T_world_base
        state = HandState(hand, q)
        begin = np.array([T.act(state.pad_center(f)) for f in self.fingers])
        parts: list[Any] = [
            q,
            np.array(T.rotation).ravel(order="F"),
            T.translation,
            self.surface.size(task.object.shape),
            Surroundings.values(table_in_object(task), obstacles_in_object(task)),
            begin.ravel(),
            (normals @ task.T_world_object.rotation).ravel(),
            [opening],
        ]
        lower, upper = hand.q_lower.copy(), hand.q_upper.copy()
        held = np.concatenate([hand.wrist_index, hand.arm_index])
        lower[held] = upper[held] = q[held]
        x, stats = self.nlp.bind(self.surface.field_of(task.object.shape))(
            x0=q, p=np.concatenate(parts), lbx=lower, ubx=upper, lbg=0, ubg=self._upper
        )
        if not stats["success"]:
            return None
        opened: FloatArray = np.clip(x, lower, upper)
        return opened


def find_approach(
    world: CollisionWorld,
    problem: PregraspProblem,
    T_world_base: SE3,
    q: FloatArray,
    normals: FloatArray,
) -> Approach | str:
    """A pre-grasp and a straight way in that touch nothing; or why there is none.

    Args:
        world: True geometry of the task.
        problem: The NLP for its hand, fingers and shape.
        T_world_base: Base pose of the grasp.
        q: Joints of the grasp (nq,).
        normals: Contact normals into the object (n, 3), world.
    """
    reason = "the fingers cannot open along the contact normals"
    carried = world.task.hand.arm is not None
    lift = find_lift(world, T_world_base, q) if carried else None
    if isinstance(lift, str):
        return lift
    for opening in OPENINGS:
        opened = problem.solve(world.task, T_world_base, q, normals, opening)
        if opened is None:
            continue
        for approach in _ways_in(world, T_world_base, opened, opening, lift):
            reason = _way_in_fault(world, T_world_base, q, approach)
            if not reason:
                return approach
    return reason


def approach_fault(
    world: CollisionWorld, T_world_base: SE3, q: FloatArray, approach: Approach
) -> str:
    """What is wrong with an approach, "" if nothing is.

    The straight way in is checked without a gap: from a pose with clearance d the hand may move by
    d less ``APPROACH_CLEARANCE`` before it could touch. Closing is sampled, all fingers in step.
    An arm's lift is looked at too.
    """
    fault = _way_in_fault(world, T_world_base, q, approach)
    if fault or approach.arm is None:
        return fault
    return lift_fault(world, T_world_base, q, approach.arm.lift)


def _way_in_fault(
    world: CollisionWorld, T_world_base: SE3, q: FloatArray, approach: Approach
) -> str:
    """What is wrong with pre-grasp, way in and closing, "" if nothing is."""
    hand = world.task.hand
    outside = np.maximum(hand.q_lower - approach.q, approach.q - hand.q_upper).max()
    matrix, value = hand.coupling_matrix
    if outside > JOINT_TOL or np.abs(matrix @ approach.q - value).max(initial=0.0) > JOINT_TOL:
        return "the pre-grasp violates a joint limit or a coupling"
    if hand.arm is not None:
        fault = _carried_fault(world, T_world_base, q, approach)
    elif approach.arm is not None:
        fault = "there are paths of an arm, but the hand is not on one"
    else:
        fault = _straight_fault(world, T_world_base, approach)
    if fault:
        return fault
    for s in np.linspace(1.0, 0.0, CLOSING_SAMPLES, endpoint=False):
        touching = world.touching(T_world_base, q + s * (approach.q - q))
        if touching is not None:
            return f"the fingers touch while they close: {touching}"
    return ""


def _carried_fault(
    world: CollisionWorld, T_world_base: SE3, q: FloatArray, approach: Approach
) -> str:
    """What is wrong with the paths of the arm, "" if nothing is."""
    hand, arm = world.task.hand, approach.arm
    if arm is None:
        return "the arm's way in and lift are missing"
    if not np.allclose(approach.T_world_base_start.homogeneous, T_world_base.homogeneous):
        return "the root of the arm moves"
    if np.abs(approach.q - q)[hand.arm_index].max() > JOINT_TOL:
        return "the arm moves while the fingers close"
    fault = approach_line_fault(hand, T_world_base, approach.q, arm.approach)
    if fault:
        return fault
    near = path_fault(world, T_world_base, approach.q, arm.approach, clearance=APPROACH_CLEARANCE)
    return f"the hand touches on its way in: {near}" if near else ""


def _straight_fault(world: CollisionWorld, T_world_base: SE3, approach: Approach) -> str:
    """What a floating hand touches on the straight way in, "" if nothing."""
    begin, end = approach.T_world_base_start, T_world_base
    if not np.allclose(begin.rotation, end.rotation, atol=SAME_ROTATION):
        return "the hand turns on its way in"
    way = end.translation - begin.translation
    length, done = float(np.linalg.norm(way)), 0.0
    while True:
        share = done / length if length > 0 else 1.0
        at = SE3(end.rotation, begin.translation + share * way)
        nearest = world.nearest(at, approach.q, surroundings_only=True)
        if nearest.distance < APPROACH_CLEARANCE:
            return f"the hand touches on its way in: {nearest}"
        if done >= length:
            break
        free = nearest.distance - APPROACH_CLEARANCE
        done = min(length, done + max(free, LEAST_STEP))
    return ""


SAME_ROTATION = 1e-9
"""Largest difference of rotation matrix entries (-) along a straight approach: rounding."""


def _ways_in(
    world: CollisionWorld,
    T_world_base: SE3,
    opened: FloatArray,
    opening: float,
    lift: FloatArray | None,
) -> Iterator[Approach]:
    """Approaches to be looked at; a base that is fixed without an arm stays where it is."""
    hand = world.task.hand
    if hand.arm is not None and lift is not None:
        for path in retreats(hand, T_world_base, opened, _ways_back(hand, T_world_base, opened)):
            arm = ArmPath(approach=path, lift=lift)
            yield Approach(q=opened, opening=opening, T_world_base_start=T_world_base, arm=arm)
        return
    ways = [np.zeros(3)]
    if world.task.T_world_base is None:
        ways = _ways_back(hand, T_world_base, opened)
    for way in ways:
        start = SE3(T_world_base.rotation, T_world_base.translation + way)
        yield Approach(q=opened, opening=opening, T_world_base_start=start)


def _ways_back(hand: Hand, T_world_base: SE3, opened: FloatArray) -> list[FloatArray]:
    """Where the palm may come from, (3,), m: above, against its normal, or between the two."""
    palm = T_world_base * HandState(hand, opened).T_base_palm
    back = -(palm.rotation @ hand.palm_normal)
    up = np.array([0.0, 0.0, 1.0])
    lengths = [(d, float(np.linalg.norm(d))) for d in (up, back + up, back)]
    return [STANDOFF * d / length for d, length in lengths if length > SHORTEST]


SHORTEST = 1e-6
"""Length (-) below which the sum of two unit directions has no direction."""
