"""Manipulations as files, as joint trajectories, and by the command that reads them."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable
from dataclasses import MISSING, fields, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from manipulations import QUICK, phases_of, task_of, turned_cylinder, turned_cylinder_report
from pydantic import ValidationError
from star_hand import write_star_hand
from typer.testing import CliRunner

from planner.errors import FileFormatError, TaskError
from planner.files import (
    read_manipulation,
    write_gait,
    write_json,
    write_manipulation,
    write_motion,
    write_trajectory,
)
from planner.files.movements import movement_from_dict, movement_to_dict
from planner.hand_loading import load_hand
from planner.kinematics import HandState
from planner.motion.manipulation import (
    ManipulationPlan,
    manipulation_of,
    plan_manipulation,
    plan_regrasping,
)
from planner.motion.plan import MovementPlan
from planner.pages.page import Page
from planner.plan import JointTrajectory
from sim.cli import app
from sim.cli.common import EXIT_INTERRUPTED
from sim.manipulation import ManipulationReport, read_manipulation_report
from sim.manipulation.phases import Phases
from sim.manipulation.report_file import ManipulationReportFile
from sim.manipulation.simulation import ManipulationOptions
from sim.manipulation.timeline import ManipulationTimeline, SuccessCriteria
from sim.show.targets import Target, ViewOptions, recognise

pytestmark = pytest.mark.usefixtures("coarse_steps")


@pytest.fixture(scope="module")
def turn() -> ManipulationPlan:
    """A turn of a cylinder, in one stroke."""
    return turned_cylinder()


@pytest.fixture(scope="module")
def tilt() -> ManipulationPlan:
    """A block that is tilted, moved, and brought back before it is put down."""
    task = task_of("box:0.05x0.05x0.08", mass=0.1, mu=0.5)
    return plan_manipulation(
        task, axis=(0.0, 1.0, 0.0), angle=math.radians(20.0), shift=(0.0, 0.0, 0.008)
    )


@pytest.fixture(scope="module")
def strokes(tmp_path_factory: pytest.TempPathFactory) -> ManipulationPlan:
    """A turn in two strokes by a hand of four fingers in a circle."""
    hand = load_hand(write_star_hand(tmp_path_factory.mktemp("star"), 4))
    task = task_of("cylinder:0.03x0.08", hand, mass=0.1, mu=0.6)
    return plan_regrasping(task, angle=math.radians(40.0), place=(0.03, 0.0))


def test_a_plan_is_kept_before_it_is_executed(
    turn: ManipulationPlan, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    write_manipulation(turn, tmp_path / "given.json")
    monkeypatch.setattr("sim.manipulation.manipulate", interrupted)
    asked = ["manipulate", "--plan", str(tmp_path / "given.json"), "--out", str(tmp_path / "out")]
    done = CliRunner().invoke(app, asked)
    assert done.exit_code == EXIT_INTERRUPTED
    kept = read_manipulation(tmp_path / "out" / "manipulation.json")
    assert np.allclose(kept.grasp.q, turn.grasp.q)
    assert kept.angle == pytest.approx(turn.angle)
    assert (tmp_path / "out" / "trajectory.csv").exists()


def test_what_ctrl_c_ended_is_reported_and_the_exit_code_says_so(
    turn: ManipulationPlan, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    write_manipulation(turn, tmp_path / "given.json")
    monkeypatch.setattr(Phases, "perform", interrupted)
    asked = ["manipulate", "--plan", str(tmp_path / "given.json"), "--json"]
    done = CliRunner().invoke(app, asked)
    assert done.exit_code == EXIT_INTERRUPTED
    assert json.loads(done.stdout)["reason"] == "stand: interrupted"


@pytest.fixture(params=["turn", "tilt", "strokes"])
def plan(request: pytest.FixtureRequest) -> ManipulationPlan:
    found: ManipulationPlan = request.getfixturevalue(request.param)
    return found


@pytest.fixture(scope="module")
def report() -> ManipulationReport:
    return turned_cylinder_report()


# --- files -------------------------------------------------------------------------------------


def numbers_in(data: Any) -> list[float]:
    """All numbers of plain data, in order."""
    if isinstance(data, dict):
        data = list(data.values())
    if isinstance(data, list):
        return [number for one in data for number in numbers_in(one)]
    return [] if isinstance(data, str | None) else [float(data)]


def test_a_file_gives_the_plan_back(plan: ManipulationPlan, tmp_path: Path) -> None:
    path = tmp_path / "manipulation.json"
    write_manipulation(plan, path)
    again = read_manipulation(path)
    assert str(again) == str(plan)
    told, true = movement_to_dict(again), movement_to_dict(plan)
    # poses become quaternions and back, contacts are computed again: rounding is all that changes
    np.testing.assert_allclose(numbers_in(told), numbers_in(true), rtol=0.0, atol=1e-9)
    words = [re.sub(r"-?\d[\d.e-]*", "", json.dumps(data)) for data in (told, true)]
    assert words[0] == words[1]
    assert [o.name for o in again.under_target] == [o.name for o in plan.under_target]


def _grasped(data: dict[str, Any]) -> list[float]:
    joints: list[float] = data["grasp"]["grasp"]["q_rad"]
    return joints


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda data: data.update(format="opposable-plan"), "is not a movement file"),
        (lambda data: data.update(version=2), "has movement version 2"),
        (lambda data: data.update(extra=1), "is damaged: extra"),
        (lambda data: data.update(ending=None, angle_rad=0.1, torque_reserve=None), "ending"),
        (lambda data: data.update(angle_rad=1.0), "to turn by 57.3 degrees and its motion by"),
        (lambda data: data.update(angle_rad=-0.2), "to turn by -11.5 degrees"),
        (lambda data: data.update(shift_m=[0.0, 0.0, 0.01]), "translation is not that of"),
        (lambda data: data.update(torque_reserve=0.9), "torque reserve is not that"),
        (
            lambda data: data["ending"]["T_world_target"]["position_m"].__setitem__(2, 0.06),
            "does not stand at its target",
        ),
        (
            lambda data: data["ending"].update(q_open_rad=data["grasp"]["grasp"]["q_rad"]),
            "way out fails its checks",
        ),
        (
            lambda data: data["ending"].update(made_backwards_because="so"),
            "does not stand at its target",
        ),
        (lambda data: data["path"].update(angle_rad=0.8), "fails its checks"),
    ],
)
def test_a_damaged_file_is_refused(
    turn: ManipulationPlan,
    tmp_path: Path,
    change: Callable[[dict[str, Any]], None],
    words: str,
) -> None:
    data = movement_to_dict(turn)
    change(data)
    path = tmp_path / "manipulation.json"
    write_json(data, path)
    with pytest.raises(FileFormatError, match=words):
        read_manipulation(path)


def test_a_file_whose_way_back_is_not_its_way_in_is_refused(
    tilt: ManipulationPlan, tmp_path: Path
) -> None:
    data = movement_to_dict(tilt)
    data["ending"]["q_open_rad"][0] += 0.01
    write_json(data, tmp_path / "m.json")
    with pytest.raises(FileFormatError, match="way out is not its way in"):
        read_manipulation(tmp_path / "m.json")


def of_older_format(data: dict[str, Any]) -> dict[str, Any]:
    """Data of a movement with an ending as the format "opposable-manipulation" had it."""
    names = ["written_by", "grasp", "path", "tube_m", "knots", "limits", "record"]
    motion = {"format": "opposable-motion", "version": 1, **{name: data[name] for name in names}}
    gait = None
    if data["cycles"] > 1:
        gait = {
            "format": "opposable-gait",
            "version": 1,
            "written_by": data["written_by"],
            "cycles": data["cycles"],
            "stroke": motion,
            "relocations": data["relocations"],
        }
    same = {
        name: data[name]
        for name in ("written_by", "angle_rad", "shift_m", "ending", "torque_reserve")
    }
    return {
        "format": "opposable-manipulation",
        "version": 1,
        "motion": None if gait else motion,
        "gait": gait,
        "attempts": data["record"]["attempts"],
        "cpu_s": data["record"]["cpu_s"],
        **same,
    }


def test_files_of_the_three_older_formats_are_read(plan: ManipulationPlan) -> None:
    data = movement_to_dict(plan)
    old = of_older_format(data)
    again = movement_from_dict(old, "an old file")
    assert isinstance(again, ManipulationPlan)
    assert str(again) == str(plan) and again.record == plan.record
    alone = movement_from_dict(old["gait"] or old["motion"], "its motion or gait")
    assert not isinstance(alone, ManipulationPlan) and alone.ending is None
    assert str(alone) == str(without_ending(plan))
    assert alone.angle == pytest.approx(plan.planned_angle)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda data: data.update(version=2), "version 2 of opposable-manipulation"),
        (lambda data: data.update(motion=None), "a motion and a gait, or neither"),
        (
            lambda data: data["motion"].pop("path"),
            "fields are not those of opposable-manipulation.*path",
        ),
        (lambda data: data["motion"]["path"].update(angle_rad=0.8), "fails its checks"),
        (lambda data: data.update(torque_reserve=0.9), "torque reserve is not that"),
        (lambda data: data.update(extra=1), "extra is no field of opposable-manipulation"),
        (lambda data: data["motion"].update(version=2), "not version 1 of opposable-motion"),
    ],
)
def test_a_damaged_file_of_an_older_format_is_refused(
    turn: ManipulationPlan, change: Callable[[dict[str, Any]], None], words: str
) -> None:
    data = of_older_format(movement_to_dict(turn))
    change(data)
    with pytest.raises(FileFormatError, match=words):
        movement_from_dict(data, "an old file")


# --- trajectories ------------------------------------------------------------------------------


def during(trajectory: JointTrajectory, *phases: str) -> np.ndarray[Any, np.dtype[np.bool_]]:
    return np.isin(np.array(trajectory.phases), phases)


def test_a_trajectory_keeps_limits_and_goes_on_without_jumps(plan: ManipulationPlan) -> None:
    rate = 2.0
    trajectory = plan.joint_trajectory(joint_rate=rate, rate_hz=100.0)
    hand, q, times = plan.task.hand, trajectory.positions, trajectory.times
    assert trajectory.joint_names == hand.joint_names
    assert len(times) == len(q) == len(trajectory.phases) == len(trajectory.T_world_base)
    assert times[0] == 0.0 and (np.diff(times) > 0.0).all() and np.diff(times).max() < 0.0101
    assert (q >= hand.q_lower - 1e-9).all() and (q <= hand.q_upper + 1e-9).all()
    moved = np.abs(np.diff(q, axis=0)) / np.diff(times)[:, None]
    turning = ~during(trajectory, "approach", "close", "open")[1:]
    assert moved[turning].max() <= 1.01 * rate
    for before, after in pairwise(trajectory.T_world_base):
        assert np.linalg.norm(after.translation - before.translation) < 0.01


def test_a_trajectory_goes_through_the_knots(turn: ManipulationPlan) -> None:
    motion = turn.motion
    trajectory = motion.joint_trajectory(rate_hz=1000.0)
    assert trajectory.phases[-1] == "turn"
    for knot in motion.knots:
        assert np.abs(trajectory.positions - knot.q).max(axis=1).min() < 3e-3
    np.testing.assert_allclose(trajectory.positions[-1], motion.knots[-1].q, atol=1e-12)
    assert all(pose.isApprox(motion.T_world_base) for pose in trajectory.T_world_base[-10:])
    fast = motion.joint_trajectory(turn_rate=10.0, joint_rate=20.0)
    slow = motion.joint_trajectory(turn_rate=0.1)
    assert fast.times[-1] < trajectory.times[-1] < slow.times[-1]
    since = slow.times[during(slow, "turn")]
    assert since[-1] - since[0] == pytest.approx(1.875 * motion.path.angle / 0.1, rel=0.01)


def without_ending(plan: ManipulationPlan) -> MovementPlan:
    """The movement alone, all of which is requested."""
    same = {one.name: getattr(plan, one.name) for one in fields(MovementPlan)}
    asked = {"angle": plan.planned_angle, "shift": plan.planned_shift, "ending": None}
    return MovementPlan(**{**same, **asked})


def test_a_trajectory_of_a_gait_has_strokes_and_regrasps(strokes: ManipulationPlan) -> None:
    gait = without_ending(strokes)
    trajectory = gait.joint_trajectory()
    names = list(dict.fromkeys(trajectory.phases))
    moved = [f"regrasp {finger}" for finger in gait.order]
    assert names == ["approach", "close", "stroke 1", *moved, "stroke 2"]
    for stroke in gait.strokes:
        q = trajectory.positions[during(trajectory, f"stroke {stroke.cycle + 1}")]
        np.testing.assert_allclose(q[-1], stroke.knots[-1].q, atol=1e-9)


def test_a_trajectory_puts_the_object_where_it_is_to_stand(plan: ManipulationPlan) -> None:
    """The object follows the hand from the lift on; turned by as much as was asked."""
    trajectory = plan.joint_trajectory(lift_m=0.05)
    lowered = np.flatnonzero(during(trajectory, "lower"))[-1]
    base = trajectory.T_world_base[lowered]
    first = plan.motion.T_world_base
    turned = plan.motion.knots[0].T_world_object if plan.ending.back else plan.turned_object()[0]
    there = base * first.inverse() * turned
    assert there.isApprox(plan.ending.T_world_target, 1e-9)
    out = trajectory.T_world_base[-1]
    assert out.isApprox(plan.way_out(base), 1e-9)
    assert plan.ending.release is not None
    np.testing.assert_allclose(trajectory.positions[-1], plan.ending.release.q, atol=1e-12)


def test_a_trajectory_is_what_the_simulated_hand_does(
    turn: ManipulationPlan, report: ManipulationReport
) -> None:
    """At the end of the turn the pads of both are at the same places of the object."""
    trajectory = turn.joint_trajectory()
    T_world_object, q = turn.turned_object()
    np.testing.assert_allclose(trajectory.positions[during(trajectory, "turn")][-1], q, atol=1e-12)
    state = HandState(turn.task.hand, q)
    T_object_base = T_world_object.inverse() * turn.motion.T_world_base
    pads = np.array([T_object_base.act(state.pad_center(f)) for f in turn.task.fingers])
    held = report.log.during("hold")[-1]
    contacts = report.log.points[held]
    # contacts are on the surface, pad centres behind it by the radius of the tip, 12 mm
    assert np.linalg.norm(pads - contacts, axis=1).max() < 0.016


@pytest.mark.parametrize("name", ["joint_rate", "turn_rate", "rate_hz", "approach_s"])
def test_rates_that_are_none_are_refused(turn: ManipulationPlan, name: str) -> None:
    with pytest.raises(TaskError, match=f"{name} of a trajectory is 0"):
        turn.joint_trajectory(**{name: 0.0})


def test_a_trajectory_is_written_as_a_table(turn: ManipulationPlan, tmp_path: Path) -> None:
    write_trajectory(turn.joint_trajectory(rate_hz=10.0), tmp_path / "t.csv")
    head, *rows = (tmp_path / "t.csv").read_text().splitlines()
    assert head.startswith("time_s,phase,") and len(rows) > 50


# --- motions and gaits -------------------------------------------------------------------------


def test_a_motion_becomes_a_manipulation(turn: ManipulationPlan, strokes: ManipulationPlan) -> None:
    made = manipulation_of(turn.motion, place=(0.1, 0.0))
    assert made.angle == turn.motion.path.angle
    np.testing.assert_allclose(made.ending.T_world_target.translation, [0.1, 0.0, 0.04])
    gait = without_ending(strokes)
    by_strokes = manipulation_of(gait)
    assert by_strokes.angle == gait.angle and by_strokes.phases is gait.phases
    motion = turn.motion
    held = replace(motion.grasp, task=replace(turn.task, table_height=None))
    with pytest.raises(TaskError, match="no table to pick from"):
        manipulation_of(replace(motion, grasp=held))


# --- the command -------------------------------------------------------------------------------


def command(*arguments: str | Path) -> Any:
    return CliRunner().invoke(app, ["manipulate", *map(str, arguments)])


@pytest.fixture
def executed(report: ManipulationReport, monkeypatch: pytest.MonkeyPatch) -> list[ManipulationPlan]:
    """What commands would execute; that it goes as a plan says is tested elsewhere."""
    plans: list[ManipulationPlan] = []

    def execute(plan: ManipulationPlan, *_: object, **__: object) -> ManipulationReport:
        plans.append(plan)
        return report

    monkeypatch.setattr("sim.manipulation.manipulate", execute)
    return plans


def test_the_command_executes_the_plan_of_a_file(
    turn: ManipulationPlan, executed: list[ManipulationPlan], tmp_path: Path
) -> None:
    write_manipulation(turn, tmp_path / "manipulation.json")
    done = command("--plan", tmp_path / "manipulation.json", "--json")
    assert done.exit_code == 0, done.output
    assert json.loads(done.stdout)["format"] == "opposable-manipulation-report"
    assert str(executed[0]) == str(turn)


def test_the_command_executes_motions_and_gaits_too(
    turn: ManipulationPlan,
    strokes: ManipulationPlan,
    executed: list[ManipulationPlan],
    tmp_path: Path,
) -> None:
    write_motion(turn.motion, tmp_path / "motion.json")
    done = command("--plan", tmp_path / "motion.json", "--place", "0.05,0")
    assert "turned" in done.output and "complete;" in done.output, done.output
    write_gait(without_ending(strokes), tmp_path / "gait.json")
    assert command("--plan", tmp_path / "gait.json").exit_code == 0
    moved, regrasped = executed
    assert moved.cycles == 1 and moved.angle == pytest.approx(turn.motion.path.angle)
    assert moved.ending.T_world_target.translation[:2] == pytest.approx([0.05, 0.0])
    assert regrasped.order == strokes.order
    assert regrasped.angle == pytest.approx(strokes.planned_angle)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ([], "give HAND and OBJECT, or a file"),
        (["allegro_hand"], "give HAND and OBJECT, or a file"),
        (["allegro_hand", "box", "--plan", "m.json"], "leave HAND, OBJECT out"),
        (["--plan", "m.json", "--rotate", "30"], "leave --rotate out"),
        (["--plan", "missing.json"], "cannot read plan file missing.json"),
        (["allegro_hand", "box", "--controller", "none"], "none"),
    ],
)
def test_the_command_says_what_to_give(arguments: list[str], words: str) -> None:
    done = command(*arguments)
    assert done.exit_code == 3
    assert words in " ".join(done.output.split())


# --- reports -----------------------------------------------------------------------------------


def test_a_report_file_has_a_head_and_all_channels(
    report: ManipulationReport, turn: ManipulationPlan, tmp_path: Path
) -> None:
    write_json(report.to_dict(), tmp_path / "report.json")
    file = read_manipulation_report(tmp_path / "report.json")
    target = Target(str(tmp_path / "report.json"))
    page = recognise(target).shown(target, ViewOptions())
    assert isinstance(page, Page) and page.data is not None
    assert page.data["format"] == "opposable-manipulation-report"
    assert (file.format, file.version) == ("opposable-manipulation-report", 4)
    assert (file.hand, file.object, file.seed) == ("allegro_hand", "cylinder:0.03x0.08", 0)
    assert file.mass_kg == 0.1 and file.controller == "ObjectImpedance"
    assert file.written_by.startswith("opposable")
    assert file.timeline["carry"] == QUICK.carry and file.physics["mu"] == 0.6
    samples, m, n = file.samples.model_dump(), len(report.log), len(turn.task.fingers)
    assert {len(channel) for channel in samples.values()} == {m}
    assert np.shape(samples["normal_force_N"]) == (m, n)
    np.testing.assert_allclose(samples["normal_force_N"], report.log.normal_force)
    np.testing.assert_allclose(samples["object_in_palm_turn_deg"], np.rad2deg(report.log.turn))
    assert samples["phase"] == list(report.log.phase)
    assert samples["contact_mode_measured"] == report.measured_modes.tolist()
    assert [(p.phase, p.about) for p in file.phases] == phases_of(report)


def test_a_report_file_of_another_kind_is_refused(
    report: ManipulationReport, tmp_path: Path
) -> None:
    for change, words in (
        ({"format": None}, "is not a manipulation-report file"),
        ({"version": 0}, "has manipulation-report version 0"),
        ({"seed": "one"}, "is damaged: seed"),
    ):
        write_json(report.to_dict() | change, tmp_path / "r.json")
        with pytest.raises(FileFormatError, match=words):
            read_manipulation_report(tmp_path / "r.json")


@pytest.mark.parametrize("kind", ["movement", "manipulation-report"])
def test_schemas_are_printed(kind: str) -> None:
    done = CliRunner().invoke(app, ["export", "--schema", kind])
    assert done.exit_code == 0
    assert f"opposable-{kind}" in done.stdout


def test_a_report_prints_as_a_screen(report: ManipulationReport) -> None:
    lines = str(report).splitlines()
    assert len(lines) < 45 and max(map(len, lines)) < 120
    assert lines[-1] == "complete; the turn: success with closure"


def test_an_ending_is_required_and_no_timeline_is_the_default_one() -> None:
    ending = next(f for f in fields(ManipulationPlan) if f.name == "ending")
    assert ending.default is MISSING
    options = ManipulationOptions().with_changes(timeline=None, criteria=None, physics=None)
    assert options.timeline == ManipulationTimeline() and options.criteria == SuccessCriteria()
    with pytest.raises(ValidationError, match="events"):
        ManipulationReportFile.model_validate({})
