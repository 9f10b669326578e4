"""Pages of trials and manipulations: they say what the report says and show what it recorded."""

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
from browser import OpenPage, browser, open_page
from conftest import PlanOf
from manipulations import QUICK as QUICK_TURN
from manipulations import task_of
from star_hand import write_star_hand

from planner.errors import FileFormatError
from planner.hand_loading import load_hand
from planner.motion.manipulation import ManipulationPlan, plan_manipulation
from planner.pages.blocks import Command, Facts, Folded, Heading, Sentence, Table, Verdict
from planner.pages.page import Page, write_page
from planner.pages.scene import Contacts, Scene
from planner.plan import GraspPlan
from planner.spatial import FloatArray, pose_from_wxyz
from sim.manipulation import ManipulationReport, manipulate, read_manipulation_report
from sim.manipulation.page import manipulation_page
from sim.manipulation.page_parts import parts_of
from sim.recording import Recording
from sim.report import TrialReport
from sim.report_file import read_report, write_report
from sim.scene.carrier import Timeline
from sim.scene.physics import PhysicsOptions
from sim.show.trial_page import trial_page
from sim.trial import simulate

pytestmark = pytest.mark.usefixtures("coarse_steps")

QUICK = Timeline(approach=0.2, close=0.3, close_wait=0.2, squeeze=0.2, lift=0.3, hold=0.2)

NEAR = 1e-3
"""How far (m) a pose in a page may be from the recorded one."""


@pytest.fixture(scope="module")
def plan(plan_of: PlanOf) -> GraspPlan:
    return plan_of("allegro_hand", "cylinder")


@pytest.fixture(scope="module")
def held(plan: GraspPlan) -> TrialReport:
    return simulate(plan, timeline=QUICK)


@pytest.fixture(scope="module")
def dropped(plan: GraspPlan) -> TrialReport:
    report = simulate(plan, timeline=QUICK, physics=PhysicsOptions(mu=0.1))
    assert report.reason == "dropped" and 0.0 < report.verdict.time < report.simulated_s - 0.1
    return report


@pytest.fixture(scope="module")
def turn() -> ManipulationPlan:
    task = task_of("cylinder:0.03x0.08", mass=0.1)
    return plan_manipulation(task, angle=math.radians(25.0), place=(0.04, -0.02))


@pytest.fixture(scope="module")
def turned(turn: ManipulationPlan) -> ManipulationReport:
    return manipulate(turn, timeline=QUICK_TURN)


# --- what is said ------------------------------------------------------------------------------


def texts(blocks: Any) -> Iterator[str]:
    """Every text of some blocks that a person reads."""
    for block in blocks:
        match block:
            case Heading(text=text) | Sentence(text=text) | Command(text=text):
                yield text
            case Verdict():
                yield from (block.text, block.reason)
                yield "" if block.time is None else f"{block.time:.2f}"
            case Facts(rows=rows):
                yield from (word for row in rows for word in row)
            case Table(columns=columns, rows=rows):
                yield from (*columns, *(cell for row in rows for cell in row))
            case Folded(title=title, blocks=inner):
                yield title
                yield from texts(inner)


def leaves(data: Any) -> Iterator[Any]:
    """All values of plain data, and its names."""
    if isinstance(data, dict):
        yield from data
        data = list(data.values())
    if isinstance(data, list):
        for one in data:
            yield from leaves(one)
    else:
        yield data


NUMBER = re.compile(r"(?<![\w.])-?\d+\.?\d*(?:e[-+]?\d+)?")


def numbers_not_in_the_report(page: Page, report: dict[str, Any]) -> set[str]:
    """Numbers that a page says and its report does not have; what is over time is left out."""
    known: set[str] = set()
    for value in leaves({k: v for k, v in report.items() if k not in ("samples", "recording")}):
        if isinstance(value, str):
            known.update(NUMBER.findall(value))
        elif isinstance(value, int | float):
            known |= {f"{value:.3g}", f"{value:.2f}", str(value)}
    blocks = [*([page.verdict] if page.verdict else []), *page.summary]
    said = [page.title, page.subtitle, *texts(blocks)]
    return {number for text in said for number in NUMBER.findall(text)} - known


@pytest.mark.slow
def test_every_number_of_a_page_is_in_its_report(
    held: TrialReport, dropped: TrialReport, turned: ManipulationReport
) -> None:
    for report in (held, dropped):
        assert numbers_not_in_the_report(trial_page(report.to_file()), report.to_dict()) == set()
    page = manipulation_page(turned.to_file())
    assert numbers_not_in_the_report(page, turned.to_dict()) == set()


