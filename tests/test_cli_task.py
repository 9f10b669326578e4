"""The whole task on the command line: place, table, obstacles, gravity, grip, base and wrist."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from typer.testing import CliRunner

from planner import plan_grasp
from planner.errors import TaskError
from planner.files import read_plan, write_plan
from planner.objects import GraspObject
from planner.task import GRAVITY as GRAVITY_OF_TASKS
from planner.task import GraspTask
from sim.cli import app
from sim.cli.search import PlanOptions
from sim.cli.tasks import GRAVITY, obstacle_of, pose_of, table_of

pytestmark = pytest.mark.usefixtures("brief_trials")

RUN = CliRunner()


def options(**given: object) -> PlanOptions:
    """Options as the command line makes them."""
    return PlanOptions(**given)  # type: ignore[arg-type]


@pytest.mark.parametrize("name", ["run", "plan", "batch", "manipulate", "states", "learn"])
def test_an_object_before_the_hand_is_recognised(name: str) -> None:
    told = RUN.invoke(app, [name, "box:0.05x0.05x0.05", "shadow_hand"])
    assert told.exit_code == 3
    assert "the hand comes first: shadow_hand box:0.05x0.05x0.05" in " ".join(told.output.split())


def test_a_pose_is_metres_and_degrees_about_fixed_axes() -> None:
    pose = pose_of("--at", "0.1,-0.2,0.3,10,20,30")
    x, y, z = np.radians([10, 20, 30])
    turn = pin.utils.rotate("z", z) @ pin.utils.rotate("y", y) @ pin.utils.rotate("x", x)
    np.testing.assert_allclose(pose.rotation, turn, atol=1e-15)
    np.testing.assert_allclose(pose.translation, [0.1, -0.2, 0.3])
    np.testing.assert_array_equal(pose_of("--at", "1,2,3").rotation, np.eye(3))


def test_an_obstacle_is_a_box_with_a_place() -> None:
    box = obstacle_of("box:0.1x0.2x0.3@1,2,3,0,0,90", 2)
    assert box.name == "obstacle 2"
    np.testing.assert_array_equal(box.size, [0.1, 0.2, 0.3])
    np.testing.assert_allclose(box.T_world_obstacle.rotation[:, 0], [0, 1, 0], atol=1e-15)
    np.testing.assert_array_equal(box.T_world_obstacle.translation, [1, 2, 3])


def test_a_table_has_a_height_or_is_not_there() -> None:
    assert (table_of("0.7"), table_of("none"), table_of(" None")) == (0.7, None, None)


def test_defaults_make_the_task_that_python_makes() -> None:
    told, made = options().task("allegro_hand", "box"), GraspTask.create("allegro_hand", "box")
    assert tuple(map(float, GRAVITY.split(","))) == GRAVITY_OF_TASKS
    for name in ("gravity", "mu", "mu_torsion", "table_height", "grip_force", "contact_model"):
        np.testing.assert_array_equal(getattr(told, name), getattr(made, name))
    assert told.T_world_object == made.T_world_object
    assert (told.T_world_base, told.wrist_free, told.obstacles) == (None, False, ())


def test_all_of_the_task_is_told() -> None:
    task = options(
        at="0.2,0.1",
        pose=2,
        table="0.5",
        obstacle=["box:0.1x0.1x0.1@0.5,0,0.55", "box:0.2x0.1x0.1@-0.5,0,0.55"],
        gravity="0,1,-9",
        mu_torsion=0.004,
        grip_force=3.0,
        base="0,0,1,180,0,0",
        wrist="-5,3",
    ).task("shadow_hand", "box:0.1x0.06x0.02")
    np.testing.assert_allclose(task.T_world_object.translation, [0.2, 0.1, 0.53])
    assert task.lowest_point(task.T_world_object) == pytest.approx(0.5)
    assert [o.size[0] for o in task.obstacles] == [0.1, 0.2]
    np.testing.assert_array_equal(task.gravity, [0, 1, -9])
    assert (task.contact_model, task.mu_torsion, task.grip_force) == ("soft", 0.004, 3.0)
    assert task.T_world_base is not None
    np.testing.assert_allclose(task.T_world_base.rotation, np.diag([1, -1, -1]), atol=1e-15)
    np.testing.assert_allclose(np.degrees(task.wrist_q), [-5, 3])
    assert options(wrist="free").task("shadow_hand", "box").wrist_free


def test_a_place_of_three_numbers_keeps_the_stable_pose() -> None:
    standing = options(pose=2).task("allegro_hand", "box").T_world_object
    held = options(pose=2, table="none", at="0,0,0.3").task("allegro_hand", "box")
    np.testing.assert_array_equal(held.T_world_object.rotation, standing.rotation)
    np.testing.assert_array_equal(held.T_world_object.translation, [0, 0, 0.3])


def test_a_stand_carries_the_object_beside_other_obstacles() -> None:
    task = options(stand=0.03, obstacle=["box:0.1x0.1x0.1@0.5,0,0.05"]).task(
        "allegro_hand", "cylinder:0.04x0.015"
    )
    assert task.lowest_point(task.T_world_object) == pytest.approx(0.03, abs=1e-4)
    assert [o.name for o in task.obstacles][-1] == "obstacle 1"
    assert len(task.obstacles) == 5


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"at": "0"}, "--at '0' has 1 numbers; give x,y for where it stands"),
        ({"at": "0,0,0.2"}, r"floats 0.1600 m .* lower T_world_object \(--at\), .*--table none"),
        ({"at": "0,0,0.02"}, r"raise T_world_object by 0.0200 m \(--at\)"),
        ({"at": "0,0,0.1,0,0,0", "pose": 1}, "so does --pose 1; .* leave --pose out"),
        ({"at": "0,up"}, "--at '0,up' holds something else than numbers"),
        ({"table": "low"}, "the height of its top in m, or none for no table"),
        ({"table": "nan"}, "--table 'nan' is not finite"),
        ({"table": "none", "stand": 0.03}, r"no table for a stand; give table_height \(--table\)"),
        ({"obstacle": ["sphere:0.1@0,0,0"]}, "is not a box with a place; give box:XxYxZ@x,y,z"),
        ({"obstacle": ["box:0.1x0.1x0.1"]}, "is not a box with a place"),
        ({"obstacle": ["box:0.1x0.1x0.1@0,0"]}, "has 2 numbers; give x,y,z or x,y,z,roll"),
        ({"gravity": "0,0"}, "--gravity '0,0' has 2 numbers; give three"),
        ({"wrist": "0"}, "gives 1 angle.*allegro_hand has 0 joint.*: none; give as many degrees"),
        ({"base": "0,0"}, "--base '0,0' has 2 numbers"),
        ({"grip_force": -1.0}, "grip_force is -1.0; give a finite number >= 0"),
        ({"grip_force": 2.0, "expect_load": "5"}, "expected_load would size it; give one of them"),
        ({"mu_torsion": -1.0}, "mu_torsion is -1.0"),
    ],
    ids=str,
)
def test_what_cannot_be_is_named_with_what_can(given: dict[str, object], words: str) -> None:
    with pytest.raises(TaskError, match=words):
        options(**given).task("allegro_hand", "box")


def test_obstacles_in_the_object_are_refused_before_solving(tmp_path: Path) -> None:
    line = ["plan", "allegro_hand", "box", "--obstacle", "box:0.1x0.1x0.1@0,0,0", "-o"]
    done = RUN.invoke(app, [*line, str(tmp_path / "plan.json")])
    assert done.exit_code == 3
    assert "inside 'obstacle 1'; move them apart" in " ".join(done.stderr.split())


@pytest.mark.slow
def test_a_plan_of_all_of_it_is_kept_by_its_file_and_held(tmp_path: Path) -> None:
    file = tmp_path / "plan.json"
    line = (
        "plan shadow_hand box --at 0.2,0.1 --table 0.5 --obstacle box:0.1x0.02x0.1@0.2,0.2,0.55 "
        "--gravity 0,0,-5 --mu-torsion 0.004 --grip-force 2 --wrist free -o"
    )
    done = RUN.invoke(app, [*line.split(), str(file)])
    assert done.exit_code == 0, done.output
    task = read_plan(file).task
    assert (task.table_height, task.wrist_free, task.contact_model) == (0.5, True, "soft")
    assert (len(task.obstacles), task.grip_force, task.gravity[2]) == (1, 2.0, -5.0)
    assert RUN.invoke(app, ["test", str(file)]).exit_code == 0


def test_a_base_that_is_told_is_kept(tmp_path: Path) -> None:
    known = plan_grasp(GraspTask.create("allegro_hand", "box"))
    pose = known.T_world_base
    numbers = [*pose.translation, *np.degrees(pin.rpy.matrixToRpy(pose.rotation))]
    task = options(base=",".join(repr(float(v)) for v in numbers)).task("allegro_hand", "box")
    plan = plan_grasp(task)
    np.testing.assert_allclose(plan.T_world_base.homogeneous, pose.homogeneous, atol=1e-9)
    write_plan(plan, tmp_path / "plan.json")
    assert read_plan(tmp_path / "plan.json").task.T_world_base is not None


@pytest.mark.slow
def test_a_batch_has_the_same_surroundings(tmp_path: Path) -> None:
    line = (
        "batch allegro_hand box -n 1 --workers 1 --table 0.3 "
        "--obstacle box:0.1x0.02x0.1@0,0.2,0.35 --out"
    )
    done = RUN.invoke(app, [*line.split(), str(tmp_path / "grasps")])
    assert done.exit_code == 0, done.output
    assert (
        RUN.invoke(
            app,
            [
                "batch",
                str(tmp_path / "grasps"),
                "--extract",
                "0",
                "-o",
                str(tmp_path / "plan.json"),
            ],
        ).exit_code
        == 0
    )
    task = read_plan(tmp_path / "plan.json").task
    assert (task.table_height, len(task.obstacles)) == (0.3, 1)


def test_a_policy_is_told_of_the_object_that_is_grasped(monkeypatch: pytest.MonkeyPatch) -> None:
    class Met(Exception):
        """The object that the policy is asked about."""

    def meet(self: object, hand: object, item: Callable[[], GraspObject], degrees: object) -> None:
        raise Met(item())

    monkeypatch.setattr("sim.cli.execution.ExecutionOptions.check_policy", meet)
    command = ["run", "allegro_hand", "box:0.1x0.1x0.1", "--density", "500", "--touch", "z>0"]
    with pytest.raises(Met) as met:
        RUN.invoke(app, command, catch_exceptions=False)
    (item,) = met.value.args
    assert item.mass == pytest.approx(0.5)
    assert item.touch is not None
