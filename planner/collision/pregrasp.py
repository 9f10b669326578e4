"""The pre-grasp and the way to it: fingers opened along the contact normals, then straight in.

Both are part of a plan: a grasp that cannot be reached without touching is no plan. The fingers are
opened by ``planner.collision.pregrasp_ik``; whether the way is free is verified here, on the true
geometry.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product

import numpy as np

from planner.collision.arm_path import (
    ArmPath,
    find_lift,
    retreats,
    verify_approach_line,
    verify_arm_path,
    verify_lift,
)
from planner.collision.pregrasp_ik import PregraspIk, spread_idle, undetermined_joints
from planner.collision.world import Clearance, CollisionWorld
from planner.failure import Failure
from planner.hands.hand import Hand
from planner.kinematics import palm_pose, palm_poses, tip_reach
from planner.spatial import SE3, FloatArray
from planner.tolerances import JOINT_TOL

__all__ = ["APPROACH_KINDS", "Approach", "find_approach", "verify_approach", "way_back"]

APPROACH_KINDS = frozenset(
    (
        "approach_collision",
        "approach_invalid",
        "arm_collision",
        "arm_path",
        "arm_torque",
        "arm_unreachable",
        "closing_collision",
        "pregrasp_unreachable",
    )
)
"""Kinds of failure of an approach, an arm's lift included."""

PREGRASP_DISTANCES = (0.025, 0.02, 0.015, 0.01)
"""Distances (m) by which pads are opened along the normals, tried in this order. More room absorbs
a larger error of the object's pose; less is easier to reach."""

STANDOFF = 0.12
"""Length (m) of the straight approach: outside the reach of most objects for a hand."""

APPROACH_CLEARANCE = 0.001
"""Smallest distance (m) to object, table and obstacles on the way in."""

AROUND_DISTANCES = (0.015, 0.03, 0.045, 0.06)
"""Distances (m) by which the outermost contacts of a hand around an object are opened across its
way in, tried in this order."""

LEAST_ACROSS = 0.3
"""Length (-) of a unit normal across the way below which a contact faces the way: its normal does
not tell in which direction it makes way."""

PALM_BACK = 0.002
"""How far (m) from the end of its way in a palm that is to touch has still the clearance of the
way: twice ``APPROACH_CLEARANCE``, so that nothing lies in between."""

CLOSING_SHARES = np.linspace(1.0, 0.0, 12, endpoint=False)[:, None]
"""Shares (-) of the way from grasp to pre-grasp at which closing is checked: pads move about 2 mm
between two of them."""


SPREADING = 10
"""Sweeps in which idle fingers make way for opened ones whose joints may be off: 20 degrees a joint
at most."""


@dataclass(frozen=True, kw_only=True)
class Approach:
    """How the hand gets to a grasp.

    Attributes:
        q: Pre-grasp joints (nq,), pads opened along the normals.
        pregrasp_distance: By how much, m.
        T_world_base_start: Base pose from which it moves straight to the grasp with ``q``.
        arm: The way in and the lift of the arm that carries the hand; its root stays.
    """

    q: FloatArray
    pregrasp_distance: float
    T_world_base_start: SE3
    arm: ArmPath | None = None


def way_back(hand: Hand, T_world_base: SE3, approach: Approach) -> FloatArray:
    """From a grasp or a release to where its straight way begins: the palm's shift (3,), m, world.

    Args:
        hand: Whose approach it is.
        T_world_base: Base pose of the grasp; on an arm that of the arm's root.
        approach: The way.
    """
    if approach.arm is None:
        return np.asarray(approach.T_world_base_start.translation - T_world_base.translation)
    q, ends = approach.q.copy(), []
    for posture in approach.arm.approach[[0, -1]]:
        q[hand.arm_index] = posture
        ends.append(palm_pose(hand, q).translation)
    return np.asarray(T_world_base.rotation @ (ends[0] - ends[1]))


def find_approach(
    world: CollisionWorld,
    T_world_base: SE3,
    q: FloatArray,
    normals: FloatArray,
) -> Approach | Failure:
    """A pre-grasp and a straight way in that touch nothing; or why there is none.

    Joints that actuators leave undetermined stay where the grasp has them if there is such a way:
    else they are elsewhere when the fingers have closed, and push the object aside.

    Args:
        world: True geometry of the task.
        T_world_base: Base pose of the grasp.
        q: Joints of the grasp (nq,).
        normals: Contact normals into the object (n, 3), world.
    """
    failure: Failure | None = Failure(
        kind="pregrasp_unreachable", text="the fingers cannot open along the contact normals"
    )
    lift = find_lift(world, T_world_base, q) if world.task.hand.on_arm else None
    if isinstance(lift, Failure):
        return lift
    if not (world.task.is_of_fingertips or world.task.hand.pair):
        return _find_around(world, T_world_base, q, normals, lift)
    solvers = [PregraspIk(world, T_world_base, q, normals)]
    loose = undetermined_joints(world.task.hand)
    if len(loose) > 0:
        solvers.insert(0, PregraspIk(world, T_world_base, q, normals, loose))
    error = world.task.joint_error * tip_reach(world.task.hand)
    for solver, distance in product(solvers, PREGRASP_DISTANCES):
        opened = solver.solve(distance)
        if opened is None:
            continue
        if error > 0.0:  # opened fingers that are off come near idle ones
            opened = spread_idle(world, T_world_base, opened, near=error, sweeps=SPREADING)
        failure = _verify_opened(world, T_world_base, opened)
        failure = failure or _verify_closing(world, T_world_base, q, opened)
        if failure is not None:
            continue
        for approach in _ways_in(world, T_world_base, opened, distance, lift):
            failure = _verify_way_in(world, T_world_base, q, approach)
            if failure is None:
                return approach
    return failure or Failure(
        kind="arm_unreachable", text="the arm cannot come in straight within its limits"
    )


