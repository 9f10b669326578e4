"""Objects from names, specifications and parameters, and what faulty ones are answered."""

from __future__ import annotations

from dataclasses import FrozenInstanceError
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from planner.errors import NotFoundError, ObjectError, PlannerError
from planner.objects import DEFAULT_MASS, GraspObject, object_names, parse_object
from planner.shapes import Box, Capsule, Cylinder, Ellipsoid, Shape, Sphere


@pytest.mark.parametrize(
    ("name", "shape"),
    [
        ("sphere", Sphere(0.035)),
        ("box", Box((0.05, 0.05, 0.08))),
        ("cylinder", Cylinder(0.03, 0.10)),
        ("capsule", Capsule(0.03, 0.12)),
        ("ellipsoid", Ellipsoid((0.09, 0.07, 0.06))),
    ],
)
def test_a_name_alone_has_default_sizes(name: str, shape: Shape) -> None:
    item = parse_object(name)
    assert item == GraspObject(name=name, shape=shape, mass=0.1)
    assert name in object_names()


@pytest.mark.parametrize(
    ("spec", "shape"),
    [
        ("sphere:0.04", Sphere(0.04)),
        ("box:0.05x0.06x0.07", Box((0.05, 0.06, 0.07))),
        ("cylinder:0.03x0.2", Cylinder(0.03, 0.2)),
        ("capsule:2e-2x1e-1", Capsule(0.02, 0.1)),
        ("ellipsoid:.05x.06x.07", Ellipsoid((0.05, 0.06, 0.07))),
        (" Box : 0.05 x 0.06 x 0.07 ", Box((0.05, 0.06, 0.07))),
        ("BOX:0.05X0.06X0.07", Box((0.05, 0.06, 0.07))),
    ],
)
def test_sizes_follow_a_colon(spec: str, shape: Shape) -> None:
    assert parse_object(spec).shape == shape


def test_mass_is_given_or_follows_from_density() -> None:
    assert parse_object("box").mass == DEFAULT_MASS
    assert parse_object("box", mass=0.25).mass == 0.25
    # 0.1 m x 0.2 m x 0.05 m of water
    assert parse_object("box:0.1x0.2x0.05", density=1000).mass == pytest.approx(1.0)
    assert parse_object("sphere:0.1", density=1000).mass == pytest.approx(4.18879, rel=1e-6)


@pytest.mark.parametrize(
    ("given_name", "nearest"),
    [("bx", "box"), ("spere", "sphere"), ("cylindre:0.1x0.2", "cylinder")],
)
def test_an_unknown_object_is_answered_with_the_nearest(given_name: str, nearest: str) -> None:
    with pytest.raises(NotFoundError, match=f"Did you mean '{nearest}'") as caught:
        parse_object(given_name)
    assert f"There is: {', '.join(sorted(object_names()))}." in str(caught.value)
    assert "Sizes follow a colon, in metres: box:0.05x0.05x0.08." in str(caught.value)


def test_no_name_at_all() -> None:
    for spec in ("", ":0.1", "  "):
        with pytest.raises(NotFoundError, match="no object is called ''"):
            parse_object(spec)


