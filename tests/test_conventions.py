"""Signs, frames and limits worked out on paper, in poses where a wrong one shows: tilted, shifted.

Each of these was once wrong on purpose, and no other test noticed.
"""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pinocchio as pin
import pytest
from conftest import PlanOf
from udp_hand import Inbox, Packet

from planner.collision.pad_contact import pad_contacts
from planner.collision.world import CollisionWorld
from planner.contacts import ContactSet
from planner.plan import GraspPlan
from planner.quality.closure import closure_of_wrenches
from planner.spatial import SE3
from planner.task import GraspTask
from planner.tolerances import ANGLE_TOL, FLAT_ANGLE_TOL
from planner.verification import force_arguments, verify_geometry
from sim.manipulation.report import ManipulationReport
from sim.manipulation.timeline import SuccessCriteria
from sim.sensing.estimation import ObjectEstimator, SensorErrors

TILTED = SE3(pin.exp3(np.array([0.3, -0.5, 0.7])), np.array([0.1, -0.2, 0.3]))
"""A pose with no symmetry."""


@pytest.fixture(scope="module")
def plan(plan_of: PlanOf) -> GraspPlan:
    return plan_of("allegro_hand", "sphere")


def test_the_centre_of_contacts_moves_with_them() -> None:
    contacts = ContactSet.from_arrays(
        [[0.1, 0, 0], [-0.1, 0, 0]], [[-1, 0, 0], [1, 0, 0]], mu=0.5, center=[0.01, 0.02, 0.03]
    )
    moved = contacts.transformed(TILTED)
    np.testing.assert_allclose(moved.center, TILTED.act(np.array([0.01, 0.02, 0.03])))
    # a wrench about the centre does not change but for its axes
    forces = np.array([[2.0, 0.3, -0.2, 0.0], [1.0, -0.1, 0.4, 0.0]])
    before = contacts.with_forces(forces).wrench()
    after = moved.with_forces(forces).wrench()
    turn = TILTED.rotation
    np.testing.assert_allclose(after[:3], turn @ before[:3], atol=1e-12)
    np.testing.assert_allclose(after[3:], turn @ before[3:], atol=1e-12)


def test_a_small_weight_is_closure() -> None:
    """One of twelve wrenches is 1e5 times as large: it needs a weight 1e-5 of its opposite's.

    With weight l of all but the opposite of the large one, which takes 1e5 l: 11 l + 1e5 l = 1.
    """
    large = 1e5
    wrenches = np.hstack([np.eye(6), -np.eye(6)])
    wrenches[:, -1] *= large
    result = closure_of_wrenches(wrenches)
    assert result.normalised_min_weight == pytest.approx(12 / (11 + large), rel=1e-3)
    assert result.closed


@pytest.mark.parametrize(("is_round", "tolerance"), [(True, ANGLE_TOL), (False, FLAT_ANGLE_TOL)])
def test_a_pad_is_left_beyond_its_own_tolerance(
    plan: GraspPlan, is_round: bool, tolerance: float
) -> None:
    """A sphere knows where it touches; a flat pad only nearly: its cone is wider."""
    task = plan.task
    touches = pad_contacts(task, plan.T_world_base, plan.q)
    world = CollisionWorld(task)
    pad = task.fingers[0].pad
    for factor, off in ((0.9, False), (1.1, True)):
        angle = pad.half_angle + factor * tolerance
        changed = [replace(touches[0], round=is_round, angle=angle), *touches[1:]]
        kinds = [
            f.kind for f in verify_geometry(world, plan.T_world_base, plan.q, changed).failures
        ]
        assert ("off_pad" in kinds) == off


def test_gravity_on_a_tilted_hand_is_the_slope_of_its_potential_energy(plan: GraspPlan) -> None:
    task, hand = plan.task, plan.task.hand
    gravity = np.array([1.0, 2.0, -9.81])
    told = replace(task, gravity=gravity)
    arguments: dict[str, Any] = {**force_arguments(told, plan.contacts, TILTED, plan.q)}
    torque = arguments["gravity_torque"]

    def energy(q: np.ndarray) -> float:
        data = hand.pin_model.createData()
        centre = pin.centerOfMass(hand.pin_model, data, q)
        return -float(data.mass[0] * gravity @ TILTED.act(centre))

    step = 1e-5
    slope = np.array(
        [
            (energy(plan.q + step * e) - energy(plan.q - step * e)) / (2 * step)
            for e in np.eye(hand.nq)
        ]
    )
    np.testing.assert_allclose(torque, slope, atol=1e-7)


def estimator() -> Any:
    return ObjectEstimator(GraspTask.create("allegro_hand", "sphere"), SensorErrors())


def test_a_base_that_spins_carries_the_object_round() -> None:
    """1 rad/s about the world's vertical; an object 0.1 m along x moves at 0.1 m/s along y."""
    filters = estimator()
    filters._base_twist = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
    known = cast(Any, SimpleNamespace(motion=None))
    twist = filters._twist(known, cast(Any, None), SE3(np.eye(3), np.array([0.1, 0.0, 0.5])))
    np.testing.assert_allclose(twist, [0.0, 0.1, 0.0, 0.0, 0.0, 1.0], atol=1e-15)


def test_a_covariance_turns_with_the_base() -> None:
    """Doubt along the base's x, which stands 30 degrees from the world's x: xy is positive."""
    filters = estimator()
    doubt = np.zeros((6, 6))
    doubt[0, 0] = doubt[3, 3] = 4.0
    base = SE3(pin.exp3(np.array([0.0, 0.0, np.pi / 6])), np.zeros(3))
    estimate = SimpleNamespace(pose_covariance=lambda: doubt)
    track = SimpleNamespace(
        last=SimpleNamespace(T_world_base=base, time=0.0), known=SimpleNamespace(estimate=estimate)
    )
    filters._note(track)
    wanted = np.array([[3.0, np.sqrt(3.0), 0.0], [np.sqrt(3.0), 1.0, 0.0], [0.0, 0.0, 0.0]])
    np.testing.assert_allclose(filters._uncertainty.covariance[:3, :3], wanted, atol=1e-12)
    np.testing.assert_allclose(filters._uncertainty.covariance[3:, 3:], wanted, atol=1e-12)


@pytest.mark.parametrize(("off_mm", "reached"), [(2.0, True), (4.0, False)])
def test_an_object_is_where_it_was_wanted_within_three_millimetres(
    off_mm: float, reached: bool
) -> None:
    asked = np.array([5e-3, 0.0, 0.0])
    stood = cast(
        Any,
        SimpleNamespace(
            asked=np.deg2rad(90.0),
            asked_shift=asked,
            criteria=SuccessCriteria(),
            R_world_palm=np.eye(3),
            log=SimpleNamespace(
                turn=np.array([np.deg2rad(91.0)]), shift=np.array([[5e-3, 1e-3 * off_mm, 0.0]])
            ),
        ),
    )
    assert ManipulationReport._reached(stood).tolist() == [reached]


def test_a_packet_that_comes_twice_is_used_once() -> None:
    inbox = Inbox()
    sent = Packet(kind=b"s", number=7, time=0.0, values=np.array([1.0])).to_bytes()
    assert inbox.take(sent) is not None
    assert inbox.take(sent) is None
    assert inbox.overtaken == 1
