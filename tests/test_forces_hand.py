"""The force programme with a hand behind it, and what it says when there is no answer."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import ArrayLike

from planner.contacts import ContactSet
from planner.errors import ContactError, InfeasibleError
from planner.forces import (
    ForceSolution,
    build_force_problem,
    distribute_forces,
    explain_infeasibility,
    gravity_wrench,
)
from planner.hand_loading import load_hand
from planner.joints.actuation import Actuation
from planner.kinematics import HandState

MASS, G = 0.1, 9.81
WEIGHT = gravity_wrench(MASS, [0, 0, -G])
NEEDED = MASS * G / (2 * 0.5)
"""Normal force of two opposed contacts with mu 0.5 that hold the weight, N."""


def opposed(**options: Any) -> ContactSet:
    """Two contacts on the x axis, thumb at +x pushing towards -x, index at -x pushing to +x."""
    return ContactSet.from_arrays(
        [[0.03, 0, 0], [-0.03, 0, 0]],
        [[-1, 0, 0], [1, 0, 0]],
        fingers=["thumb", "index"],
        **{"mu": 0.5, **options},
    )


def motors(moment: ArrayLike, limit: float, stops: ArrayLike = (), **changes: Any) -> Actuation:
    """Motors of unit gain with forces within +-limit, joints named a, b, c ..."""
    r = np.array(moment, dtype=float)
    nu, nv = r.shape
    rows = np.array(stops, dtype=float).reshape(-1, nv)
    fields: dict[str, Any] = {
        "names": tuple(f"M{i}" for i in range(nu)),
        "joint_names": tuple("abcdef"[:nv]),
        "moment": r,
        "length0": np.zeros(nu),
        "gain": np.ones(nu),
        "bias": np.zeros((nu, 3)),
        "force_range": np.tile([-limit, limit], (nu, 1)),
        "ctrl_range": np.tile([-np.inf, np.inf], (nu, 1)),
        "stop_rows": rows,
        "stop_values": np.zeros(len(rows)),
        "stop_names": tuple(f"stop {i}" for i in range(len(rows))),
    }
    return Actuation(**{**fields, **changes})


def jaws(limit: float, **options: Any) -> ForceSolution:
    """Each contact rides on a slide along x, with a motor; vertical loads go to the frame."""
    jacobians = np.zeros((2, 3, 2))
    jacobians[0, 0, 0] = jacobians[1, 0, 1] = 1.0
    return distribute_forces(
        opposed(),
        wrench=WEIGHT,
        jacobians=jacobians,
        actuation=motors(np.eye(2), limit),
        q=np.zeros(2),
        **options,
    )


# The hand by hand


def test_jaws_push_with_the_normal_force() -> None:
    solution = jaws(2.0)
    assert solution.found
    # Joint torque J^T f: the thumb pushes towards -x, the index towards +x.
    assert solution.joint_torques == pytest.approx([-NEEDED, NEEDED], rel=1e-5)
    assert solution.actuator_forces == pytest.approx(solution.joint_torques)
    assert solution.residuals.torque == pytest.approx([0, 0], abs=1e-8)


def test_jaws_that_are_too_weak_name_their_motors() -> None:
    solution = jaws(0.6 * NEEDED)
    assert not solution.found
    # 60 % of the normal force is 60 % of the friction; 40 % of the weight is left over.
    assert solution.fraction == pytest.approx(0.6)
    assert solution.unresisted_wrench == pytest.approx([0, 0, -0.4 * MASS * G, 0, 0, 0])
    assert any(name.startswith(("M0 at its least", "M1 at its gre")) for name in solution.limits)
    assert "60 % of the wrench is resisted" in solution.reason


def test_limits_are_those_at_q() -> None:
    """A servo that is past its control range on one side cannot push to the other."""
    servo = motors(
        np.eye(2), 2.0, gain=[1.0] * 2, bias=[[0, -1, 0]] * 2, ctrl_range=[[-1.5, 1.5]] * 2
    )
    jacobians = np.zeros((2, 3, 2))
    jacobians[0, 0, 0] = jacobians[1, 0, 1] = 1.0
    found = [
        distribute_forces(opposed(), wrench=WEIGHT, jacobians=jacobians, actuation=servo, q=q).found
        for q in ([0.0, 0.0], [0.0, 0.4], [0.0, 0.6])
    ]
    assert found == [True, True, False]  # 1.5 - q against 0.981


def tendon_finger(levers: tuple[float, float], q: tuple[float, float]) -> ForceSolution:
    """Contact 0 on joints a, b pulled by one tendon a + b, with the stop a - b >= 0; 1 is fixed.

    Levers are joint torque per newton of normal force.
    """
    jacobians = np.zeros((2, 3, 2))
    jacobians[0, 0] = -np.array(levers)  # the normal of contact 0 is -x
    return distribute_forces(
        opposed(),
        wrench=WEIGHT,
        jacobians=jacobians,
        actuation=motors([[1, 1]], 1.0, [[1, -1]]),
        q=q,
    )


def test_tendon_and_stop_share_the_torque() -> None:
    solution = tendon_finger((0.05, 0.02), (0.5, 0.5))
    assert solution.found
    assert solution.joint_torques == pytest.approx([0.05 * NEEDED, 0.02 * NEEDED], rel=1e-5)
    assert solution.actuator_forces == pytest.approx([0.035 * NEEDED], rel=1e-5)
    assert solution.stop_forces == pytest.approx([0.015 * NEEDED], rel=1e-5)


def test_shares_are_those_at_the_q_of_the_problem_wherever_its_limits_have_been_since() -> None:
    early, late = (tendon_finger((0.05, 0.02), (0.5, 0.5)) for _ in range(2))
    expected = early.actuator_forces, early.stop_forces
    assert late.problem.torque_limits is not None
    late.problem.torque_limits.at(np.array([0.7, 0.5]), np.zeros((2, 2)))  # off the stop
    assert late.actuator_forces == pytest.approx(expected[0], abs=1e-12)
    assert late.stop_forces == pytest.approx(expected[1], abs=1e-12)
    assert expected[1].any()


@pytest.mark.parametrize(("levers", "q"), [((0.02, 0.05), (0.5, 0.5)), ((0.05, 0.02), (0.7, 0.5))])
def test_a_torque_that_tendon_and_stop_cannot_make_is_refused(
    levers: tuple[float, float], q: tuple[float, float]
) -> None:
    """The stop would have to pull, or does not touch."""
    solution = tendon_finger(levers, q)
    assert not solution.found
    assert solution.fraction == pytest.approx(0.0, abs=1e-9)
    assert any("no actuator or stop" in n or "only pushes" in n for n in solution.limits)


@pytest.mark.parametrize("bare", [0, 1])
def test_the_joint_that_nothing_drives_is_named(bare: int) -> None:
    """Contact 0 pushes by joints a and b; one of them has a motor."""
    jacobians = np.zeros((2, 3, 2))
    jacobians[0, 0] = -0.05
    driven = np.zeros((1, 2))
    driven[0, 1 - bare] = 1.0
    solution = distribute_forces(
        opposed(), wrench=WEIGHT, jacobians=jacobians, actuation=motors(driven, 1.0), q=[0.0, 0.0]
    )
    assert not solution.found
    named = [n for n in solution.limits if "no actuator or stop" in n]
    assert named == [f"no actuator or stop supplies that share of torque {'ab'[bare]}"]


def test_at_a_joint_limit_the_actuator_still_carries_what_it_can() -> None:
    jacobians = np.zeros((2, 3, 1))
    jacobians[1, 0, 0] = 1.0
    for limit, share in ((5.0, 1.0), (0.5 * NEEDED, 0.5)):
        solution = distribute_forces(
            opposed(),
            wrench=WEIGHT,
            jacobians=jacobians,
            actuation=motors([[1.0]], limit, [[1.0]]),
            q=[0.0],
        )
        assert solution.found
        assert solution.actuator_forces == pytest.approx([share * NEEDED], rel=0.02)
        assert solution.actuator_forces + solution.stop_forces == pytest.approx(
            solution.joint_torques
        )


def test_gravity_of_the_hand_counts_on_loaded_joints_and_idle_joints_carry_their_own() -> None:
    jacobians = np.zeros((2, 3, 3))
    jacobians[0, 0, 0] = jacobians[1, 0, 1] = 1.0
    options: dict[str, Any] = {"wrench": WEIGHT, "jacobians": jacobians, "q": np.zeros(3)}
    gravity = np.array([0.5, -0.2, 9.0])
    solution = distribute_forces(
        opposed(), actuation=motors(np.eye(3), 2.0), gravity_torque=gravity, **options
    )
    assert solution.problem.joints.tolist() == [0, 1]
    assert solution.joint_torques == pytest.approx(np.array([-NEEDED, NEEDED, 0]) + gravity)
    # Joint c is beyond its motor's limit, but no matter of the grasp.
    assert solution.actuator_forces == pytest.approx(solution.joint_torques)
    tied = np.array([[1, 0, 0], [0, 1, 1]])
    assert distribute_forces(
        opposed(), actuation=motors(tied, 2.0), **options
    ).problem.joints.tolist() == [0, 1, 2]


def test_torsion_of_a_soft_contact_loads_the_joints() -> None:
    soft = opposed(model="soft", mu_torsion=0.005)
    wrench = [0, 0, 0, 0.01, 0, 0]
    jacobians = np.zeros((2, 6, 1))
    jacobians[1, 3, 0] = 1.0  # a joint that turns the index about +x, its normal
    turned = distribute_forces(soft, wrench=wrench, jacobians=jacobians)
    assert turned.joint_torques == pytest.approx([-0.005], rel=1e-5)
    with pytest.raises(ContactError, match=r"contact 0 transmits torsion.*\(n, 6, nv\)"):
        distribute_forces(soft, wrench=wrench, jacobians=jacobians[:, :3])


def test_the_whole_shadow_hand_presses_and_its_actuators_can() -> None:
    hand = load_hand("shadow_hand")
    q = hand.posture("pinch")
    state = HandState(hand, q)
    fingers = hand.choose_fingers()
    pads = np.array([state.pad_center(f) for f in fingers])
    thumb = [f.name for f in fingers].index("thumb")
    middle = (pads[thumb] + np.delete(pads, thumb, axis=0).mean(axis=0)) / 2
    normals = middle - pads
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    points = pads + normals * np.array([[f.pad.radius] for f in fingers])
    contacts = ContactSet.from_arrays(
        points, normals, mu=0.5, center=middle, fingers=[f.name for f in fingers]
    )
    pairs = zip(fingers, points, strict=True)
    jacobians = np.array([state.point_jacobian(f.pad.joint_id, p)[:3] for f, p in pairs])
    options: dict[str, Any] = {
        "wrench": gravity_wrench(MASS, [0, G, 0]),
        "jacobians": jacobians,
        "actuation": hand.actuation,
        "q": q,
        "gravity_torque": state.gravity_torque(np.array([0, G, 0])),
    }
    solution = distribute_forces(contacts, min_normal=1.0, **options)
    assert solution.found
    a = hand.actuation
    made = solution.actuator_forces @ a.moment + solution.stop_forces @ a.stop_rows
    loaded = solution.problem.joints
    assert made[loaded] == pytest.approx(solution.joint_torques[loaded], abs=1e-6)
    assert (solution.stop_forces >= -1e-9).all()
    _, achieved = a.ctrl_for_torque(q, np.zeros(hand.nq), solution.joint_torques)
    assert achieved[loaded] == pytest.approx(solution.joint_torques[loaded], abs=1e-3)
    crush = distribute_forces(contacts, min_normal=100.0, **options)
    assert not crush.found
    assert "contradict" in crush.reason
    assert any(name.startswith("A_") for name in crush.limits)


def test_hand_arguments_must_fit_together() -> None:
    jacobians = np.zeros((2, 3, 2))
    hand = motors(np.eye(2), 1.0)
    for options, message in (
        ({"actuation": hand}, "need q"),
        ({"actuation": hand, "q": [0.0, 0.0]}, "jacobians"),
        ({"actuation": hand, "q": [0.0], "jacobians": jacobians}, "actuation has 2 joints"),
        ({"actuation": hand, "q": [0.0, np.nan], "jacobians": jacobians}, "finite"),
    ):
        with pytest.raises(ContactError, match=message):
            build_force_problem(opposed(), wrench=WEIGHT, **options)


# What cannot be resisted


def test_torsion_about_two_point_contacts_is_named() -> None:
    solution = distribute_forces(opposed(), wrench=[0, 0, -MASS * G, 0.01, 0, 0])
    assert not solution.found
    assert solution.unresisted_wrench == pytest.approx([0, 0, 0, 0.01, 0, 0])
    assert solution.fraction == 0.0
    assert np.isnan(solution.forces).all()
    assert np.isnan(solution.contacts.forces).all()
    with pytest.raises(InfeasibleError, match=r"\[0.01, 0, 0\] N m is left over") as caught:
        solution.raise_if_infeasible()
    assert caught.value.wrench is solution.unresisted_wrench


def test_bounded_normal_force_holds_a_part() -> None:
    solution = distribute_forces(opposed(), wrench=WEIGHT, max_normal=0.25 * NEEDED)
    assert solution.fraction == pytest.approx(0.25)
    assert solution.unresisted_wrench == pytest.approx([0, 0, -0.75 * MASS * G, 0, 0, 0])
    assert any("greatest normal force" in name for name in solution.limits)
    assert any("friction of" in name for name in solution.limits)


def test_without_friction_a_weight_slides() -> None:
    solution = distribute_forces(opposed(mu=0.0), wrench=WEIGHT)
    assert not solution.found
    assert solution.unresisted_wrench == pytest.approx(WEIGHT)


def test_a_contact_on_top_can_only_push() -> None:
    top = ContactSet.from_arrays([[0, 0, 0.03]], [[0, 0, -1]], mu=0.5)
    solution = distribute_forces(top, wrench=WEIGHT)
    assert solution.unresisted_wrench == pytest.approx(WEIGHT)
    assert any("can only push" in name for name in solution.limits)


def test_a_grip_on_one_side_leaves_its_own_force_over() -> None:
    side = ContactSet.from_arrays([[0.03, 0, 0]], [[-1, 0, 0]], mu=0.5)
    solution = distribute_forces(side, wrench=np.zeros(6), min_normal=2.0)
    assert solution.unresisted_wrench == pytest.approx([-2, 0, 0, 0, 0, 0])
    assert solution.limits == ("least normal force 2 N at contact 0",)


def test_no_contacts_resist_nothing() -> None:
    nobody = ContactSet.from_arrays(np.zeros((0, 3)), np.zeros((0, 3)))
    solution = distribute_forces(nobody, wrench=WEIGHT)
    assert not solution.found
    assert solution.unresisted_wrench == pytest.approx(WEIGHT)
    with pytest.raises(InfeasibleError, match="there are no contacts"):
        solution.raise_if_infeasible()


def test_a_solver_that_fails_is_not_an_infeasible_task(monkeypatch: pytest.MonkeyPatch) -> None:
    options = {"osqp": {"max_iter": 1, "polishing": False}}
    monkeypatch.setattr("planner.numerics.qp._OPTIONS", options)
    solution = distribute_forces(opposed(), wrench=WEIGHT, solver="osqp")
    assert not solution.found
    assert "forces exist, but solver 'osqp' missed them" in solution.reason
    assert solution.fraction == 1.0
    assert explain_infeasibility(solution.problem).feasible
    assert np.isnan(solution.forces).all()


def test_a_found_solution_passes_through() -> None:
    solution = jaws(2.0)
    assert solution.raise_if_infeasible() is solution
    assert solution.status == "solved"
    assert solution.solver == "daqp"
    assert solution.solve_time_s > 0
