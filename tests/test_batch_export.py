"""Export to DexGraspBench: read back, seen by MuJoCo, and replayed as that benchmark does."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
import trimesh

from planner.batch import GraspSet, plan_grasps
from planner.errors import TaskError
from planner.exchange.dexgraspbench import export_dexgraspbench
from planner.exchange.dexgraspbench.export import row_squeeze
from planner.exchange.dexgraspbench.models import T_model_base
from planner.hand_loading import load_hand
from planner.spatial import FloatArray, pose_from_wxyz
from planner.task import GraspTask

pytest.importorskip("pyarrow")


@pytest.fixture(scope="module")
def exported(tmp_path_factory: pytest.TempPathFactory) -> tuple[GraspSet, Path]:
    """Two grasps each of a sphere on a high table and of a mug, and the folder of their export."""
    folder = tmp_path_factory.mktemp("export")
    task = GraspTask.create("allegro_hand", "sphere", table_height=0.4)
    grasps = plan_grasps("allegro_hand", [task, "mug"], 2, workers=1, out=folder / "set")
    exported = export_dexgraspbench(grasps, folder / "bench")
    assert (exported.hand, exported.written) == ("allegro_hand", len(list(grasps.found())))
    assert not exported.left_out
    return grasps, folder / "bench"


def load(path: Path) -> dict[str, Any]:
    """A grasp as the benchmark reads it."""
    data: dict[str, Any] = np.load(path, allow_pickle=True).item()
    return data


def test_grasps_survive_the_round_trip(exported: tuple[GraspSet, Path]) -> None:
    grasps, bench = exported
    for _, row in grasps.found():
        name = row["object"].replace(":", "-")
        data = load(bench / "graspdata" / "allegro_hand" / name / f"{row['k']}.npy")
        assert set(data) == {
            "obj_path",
            "obj_scale",
            "obj_pose",
            "pregrasp_qpos",
            "grasp_qpos",
            "squeeze_qpos",
        }
        T_object = pose_from_wxyz(data["obj_pose"][:3], data["obj_pose"][3:])
        base = pose_from_wxyz(data["grasp_qpos"][:3], data["grasp_qpos"][3:7])
        hand = grasps.task(row["object"]).hand
        T_object_base = T_object.inverse() * base * T_model_base(hand)
        assert T_object_base.translation == pytest.approx(row["base_position_object_m"])
        # joints in the order of the hand's file
        joints = grasps.task(row["object"]).hand.joint_names
        model = grasps.task(row["object"]).hand.mj_model
        for i, value in enumerate(data["grasp_qpos"][7:]):
            assert value == row["q_rad"][joints.index(model.joint(i).name)]
        assert (data["pregrasp_qpos"][:7] == data["grasp_qpos"][:7]).all()


def test_the_tables_top_is_the_floor(exported: tuple[GraspSet, Path]) -> None:
    _, bench = exported
    data = load(bench / "graspdata" / "allegro_hand" / "sphere-0.035" / "0.npy")
    assert data["obj_pose"][:3] == pytest.approx([0, 0, 0.035])


def test_objects_are_convex_closed_and_of_the_right_mass(exported: tuple[GraspSet, Path]) -> None:
    grasps, bench = exported
    for label in grasps.labels:
        folder = bench / "object" / label.replace(":", "-")
        shape = grasps.task(label).object.shape
        info = json.loads((folder / "info" / "simplified.json").read_text(encoding="utf-8"))
        assert info["mass"] / (info["density"] * info["scale"] ** 3) == pytest.approx(shape.volume)
        pieces = [trimesh.load(path) for path in sorted((folder / "urdf" / "meshes").iterdir())]
        assert all(piece.is_watertight and piece.volume > 0 for piece in pieces)
        assert sum(piece.volume for piece in pieces) > 0.99 * shape.volume
        corners = np.vstack([piece.vertices for piece in pieces])
        assert shape.signed_distance(corners).max() < 2e-3


def benchmark_scene(hand: Path, object_path: str) -> Any:
    """The benchmark's world: no gravity, friction 0.6, a free hand held by a mocap body, 0.1 kg."""
    spec = mujoco.MjSpec()
    spec.option.timestep = 0.004
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.disableflags = mujoco.mjtDisableBit.mjDSBL_GRAVITY
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    spec.option.jacobian = mujoco.mjtJacobian.mjJAC_DENSE
    spec.option.impratio, spec.option.noslip_iterations = 10, 2
    child = mujoco.MjSpec.from_file(str(hand))
    root = spec.worldbody.add_frame().attach_body(child.worldbody, "child-", "")
    root.add_freejoint(name="hand")
    spec.worldbody.add_body(name="mocap", mocap=True)
    spec.add_equality(
        type=mujoco.mjtEq.mjEQ_WELD,
        name1="mocap",
        name2="child-world",
        objtype=mujoco.mjtObj.mjOBJ_BODY,
        solimp=[0.9, 0.95, 0.001, 0.5, 2],
        data=[0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 1, 0],
    )
    body = spec.worldbody.add_body(name="object")
    body.add_freejoint()
    info = json.loads(Path(object_path, "info", "simplified.json").read_text(encoding="utf-8"))
    density = 0.1 * info["density"] / info["mass"]
    for path in Path(object_path, "urdf", "meshes").iterdir():
        spec.add_mesh(name=path.stem, file=str(path))
        body.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname=path.stem, density=density)
    for geom in spec.geoms:
        geom.friction[:2], geom.condim = [0.6, 0.02], 4
    return spec.compile()