def _find_around(
    world: CollisionWorld,
    T_world_base: SE3,
    q: FloatArray,
    normals: FloatArray,
    lift: FloatArray | None,
) -> Approach | Failure:
    """A pre-grasp and a way in of a hand that closes around the object.

    Links that are behind the object, seen from where the hand comes, have to make way for it: the
    outermost contact of every finger opens across the way, in the direction that its normal has
    there; one that faces the way, away from the object's centre of mass.
    """
    task = world.task
    outer = list(task.outermost)
    fingers = [task.fingers[i] for i in outer]
    middle = task.T_world_object.translation
    pads = world.moving.move(q).pads(fingers)[1] @ T_world_base.rotation.T
    pads += T_world_base.translation
    failure = Failure(kind="pregrasp_unreachable", text="the fingers cannot open around the object")
    for way in _ways_back(world, T_world_base, q):
        along = way / np.linalg.norm(way)
        across = np.eye(3) - np.outer(along, along)
        inward, sideways = normals[outer] @ across, (middle - pads) @ across
        facing_back = np.linalg.norm(inward, axis=1) < LEAST_ACROSS
        inward[facing_back] = sideways[facing_back]
        inward /= np.maximum(np.linalg.norm(inward, axis=1), SHORTEST)[:, None]
        solver = PregraspIk(world, T_world_base, q, inward, fingers=fingers)
        for distance in AROUND_DISTANCES:
            opened = solver.solve(distance)
            if opened is None:
                break
            found = _verify_opened(world, T_world_base, opened)
            found = found or _verify_closing(world, T_world_base, q, opened)
            for approach in _ways_in(world, T_world_base, opened, distance, lift, [way]):
                found = found or _verify_way_in(world, T_world_base, q, approach)
                if found is None:
                    return approach
            failure = found or failure
    return failure


def verify_approach(
    world: CollisionWorld, T_world_base: SE3, q: FloatArray, approach: Approach
) -> Failure | None:
    """What is wrong with an approach, None if nothing is.

    The straight way in is checked without a gap: from a pose with clearance d the hand may move by
    d less ``APPROACH_CLEARANCE`` before it could touch. Closing is sampled, all fingers in step.
    An arm's lift is looked at too.
    """
    failure = _verify_way_in(world, T_world_base, q, approach)
    failure = failure or _verify_closing(world, T_world_base, q, approach.q)
    if failure is not None or approach.arm is None:
        return failure
    return verify_lift(world, T_world_base, q, approach.arm.lift)


def _invalid(text: str) -> Failure:
    return Failure(kind="approach_invalid", text=text)


def _collision(near: Clearance) -> Failure:
    return Failure(
        kind="approach_collision",
        text=f"the hand touches on its way in: {near}",
        numbers={"distance": near.distance},
    )


def _verify_way_in(
    world: CollisionWorld, T_world_base: SE3, q: FloatArray, approach: Approach
) -> Failure | None:
    """What is wrong with the pre-grasp and the way there, None if nothing is."""
    hand = world.task.hand
    outside = np.maximum(hand.q_lower - approach.q, approach.q - hand.q_upper).max()
    matrix, value = hand.coupling_matrix
    if outside > JOINT_TOL or np.abs(matrix @ approach.q - value).max(initial=0.0) > JOINT_TOL:
        return _invalid("the pre-grasp violates a joint limit or a coupling")
    if hand.on_arm:
        return _verify_on_arm(world, T_world_base, q, approach)
    if approach.arm is not None:
        return _invalid("there are paths of an arm, but the hand is not on one")
    return _verify_straight(world, T_world_base, approach)


def _verify_closing(
    world: CollisionWorld, T_world_base: SE3, q: FloatArray, opened: FloatArray
) -> Failure | None:
    """What touches while the fingers close, None if nothing does."""
    path = q + CLOSING_SHARES * (opened - q)
    may_touch = world.task.carried_geometries
    for i in world.maybe_touching(T_world_base, path):
        touching = world.nearest_below(T_world_base, path[i], may_touch=may_touch)
        if touching is not None and touching.distance <= 0.0:
            return Failure(
                kind="closing_collision",
                text=f"the fingers touch while they close: {touching}",
                numbers={"distance": touching.distance},
            )
    return None