def test_a_number_from_elsewhere_would_be_noticed(held: TrialReport) -> None:
    page = trial_page(held.to_file())
    forged = replace(page, summary=(*page.summary, Sentence(text="It weighs 17.3 N.")))
    assert numbers_not_in_the_report(forged, held.to_dict()) == {"17.3"}


def test_a_page_says_first_whether_it_was_held_and_why_not(
    held: TrialReport, dropped: TrialReport
) -> None:
    good, bad = (trial_page(r.to_file()).verdict for r in (held, dropped))
    assert good is not None and good.good and good.text == "Held" and good.time is None
    assert bad is not None and not bad.good and bad.text == "Not held: dropped"
    assert (bad.reason, bad.time) == (dropped.verdict.detail, dropped.verdict.time)


def test_the_command_and_the_version_stand_in_the_page(held: TrialReport) -> None:
    told = replace(held, command="opposable test plan.json --sim-mu 0.1").to_file()
    said = list(texts(trial_page(told).summary))
    assert told.command in said and told.written_by in said


def test_plots_are_the_channels_of_the_report(held: TrialReport) -> None:
    file = held.to_file()
    scene = trial_page(file).scene
    assert scene is not None
    samples = file.samples.model_dump()
    np.testing.assert_array_equal(scene.time, samples["time_s"])
    lines = {line.name: line.values for plot in scene.plots for line in plot.lines}
    assert file.plan is not None
    for i, contact in enumerate(file.plan["contacts"]):
        name = contact["finger"]
        assert lines[f"{name}, planned"].tolist() == [contact["force_normal_N"]]
        forces = next(p for p in scene.plots if p.title.startswith("Normal force"))
        measured = next(line.values for line in forces.lines if line.name == name)
        np.testing.assert_array_equal(measured, np.array(samples["normal_force_N"])[:, i])
    np.testing.assert_array_equal(lines["epsilon (L1)"], samples["epsilon"])
    moved = np.array(samples["object_in_palm_moved_mm"], dtype=float)
    np.testing.assert_array_equal(lines["moved"], moved)
    assert np.nanmax(lines["moved"]) == held.largest_slip[0]


def test_commands_stay_within_their_limits_in_the_plot(held: TrialReport) -> None:
    scene = trial_page(held.to_file()).scene
    assert scene is not None
    plot = next(p for p in scene.plots if p.title.startswith("Commands"))
    limits = held.recording.control_range[0]
    share = next(line for line in plot.lines if line.name == held.recording.actuator_names[0])
    back = limits[0] + share.values * (limits[1] - limits[0])
    np.testing.assert_allclose(back, held.recording.commands[:, 0], atol=1e-5)
    assert share.group in held.fingers


def test_phases_fill_the_whole_time(held: TrialReport) -> None:
    scene = trial_page(held.to_file()).scene
    assert scene is not None
    names = [band.name for band in scene.bands]
    assert names == ["approach", "close", "squeeze", "settle", "lift", "hold"]
    assert scene.bands[0].begin == 0.0 and scene.bands[-1].end == scene.time[-1]
    assert all(a.end == b.begin for a, b in zip(scene.bands, scene.bands[1:], strict=False))


def test_a_page_opens_where_it_went_wrong(held: TrialReport, dropped: TrialReport) -> None:
    good, bad = (trial_page(r.to_file()).scene for r in (held, dropped))
    assert good is not None and bad is not None
    assert good.start == held.samples.time[held.samples.during("hold")[0]]
    assert bad.start == dropped.verdict.time
    assert [mark.kind for mark in bad.marks].count("fault") == 1


# --- contacts ----------------------------------------------------------------------------------


def contacts_of(scene: Scene | None, name: str) -> Contacts:
    assert scene is not None
    return next(c for c in scene.contacts if c.name == name)


