"""The verdict on the true geometry: every way to spoil a good grasp is found, and named."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from planner.collision.pregrasp import Approach, verify_approach
from planner.collision.world import CollisionWorld
from planner.failure import Failure
from planner.hands.hand import Hand
from planner.kinematics import HandState
from planner.plan import GraspPlan, Verification
from planner.search.grasp import plan_grasp
from planner.spatial import SE3, FloatArray
from planner.task import GraspTask, Obstacle
from planner.tolerances import TOUCH_TOL
from planner.verification import GAP_TOL, contacts_at, verify_geometry, verify_grasp


@pytest.fixture(scope="module")
def allegro_plan(allegro: Hand) -> GraspPlan:
    return plan_grasp(GraspTask.create(allegro, "box"))


@pytest.fixture(scope="module")
def shadow_plan(shadow: Hand) -> GraspPlan:
    return plan_grasp(GraspTask.create(shadow, "sphere"))


def judged(
    plan: GraspPlan,
    *,
    task: GraspTask | None = None,
    base: SE3 | None = None,
    q: FloatArray | None = None,
) -> Verification:
    world = CollisionWorld(task or plan.task)
    return verify_geometry(world, base or plan.T_world_base, plan.q if q is None else q)


def texts(found: Verification) -> list[str]:
    return [failure.text for failure in found.failures]


def turned_joint(plan: GraspPlan, name: str, angle: float) -> FloatArray:
    q = plan.q.copy()
    q[plan.task.hand.joint_index(name)] += angle
    return q


def moved_base(plan: GraspPlan, shift: FloatArray) -> SE3:
    return SE3(plan.T_world_base.rotation, plan.T_world_base.translation + shift)


def test_a_plan_has_no_faults_and_its_residuals_are_small(
    allegro_plan: GraspPlan, shadow_plan: GraspPlan
) -> None:
    for plan in (allegro_plan, shadow_plan):
        found = judged(plan)
        assert found.ok and found.failures == () and found.failure is None
        # what the last step promises, a twenty-fifth of what counts as touching
        assert np.abs(found.pad_gaps).max() <= GAP_TOL
        assert found.coupling_error < 1e-6 and found.limit_error == 0
        assert [c.distance for c in found.closest] == sorted(c.distance for c in found.closest)
        assert found.closest[0].distance >= 0


def test_gaps_are_the_distances_by_which_the_hand_was_moved(allegro_plan: GraspPlan) -> None:
    """Moving the hand against the first finger's normal opens its gap by just as much."""
    back = -allegro_plan.contacts.normals[0]
    for shift in (4e-4, 6e-4):
        found = judged(allegro_plan, base=moved_base(allegro_plan, shift * back))
        assert found.pad_gaps[0] == pytest.approx(shift, abs=2e-5)
        named = [f for f in texts(found) if f.startswith("thumb pad is ")]
        assert bool(named) == (shift > TOUCH_TOL)


def test_one_millimetre_off_is_refused_by_name_and_distance(allegro_plan: GraspPlan) -> None:
    plan = allegro_plan
    away = judged(plan, base=moved_base(plan, -1e-3 * plan.contacts.normals[0]))
    assert not away.ok
    assert "thumb pad is 1.00 mm from the surface (allowed 0.5)" in texts(away)
    into = judged(plan, base=moved_base(plan, 1e-3 * plan.contacts.normals[0]))
    assert "thumb pad is -1.00 mm from the surface (allowed 0.5)" in texts(into)
    outcome = verify_grasp(
        plan.task,
        moved_base(plan, -1e-3 * plan.contacts.normals[0]),
        plan.q,
        record=plan.record,
    )
    assert isinstance(outcome, Failure)
    assert outcome.text.startswith("true geometry: thumb pad is 1.00 mm from the surface")


def test_a_turn_of_the_wrist_is_refused(shadow_plan: GraspPlan) -> None:
    found = judged(shadow_plan, q=turned_joint(shadow_plan, "WRJ1", 0.05))
    fingers = {f.split()[0] for f in texts(found) if " pad is " in f}
    assert len(fingers) >= 3, texts(found)


def test_a_joint_outside_its_limit_is_refused(allegro_plan: GraspPlan) -> None:
    hand = allegro_plan.task.hand
    q = allegro_plan.q.copy()
    q[2] = hand.q_upper[2] + 0.01
    found = judged(allegro_plan, q=q)
    assert found.limit_error == pytest.approx(0.01)
    assert "a joint limit is violated by 1.0e-02 rad" in texts(found)


def test_a_violated_coupling_is_refused(shadow_plan: GraspPlan) -> None:
    """Little finger: it does not take part, so nothing else changes."""
    found = judged(shadow_plan, q=turned_joint(shadow_plan, "LFJ2", 0.02))
    assert "little" not in shadow_plan.task.finger_names
    assert found.coupling_error == pytest.approx(0.02, abs=1e-6)
    assert "a coupling is violated by 2.0e-02 rad" in texts(found)


def test_a_link_in_the_table_is_refused(shadow_plan: GraspPlan) -> None:
    """A sphere looks the same from below: turned over with it, the hand is under the table."""
    task = shadow_plan.task
    center = task.T_world_object.translation
    over = SE3(np.array(pin.exp3(np.array([np.pi, 0.0, 0.0]))), np.zeros(3))
    base = SE3(np.eye(3), center) * over * SE3(np.eye(3), -center) * shadow_plan.T_world_base
    found = judged(shadow_plan, base=base)
    assert not [f for f in texts(found) if " pad is " in f]
    assert any(f.startswith("penetration, palm") and " - table: -" in f for f in texts(found))
    lifted = judged(shadow_plan, base=base, task=replace(task, table_height=None))
    assert lifted.ok


