"""The verdict on given grasps: good ones pass, faults are found, MuJoCo and SciPy agree."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
import trimesh
from scipy.optimize import linprog

from benchmarks.audit import FAULTS, judged_with_fault
from planner.collision.pad_contact import PadContact
from planner.errors import FileFormatError, PlannerError, TaskError
from planner.exchange.audit import (
    AuditRow,
    StageResult,
    audit_file,
    audit_grasps,
    audit_plans,
    plans_as_imported,
    scaled_object,
)
from planner.exchange.audit.judge import Judge, _gap
from planner.exchange.formats import ImportedGrasp, ImportedGrasps, Reading, Writing
from planner.exchange.table import read_table, write_table
from planner.hand_loading import load_hand
from planner.hands.hand import Hand
from planner.objects import parse_object
from planner.plan import GraspPlan
from planner.search.grasp import plan_grasp
from planner.spatial import SE3, FloatArray, pose_from_wxyz, pose_to_wxyz
from planner.task import GraspTask
from planner.verification import verify_grasp

BOX = "box:0.05x0.05x0.08"

Good = tuple[GraspTask, list[GraspPlan], ImportedGrasps]


def _good(hand: str, spec: str, count: int, folder: Path) -> Good:
    """Plans, and what a reader makes of their table."""
    task = GraspTask.create(hand, spec)
    plans = [plan_grasp(task, seed=seed) for seed in range(count)]
    (path,) = write_table(plans, folder / f"{hand}.csv", Writing())
    return task, plans, read_table(path, task.hand, Reading())


@pytest.fixture(scope="module")
def good(tmp_path_factory: pytest.TempPathFactory) -> Good:
    return _good("allegro_hand", BOX, 5, tmp_path_factory.mktemp("good"))


@pytest.fixture(scope="module")
def good_shadow(tmp_path_factory: pytest.TempPathFactory) -> Good:
    return _good("shadow_hand", "mug", 3, tmp_path_factory.mktemp("shadow"))


@pytest.mark.slow
@pytest.mark.parametrize("which", ["good", "good_shadow"])
def test_our_own_plans_pass_as_plans_and_as_foreign_grasps(
    which: str, request: pytest.FixtureRequest
) -> None:
    task, plans, given = request.getfixturevalue(which)
    foreign = audit_grasps(task, given, approach=True)
    assert foreign.ok, foreign.summary
    own = audit_plans(plans, Path("plans"), approach=True)
    assert own.ok and len(own) == len(plans)
    for one, other, plan in zip(foreign.rows, own.rows, plans, strict=True):
        assert set(plan.task.finger_names) <= set(one.fingers)
        assert other.fingers == plan.task.finger_names
        weight = plan.quality.closure.normalised_min_weight
        assert other.stages["closure"].number == pytest.approx(weight, abs=1e-6)


@pytest.mark.parametrize("name", list(FAULTS))
@pytest.mark.parametrize("which", ["good", "good_shadow"])
def test_known_faults_are_found_by_their_stage(
    name: str, which: str, request: pytest.FixtureRequest
) -> None:
    _, plans, given = request.getfixturevalue(which)
    for plan, grasp in zip(plans, given.grasps, strict=True):
        row, noticed = judged_with_fault(name, plan.task, grasp)
        assert noticed and not row.passed, row.to_dict()
        assert row.reason


@pytest.mark.parametrize("name", ["gap", "penetration", "no closure", "torque limit"])
def test_a_fault_is_found_by_its_stage_first(name: str, good: Good) -> None:
    """So the reasons are those that were put in, and no others before them."""
    _, plans, given = good
    (stage,) = FAULTS[name].stages
    for plan, grasp in zip(plans, given.grasps, strict=True):
        row, _ = judged_with_fault(name, plan.task, grasp)
        assert row.first_fault == stage
        failed = [n for n, result in row.stages.items() if result.passed is False]
        assert failed == [stage] or name == "penetration", row.reason


@pytest.mark.slow
def test_the_verdict_is_that_on_our_own_plans(good: Good) -> None:
    """Stage by stage or at once: the same grasps pass ``verify_grasp``."""
    _, plans, given = good
    record = plans[0].record
    for name in ("", *FAULTS):
        for plan, grasp in zip(plans, given.grasps, strict=True):
            fault = FAULTS.get(name)
            made = grasp if fault is None else fault.grasp(grasp, plan.task)
            asked = plan.task if fault is None else fault.task(plan.task)
            row = Judge(asked, fixed_fingers=True, approach=True).row(made)
            base = asked.T_world_object * made.T_object_base
            plain = verify_grasp(asked, base, made.q, record=record)
            assert row.passed == isinstance(plain, GraspPlan), (name, row.reason)


def test_the_gap_is_how_tolerant_one_would_have_to_be(good: Good) -> None:
    _, plans, given = good
    row, _ = judged_with_fault("gap", plans[0].task, given.grasps[0])
    gaps = sorted(abs(v) for v in row.gaps_mm.values())
    needed = plans[0].task.fingers_needed
    assert row.stages["gap"].number == pytest.approx(gaps[needed - 1])
    assert gaps[needed - 1] > 0.5


def _moved(grasp: ImportedGrasp, turn: FloatArray) -> ImportedGrasp:
    """The same grasp with hand and object turned together in the world."""
    assert grasp.T_world_object is not None
    by = pose_from_wxyz(np.array([0.3, -0.2, 0.5]), turn)
    return replace(grasp, T_world_object=by * grasp.T_world_object)


def test_gravity_pulls_as_the_file_has_the_object(good: Good) -> None:
    """A turned scene has the same forces as a task whose gravity is turned back."""
    task, _, given = good
    free = replace(task, table_height=None)
    turn = np.array([0.5, 0.5, -0.5, 0.5])
    for grasp in given.grasps:
        moved = _moved(grasp, turn)
        row = Judge(free).row(moved)
        asked = Judge(free).task_of(moved, row.fingers)
        rotation = pose_from_wxyz(np.zeros(3), turn).rotation
        np.testing.assert_allclose(asked.gravity, rotation.T @ task.gravity, atol=1e-12)
        assert Judge(free).row(grasp).stages["gap"] == row.stages["gap"]


# What follows shares nothing with the verdict: MuJoCo has the geometry, SciPy the programmes.


class Witness:
    """A hand and a box in MuJoCo, without this package's kinematics, distances or programmes."""

    def __init__(self, hand: Hand, size: FloatArray) -> None:
        """Compile both in one model."""
        spec = hand.new_spec()
        body = spec.worldbody.add_body(name="box", mocap=True)
        body.add_geom(name="box", type=mujoco.mjtGeom.mjGEOM_BOX, size=size / 2)
        self.model = spec.compile()
        self.data = mujoco.MjData(self.model)
        self.hand = hand

    def place(self, grasp: ImportedGrasp) -> None:
        """Put the box where the hand's base has it."""
        for name, value in zip(self.hand.joint_names, grasp.q, strict=True):
            self.data.qpos[self.model.joint(name).qposadr[0]] = value
        mujoco.mj_forward(self.model, self.data)
        base = self.data.body(self.hand.description.base_body)
        T_world_base = SE3(base.xmat.reshape(3, 3).copy(), base.xpos.copy())
        pose = T_world_base * grasp.T_object_base.inverse()
        quaternion = np.zeros(4)
        mujoco.mju_mat2Quat(quaternion, pose.rotation.ravel().copy())
        self.data.mocap_pos[0], self.data.mocap_quat[0] = pose.translation, quaternion
        mujoco.mj_forward(self.model, self.data)

    def distance(self, geom: str) -> tuple[float, FloatArray, FloatArray]:
        """Signed distance (m), contact point, and normal into the box."""
        fromto = np.zeros(6)
        ids = self.model.geom(geom).id, self.model.geom("box").id
        found = mujoco.mj_geomDistance(self.model, self.data, *ids, 0.5, fromto)
        centre = self.data.geom("box")
        local = centre.xmat.reshape(3, 3).T @ (fromto[3:] - centre.xpos)
        axis = int(np.argmax(np.abs(local) / self.model.geom("box").size))
        normal = np.zeros(3)
        normal[axis] = -np.sign(local[axis])
        return float(found), fromto[3:].copy(), centre.xmat.reshape(3, 3) @ normal

    def forces_exist(
        self,
        touches: list[tuple[str, FloatArray, FloatArray]],
        *,
        mu: float,
        grip: float,
        weight: FloatArray,
        centre: FloatArray,
        limits: bool,
        sides: int = 16,
    ) -> bool:
        """Whether forces in inscribed pyramids balance a weight, within what the servos give."""
        rays, generators, torques = [], [], []
        for geom, point, normal in touches:
            tangent = np.cross(normal, np.eye(3)[int(np.argmin(np.abs(normal)))])
            tangent /= np.linalg.norm(tangent)
            other = np.cross(normal, tangent)
            jacobian = np.zeros((3, self.model.nv))
            body = self.model.geom(geom).bodyid[0]
            mujoco.mj_jac(self.model, self.data, jacobian, None, point, body)
            for angle in 2 * np.pi * np.arange(sides) / sides:
                ray = normal + mu * (np.cos(angle) * tangent + np.sin(angle) * other)
                rays.append(ray)
                generators.append(np.concatenate([ray, np.cross(point - centre, ray)]))
                torques.append(jacobian.T @ ray)
        n = len(touches)
        equal, balance = np.array(generators).T, -np.concatenate([weight, np.zeros(3)])
        upper = [np.kron(np.eye(n)[i], -np.ones(sides)) for i in range(n)]
        most = [-grip] * n
        if limits:
            low, high = self._servos()
            hold = np.array(torques).T  # the fingers press on the object: they must give this
            upper += [*hold, *-hold]
            most += [*high, *-low]
        found = linprog(
            np.zeros(equal.shape[1]), A_ub=np.array(upper), b_ub=most, A_eq=equal, b_eq=balance
        )
        return bool(found.success)

    def _servos(self) -> tuple[FloatArray, FloatArray]:
        """Least and most joint torques (nv,) of position servos, one for each joint."""
        model, low, high = self.model, np.zeros(self.model.nv), np.zeros(self.model.nv)
        for i in range(model.nu):
            joint = model.actuator_trnid[i, 0]
            dof, q = model.jnt_dofadr[joint], self.data.qpos[model.jnt_qposadr[joint]]
            ends = model.actuator_gainprm[i, 0] * model.actuator_ctrlrange[i]
            ends = ends + model.actuator_biasprm[i, 1] * q
            if model.actuator_forcelimited[i]:
                ends = np.clip(ends, *model.actuator_forcerange[i])
            low[dof], high[dof] = np.sort(ends * model.actuator_gear[i, 0])
        return low, high

    def closes(self, touches: list[tuple[str, FloatArray, FloatArray]], mu: float) -> bool:
        """Whether positive combinations of friction rays make every wrench."""
        centre = np.mean([point for _, point, _ in touches], axis=0)
        length = 0.05
        columns = []
        for _, point, normal in touches:
            tangent = np.cross(normal, np.eye(3)[int(np.argmin(np.abs(normal)))])
            tangent /= np.linalg.norm(tangent)
            other = np.cross(normal, tangent)
            for angle in 2 * np.pi * np.arange(16) / 16:
                ray = normal + mu * (np.cos(angle) * tangent + np.sin(angle) * other)
                columns.append(np.concatenate([ray, np.cross(point - centre, ray) / length]))
        wrenches = np.array(columns).T
        count = wrenches.shape[1]
        # most l with W a = 0, a >= l, sum a = 1
        equal = np.vstack([np.hstack([wrenches, np.zeros((6, 1))]), np.append(np.ones(count), 0.0)])
        above = np.hstack([-np.eye(count), np.ones((count, 1))])
        found = linprog(
            np.append(np.zeros(count), -1.0),
            A_ub=above,
            b_ub=np.zeros(count),
            A_eq=equal,
            b_eq=np.append(np.zeros(6), 1.0),
            bounds=[(0, None)] * count + [(None, None)],
        )
        rank = int(np.linalg.matrix_rank(wrenches, tol=1e-9))
        return bool(found.success and -found.fun > 1e-7 and rank == 6)