@pytest.mark.parametrize(
    ("spec", "message"),
    [
        ("box:0.05x0.05", r"has 2 size\(s\); box:XxYxZ needs 3, in metres"),
        ("box:0.05x0.05x0.05x0.05", r"has 4 size\(s\); box:XxYxZ needs 3"),
        ("sphere:0.05x0.05", r"has 2 size\(s\); sphere:RADIUS needs 1"),
        ("cylinder:0.05", r"has 1 size\(s\); cylinder:RADIUSxHEIGHT needs 2"),
        ("box:", "'' is not numbers separated by x; write box:XxYxZ in metres"),
        ("box:axbxc", "'axbxc' is not numbers separated by x; write box:XxYxZ"),
        ("box:0.05,0.05,0.05", "is not numbers separated by x; write box:XxYxZ"),
        ("box:0.05x0.05x", "is not numbers separated by x"),
        ("box:50x50x80", r"box: x is 50\.0 m, more than 2\.0 m; .*in millimetres by mistake"),
        ("box:0.05x0x0.05", r"box: y is 0\.0; give a finite number > 0 in m"),
        ("box:0.05x-0.05x0.05", r"box: y is -0\.05; give a finite number > 0 in m"),
        ("sphere:nan", "sphere: radius is nan; give a finite number > 0 in m"),
        ("sphere:inf", "sphere: radius is inf; give a finite number > 0 in m"),
        ("sphere:1e-9", "less than 0.0001 m; sizes are in metres, give more"),
        ("capsule:0.03x0.05", r"must be more than twice the radius 0\.03 m"),
    ],
)
def test_faulty_sizes_are_refused_with_the_remedy(spec: str, message: str) -> None:
    with pytest.raises(ObjectError, match=message):
        parse_object(spec)


@pytest.mark.parametrize(
    ("value", "remedy"),
    [
        (0.0, "is 0.0; give a finite number > 0 in kg"),
        (-1.0, "is -1.0; give a finite number > 0 in kg"),
        (float("nan"), "is nan; give a finite number > 0 in kg"),
        (float("inf"), "is inf; give a finite number > 0 in kg"),
        ("0.1", "is '0.1', not a number; give a finite number > 0 in kg"),
        (True, "is True, not a number; give a finite number > 0 in kg"),
        (
            250.0,
            "is 250 kg, more than 100 kg; masses are in kg and densities in kg/m3, was it given",
        ),
    ],
)
def test_a_mass_that_cannot_be_is_refused(value: Any, remedy: str) -> None:
    with pytest.raises(ObjectError, match=r"^box: mass ") as caught:
        parse_object("box", mass=value)
    assert remedy in str(caught.value)
    with pytest.raises(ObjectError, match=r"^thing: mass ") as caught:
        GraspObject(name="thing", shape=Sphere(0.03), mass=value)
    assert remedy in str(caught.value)


@pytest.mark.parametrize("value", [0.0, -1.0, float("nan"), float("inf"), "heavy"])
def test_a_density_that_cannot_be_is_refused(value: Any) -> None:
    with pytest.raises(ObjectError, match=r"box: density is .*; give a finite number > 0 in kg/m3"):
        parse_object("box", density=value)


def test_a_density_that_makes_it_too_heavy_is_refused() -> None:
    with pytest.raises(ObjectError, match=r"more than 100 kg; .*densities in kg/m3"):
        parse_object("box:1x1x1", density=1000)


def test_mass_and_density_together_are_refused() -> None:
    with pytest.raises(
        ObjectError, match=r"mass 0\.1 kg and density 500 kg/m3 are both given; give"
    ):
        parse_object("box", mass=0.1, density=500)


@given(st.text("abelopsx:.-0123 \tn", max_size=20))
def test_any_text_is_an_object_or_an_error_of_ours(text: str) -> None:
    try:
        item = parse_object(text)
    except PlannerError as error:
        assert str(error)
    else:
        assert item.name in object_names()


@given(
    st.sampled_from(object_names()),
    st.lists(
        st.sampled_from(["0.05", "1", "-1", "nan", "1e999", "1_0", "", " ", "0x1"]), max_size=4
    ),
)
def test_any_sizes_are_a_shape_or_an_error_of_ours(name: str, parts: list[str]) -> None:
    try:
        shape = parse_object(f"{name}:{'x'.join(parts)}").shape
    except PlannerError as error:
        assert "give" in str(error) or "metres" in str(error)
    else:
        assert np.isfinite(shape.sizes).all()
        assert min(shape.sizes) > 0


def test_an_object_cannot_be_changed_by_accident() -> None:
    with pytest.raises(FrozenInstanceError):
        parse_object("box").mass = 3.0  # type: ignore[misc]
