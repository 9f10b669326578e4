"""Errors come back from another process as they were raised there."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

from planner import errors
from planner.errors import InfeasibleError, NoGraspFoundError, NotFoundError, PlannerError

SPECIAL: dict[str, PlannerError] = {
    "NotFoundError": NotFoundError("hand", "alegro", ["shadow", "allegro"], "Name a path."),
    "NoGraspFoundError": NoGraspFoundError("no grasp in 2 attempts", ("first", "second")),
    "InfeasibleError": InfeasibleError("no forces", np.arange(6.0)),
}


@pytest.mark.parametrize("name", errors.__all__)
def test_every_error_survives_pickling(name: str) -> None:
    error = SPECIAL.get(name) or getattr(errors, name)("what was given; what to do")
    again = pickle.loads(pickle.dumps(error))
    assert type(again) is type(error)
    assert str(again) == str(error)
    assert vars(again).keys() == vars(error).keys()
    for key, value in vars(error).items():
        np.testing.assert_array_equal(getattr(again, key), value)
