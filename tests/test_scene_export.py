"""Exported scenes: the numbers of the trial's scene, held by a process that knows nothing of us."""

from __future__ import annotations

import ast
import json
import os
import shutil
import subprocess
import sys
import xml.etree.ElementTree as ET
from pathlib import Path

import mujoco
import numpy as np
import pinocchio as pin
import pytest
import trimesh
from conftest import PlanOf, hand_of_others

from planner.errors import FileFormatError, TaskError
from planner.exchange.formats import Writing, format_named
from planner.kinematics import HandState
from planner.plan import GraspPlan
from planner.search.grasp import plan_grasp
from planner.spatial import pose_to_wxyz
from planner.task import GraspTask
from sim.datasets.reset_states.hold import write_scene
from sim.scene.build import HAND_PREFIX, build_scene
from sim.scene.export import MJCF_SCENE, check, export_scene
from sim.scene.physics import PhysicsOptions

DATA = Path(__file__).parent / "data"
SCENES = (("allegro_hand", "ellipsoid"), ("shadow_hand", "box"), ("allegro_hand", "lbracket"))


@pytest.fixture(scope="module", params=SCENES, ids="-".join)
def plan(request: pytest.FixtureRequest, plan_of: PlanOf) -> GraspPlan:
    return plan_of(*request.param)


@pytest.fixture(scope="module")
def folder(plan: GraspPlan, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("export") / "scene"
    export_scene(plan, out)
    return out


def loaded(folder: Path) -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_path(str(folder / "scene.xml"))


def in_body(model: mujoco.MjModel, g: int) -> np.ndarray:
    """What a geom is made of in its body, m: vertices of a mesh, else its box with its axes.

    A mesh is centred anew by every compiler, so that only its vertices can be compared.
    """
    turn = np.zeros(9)
    mujoco.mju_quat2Mat(turn, model.geom_quat[g])
    points = np.vstack([np.zeros(3), np.diag(model.geom_size[g])])
    if model.geom_type[g] == int(mujoco.mjtGeom.mjGEOM_MESH):
        k = model.geom_dataid[g]
        start = model.mesh_vertadr[k]
        points = model.mesh_vert[start : start + model.mesh_vertnum[k]]
    return np.asarray(points @ turn.reshape(3, 3).T + model.geom_pos[g])


def run_check(folder: Path) -> subprocess.CompletedProcess[str]:
    """The shipped script in a process of its own, whose path does not hold our packages."""
    command = [sys.executable, "-I", str(folder / "check.py")]
    return subprocess.run(command, capture_output=True, text=True, check=False, cwd=folder.parent)


def test_the_check_of_a_folder_without_a_scene_is_one_line(tmp_path: Path) -> None:
    for words in ([str(tmp_path)], ["a", "b"]):
        command = [sys.executable, "-I", check.__file__, *words]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        assert done.returncode == 2
        assert done.stderr.startswith("usage: python check.py [FOLDER]")
        assert len(done.stderr.splitlines()) == 2


# --- the same scene -------------------------------------------------------------------------------


def test_the_file_has_the_numbers_of_the_scene_of_a_trial(plan: GraspPlan, folder: Path) -> None:
    """Bodies, geoms, joints and actuators of the hand and the object, by name."""
    mine = loaded(folder)
    trial = build_scene(plan.task, T_world_base=plan.T_world_base).model
    fields = {
        "geom": "friction solref solimp contype conaffinity condim priority margin type",
        "body": "mass inertia ipos iquat",
        "joint": "axis pos range",
        "actuator": "gainprm biasprm ctrlrange forcerange gear",
        "tendon": "range stiffness",
    }
    prefixes = {"geom": "geom", "body": "body", "joint": "jnt", "actuator": "actuator"}
    counted = 0
    for kind, names in fields.items():
        for i in range(getattr(mine, f"n{ {'joint': 'jnt', 'actuator': 'u'}.get(kind, kind) }")):
            name = getattr(mine, kind)(i).name
            if not name.startswith((HAND_PREFIX, "object")):
                continue
            j = getattr(trial, kind)(name).id
            for field in names.split():
                array = f"{prefixes.get(kind, kind)}_{field}"
                a, b = getattr(mine, array)[i], getattr(trial, array)[j]
                np.testing.assert_allclose(a, b, rtol=0, atol=2e-7, err_msg=f"{name} {array}")
                counted += 1
    assert counted > 200
    for g in range(mine.ngeom):
        j = trial.geom(mine.geom(g).name).id
        np.testing.assert_allclose(in_body(mine, g), in_body(trial, j), rtol=0, atol=2e-7)
    for name in ("timestep", "impratio", "cone", "integrator", "noslip_iterations", "jacobian"):
        assert getattr(mine.opt, name) == getattr(trial.opt, name)
    np.testing.assert_array_equal(mine.opt.gravity, trial.opt.gravity)


def test_the_hand_stands_where_the_plan_has_it(plan: GraspPlan, folder: Path) -> None:
    """All bodies of the hand, by Pinocchio, and the object: to 1e-9 m."""
    model = loaded(folder)
    data = mujoco.MjData(model)
    for key, q in (("pregrasp", plan.q_pregrasp), ("grasp", plan.q), ("squeeze", plan.q)):
        mujoco.mj_resetDataKeyframe(model, data, model.key(key).id)
        mujoco.mj_forward(model, data)
        state = HandState(plan.task.hand, q)
        palm = plan.T_world_base * state.T_base_palm
        body = model.body(HAND_PREFIX + plan.task.hand.description.palm_body).id
        np.testing.assert_allclose(data.xpos[body], palm.translation, rtol=0, atol=1e-9)
        joints = [model.joint(HAND_PREFIX + name).qposadr[0] for name in plan.task.hand.joint_names]
        np.testing.assert_array_equal(data.qpos[joints], q)
        position, quaternion = pose_to_wxyz(plan.task.T_world_object)
        np.testing.assert_allclose(data.body("object").xpos, position, rtol=0, atol=1e-12)
        np.testing.assert_allclose(data.body("object").xquat, quaternion, rtol=0, atol=1e-12)


def test_the_squeeze_commands_the_torques_that_the_plan_needs(
    plan: GraspPlan, folder: Path
) -> None:
    """At the planned posture and at rest, MuJoCo's own actuators make them."""
    model = loaded(folder)
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("squeeze").id)
    mujoco.mj_forward(model, data)
    hand = plan.task.hand
    dofs = [model.joint(HAND_PREFIX + name).dofadr[0] for name in hand.joint_names]
    force, _ = hand.actuation.split_torque(plan.q, plan.forces.joint_torques)[0:2]
    wanted = hand.actuation.moment.T @ force
    np.testing.assert_allclose(data.qfrc_actuator[dofs], wanted, rtol=0, atol=1e-6)


