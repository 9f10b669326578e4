"""Tasks and plans hold copies: whoever changes what he gave changes neither."""

from __future__ import annotations

import pickle
from collections.abc import Iterator
from contextlib import suppress
from copy import copy, deepcopy
from dataclasses import fields, is_dataclass, replace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from planner.batch.diversity import GraspFeatures
from planner.collision.pad_contact import pad_contacts
from planner.errors import TaskError
from planner.hands.hand import Hand
from planner.immutable import FixedPose, fixed_pose
from planner.motion import plan_motion
from planner.motion.path import ObjectPath
from planner.objects import TouchRegion, parse_object, parse_region
from planner.plan import GraspPlan
from planner.search.grasp import plan_grasp
from planner.shapes import Shape
from planner.spatial import SE3
from planner.task import GraspTask, Obstacle

TOUCH = 5e-4
"""What counts as touching, m."""


def worst_gap(plan: GraspPlan) -> float:
    """Largest distance (m) of a pad from the surface, in a task made anew."""
    task = replace(plan.task, T_world_object=SE3(plan.task.T_world_object))
    return max(abs(t.pad_gap) for t in pad_contacts(task, plan.T_world_base, plan.q))


def test_a_pose_that_the_caller_moves_moves_no_task(allegro: Hand) -> None:
    # as it was reported: plan, move the pose that was given by 20 mm, plan again
    given = SE3(np.eye(3), np.array([0.0, 0.0, 0.05]))
    task = GraspTask.create(allegro, "cylinder:0.03x0.10", T_world_object=given)
    before = plan_grasp(task, seed=0)
    given.translation = given.translation + np.array([0.02, 0.0, 0.0])
    for seed in range(4):
        plan = plan_grasp(task, seed=seed)
        assert worst_gap(plan) <= TOUCH
        assert plan.task.T_world_object.translation.tolist() == [0.0, 0.0, 0.05]
    assert (plan_grasp(task, seed=0).q == before.q).all()


def test_nothing_that_is_given_is_kept(allegro: Hand) -> None:
    poses = {name: SE3(np.eye(3), np.array([0.0, 0.0, 0.3])) for name in ("object", "base", "wall")}
    size, gravity = np.full(3, 0.02), np.array([0.0, 0.0, -9.81])
    wall = Obstacle(name="wall", size=size, T_world_obstacle=poses["wall"])
    obstacles = [wall]
    task = GraspTask.create(
        allegro,
        "box",
        T_world_object=poses["object"],
        T_world_base=poses["base"],
        obstacles=obstacles,
        gravity=gravity,
    )
    for pose in poses.values():
        pose.setRandom()
    size[:], gravity[:] = 9.0, 9.0
    obstacles.clear()
    for pose in (task.T_world_object, task.T_world_base, task.obstacles[0].T_world_obstacle):
        assert pose is not None and pose.translation.tolist() == [0.0, 0.0, 0.3]
        assert (pose.rotation == np.eye(3)).all()
    assert task.obstacles[0].size.tolist() == [0.02] * 3
    assert task.gravity.tolist() == [0.0, 0.0, -9.81]


def test_the_wrist_that_is_given_is_not_kept(shadow: Hand) -> None:
    wrist = np.zeros(len(shadow.wrist_index))
    task = GraspTask.create(shadow, "box", wrist_q=wrist)
    wrist[:] = 0.1
    assert not task.wrist_q.any()


def parts_of(value: Any, path: str, seen: set[int]) -> Iterator[tuple[str, Any]]:
    """Arrays and poses that are reached from a value, with the way to each."""
    if id(value) in seen or isinstance(value, Hand | Shape):  # those are made by us
        return
    seen.add(id(value))
    if isinstance(value, np.ndarray | pin.SE3):
        yield path, value
    elif is_dataclass(value):
        for one in fields(value):
            yield from parts_of(getattr(value, one.name), f"{path}.{one.name}", seen)
    elif isinstance(value, tuple | list):
        for k, one in enumerate(value):
            yield from parts_of(one, f"{path}[{k}]", seen)
    elif isinstance(value, dict):
        raise AssertionError(f"{path} is a dictionary, which can be changed")


def changeable(value: Any) -> list[str]:
    """What of a value can be changed in place."""
    return [
        path
        for path, part in parts_of(value, type(value).__name__, set())
        if not isinstance(part, FixedPose)
        and not (isinstance(part, np.ndarray) and not part.flags.writeable)
    ]


def test_everything_that_a_task_holds_is_read_only(shadow: Hand) -> None:
    touch = TouchRegion(allowed=(parse_region("z>-0.1"),), required={"thumb": parse_region("x>-1")})
    pose = SE3(np.eye(3), np.array([0.0, 0.0, 0.3]))
    task = GraspTask.create(
        shadow,
        parse_object("box", touch=touch),
        T_world_object=pose,
        T_world_base=pose,
        obstacles=[Obstacle(name="wall", size=np.ones(3), T_world_obstacle=pose)],
        wrist_q=np.zeros(len(shadow.wrist_index)),
    )
    for one in (task, replace(task, mu=0.4), task.with_fingers(["thumb", "index", "middle"])):
        assert changeable(one) == []
    assert changeable(task.obstacles[0].moved(np.ones(3))) == []
    with pytest.raises(TypeError):
        touch.required["index"] = parse_region("x>0")  # type: ignore[index]


