"""The second engine: Drake has the same hand, obeys the same commands, and can say no."""

from __future__ import annotations

import builtins
import itertools
import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import mujoco
import numpy as np
import pytest
from conftest import PlanOf
from scipy.spatial import ConvexHull

from planner.errors import FileFormatError, TaskError
from planner.files import write_plan
from planner.objects import parse_object
from planner.plan import GraspPlan
from planner.search.grasp import plan_grasp
from planner.spatial import FloatArray
from planner.task import GraspTask
from sim.cli import main
from sim.protocols import PROTOCOLS, in_all, run_protocol, unsuitable
from sim.protocols.drake import Held, hold_in_drake
from sim.protocols.drake_scene import drake_missing, load_drake_scene
from sim.scene.export import export_scene
from sim.scene.physics import PhysicsOptions

WEIGHT = 0.1 * 9.81


def need_drake() -> None:
    if drake_missing():
        pytest.skip("drake is not installed")


@pytest.fixture(scope="module", params=["allegro_hand", "shadow_hand"])
def plan(request: pytest.FixtureRequest, plan_of: PlanOf) -> GraspPlan:
    return plan_of(request.param, "box")


@pytest.fixture(scope="module")
def folder(plan: GraspPlan, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("export") / "scene"
    export_scene(plan, out)
    return out


@pytest.fixture
def edited(folder: Path, tmp_path: Path) -> Callable[..., Path]:
    """A copy of the export with another physics.json."""

    def edit(change: Callable[[dict[str, Any]], None]) -> Path:
        copy = tmp_path / "edited"
        shutil.copytree(folder, copy)
        told = json.loads((copy / "physics.json").read_text())
        change(told)
        (copy / "physics.json").write_text(json.dumps(told))
        return copy

    return edit


# --- the same hand --------------------------------------------------------------------------------


def test_drake_has_the_mass_matrix_of_mujoco(plan: GraspPlan, folder: Path) -> None:
    """Frames, masses, inertia and armature of every joint at once, at 1e-9."""
    need_drake()
    scene = load_drake_scene(folder)
    context = scene.plant.CreateDefaultContext()
    q = scene.plant.GetPositions(context)
    q[scene.q_index] = plan.q
    scene.plant.SetPositions(context, q)
    theirs = scene.plant.CalcMassMatrix(context)[np.ix_(scene.v_index, scene.v_index)]
    model = mujoco.MjModel.from_xml_path(str(folder / "scene.xml"))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("grasp").id)
    mujoco.mj_forward(model, data)
    whole = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, whole)
    dofs = [int(model.joint(name).dofadr[0]) for name in scene.joints]
    np.testing.assert_allclose(theirs, whole[np.ix_(dofs, dofs)], rtol=0, atol=1e-9)


def test_a_body_with_several_joints_stands_where_mujoco_has_it(tmp_path: Path) -> None:
    """The carriages of two hands, in a posture of all joints."""
    need_drake()
    ball = replace(parse_object("sphere:0.12"), mass=1.0)
    export_scene(plan_grasp(GraspTask.create("two_allegro_hands", ball), seed=0), tmp_path / "two")
    scene = load_drake_scene(tmp_path / "two")
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "two" / "scene.xml"))
    data = mujoco.MjData(model)
    context = scene.plant.CreateDefaultContext()
    q = scene.plant.GetPositions(context)
    posture = np.random.default_rng(0).uniform(-0.5, 0.5, len(scene.joints))
    q[scene.q_index] = posture
    data.qpos[[int(model.joint(name).qposadr[0]) for name in scene.joints]] = posture
    scene.plant.SetPositions(context, q)
    mujoco.mj_kinematics(model, data)
    for name in ("right/carriage", "right/palm", "left/palm", "left/thumb_distal"):
        body = scene.plant.GetBodyByName(f"hand/{name}")
        theirs = scene.plant.EvalBodyPoseInWorld(context, body).GetAsMatrix4()
        ours = data.body(f"hand/{name}")
        np.testing.assert_allclose(theirs[:3, 3], ours.xpos, rtol=0, atol=1e-9)
        np.testing.assert_allclose(theirs[:3, :3], ours.xmat.reshape(3, 3), rtol=0, atol=1e-9)


