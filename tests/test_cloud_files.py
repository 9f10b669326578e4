"""Files of clouds and depth images: what goes in comes out, and what is broken is named."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from planner.clouds.files import DepthView, cloud_of_views, is_cloud_file, read_cloud
from planner.errors import ObjectError
from planner.objects import parse_object
from planner.spatial import FloatArray
from sim.scan import scan, write_scan

RNG = np.random.default_rng(31)
POINTS = RNG.normal(size=(200, 3)) * [0.03, 0.02, 0.02] + [0.0, 0.0, 0.1]
NORMALS = POINTS - [0.0, 0.0, 0.1]
NORMALS = NORMALS / np.linalg.norm(NORMALS, axis=1)[:, None]


def ply(form: str, *, normals: bool, count: int | None = None) -> bytes:
    """A PLY file of the points, with a colour between its columns."""
    names = ["x", "y", "z", *(["nx", "ny", "nz"] if normals else []), "red"]
    kinds = ["float"] * (len(names) - 1) + ["uchar"]
    data = np.hstack([POINTS, *([NORMALS] if normals else []), np.full((len(POINTS), 1), 200)])
    head = [f"ply\nformat {form} 1.0\ncomment made by hand\ncomment view 0.1 0.2 0.5"]
    head += [f"element vertex {len(POINTS) if count is None else count}"]
    head += [f"property {kind} {name}" for kind, name in zip(kinds, names, strict=True)]
    head += ["element face 0\nproperty list uchar int vertex_indices\nend_header\n"]
    if form == "ascii":
        body = "\n".join(" ".join(f"{v:.9g}" for v in row) for row in data).encode()
    else:
        order = "<" if "little" in form else ">"
        row = [
            (n, order + ("u1" if k == "uchar" else "f4")) for n, k in zip(names, kinds, strict=True)
        ]
        body = np.array([tuple(r) for r in data], dtype=row).tobytes()
    return "\n".join(head).encode() + body


def pcd(form: str, *, viewpoint: str = "0.1 0.2 0.5 1 0 0 0") -> bytes:
    """A PCD file of the points with normals and a column of two numbers."""
    head = (
        "# .PCD v0.7\nVERSION 0.7\nFIELDS x y z fpfh normal_x normal_y normal_z\n"
        "SIZE 4 4 4 4 4 4 4\nTYPE F F F F F F F\nCOUNT 1 1 1 2 1 1 1\n"
        f"WIDTH {len(POINTS)}\nHEIGHT 1\nVIEWPOINT {viewpoint}\nPOINTS {len(POINTS)}\nDATA {form}\n"
    )
    data = np.hstack([POINTS, np.ones((len(POINTS), 2)), NORMALS])
    if form == "ascii":
        return (head + "\n".join(" ".join(map(repr, row)) for row in data.tolist())).encode()
    return head.encode() + data.astype("<f4").tobytes()


def written(folder: Path, name: str, content: bytes | FloatArray) -> Path:
    """A file with a content."""
    file = folder / name
    if isinstance(content, bytes):
        file.write_bytes(content)
    else:
        np.save(file, content)
    return file


@pytest.mark.parametrize(
    ("name", "content", "has_normals", "has_view"),
    [
        ("a.ply", ply("ascii", normals=True), True, True),
        ("b.ply", ply("binary_little_endian", normals=True), True, True),
        ("c.ply", ply("binary_big_endian", normals=False), False, True),
        ("d.pcd", pcd("ascii"), True, True),
        ("e.pcd", pcd("binary", viewpoint="0 0 0 1 0 0 0"), True, False),
        ("f.xyz", "\n".join(" ".join(map(str, r)) for r in POINTS).encode(), False, False),
        ("g.xyz", b"# x y z\n" + b"\n".join(
            " ".join(map(str, r)).encode() for r in np.hstack([POINTS, NORMALS])), True, False),
        ("h.npy", np.hstack([POINTS, NORMALS]), True, False),
        ("i.npy", POINTS.astype(np.float32), False, False),
    ],
)  # fmt: skip
def test_points_normals_and_views_come_out_of_every_format(
    tmp_path: Path, name: str, content: Any, has_normals: bool, has_view: bool
) -> None:
    file = written(tmp_path, name, content)
    assert is_cloud_file(str(file))
    cloud = read_cloud(file, table=None)
    assert np.allclose(cloud.points, POINTS, atol=1e-7)
    assert (cloud.normals is not None) == has_normals
    if cloud.normals is not None:
        assert np.allclose(cloud.normals, NORMALS, atol=1e-6)
    assert np.allclose(cloud.views, [[0.1, 0.2, 0.5]] if has_view else np.zeros((0, 3)))


def test_a_mesh_a_plan_and_a_name_are_no_clouds(tmp_path: Path) -> None:
    import trimesh

    trimesh.creation.box().export(tmp_path / "box.ply")
    written(tmp_path, "plan.json", json.dumps({"format": "opposable-plan", "views": 1}).encode())
    for spec in (tmp_path / "box.ply", tmp_path / "plan.json", tmp_path / "no.ply", "box", "a.stl"):
        assert not is_cloud_file(str(spec))
    for content in (None, b"{", b"[]"):  # missing, damaged, another's
        if content is not None:
            written(tmp_path, "frame.json", content)
        assert is_cloud_file(str(tmp_path / "frame.json"))
    with pytest.raises(ObjectError, match="mesh with 12 faces"):
        read_cloud(tmp_path / "box.ply")


LITTLE = ply("binary_little_endian", normals=False)
XYZ = b"0 0 0.1\n" * 100


def images(view: dict[str, Any] | None = None, **more: Any) -> bytes:
    """A file that lists one depth image, with other fields."""
    usual = {"depth": "a.png", "K": np.diag([9, 9, 1]).tolist(),
             "T_world_camera": np.eye(4).tolist()}  # fmt: skip
    return json.dumps({"views": [usual | (view or {})], **more}).encode()


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        ("no.ply", b"", "cut short"),
        ("no.ply", b"ply\nformat ascii 1.0\nelement vertex 5\n", "end_header"),
        ("no.ply", b"PLY?\nend_header\n", "does not begin as a PLY"),
        ("no.ply", LITTLE[:-5], "announces 200 points and has 199"),
        ("no.ply", ply("ascii", normals=False)[:-900], "cut short"),
        ("no.ply", ply("ascii", normals=False, count=10**12), "cut short"),
        ("no.ply", LITTLE.replace(b"property float x", b"property list uchar int x"), "is not und"),
        ("no.ply", LITTLE.replace(b"property float x", b"property float q"), "x, y, z are needed"),
        ("no.ply", LITTLE.replace(b"vertex", b"camera"), "does not begin with vertices"),
        ("no.ply", ply("ascii", normals=False, count=0), "is empty"),
        ("no.pcd", pcd("binary")[:-5], "cut short"),
        ("no.pcd", pcd("ascii").replace(b"SIZE 4", b"SIZE"), "garbles"),
        ("no.pcd", pcd("binary").replace(b"DATA binary", b"DATA binary_compressed"), "is not read"),
        ("no.pcd", pcd("ascii").replace(b"COUNT 1", b"COUNT 99999999"), "COUNT 99999999"),
        ("no.pcd", b"\x00" * 5000, "no line 'DATA'"),
        ("no.xyz", XYZ + b"0 0\n", "or is cut short"),
        ("no.xyz", XYZ + b"0 0 zero\n", "something else than numbers"),
        ("no.xyz", b"0,1 0,2 0,3\n" * 100, "a dot"),
        ("no.xyz", b"", "is empty"),
        ("no.xyz", b"nan nan nan\n" * 100, "0 are finite"),
        ("no.xyz", b"# nothing\n", "is empty"),
        ("no.npy", b"\x93NUMPY\x01", "no array of numbers"),
        ("no.npy", np.zeros((480, 640)), "of a depth image"),
        ("no.npy", np.zeros((100, 3), dtype=complex), "complex"),
        ("no.npy", np.full((100, 3), 1e3) + RNG.normal(size=(100, 3)) * 60, "millimetres"),
        ("no.json", b'{"views": []}', 'lists no "views"'),
        ("no.json", b'{"views": [1', "no JSON"),
        ("no.json", b'{"views": [{"depth": "a.png"}]}', "view 0 needs"),
        ("no.json", images(table="low"), "table is 'low'"),
        ("no.json", images(nois=0.001), "has .'nois'.; give some of"),
        ("no.json", images({"depth": 5}), "depth is 5; give the name of a file"),
        ("no.json", images({"mask": 5}), "mask is 5; give the name of a file"),
        ("no.json", images({"K": [[9, 0, 1], [0, 9, 1], [5, 5, 5]]}), "the last row"),
        ("no.json", images({"T_world_camera": np.diag([1, 1, -1, 1]).tolist()}), "is no pose"),
        ("no.json", images({"intrinsics": 1}), "has .'intrinsics'.; give some of"),
    ],
)  # fmt: skip
def test_what_is_broken_is_named(tmp_path: Path, name: str, content: Any, said: str) -> None:
    with pytest.raises(ObjectError, match=said):
        read_cloud(written(tmp_path, name, content))


def test_objects_in_an_array_are_never_unpickled(tmp_path: Path) -> None:
    np.save(tmp_path / "no.npy", np.array([{"a": 1}], dtype=object), allow_pickle=True)
    with pytest.raises(ObjectError, match="no array of numbers"):
        read_cloud(tmp_path / "no.npy")
    with pytest.raises(ObjectError, match="cannot read"):
        read_cloud(tmp_path / "missing.xyz")
    with pytest.raises(ObjectError, match="is no cloud"):
        read_cloud(tmp_path / "cloud.las")


def test_depth_images_with_intrinsics_give_the_points_of_the_scan(tmp_path: Path) -> None:
    found = scan(parse_object("box"), views=2, noise=0.0, seed=7)
    listed = []
    for k, (view, mask) in enumerate(zip(found.views, found.on_object, strict=True)):
        fx, fy, cx, cy = view.intrinsics
        grey = np.nan_to_num(1e4 * view.depth).round().astype(np.uint16)
        Image.fromarray(grey).save(tmp_path / f"d{k}.png")
        Image.fromarray((255 * mask).astype(np.uint8)).save(tmp_path / f"m{k}.png")
        listed.append(
            {
                **{"depth": f"d{k}.png", "mask": f"m{k}.png", "scale": 1e-4},
                "K": [[fx, 0, cx], [0, fy, cy], [0, 0, 1]],
                "T_world_camera": view.T_world_camera.tolist(),
            }
        )
    file = written(tmp_path, "frame.json", json.dumps({"views": listed, "noise": 0.001}).encode())
    assert is_cloud_file(str(file))
    cloud = read_cloud(file, table=None)
    masked = [
        DepthView(**{**vars(v), "mask": m})
        for v, m in zip(found.views, found.on_object, strict=True)
    ]
    exact = cloud_of_views(masked, table=None)
    assert len(cloud) == len(exact) == sum(int(m.sum()) for m in found.on_object)
    assert np.abs(cloud.points - exact.points).max() < 1e-4
    assert np.allclose(cloud.past, exact.past, atol=1e-4)
    assert len(cloud.past) > 1000
    assert cloud.noise == 0.001
    surface = parse_object("box").shape.signed_distance(cloud.points - [0.0, 0.0, 0.04])
    assert np.abs(surface).max() < 1e-4

    for broken, said in (
        ({"T_world_camera": np.diag([1.0, 1.0, 2.0, 1.0]).tolist()}, "not orthogonal"),
        ({"K": [[0, 0, 0], [0, 1, 0], [0, 0, 1]]}, "focal lengths"),
        ({"K": "camera"}, r"give \(3, 3\)"),
        ({"depth": "none.png"}, "cannot read the image"),
        ({"mask": "frame.json"}, "cannot read the image"),
        ({"scale": -1}, "scale"),
    ):
        data = {"views": [{**listed[0], **broken}]}
        written(tmp_path, "bad.json", json.dumps(data).encode())
        with pytest.raises(ObjectError, match=said):
            read_cloud(tmp_path / "bad.json")


def test_half_a_million_points_are_read(tmp_path: Path) -> None:
    many = RNG.normal(size=(500_000, 3)).astype(np.float32) * np.float32(0.02)
    np.save(tmp_path / "many.npy", many)
    assert len(read_cloud(tmp_path / "many.npy", table=None)) == 500_000


def test_a_table_given_by_its_height_is_where_the_cloud_is_brought(tmp_path: Path) -> None:
    write_scan(scan(parse_object("box"), seed=8), tmp_path / "cloud.ply")
    assert read_cloud(tmp_path / "cloud.ply").table == pytest.approx(0.0, abs=5e-4)
    moved = read_cloud(tmp_path / "cloud.ply", table=0.01)
    assert moved.table == pytest.approx(0.01)
    low = np.percentile(moved.points[:, 2], 30)
    assert low == pytest.approx(0.01, abs=1e-3)


def test_a_pcd_file_says_where_its_camera_was(tmp_path: Path) -> None:
    points = np.random.default_rng(0).uniform(-0.03, 0.03, (100, 3))
    body = "\n".join(" ".join(f"{v:.6f}" for v in row) for row in points)
    head = "VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 100\nHEIGHT 1\n"
    (tmp_path / "a.pcd").write_text(
        f"{head}VIEWPOINT 0.3 -0.1 0.4 1 0 0 0\nPOINTS 100\nDATA ascii\n{body}\n"
    )
    cloud = read_cloud(tmp_path / "a.pcd", table=None)
    np.testing.assert_allclose(cloud.views, [[0.3, -0.1, 0.4]])


def test_rays_beside_a_mask_went_past_the_object() -> None:
    mask = np.zeros((20, 20), dtype=bool)
    mask[5:15, 5:15] = True
    depth = np.where(mask, 0.4, 0.6)
    view = DepthView(
        depth=depth, intrinsics=(50.0, 50.0, 9.5, 9.5), T_world_camera=np.eye(4), mask=mask
    )
    cloud = cloud_of_views([view], table=None, noise=0.001)
    assert len(cloud.points) == mask.sum() and np.allclose(cloud.points[:, 2], 0.4)
    assert len(cloud.past) == (~mask).sum() and np.allclose(cloud.past[:, 2], 0.6)
