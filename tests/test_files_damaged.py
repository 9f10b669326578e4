"""Damaged plan files: each kind of damage is refused by name, and none ends in a traceback."""

from __future__ import annotations

import copy
import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from planner.errors import FileFormatError, HandError, PlannerError
from planner.files import plan_to_dict, read_plan, write_plan
from planner.hand_loading import load_hand
from planner.hands.hand import Hand
from planner.plan import GraspPlan
from planner.search.grasp import plan_grasp
from planner.spatial import SE3
from planner.system.package import models_dir
from planner.task import GraspTask, Obstacle

Json: TypeAlias = Any
Read: TypeAlias = Callable[[Json], GraspPlan]


@pytest.fixture(scope="module")
def plan(allegro: Hand) -> GraspPlan:
    pose = SE3(np.eye(3), np.array([0.3, 0.0, 0.15]))
    wall = Obstacle(name="wall", size=np.array([0.02, 0.3, 0.3]), T_world_obstacle=pose)
    return plan_grasp(GraspTask.create(allegro, "box", obstacles=(wall,)), seed=3)


@pytest.fixture(scope="module")
def good(plan: GraspPlan) -> Json:
    return json.loads(json.dumps(plan_to_dict(plan)))


@pytest.fixture(scope="module")
def read(allegro: Hand, tmp_path_factory: pytest.TempPathFactory) -> Read:
    """Reads plain data as a plan file of the session's hand."""
    path = tmp_path_factory.mktemp("plans") / "plan.json"

    def read(data: Json) -> GraspPlan:
        path.write_text(data if isinstance(data, str) else json.dumps(data), encoding="utf-8")
        return read_plan(path, hand=allegro)

    return read


def edited(good: Json, *changes: tuple[str, Json]) -> Json:
    """A copy with values replaced at dotted paths; ``...`` deletes."""
    data = copy.deepcopy(good)
    for where, value in changes:
        *path, last = [int(k) if k.isdigit() else k for k in where.split(".")]
        inner = data
        for key in path:
            inner = inner[key]
        if value is ...:
            del inner[last]
        else:
            inner[last] = value
    return data


LIMIT = 1.0e4
DAMAGE: list[tuple[list[tuple[str, Json]], type[PlannerError], str]] = [
    ([("format", "opposable-trial")], FileFormatError, "not a plan file: its format is 'opposable"),
    ([("format", ...)], FileFormatError, "not a plan file: its format is None"),
    (
        [("version", 99)],
        FileFormatError,
        "plan version 99; this Opposable reads version 1 or 2 or 3 or 4; plan ag",
    ),
    ([("version", ...)], FileFormatError, "plan version None"),
    (
        [("task.hand.sha256", "0" * 64)],
        FileFormatError,
        "a different 'allegro_hand' than .*plan ag",
    ),
    ([("grasp.q_rad", ...)], FileFormatError, "is damaged: grasp.q_rad is missing"),
    ([("grasp.colour", "red")], FileFormatError, "grasp.colour is no field"),
    (
        [("grasp.q_rad.3", float("nan"))],
        FileFormatError,
        "grasp.q_rad.3 is nan; it should be a finite",
    ),
    ([("grasp.q_rad.3", None)], FileFormatError, "grasp.q_rad.3 is None; it should be a number"),
    (
        [("grasp.q_rad.3", "bent")],
        FileFormatError,
        "grasp.q_rad.3 is 'bent'; it should be a number",
    ),
    ([("grasp.q_rad", 0.5)], FileFormatError, "grasp.q_rad is 0.5; it should be a list"),
    ([("task", [])], FileFormatError, r"task is \[\]; it should be"),
    ([("grasp.joint_names.0", "index_1")], FileFormatError, "other joints than allegro_hand"),
    ([("grasp.q_rad", [0.1])], HandError, r"q_rad has shape \(1,\); allegro_hand needs \(16,\)"),
    ([("grasp.q_rad.1", LIMIT)], HandError, r"q_rad: joint index_1 is at 10000.*outside its range"),
    ([("grasp.q_pregrasp_rad.1", -LIMIT)], HandError, "q_pregrasp_rad: joint index_1"),
    ([("contacts.1.position_world_m.0", 0.2)], FileFormatError, "contacts are not those of its"),
    ([("contacts.1.finger", "ring")], FileFormatError, "contacts are not those of its"),
    (
        [("contacts.0.normal_into_object_world", [0, 0, 1])],
        FileFormatError,
        "contacts are not those of its",
    ),
    ([("contacts.0.force_normal_N", 9.0)], FileFormatError, "contacts are not those of its"),
    (
        [("contacts.0.tangent1_world", [0.6, 0, 0.8])],
        FileFormatError,
        "contacts are not those of its",
    ),
    ([("joint_torques_N_m.3", 9.0)], FileFormatError, "torques are not those of its joints"),
    (
        [("task.gravity_m_s2.1", 1e300)],
        FileFormatError,
        "gravity_m_s2.1 is 1e.300; it should be less th",
    ),
    ([("contacts", [])], FileFormatError, "contacts are not those of its"),
    (
        [("grasp.T_world_base.position_m.2", 0.5)],
        FileFormatError,
        "fails its checks: true geometry",
    ),
    (
        [("grasp.T_world_base.quaternion_wxyz", [0, 0, 0, 0])],
        FileFormatError,
        "quaternion .* is not of unit length",
    ),
    (
        [("grasp.T_world_base.quaternion_wxyz.1", 1e5)],
        FileFormatError,
        "quaternion .* is not of unit length",
    ),
    (
        [("grasp.T_world_base_start.position_m.2", 0.0)],
        FileFormatError,
        "fails its checks: approac",
    ),
    ([("task.fingers.1", "nose")], PlannerError, "no finger of allegro_hand is called 'nose'"),
    ([("task.fingers.1", "thumb")], PlannerError, "a finger is named twice"),
    ([("task.mu", 0.0)], PlannerError, "mu is 0"),
    (
        [("task.object.mass_kg", -1.0)],
        FileFormatError,
        "task.object.mass_kg is .*; it should be great",
    ),
    ([("task.object.mass_kg", 50.0)], FileFormatError, "fails its checks: forces"),
    ([("task.object.shape.kind", "cone")], PlannerError, "no shape is called 'cone'"),
    ([("task.obstacles.0.size_m.1", -0.3)], PlannerError, "obstacle 'wall': size"),
]