def test_what_makes_a_plan_is_read_only(shadow: Hand, allegro: Hand) -> None:
    plan = plan_grasp(GraspTask.create(allegro, "box"), seed=0)
    proven = ("task", "T_world_base", "T_world_base_start", "q", "q_pregrasp", "contacts", "arm")
    assert [p for name in proven for p in changeable(getattr(plan, name))] == []
    epsilon = plan.quality.epsilon
    with pytest.raises(ValueError, match="read-only"):
        plan.q[0] = 1.0
    with pytest.raises(AttributeError):
        plan.T_world_base.translation = np.zeros(3)
    assert plan.quality.epsilon == epsilon
    task = GraspTask.create(shadow, "cylinder:0.03x0.08", fingers=["thumb", "index", "middle"])
    motion = plan_motion(task, angle=0.3, seed=0)
    kept = [motion.path.axis, motion.path.shift]
    kept += [a for knot in motion.knots for a in (knot.T_world_object, knot.q, knot.slips)]
    assert [path for part in kept for path in changeable(part)] == []


def test_a_path_keeps_copies() -> None:
    axis, shift = np.array([0.0, 0.0, 1.0]), np.array([0.01, 0.0, 0.0])
    path = ObjectPath(axis=axis, angle=1.0, shift=shift)
    axis[:], shift[:] = 5.0, 5.0
    assert path.axis.tolist() == [0.0, 0.0, 1.0]
    assert path.shift.tolist() == [0.01, 0.0, 0.0]
    assert not path.axis.flags.writeable
    assert not path.shift.flags.writeable


def test_a_fixed_pose_is_a_pose_like_any_other() -> None:
    pose = SE3.Random()
    fixed = fixed_pose(pose)
    assert fixed_pose(fixed) is fixed
    assert isinstance(fixed, pin.SE3)
    assert fixed == pose
    assert (fixed.homogeneous == pose.homogeneous).all()
    assert (fixed.rotation == pose.rotation).all()
    assert ((fixed * pose).homogeneous == (pose * pose).homogeneous).all()
    assert (fixed.inverse().homogeneous == pose.inverse().homogeneous).all()
    assert (fixed.act(np.ones(3)) == pose.act(np.ones(3))).all()
    assert (pin.log6(fixed).vector == pin.log6(pose).vector).all()
    for other in (pickle.loads(pickle.dumps(fixed)), copy(fixed), deepcopy(fixed), SE3(fixed)):
        assert other == fixed
    free = SE3(fixed)
    free.translation = np.zeros(3)
    assert not (fixed.translation == 0.0).all()


@pytest.mark.parametrize(
    "change",
    [
        lambda T: T.setIdentity(),
        lambda T: T.setRandom(),
        lambda T: setattr(T, "translation", np.zeros(3)),
        lambda T: setattr(T, "rotation", np.eye(3)),
        lambda T: T.translation.__setitem__(0, 1.0),
        lambda T: T.rotation.__setitem__((0, 0), 7.0),
        lambda T: T.homogeneous.__setitem__((0, 0), 7.0),
    ],
)
def test_a_fixed_pose_cannot_be_changed(change: Any) -> None:
    fixed = fixed_pose(SE3.Random())
    before = fixed.homogeneous.copy()
    with suppress(AttributeError, ValueError):
        change(fixed)
    assert (fixed.homogeneous == before).all()


@pytest.mark.parametrize("pose", [np.eye(4), "here", 3.0])
def test_what_is_no_pose_is_refused(allegro: Hand, pose: Any) -> None:
    with pytest.raises(TaskError, match=r"give a pinocchio\.SE3"):
        Obstacle(name="wall", size=np.ones(3), T_world_obstacle=pose)
    with pytest.raises(TaskError, match=r"give a pinocchio\.SE3"):
        replace(GraspTask.create(allegro, "box"), T_world_object=pose)


@pytest.mark.parametrize("name", ["gravity", "wrist_q"])
def test_what_are_no_numbers_is_refused(shadow: Hand, name: str) -> None:
    given: Any = {name: "down"}
    with pytest.raises(TaskError, match=f"{name} is"):
        GraspTask.create(shadow, "box", **given)
    with pytest.raises(TaskError, match="size"):
        Obstacle(name="wall", size="large", T_world_obstacle=SE3.Identity())  # type: ignore[arg-type]


def test_grasps_with_fewer_fingers_are_compared_with_the_others() -> None:
    n, c, d = 3, 4, 2
    contacts = np.zeros((n, c, 3))
    contacts[1:, 3] = np.nan  # the second and the third spare a finger
    grasps = GraspFeatures(
        positions=np.zeros((n, 3)),
        rotations=np.tile(np.eye(3), (n, 1, 1)),
        approach=np.tile([0.0, 0.0, 1.0], (n, 1)),
        contacts=contacts,
        q=np.zeros((n, d)),
    )
    from planner.batch.diversity import thin

    assert thin(grasps).tolist() == [0, 1]
