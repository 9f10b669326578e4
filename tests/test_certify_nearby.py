"""Bounds over a neighbourhood of a plan: against members drawn at random and another programme."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy.optimize import linprog

from planner.certify import NEAR, Neighbourhood, bound_nearby, breaking_along
from planner.certify.nearby import Changes
from planner.contacts import ContactSet, cone_edges
from planner.errors import ContactError, TaskError
from planner.kinematics import HandState
from planner.plan import GraspPlan
from planner.search.grasp import plan_grasp
from planner.spatial import SE3, FloatArray
from planner.task import GraspTask

NOWHERE = Neighbourhood(shift=0.0, turn=0.0, tips=0.0, joints=0.0)
FEW = 6
"""Members that are tried at a time: those of a Shadow hand take a tenth of a second to find."""

LEVER = 0.1
"""About the length of a finger, m."""

FORCE, TORQUE = np.eye(6)[1], 0.05 * np.eye(6)[3]


@pytest.fixture(
    scope="module",
    params=[("allegro_hand", "cylinder"), ("shadow_hand", "box"), ("allegro_hand", "sphere")],
    ids=["allegro", "shadow", "ball"],
)
def plan(request: pytest.FixtureRequest) -> GraspPlan:
    hand, item = request.param
    return plan_grasp(GraspTask.create(hand, item))


@dataclass(frozen=True)
class Member:
    """A grasp near a plan, in the hand's base."""

    q: FloatArray
    contacts: ContactSet  # about the centre of mass where it is
    jacobians: FloatArray  # (n, 6, nq)


def members(plan: GraspPlan, near: Neighbourhood, count: int) -> Iterator[Member]:
    """So many at random, many of them of full size: pads that touch, each about where it was."""
    rng = np.random.default_rng(5)
    hand, fingers = plan.task.hand, plan.task.fingers
    state = HandState(hand, plan.q)
    centers = np.array([state.pad_center(f) for f in fingers])
    radii = np.array([f.pad.radius for f in fingers])
    T_planned = plan.T_world_base.inverse() * plan.task.T_world_object
    while count:
        size = rng.choice([0.3, 0.6, 1.0], size=4)
        shift, axis = (v / np.linalg.norm(v) for v in rng.normal(size=(2, 3)))
        turned = SE3(SE3.Identity())
        angle = size[1] * near.turn
        cross = np.cross(np.eye(3), -axis)
        turned.rotation = np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * cross @ cross
        T = SE3(
            turned.rotation @ T_planned.rotation,
            T_planned.translation + size[0] * near.shift * shift,
        )
        wished = centers + size[2] * near.tips * _directions(rng, len(centers))
        seen = (wished - T.translation) @ T.rotation
        surface, outward = plan.task.object.shape.closest_point(seen)
        places = (surface + radii[:, None] * outward) @ T.rotation.T + T.translation
        if np.linalg.norm(places - centers, axis=1).max() > near.tips:
            continue
        spread = min(near.joints, near.tips / LEVER)
        q = plan.q + size[3] * spread * rng.choice([-1.0, 1.0], size=hand.nq)
        moved = reached(plan, q, places, near.joints)
        if moved is None:
            continue
        points = surface @ T.rotation.T + T.translation
        contacts = ContactSet.from_arrays(
            points,
            -outward @ T.rotation.T,
            mu=plan.task.mu,
            center=T.translation,
            model=plan.task.contact_model,
        )
        jacobians = np.array(
            [moved.point_jacobian(f.pad.joint_id, p) for f, p in zip(fingers, points, strict=True)]
        )
        count -= 1
        yield Member(q=moved.q, contacts=contacts, jacobians=jacobians)


def reached(plan: GraspPlan, q: FloatArray, places: FloatArray, within: float) -> HandState | None:
    """The hand with its pads' centres at places (n, 3), by Newton's method from joints (nq,).

    None if it does not get there with all joints within so much (rad) of the planned ones.
    """
    fingers = plan.task.fingers
    state = HandState(plan.task.hand, q)
    for _ in range(9):
        missed = [place - state.pad_center(f) for f, place in zip(fingers, places, strict=True)]
        left = np.abs(state.q - plan.q).max()
        if np.linalg.norm(missed, axis=1).max() < 1e-6:
            return state if left <= within else None
        if left > 3.0 * within:
            return None
        q = state.q.copy()
        for finger, way in zip(fingers, missed, strict=True):
            k = finger.q_index
            jacobian = state.point_jacobian(finger.pad.joint_id, state.pad_center(finger))[:3, k]
            q[k] += np.linalg.pinv(jacobian, rcond=1e-3) @ way
        state = HandState(plan.task.hand, q)
    return None


