"""Weights that prove force closure, against the linear programme and against what they mean."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planner.contacts import ContactModel, ContactSet
from planner.quality import force_closure, plainly_closed, primitive_wrenches
from planner.quality.closure import PLAIN, positive_weights
from planner.spatial import FloatArray


def some_contacts(seed: int) -> ContactSet:
    """Contacts on a ball or a box, often closed, often nearly so, some in a plane."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 6))
    points = rng.normal(size=(n, 3))
    if seed % 3 == 0:
        points[:, 2] *= 0.02
    inward = -points + rng.normal(0, 0.5, (n, 3))
    if seed % 4 == 0:  # along the axes
        largest = np.abs(inward).argmax(axis=1)
        inward = np.sign(inward) * np.eye(3)[largest]
    model: ContactModel = "soft" if seed % 5 == 0 else "point"
    mu = float(rng.choice([0.0, 0.3, rng.uniform(0.2, 1.0)]))
    return ContactSet.from_arrays(0.04 * points, inward, mu=mu, mu_torsion=0.005, model=model)


def rows(contacts: ContactSet) -> FloatArray:
    return np.ascontiguousarray(primitive_wrenches(contacts).T)


@settings(max_examples=300, deadline=None)
@given(st.integers(0, 1_000_000))
def test_what_is_proven_the_programme_confirms(seed: int) -> None:
    contacts = some_contacts(seed)
    closure = force_closure(contacts)
    if plainly_closed(contacts):
        assert closure.closed
        assert closure.normalised_min_weight > PLAIN * (1 - 1e-6)
    else:  # and nothing that is clearly closed is missed
        assert not closure.closed or closure.normalised_min_weight < 0.01


def test_closure_is_seen_and_what_lacks_is_seen() -> None:
    directions = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1.0]]) / np.sqrt(3)
    closed = ContactSet.from_arrays(0.03 * directions, -directions, mu=0.5)
    assert positive_weights(rows(closed))
    pushed_away = ContactSet.from_arrays(0.03 * directions[:3], -directions[:3], mu=0.1)
    assert not positive_weights(rows(pushed_away))
    # two points: the object turns about the line between them
    line = 0.03 * np.array([[1.0, 0, 0], [-1, 0, 0]])
    two = ContactSet.from_arrays(line, -line, mu=0.5)
    assert not positive_weights(rows(two))
    assert not positive_weights(np.zeros((0, 6)))
    assert not positive_weights(np.zeros((8, 6)))


def test_the_scale_of_lengths_does_not_matter() -> None:
    for seed in range(20):
        contacts = some_contacts(seed)
        large = ContactSet.from_arrays(
            1e3 * contacts.positions,
            contacts.normals,
            mu=contacts.mu,
            mu_torsion=1e3 * contacts.mu_torsion,
            model=contacts.models,
        )
        assert plainly_closed(large) == plainly_closed(contacts)


def test_a_grasp_that_nearly_opens_is_left_to_the_programme(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Opposite pads, one tilted: closed as long as the line between them is in both cones."""
    said = []
    for tilt in np.linspace(0.0, 2 * np.arctan(0.5), 60):
        normals = np.array([[-1.0, 0, 0], [np.cos(tilt), np.sin(tilt), 0]])
        contacts = ContactSet.from_arrays(
            [[0.03, 0, 0], [-0.03, 0, 0]], normals, mu=0.5, mu_torsion=0.01, model="soft"
        )
        proven, closure = plainly_closed(contacts), force_closure(contacts)
        assert closure.closed or not proven
        said.append((proven, closure.closed))
    assert (True, True) in said
    assert (False, False) in said
    monkeypatch.setattr("planner.quality.closure.STEPS", 0)
    assert not positive_weights(rows(some_contacts(1)))
