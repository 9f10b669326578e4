"""What a task fills in, and that one that cannot work is refused at once, in words that help."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planner.contacts.friction import LOAD_SAFETY, ExpectedLoad, grip_for_load
from planner.errors import HandError, NotFoundError, PlannerError, TaskError
from planner.hands.hand import Hand
from planner.objects import GraspObject, parse_object
from planner.search.grasp import attempts, plan_grasp
from planner.spatial import SE3
from planner.synthesis.problem import GraspProblem
from planner.task import DEFAULT_MU, FLOATING_TOL, GRAVITY, GraspTask, Obstacle

NAN, INF = float("nan"), float("inf")


def at(*position: float) -> SE3:
    return SE3(np.eye(3), np.array(position))


def test_defaults(allegro: Hand) -> None:
    """A box of 0.05 x 0.05 x 0.08 m and 0.1 kg rests on the table; four fingers, mu 0.5."""
    task = GraspTask.create(allegro, "box")
    assert task.finger_names == ("thumb", "index", "middle", "ring")
    assert tuple(f.name for f in task.fingers) == task.finger_names
    np.testing.assert_array_equal(task.T_world_object.translation, [0, 0, 0.04])
    np.testing.assert_array_equal(task.gravity, GRAVITY)
    assert (task.table_height, task.mu, task.contact_model) == (0.0, DEFAULT_MU, "point")
    # 0.1 kg * 9.81 over mu 0.5 and four fingers is 0.49 N; twice that is below the least grip
    assert task.grip_force == 1.5


def test_default_grip_carries_twice_the_weight_by_friction(allegro: Hand) -> None:
    """By hand: 2 * 1 kg * 9.81 / (0.5 * 4) = 9.81 N per finger."""
    task = GraspTask.create(allegro, parse_object("box", mass=1.0))
    assert task.grip_force == pytest.approx(9.81)
    on_the_moon = GraspTask.create(allegro, parse_object("box", mass=1.0), gravity=(0, 0, -1.62))
    assert on_the_moon.grip_force == pytest.approx(1.62)


def test_fewer_fingers_grip_harder_and_never_less_than_asked(allegro: Hand) -> None:
    """By hand: 2 * 1 kg * 9.81 / (0.5 * 3) = 13.08 N per finger."""
    three = ["thumb", "index", "middle"]
    task = GraspTask.create(allegro, parse_object("box", mass=1.0)).with_fingers(three)
    assert task.finger_names == tuple(three)
    assert task.grip_force == pytest.approx(13.08)
    strong = GraspTask.create(allegro, parse_object("box", mass=1.0), grip_force=20.0)
    assert strong.with_fingers(three).grip_force == 20.0
    with pytest.raises(TaskError, match="at least 3"):
        task.with_fingers(three[:2])


def test_object_rests_on_a_raised_table(allegro: Hand) -> None:
    task = GraspTask.create(allegro, "sphere", table_height=0.7)
    np.testing.assert_allclose(task.T_world_object.translation, [0, 0, 0.735], atol=1e-12)


def test_fingers_and_wrist_are_taken_as_given(shadow: Hand) -> None:
    task = GraspTask.create(shadow, "box", fingers=["little", "thumb", "index"], wrist_q=[0.1, 0.2])
    assert task.finger_names == ("little", "thumb", "index")
    np.testing.assert_array_equal(task.wrist_q, [0.1, 0.2])
    np.testing.assert_array_equal(GraspTask.create(shadow, "box").wrist_q, [0, 0])


REFUSED: list[tuple[dict[str, Any], str]] = [
    ({"fingers": ["thumb"]}, r"1 finger\(s\) \['thumb'\].*needs at least 3; name more of.*ring"),
    ({"fingers": ["thumb", "index"]}, r"2 finger\(s\).*point contacts, which needs at least 3"),
    (
        {"fingers": ["thumb", "index"], "contact_model": "soft"},
        r"soft contacts, which needs at least 3.*or give mu_torsion > 0",
    ),
    ({"contact_model": "frictionless"}, "frictionless contacts, which needs at least 7"),
    ({"contact_model": "sticky"}, r"'sticky'; use one of \['frictionless', 'point', 'soft'\]"),
    ({"mu": 0}, "mu is 0: fingertips cannot close a grasp without friction; give mu > 0"),
    ({"mu": NAN}, "mu is nan; give a finite number from 0 to 1000"),
    ({"mu": INF}, "mu is inf; give a finite number from 0 to 1000"),
    ({"mu": -0.5}, "mu is -0.5; give a finite number from 0 to 1000"),
    ({"mu_torsion": -0.001}, "mu_torsion is -0.001; give"),
    ({"grip_force": -1.0}, "grip_force is -1.0; give a finite number >= 0"),
    ({"grip_force": NAN}, "grip_force is nan"),
    ({"gravity": (0.0, -9.81)}, r"gravity is .*-9.81.*; give three finite numbers in m/s2"),
    ({"gravity": 10**400}, "gravity is 10+.*; give three finite numbers"),
    ({"table_height": 10**400}, "table_height has more digits"),
    ({"gravity": (0.0, 0.0, NAN)}, "gravity is"),
    ({"table_height": NAN}, "table_height is nan; give metres, or None for none"),
    ({"T_world_object": at(0, 0, NAN)}, "T_world_object holds NaN or infinity"),
    ({"T_world_base": at(INF, 0, 0)}, "T_world_base holds NaN or infinity"),
    (
        {"T_world_object": at(0, 0, 0.03)},
        r"down to z = -0.0100 m, below the table's top at 0.0000 m; raise T_world_object by 0.0100",
    ),
    ({"fingers": ["thumb", "index", "index"]}, "a finger is named twice.*name each once"),
    ({"wrist_q": [0.1]}, r"wrist_q has shape \(1,\), the hand needs \(0,\)"),
]


@pytest.mark.parametrize(("options", "message"), REFUSED)
def test_a_task_that_cannot_work_is_refused(
    allegro: Hand, options: dict[str, Any], message: str
) -> None:
    with pytest.raises(TaskError, match=message):
        GraspTask.create(allegro, "box", **options)


def test_unknown_finger_gets_the_nearest_name(allegro: Hand) -> None:
    with pytest.raises(NotFoundError, match=r"'midle'. Did you mean 'middle'\? There is: index"):
        GraspTask.create(allegro, "box", fingers=["thumb", "index", "midle"])


@pytest.mark.parametrize("names", [("thumb", "index", "nose"), ("thumb", "index", "index")])
def test_fingers_are_checked_without_create_too(allegro: Hand, names: tuple[str, ...]) -> None:
    """A plan file makes its task by the constructor."""
    good = GraspTask.create(allegro, "box")
    with pytest.raises(PlannerError, match=r"nose|named twice"):
        GraspTask(
            hand=allegro,
            object=good.object,
            T_world_object=good.T_world_object,
            finger_names=names,
            grip_force=1.0,
            wrist_q=good.wrist_q,
        )


@pytest.mark.parametrize(
    ("wrist_q", "error", "message"),
    [
        ([0.0, 0.6], HandError, r"WRJ1 is at 0.6000, outside its range \[-0.6981, 0.4887\]"),
        ([0.0, NAN], HandError, "wrist_q holds NaN"),
        ([0.0], TaskError, r"wrist_q has shape \(1,\), the hand needs \(2,\)"),
    ],
)
def test_wrist_outside_its_range(
    shadow: Hand, wrist_q: list[float], error: type[PlannerError], message: str
) -> None:
    with pytest.raises(error, match=message):
        GraspTask.create(shadow, "box", wrist_q=wrist_q)


@pytest.mark.parametrize("size", [(0.1, 0.1), (0.1, 0.0, 0.1), (0.1, -0.1, 0.1), (0.1, NAN, 0.1)])
def test_obstacle_sizes(size: tuple[float, ...]) -> None:
    with pytest.raises(TaskError, match=r"obstacle 'wall': size .* three lengths > 0 m"):
        Obstacle(name="wall", size=np.array(size), T_world_obstacle=SE3.Identity())


def test_obstacle_pose_with_nan() -> None:
    with pytest.raises(TaskError, match="obstacle 'wall': its pose holds NaN"):
        Obstacle(name="wall", size=np.ones(3), T_world_obstacle=at(0, NAN, 0))


@given(
    angle=st.floats(-np.pi, np.pi),
    axis=st.integers(0, 2),
    gap=st.floats(-0.02, 0.02),
    height=st.floats(-1, 1),
)
@settings(max_examples=40, deadline=None)
def test_a_turned_box_is_refused_exactly_where_it_is_below_the_table_or_floats(
    allegro: Hand, angle: float, axis: int, gap: float, height: float
) -> None:
    """The lowest corner by its eight corners, not by the shape's support function."""
    if min(abs(gap), abs(gap - FLOATING_TOL)) < 1e-5:
        gap = 5e-4
    rotation = pin.exp3(angle * np.eye(3)[axis] + 0.3)
    half = np.array([0.025, 0.025, 0.04])
    corners = np.array(np.meshgrid(*[[-h, h] for h in half])).reshape(3, -1)
    z = height + gap - float((rotation @ corners)[2].min())
    pose = SE3(rotation, np.array([0.1, 0.2, z]))
    if 0 < gap < FLOATING_TOL:
        GraspTask.create(allegro, "box", T_world_object=pose, table_height=height)
        return
    with pytest.raises(TaskError) as caught:
        GraspTask.create(allegro, "box", T_world_object=pose, table_height=height)
    said = re.search(r"(raise T_world_object by|the object floats) ([0-9.]+) m", str(caught.value))
    assert said is not None
    assert said[1] == ("raise T_world_object by" if gap < 0 else "the object floats")
    assert float(said[2]) == pytest.approx(abs(gap), abs=6e-5)