def _verify_opened(world: CollisionWorld, T_world_base: SE3, opened: FloatArray) -> Failure | None:
    """What the opened hand is too near to at the end of any way in, None if nothing."""
    near = world.nearest_below(
        T_world_base,
        opened,
        clearance=APPROACH_CLEARANCE,
        surroundings_only=True,
        may_touch=world.task.carried_geometries,
    )
    return None if near is None else _collision(near)


def _verify_on_arm(
    world: CollisionWorld, T_world_base: SE3, q: FloatArray, approach: Approach
) -> Failure | None:
    """What is wrong with the paths of the arm, None if nothing is."""
    hand, arm = world.task.hand, approach.arm
    if arm is None:
        return _invalid("the arm's way in and lift are missing")
    if not np.allclose(approach.T_world_base_start.homogeneous, T_world_base.homogeneous):
        return _invalid("the root of the arm moves")
    if not hand.pair and np.abs(approach.q - q)[hand.arm_index].max() > JOINT_TOL:
        return _invalid("the arm moves while the fingers close")
    failure = verify_approach_line(hand, T_world_base, approach.q, arm.approach)
    if failure is not None:
        return failure
    near = verify_arm_path(
        world, T_world_base, approach.q, arm.approach, clearance=APPROACH_CLEARANCE
    )
    return None if near is None else near.at("the hand touches on its way in")


def _verify_straight(
    world: CollisionWorld, T_world_base: SE3, approach: Approach
) -> Failure | None:
    """What a floating hand touches on the straight way in, None if nothing."""
    begin, end = approach.T_world_base_start, T_world_base
    same = (begin.rotation == end.rotation).all()
    if not same and not np.allclose(begin.rotation, end.rotation, atol=SAME_ROTATION):
        return _invalid("the hand turns on its way in")
    # from the grasp outwards: what touches mostly touches there
    back = begin.translation - end.translation
    if world.task.carried_geometries and (length := float(np.linalg.norm(back))) > PALM_BACK:
        # a palm that is to touch comes near only at the end, where all else keeps its clearance
        near = _verify_opened(world, T_world_base, approach.q)
        if near is not None:
            return near
        end = SE3(end.rotation, end.translation + PALM_BACK / length * back)
        back = begin.translation - end.translation
    swept = world.swept_clearance_violation(end, approach.q, back, APPROACH_CLEARANCE)
    return None if swept is None else _collision(swept)


SAME_ROTATION = 1e-9
"""Largest difference of rotation matrix entries (-) along a straight approach: rounding."""


def _ways_in(
    world: CollisionWorld,
    T_world_base: SE3,
    opened: FloatArray,
    distance: float,
    lift: FloatArray | None,
    ways: list[FloatArray] | None = None,
) -> Iterator[Approach]:
    """Approaches to be looked at; a base that is fixed without an arm stays where it is."""
    hand = world.task.hand
    ways = _ways_back(world, T_world_base, opened) if ways is None else ways
    if lift is not None:
        for path in retreats(hand, T_world_base, opened, ways):
            arm = ArmPath(approach=path, lift=lift)
            yield Approach(
                q=opened, pregrasp_distance=distance, T_world_base_start=T_world_base, arm=arm
            )
        return
    if world.task.T_world_base is not None:
        ways = [np.zeros(3)]
    for way in ways:
        start = SE3(T_world_base.rotation, T_world_base.translation + way)
        yield Approach(q=opened, pregrasp_distance=distance, T_world_base_start=start)


def _ways_back(world: CollisionWorld, T_world_base: SE3, opened: FloatArray) -> list[FloatArray]:
    """Where the palm may come from, (3,), m: above, against its normal, or between the two.

    Over a table first from above, without one first against the palm's normal.
    """
    if world.task.hand.pair and world.task.hand.on_arm:
        return _palms_back(world.task.hand, T_world_base, opened)
    palm = T_world_base * world.moving.move(opened).T_base_palm
    back = -(palm.rotation @ world.moving.hand.palm_normal)
    up = np.array([0.0, 0.0, 1.0])
    ways = [up, back + up, back]
    if world.task.table_height is None:
        ways = ways[::-1]
    if not world.task.is_of_fingertips:
        aside = np.cross(back, np.roll(back, 1))
        aside /= np.linalg.norm(aside)
        ways += [back + sign * a for a in (aside, np.cross(back, aside)) for sign in (1.0, -1.0)]
    lengths = [(d, float(np.linalg.norm(d))) for d in ways]
    return [STANDOFF * d / length for d, length in lengths if length > SHORTEST]


def _palms_back(hand: Hand, T_world_base: SE3, opened: FloatArray) -> list[FloatArray]:
    """Where both palms of two hands may come from, (2, 3), m: against their normals, or nowhere."""
    palms = zip(hand.pair, palm_poses(hand, opened), strict=True)
    back = np.array([-(palm.rotation @ side.palm_normal) for side, palm in palms])
    return [STANDOFF * back @ T_world_base.rotation.T, np.zeros((2, 3))]


SHORTEST = 1e-6
"""Length (-) below which the sum of two unit directions has no direction."""
