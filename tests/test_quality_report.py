"""Isotropy and the report: known answers, and that the report says what its parts say."""

from __future__ import annotations

import json

import numpy as np
import pytest

from planner.contacts import ContactModel, ContactSet
from planner.errors import ContactError
from planner.quality import (
    analyse,
    closure_and_epsilon,
    epsilon_l1,
    force_closure,
    isotropy,
    primitive_wrenches,
    singular_values,
    smallest_singular_value,
    volume_l1,
)

RADIUS = 0.03  # m
TRIANGLE = [[np.cos(a), np.sin(a), 0.0] for a in 2 * np.pi / 3 * np.arange(3)]


def on_sphere(directions: object, model: ContactModel = "point") -> ContactSet:
    d = np.asarray(directions, dtype=float)
    return ContactSet.from_arrays(RADIUS * d, -d, model=model, mu=0.5, mu_torsion=0.006)


def test_singular_values_of_two_soft_fingers() -> None:
    # Each wrench axis is met by both contacts: sqrt(2) six times when torque is over the radius.
    contacts = on_sphere([[1, 0, 0], [-1, 0, 0]], "soft")
    assert singular_values(contacts, length=RADIUS) == pytest.approx(np.sqrt(2.0))
    assert isotropy(contacts, length=RADIUS) == pytest.approx(1.0)
    # With twice the length the turns across the line lose half; torsion is scaled on both sides.
    assert singular_values(contacts, length=2 * RADIUS) == pytest.approx(
        np.sqrt(2.0) * np.array([1, 1, 1, 1, 0.5, 0.5])
    )
    assert smallest_singular_value(contacts, length=2 * RADIUS) == pytest.approx(np.sqrt(0.5))
    assert isotropy(contacts, length=2 * RADIUS) == pytest.approx(0.5)


def test_three_symmetric_contacts_have_the_singular_values_of_a_triangle() -> None:
    # Forces: sum of three identities, sqrt(3) along each axis. Torque over the radius:
    # sum of (1 - p p') is diag(3/2, 3/2, 3); force and torque rows do not mix, since sum p = 0.
    values = singular_values(on_sphere(TRIANGLE), length=RADIUS)
    assert values == pytest.approx(np.sqrt([3, 3, 3, 3, 1.5, 1.5]))


@pytest.mark.parametrize("n", [0, 1, 2])
def test_too_few_point_contacts_have_no_isotropy(n: int) -> None:
    d = np.array([[1.0, 0, 0], [-1, 0, 0]])[:n].reshape(n, 3)
    contacts = on_sphere(d)
    assert smallest_singular_value(contacts, length=RADIUS) == pytest.approx(0.0, abs=1e-12)
    assert isotropy(contacts, length=RADIUS) == pytest.approx(0.0, abs=1e-12)


def test_report_repeats_its_parts() -> None:
    contacts = on_sphere(TRIANGLE, "soft")
    report = analyse(contacts, length=0.04, edges=6)
    assert report.closure.closed
    assert report.closure.min_weight == force_closure(contacts, 6).min_weight
    assert report.epsilon == epsilon_l1(contacts, length=0.04, edges=6)
    assert report.volume == volume_l1(contacts, length=0.04, edges=6)
    assert report.isotropy == isotropy(contacts, length=0.04)
    assert report.epsilon <= report.epsilon_round.upper
    assert report.epsilon_round.lower <= report.epsilon_linf.upper
    assert report.epsilon_round.width < 0.25 * report.epsilon_round.upper


def test_weakest_wrench_is_in_newtons_and_takes_one_over_epsilon_of_force() -> None:
    contacts, length = on_sphere(TRIANGLE, "soft"), 0.04
    report = analyse(contacts, length=length)
    weakest = report.weakest_wrench
    scaled = np.append(weakest[:3], weakest[3:] / length)
    assert np.linalg.norm(scaled) == pytest.approx(1.0)
    # Contacts counter it with its opposite, and reach no further than epsilon along that.
    w = primitive_wrenches(contacts, length=length)
    assert (-scaled @ w).max() == pytest.approx(report.epsilon)


def test_report_survives_json() -> None:
    for contacts in (on_sphere(TRIANGLE), on_sphere(TRIANGLE[:1]), ContactSet.from_arrays([], [])):
        data = json.loads(json.dumps(analyse(contacts, length=RADIUS).to_dict(), allow_nan=False))
        assert data["n_contacts"] == len(contacts)
        assert data["closure"]["closed"] == (len(contacts) == 3)
        assert data["length_m"] == RADIUS
        assert (data["closure"]["weights"] is None) == (len(contacts) < 3)
        assert len(data["epsilon_round"]) == 2


def test_report_reads_well() -> None:
    text = str(analyse(on_sphere(TRIANGLE), length=RADIUS))
    assert text.startswith("3 contacts, 8 edges per cone, torque divided by 30.0 mm")
    assert "closed: rank 6, normalised min-weight 1" in text
    one = str(analyse(on_sphere(TRIANGLE[:1]), length=RADIUS))
    assert "not closed: rank 3" in one
    assert "cannot be resisted" in one


@pytest.mark.parametrize("model", ["point", "soft"])
def test_quick_path_agrees_with_the_full_one(model: ContactModel) -> None:
    for n in (0, 1, 2, 3):
        d = np.array(TRIANGLE)[:n].reshape(n, 3)
        contacts = on_sphere(d, model)
        closed, epsilon = closure_and_epsilon(contacts, length=0.04, edges=6)
        assert closed == force_closure(contacts, 6).closed == (n == 3)
        assert epsilon == epsilon_l1(contacts, length=0.04, edges=6)


def test_quick_path_sees_a_grasp_that_barely_closes() -> None:
    # Torsional friction of a micrometre: epsilon is next to nothing, closure is still closure.
    contacts = ContactSet.from_arrays(
        [[RADIUS, 0, 0], [-RADIUS, 0, 0]],
        [[-1, 0, 0], [1, 0, 0]],
        model="soft",
        mu=0.5,
        mu_torsion=1e-6,
    )
    closed, epsilon = closure_and_epsilon(contacts, length=RADIUS)
    assert closed
    assert 0 < epsilon < 1e-4


def test_samples_are_judged_with_as_many_edges_as_plans() -> None:
    """Four edges call some grasps open that the eight of plans close; those are asked again."""
    rng = np.random.default_rng(3)
    differ = 0
    for _ in range(40):
        contacts = on_sphere(rng.normal(size=(3, 3)), "soft")
        closed, epsilon = closure_and_epsilon(contacts, length=RADIUS)
        assert closed == force_closure(contacts, 8).closed
        assert (epsilon > 0.0) == closed
        differ += closed and not force_closure(contacts, 4).closed
    assert differ


def test_length_must_be_positive() -> None:
    for call in (analyse, closure_and_epsilon, isotropy, smallest_singular_value):
        with pytest.raises(ContactError, match="positive number of metres"):
            call(on_sphere(TRIANGLE), length=0.0)
