"""isaac_grasp YAML: numbers survive, frames and directions are Isaac's, damage is named."""

from __future__ import annotations

import copy
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import pytest
from exchange import make_claw, moved, some_numbers
from hypothesis import HealthCheck, given, settings

from planner.errors import FileFormatError, NotFoundError, TaskError
from planner.exchange import Reading, Writing, export_plans
from planner.exchange.formats import format_of
from planner.exchange.isaac_grasp import read_isaac_grasp, write_isaac_grasp
from planner.exchange.joints import T_object_body
from planner.exchange.yaml_text import read_documents
from planner.hand_loading import load_hand
from planner.hands.hand import Hand
from planner.kinematics import HandState
from planner.objects import parse_object
from planner.plan import GraspPlan
from planner.search.grasp import plan_grasp
from planner.spatial import SE3, pose_from_wxyz
from planner.task import GraspTask

yaml = pytest.importorskip("yaml")

Json: TypeAlias = Any


@pytest.fixture(scope="module")
def plan(shadow: Hand) -> GraspPlan:
    """With a wrist that moves, so that palm and base are not the same."""
    return plan_grasp(GraspTask.create(shadow, "box", wrist_free=True), seed=0)


@pytest.fixture(scope="module")
def good(plan: GraspPlan, tmp_path_factory: pytest.TempPathFactory) -> Json:
    path = tmp_path_factory.mktemp("good") / "good.yaml"
    write_isaac_grasp([plan], path, Writing())
    return yaml.safe_load(path.read_text(encoding="utf-8"))


@pytest.fixture
def read(shadow: Hand, tmp_path: Path) -> Callable[..., Any]:
    """Reads plain data, or text, as a file."""

    def read(data: Json, reading: Reading | None = None) -> Any:
        path = tmp_path / "g.yaml"
        path.write_text(data if isinstance(data, str) else yaml.safe_dump(data), encoding="utf-8")
        return read_isaac_grasp(path, shadow, reading or Reading())

    return read


