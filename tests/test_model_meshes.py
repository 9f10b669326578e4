"""What load_spec mends: meshes elsewhere, in other formats or in parts; links without inertia."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest
import trimesh

from planner.bridge import compile_spec, link_surfaces, load_spec, prepare_spec
from planner.bridge.load import HIDDEN_GROUP, model_files, named_files
from planner.bridge.numbers import (
    LEAST_INERTIA,
    LEAST_MASS,
    impossible_inertias,
    with_least_inertias,
)
from planner.bridge.pinocchio_model import pinocchio_from_mujoco
from planner.bridge.structure import read_spec
from planner.errors import ModelError, NotFoundError
from planner.joints.description import HandDescription, RepairDescription
from planner.shapes import Mesh
from planner.shapes.meshes.io import converted_mesh
from planner.system.disk_cache import CACHE_VARIABLE

SIZE = (0.06, 0.02, 0.04)

URDF = """<robot name="one">{head}<link name="palm"><collision><geometry>
<mesh filename="{mesh}" scale="1 1 1"/></geometry></collision></link></robot>"""

MJCF = """<mujoco><include file="assets.xml"/><worldbody><body name="palm">
<geom type="mesh" mesh="palm"/></body></worldbody></mujoco>"""


@pytest.fixture(autouse=True)
def own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(CACHE_VARIABLE, str(tmp_path / "cache"))


def box(path: Path) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    trimesh.creation.box(SIZE).export(path)
    return path


def urdf(path: Path, mesh: str, head: str = "") -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(URDF.format(mesh=mesh, head=head), encoding="utf-8")
    return path


def extents(model_file: Path) -> list[float]:
    """Extents of the only mesh, m, sorted: MuJoCo turns a mesh into its principal axes."""
    model = compile_spec(load_spec(model_file), "the model")
    assert model.nmesh == 1
    return sorted(float(v) for v in np.ptp(model.mesh_vert, axis=0))


@pytest.mark.parametrize(
    ("where", "named", "head"),
    [
        ("clone/meshes/palm.stl", "package://one_description/meshes/palm.stl", ""),
        ("clone/meshes/palm.stl", "package:///one_description/meshes/palm.stl", ""),
        ("clone/one/meshes/palm.stl", "package:///one//meshes/palm.stl", ""),
        ("clone/meshes/palm.stl", "package://data/robots/clone/meshes/palm.stl", ""),
        ("clone/meshes/palm.stl", "meshes/palm.stl", ""),  # from the folder above
        ("clone/urdf/palm.stl", "/home/someone/meshes/palm.stl", ""),
        (
            "clone/urdf/meshes/palm.stl",
            "meshes/palm.stl",
            '<mujoco><compiler meshdir="meshes"/></mujoco>',
        ),
    ],
    ids=[
        "a clone of another name",
        "three slashes",
        "three slashes, then two",
        "a part of the package",
        "from the root",
        "beside the model",
        "mesh folder named twice",
    ],
)
def test_a_mesh_is_found_where_it_lies(tmp_path: Path, where: str, named: str, head: str) -> None:
    mesh = box(tmp_path / where)
    model = urdf(tmp_path / "clone" / "urdf" / "one.urdf", named, head)
    np.testing.assert_allclose(extents(model), sorted(SIZE), rtol=1e-6)
    assert mesh.resolve() in {file.resolve() for file in model_files(model)}


def test_a_path_that_leads_somewhere_is_kept(tmp_path: Path) -> None:
    box(tmp_path / "palm.stl")  # one of this name beside the model is another mesh
    trimesh.creation.box((0.1, 0.1, 0.1)).export(tmp_path / "palm_big.stl")
    (tmp_path / "meshes").mkdir()
    (tmp_path / "palm_big.stl").rename(tmp_path / "meshes" / "palm.stl")
    np.testing.assert_allclose(
        extents(urdf(tmp_path / "one.urdf", "meshes/palm.stl")), 0.1, rtol=1e-6
    )


def test_a_mesh_that_is_nowhere_is_named(tmp_path: Path) -> None:
    with pytest.raises(ModelError, match=r"opening file 'meshes/palm\.stl'; put the missing file"):
        compile_spec(load_spec(urdf(tmp_path / "one.urdf", "meshes/palm.stl")), "it")
    for slashes in ("//", "///"):
        model = urdf(tmp_path / "one.urdf", f"package:{slashes}one/meshes/palm.stl")
        with pytest.raises(ModelError, match=r"folders above it is or holds 'one'") as told:
            load_spec(model)
        assert f"copy the package's folder into {tmp_path.resolve()}, from" in str(told.value)


def test_a_clone_without_its_large_files(tmp_path: Path) -> None:
    (tmp_path / "palm.stl").write_text("version https://git-lfs.github.com/spec/v1\noid sha256:0\n")
    with pytest.raises(ModelError, match=r"palm\.stl, which is only a pointer.*run git lfs pull"):
        load_spec(urdf(tmp_path / "one.urdf", "palm.stl"))


@pytest.mark.parametrize("suffix", [".glb", ".ply", ".off", ".GLB"])
def test_formats_that_mujoco_does_not_read_are_converted(tmp_path: Path, suffix: str) -> None:
    mesh = box(tmp_path / f"palm{suffix}")
    model = urdf(tmp_path / "one.urdf", mesh.name)
    np.testing.assert_allclose(extents(model), sorted(SIZE), rtol=1e-6)
    assert mesh in model_files(model)  # so that a changed mesh is another hand


def test_a_scale_holds_for_a_converted_mesh_too(tmp_path: Path) -> None:
    box(tmp_path / "palm.glb")
    model = urdf(tmp_path / "one.urdf", "palm.glb")
    model.write_text(model.read_text().replace("1 1 1", "2 2 2"))
    np.testing.assert_allclose(extents(model), 2 * np.sort(SIZE), rtol=1e-6)


def test_a_collada_file_is_read_in_its_unit(tmp_path: Path) -> None:
    pytest.importorskip("collada")
    mesh = box(tmp_path / "palm.dae")
    text = mesh.read_text()
    np.testing.assert_allclose(
        extents(urdf(tmp_path / "one.urdf", mesh.name)), sorted(SIZE), rtol=1e-6
    )
    asset = '<asset><unit name="centimeter" meter="0.01"/><up_axis>Y_UP</up_axis></asset>'
    start, end = text.index("<asset>"), text.index("</asset>") + len("</asset>")
    mesh.write_text(text[:start] + asset + text[end:])
    np.testing.assert_allclose(np.ptp(converted_mesh(mesh)[0], axis=0), 0.01 * np.array(SIZE))


def test_a_conversion_is_done_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    mesh = box(tmp_path / "palm.glb")
    vertices, faces = converted_mesh(mesh)
    monkeypatch.setattr(trimesh, "load_mesh", lambda *_, **__: pytest.fail("read again"))
    again = converted_mesh(mesh)
    np.testing.assert_array_equal(again[0], vertices)
    np.testing.assert_array_equal(again[1], faces)


def test_files_of_meshes_and_height_fields_belong_to_a_model(tmp_path: Path) -> None:
    """What is kept of a model holds as long as these are the same; one is missing."""
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts" / "tip.stl").write_bytes(b"")
    path = tmp_path / "hand.xml"
    path.write_text(
        '<mujoco><compiler meshdir="parts"/><asset><mesh name="tip" file="tip.stl"/>'
        '<hfield name="skin" file="skin.png" size="1 1 1 1"/></asset>'
        '<worldbody><body name="palm"><geom size="0.1"/></body></worldbody></mujoco>'
    )
    parts = tmp_path / "parts"
    assert named_files(path) == (path, parts / "skin.png", parts / "tip.stl")
    assert model_files(path) == (path, parts / "tip.stl")


def test_a_mesh_that_cannot_be_converted_is_named(tmp_path: Path) -> None:
    (tmp_path / "palm.glb").write_bytes(b"glTF, or not")
    with pytest.raises(ModelError, match=r"palm\.glb cannot be read as \.glb .*export it again"):
        load_spec(urdf(tmp_path / "one.urdf", "palm.glb"))


def test_the_suffix_mjcf_with_an_included_file(tmp_path: Path) -> None:
    box(tmp_path / "palm.stl")
    (tmp_path / "assets.xml").write_text(
        '<mujoco><asset><mesh name="palm" file="palm.stl"/></asset></mujoco>'
    )
    model = tmp_path / "one.mjcf"
    model.write_text(MJCF, encoding="utf-8")
    np.testing.assert_allclose(extents(model), sorted(SIZE), rtol=1e-6)
    assert {file.name for file in model_files(model)} == {"one.mjcf", "assets.xml", "palm.stl"}


def test_a_file_of_another_version_of_mujoco(tmp_path: Path) -> None:
    (tmp_path / "old.xml").write_text('<mujoco><option apirate="200"/></mujoco>')
    with pytest.raises(ModelError, match=r"apirate.*may be of another version"):
        load_spec(tmp_path / "old.xml")


# --- an OBJ file with several objects -------------------------------------------------------------

CORNERS = "v {0} 0 0\nv {1} 0 0\nv {0} 0.2 0\nv {0} 0 0.3\n"
FACES = "f {0} {2} {1}\nf {0} {1} {3}\nf {0} {3} {2}\nf {1} {2} {3}\n"


@pytest.mark.parametrize("head", ["o {}", "g {}", "  o {}"])
@pytest.mark.parametrize("kind", ["urdf", "mjcf", "spec"])
def test_all_objects_of_an_obj_file_are_drawn_and_weighed(
    tmp_path: Path, head: str, kind: str
) -> None:
    (tmp_path / "palm.obj").write_text(
        f"{head.format('a')}\n{CORNERS.format(0, 0.1)}{FACES.format(1, 2, 3, 4)}"
        f"{head.format('b')}\n{CORNERS.format(1, 1.1)}{FACES.format(5, 6, 7, 8)}"
    )
    text = (
        f'<mujoco><compiler meshdir="{tmp_path}"/><asset><mesh name="palm" file="palm.obj" '
        'inertia="exact"/></asset><worldbody><body name="palm"><geom name="g" type="mesh" '
        'mesh="palm" density="1000"/></body></worldbody></mujoco>'
    )
    if kind == "spec":
        spec = read_spec(mujoco.MjSpec.from_string(text))
    elif kind == "mjcf":
        (tmp_path / "one.xml").write_text(text)
        spec = load_spec(tmp_path / "one.xml")
    else:
        spec = load_spec(urdf(tmp_path / "one.urdf", "palm.obj"))
        spec.meshes[0].inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_EXACT
    model = compile_spec(spec, "it")
    (surface,) = link_surfaces(model, pinocchio_from_mujoco(model))
    assert len(surface.triangles) == 8
    drawn = surface.vertices[surface.triangles].reshape(-1, 3)
    np.testing.assert_allclose(drawn.min(axis=0), [0, 0, 0], atol=1e-6)
    np.testing.assert_allclose(drawn.max(axis=0), [1.1, 0.2, 0.3], atol=1e-6)
    volume = 2 * 0.1 * 0.2 * 0.3 / 6
    assert model.body("palm").mass[0] == pytest.approx(1000 * volume, rel=1e-6)
    np.testing.assert_allclose(model.body("palm").ipos, [0.525, 0.05, 0.075], atol=1e-6)


def test_all_objects_of_an_obj_file_are_an_object(tmp_path: Path) -> None:
    parts = [trimesh.creation.box(SIZE).apply_translation([x, 0, 0]) for x in (0.0, 0.05)]
    text, first = "", 1
    for name, part in zip("ab", parts, strict=True):
        text += f"o {name}\n" + "".join(f"v {x} {y} {z}\n" for x, y, z in part.vertices)
        text += "".join(f"f {a} {b} {c}\n" for a, b, c in part.faces + first)
        first += len(part.vertices)
    (tmp_path / "two.obj").write_text(text)
    mesh = Mesh.load(tmp_path / "two.obj")
    np.testing.assert_allclose(np.ptp(mesh.vertices, axis=0), [0.11, 0.02, 0.04], atol=1e-9)
    # both count once
    assert mesh.volume == pytest.approx(0.11 * 0.02 * 0.04, rel=1e-6)


# --- what a URDF only shows -----------------------------------------------------------------------

SHOWN = """<robot name="one"><material name="red"><color rgba="1 0 0 1"/></material>
<link name="palm"><inertial><mass value="0.2"/>
<inertia ixx="1e-4" iyy="1e-4" izz="1e-4" ixy="0" ixz="0" iyz="0"/></inertial>
<visual name="p"><origin xyz="0 0 0.1" rpy="0 0 1.5707963267948966"/><geometry>
<mesh filename="visual/palm.glb" scale="2 2 2"/></geometry><material name="red"/></visual>
<visual name="p"><geometry><box size="0.01 0.02 0.03"/></geometry></visual>
<visual><geometry><mesh filename="package://nowhere/palm.dae"/></geometry></visual>
<visual><geometry><mesh filename="visual/broken.glb"/></geometry></visual>
<collision name="p"><geometry><mesh filename="collision/palm.stl"/></geometry></collision></link>
<link name="tip"><collision><geometry><sphere radius="0.01"/></geometry></collision></link>
<joint name="j" type="revolute"><parent link="palm"/><child link="tip"/><axis xyz="0 0 1"/>
<limit lower="0" upper="1" effort="1" velocity="1"/></joint></robot>"""


def test_what_a_urdf_only_shows_is_drawn_and_changes_nothing_else(tmp_path: Path) -> None:
    box(tmp_path / "visual/palm.glb")
    (tmp_path / "visual/broken.glb").write_bytes(b"glTF, or not")
    (tmp_path / "collision").mkdir()
    trimesh.creation.box((0.1, 0.1, 0.1)).export(tmp_path / "collision/palm.stl")
    (tmp_path / "one.urdf").write_text(SHOWN)
    model = compile_spec(load_spec(tmp_path / "one.urdf"), "it")
    hull, shown, shown_box, tip = link_surfaces(model, pinocchio_from_mujoco(model))
    # the mesh of the same name that collides is still the other one
    np.testing.assert_allclose(np.ptp(hull.vertices, axis=0), 0.1, atol=1e-6)
    assert hull.collides and tip.collides and not shown.collides and not shown_box.collides
    width, depth, height = 2 * np.array(SIZE)
    np.testing.assert_allclose(np.ptp(shown.vertices, axis=0), [depth, width, height], atol=1e-6)
    np.testing.assert_allclose(shown.vertices.mean(axis=0), [0, 0, 0.1], atol=1e-6)
    assert list(shown.colour) == [1, 0, 0, 1]
    np.testing.assert_allclose(np.ptp(shown_box.vertices, axis=0), [0.01, 0.02, 0.03], atol=1e-9)
    colliding = model.geom_contype != 0
    assert model.geom_group[colliding].tolist() == [HIDDEN_GROUP, 0]  # the tip has nothing else
    assert model.body("palm").mass[0] == 0.2
    assert {f.name for f in model_files(tmp_path / "one.urdf")} == {"one.urdf", "palm.stl"}


def test_a_urdf_whose_links_show_nothing_is_drawn_as_it_collides(tmp_path: Path) -> None:
    box(tmp_path / "palm.stl")
    model = compile_spec(load_spec(urdf(tmp_path / "one.urdf", "palm.stl")), "it")
    assert model.ngeom == 1 and not model.geom_group.any()


# --- links without mass ---------------------------------------------------------------------------

CHAIN = """<robot name="two"><link name="palm"><inertial><mass value="0.2"/>
<inertia ixx="1e-4" iyy="1e-4" izz="1e-4" ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="hub">{hub}</link><link name="tip"><inertial><mass value="0.01"/>
<inertia ixx="1e-6" iyy="1e-6" izz="1e-6" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="a" type="revolute"><parent link="palm"/><child link="hub"/><axis xyz="0 0 1"/>
<limit lower="0" upper="1" effort="1" velocity="1"/></joint>
<joint name="b" type="revolute"><parent link="hub"/><child link="tip"/><axis xyz="0 1 0"/>
<limit lower="0" upper="1" effort="1" velocity="1"/></joint></robot>"""

INERTIAL = """<inertial><mass value="{mass}"/>
<inertia ixx="{i}" iyy="{i}" izz="{i}" ixy="{xy}" ixz="0" iyz="0"/></inertial>"""


@pytest.mark.parametrize(
    ("hub", "mass"),
    [
        ("", LEAST_MASS),
        (INERTIAL.format(mass=0, i=0, xy=0), LEAST_MASS),
        (INERTIAL.format(mass=0.02, i=0, xy=0), 0.02),
        (INERTIAL.format(mass=0.02, i=1e-6, xy=2e-6), 0.02),
    ],
    ids=["nothing", "zeros", "a mass alone", "an impossible inertia"],
)
def test_a_link_that_only_joins_two_joints_gets_the_least_inertia(
    tmp_path: Path, hub: str, mass: float
) -> None:
    path = tmp_path / "two.urdf"
    path.write_text(CHAIN.format(hub=hub), encoding="utf-8")
    spec = load_spec(path)
    assert with_least_inertias(spec) == ("hub",)
    model = compile_spec(spec, "it")
    assert model.body("hub").mass == pytest.approx(mass)
    np.testing.assert_allclose(model.body("hub").inertia, LEAST_INERTIA)
    assert model.body("tip").mass == 0.01
    np.testing.assert_allclose(model.body("tip").inertia, 1e-6)


def test_links_with_an_inertia_keep_it(tmp_path: Path) -> None:
    path = tmp_path / "two.urdf"
    path.write_text(CHAIN.format(hub=INERTIAL.format(mass=0.02, i=1e-6, xy=1e-7)), encoding="utf-8")
    spec = load_spec(path)
    assert with_least_inertias(spec) == ()
    inertia = compile_spec(spec, "it").body("hub").inertia
    np.testing.assert_allclose(np.sort(inertia), [0.9e-6, 1e-6, 1.1e-6])


# --- inertias that no link can have ---------------------------------------------------------------

TWO_LINKS = """<mujoco><worldbody><body name="palm"><geom size="0.05"/>
<body name="link" pos="0 0 0.05"><joint name="a" axis="1 0 0"/>
<inertial pos="0 0 0.03" mass="0.03" diaginertia="{link}"/>
<geom type="box" size="0.01 0.02 0.03" pos="0 0 0.03"/>
<body name="tip" pos="0 0 0.06"><joint name="b" axis="1 0 0"/>
<inertial pos="0.001 0 0" mass="0.02" diaginertia="{tip}"/><geom size="0.01"/>
<geom type="box" size="0.009 0.009 0.009" contype="0" conaffinity="0"/>
</body></body></body></worldbody></mujoco>"""

BOX = 0.03 / 3 * np.array([0.02**2 + 0.03**2, 0.01**2 + 0.03**2, 0.01**2 + 0.02**2])
"""Principal moments, kg m^2, of the first link as a uniform box."""


def two_links(link: float, tip: float) -> mujoco.MjSpec:
    text = TWO_LINKS.format(link=f"{link} {link} {link}", tip=f"{tip} {tip} {tip}")
    return mujoco.MjSpec.from_string(text)


@pytest.mark.parametrize(
    ("link", "tip", "told"),
    [
        (1e-5, 1e-6, ()),
        (1e-5, 0.1, ("tip",)),
        (0.1, 0.1, ("link", "tip")),
        (1e-5, 8e-5, ("tip",)),  # a radius of gyration of 63 mm, above its diagonal of 36 mm
        (4e-4, 1e-6, ()),  # more than its own, less than with all that it carries: a filler
    ],
)
def test_inertias_beyond_size_and_mass_are_found(
    link: float, tip: float, told: tuple[str, ...]
) -> None:
    found = impossible_inertias(two_links(link, tip).compile())
    assert tuple(one.body for one in found) == told


def test_an_inertia_from_geometry_is_that_of_a_uniform_solid() -> None:
    spec = two_links(0.1, 0.1)
    description = HandDescription(
        schema=1,
        name="it",
        model="it.xml",
        base_body="palm",
        palm_body="palm",
        palm_normal=(0, 0, 1),
        repair=RepairDescription(inertia_from_geometry=("link", "tip")),
    )
    prepare_spec(spec, description, "it")
    model = compile_spec(spec, "it")
    assert impossible_inertias(model) == ()
    np.testing.assert_allclose(np.sort(model.body("link").inertia), np.sort(BOX), rtol=1e-9)
    np.testing.assert_allclose(model.body("tip").inertia, 0.4 * 0.02 * 0.01**2, rtol=1e-9)
    for name, mass, center in (("link", 0.03, [0, 0, 0.03]), ("tip", 0.02, [0.001, 0, 0])):
        assert model.body(name).mass[0] == mass
        np.testing.assert_allclose(model.body(name).ipos, center)
    gone = description.model_copy(
        update={"repair": RepairDescription(inertia_from_geometry=("thumb",))}
    )
    with pytest.raises(NotFoundError, match="thumb"):
        prepare_spec(two_links(0.1, 0.1), gone, "it")