def most_borne(plan: GraspPlan, member: Member, wrench: FloatArray) -> float:
    """The largest factor of a wrench (world) that a member bears: by SciPy, from its own numbers.

    Cones are replaced by pyramids of 64 sides around them, which bear a little more.
    """
    hand, actuation = plan.task.hand, plan.task.hand.actuation
    turn = plan.T_world_base.rotation.T
    seen = np.concatenate([turn @ wrench[:3], turn @ wrench[3:]])
    gravity = turn @ plan.task.gravity
    contacts = member.contacts
    edges = cone_edges(plan.task.mu / np.cos(np.pi / 64), 0.0, 64)[:3]
    pushes, levers = [], []
    for i in range(len(contacts)):
        forces = contacts.frames[i] @ edges
        arm = contacts.positions[i] - contacts.center
        pushes.append(np.vstack([forces, np.cross(arm, forces.T).T]))
        levers.append(member.jacobians[i, :3].T @ forces)
    push, lever = np.hstack(pushes), np.hstack(levers)
    stops = actuation.stop_rows[actuation.active_stops(member.q)].T
    limits = actuation.force_limits(member.q)
    k, nu, ns = push.shape[1], len(limits), stops.shape[1]
    a_eq = np.block(
        [
            [push, np.zeros((6, nu + ns)), seen[:, None]],
            [-lever, actuation.moment.T, stops, np.zeros((hand.nq, 1))],
        ]
    )
    weight = np.concatenate([plan.task.object.mass * gravity, np.zeros(3)])
    own = HandState(hand, member.q).gravity_torque(gravity) - actuation.passive_torque(member.q)
    found = linprog(
        -np.eye(k + nu + ns + 1)[-1],
        A_eq=a_eq,
        b_eq=np.concatenate([-weight, own]),
        bounds=[*[(0, None)] * k, *limits.tolist(), *[(0, None)] * ns, (0, None)],
    )
    return float(-found.fun) if found.status == 0 else 0.0


def test_nowhere_else_it_is_the_bound_of_the_planned_posture() -> None:
    plan = plan_grasp(GraspTask.create("allegro_hand", "box"))
    for wrench in (FORCE, TORQUE, -FORCE):
        upper = breaking_along(plan.forces.problem, wrench).upper
        assert bound_nearby(plan, wrench, near=NOWHERE).factor == pytest.approx(upper, rel=2e-3)


@pytest.fixture(scope="module")
def near_members(plan: GraspPlan) -> list[Member]:
    return list(members(plan, NEAR, 2 * FEW))


@pytest.mark.slow
def test_no_member_bears_more(plan: GraspPlan, near_members: list[Member]) -> None:
    planned = [breaking_along(plan.forces.problem, wrench).upper for wrench in (FORCE, TORQUE)]
    for near in (NEAR, replace(NEAR, shift=3e-4, turn=3e-3), replace(NEAR, joints=0.05)):
        found = near_members if near is NEAR else list(members(plan, near, FEW))
        for wrench, least in zip((FORCE, TORQUE), planned, strict=True):
            bound = bound_nearby(plan, wrench, near=near).factor
            assert least < bound < 4.0 * least
            for member in found:
                assert most_borne(plan, member, wrench) <= bound


def test_members_bear_more_than_the_planned_posture_could() -> None:
    """Which is why its bound is none for what a hand has become under a load."""
    ball = plan_grasp(GraspTask.create("allegro_hand", "sphere"))
    planned = breaking_along(ball.forces.problem, FORCE).upper
    borne = [most_borne(ball, member, FORCE) for member in members(ball, NEAR, 20)]
    assert max(borne) > 1.02 * planned
    assert max(borne) > 0.5 * bound_nearby(ball, FORCE).factor