def test_it_uses_only_what_other_readers_follow(folder: Path) -> None:
    root = ET.parse(folder / "scene.xml").getroot()
    tags = {element.tag for element in root.iter()}
    assert not tags & {"default", "include", "frame", "texture", "general"}
    for mesh in root.iter("mesh"):
        path = mesh.attrib["file"]
        assert not Path(path).is_absolute() and (folder / path).suffix == ".obj"
        assert (folder / path).is_file()
    assert not any("class" in e.attrib or "childclass" in e.attrib for e in root.iter())


@pytest.fixture(scope="module")
def scenes(
    plan: GraspPlan, folder: Path, tmp_path_factory: pytest.TempPathFactory
) -> tuple[Path, ...]:
    """What is written for others: the scene of an export and that of states."""
    states = write_scene(plan.task, PhysicsOptions(), tmp_path_factory.mktemp("states"))
    return folder / "scene.xml", states


def test_only_what_mujoco_3_3_reads_is_written(scenes: tuple[Path, ...]) -> None:
    """The list is what ``mujoco.mj_printSchema(False, False)`` says in 3.3.2."""
    known = json.loads((DATA / "mjcf_of_mujoco_3_3_2.json").read_text(encoding="utf-8"))
    for scene in scenes:
        for element in ET.parse(scene).getroot().iter():
            unknown = set(element.attrib) - set(known.get(element.tag, "").split()) - {"class"}
            assert not unknown, f"<{element.tag}> of {scene} has {unknown}"


def test_mujoco_3_3_loads_what_is_written_as_ours_does(scenes: tuple[Path, ...]) -> None:
    """Runs where OPPOSABLE_OLDER_PYTHON names a Python with ``pip install mujoco==3.3.2``."""
    older = os.environ.get("OPPOSABLE_OLDER_PYTHON", "")
    if not older:
        pytest.skip("OPPOSABLE_OLDER_PYTHON names no Python with an older MuJoCo")
    code = """
import json, mujoco, sys
model = mujoco.MjModel.from_xml_path(sys.argv[1])
arrays = ("body_mass", "geom_size", "jnt_range", "actuator_gainprm", "actuator_biasprm",
          "actuator_forcerange", "geom_friction", "key_ctrl")
print(mujoco.__version__)
print(json.dumps({name: getattr(model, name)[:, :3].tolist() if getattr(model, name).ndim > 1
                  else getattr(model, name).tolist() for name in arrays}))
"""
    for scene in scenes:
        said = [
            subprocess.run(
                [python, "-I", "-c", code, str(scene)], capture_output=True, text=True, check=True
            ).stdout.splitlines()
            for python in (older, sys.executable)
        ]
        assert said[0][0] < said[1][0]
        theirs, ours = (json.loads(lines[1]) for lines in said)
        for name, values in ours.items():
            np.testing.assert_allclose(theirs[name], values, rtol=1e-9, atol=1e-12, err_msg=name)


