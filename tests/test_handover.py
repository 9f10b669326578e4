"""Handing an object from one hand to the other: three grasps, the ways between, the trial."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planner import GraspTask, load_hand
from planner.collision.world import CollisionWorld
from planner.contacts import ContactSet
from planner.errors import FileFormatError, NoGraspFoundError, PlannerError, TaskError
from planner.failure import Failure
from planner.files import read_movement, write_movement
from planner.files.handovers import HandoverData
from planner.files.movements import _other, movement_from_dict, movement_to_dict
from planner.motion.handover import plan_handover, put_together
from planner.motion.phase import Handover
from planner.motion.plan import ManipulationPlan, MovementPlan
from planner.pages.blocks import Folded, Table
from planner.pages.motion_page import motion_page, object_motion
from planner.plan import GraspPlan
from planner.spatial import SE3, FloatArray
from planner.system.package import models_dir
from sim import Timeline, manipulate
from sim.cli import main
from sim.cli.execution import trial_of
from sim.cli.reading import one_plan, plan_to_test
from sim.controllers import Observation
from sim.controllers.base import PadReading
from sim.handover import (
    HANDOVER_PHASES,
    HandoverTimeline,
    HandoverTrial,
    _seen,
    hand_over,
    judge_handover,
)
from sim.report import TrialReport
from sim.report_file import ReportFile
from sim.show.trial_page import trial_page
from sim.verdict import Thresholds

pytestmark = pytest.mark.usefixtures("coarse_steps")

GRAVITY = 9.81
QUICK = HandoverTimeline.quick(lift=1.0, reach=0.8, transfer=0.5, open=0.3, retreat=0.6, hold=0.5)


def refused(word: str) -> pytest.RaisesExc[PlannerError]:
    return pytest.raises(PlannerError, match=word)


@pytest.fixture(scope="module")
def movement() -> ManipulationPlan:
    return plan_handover(GraspTask.create("two_allegro_hands", "box:0.06x0.06x0.16"), seed=0)


@pytest.fixture(scope="module")
def give(movement: ManipulationPlan) -> GraspPlan:
    return movement.grasp


@pytest.fixture(scope="module")
def plan(movement: ManipulationPlan) -> Handover:
    assert movement.handover is not None
    return movement.handover


@pytest.fixture(scope="module")
def report(movement: ManipulationPlan) -> TrialReport:
    return hand_over(movement, timeline=QUICK)


class Pair:
    """MuJoCo's own model of a pair, its base at a pose."""

    def __init__(self, plan: Handover) -> None:
        """Load it."""
        self.model = plan.task.hand.mj_model
        self.data = mujoco.MjData(self.model)
        self._pose = plan.both.T_world_base

    def put(self, q: FloatArray) -> None:
        self.data.qpos[:] = q
        mujoco.mj_forward(self.model, self.data)

    def body(self, name: str) -> SE3:
        body = self.data.body(name)
        return self._pose * SE3(body.xmat.reshape(3, 3).copy(), body.xpos.copy())

    def geoms(self, side: str) -> list[int]:
        return [
            i
            for i in range(self.model.ngeom)
            if self.model.geom(i).name.startswith(f"{side}/") and self.model.geom_contype[i]
        ]

    def apart(self, side: str, other: str) -> float:
        """Least distance (m) of two hands, by MuJoCo."""
        return min(
            float(mujoco.mj_geomDistance(self.model, self.data, a, b, 0.05, None))
            for a in self.geoms(side)
            for b in self.geoms(other)
        )


def test_carriages_bring_both_hands_where_they_grasp_alone(plan: Handover) -> None:
    pair = Pair(plan)
    pair.put(plan.both.q)
    for side, alone in zip((plan.giver, plan.taker), plan.alone, strict=True):
        base = alone.task.hand.description.base_body
        off = pair.body(f"{side}/{base}").actInv(alone.T_world_base)
        assert np.allclose(off.homogeneous, np.eye(4), atol=1e-8)


def test_hands_come_and_go_as_when_alone(plan: Handover) -> None:
    """The carriages move them as far, and in the direction, in which each alone comes in."""
    pair, (give, take) = Pair(plan), plan.alone
    for q, side, alone in (
        (plan.way_in[1], plan.taker, take),
        (plan.way_out[-1], plan.giver, give),
    ):
        pair.put(q)
        base = pair.body(f"{side}/{alone.task.hand.description.base_body}")
        assert np.allclose(base.homogeneous, alone.T_world_base_start.homogeneous, atol=1e-8)


