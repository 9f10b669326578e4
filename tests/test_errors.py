"""Errors come back from another process as they were raised there."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
from pydantic import ValidationError

from planner import errors
from planner.errors import (
    InfeasibleError,
    NoGraspFoundError,
    NotFoundError,
    PlannerError,
    UncertainError,
    UnreachableError,
)
from planner.exchange.yaml_text import number, table, text
from planner.files import PlanFile
from planner.files.disk import checked_file
from planner.schema import StrictData, faults_of
from planner.shapes import shape_from_dict

SPECIAL: dict[str, PlannerError] = {
    "NotFoundError": NotFoundError("hand", "alegro", ["shadow", "allegro"], "Name a path."),
    "NoGraspFoundError": NoGraspFoundError("no grasp in 2 attempts", ("first", "second")),
    "UnreachableError": UnreachableError("not reached", [[1.0]], 5.0),
    "UncertainError": UncertainError("too little was seen", ()),  # plans stay: test_clouds
    "InfeasibleError": InfeasibleError("no forces", np.arange(6.0)),
}


def aliased(levels: int = 12) -> list[object]:
    """What nine aliases in each other, that deep, stand for: 9 to that power values."""
    value: list[object] = ["x"] * 9
    for _ in range(levels):
        value = [value] * 9
    return value


def test_a_value_in_a_message_costs_nothing_and_is_short() -> None:
    # written out, the aliases alone would not end
    long = (aliased(), {"a": aliased()}, "x" * 10**7, b"x" * 10**7, 10**5000, np.zeros(10**6))
    for value in long:
        assert len(errors.shown(value)) <= errors.MOST_SHOWN
        assert len(str(PlannerError(errors.shown(value) * 10**4))) <= errors.MOST_MESSAGE + 5
    for plain in (1.5, "text", [1, 2], {"a": (1, None)}, np.nan):
        assert errors.shown(plain) == repr(plain)


def test_readers_of_plain_data_show_no_value_whole() -> None:
    doors = (
        lambda: shape_from_dict(aliased()),
        lambda: shape_from_dict({"kind": aliased()}),
        lambda: checked_file(PlanFile, {"format": aliased()}, "a file"),
        lambda: checked_file(PlanFile, {"format": "opposable-plan", "version": aliased()}, "a"),
        lambda: number(aliased(), "a place"),
        lambda: table(aliased(), "a place"),
        lambda: text(aliased(), "a place"),
    )
    for door in doors:
        with pytest.raises(PlannerError) as caught:
            door()
        assert len(str(caught.value)) < 400


@pytest.mark.parametrize("name", [n for n in errors.__all__ if n != "shown"])
def test_every_error_survives_pickling(name: str) -> None:
    error = SPECIAL.get(name) or getattr(errors, name)("what was given; what to do")
    again = pickle.loads(pickle.dumps(error))
    assert type(again) is type(error)
    assert str(again) == str(error)
    assert vars(again).keys() == vars(error).keys()
    for key, value in vars(error).items():
        np.testing.assert_array_equal(getattr(again, key), value)


@pytest.mark.parametrize("number", [1.34e154, -1e13, 10**400])
def test_every_number_of_a_file_has_a_bound_and_is_named(number: float) -> None:
    class Quality(StrictData):
        quality: dict[str, object]

    assert Quality(quality={"weakest_wrench_n_nm": [1e6, 0.0]})
    with pytest.raises(ValidationError) as caught:
        Quality(quality={"weakest_wrench_n_nm": [0.0, number]})
    assert "quality.weakest_wrench_n_nm.1 is" in faults_of(caught.value)