def _agrees(witness: Witness, grasp: ImportedGrasp, task: GraspTask, row: AuditRow) -> set[str]:
    """Compare a row with the witness; names of the stages that it judged."""
    witness.place(grasp)
    hand = task.hand
    pads = {name: hand.fingers[name].pad.geom for name in hand.fingers}
    found = {name: witness.distance(geom) for name, geom in pads.items()}
    for name, (gap, _, _) in found.items():
        if gap > -0.002:  # coal and MuJoCo define depths of more differently
            assert row.gaps_mm[name] == pytest.approx(1e3 * gap, abs=0.05), name
    others = [g.name for g in hand.geometries if g.name not in [pads[n] for n in row.fingers]]
    depth = min(witness.distance(name)[0] for name in others)
    pads_deep = min(found[name][0] for name in row.fingers)
    clear = row.stages["penetration"].passed
    if clear:
        assert depth > -1e-4 and pads_deep > -6e-4
    touches = [(pads[name], *found[name][1:]) for name in row.fingers]
    judged = {"gap", "penetration"}
    wide = max(found[name][0] for name in row.fingers)
    assert row.stages["gap"].passed == (wide <= 5e-4)
    if row.stages["closure"].passed is not None:
        judged.add("closure")
        assert row.stages["closure"].passed == witness.closes(touches, task.mu)
    if row.stages["forces"].passed is not None:
        judged.add("forces")
        box = witness.data.geom("box")
        # gravity in MuJoCo's world, where the box is turned with the hand's base
        upright = box.xmat.reshape(3, 3) @ task.T_world_object.rotation.T
        weight = task.object.mass * (upright @ task.gravity)
        exists = witness.forces_exist(
            touches,
            mu=0.8 * task.mu,
            grip=task.grip_force,
            weight=weight,
            centre=box.xpos.copy(),
            limits=True,
        )
        assert row.stages["forces"].passed == exists
    return judged


