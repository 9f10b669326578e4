"""``check_hand`` and the commands about hands: what is found, what it says, exit codes."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from PIL import Image
from test_describe import claw, written
from typer.testing import CliRunner

from planner.describe import CheckReport, check_hand
from planner.describe.overlaps import HandGaps, frequent_overlaps
from planner.errors import HandError, TaskError
from planner.hand_loading import load_hand
from planner.hands.hand import Hand
from planner.kinematics import HandState
from planner.synthesis.seeds.opposition import opposition
from planner.system.package import models_dir
from planner.task import GraspTask
from sim.cli import app
from sim.cli.common import EXIT_BAD_INPUT, EXIT_NO
from sim.cli.hand_tables import inspect_hand
from sim.cli.hands import _graspable

EditHand = Callable[..., Path]


@pytest.fixture(scope="module")
def runner() -> CliRunner:
    return CliRunner()


@pytest.fixture(scope="module")
def allegro_report() -> CheckReport:
    return check_hand(load_hand("allegro_hand"))


def levels(report: CheckReport) -> dict[str, list[str]]:
    return {
        level: [f.what for f in report.findings if f.level == level]
        for level in ("error", "warning", "note")
    }


@pytest.mark.parametrize("name", ["allegro_hand", "shadow_hand", "shadow_hand_left"])
def test_nothing_is_wrong_with_a_shipped_hand(name: str) -> None:
    report = check_hand(load_hand(name))
    assert report.ok
    assert report.findings == ()
    assert report.kinematics_error < 1e-12
    assert report.touches == ()


def test_joints_are_told_in_the_order_of_both_engines(allegro_report: CheckReport) -> None:
    hand = load_hand("allegro_hand")
    for k, row in enumerate(allegro_report.joints):
        assert row.name == hand.joint_names[k] == hand.mj_model.joint(row.qpos_index).name
        assert row.q_index == k
        assert (row.lower, row.upper) == tuple(hand.mj_model.joint(row.name).range)
        assert row.torque == (-0.7, 0.7)  # the servos' force range, reached mid-range
        assert row.belongs_to == row.name.split("_")[0]
        assert row.actuators == (f"A_{row.name}",)


def test_workspaces_hold_the_tips_of_other_configurations(allegro_report: CheckReport) -> None:
    hand = load_hand("allegro_hand")
    rng = np.random.default_rng(99)
    margin = 0.01  # m: a sample of 500 does not reach every corner
    for row in allegro_report.workspaces:
        finger = hand.fingers[row.finger]
        tips = [
            HandState(hand, rng.uniform(hand.q_lower, hand.q_upper)).tip_pose(finger).translation
            for _ in range(100)
        ]
        assert (np.array(tips) > np.array(row.lower) - margin).all()
        assert (np.array(tips) < np.array(row.upper) + margin).all()
        assert (np.array(row.upper) - np.array(row.lower) > 0.05).all()


def test_gaps_are_those_of_the_seeder(allegro_report: CheckReport) -> None:
    hand = load_hand("allegro_hand")
    task = GraspTask.create(hand, "sphere")
    for row in allegro_report.postures:
        found = opposition(task, hand.posture(row.name))
        assert row.gap == pytest.approx(found.gap)
        state = HandState(hand, hand.posture(row.name))
        thumb = state.pad_axis(task.fingers[found.opposer]) @ found.axis
        assert row.facing_deg[found.opposer] == pytest.approx(np.rad2deg(np.arccos(thumb)))


def test_the_force_of_a_finger_is_limited_by_its_weakest_servo(edit_hand: EditHand) -> None:
    strong = {p.finger: p.presses for p in check_hand(load_hand(edit_hand())).pads}
    path = edit_hand(xml={'kp="3" forcerange="-0.7 0.7"': 'kp="3" forcerange="-0.35 0.35"'})
    weak = {p.finger: p.presses for p in check_hand(load_hand(path)).pads}
    for finger, presses in strong.items():
        assert presses is not None
        assert weak[finger] == pytest.approx(presses / 2, rel=1e-3)
    # index_1 carries most: 0.7 N m at the height of its pad above it, along the look
    hand = load_hand("allegro_hand")
    task = GraspTask.create(hand, "sphere")
    q = hand.posture("pinch")
    state = HandState(hand, q)
    index = hand.fingers["index"]
    axis = opposition(task, q).axis
    jacobian = state.point_jacobian(index.pad.joint_id, state.pad_center(index))[:3]
    assert strong["index"] == pytest.approx(0.7 / np.abs(jacobian.T @ axis).max(), rel=1e-3)


def test_a_hand_without_postures_cannot_be_planned_with(edit_hand: EditHand) -> None:
    report = check_hand(load_hand(edit_hand({"[postures.pinch]": "[postures.other]"})))
    assert not report.ok
    assert levels(report)["error"] == ["there is no posture 'pinch'"]
    assert "opposable hands --describe" in report.findings[0].what_to_do


def test_a_pad_that_faces_backwards_is_an_error(edit_hand: EditHand) -> None:
    toml = (models_dir() / "hands" / "allegro_hand" / "hand.toml").read_text(encoding="utf-8")
    thumb = toml.split("[[fingers]]")[1]
    turned = thumb.replace("axis = [0.7071067811865476, 0.0,", "axis = [-0.7071067811865476, 0.0,")
    turned = turned.replace("0.0, 0.7071067811865476]", "0.0, -0.7071067811865476]")
    report = check_hand(load_hand(edit_hand({thumb: turned})))
    assert not report.ok
    assert any("faces" in what and "away" in what for what in levels(report)["error"])


def test_a_servo_at_the_end_of_its_range_cannot_press(edit_hand: EditHand) -> None:
    # index_1 is at 0.538 in the pinch posture: a command range that ends there gives no torque
    xml = {
        'joint="index_1" ctrlrange="-0.4294 1.8434"': 'joint="index_1" ctrlrange="-0.4294 0.538"'
    }
    report = check_hand(load_hand(edit_hand(xml=xml)))
    assert any(
        what.startswith("in the pinch posture index presses")
        for what in levels(report)["error"] + levels(report)["warning"]
    )


def test_missing_force_limits_are_told(edit_hand: EditHand) -> None:
    text = (models_dir() / "hands" / "allegro_hand" / "allegro_hand.xml").read_text("utf-8")
    xml = {'kp="3" forcerange="-0.7 0.7"': 'kp="3"'}
    for line in text.splitlines():
        if "ctrlrange" in line:
            xml[line] = line.split(" ctrlrange")[0] + "/>"
    report = check_hand(load_hand(edit_hand(xml=xml)))
    assert report.ok
    assert any("nothing limits the torque" in what for what in levels(report)["warning"])
    assert report.to_dict()["joints"][0]["torque"] == [None, None]  # JSON knows no infinity


def test_overlap_at_rest_is_told_with_its_remedy(edit_hand: EditHand) -> None:
    # the middle finger's first link as thick as a fist
    xml = {
        '<geom name="middle_proximal" class="link" fromto="0 0 0 0 0 0.054"/>': "<geom name="
        '"middle_proximal" class="link" fromto="0 0 0 0 0 0.054" size="0.04"/>'
    }
    report = check_hand(load_hand(edit_hand(xml=xml)))
    touching = {frozenset((t.first, t.second)) for t in report.touches}
    assert frozenset(("middle_proximal", "index_proximal")) in touching
    row = next(t for t in report.touches if "index_proximal" in (t.first, t.second))
    assert row.collides_in_mujoco
    # axes some 45 mm apart, radii 40 and 9.8: both engines measure the same depth
    assert row.coal == pytest.approx(row.mujoco, abs=1e-4)
    assert row.coal < -0.004
    finding = next(f for f in report.findings if "index_proximal" in f.what)
    assert 'exclude = [["' in finding.what_to_do
    assert "middle_proximal" in finding.what_to_do


def test_a_pad_below_another_geom_is_told(edit_hand: EditHand) -> None:
    xml = {
        '<geom name="index_pad" class="pad" pos="0 0 0.0267"/>': '<geom name="index_pad" '
        'class="pad" pos="0 0 0.0267"/><geom name="glove" class="pad" pos="0.001 0 0.0277"/>'
    }
    report = check_hand(load_hand(edit_hand(xml=xml)))
    found = [f for f in report.findings if "before the pad of index" in f.what]
    assert len(found) == 1
    assert "1.41 mm" in found[0].what  # |(1, 0, 1)| mm along the axis (1, 0, 1) / sqrt 2
    assert "drop_collision" in found[0].what_to_do


def test_a_gripper_of_two_fingers_is_said_plainly(edit_hand: EditHand) -> None:
    # run refuses it, so that check-hand may not pass it
    toml = {
        'default_fingers = ["thumb", "index", "middle", "ring"]': 'default_fingers = ["thumb", '
        '"index"]'
    }
    hand = load_hand(edit_hand(toml))
    report = check_hand(hand)
    assert not report.ok
    (finding,) = (f for f in report.findings if "two fingers" in f.what)
    assert "gripper" in finding.what and 'contact_model="soft"' in finding.what_to_do
    with pytest.raises(TaskError, match="needs at least 3"):
        GraspTask.create(hand, "sphere")


@pytest.mark.slow
def test_a_finger_that_takes_no_part_presses_with_nothing(
    runner: CliRunner, edit_hand: EditHand
) -> None:
    three = {'["thumb", "index", "middle", "ring"]': '["thumb", "index", "middle"]'}
    path = edit_hand(three)
    presses = {p.finger: p.presses for p in check_hand(load_hand(path)).pads}
    assert presses["ring"] is None
    assert all(presses[f] is not None for f in ("thumb", "index", "middle"))
    shown = runner.invoke(app, ["hands", "--check", str(path)])
    assert shown.exit_code == 0 and "nan" not in shown.output


def test_a_link_that_overlaps_the_one_that_carries_it_is_told_with_its_share(
    edit_hand: EditHand,
) -> None:
    # a block before the knuckle, in the way of the link after the next
    base = '<geom name="index_base" class="dark" type="box" pos="0 0 0.0082"'
    xml = {base: f'<geom name="block" type="sphere" size="0.02" pos="0.045 0 0.055"/>{base}'}
    hand = load_hand(edit_hand(xml=xml))
    overlap = frequent_overlaps(hand)[0]
    assert overlap.bodies == ("index_base", "index_middle")
    assert 0.2 < overlap.share <= 1.0
    findings = [f for f in check_hand(hand).findings if "between open and pinch" in f.what]
    assert findings and all(f.level == "warning" for f in findings)
    assert "block" in findings[0].what and f"{100 * overlap.share:.0f} %" in findings[0].what
    assert 'exclude = [["index_base", "index_middle"]]' in findings[0].what_to_do
    excluded = {
        '[[fingers]]\nname = "thumb"': "[repair]\nexclude = "
        '[["index_base", "index_middle"], ["index_base", "index_distal"]]\n\n'
        '[[fingers]]\nname = "thumb"'
    }
    assert frequent_overlaps(load_hand(edit_hand(excluded, xml))) == ()


def test_links_too_heavy_for_their_servos_are_told(edit_hand: EditHand) -> None:
    xml = {
        '<geom name="index_pad" class="pad" pos="0 0 0.0267"/>': '<geom name="index_pad" '
        'class="pad" pos="0 0 0.0267" mass="50"/>'
    }
    text = (models_dir() / "hands" / "allegro_hand" / "allegro_hand.xml").read_text("utf-8")
    for line in re.findall(r"<inertial[^>]*/>", text):
        xml[line] = ""
    report = check_hand(load_hand(edit_hand(xml=xml)))
    (finding,) = (f for f in report.findings if "cannot bear the weight" in f.what)
    # all four have the same limit, and the one that flexes the whole finger needs most of it
    assert "A_index_0, A_index_1, A_index_2, A_index_3 cannot" in finding.what
    assert "A_index_1 needs" in finding.what and "0.7 at most" in finding.what


TIP_INERTIA = re.search(
    r'<body name="index_distal".*?(<inertial[^>]*/>)',
    (models_dir() / "hands/allegro_hand/allegro_hand.xml").read_text("utf-8"),
    re.DOTALL,
)


def with_table(path: Path, table: str) -> Path:
    """A description with a table before its fingers."""
    text = path.read_text("utf-8").replace("[[fingers]]", f"{table}\n\n[[fingers]]", 1)
    path.write_text(text, encoding="utf-8")
    return path


def test_an_inertia_that_no_link_can_have_is_told_and_mended(edit_hand: EditHand) -> None:
    assert TIP_INERTIA is not None
    wrong = '<inertial pos="0 0 0.01" mass="0.047" diaginertia="0.24 0.24 0.24"/>'
    report = check_hand(load_hand(edit_hand(xml={TIP_INERTIA.group(1): wrong})))
    impossible, *slow = report.findings  # of the three fingers that are alike
    assert impossible.level == "warning"
    assert "index_distal has an inertia of 0.24 kg m2 at 0.047 kg" in impossible.what
    assert "radius of gyration of 2.26e+03 mm in a link of" in impossible.what
    assert "(and 2 more such bodies)" in impossible.what
    mend = 'inertia_from_geometry = ["index_distal", "middle_distal", "ring_distal"]'
    assert f"{mend} under [repair]" in impossible.what_to_do
    assert slow and not any(f.what.startswith("thumb") for f in slow)
    mend = f"[repair]\n{mend}"
    path = with_table(edit_hand(xml={TIP_INERTIA.group(1): wrong}), mend)
    hand = load_hand(path)
    assert check_hand(hand).findings == ()
    tip = hand.mj_model.body("index_distal")
    assert tip.mass[0] == 0.047
    np.testing.assert_allclose(tip.ipos, [0, 0, 0.01])


def test_an_armature_that_no_torque_moves_is_told(edit_hand: EditHand) -> None:
    path = with_table(edit_hand(), "[joint_defaults]\narmature = 0.5")
    report = check_hand(load_hand(path))
    slow = [f.what for f in report.findings]
    assert len(slow) == 16 and all("armature 0.5" in what for what in slow)
    # sqrt(2 I / torque) from rest over 1 rad, at 0.7 N m
    assert all("1.2 s for 1 rad" in what for what in slow)


def test_the_report_is_plain_data(allegro_report: CheckReport) -> None:
    data = json.loads(json.dumps(allegro_report.to_dict(), allow_nan=False))
    assert data["ok"] is True
    assert data["hand"] == "allegro_hand"
    assert len(data["joints"]) == 16


def test_inspect_tells_the_same_torques(shadow: Hand) -> None:
    told = {row.name: max(abs(t) for t in row.torque) for row in check_hand(shadow).joints}
    data = inspect_hand(shadow)
    joints = [j for part in (*data["other_joints"], *data["fingers"]) for j in part["joints"]]
    assert {j["name"]: j["torque_limit_N_m"] for j in joints} == told


def test_check_hand_command(runner: CliRunner, edit_hand: EditHand) -> None:
    good = runner.invoke(app, ["hands", "--check", "allegro_hand"])
    assert good.exit_code == 0, good.output
    assert "nothing forbids planning" in good.output
    as_json = runner.invoke(app, ["hands", "--check", "allegro_hand", "--json"])
    told = json.loads(as_json.output)
    assert told["ok"] is True
    # an object of each shape, of which a grasp is found
    assert {item.partition(":")[0] for item in told["fits"]} == {"cylinder", "sphere", "box"}
    assert all(f"opposable run allegro_hand {item}" in good.output for item in told["fits"])
    path = edit_hand({"[postures.pinch]": "[postures.other]"})
    bad = runner.invoke(app, ["hands", "--check", str(path)])
    assert bad.exit_code == EXIT_NO
    assert "no posture 'pinch'" in " ".join(bad.output.split())
    missing = runner.invoke(app, ["hands", "--check", "no_such_hand"])
    assert missing.exit_code == EXIT_BAD_INPUT


def test_arrays_of_taxels_are_shown_and_wrong_ones_are_told_by_finger(edit_hand: EditHand) -> None:
    thumb = 'name = "thumb"'
    text = (models_dir() / "hands" / "allegro_hand" / "hand.toml").read_text(encoding="utf-8")
    pad = text[text.index(thumb) :].split("[fingers.pad]")[1].split("geom = ")[1].splitlines()[0]
    line = f"geom = {pad}"
    array = "taxels = { rows = 9, columns = 7, spacing = 0.002, dead = [[0, 3]] }"
    report = check_hand(load_hand(edit_hand({line: f"{line}\n{array}"})))
    assert {p.finger: p.taxels for p in report.pads}["thumb"] == "9 x 7, 2 mm apart, 1 dead"
    assert [p.taxels for p in report.pads if p.finger != "thumb"] == [""] * 3
    twice = array.replace("[[0, 3]]", "[[0, 3], [0, 3]]")
    with pytest.raises(HandError, match=r"fingers\[thumb\].*\[0, 3\] is named twice"):
        load_hand(edit_hand({line: f"{line}\n{twice}"}))


@pytest.mark.slow
@pytest.mark.usefixtures("brief_postures")
def test_describe_command(runner: CliRunner, tmp_path: Path) -> None:
    model = written(tmp_path, claw())
    printed = runner.invoke(app, ["hands", str(model), "--describe"])
    assert printed.exit_code == 0, printed.output
    assert 'name = "claw' in printed.output
    path = tmp_path / "hand.toml"
    wrote = runner.invoke(app, ["hands", str(model), "--describe", "--out", str(path)])
    assert wrote.exit_code == 0, wrote.output
    fingers = ("thumb", "left", "right")
    assert load_hand(path).joint_names == tuple(f"{f}_{k}" for f in fingers for k in "ab")
    with Image.open(tmp_path / "hand.png") as picture:  # a row of pinch and open per candidate
        rows = len(load_hand(path).description.postures) // 2
        wide, high = picture.size
        assert (picture.format, high * 2 * 320) == ("PNG", wide * 260 * rows)
    again = runner.invoke(app, ["hands", str(model), "--describe", "-o", str(path)])
    assert again.exit_code == EXIT_BAD_INPUT
    assert "--force" in again.output
    nowhere = runner.invoke(
        app, ["hands", "--describe", str(model), "-o", str(tmp_path / "no" / "h.toml")]
    )
    assert nowhere.exit_code == EXIT_BAD_INPUT
    assert (
        runner.invoke(app, ["hands", "--describe", str(tmp_path / "no.xml")]).exit_code
        == EXIT_BAD_INPUT
    )


def test_hands_command_lists_ours_and_those_of_others(runner: CliRunner) -> None:
    result = runner.invoke(app, ["hands"])
    assert result.exit_code == 0
    assert "allegro_hand" in result.output
    assert "robosuite:inspire_right" in result.output


def test_an_overlap_on_the_way_to_the_pinch_alone_is_found(edit_hand: EditHand) -> None:
    # a ball on the index's first link, where its pad is when the next two joints are at 0.85, 0.67
    bent, tip = 0.85, 0.85 + 0.67
    x = 0.0384 * np.sin(bent) + 0.0267 * np.sin(tip)
    z = 0.054 + 0.0384 * np.cos(bent) + 0.0267 * np.cos(tip)
    link = '<geom name="index_proximal"'
    ball = f'<geom name="ball" type="sphere" size="0.006" pos="{x} 0 {z}"/>'
    hand = load_hand(edit_hand(xml={link: ball + link}))
    gaps = HandGaps(hand, 0.0)
    pair = next(k for k, p in enumerate(gaps.pairs) if {g.name for g in p} == {"ball", "index_pad"})
    shares = np.linspace(0.0, 1.0, 21)
    wide, narrow = hand.posture("open"), hand.posture("pinch")
    touching = np.zeros(len(shares), dtype=bool)
    data = hand.pin_model.createData()
    for k, share in enumerate(shares):
        pin.forwardKinematics(hand.pin_model, data, wide + share * (narrow - wide))
        touching[k] = gaps.between_parts(data.oMi)[pair] < 0.0
    assert touching[-1] and not touching[: len(shares) // 2].any()
    found = [set(overlap.bodies) for overlap in frequent_overlaps(hand)]
    assert {"index_proximal", "index_distal"} in found


def test_the_objects_that_are_named_are_those_of_one_hand(allegro: Hand) -> None:
    # one that no posture opens for, and one that is found
    assert _graspable(allegro, ["box:0.5x0.5x0.5", "sphere:0.03"]) == ["sphere:0.03"]


def test_two_hands_are_checked_and_no_small_object_is_tried(runner: CliRunner) -> None:
    told = runner.invoke(app, ["hands", "--check", "two_allegro_hands", "--json"])
    assert told.exit_code == 0, told.output
    read = json.loads(told.output)
    assert read["fits"] == []
    assert {j["belongs_to"] for j in read["joints"] if "carriage" in j["name"]} == {"carriage"}
