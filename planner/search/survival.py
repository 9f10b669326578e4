"""``survival_of``: how much of what may be true of an object of a cloud a grasp of it survives.

Called by ``planner.search.from_cloud`` of every plan that it finds, which takes the best.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from planner.clouds.belief import STEP
from planner.contacts import ContactSet
from planner.kinematics import HandState
from planner.plan import GraspPlan
from planner.quality import force_closure, plainly_closed
from planner.search.beyond import Neighbours, search_directions
from planner.search.in_the_way import (
    CLEAR,
    SPARE,
    clearance_of_others,
    clearance_of_points,
    hidden_share,
    hits,
    seen_nearby,
)
from planner.shapes.mesh import surface_triangles
from planner.spatial import FloatArray, contact_frames
from planner.tolerances import CLOSURE_EDGES, FRICTION_SHARE

SAMPLES = 60
"""Samples of what may be true on which a plan is tried: a share of 0.9 is known to 0.04."""

FELT = 0.012
"""How far (m) a finger goes beyond its planned place until it feels the surface."""

NEWTON = 3
"""Steps by which a finger's way to the surface is found."""

LEAST_SLOPE = 0.3
"""Slope (-) of the surface's distance along a contact's normal below which a finger slides past."""

LAG = 0.002
"""Way (m) by which the last finger comes later than the first that moves an object on its table."""

TABLE_MU = 0.6
"""Friction (-) of object and table beyond which pushes are not thought of: that of a trial."""

BASE = 0.005
"""Height (m) of what counts as an object's base, whose edge a belief rounds."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Survival:
    """What came of the samples; fields as those of ``CloudPlan``."""

    survival: float
    tipping: float
    samples: int
    position_std: FloatArray
    normal_std: FloatArray
    clearance: float
    hidden: float


def survival_of(
    plan: GraspPlan, pose_error: tuple[float, float], seed: int, beaten: float
) -> Survival:
    """What comes of a plan on samples of what may be true.

    Args:
        plan: Of an object with a belief.
        pose_error: Standard deviations of the pose's error along and about each axis, m and rad.
        seed: Of the samples.
        beaten: Share (-) above which survival is of interest: one that cannot come to more may be
            less than it is.
    """
    belief = plan.task.object.belief
    assert belief is not None, "the plan is of a cloud"
    planned = plan.contacts_in_object
    n, rng = len(planned), np.random.default_rng(seed)
    points, frames = planned.positions, planned.frames
    # a contact, one step before it, where the finger comes from, and along each tangent: value and
    # slope of the surface; beyond a thin wall its far side rises again
    stencil = np.concatenate([np.zeros((3, 1)), STEP * np.diag([-1.0, 1.0, 1.0])], axis=1)
    spots = points[:, None] + np.einsum("nde,ek->nkd", frames, stencil)
    errors = belief.samples(spots.reshape(-1, 3), SAMPLES, rng).reshape(SAMPLES, n, 4)
    tilt = errors[..., 2:] - errors[..., :1]
    own, others = seen_nearby(belief, plan.task.T_world_object)
    clearance = clearance_of_points(plan, np.concatenate([own, others]))
    clearance = min(clearance, clearance_of_others(plan, belief, others))
    nothing = Survival(
        survival=0.0,
        tipping=0.0,
        samples=SAMPLES,
        position_std=belief.deviation(points),
        normal_std=np.arctan(tilt.std(axis=0).mean(axis=1) / STEP),
        clearance=clearance,
        hidden=hidden_share(plan, belief),
    )
    if clearance < CLEAR:
        return nothing
    weights = np.array([h.weight for h in belief.hypotheses])
    kinds = rng.choice(len(weights), SAMPLES, p=weights / weights.sum())
    shifts = rng.normal(size=(SAMPLES, 3)) * pose_error[0]
    turns = rng.normal(size=(SAMPLES, 3)) * pose_error[1]
    if belief.cloud.table is not None:
        shifts[:, 2] = turns[:, :2] = 0.0
    # where the object's surface is if its pose is off: seen from it, contacts are elsewhere
    moved = spots[None] - shifts[:, None, None] - np.cross(turns[:, None, None], spots[None])
    joints = plan.task.joint_error * rng.normal(size=(SAMPLES, plan.task.hand.nq))
    moved += _tip_errors(plan, joints)[:, :, None]
    way = np.zeros((SAMPLES, n))
    for _ in range(NEWTON):
        at = moved + way[:, :, None, None] * frames[:, None, :, 0]
        values = np.empty((SAMPLES, n, 4))
        for kind in np.unique(kinds):
            mine = kinds == kind
            values[mine] = belief.mean(at[mine].reshape(-1, 3), int(kind)).reshape(-1, n, 4)
        here = values[..., 0] + errors[..., 0]
        slope = (values[..., 1:] - values[..., :1]) / STEP  # against the normal, along tangents
        inward = slope[..., 0].copy()
        steep = inward > LEAST_SLOPE
        way = np.clip(way + here / np.where(steep, inward, 1.0), -2.0 * FELT, 2.0 * FELT)
    slope[..., 0] *= -1.0
    slope[..., 1:] += (errors[..., 2:] - errors[..., :1]) / STEP
    reached = (way <= FELT) & (way >= SPARE - plan.pregrasp_distance)
    touched = (steep & reached & (np.abs(here) < FELT / 4)).all(axis=1)
    positions = moved[:, :, 0] + way[..., None] * frames[:, :, 0]
    normals = -np.einsum("nde,sne->snd", frames, slope)
    lags = way - way.min(axis=1, keepdims=True)
    tips = (lags.max(axis=1) > LAG) & _tips(plan)[way.argmin(axis=1)]
    if touched.any():
        touched &= ~hits(plan, belief)[kinds] & ~_meets(plan, way, joints)
    held, left = 0, np.flatnonzero(touched)
    for done, k in enumerate(left):
        if held + len(left) - done <= beaten * SAMPLES:
            break
        held += _closed(planned, positions[k], normals[k])
    return replace(nothing, survival=held / SAMPLES, tipping=float(tips.mean()))


def _tip_errors(plan: GraspPlan, joints: FloatArray) -> FloatArray:
    """Errors (s, n, 3) of contacts by joints that are off (s, nq), object's axes, m."""
    task, state = plan.task, HandState(plan.task.hand, plan.q)
    turn = task.T_world_object.rotation.T @ plan.T_world_base.rotation
    points = plan.contacts.transformed(plan.T_world_base.inverse()).positions
    rows = [
        turn @ state.point_jacobian(finger.pad.joint_id, point)[:3]
        for finger, point in zip(task.fingers, points, strict=True)
    ]
    return np.asarray(np.einsum("nij,sj->sni", np.array(rows), joints))


