"""Where pads touch the true surface of an object, by Pinocchio and coal.

Two kinds of pad. Where the pad's sphere is the surface of its geometry (the end of a capsule), the
contact is the surface point nearest to the sphere's centre: exact, and smooth in q. Elsewhere (a
box, a hull) the sphere is an approximation, and the contact is where coal finds the true geometry
nearest to the object.

A link or a palm that lies on the object touches along a line or in a face, and what it presses with
may add up anywhere there. Its contact is the place there next to the middle of all contacts, where
it opposes the others.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np

from planner.bridge import LinkGeometry
from planner.collision.world import shape_pair
from planner.hands.fingers import Finger
from planner.hands.hand import Hand
from planner.kinematics import MovingHand
from planner.spatial import SE3, FloatArray
from planner.system.threads import kept_by_thread
from planner.task import GraspTask
from planner.tolerances import TOUCH_TOL

ROUND = ("sphere", "capsule")
"""Kinds of geometry whose surface is a pad's sphere where the pad may touch."""

ON_LINE, ON_SIDE = 31, 11
"""Places along a link, and along each side of a face, at which it is looked whether it touches:
some 2 mm and 10 mm apart."""

NEXT_TO = 0.005
"""Standard deviation (m) with which places count that are away from the one next to the middle: the
contact moves smoothly when the hand does."""

IDENTITY = SE3.Identity()
"""The object's pose in its own frame; read only."""

LIFTED = 1e-3
"""How far (m) a geometry is drawn back before coal is asked for points and normal: apart, both are
exact, whatever the depth was."""


@dataclass(frozen=True, kw_only=True)
class PadContact:
    """How a finger's pad and the object's surface lie to each other, in the object's frame.

    Attributes:
        sphere_gap: Signed distance of the pad's sphere, m.
        gap: Signed distance of all that may touch with the finger, m.
        round: Whether the pad's sphere is the geometry's surface, or only approximates it.
        point: Nearest point of the object's surface (3,), m.
        outward: Normal of the object there (3,), unit, out of the object.
        angle: Between the pad's axis and the direction into the object, rad.
        lies: Whether the pad touches along a line or in a face, at ``point``.
    """

    sphere_gap: float
    gap: float
    round: bool
    point: FloatArray
    outward: FloatArray
    angle: float
    lies: bool = False

    @property
    def pad_gap(self) -> float:
        """Signed distance, m, of the pad: of its sphere where that is the geometry's surface."""
        return self.sphere_gap if self.round or self.lies else self.gap


@dataclass(frozen=True, kw_only=True, eq=False)
class PadGaps:
    """Gaps of all pads of a task, in the object's frame.

    Attributes:
        gaps: (n,), m, see ``PadContact.pad_gap``.
        points: Nearest points of the object's surface (n, 3), m.
        outward: Unit normals (n, 3) there, out of the object.
        jacobians: (n, 3, nq), velocity of what moves with each pad at its point, base axes.
    """

    gaps: FloatArray
    points: FloatArray
    outward: FloatArray
    jacobians: FloatArray


