"""A cost of the force programme from outside the package: one object, for both ways to solve it."""

from __future__ import annotations

import numpy as np
import pytest

from planner.contacts import ContactSet
from planner.errors import ContactError
from planner.forces import ForceLoop, QuadraticCost, build_force_problem, distribute_forces

WEIGHT = np.array([0.0, 0.0, -1.0, 0.0, 0.0, 0.0])


def above_and_below(mu: float = 0.0) -> ContactSet:
    """Two contacts below that share the weight, and one above that only presses."""
    return ContactSet.from_arrays(
        [[0.01, 0, -0.03], [-0.01, 0, -0.03], [0, 0, 0.03]],
        [[0, 0, 1], [0, 0, 1], [0, 0, -1]],
        mu=mu,
        model="frictionless",
    )


def press_from_above(newtons: float, weight: float) -> QuadraticCost:
    """A cost of one's own: the contact above wants a certain normal force."""
    return QuadraticCost.of_residual(
        [[0.0, 0.0, 1.0]], [newtons], weight=weight, name="press from above"
    )


@pytest.mark.parametrize("weight", [0.0, 1.0, 1e4])
def test_an_own_cost_acts_as_on_paper_in_both(weight: float) -> None:
    """With a above and b = (1 + a) / 2 below: a + 2 b (1/2) + c (a - 2) = 0 at the least."""
    contacts, cost = above_and_below(), press_from_above(2.0, weight)
    expected = max(0.0, (2.0 * weight - 0.5) / (1.5 + weight))
    anew = distribute_forces(contacts, wrench=WEIGHT, costs=[cost])
    assert anew.found
    assert anew.forces[2, 0] == pytest.approx(expected, abs=1e-6)
    assert ForceLoop(contacts, costs=[cost]).step(WEIGHT).forces == pytest.approx(anew.forces)
    loop = ForceLoop(contacts)
    plain = loop.step(WEIGHT).forces.copy()
    assert loop.step(WEIGHT, costs=[cost]).forces == pytest.approx(anew.forces)
    assert loop.step(WEIGHT, costs=[]).forces == pytest.approx(plain)


def test_costs_add_up_and_are_printed_by_name() -> None:
    contacts = above_and_below()
    half = press_from_above(2.0, 0.5)
    one = distribute_forces(contacts, wrench=WEIGHT, costs=[press_from_above(2.0, 1.0)])
    two = distribute_forces(contacts, wrench=WEIGHT, costs=[half, half])
    assert two.forces == pytest.approx(one.forces)
    assert "press from above" in str(build_force_problem(contacts, wrench=WEIGHT, costs=[half]))


def test_a_cost_beside_the_cost_of_change() -> None:
    contacts, cost = above_and_below(), press_from_above(2.0, 1.0)
    loop = ForceLoop(contacts, change_cost=5.0, costs=[cost])
    first = loop.step(WEIGHT).forces[2, 0]
    for _ in range(200):
        step = loop.step(WEIGHT)
    last = distribute_forces(contacts, wrench=WEIGHT, costs=[cost]).forces
    assert first < last[2, 0] - 0.1
    assert step.forces == pytest.approx(last, abs=1e-6)


@pytest.mark.parametrize(
    ("p", "q", "message"),
    [
        (np.eye(2), np.zeros(3), r"one entry per force component"),
        (np.diag([1.0, -1.0]), np.zeros(2), "is not convex"),
        ([[1.0, 1.0], [0.0, 1.0]], np.zeros(2), "is not convex"),
        (np.full((2, 2), np.nan), np.zeros(2), "finite"),
        (np.eye(4), np.zeros(4), "of 4 force components, but the contacts have 3"),
    ],
)
def test_a_cost_that_does_not_fit_is_refused(p: object, q: object, message: str) -> None:
    with pytest.raises(ContactError, match=message):
        distribute_forces(
            above_and_below(),
            wrench=WEIGHT,
            costs=[QuadraticCost(p=p, q=q, name="own")],  # type: ignore[arg-type]
        )
