"""Plan and contacts files: what is written comes back, and what is wrong is refused in words."""

from __future__ import annotations

import copy
import json
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from planner.catalog import models_dir
from planner.errors import ContactError, FileFormatError, HandError, PlannerError
from planner.files import PLAN_VERSION, PlanFile, plan_to_dict, read_contacts, read_plan, write_plan
from planner.hand import Hand
from planner.objects import parse_object
from planner.plan import GraspPlan
from planner.search import plan_grasp
from planner.spatial import SE3
from planner.task import GraspTask, Obstacle

Json: TypeAlias = Any
Read: TypeAlias = Callable[[Json], GraspPlan]


@pytest.fixture(scope="module")
def plan(allegro: Hand) -> GraspPlan:
    """A plan with everything off its default that a file has to keep."""
    wall = Obstacle(
        name="wall",
        size=np.array([0.02, 0.3, 0.3]),
        T_world_obstacle=SE3(pin.exp3(np.array([0.0, 0.0, 0.3])), np.array([0.3, -0.2, 0.25])),
    )
    pose = SE3(pin.exp3(np.array([0.0, 0.0, 0.7])), np.array([0.1, -0.2, 0.141]))
    return plan_grasp(
        GraspTask.create(
            allegro,
            parse_object("box:0.05x0.05x0.08", mass=0.123),
            T_world_object=pose,
            table_height=0.1,
            obstacles=(wall,),
            gravity=(0.1, 0.0, -9.7),
            mu=0.55,
            grip_force=1.7,
        ),
        seed=3,
    )


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


def test_a_plan_comes_back_as_it_was(plan: GraspPlan, tmp_path: Path) -> None:
    """Without a hand given: it is loaded by its name."""
    path = tmp_path / "plan.json"
    write_plan(plan, path)
    back = read_plan(path)
    assert back.q.tobytes() == plan.q.tobytes()
    assert back.q_pregrasp.tobytes() == plan.q_pregrasp.tobytes()
    for name in ("T_world_base", "T_world_base_start", "T_world_palm"):
        a, b = getattr(back, name), getattr(plan, name)
        np.testing.assert_allclose(a.homogeneous, b.homogeneous, rtol=0, atol=1e-14)
    np.testing.assert_allclose(back.contacts.positions, plan.contacts.positions, atol=1e-9)
    np.testing.assert_allclose(back.contacts.frames, plan.contacts.frames, atol=1e-9)
    np.testing.assert_allclose(back.contacts.forces, plan.contacts.forces, atol=1e-6)
    assert back.contacts.fingers == plan.contacts.fingers
    assert (back.record, back.opening) == (plan.record, plan.opening)
    a, b = back.task, plan.task
    assert (a.object.name, a.object.shape, a.object.mass) == ("box", b.object.shape, 0.123)
    for name in ("table_height", "mu", "grip_force", "finger_names", "contact_model", "wrist_free"):
        assert getattr(a, name) == getattr(b, name), name
    np.testing.assert_array_equal(a.gravity, b.gravity)
    assert a.obstacles[0].name == "wall" and a.T_world_base is None
    np.testing.assert_array_equal(a.obstacles[0].size, b.obstacles[0].size)
    np.testing.assert_allclose(
        a.obstacles[0].T_world_obstacle.homogeneous,
        b.obstacles[0].T_world_obstacle.homogeneous,
        atol=1e-14,
    )
    assert not list(tmp_path.glob("*.part"))


def test_a_plan_file_is_read_by_the_json_module_alone(plan: GraspPlan, tmp_path: Path) -> None:
    """Every number has its unit and frame in its name, and they are the plan's numbers."""
    write_plan(plan, tmp_path / "plan.json")
    data = json.loads((tmp_path / "plan.json").read_text(encoding="utf-8"))
    assert (data["format"], data["version"]) == ("opposable-plan", PLAN_VERSION)
    joints = dict(zip(data["grasp"]["joint_names"], data["grasp"]["q_rad"], strict=True))
    assert joints["thumb_3"] == plan.q[plan.task.hand.joint_index("thumb_3")]
    assert data["task"]["object"]["mass_kg"] == 0.123
    # force balance from the file alone: sum of the forces is minus the weight
    total = np.zeros(3)
    for c in data["contacts"]:
        total += c["force_normal_N"] * np.array(c["normal_into_object_world"])
        total += c["force_tangent1_N"] * np.array(c["tangent1_world"])
        total += c["force_tangent2_N"] * np.array(c["tangent2_world"])
    np.testing.assert_allclose(total, -0.123 * np.array(data["task"]["gravity_m_s2"]), atol=1e-6)
    units = ("_m", "_rad", "_N", "_N_m", "_kg", "_s", "_s2", "_wxyz", "_world", "_object")
    without = {"mu", "version", "seed", "attempt", "attempts", "iterations", "wrist_free"}
    for key, value in leaves({k: v for k, v in data.items() if k != "quality"}):
        if isinstance(value, (int, float)) and "smallest_clearances_m" not in key:
            name = next(k for k in reversed(key) if isinstance(k, str))
            assert name.endswith(units) or name in without, key


