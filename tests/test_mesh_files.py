"""Mesh files: formats, scale, seams, and what a plan stores of them."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import trimesh
from conftest import of_trimesh

from planner.errors import ObjectError
from planner.objects import parse_object
from planner.shapes import Mesh, Torus, shape_from_dict, shape_to_dict
from planner.shapes.meshes.io import read_mesh
from planner.system.disk_cache import CACHE_VARIABLE


@pytest.fixture(autouse=True)
def own_cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(CACHE_VARIABLE, str(tmp_path_factory.mktemp("cache")))
        yield


def saved(mesh: Mesh, path: Path, scale: float = 1.0) -> Path:
    trimesh.Trimesh(mesh.vertices * scale, mesh.faces, process=False).export(path)
    return path


@pytest.mark.parametrize("name", ["ring.stl", "ring.OBJ", "my ring.ply", "a.b*c.stl"])
def test_a_file_reads_back_the_same_solid(tmp_path: Path, name: str) -> None:
    torus = Torus()
    item = parse_object(str(saved(torus, tmp_path / name)))
    mesh = item.shape
    assert isinstance(mesh, Mesh)
    assert item.name == Path(name).stem
    assert len(mesh.faces) == len(torus.faces) and len(mesh.vertices) == len(torus.vertices)
    assert mesh.volume == pytest.approx(torus.volume, rel=1e-5)
    assert parse_object(mesh.spec).shape == mesh


def test_a_file_that_is_known_is_not_read_again_and_a_changed_one_is(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = saved(Torus(), tmp_path / "ring.ply")
    first = read_mesh(path, 1.0)
    with monkeypatch.context() as patch:
        patch.setattr("planner.shapes.meshes.io._read", None)  # not called
        for a, b in zip(read_mesh(path, 1.0), first, strict=True):
            np.testing.assert_array_equal(a, b)
            assert a.dtype == b.dtype
    vertices, _ = read_mesh(saved(Torus(), path, scale=2.0), 1.0)
    np.testing.assert_array_equal(vertices, 2.0 * first[0])
    monkeypatch.setattr(
        "planner.shapes.meshes.io.read_arrays",
        lambda kind, key: {"vertices": first[0], "faces": first[1] + len(first[0])},
    )
    np.testing.assert_array_equal(read_mesh(path, 1.0)[0], vertices)  # not of these vertices


def test_millimetres_with_a_scale(tmp_path: Path) -> None:
    path = saved(Torus(), tmp_path / "Ring.stl", scale=1000.0)
    mesh = parse_object(f"{path}*0.001").shape
    assert mesh.volume == pytest.approx(Torus().volume, rel=1e-5)
    assert mesh.spec == f"{path}*0.001"
    assert parse_object(mesh.spec).shape == mesh
    with pytest.raises(ObjectError, match=r"is 100 m long.*in millimetres, give scale 0\.001"):
        parse_object(str(path))


def test_a_glb_file_is_read_with_everything_where_the_file_places_it(tmp_path: Path) -> None:
    scene = trimesh.Scene()
    for x in (0.0, 0.2):
        placed = np.eye(4)
        placed[0, 3] = x
        scene.add_geometry(trimesh.creation.box((0.05, 0.06, 0.08)), transform=placed)
    scene.export(tmp_path / "pair.glb")
    mesh = parse_object(str(tmp_path / "pair.glb")).shape
    assert isinstance(mesh, Mesh)
    assert mesh.volume == pytest.approx(2 * 0.05 * 0.06 * 0.08)
    np.testing.assert_allclose(np.ptp(mesh.vertices, axis=0), [0.25, 0.06, 0.08], atol=1e-7)


def test_the_remedy_for_other_formats_works(tmp_path: Path) -> None:
    """The command of the message is run as it is told."""
    trimesh.creation.box((0.05, 0.06, 0.08)).export(tmp_path / "crate.off")
    with pytest.raises(ObjectError) as told:
        Mesh.load(tmp_path / "crate.off")
    code = re.search(r'python -c "(.*)"', str(told.value))
    assert code is not None
    subprocess.run([sys.executable, "-c", code[1]], check=True, timeout=600)
    assert Mesh.load(tmp_path / "crate.ply").volume == pytest.approx(0.05 * 0.06 * 0.08)


def test_seams_of_an_obj_are_merged(tmp_path: Path) -> None:
    # as exporters write it: each face with its own normal, so that no vertex is shared
    box, lines = trimesh.creation.box((0.05, 0.05, 0.05)), []
    for corners, normal in zip(box.triangles, box.face_normals, strict=True):
        lines += [f"v {x:.6f} {y:.6f} {z:.6f}" for x, y, z in corners]
        lines.append("vn {:.3f} {:.3f} {:.3f}".format(*normal))
    lines += [
        f"f {3 * i + 1}//{i + 1} {3 * i + 2}//{i + 1} {3 * i + 3}//{i + 1}" for i in range(12)
    ]
    (tmp_path / "seams.obj").write_text("\n".join(lines))
    mesh = Mesh.load(tmp_path / "seams.obj")
    assert (len(mesh.vertices), len(mesh.faces)) == (8, 12)


def test_plain_data_of_a_file_reads_back(tmp_path: Path) -> None:
    mesh = Mesh.load(saved(Torus(), tmp_path / "ring.ply", 1000.0), scale=0.001)
    data = json.loads(json.dumps(shape_to_dict(mesh)))
    assert set(data) == {"kind", "path", "scale", "repair", "sha256"}
    assert shape_from_dict(data) == mesh


def test_a_file_that_was_changed_is_told(tmp_path: Path) -> None:
    path = saved(Torus(), tmp_path / "ring.ply")
    data = shape_to_dict(Mesh.load(path))
    saved(Torus(0.04, 0.015), path)
    with pytest.raises(ObjectError, match="was changed since; plan again"):
        shape_from_dict(data)
    path.unlink()
    with pytest.raises(ObjectError, match="there is no mesh file"):
        shape_from_dict(data)


def test_plain_data_without_a_file_holds_the_triangles() -> None:
    box = trimesh.creation.box((0.05, 0.06, 0.1))
    mesh = of_trimesh(box)
    data = json.loads(json.dumps(shape_to_dict(mesh)))
    assert set(data) == {"kind", "vertices_m", "faces"}
    again = shape_from_dict(data)
    assert isinstance(again, Mesh)
    np.testing.assert_allclose(again.vertices, mesh.vertices, rtol=0, atol=1e-15)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"path": 3}, "a mesh has path 3"),
        ({"scale": "1"}, "scale '1'; give text and a number"),
        ({"repair": True}, 'a mesh has repair True; give "yes" or "no"'),
        ({"extra": 1}, "it needs"),
    ],
)
def test_faulty_plain_data_is_refused(
    tmp_path: Path, change: dict[str, object], message: str
) -> None:
    data = shape_to_dict(Mesh.load(saved(Torus(), tmp_path / "ring.ply")))
    with pytest.raises(ObjectError, match=message):
        shape_from_dict(data | change)
    with pytest.raises(ObjectError, match="not lists of numbers"):
        shape_from_dict({"kind": "mesh", "vertices_m": "abc", "faces": [0.0, 1.0, 2.0]})
