"""Pages of ``opposable view`` in a browser: sliders, postures, poses, ghosts, motions, the grid."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from browser import OpenPage, browser, open_page
from conftest import PlanOf
from serving import large_dataset, serving, small_dataset

from planner.hand_loading import load_hand
from planner.hands.hand import Hand
from planner.kinematics import HandState
from planner.motion import plan_motion
from planner.objects import parse_object
from planner.pages.motion_page import motion_page
from planner.pages.page import Page, write_page
from planner.pages.scene import pose_row
from planner.plan import GraspPlan
from planner.search.grasp import plan_grasp
from planner.spatial import SE3, FloatArray, pose_from_wxyz
from planner.task import GraspTask
from sim.show.dataset import DatasetSite, DatasetTables
from sim.show.kinds import page_of_plan
from sim.show.targets import Target, ViewOptions, recognise

pytestmark = pytest.mark.slow  # a page takes seconds to start where no GPU draws it

NEAR = 1e-3
"""How far (m) what is drawn may be from what Pinocchio computes."""

LEAST_COLOURS = 8
"""Colours of a scene that is not blank."""

ROWS = 2_000


@pytest.fixture(scope="module")
def chromium() -> Iterator[Any]:
    with browser() as opened:
        yield opened


@pytest.fixture(scope="module")
def plan(plan_of: PlanOf) -> GraspPlan:
    return plan_of("allegro_hand", "box")


def page_of(target: str, options: ViewOptions | None = None) -> Page:
    found = Target(target)
    page = recognise(found).shown(found, options or ViewOptions())
    assert isinstance(page, Page)
    return page


@contextmanager
def opened(chromium: Any, page: Page, folder: Path) -> Iterator[OpenPage]:
    """A page in the browser, checked for errors, requests and a blank scene at its end."""
    write_page(page, folder / "page.html")
    with open_page(chromium, folder / "page.html") as shown:
        yield shown
        assert shown.all_errors() == []
        assert shown.requests == []
        assert shown.colours() >= LEAST_COLOURS


def drawn_tip(page: OpenPage, hand: Hand, finger: str) -> FloatArray:
    """Position (3,) of a fingertip in the page, m, from the drawn pose of its last joint."""
    frame = hand.pin_model.frames[hand.fingers[finger].tip_frame_id]
    row = page.pose("hand", hand.pin_model.names[frame.parentJoint])
    joint: SE3 = pose_from_wxyz(row[:3], row[3:])
    tip: FloatArray = (joint * frame.placement).translation
    return tip


def alike(drawn: FloatArray, planned: SE3) -> bool:
    """Whether a drawn pose (7,) is a planned one: within NEAR and 0.2 degrees."""
    row = pose_row(planned)
    near = np.linalg.norm(drawn[:3] - row[:3]) < NEAR
    return bool(near and abs(drawn[3:] @ row[3:]) > 1 - 1e-6)


def slide(page: OpenPage, joint: str, value: float) -> None:
    """Move a joint's slider as a person does: its value, then the event."""
    page.page.locator(f'input[data-joint="{joint}"]').evaluate(
        "(e, v) => { e.value = v; e.dispatchEvent(new Event('input')); }", value
    )


def joints(page: OpenPage) -> FloatArray:
    """Joints (nq,) that the sliders show."""
    values = page.page.evaluate("[...Opposable.hand.q]")
    shown = page.page.evaluate("Opposable.hand.sliders.map((s) => Number(s.input.value))")
    assert np.allclose(values, shown, atol=1e-9)
    return np.array(values)


