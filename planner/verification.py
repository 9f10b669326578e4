"""``verify_grasp``: a base pose and joints become a plan if everything holds, else a ``Failure``.

The search asks it about what the solver found, and whoever reads a plan from a file asks it again.
The solver's result is recomputed here by other code on other geometry: Pinocchio's kinematics,
coal's distances between the true shapes (no spheres, no softened edges), contact points and normals
of the true surface.

The solver's solution touches a model of the object (the smooth field of a mesh) with a model of the
pad (a sphere). Both are right to some tenths of a millimetre. ``project_onto_surface`` moves the
fingers' own joints by the least amount that brings every pad onto the true surface and closes the
couplings,

    min |dq|  s.t.  n_i' J_i dq = -gap_i,   C dq = d - C q,   wrist and base as they are,

repeated until gaps and couplings are met (``planner.numerics.least_squares``).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np

from planner.collision.arm_path import beyond_limits, lift_height
from planner.collision.pad_contact import PadContact, pad_contact_queries, pad_contacts
from planner.collision.pregrasp import Approach, find_approach, verify_approach
from planner.collision.world import CollisionWorld
from planner.contacts import ContactSet
from planner.failure import Failure
from planner.forces import (
    ForceArguments,
    ForceSolution,
    distribute_forces,
    gravity_wrench,
)
from planner.kinematics import HandState, moving_hand
from planner.numerics.least_squares import Task, ik_step
from planner.objects import NeededWrench
from planner.plan import GraspPlan, SolveRecord, Verification
from planner.quality import ClosureResult, force_closure, plainly_closed
from planner.spatial import SE3, FloatArray, IntArray, contact_frames
from planner.system.threads import stage
from planner.task import GraspTask
from planner.tolerances import (
    ANGLE_TOL,
    CLOSURE_EDGES,
    EDGE_RADIUS,
    EDGE_SPREAD,
    FLAT_ANGLE_TOL,
    FRICTION_SHARE,
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


GAP_TOL = 2e-5
"""Gap (m) that counts as none: a twenty-fifth of what counts as touching."""

COUPLING_TOL = 1e-7
"""Violation of a coupling (rad) that counts as none: a tenth of what is allowed in the verdict."""

STEPS = 8
"""Most steps."""

NO_FORCES, NO_NEEDED = "no_forces", "no_needed_wrench"
"""Kinds of the failures of a grasp that cannot bear the weight, and a needed wrench."""

FARTHEST = 0.006
"""Largest gap (m) that is still a matter of models; more than that is no solution."""


def project_onto_surface(task: GraspTask, T_world_base: SE3, q: FloatArray) -> FloatArray:
    """Joints (nq,) near q with every pad on the true surface, as far as limits let them.

    The verdict on it is ``planner.verification``'s; q itself if it touches already, or is
    too far off.
    """
    hand, touching = task.hand, pad_contact_queries(task)
    matrix, value = hand.coupling_matrix
    index = _moved(task)
    lower, upper = hand.q_lower[index], hand.q_upper[index]
    turn = T_world_base.rotation.T @ task.T_world_object.rotation
    q = q.copy()
    for _ in range(STEPS):
        found = touching.gaps(T_world_base, q)
        missing = value - matrix @ q
        worst = float(np.abs(found.gaps).max())
        arrived = worst <= GAP_TOL and float(np.abs(missing).max(initial=0.0)) <= COUPLING_TOL
        if arrived or worst > FARTHEST:
            break
        rates = np.einsum("ni,nij->nj", found.outward @ turn.T, found.jacobians)
        touch = Task(np.vstack([rates, matrix])[:, index], np.concatenate([-found.gaps, missing]))
        q[index] = ik_step(touch, q[index], lower, upper)
    return q


def with_palm_on_surface(task: GraspTask, T_world_base: SE3, q: FloatArray) -> SE3:
    """The base moved so that a palm that takes part touches, which no joint can bring there.

    The base itself if it is fixed, or too far off.
    """
    palms = [i for i, finger in enumerate(task.fingers) if not finger.joints]
    if not palms or task.T_world_base is not None:
        return T_world_base
    found = pad_contacts(task, T_world_base, q)[palms[0]]
    if abs(found.pad_gap) > FARTHEST:
        return T_world_base
    way = -found.pad_gap * (task.T_world_object.rotation @ found.outward)
    return SE3(T_world_base.rotation, T_world_base.translation + way)


@lru_cache(maxsize=8)
def _moved(task: GraspTask) -> IntArray:
    """Joints (k,) that may move: the task's fingers, and what is coupled on fingers left out."""
    hand = task.hand
    coupled = np.flatnonzero(np.abs(hand.coupling_matrix[0]).sum(axis=0))
    held = np.concatenate([hand.wrist_index, hand.arm_index])
    mine = np.concatenate([hand.carriage_index, *(f.q_index for f in task.fingers)])
    found = np.union1d(mine, np.setdiff1d(coupled, held))
    found.flags.writeable = False
    return found