def test_a_link_in_an_obstacle_is_refused_with_both_names(allegro_plan: GraspPlan) -> None:
    task = allegro_plan.task
    pose = SE3(np.eye(3), allegro_plan.T_world_palm.translation)
    lamp = Obstacle(name="lamp", size=np.full(3, 0.02), T_world_obstacle=pose)
    found = judged(allegro_plan, task=replace(task, obstacles=(lamp,)))
    assert any(f.startswith("penetration, palm") and "- lamp: -" in f for f in texts(found))


def test_two_fingers_in_each_other_are_refused(allegro_plan: GraspPlan) -> None:
    """The first joints swing the fingers sideways: index and middle towards each other."""
    hand = allegro_plan.task.hand
    q = hand.posture("open")
    q[hand.joint_index("index_0")] = hand.q_lower[hand.joint_index("index_0")]
    q[hand.joint_index("middle_0")] = hand.q_upper[hand.joint_index("middle_0")]
    faults = texts(judged(allegro_plan, q=q))
    assert any("index" in f and "middle" in f for f in faults if f.startswith("penetration"))


def test_a_contact_beside_the_pad_is_refused(shadow: Hand) -> None:
    """The sphere touches the thumb's pad sphere, but on its back, through the finger's bone."""
    task = GraspTask.create(shadow, "sphere", table_height=None)
    q = shadow.posture("pinch")
    thumb, state = shadow.fingers["thumb"], HandState(shadow, q)
    reach = thumb.pad.radius + 0.035
    at = state.pad_center(thumb) - reach * state.pad_axis(thumb)
    base = SE3(np.eye(3), task.T_world_object.translation - at)
    found = verify_geometry(CollisionWorld(task), base, q)
    assert found.pad_gaps[0] == pytest.approx(0.0, abs=1e-9)
    assert found.pad_angles[0] == pytest.approx(np.pi)
    assert "thumb touches 180 degrees off its pad axis, outside the pad" in texts(found)
    assert any(
        f.startswith(f"{thumb.pad.geom} is -") and f.endswith("although its pad touches")
        for f in texts(found)
    )


def test_contacts_lie_on_the_true_surface_with_normals_into_the_object(
    allegro_plan: GraspPlan,
) -> None:
    plan = allegro_plan
    found = contacts_at(plan.task, plan.T_world_base, plan.q).transformed(
        plan.task.T_world_object.inverse()
    )
    half = plan.task.object.shape.half_extents
    faces = np.abs(found.positions) / half
    np.testing.assert_allclose(faces.max(axis=1), 1.0, atol=1e-12)
    for position, normal, finger in zip(
        found.positions, found.normals, plan.task.fingers, strict=True
    ):
        face = int(np.argmax(np.abs(position) / half))
        expected = np.zeros(3)
        expected[face] = -np.sign(position[face])
        np.testing.assert_allclose(normal, expected, atol=1e-12)
        center = (plan.task.T_world_object.inverse() * plan.T_world_base).act(
            HandState(plan.task.hand, plan.q).pad_center(finger)
        )
        np.testing.assert_allclose(
            position, center + finger.pad.radius * normal, rtol=0, atol=GAP_TOL
        )


def test_too_little_friction_is_no_closure(allegro: Hand) -> None:
    """Pads on the upright sides of a box leave up and down to friction alone."""
    plan = plan_grasp(GraspTask.create(allegro, "box"))
    assert np.abs(plan.contacts.normals[:, 2]).max() < 1e-6
    slippery = replace(plan.task, mu=1e-9)
    outcome = verify_grasp(slippery, plan.T_world_base, plan.q, record=plan.record)
    assert isinstance(outcome, Failure)
    assert outcome.text.startswith("no force closure"), outcome


def test_too_heavy_is_no_forces(allegro_plan: GraspPlan) -> None:
    """A grasp closes whatever the mass, but motors do not hold 50 kg."""
    heavy = replace(allegro_plan.task, object=replace(allegro_plan.task.object, mass=50.0))
    outcome = verify_grasp(
        heavy, allegro_plan.T_world_base, allegro_plan.q, record=allegro_plan.record
    )
    assert isinstance(outcome, Failure)
    assert outcome.text.startswith("forces: "), outcome


def test_an_approach_that_touches_is_refused(allegro_plan: GraspPlan) -> None:
    plan, world = allegro_plan, CollisionWorld(allegro_plan.task)
    good = Approach(
        q=plan.q_pregrasp,
        pregrasp_distance=plan.pregrasp_distance,
        T_world_base_start=plan.T_world_base_start,
    )
    assert verify_approach(world, plan.T_world_base, plan.q, good) is None
    closed = replace(good, q=plan.q)
    failure = verify_approach(world, plan.T_world_base, plan.q, closed)
    assert failure is not None and failure.kind == "approach_collision"
    assert "the hand touches on its way in" in failure.text
    below = replace(good, T_world_base_start=moved_base(plan, np.array([0.0, 0.0, -0.2])))
    failure = verify_approach(world, plan.T_world_base, plan.q, below)
    assert "the hand touches on its way in" in str(failure)
    turned = plan.T_world_base_start * SE3(pin.exp3(np.array([0.1, 0, 0])), np.zeros(3))
    turning = replace(good, T_world_base_start=turned)
    failure = verify_approach(world, plan.T_world_base, plan.q, turning)
    assert str(failure) == "the hand turns on its way in"