@pytest.mark.parametrize("name", ["allegro_hand", "shadow_hand_left"])
def test_a_slider_moves_the_hand_as_pinocchio_does(
    chromium: Any, name: str, tmp_path: Path
) -> None:
    """A hand without and one with couplings, which is mirrored as well."""
    hand = load_hand(name)
    matrix, value = hand.coupling_matrix
    rng = np.random.default_rng(0)
    with opened(chromium, page_of(name), tmp_path) as page:
        for k in rng.permutation(hand.nq)[:8]:
            asked = float(rng.uniform(hand.q_lower[k], hand.q_upper[k]))
            before = joints(page)
            slide(page, hand.joint_names[k], asked)
            q = joints(page)
            assert q[k] == pytest.approx(asked, abs=2e-3)
            assert (q >= hand.q_lower - 1e-9).all()
            assert (q <= hand.q_upper + 1e-9).all()
            assert np.abs(matrix @ q - value).max(initial=0.0) < 1e-6
            alone = not matrix[:, k].any() if len(matrix) else True
            moved = np.flatnonzero(np.abs(q - before) > 1e-9)
            assert set(moved) <= {int(k)} if alone else len(moved) > 1
            state = HandState(hand, q)
            for finger in hand.fingers.values():
                drawn = drawn_tip(page, hand, finger.name)
                assert np.linalg.norm(drawn - state.tip_pose(finger).translation) < NEAR


def test_a_coupled_joint_goes_as_far_as_the_others_follow(
    chromium: Any, shadow: Hand, tmp_path: Path
) -> None:
    k, tied = (shadow.joint_index(name) for name in ("FFJ1", "FFJ2"))
    with opened(chromium, page_of("shadow_hand"), tmp_path) as page:
        slide(page, "FFJ1", float(shadow.q_upper[k]))
        q = joints(page)
        assert q[tied] == pytest.approx(q[k], abs=1e-6)  # +1 FFJ2 -1 FFJ1 = 0
        assert q[k] == pytest.approx(min(shadow.q_upper[[k, tied]]), abs=1e-3)


def test_postures_and_lines_of_the_description_are_shown(
    chromium: Any, allegro: Hand, tmp_path: Path
) -> None:
    glowing = """Opposable.stage.bodies.get("hand").meshes
        .filter((m) => m.material.emissive.getHex()).map((m) => m.userData.part.joint)"""
    with opened(chromium, page_of("allegro_hand"), tmp_path) as page:
        page.page.locator('button[data-posture="pinch"]').click()
        assert np.allclose(joints(page), allegro.posture("pinch"))
        page.page.locator('button[data-tab="description"]').click()
        line = page.page.locator(".described", has_text="fingers.index.joints")
        line.hover()
        lit = set(page.page.evaluate(glowing))
        assert lit == set(allegro.fingers["index"].q_index.tolist())
        page.page.locator("h1").hover()
        assert page.page.evaluate(glowing) == []


def test_a_proposed_hand_tells_its_reasons_and_its_findings(chromium: Any, tmp_path: Path) -> None:
    page = page_of(str(write_two_fingers(tmp_path / "pincer.xml")))
    lines = {line["key"]: line for line in page.extra["hand"]["lines"]}
    assert "chains of joints" in lines["palm_body"]["why"]
    with opened(chromium, page, tmp_path) as shown:
        shown.page.locator('button[data-tab="description"]').click()
        assert "chains of joints" in shown.page.locator(".own-panel").inner_text()
        shown.page.locator('button[data-tab="findings"]').click()
        findings = page.extra["hand"]["findings"]
        assert [f["level"] for f in findings] == ["error"]  # two fingers do not close
        assert shown.page.locator(".finding:visible").count() == len(findings)
        assert "two fingers take part" in shown.page.locator(".own-panel").inner_text()


