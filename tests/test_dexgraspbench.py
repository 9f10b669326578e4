"""What DexGraspBench is given: hand files, frames, names, what is left out, and the squeeze."""

from __future__ import annotations

import json
import re
import shutil
import xml.etree.ElementTree as ET
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import mujoco
import numpy as np
import pytest
import trimesh
from test_protocols import PAD, SERVOS, make_jaw, pinch

from planner.batch import GraspSet, plan_grasps
from planner.errors import FileFormatError, ModelError, TaskError
from planner.exchange.dexgraspbench import (
    Squeeze,
    benchmark_pieces,
    export,
    export_dexgraspbench,
    export_name,
    models,
)
from planner.exchange.dexgraspbench.export import SPARE, plan_squeeze
from planner.exchange.dexgraspbench.models import T_model_base, file_name, pinned_mjcf, write_hand
from planner.hand_loading import load_hand
from planner.hands.hand import Hand
from planner.objects import parse_object
from planner.shapes import Mesh
from planner.shapes.pieces import Pieces
from planner.spatial import SE3, pose_from_wxyz
from planner.task import GraspTask
from sim.protocols import dexgraspbench
from sim.protocols.dexgraspbench import benchmark_contacts, benchmark_scene

pytest.importorskip("pyarrow")

NEW_SINCE_PINNED = (
    *("input", "delay", "interp", "nsample", "ffrange", "velrange", "inheritrange"),  # actuators
    *("adhesion", "surfacevel", "castshadow", "springyield", "layer", "embed"),
)
"""Attributes that MuJoCo 4.0.0 has and 3.3.2 has not, read from the schemas of both."""


@pytest.fixture(scope="module")
def jaw(tmp_path_factory: pytest.TempPathFactory) -> Hand:
    """A hand whose base stands somewhere in its file."""
    folder = tmp_path_factory.mktemp("jaw")
    make_jaw(folder, SERVOS)
    model = folder / "jaw.xml"
    text = model.read_text(encoding="utf-8")
    placed = '<body name="palm" pos="0.1 -0.2 0.3" quat="0.6 0 0.8 0">'
    model.write_text(text.replace('<body name="palm">', placed), encoding="utf-8")
    return load_hand(folder / "hand.toml")


@pytest.fixture(scope="module")
def grasps(tmp_path_factory: pytest.TempPathFactory) -> GraspSet:
    """Grasps of a mesh whose file has its origin far from the centre of mass."""
    folder = tmp_path_factory.mktemp("off")
    solid = trimesh.creation.cylinder(radius=30.0, height=90.0, sections=24)
    solid.apply_translation([100.0, -20.0, 40.0])
    solid.export(folder / "off.stl")
    task = GraspTask.create("allegro_hand", parse_object(f"{folder / 'off.stl'}*0.001"))
    return plan_grasps("allegro_hand", [task], 2, workers=1, out=folder / "set")


def tips_of(model: Any, qpos: Any, names: list[str]) -> Any:
    """Positions (n, 3) of geoms of a hand file under a qpos of the benchmark."""
    data = mujoco.MjData(model)
    data.qpos[:] = qpos[7:]
    mujoco.mj_kinematics(model, data)
    T_world_model = pose_from_wxyz(qpos[:3], qpos[3:7])
    return np.array([T_world_model.act(data.geom(name).xpos) for name in names])


def test_tips_are_where_the_plan_has_them_by_the_exported_file_and_by_the_original(
    jaw: Hand, tmp_path: Path
) -> None:
    plan = pinch(jaw)
    T_base_model = T_model_base(jaw).inverse()
    assert np.linalg.norm(T_base_model.translation) > 0.1
    row = export_row(plan)
    squeeze = plan_squeeze(plan.task, plan.contacts, plan.T_world_base, plan.q)
    data = export.grasp_dict(plan.task, row, tmp_path, squeeze, T_base_model)
    name = write_hand(jaw, tmp_path)
    pads = [finger.pad.geom for finger in plan.task.fingers]
    for path in (tmp_path / name / f"{name}.xml", jaw.path.parent / "jaw.xml"):  # type: ignore[union-attr]
        centers = tips_of(mujoco.MjModel.from_xml_path(str(path)), data["grasp_qpos"], pads)
        # a test's task has no table, so the world is the plan's
        reach = np.linalg.norm(centers - plan.contacts.positions, axis=1)
        np.testing.assert_allclose(reach, PAD, atol=1e-5)
        np.testing.assert_allclose(
            centers + PAD * plan.contacts.normals, plan.contacts.positions, atol=1e-5
        )


def export_row(plan: Any) -> dict[str, Any]:
    """A plan as a row of a batch."""
    from planner.batch.rows import found_row

    return found_row(0, "box", 0, plan, [])