def test_planned_contacts_lie_beside_the_measured_ones(held: TrialReport, plan: GraspPlan) -> None:
    scene = trial_page(held.to_file()).scene
    planned, measured = contacts_of(scene, "planned"), contacts_of(scene, "measured")
    np.testing.assert_allclose(planned.points[0], plan.contacts_in_object.positions, atol=1e-9)
    rotation = plan.task.T_world_object.rotation
    world = planned.forces[0] @ rotation.T
    np.testing.assert_allclose(world, plan.contacts.forces_in_axes(), atol=1e-9)
    assert planned.actor == "object" and measured.actor is None
    last = pose_from_wxyz(*np.split(held.recording.T_world_object[-1], [3]))
    shown = planned.points[0] @ last.rotation.T + last.translation
    assert np.linalg.norm(shown - measured.points[-1, : len(shown)], axis=1).max() < 2e-3


@pytest.mark.slow
@pytest.mark.parametrize("how", ["one stroke", "gait"])
def test_planned_contacts_of_a_turn_go_along_with_the_fingers(
    how: str, turn: ManipulationPlan, turned: ManipulationReport, tmp_path: Path
) -> None:
    report, plan = turned, turn
    if how == "gait":
        hand = load_hand(write_star_hand(tmp_path, 4))
        task = task_of("cylinder:0.03x0.08", hand, mass=0.1, mu=0.6)
        plan = plan_manipulation(task, angle=math.radians(40.0), place=(0.03, 0.0), regrasp=True)
        report = manipulate(plan, timeline=QUICK_TURN)
    file = report.to_file()
    scene = manipulation_page(file, plan.task).scene
    planned, measured = contacts_of(scene, "planned"), contacts_of(scene, "measured")
    turning = report.log.during("turn")
    n = len(report.fingers)
    off = np.linalg.norm(planned.points[turning] - measured.points[turning][:, :n], axis=2)
    both = np.isfinite(off)
    assert both.mean() > 0.9
    assert np.median(off[both]) < 2e-3 and np.quantile(off[both], 0.95) < 6e-3
    gone = report.log.during("retreat")
    assert np.isnan(planned.points[gone]).all()


# --- manipulations -----------------------------------------------------------------------------


def test_modes_and_phases_of_a_manipulation_are_shown(turned: ManipulationReport) -> None:
    scene = manipulation_page(turned.to_file()).scene
    assert scene is not None
    (bars,) = scene.bars
    for i, finger in enumerate(turned.fingers):
        assert bars.rows[f"{finger}, planned"] == tuple(turned.planned_modes[:, i])
        assert bars.rows[f"{finger}, measured"] == tuple(turned.measured_modes[:, i])
    assert {m for row in bars.rows.values() for m in row} <= set(bars.colours)
    told = [f"{r.phase} {r.about}".strip() for r in turned.results]
    assert [band.name for band in scene.bands] == told


def test_a_manipulation_that_was_begun_again_is_shown_whole(turned: ManipulationReport) -> None:
    again = replace(turned, earlier=replace(turned, complete=False, put_down=True))
    page = manipulation_page(again.to_file())
    scene, m, end = page.scene, len(turned.log), float(turned.log.time[-1])
    assert scene is not None and page.verdict is not None and not page.verdict.good
    assert len(scene.time) == 2 * m and (np.diff(scene.time) > 0).all()
    np.testing.assert_allclose(scene.time[m:], turned.log.time + end)
    assert all(len(motion.pose) == 2 * m for motion in scene.motions)
    assert all(len(c.points) == 2 * m for c in scene.contacts)
    assert all(len(line.values) in (1, 2 * m) for plot in scene.plots for line in plot.lines)
    assert all(len(row) == 2 * m for bars in scene.bars for row in bars.rows.values())
    assert [mark.time for mark in scene.marks if mark.text == "begun again"] == [end]
    assert any("one after the other" in text for text in texts(page.summary))
    assert len(parts_of(again.to_file())) == 2


def test_a_failed_phase_is_told_and_marked(turned: ManipulationReport) -> None:
    lift = next(i for i, r in enumerate(turned.results) if r.phase == "lift")
    failed = replace(turned.results[lift], reason="the object slipped by 9.9 mm")
    broken = replace(
        turned, results=(*turned.results[:lift], failed), complete=False, put_down=False
    )
    page = manipulation_page(broken.to_file())
    assert page.verdict is not None and page.scene is not None
    assert page.verdict.reason == "lift: the object slipped by 9.9 mm"
    assert page.verdict.time == page.scene.start == pytest.approx(failed.end)
    assert [m.text for m in page.scene.marks if m.kind == "fault"] == [page.verdict.reason]


# --- files -------------------------------------------------------------------------------------


