"""Damaged copies of good meshes: mended to the solid that they were, and by how much they moved."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import trimesh
from scipy.spatial import cKDTree

from planner import GraspTask, plan_grasp
from planner.errors import ObjectError
from planner.files import read_plan, write_plan
from planner.objects import parse_object
from planner.shapes import Mesh, shape_from_dict, shape_to_dict
from planner.shapes.meshes.mending import MOVED
from planner.shapes.meshes.repair import WIDEST_HOLE
from planner.shapes.meshes.soundness import faults_of
from planner.system.disk_cache import CACHE_VARIABLE

RADIUS, SIDE = 0.03, 0.05
Damage = Callable[[], trimesh.Trimesh]


@pytest.fixture(autouse=True)
def own_cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(CACHE_VARIABLE, str(tmp_path_factory.mktemp("cache")))
        yield


BALL = trimesh.creation.icosphere(4, RADIUS)
"""5,120 triangles with edges of 2.2 mm."""


def ball() -> trimesh.Trimesh:
    return BALL.copy()


def box(at: tuple[float, float, float] = (0, 0, 0), side: float = SIDE) -> trimesh.Trimesh:
    made = trimesh.creation.box((side, side, side))
    made.apply_translation(at)
    return made


def of(vertices: object, faces: object) -> trimesh.Trimesh:
    return trimesh.Trimesh(vertices, faces, process=False)


def together(*parts: trimesh.Trimesh) -> trimesh.Trimesh:
    return trimesh.util.concatenate(list(parts))


def inverted(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    mesh.invert()
    return mesh


def punctured() -> trimesh.Trimesh:
    """Without every 500th triangle."""
    whole = ball()
    return of(whole.vertices, np.delete(np.array(whole.faces), slice(0, None, 500), axis=0))


def half_turned() -> trimesh.Trimesh:
    faces = np.array(ball().faces)
    faces[::7] = faces[::7, ::-1]
    return of(ball().vertices, faces)


def torn() -> trimesh.Trimesh:
    """No two triangles share a vertex, and each is off by a tenth of a micrometre."""
    corners = np.array(ball().triangles).reshape(-1, 3)
    noise = np.random.default_rng(0).uniform(-1e-7, 1e-7, corners.shape)
    return of(corners + noise, np.arange(len(corners)).reshape(-1, 3))


def repeated() -> trimesh.Trimesh:
    return of(ball().vertices, np.concatenate([ball().faces, np.array(ball().faces)[::50]]))


def folded() -> trimesh.Trimesh:
    """One vertex is drawn 3 mm along the surface, over its neighbours' triangles."""
    vertices = np.array(ball().vertices)
    aside = np.cross(vertices[100], [0.3, 0.5, 0.8])
    moved = vertices[100] + 3e-3 * aside / np.linalg.norm(aside)
    vertices[100] = RADIUS * moved / np.linalg.norm(moved)
    return of(vertices, ball().faces)


def pushed_through() -> trimesh.Trimesh:
    """One vertex has gone through the other side, and 5 mm out of it."""
    vertices = np.array(ball().vertices)
    vertices[100] *= -(RADIUS + 5e-3) / RADIUS
    return of(vertices, ball().faces)


def flapping() -> trimesh.Trimesh:
    """A box with a triangle that sticks out of an edge by 0.1 mm."""
    made = box()
    edge = made.faces[0][:2]
    tip = made.vertices[edge].mean(axis=0) * (1 + 1e-4 / np.linalg.norm(made.vertices[edge[0]]))
    return of([*made.vertices, tip], [*made.faces, [*edge, len(made.vertices)]])


