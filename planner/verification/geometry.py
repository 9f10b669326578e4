"""The verdict on a candidate: the true geometry, by Pinocchio and coal.

The solver's result is recomputed here by other code on other geometry: Pinocchio's kinematics,
coal's distances between the true shapes (no spheres, no softened edges), contact points and normals
of the true surface.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from planner.collision.pad_contact import PadContact, pad_contact_queries, pad_contacts
from planner.collision.world import CollisionWorld
from planner.contacts import ContactSet
from planner.failure import Failure
from planner.plan import Verification
from planner.spatial import SE3, FloatArray, contact_frames
from planner.task import GraspTask
from planner.tolerances import (
    ANGLE_TOL,
    EDGE_RADIUS,
    EDGE_SPREAD,
    FLAT_ANGLE_TOL,
    JOINT_TOL,
    PENETRATION_TOL,
    TOUCH_TOL,
)

__all__ = ["contacts_at", "contacts_of", "edge_failures", "verify_geometry"]

LISTED = 5
"""Clearances that a verification keeps."""


def edge_failures(task: GraspTask, touches: Sequence[PadContact]) -> list[Failure]:
    """Which contacts, one for each finger, are on an edge of a mesh.

    Contacts on primitives keep off edges by construction: their dispersion is 0. Of a thin wall
    only the side that a pad presses on counts: it never meets the other one.
    """
    points = np.array([touch.point for touch in touches])
    outward = np.array([touch.outward for touch in touches])
    spreads = task.object.shape.normal_dispersion(points, EDGE_RADIUS, facing=outward)
    return [
        Failure(
            kind="edge",
            text=f"{finger} is on an edge: normals differ by {np.rad2deg(angle):.0f} degrees "
            f"within {1e3 * EDGE_RADIUS:.0f} mm",
            numbers={"spread": float(angle)},
        )
        for finger, angle in zip(task.finger_names, spreads, strict=True)
        if angle > EDGE_SPREAD
    ]


def _fixed_failures(task: GraspTask, T_world_base: SE3 | None, q: FloatArray) -> list[Failure]:
    """Whether base and wrist are where the task fixes them."""
    failures = []
    if task.T_world_base is not None and T_world_base is not None:
        off = task.T_world_base.inverse() * T_world_base
        if not np.allclose(off.homogeneous, np.eye(4), atol=JOINT_TOL):
            text = "the base is not where the task fixes it"
            failures.append(Failure(kind="base_moved", text=text))
    wrist = q[task.hand.wrist_index]
    if not task.wrist_free and np.abs(wrist - task.wrist_q).max(initial=0.0) > JOINT_TOL:
        text = "the wrist is not where the task holds it"
        failures.append(Failure(kind="wrist_moved", text=text))
    return failures


def contacts_at(task: GraspTask, T_world_base: SE3, q: FloatArray) -> ContactSet:
    """Contacts of the task's pads with the true surface, in the world, forces unknown.

    A contact is the surface point nearest to the pad (``planner.collision.pad_contact``).
    """
    return contacts_of(task, pad_contacts(task, T_world_base, q))


def contacts_of(task: GraspTask, touches: Sequence[PadContact]) -> ContactSet:
    """The same from the touches of all fingers, if they are at hand."""
    n, turn, shift = len(touches), task.T_world_object.rotation, task.T_world_object.translation
    points = np.array([touch.point for touch in touches])
    # tangents belong to the object: chosen in its frame, and turned with it
    frames = contact_frames(-np.array([touch.outward for touch in touches]))
    return ContactSet(
        positions=points @ turn.T + shift,
        frames=turn @ frames,
        models=(task.contact_model,) * n,
        mu=np.full(n, task.mu),
        mu_torsion=np.full(n, task.mu_torsion),
        forces=np.full((n, 4), np.nan),
        fingers=task.finger_names,
        center=shift,
    )


def verify_geometry(
    world: CollisionWorld,
    T_world_base: SE3,
    q: FloatArray,
    touches: Sequence[PadContact] | None = None,
    *,
    object_moved: bool = False,
) -> Verification:
    """Recompute everything that must hold of a grasp, on the true geometry.

    Args:
        world: True geometry of the task.
        T_world_base: Base pose.
        q: Joints (nq,).
        touches: The touch of every finger there, if it is at hand.
        object_moved: Whether the base is where it is because the object has moved in the hand, so
            that it need not be where the task fixes it.
    """
    task = world.task
    hand = task.hand
    if touches is None:
        touches = pad_contacts(task, T_world_base, q)
    gaps = np.array([t.pad_gap for t in touches])
    whole = np.array([t.gap for t in touches])
    angles = np.array([t.angle for t in touches])

    others = world.closest(T_world_base, q, LISTED, may_touch=pad_contact_queries(task).names)

    matrix, value = hand.coupling_matrix
    coupling = float(np.abs(matrix @ q - value).max(initial=0.0))
    limits = float(np.maximum(hand.q_lower - q, q - hand.q_upper).max(initial=0.0))
    failures = [
        Failure(
            kind="pad_gap",
            text=f"{f.name} pad is {1e3 * gap:.2f} mm from the surface "
            f"(allowed {1e3 * TOUCH_TOL:.1f})",
            numbers={"gap": gap},
        )
        for f, gap in zip(task.fingers, gaps, strict=True)
        if not abs(gap) <= TOUCH_TOL
    ]
    failures += [
        Failure(
            kind="pad_geometry_gap",
            text=f"{f.pad.geom} is {1e3 * gap:.2f} mm from the surface although its pad touches",
            numbers={"gap": gap},
        )
        for f, gap in zip(task.fingers, whole, strict=True)
        if not abs(gap) <= TOUCH_TOL
    ]
    failures += [
        Failure(
            kind="off_pad",
            text=f"{f.name} touches {np.rad2deg(angle):.0f} degrees off its pad axis, "
            "outside the pad",
            numbers={"angle": angle},
        )
        for f, touch, angle in zip(task.fingers, touches, angles, strict=True)
        if angle > f.pad.half_angle + (ANGLE_TOL if touch.round else FLAT_ANGLE_TOL)
    ]
    points = np.array([touch.point for touch in touches])
    failures += [
        Failure(
            kind="region",
            text=f"{f.name} touches where it may not, at {np.round(point, 4)} m of the object",
        )
        for f, point, good in zip(
            task.fingers, points, task.object.permits(points, task.finger_names), strict=True
        )
        if not good
    ]
    failures += edge_failures(task, touches)
    failures += [
        Failure(kind="penetration", text=f"penetration, {c}", numbers={"distance": c.distance})
        for c in others
        if c.distance < -PENETRATION_TOL
    ]
    if coupling > JOINT_TOL:
        text = f"a coupling is violated by {coupling:.1e} rad"
        failures.append(Failure(kind="coupling", text=text, numbers={"violation": coupling}))
    if limits > JOINT_TOL:
        text = f"a joint limit is violated by {limits:.1e} rad"
        failures.append(Failure(kind="joint_limit", text=text, numbers={"violation": limits}))
    failures += _fixed_failures(task, None if object_moved else T_world_base, q)
    return Verification(
        pad_gaps=gaps,
        pad_geometry_gaps=whole,
        pad_angles=angles,
        closest=tuple(others[:LISTED]),
        coupling_error=coupling,
        limit_error=limits,
        failures=tuple(failures),
    )