@pytest.mark.parametrize(
    ("spec", "message"),
    [
        ("sphere:0.2", "too large for .*: its pads open .* mm.*use a smaller object, another pose"),
        ("box:0.4x0.3x0.3", "too large for"),
        ("cylinder:0.15x0.1", "too large for"),
        ("sphere:0.0005", "too small for .* pads of .* mm radius do not fit around a ball of 0.5"),
        ("box:0.001x0.001x0.001", "too small for"),
    ],
)
def test_objects_of_impossible_size_are_found_out_before_solving(
    right_hand: Hand, spec: str, message: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """No problem is built, which takes longer than the answer; forty attempts take a minute."""

    def never(*_: object, **__: object) -> None:
        pytest.fail("a problem was built")

    monkeypatch.setattr(GraspProblem, "__init__", never)
    task = GraspTask.create(right_hand, spec)
    with pytest.raises(TaskError, match=message):
        plan_grasp(task)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"seed": -1}, "seed is -1; give an integer >= 0"),
        ({"max_attempts": 0}, "max_attempts is 0; give an integer, at least 1"),
        ({"max_cpu_s": 0.0}, "max_cpu_s is 0.0; give seconds > 0"),
        ({"max_cpu_s": NAN}, "max_cpu_s is nan; give seconds > 0"),
    ],
)
def test_budgets_and_seed_out_of_range(
    allegro: Hand, options: dict[str, Any], message: str
) -> None:
    with pytest.raises(TaskError, match=message):
        plan_grasp(GraspTask.create(allegro, "box"), **options)