@pytest.mark.parametrize("name", ["allegro_hand", "shadow_hand", "allegro_hand_left"])
def test_hand_files_hold_nothing_that_the_pinned_mujoco_does_not_know(
    name: str, tmp_path: Path
) -> None:
    hand = load_hand(name)
    written = write_hand(hand, tmp_path)
    path = tmp_path / written / f"{written}.xml"
    for element in ET.parse(path).getroot().iter():
        assert not set(element.attrib) & set(NEW_SINCE_PINNED)
        assert element.tag not in ("option", "sensor", "keyframe", "texture")
    model = mujoco.MjModel.from_xml_path(str(path))
    assert (model.nq, model.nu) == (hand.nq, len(hand.actuation.names))
    np.testing.assert_allclose(model.actuator_biasprm, hand.mj_model.actuator_biasprm, rtol=1e-5)


def test_what_the_pinned_mujoco_cannot_say_is_refused() -> None:
    body = "<mujoco><worldbody><body name='b'>{}</body></worldbody>{}</mujoco>"
    kept = pinned_mjcf(
        body.format(
            "<joint name='j'/><geom size='1' castshadow='false'/>",
            "<actuator><general joint='j' input='pos'/></actuator><option impratio='3'/>",
        ),
        "h",
    )
    assert "input" not in kept
    assert "option" not in kept
    for inside, after, what in (
        ("<geom size='1' surfacevel='1 0 0'/>", "", "surfacevel"),
        ("<joint damping='0.1 0.2'/>", "", "damping"),
        ("", "<deformable/>", "deformable"),
    ):
        with pytest.raises(ModelError, match=f"{what}.*3.3.2"):
            pinned_mjcf(body.format(inside, after), "h")


def test_meshes_travel_with_the_hand(tmp_path: Path) -> None:
    home = tmp_path / "hand" / "parts"
    home.mkdir(parents=True)
    make_jaw(home.parent, SERVOS)
    trimesh.creation.box((0.1, 0.04, 0.02)).export(home / "palm.stl")
    model = home.parent / "jaw.xml"
    text = model.read_text(encoding="utf-8")
    text = text.replace("<worldbody>", "<asset><mesh file='palm.stl'/></asset><worldbody>")
    text = text.replace('angle="radian"', 'angle="radian" meshdir="parts"')
    text = text.replace('type="box" size="0.08 0.02 0.01"', 'type="mesh" mesh="palm"')
    model.write_text(text, encoding="utf-8")
    name = write_hand(load_hand(home.parent / "hand.toml"), tmp_path / "out")
    shutil.rmtree(home.parent)
    moved = tmp_path / "elsewhere"
    (tmp_path / "out").rename(moved)
    assert mujoco.MjModel.from_xml_path(str(moved / name / f"{name}.xml")).nmesh == 1


