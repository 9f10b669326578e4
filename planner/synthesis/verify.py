"""The verdict on a candidate: the true geometry, by Pinocchio and coal.

What the NLP solved is recomputed here with other code on other geometry: Pinocchio's kinematics,
coal's distances between the real shapes (no balls, no softened edges), contact points and normals
from the true surface.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from planner.collision import OBJECT, Clearance, CollisionWorld
from planner.contacts import ContactSet
from planner.kinematics import HandState
from planner.spatial import SE3, FloatArray
from planner.task import GraspTask

__all__ = ["TOUCH_TOL", "Verification", "contacts_at", "verify"]

TOUCH_TOL = 5e-4
"""A pad touches when its signed distance to the true surface is at most this (m), either sign."""

PENETRATION_TOL = 5e-6
"""Depth (m) from which two geometries that must not touch count as penetrating: coal is that
accurate in penetration (``planner.proximity``)."""


@dataclass(frozen=True, kw_only=True)
class Verification:
    """Residuals of a grasp on the true geometry.

    Attributes:
        pad_gaps: Signed distance of each finger's pad sphere from the surface, (n,), m.
        pad_geometry_gaps: The same for the whole geometry that carries the pad, by coal, (n,), m.
        pad_angles: Angle between pad axis and contact direction, (n,), rad.
        closest: The smallest clearances that are not pad contacts, nearest first.
        coupling_error: Largest violation of a kinematic coupling, rad.
        limit_error: Largest violation of a joint limit, rad.
        faults: What fails, in words; empty if the grasp holds geometrically.
    """

    pad_gaps: FloatArray
    pad_geometry_gaps: FloatArray
    pad_angles: FloatArray
    closest: tuple[Clearance, ...]
    coupling_error: float
    limit_error: float
    faults: tuple[str, ...]

    @property
    def ok(self) -> bool:
        """Whether nothing failed."""
        return not self.faults


def _given_faults(task: GraspTask, T_world_base: SE3, q: FloatArray) -> list[str]:
    """Whether base and wrist are where the task fixes them."""
    faults = []
    if task.T_world_base is not None:
        off = task.T_world_base.inverse() * T_world_base
        if not np.allclose(off.homogeneous, np.eye(4), atol=JOINT_TOL):
            faults.append("the base is not where the task fixes it")
    wrist = q[task.hand.wrist_index]
    if not task.wrist_free and np.abs(wrist - task.wrist_q).max(initial=0.0) > JOINT_TOL:
        faults.append("the wrist is not where the task holds it")
    return faults


ANGLE_TOL = 1e-3
"""How far (rad) a contact may lie outside the pad's cone: the solver's accuracy."""

JOINT_TOL = 1e-6
"""How far (rad) couplings and joint limits may be violated: the solver's accuracy."""


def contacts_at(task: GraspTask, T_world_base: SE3, q: FloatArray) -> ContactSet:
    """Contacts of the task's pads with the true surface, in the world, forces unknown.

    A contact is the surface point nearest to the pad's centre.
    """
    state = HandState(task.hand, q)
    to_object = task.T_world_object.inverse() * T_world_base
    centers = np.array([to_object.act(state.pad_center(f)) for f in task.fingers])
    points, outward = task.object.shape.closest_point(centers)
    return ContactSet.from_arrays(
        points,
        -outward,
        mu=task.mu,
        mu_torsion=task.mu_torsion,
        model=task.contact_model,
        fingers=task.finger_names,
    ).transformed(task.T_world_object)


def verify(world: CollisionWorld, T_world_base: SE3, q: FloatArray) -> Verification:
    """Recompute everything that must hold of a grasp, on the true geometry."""
    task = world.task
    hand = task.hand
    state = HandState(hand, q)
    to_object = task.T_world_object.inverse() * T_world_base
    centers = np.array([to_object.act(state.pad_center(f)) for f in task.fingers])
    radii = np.array([f.pad.radius for f in task.fingers])
    gaps = task.object.shape.signed_distance(centers) - radii
    _, outward = task.object.shape.closest_point(centers)
    axes = np.array([to_object.rotation @ state.pad_axis(f) for f in task.fingers])
    angles = np.arccos(np.clip(-(axes * outward).sum(axis=1), -1.0, 1.0))

    pads = {f.pad.geom: i for i, f in enumerate(task.fingers)}
    whole, others = np.full(len(pads), np.inf), []
    for clearance in world.distances(T_world_base, q):
        if clearance.second == OBJECT and clearance.first in pads:
            whole[pads[clearance.first]] = clearance.distance
        else:
            others.append(clearance)
    others.sort(key=lambda c: c.distance)

    matrix, value = hand.coupling_matrix
    coupling = float(np.abs(matrix @ q - value).max(initial=0.0))
    limits = float(np.maximum(hand.q_lower - q, q - hand.q_upper).max(initial=0.0))
    faults = [
        f"{f.name} pad is {1e3 * gap:.2f} mm from the surface (allowed {1e3 * TOUCH_TOL:.1f})"
        for f, gap in zip(task.fingers, gaps, strict=True)
        if not abs(gap) <= TOUCH_TOL
    ]
    faults += [
        f"{f.pad.geom} is {1e3 * gap:.2f} mm from the surface although its pad touches"
        for f, gap in zip(task.fingers, whole, strict=True)
        if not abs(gap) <= TOUCH_TOL
    ]
    faults += [
        f"{f.name} touches {np.rad2deg(angle):.0f} degrees off its pad axis, outside the pad"
        for f, angle in zip(task.fingers, angles, strict=True)
        if angle > f.pad.half_angle + ANGLE_TOL
    ]
    faults += [f"penetration, {c}" for c in others if c.distance < -PENETRATION_TOL]
    if coupling > JOINT_TOL:
        faults.append(f"a coupling is violated by {coupling:.1e} rad")
    if limits > JOINT_TOL:
        faults.append(f"a joint limit is violated by {limits:.1e} rad")
    faults += _given_faults(task, T_world_base, q)
    return Verification(
        pad_gaps=gaps,
        pad_geometry_gaps=whole,
        pad_angles=angles,
        closest=tuple(others[:5]),
        coupling_error=coupling,
        limit_error=limits,
        faults=tuple(faults),
    )
