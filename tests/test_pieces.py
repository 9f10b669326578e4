"""Convex pieces of a mesh: they cover it, and reach out of it no farther than told."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import trimesh
from conftest import of_trimesh

from planner.shapes import Box, Mesh, Sphere
from planner.shapes import pieces as pieces_of
from planner.shapes.cutting import Cell, Guards, cut, half_of
from planner.shapes.hulls import clip, crossing_points, hull_of
from planner.shapes.made import LBracket, Mug, Torus
from planner.shapes.meshes.triangles import cover
from planner.shapes.pieces import (
    TOLERANCE,
    Pieces,
    convex_pieces,
    deviation,
    pieces_fit,
)
from planner.shapes.solid import solid_deviation, solid_geoms
from planner.spatial import FloatArray
from planner.system.disk_cache import CACHE_VARIABLE, read_arrays, write_arrays

MADE = (LBracket(), Torus())


@pytest.fixture(autouse=True, scope="module")
def _cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(CACHE_VARIABLE, str(tmp_path_factory.mktemp("cache")))
        convex_pieces.cache_clear()
        yield


def cube(low: float = 0.0, high: float = 1.0) -> FloatArray:
    grid = np.stack(np.meshgrid(*[[low, high]] * 3), axis=-1)
    return grid.reshape(-1, 3)


def inside_of_some(pieces: Pieces, points: FloatArray, slack: float) -> np.ndarray:
    out = np.zeros(len(points), dtype=bool)
    for vertices in pieces.vertices:
        hull = hull_of(vertices)
        assert hull is not None
        out |= hull.depths(points) > -slack
    return out


@pytest.mark.slow
@pytest.mark.parametrize("mesh", [*MADE, Mug()], ids=lambda m: m.kind)
def test_pieces_cover_the_solid_and_stay_near_it(mesh: Mesh) -> None:
    pieces = convex_pieces(mesh)
    parts = list(zip(pieces.vertices, pieces.faces, strict=True))
    # pieces from the disk are used only if they fit; cuts run along faces of the mug's floor
    assert pieces_fit(mesh, mesh.vertices, parts, pieces.deviation)
    surface, _ = mesh.surface_samples(2000, np.random.default_rng(1))
    assert inside_of_some(pieces, surface, 1e-6).all()
    rng = np.random.default_rng(2)
    reach = 0.0
    for vertices, faces in zip(pieces.vertices, pieces.faces, strict=True):
        weights = rng.dirichlet(np.ones(3), size=(len(faces), 3))
        points = np.einsum("fkc,fcd->fkd", weights, vertices[faces]).reshape(-1, 3)
        reach = max(reach, float(mesh.signed_distance(points[:1500]).max()))
    assert reach <= pieces.deviation + 2e-4  # measured at other points
    assert pieces.deviation <= 1.3 * TOLERANCE


def test_an_l_bracket_is_two_boxes() -> None:
    pieces = convex_pieces(LBracket())
    assert len(pieces) == 2
    assert [len(v) for v in pieces.vertices] == [8, 8]
    assert pieces.deviation == pytest.approx(0.0, abs=1e-6)
    volumes = [h.volume for h in map(hull_of, pieces.vertices) if h is not None]
    assert sum(volumes) == pytest.approx(LBracket().volume)


def test_a_convex_mesh_is_one_piece() -> None:
    assert len(convex_pieces(of_trimesh(trimesh.creation.icosphere(2, 0.03)))) == 1


def test_a_cell_with_a_corner_in_the_solid_is_filled_to_that_corner() -> None:
    """The eighth of a cube that three cuts leave: no surface reaches the cuts' common corner."""
    hull = hull_of(cube(-0.05, 0.05))
    assert hull is not None
    mesh = Mesh.from_triangles(hull.points, hull.faces)
    walls = hull_of(cube(-1.0, 1.0))
    assert walls is not None
    cell = Cell(
        surface=mesh.vertices[mesh.faces], walls=walls, hull=hull, bad=np.arange(0, dtype=np.int64)
    )
    guards = Guards(mesh, hull, TOLERANCE)
    for axis in np.eye(3):
        half = half_of(mesh, guards, cell, axis, 0.01)
        assert half is not None
        cell = half
    assert cell.hull.volume == pytest.approx(0.06**3)


