"""Regions that may, must not, or must be touched."""

from __future__ import annotations

from dataclasses import FrozenInstanceError

import numpy as np
import pytest

from planner.errors import ObjectError
from planner.objects import Region, TouchRegion, parse_object

UPPER = Region(name="upper half", lower=(-np.inf, -np.inf, 0.0))
RIGHT = Region(name="right", lower=(0.01, -1.0, -1.0), upper=(1.0, 1.0, 1.0))
POINTS = np.array([[0.0, 0, 0.1], [0.0, 0, -0.1], [0.02, 0, 0.1], [0.02, 0, -0.1]])


def test_a_box_and_a_half_space_contain_what_they_should() -> None:
    assert UPPER.contains(POINTS).tolist() == [True, False, True, False]
    assert RIGHT.contains(POINTS).tolist() == [False, False, True, True]
    assert UPPER.contains(np.array([[0.0, 0.0, 0.0]])).tolist() == [True]
    assert Region(name="all").contains(POINTS).all()


def test_allowed_forbidden_and_required() -> None:
    assert TouchRegion().permits(POINTS).all()
    assert TouchRegion(allowed=(UPPER,)).permits(POINTS).tolist() == [True, False, True, False]
    both = TouchRegion(allowed=(UPPER, RIGHT)).permits(POINTS)
    assert both.tolist() == [True, False, True, True]
    less = TouchRegion(allowed=(UPPER,), forbidden=(RIGHT,)).permits(POINTS)
    assert less.tolist() == [True, False, False, False]
    must = TouchRegion(required={"thumb": RIGHT})
    assert must.permits(POINTS[:2], ["index", "thumb"]).tolist() == [True, False]
    assert must.permits(POINTS[:2]).all()


def test_an_object_carries_its_region() -> None:
    touch = TouchRegion(forbidden=(UPPER,))
    assert parse_object("mug", touch=touch).touch is touch
    assert parse_object("mug").touch is None


@pytest.mark.parametrize(
    ("lower", "upper", "message"),
    [
        ((0.0, 0.0, 0.1), (1.0, 1.0, 0.1), "give lower < upper along every axis"),
        ((0.0, 0.0), (1.0, 1.0, 1.0), "lower is .*give three numbers x, y, z in m"),
        ((0.0, 0.0, 0.0), (1.0, 1.0, float("nan")), "upper is .*give three numbers"),
        ("abc", (1.0, 1.0, 1.0), "lower is 'abc'; give three numbers"),
        (None, (1.0, 1.0, 1.0), "lower is None; give three numbers"),
    ],
)
def test_faulty_regions_are_refused(lower: object, upper: object, message: str) -> None:
    with pytest.raises(ObjectError, match=rf"^region 'rim'.*{message}"):
        Region(name="rim", lower=lower, upper=upper)  # type: ignore[arg-type]


def test_a_region_cannot_be_allowed_and_forbidden() -> None:
    with pytest.raises(ObjectError, match=r"\['right'\] are both allowed and forbidden"):
        TouchRegion(allowed=(RIGHT,), forbidden=(RIGHT,))


def test_regions_cannot_be_changed() -> None:
    with pytest.raises(FrozenInstanceError):
        UPPER.name = "x"  # type: ignore[misc]
    fingers = {"thumb": RIGHT}
    touch = TouchRegion(required=fingers)
    fingers["index"] = UPPER
    assert set(touch.required) == {"thumb"}
    with pytest.raises(TypeError):
        touch.required["index"] = UPPER  # type: ignore[index]