def write_two_fingers(path: Path) -> Path:
    """A model of two fingers of two joints each, without a description."""
    finger = """
      <body name="{0}_lower" pos="{1} 0 0.02"><joint name="{0}_1" axis="0 {2} 0" range="-0.3 1.2"/>
        <geom type="capsule" fromto="0 0 0 0 0 0.05" size="0.009" mass="0.05"/>
        <body name="{0}_upper" pos="0 0 0.05"><joint name="{0}_2" axis="0 {2} 0" range="-0.3 1.2"/>
          <geom type="capsule" fromto="0 0 0 0 0 0.04" size="0.009" mass="0.04"/></body></body>"""
    fingers = finger.format("left", -0.04, 1) + finger.format("right", 0.04, -1)
    motors = "".join(
        f'<position joint="{side}_{k}" kp="5" forcerange="-2 2"/>'
        for side in ("left", "right")
        for k in (1, 2)
    )
    path.write_text(
        f"""<mujoco><compiler angle="radian"/><worldbody><body name="palm">
        <geom type="box" size="0.05 0.03 0.02" mass="0.3"/>{fingers}</body></worldbody>
        <actuator>{motors}</actuator></mujoco>"""
    )
    return path


def test_stable_poses_are_chosen_by_buttons(chromium: Any, tmp_path: Path) -> None:
    mug = parse_object("mug")
    page = page_of("mug", ViewOptions(touch=("z>0.01",), avoid=("x>0.045",)))
    with opened(chromium, page, tmp_path) as shown:
        poses = mug.shape.resting_poses()
        assert shown.page.locator("button[data-pose]").count() == len(poses)
        for k in range(len(poses)):
            shown.page.locator(f'button[data-pose="{k}"]').click()
            assert alike(shown.pose("object"), mug.resting_pose(index=k))
        command = shown.page.locator(".own-panel code").inner_text()
        assert command.endswith(f"--touch 'z>0.01' --avoid 'x>0.045' --pose {len(poses) - 1}")
        assert shown.page.evaluate("opposable.layers")["regions"]
        shown.set("field", True)


def test_ghosts_of_alternatives_are_where_they_are_planned(
    chromium: Any, plan: GraspPlan, tmp_path: Path
) -> None:
    page = page_of_plan(plan, ViewOptions(alternatives=2))
    other = plan_grasp(plan.task, seed=1)
    with opened(chromium, page, tmp_path) as shown:
        assert alike(shown.pose("seed 1"), other.T_world_base)
        shown.page.locator('tr[data-actor="seed 2"]').click()
        visible = "(n) => Opposable.stage.bodies.get(n).base.visible"
        assert not shown.page.evaluate(visible, "seed 1")
        assert shown.page.evaluate(visible, "seed 2")
        shown.page.locator('tr[data-actor="seed 2"]').click()
        assert shown.page.evaluate(visible, "seed 1")


def test_a_motion_shows_its_knots(chromium: Any, tmp_path: Path) -> None:
    task = GraspTask.create("allegro_hand", "cylinder:0.03x0.08")
    motion = plan_motion(task, angle=np.deg2rad(15), seed=0)
    with opened(chromium, motion_page(motion), tmp_path) as page:
        page.seek(0.0)
        assert alike(page.pose("object"), task.T_world_object)
        page.seek(1e9)
        assert alike(page.pose("object"), motion.knots[-1].T_world_object)
        hand = task.hand
        state = HandState(hand, motion.knots[-1].q)
        tip = (motion.T_world_base * state.tip_pose(hand.fingers["index"])).translation
        assert np.linalg.norm(drawn_tip(page, hand, "index") - tip) < NEAR


# ---- the grid of a dataset