def verify_grasp(
    task: GraspTask,
    T_world_base: SE3,
    q: FloatArray,
    *,
    record: SolveRecord,
    approach: Approach | None = None,
    world: CollisionWorld | None = None,
) -> GraspPlan | Failure:
    """A plan out of a base pose and joints if everything holds on the true geometry; else why not.

    Args:
        task: The task.
        T_world_base: Base pose at the grasp.
        q: Joints (nq,), within their limits.
        record: Where the candidate comes from.
        approach: Pre-grasp and way in, checked; searched for if None.
        world: True geometry of the task, if it is at hand already.
    """
    world = world or CollisionWorld(task)
    with stage("verify"):
        touches = pad_contacts(task, T_world_base, q)
        verification = verify_geometry(world, T_world_base, q, touches)
    if verification.failure is not None:
        return verification.failure
    contacts = contacts_of(task, touches)
    with stage("closure"):
        proven = plainly_closed(contacts, edges=CLOSURE_EDGES)
        closure = None if proven else force_closure(contacts, edges=CLOSURE_EDGES)
    if closure is not None and not closure.closed:
        return no_closure(closure)
    with stage("forces"):
        forces = plan_forces(task, contacts, T_world_base, q)
    if not forces.found:
        return no_forces(task, forces)
    with stage("forces"):
        needed = needed_forces(task, contacts, T_world_base, q)
    for one, found in zip(task.needed, needed, strict=True):
        if not found.found:
            return no_needed(task, one, found)
    with stage("approach"):
        way = _way_in(world, T_world_base, q, contacts, approach)
    if not isinstance(way, Failure) and way.arm is not None and task.hand.pair:
        way = lift_torques(task, T_world_base, q, forces.contacts, way.arm.lift) or way
    if isinstance(way, Failure):
        return way.at("approach")
    return GraspPlan(
        task=task,
        T_world_base=T_world_base,
        T_world_base_start=way.T_world_base_start,
        q=q,
        q_pregrasp=way.q,
        pregrasp_distance=way.pregrasp_distance,
        arm=way.arm,
        contacts=forces.contacts,
        forces=forces,
        verification=verification,
        record=record,
        needed=needed,
    )


def lift_torques(
    task: GraspTask, T_world_base: SE3, q: FloatArray, contacts: ContactSet, lift: FloatArray
) -> Failure | None:
    """Which actuator cannot give what two arms press and carry with along their lift; None if all.

    The contact forces stay as planned, since the object does not turn: torque = sum J^T f + g(q).

    Args:
        task: Hand and gravity.
        T_world_base: Base pose.
        q: Joints of the grasp (nq,).
        contacts: With their forces, world, at the grasp.
        lift: Arm postures (k, n).
    """
    hand, joints = task.hand, np.array(q, dtype=np.float64)
    soft = np.nan_to_num(contacts.forces[:, 3])[:, None] * contacts.normals
    wrenches = np.hstack([contacts.forces_in_axes(), soft]) @ np.kron(
        np.eye(2), T_world_base.rotation
    )
    pads = np.array([f.pad.joint_id for f in task.fingers])
    points = (contacts.positions - T_world_base.translation) @ T_world_base.rotation
    up = T_world_base.rotation.T @ np.array([0.0, 0.0, lift_height(hand)])
    for share, posture in zip(np.linspace(0.0, 1.0, len(lift)), lift, strict=True):
        joints[hand.arm_index] = posture
        state = HandState(hand, joints)
        torque = state.gravity_torque(T_world_base.rotation.T @ task.gravity)
        jacobians = state.point_jacobians(pads, points + share * up)
        torque += np.einsum("nij,ni->j", jacobians, wrenches)
        # fingers' torques stay
        if (failure := beyond_limits(hand, joints, torque, LIFT_TORQUE_TOL)) is not None:
            return failure.at(f"{share:.0%} of the lift")
    return None


LIFT_TORQUE_TOL = 0.05
"""How far (N m) an actuator may be beyond its limit along a lift: what servos do not hold to."""


