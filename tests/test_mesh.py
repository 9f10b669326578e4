"""Meshes: distances against other witnesses, mass properties of known solids, files and caches."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path

import coal
import numpy as np
import pytest
import trimesh
from conftest import box_mesh, of_trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from planner.collision.world import shape_pair
from planner.errors import ObjectError
from planner.shapes import Box, LBracket, Mesh, Mug, Sphere, Torus
from planner.shapes.convex_pairs import DistancePair
from planner.shapes.distance_field import DistanceField
from planner.shapes.mesh import THIN
from planner.shapes.mesh_field import SMOOTHED_MOST, fit_mesh_field
from planner.shapes.meshes.nearest_triangle import NearestTriangles
from planner.shapes.meshes.triangles import COVERED, cover, nearest_on_triangles, winding_number
from planner.spatial import SE3, FloatArray
from planner.system.disk_cache import CACHE_VARIABLE, cache_directory, read_arrays, write_arrays

BRICK = (0.05, 0.06, 0.1)


@pytest.fixture(autouse=True)
def own_cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    folder = tmp_path_factory.mktemp("cache")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(CACHE_VARIABLE, str(folder))
        yield folder


def hollow() -> Mesh:
    """A box with a box-shaped cavity."""
    outer, inner = trimesh.creation.box((0.08, 0.08, 0.08)), trimesh.creation.box((0.04,) * 3)
    inner.invert()
    return of_trimesh(trimesh.util.concatenate([outer, inner]))


@cache
def example(name: str) -> Mesh:
    """Meshes that several tests share, so that each is prepared once."""
    makers: dict[str, Callable[[], Mesh]] = {
        "mug": Mug,
        "torus": Torus,
        "lbracket": LBracket,
        "box": lambda: box_mesh(BRICK),
        "hollow": hollow,
        "cube of 0.5 m": lambda: box_mesh((0.5,) * 3),
        "cube of 1 m": lambda: box_mesh((1.0,) * 3),
        "cube of 2 m": lambda: box_mesh((2.0,) * 3),
    }
    return makers[name]()


@pytest.fixture
def quick_fit(monkeypatch: pytest.MonkeyPatch) -> list[object]:
    """A field that is fitted once for all tests; the list tells how often one was asked for."""
    calls: list[object] = []

    def fit(surface: NearestTriangles, thickness: float, *, wall: float) -> DistanceField:
        calls.append(surface)
        key = surface.corners.tobytes()
        if key not in FITTED:
            FITTED[key] = fit_mesh_field(surface, thickness, wall=wall)
        return FITTED[key]

    monkeypatch.setattr("planner.shapes.mesh_field.fit_mesh_field", fit)
    return calls


FITTED: dict[bytes, DistanceField] = {}


# --- distances ------------------------------------------------------------------------------------


def test_distances_from_a_box_are_those_of_the_box() -> None:
    mesh, box = box_mesh(BRICK), Box((0.05, 0.06, 0.1))
    points = np.random.default_rng(0).uniform(-0.1, 0.1, size=(500, 3))
    np.testing.assert_allclose(
        mesh.signed_distance(points), box.signed_distance(points), rtol=0, atol=1e-15
    )
    outside = box.signed_distance(points) > 1e-6
    for ours, theirs in zip(mesh.closest_point(points), box.closest_point(points), strict=True):
        np.testing.assert_allclose(ours[outside], theirs[outside], rtol=0, atol=1e-12)


@pytest.mark.parametrize("name", ["mug", "torus", "lbracket", "hollow"])
def test_distance_and_sign_by_brute_force_and_winding_number(name: str) -> None:
    mesh = example(name)
    rng = np.random.default_rng(1)
    near, normals = mesh.surface_samples(25, rng)
    points = np.concatenate(
        [
            rng.uniform(-1.3, 1.3, size=(25, 3)) * mesh.half_extents,
            near + rng.normal(size=(25, 1)) * 1e-3 * normals,
        ]
    )
    corners = mesh.vertices[mesh.faces]
    each = np.repeat(points, len(corners), axis=0)
    onto, _ = nearest_on_triangles(each, np.tile(corners, (len(points), 1, 1)))
    brute = np.linalg.norm(each - onto, axis=1).reshape(len(points), -1).min(axis=1)
    distance = mesh.signed_distance(points)
    np.testing.assert_allclose(np.abs(distance), brute, rtol=0, atol=1e-12)
    np.testing.assert_allclose(mesh.winding_number(points), distance < 0, atol=1e-6)


def test_distance_outside_is_coal_s() -> None:
    mesh, probe = Mug(), 1e-3
    points = np.random.default_rng(2).uniform(-0.15, 0.15, size=(100, 3))
    distance = mesh.signed_distance(points)
    tree, ball = mesh.coal_geometry(), coal.Sphere(probe)
    query = coal.ComputeDistance(tree, ball)
    request, result = coal.DistanceRequest(), coal.DistanceResult()
    for p, ours in zip(points, distance, strict=True):
        if ours < 2 * probe:
            continue
        result.clear()
        pose = coal.Transform3s.Identity()
        pose.setTranslation(p)
        theirs = query(coal.Transform3s.Identity(), pose, request, result)
        assert theirs + probe == pytest.approx(ours, abs=2e-6)


def test_the_normal_points_from_the_surface_to_a_point_outside() -> None:
    mesh = LBracket()
    points = np.random.default_rng(3).uniform(-0.15, 0.15, size=(200, 3))
    surface, normals = mesh.closest_point(points)
    distance = mesh.signed_distance(points)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1, atol=1e-12)
    np.testing.assert_allclose(surface + distance[:, None] * normals, points, atol=1e-12)


def test_on_the_surface_the_normal_is_of_face_edge_or_corner() -> None:
    mesh = box_mesh((0.1, 0.1, 0.1))
    corner = np.array([[0.05, 0.0, 0.01], [0.05, 0.05, 0.01], [0.05, 0.05, 0.05]])
    _, normals = mesh.closest_point(corner)
    expected = np.array([[1, 0, 0], [1, 1, 0], [1, 1, 1]]) / np.sqrt([[1], [2], [3]])
    np.testing.assert_allclose(normals, expected, atol=1e-12)


@settings(max_examples=40, deadline=None)
@given(st.floats(-0.999, 0.999), st.floats(-0.999, 0.999), st.floats(-0.999, 0.999))
def test_a_point_right_at_edges_and_corners_has_the_right_sign(
    x: float, y: float, z: float
) -> None:
    # the sign by face normals alone is wrong beside the sharp ridge of a flat pyramid
    mesh, apex = ridge()
    p = np.array([[x, y, z]]) * [0.06, 0.06, 0.01] + apex
    if abs(mesh.signed_distance(p)[0]) > 1e-9:
        inside = mesh.winding_number(p)[0] > 0.5
        assert inside == (mesh.signed_distance(p)[0] < 0)


@cache
def ridge() -> tuple[Mesh, FloatArray]:
    """A flat pyramid and its apex (3,)."""
    points = np.array([[1, 1, 0], [-1, 1, 0], [-1, -1, 0], [1, -1, 0], [0, 0, 0.1]]) * 0.05
    faces = np.array([[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4], [2, 1, 0], [3, 2, 0]])
    mesh = Mesh.from_triangles(points, faces)
    return mesh, points[4] - mesh.offset


def test_no_points_are_no_distances() -> None:
    assert box_mesh(BRICK).signed_distance(np.zeros((0, 3))).shape == (0,)
    with pytest.raises(ObjectError, match="points hold NaN or infinity"):
        box_mesh(BRICK).closest_point(np.array([[np.nan, 0, 0]]))


# --- single triangles -----------------------------------------------------------------------------


def test_nearest_points_of_a_triangle_worked_out_by_hand() -> None:
    corners = np.tile([[0.0, 0, 0], [2, 0, 0], [0, 2, 0]], (6, 1, 1))
    points = np.array(
        [[0.5, 0.5, 3], [-1, -1, 0], [1, -1, 1], [3, -1, 0], [2, 2, 0], [-1, 1, 0]], dtype=float
    )
    nearest, feature = nearest_on_triangles(points, corners)
    expected = np.array(
        [[0.5, 0.5, 0], [0, 0, 0], [1, 0, 0], [2, 0, 0], [1, 1, 0], [0, 1, 0]], dtype=float
    )
    np.testing.assert_allclose(nearest, expected, atol=1e-15)
    assert feature.tolist() == [6, 0, 3, 1, 4, 5]


def test_a_triangle_without_area_is_a_segment() -> None:
    corners = np.array([[[0.0, 0, 0], [1, 0, 0], [0.5, 0, 0]], [[1.0, 1, 1]] * 3])
    nearest, feature = nearest_on_triangles(np.array([[0.7, 1.0, 0], [0, 0, 0]]), corners)
    np.testing.assert_allclose(nearest, np.array([[0.7, 0, 0], [1, 1, 1]]))
    assert (feature < 6).all()


def test_a_cube_s_face_seen_from_its_middle_is_a_sixth_of_all() -> None:
    mesh = trimesh.creation.box((1, 1, 1))
    up = np.array(mesh.triangles)[np.array(mesh.face_normals)[:, 2] > 0.5]
    assert winding_number(np.zeros((1, 3)), up)[0] == pytest.approx(1 / 6)


@settings(max_examples=50, deadline=None)
@given(st.integers(0, 10_000))
def test_points_on_triangles_cover_them(seed: int) -> None:
    # needles as well: one extent is up to 1000 times another
    rng = np.random.default_rng(seed)
    corners = rng.normal(size=(1, 3, 3)) * 10 ** rng.uniform(-3, 0, size=3)
    step = 0.1
    points, owner = cover(corners, step)
    assert (owner == 0).all()
    onto, _ = nearest_on_triangles(points, np.repeat(corners, len(points), axis=0))
    np.testing.assert_allclose(onto, points, atol=1e-12)
    u = np.sort(rng.random((200, 2)), axis=1)
    shares = np.column_stack([u[:, 0], u[:, 1] - u[:, 0], 1 - u[:, 1]])
    inside = shares @ corners[0]
    gaps = np.linalg.norm(inside[:, None] - points[None], axis=2).min(axis=1)
    assert gaps.max() <= COVERED * step


# --- mass properties and extent -------------------------------------------------------------------


def test_mass_properties_of_a_box_and_a_moved_box() -> None:
    moved = trimesh.creation.box((0.05, 0.06, 0.1))
    moved.apply_translation((0.3, -0.2, 0.1))
    mesh, box = of_trimesh(moved), Box((0.05, 0.06, 0.1))
    assert mesh.volume == pytest.approx(box.volume, rel=1e-12)
    np.testing.assert_allclose(mesh.inertia(0.7), box.inertia(0.7), rtol=1e-10, atol=1e-15)
    np.testing.assert_allclose(mesh.offset, (0.3, -0.2, 0.1), atol=1e-15)
    np.testing.assert_allclose(mesh.half_extents, box.half_extents, atol=1e-15)
    assert mesh.bounding_radius == pytest.approx(box.bounding_radius)


def test_mass_properties_of_a_torus_by_its_formula() -> None:
    # volume 2 pi^2 R r^2; inertia m (R^2 + 3/4 r^2) about z, m (R^2/2 + 5/8 r^2) across
    ring, tube = 0.04, 0.012
    mesh = Torus(ring, tube)
    assert mesh.volume == pytest.approx(2 * np.pi**2 * ring * tube**2, rel=8e-3)
    inertia = np.diag(mesh.inertia(1.0))
    assert inertia[2] == pytest.approx(ring**2 + 0.75 * tube**2, rel=4e-3)
    assert inertia[0] == pytest.approx(ring**2 / 2 + 0.625 * tube**2, rel=4e-3)


def test_mass_properties_with_a_cavity() -> None:
    mesh = hollow()
    assert mesh.volume == pytest.approx(0.08**3 - 0.04**3)
    density = 1.0 / mesh.volume
    whole = Box((0.08,) * 3).inertia(density * 0.08**3) - Box((0.04,) * 3).inertia(
        density * 0.04**3
    )
    np.testing.assert_allclose(mesh.inertia(1.0), whole, atol=1e-15)
    assert mesh.signed_distance(np.zeros((1, 3)))[0] == pytest.approx(0.02)


def test_mass_properties_are_trimesh_s() -> None:
    mesh = Mug()
    theirs = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    assert mesh.volume == pytest.approx(theirs.volume, rel=1e-10)
    np.testing.assert_allclose(theirs.center_mass, 0, atol=1e-12)
    np.testing.assert_allclose(
        mesh.inertia(theirs.volume), theirs.moment_inertia, rtol=1e-8, atol=1e-15
    )


def test_extent_of_a_mesh_that_is_not_even_about_its_centre() -> None:
    mesh = Mug()
    lower, upper = mesh.bounds
    np.testing.assert_array_equal(mesh.half_extents, np.maximum(-lower, upper))
    assert upper[0] > -lower[0] + 0.01  # the handle
    for axis, low, high in zip(np.eye(3), lower, upper, strict=True):
        assert mesh.support(axis) == pytest.approx(high)
        assert mesh.support(-axis) == pytest.approx(-low)


# --- surface --------------------------------------------------------------------------------------


def test_samples_are_on_the_surface_and_even() -> None:
    mesh = box_mesh((0.1, 0.1, 0.2))
    points, normals = mesh.surface_samples(4000, np.random.default_rng(4))
    np.testing.assert_allclose(mesh.signed_distance(points), 0, atol=1e-12)
    assert (np.einsum("nd,nd->n", points, normals) > 0.04).all()
    # the ends have a fifth of the area
    assert np.mean(np.abs(normals[:, 2]) > 0.5) == pytest.approx(0.2, abs=0.03)
    assert np.abs(points.mean(axis=0)).max() < 0.004


def test_dispersion_of_normals() -> None:
    mesh = box_mesh((0.1, 0.1, 0.1))
    assert mesh.normal_dispersion(np.array([[0.05, 0.0, 0.0]]), 0.01)[0] == pytest.approx(
        0, abs=1e-6
    )
    # right on the edge two faces have equal parts of the ball: arccos |(1, 1, 0) / 2|
    on_edge = mesh.normal_dispersion(np.array([[0.05, 0.05, 0.0]]), 0.01)[0]
    assert on_edge == pytest.approx(np.pi / 4, abs=0.1)
    # on a ball of 40 mm, within 5 mm: normals about the axis by at most 7 degrees, and facets
    ball = of_trimesh(trimesh.creation.icosphere(4, 0.04))
    assert 0.02 < ball.normal_dispersion(ball.vertices[[7]], 0.005)[0] < np.radians(10)


def test_the_far_side_of_a_wall_is_no_edge() -> None:
    plate = of_trimesh(trimesh.creation.box((0.05, 0.05, 0.003)).subdivide_to_size(0.002))
    middle, rim = np.array([[0.0, 0.0, 0.0015]]), np.array([[0.025, 0.0, 0.0015]])
    up = np.array([[0.0, 0.0, 1.0]])
    assert plate.normal_dispersion(middle, 0.004)[0] > 1.0  # both sides, one against the other
    assert plate.normal_dispersion(middle, 0.004, facing=up)[0] == pytest.approx(0, abs=1e-6)
    assert plate.normal_dispersion(rim, 0.004, facing=up)[0] > 0.5


def test_the_thickness_of_walls() -> None:
    # 2 V / A of 50 x 50 x 3 mm
    paper = 2 * 7.5e-6 / (2 * 25e-4 + 4 * 1.5e-4)
    assert box_mesh((0.05, 0.05, 0.003)).wall_thickness == pytest.approx(paper)
    # an L-bracket's own size of that name is another one
    bracket = LBracket()
    assert bracket.wall_thickness < 0.9 * bracket.thickness


def test_a_narrow_bar_is_no_thin_wall() -> None:
    bar, plate = box_mesh((0.012, 0.012, 0.06)), box_mesh((0.05, 0.05, 0.004))
    assert max(bar.wall_thickness, plate.wall_thickness) < THIN
    assert plate.thin_walled
    assert not bar.thin_walled


# --- the field ------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("name", ["mug", "torus", "lbracket"])
def test_the_field_of_a_mesh_is_its_distance(name: str) -> None:
    mesh = example(name)
    rng = np.random.default_rng(5)
    field = mesh.field()
    surface, _ = mesh.surface_samples(1000, rng)
    error = np.abs(field.value(surface))
    # edges are rounded by less than the smoothing is wide
    assert np.median(error) < 6e-4 and error.max() < SMOOTHED_MOST
    for reach, tolerance in ((0.06, SMOOTHED_MOST), (0.15, 4e-3), (0.3, 4e-3)):
        points = rng.normal(size=(150, 3))
        points *= reach / np.linalg.norm(points, axis=1, keepdims=True)
        distance = mesh.signed_distance(points)
        assert np.abs(field.value(points) - distance).max() < tolerance


@pytest.mark.slow
def test_the_fine_field_is_as_steep_on_thin_walls() -> None:
    mug = example("mug")
    points, normals = mug.surface_samples(2000, np.random.default_rng(5))
    height = np.abs(points[:, 2] - points[:, 2].mean())
    on_side = (np.abs(normals[:, 2]) < 0.1) & (height < 0.02)
    slopes = mug.field(fine=True).taylor(points[on_side], 1)[:, 1:4]
    steep = np.linalg.norm(slopes, axis=1)
    assert on_side.sum() > 500 and np.quantile(steep, 0.1) > 0.9
    off = np.arccos(np.einsum("nd,nd->n", slopes, normals[on_side]) / steep)
    assert np.rad2deg(np.quantile(off, 0.9)) < 3.0


@pytest.mark.parametrize("name", ["mug", "lbracket", "hollow"])
def test_the_field_knows_inside_from_outside(name: str) -> None:
    mesh = example(name)
    points = np.random.default_rng(6).uniform(-1.2, 1.2, size=(4000, 3)) * mesh.half_extents
    distance = mesh.signed_distance(points)
    told = np.abs(distance) > SMOOTHED_MOST
    assert (distance[told] < 0).sum() > (50 if name != "mug" else 0)  # its walls are thin
    np.testing.assert_array_equal(mesh.field().value(points[told]) < 0, distance[told] < 0)


@pytest.mark.parametrize("name", ["mug", "torus", "lbracket", "hollow", "cube of 1 m"])
def test_the_field_s_error_is_bounded_within_the_bounding_box(name: str) -> None:
    mesh = example(name)
    lower, upper = mesh.bounds
    points = np.random.default_rng(8).uniform(lower, upper, size=(3000, 3))
    error = np.abs(mesh.field().value(points) - mesh.signed_distance(points))
    assert error.max() <= mesh.field().error < 5 * mesh.field().spacing


@pytest.mark.parametrize("size", [0.5, 1.0, 2.0])
def test_a_small_box_just_inside_a_large_mesh_is_inside(size: float) -> None:
    # its centre is 9 mm inside; coal measures to the triangles and calls it apart
    mesh = example(f"cube of {size:g} m")
    pair = shape_pair(coal.Box(0.01, 0.01, 0.01), mesh)
    rng = np.random.default_rng(9)
    for place in rng.uniform(-1, 1, size=(200, 3)) * (size / 2 - 0.009):
        place[rng.integers(3)] = size / 2 - 0.009
        assert pair.distance(SE3(np.eye(3), place), SE3.Identity()) < -0.008


def test_the_field_of_an_aligned_box_has_the_right_sign_inside() -> None:
    # no node next to the faces may be needed to tell a region's side
    assert example("box").field().value(np.zeros((1, 3)))[0] < -0.02


def test_the_field_is_kept_on_disk_by_content(own_cache: Path, quick_fit: list[object]) -> None:
    first = box_mesh(BRICK).field()
    (stored,) = (own_cache / "field").iterdir()
    again = box_mesh(BRICK).field()
    assert len(quick_fit) == 1
    box_mesh((0.05, 0.06, 0.11)).field()
    assert len(quick_fit) == 2
    points = np.random.default_rng(7).uniform(-0.2, 0.2, size=(50, 3))
    np.testing.assert_array_equal(again.taylor(points), first.taylor(points))
    assert box_mesh(BRICK).digest in stored.name


@pytest.mark.parametrize(
    "damage",
    [
        "cut",
        "text",
        "empty",
        "other arrays",
        "folder",
        "one byte",
        "open to others",
        "of another key",
        "of another mesh",
        "moved by a centimetre",
        "NaN",
        "no numbers",
        "a pipe",
    ],
)
def test_a_damaged_cache_is_made_anew(
    own_cache: Path, quick_fit: list[object], damage: str
) -> None:
    mesh = box_mesh(BRICK)
    value = mesh.field().value(np.zeros((1, 3)))
    (stored,) = (own_cache / "field").iterdir()
    if damage == "cut":
        stored.write_bytes(stored.read_bytes()[:-1000])
    elif damage == "text":
        stored.write_text("no arrays")
    elif damage == "empty":
        stored.write_bytes(b"")
    elif damage == "other arrays":
        write_arrays("field", stored.stem, {"place0": np.zeros(2)})
    elif damage == "one byte":
        content = bytearray(stored.read_bytes())
        content[len(content) // 2] ^= 1
        stored.write_bytes(content)
    elif damage == "open to others":
        stored.chmod(0o666)
    elif damage == "of another key":
        write_arrays("field", "key", read_arrays("field", stored.stem) or {})
        stored.with_stem("key").rename(stored)
    elif damage == "of another mesh":
        write_arrays("field", stored.stem, example("cube of 0.5 m").field().to_arrays())
        quick_fit[1:] = []
    elif damage == "folder":
        stored.unlink()
        stored.mkdir()
    elif damage == "a pipe":
        stored.unlink()
        os.mkfifo(stored, mode=0o600)
    else:
        arrays = read_arrays("field", stored.stem) or {}
        for name in [name for name in arrays if name.startswith("coefficients")]:
            changed = {"NaN": np.full(4, np.nan), "no numbers": np.array(["text"])}
            arrays[name] = changed.get(damage, arrays[name] - 0.01)
        write_arrays("field", stored.stem, arrays)
    np.testing.assert_array_equal(box_mesh(BRICK).field().value(np.zeros((1, 3))), value)
    assert len(quick_fit) == 2
    if damage != "folder":
        assert read_arrays("field", stored.stem) is not None
        np.testing.assert_array_equal(box_mesh(BRICK).field().value(np.zeros((1, 3))), value)
        assert len(quick_fit) == 2  # what was made anew is kept
    assert not list(own_cache.rglob("*.part"))


def test_without_a_cache_that_can_be_written_it_works(
    tmp_path: Path, quick_fit: list[object], monkeypatch: pytest.MonkeyPatch
) -> None:
    blocked = tmp_path / "file"
    blocked.write_text("")
    monkeypatch.setenv(CACHE_VARIABLE, str(blocked))
    assert cache_directory() == blocked
    assert box_mesh(BRICK).field().value(np.zeros((1, 3)))[0] < 0
    assert read_arrays("field", "nothing") is None


# --- the type -------------------------------------------------------------------------------------


def test_meshes_are_equal_by_their_triangles() -> None:
    assert box_mesh(BRICK) == box_mesh(BRICK) and hash(box_mesh(BRICK)) == hash(box_mesh(BRICK))
    assert box_mesh(BRICK) != box_mesh((0.05, 0.06, 0.11))
    assert Torus() == Torus() and Torus() != Torus(0.04, 0.01)
    assert box_mesh(BRICK) != Box((0.05, 0.06, 0.1))
    assert (box_mesh(BRICK) == Sphere(0.03)) is False


def test_triangles_cannot_be_changed_by_accident() -> None:
    mesh = box_mesh(BRICK)
    with pytest.raises(ValueError, match="read-only"):
        mesh.vertices[0] = 0.0
    with pytest.raises(ValueError, match="read-only"):
        mesh.faces[0] = 0


def test_what_a_mesh_has_not_is_said() -> None:
    with pytest.raises(ObjectError, match="a mesh has no sizes; give the path"):
        Mesh.from_sizes((0.1,))
    with pytest.raises(ObjectError, match="no single MuJoCo geom"):
        box_mesh(BRICK).mujoco_geom()
    assert box_mesh(BRICK).sizes == () and box_mesh(BRICK).spec == "mesh"


def test_it_rests_on_a_table() -> None:
    pose = box_mesh(BRICK).resting_pose(0.2)
    assert pose.translation[2] == pytest.approx(0.2 + 0.025)  # on its largest face
    lowest = (box_mesh(BRICK).vertices @ pose.rotation.T + pose.translation)[:, 2].min()
    assert lowest == pytest.approx(0.2)
    table = SE3(np.eye(3), np.array([0.0, 0.0, -0.3]))
    assert DistancePair(Box((0.05, 0.06, 0.1)).coal_geometry(), coal.Box(4, 4, 1)).query(
        pose, table
    ).distance == pytest.approx(0, abs=1e-7)


@pytest.mark.parametrize("radius", [1e-4, 3e-3, 0.02])
def test_triangles_within_are_those_of_brute_force_for_few_points_and_many(
    radius: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    mesh = trimesh.creation.torus(0.04, 0.012, major_sections=40, minor_sections=20)
    surface = NearestTriangles(np.array(mesh.vertices), np.array(mesh.faces))
    points = np.random.default_rng(5).uniform(-0.06, 0.06, (30, 3))
    n, m = len(points), len(surface.faces)
    owner, triangle = np.repeat(np.arange(n), m), np.tile(np.arange(m), n)
    nearest, _ = nearest_on_triangles(points[owner], surface.corners[triangle])
    near = ((nearest - points[owner]) ** 2).sum(axis=1) <= radius**2
    for most in (n * m, 0):  # every triangle is looked at; the tree is asked
        monkeypatch.setattr("planner.shapes.meshes.nearest_triangle.FEW", most)
        found = surface.within(points, radius)
        np.testing.assert_array_equal(found[0], owner[near])
        np.testing.assert_array_equal(found[1], triangle[near])
