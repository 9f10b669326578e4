"""How objects stand on a table: known solids, and invariants of all."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh
from conftest import of_trimesh
from scipy.spatial import ConvexHull

from planner.errors import ObjectError
from planner.objects import GraspObject, parse_object
from planner.shapes import Box, Hammer, Knot, LBracket, Mesh, Mug, Shape, Sphere, Torus
from planner.shapes import hulls as stable
from planner.shapes.hulls import stable_poses
from planner.shapes.mesh import HULL_VERSION
from planner.spatial import FloatArray, IntArray
from planner.system.disk_cache import CACHE_VARIABLE, write_arrays

SIZES = np.array([0.04, 0.06, 0.10])


def box_corners() -> FloatArray:
    return np.asarray(np.array(np.meshgrid(*[[-0.5, 0.5]] * 3)).reshape(3, -1).T * SIZES)


def test_a_box_stands_on_six_faces_as_worked_out_by_hand() -> None:
    poses = stable_poses(box_corners())
    assert len(poses) == 6
    assert [round(p.height, 9) for p in poses] == [0.02, 0.02, 0.03, 0.03, 0.05, 0.05]
    for pose in poses:
        across = np.delete(np.sort(SIZES), np.argmin(np.abs(np.sort(SIZES) - 2 * pose.height)))
        # it falls over its nearer edge when the centre is beyond it
        fall = np.degrees(np.arctan2(across.min() / 2, pose.height))
        assert pose.margin_deg == pytest.approx(fall)
    # solid angle of a rectangle a x b at height h: 4 atan(ab / (h sqrt(a^2 + b^2 + h^2))), halves
    a, b, h = 0.03, 0.05, 0.02
    share = 4 * np.arctan(a * b / (h * np.sqrt(a * a + b * b + h * h))) / (4 * np.pi)
    assert poses[0].probability == pytest.approx(share)
    assert sum(p.probability or 0 for p in poses) == pytest.approx(1)


@pytest.mark.parametrize(
    "shape", [Mug(), Torus(), LBracket(), Hammer(), Knot(), Box((0.05, 0.05, 0.08))], ids=str
)
def test_every_pose_is_a_minimum_of_height(shape: Shape) -> None:
    # tilted a little in any direction, the centre of mass rises; and nothing is below the table
    rng = np.random.default_rng(0)
    for pose in shape.resting_poses():
        np.testing.assert_allclose(pose.rotation @ pose.rotation.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(pose.rotation) == pytest.approx(1)
        height = shape.support(-pose.rotation[2])
        # facets within half a degree are one face, whose mean normal is what stands
        assert pose.height == pytest.approx(height, abs=5e-4)
        assert pose.margin_deg is not None
        tilt = np.radians(max(0.6 * pose.margin_deg, 1.0))
        for angle in rng.uniform(0, 2 * np.pi, size=12):
            axis = np.array([np.cos(angle), np.sin(angle), 0.0])
            turn = trimesh.transformations.rotation_matrix(tilt, axis)[:3, :3]
            rotation = turn @ pose.rotation
            assert shape.support(-rotation[2]) > height + 1e-6


def test_the_first_pose_is_the_one_that_is_hardest_to_tip() -> None:
    for shape in (Mug(), Torus(), LBracket(), Hammer()):
        margins = [p.margin_deg for p in shape.resting_poses()]
        assert margins == sorted(margins, key=lambda m: -round(m or 0, 1))
    np.testing.assert_allclose(Mug().resting_rotation, np.eye(3), atol=1e-9)  # upright
    np.testing.assert_allclose(Torus().resting_rotation, np.eye(3), atol=1e-9)  # flat
    assert abs(Hammer().resting_rotation[2] @ [0, 1, 0]) > 0.99  # head and handle on the table
    lying = LBracket().resting_pose().rotation @ [0.0, 1.0, 0.0]
    assert abs(lying[2]) == pytest.approx(1)


def test_what_topples_ends_where_it_falls_to() -> None:
    # a slanted prism whose upper end overhangs: of its two ends it stands on neither
    lower = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]) * 0.02
    upper = lower + np.array([0.06, 0.0, 0.03])
    hull = trimesh.convex.convex_hull(np.concatenate([lower, upper]))
    mesh = of_trimesh(hull)
    down = np.array([p.rotation[2] for p in mesh.resting_poses()])
    assert (np.abs(down @ [0, 0, 1]) < 0.999).all()
    assert sum(p.probability or 0 for p in mesh.resting_poses()) == pytest.approx(1)


def test_a_round_flank_is_not_one_face() -> None:
    can = trimesh.creation.cylinder(0.03, 0.1, sections=200)
    poses = of_trimesh(can).resting_poses()
    ends = [p for p in poses if p.height > 0.04]
    assert len(ends) == 2 and poses[0] in ends
    # a flank of 1.8 degrees does not hold it: it rolls
    assert len(poses) == 2


def test_a_ball_still_gets_a_pose() -> None:
    ball = trimesh.creation.icosphere(4, 0.03)
    (pose,) = of_trimesh(ball).resting_poses()
    assert pose.height == pytest.approx(0.03, abs=3e-4)


def test_an_object_stands_in_the_pose_that_is_asked_for() -> None:
    mug = parse_object("mug")
    upside_down = mug.resting_pose(0.1, index=1)
    np.testing.assert_allclose(upside_down.rotation[2], [0, 0, -1], atol=1e-9)
    lowest = mug.shape.support(-upside_down.rotation[2])
    assert upside_down.translation[2] == pytest.approx(0.1 + lowest)
    for shape, index, there in ((Mug(), 4, "4 stable"), (Sphere(0.03), 1, "1 stable")):
        item = GraspObject(name="thing", shape=shape)
        with pytest.raises(ObjectError, match=rf"{there} pose\(s\).*there is no pose {index}"):
            item.resting_pose(index=index)
    with pytest.raises(ObjectError, match="there is no pose -1"):
        Mug().resting_pose(0.0, -1)


def test_a_box_stands_as_it_always_did() -> None:
    for size in ((0.05, 0.05, 0.08), (0.004, 0.1, 0.2)):
        poses = Box(size).resting_poses()
        np.testing.assert_array_equal(poses[0].rotation, np.eye(3))
        assert poses[0].height == pytest.approx(size[2] / 2)


def _one_face_after_the_other(
    normals: FloatArray, areas: FloatArray, neighbours: IntArray
) -> list[int]:
    """Numbers of the faces that simplices are of, each compared with every neighbour."""
    group, count = [-1] * len(normals), 0
    for seed in np.argsort(-areas, kind="stable"):
        if group[seed] >= 0:
            continue
        group[seed], queue = count, [seed]
        while queue:
            for other in neighbours[queue.pop()]:
                flat = normals[other] @ normals[seed] > np.cos(np.radians(stable.FLAT_DEG))
                if group[other] < 0 and flat:
                    group[other] = count
                    queue.append(other)
        count += 1
    return group


@pytest.mark.parametrize("seed", range(6))
def test_faces_are_those_found_one_after_the_other(seed: int) -> None:
    """On hulls of points with flat faces, rounded ones, and some in between."""
    rng = np.random.default_rng(seed)
    round_points = rng.normal(size=(400, 3))
    round_points /= np.linalg.norm(round_points, axis=1, keepdims=True)
    flattened = np.clip(round_points, -0.99, [0.6, 0.9, 0.999])
    boxed = rng.uniform(-1.0, 1.0, size=(60, 3)).round(seed % 3)
    for points in (round_points, flattened, boxed):
        hull = ConvexHull(points)
        normals, corners = hull.equations[:, :3], points[hull.simplices]
        cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        areas = np.linalg.norm(cross, axis=1)
        found = stable._coplanar(normals, areas, hull.neighbors)
        assert found.tolist() == _one_face_after_the_other(normals, areas, hull.neighbors)


def test_poses_on_a_known_hull_are_those_on_a_new_one() -> None:
    """All vertices of an ellipsoid are on its hull, which is then not computed again."""
    ball = trimesh.creation.icosphere(subdivisions=3)
    ball.apply_scale([0.05, 0.03, 0.02])
    mesh = of_trimesh(ball)
    assert len(mesh.hull_vertices) == len(mesh.vertices)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("scipy.spatial.ConvexHull", None)
        known = mesh.resting_poses()
    new = stable_poses(mesh.hull_vertices)
    assert len(known) == len(new) > 0
    for one, other in zip(known, new, strict=True):
        assert np.array_equal(one.rotation, other.rotation)
        assert (one.height, one.margin_deg) == (other.height, other.margin_deg)
        assert one.probability == other.probability


def test_hull_and_poses_are_the_same_from_the_disk(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(CACHE_VARIABLE, str(tmp_path))
    known = parse_object("mug").shape
    assert isinstance(known, Mesh)

    def fresh() -> Mesh:
        return Mesh(known.vertices, known.faces)

    made = fresh()
    expected = made.hull_vertices, made.hull_planes, made.resting_poses()
    monkeypatch.setattr(Mesh, "_hull", None)  # nothing is computed from here on
    stored = fresh()
    np.testing.assert_array_equal(stored.hull_vertices, expected[0])
    np.testing.assert_array_equal(stored.hull_planes, expected[1])
    for a, b in zip(stored.resting_poses(), expected[2], strict=True):
        np.testing.assert_array_equal(a.rotation, b.rotation)
        assert (a.height, a.margin_deg, a.probability) == (b.height, b.margin_deg, b.probability)


@pytest.mark.parametrize(
    "spoilt",
    [
        {"poses": np.ones((1, 12))},
        {"poses": np.hstack([np.eye(3).reshape(1, 9), [[0.5, 10.0, 1.0]]])},
        {"poses": np.ones(12)},
        {"corners": np.arange(4), "planes": np.ones((3, 4))},
        {"corners": np.array([-1, 0, 1, 2]), "planes": np.ones((3, 4))},
        {"corners": np.arange(4)},
    ],
)
def test_a_hull_of_another_mesh_is_not_believed(
    spoilt: dict[str, FloatArray], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(CACHE_VARIABLE, str(tmp_path))
    given = parse_object("mug").shape
    assert isinstance(given, Mesh)
    known = Mesh(given.vertices, given.faces)
    expected = known.hull_vertices, known.hull_planes, known.resting_poses()
    kind = "poses" if "poses" in spoilt else "hull"
    write_arrays(kind, f"{HULL_VERSION}-{known.digest}", spoilt)
    mesh = Mesh(given.vertices, given.faces)
    np.testing.assert_array_equal(mesh.hull_vertices, expected[0])
    np.testing.assert_array_equal(mesh.hull_planes, expected[1])
    assert [p.height for p in mesh.resting_poses()] == [p.height for p in expected[2]]