def test_mujoco_and_scipy_agree_on_good_and_faulty_grasps(good: Good) -> None:
    task, plans, given = good
    witness = Witness(task.hand, np.array([0.05, 0.05, 0.08]))
    seen: dict[str, set[str]] = {}
    for name in ("", "gap", "penetration", "no closure", "torque limit"):
        for plan, grasp in zip(plans, given.grasps, strict=True):
            fault = FAULTS.get(name)
            made = grasp if fault is None else fault.grasp(grasp, plan.task)
            asked = plan.task if fault is None else fault.task(plan.task)
            row = Judge(asked).row(made)
            seen.setdefault(name, set()).update(_agrees(witness, made, asked, row))
    assert "forces" in seen[""] & seen["torque limit"]
    assert "closure" in seen["no closure"]


# Files that are read in another way than they were written.


@pytest.mark.parametrize(
    ("write", "read", "said"),
    [
        ({"unit": 1e3}, Reading(), "give --unit mm"),
        ({}, Reading(unit=1e-3), "give --unit m"),
        ({"order": [1, 2, 3, 0]}, Reading(), "give --quaternion xyzw"),
        ({}, Reading(quaternion="xyzw"), "give --quaternion wxyz"),
    ],
)
def test_another_unit_or_order_is_named(
    good: Good, tmp_path: Path, write: Mapping[str, Any], read: Reading, said: str
) -> None:
    task, _, given = good
    rows = list(csv.reader(given.source.read_text().splitlines()))
    x, w = rows[0].index("x_m"), rows[0].index("qw")
    for row in rows[1:]:
        row[x : x + 3] = [repr(float(v) * write.get("unit", 1.0)) for v in row[x : x + 3]]
        row[w : w + 4] = [row[w + i] for i in write.get("order", range(4))]
    path = tmp_path / "a.csv"
    path.write_text("\n".join(",".join(row) for row in rows) + "\n")
    with pytest.raises(FileFormatError, match=said):
        audit_file(path, lambda hand: _for(task, hand), task.hand, reading=read)