def leaves(data: Json, at: tuple[Any, ...] = ()) -> Iterator[tuple[tuple[Any, ...], Json]]:
    """Every value that is neither an object nor a list, with its path."""
    pairs = data.items() if isinstance(data, dict) else enumerate(data)
    for key, value in pairs:
        if isinstance(value, (dict, list)):
            yield from leaves(value, (*at, key))
        else:
            yield (*at, key), value


def test_a_plan_file_follows_its_schema(good: Json) -> None:
    assert PlanFile.model_validate(good).model_dump(mode="json") == good
    schema = PlanFile.model_json_schema()
    assert set(schema["required"]) >= {"task", "grasp", "contacts", "record"}
    assert schema["additionalProperties"] is False
    assert set(schema["$defs"]["GraspData"]["required"]) == set(good["grasp"])


LIMIT = 1.0e4
DAMAGE: list[tuple[list[tuple[str, Json]], type[PlannerError], str]] = [
    ([("format", "opposable-trial")], FileFormatError, "not a plan file: its format is 'opposable"),
    ([("format", ...)], FileFormatError, "not a plan file: its format is None"),
    (
        [("version", 99)],
        FileFormatError,
        "plan version 99; this Opposable reads version 1; plan ag",
    ),
    ([("version", ...)], FileFormatError, "plan version None"),
    (
        [("task.hand.sha256", "0" * 64)],
        FileFormatError,
        "a different 'allegro_hand' than .*plan ag",
    ),
    ([("grasp.q_rad", ...)], FileFormatError, "is damaged: grasp.q_rad: Field required"),
    ([("grasp.colour", "red")], FileFormatError, "grasp.colour: Extra inputs are not permitted"),
    ([("grasp.q_rad.3", float("nan"))], FileFormatError, "grasp.q_rad.3: Input should be a finite"),
    ([("grasp.q_rad.3", None)], FileFormatError, "grasp.q_rad.3: Input should be a valid number"),
    ([("grasp.q_rad.3", "bent")], FileFormatError, "grasp.q_rad.3: Input should be a valid number"),
    ([("grasp.q_rad", 0.5)], FileFormatError, "grasp.q_rad: Input should be a valid list"),
    ([("task", [])], FileFormatError, "task: Input should be"),
    ([("grasp.joint_names.0", "index_1")], FileFormatError, "other joints than allegro_hand"),
    ([("grasp.q_rad", [0.1])], HandError, r"q_rad has shape \(1,\); allegro_hand needs \(16,\)"),
    ([("grasp.q_rad.1", LIMIT)], HandError, r"q_rad: joint index_1 is at 10000.*outside its range"),
    ([("grasp.q_pregrasp_rad.1", -LIMIT)], HandError, "q_pregrasp_rad: joint index_1"),
    ([("contacts.1.position_world_m.0", 0.2)], FileFormatError, "contacts are not those of its j"),
    ([("contacts.1.finger", "ring")], FileFormatError, "contacts are not those of its joints"),
    (
        [("contacts.0.normal_into_object_world", [0, 0, 1])],
        FileFormatError,
        "contacts are not those of its joints",
    ),
    ([("contacts", [])], FileFormatError, "contacts are not those of its joints"),
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
        [("grasp.T_world_base.quaternion_wxyz.1", 1e200)],
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
        "task.object.mass_kg: Input should be great",
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
        read_plan(tmp_path / "plan.json", hand=Hand.load(tmp_path / "hand"))


def test_a_failed_write_leaves_nothing_behind(plan: GraspPlan, tmp_path: Path) -> None:
    with pytest.raises(FileFormatError, match=r"cannot write .*plan.json: No such file"):
        write_plan(plan, tmp_path / "nowhere" / "plan.json")
    (tmp_path / "taken").mkdir()
    with pytest.raises(FileFormatError, match=r"cannot write .*taken: Is a directory"):
        write_plan(plan, tmp_path / "taken")
    assert [p.name for p in tmp_path.iterdir()] == ["taken"]


def test_a_failed_write_keeps_the_old_file(
    plan: GraspPlan, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A full disk: half of the text is written, then the system refuses."""
    path = tmp_path / "plan.json"
    write_plan(plan, path)
    old = path.read_text(encoding="utf-8")

    def full(self: Path, text: str, encoding: str) -> int:
        with self.open("w", encoding=encoding) as file:
            file.write(text[:100])
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "write_text", full)
    with pytest.raises(FileFormatError, match="No space left on device"):
        write_plan(plan, path)
    assert path.read_text(encoding="utf-8") == old
    assert list(tmp_path.iterdir()) == [path]


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
@settings(max_examples=300, deadline=None, suppress_health_check=[HealthCheck.too_slow])
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
            inner[key] = data.draw(ANYTHING)
        elif change == "scale" and isinstance(inner[key], float):
            inner[key] *= data.draw(st.sampled_from([-1.0, 1.0001, 1e10, 1e200, 1e-200]))
        elif change == "add" and isinstance(inner, dict):
            inner[data.draw(st.text(max_size=3))] = data.draw(ANYTHING)
        elif isinstance(inner, list) or len(inner) > 1:
            del inner[key]
    try:
        plan = read(mutated)
    except PlannerError as error:
        assert str(error)
    else:
        assert plan.verification.ok and plan.forces.found


TYPED = {
    "contacts": [
        {"position_m": [0.03, 0, 0], "normal_into_object": [-2, 0, 0], "mu": 0.4},
        {"position_m": [-0.05, 0, 0], "normal_into_object": [1, 0, 0], "model": "soft"},
    ]
}


def test_contacts_that_a_user_typed_in(tmp_path: Path) -> None:
    path = tmp_path / "contacts.json"
    path.write_text(json.dumps(TYPED), encoding="utf-8")
    contacts, length = read_contacts(path)
    assert length == pytest.approx(0.05)
    np.testing.assert_allclose(contacts.normals, [[-1, 0, 0], [1, 0, 0]])
    assert contacts.models == ("point", "soft") and contacts.mu.tolist() == [0.4, 0.5]
    path.write_text(json.dumps({**TYPED, "length_m": 0.2, "center_m": [0, 0, 1]}))
    contacts, length = read_contacts(path)
    assert length == 0.2 and contacts.center.tolist() == [0, 0, 1]


def test_contacts_of_a_plan_file(plan: GraspPlan, tmp_path: Path) -> None:
    write_plan(plan, tmp_path / "plan.json")
    contacts, length = read_contacts(tmp_path / "plan.json")
    np.testing.assert_allclose(contacts.positions, plan.contacts.positions, atol=1e-9)
    assert length == pytest.approx(np.sqrt(0.025**2 + 0.025**2 + 0.04**2))


@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        (
            ("contacts", []),
            FileFormatError,
            "neither a plan nor a list of contacts: contacts: List",
        ),
        (
            ("contacts.0.mu", -0.1),
            FileFormatError,
            "contacts.0.mu: Input should be greater than or",
        ),
        (("contacts.0.normal", [1, 0, 0]), FileFormatError, "contacts.0.normal: Extra inputs"),
        (("contacts.1.position_m", [0, 0]), FileFormatError, "contacts.1.position_m.2: Field requ"),
        (("contacts.1.model", "hard"), FileFormatError, "'frictionless', 'point' or 'soft'"),
        (("contacts.0.normal_into_object", [0, 0, 0]), ContactError, "normal 0 has no direction"),
        (
            ("center_m", [0.0, 0.0, float("inf")]),
            FileFormatError,
            "center_m.2: Input should be a fi",
        ),
        (("length_m", 0.0), FileFormatError, "length_m: Input should be greater than 0"),
    ],
)
def test_bad_contacts_are_refused(
    tmp_path: Path, change: tuple[str, Json], error: type[PlannerError], message: str
) -> None:
    path = tmp_path / "contacts.json"
    path.write_text(json.dumps(edited(TYPED, change)), encoding="utf-8")
    with pytest.raises(error, match=message):
        read_contacts(path)


def test_contacts_all_at_the_centre_need_a_length(tmp_path: Path) -> None:
    one = {"position_m": [0, 0, 0], "normal_into_object": [1, 0, 0]}
    (tmp_path / "c.json").write_text(json.dumps({"contacts": [one, one]}), encoding="utf-8")
    with pytest.raises(FileFormatError, match="every contact is at the centre of mass; give len"):
        read_contacts(tmp_path / "c.json")
