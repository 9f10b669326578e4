"""Offsets from contacts: answers on paper, and hands with offsets that only the test knows."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from conftest import PlanOf

from planner.kinematics import HandState
from planner.plan import GraspPlan
from planner.shapes import Sphere
from planner.spatial import SE3, FloatArray
from sim.controllers.calibration import DISTANCE, OFFSET, ContactSample, estimate_offsets


@pytest.fixture(scope="module", params=["allegro_hand", "shadow_hand"])
def plan(request: pytest.FixtureRequest, plan_of: PlanOf) -> GraspPlan:
    return plan_of(request.param, "ellipsoid")


def look_of(
    plan: GraspPlan, offset: FloatArray, *, pads: bool = True, pose_error: SE3 | None = None
) -> ContactSample:
    """What a hand at the plan's true contacts reads with encoders that are off."""
    true, read = HandState(plan.task.hand, plan.q), HandState(plan.task.hand, plan.q + offset)
    inverse = plan.T_world_base.inverse()
    T_base_object = inverse * plan.task.T_world_object
    points, normals = [], []
    for finger, p, n in zip(
        plan.task.fingers, plan.contacts.positions, plan.contacts.normals, strict=True
    ):
        joint = finger.pad.joint_id
        moved = read.joint_pose(joint) * true.joint_pose(joint).inverse()
        points.append(moved.act(inverse.act(p)))
        normals.append(moved.rotation @ inverse.rotation @ n)
    return ContactSample(
        q=plan.q + offset,
        T_base_object=(pose_error or SE3.Identity()) * T_base_object,
        touching=np.ones(len(points), dtype=bool),
        points=np.array(points) if pads else None,
        normals=np.array(normals) if pads else None,
    )


def estimated(plan: GraspPlan, *samples: ContactSample, prior: float = OFFSET) -> FloatArray:
    task = plan.task
    found = estimate_offsets(task.hand, task.fingers, task.object.shape, samples, prior=prior)
    return found.offset


def test_exact_joints_have_no_offset(plan: GraspPlan) -> None:
    found = estimated(plan, look_of(plan, np.zeros(plan.task.hand.nq)))
    assert np.abs(found).max() < np.deg2rad(
        0.15
    )  # the plan's pads are on the surface within 0.1 mm


def test_one_contact_moves_the_joints_in_proportion_to_their_levers(plan: GraspPlan) -> None:
    """On paper: J d = r has, with equal priors s, the answer J^T r / (J J^T + (s_d / s)^2)."""
    task = plan.task
    hand, finger = task.hand, task.fingers[0]
    state = HandState(hand, plan.q)
    center, r = state.pad_center(finger), 0.0004
    ball = Sphere(radius=0.03)
    side = np.array([0.0, 0.0, 1.0])
    # the reading has the pad 0.4 mm short of a ball at rest
    T = SE3(np.eye(3), center + (0.03 + finger.pad.radius + r) * side)
    touching = np.zeros(len(task.fingers), dtype=bool)
    touching[0] = True
    sample = ContactSample(q=plan.q, T_base_object=T, touching=touching)
    found = estimate_offsets(hand, task.fingers, ball, [sample], position=1e-9, rotation=1e-9)
    lever = state.point_jacobian(finger.pad.joint_id, center)[2]  # towards the ball
    # true = read - offset: the offset is against the way
    expected = -lever * r / (lever @ lever + (DISTANCE / OFFSET) ** 2)
    np.testing.assert_allclose(found.offset, expected, atol=0.06 * np.abs(expected).max())
    assert found.before == pytest.approx(r)
    assert found.after < 0.2 * r
    # of directions that the contact does not see, nothing is claimed
    assert found.deviation[task.fingers[1].q_index] == pytest.approx(OFFSET)


@pytest.mark.parametrize("seed", range(3))
def test_contacts_bring_the_pads_to_where_they_are(plan: GraspPlan, seed: int) -> None:
    rng = np.random.default_rng(seed)
    hand = plan.task.hand
    offset = np.deg2rad(2.0) * rng.standard_normal(hand.nq)
    sample = look_of(plan, offset)
    found = estimated(plan, sample)
    moving = hand.moved_by[[f.pad.joint_id for f in plan.task.fingers]].any(axis=0)
    assert not found[~moving].any()
    true = HandState(hand, plan.q)

    def turned(q: FloatArray) -> FloatArray:
        """How far (rad) the normals of the pads are off at joints q."""
        state = HandState(hand, q)
        errors = []
        for finger in plan.task.fingers:
            joint = finger.pad.joint_id
            apart = state.joint_pose(joint).rotation @ true.joint_pose(joint).rotation.T
            errors.append(np.linalg.norm(pin.log3(apart)))
        return np.array(errors)

    def rms(values: FloatArray) -> float:
        return float(np.sqrt(np.mean(values**2)))

    assert rms(turned(sample.q - found)) < 0.9 * rms(turned(sample.q))