def _for(task: GraspTask, hand: Hand) -> GraspTask:
    return GraspTask.create(hand, task.object, table_height=None)


def test_inverted_poses_are_named(good: Good, tmp_path: Path) -> None:
    task, _, given = good
    rows = list(csv.reader(given.source.read_text().splitlines()))
    x, w = rows[0].index("x_m"), rows[0].index("qw")
    for row in rows[1:]:
        pose = pose_from_wxyz(np.array(row[x : x + 3], float), np.array(row[w : w + 4], float))
        position, quat = pose_to_wxyz(pose.inverse())
        row[x : x + 3] = [repr(float(v)) for v in position]
        row[w : w + 4] = [repr(float(v)) for v in quat]
    path = tmp_path / "a.csv"
    path.write_text("\n".join(",".join(row) for row in rows) + "\n")
    with pytest.raises(FileFormatError, match="with the inverse of each pose"):
        audit_file(path, lambda hand: _for(task, hand), task.hand)


def test_a_file_that_mixes_hands_is_named(good: Good, tmp_path: Path) -> None:
    """Half of its rows are of the left hand, mirrored grasps: each passes with its own hand."""
    task, _, given = good
    left = load_hand("allegro_hand_left")
    plans = [plan_grasp(_for(task, left), seed=seed) for seed in range(len(given))]
    write_table(plans, tmp_path / "left.csv", Writing())
    head, *mine = given.source.read_text().splitlines()
    _, *theirs = (tmp_path / "left.csv").read_text().splitlines()
    both = "\n".join([head, *mine, *theirs]) + "\n"
    path = tmp_path / "both.csv"
    path.write_text(both.replace("allegro_hand_left", "").replace("allegro_hand", ""))
    with pytest.raises(FileFormatError, match=r"mixes hands: .* allegro_hand_left"):
        audit_file(path, lambda hand: _for(task, hand), task.hand)