def test_drake_makes_the_torques_of_the_servos(plan: GraspPlan, folder: Path) -> None:
    """PD laws and explicit torques together are MuJoCo's actuator and spring forces."""
    need_drake()
    scene = load_drake_scene(folder)
    model = mujoco.MjModel.from_xml_path(str(folder / "scene.xml"))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("squeeze").id)
    dofs = [int(model.joint(name).dofadr[0]) for name in scene.joints]
    adr = [int(model.joint(name).qposadr[0]) for name in scene.joints]
    rng = np.random.default_rng(1)
    # bent a little further, so that no stop touches; slow, so that no force range is reached
    q = plan.q + 0.02 * rng.uniform(size=len(adr))
    v = 0.1 * rng.normal(size=len(adr))
    data.qpos[adr], data.qvel[dofs] = q, v
    mujoco.mj_forward(model, data)
    ctrl = {model.actuator(i).name: float(data.ctrl[i]) for i in range(model.nu)}
    commands = np.array([ctrl[name] for name in scene.explicit.names])
    explicit = scene.explicit
    without_stops = type(explicit)(
        **{**vars(explicit), "stops": explicit.stops[:0], "at_least": explicit.at_least[:0]}
    )
    torque = without_stops.torque(q, v, commands)
    for name, (_, factor, offset) in scene.wanted.items():
        actuator = scene.plant.GetJointActuatorByName(name)
        gains = actuator.get_controller_gains()
        k = scene.joints.index(actuator.joint().name())
        wanted = gains.p * (factor * ctrl[name] + offset - q[k]) - gains.d * v[k]
        torque[k] += np.clip(wanted, -actuator.effort_limit(), actuator.effort_limit())
    springs = data.qfrc_spring[dofs]
    np.testing.assert_allclose(torque, data.qfrc_actuator[dofs] + springs, rtol=0, atol=1e-9)


def test_the_same_geoms_may_touch(folder: Path) -> None:
    """Pairs that MuJoCo filters by its bits or as neighbours are not even candidates in Drake."""
    need_drake()
    scene = load_drake_scene(folder)
    graph = scene.simulator.get_system().GetSubsystemByName("scene_graph")
    view = graph.model_inspector()
    theirs = {
        frozenset(view.GetName(g).split("::", 1)[-1] for g in pair)
        for pair in view.GetCollisionCandidates()
    }
    model = mujoco.MjModel.from_xml_path(str(folder / "scene.xml"))
    ours = set()
    excluded = {int(s) for s in model.exclude_signature}
    for a in range(model.ngeom):
        for b in range(a + 1, model.ngeom):
            first, second = sorted((int(model.geom_bodyid[a]), int(model.geom_bodyid[b])))
            roots = model.body_weldid[[first, second]]
            above = model.body_weldid[model.body_parentid[roots]]
            bits = (
                model.geom_contype[a] & model.geom_conaffinity[b]
                or model.geom_contype[b] & model.geom_conaffinity[a]
            )
            neighbours = roots[0] == above[1] or roots[1] == above[0]
            apart = roots[0] == roots[1] or (first << 16) + second in excluded
            if bits and not apart and (not neighbours or 0 in roots):
                ours.add(frozenset((model.geom(a).name, model.geom(b).name)))
    assert theirs == ours


# --- a verdict that can be no ---------------------------------------------------------------------


def test_the_grasp_holds_and_its_contacts_carry_the_weight(folder: Path) -> None:
    need_drake()
    seen = hold_in_drake(folder, seconds=1.0)
    assert seen.held and seen.moved_mm[-1] < 1.0 and seen.turned_deg[-1] < 2.0
    last = seen.touches.moment == len(seen.time) - 1
    np.testing.assert_allclose(
        seen.touches.forces[last].sum(axis=0), [0.0, 0.0, WEIGHT], atol=0.02 * WEIGHT
    )
    pressing = np.einsum("ij,ij->i", seen.touches.forces, seen.touches.normals)
    assert (pressing[last] > 0.1).all()


def test_normals_of_round_contacts_are_those_of_the_shapes(tmp_path: Path) -> None:
    """Drake's point contacts are off by 10 to 40 degrees here, which lets a good grasp go."""
    need_drake()
    plan = plan_grasp(GraspTask.create("shadow_hand", "capsule"), seed=4)
    export_scene(plan, tmp_path / "scene")
    seen = hold_in_drake(tmp_path / "scene", seconds=0.2)
    of_body = plan.task.hand.finger_of_body
    planned = dict(zip(plan.contacts.fingers, plan.contacts.normals, strict=True))
    assert len(seen.touches.bodies) >= 4
    for body, normal in zip(seen.touches.bodies, seen.touches.normals, strict=True):
        finger = of_body[body.removeprefix("hand/")]
        assert normal @ planned[finger] > np.cos(np.deg2rad(6.0))