@pytest.mark.parametrize(("changes", "error", "message"), DAMAGE, ids=[d[0][0][0] for d in DAMAGE])
def test_a_damaged_file_is_refused(
    good: Json,
    read: Read,
    changes: list[tuple[str, Json]],
    error: type[PlannerError],
    message: str,
) -> None:
    with pytest.raises(error, match=message):
        read(edited(good, *changes))


def test_swapped_joint_values_are_refused(good: Json, read: Read) -> None:
    q = good["grasp"]["q_rad"]
    with pytest.raises(PlannerError, match=r"fails its checks|outside its range"):
        read(edited(good, ("grasp.q_rad.2", q[14]), ("grasp.q_rad.14", q[2])))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "damaged or not JSON"),
        ("[1, 2]", "holds a list; plan file is a JSON object"),
        ("[" * 100_000, "damaged or not JSON"),
        ('{"format": ' + "1" * 5000 + "}", "damaged or not JSON"),
    ],
    ids=["empty", "list", "too deep", "endless number"],
)
def test_a_file_that_is_no_json_object_is_refused(read: Read, text: str, message: str) -> None:
    with pytest.raises(FileFormatError, match=message):
        read(text)


def test_a_truncated_file_is_refused_wherever_it_ends(good: Json, read: Read) -> None:
    text = json.dumps(good)
    for end in range(1, len(text), 400):
        with pytest.raises(FileFormatError, match="damaged or not JSON"):
            read(text[:end])


def test_files_that_cannot_be_read(tmp_path: Path) -> None:
    with pytest.raises(FileFormatError, match=r"cannot read plan file .*gone.json: No such file"):
        read_plan(tmp_path / "gone.json")
    with pytest.raises(FileFormatError, match="cannot read plan file"):
        read_plan(tmp_path)
    (tmp_path / "picture.png").write_bytes(b"\x89PNG\r\n\xff\xfe")
    with pytest.raises(FileFormatError, match="damaged or not JSON"):
        read_plan(tmp_path / "picture.png")


def test_a_hand_that_has_changed_since_is_refused(plan: GraspPlan, tmp_path: Path) -> None:
    """The description file grows by a comment; the same hand, but nobody can know."""
    shutil.copytree(models_dir() / "hands" / "allegro_hand", tmp_path / "hand")
    with (tmp_path / "hand" / "hand.toml").open("a", encoding="utf-8") as file:
        file.write("# repaired\n")
    write_plan(plan, tmp_path / "plan.json")
    with pytest.raises(FileFormatError, match="the files have changed since; plan again, or give"):
        read_plan(tmp_path / "plan.json", hand=load_hand(tmp_path / "hand"))


ANYTHING = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(),
    st.floats(),
    st.sampled_from([1e300, -1e300, 1e160, 1e-300, 0.0, -1.0, [1e300] * 3, [0.0] * 4, "\x00", "/"]),
    st.text(max_size=5),
    st.lists(st.floats(), max_size=4),
    st.dictionaries(st.text(max_size=3), st.integers(), max_size=2),
)


@given(data=st.data())
@settings(max_examples=80, deadline=None, suppress_health_check=[HealthCheck.too_slow])
def test_any_mutation_is_a_plan_or_an_error_that_the_user_can_read(
    good: Json, read: Read, data: st.DataObject
) -> None:
    """One or two values anywhere become something else, vanish, or change places."""
    mutated = copy.deepcopy(good)
    for _ in range(data.draw(st.integers(1, 2))):
        inner, key = mutated, data.draw(st.sampled_from(sorted(mutated)))
        while isinstance(inner[key], (dict, list)) and inner[key] and data.draw(st.booleans()):
            inner = inner[key]
            keys = sorted(inner) if isinstance(inner, dict) else list(range(len(inner)))
            key = data.draw(st.sampled_from(keys))
        change = data.draw(st.sampled_from(["set", "set", "scale", "delete", "add"]))
        if change == "set":
            # a copy: the second change may be made in it, and the next example draws it again
            inner[key] = copy.deepcopy(data.draw(ANYTHING))
        elif change == "scale" and isinstance(inner[key], float):
            inner[key] *= data.draw(st.sampled_from([-1.0, 1.0001, 1e10, 1e200, 1e-200]))
        elif change == "add" and isinstance(inner, dict):
            inner[data.draw(st.text(max_size=3))] = copy.deepcopy(data.draw(ANYTHING))
        elif isinstance(inner, list) or len(inner) > 1:
            del inner[key]
    try:
        plan = read(mutated)
    except PlannerError as error:
        assert str(error)
    else:
        assert plan.verification.ok and plan.forces.found
