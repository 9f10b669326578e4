"""Goal rotations: movements composed as on paper, verified, kept, refused, and one executed."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
import typer
from manipulations import QUICK
from typer.testing import CliRunner

from planner.errors import FileFormatError, TaskError, UnreachableError
from planner.failure import Failure
from planner.files import read_manipulation, write_manipulation
from planner.files.movements import manipulation_from_dict, movement_to_dict
from planner.motion import goal_moves, goals, roadmap
from planner.motion.ending import verify_turned
from planner.motion.goal_moves import GoalMoves, upright
from planner.motion.goals import _set_down, plan_reorientation
from planner.motion.path import ObjectPath, checked_rotation
from planner.motion.plan import ManipulationPlan
from planner.motion.roadmap import Roadmap, poses_of, roadmap_for
from planner.motion.task import manipulation_task
from planner.objects import parse_object
from planner.spatial import SE3, FloatArray, rotation_angle
from planner.system.disk_cache import CACHE_VARIABLE
from planner.task import GraspTask
from sim.cli import app, main
from sim.cli.common import EXIT_BAD_INPUT
from sim.cli.manipulate import GOAL
from sim.cli.palm import IN_PALM, WITH_GOAL
from sim.cli.palm import KEPT as WITH_PALM
from sim.manipulation import manipulate
from sim.manipulation.timeline import SuccessCriteria, at_goal

X, Y, Z = np.eye(3)
BOX = "box:0.05x0.05x0.08"


def turn(axis: FloatArray, degrees: float) -> FloatArray:
    """A rotation about an axis."""
    return np.asarray(pin.exp3(math.radians(degrees) * axis))


@pytest.fixture(scope="module")
def cached(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A cache of this module, and roadmaps of a few attempts."""
    folder = tmp_path_factory.mktemp("cache")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(CACHE_VARIABLE, str(folder))
        patch.setattr(roadmap, "ATTEMPTS", 24)
        yield folder


@pytest.fixture(scope="module")
def task() -> GraspTask:
    """A box before the Allegro-type hand."""
    return manipulation_task("allegro_hand", parse_object(BOX), mu=0.45)


@pytest.fixture(scope="module")
def road(task: GraspTask, cached: Path) -> Roadmap:
    """The roadmap of the box."""
    return roadmap_for(task)


@pytest.fixture(scope="module")
def sideways(road: Roadmap) -> ManipulationPlan:
    """The box held lying on its side in the air."""
    return plan_reorientation("allegro_hand", parse_object(BOX), turn(X, 90.0))


# ---- rotations


def test_a_box_turned_by_90_degrees_lies_on_its_other_face() -> None:
    """By hand: +y comes up, the height is half of y, heading and place stay."""
    poses = poses_of(parse_object(BOX), 0.0)
    start = SE3(turn(Z, 30.0), np.array([0.1, 0.2, 0.04]))
    up = start.rotation @ X  # any horizontal axis of the box as it stands
    lying = next(p for p in poses if np.allclose(p.rotation[2], [0, 1, 0], atol=1e-9))
    after = _set_down(start, lying)
    np.testing.assert_allclose(after.translation, [0.1, 0.2, 0.025], atol=1e-12)
    np.testing.assert_allclose(after.rotation, turn(up, 90.0) @ start.rotation, atol=1e-9)
    np.testing.assert_allclose(after.rotation[2], [0, 1, 0], atol=1e-9)


def test_the_smallest_rotation_that_makes_a_direction_vertical() -> None:
    """Nothing, a quarter turn, and half a turn, whose axis is any horizontal one."""
    np.testing.assert_allclose(upright(Z, turn(Z, 70.0)), np.eye(3), atol=1e-12)
    np.testing.assert_allclose(upright(Y, np.eye(3)), turn(X, 90.0), atol=1e-12)
    half = upright(-Z, np.eye(3))
    np.testing.assert_allclose(half @ -Z, Z, atol=1e-12)
    assert np.linalg.det(half) == pytest.approx(1.0)


def test_the_wrist_alone_makes_the_goal(sideways: ManipulationPlan) -> None:
    """Its attitude times the pose that it was picked up in is the goal, about the object."""
    goal = turn(X, 90.0)
    start = sideways.task.T_world_object.rotation
    np.testing.assert_allclose(sideways.path.attitude @ start, goal, atol=1e-9)
    np.testing.assert_allclose(sideways.ending.T_world_target.rotation, goal, atol=1e-9)
    assert sideways.ending.release is None and sideways.path.stays and sideways.then is None
    trajectory = sideways.joint_trajectory()
    assert list(dict.fromkeys(trajectory.phases)) == [
        *("approach", "close", "lift", "wrist", "turn", "carry")
    ]
    held = trajectory.T_world_base[-1] * sideways.T_world_base.inverse()
    np.testing.assert_allclose((held * sideways.task.T_world_object).rotation, goal, atol=1e-9)


