"""Where pads touch the true surface of an object, by Pinocchio and coal.

Two kinds of pad. Where the pad's sphere is the surface of its geometry (the end of a capsule), the
contact is the surface point nearest to the sphere's centre: exact, and smooth in q. Elsewhere (a
box, a hull) the sphere is an approximation, and the contact is where coal finds the true geometry
nearest to the object.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from planner.bridge import LinkGeometry
from planner.collision import shape_pair
from planner.hand import Finger, Hand
from planner.kinematics import HandState
from planner.spatial import SE3, FloatArray
from planner.task import GraspTask

__all__ = ["ROUND", "PadTouch", "pad_geometry", "pad_touches", "touching_geometries"]

ROUND = ("sphere", "capsule")
"""Kinds of geometry whose surface is a pad's sphere where the pad may touch."""

LIFTED = 1e-3
"""How far (m) a geometry is drawn back before coal is asked for points and normal: apart, both are
exact, whatever the depth was."""


@dataclass(frozen=True, kw_only=True)
class PadTouch:
    """How a finger's pad and the object's surface lie to each other, in the object's frame.

    Attributes:
        sphere_gap: Signed distance of the pad's sphere, m.
        gap: Signed distance of all that may touch with the finger, m.
        round: Whether the pad's sphere is the geometry's surface, or only approximates it.
        point: Nearest point of the object's surface (3,), m.
        outward: Normal of the object there (3,), unit, out of the object.
        angle: Between the pad's axis and the direction into the object, rad.
    """

    sphere_gap: float
    gap: float
    round: bool
    point: FloatArray
    outward: FloatArray
    angle: float

    @property
    def pad_gap(self) -> float:
        """Signed distance, m, of the pad: of its sphere where that is the geometry's surface."""
        return self.sphere_gap if self.round else self.gap


def pad_touches(task: GraspTask, T_world_base: SE3, q: FloatArray) -> list[PadTouch]:
    """The touch of every finger of the task, touching or not."""
    state = HandState(task.hand, q)
    T_object_base = task.T_world_object.inverse() * T_world_base
    centers = np.array([T_object_base.act(state.pad_center(f)) for f in task.fingers])
    points, outward = task.object.shape.closest_point(centers)
    distances = np.einsum("ij,ij->i", centers - points, outward)
    return [
        _touch(task, state, T_object_base, f, *rest)
        for f, *rest in zip(task.fingers, centers, points, outward, distances, strict=True)
    ]


def pad_geometry(hand: Hand, name: str) -> LinkGeometry:
    """The geometry of a hand that a pad is part of."""
    return next(g for g in hand.geometries if g.name == name)


def touching_geometries(hand: Hand, finger: Finger) -> list[LinkGeometry]:
    """What may touch with a finger: the geometry of its pad; of a box or a hull all of its link."""
    geometry = pad_geometry(hand, finger.pad.geom)
    if geometry.kind in ROUND:
        return [geometry]
    return [g for g in hand.geometries if g.joint_id == geometry.joint_id]


def _touch(
    task: GraspTask,
    state: HandState,
    T_object_base: SE3,
    finger: Finger,
    center: FloatArray,
    point: FloatArray,
    outward: FloatArray,
    distance: float,
) -> PadTouch:
    pad, shape = finger.pad, task.object.shape
    sphere_gap = float(distance) - pad.radius
    T_object_joint = T_object_base * state.joint_pose(pad.joint_id)
    pairs = [
        (shape_pair(g.geometry, shape), T_object_joint * g.T_joint_geometry)
        for g in touching_geometries(task.hand, finger)
    ]
    gaps = [pair.distance(pose, SE3.Identity()) for pair, pose in pairs]
    gap = min(gaps)
    pair, pose = pairs[gaps.index(gap)]
    is_round = pad_geometry(task.hand, pad.geom).kind in ROUND
    if not is_round:
        lifted = SE3(pose.rotation, pose.translation + (LIFTED + max(-gap, 0.0)) * outward)
        found = pair.query(lifted, SE3.Identity())
        point, outward = found.point_b, -found.normal
    axis = T_object_base.rotation @ state.pad_axis(finger)
    return PadTouch(
        sphere_gap=sphere_gap,
        gap=gap,
        round=is_round,
        point=point,
        outward=outward,
        angle=float(np.arccos(np.clip(-(axis @ outward), -1.0, 1.0))),
    )