def replayed(model: Any, grasp: dict[str, Any], squeeze: str, force: FloatArray) -> float:
    """How far (m) the object is from where it was, 0.4 s after it is pushed."""
    data = mujoco.MjData(model)
    data.qpos[:] = np.concatenate([grasp["pregrasp_qpos"], grasp["obj_pose"]])
    data.mocap_pos[0], data.mocap_quat[0] = np.split(grasp["grasp_qpos"][:7], [3])
    mujoco.mj_forward(model, data)
    moment = np.zeros((model.nu, model.nv))
    mujoco.mju_sparse2dense(
        moment,
        data.actuator_moment,
        data.moment_rownnz,
        data.moment_rowadr,
        data.moment_colind,
    )
    for first, second in (("pregrasp_qpos", "grasp_qpos"), ("grasp_qpos", squeeze)):
        for share in np.linspace(0.1, 1.0, 10):
            q = grasp[first] + share * (grasp[second] - grasp[first])
            data.ctrl[:] = moment[:, 6:-6] @ q[7:]
            mujoco.mj_step(model, data, 10)
    data.xfrc_applied[-1, :3] = force
    mujoco.mj_step(model, data, 100)
    return float(np.linalg.norm(data.qpos[-7:-4] - grasp["obj_pose"][:3]))


def test_the_exported_grasp_holds_as_the_benchmark_replays_it(
    exported: tuple[GraspSet, Path],
) -> None:
    _, bench = exported
    for name in ("sphere-0.035", "mug-0.04x0.09"):
        grasp = load(bench / "graspdata" / "allegro_hand" / name / "0.npy")
        hand = bench / "hand" / "allegro_hand" / "allegro_hand.xml"
        model = benchmark_scene(hand, grasp["obj_path"])
        assert model.body("object").mass[0] == pytest.approx(0.1, rel=0.35)  # pieces overlap
        push = np.array([0.0, 0.0, -1.0])
        assert replayed(model, grasp, "squeeze_qpos", push) < 0.01
        # without the squeeze the same push carries the object away
        assert replayed(model, grasp, "grasp_qpos", push) > 0.03


def test_the_squeeze_presses_with_its_forces(exported: tuple[GraspSet, Path]) -> None:
    grasps, bench = exported
    row = grasps[0]
    data = load(bench / "graspdata" / "allegro_hand" / "sphere-0.035" / "0.npy")
    hand = grasps.task(row["object"]).hand
    squeeze = row_squeeze(grasps.task(row["object"]), row)
    # each joint has a servo of 3 N m/rad: the torques of the normal forces, about
    torque = 3.0 * (data["squeeze_qpos"] - data["grasp_qpos"])[7:]
    model, state = hand.mj_model, mujoco.MjData(hand.mj_model)
    state.qpos[:] = data["grasp_qpos"][7:]
    mujoco.mj_forward(model, state)
    T_object_base = pose_from_wxyz(
        np.array(row["base_position_object_m"]), np.array(row["base_quaternion_object_wxyz"])
    )
    points = [T_object_base.actInv(np.array(p)) for p in row["contact_positions_object_m"]]
    normals = T_object_base.rotation.T @ np.array(row["contact_normals_object"]).T
    lift = np.zeros(model.nv)
    fingers = hand.choose_fingers(grasps.task(row["object"]).finger_names)
    for finger, point, normal, force in zip(
        fingers, points, normals.T, squeeze.forces, strict=True
    ):
        jacobian = np.zeros((3, model.nv))
        tip = model.site(finger.tip_frame).bodyid[0]
        mujoco.mj_jac(model, state, jacobian, None, point, tip)
        lift += jacobian.T @ normal * force
        assert torque @ (jacobian.T @ normal) > 0  # presses into the object
    assert np.abs(torque - lift).max() < 0.1 * squeeze.factor  # friction makes the rest


def test_the_shadows_coupled_joints_share_a_command(tmp_path: Path) -> None:
    grasps = plan_grasps("shadow_hand", ["sphere"], 1, workers=1, out=tmp_path / "set")
    export_dexgraspbench(grasps, tmp_path / "bench")
    data = load(tmp_path / "bench" / "graspdata" / "shadow_hand" / "sphere-0.035" / "0.npy")
    hand = grasps.task("sphere:0.035").hand
    assert len(data["grasp_qpos"]) == 7 + hand.nq
    change = (data["squeeze_qpos"] - data["grasp_qpos"])[7:]
    for actuator in hand.actuation.names:
        row = hand.actuation.moment[hand.actuation.names.index(actuator)]
        parts = [
            change[hand.mj_model.joint(hand.joint_names[j]).qposadr[0]] for j in row.nonzero()[0]
        ]
        assert parts == pytest.approx([parts[0]] * len(parts), abs=1e-9)
    described = json.loads((tmp_path / "bench" / "hand" / "shadow_hand.yaml").read_text())
    bodies = [hand.mj_model.body(i).name for i in range(hand.mj_model.nbody)]
    assert set(described["tip_body_name"]) <= set(described["valid_body_name"]) <= set(bodies)
    for prefix, tip in zip(described["finger_prefix"], described["tip_body_name"], strict=True):
        assert tip.startswith(prefix)
    assert len(set(described["finger_prefix"])) == 5


def test_a_hand_on_an_arm_is_not_exported(
    exported: tuple[GraspSet, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    grasps, _ = exported
    task = GraspTask.create(load_hand("allegro_on_arm7"), "sphere")
    monkeypatch.setattr(grasps, "task", lambda label: task)
    with pytest.raises(TaskError, match="on an arm"):
        export_dexgraspbench(grasps, tmp_path)
