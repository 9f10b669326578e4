"""The closure margin of motions: a knot whose contacts close, but barely, does not hold."""

from __future__ import annotations

import math

import numpy as np
import pytest
import test_motion

from planner.contacts import ContactSet
from planner.hand_loading import load_hand
from planner.hands.hand import Hand
from planner.motion import ObjectPath
from planner.motion.order import NoOrder, Order, find_order
from planner.motion.verify import MovementVerifier, Waypoint
from planner.objects import parse_object
from planner.quality import force_closure
from planner.spatial import SE3
from planner.task import GraspTask
from planner.tolerances import CLOSURE_EDGES, CLOSURE_MARGIN
from planner.verification import contacts_at, plan_forces

UP = np.array([0.0, 0.0, 1.0])

SLIPPERY = 0.01
"""Friction coefficient with which three contacts around a cylinder close only where the normals
themselves reach around it."""


@pytest.fixture(scope="module")
def hand(tmp_path_factory: pytest.TempPathFactory) -> Hand:
    """Three fingers on hinges about one vertical axis, wide enough to bring two face to face."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(test_motion, "HINGE", 1.0)
        return load_hand(test_motion.write_turning_hand(tmp_path_factory.mktemp("wide")))


@pytest.mark.parametrize("barely", [False, True])
def test_a_knot_closes_with_the_margin_or_does_not_hold(hand: Hand, barely: bool) -> None:
    """Two contacts 90.8 or 90.2 degrees from the third on either side.

    Both close and bear the weight: what the second lacks is the margin alone.
    """
    turn = math.radians(29.8 if barely else 29.2)
    q = np.array([0.0, 0.015, -turn, 0.015, turn, 0.015])
    item = parse_object("cylinder:0.03x0.08", mass=1e-4)
    task = GraspTask.create(hand, item, mu=SLIPPERY, grip_force=0.1)
    T_object_base = SE3(np.eye(3), np.array([0.0, 0.0, 0.075]))
    T_world_base = task.T_world_object * T_object_base
    contacts = contacts_at(task, T_world_base, q)
    closure = force_closure(contacts, edges=CLOSURE_EDGES)
    assert closure.closed
    assert (closure.normalised_min_weight < CLOSURE_MARGIN) == barely
    assert plan_forces(task, contacts, T_world_base, q).found
    path = ObjectPath(axis=UP, angle=0.0, shift=np.array([0.0, 0.0, 1e-3]))
    place = Waypoint(path_parameter=0.0, T_object_base=T_object_base, q=q)
    knots = MovementVerifier(task).verify_knots(T_world_base, [place], path, 0.01)
    if barely:
        assert not isinstance(knots, tuple)
        assert f"margin of {closure.normalised_min_weight:.3f} only" in str(knots)
    else:
        assert isinstance(knots, tuple)
        assert knots[0].closure.normalised_min_weight == closure.normalised_min_weight


@pytest.mark.parametrize("barely", [False, True])
def test_fingers_are_lifted_only_if_the_others_close_with_the_margin(barely: bool) -> None:
    """Of four contacts at right angles three close by friction alone, with a margin that it sets.

    Two are opposed, and their friction has to hold what the third presses.
    """
    angles = np.deg2rad([0.0, 90.0, 180.0, 270.0])
    outward = np.stack([np.cos(angles), np.sin(angles), np.zeros(4)], axis=1)
    names = ["one", "two", "three", "four"]
    mu = 0.01 if barely else 0.5
    contacts = ContactSet.from_arrays(0.03 * outward, -outward, mu=mu, fingers=names)
    others = ContactSet.from_contacts([contacts[k] for k in (0, 1, 2)], center=contacts.center)
    closure = force_closure(others, edges=CLOSURE_EDGES)
    assert closure.closed
    assert (closure.normalised_min_weight < CLOSURE_MARGIN) == barely
    found = find_order(contacts, contacts, UP)
    if barely:
        assert isinstance(found, NoOrder)
        assert not found.proven
        assert "the others close with a margin of" in str(found)
    else:
        assert isinstance(found, Order)
        assert found.margin >= CLOSURE_MARGIN