def test_the_report_comes_back_out_of_its_page(
    held: TrialReport, turned: ManipulationReport, tmp_path: Path
) -> None:
    held.save_html(tmp_path / "report.html")
    assert read_report(tmp_path / "report.html") == held.to_file()
    turned.save_html(tmp_path / "turn.html")
    assert read_manipulation_report(tmp_path / "turn.html") == turned.to_file()
    for file in tmp_path.iterdir():
        assert file.stat().st_size < 3e6, file


def test_a_page_is_made_of_the_json_alone(
    held: TrialReport, plan: GraspPlan, tmp_path: Path
) -> None:
    """Without the plan at hand, and the same to the last byte."""
    write_report(held.to_dict(), tmp_path / "report.json")
    write_page(trial_page(read_report(tmp_path / "report.json")), tmp_path / "again.html")
    held.save_html(tmp_path / "at_hand.html")
    assert (tmp_path / "again.html").read_bytes() == (tmp_path / "at_hand.html").read_bytes()


def test_a_report_without_states_says_so_in_one_line(
    held: TrialReport, turned: ManipulationReport, tmp_path: Path
) -> None:
    old = held.to_dict() | {"version": 1}
    older = turned.to_dict() | {"version": 1}
    for data in (old, older):
        for name in ("plan", "recording", "command"):
            del data[name]
    for name in ("epsilon", "friction_utilisation"):
        del older["samples"][name]
    write_report(old, tmp_path / "old.json")
    write_report(older, tmp_path / "older.json")
    pages = (
        trial_page(read_report(tmp_path / "old.json")),
        manipulation_page(read_manipulation_report(tmp_path / "older.json")),
    )
    for page in pages:
        assert "no recorded states (it is of an older version" in " ".join(texts(page.summary))
        assert page.scene is not None and page.scene.actors == () and page.scene.plots
        write_page(page, tmp_path / "page.html")


def test_a_hand_that_has_changed_since_is_refused(held: TrialReport) -> None:
    file = held.to_file()
    assert file.plan is not None
    task = file.plan["task"]
    other = {**file.plan, "task": {**task, "hand": {**task["hand"], "sha256": "0" * 64}}}
    with pytest.raises(FileFormatError, match="the hand's files have changed since"):
        trial_page(file.model_copy(update={"plan": other}))


def test_a_damaged_page_is_refused_in_one_line(held: TrialReport, tmp_path: Path) -> None:
    held.save_html(tmp_path / "report.html")
    text = (tmp_path / "report.html").read_text()
    at = text.index('id="opposable-data"') + 400
    for name, wrong, words in (
        ("cut", text[: at + 1000], "not a page with numbers in it"),
        ("changed", text[:at] + "AAAA" + text[at + 4 :], "damaged"),
        ("foreign", "<html><p>held</p></html>", "not a page with numbers in it"),
    ):
        (tmp_path / f"{name}.html").write_text(wrong)
        with pytest.raises(FileFormatError, match=words) as caught:
            read_report(tmp_path / f"{name}.html")
        assert "\n" not in str(caught.value)
    with pytest.raises(FileFormatError, match="cannot read"):
        read_report(tmp_path / "missing.html")
    with pytest.raises(FileFormatError, match="is not a manipulation-report file"):
        read_manipulation_report(tmp_path / "report.html")


def test_a_page_that_cannot_be_written_is_an_error_for_people(
    held: TrialReport, tmp_path: Path
) -> None:
    with pytest.raises(FileFormatError, match="cannot write"):
        held.save_html(tmp_path / "no folder" / "report.html")


def test_a_hand_that_no_file_can_name_is_shown_from_the_report_in_memory(
    turned: ManipulationReport, held: TrialReport, plan: GraspPlan, tmp_path: Path
) -> None:
    hand = replace(plan.task.hand, reference=None)
    made = replace(held, plan=replace(plan, task=replace(plan.task, hand=hand)))
    file = made.to_file()
    assert file.plan is None and file.recording is not None
    shown, alone = trial_page(file, made.plan.task), trial_page(file)
    assert shown.scene is not None and len(shown.scene.actors) == 3
    assert alone.scene is not None and alone.scene.actors == ()
    assert any("names no hand that can be loaded" in text for text in texts(alone.summary))
    made.save_html(tmp_path / "report.html")


# --- in the browser ----------------------------------------------------------------------------


@pytest.fixture(scope="module")
def chromium() -> Iterator[Any]:
    with browser() as found:
        yield found


