"""A table of grasps comes back from every form, whatever the poses; damage is named."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from conftest import RIGHT_HANDS, PlanOf
from hypothesis import given, settings
from hypothesis import strategies as st

from planner.errors import FileFormatError, TaskError
from planner.exchange.formats import ImportedGrasp, Reading, Writing, format_of
from planner.exchange.table import read_table, write_table
from planner.exchange.table_forms import TableFile, TableGrasp, table_bytes
from planner.hand_loading import load_hand
from planner.hands.hand import Hand
from planner.spatial import SE3, pose_from_wxyz, pose_to_wxyz

FORMS = (".csv", ".json", ".npz")

numbers = st.floats(-3.0, 3.0, allow_subnormal=False)
quaternions = st.tuples(*(st.floats(-1.0, 1.0) for _ in range(4))).filter(
    lambda q: np.linalg.norm(q) > 0.1
)
poses = st.builds(
    lambda p, q: pose_from_wxyz(np.array(p), np.array(q)),
    st.tuples(numbers, numbers, numbers),
    quaternions,
)
texts = st.text(st.characters(codec="utf-8", exclude_characters="\x00\r\n"), max_size=8).map(
    str.strip
)


@pytest.fixture(scope="module")
def hand() -> Hand:
    return load_hand("allegro_hand")


@st.composite
def given_grasps(draw: st.DrawFn, nq: int) -> ImportedGrasp:
    """Any grasp with nq joints."""

    def joints() -> np.ndarray:
        return np.array(draw(st.lists(numbers, min_size=nq, max_size=nq)))

    return ImportedGrasp(
        name=draw(texts.filter(bool)),
        T_object_base=draw(poses),
        q=joints(),
        q_pregrasp=joints() if draw(st.booleans()) else None,
        q_squeeze=joints() if draw(st.booleans()) else None,
        object=draw(texts),
        scale=draw(st.floats(1e-3, 1e3)),
        T_world_object=draw(st.none() | poses),
        confidence=draw(st.none() | numbers),
    )


def _written(grasps: list[ImportedGrasp], hand: Hand, path: Path) -> None:
    """A table of grasps as another programme would write it, each number where it belongs."""
    rows = []
    for grasp in grasps:
        here, turn = pose_to_wxyz(grasp.T_object_base)
        place = None if grasp.T_world_object is None else pose_to_wxyz(grasp.T_world_object)
        rows.append(
            TableGrasp(
                name=grasp.name,
                position=tuple(here),
                quaternion_wxyz=tuple(turn),
                joints=tuple(grasp.q),
                pregrasp_joints=None if grasp.q_pregrasp is None else tuple(grasp.q_pregrasp),
                squeeze_joints=None if grasp.q_squeeze is None else tuple(grasp.q_squeeze),
                object=grasp.object,
                scale=grasp.scale,
                object_position=None if place is None else tuple(place[0]),
                object_quaternion_wxyz=None if place is None else tuple(place[1]),
                confidence=grasp.confidence,
            )
        )
    table = TableFile(hand=hand.name, joint_names=hand.joint_names, grasps=tuple(rows))
    path.write_bytes(table_bytes(table, path.suffix))


def _need_same(a: ImportedGrasp, b: ImportedGrasp) -> None:
    assert (a.name, a.object, a.scale, a.confidence) == (b.name, b.object, b.scale, b.confidence)
    for name in ("T_object_base", "T_world_object"):
        one, other = getattr(a, name), getattr(b, name)
        assert (one is None) == (other is None)
        if one is not None:
            np.testing.assert_allclose(one.homogeneous, other.homogeneous, atol=1e-12)
    for name in ("q", "q_pregrasp", "q_squeeze"):
        one, other = getattr(a, name), getattr(b, name)
        assert (one is None) == (other is None)
        if one is not None:
            np.testing.assert_array_equal(one, other)


@settings(max_examples=25, deadline=None)  # a hand is loaded at the first
@given(st.lists(given_grasps(16), min_size=1, max_size=3), st.sampled_from(FORMS))
def test_any_grasps_come_back(grasps: list[ImportedGrasp], form: str) -> None:
    mine = load_hand("allegro_hand")
    with TemporaryDirectory() as folder:
        path = Path(folder) / f"grasps{form}"
        _written(grasps, mine, path)
        assert format_of(path).name == "table"
        again = read_table(path, mine, Reading())
    assert len(again) == len(grasps)
    for a, b in zip(again.grasps, grasps, strict=True):
        _need_same(a, b)


def _csv(
    hand: Hand, *, unit: str = "m", angle: str = "rad", joints: list[str] | None = None
) -> str:
    """A table of one grasp with its hand at (10, 20, 30) mm and joint i at i hundredths."""
    names = list(hand.joint_names) if joints is None else joints
    lengths = [0.01, 0.02, 0.03] if unit == "m" else [10.0, 20.0, 30.0]
    values = [0.01 * hand.joint_index(n) if n in hand.joint_names else 0.0 for n in names]
    if angle == "deg":
        values = np.rad2deg(values).tolist()
    header = [f"x_{unit}", f"y_{unit}", f"z_{unit}", "qw", "qx", "qy", "qz"]
    header += [f"{n}_{angle}" for n in names]
    row = [*lengths, 0.5, 0.5, 0.5, 0.5, *values]
    return ",".join(header) + "\n" + ",".join(map(repr, row)) + "\n"


@pytest.mark.parametrize(("unit", "angle"), [("m", "rad"), ("mm", "deg"), ("mm", "rad")])
def test_units_and_orders_by_name(hand: Hand, tmp_path: Path, unit: str, angle: str) -> None:
    path = tmp_path / "a.csv"
    path.write_text(_csv(hand, unit=unit, angle=angle, joints=list(reversed(hand.joint_names))))
    (grasp,) = read_table(path, hand, Reading()).grasps
    np.testing.assert_allclose(grasp.T_object_base.translation, [0.01, 0.02, 0.03])
    np.testing.assert_allclose(grasp.q, 0.01 * np.arange(hand.nq))


def test_the_pose_of_another_body_becomes_that_of_the_base(tmp_path: Path) -> None:
    shadow = load_hand("shadow_hand")
    path = tmp_path / "a.csv"
    no_wrist = [n for n in shadow.joint_names if not n.startswith("WR")]
    path.write_text(_csv(shadow, joints=no_wrist))
    given = read_table(path, shadow, Reading(base_body="palm"))
    (grasp,) = given.grasps
    assert "WRJ2, WRJ1" in given.assumed[0]
    assert not grasp.q[shadow.wrist_index].any()
    from planner.kinematics import HandState

    palm = grasp.T_object_base * HandState(shadow, grasp.q).T_base_palm
    np.testing.assert_allclose(palm.translation, [0.01, 0.02, 0.03], atol=1e-12)
    with pytest.raises(
        FileFormatError, match="does not fit shadow_hand: it lacks WRJ2, WRJ1; give"
    ):
        read_table(path, shadow, Reading())


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda t: t.replace("index_0_rad", "pinky_0_rad"), "index_0"),
        (lambda t: t.replace("index_0_rad", "index_0"), "columns that a table .* index_0; leave"),
        (lambda t: t.replace("index_0_rad", "index_1_rad"), "twice"),
        (lambda t: t.replace("index_0_rad", "index_0_deg"), "in rad and in deg"),
        (lambda t: t.replace("index_0_rad", "index_0_m"), "gives index_0 as a length"),
        (lambda t: t.replace("index_0_rad", "index_0_mm"), "positions in m and index_0_mm"),
        (lambda t: t.replace("x_m,", "x,"), "needs the columns x_m, y_m and z_m"),
        (lambda t: t.replace("0.5,0.5", "0.5,banana"), "row 2, column qx: 'banana' is no number"),
        (lambda t: t.replace("0.5,0.5", "0.5,nan"), "row 2, column qx: 'nan' is no number; put"),
        (lambda t: t.replace("0.5,0.5", "0.5,inf"), "row 2, column qx: 'inf' is no number; put"),
        (lambda t: t.replace("0.5,0.5", "0.5,"), "row 2, column qx: an empty cell is no number"),
        (lambda t: t.replace("qw,", "w,"), "lacks the columns qw; an orientation"),
        (lambda t: t.replace(",", ";"), "has semicolons between its columns; write it with commas"),
        (lambda t: t.replace("\n", "\n\n").replace("0.5,0.5", "0.5,x"), "row 3, column qx"),
        (lambda t: t.replace("0.5,0.5", "0.5,0.9"), "length 1"),
        (lambda t: t.rstrip("\n").rsplit(",", 1)[0], "22 values for 23 columns"),
        (lambda t: "", "is empty"),
    ],
)
def test_damaged_tables_name_the_place(
    hand: Hand, tmp_path: Path, change: object, said: str
) -> None:
    path = tmp_path / "a.csv"
    assert callable(change)
    path.write_text(change(_csv(hand)))
    with pytest.raises(FileFormatError, match=said) as raised:
        read_table(path, hand, Reading())
    assert str(path) in str(raised.value)


def test_a_table_for_another_hand_or_version_is_refused(hand: Hand, tmp_path: Path) -> None:
    path = tmp_path / "a.json"
    grasp = ImportedGrasp(name="g", T_object_base=SE3.Identity(), q=np.zeros(16))
    _written([grasp], hand, path)
    with pytest.raises(FileFormatError, match="for the hand 'allegro_hand', and 'allegro_hand_l"):
        read_table(path, load_hand("allegro_hand_left"), Reading())
    data = json.loads(path.read_text())
    for key, value, said in (
        ("version", 2, "version 2"),
        ("format", "x", "its format is 'x'"),
        ("length", "inch", "length"),
        ("colour", "red", "colour"),
    ):
        path.write_text(json.dumps(data | {key: value}))
        with pytest.raises(FileFormatError, match=said):
            read_table(path, hand, Reading())
    path.write_text(json.dumps(data)[:-20])
    with pytest.raises(FileFormatError, match="damaged or not JSON"):
        read_table(path, hand, Reading())


def test_nothing_is_half_written(plan_of: PlanOf, tmp_path: Path) -> None:
    plans = [plan_of("allegro_hand", "cylinder:0.03x0.1")]
    with pytest.raises(TaskError, match=r"a table ends with \.json, \.npz, \.csv"):
        write_table(plans, tmp_path / "a.yaml", Writing())
    with pytest.raises(FileFormatError):
        write_table(plans, tmp_path / "none" / "a.csv", Writing())
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", RIGHT_HANDS)
def test_plans_come_back_with_their_poses(name: str, tmp_path: Path) -> None:
    from planner.search.grasp import plan_grasp
    from planner.task import GraspTask

    plan = plan_grasp(GraspTask.create(name, "cylinder:0.03x0.1"), seed=0)
    other = replace(plan, q=plan.q_pregrasp)
    for form in FORMS:
        (path,) = write_table(
            [plan, other],
            tmp_path / f"a{form}",
            Writing(base_body=plan.task.hand.description.palm_body),
        )
        back = read_table(path, plan.task.hand, Reading()).grasps
        for one, mine in zip(back, (plan, other), strict=True):
            T_object_base = mine.task.T_world_object.inverse() * mine.T_world_base
            np.testing.assert_allclose(
                one.T_object_base.homogeneous, T_object_base.homogeneous, atol=1e-12
            )
            np.testing.assert_array_equal(one.q, mine.q)