def off_centre(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    mesh.apply_translation((0.3, -0.2, 0.1))
    return mesh


OVERLAP = (0.02, 0.013, 0.011)
TWO_BOXES = 2 * SIDE**3 - float(np.prod(SIDE - np.array(OVERLAP)))

DAMAGED: dict[str, tuple[Damage, float, float, str]] = {
    "small holes": (punctured, ball().volume, 0.7e-3, r"11 hole\(s\) closed, up to 2\.\d mm wide"),
    "turned triangles": (half_turned, ball().volume, 0, r"\d+ triangle\(s\) turned to agree"),
    "seams": (torn, ball().volume, 1e-6, "repeated vertices merged"),
    "repeated triangles": (repeated, ball().volume, 0, "repeated or empty"),
    "a fold": (folded, ball().volume, MOVED, r"\d+ triangles crossed, cut out and filled"),
    "a flap": (flapping, SIDE**3, MOVED, "flap"),
    "inside out": (lambda: inverted(ball()), ball().volume, 0, "pointed inwards turned"),
    "two parts that cross": (lambda: together(box(), box(OVERLAP)), TWO_BOXES, 1e-6, "2 parts"),
    "crossing parts, one reversed": (
        lambda: together(box(), inverted(box(OVERLAP))),
        TWO_BOXES,
        1e-6,
        "2 parts",
    ),
    "a part in a part": (lambda: together(box(), box(side=0.02)), SIDE**3, 1e-6, "2 parts"),
    "far from the origin": (lambda: off_centre(folded()), ball().volume, MOVED, "crossed"),
}
"""What was done to a mesh, its volume before (m3), how far its surface may move, what is told."""


def farthest(mesh: Mesh, given: trimesh.Trimesh) -> float:
    """Largest distance (m) of vertices that are new, some of many, from given triangles."""
    points = mesh.vertices + mesh.offset
    fresh = points[cKDTree(given.vertices).query(points)[0] > 1e-9]
    if len(fresh) == 0:
        return 0.0
    fresh = fresh[:: max(1, len(fresh) // 300)]
    return float(trimesh.proximity.closest_point_naive(given, fresh)[1].max())


@cache
def mended_copy(name: str) -> tuple[trimesh.Trimesh, Mesh]:
    """A damaged mesh, and what becomes of it."""
    given = DAMAGED[name][0]()
    return given, Mesh.from_triangles(np.array(given.vertices), np.array(given.faces))


@pytest.mark.parametrize("name", DAMAGED)
def test_a_damaged_copy_is_mended_to_what_it_was(name: str) -> None:
    _, volume, moved, told = DAMAGED[name]
    given, mesh = mended_copy(name)
    assert faults_of(mesh.vertices, mesh.faces) == ()
    assert mesh.volume == pytest.approx(volume, rel=2e-3)

    assert re.search(told, mesh.mended), mesh.mended
    # the independent measure: no vertex is farther from what was given than is told
    assert farthest(mesh, given) <= moved + 2e-6


@pytest.mark.parametrize("name", ["small holes", "turned triangles", "a fold", "seams"])
def test_the_inertia_of_a_mended_ball_is_that_of_the_ball(name: str) -> None:
    _, mesh = mended_copy(name)
    whole = Mesh.from_triangles(np.array(ball().vertices), np.array(ball().faces))
    np.testing.assert_allclose(mesh.inertia(0.2), whole.inertia(0.2), rtol=0, atol=4e-8)
    np.testing.assert_allclose(mesh.offset, 0, atol=2e-5)
    assert whole.inertia(0.2)[0, 0] == pytest.approx(0.4 * 0.2 * RADIUS**2, rel=1e-2)


@pytest.mark.parametrize("name", DAMAGED)
def test_strict_refuses_what_would_be_mended(name: str) -> None:
    given = DAMAGED[name][0]()
    with pytest.raises(ObjectError, match=r"not mended, since --strict \(strict=True\) is given"):
        Mesh.from_triangles(np.array(given.vertices), np.array(given.faces), strict=True)


def test_a_reversed_part_inside_another_is_a_cavity_and_stays_one() -> None:
    given = together(box(), inverted(box(side=0.02)))
    mesh = Mesh.from_triangles(np.array(given.vertices), np.array(given.faces), strict=True)
    assert mesh.mended == "" and mesh.volume == pytest.approx(SIDE**3 - 0.02**3)


@pytest.mark.parametrize(
    ("at", "volume"),
    [
        ((-0.015, 0, 0), TWO_BOXES - 0.008**3),  # beside the overlap: the cavity stays
        ((0.01, 0, 0), TWO_BOXES),  # within it: matter of the other part fills it
        ((-0.005, 0, 0), TWO_BOXES - 0.004 * 0.008**2),  # half of it
    ],
)
def test_a_cavity_stays_where_no_other_part_fills_it(
    at: tuple[float, float, float], volume: float
) -> None:
    given = together(box(), inverted(box(at, side=0.008)), box(OVERLAP))
    mesh = Mesh.from_triangles(np.array(given.vertices), np.array(given.faces))
    assert mesh.volume == pytest.approx(volume, rel=1e-6)


@pytest.mark.slow
def test_a_vertex_on_the_far_side_is_too_much_to_mend_unasked() -> None:
    given = pushed_through()
    with pytest.raises(
        ObjectError, match=r"moves the surface by up to \d.* accept that with --rep"
    ):
        Mesh.from_triangles(np.array(given.vertices), np.array(given.faces))
    mesh = Mesh.from_triangles(np.array(given.vertices), np.array(given.faces), repair=True)
    assert mesh.volume == pytest.approx(ball().volume, rel=5e-3)
    assert float(np.abs(np.linalg.norm(mesh.vertices, axis=1) - RADIUS).max()) < 1e-3


@pytest.mark.parametrize(("cut", "mended"), [(0.0298, False), (0.029, False), (0.01, None)])
def test_a_wide_hole_is_closed_on_request_and_an_open_shell_never(
    cut: float, mended: bool | None
) -> None:
    whole = ball()
    kept = np.array(whole.triangles)[:, :, 2].max(axis=1) < cut
    given = of(whole.vertices, np.array(whole.faces)[kept])
    triangles = np.array(given.vertices), np.array(given.faces)
    with pytest.raises(ObjectError, match=r"closing a hole|not closed"):
        Mesh.from_triangles(*triangles)
    if mended is None:
        with pytest.raises(
            ObjectError, match=r"Mending was tried .* not closed: .* close it"
        ) as told:
            Mesh.from_triangles(*triangles, repair=True)
        # the rim's width, its share of the length, and the limit
        extent = np.ptp(triangles[0], axis=0).max()
        assert float(re.findall(r"([\d.]+) of the object", str(told.value))[0]) > WIDEST_HOLE
        width = float(re.findall(r"a hole is ([\d.]+) mm wide", str(told.value))[0])
        assert width == pytest.approx(2e3 * np.sqrt(0.03**2 - cut**2), rel=0.05)
        assert f"up to 0.3 of it ({300 * extent:.3g} mm)" in str(told.value)
    else:
        assert Mesh.from_triangles(*triangles, repair=True).volume > 0.9 * whole.volume


def test_repair_and_strict_together_are_refused() -> None:
    made = box()
    with pytest.raises(ObjectError, match="repair and strict are both asked for; give one"):
        Mesh.from_triangles(made.vertices, np.array(made.faces), repair=True, strict=True)


def test_a_mended_file_is_kept_and_its_plan_says_so(tmp_path: Path) -> None:
    file = tmp_path / "folded.ply"
    folded().export(file)
    item = parse_object(str(file))
    assert "triangles crossed" in item.mended
    again = Mesh.load(file)  # out of the disk cache
    assert again == item.shape and again.mended == item.mended
    plan = plan_grasp(GraspTask.create("allegro_hand", item), seed=0)
    assert f"object mended: {item.mended}" in str(plan)
    write_plan(plan, tmp_path / "plan.json")
    read = read_plan(tmp_path / "plan.json")
    assert read.task.object.mended == item.mended and read.task.object.shape == item.shape


def test_plain_data_tells_that_another_mending_was_stored(tmp_path: Path) -> None:
    file = tmp_path / "two.ply"
    together(box(), box(OVERLAP)).export(file)
    data = json.loads(json.dumps(shape_to_dict(Mesh.load(file))))
    assert shape_from_dict(data).volume == pytest.approx(TWO_BOXES, rel=1e-4)
    folded().export(file)
    with pytest.raises(ObjectError, match=r"was mended as '2 parts .* united.* changed since"):
        shape_from_dict(data)


def test_what_crosses_itself_too_much_is_refused_with_its_place() -> None:
    """A ball whose vertices are shaken by several lengths of its edges: folds everywhere."""
    made = trimesh.creation.icosphere(2, RADIUS)
    shaken = np.array(made.vertices) + np.random.default_rng(0).uniform(-0.04, 0.04, (162, 3))
    with pytest.raises(ObjectError, match=r"passes through itself: \d+ pair.* near \(.*Mending"):
        Mesh.from_triangles(shaken, np.array(made.faces), repair=True)
