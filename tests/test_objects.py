"""Objects: names, specifications, mass and density, refusals."""

from __future__ import annotations

import numpy as np
import pytest

from planner.errors import NotFoundError, ObjectError, PlannerError
from planner.objects import DEFAULT_MASS, OBJECT_NAMES, GraspObject, parse_object
from planner.shapes import SHAPES, Box, Capsule, Cylinder, Ellipsoid, Shape, Sphere


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
def test_a_name_has_a_default_size_and_mass(name: str, shape: Shape) -> None:
    item = parse_object(name)
    assert item == GraspObject(name=name, shape=shape, mass=DEFAULT_MASS)


def test_every_shape_has_a_name() -> None:
    assert set(OBJECT_NAMES) == set(SHAPES)


@pytest.mark.parametrize(
    ("spec", "shape"),
    [
        ("sphere:0.02", Sphere(0.02)),
        ("box:0.01x0.02x3e-2", Box((0.01, 0.02, 0.03))),
        (" Box: 0.01 X 0.02 x 0.03 ", Box((0.01, 0.02, 0.03))),
        ("cylinder:0.02x0.3", Cylinder(0.02, 0.3)),
        ("capsule:0.02x0.3", Capsule(0.02, 0.3)),
        ("ellipsoid:0.1x0.2x0.3", Ellipsoid((0.1, 0.2, 0.3))),
    ],
)
def test_specifications(spec: str, shape: Shape) -> None:
    assert parse_object(spec).shape == shape


def test_mass_and_density() -> None:
    assert parse_object("box", mass=0.25).mass == 0.25
    # 5 x 5 x 8 cm of water
    assert parse_object("box", density=1000).mass == pytest.approx(0.2)
    assert parse_object("sphere:0.1", density=500).mass == pytest.approx(500 * 4 / 3 * np.pi * 1e-3)


@pytest.mark.parametrize(
    ("spec", "message"),
    [
        ("bx", "no object is called 'bx'. Did you mean 'box'? There is: box, capsule,"),
        ("", "no object is called ''"),
        ("banana:0.1", "no object is called 'banana'.* Sizes follow a colon, in metres"),
    ],
)
def test_unknown_names(spec: str, message: str) -> None:
    with pytest.raises(NotFoundError, match=message.replace("?", r"\?")):
        parse_object(spec)


@pytest.mark.parametrize(
    ("spec", "message"),
    [
        ("box:0.05x0.05", r"has 2 size\(s\); box:XxYxZ needs 3, in metres"),
        ("sphere:0.05x0.05", r"has 2 size\(s\); sphere:RADIUS needs 1"),
        ("cylinder:0.05", r"has 1 size\(s\); cylinder:RADIUSxHEIGHT needs 2"),
        ("box:", "'' is not numbers separated by x; write box:XxYxZ in metres"),
        ("box:axbxc", "'axbxc' is not numbers separated by x"),
        ("capsule:0.05,0.2", "'0.05,0.2' is not numbers .* write capsule:RADIUSxHEIGHT"),
        ("box:5cmx5cmx8cm", "'5cmx5cmx8cm' is not numbers"),
        ("sphere:nan", "sphere: radius is nan; give metres > 0"),
        ("sphere:inf", "sphere: radius is inf; give metres > 0"),
        ("sphere:0", "sphere: radius is 0.0; give metres > 0"),
        ("box:0.05x-0.05x0.08", "box: y is -0.05; give metres > 0"),
        ("box:50x50x80", "box: x is 50.0 m, more than 2.0 m; .* in millimetres by mistake"),
        ("sphere:0.00001", "sphere: radius is 1e-05 m, less than 0.0001 m"),
        ("capsule:0.05x0.1", "must be more than twice the radius"),
    ],
)
def test_sizes_that_are_none(spec: str, message: str) -> None:
    with pytest.raises(ObjectError, match=message):
        parse_object(spec)


@pytest.mark.parametrize("value", [0.0, -0.1, np.nan, np.inf])
def test_mass_and_density_out_of_range(value: float) -> None:
    with pytest.raises(ObjectError, match=f"box: mass is {value}; give kg > 0"):
        parse_object("box", mass=value)
    with pytest.raises(ObjectError, match=f"box: density is {value}; give kg/m3 > 0"):
        parse_object("box", density=value)


def test_mass_that_is_no_number_or_not_believed() -> None:
    with pytest.raises(ObjectError, match="box: mass is '1', not a number"):
        parse_object("box", mass="1")  # type: ignore[arg-type]
    with pytest.raises(ObjectError, match=r"mass is 150 kg, more than 100 kg; .* in grams"):
        parse_object("box", mass=150)
    with pytest.raises(ObjectError, match=r"mass is 200 kg, more than 100 kg; .* densities in kg"):
        parse_object("box", density=1e6)


def test_mass_and_density_together() -> None:
    with pytest.raises(ObjectError, match=r"mass 0.1 kg and density 500 kg/m3 are both given"):
        parse_object("box", mass=0.1, density=500)


def test_every_refusal_is_of_the_family() -> None:
    for spec in ("bx", "box:1", "box:0x0x0"):
        with pytest.raises(PlannerError):
            parse_object(spec)
