"""What moves in a simulation, by closed forms: slip, sliding of pads, twists, damped turns.

Each number is compared with one that is worked out another way: a movement that was put in, a
difference of poses, MuJoCo's Jacobians of points, the solution of the differential equation.
"""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
import pinocchio as pin
import pytest
from conftest import PlanOf

from planner.plan import GraspPlan
from planner.spatial import SE3, FloatArray, pose_to_wxyz
from sim.contacts import hand_contacts
from sim.controllers import GraspController, ImpedanceGains
from sim.controllers.impedance import ImpedanceLaw
from sim.protocols.disturbance import DisturbanceTrial
from sim.scene.build import HAND_PREFIX, Scene
from sim.trial import Trial

IN_PALM = SE3(pin.exp3(np.array([0.3, -0.5, 0.2])), np.array([0.02, -0.09, 0.1]))
"""Any place of an object in a palm."""


@pytest.fixture(scope="module")
def allegro_plan(plan_of: PlanOf) -> GraspPlan:
    return plan_of("allegro_hand", "sphere")


@pytest.fixture(scope="module")
def shadow_plan(plan_of: PlanOf) -> GraspPlan:
    """With a wrist between base and palm."""
    return plan_of("shadow_hand", "sphere")


def put(scene: Scene, data: Any, T_palm_object: SE3) -> None:
    """Put the object into the palm, wherever that is."""
    mujoco.mj_kinematics(scene.model, data)
    T_world_object = scene.body_pose(data, scene.palm_body) * T_palm_object
    data.qpos[scene.object_qpos] = np.concatenate(pose_to_wxyz(T_world_object))
    mujoco.mj_forward(scene.model, data)


def bend_wrist(scene: Scene, data: Any) -> None:
    hand = scene.task.hand
    for name in ("WRJ1", "WRJ2"):
        data.qpos[scene.hand_qpos[hand.joint_names.index(name)]] += 0.2


# --- slip --------------------------------------------------------------------------------------


def test_an_object_that_goes_along_with_the_palm_does_not_slip(shadow_plan: GraspPlan) -> None:
    """A wrist that bends takes palm and object along; only what moves in the palm slips."""
    trial = Trial(shadow_plan)
    scene, data = trial.simulation.scene, trial.simulation.data
    put(scene, data, IN_PALM)
    trial.recorder.mark_reference()
    trial.recorder.record()
    T_base_object = scene.body_pose(data, scene.base_body).inverse() * scene.body_pose(
        data, scene.object_body
    )
    bend_wrist(scene, data)
    put(scene, data, IN_PALM)
    trial.recorder.record()
    now = scene.body_pose(data, scene.base_body).inverse() * scene.body_pose(
        data, scene.object_body
    )
    assert np.linalg.norm(now.translation - T_base_object.translation) > 0.01
    slipped = SE3(
        IN_PALM.rotation @ pin.exp3(np.array([0.0, 0.1, 0.0])),
        IN_PALM.translation + np.array([0.002, 0.0, -0.001]),
    )
    put(scene, data, slipped)
    trial.recorder.record()
    samples = trial.recorder.samples()
    np.testing.assert_allclose(samples.slip_mm, [0.0, 0.0, 5**0.5], atol=1e-9)
    np.testing.assert_allclose(samples.slip_deg, [0.0, 0.0, np.rad2deg(0.1)], atol=1e-5)


def test_a_held_object_is_where_it_is_in_the_palm(shadow_plan: GraspPlan) -> None:
    hold = DisturbanceTrial(shadow_plan, controller=GraspController(shadow_plan))
    bend_wrist(hold.simulation.scene, hold.simulation.data)
    put(hold.simulation.scene, hold.simulation.data, IN_PALM)
    assert hold.simulation.T_palm_object.isApprox(IN_PALM, 1e-9)
    assert not hold.simulation.T_base_object.isApprox(IN_PALM, 1e-2)


# --- twists ------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(3))
def test_a_twist_is_the_rate_of_the_pose_in_world_axes(allegro_plan: GraspPlan, seed: int) -> None:
    trial = Trial(allegro_plan)
    scene, data = trial.simulation.scene, trial.simulation.data
    rng = np.random.default_rng(seed)
    pose = SE3(pin.exp3(rng.normal(size=3)), rng.normal(size=3))
    data.qpos[scene.object_qpos] = np.concatenate(pose_to_wxyz(pose))
    data.qvel[scene.object_dof] = rng.normal(size=6)
    mujoco.mj_forward(scene.model, data)
    observed = trial.simulation.observe("hold", 0.0).object_twist
    before, dt = scene.body_pose(data, scene.object_body), 1e-6
    mujoco.mj_integratePos(scene.model, data.qpos, data.qvel, dt)
    mujoco.mj_kinematics(scene.model, data)
    after = scene.body_pose(data, scene.object_body)
    rate = np.concatenate(
        [
            after.translation - before.translation,
            pin.log3(after.rotation @ before.rotation.T),
        ]
    )
    np.testing.assert_allclose(observed, rate / dt, atol=1e-5)
    # the axes matter: in the object's own the turn is another one
    assert np.linalg.norm(pose.rotation.T @ observed[3:] - observed[3:]) > 0.1


