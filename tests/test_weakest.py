"""The directions in which a grasp resists least."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planner.contacts import ContactSet
from planner.hands.hand import Hand
from planner.quality import epsilon_round, primitive_wrenches
from planner.quality.weakest import APART, weakest_directions
from planner.search.grasp import attempts
from planner.spatial import FloatArray
from planner.synthesis.options import SynthesisOptions
from planner.task import GraspTask

MU, LENGTH = 0.5, 0.05


def spread(seed: int, n: int = 4) -> tuple[FloatArray, FloatArray]:
    """Contacts on a ball of 40 mm radius, normals to its centre with some tilt."""
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(n, 3))
    points *= 0.04 / np.linalg.norm(points, axis=1, keepdims=True)
    inward = -points / 0.04 + rng.normal(0, 0.1, (n, 3))
    return points, inward / np.linalg.norm(inward, axis=1, keepdims=True)


def resistance(directions: FloatArray, points: FloatArray, inward: FloatArray) -> FloatArray:
    """Support (n,) of the wrenches of fine pyramids in directions (n, 6): another code's."""
    contacts = ContactSet.from_arrays(points, inward, mu=MU)
    wrenches = primitive_wrenches(contacts, edges=256).reshape(6, -1)
    wrenches[3:] /= LENGTH
    return np.asarray((directions @ wrenches).max(axis=1))


@settings(deadline=None)
@given(st.integers(0, 10_000))
def test_directions_are_weak_apart_and_in_order(seed: int) -> None:
    points, inward = spread(seed)
    found = weakest_directions(points, inward, MU, LENGTH, 12)
    assert 1 <= len(found) <= 12
    np.testing.assert_allclose(np.linalg.norm(found, axis=1), 1, atol=1e-9)
    cosines = found @ found.T
    assert (cosines[np.triu_indices(len(found), 1)] < APART).all()
    rng = np.random.default_rng(seed)
    anywhere = rng.normal(size=(40, 6))
    anywhere /= np.linalg.norm(anywhere, axis=1, keepdims=True)
    usual = np.median(resistance(anywhere, points, inward))
    assert resistance(found[:1], points, inward)[0] < usual


def test_the_weakest_direction_is_near_epsilon() -> None:
    """No direction resists less than epsilon; pyramids of four sides find one that is near."""
    ratios = []
    for seed in range(30):
        points, inward = spread(seed, 6)
        found = weakest_directions(points, inward, MU, LENGTH, 12)
        least = resistance(found, points, inward).min()
        epsilon = epsilon_round(ContactSet.from_arrays(points, inward, mu=MU), length=LENGTH)
        assert least >= epsilon.lower - 1e-3
        if epsilon.lower > 0:
            ratios.append(least / epsilon.upper)
    assert len(ratios) >= 15
    assert np.median(ratios) < 1.6


def test_wrenches_in_a_plane_have_no_direction() -> None:
    points = np.array([[0.03, 0.0, 0.0], [-0.03, 0.0, 0.0]])
    inward = np.array([[-1.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    assert weakest_directions(points, inward, 0.0, LENGTH, 12).shape == (0, 6)


@pytest.mark.slow
@pytest.mark.parametrize("item", ["box", "cylinder:0.03x0.10"])
def test_rounds_raise_epsilon(allegro: Hand, item: str) -> None:
    task = GraspTask.create(allegro, item)

    def median(rounds: int) -> float:
        made = attempts(task, seed=0, options=SynthesisOptions(rounds=rounds))
        plans = [attempt.plan for attempt, _ in zip(made, range(8), strict=False)]
        return float(np.median([p.quality.epsilon for p in plans if p is not None]))

    assert median(2) > 1.2 * median(0)