@pytest.mark.slow
@given(numbers=some_numbers())
@settings(
    max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
def test_what_is_written_is_read(plan: GraspPlan, numbers: list[float], tmp_path: Path) -> None:
    plans, path = [plan, moved(plan, numbers)], tmp_path / "g.yaml"
    write_isaac_grasp(plans, path, Writing())
    found = read_isaac_grasp(path, plan.task.hand, Reading())
    assert [g.name for g in found.grasps] == ["grasp_0", "grasp_1"]
    for wanted, grasp in zip(plans, found.grasps, strict=True):
        np.testing.assert_array_equal(grasp.q, wanted.q)
        np.testing.assert_array_equal(grasp.q_pregrasp, wanted.q_pregrasp)
        np.testing.assert_allclose(
            grasp.T_object_base.homogeneous, T_object_body(wanted).homogeneous, rtol=0, atol=1e-12
        )
        assert grasp.confidence == wanted.quality.closure.normalised_min_weight


def test_a_file_has_the_keys_and_the_pose_that_isaac_sim_reads(plan: GraspPlan, good: Json) -> None:
    # data_writer.py and grasp_importer.py of Isaac Sim, commit 045ca8b
    assert (good["format"], good["format_version"]) == ("isaac_grasp", 1.0)
    assert (good["object_frame"], good["gripper_frame"]) == ("box", "forearm")
    grasp = good["grasps"]["grasp_0"]
    assert list(grasp) == [
        *("confidence", "position", "orientation", "cspace_position", "pregrasp_cspace_position")
    ]
    assert 0.0 < grasp["confidence"] <= 1.0
    T_object_gripper = pose_from_wxyz(
        np.array(grasp["position"]),
        np.array([grasp["orientation"]["w"], *grasp["orientation"]["xyz"]]),
    )
    # the gripper's pose is the object's pose times what the file says
    np.testing.assert_allclose(
        (plan.task.T_world_object * T_object_gripper).homogeneous,
        plan.T_world_base.homogeneous,
        atol=1e-12,
    )


def test_small_numbers_stay_numbers_and_texts_of_numbers_count(
    good: Json, read: Callable[..., Any], plan: GraspPlan, tmp_path: Path
) -> None:
    tiny = moved(plan, [1e-7, 3e-22, -1e-5, *[0.5] * 20])
    write_isaac_grasp([tiny], tmp_path / "tiny.yaml", Writing())
    data = yaml.safe_load((tmp_path / "tiny.yaml").read_text(encoding="utf-8"))
    assert all(isinstance(v, float) for v in data["grasps"]["grasp_0"]["position"])
    theirs = copy.deepcopy(good)  # as Isaac Sim writes 1e-05 and reads it
    theirs["grasps"]["grasp_0"]["cspace_position"]["WRJ1"] = "1e-05"
    theirs["format_version"] = "1.0"
    assert read(theirs).grasps[0].q[1] == 1e-5


def test_a_mesh_is_where_its_own_file_has_it(allegro: Hand, tmp_path: Path) -> None:
    item = parse_object("models/objects/mug.ply")
    plan = plan_grasp(GraspTask.create(allegro, item), seed=0)
    export_plans([plan], tmp_path / "g.yaml", "isaac-grasp")
    (grasp,) = read_isaac_grasp(tmp_path / "g.yaml", allegro, Reading()).grasps
    centre = np.array(item.shape.offset)  # type: ignore[attr-defined]
    assert np.linalg.norm(centre) > 0.03
    T_world_file = plan.task.T_world_object * SE3(np.eye(3), -centre)
    np.testing.assert_allclose(
        (T_world_file * grasp.T_object_base).homogeneous, plan.T_world_base.homogeneous, atol=1e-12
    )


def test_another_body_and_other_names_come_back(
    plan: GraspPlan, shadow: Hand, tmp_path: Path
) -> None:
    path = tmp_path / "g.yaml"
    writing = Writing(
        rename={"FFJ4": "rh_FFJ4"}, base_body="palm", hand_frame="tcp", object_frame="/World/box"
    )
    export_plans([plan], path, "isaac-grasp", writing=writing)
    data = yaml.safe_load(path.read_text(encoding="utf-8"))
    assert (data["object_frame"], data["gripper_frame"]) == ("/World/box", "tcp")
    assert "rh_FFJ4" in data["grasps"]["grasp_0"]["cspace_position"]
    T_base_palm = HandState(shadow, plan.q).T_base_palm
    palm = plan.task.T_world_object.inverse() * plan.T_world_base * T_base_palm
    np.testing.assert_allclose(data["grasps"]["grasp_0"]["position"], palm.translation, atol=1e-12)
    with pytest.raises(FileFormatError, match="it lacks FFJ4 and names rh_FFJ4, which"):
        read_isaac_grasp(path, shadow, Reading(base_body="palm"))
    told = Reading(base_body="palm", rename={"rh_FFJ4": "FFJ4"})
    (grasp,) = read_isaac_grasp(path, shadow, told).grasps
    np.testing.assert_allclose(
        grasp.T_object_base.homogeneous, T_object_body(plan).homogeneous, atol=1e-12
    )
    with pytest.raises(NotFoundError, match="no body of shadow_hand is called 'plam'"):
        export_plans([plan], path, "isaac-grasp", writing=Writing(base_body="plam"))


def test_a_joint_that_follows_is_left_out_and_computed(tmp_path: Path) -> None:
    claw = make_claw(tmp_path)
    text = (
        "format: isaac_grasp\nformat_version: 1.0\ngrasps:\n  only:\n    position: [0, 0, 0.1]\n"
        "    orientation: {w: 1, xyz: [0, 0, 0]}\n    cspace_position: {left: 0.4}\n"
    )
    (tmp_path / "g.yaml").write_text(text, encoding="utf-8")
    (grasp,) = read_isaac_grasp(tmp_path / "g.yaml", claw, Reading()).grasps
    np.testing.assert_allclose(grasp.q, [0.4, 0.1 - 0.5 * 0.4], atol=1e-12)
    assert (grasp.q_pregrasp, grasp.confidence) == (None, None)
    (tmp_path / "g.yaml").write_text(text.replace("left", "right"), encoding="utf-8")
    with pytest.raises(FileFormatError, match="position does not fit claw: it lacks left"):
        read_isaac_grasp(tmp_path / "g.yaml", claw, Reading())


def test_grasps_of_a_coupled_hand_come_back_without_its_followers(
    edit_hand: Callable[..., Path], tmp_path: Path
) -> None:
    tie = (
        '[[couplings]]\nname = "tie"\nkind = "equality"\njoints = { index_3 = 1, index_2 = -0.8 }\n'
    )
    motor = '<position name="A_index_3" joint="index_3" ctrlrange="-0.4604 1.8514"/>'
    finger = '[[fingers]]\nname = "thumb"'
    hand = load_hand(edit_hand({finger: f"{tie}\n{finger}"}, {motor: ""}))
    plans = [plan_grasp(GraspTask.create(hand, "box"), seed=seed) for seed in (0, 1)]
    done = export_plans(plans, tmp_path / "g.yaml", "isaac-grasp")
    assert done.notes == ("left out, since they follow other joints by couplings: index_3",)
    data = yaml.safe_load((tmp_path / "g.yaml").read_text(encoding="utf-8"))
    told = data["grasps"]["grasp_0"]["cspace_position"]
    assert set(told) == set(hand.joint_names) - {"index_3"}
    for grasp, plan in zip(
        read_isaac_grasp(tmp_path / "g.yaml", hand, Reading()).grasps, plans, strict=True
    ):
        np.testing.assert_allclose(grasp.q, plan.q, rtol=0, atol=1e-6)
        assert grasp.q_pregrasp is not None
        np.testing.assert_allclose(grasp.q_pregrasp, plan.q_pregrasp, rtol=0, atol=1e-6)


DAMAGE: list[tuple[str, Json, str]] = [
    ("format", ..., "has no format; it has format_version"),
    ("format", "isaac", "format is 'isaac'; isaac_grasp is needed"),
    ("format_version", ..., "has no format_version"),
    ("format_version", 1.1, "format_version is 1.1; this Opposable reads 1.0"),
    ("format_version", "new", "format_version is 'new'; a finite number is needed"),
    ("object_frame", 3, "object_frame is 3; a text is needed"),
    ("grasps", ..., "has no grasps"),
    ("grasps", [1], "grasps is a list; a mapping"),
    ("grasps.grasp_0", None, "grasps.grasp_0 is None; a mapping"),
    ("grasps.grasp_0.position", ..., "grasps.grasp_0 has no position; it has confidence"),
    ("grasps.grasp_0.position", [0, 0], "position is a list of 2; a list of 3 numbers is needed"),
    ("grasps.grasp_0.position", [0, "a", 0], r"position\[1\] is 'a'; a finite number is needed"),
    ("grasps.grasp_0.position", [0, 0, float("nan")], r"position\[2\] is nan; a finite"),
    ("grasps.grasp_0.orientation", ..., "grasps.grasp_0 has no orientation"),
    ("grasps.grasp_0.orientation", [1, 0, 0, 0], "orientation is a list; a mapping"),
    ("grasps.grasp_0.orientation.w", ..., "orientation has no w; it has xyz"),
    ("grasps.grasp_0.orientation.xyz", ..., "orientation has no xyz; it has w"),
    ("grasps.grasp_0.orientation.w", 4.0, "orientation is a quaternion of length 4"),
    ("grasps.grasp_0.confidence", True, "confidence is True; a finite number is needed"),
    ("grasps.grasp_0.cspace_position", ..., "grasps.grasp_0 has no cspace_position"),
    (
        "grasps.grasp_0.cspace_position.FFJ4",
        ...,
        "does not fit shadow_hand: it lacks FFJ4; give",
    ),
    (
        "grasps.grasp_0.cspace_position.thumb",
        0.1,
        "it names thumb, which shadow_hand does not",
    ),
    ("grasps.grasp_0.cspace_position.FFJ4", float("inf"), "cspace_position.FFJ4 is inf; a finite"),
    ("grasps.grasp_0.pregrasp_cspace_position.FFJ4", None, "pregrasp_cspace_position.FFJ4 is None"),
]


@pytest.mark.parametrize(("where", "value", "said"), DAMAGE, ids=[f"{d[0]}-{d[1]}" for d in DAMAGE])
def test_damage_is_named_with_its_place(
    good: Json, read: Callable[..., Any], where: str, value: Json, said: str
) -> None:
    data = copy.deepcopy(good)
    *path, last = where.split(".")
    inner = data
    for key in path:
        inner = inner[key]
    if value is ...:
        del inner[last]
    else:
        inner[last] = value
    with pytest.raises(FileFormatError, match=said) as raised:
        read(data)
    assert "g.yaml" in str(raised.value)


def test_texts_that_are_no_such_file_are_refused(good: Json, read: Callable[..., Any]) -> None:
    whole = yaml.safe_dump(good)
    for text, said in (
        (whole[: len(whole) // 2] + "\n  {", "is damaged or not YAML"),
        (whole + "grasps: {}\n", "the key 'grasps' is given twice"),
        (f"{whole}---\n{whole}", "holds 2 YAML documents; one is needed"),
        ("", "holds 0 YAML documents"),
        ("- 1\n- 2\n", "is a list; a mapping of names to values is needed"),
        (
            "!!python/object/apply:os.system ['true']\n",
            "is damaged or not YAML: could not determin",
        ),
        ("[" * 60 + "]" * 60, "it is nested more than 50 times"),
        # libyaml before 0.2.6 ends the process here; later ones refuse it before we count
        ("[" * 100_000, "it is nested more than 50 times|exceeded maximum nesting depth"),
    ):
        with pytest.raises(FileFormatError, match=said):
            read(text)
    with pytest.raises(FileFormatError, match="says w and xyz by name, and an order of xyzw"):
        read(good, Reading(quaternion="xyzw"))


def test_millimetres_are_read_where_they_are_said(good: Json, read: Callable[..., Any]) -> None:
    (metres,) = read(good).grasps
    (millimetres,) = read(good, Reading(unit=1e-3)).grasps
    np.testing.assert_allclose(
        1e-3 * metres.T_object_base.translation, millimetres.T_object_base.translation
    )


def test_what_one_file_cannot_hold_is_refused_and_the_old_file_stays(
    plan: GraspPlan, allegro: Hand, tmp_path: Path
) -> None:
    path = tmp_path / "g.yaml"
    path.write_text("mine", encoding="utf-8")
    other = plan_grasp(GraspTask.create(allegro, "box"), seed=0)
    ball = plan_grasp(GraspTask.create(allegro, "sphere"), seed=0)
    with pytest.raises(TaskError, match="more than one hand, shadow_hand and allegro_hand"):
        export_plans([plan, other], path, "isaac-grasp")
    with pytest.raises(
        TaskError, match=r"more than one object, box and sphere, .* a file for each"
    ):
        export_plans([other, ball], path, "isaac-grasp")
    on_arm = plan_grasp(GraspTask.create("allegro_on_arm7", "sphere"), seed=0)
    with pytest.raises(TaskError, match=r"is on an arm, .* without its arm"):
        export_plans([on_arm], path, "isaac-grasp")
    with pytest.raises(FileFormatError, match="cannot write"):
        export_plans([plan], tmp_path / "none" / "g.yaml", "isaac-grasp")
    assert path.read_text(encoding="utf-8") == "mine"
    assert [p.name for p in tmp_path.iterdir()] == ["g.yaml"]
    export_plans([plan], path, "isaac-grasp")
    assert format_of(path).name == "isaac-grasp"


def test_aliases_that_stand_for_billions_are_refused_at_once(tmp_path: Path) -> None:
    lines = ["a: &a [x, x, x, x, x, x, x, x, x]"]
    for last, name in pairwise("abcdefghijkl"):
        lines.append(f"{name}: &{name} [{', '.join([f'*{last}'] * 9)}]")
    path = tmp_path / "bomb.yaml"
    path.write_text("\n".join([*lines, "format: isaac_grasp", "format_version: *l", "grasps: {}"]))
    with pytest.raises(FileFormatError, match="aliases stand for more than"):
        read_documents(path, "a file of grasps")  # written out, it would not end
