"""Pictures: a file with the object in it, or a stated reason; never an error, never a weight."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import mujoco
import numpy as np
import pytest
from brief import SMALL_PICTURE
from PIL import Image

from planner.spatial import SE3, FloatArray
from planner.task import GraspTask
from sim.scene.build import Scene, build_scene
from sim.show import picture
from sim.show.camera import Subject
from sim.show.dress import dress_hand
from sim.show.painter import open_backend
from sim.show.picture import Drawn, Tape, draw_tape, moments_of

AWAY = SE3(np.eye(3), np.array([0.6, 0.0, 0.4]))


def scene_of(shape: str, hand: str = "allegro_hand", table: float | None = 0.0) -> Scene:
    task = GraspTask.create(hand, shape, table_height=table)
    return build_scene(task, T_world_base=AWAY)


def tape_of(scene: Scene, *turns_deg: float) -> Tape:
    """States in which the object alone is in the picture, turned about z."""
    tape = Tape(
        scene.model,
        Subject(
            object_body=scene.object_body, tips=(scene.object_body,), bodies=(scene.object_body,)
        ),
    )
    data = scene.start(scene.task.hand.posture("open"), AWAY)
    for k, degrees in enumerate(turns_deg):
        half = np.deg2rad(degrees) / 2
        data.qpos[scene.object_qpos[3:]] = np.cos(half), 0.0, 0.0, np.sin(half)
        tape.keep(float(k), data.qpos)
    return tape


def pixels_of(path: Path) -> FloatArray:
    with Image.open(path) as picture:
        return np.asarray(picture).astype(float)


@pytest.fixture(scope="module", params=[0.0, None])
def scene(request: pytest.FixtureRequest) -> Scene:
    return scene_of("box", table=request.param)


@pytest.fixture
def drawing(can_draw: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """Pictures are small, which is drawn in a tenth of the time; one test draws the whole size."""
    if not can_draw:
        pytest.skip("this machine does not draw without a display")
    monkeypatch.setattr(picture, "PICTURE", SMALL_PICTURE)


def test_there_is_a_picture_exactly_where_the_machine_draws(
    scene: Scene, tmp_path: Path, can_draw: bool
) -> None:
    path = tmp_path / "box.png"
    drawn = draw_tape(tape_of(scene, 0.0), pictures={path: None})
    assert (drawn.files == (path,)) == can_draw, drawn.reason
    assert bool(drawn.reason) != can_draw
    assert path.exists() == can_draw
    assert str(drawn).startswith("box.png (drawn by ") == can_draw


@pytest.mark.usefixtures("drawing")
def test_object_is_in_the_middle_of_the_picture(scene: Scene, tmp_path: Path) -> None:
    path = tmp_path / "box.png"
    draw_tape(tape_of(scene, 0.0), pictures={path: None})
    pixels = pixels_of(path)
    width, height = SMALL_PICTURE.size
    assert pixels.shape == (height, width, 3)
    red, green, blue = np.moveaxis(pixels, 2, 0)
    leafy = (green > red + 20) & (green > blue + 20)
    middle = leafy[height // 2 - 20 : height // 2 + 20, width // 2 - 20 : width // 2 + 20]
    assert middle.mean() > 0.9
    rows, columns = np.nonzero(leafy)
    assert rows.min() > 0.02 * height and rows.max() < 0.98 * height
    assert columns.min() > 0.02 * width and columns.max() < 0.98 * width
    assert np.ptp(rows) > 0.5 * height  # it fills the picture


@pytest.mark.usefixtures("drawing")
@pytest.mark.parametrize("shape", ["box", "cylinder", "sphere", "capsule", "torus", "knot"])
def test_a_turn_of_the_object_is_seen(shape: str, tmp_path: Path) -> None:
    """About its axis a cylinder looks the same from every side, but for its mark."""
    scene = scene_of(shape)
    paths = {tmp_path / f"{k}.png": float(k) for k in range(2)}
    draw_tape(tape_of(scene, 0.0, 90.0), pictures=paths)
    first, second = (pixels_of(path) for path in paths)
    changed = np.abs(first - second).max(axis=2) > 20
    red, green, blue = np.moveaxis(first, 2, 0)
    leafy = (green > red + 15) & (green > blue + 15)
    assert (changed & leafy).sum() > 0.3 * leafy.sum()


@pytest.mark.usefixtures("drawing")
def test_the_mark_is_where_the_heading_is(tmp_path: Path) -> None:
    """Seen with +x to the right, the cream sector lies right of the middle."""
    scene = scene_of("cylinder:0.04x0.02")
    tape = tape_of(scene, *(0.0, 90.0, 180.0, 270.0))
    paths = {tmp_path / f"{k}.png": float(k) for k in range(4)}
    draw_tape(tape, pictures=paths)
    places = []
    for path in paths:
        pixels = pixels_of(path)
        cream = (pixels.min(axis=2) > 150) & (pixels[..., 0] - pixels[..., 2] > 12)
        leafy = pixels[..., 1] > pixels[..., 0] + 15
        rows, columns = np.nonzero(leafy)
        box = np.s_[rows.min() : rows.max(), columns.min() : columns.max()]
        at = np.argwhere(cream[box])
        assert len(at) > 50
        places.append(at.mean(axis=0) - np.array(cream[box].shape) / 2)
    # opposite headings are opposite in the picture
    assert np.dot(places[0], places[2]) < 0
    assert np.dot(places[1], places[3]) < 0


def test_looks_weigh_nothing_and_touch_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    for hand in ("allegro_hand", "shadow_hand", "shadow_hand_left", "allegro_on_arm7"):
        dressed = scene_of("box", hand).model
        with monkeypatch.context() as plain:
            plain.setattr("sim.scene.build.dress_hand", lambda spec, model: None)
            bare = scene_of("box", hand).model
        assert dressed.ngeom > bare.ngeom + 10
        for name in (
            "body_mass",
            "body_inertia",
            "body_ipos",
            "body_iquat",
            "dof_M0",
            "body_contype",
        ):
            assert np.array_equal(getattr(dressed, name), getattr(bare, name)), name
        collides = (dressed.geom_contype != 0) | (dressed.geom_conaffinity != 0)
        names = [dressed.geom(int(g)).name for g in np.flatnonzero(collides)]
        assert names == [
            bare.geom(g).name
            for g in range(bare.ngeom)
            if bare.geom_contype[g] or bare.geom_conaffinity[g]
        ]
        there = [bare.geom(name).id for name in names]
        for field in (
            "size",
            "pos",
            "quat",
            "type",
            "contype",
            "conaffinity",
            "priority",
            "margin",
        ):
            a, b = getattr(dressed, f"geom_{field}"), getattr(bare, f"geom_{field}")
            assert np.array_equal(a[collides], b[there]), field


def test_a_published_hand_is_drawn_as_it_is_under_our_sky() -> None:
    spec = mujoco.MjSpec.from_string(
        """<mujoco><asset><texture name="sky" type="skybox" builtin="flat" width="8" height="48"/>
        <texture name="skin" type="2d" builtin="flat" width="8" height="8"/></asset>
        <worldbody><light name="own"/><body><geom name="seen" size="0.1" contype="0"
        conaffinity="0"/><geom name="felt" type="box" size="0.1 0.1 0.1"/></body></worldbody>
        </mujoco>"""
    )
    dress_hand(spec, spec.compile())
    model = spec.compile()
    assert [model.texture(i).name for i in range(model.ntex)] == ["skin"]
    assert model.nlight == 0
    assert model.ngeom == 2 and not model.geom_group.any()


def test_looks_add_no_mass_where_inertia_comes_from_geoms() -> None:
    spec = mujoco.MjSpec.from_string(
        """<mujoco><worldbody><body><geom name="palm" type="box" size="0.04 0.04 0.01"/>
        <body><joint axis="0 1 0"/><geom name="link" type="capsule" size="0.01"
        fromto="0 0 0 0 0 0.05"/></body></body></worldbody></mujoco>"""
    )
    bare = spec.compile()
    dress_hand(spec, bare)
    dressed = spec.compile()
    assert dressed.ngeom == bare.ngeom + 3  # a housing, a boot, a pin
    assert np.array_equal(dressed.body_mass, bare.body_mass)
    assert np.array_equal(dressed.body_inertia, bare.body_inertia)


def test_what_collides_and_is_not_drawn_is_drawn_as_something_else() -> None:
    for hand in ("allegro_hand", "shadow_hand"):
        model = scene_of("box", hand).model
        hidden = np.flatnonzero(model.geom_group == 3)
        assert len(hidden) > 3
        for body in np.unique(model.geom_bodyid[hidden]):
            own = np.flatnonzero(model.geom_bodyid == body)
            drawn = [g for g in own.tolist() if model.geom_group[g] == 0]
            # the box around what is drawn is that around what collides, up to a rounded corner
            boxes = [box_of(model, g) for g in own.tolist() if g in hidden]
            seen = [box_of(model, g) for g in drawn]
            low, high = np.min([b[0] for b in boxes], axis=0), np.max([b[1] for b in boxes], axis=0)
            assert (np.min([b[0] for b in seen], axis=0) <= low + 1e-4).all()
            assert (np.max([b[1] for b in seen], axis=0) >= high - 1e-4).all()


def box_of(model: mujoco.MjModel, g: int) -> tuple[FloatArray, FloatArray]:
    """Least and largest coordinates (3,) in the body's frame."""
    center, half = model.geom_aabb[g][:3], model.geom_aabb[g][3:]
    turn = np.zeros(9)
    mujoco.mju_quat2Mat(turn, model.geom_quat[g])
    corners = np.array([center + half * (2 * np.array(s) - 1) for s in np.ndindex(2, 2, 2)])
    there = corners @ turn.reshape(3, 3).T + model.geom_pos[g]
    return there.min(axis=0), there.max(axis=0)