def test_what_the_wrist_and_the_fingers_make_is_the_goal(task: GraspTask, road: Roadmap) -> None:
    """The turn of the fingers comes first, then the attitude; the palm tilts by the rest."""
    moves = GoalMoves(task, road, goal_tilt=math.radians(20.0), wrist_tilt=np.pi, seed=0)
    goal = turn(Z, 40.0) @ turn(X, 30.0)
    left = moves.left_to_fingers(task.T_world_object, goal)
    assert left is not None
    np.testing.assert_allclose(left, turn(X, 20.0), atol=1e-9)
    attitude = goal @ task.T_world_object.rotation.T @ left.T
    assert rotation_angle(upright(attitude.T @ Z, np.eye(3))) == pytest.approx(math.radians(10.0))
    assert moves.left_to_fingers(task.T_world_object, turn(Z, 120.0)) is None


# ---- every movement is verified


def weight_left(plan: ManipulationPlan) -> float:
    """Largest part of the weight (N) that forces leave over, anywhere on the wrist's way."""
    task, left = plan.task, 0.0
    for knot in plan.knots:
        solved = (*knot.on_the_way[::-1], knot.forces)
        for share, forces in zip(plan.path.wrist_shares, solved, strict=True):
            pull = task.object.mass * plan.path.wrist(share).T @ task.gravity
            pressed = np.einsum("nij,nj->i", forces.contacts.frames, forces.contacts.forces[:, :3])
            left = max(left, float(np.linalg.norm(pressed + pull)))
    return left