def test_weak_carriages_take_nothing(plan: Handover, tmp_path: Path) -> None:
    text = (models_dir() / "hands/two_allegro_hands/hand.toml").read_text()
    hands = models_dir() / "hands"
    file = tmp_path / "hand.toml"
    file.write_text(text.replace('"../', f'"{hands.as_posix()}/') + "\n[carriage]\nforce = 3.0\n")
    task = GraspTask.create(load_hand(file), plan.task.object)
    found = put_together(task, *plan.alone, to="left", lift_height=plan.lift_height)
    assert isinstance(found, Failure)
    assert found.kind == "no_forces"


def test_each_hand_holds_alone_and_any_blend_of_their_forces_holds(
    plan: Handover, give: GraspPlan
) -> None:
    given, take = give.contacts, plan.take.contacts
    weight = plan.task.object.mass * GRAVITY
    center = plan.task.T_world_object.translation
    for share in np.linspace(0.0, 1.0, 6):
        total = np.zeros(6)
        for contacts, part in ((given, 1.0 - share), (take, share)):
            forces = part * contacts.forces_in_axes()
            arms = contacts.positions - center
            total[:3] += forces.sum(axis=0)
            total[3:] += np.cross(arms, forces).sum(axis=0)
            normal = (forces * contacts.normals).sum(axis=1)
            along = np.linalg.norm(forces - normal[:, None] * contacts.normals, axis=1)
            assert (along <= plan.task.mu * normal + 1e-9).all()
        assert np.allclose(total, [0, 0, weight, 0, 0, 0], atol=1e-6)


def test_motors_bear_the_forces_of_both(plan: Handover, give: GraspPlan) -> None:
    """By MuJoCo's Jacobians: torques J^T f and the hands' weight, within the actuators' limits."""
    pair, hand = Pair(plan), plan.task.hand
    model, data = pair.model, pair.data
    pair.put(plan.take.q)
    turn = give.T_world_base.rotation
    low, high = hand.actuation.torque_limits(plan.take.q).T
    for share in (0.0, 0.5, 1.0):
        torque = np.zeros(hand.nq)
        for grasp, part in ((give, 1.0 - share), (plan.take, share)):
            points = grasp.contacts.positions - give.T_world_base.translation
            for finger, point, force in zip(
                grasp.task.fingers, points @ turn, grasp.contacts.forces_in_axes(), strict=True
            ):
                jacobian = np.zeros((3, model.nv))
                body = int(model.geom(finger.pad.geom).bodyid[0])
                mujoco.mj_jac(model, data, jacobian, None, point, body)
                torque += part * jacobian.T @ (turn.T @ force)
        for body in range(1, model.nbody):
            jacobian = np.zeros((3, model.nv))
            mujoco.mj_jacBodyCom(model, data, jacobian, None, body)
            torque += model.body_mass[body] * GRAVITY * jacobian.T @ turn.T @ [0.0, 0.0, 1.0]
        assert (torque >= low - 1e-6).all()
        assert (torque <= high + 1e-6).all()


def test_hands_keep_apart_on_their_ways(plan: Handover) -> None:
    """By MuJoCo's distances; the ways are straight between their points."""
    pair = Pair(plan)
    for way in (plan.way_in, np.vstack([plan.take.q, plan.way_out])):
        for begin, end in pairwise(way):
            for share in np.linspace(0.0, 1.0, 9):
                pair.put(begin + share * (end - begin))
                assert pair.apart(plan.giver, plan.taker) > 5e-4


def test_the_taking_hand_waits_above_the_table(plan: Handover, give: GraspPlan) -> None:
    world = CollisionWorld(give.task)
    names = frozenset(g.name for g in plan.task.hand.geometries if g.name.startswith("left/"))
    for pose in (give.T_world_base, give.T_world_base_start):
        assert world.nearest_of(pose, give.q, names).distance >= 0.01


def test_an_object_is_handed_over(plan: Handover, give: GraspPlan, report: TrialReport) -> None:
    assert report.verdict.outcome == "held", report.verdict
    samples, n = report.samples, len(give.task.finger_names)
    assert tuple(dict.fromkeys(samples.phase)) == HANDOVER_PHASES
    end, held = samples.during("hold"), samples.during("reach")
    planned = plan.take.contacts.forces[:, 0]
    assert np.allclose(samples.normal_force[end][:, n:].mean(axis=0), planned, rtol=0.1)
    assert not samples.normal_force[end][:, :n].any()
    assert not samples.normal_force[held][:, n:].any()
    assert abs(samples.lift_mm[end[-1]] - 1e3 * plan.lift_height) < 1.0
    assert samples.slip_mm[end].max() < 2.0
    assert [c.finger for c in report.comparison] == list(plan.take.task.finger_names)
    assert np.allclose([c.planned_normal_force for c in report.comparison], planned)


