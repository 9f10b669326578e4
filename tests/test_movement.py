"""``sim.cli.options.movement``: what ``--rotate`` and ``--shift`` say."""

from __future__ import annotations

import pytest

from planner.errors import TaskError
from sim.cli.options import NO_SHIFT, movement

STILL = (0.0, 0.0, 0.0)


@pytest.mark.parametrize(
    ("rotate", "axis", "degrees"),
    [
        ("y:-45", (0.0, 1.0, 0.0), -45.0),
        ("x:7.5", (1.0, 0.0, 0.0), 7.5),
        ("90", (0.0, 0.0, 1.0), 90.0),
        ("-360", (0.0, 0.0, 1.0), -360.0),
        ("z:360", (0.0, 0.0, 1.0), 360.0),
        (None, (0.0, 0.0, 1.0), 90.0),
    ],
)
def test_a_turn_is_an_axis_and_degrees(
    rotate: str | None, axis: tuple[float, float, float], degrees: float
) -> None:
    assert movement(rotate, NO_SHIFT) == (axis, degrees, STILL)


def test_a_translation_comes_with_the_turn_that_is_asked_for_or_none() -> None:
    assert movement(None, "0,0,0.015")[1:] == (0.0, (0.0, 0.0, 0.015))
    assert movement("y:30", "0,-0.01,0") == ((0.0, 1.0, 0.0), 30.0, (0.0, -0.01, 0.0))


@pytest.mark.parametrize("text", ["q:90", "z", "z:", ":90", "z:a", "z:1,2", "x:y:30", "nan", ""])
def test_a_turn_that_cannot_be_read_is_refused(text: str) -> None:
    with pytest.raises(TaskError, match="--rotate"):
        movement(text, NO_SHIFT)


@pytest.mark.parametrize("text", ["", "0,0", "0,0,a", "0,0,inf"])
def test_a_translation_that_cannot_be_read_is_refused(text: str) -> None:
    with pytest.raises(TaskError, match="--shift"):
        movement(None, text)