def test_a_cell_in_the_corner_of_a_bracket_holds_nothing_of_it_for_rounding() -> None:
    """Six of its corners are 1e-12 m in the solid: a hull of them would have no surface in it."""
    mesh = LBracket()
    whole = hull_of(mesh.hull_vertices)
    inner_corner = np.array([mesh.thickness, 0.0, mesh.thickness]) + mesh.vertices[0] * (1, 0, 1)
    walls = hull_of(cube(-0.02, 0.02) + inner_corner + (0.02 - 1e-12, 0.0, 0.02 - 1e-12))
    assert whole is not None and walls is not None
    inside = mesh.signed_distance(walls.points) < 0
    assert inside.sum() == 6
    none = np.zeros((0, 3, 3))
    cell = Cell(surface=none, walls=walls, hull=walls, bad=np.arange(0, dtype=np.int64))
    guards = Guards(mesh, whole, TOLERANCE)
    assert half_of(mesh, guards, cell, np.array([1.0, 0.0, 0.0]), 1.0) is None


def test_cutting_ends_where_a_plane_cuts_nothing_off(monkeypatch: pytest.MonkeyPatch) -> None:
    mesh = LBracket()
    whole = hull_of(mesh.hull_vertices)
    assert whole is not None
    asked = []

    def beside(*_: object) -> FloatArray:
        asked.append(1)
        if len(asked) > 10:
            raise AssertionError("the same cell is cut again and again")
        return np.array([1.0, 0.0, 0.0, 1.0])

    monkeypatch.setattr("planner.shapes.cutting._best_plane", beside)
    hulls = cut(mesh, Guards(mesh, whole, TOLERANCE), whole, TOLERANCE)
    assert [h.volume for h in hulls] == [pytest.approx(whole.volume)]