def test_the_other_hand_is_named(good: Good, tmp_path: Path) -> None:
    task, _, given = good
    path = tmp_path / "a.csv"
    path.write_text(given.source.read_text().replace("allegro_hand", ""))  # it says no hand
    with pytest.raises(FileFormatError, match="give --hand allegro_hand"):
        audit_file(path, lambda hand: _for(task, hand), load_hand("allegro_hand_left"))
    report = audit_file(path, lambda hand: _for(task, hand), task.hand)
    assert report.ok


def test_bad_grasps_are_not_taken_for_another_reading(good: Good, tmp_path: Path) -> None:
    """Grasps that are wrong by some millimetres are judged, not refused."""
    task, plans, _ = good
    worse = [replace(p, q=p.q + 0.3 * (p.q_pregrasp - p.q)) for p in plans]
    (path,) = write_table(worse, tmp_path / "a.csv", Writing())
    report = audit_file(path, lambda hand: _for(task, hand), task.hand)
    assert report.passed == 0 and report.complete


def test_several_objects_need_a_choice(good: Good, tmp_path: Path) -> None:
    task, plans, _ = good
    (path,) = write_table(plans, tmp_path / "a.csv", Writing())
    lines = path.read_text().splitlines()
    lines[1] = lines[1].replace(BOX, "other")
    path.write_text("\n".join(lines) + "\n")

    def run(only: str) -> int:
        return len(audit_file(path, lambda hand: _for(task, hand), task.hand, only=only))

    with pytest.raises(FileFormatError, match=r"grasps of 2 objects.*--only"):
        run("")
    assert (run("other"), run("box")) == (1, len(plans) - 1)
    with pytest.raises(TaskError, match=r"no object of .* has 'cup' in its name"):
        run("cup")


def test_poses_are_in_the_frame_of_the_objects_own_file(tmp_path: Path) -> None:
    """The origin of this file is not the centre of mass."""
    mesh = trimesh.creation.box((0.05, 0.05, 0.08))
    away = np.array([0.02, 0.01, 0.03])
    mesh.apply_translation(away)
    mesh.export(tmp_path / "box.stl")
    task = GraspTask.create("allegro_hand", str(tmp_path / "box.stl"))
    plan = plan_grasp(task, seed=0)
    (path,) = write_table([plan], tmp_path / "a.csv", Writing())
    given = read_table(path, task.hand, Reading())
    in_ours = task.T_world_object.inverse() * plan.T_world_base
    moved = given.grasps[0].T_object_base.translation - in_ours.translation
    np.testing.assert_allclose(moved, away, atol=1e-6)
    assert audit_grasps(task, given).ok
    assert audit_plans([plan], path).ok


def test_scale_multiplies_the_object() -> None:
    box = scaled_object(parse_object(BOX), 2.0)
    np.testing.assert_allclose(box.shape.half_extents, [0.05, 0.05, 0.08])
    mug = parse_object("mug")
    np.testing.assert_allclose(
        scaled_object(mug, 0.5).shape.half_extents, mug.shape.half_extents / 2
    )
    with pytest.raises(TaskError, match="cannot be scaled; give the mesh file"):
        scaled_object(parse_object("superquadric"), 1.1)


def test_a_grasp_of_a_scaled_object_passes_at_that_scale(good: Good) -> None:
    """The plan's box is the unit box of half the size, scaled by two."""
    task, _, given = good
    half = scaled_object(task.object, 0.5)
    small = replace(task, object=half, table_height=None)
    twice = replace(given, grasps=tuple(replace(g, scale=2.0) for g in given.grasps))
    assert audit_grasps(small, twice).ok
    assert audit_grasps(small, given).passed == 0


