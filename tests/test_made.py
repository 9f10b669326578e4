"""Objects made from sizes: sound for all sizes that are accepted, and of the sizes asked for."""

from __future__ import annotations

import json
from dataclasses import FrozenInstanceError

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planner.errors import ObjectError
from planner.objects import object_names, parse_object
from planner.shapes import (
    SIZED_SHAPES,
    Hammer,
    Knot,
    LBracket,
    Mesh,
    Mug,
    Superquadric,
    Torus,
    shape_from_dict,
    shape_to_dict,
)
from planner.shapes.made import read_object
from planner.shapes.meshes.soundness import bodies_of, faults_of

EXAMPLES: tuple[Mesh, ...] = (
    Mug(),
    Mug(0.03, 0.16),
    Mug(0.05, 0.07),
    LBracket(),
    LBracket(0.05, 0.2, 0.01, 0.004),
    Torus(),
    Torus(0.06, 0.005),
    Hammer(),
    Hammer(0.12, 0.06, 0.02),
    Hammer(0.3, 0.1, 0.015),
    Superquadric(),
    Superquadric(0.08, 0.07, 0.06, 2.5, 2.5),
    Superquadric(0.06, 0.06, 0.1, 0.2, 1.0),
    Knot(),
    Knot(0.05, 0.01),
)
each_made = pytest.mark.parametrize("mesh", EXAMPLES, ids=lambda m: m.spec)