@pytest.mark.slow
@pytest.mark.parametrize("mesh", MADE, ids=lambda m: m.kind)
def test_deviation_is_what_measuring_every_point_gives(
    mesh: Mesh, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of the hull alone, which bridges centimetres: the smooth field must hide none of it."""
    monkeypatch.setattr(pieces_of, "MEASURED", 0.002)
    hull = hull_of(mesh.hull_vertices)
    assert hull is not None
    points, _ = cover(hull.triangles, 0.002)
    exact = mesh.signed_distance(points).max()
    assert exact > 0.01
    assert deviation(mesh, [hull]) == pytest.approx(exact, abs=1e-12)


def test_faces_of_pieces_are_closed_and_outward() -> None:
    pieces = convex_pieces(Torus())
    for vertices, faces in zip(pieces.vertices, pieces.faces, strict=True):
        a, b, c = (vertices[faces[:, k]] for k in range(3))
        volume = np.einsum("nd,nd->", a, np.cross(b, c)) / 6
        hull = hull_of(vertices)
        assert hull is not None
        assert volume == pytest.approx(hull.volume)


@pytest.mark.slow
def test_pieces_are_the_same_again_from_the_cache_and_anew(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(CACHE_VARIABLE, str(tmp_path))
    runs = []
    for damage in (False, False, True):
        convex_pieces.cache_clear()
        if damage:
            (file,) = (tmp_path / "pieces").iterdir()
            file.write_bytes(file.read_bytes()[:200])
        runs.append(convex_pieces(LBracket()))
    for again in runs[1:]:
        assert again.deviation == runs[0].deviation
        for k in range(len(runs[0])):
            np.testing.assert_array_equal(again.vertices[k], runs[0].vertices[k])
            np.testing.assert_array_equal(again.faces[k], runs[0].faces[k])


@pytest.fixture
def bracket() -> tuple[Pieces, str, dict[str, FloatArray]]:
    """The pieces of an L-bracket, and how the disk keeps them: the key and its arrays."""
    mesh = LBracket()
    made, key = convex_pieces(mesh), f"{pieces_of.PIECES_VERSION}-{mesh.digest}"
    arrays = read_arrays("pieces", key)
    assert arrays is not None
    return made, key, arrays


@pytest.mark.parametrize(
    "damage",
    ["larger", "smaller", "one left out", "flat", "no faces", "inside out", "no deviation"],
)
def test_pieces_that_do_not_fit_the_mesh_are_made_anew(
    bracket: tuple[Pieces, str, dict[str, FloatArray]],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    damage: str,
) -> None:
    made, key, kept = bracket
    arrays = dict(kept)
    monkeypatch.setenv(CACHE_VARIABLE, str(tmp_path))
    if damage in ("larger", "smaller"):
        factor = {"larger": 1.01, "smaller": 0.99}[damage]
        arrays |= {name: v * factor for name, v in arrays.items() if name.startswith("vertices")}
    elif damage == "one left out":
        arrays["number_and_deviation"] = np.array([len(made) - 1, made.deviation])
    elif damage == "flat":
        arrays["vertices_0"] = arrays["vertices_0"].ravel()
    elif damage == "no faces":
        arrays["faces_0"] = arrays["faces_0"][:0]
    elif damage == "inside out":
        arrays["faces_0"] = arrays["faces_0"][:, ::-1]
    else:
        arrays["number_and_deviation"] = np.array([len(made), -1.0])
    write_arrays("pieces", key, arrays)
    calls: list[Mesh] = []

    def make(mesh: Mesh, _: float) -> Pieces:
        calls.append(mesh)
        return made

    monkeypatch.setattr(pieces_of, "_make", make)
    read = convex_pieces.__wrapped__
    assert read(LBracket()) is made and len(calls) == 1
    # and what was written in its place is read
    assert read(LBracket()).deviation == made.deviation and len(calls) == 1


def test_primitives_are_one_geom_and_true() -> None:
    for shape, kind, size in (
        (Box((0.04, 0.06, 0.08)), "box", (0.02, 0.03, 0.04)),
        (Sphere(0.03), "sphere", (0.03,)),
    ):
        (geom,) = solid_geoms(shape)
        assert geom.kind == kind
        assert geom.size == pytest.approx(size)
        assert geom.vertices is None
        assert geom.faces is None
        assert solid_deviation(shape) == 0.0


def test_hull_of_a_cube_has_its_volume_and_knows_inside() -> None:
    hull = hull_of(np.concatenate([cube(), [[0.5, 0.5, 0.5]]]))
    assert hull is not None
    assert len(hull.points) == 8
    assert hull.volume == pytest.approx(1.0)
    points = np.array([[0.5, 0.5, 0.5], [1.5, 0.5, 0.5], [0.9, 0.5, 0.5], [1.0, 0.5, 0.5]])
    assert hull.inside(points).tolist() == [0, 2]
    np.testing.assert_allclose(hull.depths(points), [0.5, -0.5, 0.1, 0.0], atol=1e-12)


def test_flat_or_too_few_points_have_no_hull() -> None:
    flat = cube()
    flat[:, 2] = 0.0
    assert hull_of(flat) is None
    assert hull_of(cube()[:3]) is None


def test_clipping_a_cube_keeps_the_part_below() -> None:
    hull = hull_of(cube())
    assert hull is not None
    below = clip(hull.triangles, np.array([0.0, 0.0, 1.0]), 0.25)
    assert below[..., 2].max() == pytest.approx(0.25)
    part = hull_of(below.reshape(-1, 3))
    assert part is not None
    assert part.volume == pytest.approx(0.25)
    rim = crossing_points(hull.triangles, np.array([0.0, 0.0, 1.0]), 0.25, 1000)
    np.testing.assert_allclose(rim[:, 2], 0.25)


def test_what_only_touches_a_plane_is_not_below_it() -> None:
    """A face in the plane would let the hull of one side reach through the void of the other."""
    hull = hull_of(cube())
    assert hull is not None
    assert len(clip(hull.triangles, np.array([0.0, 0.0, -1.0]), -1.0)) == 0
    assert len(clip(hull.triangles, np.array([0.0, 0.0, 1.0]), 1.0)) == len(hull.triangles) - 2
