"""What is drawn for trials of turns, and how meshes stand in them."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from conftest import box_mesh

from benchmarks.conditions import (
    FRICTION,
    MASS,
    PUSH_UNTIL,
    SIZE,
    Conditions,
    scaled_spec,
    standing,
)
from benchmarks.manipulate import Options, Turn, cases
from planner.errors import NotFoundError, TaskError
from planner.objects import parse_object
from planner.shapes import Mesh

CYLINDER = Turn(
    hand="allegro_hand",
    kind="cylinder",
    number=3,
    height=0.08,
    fingers=None,
    stand=0.0,
    seed=5,
)
Y = (0.0, 1.0, 0.0)


@pytest.mark.parametrize("name", ["superquadric", "lbracket", "mug", "torus", "hammer"])
def test_meshes_of_the_project_are_as_wide_as_asked(name: str) -> None:
    shape = parse_object(scaled_spec(name, 0.06)).shape
    assert isinstance(shape, Mesh)
    corners = shape.vertices @ standing(shape).rotation.T
    assert np.ptp(corners, axis=0)[:2].min() == pytest.approx(0.06, abs=2e-4)


def test_a_scaled_mesh_keeps_its_form() -> None:
    assert scaled_spec("superquadric", 0.06) == "superquadric:0.06x0.06x0.09x0.5x0.5"


@pytest.mark.parametrize("spec", ["superquadric:0.05x0.05x0.08x0.4x0.4", "part.stl*0.001", "box"])
def test_what_has_a_size_is_taken_as_it_is(spec: str) -> None:
    assert scaled_spec(spec, 0.06) == spec


def test_an_object_stands_as_high_as_it_stands_surely() -> None:
    lying = box_mesh((0.05, 0.06, 0.09))
    pose = standing(lying)
    assert pose.translation[2] == pytest.approx(0.045)
    assert abs(pose.rotation[2, 2]) == pytest.approx(1.0)
    thin = box_mesh((0.01, 0.06, 0.09))  # 6 degrees on its smallest side, 9 on the next
    assert standing(thin).translation[2] == pytest.approx(0.005)


def test_of_two_poses_as_high_the_surer_is_taken() -> None:
    mug = parse_object("mug").shape
    assert standing(mug).rotation[2, 2] > 0.99  # upright, though upside down is as high


def test_what_is_drawn_for_kinds_is_as_for_planning() -> None:
    assert CYLINDER.draw() == Conditions.draw("cylinder", 0.08, np.random.default_rng([5, 0, 3]))


def test_what_is_drawn_for_a_file_does_not_depend_on_its_folder() -> None:
    here, there = (
        replace(CYLINDER, kind="part", spec=f"{folder}/part.stl").draw() for folder in "ab"
    )
    assert here.spec == "a/part.stl"
    assert replace(here, spec="") == replace(there, spec="")
    other = replace(CYLINDER, kind="piece", spec="a/piece.stl").draw()
    assert other.mass != here.mass


def test_named_meshes_are_drawn_as_wide_as_cylinders() -> None:
    widths = [
        float(replace(CYLINDER, kind="mug", spec="mug", number=k).draw().spec[4:].split("x")[0])
        for k in range(20)
    ]
    assert min(widths) >= SIZE[0] / 2 - 1e-4
    assert max(widths) <= SIZE[1] / 2 + 1e-4
    assert np.ptp(widths) > 0.005


def test_conditions_keep_their_ranges_and_their_seed() -> None:
    drawn = [Conditions.draw("cylinder", 0.08, np.random.default_rng([1, k])) for k in range(200)]
    again = Conditions.draw("cylinder", 0.08, np.random.default_rng([1, 7]))
    assert again == drawn[7]
    sizes = [2 * float(c.spec.split(":")[1].split("x")[0]) for c in drawn]
    for values, (low, high) in (
        (sizes, SIZE),
        ([c.mass for c in drawn], MASS),
        ([c.mu for c in drawn], FRICTION),
        ([math.degrees(c.heading) for c in drawn], (-5.0, 5.0)),
        ([1e3 * c.shift[0] for c in drawn], (-3.0, 3.0)),
    ):
        assert low - 1e-9 <= min(values) < low + 0.1 * (high - low)
        assert high - 0.1 * (high - low) < max(values) <= high + 1e-9
    assert all(math.hypot(*c.push) == pytest.approx(0.4) for c in drawn)


@pytest.mark.parametrize(
    ("asked", "latest"),
    [
        ({"angle": math.radians(30.0)}, PUSH_UNTIL),  # as it always was about the vertical
        ({"axis": Y, "angle": math.radians(30.0)}, 0.476),  # at 1.1 rad/s
        ({"angle": 0.0, "shift": (0.0, 0.0, 0.015)}, 0.3),  # at 50 mm/s
        ({"axis": Y, "angle": math.radians(-30.0), "shift": (0.0, 0.01, 0.0)}, 0.476),
        ({"axis": Y, "angle": math.pi}, PUSH_UNTIL),
    ],
)
def test_the_push_begins_while_the_object_is_moved(asked: dict[str, Any], latest: float) -> None:
    begins = [replace(CYLINDER, number=k, **asked).draw().push_after for k in range(100)]
    assert 0.9 * latest < max(begins) <= latest + 1e-3


def test_what_is_there_does_not_depend_on_where_it_is_turned() -> None:
    plain, tilted = CYLINDER.draw(), replace(CYLINDER, axis=Y, angle=0.5).draw()
    assert replace(tilted, push_after=plain.push_after) == plain


@pytest.mark.parametrize(
    ("asked", "words"),
    [
        ({"rotate": "q:30"}, "--rotate 'q:30' names no axis; give x, y or z and degrees"),
        ({"shift": "0,0.01"}, "--shift '0,0.01' has 2 numbers; give three"),
        ({"rotate": "0"}, "give an angle or a shift"),
        ({"rotate": "y:200", "shift": "0,0,0.01"}, "at most a half turn"),
    ],
)
def test_a_movement_that_cannot_be_is_refused(asked: dict[str, Any], words: str) -> None:
    with pytest.raises(TaskError, match=words):
        list(cases(Options(**asked)))


def test_an_object_that_is_not_known_is_refused_with_all_that_are() -> None:
    with pytest.raises(NotFoundError, match="block") as caught:
        list(cases(Options(hands=["allegro_hand"], objects="xyzzy")))
    assert "superquadric" in str(caught.value)