def test_forces_go_from_one_hand_to_the_other_along_a_ramp(
    plan: Handover, give: GraspPlan, report: TrialReport
) -> None:
    samples, n = report.samples, len(give.task.finger_names)
    moments = samples.during("transfer")
    given, taken = samples.normal_force[moments][:, :n], samples.normal_force[moments][:, n:]
    middle = len(moments) // 2
    full = give.contacts.forces[:, 0].sum(), plan.take.contacts.forces[:, 0].sum()
    assert given[middle].sum() == pytest.approx(full[0] / 2, rel=0.25)
    assert taken[middle].sum() == pytest.approx(full[1] / 2, rel=0.3)
    assert (np.diff(given.sum(axis=1)) < 0.05 * full[0]).all()
    assert (np.diff(taken.sum(axis=1)) > -0.05 * full[1]).all()


def test_what_goes_wrong_is_named(
    plan: Handover, movement: ManipulationPlan, give: GraspPlan, report: TrialReport
) -> None:
    samples, n = report.samples, len(give.task.finger_names)
    hold, open_, reach = (samples.during(phase) for phase in ("hold", "open", "reach"))

    def reason(**changes: Any) -> str:
        fault = judge_handover(replace(samples, **changes), movement, Thresholds())
        return "" if fault is None else f"{fault.reason}: {fault.detail}"

    assert reason() == ""
    contacts = samples.contacts.copy()
    contacts[hold[-1], 0] = 1
    assert "right still touched" in reason(contacts=contacts)
    contacts = samples.contacts.copy()
    contacts[open_[0], n:] = 0
    assert reason(contacts=contacts).startswith("dropped")
    contacts = samples.contacts.copy()
    contacts[reach[0], :n] = 0
    assert reason(contacts=contacts).startswith("dropped")
    contacts = samples.contacts.copy()
    contacts[samples.during("take", "transfer"), n] = 0
    contacts[samples.during("take", "transfer"), n + 1] = 0
    assert reason(contacts=contacts).startswith("no contact: after the take")
    slip = samples.slip_mm.copy()
    slip[hold[0]] = 6.0
    assert reason(slip_mm=slip).startswith("slipped")
    force = samples.collision_N.copy()
    force[reach[0]] = 2.0
    assert reason(collision_N=force).startswith("hand collided")


def test_a_hand_that_feels_nothing_takes_nothing(
    plan: Handover, movement: ManipulationPlan, give: GraspPlan, monkeypatch: pytest.MonkeyPatch
) -> None:
    names = give.task.finger_names
    monkeypatch.setattr("sim.handover.felt_by", lambda simulation: names)
    trial = HandoverTrial(movement, timeline=QUICK)
    report = trial.run()
    assert "too few fingers of left felt" in report.verdict.detail
    assert report.samples.phase[-1] == "take"
    last = report.results[-1]
    assert (last.phase, last.reason) == (
        "take",
        "too few fingers of left felt the object to take it",
    )
    assert (report.samples.contacts[-1, : len(names)] > 0).all()  # still held


def _older(plan: Handover, version: int = 1) -> dict[str, Any]:
    """A handover in the format that files of it alone had."""
    told = HandoverData.of(plan).model_dump(mode="json")
    del told["T_world_pair"]
    return {"format": "opposable-handover", "version": version, "written_by": "0.9", **told}


def _handed(plan: MovementPlan) -> Handover:
    assert plan.handover is not None
    return plan.handover