@pytest.fixture(scope="module")
def grid(chromium: Any, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    """A dataset of many rows in the browser, which may ask this machine alone."""
    pytest.importorskip("pyarrow")
    folder = tmp_path_factory.mktemp("data")
    large = large_dataset(small_dataset(folder / "small"), folder / "large", ROWS)
    with serving(DatasetSite(DatasetTables(large))) as server:
        context = chromium.new_context(viewport={"width": 1400, "height": 900})
        foreign: list[str] = []

        def only_this_machine(route: Any) -> None:
            if route.request.url.startswith((server.address, "data:", "blob:")):
                route.continue_()
            else:
                foreign.append(route.request.url)
                route.abort()

        context.route("**/*", only_this_machine)
        page, errors = context.new_page(), []
        page.on("pageerror", lambda error: errors.append(str(error)))
        page.on("console", lambda m: errors.append(m.text) if m.type == "error" else None)
        page.goto(server.address)
        page.wait_for_selector('html[data-ready="yes"]')
        yield page
        assert errors == []
        assert foreign == []
        assert page.evaluate("Opposable.errors") == []
        context.close()


def shown_rows(page: Any) -> list[int]:
    """Rows in the order of the grid."""
    return [int(row) for row in page.evaluate("Opposable.grid.rows.shown")]


def test_the_grid_draws_what_is_on_the_screen_alone(grid: Any) -> None:
    grid.wait_for_selector(".card.painted")
    assert f"{ROWS} rows" in grid.locator(".grid-count").inner_text()
    assert 10 < grid.locator(".card").count() < 100
    grid.evaluate("Opposable.grid.scroll.scrollTop = 1e4")
    grid.wait_for_selector(f'.card[data-row="{ROWS - 1}"]', state="detached")
    assert 10 < grid.locator(".card").count() < 100
    grid.wait_for_selector(".card.painted")
    picture = grid.locator(".card.painted canvas").first
    colours = picture.evaluate("""(canvas) => {
        const data = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height).data;
        const seen = new Set();
        for (let i = 0; i < data.length; i += 4) seen.add(data[i] >> 4 | data[i + 1] >> 4 << 4);
        return seen.size; }""")
    assert colours >= LEAST_COLOURS


def test_the_grid_sorts_and_filters(grid: Any) -> None:
    found = [i for i in range(ROWS) if i % 7]
    grid.locator("#sort-column").select_option("epsilon")
    assert shown_rows(grid)[:3] == [ROWS - 1, ROWS - 2, ROWS - 3]
    assert set(shown_rows(grid)[-10:]) <= set(range(0, ROWS, 7))  # no grasp, no epsilon
    grid.locator("#sort-direction").click()
    assert shown_rows(grid)[:3] == found[:3]
    grid.locator("#filter-column").select_option("epsilon")
    grid.locator("#filter-operator").select_option("≥")
    grid.locator("#filter-value").fill("0.18")
    grid.locator("#filter-add").click()
    assert shown_rows(grid) == [i for i in found if 1e-4 * i >= 0.18]
    grid.locator("#filter-value").fill("many")
    grid.locator("#filter-add").click()
    assert "many is not a number" in grid.locator(".grid-complaint").first.inner_text()
    grid.locator(".chip").click()
    assert len(shown_rows(grid)) == ROWS
    grid.locator("#filter-column").select_option("found")
    grid.locator("#filter-value").fill("no")
    grid.locator("#filter-add").click()
    assert len(shown_rows(grid)) == ROWS - len(found)
    grid.locator(".chip").click()


def test_a_click_shows_the_grasp_its_duplicates_and_its_attempts(grid: Any) -> None:
    grid.evaluate("Opposable.grid.sort('k', true)")
    grid.locator('.card[data-row="1"]').click()
    grid.wait_for_selector(".panel-body table", timeout=60_000)
    frame = grid.frame_locator("iframe")
    frame.locator(".verdict").wait_for(timeout=60_000)
    assert "Verified" in frame.locator(".verdict").inner_text()
    told = grid.locator(".panel-body").inner_text()
    assert "near-duplicates (" in told  # the rows that repeat it
    assert "no failed attempts (of 1)" in told
    grid.locator('.card[data-row="0"]').click()
    grid.wait_for_selector(".attempts li", timeout=60_000)
    told = grid.locator(".grid-panel").inner_text()
    assert "thumb touches 110 degrees off its pad axis" in told
    assert "failed attempts (1 of 1)" in told
    assert grid.locator("iframe").count() == 0
    grid.keyboard.press("Escape")
    assert not grid.locator(".grid-panel").is_visible()
