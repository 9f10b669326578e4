"""The grasp controller: its torques against other code, its closing, its law on other actuators."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from conftest import PlanOf

from planner.contacts import ContactModel, ContactSet
from planner.hand_loading import load_hand
from planner.kinematics import HandState
from planner.plan import GraspPlan
from planner.spatial import SE3, FloatArray
from sim.controllers import PHASES, GraspController, Observation, Phase
from sim.scene.carrier import Timeline
from sim.trial import simulate


@pytest.fixture(scope="module")
def plan(plan_of: PlanOf) -> GraspPlan:
    return plan_of("allegro_hand", "sphere")


def observe(
    plan: GraspPlan,
    phase: Phase,
    progress: float = 1.0,
    *,
    time: float = 0.0,
    q: FloatArray | None = None,
    force: FloatArray | float = 0.0,
    shift: SE3 | None = None,
) -> Observation:
    """What a controller would see with the hand at the grasp; ``shift`` moves everything."""
    shift = SE3.Identity() if shift is None else shift
    hand = plan.task.hand
    return Observation(
        time=time,
        phase=phase,
        progress=progress,
        q=plan.q if q is None else q,
        v=np.zeros(hand.nq),
        T_world_base=shift * plan.T_world_base,
        T_world_object=shift * plan.task.T_world_object,
        read_twist=lambda: np.zeros(6),
        normal_forces=np.zeros(len(plan.task.fingers)) + force,
        read_contacts=lambda: ContactSet.from_arrays(np.zeros((0, 3)), np.zeros((0, 3))),
    )


def produced(plan: GraspPlan, controller: GraspController, o: Observation) -> FloatArray:
    """Joint torques (nq,) that the actuators produce at the observed joints at rest."""
    actuation = plan.task.hand.actuation
    length = actuation.moment @ o.q + actuation.length0
    force = (
        actuation.gain * controller.step(o) + actuation.bias[:, 0] + actuation.bias[:, 1] * length
    )
    return np.asarray(np.clip(force, *actuation.force_range.T) @ actuation.moment)


def wanted(plan: GraspPlan, share: float, shift: SE3 | None = None) -> FloatArray:
    """J^T f + gravity by ``HandState``, contact by contact; forces turn with ``shift``."""
    hand, state = plan.task.hand, HandState(plan.task.hand, plan.q)
    inverse = plan.T_world_base.inverse()
    turn = np.eye(3) if shift is None else shift.rotation
    gravity = (turn @ plan.T_world_base.rotation).T @ plan.task.gravity
    torque = state.gravity_torque(gravity)
    contacts = plan.contacts
    for finger, p, f in zip(
        plan.task.fingers, contacts.positions, contacts.forces_in_axes(), strict=True
    ):
        jacobian = state.point_jacobian(finger.pad.joint_id, inverse.act(p))[:3]
        torque += share * jacobian.T @ (inverse.rotation @ f)
    assert torque.shape == (hand.nq,)
    return torque


def test_full_squeeze_produces_the_planned_torques(plan: GraspPlan) -> None:
    controller = GraspController(plan)
    torque = produced(plan, controller, observe(plan, "hold"))
    np.testing.assert_allclose(torque, wanted(plan, 1.0), atol=1e-9)
    np.testing.assert_allclose(torque, plan.forces.joint_torques, atol=1e-6)


def test_offsets_that_were_found_change_no_torque(plan: GraspPlan) -> None:
    """Encoders read too much by a known offset: the hand is where it was, and so is its weight."""
    controller = GraspController(plan)
    controller.calibration.offset = np.linspace(-0.05, 0.05, len(plan.q))
    seen = observe(plan, "hold", q=plan.q + controller.calibration.offset)
    np.testing.assert_allclose(produced(plan, controller, seen), wanted(plan, 1.0), atol=1e-9)


def test_squeeze_begins_lightly_and_ends_in_full(plan: GraspPlan) -> None:
    for progress, share in ((0.0, 0.1), (0.5, 0.55), (1.0, 1.0)):
        controller = GraspController(plan)
        torque = produced(plan, controller, observe(plan, "squeeze", progress))
        np.testing.assert_allclose(torque, wanted(plan, share), atol=1e-9)


def test_forces_turn_with_the_object(plan: GraspPlan) -> None:
    shift = SE3(pin.exp3(np.array([0.3, -0.5, 0.8])), np.array([0.1, 0.2, 0.3]))
    controller = GraspController(plan)
    torque = produced(plan, controller, observe(plan, "hold", shift=shift))
    np.testing.assert_allclose(torque, wanted(plan, 1.0, shift), atol=1e-9)


def test_soft_contacts_press_with_their_torsion(plan: GraspPlan) -> None:
    contacts = plan.contacts
    n = len(contacts)
    forces = np.c_[contacts.forces[:, :3], np.full(n, 0.004)]
    model: ContactModel = "soft"
    soft = replace(contacts, models=(model,) * n, mu_torsion=np.full(n, 0.01), forces=forces)
    change = wanted(plan, 0.0)
    state, inverse = HandState(plan.task.hand, plan.q), plan.T_world_base.inverse()
    for finger, p, normal in zip(
        plan.task.fingers, contacts.positions, contacts.normals, strict=True
    ):
        jacobian = state.point_jacobian(finger.pad.joint_id, inverse.act(p))[3:]
        change += 0.004 * jacobian.T @ (inverse.rotation @ normal)
    change -= wanted(plan, 0.0)
    with_torsion = replace(plan, contacts=soft)
    torque = produced(plan, GraspController(with_torsion), observe(plan, "hold"))
    assert np.abs(change).max() > 1e-4
    np.testing.assert_allclose(torque - wanted(plan, 1.0), change, atol=1e-9)


def test_servos_stay_springs_around_the_latched_posture(plan: GraspPlan) -> None:
    controller = GraspController(plan)
    controller.step(observe(plan, "squeeze", 0.0))
    actuation = plan.task.hand.actuation
    stiffness = -actuation.bias[:, 1] @ actuation.moment**2
    pushed = plan.q + 0.01
    o = observe(plan, "hold", q=pushed)
    extra = produced(plan, controller, o)
    still = GraspController(plan)
    still.q_ref = pushed
    np.testing.assert_allclose(controller.q_ref, plan.q)
    difference = extra - produced(plan, still, o)
    np.testing.assert_allclose(difference, -0.01 * stiffness, atol=1e-9)


def test_fingers_close_from_pregrasp_to_grasp(plan: GraspPlan) -> None:
    controller = GraspController(plan)
    controller.step(observe(plan, "approach"))
    np.testing.assert_allclose(controller.q_ref, plan.q_pregrasp)
    for k in range(1, 251):
        controller.step(observe(plan, "close", min(1.0, k / 250), time=0.002 * k))
    np.testing.assert_allclose(controller.q_ref, plan.q, atol=1e-12)


def test_a_finger_that_touches_stops_and_the_others_go_on(plan: GraspPlan) -> None:
    controller = GraspController(plan)
    force = np.zeros(len(plan.task.fingers))
    for k in range(1, 251):
        if k == 125:
            force[0] = 0.5
        controller.step(observe(plan, "close", k / 250, time=0.002 * k, force=force))
    first, second = plan.task.fingers[:2]
    half = (plan.q + plan.q_pregrasp) / 2
    way = np.abs(plan.q - plan.q_pregrasp)[first.q_index].max()
    np.testing.assert_allclose(
        controller.q_ref[first.q_index], half[first.q_index], atol=0.02 * way
    )
    np.testing.assert_allclose(controller.q_ref[second.q_index], plan.q[second.q_index])


def test_a_finger_that_misses_goes_on_along_its_normal(plan: GraspPlan) -> None:
    controller = GraspController(plan)
    for k in range(1, 501):
        controller.step(observe(plan, "close", min(1.0, k / 250), time=0.002 * k))
    before, after = HandState(plan.task.hand, plan.q), HandState(plan.task.hand, controller.q_ref)
    normals = plan.contacts.normals @ plan.T_world_base.rotation
    for finger, normal in zip(plan.task.fingers, normals, strict=True):
        moved = after.pad_center(finger) - before.pad_center(finger)
        assert 0.002 < moved @ normal < 0.006  # 10 mm/s for 0.5 s, less what damping takes
        assert np.linalg.norm(moved - normal * (moved @ normal)) < 0.002


def test_motors_hold_the_object_too(plan: GraspPlan, tmp_path: Path) -> None:
    """The same hand with bare motors: its stiffness comes from the controller."""
    assert plan.task.hand.path is not None
    source = plan.task.hand.path.parent
    shutil.copytree(source, tmp_path / "hand")
    model = tmp_path / "hand" / plan.task.hand.description.model
    text = model.read_text()
    assert "<position" in text
    text = text.replace('<position kp="3" ', "<motor ").replace("<position ", "<motor ")
    lines = [
        _without(line, "ctrlrange", "kp") if "<motor" in line else line for line in text.split("\n")
    ]
    model.write_text("\n".join(lines))
    hand = load_hand(tmp_path / "hand")
    assert (hand.actuation.bias == 0).all()
    with_motors = replace(plan, task=replace(plan.task, hand=hand))
    report = simulate(with_motors, timeline=Timeline(lift=0.5, hold=0.3))
    assert report.success, report.verdict.detail
    assert max(c.force_error_percent for c in report.comparison) < 20


def _without(line: str, *attributes: str) -> str:
    import re

    for attribute in attributes:
        line = re.sub(rf'\s{attribute}="[^"]*"', "", line)
    return line


def test_phases_are_in_order() -> None:
    assert PHASES == ("approach", "close", "squeeze", "settle", "lift", "hold")
