"""Opening the fingers of a grasp: what is promised, and that it is the least-squares solution."""

from __future__ import annotations

import copy
from dataclasses import replace

import mujoco
import numpy as np
import pytest
from conftest import PlanOf
from scipy.optimize import minimize
from test_describe_drive import shared

from planner.collision.pregrasp import PREGRASP_DISTANCES
from planner.collision.pregrasp_ik import (
    FINGER_CLEARANCE,
    OPEN_CLEARANCE,
    OPENED_SHARE,
    POSTURE_WEIGHT,
    PregraspIk,
    undetermined_joints,
)
from planner.collision.world import CollisionWorld
from planner.hand_loading import hand_from_spec, load_hand
from planner.hands.catalog import hand_names
from planner.hands.hand import Hand
from planner.kinematics import HandState
from planner.plan import GraspPlan
from planner.search.grasp import plan_grasp
from planner.spatial import FloatArray
from planner.synthesis.options import SynthesisOptions
from planner.task import GraspTask


@pytest.fixture(scope="module", params=["allegro_hand", "shadow_hand"])
def plan(request: pytest.FixtureRequest, plan_of: PlanOf) -> GraspPlan:
    return plan_of(request.param, "sphere", seed=1)


def pads(hand: Hand, q: FloatArray, plan: GraspPlan) -> FloatArray:
    state = HandState(hand, q)
    return np.array([plan.T_world_base.act(state.pad_center(f)) for f in plan.task.fingers])


@pytest.mark.parametrize("opening", PREGRASP_DISTANCES)
def test_pads_move_back_along_the_normals(plan: GraspPlan, opening: float) -> None:
    hand, normals = plan.task.hand, plan.contacts.normals
    world = CollisionWorld(plan.task)
    q = PregraspIk(world, plan.T_world_base, plan.q, normals).solve(opening)
    assert q is not None
    moved = pads(hand, q, plan) - pads(hand, plan.q, plan)
    assert (-np.einsum("ij,ij->i", moved, normals) >= OPENED_SHARE * opening).all()
    assert (q >= hand.q_lower).all() and (q <= hand.q_upper).all()
    matrix, value = hand.coupling_matrix
    np.testing.assert_allclose(matrix @ q, value, rtol=0, atol=1e-9)
    np.testing.assert_array_equal(q[hand.wrist_index], plan.q[hand.wrist_index])
    assert world.is_clear(
        plan.T_world_base, q, environment=0.5 * OPEN_CLEARANCE, fingers=0.5 * FINGER_CLEARANCE
    )


def test_joints_that_may_be_off_keep_the_opened_hand_farther_away(plan: GraspPlan) -> None:
    normals, least = plan.contacts.normals, []
    for error in (0.0, float(np.deg2rad(3.0))):
        world = CollisionWorld(replace(plan.task, joint_error=error))
        q = PregraspIk(world, plan.T_world_base, plan.q, normals).solve(PREGRASP_DISTANCES[0])
        assert q is not None
        near = world.near(plan.T_world_base, q, 0.05)
        least.append(near.distances[near.hand_environment].min())
    assert least[1] > least[0] + 1e-3


def test_where_nothing_is_in_the_way_it_is_the_least_squares_solution() -> None:
    # SciPy's SLSQP on the same cost, with joint limits, derivatives by finite differences
    # rounds would bring the fingers so near to each other that they are in the way
    plan = plan_grasp(
        GraspTask.create("allegro_hand", "sphere"), seed=1, options=SynthesisOptions(rounds=0)
    )
    hand, opening = plan.task.hand, 0.01
    q = PregraspIk(
        CollisionWorld(plan.task), plan.T_world_base, plan.q, plan.contacts.normals
    ).solve(opening)
    assert q is not None
    goal = pads(hand, plan.q, plan) - opening * plan.contacts.normals

    def cost(x: FloatArray) -> float:
        miss = (pads(hand, x, plan) - goal) / opening
        return float((miss**2).sum() + POSTURE_WEIGHT * ((x - plan.q) ** 2).sum())

    best = minimize(
        cost, plan.q, method="SLSQP", bounds=list(zip(hand.q_lower, hand.q_upper, strict=True))
    )
    assert cost(plan.q) > 3.9
    assert cost(q) < best.fun + 0.02


def test_what_limits_forbid_is_not_opened() -> None:
    # a hand's breadth is more than any finger can open
    plan = plan_grasp(GraspTask.create("allegro_hand", "sphere"), seed=1)
    opener = PregraspIk(CollisionWorld(plan.task), plan.T_world_base, plan.q, plan.contacts.normals)
    assert opener.solve(0.3) is None
    assert opener.solve(0.02) is not None  # and nothing is left of it


def closed_in_the_air(hand: Hand, begin: FloatArray, end: FloatArray) -> FloatArray:
    """Joints after servos have gone from one posture to another in 0.4 s, nothing touched."""
    model = copy.copy(hand.mj_model)
    model.opt.gravity[:] = 0.0
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    model.dof_damping[:] = 0.05
    data = mujoco.MjData(model)
    data.qpos[:] = begin
    for share in np.linspace(0.0, 1.0, 40):
        data.ctrl[:] = hand.actuation.moment @ (begin + share * (end - begin))
        mujoco.mj_step(model, data, round(0.01 / model.opt.timestep))
    mujoco.mj_step(model, data, round(0.5 / model.opt.timestep))
    return np.array(data.qpos)


@pytest.mark.slow
def test_fingers_of_shared_tendons_close_the_way_that_they_opened() -> None:
    hand = hand_from_spec(mujoco.MjSpec.from_string(shared()))
    joints = undetermined_joints(hand)
    assert [hand.joint_names[k][-1] for k in joints] == ["b", "c"] * 3
    plan = plan_grasp(GraspTask.create(hand, "sphere:0.035"), seed=0)
    np.testing.assert_array_equal(plan.q_pregrasp[joints], plan.q[joints])
    now = closed_in_the_air(hand, plan.q_pregrasp, plan.q)
    np.testing.assert_allclose(now, plan.q, rtol=0, atol=0.01)
    # opened by all joints, the fingers are elsewhere when they have closed
    world = CollisionWorld(plan.task)
    every = PregraspIk(world, plan.T_world_base, plan.q, plan.contacts.normals).solve(
        plan.pregrasp_distance
    )
    assert every is not None
    assert np.abs(closed_in_the_air(hand, every, plan.q) - plan.q).max() > 0.05


def test_joints_that_a_tendon_moves_alike_may_open() -> None:
    # the tendon of the shipped fingers is stopped where both joints are equal, and moves both alike
    assert [name for name in hand_names() if len(undetermined_joints(load_hand(name)))] == []