def genus(mesh: Mesh) -> int:
    """Number of handles, by Euler's formula V - E + F = 2 - 2 g of one closed surface."""
    v, f = len(mesh.vertices), len(mesh.faces)
    return (2 - (v - 3 * f // 2 + f)) // 2


@pytest.mark.slow
@each_made
def test_it_is_the_surface_of_one_solid(mesh: Mesh) -> None:
    assert faults_of(np.array(mesh.vertices), np.array(mesh.faces)) == ()
    assert bodies_of(mesh.faces).max() == 0
    assert mesh.volume > 0
    holes = 1 if isinstance(mesh, Mug | Torus | Knot) else 0
    assert genus(mesh) == holes


@settings(max_examples=8, deadline=None)
@given(
    name=st.sampled_from(["mug", "lbracket", "torus", "hammer", "superquadric", "knot"]),
    data=st.data(),
)
def test_every_size_that_is_accepted_is_sound(name: str, data: st.DataObject) -> None:
    kind = SIZED_SHAPES[name]
    ranges = [
        st.floats(0.2, 3.0) if size in ("e1", "e2") else st.floats(0.003, 0.3)
        for size in kind.size_names
    ]
    sizes = [data.draw(r) for r in ranges]
    try:
        mesh = kind.from_sizes(sizes)
    except ObjectError as error:
        assert "give a" in str(error)
        return
    assert isinstance(mesh, Mesh)
    assert faults_of(np.array(mesh.vertices), np.array(mesh.faces)) == ()
    assert mesh.volume > 0


def test_outer_sizes_are_those_asked_for() -> None:
    def extents(mesh: Mesh) -> list[float]:
        lower, upper = mesh.bounds
        return [round(1e3 * float(v), 6) for v in upper - lower]

    assert extents(LBracket(0.09, 0.08, 0.045, 0.025)) == [90, 45, 80]
    assert extents(Torus(0.035, 0.015)) == [100, 100, 30]
    assert extents(Superquadric(0.06, 0.07, 0.09, 1.0, 1.0)) == [60, 70, 90]
    assert extents(Hammer(0.2, 0.09, 0.02)) == [90, 40, 200]
    assert extents(Hammer(0.3, 0.1, 0.015)) == [100, 30, 300]
    assert extents(Mug(0.04, 0.09))[1:] == [80, 90]
    assert extents(Mug(0.03, 0.16))[1:] == [60, 160]
    # a trefoil of radius R: x of sin t + 2 sin 2t is at most 2.74 R/3
    assert extents(Knot(0.04, 0.007))[2] == pytest.approx(2 * (40 / 3 + 7), abs=0.1)


@pytest.mark.parametrize("mesh", [Mug(), Hammer()], ids=lambda m: m.kind)
def test_default_sizes_are_the_stored_mesh_and_others_its_scales(mesh: Mug | Hammer) -> None:
    vertices, faces = read_object(mesh.kind)
    np.testing.assert_array_equal(mesh.faces, faces)
    np.testing.assert_allclose(mesh.vertices + mesh.offset, vertices, rtol=0, atol=1e-15)
    double = type(mesh).from_sizes([2 * size for size in mesh.sizes])
    np.testing.assert_allclose(double.vertices, 2 * mesh.vertices, rtol=0, atol=1e-15)
    assert double.volume == pytest.approx(8 * mesh.volume)


def test_sizes_cannot_be_changed_afterwards() -> None:
    with pytest.raises(FrozenInstanceError):
        Torus().tube = 0.01  # type: ignore[misc]
    mesh = Mesh(Torus().vertices, Torus().faces)
    with pytest.raises(AttributeError):
        mesh.vertices = np.zeros((0, 3))  # type: ignore[misc]


def test_volumes_worked_out_by_hand() -> None:
    assert LBracket(0.09, 0.08, 0.045, 0.025).volume == pytest.approx(
        0.045 * (0.09 * 0.025 + 0.055 * 0.025)
    )
    ball = Superquadric(0.06, 0.07, 0.08, 1.0, 1.0)
    assert ball.volume == pytest.approx(4 / 3 * np.pi * 0.03 * 0.035 * 0.04, rel=5e-3)
    # exponents 2: two square pyramids, and towards 0 a box
    pyramids = Superquadric(0.06, 0.06, 0.06, 2.0, 2.0)
    assert pyramids.volume == pytest.approx(0.06**3 / 6, rel=1e-6)
    assert Superquadric(0.06, 0.06, 0.06, 0.2, 0.2).volume > 0.9 * 0.06**3


def test_a_superquadric_s_points_obey_its_equation() -> None:
    mesh = Superquadric(0.06, 0.08, 0.10, 0.5, 1.5)
    x, y, z = (np.abs(mesh.vertices) / [0.03, 0.04, 0.05]).T
    level = (x ** (2 / 1.5) + y ** (2 / 1.5)) ** (1.5 / 0.5) + z ** (2 / 0.5)
    np.testing.assert_allclose(level, 1, atol=1e-9)


def test_a_mug_holds_water_and_can_be_held_by_its_handle() -> None:
    mug = Mug(0.04, 0.09)

    def distance(x: float, z: float) -> float:
        """At a point given from the bottom's middle."""
        return float(mug.signed_distance(np.array([[x, 0.0, z]]) - mug.offset)[0])

    assert distance(0.0, 0.05) > 0.03  # in the cup
    assert distance(0.038, 0.05) == pytest.approx(-0.002, abs=1e-4)  # in the wall
    assert distance(0.0, 0.002) == pytest.approx(-0.002, abs=1e-4)  # in the floor
    assert distance(0.070, 0.046) < -0.004  # in the handle's bar
    assert distance(0.052, 0.046) > 0.009  # a finger fits between bar and wall


def test_nothing_is_convex() -> None:
    for mesh in (Mug(), Torus(), LBracket(), Hammer(), Knot(), Superquadric(e1=2.5, e2=2.5)):
        corners = mesh.hull_vertices
        hull_middle = corners.mean(axis=0)
        rng = np.random.default_rng(0)
        chords = rng.dirichlet(np.ones(4), size=400) @ corners[rng.integers(len(corners), size=4)]
        assert np.isfinite(hull_middle).all()
        pairs = rng.integers(len(corners), size=(2, 400))
        middles = (corners[pairs[0]] + corners[pairs[1]]) / 2
        outside = mesh.signed_distance(np.concatenate([middles, chords])) > 1e-3
        assert outside.mean() > 0.05


@each_made
def test_specification_and_plain_data_read_back(mesh: Mesh) -> None:
    assert parse_object(mesh.spec).shape == mesh
    assert shape_from_dict(json.loads(json.dumps(shape_to_dict(mesh)))) == mesh
    assert hash(parse_object(mesh.spec).shape) == hash(mesh)


def test_plain_data_says_which_numbers_are_lengths() -> None:
    data = shape_to_dict(Superquadric())
    assert list(data) == ["kind", "x_m", "y_m", "z_m", "e1", "e2"]
    assert shape_to_dict(Mug()) == {"kind": "mug", "radius_m": 0.04, "height_m": 0.09}


def test_every_name_has_defaults_that_can_be_grasped() -> None:
    for name in ("mug", "lbracket", "torus", "hammer", "superquadric", "knot"):
        assert name in object_names()
        shape = parse_object(name).shape
        assert shape.sizes == SIZED_SHAPES[name]().sizes
        assert 0.02 < shape.bounding_radius < 0.14


@pytest.mark.parametrize(
    ("spec", "message"),
    [
        ("mug:0.04x0.5", r"height 0\.5 m does not go with radius 0\.04 m; give a height from"),
        ("mug:0.04x0.03", "does not go with radius"),
        ("mug:40x90", "mug: radius is 40.0 m, more than 2.0 m; sizes are in metres, was it given"),
        ("torus:0.02x0.03", "closes the hole of ring 0.02 m; give a thinner tube or a wider ring"),
        ("lbracket:0.05x0.05x0.05x0.05", "leaves no corner"),
        ("hammer:0.2x0.02x0.02", "too short for radius 0.02 m; give a head of at least 2.5 radii"),
        ("hammer:0.05x0.09x0.02", "too short for radius"),
        ("superquadric:0.05x0.05x0.05x0.01x1", "e1 is 0.01; give a finite number from 0.2 to 3"),
        ("superquadric:0.05x0.05x0.05x1xnan", "e2 is nan; give a finite number from"),
        ("superquadric:0.05x0.05x0.05", "has 3 size"),
        ("knot:0.04x0.02", "so that strands touch; give a thinner tube or a larger radius"),
    ],
)
def test_sizes_that_do_not_fit_are_refused(spec: str, message: str) -> None:
    with pytest.raises(ObjectError, match=message.replace("(", r"\(")):
        parse_object(spec)