# Workers, interruption and files.


def test_workers_give_the_same_rows(good: Good, monkeypatch: pytest.MonkeyPatch) -> None:
    task, _, given = good
    monkeypatch.setattr("planner.exchange.audit.run.FEW", 0)
    many = replace(given, grasps=given.grasps * 8)
    alone = audit_grasps(task, many)
    shared = audit_grasps(task, many, workers=2)
    assert [r.to_dict() for r in alone.rows] == [r.to_dict() for r in shared.rows]


def test_a_grasp_that_cannot_be_judged_ends_itself_alone(
    good: Good, monkeypatch: pytest.MonkeyPatch
) -> None:
    row, asked = Judge.row, []

    def fails_once(self: Judge, grasp: ImportedGrasp, index: int = 0, source: str = "") -> AuditRow:
        asked.append(index)
        if index == 0:
            raise PlannerError("no solver decides it")
        return row(self, grasp, index, source)

    monkeypatch.setattr(Judge, "row", fails_once)
    task, _, several = good
    given = replace(several, grasps=several.grasps[:1] * 2)
    report = audit_grasps(task, given, fixed_fingers=True)
    first, second = report.rows
    assert asked == [0, 1] and second.passed and not first.passed and not report.ok
    assert first.stages["joints"].reason == "no solver decides it"


def test_ctrl_c_keeps_the_rows(good: Good, tmp_path: Path) -> None:
    task, _, given = good

    def press(row: AuditRow) -> None:
        if row.index == 2:
            raise KeyboardInterrupt

    report = audit_grasps(task, given, progress=press)
    assert (len(report), report.complete, report.ok) == (3, False, False)
    assert "2 were not judged" in report.summary
    report.write(tmp_path / "a.csv")
    assert len((tmp_path / "a.csv").read_text().splitlines()) == 4


def test_rows_are_written_and_read_by_others(good: Good, tmp_path: Path) -> None:
    parquet = pytest.importorskip("pyarrow.parquet")
    task, plans, given = good
    worse = replace(given, grasps=(*given.grasps, FAULTS["gap"].grasp(given.grasps[0], task)))
    report = audit_grasps(task, worse, execute=lambda task, grasp: StageResult(passed=True))
    for name in ("a.csv", "a.parquet"):
        report.write(tmp_path / name)
    rows = parquet.read_table(tmp_path / "a.parquet").to_pylist()
    told = list(csv.DictReader((tmp_path / "a.csv").read_text().splitlines()))
    assert [r["passed"] for r in rows] == [True] * len(plans) + [False]
    assert [r["first_fault"] for r in told] == [""] * len(plans) + ["gap"]
    assert rows[-1]["closure"] is None and rows[-1]["held"] is True
    # the row of a grasp whose process died has no stage but the first
    lost = AuditRow(index=0, name="x", stages={"joints": StageResult(passed=None, reason="died")})
    replace(report, rows=(lost, *report.rows)).write(tmp_path / "b.csv")
    told = list(csv.DictReader((tmp_path / "b.csv").read_text().splitlines()))
    assert (told[0]["passed"], told[0]["gap"], told[1]["gap"]) == ("False", "", "True")
    with pytest.raises(TaskError, match=r"rows are written as \.csv or \.parquet"):
        report.write(tmp_path / "a.xlsx")


def test_a_plan_goes_through_the_same_door(good: Good) -> None:
    _, plans, _ = good
    for task, given in plans_as_imported(plans, Path("x")):
        assert audit_grasps(task, given, fixed_fingers=True).ok
    with pytest.raises(TaskError, match="nothing to join"):
        audit_plans([], Path("x"))


@pytest.mark.parametrize(("pad", "carrier"), [(-0.002, 0.0005), (0.0005, -0.002)])
def test_the_gap_of_a_contact_is_the_farther_off_of_pad_and_carrier(
    pad: float, carrier: float
) -> None:
    """Two millimetres deep is farther off than half a millimetre apart, whichever it is."""
    touch = PadContact(
        sphere_gap=pad,
        gap=carrier,
        round=True,
        point=np.zeros(3),
        outward=np.array([0.0, 0.0, 1.0]),
        angle=0.0,
    )
    assert _gap(touch) == -0.002
