"""A corpus of bad meshes and objects: each ends in a named error or a correct result."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
import trimesh

from planner.errors import NotFoundError, ObjectError, PlannerError
from planner.objects import parse_object
from planner.shapes import Mesh
from planner.shapes.meshes import soundness
from planner.system.disk_cache import CACHE_VARIABLE

Make = Callable[[Path], Path]


@pytest.fixture(autouse=True)
def own_cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(CACHE_VARIABLE, str(tmp_path_factory.mktemp("cache")))
        yield


def box(size: float = 0.05, at: tuple[float, float, float] = (0, 0, 0)) -> trimesh.Trimesh:
    mesh = trimesh.creation.box((size, size, size))
    mesh.apply_translation(at)
    return mesh


def ball() -> trimesh.Trimesh:
    return trimesh.creation.icosphere(3, 0.03)


def turned(mesh: trimesh.Trimesh, faces: list[int]) -> trimesh.Trimesh:
    index = np.array(mesh.faces)
    index[faces] = index[faces][:, ::-1]
    return trimesh.Trimesh(mesh.vertices, index, process=False)


def without(mesh: trimesh.Trimesh, faces: list[int]) -> trimesh.Trimesh:
    keep = np.ones(len(mesh.faces), dtype=bool)
    keep[faces] = False
    return trimesh.Trimesh(mesh.vertices, np.array(mesh.faces)[keep], process=False)


def together(*meshes: trimesh.Trimesh) -> trimesh.Trimesh:
    return trimesh.util.concatenate(list(meshes))


def inverted(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    mesh.invert()
    return mesh


def bow_tie() -> trimesh.Trimesh:
    """A prism whose outline crosses itself."""
    outline = np.array([[0, 0], [0.05, 0.05], [0.05, 0], [0, 0.04]])
    low = np.column_stack([outline, np.zeros(4)])
    points = np.concatenate([low, low + np.array([0, 0, 0.03])])
    sides = [[i, (i + 1) % 4, (i + 1) % 4 + 4] for i in range(4)]
    sides += [[i, (i + 1) % 4 + 4, i + 4] for i in range(4)]
    ends = [[2, 1, 0], [3, 2, 0], [4, 5, 6], [4, 6, 7]]
    return trimesh.Trimesh(points, np.array(sides + ends), process=False)


def fin() -> trimesh.Trimesh:
    """A box with one more triangle on an edge."""
    mesh = box()
    points = np.concatenate([mesh.vertices, [[0.1, 0.1, 0.1]]])
    extra = [*mesh.faces[0][:2], len(points) - 1]
    return trimesh.Trimesh(points, np.concatenate([mesh.faces, [extra]]), process=False)


def collapsed() -> trimesh.Trimesh:
    """A closed surface that goes out and comes back on itself."""
    points = np.array([[0, 0, 0], [0.05, 0, 0], [0.05, 0.05, 0], [0, 0.05, 0]])
    faces = np.array([[0, 1, 2], [0, 2, 3], [0, 2, 1], [0, 3, 2]])
    return trimesh.Trimesh(points, faces, process=False)


def exported(mesh: Callable[[], trimesh.Trimesh], name: str = "thing.ply") -> Make:
    def make(folder: Path) -> Path:
        mesh().export(folder / name)
        return folder / name

    return make


def written(content: bytes | str, name: str) -> Make:
    def make(folder: Path) -> Path:
        data = content.encode() if isinstance(content, str) else content
        (folder / name).write_bytes(data)
        return folder / name

    return make


def stl_of(count: int, holds: int) -> bytes:
    """A binary STL that promises ``count`` triangles and holds some."""
    return b"\0" * 80 + struct.pack("<I", count) + b"\0" * 50 * holds


FEW = 10_000
"""Triangles at most in these tests: the million of the package takes seconds to be written and
read."""


@pytest.fixture
def few(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(soundness, "MOST_TRIANGLES", FEW)


def crowd() -> trimesh.Trimesh:
    points = np.random.default_rng(0).random((3 * (FEW + 1), 3))
    return trimesh.Trimesh(points, np.arange(len(points)).reshape(-1, 3), process=False)


def cut_short(folder: Path) -> Path:
    path = exported(ball, "cut.stl")(folder)
    path.write_bytes(path.read_bytes()[:-5000])
    return path


OBJ_BOX_OPEN = "v 0 0 0\nv 0.05 0 0\nv 0 0.05 0\nf 1 2 3\n"
OBJ_NAN = "v 0 0 0\nv nan 0 0\nv 0 0.05 0\nv 0 0 0.05\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n"
OBJ_INDEX = "v 0 0 0\nv 0.05 0 0\nv 0 0.05 0\nf 1 2 9\n"

BAD: dict[str, tuple[Make, str]] = {
    "one triangle missing": (
        exported(lambda: without(ball(), [5])),
        r"is not closed: 3 open edge\(s\), the first at .*not mended, since --strict",
    ),
    "half of it missing": (
        exported(lambda: without(ball(), list(range(640)))),
        r"is not closed: \d+ open edge",
    ),
    "one triangle wound wrongly": (
        exported(lambda: turned(ball(), [7])),
        r"wound in opposite senses at 3 edge\(s\), the first at",
    ),
    "inside out": (exported(lambda: inverted(ball())), r"inside out \(normals point inwards\) at"),
    "one of two bodies inside out": (
        exported(lambda: together(box(), inverted(box(at=(0.1, 0, 0))))),
        "inside out",
    ),
    "overlapping bodies": (
        exported(lambda: together(box(), box(at=(0.02, 0.013, 0.011)))),
        r"passes through itself: \d+ pair\(s\) of triangles cross, the first near",
    ),
    "overlapping bodies with faces in one plane": (
        exported(lambda: together(box(), box(at=(0.03, 0, 0)))),
        "several bodies overlap",
    ),
    "a body in a body": (
        exported(lambda: together(box(), box(0.02))),
        "several bodies overlap, or one lies inside another, at",
    ),
    "a body on a body": (
        exported(lambda: together(box(), box(0.02, (0, 0, 0.035)))),
        "several bodies overlap",
    ),
    "bodies that share an edge": (
        exported(lambda: together(box(), box(at=(0.05, 0.05, 0)))),
        r"more than two triangles \(non-manifold\)",
    ),
    "bodies that share a face": (
        exported(lambda: together(box(), box(at=(0.05, 0, 0)))),
        "non-manifold",
    ),
    "an outline that crosses itself": (exported(bow_tie), "passes through itself|inside out"),
    "a fin": (exported(fin), r"not closed: 2 open edge.*non-manifold"),
    "no thickness": (exported(collapsed), "it is flat|non-manifold"),
    "flat": (
        exported(lambda: trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])),
        "not closed: 3 open",
    ),
    "in millimetres": (
        exported(lambda: box(60.0)),
        r"is 60 m long, more than 2 m; sizes are in metres: .* scale 0\.001 \([^ ]+\.\w+\*0",
    ),
    "a tenth of a millimetre": (
        exported(lambda: box(1e-4)),
        r"is 0\.1 mm long, less than 1 mm; .*give a larger scale",
    ),
    "too many triangles": (
        exported(crowd, "crowd.stl"),
        r"has 10001 triangles, more than 10000; simplify it first",
    ),
    "no triangles": (written(stl_of(0, 0), "empty.stl"), "holds no triangles|cannot be read"),
    "cut short": (
        cut_short,
        r"^cut\.stl cannot be read as \.stl.*export it again",
    ),
    "triangles of one point": (written(stl_of(9, 9), "zeros.stl"), "holds no triangles"),
    "an empty file": (written("", "empty.obj"), "holds no triangles|cannot be read"),
    "an empty ply": (written("", "empty.ply"), r"cannot be read as \.ply"),
    "text that is no mesh": (written("hello", "hello.stl"), "cannot be read|holds no triangles"),
    "a picture": (written(b"\x89PNG\r\n\x1a\n" + b"\0" * 99, "p.ply"), r"cannot be read as \.ply"),
    "an open obj": (written(OBJ_BOX_OPEN, "open.obj"), "is not closed: 3 open"),
    "a vertex that is not a number": (written(OBJ_NAN, "nan.obj"), "NaN or infinite"),
    "vertices in a plane": (
        written("v 0 0\nv 1 0\nv 0 1\nv 1 1\nf 1 2 3\nf 2 4 3\n", "plane.obj"),
        r"vertices of another number of coordinates than 3 \(shape \(4, 2\)\)",
    ),
    "a vertex that is not there": (written(OBJ_INDEX, "index.obj"), "cannot be read"),
    "points only": (
        exported(lambda: trimesh.PointCloud(np.eye(3)), "points.ply"),
        "holds no triangles|cannot be read",
    ),
    "a missing file": (lambda folder: folder / "none.stl", r"there is no mesh file .*none\.stl"),
    "a folder": (
        lambda folder: [(folder / "dir.stl").mkdir(), folder / "dir.stl"][1],  # type: ignore
        "there is no mesh file",
    ),
}


@pytest.mark.usefixtures("few")
@pytest.mark.parametrize("name", BAD)
def test_strict_answers_a_bad_file_by_name(tmp_path: Path, name: str) -> None:
    make, message = BAD[name]
    path = make(tmp_path)
    with pytest.raises(ObjectError, match=message) as caught:
        parse_object(str(path), strict=True)
    assert path.name in str(caught.value)


@pytest.mark.usefixtures("few")
@pytest.mark.parametrize("name", BAD)
def test_a_bad_file_is_mended_or_refused_by_name(tmp_path: Path, name: str) -> None:
    path = BAD[name][0](tmp_path)
    try:
        mesh = Mesh.load(path)
    except ObjectError as error:
        assert path.name in str(error)
        assert name not in MENDED
        return
    assert name in MENDED, f"{mesh.mended}, {mesh.volume} m3"
    assert mesh.volume == pytest.approx(MENDED[name], rel=0.005)
    assert "surface moved by" in mesh.mended
    # a sound surface now: every side of every sampled face is told rightly
    points, normals = mesh.surface_samples(20, np.random.default_rng(0))
    np.testing.assert_allclose(mesh.winding_number(points + 1e-5 * normals), 0, atol=1e-6)
    np.testing.assert_allclose(mesh.winding_number(points - 1e-5 * normals), 1, atol=1e-6)


BALL = float(trimesh.creation.icosphere(3, 0.03).volume)
BOX = 0.05**3
MENDED = {
    "one triangle missing": BALL,
    "one triangle wound wrongly": BALL,
    "inside out": BALL,
    "one of two bodies inside out": 2 * BOX,
    "overlapping bodies": 2 * BOX - 0.03 * 0.037 * 0.039,
    "overlapping bodies with faces in one plane": 2 * BOX - 0.02 * 0.05 * 0.05,
    "a body in a body": BOX,
    "a body on a body": BOX + 0.02**3,
    "bodies that share an edge": 2 * BOX,
    "bodies that share a face": 2 * BOX,
}
"""What is mended unasked, and its volume (m3)."""


GOOD: dict[str, tuple[Make, float]] = {
    "a name with spaces": (exported(box, "my old box.stl"), 0.05**3),
    "a suffix in capitals": (exported(box, "BOX.STL"), 0.05**3),
    "letters of another alphabet": (exported(box, "чашка.obj"), 0.05**3),
    "two bodies apart": (exported(lambda: together(box(), box(at=(0.1, 0, 0)))), 2 * 0.05**3),
    "a cavity": (
        exported(lambda: together(box(), inverted(box(0.02)))),
        0.05**3 - 0.02**3,
    ),
    "far from the origin": (exported(lambda: box(at=(1.5, -3.0, 20.0))), 0.05**3),
    "triangles without area": (
        written(
            "v 0 0 0\nv 0.05 0 0\nv 0 0.05 0\nv 0 0 0.05\nv 0.02 0 0\n"
            # the edge from 1 to 2 is split on one side; 1 5 2 has no area and closes the gap
            "f 1 3 5\nf 5 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\nf 1 5 2\n",
            "needle.obj",
        ),
        0.05**3 / 6,
    ),
    "faces of four corners": (
        written(
            "v 0 0 0\nv 0 0 .04\nv 0 .04 0\nv 0 .04 .04\nv .04 0 0\nv .04 0 .04\nv .04 .04 0\n"
            "v .04 .04 .04\nf 1 2 4 3\nf 5 7 8 6\nf 1 5 6 2\nf 3 4 8 7\nf 1 3 7 5\nf 2 6 8 4\n",
            "quads.obj",
        ),
        0.04**3,
    ),
}


@pytest.mark.parametrize("name", GOOD)
def test_what_only_looks_bad_is_read_rightly(tmp_path: Path, name: str) -> None:
    make, volume = GOOD[name]
    mesh = parse_object(str(make(tmp_path))).shape
    assert isinstance(mesh, Mesh)
    assert mesh.volume == pytest.approx(volume, rel=1e-4)
    points, normals = mesh.surface_samples(10, np.random.default_rng(0))
    below = mesh.signed_distance(points - 1e-4 * normals)
    assert (below < -5e-5).all() and (below > -1.001e-4).all()


def test_a_hole_that_is_the_shape_itself_is_not_closed(tmp_path: Path) -> None:
    path = BAD["half of it missing"][0](tmp_path)
    for repair in (False, True):
        with pytest.raises(ObjectError, match=r"not closed: .*Mending was tried .* not closed"):
            Mesh.load(path, repair=repair)


@pytest.mark.parametrize("options", [{}, {"repair": True}, {"strict": True}])
def test_a_sound_file_is_left_as_it_is(tmp_path: Path, options: dict[str, bool]) -> None:
    mesh = Mesh.load(exported(ball)(tmp_path), **options)
    assert mesh.mended == "" and len(mesh.faces) == len(ball().faces)
    assert mesh.volume == pytest.approx(BALL)


@pytest.mark.parametrize(
    ("spec", "error", "message"),
    [
        ("thing.stl*0", ObjectError, "scale is 0.0; give metres per unit"),
        ("thing.stl*-1", ObjectError, "scale is -1.0"),
        ("thing.stl*nan", ObjectError, "scale is nan"),
        ("thing.stl*", ObjectError, r"scale '' is not a number; .*\*0\.001 for millimetres"),
        ("thing.stl*mm", ObjectError, "scale 'mm' is not a number"),
        ("thing.dae", ObjectError, r"pip install pycollada\): python -c .*export\('thing.ply'\)"),
        ("thing.off*0.001", ObjectError, r"load_mesh\('thing.off'\).export\('thing.ply'\)"),
        ("thing.fbx", NotFoundError, "A mesh is the path of a GLB, OBJ, PLY or STL file"),
        ("thing.step", NotFoundError, "no object is called 'thing.step'"),
        ("thing", NotFoundError, "no object is called 'thing'"),
    ],
)
def test_bad_specifications(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    spec: str,
    error: type[PlannerError],
    message: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    exported(box, "thing.stl")(tmp_path)
    with pytest.raises(error, match=message):
        parse_object(spec)


@pytest.mark.parametrize(
    ("vertices", "faces", "message"),
    [
        (np.zeros((4, 2)), [[0, 1, 2]], r"vertices have shape \(4, 2\)"),
        (np.full((3, 3), np.inf), [[0, 1, 2]], r"give finite \(n, 3\)"),
        (np.eye(3), np.zeros((0, 3), dtype=int), "faces are .* of shape"),
        (np.eye(3), [[0.0, 1.0, 2.0]], "faces are float64"),
        (np.eye(3), [[0, 1, 3]], "faces name vertex 0 to 3, but there are 0 to 2"),
        (np.eye(3), [[0, 1, -1]], "faces name vertex -1 to 1"),
    ],
)
def test_bad_arrays(vertices: object, faces: object, message: str) -> None:
    with pytest.raises(ObjectError, match=message):
        Mesh.from_triangles(np.array(vertices), np.array(faces))


def test_the_few_that_are_wrong_are_turned_not_all_others(tmp_path: Path) -> None:
    path = exported(lambda: turned(ball(), [0]))(tmp_path)
    assert Mesh.load(path).mended.startswith("1 triangle(s) turned to agree with their neighbours;")


def test_the_corpus_is_large() -> None:
    assert len(BAD) + len(GOOD) >= 35
