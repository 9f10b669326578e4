"""Arrays and numbers of users: one named error for what is none, whatever NumPy would say."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from planner.arrays import check_fields, checked_count, checked_number, finite_array
from planner.contacts import Contact, ContactSet
from planner.errors import ContactError, TaskError
from planner.forces import distribute_forces
from planner.quality import analyse, epsilon_l1
from planner.quality.ball import MOST_HULL_POINTS, measure_hull
from planner.search.metrics import resisted_per_newton

P = np.random.default_rng(0).normal(size=(3, 3))
FIVE = np.random.default_rng(1).normal(size=(5, 3))


def test_transposed_normals_are_refused() -> None:
    with pytest.raises(
        ContactError, match=r"normals have shape \(3, 5\); 5 positions need \(5, 3\)"
    ):
        ContactSet.from_arrays(FIVE, -FIVE.T)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"positions": P.ravel()}, r"positions have shape \(9,\)"),
        ({"positions": None}, "positions is None"),
        ({"positions": "text"}, "give an array of numbers"),
        ({"positions": [[1.0, 2.0, 3.0], [1.0, 2.0]]}, "give an array of numbers"),
        ({"positions": P + 1e300}, "farther than 1e\\+06 m"),
        ({"normals": None}, "normals is None"),
        ({"normals": np.ones(1)}, r"normals have shape \(1,\)"),
        ({"normals": P.ravel()}, r"normals have shape \(9,\)"),
        ({"normals": P * 1j}, "an array of complex128"),
        ({"mu": [0.5, 0.5]}, r"mu has shape \(2,\); give a number or \(3,\)"),
        ({"mu": 10**400}, "mu is 1000"),
        ({"mu": 1e7}, "friction is above 1000"),
        ({"mu_torsion": np.ones((3, 1))}, r"mu_torsion has shape \(3, 1\)"),
        ({"model": None}, "model is None"),
        ({"model": [None] * 3}, "contact models are names"),
        ({"model": ["point"] * 2}, "2 contacts need"),
        ({"forces": np.zeros((4, 3))}, r"forces has shape \(4, 3\)"),
        ({"forces": np.full((3, 4), np.inf)}, "forces hold infinity"),
        ({"fingers": "abc"}, "fingers is 'abc'"),
        ({"fingers": ["a"]}, "1 finger names for 3 contacts"),
        ({"center": np.zeros((3, 1))}, r"center has shape \(3, 1\)"),
    ],
)
def test_contacts_refuse_what_does_not_fit(given: dict[str, Any], message: str) -> None:
    arguments = {"positions": P, "normals": -P} | given
    with pytest.raises(ContactError, match=message):
        ContactSet.from_arrays(arguments.pop("positions"), arguments.pop("normals"), **arguments)


def test_single_contacts_and_changed_ones_are_checked_too() -> None:
    contacts = ContactSet.from_arrays(P, -P)
    wrongs: tuple[Callable[[], object], ...] = (
        lambda: Contact(position=np.zeros(2), frame=np.eye(3)),
        lambda: Contact(position=np.zeros(3), frame=2 * np.eye(3)),
        lambda: contacts.with_friction([0.1, 0.2]),
        lambda: contacts.with_friction("much"),
        lambda: contacts.with_forces(np.zeros(4)),
    )
    for wrong in wrongs:
        with pytest.raises(ContactError):
            wrong()


@pytest.mark.parametrize("edges", [2, 65, 2**31, 8.0, 1e308, None, "8"])
def test_edges_of_a_hull_are_few_whole_numbers(edges: Any) -> None:
    contacts = ContactSet.from_arrays(P, -P)
    for measure in (analyse, epsilon_l1):
        with pytest.raises(ContactError, match="give a whole number from 3 to"):
            measure(contacts, length=0.05, edges=edges)


def test_a_hull_of_too_many_points_is_refused_at_once() -> None:
    many = np.random.default_rng(2).normal(size=(MOST_HULL_POINTS // 8 + 1, 3))
    with pytest.raises(ContactError, match="give fewer edges, or merge contacts"):
        analyse(ContactSet.from_arrays(many, -many), length=0.05)
    with pytest.raises(ContactError, match="larger than 1e\\+12"):
        measure_hull(np.full((6, 9), 1e300))


def test_other_doors_of_arrays() -> None:
    contacts = ContactSet.from_arrays(P, -P)
    with pytest.raises(ContactError, match=r"wrenches have shape \(16,\)"):
        resisted_per_newton(contacts, np.ones(16), length=0.05)
    for name in ("edge_cost", "friction_scale"):
        with pytest.raises(ContactError, match=name):
            distribute_forces(contacts, wrench=np.zeros(6), **{name: np.ones(3)})  # type: ignore[arg-type]


def test_the_error_may_be_another_of_the_family() -> None:
    with pytest.raises(TaskError, match="gravity has shape"):
        finite_array("gravity", np.zeros(2), (3,), error=TaskError)
    with pytest.raises(TaskError, match=r"mass is nan; give a finite number from 0 to 5 in kg"):
        checked_number("mass", np.nan, least=0, most=5, unit="kg", error=TaskError)
    with pytest.raises(TaskError, match="workers is 9223372036854775808; give a whole number"):
        checked_count("workers", 2**63, least=1, most=8, error=TaskError)
    assert checked_number("mass", 1, least=0) == 1.0
    assert checked_count("workers", np.int64(3), least=1, most=8) == 3


@pytest.mark.parametrize("truth", [True, np.True_, np.array(True), np.array([True])[0]])
def test_a_truth_value_is_no_number_in_any_form(truth: Any) -> None:
    with pytest.raises(TaskError, match="not a number"):
        checked_number("mass", truth, error=TaskError)


@dataclass(frozen=True)
class Sized:
    """Fields of every kind that ``check_fields`` knows."""

    count: int = 3
    pair: tuple[float, float] = (1.0, 2.0)
    many: tuple[float, ...] = (1.0, 2.0, 3.0)
    grid: Any = None


@pytest.mark.parametrize("above", [2.0, 2.5, 2])
def test_a_whole_number_exceeds_what_it_has_to_exceed(above: float) -> None:
    check_fields(Sized(count=3), ("count",), above=above)
    with pytest.raises(TaskError, match="count is 2; give a whole number from 3"):
        check_fields(Sized(count=2), ("count",), above=above)


@pytest.mark.parametrize(
    "given",
    [
        {"pair": ((1.0, 2.0),)},
        {"pair": ((1.0,), (2.0,))},
        {"pair": np.ones((2, 1))},
        {"pair": (True, 2.0)},
        {"many": ((1.0, 2.0), (3.0, 4.0))},
        {"many": 1.0},
    ],
)
def test_numbers_in_a_row_are_not_rows_of_numbers(given: dict[str, Any]) -> None:
    (name,) = given
    with pytest.raises(TaskError, match=f"{name} is "):
        check_fields(Sized(**given), (name,))
    check_fields(Sized(pair=np.ones(2), many=[4.0]), ("pair", "many"))  # type: ignore[arg-type]