# --- held by those who know nothing of us ---------------------------------------------------------


def test_the_script_imports_nothing_of_ours() -> None:
    tree = ast.parse(Path(check.__file__).read_text(encoding="utf-8"))
    names = {
        (node.module or "").split(".")[0] if isinstance(node, ast.ImportFrom) else alias.name
        for node in ast.walk(tree)
        if isinstance(node, ast.Import | ast.ImportFrom)
        for alias in node.names
    }
    assert names == {"sys", "pathlib", "mujoco", "numpy"}


def test_a_fresh_process_holds_the_object_and_the_folder_may_be_moved(
    folder: Path, tmp_path: Path
) -> None:
    elsewhere = tmp_path / "somewhere else"
    shutil.copytree(folder, elsewhere)
    done = run_check(elsewhere)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.startswith("held: the object moved 0.")


def test_without_the_squeeze_the_object_is_lost(folder: Path, tmp_path: Path) -> None:
    """The check can fail: with the commands of "grasp", nothing presses."""
    loose = tmp_path / "loose"
    shutil.copytree(folder, loose)
    tree = ET.parse(loose / "scene.xml")
    keys = {key.attrib["name"]: key for key in tree.iter("key")}
    keys["squeeze"].set("ctrl", keys["grasp"].attrib["ctrl"])
    tree.write(loose / "scene.xml")
    done = run_check(loose)
    assert done.returncode == 1
    assert done.stdout.startswith("not held: the object moved 1")


@pytest.mark.slow
@pytest.mark.usefixtures("brief_postures")
def test_a_hand_of_others_holds_its_object(tmp_path: Path) -> None:
    """Links of it overlap its palm: a base that stands fixed must not push them away."""
    name = "example-robot-data:allegro_right"
    hand_of_others(name)
    export_scene(plan_grasp(GraspTask.create(name, "sphere")), tmp_path / "scene")
    done = run_check(tmp_path / "scene")
    assert (done.returncode, done.stdout[:5]) == (0, "held:")


# --- physics.json and URDF ------------------------------------------------------------------------


def test_the_numbers_beside_it_are_those_of_the_model(plan: GraspPlan, folder: Path) -> None:
    model = loaded(folder)
    told = json.loads((folder / "physics.json").read_text())
    assert (told["format"], told["version"]) == ("opposable-scene", 1)
    assert [j["joint"] for j in told["joints"]] == list(plan.task.hand.joint_names)
    for joint in told["joints"]:
        there = model.joint(joint["name"])
        assert joint["qpos_index"] == there.qposadr[0]
        assert joint["armature"] == there.armature[0]
        assert joint["dry_friction"] == there.frictionloss[0]
    ctrl = model.key("squeeze").ctrl
    commands = told["key_frames"]["squeeze"]["commands"]
    for actuator in told["actuators"]:
        there = model.actuator(actuator["name"])
        assert actuator["gain"] == there.gainprm[0]
        np.testing.assert_array_equal(actuator["bias"], there.biasprm[:3])
        assert commands[actuator["name"]] == ctrl[there.id]
    assert told["engine"]["timestep"] == model.opt.timestep
    assert told["contact"]["friction"] == model.geom("object").friction[0]
    assert told["left_out"]["table_height"] == plan.task.table_height


