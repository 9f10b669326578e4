"""Pictures: a file with the object in it, or a stated reason; never an error."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from planner.spatial import SE3
from planner.task import GraspTask
from sim.looking.picture import PICTURE_SIZE, save_picture
from sim.scene import Scene, build_scene

AWAY = SE3(np.eye(3), np.array([0.6, 0.0, 0.4]))


@pytest.fixture(scope="module", params=[0.0, None])
def scene(request: pytest.FixtureRequest) -> Scene:
    pose = SE3(np.eye(3), np.array([0.0, 0.0, 0.04]))
    task = GraspTask.create("allegro_hand", "box", table_height=request.param, T_world_object=pose)
    return build_scene(task, T_world_base=AWAY)


def test_there_is_a_picture_exactly_where_the_machine_draws(
    scene: Scene, tmp_path: Path, can_draw: bool
) -> None:
    data = scene.start(scene.task.hand.posture("open"), AWAY)
    made = save_picture(scene.model, data, tmp_path / "box.png")
    assert (made.path is not None) == can_draw, made.reason
    assert bool(made.reason) != can_draw


def test_object_is_in_the_middle_of_the_picture(
    scene: Scene, tmp_path: Path, can_draw: bool
) -> None:
    if not can_draw:
        pytest.skip("this machine does not draw without a display")
    data = scene.start(scene.task.hand.posture("open"), AWAY)
    made = save_picture(scene.model, data, tmp_path / "box.png")
    assert made.path is not None, made.reason
    pixels = np.asarray(Image.open(made.path)).astype(int)
    width, height = PICTURE_SIZE
    assert pixels.shape == (height, width, 3)
    red, green, blue = np.moveaxis(pixels, 2, 0)
    leafy = (green > red + 20) & (green > blue + 20)
    middle = leafy[height // 2 - 20 : height // 2 + 20, width // 2 - 20 : width // 2 + 20]
    assert middle.mean() > 0.9
    assert leafy.mean() < 0.2
    blueness = (blue - red).mean(axis=1)
    assert blueness[0] > blueness[-1] + 5  # sky above, ground below


def test_camera_follows_the_object(scene: Scene, tmp_path: Path) -> None:
    data = scene.start(scene.task.hand.posture("open"), AWAY)
    eye = np.array(data.cam("view").xpos)
    line = data.xpos[scene.object_body] - eye
    gaze = -data.cam("view").xmat.reshape(3, 3)[:, 2]
    assert gaze @ line / np.linalg.norm(line) == pytest.approx(1.0, abs=1e-6)


def test_unusable_renderer_gives_a_reason(
    scene: Scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sys.platform", "linux")
    monkeypatch.setenv("MUJOCO_GL", "egl")
    monkeypatch.setitem(sys.modules, "mujoco.egl", None)
    data = scene.start(scene.task.hand.posture("open"), AWAY)
    made = save_picture(scene.model, data, tmp_path / "box.png")
    assert made.path is None
    assert made.reason.startswith("no offscreen rendering by egl: import of mujoco.egl halted")


def test_unwritable_file_gives_a_reason(scene: Scene, tmp_path: Path) -> None:
    data = scene.start(scene.task.hand.posture("open"), AWAY)
    made = save_picture(scene.model, data, tmp_path / "missing" / "box.png")
    assert made.path is None
    assert made.reason