def point_velocity(model: Any, data: Any, body: int, point: FloatArray) -> FloatArray:
    """Velocity (3,), m/s, world, of a body's point by MuJoCo's Jacobian."""
    jacobian = np.zeros((3, model.nv))
    mujoco.mj_jac(model, data, jacobian, None, point, body)
    return np.asarray(jacobian @ data.qvel)


@pytest.mark.parametrize("finger", ["thumb", "index", "middle", "ring"])
def test_pads_feel_only_what_moves_along_the_surface(allegro_plan: GraspPlan, finger: str) -> None:
    """Sliding is the velocity of object over pad without its part along the normal."""
    rng = np.random.default_rng(5)
    trial = Trial(allegro_plan)
    scene, data = trial.simulation.scene, trial.simulation.data
    scene.model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_ACTUATION)  # no servo lets go
    k = allegro_plan.task.finger_names.index(finger)
    data.qpos[scene.hand_qpos] = allegro_plan.q
    mujoco.mj_kinematics(scene.model, data)
    # the grasp where the trial has the hand, the object pressed 0.5 mm into one pad, and all moves
    moved = scene.body_pose(data, scene.base_body) * allegro_plan.T_world_base.inverse()
    into = moved.rotation @ allegro_plan.contacts.normals[k]
    pose = moved * allegro_plan.task.T_world_object
    pose = SE3(pose.rotation, pose.translation - 5e-4 * into)
    data.qpos[scene.object_qpos] = np.concatenate(pose_to_wxyz(pose))
    data.qvel[:] = 0.02 * rng.normal(size=len(data.qvel))
    data.qvel[scene.object_dof[:3]] = 0.02 * rng.normal(size=3) - 0.1 * into
    mujoco.mj_forward(scene.model, data)
    pads, contacts = trial.simulation.observe("hold", 0.0).pads, hand_contacts(scene, data)
    assert contacts.fingers.count(finger) == 1
    contact = contacts[contacts.fingers.index(finger)]
    geom = scene.model.geom(HAND_PREFIX + allegro_plan.task.hand.fingers[finger].pad.geom)
    over = velocity(scene.model, data, scene.object_body, contact.position)
    over -= velocity(scene.model, data, int(geom.bodyid[0]), contact.position)
    normal = contact.frame[:, 0]
    assert abs(normal @ over) > 0.02
    along = over - normal * (normal @ over)
    np.testing.assert_allclose(pads.sliding[k], along, atol=1e-9)
    assert pads.sliding_speed[k] == pytest.approx(np.linalg.norm(along))


def velocity(model: Any, data: Any, body: int, point: FloatArray) -> FloatArray:
    """Velocity (3,), m/s, world, of a body's point by MuJoCo's Jacobian."""
    jacobian = np.zeros((3, model.nv))
    mujoco.mj_jac(model, data, jacobian, None, point, body)
    return np.asarray(jacobian @ data.qvel)


# --- damping -----------------------------------------------------------------------------------


@pytest.mark.parametrize("ratio", [1.0, 0.5])
def test_a_turned_body_comes_back_with_the_damping_that_was_asked(ratio: float) -> None:
    """Worked on paper for a body that is let go at rest, 0.4 rad from where it is wanted.

    With the damping ratio z and the natural frequency w the turn is a critically damped one for
    z = 1, else (cos d t + z w / d sin d t) exp(-z w t) with d = w sqrt(1 - z^2).
    """
    inertia, w, dt = 2e-4, 20.0, 1e-5
    gains = ImpedanceGains.of_body(
        mass=0.5, inertia=inertia, bandwidth=w, damping_ratio=ratio, learning_rate=0.0
    )
    law = ImpedanceLaw(gains)
    axis = np.array([1.0, 2.0, -2.0]) / 3.0
    turn, rate, seen = 0.4, 0.0, []
    for _ in range(30_000):
        pose = SE3(pin.exp3(turn * axis), np.zeros(3))
        twist = np.concatenate([np.zeros(3), rate * axis])
        torque = law.wrench(SE3.Identity(), pose, twist)[3:]
        rate += dt * float(torque @ axis) / inertia
        turn += dt * rate
        seen.append(turn)
    t = dt * np.arange(1, len(seen) + 1)
    if ratio == 1.0:
        expected = (1 + w * t) * np.exp(-w * t)
    else:
        d = w * np.sqrt(1 - ratio**2)
        expected = (np.cos(d * t) + ratio * w / d * np.sin(d * t)) * np.exp(-ratio * w * t)
    np.testing.assert_allclose(seen, 0.4 * expected, atol=1e-4)