def test_a_power_grasp_has_its_planned_forces(tmp_path: Path) -> None:
    """Commands of the planned posture left the palm 0.4 of 2.9 N, and the ball flew out."""
    need_drake()
    task = GraspTask.create("allegro_hand", "sphere:0.0264", grasp_type="power")
    plan = plan_grasp(task, seed=29137)
    export_scene(plan, tmp_path / "scene")
    seen = hold_in_drake(tmp_path / "scene", seconds=0.2)
    assert seen.held and seen.moved_mm[-1] < 1.0, seen.detail
    pressing = np.einsum("ij,ij->i", seen.touches.forces, seen.touches.normals)
    last = seen.touches.moment == len(seen.time) - 1
    for part, planned in zip(plan.contacts.fingers, plan.forces.forces[:, 0], strict=True):
        of_part = [part == plan.task.part_of_body[b[5:]] for b in seen.touches.bodies]
        assert pressing[last & of_part].sum() == pytest.approx(planned, rel=0.25)


def test_without_the_squeeze_the_object_falls(edited: Callable[..., Path]) -> None:
    need_drake()

    def loosen(told: dict[str, Any]) -> None:
        keys = told["key_frames"]
        keys["squeeze"]["commands"] = keys["pregrasp"]["commands"]

    seen = hold_in_drake(edited(loosen))
    assert not seen.held
    assert seen.time[-1] < 1.0 and seen.rise_mm[-1] < 0.0


def test_a_push_beyond_the_grip_takes_the_object(folder: Path) -> None:
    need_drake()
    little, much = (
        hold_in_drake(folder, seconds=0.6, wrench=np.array([0.0, 0.0, -force, 0.0, 0.0, 0.0]))
        for force in (0.1, 20.0)
    )
    assert little.held and not much.held
    assert much.pushed_from == 0.3 < much.time[-1] < 0.6


def test_slippery_fingers_lose_it(plan: GraspPlan, tmp_path: Path) -> None:
    """Friction of the scene reaches Drake's contacts."""
    need_drake()
    export_scene(plan, tmp_path / "scene", physics=PhysicsOptions(mu=0.05))
    assert not hold_in_drake(tmp_path / "scene").held


def with_box_of(corners: FloatArray, folder: Path, copy: Path) -> Path:
    """A copy of the export of a box that is now the hull of its corners (n, 3), m."""
    shutil.copytree(folder, copy)
    lines = [f"v {x:.12g} {y:.12g} {z:.12g}" for x, y, z in corners.tolist()]
    faces = ConvexHull(corners, qhull_options="QJ").simplices + 1
    lines += [f"f {a} {b} {c}" for a, b, c in faces.tolist()]
    (copy / "meshes" / "corners.obj").write_text("\n".join(lines) + "\n")
    mjcf = ElementTree.parse(copy / "scene.xml")
    asset = next(iter(mjcf.getroot().iter("asset")), None)
    asset = ElementTree.SubElement(mjcf.getroot(), "asset") if asset is None else asset
    ElementTree.SubElement(asset, "mesh", name="corners", file="meshes/corners.obj")
    (geom,) = [g for g in mjcf.iter("geom") if g.get("type") == "box" and g.get("name") == "object"]
    del geom.attrib["size"]
    geom.attrib |= {"type": "mesh", "mesh": "corners"}
    mjcf.write(copy / "scene.xml")
    return copy


def corners_of(plan: GraspPlan) -> FloatArray:
    signs = np.array(list(itertools.product((-1.0, 1.0), repeat=3)))
    return np.asarray(signs * plan.task.object.shape.half_extents)


def test_a_sliver_of_the_mesh_does_not_keep_drake_from_it(
    plan: GraspPlan, folder: Path, tmp_path: Path
) -> None:
    """Drake cannot fill a box with a corner cut off 3 nm from its end."""
    need_drake()
    if plan.task.hand.name != "allegro_hand":
        pytest.skip("one hand is enough")
    corners = corners_of(plan)
    cut = np.vstack([corners[:7], corners[7] - 3e-9 * np.eye(3)])
    seen = hold_in_drake(with_box_of(cut, folder, tmp_path / "cut"), seconds=0.3)
    assert seen.held, seen.detail