def test_the_urdf_moves_and_weighs_like_the_model(plan: GraspPlan, folder: Path) -> None:
    """Read by Pinocchio's own URDF reader: poses to 1e-9, and the mass matrix."""
    hand = plan.task.hand
    model = pin.buildModelFromUrdf(str(folder / "hand.urdf"))
    data = model.createData()
    rng = np.random.default_rng(0)
    for _ in range(5):
        q = rng.uniform(hand.q_lower, hand.q_upper)
        mine = np.zeros(model.nq)
        for name, value in zip(hand.joint_names, q, strict=True):
            mine[model.joints[model.getJointId(HAND_PREFIX + name)].idx_q] = value
        pin.framesForwardKinematics(model, data, mine)
        palm = data.oMf[model.getFrameId(HAND_PREFIX + hand.description.palm_body)]
        np.testing.assert_allclose(
            palm.homogeneous, HandState(hand, q).T_base_palm.homogeneous, rtol=0, atol=1e-9
        )
        for finger in hand.fingers.values():
            body = hand.mj_model.body(hand.mj_model.geom(finger.pad.geom).bodyid[0]).name
            frame = data.oMf[model.getFrameId(HAND_PREFIX + body)]
            own = hand.pin_model.getFrameId(body)
            theirs = hand.pin_model.createData()
            pin.framesForwardKinematics(hand.pin_model, theirs, q)
            np.testing.assert_allclose(
                frame.homogeneous, theirs.oMf[own].homogeneous, rtol=0, atol=1e-9
            )
    told = json.loads((folder / "physics.json").read_text())
    names = [joint["name"] for joint in told["joints"]]  # both files name joints alike
    assert set(names) == set(model.names.tolist()[1:]) == set(told["key_frames"]["grasp"]["joints"])
    place = [model.joints[model.getJointId(name)].idx_v for name in names]
    theirs = pin.crba(model, data, mine)[np.ix_(place, place)]
    ours = pin.crba(hand.pin_model, hand.pin_model.createData(), q)
    ours -= np.diag(hand.pin_model.armature)  # which URDF does not have
    np.testing.assert_allclose(np.triu(theirs), np.triu(ours), rtol=0, atol=1e-10)
    item = ET.parse(folder / "object.urdf").getroot()
    mass = item.find("link/inertial/mass")
    assert mass is not None and float(mass.attrib["value"]) == plan.task.object.mass


def test_an_ellipsoid_becomes_a_mesh_of_its_size_in_the_urdf(
    plan_of: PlanOf, tmp_path: Path
) -> None:
    plan = plan_of("allegro_hand", "ellipsoid")
    export_scene(plan, tmp_path / "scene")
    link = ET.parse(tmp_path / "scene" / "object.urdf").getroot().find("link/collision/geometry/*")
    assert link is not None and link.tag == "mesh"
    mesh = trimesh.load_mesh(tmp_path / "scene" / link.attrib["filename"])
    np.testing.assert_allclose(mesh.extents / 2, plan.task.object.shape.half_extents, rtol=0.01)


# --- what is refused ------------------------------------------------------------------------------


def test_a_hand_of_motors_is_refused_and_nothing_is_written(
    plan_of: PlanOf, tmp_path: Path
) -> None:
    plan = plan_of("shadow_hand_torque", "sphere")
    with pytest.raises(TaskError, match="are no position servos; an exported scene is held by"):
        export_scene(plan, tmp_path / "scene")
    assert not list(tmp_path.iterdir())


def test_a_folder_of_something_else_is_kept(plan_of: PlanOf, tmp_path: Path) -> None:
    plan = plan_of("allegro_hand", "sphere")
    taken = tmp_path / "taken"
    taken.mkdir()
    (taken / "letter.txt").write_text("dear")
    with pytest.raises(FileFormatError, match="is no earlier export of a scene"):
        export_scene(plan, taken)
    assert [path.name for path in taken.iterdir()] == ["letter.txt"]
    with pytest.raises(FileFormatError, match="there is no folder"):
        export_scene(plan, tmp_path / "no" / "scene")
    mine = tmp_path / "mine"
    export_scene(plan, mine)
    (mine / "notes.txt").write_text("of the user")
    with pytest.raises(FileFormatError, match=r"export and notes\.txt, which would be lost"):
        export_scene(plan, mine, physics=PhysicsOptions(mu=0.8))
    assert (mine / "notes.txt").read_text() == "of the user"
    (mine / "notes.txt").unlink()
    export_scene(plan, mine, physics=PhysicsOptions(mu=0.8))
    assert json.loads((mine / "physics.json").read_text())["contact"]["friction"] == 0.8
    assert sorted(path.name for path in tmp_path.iterdir()) == ["mine", "taken"]


def test_the_format_is_registered_and_writes_a_folder_for_each_plan(
    plan_of: PlanOf, tmp_path: Path
) -> None:
    assert format_named("mjcf-scene") is MJCF_SCENE
    plan = plan_of("allegro_hand", "sphere")
    assert MJCF_SCENE.write is not None
    files = MJCF_SCENE.write([plan], tmp_path / "one", Writing())
    assert tmp_path / "one" / "scene.xml" in files
    files = MJCF_SCENE.write([plan, plan], tmp_path / "two", Writing())
    assert {path.parts[len(tmp_path.parts) + 1] for path in files} == {"000", "001"}
    with pytest.raises(FileFormatError, match="exists already"):
        MJCF_SCENE.write([plan, plan], tmp_path / "two", Writing())
    weak = plan_of("shadow_hand_torque", "sphere")
    with pytest.raises(TaskError):
        MJCF_SCENE.write([plan, weak], tmp_path / "three", Writing())
    assert sorted(path.name for path in tmp_path.iterdir()) == ["one", "two"]  # whole or not at all
