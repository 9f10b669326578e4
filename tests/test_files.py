"""Plan and contacts files: what is written comes back; damage is in ``test_files_damaged``."""

from __future__ import annotations

import json
from collections.abc import Iterator
from importlib import metadata
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import pinocchio as pin
import pytest

import planner
from planner.errors import ContactError, FileFormatError, PlannerError
from planner.files import (
    PLAN_VERSION,
    PlanFile,
    plan_from_dict,
    plan_to_dict,
    read_contacts,
    read_plan,
    write_plan,
)
from planner.hands.hand import Hand
from planner.objects import parse_object
from planner.plan import GraspPlan
from planner.search.grasp import plan_grasp
from planner.spatial import SE3
from planner.task import GraspTask, Obstacle

Json: TypeAlias = Any
ROOT = Path(__file__).resolve().parent.parent


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


def test_a_plan_goes_through_plain_data_too(plan: GraspPlan, good: Json) -> None:
    back = plan_from_dict(good, "mine")
    assert back.q.tobytes() == plan.q.tobytes()
    assert back.record == plan.record
    with pytest.raises(FileFormatError, match="mine is not a plan file: its format is 'other'"):
        plan_from_dict(good | {"format": "other"}, "mine")


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
    assert (back.record, back.pregrasp_distance) == (plan.record, plan.pregrasp_distance)
    a, b = back.task, plan.task
    assert (a.object.name, a.object.mass) == ("box", 0.123) and a.object == b.object
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
    without = {"mu", "version", "seed", "attempt", "attempts", "iterations"}
    without |= {"wrist_free", "rolling"}  # flags
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
    """A full disk: the text is written beside the file, then the system refuses."""
    path = tmp_path / "plan.json"
    write_plan(plan, path)
    old = path.read_text(encoding="utf-8")

    def full(partial: Path, target: Path) -> None:
        assert partial.stat().st_size > 100
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("planner.files.disk.os.replace", full)
    with pytest.raises(FileFormatError, match="No space left on device"):
        write_plan(plan, path)
    assert path.read_text(encoding="utf-8") == old
    assert list(tmp_path.iterdir()) == [path]


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


BAD_CONTACTS: list[tuple[str, Json, type[PlannerError], str]] = [
    (
        "mu",
        -0.1,
        FileFormatError,
        "neither a plan nor a list of contacts: contacts.0.mu is -0.1; it should",
    ),
    ("normal", [1, 0, 0], FileFormatError, "contacts.0.normal is no field"),
    ("position_m", [0, 0], FileFormatError, "contacts.0.position_m.2 is missing"),
    (
        "position_m",
        [0, 0, float("nan")],
        FileFormatError,
        "position_m.2 is nan; it should be a finite",
    ),
    ("model", "hard", FileFormatError, "'frictionless', 'point' or 'soft'"),
    ("normal_into_object", [0, 0, 0], ContactError, "normal 0 has no direction"),
]


@pytest.mark.parametrize(("key", "value", "error", "message"), BAD_CONTACTS)
def test_bad_contacts_are_refused(
    tmp_path: Path, key: str, value: Json, error: type[PlannerError], message: str
) -> None:
    first, second = TYPED["contacts"]
    path = tmp_path / "contacts.json"
    path.write_text(json.dumps({"contacts": [{**first, key: value}, second]}), encoding="utf-8")
    with pytest.raises(error, match=message):
        read_contacts(path)


@pytest.mark.parametrize(
    ("extra", "message"),
    [
        ({"contacts": []}, r"contacts is \[\]; it should have at least 1 item\. "),
        ({"center_m": [0.0, 0.0, float("inf")]}, "center_m.2 is inf; it should be a finite number"),
        ({"length_m": 0.0}, "length_m is 0.0; it should be greater than 0"),
        ({"lenght_m": 0.1}, "lenght_m is no field.*A list of contacts is .*position_m"),
    ],
)
def test_bad_contacts_files_are_refused(tmp_path: Path, extra: Json, message: str) -> None:
    path = tmp_path / "contacts.json"
    path.write_text(json.dumps({**TYPED, **extra}), encoding="utf-8")
    with pytest.raises(FileFormatError, match=message):
        read_contacts(path)


def test_contacts_all_at_the_centre_need_a_length(tmp_path: Path) -> None:
    one = {"position_m": [0, 0, 0], "normal_into_object": [1, 0, 0]}
    (tmp_path / "c.json").write_text(json.dumps({"contacts": [one, one]}), encoding="utf-8")
    with pytest.raises(FileFormatError, match="every contact is at the centre of mass; give len"):
        read_contacts(tmp_path / "c.json")


def test_files_are_written_from_a_checkout_that_is_not_installed(
    monkeypatch: pytest.MonkeyPatch, plan: GraspPlan, tmp_path: Path
) -> None:
    def missing(name: str) -> str:
        raise metadata.PackageNotFoundError(name)

    monkeypatch.setattr(metadata, "version", missing)
    write_plan(plan, tmp_path / "plan.json")
    data = json.loads((tmp_path / "plan.json").read_text(encoding="utf-8"))
    assert data["written_by"] == f"opposable {planner.__version__}"
    sources = [*ROOT.glob("planner/**/*.py"), *ROOT.glob("sim/**/*.py")]
    asking = [p for p in sources if "version('opposable')" in p.read_text(encoding="utf-8")]
    assert not asking
