"""Meshes in trials of turns: their width, how they stand, and what is drawn for them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from conftest import box_mesh
from rich.console import Console

from benchmarks.conditions import SIZE, Conditions
from benchmarks.manipulate import Turn, run_manipulate
from benchmarks.meshes import scaled_spec, standing
from planner.errors import NotFoundError
from planner.objects import parse_object
from planner.shapes import Box, Mesh
from sim.runner import Runner

CYLINDER = Turn(
    index=0,
    hand="allegro_hand",
    kind="cylinder",
    number=3,
    height=0.08,
    fingers=None,
    stand=0.0,
    seed=5,
)


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


def test_primitives_stand_as_always() -> None:
    assert standing(Box((0.05, 0.05, 0.08))).translation[2] == pytest.approx(0.04)


def test_what_is_drawn_for_kinds_is_what_older_journals_have() -> None:
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


def test_an_object_that_is_not_known_is_refused_with_all_that_are(tmp_path: Path) -> None:
    with pytest.raises(NotFoundError, match="block") as caught:
        run_manipulate(
            ["allegro_hand"],
            ["xyzzy"],
            1,
            height=0.08,
            fingers=None,
            stand=0.0,
            seed=0,
            file=tmp_path / "rows.jsonl",
            runner=Runner(console=Console(quiet=True), check=lambda: None),
        )
    assert "superquadric" in str(caught.value)
