"""The second opinion of the tests (``plain_check``) sees what is wrong, and nothing else."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from conftest import PlanOf
from plain_check import bears, closes, doubts, nearest_on, signed_distance

from benchmarks.refine import perturbed
from planner.objects import parse_object
from planner.plan import GraspPlan
from planner.spatial import SE3


@pytest.fixture(scope="module")
def plan(plan_of: PlanOf) -> GraspPlan:
    return plan_of("allegro_hand", "sphere")


def test_a_hand_is_perturbed_by_as_much_as_is_said(plan: GraspPlan) -> None:
    base, q = perturbed(plan, 0.01, 0.2, np.random.default_rng(3))
    middle = plan.contacts.positions.mean(axis=0)
    motion = base * plan.T_world_base.inverse()
    assert np.linalg.norm(motion.act(middle) - middle) == pytest.approx(0.01)
    assert np.linalg.norm(pin.log3(motion.rotation)) == pytest.approx(0.2)
    assert 0.05 < np.abs(q - plan.q).max() <= 0.1
    assert (perturbed(plan, 0.0, 0.0, np.random.default_rng(3))[1] == plan.q).all()


def test_the_second_opinion_sees_what_is_wrong(plan: GraspPlan) -> None:
    assert doubts(plan) == []
    T = plan.T_world_base
    sideways = np.array([0.002, 0.0, 0.0])
    beside = replace(plan, T_world_base=SE3(T.rotation, T.translation + sideways))
    assert any("mm off" in text for text in doubts(beside))
    sunk = replace(plan, T_world_base=SE3(T.rotation, T.translation - [0.0, 0.0, 0.1]))
    assert any("below the table" in text for text in doubts(sunk))
    assert any("in the object" in text for text in doubts(sunk))
    bent = plan.q.copy()
    bent[0] = plan.task.hand.q_upper[0] + 0.01
    assert any("limit" in text for text in doubts(replace(plan, q=bent)))


def test_the_second_opinion_on_closure_and_weight_is_that_of_known_cases() -> None:
    turns = 2 * np.pi * np.arange(3) / 3
    inward = -np.column_stack([np.cos(turns), np.sin(turns), 0 * turns])
    around = -0.03 * inward
    pull = np.array([0.0, 0.0, -1.0])
    assert closes(around, inward, 0.5, 0.03)
    assert bears(around, inward, 0.5, pull, 1.0, 0.03)
    assert not closes(around, inward, 0.0, 0.03)
    assert not bears(around, inward, 0.0, pull, 1.0, 0.03)
    # all on one side: they push the object away
    beside = np.array([[0.0, 0.0, 0.0], [0.0, 0.02, 0.0], [0.0, 0.0, 0.02]])
    same = np.tile([1.0, 0.0, 0.0], (3, 1))
    assert not closes(beside, same, 0.5, 0.03)
    assert not bears(beside, same, 0.5, pull, 1.0, 0.03)


@pytest.mark.parametrize("spec", ["sphere", "box", "cylinder", "capsule", "ellipsoid", "torus"])
def test_distances_by_formula_are_those_of_the_shapes(spec: str) -> None:
    shape = parse_object(spec).shape
    points = np.random.default_rng(0).normal(0, 0.05, (60, 3))
    near, outward = shape.closest_point(points)
    signed = ((points - near) * outward).sum(axis=1)
    assert nearest_on(shape, points)[0] == pytest.approx(np.abs(signed), abs=1e-7)
    mine = signed_distance(shape, points)
    assert mine[signed < 0] == pytest.approx(signed[signed < 0], abs=1e-7)
    assert (mine[signed > 0] > 0).all()