def _meets(plan: GraspPlan, way: FloatArray, joints: FloatArray) -> NDArray[np.bool_]:
    """Whether fingers meet one another or the table where they feel the surface, (s,).

    Args:
        plan: Where they are planned.
        way: How far each goes on along its normal until it feels, (s, n), m.
        joints: Errors of the joints (s, nq), rad.
    """
    neighbours = Neighbours(plan.task.hand, plan.task.fingers)
    q = np.repeat(plan.q[None], len(way), axis=0) + joints
    for i, one in enumerate(search_directions(plan)):
        q[:, one.index] += way[:, i, None] * one.straight
    table, turn = plan.task.table_height, plan.T_world_base.rotation
    above = np.inf if table is None else plan.T_world_base.translation[2] - table

    def rooms(q: FloatArray) -> FloatArray:
        ends = neighbours.ends(q)
        lowest = (ends @ turn[2]).min(axis=1) - neighbours.radii + above
        return np.concatenate([neighbours.gaps_of(ends), lowest])

    # capsules may be wider than links, which are clear where they are planned
    least = np.minimum(0.0, rooms(plan.q) - SPARE)
    return np.array([(rooms(one) < least).any() for one in q])


def _tips(plan: GraspPlan) -> NDArray[np.bool_]:
    """Whether each finger (n,), were it the first to push, tips the object instead of sliding it.

    A push at height h by what friction with the table bears, mu W, tips it where mu h exceeds the
    lever of the weight about the edge of the base. What has no base, as a ball, rolls either way.
    """
    task, contacts = plan.task, plan.contacts
    if task.table_height is None:
        return np.zeros(len(contacts), dtype=bool)
    vertices = surface_triangles(task.object.shape)[0] @ task.T_world_object.rotation.T
    base = vertices[vertices[:, 2] < vertices[:, 2].min() + BASE]
    push = contacts.normals[:, :2]
    levers = (push @ base[:, :2].T).max(axis=1)
    heights = contacts.positions[:, 2] - task.table_height
    flat = np.linalg.norm(push, axis=1)
    tips = (levers > SPARE * flat) & (TABLE_MU * heights * flat > levers)
    return np.asarray(tips, dtype=bool)


def _closed(contacts: ContactSet, positions: FloatArray, normals: FloatArray) -> bool:
    """Whether contacts close elsewhere, within the share of the friction that is pressed with."""
    mu = FRICTION_SHARE * contacts.mu
    there = replace(contacts, positions=positions, frames=contact_frames(normals), mu=mu)
    return plainly_closed(there, CLOSURE_EDGES) or force_closure(there, CLOSURE_EDGES).closed