def test_a_contact_of_a_tip_that_stands_moves_by_the_chord_of_its_tilt(plan: GraspPlan) -> None:
    """It lies a pad's radius off the tip's centre, along the normal."""
    turned = Changes.of(plan, Neighbourhood(shift=0.0, turn=0.05, tips=0.0, joints=0.0))
    radii = np.array([finger.pad.radius for finger in plan.task.fingers])
    assert turned.arms.min() > 0.0
    assert (turned.arms <= 2.0 * radii * np.sin(turned.tilts / 2.0) + 1e-12).all()


def test_no_member_differs_by_more_than_is_said(
    plan: GraspPlan, near_members: list[Member]
) -> None:
    changes = Changes.of(plan, NEAR)
    actuation = plan.task.hand.actuation
    here = plan.contacts.transformed(plan.T_world_base.inverse())
    state = HandState(plan.task.hand, plan.q)
    gravity = plan.T_world_base.rotation.T @ plan.task.gravity
    first = np.array(
        [
            state.point_jacobian(f.pad.joint_id, p)
            for f, p in zip(plan.task.fingers, here.positions, strict=True)
        ]
    )
    used = np.zeros(3)
    for member in near_members:
        there = member.contacts
        arms = np.linalg.norm(
            (there.positions - there.center) - (here.positions - here.center), axis=1
        )
        tilts = np.arccos(np.clip((there.normals * here.normals).sum(axis=1), -1.0, 1.0))
        turned = np.linalg.norm((member.jacobians - first).reshape(len(first), 2, 3, -1), axis=2)
        slack = 1e-5  # the planned contacts are that near to the surface
        assert (arms <= changes.arms + slack).all()
        assert (tilts <= changes.tilts + 1e-3).all()
        assert (turned <= changes.jacobians + slack).all()
        used = np.maximum(
            used,
            [
                (arms / changes.arms).max(),
                (tilts / changes.tilts).max(),
                (turned / np.maximum(changes.jacobians, 1e-3)).max(),
            ],
        )
        limits = actuation.force_limits(member.q)
        assert (limits[:, 0] >= changes.limits[:, 0] - 1e-9).all()
        assert (limits[:, 1] <= changes.limits[:, 1] + 1e-9).all()
        assert set(np.flatnonzero(actuation.active_stops(member.q))) <= set(changes.stops.tolist())
        held = HandState(plan.task.hand, member.q)
        torque = (
            held.gravity_torque(gravity)
            - state.gravity_torque(gravity)
            + actuation.passive_torque(plan.q)
            - actuation.passive_torque(member.q)
        )
        assert (np.abs(torque) <= changes.torques + 1e-9).all()
    assert (used > 0.25).all()  # none of the bounds is far from what happens


def test_more_room_is_never_less(plan: GraspPlan) -> None:
    factors = [
        bound_nearby(
            plan, FORCE, near=Neighbourhood(shift=s * 1e-3, turn=0.01 * s, tips=s * 1e-3, joints=0)
        ).factor
        for s in (0.0, 0.25, 0.5, 1.0)
    ]
    assert factors == sorted(factors)


def test_a_mesh_has_no_such_bound() -> None:
    plan = plan_grasp(GraspTask.create("allegro_hand", "mug"))
    found = bound_nearby(plan, FORCE)
    assert np.isinf(found.factor)
    assert "a mesh may be concave" in found.reason


def test_what_makes_no_sense_is_refused(plan: GraspPlan) -> None:
    with pytest.raises(ContactError, match="give six finite numbers, not all zero"):
        bound_nearby(plan, np.zeros(6))
    with pytest.raises(TaskError, match="tips is -1; give a finite number >= 0"):
        Neighbourhood(tips=-1)
    assert "object within 1 mm and 1 degrees, fingertips within 1 mm" in str(NEAR)
    assert NEAR.holds(NOWHERE)
    assert not NOWHERE.holds(NEAR)


def _directions(rng: np.random.Generator, n: int) -> FloatArray:
    drawn = rng.normal(size=(n, 3))
    return np.asarray(drawn / np.linalg.norm(drawn, axis=1, keepdims=True))