def test_every_way_to_draw_is_tried_and_named(
    scene: Scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sys.platform", "linux")
    for name in ("MUJOCO_GL", "DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    before = os.environ.copy()
    for way in ("egl", "osmesa"):
        monkeypatch.setitem(sys.modules, f"mujoco.{way}", None)
    drawn = draw_tape(tape_of(scene, 0.0), pictures={tmp_path / "box.png": None})
    assert drawn.files == ()
    assert drawn.reason.startswith("no offscreen rendering (EGL: import of mujoco.egl halted")
    assert "OSMesa: import of mujoco.osmesa halted" in drawn.reason
    assert "GLFW: there is no display" in drawn.reason
    assert "\n" not in drawn.reason
    assert os.environ.copy() == before


@pytest.mark.parametrize(
    ("asked", "told"),
    [
        ("off", "MUJOCO_GL is off; unset it"),
        ("vulkan", "MUJOCO_GL does not know it; give one of egl, osmesa, glfw"),
        ("glfw", "GLFW: there is no display); unset MUJOCO_GL"),
    ],
)
def test_what_mujoco_gl_names_is_the_only_way(
    asked: str, told: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sys.platform", "linux")
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    monkeypatch.setenv("MUJOCO_GL", asked)
    found = open_backend(8, 8)
    assert isinstance(found, str)
    assert told in found


BACKEND = "from sim.show.painter import open_backend; print(open_backend(8, 8))"


@pytest.mark.skipif(sys.platform != "linux", reason="the ways of Linux")
@pytest.mark.parametrize("display", ["", ":77"])
def test_a_machine_without_any_is_told_in_one_line(tmp_path: Path, display: str) -> None:
    """No driver for EGL, no OSMesa, and no display or one that is not there; for real."""
    environment = {**os.environ, "__EGL_VENDOR_LIBRARY_DIRS": str(tmp_path), "DISPLAY": display}
    environment.pop("MUJOCO_GL", None)
    environment.pop("WAYLAND_DISPLAY", None)
    ran = subprocess.run(
        [sys.executable, "-c", BACKEND],
        env=environment,
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=True,
    )
    assert ran.stderr == ""
    assert ran.stdout.count("\n") == 1
    if ran.stdout.startswith("Backend"):
        pytest.skip("a way is left: OSMesa, or an EGL without vendor files")
    assert ran.stdout.startswith("no offscreen rendering (EGL: ")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.usefixtures("drawing")
def test_unwritable_file_gives_a_reason(scene: Scene, tmp_path: Path) -> None:
    for name, told in (("missing/box.png", "No such file"), ("box.nothing", "unknown file ext")):
        drawn = draw_tape(tape_of(scene, 0.0), pictures={tmp_path / name: None})
        assert drawn.files == ()
        assert drawn.reason.startswith(f"cannot write {tmp_path / name}: {told}")


def test_a_failure_has_its_moment_and_its_end() -> None:
    assert moments_of(None, 1.0) == {}
    assert moments_of("a/held.png", None) == {Path("a/held.png"): None}
    assert moments_of("a/held.png", 1.5) == {
        Path("a/held.png"): 1.5,
        Path("a/held-end.png"): None,
    }


def test_what_was_drawn_is_told_in_one_line() -> None:
    files = tuple(Path(f"{k}.png") for k in range(2))
    drawn = Drawn(files=(*files, Path("run.mp4")), moments={files[0]: 1.5}, backend="EGL", speed=2)
    assert str(drawn) == (
        "0.png at 1.50 s, 1.png, run.mp4 (drawn by EGL, 2.0 times as fast as simulated)"
    )
    many = Drawn(files=tuple(Path(f"{k}.png") for k in range(9)), backend="EGL")
    assert str(many) == "9 pictures (drawn by EGL)"
    assert str(Drawn(reason="nothing")) == "nothing"


def test_ctrl_c_while_a_film_is_drawn_keeps_what_there_is(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The report of what was simulated is made after it."""
    still = Drawn(files=(tmp_path / "a.png",), backend="EGL")

    def struck(*_: object) -> Drawn:
        raise KeyboardInterrupt

    monkeypatch.setattr("sim.show.picture._draw_stills", lambda *_: still)
    monkeypatch.setattr("sim.show.picture._draw_film", struck)
    tape: Any = SimpleNamespace(frames=[0])
    drawn = draw_tape(tape, pictures={tmp_path / "a.png": None}, video=tmp_path / "a.webp")
    assert drawn.files == still.files
    assert drawn.reason == "the drawing was ended by Ctrl-C"
    monkeypatch.setattr("sim.show.picture._draw_stills", struck)
    assert draw_tape(tape, pictures={tmp_path / "a.png": None}).reason == drawn.reason