def _way_in(
    world: CollisionWorld,
    T_world_base: SE3,
    q: FloatArray,
    contacts: ContactSet,
    given: Approach | None,
) -> Approach | Failure:
    """The given approach if nothing is wrong with it, one that is found where none is given."""
    if given is None:
        return find_approach(world, T_world_base, q, contacts.normals)
    return verify_approach(world, T_world_base, q, given) or given


def no_closure(closure: ClosureResult) -> Failure:
    """The failure of contacts that do not close."""
    return Failure(
        kind="no_closure",
        text=f"no force closure: {closure.reason}",
        numbers={"normalised_min_weight": closure.normalised_min_weight},
    )


def no_forces(task: GraspTask, forces: ForceSolution) -> Failure:
    """The failure of a grasp whose contacts or actuators cannot bear the object's weight."""
    return Failure(
        kind=NO_FORCES,
        text=f"forces: with {task.grip_force:.3g} N per finger, {forces.reason}",
        numbers={"fraction": forces.fraction},
    )


def no_needed(task: GraspTask, needed: NeededWrench, forces: ForceSolution) -> Failure:
    """The failure of a grasp that cannot produce a needed wrench; names what ends it."""
    return Failure(
        kind=NO_NEEDED,
        text=f"needed wrench {needed.name!r}, {task.needed_margin:g} times: {forces.reason}",
        numbers={"fraction": forces.fraction},
    )


def needed_forces(
    task: GraspTask, contacts: ContactSet, T_world_base: SE3, q: FloatArray
) -> tuple[ForceSolution, ...]:
    """Contact forces (world) that produce each needed wrench with the task's margin.

    They bear the object's weight too, at the pose of the grasp.

    Args:
        task: Gives needed wrenches, weight, friction and grip.
        contacts: One contact per finger of the task, world.
        T_world_base: Base pose.
        q: Joints (nq,).
    """
    weight, margin = gravity_wrench(task.object.mass, task.gravity), task.needed_margin
    return tuple(
        plan_forces(task, contacts, T_world_base, q, wrench=weight + margin * task.needed_load(one))
        for one in task.needed
    )


def plan_forces(
    task: GraspTask, contacts: ContactSet, T_world_base: SE3, q: FloatArray, **options: Any
) -> ForceSolution:
    """Contact forces (world) that carry the object's weight, within torque limits, at a grasp.

    Args:
        task: Gives weight, friction and grip.
        contacts: One contact per finger of the task, world.
        T_world_base: Base pose.
        q: Joints (nq,).
        **options: Passed to ``distribute_forces``.
    """
    given: dict[str, Any] = {**force_arguments(task, contacts, T_world_base, q), **options}
    return distribute_forces(contacts, **given)


def with_grip(plan: GraspPlan, grip_force: float) -> GraspPlan:
    """The same grasp pressed with another least normal force.

    Its ``forces`` tell whether the hand's actuators have that much; where not, ``found`` is False
    and the reason is with them.

    Args:
        plan: The grasp.
        grip_force: N per finger.

    Raises:
        TaskError: The grip is negative or not finite.
    """
    task = replace(plan.task, grip_force=grip_force)
    forces = plan_forces(task, plan.contacts, plan.T_world_base, plan.q)
    needed = needed_forces(task, plan.contacts, plan.T_world_base, plan.q)
    return replace(plan, task=task, forces=forces, contacts=forces.contacts, needed=needed)


def force_arguments(
    task: GraspTask, contacts: ContactSet, T_world_base: SE3, q: FloatArray
) -> ForceArguments:
    """What ``build_force_problem`` needs for a task's weight, grip and hand at a grasp.

    Args:
        task: Gives weight, friction and grip.
        contacts: One contact per finger of the task, world.
        T_world_base: Base pose.
        q: Joints (nq,).
    """
    state = moving_hand(task.hand).move(q)
    rotation = T_world_base.rotation
    joints = np.array([f.pad.joint_id for f in task.fingers])
    points = (contacts.positions - T_world_base.translation) @ rotation
    local = state.point_jacobians(joints, points)
    jacobians = (rotation @ local.reshape(-1, 2, 3, task.hand.nq)).reshape(local.shape)
    given: ForceArguments = {
        "wrench": gravity_wrench(task.object.mass, task.gravity),
        "min_normal": task.grip_force if task.is_of_fingertips else task.least_normals,
        "friction_scale": FRICTION_SHARE,
        "jacobians": jacobians,
        "actuation": task.hand.actuation,
        "q": q,
        "gravity_torque": state.gravity_torque(rotation.T @ task.gravity),
    }
    if not task.is_of_fingertips:  # three joints or more move a fingertip wherever a force points
        given["contact_compliance"] = 1.0
    return given