def test_a_movement_file_holds_it_and_is_checked(
    movement: ManipulationPlan, plan: Handover, tmp_path: Path
) -> None:
    file = tmp_path / "plan.json"
    write_movement(movement, file)
    again = read_movement(file)
    assert np.allclose(_handed(again).both.q, plan.both.q, atol=1e-9)
    assert np.allclose(_handed(again).way_in, plan.way_in, atol=1e-9)
    assert _handed(again).lift_height == plan.lift_height
    assert np.allclose(again.grasp.q, movement.grasp.q, atol=1e-9)
    with refused(f"opposable test {file} a handover or the use of a tool"):
        one_plan(file)
    assert plan_to_test(file).task.finger_names == movement.task.finger_names
    whole = json.loads(file.read_text())
    turned = json.loads(json.dumps(whole))
    pose = turned["grasp"]["grasp"]["T_world_base"]
    pose["quaternion_wxyz"] = [-v for v in pose["quaternion_wxyz"]]  # the same turn
    file.write_text(json.dumps(turned))
    assert read_movement(file).T_world_base.isApprox(movement.T_world_base, 1e-9)

    def fails(match: str, change: Callable[[dict[str, Any]], None]) -> None:
        data = json.loads(json.dumps(whole))
        change(data)
        file.write_text(json.dumps(data))
        with pytest.raises(FileFormatError, match=match):
            read_movement(file)

    def turn_a_joint(data: dict[str, Any]) -> None:
        data["handover"]["take"]["grasp"]["q_rad"][3] += 0.2

    def move_the_pair(data: dict[str, Any]) -> None:
        data["handover"]["T_world_pair"]["position_m"][0] += 1.0

    tool_use = {"T_world_base": [pose], "finger": "", "q_rad": []}
    fails("has a tool and a handover", lambda data: data.update(tool_use=tool_use))
    fails("lift_height_m", lambda data: data["handover"].update(lift_height_m="0.2"))
    fails("take", turn_a_joint)
    fails("the carriages do not reach both grasps", move_the_pair)
    fails("lift_height_m", lambda data: data["handover"].update(lift_height_m=-1.0))
    fails(r"angle_rad is not what follows", lambda data: data.update(angle_rad=1.0))
    fails(r"grasp.q_rad\[5\] is not", lambda data: _add(data["grasp"]["grasp"]["q_rad"], 5))
    fails(r"knots\[1\].q_rad\[2\] is not", lambda data: _add(data["knots"][1]["q_rad"], 2))
    fails("knots is not", lambda data: data["knots"].pop())


def _add(numbers: list[float], k: int) -> None:
    numbers[k] += 0.01


def test_what_differs_in_plain_data_is_named() -> None:
    true = {"a": [1.0, {"b": 2.0}], "c": None}
    assert _other({"a": [1.0 + 1e-12, {"b": 2}], "c": None}, true) == ""
    assert _other({"a": [1.0, {"b": 2.1}], "c": None}, true) == "a[1].b"
    assert _other({"a": [1.0], "c": None}, true) == "a"
    assert _other({"a": true["a"]}, true) == "c"
    assert _other({**true, "tool": 1}, true) == "tool"
    assert _other({"a": [1.0, {"d": 2.0}], "c": None}, true) == "a[1].b"
    assert _other({**true, "c": 0.0}, true) == "c"


def test_a_file_keeps_where_the_pair_stands() -> None:
    """Of two places that are as good rounding took the other one when this file was read."""
    task = GraspTask.create("shadow_hand+allegro_hand_left", "box:0.06x0.06x0.16")
    planned = plan_handover(task, seed=0)
    again = movement_from_dict(json.loads(json.dumps(movement_to_dict(planned))), "a file")
    assert again.T_world_base.isApprox(planned.T_world_base, 1e-9)
    assert np.allclose(_handed(again).way_in, _handed(planned).way_in, atol=1e-9)


def test_files_of_handovers_alone_are_read_and_checked(plan: Handover, tmp_path: Path) -> None:
    file, data = tmp_path / "plan.json", _older(plan)
    file.write_text(json.dumps(data))
    again = _handed(read_movement(file))
    assert np.allclose(again.both.q, plan.both.q, atol=1e-9)
    assert np.allclose(again.way_out, plan.way_out, atol=1e-9)
    data["task"]["joint_error_rad"] = 0.05
    file.write_text(json.dumps(data))
    with pytest.raises(FileFormatError, match="joint_error_rad is in version 2 alone"):
        read_movement(file)
    data = _older(plan)
    data["take"]["grasp"]["q_rad"][3] += 0.2
    file.write_text(json.dumps(data))
    with pytest.raises(FileFormatError, match="take"):
        read_movement(file)


