"""Contacts on middle links and palm: what they add to analysis and to the force programme."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from conftest import PlanOf

from planner.certify import breaking_along
from planner.contacts import ContactSet
from planner.forces import ForceLoop, ForceProblem, build_force_problem, solve_force_problem
from planner.kinematics import HandState
from planner.plan import GraspPlan
from planner.quality import force_closure
from planner.spatial import FloatArray

PALM_FORCE = 60.0
"""Several times what the actuators of four fingers can push with, N."""


STRONGEST = 200.0
"""Largest normal force, N: what a palm may bear; fingers end far below."""


@pytest.fixture(scope="module")
def plan(plan_of: PlanOf) -> GraspPlan:
    return plan_of("allegro_hand", "sphere")


@pytest.fixture(scope="module")
def state(plan: GraspPlan) -> HandState:
    return HandState(plan.task.hand, plan.q)


@pytest.fixture(scope="module")
def power(plan: GraspPlan, state: HandState) -> ContactSet:
    """In the base: the plan's tips, the link before the index's tip, and the palm."""
    tips = plan.contacts.transformed(plan.T_world_base.inverse())
    hand = plan.task.hand
    palm = state.T_base_palm.rotation @ hand.palm_normal
    radius = 0.035  # of the default sphere
    k = plan.task.finger_names.index("index")
    between = tips.normals[k] + palm  # between the tip and the palm, as a middle link lies
    normals = np.vstack([tips.normals, between / np.linalg.norm(between), palm])
    return ContactSet.from_arrays(
        tips.center - radius * normals,
        normals,
        center=tips.center,
        mu=0.5,
        fingers=[*plan.task.finger_names, "index", ""],
    )


def jacobians_of(plan: GraspPlan, state: HandState, power: ContactSet) -> FloatArray:
    """(6, 6, nq): of the pads' links, of the link before the index's last joint, of the palm."""
    hand, fingers = plan.task.hand, plan.task.fingers
    out = np.zeros((len(power), 6, hand.nq))
    index = next(f for f in fingers if f.name == "index")
    joints = [f.pad.joint_id for f in fingers]
    joints.append(int(hand.pin_model.parents[index.pad.joint_id]))
    for jacobian, joint, point in zip(out, joints, power.positions, strict=False):
        jacobian[:] = state.point_jacobian(joint, point)
    return out  # the palm is the base itself: no joint moves it


def first(contacts: ContactSet, n: int) -> ContactSet:
    """The first n contacts."""
    return ContactSet.from_contacts([contacts[i] for i in range(n)], center=contacts.center)


def programme(
    plan: GraspPlan, state: HandState, power: ContactSet, n: int, wrench: FloatArray
) -> ForceProblem:
    """Of the first n contacts."""
    return build_force_problem(
        first(power, n),
        wrench=wrench,
        max_normal=STRONGEST,
        jacobians=jacobians_of(plan, state, power)[:n],
        actuation=plan.task.hand.actuation,
        q=plan.q,
    )


def test_a_middle_link_loads_the_joints_before_it_only(
    plan: GraspPlan, state: HandState, power: ContactSet
) -> None:
    jacobian = jacobians_of(plan, state, power)[4]
    hand = plan.task.hand
    index = next(f for f in plan.task.fingers if f.name == "index")
    moved = np.flatnonzero(np.abs(jacobian[:3]).max(axis=0) > 1e-9)
    assert set(moved) == set(index.q_index[:-1])
    # virtual work: f . dp = tau . dq, with dp of the material point by finite differences
    joint = int(hand.pin_model.parents[index.pad.joint_id])
    place = HandState(hand, plan.q).pin_data.oMi[joint].actInv(power.positions[4])
    step = 1e-6
    for k in moved:
        q = plan.q.copy()
        q[k] += step
        data = hand.pin_model.createData()
        pin.forwardKinematics(hand.pin_model, data, q)
        after = data.oMi[joint].act(place)
        np.testing.assert_allclose((after - power.positions[4]) / step, jacobian[:3, k], atol=1e-6)


def test_the_palm_carries_what_fingers_cannot(
    plan: GraspPlan, state: HandState, power: ContactSet
) -> None:
    jacobians = jacobians_of(plan, state, power)
    into_palm = np.append(-PALM_FORCE * power.normals[5], np.zeros(3))
    found = {n: solve_force_problem(programme(plan, state, power, n, into_palm)) for n in (4, 5, 6)}
    assert [found[n].found for n in (4, 5, 6)] == [False, False, True]
    answer = found[6]
    forces = answer.forces
    # all balance the wrench, the palm takes its part, and no joint feels that
    everything = np.einsum("nij,nj->ni", power.frames, forces[:, :3])
    np.testing.assert_allclose(everything.sum(axis=0), -into_palm[:3], atol=1e-3)
    torque = np.cross(power.positions - power.center, everything).sum(axis=0)
    np.testing.assert_allclose(torque, 0.0, atol=1e-4)
    assert forces[5, 0] > PALM_FORCE / 3
    fingers = everything[:5]
    torque = np.einsum("nij,ni->j", jacobians[:5, :3], fingers)
    np.testing.assert_allclose(answer.joint_torques, torque, atol=1e-6)
    low, high = plan.task.hand.actuation.force_limits(plan.q).T
    assert (answer.actuator_forces <= high + 1e-6).all()
    assert (answer.actuator_forces >= low - 1e-6).all()


def test_every_contact_more_is_no_less_force_along_any_direction(
    plan: GraspPlan, state: HandState, power: ContactSet
) -> None:
    assert force_closure(power, 8).closed
    rng = np.random.default_rng(0)
    gained = []
    for _ in range(5):
        direction = np.append(rng.normal(size=3), 0.03 * rng.normal(size=3))
        bounds = [
            breaking_along(programme(plan, state, power, n, np.zeros(6)), direction).upper
            for n in (4, 5, 6)
        ]
        assert bounds[0] <= bounds[1] * (1 + 1e-6)
        assert bounds[1] <= bounds[2] * (1 + 1e-6)
        gained.append(bounds[2] / bounds[0])
    assert max(gained) > 1.2


def test_the_loop_gives_what_the_programme_gives(
    plan: GraspPlan, state: HandState, power: ContactSet
) -> None:
    jacobians = jacobians_of(plan, state, power)
    hand = plan.task.hand
    loop = ForceLoop(power, min_normal=0.2, max_normal=STRONGEST, actuation=hand.actuation)
    rng = np.random.default_rng(1)
    balanced = 0
    for _ in range(20):
        wrench = rng.normal(size=6) * [4, 4, 4, 0.05, 0.05, 0.05]
        step = loop.step(wrench, jacobians=jacobians, q=plan.q)
        problem = build_force_problem(
            power,
            wrench=wrench,
            min_normal=0.2,
            max_normal=STRONGEST,
            jacobians=jacobians,
            actuation=hand.actuation,
            q=plan.q,
        )
        anew = solve_force_problem(problem)
        assert step.balanced == anew.found
        if anew.found:
            balanced += 1
            np.testing.assert_allclose(step.forces, anew.forces, atol=2e-4)
    assert balanced >= 10


def test_fingers_leave_and_the_palm_and_one_link_stay(
    plan: GraspPlan, state: HandState, power: ContactSet
) -> None:
    """Contacts come and go by their bounds, whatever link they are on."""
    loop = ForceLoop(power, actuation=plan.task.hand.actuation)
    jacobians = jacobians_of(plan, state, power)
    wrench = np.append(-5.0 * power.normals[5], np.zeros(3))
    only_palm = np.array([0.0, 0, 0, 0, 0, np.inf])
    step = loop.step(wrench, jacobians=jacobians, q=plan.q, max_normal=only_palm)
    assert step.balanced
    assert step.forces[5, 0] == pytest.approx(5.0, abs=1e-5)
    np.testing.assert_allclose(step.forces[:5], 0.0, atol=1e-9)
    np.testing.assert_allclose(step.joint_torques, 0.0, atol=1e-7)