@pytest.mark.slow
def test_a_mesh_that_drake_cannot_fill_ends_its_own_trials_alone(
    plan: GraspPlan, folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    need_drake()
    if plan.task.hand.name != "allegro_hand":
        pytest.skip("one hand is enough")
    needle = corners_of(plan) * np.array([1.0, 1e-7, 1e-7])
    made = with_box_of(needle, folder, tmp_path / "needle")
    with pytest.raises(FileFormatError, match="leave this plan out"):
        load_drake_scene(made)

    def held_but_the_first(export: Path, *, wrench: FloatArray | None) -> Held:
        where = export if wrench is not None and wrench.any() else made
        return hold_in_drake(where, seconds=0.2, wrench=wrench)

    monkeypatch.setattr("sim.protocols.drake.hold_in_drake", held_but_the_first)
    file = tmp_path / "trials.jsonl"
    report = run_protocol(plan, "drake", only=["hold", "push +x"], file=file)
    first, second = report.outcomes
    assert (first.reason, second.reason) == ("not run", "") and second.held and not first.held
    assert not report.success and "degenerate" in first.to_row()["detail"]
    assert len(file.read_text().splitlines()) == 2 and "not run" in str(report)


def test_a_folder_that_is_no_export_is_refused(tmp_path: Path) -> None:
    need_drake()
    with pytest.raises(FileFormatError, match="is no exported scene"):
        hold_in_drake(tmp_path)
    (tmp_path / "physics.json").write_text("{}")
    (tmp_path / "scene.xml").write_text("<mujoco>")
    with pytest.raises(FileFormatError, match="is no exported scene"):
        hold_in_drake(tmp_path)


# --- the protocol ---------------------------------------------------------------------------------


@pytest.mark.slow
def test_the_protocol_judges_the_contacts_of_drake(plan: GraspPlan) -> None:
    need_drake()
    report = run_protocol(plan, "drake", only=["push +x"])
    (push,) = report.outcomes
    assert report.success and push.name == "push +x"
    assert push.share_closed == 1.0
    assert 0.05 < push.largest_utilisation <= 1.0
    assert (push.samples.normal_force[-1] > 0.1).all()
    assert push.load[0] == 0.0 and push.load[-1] == pytest.approx(WEIGHT / 2)
    assert "physics: Drake (0.001 s" in " ".join(str(report).split())
    json.dumps(report.to_dict(), allow_nan=False)


def test_without_the_package_it_says_what_to_install(
    plan: GraspPlan, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any
) -> None:
    there = builtins.__import__

    def missing(name: str, *args: Any, **kwargs: Any) -> Any:
        if name.startswith("pydrake"):
            raise ImportError(name)
        return there(name, *args, **kwargs)

    monkeypatch.setattr(builtins, "__import__", missing)
    with pytest.raises(TaskError, match=r'not installed: pip install "opposable\[drake\]"'):
        run_protocol(plan, "drake")
    write_plan(plan, tmp_path / "plan.json")
    with pytest.raises(SystemExit) as ended:
        main(["test", str(tmp_path / "plan.json"), "--protocol", "drake", "--out", str(tmp_path)])
    assert ended.value.code not in (0, 1)
    assert 'pip install "opposable[drake]"' in " ".join(capsys.readouterr().err.split())


def test_it_is_run_by_its_name_alone() -> None:
    assert "drake" in PROTOCOLS and "drake" not in in_all()
    of_motors = GraspTask.create("shadow_hand_torque", "sphere")
    assert "are no position servos; use the protocol forces" in unsuitable("drake", of_motors)


@pytest.mark.slow
def test_the_benchmark_counts_both_engines() -> None:
    need_drake()
    from benching import run_bench

    from benchmarks.drake import tables

    result = run_bench("drake", hands=["allegro_hand"], objects="sphere", n=1)
    (row,) = result["rows"]
    assert row["mujoco_held"] and row["drake_held"] and row["reason"] == ""
    lost = {**row, "drake_held": False, "both": False, "reason": "after 0.1 s it had moved"}
    table, told = tables({**result, "rows": [row, lost]})
    assert told == "allegro_hand sphere seed 0: after 0.1 s it had moved"
    assert isinstance(table, dict)
    assert table["rows"][-1][2:6] == ["2/2", "2/2", "1/2", "1/2"]