def test_its_joints_over_time_go_through_all_it_planned(
    movement: ManipulationPlan, plan: Handover
) -> None:
    """For real hands: from phase to phase without a jump, through the ends of both ways."""
    made = movement.joint_trajectory(rate_hz=100.0)
    order = list(dict.fromkeys(made.phases))
    assert order == ["approach", "close", "lift", "reach", "take", "open", "retreat"]
    ends = {name: max(i for i, p in enumerate(made.phases) if p == name) for name in order}
    for name, q in (
        ("close", movement.grasp.q),
        ("reach", plan.way_in[-1]),
        ("take", plan.both.q),
        ("open", plan.way_out[0]),
        ("retreat", plan.way_out[-1]),
    ):
        assert np.allclose(made.positions[ends[name]], q, atol=1e-9), name
    lifted = made.T_world_base[-1].translation - movement.T_world_base.translation
    assert np.allclose(lifted, [0.0, 0.0, plan.lift_height])
    assert np.abs(np.diff(made.positions, axis=0)).max() < 0.05


def test_its_page_shows_the_object_in_one_hand_then_in_the_other(
    movement: ManipulationPlan, plan: Handover
) -> None:
    page = motion_page(movement)
    assert page.title == "two_allegro_hands hands over box:0.06x0.06x0.16"
    assert page.verdict is not None and "the ways of both are free" in page.verdict.reason
    assert page.scene is not None
    titles = [plot.title for plot in page.scene.plots]
    assert titles == [
        "Turn of the object",
        "Planned normal force",
        "Planned use of the friction cone",
    ]
    made = movement.joint_trajectory(rate_hz=30.0)
    found = object_motion(movement, made)

    def holds(phase: str) -> set[str]:
        last = max(i for i, p in enumerate(made.phases) if p == phase)
        contacts = found.contacts[last]
        return set() if contacts is None else set(contacts.fingers)

    assert holds("reach") == set(movement.task.finger_names)
    assert holds("retreat") == set(plan.take.task.finger_names)
    assert found.poses[-1].translation[2] == pytest.approx(
        plan.task.T_world_object.translation[2] + plan.lift_height
    )