def test_every_hand_has_its_own_name_and_none_is_overwritten(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Models without a description; what would be proposed for them is known, and takes long."""
    known = make_jaw(tmp_path, SERVOS).description.model_copy(update={"name": "right_hand"})
    monkeypatch.setattr("planner.describe.proposed_description", lambda _: known)
    text = (tmp_path / "jaw.xml").read_text(encoding="utf-8")
    hands = []
    for folder, name in (("one", "model_one"), ("two", "model_two"), ("three", None)):
        path = tmp_path / folder / "right_hand.xml"
        path.parent.mkdir()
        head = "<mujoco>" if name is None else f'<mujoco model="{name}">'
        path.write_text(re.sub(r"<mujoco[^>]*>", head, text, count=1), encoding="utf-8")
        hands.append(load_hand(path))
    assert {hand.name for hand in hands} == {"right_hand"}
    assert [export_name(hand) for hand in hands] == ["model_one", "model_two", "three-right_hand"]
    assert export_name(load_hand("allegro_hand")) == "allegro_hand"
    for hand in hands:
        write_hand(hand, tmp_path / "out")
        write_hand(hand, tmp_path / "out")  # the same one again
    other = tmp_path / "four" / "right_hand.xml"
    other.parent.mkdir()
    other.write_text(
        re.sub(r"<mujoco[^>]*>", '<mujoco model="model_one">', text, count=1).replace(
            'mass="0.5"', 'mass="0.6"', 1
        ),
        encoding="utf-8",
    )
    with pytest.raises(FileFormatError, match="another hand of that name"):
        write_hand(load_hand(other), tmp_path / "out")


@pytest.mark.parametrize(
    ("given", "name"),
    [
        ("../../ESCAPED", "ESCAPED"),
        ("..", "unnamed"),
        ("/etc/passwd", "etc-passwd"),
        ("x" * 5000, "x" * 100),
        ("my hand, v1.2", "my-hand--v1-2"),
        ("Shadow", "hand-Shadow"),  # the benchmark's own, which it finds first
        ("null", "hand-null"),
        ("1e5", "hand-1e5"),
    ],
)
def test_a_name_stays_in_its_folder_and_means_this_hand(
    given: str, name: str, tmp_path: Path
) -> None:
    home, out = tmp_path / "jaw", tmp_path / "out"
    home.mkdir()
    make_jaw(home, SERVOS)
    described = home / "hand.toml"
    text = re.sub(r'(?m)^name = ".*"$', f'name = "{given}"', described.read_text(), count=1)
    described.write_text(text, encoding="utf-8")
    hand = load_hand(described)
    assert hand.name == given
    folder = out / "a" / "b" / "hand"
    assert write_hand(hand, folder) == export_name(hand) == name
    written = {path for path in tmp_path.rglob("*") if path.is_file() and home not in path.parents}
    assert written == {folder / f"{name}.yaml", folder / name / f"{name}.xml"}


def test_an_objects_folder_is_below_the_export_and_its_own(
    grasps: GraspSet, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert [file_name(label) for label in ("..", "../x", "sphere:0.035", "a+b")] == [
        *("unnamed", "x", "sphere-0.035", "a-b")
    ]
    labels = property(lambda self: ("a b", "a:b"))
    task = grasps.task(grasps.labels[0])
    monkeypatch.setattr(GraspSet, "labels", labels)
    monkeypatch.setattr(GraspSet, "task", lambda self, label: task)
    with pytest.raises(TaskError, match="'a b' and 'a:b' would both be exported as 'a-b'"):
        export_dexgraspbench(grasps, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_the_frame_of_the_objects_file_is_kept_and_used(grasps: GraspSet, tmp_path: Path) -> None:
    exported = export_dexgraspbench(grasps, tmp_path)
    (label,) = grasps.labels
    task = grasps.task(label)
    assert isinstance(task.object.shape, Mesh)
    given = trimesh.load(task.object.shape.source.path)  # type: ignore[union-attr]
    pieces = sorted((tmp_path / "object" / label / "urdf" / "meshes").iterdir())
    corners = np.vstack([trimesh.load(path).vertices for path in pieces])
    np.testing.assert_allclose(corners.min(axis=0), 1e-3 * given.bounds[0], atol=1e-6)
    np.testing.assert_allclose(corners.max(axis=0), 1e-3 * given.bounds[1], atol=1e-6)
    info = (tmp_path / "object" / label / "info" / "simplified.json").read_text(encoding="utf-8")
    shift = np.array(json.loads(info)["gravity_center"])
    np.testing.assert_allclose(shift, [0.1, -0.02, 0.04], atol=1e-6)
    path = tmp_path / "graspdata" / exported.hand / label / "0.npy"
    data = np.load(path, allow_pickle=True).item()
    T_world_file = pose_from_wxyz(data["obj_pose"][:3], data["obj_pose"][3:])
    T_world_object = T_world_file * SE3(np.eye(3), shift)
    np.testing.assert_allclose(T_world_object.homogeneous, task.T_world_object.homogeneous)


def test_a_grasp_that_cannot_press_is_left_out_and_counted(
    grasps: GraspSet, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    none = np.zeros(0)
    weak = Squeeze(
        reason="too weak; a detail",
        ctrl=none,
        factor=np.nan,
        use=np.nan,
        forces=none,
        torques=none,
    )
    true = export.row_squeeze

    def some(task: GraspTask, row: Any) -> Squeeze:
        return weak if row["k"] == 0 else true(task, row)

    monkeypatch.setattr(export, "row_squeeze", some)
    exported = export_dexgraspbench(grasps, tmp_path)
    assert (exported.written, exported.left_out) == (1, {"too weak": 1})
    assert exported.summary == "1 grasps exported, 1 left out (1: too weak)"
    written = list((tmp_path / "graspdata").rglob("*.npy"))
    assert [path.name for path in written] == ["1.npy"]
    with pytest.raises(FileFormatError, match="grasp 0 of 'off' cannot press"):
        export_dexgraspbench(grasps, tmp_path, need_all=True)


def test_motors_are_not_exported(grasps: GraspSet, monkeypatch: pytest.MonkeyPatch) -> None:
    task = GraspTask.create(load_hand("shadow_hand_torque"), "sphere")
    monkeypatch.setattr(grasps, "task", lambda label: task)
    with pytest.raises(TaskError, match="no position servos"):
        export_dexgraspbench(grasps, "nowhere")


def test_pieces_that_are_no_truer_than_the_hull_are_one(monkeypatch: pytest.MonkeyPatch) -> None:
    # a tin: a flat recess in both ends, 3 mm deep
    outer = np.array([[0.0, -0.037], [0.026, -0.037], [0.026, -0.04], [0.03, -0.04]])
    profile = np.vstack([outer, outer[::-1] * [1.0, -1.0]])
    tin = trimesh.creation.revolve(profile, sections=24)
    shape = Mesh.from_triangles(tin.vertices, tin.faces)
    hull = trimesh.convex.convex_hull(shape.vertices)
    many = tuple(np.array(hull.vertices) for _ in range(50))
    faces = tuple(np.array(hull.faces) for _ in range(50))

    def pieces(deviation: float) -> Any:
        made = Pieces(vertices=many, faces=faces, deviation=deviation)
        models.benchmark_pieces.cache_clear()
        monkeypatch.setattr(models, "convex_pieces", lambda mesh: made)
        return benchmark_pieces(shape)

    assert len(pieces(0.003)) == 1  # as far out as the hull
    assert len(pieces(0.001)) == 50
    models.benchmark_pieces.cache_clear()


def test_the_squeeze_bears_the_benchmarks_loads(jaw: Hand) -> None:
    plan = pinch(jaw)
    squeeze = plan_squeeze(plan.task, plan.contacts, plan.T_world_base, plan.q)
    # two springs of 500 N/m: a contact out of place by 1 mm in each moves both by half, and a lift
    # of 0.1 kg at 10 + 25 m/s2 hangs on both: 1.75 N <= 0.6 ((1 - SPARE) f - 0.35 N)
    lost = 500 / 2 * 0.001 * np.sqrt(2)
    np.testing.assert_allclose(squeeze.forces, (1.75 / 0.6 + lost) / (1.0 - SPARE), rtol=0.02)
    np.testing.assert_allclose(squeeze.ctrl, plan.q + squeeze.forces / 500, rtol=1e-6)
    assert squeeze.factor > 1.0
    assert squeeze.use == pytest.approx(1.0 - SPARE)
    tighter = plan_squeeze(pinch(jaw, press=8.0).task, plan.contacts, plan.T_world_base, plan.q)
    np.testing.assert_allclose(tighter.forces, 8.0, rtol=1e-3)  # presses enough already


def test_the_world_of_fc_is_the_benchmarks(jaw: Hand) -> None:
    plan = pinch(jaw)
    scene, welded = benchmark_scene(plan.task, plan.T_world_base)
    model = scene.model
    assert model.neq == 1
    assert model.eq_solimp[0] == pytest.approx([0.9, 0.95, 0.001, 0.5, 2])
    assert model.eq_solref[0] == pytest.approx([0.02, 1.0])
    data = scene.start(plan.q, plan.T_world_base)
    assert np.linalg.norm(data.efc_pos[:6]) < 1e-9  # the weld is where the hand is
    np.testing.assert_allclose(
        data.xpos[scene.base_body], plan.T_world_base.translation, atol=1e-12
    )
    data.ctrl[scene.hand_ctrl] = plan.q + 0.005
    mujoco.mj_step(model, data, 50)
    contacts = [c for c in data.contact if scene.object_body in model.geom_bodyid[list(c.geom)]]
    assert contacts
    for contact in contacts:
        # the hand's 5 ms and MuJoCo's default of 20 ms for the object, mixed
        assert contact.solref == pytest.approx([0.0125, 1.0])
        assert contact.solimp[:3] == pytest.approx([0.7, 0.97, 0.00055])
        assert contact.solref == pytest.approx(benchmark_contacts()["solref"])
        assert contact.solimp == pytest.approx(benchmark_contacts()["solimp"])
        assert contact.friction[:3] == pytest.approx([0.6, 0.6, 0.02])
    assert model.body_mass[scene.object_body] == pytest.approx(0.1)
    assert model.body_mass[scene.object_body] == pytest.approx(plan.task.object.mass)
    assert welded.coordinates(plan.T_world_base).shape == (7,)


def test_without_planned_forces_a_grasp_is_closed_as_far_again_as_from_its_pregrasp(
    allegro: Hand, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(dexgraspbench, "contacts_at", lambda *_: None)
    monkeypatch.setattr(dexgraspbench, "plan_squeeze", lambda *_: SimpleNamespace(reason="none"))
    q, task = allegro.posture("pinch"), SimpleNamespace(hand=allegro)
    for before, wanted in ((None, q), (q - 0.1, q + 0.1)):  # its servos take angles
        grasp = SimpleNamespace(q_squeeze=None, q=q, q_pregrasp=before)
        asked: Any = (task, grasp, SE3.Identity())
        np.testing.assert_allclose(dexgraspbench._squeeze(*asked), wanted, atol=1e-12)
