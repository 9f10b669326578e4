"""Pages in a browser without a network: no errors, no requests, and poses as they were planned."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from browser import OpenPage, browser, open_page
from conftest import PlanOf
from PIL import Image

from planner import GraspPlan, GraspTask, plan_grasp
from planner.pages.blocks import Sentence, Verdict
from planner.pages.page import Page, write_page
from planner.pages.plan_page import RATE, plan_page
from planner.pages.scene import Bars, Line, Mark, Plot, pose_row
from planner.spatial import FloatArray

NEAR = 1e-3
"""How far (m) what is drawn may be from what was planned."""

ARM = "allegro_on_arm7"
SLOW = pytest.mark.slow

LEAST_COLOURS = 8
"""Colours of a scene that is not blank."""


@pytest.fixture(scope="module")
def chromium() -> Iterator[Any]:
    with browser() as opened:
        yield opened


@pytest.fixture(scope="module")
def plan(plan_of: PlanOf) -> GraspPlan:
    return plan_of("allegro_hand", "box")


@pytest.fixture(scope="module")
def with_plots(plan: GraspPlan) -> Page:
    """The page of a plan with one plot, bars and a fault, as reports have them."""
    scene = plan_page(plan).scene
    assert scene is not None
    t = scene.time
    wave = np.where(t > 2.0, np.nan, 2.0 + np.sin(5 * t))
    plot = Plot(
        title="normal force",
        unit="N",
        lines=(
            Line(name="thumb", values=wave, group="thumb"),
            Line(name="planned", values=np.array([2.5]), dashed=True, group="thumb"),
        ),
    )
    states = tuple("stick" if v < 1 else "slip" for v in t)
    bars = Bars(title="modes", rows={"thumb": states}, colours={"stick": "#2a7", "slip": "#c33"})
    scene = dataclasses.replace(
        scene, plots=(plot,), bars=(bars,), marks=(Mark(time=1.25, text="dropped", kind="fault"),)
    )
    return dataclasses.replace(
        plan_page(plan),
        scene=scene,
        verdict=Verdict(good=False, text="Dropped", reason="a test", time=1.25),
    )


@pytest.fixture(scope="module")
def untouched(
    chromium: Any, with_plots: Page, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[tuple[OpenPage, Opening]]:
    """The page, and what it was when it opened; tests ask for ``opened``."""
    path = tmp_path_factory.mktemp("pages") / "page.html"
    write_page(with_plots, path)
    with open_page(chromium, path) as page:
        yield page, Opening(page.time(), page.page.evaluate("window.opposable.layers"))


@pytest.fixture
def opened(untouched: tuple[OpenPage, Opening]) -> Iterator[OpenPage]:
    """The page as it was when it opened: opened once, for no GPU starts it."""
    page, opening = untouched
    page.page.evaluate("window.scrollTo(0, 0)")
    page.page.mouse.move(0, 0)
    page.page.locator("#speed").select_option("1")
    page.seek(opening.time)
    for layer, on in opening.layers.items():
        page.set(layer, on)
    page.page.evaluate("Opposable.stage.camera.look(Opposable.stage.opening)")
    yield page
    errors = page.all_errors()
    page.errors.clear()
    page.page.evaluate("window.opposable.errors.length = 0")  # of this test alone
    assert errors == []
    assert page.requests == []


@dataclass(frozen=True)
class Opening:
    """A page when it has opened: its time (s), and its layers."""

    time: float
    layers: dict[str, bool]


def planned_pose(plan: GraspPlan, time: float, joint: str | None) -> FloatArray:
    """Where Pinocchio has the body of a joint at the sample that a page shows at a time."""
    trajectory = plan.joint_trajectory(rate_hz=RATE)
    k = int(np.searchsorted(trajectory.times, time + 1e-9, side="right")) - 1
    base = trajectory.T_world_base[k]
    if joint is None:
        return pose_row(base)
    model = plan.task.hand.pin_model
    data = model.createData()
    pin.forwardKinematics(model, data, trajectory.positions[k])
    return pose_row(base * data.oMi[model.getJointId(joint)])


def test_a_plan_opens_without_errors_and_is_not_blank(
    opened: OpenPage, untouched: tuple[OpenPage, Opening]
) -> None:
    assert opened.colours() >= LEAST_COLOURS
    assert untouched[1].time == pytest.approx(2.5)


@pytest.mark.parametrize(
    "hand", ["allegro_hand", *(pytest.param(h, marks=SLOW) for h in ("shadow_hand", ARM))]
)
def test_poses_in_the_page_are_those_of_pinocchio(chromium: Any, hand: str, tmp_path: Path) -> None:
    plan = plan_grasp(GraspTask.create(hand, "box"), seed=0)
    plan.save_html(tmp_path / "plan.html")
    rng = np.random.default_rng(0)
    with open_page(chromium, tmp_path / "plan.html") as page:
        for time in rng.uniform(0, page.time(), size=10):
            page.seek(time)
            for joint in (None, *plan.task.hand.joint_names):
                shown, true = page.pose("hand", joint), planned_pose(plan, time, joint)
                assert np.linalg.norm(shown[:3] - true[:3]) < NEAR, (time, joint)
                assert abs(abs(shown[3:] @ true[3:]) - 1) < 1e-5, (time, joint)
        assert page.all_errors() == [] and page.requests == []


def test_the_cursor_of_a_plot_moves_the_scene_and_back(opened: OpenPage, plan: GraspPlan) -> None:
    plot = opened.page.locator(".plot svg").first
    plot.scroll_into_view_if_needed()
    box = plot.bounding_box()
    assert box is not None
    before = opened.pose("hand")
    # the time axis begins and ends at the margins of axes.js
    x = box["x"] + 52 + 0.4 * (box["width"] - 52 - 12)
    opened.page.mouse.click(x, box["y"] + 50)
    assert opened.time() == pytest.approx(1.0, abs=0.02)
    assert np.linalg.norm(opened.pose("hand")[:3] - before[:3]) > 0.01
    true = planned_pose(plan, opened.time(), None)
    assert np.allclose(opened.pose("hand")[:3], true[:3], atol=NEAR)
    assert float(opened.page.locator("#slider").input_value()) == pytest.approx(opened.time())
    # and back: the scene's time moves the cursor of every plot
    opened.seek(2.0)
    for cursor in opened.page.locator(".plot .cursor").all():
        width = cursor.evaluate("c => c.ownerSVGElement.clientWidth")
        at = 52 + 0.8 * (width - 52 - 12)
        assert float(cursor.get_attribute("x1")) == pytest.approx(at, abs=0.5)


def test_keys_and_buttons_step_play_and_pause(opened: OpenPage) -> None:
    opened.seek(1.0)
    opened.page.locator("#view").focus()
    opened.page.keyboard.press("ArrowRight")
    assert opened.time() == pytest.approx(1.0 + 1 / RATE, abs=1e-3)
    opened.page.locator("#back").click()
    assert opened.time() == pytest.approx(1.0, abs=1e-3)
    opened.page.locator("#view").focus()
    opened.page.keyboard.press(" ")
    opened.wait("window.opposable.time() > 1.1")
    opened.page.keyboard.press(" ")
    stopped = opened.time()
    opened.page.wait_for_timeout(200)
    assert opened.time() == stopped < 2.5
    opened.page.locator("#speed").select_option("4")
    opened.page.locator("#play").click()
    opened.wait("window.opposable.time() >= 2.5")


def test_the_moment_of_the_verdict_is_one_click_away(opened: OpenPage) -> None:
    opened.page.locator("[data-seek]").click()
    assert opened.time() == 1.25
    opened.seek(0.0)
    opened.page.locator("#timeline .sign.fault").click()
    assert opened.time() == 1.25


@pytest.mark.parametrize("layer", ["hand", "object", "table", "cones", "forces", "collision"])
def test_a_layer_is_switched_on_and_off(opened: OpenPage, layer: str) -> None:
    def shot() -> Any:
        return np.asarray(opened.drawn()).astype(int)

    box = opened.page.locator(f'[data-layer="{layer}"]')
    first = shot()
    box.click()
    second = shot()
    assert (np.abs(first - second).max(axis=2) > 8).sum() > 200
    box.click()
    assert (np.abs(shot() - first).max(axis=2) > 8).sum() == 0


def test_what_is_pointed_at_is_named(opened: OpenPage) -> None:
    opened.page.locator("#cameras button", has_text="top").click()
    for layer in ("hand", "pads", "planned contacts"):
        opened.set(layer, False)
    view = opened.page.locator("#canvas").bounding_box()
    assert view is not None
    names = set()
    for dx in (-40, 0, 40):
        for dy in (-40, 0, 40):
            opened.page.mouse.move(
                view["x"] + view["width"] / 2 + dx, view["y"] + view["height"] / 2 + dy
            )
            opened.page.wait_for_timeout(100)
            names.add(opened.page.locator("#tooltip").text_content())
    assert "box (object)" in names, names


def test_a_drag_turns_the_camera(opened: OpenPage) -> None:
    first = np.asarray(opened.picture("#canvas")).astype(int)
    view = opened.page.locator("#canvas").bounding_box()
    assert view is not None
    x, y = view["x"] + view["width"] / 2, view["y"] + view["height"] / 2
    opened.page.mouse.move(x, y)
    opened.page.mouse.down()
    opened.page.mouse.move(x + 120, y, steps=4)
    opened.page.mouse.up()
    turned = np.asarray(opened.picture("#canvas")).astype(int)
    assert (np.abs(first - turned).max(axis=2) > 8).mean() > 0.05
    opened.page.locator("#cameras button", has_text="home").click()
    back = np.asarray(opened.picture("#canvas")).astype(int)
    assert (np.abs(first - back).max(axis=2) > 8).mean() < 1e-3


@SLOW
def test_a_dark_page_and_a_narrow_one_are_drawn(
    chromium: Any, with_plots: Page, tmp_path: Path
) -> None:
    path = tmp_path / "page.html"
    write_page(with_plots, path)
    with open_page(chromium, path, dark=True, width=420, height=800) as page:
        assert page.colours() >= LEAST_COLOURS
        ground = np.asarray(page.picture("body"))[2, 2]
        assert ground.max() < 60
        assert page.page.evaluate("document.documentElement.scrollWidth") <= 420
        assert page.all_errors() == []


@SLOW
def test_without_webgl_one_line_says_so(chromium: Any, plan: GraspPlan, tmp_path: Path) -> None:
    plan.save_html(tmp_path / "plan.html")
    blind = "HTMLCanvasElement.prototype.getContext = () => null"
    with open_page(chromium, tmp_path / "plan.html", script=blind) as page:
        assert "no WebGL" in page.page.locator("#notice").text_content()
        assert page.page.locator("#notice").is_visible()
        assert "Force closure holds" in page.page.locator("#summary").text_content()
        page.seek(0.5)
        assert page.all_errors() == []


def test_the_numbers_are_saved_from_the_page(opened: OpenPage, tmp_path: Path) -> None:
    from planner.files import read_plan

    button = opened.page.locator("#save-numbers")
    with opened.page.expect_download() as download:
        button.click()
    download.value.save_as(tmp_path / "plan.json")
    assert read_plan(tmp_path / "plan.json").task.hand.name == "allegro_hand"


def test_the_scene_is_saved_as_a_picture(opened: OpenPage, tmp_path: Path) -> None:
    with opened.page.expect_download() as download:
        opened.page.locator("#tools button", has_text="save picture").click()
    download.value.save_as(tmp_path / "scene.png")
    pixels = np.asarray(Image.open(tmp_path / "scene.png"))
    assert len(np.unique(pixels[::4, ::4, :3].reshape(-1, 3) // 16, axis=0)) >= LEAST_COLOURS
    assert pixels[..., 3].min() == 255


def test_a_camera_below_the_table_sees_the_hand(opened: OpenPage) -> None:
    opened.page.evaluate("Opposable.stage.camera.look([0.1, 0, -1])")
    for layer in ("planned contacts", "pads"):
        opened.set(layer, False)
    assert opened.colours() >= LEAST_COLOURS


def test_text_on_a_page_is_not_markup(chromium: Any, plan: GraspPlan, tmp_path: Path) -> None:
    evil = "</script><script>window.evil = 1</script><img src=x onerror='window.evil = 2'>"
    page = dataclasses.replace(
        plan_page(plan), title=evil, summary=(Sentence(text=evil),), data={"text": evil}
    )
    scene = page.scene
    assert scene is not None
    marks = (Mark(time=1.0, text=evil),)
    page = dataclasses.replace(page, scene=dataclasses.replace(scene, marks=marks))
    write_page(page, tmp_path / "page.html")
    with open_page(chromium, tmp_path / "page.html") as opened:
        assert opened.page.evaluate("window.evil") is None
        assert opened.page.locator("h1").text_content() == evil
        assert opened.all_errors() == []