def test_a_handover_is_no_turn_in_the_hand_and_test_executes_its_file(
    movement: ManipulationPlan, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with refused("hands over or uses a tool; execute it by hand_over"):
        manipulate(movement)
    assert trial_of(movement) is HandoverTrial
    file = tmp_path / "plan.json"
    write_movement(movement, file)
    seen: list[ManipulationPlan] = []

    def run(trial: HandoverTrial, **_: object) -> TrialReport:
        seen.append(trial.movement)
        raise TaskError("seen enough")

    monkeypatch.setattr(HandoverTrial, "run", run)
    with pytest.raises(SystemExit):
        main(["test", str(file)])
    assert len(seen) == 1


def test_the_page_of_its_report_tells_each_phase(report: TrialReport) -> None:
    page = trial_page(report.to_file())
    assert page.title == "two_allegro_hands hands over box:0.06x0.06x0.16"
    (told,) = [b for b in page.summary if isinstance(b, Folded) and b.title == "Phases"]
    (table,) = told.blocks
    assert isinstance(table, Table)
    assert [row[0] for row in table.rows] == [r.phase for r in report.results]
    assert table.rows[-1][2] == "passed"


def test_the_machine_runs_it_and_the_report_tells_each_phase(report: TrialReport) -> None:
    assert [r.phase for r in report.results] == [
        *("stand", "approach", "close", "squeeze", "verify", "lift"),
        *("reach", "take", "transfer", "open", "retreat", "hold"),
    ]
    assert all(r.passed for r in report.results)
    last, samples = report.results[-1].numbers, report.samples
    assert last["moved_mm"] == pytest.approx(samples.slip_mm[-1], abs=0.05)
    assert last["turned_deg"] == pytest.approx(samples.slip_deg[-1], abs=0.05)
    times = [(r.begin, r.end) for r in report.results]
    assert all(a[1] == b[0] for a, b in pairwise(times))
    data = report.to_dict(states=False)
    assert [p["phase"] for p in data["phases"]] == [r.phase for r in report.results]
    assert ReportFile.model_validate(data).phases[-1].passed
    assert "phases" not in replace(report, results=()).to_dict(states=False)  # as a grasp's was


def test_what_cannot_be_handed_over_is_said(plan: Handover, movement: ManipulationPlan) -> None:
    with refused("takes two hands"):
        plan_handover(GraspTask.create("allegro_hand", "box"))
    task = GraspTask.create("two_allegro_hands", "box")
    with refused("no hand to take the object is called 'leff'"):
        plan_handover(task, to="leff")
    for height in (0.0, 5.0, float("nan")):
        with refused("lift_height"):
            plan_handover(task, lift_height=height)
    wrong: Any = 7
    with refused("no hand to take the object is called '7'"):
        plan_handover(task, to=wrong)
    with refused("task is"):
        plan_handover(wrong)
    with refused("is no handover"):
        hand_over(wrong)
    with refused("its own controller"):
        HandoverTrial(movement, controller="feedforward")
    with refused("HandoverTimeline"):
        HandoverTrial(movement, timeline=Timeline())
    small = GraspTask.create("two_allegro_hands", "box:0.025x0.025x0.025")
    with pytest.raises(NoGraspFoundError, match="room for both hands"):
        plan_handover(small, rounds=1)
    tiny = GraspTask.create("two_allegro_hands", "sphere:0.005")
    with pytest.raises(
        NoGraspFoundError, match=r"by right .* alone in 60 attempts: 60 x .*surface"
    ):
        plan_handover(tiny, to="left")


def test_each_hand_sees_the_forces_and_pads_of_its_own_fingers() -> None:
    forces = np.array([1.0, 2.0, 3.0, 4.0, 5.0])
    points = np.arange(15.0).reshape(5, 3)
    pads = PadReading(
        normal_force=forces, force=points, position=points, normal=points, sliding=points
    )
    observation = Observation(
        time=0.0,
        phase="hold",
        progress=1.0,
        q=np.zeros(1),
        v=np.zeros(1),
        T_world_base=SE3.Identity(),
        T_world_object=SE3.Identity(),
        read_twist=lambda: np.zeros(6),
        normal_forces=forces,
        read_contacts=lambda: ContactSet.from_arrays(np.zeros((0, 3)), np.zeros((0, 3))),
        read_pads=lambda: pads,
    )
    assert observation.pads is pads  # what was read before is not what a part of it sees
    seen = _seen(observation, slice(2, 5))
    assert seen.normal_forces.tolist() == [3.0, 4.0, 5.0]
    assert seen.pads.normal_force.tolist() == [3.0, 4.0, 5.0]
    assert seen.pads.position.tolist() == points[2:].tolist()


def test_two_hands_by_their_names() -> None:
    hand = load_hand("shadow_hand+allegro_hand_left")
    assert hand.reference == "shadow_hand+allegro_hand_left"
    assert [side.name for side in hand.sides] == ["first", "second"]
    data = mujoco.MjData(hand.mj_model)
    data.qpos[:] = hand.neutral
    mujoco.mj_kinematics(hand.mj_model, data)
    palms = [data.body(side.palm_body) for side in hand.sides]
    looks = [
        palm.xmat.reshape(3, 3) @ side.palm_normal
        for palm, side in zip(palms, hand.sides, strict=True)
    ]
    assert np.allclose(looks[0], [0, 1, 0], atol=1e-9)
    assert np.allclose(looks[1], [0, -1, 0], atol=1e-9)
    assert np.allclose([palm.xpos for palm in palms], [[0, -0.25, 0], [0, 0.25, 0]], atol=1e-9)
    up = [data.site(hand.fingers[f"{side.name}_index"].tip_frame).xpos[2] for side in hand.sides]
    assert min(up) > 0.05
    for name, word in (
        ("allegro_hand+", "missing beside the plus"),
        ("allegro_hand+nobody", "nobody"),
        ("allegro_hand+allegro_hand+allegro_hand", "names 3 hands"),
        ("allegro_hand+two_allegro_hands", "is two hands itself"),
    ):
        with refused(word):
            load_hand(name)


@settings(max_examples=3, deadline=None)
@given(seed=st.integers(0, 10_000))
def test_the_nearest_of_one_hand_is_the_least_of_its_distances(seed: int) -> None:
    hand = load_hand("two_allegro_hands")
    task = GraspTask.create(hand, "box:0.2x0.2x0.2")
    world, rng = CollisionWorld(task), np.random.default_rng(seed)
    q = hand.q_lower + rng.uniform(0.2, 0.8, hand.nq) * (hand.q_upper - hand.q_lower)
    mine = frozenset(g.name for g in hand.geometries if g.name.startswith("left/"))
    assert task.T_world_base is not None
    pairs = world.distances(task.T_world_base, q)
    expected = min(c.distance for c in pairs if (c.first in mine) != (c.second in mine))
    assert world.nearest_of(task.T_world_base, q, mine).distance == pytest.approx(expected)
