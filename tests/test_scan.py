"""Depth cameras: exact rays, the statistics of their errors, frames, and what a file keeps."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from planner.clouds.cloud import prepared
from planner.clouds.files import read_cloud
from planner.clouds.level import levelled
from planner.errors import ObjectError, TaskError
from planner.objects import parse_object
from planner.spatial import SE3, FloatArray
from sim.scan import (
    Calibration,
    DepthCamera,
    DepthNoise,
    Scan,
    look_at,
    scan,
    scanned_truth,
    write_scan,
)

CAMERA = DepthCamera()


def on_object(found: Scan, view: int = 0) -> FloatArray:
    """Points of the object in its own frame (n, 3)."""
    points = found.views[view].points()[found.on_object[view]]
    pose = found.truth.T_world_object
    return np.asarray((points - pose.translation) @ pose.rotation)


def test_depth_of_a_sphere_is_the_exact_distance_along_each_ray() -> None:
    ball, radius = parse_object("sphere:0.04"), 0.04
    eye = np.array([0.4, 0.0, 0.4])
    found = scan(ball, views=(look_at(eye, np.array([0.0, 0.0, radius])),), noise=0.0)
    image, (fx, fy, cx, cy) = found.views[0], CAMERA.intrinsics
    v, u = np.nonzero(found.on_object[0])
    ray = np.stack([(u - cx) / fx, (v - cy) / fy, np.ones(len(u))], axis=1)
    turn = image.T_world_camera[:3, :3]
    centre = turn.T @ (np.array([0.0, 0.0, radius]) - eye)
    along, square = ray @ centre, (ray**2).sum(axis=1)
    root = along**2 - square * (centre @ centre - radius**2)
    exact = (along - np.sqrt(np.maximum(root, 0.0))) / square
    assert len(u) > 3000
    assert np.abs(image.depth[v, u] - exact).max() < 1e-9


def test_depth_of_a_box_from_above_is_the_height_left() -> None:
    box = parse_object("box:0.06x0.05x0.07")
    eye = np.array([0.0, 0.0, 0.57])
    found = scan(box, views=(look_at(eye, np.zeros(3)),), noise=0.0)
    assert np.allclose(found.views[0].depth[found.on_object[0]], 0.5, atol=1e-12)
    on_table = np.isfinite(found.views[0].depth) & ~found.on_object[0]
    assert np.allclose(found.views[0].depth[on_table], 0.57, atol=1e-12)
    rows, columns = np.nonzero(found.on_object[0])
    size = np.array([np.ptp(columns), np.ptp(rows)]) * 0.5 / CAMERA.focal
    assert np.allclose(np.sort(size), [0.05, 0.06], atol=2e-3)


def test_a_mesh_is_seen_with_its_hollow() -> None:
    mug = parse_object("mug")
    found = scan(mug, views=(look_at(np.array([0.05, 0.0, 0.6]), np.zeros(3)),), noise=0.0)
    seen = on_object(found)
    assert np.abs(mug.shape.signed_distance(seen)).max() < 1e-6
    inside = np.hypot(seen[:, 0], seen[:, 1]) < 0.02
    assert seen[inside, 2].min() < -0.03  # the bottom, not the hull's lid


def test_noise_has_the_standard_deviation_that_was_asked_for_and_grows_with_distance() -> None:
    plate = parse_object("box:0.2x0.2x0.02")
    errors = DepthNoise(lateral=0.0, bleeding=0.0, specks=0.0, shadow=False)
    spread = {}
    for far in (0.5, 0.7):
        view = look_at(np.array([0.0, 0.0, 0.02 + far]), np.zeros(3))
        # what the noise is at 0.51 m, where the object's centre is
        asked = DepthNoise(**{**vars(errors), "depth": 0.002 * ((far + 0.01) / 0.51) ** 2})
        found = scan(plate, views=(view,), noise=asked, seed=3)
        off = found.views[0].depth[found.on_object[0]] - far
        spread[far] = off.std()
        assert abs(off.mean()) < 1e-4
    assert spread[0.5] == pytest.approx(0.002, rel=0.08)
    assert spread[0.7] / spread[0.5] == pytest.approx((0.7 / 0.5) ** 2, rel=0.08)


def test_disparity_comes_in_steps() -> None:
    plate = parse_object("box:0.2x0.2x0.02")
    view = look_at(np.array([0.0, 0.0, 0.52]), np.zeros(3))
    found = scan(plate, views=(view,), noise=DepthNoise(lateral=0.0, bleeding=0.0))
    depth = found.views[0].depth[found.on_object[0]]
    steps = CAMERA.focal * CAMERA.baseline / depth * 32
    assert np.abs(steps - np.round(steps)).max() < 1e-6
    assert len(np.unique(np.round(steps))) > 5


def test_edges_bleed_shadows_and_specks_have_no_depth() -> None:
    box = parse_object("box:0.06x0.06x0.08")
    view = (look_at(np.array([0.3, 0.0, 0.45]), np.array([0.0, 0.0, 0.04])),)
    plain = DepthNoise.of(0.0)
    count, depth = {}, {}
    for name, changed in (
        ("plain", {}),
        ("shadow", {"shadow": True}),
        ("specks", {"specks": 0.05}),
        ("bleeding", {"bleeding": 0.5}),
    ):
        found = scan(box, views=view, noise=DepthNoise(**{**vars(plain), **changed}))
        points = found.views[0].points()[np.isfinite(found.views[0].depth)]
        local = (
            points - found.truth.T_world_object.translation
        ) @ found.truth.T_world_object.rotation
        off = np.minimum(np.abs(box.shape.signed_distance(local)), np.abs(points[:, 2]))
        count[name] = len(points), int((off > 2e-3).sum())
        depth[name] = found.views[0].depth
    assert count["plain"][1] == count["shadow"][1] == count["specks"][1] == 0
    hidden = np.argwhere(np.isfinite(depth["plain"]) & np.isnan(depth["shadow"]))
    assert 500 < len(hidden) < 2000  # up to f b (1/0.5 - 1/0.62) = 13 pixels wide, 110 high
    assert (hidden[:, 1] < CAMERA.intrinsics[2]).all()  # the eye to the right sees less on the left
    assert count["specks"][0] == pytest.approx(0.95 * count["plain"][0], rel=0.01)
    assert count["bleeding"][0] == count["plain"][0]
    assert count["bleeding"][1] > 50  # in the air between edge and table


def test_a_calibration_error_moves_what_is_seen_and_nothing_else() -> None:
    item = parse_object("mug")
    true = scan(item, noise=0.0, views=2, seed=4)
    off = Calibration(shift=0.005, turn=np.radians(5.0), view_shift=0.001)
    seen = scan(item, noise=0.0, views=2, seed=4, calibration=off)
    for k in range(2):
        error = seen.calibration[k]
        here = SE3(np.eye(3), true.truth.T_world_object.translation)
        moved = here * error * here.inverse()
        before, after = (s.views[k].points()[s.on_object[k]] for s in (true, seen))
        assert np.allclose(before @ moved.rotation.T + moved.translation, after, atol=1e-12)
        assert np.allclose(seen.views[k].depth, true.views[k].depth, equal_nan=True)
    first, second = seen.calibration
    assert np.linalg.norm((first.inverse() * second).translation) < 0.004
    sizes = [
        Calibration(shift=0.005, turn=0.1).drawn(1, np.random.default_rng(k))[0] for k in range(400)
    ]
    shifts = [np.linalg.norm(pose.translation) for pose in sizes]
    assert np.sqrt(np.mean(np.square(shifts))) == pytest.approx(0.005, rel=0.1)


def test_two_views_look_from_opposite_sides() -> None:
    found = scan(parse_object("sphere:0.03"), views=2, seed=5)
    eyes = np.array([view.T_world_camera[:3, 3] for view in found.views])
    flat = eyes[:, :2] / np.linalg.norm(eyes[:, :2], axis=1)[:, None]
    assert flat[0] @ flat[1] == pytest.approx(-1.0)
    assert (eyes[:, 2] > 0.2).all()


def test_the_same_seed_gives_the_same_scan() -> None:
    item = parse_object("lbracket")
    first, again, other = (scan(item, seed=s).views[0].depth for s in (1, 1, 2))
    assert np.array_equal(first, again, equal_nan=True)
    assert not np.array_equal(first, other, equal_nan=True)


def test_a_file_keeps_points_views_noise_and_the_truth_apart(tmp_path: Path) -> None:
    item, file = parse_object("box:0.05x0.04x0.07", mass=0.2), tmp_path / "cloud.ply"
    found = scan(item, views=2, seed=6)
    write_scan(found, file)
    cloud, direct = read_cloud(file, table=None), found.cloud(table=None)
    assert np.allclose(cloud.points, direct.points, atol=1e-7)
    assert np.array_equal(cloud.view_of, direct.view_of)
    assert np.allclose(cloud.views, direct.views, atol=1e-7)
    assert cloud.noise == 0.002
    truth = scanned_truth(file)
    assert truth is not None
    assert (truth.object.shape.spec, truth.object.mass) == (item.shape.spec, 0.2)
    assert truth.table_height == 0.0
    assert np.allclose(truth.T_world_object.homogeneous, found.truth.T_world_object.homogeneous)


def test_a_tilted_table_is_levelled_and_brought_to_its_height() -> None:
    item = parse_object("box:0.05x0.05x0.08")
    off = Calibration(shift=0.005, turn=np.radians(5.0))
    for seed in range(3):
        found = scan(item, seed=seed, calibration=off)
        cloud = levelled(found.cloud(table=None), 0.0)
        on_table = cloud.points[cloud.points[:, 2] < 0.01]
        slope = np.linalg.lstsq(
            np.c_[on_table[:, :2], np.ones(len(on_table))], on_table[:, 2], rcond=None
        )[0]
        assert np.abs(slope[:2]).max() < np.radians(0.5)
        assert abs(slope[2]) < 5e-4
        assert cloud.table == 0.0
        assert len(prepared(cloud).past) > 5000  # what hid no table was seen through
    with pytest.raises(ObjectError, match="--table find"):
        levelled(found.cloud(table=None), 0.1)


def test_what_cannot_be_scanned_is_said() -> None:
    item = parse_object("box")
    away = look_at(np.array([0.4, 0.0, 0.4]), np.array([1.0, 0.0, 0.4]))
    with pytest.raises(ObjectError, match="let it look at it"):
        scan(item, views=(away,))
    aside = look_at(np.array([0.5, 0.0, 0.04]), np.array([0.0, 0.7, 0.04]))
    with pytest.raises(ObjectError, match="no view sees"):
        scan(item, views=(aside,))
    with pytest.raises(TaskError, match="at least one"):
        scan(item, views=())
    with pytest.raises(TaskError, match="noise"):
        scan(item, noise=-0.1)


def test_a_camera_where_it_looks_is_refused() -> None:
    with pytest.raises(TaskError, match="put it outside"):
        look_at(np.array([0.0, 0.0, 0.04]), np.array([0.0, 0.0, 0.04]))


def test_levelling_is_a_rigid_motion_of_cameras_points_and_rays() -> None:
    off = Calibration(shift=0.005, turn=np.deg2rad(5.0))
    raw = scan(parse_object("box"), views=2, seed=4, calibration=off).cloud(table=None)
    flat = levelled(raw, 0.0)
    for before, after in ((raw.points[::500], flat.points[::500]), (raw.past, flat.past)):
        gaps = [
            np.linalg.norm(cloud.views[:, None] - rows, axis=2)
            for cloud, rows in ((raw, before), (flat, after))
        ]
        np.testing.assert_allclose(gaps[0], gaps[1], atol=1e-9)
    assert np.linalg.norm(flat.views - raw.views, axis=1).min() > 1e-3
