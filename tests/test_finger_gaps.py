"""Clearances of the true links in least squares: linear where they were looked at, and kept."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from planner.collision import CollisionWorld
from planner.hand import Hand
from planner.objects import parse_object
from planner.spatial import FloatArray
from planner.synthesis.clearance import bones_are_true
from planner.synthesis.mesh_seeds import seeder_for
from planner.synthesis.options import SynthesisOptions
from planner.synthesis.problem import Candidate, Start
from planner.synthesis.problems import problems_for
from planner.synthesis.strengthen import descend_grasp, finger_gaps
from planner.task import GraspTask

APART = 0.02


@pytest.fixture(scope="module")
def task(allegro: Hand) -> GraspTask:
    """The Allegro's links are bars."""
    return GraspTask.create(allegro, parse_object("cylinder"))


def test_only_hands_of_spheres_and_capsules_have_bones_that_are_true(
    allegro: Hand, shadow: Hand
) -> None:
    assert bones_are_true(shadow)
    assert not bones_are_true(allegro)


def test_gaps_are_what_coal_measures_and_change_as_they_say(task: GraspTask) -> None:
    """A hundredth of a radian away the distance of nearly every pair is the one foretold."""
    world = CollisionWorld(task)
    hand, rng = task.hand, np.random.default_rng(4)
    errors, least = [], []
    for _ in range(12):
        q = rng.uniform(hand.q_lower, hand.q_upper)
        gaps = finger_gaps(world, q, APART)
        if gaps is None:
            assert world.fingers_near(q, APART).distances.size == 0
            continue
        near = world.fingers_near(q, APART)
        np.testing.assert_allclose(gaps.values, near.distances - APART)
        assert (gaps.values < 0.0).all()
        least.append(gaps.values.min())
        step = 1e-4 * rng.normal(size=hand.nq)
        after = world.fingers_near(q + step, 2 * APART)
        there = dict(zip(after.numbers.tolist(), after.distances.tolist(), strict=True))
        for number, value, row in zip(near.numbers.tolist(), gaps.values, gaps.rows, strict=True):
            if value > -APART:  # apart: in penetration coal's distance is not smooth
                errors.append(abs(there[number] - APART - value - row @ step))
    assert len(errors) > 30
    assert min(least) < -APART, "some cross"
    # where two faces are parallel the nearest points, and with them the slope, may jump
    assert np.quantile(errors, 0.9) < 1e-7


def _ends(task: GraspTask, apart: float, k: int) -> tuple[Candidate, Candidate]:
    """Where a start leads without and with a look at the true links."""
    problem, seeder = problems_for(task).grasp, seeder_for(task)
    start = seeder.draw(np.random.default_rng([3, k]))
    assert isinstance(start, Start)
    options = SynthesisOptions(rounds=0)
    parameters = problem.parameters(task, start, seeder.posture, options)
    asked = replace(options, clear_fingers=apart)
    world = CollisionWorld(task)
    return (
        descend_grasp(problem, task, start, parameters, options),
        descend_grasp(problem, task, start, parameters, asked, world),
    )


def test_fingers_end_as_far_apart_as_is_asked_and_still_touch(task: GraspTask) -> None:
    """Twice as far as they come to be without: the bones know nothing of it, the look does."""
    world, better = CollisionWorld(task), 0

    def least(q: FloatArray) -> float:
        return float(world.fingers_near(q, 0.05).distances.min())

    for k in range(4):
        before = least(_ends(task, 0.002, k)[0].q)
        plain, kept = _ends(task, before + 0.003, k)
        assert least(plain.q) == pytest.approx(before)
        solved = kept.violation["touch"] < 1e-4 and kept.violation["balance"] < 5e-3
        better += solved and least(kept.q) > before + 0.0025
    assert better >= 3