def test_gravity_that_is_not_turned_is_found_out(
    task: GraspTask, road: Roadmap, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Planned forces bear the weight as it is seen from the hand, every 15 degrees of the way."""
    moves = GoalMoves(task, road, goal_tilt=np.pi, wrist_tilt=np.pi, seed=0)
    grasp = int(np.flatnonzero(road.stands[:, 0])[0])
    target = SE3(turn(X, 180.0), task.T_world_object.translation)
    right = moves.movement(task.T_world_object, grasp, target, stands=False)
    assert isinstance(right, ManipulationPlan) and len(right.path.wrist_shares) == 13
    assert weight_left(right) < 1e-4
    monkeypatch.setattr(ObjectPath, "borne", lambda self, task, share=1.0: task)
    wrong = moves.movement(task.T_world_object, grasp, target, stands=False)
    assert isinstance(wrong, ManipulationPlan)
    assert weight_left(wrong) == pytest.approx(2 * 9.81 * task.object.mass, rel=1e-3)


def test_a_heavy_object_falls_on_the_way(task: GraspTask, road: Roadmap) -> None:
    """At ten times the mass no grasp of the roadmap holds it with the palm up."""
    heavy = replace(task, object=replace(task.object, mass=10 * task.object.mass))
    moves = GoalMoves(heavy, road, goal_tilt=np.pi, wrist_tilt=np.pi, seed=0)
    target = SE3(turn(X, 180.0), task.T_world_object.translation)
    grasps = [int(g) for g in np.flatnonzero(road.stands[:, 0])]
    assert moves.best(task.T_world_object, grasps, target, stands=False) is None
    assert moves.failures


def test_a_set_down_in_the_table_is_refused(task: GraspTask, road: Roadmap) -> None:
    """Palm up on the other end face of the box the hand would be below."""
    moves = GoalMoves(task, road, goal_tilt=np.pi, wrist_tilt=np.pi, seed=0)
    grasp = int(np.flatnonzero(road.stands[:, 0])[0])
    target = SE3(turn(X, 180.0), task.T_world_object.translation)
    failure = moves.movement(task.T_world_object, grasp, target, stands=True)
    assert isinstance(failure, Failure) and "where it is set down" in failure.text


def test_the_palm_keeps_its_tilt_on_the_whole_way(task: GraspTask, road: Roadmap) -> None:
    """Half a turn about a horizontal axis goes through the palm up, whatever its end."""
    moves = GoalMoves(task, road, goal_tilt=np.pi, wrist_tilt=math.radians(80.0), seed=0)
    grasp = int(np.flatnonzero(road.stands[:, 0])[0])
    target = SE3(turn(X, 180.0), task.T_world_object.translation)
    failure = moves.movement(task.T_world_object, grasp, target, stands=False)
    assert isinstance(failure, Failure) and failure.kind == "palm_tilts"


def test_an_ending_in_the_attitude_is_verified(road: Roadmap) -> None:
    """Put down on its side: a target that is turned, or is in the table, is none."""
    plan = plan_reorientation("allegro_hand", parse_object(BOX), turn(Z, 25.0), put_down=True)
    ending = plan.ending
    assert ending.release is not None and verify_turned(plan, ending) is None
    target = ending.T_world_target
    for wrong, told in (
        (SE3(turn(Z, 5.0) @ target.rotation, target.translation), "not turned"),
        (SE3(target.rotation, target.translation - 0.01 * Z), "does not stand"),
    ):
        failure = verify_turned(plan, replace(ending, T_world_target=wrong))
        assert failure is not None and told in failure.text


# ---- set-downs and regrasps


def test_a_palm_that_stays_down_makes_a_regrasp_necessary(road: Roadmap) -> None:
    """Upside down the palm would be up: the box is set down before, and the parts fit."""
    plan = plan_reorientation(
        "allegro_hand", parse_object(BOX), turn(X, 180.0), goal_tilt=math.radians(80.0)
    )
    assert len(plan.chain) >= 2
    for one, following in zip(plan.chain, plan.chain[1:], strict=False):
        assert one.ending.release is not None
        assert one.ending.T_world_target.isApprox(following.task.T_world_object, 1e-9)
    last = plan.chain[-1]
    palm = last.path.attitude @ last.grasp.T_world_palm.rotation @ last.task.hand.palm_normal
    assert -palm[2] >= math.cos(math.radians(80.0))
    assert "then" in str(plan)


def test_a_chain_is_written_and_read(road: Roadmap, tmp_path: Path) -> None:
    """And judged again: a part that begins elsewhere is refused."""
    plan = plan_reorientation(
        "allegro_hand", parse_object(BOX), turn(X, 180.0), goal_tilt=math.radians(80.0)
    )
    write_manipulation(plan, tmp_path / "goal.json")
    again = read_manipulation(tmp_path / "goal.json")
    assert len(again.chain) == len(plan.chain) and str(again) == str(plan)
    for one, other in zip(again.chain, plan.chain, strict=True):
        assert one.ending.T_world_target.isApprox(other.ending.T_world_target, 1e-12)
        assert (one.ending.release is None) == (other.ending.release is None)
    data = movement_to_dict(plan)
    data["then"] = movement_to_dict(plan)
    with pytest.raises(FileFormatError, match="begins elsewhere"):
        manipulation_from_dict(data, "it")
    data = movement_to_dict(plan)
    data["ending"]["q_open_rad"] = None
    with pytest.raises(FileFormatError, match="a part of a way out only"):
        manipulation_from_dict(data, "it")
    data = movement_to_dict(plan.chain[-1])
    data["ending"]["T_world_target"]["position_m"][2] -= 3.0
    with pytest.raises(FileFormatError, match="held at another height"):
        manipulation_from_dict(data, "it")
    data = movement_to_dict(plan)
    data["ending"]["T_world_target"]["position_m"][2] -= 0.01
    with pytest.raises(FileFormatError, match="does not stand"):
        manipulation_from_dict(data, "it")


# ---- the cache


def test_a_roadmap_is_kept_and_read_again(
    task: GraspTask, road: Roadmap, cached: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Read where it is whole, built again with one line where it is damaged."""
    told: list[str] = []
    again = roadmap_for(task, tell=told.append)
    assert not told and str(again) == str(road)
    for name in ("bases", "joints", "forces", "stands", "fingers"):
        np.testing.assert_array_equal(getattr(again, name), getattr(road, name))
    kept = next((cached / "roadmap").glob("*.arrays"))
    kept.write_bytes(kept.read_bytes()[:-100])
    monkeypatch.setattr(roadmap, "build_roadmap", lambda *_, **__: road)
    roadmap_for(task, tell=told.append)
    assert len(told) == 1 and "damaged" in told[0]
    assert roadmap_for(task, tell=told.append) is not road and len(told) == 1


def test_a_roadmap_that_is_cut_short_is_not_kept(task: GraspTask, cached: Path) -> None:
    """What a budget in seconds gives depends on the machine."""
    before = len(list((cached / "roadmap").glob("*")))
    other = replace(task, mu=0.46)
    told: list[str] = []
    for _ in range(2):  # built again
        roadmap_for(other, max_cpu_s=1e-9, tell=told.append)
    assert len(told) == 2
    assert len(list((cached / "roadmap").glob("*"))) == before


def test_grasps_that_serve_two_poses_are_grasps_on_both(task: GraspTask, road: Roadmap) -> None:
    """Of the same seed the same; every pose has grasps, and some of them move the box."""
    assert road.stands.any(axis=0).all()
    assert (road.stands.sum(axis=1) > 1).any()
    assert (road.forces_towards(-Z)[road.stands[:, 0]] < 12.0).any()


# ---- bad input


@pytest.mark.parametrize(
    ("goal", "told"),
    [
        (np.diag([1.0, 1.0, -1.0]), "goal is no rotation"),
        (2.0 * np.eye(3), "goal is no rotation"),
        (np.full((3, 3), np.nan), "goal"),
        (np.eye(2), "goal"),
    ],
)
def test_a_goal_is_a_rotation(goal: FloatArray, told: str) -> None:
    """Orthonormal, with determinant 1."""
    with pytest.raises(TaskError, match=told):
        plan_reorientation("allegro_hand", parse_object(BOX), goal)
    np.testing.assert_array_equal(checked_rotation("goal", turn(X, 10.0), ""), turn(X, 10.0))


def test_what_cannot_begin_is_refused() -> None:
    """No table, a pose in which it falls, in the air, on an arm, tilts that are none."""
    box, goal = parse_object(BOX), turn(X, 90.0)
    with pytest.raises(TaskError, match="there is no table"):
        plan_reorientation("allegro_hand", box, goal, table_height=None)
    tilted = SE3(turn(X, 30.0), np.array([0.0, 0.0, 0.0472]))
    with pytest.raises(TaskError, match=r"turned by 30\.0 degrees from its nearest stable pose"):
        plan_reorientation("allegro_hand", box, goal, T_world_object=tilted)
    with pytest.raises(TaskError, match=r"floats 0\.1000 m above"):
        plan_reorientation(
            "allegro_hand", box, goal, T_world_object=SE3(np.eye(3), np.array([0, 0, 0.14]))
        )
    with pytest.raises(TaskError, match="is on an arm"):
        plan_reorientation("allegro_on_arm7", box, goal)
    with pytest.raises(TaskError, match="goal_tilt"):
        plan_reorientation("allegro_hand", box, goal, goal_tilt=4.0)


def test_a_goal_that_does_not_stand_tells_the_nearest_that_does_before_a_roadmap_is_built(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """30 degrees from standing, whatever grasps there are."""
    monkeypatch.setattr(goals, "roadmap_for", lambda *_, **__: pytest.fail("it was built"))
    with pytest.raises(UnreachableError, match="does not stand as it is turned there") as caught:
        plan_reorientation("allegro_hand", parse_object(BOX), turn(X, 30.0), put_down=True)
    assert caught.value.off_deg == pytest.approx(30.0)
    np.testing.assert_allclose(caught.value.nearest, np.eye(3), atol=1e-9)


def test_a_palm_that_may_not_tilt_tells_the_nearest_goal(
    cached: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A cylinder has one stable pose: upside down it is not reached with the palm down."""
    monkeypatch.setattr(goal_moves, "FINGER_TRIES", 1)
    with pytest.raises(UnreachableError, match="palm tilted too far there") as caught:
        plan_reorientation(
            "allegro_hand", parse_object("cylinder:0.03x0.08"), turn(X, 180.0), goal_tilt=0.7
        )
    error = caught.value
    assert error.nearest is not None and error.off_deg is not None
    assert rotation_angle(error.nearest.T @ turn(X, 180.0)) == pytest.approx(
        math.radians(error.off_deg)
    )
    again = plan_reorientation(
        "allegro_hand", parse_object("cylinder:0.03x0.08"), error.nearest, goal_tilt=0.7
    )
    np.testing.assert_allclose(again.chain[-1].ending.T_world_target.rotation, error.nearest)


def test_a_wrist_that_may_not_tilt_tells_how_many_grasps_that_excludes(road: Roadmap) -> None:
    with pytest.raises(UnreachableError, match=r"palm tilted") as caught:
        plan_reorientation(
            "allegro_hand", parse_object(BOX), turn(X, 90.0), wrist_tilt=math.radians(5.0)
        )
    told = str(caught.value)
    tilted = sum(int(n) for n in re.findall(r"(\d+) (?:more )?have the palm tilted", told))
    whole = re.search(r"of (\d+) grasps", told)
    assert whole is not None and 0 < tilted <= int(whole[1])
    assert " 0 " not in told.partition(";")[0]
    assert ("the others fail" in told) == (tilted < int(whole[1]))


@pytest.mark.parametrize(
    ("turned", "reached"),
    [((X, 30.0), True), ((X, 34.0), True), ((X, 36.0), False), ((X, -30.0), False)],
)
def test_an_object_is_at_its_goal_by_the_angle_between_them(
    turned: tuple[FloatArray, float], reached: bool
) -> None:
    """Five degrees are allowed; the goal is itself a turn."""
    goal, now = SE3(turn(X, 30.0), np.ones(3)), SE3(turn(*turned), np.zeros(3))
    fault, numbers = at_goal(goal, now, SuccessCriteria())
    assert (fault == "") == reached
    assert numbers["goal_off_deg"] == pytest.approx(abs(turned[1] - 30.0))


@pytest.mark.parametrize(
    ("given", "told"),
    [
        (["--put-down"], "there is no --goal"),
        (["--goal", "1,2"], "give three"),
        (["--goal", "0,0,0", "--rotate", "z:20"], "leave --rotate out (--rotate: --goal is the ro"),
        (["--in-palm", "--mu", "0.4"], "leave --mu out (--mu: no contact is planned; --sim-mu is"),
        (
            ["--in-palm", "--place", "0,0", "--stand", "0.1", "--gait"],
            "out (--stand, --place: the object lies in the palm, and there is no table; --gait: ",
        ),
        (["--goal", "0,0,0", "--wrist-tilt", "nan"], "it is 'nan'; it should be"),
    ],
)
def test_the_command_refuses(
    given: list[str], told: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """Options that do not go together, and goals that are none."""
    with pytest.raises(SystemExit):
        main(["manipulate", "allegro_hand", "box", *given])
    assert told in " ".join(capsys.readouterr().err.split())


def test_every_option_that_is_refused_has_a_reason() -> None:
    """With --goal and with --in-palm; files and the demonstration are refused before."""
    commands: Any = typer.main.get_command(app)
    parameters = {p.name for p in commands.commands["manipulate"].params}
    first = {"plan_file", "demo"}
    assert parameters - GOAL - first == WITH_GOAL.keys()
    assert parameters - WITH_PALM - first == IN_PALM.keys()


# ---- executed


@pytest.mark.slow
def test_a_chain_is_executed_to_its_goal(road: Roadmap, tmp_path: Path) -> None:
    """Set down on its side, picked up again, and held upside down; a fault is found out."""
    plan = plan_reorientation(
        "allegro_hand", parse_object(BOX), turn(X, 180.0), goal_tilt=math.radians(80.0)
    )
    film = tmp_path / "film.gif"
    report = manipulate(plan, timeline=QUICK, pictures=tmp_path, video=film)
    before = report.earlier
    assert before is not None and (film.is_file() or not before.pictures)  # without OpenGL none
    if before.pictures:  # each movement has its own
        assert (tmp_path / "film-2.gif").is_file() and "film-2.gif" in report.drawn
        assert all(Path(p).name.startswith("2-") for p in report.pictures.values())
        assert not any(Path(p).name.startswith("2-") for p in before.pictures.values())
        assert all(
            Path(p).is_file() for p in (*before.pictures.values(), *report.pictures.values())
        )
    assert report.goal_reached and report.earlier is not None and report.earlier.complete
    assert report.numbers()["goal_off_deg"] < 3.0
    assert "goal reached" in str(report)
    assert report.to_file().numbers["goal_off_deg"] == pytest.approx(np.rad2deg(report.goal_off))


@pytest.mark.slow
def test_an_object_off_its_goal_fails(sideways: ManipulationPlan) -> None:
    """Judged by where the object is, not by what was planned."""
    strict = replace(manipulate(sideways, timeline=QUICK).criteria, goal_deg=1e-6)
    report = manipulate(sideways, timeline=QUICK, criteria=strict)
    assert not report.goal_reached and "off its goal" in report.reason


def test_a_file_that_cannot_be_written_is_refused_before_a_goal_is_planned(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(
        "sim.cli.manipulate.TurnOptions.plan_goal", lambda *_: pytest.fail("planned")
    )
    asked = ["manipulate", "shadow_hand", "box", "--goal", "0,90,0", "--plan-only"]
    done = CliRunner().invoke(app, [*asked, "--out", str(tmp_path / "none" / "goal.json")])
    assert done.exit_code == EXIT_BAD_INPUT
    assert "none" in done.output
