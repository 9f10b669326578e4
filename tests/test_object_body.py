"""A body of an MJCF file as an object: primitives stay what they are, the rest becomes a mesh."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import mujoco
import numpy as np
import pytest
import trimesh

from planner.bridge.object_body import object_body, object_in_model
from planner.errors import ModelError, NotFoundError, ObjectError
from planner.objects import DEFAULT_MASS, parse_object
from planner.shapes import Box, Capsule, Cylinder, Ellipsoid, Mesh, Shape, Sphere, Torus
from planner.system.disk_cache import CACHE_VARIABLE

Scene = Callable[[str], Path]


@pytest.fixture(autouse=True)
def own_cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(CACHE_VARIABLE, str(tmp_path_factory.mktemp("cache")))
        yield


@pytest.fixture
def scene(tmp_path: Path) -> Scene:
    """A file with a floor and one body "thing" that holds what is given."""

    def write(content: str) -> Path:
        path = tmp_path / "my scene.xml"
        path.write_text(
            '<mujoco><asset><mesh name="ring" file="ring.stl"/></asset><worldbody>'
            '<geom type="plane" size="1 1 1"/>'
            f'<body name="thing" pos="1 2 3" euler="10 20 30"><freejoint/>{content}</body>'
            '<body name="floor"><geom type="plane" size="1 1 1"/></body>'
            '<body name="frame"/></worldbody></mujoco>'
        )
        torus = Torus()
        moved = trimesh.Trimesh(
            torus.vertices + np.array([0.3, 0.0, 0.1]), torus.faces, process=False
        )
        moved.export(tmp_path / "ring.stl")
        return path

    return write


@pytest.mark.parametrize(
    ("geom", "shape"),
    [
        ('type="sphere" size="0.03"', Sphere(0.03)),
        ('type="box" size="0.02 0.03 0.04"', Box((0.04, 0.06, 0.08))),
        ('type="cylinder" size="0.03 0.05"', Cylinder(0.03, 0.1)),
        ('type="capsule" size="0.03 0.05"', Capsule(0.03, 0.16)),
        ('type="ellipsoid" size="0.02 0.03 0.04"', Ellipsoid((0.04, 0.06, 0.08))),
    ],
)
def test_one_primitive_is_that_primitive(scene: Scene, geom: str, shape: Shape) -> None:
    path = scene(f'<geom {geom} pos="0.01 0 0" mass="0.7"/>')
    item = parse_object(f"{path}#thing")
    assert (item.name, item.shape) == ("thing", shape)
    assert item.mass == pytest.approx(0.7)
    assert parse_object(f"{path}#thing", mass=0.2).mass == 0.2
    np.testing.assert_allclose(object_body(path, "thing").T_body_object.translation, [0.01, 0, 0])


def test_what_is_only_drawn_counts_if_nothing_collides(scene: Scene) -> None:
    drawn = '<geom size="0.02" contype="0" conaffinity="0" mass="0"/>'
    path = scene(drawn + '<geom size="0.03"/>')
    assert parse_object(f"{path}#thing").shape == Sphere(0.03)
    path = scene('<inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>' + drawn)
    only = parse_object(f"{path}#thing")
    assert only.shape == Sphere(0.02) and only.mass == 1


def test_a_mesh_keeps_its_true_triangles(scene: Scene) -> None:
    body = object_body(scene('<geom type="mesh" mesh="ring"/>'), "thing")
    assert isinstance(body.shape, Mesh)
    assert body.shape.volume == pytest.approx(Torus().volume, rel=1e-4)
    # in the axes of the body, not in those that MuJoCo turns a mesh into
    np.testing.assert_allclose(body.shape.half_extents, Torus().half_extents, atol=1e-6)
    np.testing.assert_allclose(body.T_body_object.translation, [0.3, 0.0, 0.1], atol=1e-6)


def test_parts_that_are_apart_are_one_object_of_two_bodies(scene: Scene) -> None:
    path = scene(
        '<geom type="box" size="0.02 0.02 0.02" pos="0.1 0 0"/><geom type="sphere" size="0.02"/>'
    )
    body = object_body(path, "thing")
    volume = 0.04**3 + 4 / 3 * np.pi * 0.02**3
    assert body.shape.volume == pytest.approx(volume, rel=3e-3)
    model = mujoco.MjModel.from_xml_path(str(path))
    number = model.body("thing").id
    np.testing.assert_allclose(body.T_body_object.translation, model.body_ipos[number], atol=1e-4)
    inertia = np.linalg.eigvalsh(body.shape.inertia(float(model.body_mass[number])))
    np.testing.assert_allclose(inertia[::-1], model.body_inertia[number], rtol=5e-3)


OVERLAP = (
    '<geom type="cylinder" size="0.02 0.05"/>'
    '<geom type="capsule" size="0.015 0.03" pos="0.02 0 0"/>'
)


def test_parts_that_overlap_are_united(scene: Scene) -> None:
    body = object_body(scene(OVERLAP), "thing")
    assert isinstance(body.shape, Mesh) and body.shape.mended == ""
    one, other = Cylinder(0.02, 0.1), Capsule(0.015, 0.09)
    points = np.random.default_rng(0).uniform(-0.06, 0.06, size=(4000, 3))
    either = np.minimum(
        one.signed_distance(points), other.signed_distance(points - np.array([0.02, 0, 0]))
    )
    ours = body.shape.signed_distance(points - body.T_body_object.translation)
    told = np.abs(either) > 2e-4
    np.testing.assert_array_equal(ours[told] < 0, either[told] < 0)


def test_parts_that_meet_face_to_face_are_one_body(scene: Scene) -> None:
    """Turned by quaternions of six digits, as files have them: neither apart nor overlapping."""
    path = scene(
        '<geom type="box" pos="0 0 0.1575" size="0.061 0.0305 0.0305"/>'
        '<geom type="cylinder" pos="0.0671 0 0.1575" quat="0.707106 0 0.707106 0"'
        ' size="0.0244 0.0061"/>'
        '<geom type="cylinder" pos="0.0854 0 0.1575" quat="0.707106 0 0.707106 0"'
        ' size="0.0305 0.0122"/>'
        '<geom type="box" pos="-0.061 0 0.1575" quat="0.9238795 0 0.3826834 0"'
        ' size="0.0215 0.029 0.0215"/>'
    )
    shape = object_body(path, "thing").shape
    assert isinstance(shape, Mesh) and shape.mended == ""
    ends = shape.bounds[1][0] - shape.bounds[0][0]
    assert ends == pytest.approx(0.0976 + 0.061 + 0.0215 * np.sqrt(2.0), abs=1e-5)


def test_the_centre_of_mass_is_the_models_own(scene: Scene) -> None:
    path = scene(
        '<geom type="box" size="0.02 0.02 0.02" mass="0.1"/>'
        '<geom type="box" size="0.02 0.02 0.02" pos="0.1 0 0" mass="0.3"/>'
    )
    body = object_body(path, "thing")
    np.testing.assert_allclose(body.T_body_object.act(body.center), [0.075, 0, 0], atol=1e-9)
    np.testing.assert_allclose(body.center, [0.025, 0, 0], atol=1e-6)
    turned = object_body(scene('<geom type="box" size=".02 .03 .04" euler="0 0 90"/>'), "thing")
    np.testing.assert_allclose(turned.center, 0.0, atol=1e-9)


@pytest.mark.parametrize(
    ("body", "error", "message"),
    [
        ("thong", NotFoundError, "no body is called 'thong'. Did you mean 'thing'"),
        ("floor", ObjectError, "plane or a height field, which is no solid; use a box"),
        ("frame", ObjectError, "body 'frame' of my scene.xml has no geom; name a body that"),
    ],
)
def test_bodies_that_are_no_objects(
    scene: Scene, body: str, error: type[Exception], message: str
) -> None:
    path = scene('<geom size=".03"/>')
    with pytest.raises(error, match=message):
        parse_object(f"{path}#{body}")


def test_a_missing_model_is_told(tmp_path: Path) -> None:
    with pytest.raises(ModelError, match="there is no model file"):
        parse_object(f"{tmp_path / 'none.xml'}#thing")


def test_a_body_without_mass_gets_the_default(tmp_path: Path) -> None:
    (tmp_path / "a.xml").write_text(
        '<mujoco><worldbody><body name="b"><geom size="0.03" mass="0"/></body></worldbody></mujoco>'
    )
    assert parse_object(f"{tmp_path / 'a.xml'}#b").mass == DEFAULT_MASS


@pytest.mark.parametrize("bits", ['contype="1" conaffinity="0"', 'contype="0" conaffinity="1"'])
def test_a_geom_collides_by_either_of_its_masks(scene: Scene, bits: str) -> None:
    drawn = '<geom type="box" size="0.05 0.05 0.05" contype="0" conaffinity="0"/>'
    path = scene(f'{drawn}<geom type="sphere" size="0.03" {bits}/>')
    assert object_body(path, "thing").shape == Sphere(0.03)


def test_a_mesh_may_be_what_mujoco_lets_collide() -> None:
    corners = [(0, 0), (2, 0), (2, 1), (1, 1), (1, 2), (0, 2)]
    vertices = [(0.01 * x, 0.01 * y, z) for z in (0.0, 0.01) for x, y in corners]
    faces = [f for k in range(1, 5) for f in ((0, k + 1, k), (6, k + 6, k + 7))]
    faces += [
        f for k in range(6) for j in [(k + 1) % 6] for f in ((k, j, j + 6), (k, j + 6, k + 6))
    ]
    spec = mujoco.MjSpec()
    spec.add_mesh(name="l", uservert=np.ravel(vertices), userface=np.ravel(faces))
    spec.worldbody.add_body(name="l").add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname="l")
    model = spec.compile()
    for hulls, volume in ((False, 3.0e-6), (True, 3.5e-6)):
        shape = object_in_model(model, "l", "an L", hulls=hulls).shape
        assert shape.volume == pytest.approx(volume, rel=1e-6)