class PadContactQueries:
    """The pads of a task's fingers at one placement after the other; its queries are made once."""

    def __init__(self, task: GraspTask) -> None:
        """Prepare the queries."""
        hand, shape = task.hand, task.object.shape
        self._task = task
        self._state = MovingHand(hand, hand.q_lower)
        self._to_object = task.T_world_object.inverse()
        self._joints = np.array([f.pad.joint_id for f in task.fingers])
        self._radii = np.array([f.pad.radius for f in task.fingers])
        nowhere = np.zeros(0)
        self._at = (nowhere, nowhere, nowhere), np.zeros((4, 4))  # the last answer, and its pose
        self.round = [pad_geometry(hand, f.pad.geom).kind in ROUND for f in task.fingers]
        """Whether each pad's sphere is its geometry's surface."""
        self._reach = [f.pad.reach for f in task.fingers]
        kinds = [pad_geometry(hand, f.pad.geom).kind for f in task.fingers]
        self._lies = np.array(  # the box of a hull is not its surface
            [len(way) > 0 and kind != "mesh" for way, kind in zip(self._reach, kinds, strict=True)]
        )
        carried = [i for i, f in enumerate(task.fingers) if f.pad.geom in _palms_of_two(hand)]
        self.middling = carried or list(range(len(task.fingers)))
        """Numbers of the pads next to whose middle a face or a line touches."""
        self._shares = [_shares(len(reach)) for reach in self._reach]
        self._pairs = [
            [
                (shape_pair(g.geometry, shape), g.T_joint_geometry)
                for g in contact_geometries(hand, f)
            ]
            for f in task.fingers
        ]
        self.names = frozenset(g.name for f in task.fingers for g in contact_geometries(hand, f))
        """Geometries of the hand that may touch the object."""

    def touches(self, T_world_base: SE3, q: FloatArray) -> list[PadContact]:
        """The touch of every finger at base pose and q (nq,), touching or not."""
        base, distances, points, outward = self._spheres(T_world_base, q)
        out = []
        for i, (finger, is_round) in enumerate(zip(self._task.fingers, self.round, strict=True)):
            gap, point, normal = self._whole(i, base, points[i], outward[i])
            axis = base.rotation @ self._state.pad_axis(finger)
            out.append(
                PadContact(
                    sphere_gap=float(distances[i]),
                    gap=gap,
                    round=is_round,
                    lies=bool(self._lies[i]),
                    point=point,
                    outward=normal,
                    angle=float(np.arccos(min(max(-float(axis @ normal), -1.0), 1.0))),
                )
            )
        return out

    def gaps(self, T_world_base: SE3, q: FloatArray) -> PadGaps:
        """Gaps of the pads alone and how they move, at base pose and q (nq,)."""
        base, gaps, points, outward = self._spheres(T_world_base, q)
        for i, by_sphere in enumerate(self._lies | self.round):
            if not by_sphere:
                gaps[i], points[i], outward[i] = self._whole(i, base, points[i], outward[i])
        to_base = base.inverse()
        in_base = points @ to_base.rotation.T + to_base.translation
        jacobians = self._state.point_jacobians(self._joints, in_base)[:, :3]
        return PadGaps(gaps=gaps, points=points, outward=outward, jacobians=jacobians)

    def _spheres(
        self, T_world_base: SE3, q: FloatArray
    ) -> tuple[SE3, FloatArray, FloatArray, FloatArray]:
        """Base in the object's frame; of the pads' spheres, gaps, nearest points and normals.

        The last answer is kept: what is projected onto the surface is verified next.
        """
        base = self._to_object * T_world_base
        at, pose = self._at
        if np.array_equal(q, self._state.q) and np.array_equal(pose, base.homogeneous):
            return base, at[0].copy(), at[1].copy(), at[2].copy()
        self._state.move(q)
        _, centers = self._state.pads(self._task.fingers)
        centers = centers @ base.rotation.T + base.translation
        if self._lies.any():
            centers = self._touching_centers(base, centers)
        points, outward = self._task.object.shape.closest_point(centers)
        gaps = ((centers - points) * outward).sum(axis=1) - self._radii
        self._at = (gaps, points, outward), base.homogeneous
        return base, gaps.copy(), points.copy(), outward.copy()

    def _touching_centers(self, base: SE3, middles: FloatArray) -> FloatArray:
        """Centres (n, 3) of the pads' spheres where they touch, next to the middle of all.

        Palms of two hands press against each other, next to the middle of both: fingers, which
        touch lightly, would draw them to the palms' ends, where wrists bear least.
        """
        out, middle = middles.copy(), middles[self.middling].mean(axis=0)
        for i in np.flatnonzero(self._lies).tolist():
            turn = base.rotation @ self._state.joint_pose(int(self._joints[i])).rotation
            at = middles[i] + self._shares[i] @ self._reach[i] @ turn.T
            points, outward = self._task.object.shape.closest_point(at)
            gaps = ((at - points) * outward).sum(axis=1)
            away = ((at - middle) ** 2).sum(axis=1)
            weights = np.maximum(gaps.min() + TOUCH_TOL - gaps, 0.0)
            nearer = np.minimum(away[weights > 0.0].min() - away, 0.0)
            weights *= np.exp(nearer / (2.0 * NEXT_TO**2))
            out[i] = weights @ at / weights.sum()
        return out

    def _whole(
        self, i: int, base: SE3, point: FloatArray, outward: FloatArray
    ) -> tuple[float, FloatArray, FloatArray]:
        """Gap of all that may touch with finger i, and the point and normal of its contact."""
        pose = base * self._state.joint_pose(self._task.fingers[i].pad.joint_id)
        pairs = [(pair, pose * local) for pair, local in self._pairs[i]]
        gaps = [pair.distance(at, IDENTITY) for pair, at in pairs]
        gap = min(gaps)
        if self.round[i] or self._lies[i]:
            return gap, point, outward
        pair, at = pairs[gaps.index(gap)]
        lifted = SE3(at.rotation, at.translation + (LIFTED + max(-gap, 0.0)) * outward)
        found = pair.query(lifted, IDENTITY)
        return gap, found.point_b, -found.normal


def _palms_of_two(hand: Hand) -> set[str]:
    """Geometries with which the palms of two hands touch."""
    palms = [hand.contact_parts.get(side.palm_body) for side in hand.pair]
    return {palm.pad.geom for palm in palms if palm is not None}


def _shares(n: int) -> FloatArray:
    """Where along n ways a pad is looked at (k, n), in shares of its reach."""
    along = np.linspace(-1.0, 1.0, {0: 1, 1: ON_LINE}.get(n, ON_SIDE))
    return np.array(list(product(along, repeat=n)))


@kept_by_thread(8)
def pad_contact_queries(task: GraspTask) -> PadContactQueries:
    """The pads of a task, of which every thread keeps its last few."""
    return PadContactQueries(task)


def pad_contacts(task: GraspTask, T_world_base: SE3, q: FloatArray) -> list[PadContact]:
    """The touch of every finger of the task, touching or not."""
    return pad_contact_queries(task).touches(T_world_base, q)


def pad_geometry(hand: Hand, name: str) -> LinkGeometry:
    """The geometry of a hand that a pad is part of."""
    return next(g for g in hand.geometries if g.name == name)


def contact_geometries(hand: Hand, finger: Finger) -> list[LinkGeometry]:
    """What may touch with a finger: the geometry of its pad; of a box or a hull all of its link."""
    geometry = pad_geometry(hand, finger.pad.geom)
    if geometry.kind in ROUND:
        return [geometry]
    own = [g for g in hand.geometries if g.name not in hand.arm_geometries]
    return [g for g in own if g.joint_id == geometry.joint_id]