def shown_equals_recorded(page: OpenPage, recording: Recording, model: Any) -> None:
    """Poses that a page shows at ten times against the states, and Pinocchio's of the joints."""
    rng = np.random.default_rng(0)
    data = model.createData()
    for i in rng.integers(0, len(recording), 10):
        page.seek(float(recording.time[i]) + 1e-6)
        base = recording.T_world_base[i]
        assert_near(page.pose("hand"), base)
        assert_near(page.pose("object"), recording.T_world_object[i])
        pin.forwardKinematics(model, data, recording.q[i])
        T_world_base = pose_from_wxyz(base[:3], base[3:])
        for name in recording.joint_names:
            true = (T_world_base * data.oMi[model.getJointId(name)]).translation
            assert np.linalg.norm(page.pose("hand", name)[:3] - true) < NEAR, (i, name)


def assert_near(shown: FloatArray, true: FloatArray) -> None:
    assert np.linalg.norm(shown[:3] - true[:3]) < NEAR
    assert abs(abs(shown[3:] @ true[3:]) - 1.0) < 1e-5


@pytest.mark.slow
def test_a_failed_trial_opens_at_its_failure(
    chromium: Any, dropped: TrialReport, plan: GraspPlan, tmp_path: Path
) -> None:
    dropped.save_html(tmp_path / "report.html")
    with open_page(chromium, tmp_path / "report.html") as page:
        assert page.time() == pytest.approx(dropped.verdict.time, abs=1e-6)
        slider = float(page.page.locator("#slider").input_value())
        assert slider == pytest.approx(dropped.verdict.time, abs=0.011)
        i = int(np.flatnonzero(dropped.recording.time <= page.time() + 1e-9)[-1])
        assert_near(page.pose("object"), dropped.recording.T_world_object[i])
        page.seek(0.0)
        page.page.get_by_text("show the moment").click()
        assert page.time() == pytest.approx(dropped.verdict.time, abs=1e-6)
        assert page.colours() > 5
        shown_equals_recorded(page, dropped.recording, plan.task.hand.pin_model)
        assert page.all_errors() == [] and page.requests == []


@pytest.mark.slow
def test_a_cursor_moved_in_a_plot_moves_the_scene_and_back(
    chromium: Any, held: TrialReport, tmp_path: Path
) -> None:
    held.save_html(tmp_path / "report.html")
    recording = held.recording
    with open_page(chromium, tmp_path / "report.html") as page:
        plot = page.page.locator(".plot svg").first
        plot.scroll_into_view_if_needed()
        box = plot.bounding_box()
        for share in (0.3, 0.8):
            page.page.mouse.click(box["x"] + share * box["width"], box["y"] + 50)
            i = int(np.flatnonzero(recording.time <= page.time() + 1e-9)[-1])
            assert_near(page.pose("hand"), recording.T_world_base[i])
            assert_near(page.pose("object"), recording.T_world_object[i])
        times = []
        for at in (0.2, 1.2):  # and back: the scene's time moves the cursors
            page.seek(at)
            places = {c.get_attribute("x1") for c in page.page.locator(".plot .cursor").all()}
            assert len(places) == 1
            times.append(float(places.pop()))
        assert times[1] - times[0] > 50
        assert page.all_errors() == [] and page.requests == []


@pytest.mark.slow
def test_a_manipulation_in_the_browser(
    chromium: Any, turned: ManipulationReport, turn: ManipulationPlan, tmp_path: Path
) -> None:
    turned.save_html(tmp_path / "report.html")
    with open_page(chromium, tmp_path / "report.html") as page:
        assert page.colours() > 5
        shown_equals_recorded(page, turned.recording, turn.task.hand.pin_model)
        assert page.page.locator(".plot svg").count() == 7
        assert page.all_errors() == [] and page.requests == []


@pytest.mark.slow
def test_a_wrong_state_is_noticed(
    chromium: Any, held: TrialReport, plan: GraspPlan, tmp_path: Path
) -> None:
    moved = held.recording.T_world_object.copy()
    moved[:, 0] += 0.002
    wrong = replace(held, recording=replace(held.recording, T_world_object=moved))
    wrong.save_html(tmp_path / "report.html")
    with (
        open_page(chromium, tmp_path / "report.html") as page,
        pytest.raises(AssertionError),
    ):
        shown_equals_recorded(page, held.recording, plan.task.hand.pin_model)