def test_a_bad_seed_is_refused_by_attempts_too(allegro: Hand) -> None:
    with pytest.raises(TaskError, match="seed is -3"):
        next(attempts(GraspTask.create(allegro, "box"), seed=-3))


def test_mass_is_checked_by_the_object(allegro: Hand) -> None:
    shape = parse_object("box").shape
    with pytest.raises(PlannerError, match="mass is -1"):
        GraspTask.create(allegro, GraspObject(name="box", shape=shape, mass=-1.0))


def test_an_expected_load_sizes_the_grip(allegro: Hand) -> None:
    """1.5 times (weight + 5 N + 0.1 N m by the radius) over mu and the number of fingers."""
    load = ExpectedLoad(force=5.0, torque=0.1)
    task = GraspTask.create(allegro, "sphere", expected_load=load)
    needed = LOAD_SAFETY * (0.981 + 5.0 + 0.1 / 0.035) / 0.5
    assert task.grip_force == pytest.approx(needed / 4)
    three = task.with_fingers(("thumb", "index", "ring"))
    assert three.grip_force == pytest.approx(needed / 3)
    assert three.expected_load == load
    # without a load, and with a small one, it is the grip for the weight
    assert GraspTask.create(allegro, "sphere").expected_load == ExpectedLoad()
    little = GraspTask.create(allegro, "sphere", expected_load=ExpectedLoad(force=0.1))
    assert little.grip_force == 1.5
    slippery = grip_for_load(load, weight=1.0, lever=0.1, mu=0.25, n_contacts=2)
    assert slippery == pytest.approx(LOAD_SAFETY * 7.0 / 0.5)


def test_a_load_and_a_grip_exclude_each_other(allegro: Hand) -> None:
    with pytest.raises(TaskError, match="grip_force is 2 N, and expected_load would size it"):
        GraspTask.create(allegro, "box", grip_force=2.0, expected_load=ExpectedLoad(force=1.0))
    with pytest.raises(TaskError, match="the expected force is -1; give a finite number >= 0 in N"):
        ExpectedLoad(force=-1)
    with pytest.raises(TaskError, match="the expected torque is nan; give a finite number"):
        ExpectedLoad(torque=float("nan"))
