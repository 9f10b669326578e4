"""What reviewers broke on purpose without a test noticing: units, paths, torques, fixed poses."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from conftest import PlanOf

from planner.collision.pregrasp import Approach, verify_approach
from planner.collision.world import CollisionWorld
from planner.errors import TaskError
from planner.failure import Failure
from planner.kinematics import HandState
from planner.plan import GraspPlan
from planner.search.grasp import plan_grasp
from planner.spatial import SE3
from planner.task import GraspTask, Obstacle
from planner.verification import verify_grasp
from sim.recorder import Recorder
from sim.simulation import Simulation
from sim.trial import Trial


@pytest.fixture(scope="module")
def plan(plan_of: PlanOf) -> GraspPlan:
    return plan_of("allegro_hand", "sphere")


def test_slip_is_in_millimetres_and_degrees(plan: GraspPlan) -> None:
    simulation = Simulation(plan, q=plan.q, T_world_base=plan.T_world_base)
    scene, data = simulation.scene, simulation.data
    recorder = Recorder(simulation, 0.02)
    recorder.mark_reference()
    moved = SE3(pin.exp3(np.deg2rad(7.0) * np.array([0.6, 0.0, 0.8])), np.array([0.0, 0.003, 0.0]))
    data.xpos[scene.object_body] += moved.translation
    turned = moved.rotation @ data.xmat[scene.object_body].reshape(3, 3)
    data.xmat[scene.object_body] = turned.ravel()
    data.xquat[scene.object_body] = pin.Quaternion(turned).coeffs()[[3, 0, 1, 2]]
    recorder.record()
    samples = recorder.samples()
    assert samples.slip_mm[-1] == pytest.approx(3.0, abs=1e-6)
    assert samples.slip_deg[-1] == pytest.approx(7.0, abs=1e-6)


def rod_across_the_way(plan: GraspPlan, share: float) -> Obstacle:
    """A rod of 2 mm just outside a fingertip at a share of the way in, moved past on the way."""
    way = plan.T_world_base_start.translation - plan.T_world_base.translation
    tip = plan.T_world_base.act(
        HandState(plan.task.hand, plan.q_pregrasp).pad_center(plan.task.fingers[0])
    )
    at = SE3(np.eye(3), tip + share * way)
    return Obstacle(name="rod", size=np.array([0.002, 0.002, 0.002]), T_world_obstacle=at)


@pytest.mark.parametrize("share", np.linspace(0.3, 0.95, 9))
def test_nothing_small_hides_between_samples_of_the_approach(plan: GraspPlan, share: float) -> None:
    task = replace(plan.task, obstacles=(rod_across_the_way(plan, share),))
    approach = Approach(
        q=plan.q_pregrasp,
        pregrasp_distance=plan.pregrasp_distance,
        T_world_base_start=plan.T_world_base_start,
    )
    fault = verify_approach(CollisionWorld(task), plan.T_world_base, plan.q, approach)
    assert "rod" in str(fault)
    assert verify_approach(CollisionWorld(plan.task), plan.T_world_base, plan.q, approach) is None


def test_joint_torques_are_the_contacts_and_the_hands_own_weight(plan: GraspPlan) -> None:
    hand, task = plan.task.hand, plan.task
    model = hand.pin_model.copy()
    model.gravity = pin.Motion(
        np.concatenate([plan.T_world_base.rotation.T @ task.gravity, np.zeros(3)])
    )
    expected = pin.computeGeneralizedGravity(model, model.createData(), plan.q)
    state = HandState(hand, plan.q)
    inverse = plan.T_world_base.inverse()
    for finger, point, force in zip(
        task.fingers, plan.contacts.positions, plan.contacts.forces_in_axes(), strict=True
    ):
        jacobian = state.point_jacobian(finger.pad.joint_id, inverse.act(point))[:3]
        expected = expected + jacobian.T @ (inverse.rotation @ force)
    np.testing.assert_allclose(plan.forces.joint_torques, expected, atol=1e-9)


def test_a_grasp_keeps_what_the_task_fixes(plan: GraspPlan) -> None:
    elsewhere = SE3(np.eye(3), np.array([1.0, 0.0, 0.0])) * plan.T_world_base
    task = replace(plan.task, T_world_base=elsewhere)
    judged = verify_grasp(task, plan.T_world_base, plan.q, record=plan.record)
    assert isinstance(judged, Failure)
    assert "the base is not where the task fixes it" in judged.text


def test_a_pregrasp_outside_its_limits_is_refused(plan: GraspPlan) -> None:
    q = plan.q_pregrasp.copy()
    q[0] = plan.task.hand.q_upper[0] + 0.1
    approach = Approach(q=q, pregrasp_distance=0.02, T_world_base_start=plan.T_world_base_start)
    judged = verify_grasp(
        plan.task, plan.T_world_base, plan.q, record=plan.record, approach=approach
    )
    assert str(judged) == "approach: the pre-grasp violates a joint limit or a coupling"


def test_an_obstacle_in_the_object_is_refused(plan: GraspPlan) -> None:
    inside = Obstacle(name="nail", size=np.full(3, 0.01), T_world_obstacle=plan.task.T_world_object)
    with pytest.raises(TaskError, match="inside 'nail'; move them apart"):
        CollisionWorld(replace(plan.task, obstacles=(inside,)))


def test_an_object_in_the_air_needs_to_be_held() -> None:
    up = SE3(np.eye(3), np.array([0.0, 0.0, 0.3]))
    with pytest.raises(TaskError, match=r"floats .* give table_height=None"):
        GraspTask.create("allegro_hand", "sphere", T_world_object=up)
    GraspTask.create("allegro_hand", "sphere", T_world_object=up, table_height=None)


def test_a_trial_runs_once_and_is_recorded_often(plan: GraspPlan) -> None:
    with pytest.raises(TaskError, match=r"record_every, .*, is 2\.3"):
        Trial(plan, record_every=2.3)
    trial = Trial(plan)
    trial.run(on_step=lambda t: (_ for _ in ()).throw(KeyboardInterrupt))
    with pytest.raises(TaskError, match="has run already"):
        trial.run()


def test_numbers_that_are_none() -> None:
    with pytest.raises(TaskError, match="mu is None; give a number"):
        GraspTask.create("allegro_hand", "sphere", mu=None)  # type: ignore[arg-type]
    with pytest.raises(TaskError, match=r"seed is 1\.5; give an integer"):
        plan_grasp(GraspTask.create("allegro_hand", "sphere"), seed=1.5)  # type: ignore[arg-type]


@pytest.mark.parametrize("spec", ["sphere:0.05", "box:0.09x0.09x0.1"])
def test_an_object_wider_than_the_open_posture_is_grasped(spec: str) -> None:
    """Pads stand 88 mm apart in the Allegro's open posture, but can be stretched further."""
    found = plan_grasp(GraspTask.create("allegro_hand", spec), seed=0)
    assert found.verification.ok
