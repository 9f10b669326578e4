"""Films: what they show, how long they are, and that nothing moves otherwise because of them."""

from __future__ import annotations

import importlib.util
import io
import subprocess
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import fields, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from brief import SMALL_PICTURE, brief_trials
from conftest import PlanOf
from PIL import Image, ImageSequence

from planner.errors import TaskError
from planner.files import write_plan
from planner.plan import GraspPlan
from planner.search.grasp import plan_grasp
from planner.task import GraspTask
from sim.cli import main
from sim.report import TrialReport
from sim.scene.build import build_scene
from sim.scene.physics import PhysicsOptions
from sim.show.camera import FIELD_OF_VIEW_DEG, MARGIN, Subject, View, choose_views, sees
from sim.show.painter import Quality
from sim.show.picture import FORMATS, Tape, check_video, draw_tape, write_film
from sim.simulation import Simulation, filmed
from sim.trial import Timeline, simulate

pytestmark = pytest.mark.usefixtures("coarse_steps")

SHORT = Timeline.quick()


@pytest.fixture(scope="module")
def plan(plan_of: PlanOf) -> GraspPlan:
    return plan_of("allegro_hand", "cylinder")


@pytest.fixture(scope="module")
def tape(plan: GraspPlan) -> Tape:
    """A trial's states."""
    tapes: list[Tape] = []

    def look(simulation: Simulation) -> None:
        if not tapes:
            tapes.append(simulation.record())

    simulate(plan, timeline=SHORT, on_step=look)
    return tapes[0]


@pytest.fixture
def drawing(can_draw: bool) -> None:
    if not can_draw:
        pytest.skip("this machine does not draw without a display")


# ---- where the camera stands


def in_picture(tape: Tape, view: View, qpos: Any, aspect: float) -> Any:
    """Coordinates in the picture, 1 at its edges, of everything that is to be seen: (n, 2)."""
    data = mujoco.MjData(tape.model)
    data.qpos[:] = qpos
    mujoco.mj_kinematics(tape.model, data)
    geoms = np.flatnonzero(np.isin(tape.model.geom_bodyid, tape.subject.bodies))
    corners = []
    for g in geoms:
        center, half = tape.model.geom_aabb[g][:3], tape.model.geom_aabb[g][3:]
        for signs in np.ndindex(2, 2, 2):
            local = center + half * (2 * np.array(signs) - 1)
            corners.append(data.geom_xmat[g].reshape(3, 3) @ local + data.geom_xpos[g])
    eye = view.lookat - view.distance * view.axes[:, 2]
    right, up, depth = ((np.array(corners) - eye) @ view.axes).T
    half_height = np.tan(np.deg2rad(FIELD_OF_VIEW_DEG / 2)) * depth
    assert (depth > 0).all()
    return np.column_stack([right / (aspect * half_height), up / half_height])


@pytest.mark.parametrize("aspect", [4 / 3, 16 / 9, 0.6])
def test_hand_and_object_stay_in_the_picture(tape: Tape, aspect: float) -> None:
    poses = [frame.qpos for frame in tape.frames]
    views = choose_views(tape.model, poses, tape.subject, aspect, follow=25.0)
    furthest = [
        np.abs(in_picture(tape, v, q, aspect)).max() for v, q in zip(views, poses, strict=True)
    ]
    assert max(furthest) <= 1.0
    assert min(furthest) > 0.55  # not from far away
    single = choose_views(tape.model, poses[-1:], tape.subject, aspect, follow=None)
    assert np.abs(in_picture(tape, single[0], poses[-1], aspect)).max() == pytest.approx(
        1 / MARGIN, abs=0.02
    )


def test_the_camera_moves_smoothly(tape: Tape) -> None:
    poses = [frame.qpos for frame in tape.frames]
    views = choose_views(tape.model, poses, tape.subject, 4 / 3, follow=25.0)
    steps = [np.linalg.norm(b.lookat - a.lookat) for a, b in pairwise(views)]
    assert max(steps) < 0.01
    assert len({(v.azimuth, v.elevation) for v in views}) == 1


@pytest.mark.parametrize("hand", ["allegro_hand", "shadow_hand"])
@pytest.mark.parametrize("shape", ["box", "cylinder"])
def test_the_camera_does_not_look_through_the_palm(hand: str, shape: str) -> None:
    """Object and tips are seen, and more of them than from the other side of the palm."""
    found = plan_grasp(GraspTask.create(hand, shape), seed=1)
    scene = build_scene(found.task, T_world_base=found.T_world_base, q=found.q)
    data = scene.start(found.q, found.T_world_base)
    (view,) = choose_views(scene.model, [data.qpos], scene.subject, 4 / 3, follow=None)

    def shares(view: View) -> tuple[float, int]:
        bodies = sees(scene.model, data, view, 4 / 3)
        tips = sum((bodies == tip).any() for tip in scene.subject.tips)
        return float((bodies == scene.object_body).mean()), int(tips)

    area, tips = shares(view)
    assert area > 0.04
    assert tips >= len(scene.subject.tips) - 1
    palm = found.T_world_palm.rotation @ found.task.hand.palm_normal
    behind = View(
        lookat=view.lookat,
        distance=view.distance,
        azimuth=float(np.rad2deg(np.arctan2(palm[1], palm[0]))),
        elevation=float(np.rad2deg(np.arcsin(palm[2]))),
    )
    assert shares(behind)[0] < area


def test_a_wall_is_walked_around() -> None:
    wall = '<geom type="box" size="0.01 0.4 0.4" pos="{} 0 0.2"/>'
    for side in (-0.12, 0.12):
        model = mujoco.MjModel.from_xml_string(
            f'<mujoco><worldbody>{wall.format(side)}<body name="ball"><freejoint/>'
            '<geom size="0.05"/></body></worldbody></mujoco>'
        )
        subject = Subject(object_body=1, tips=(1,), bodies=(1,))
        (view,) = choose_views(model, [np.array(model.qpos0)], subject, 4 / 3, follow=None)
        eye = -view.axes[:, 2]
        assert eye[0] * side < 0.02, "the camera stands behind the wall"


# ---- which states are shown


def numbered(tape: Tape, times: list[float]) -> Tape:
    other = Tape(tape.model, tape.subject)
    for time in times:
        other.keep(time, tape.frames[0].qpos)
    return other


def test_a_film_is_as_long_as_what_it_shows(tape: Tape) -> None:
    even = numbered(tape, [0.04 * k for k in range(251)])
    frames, speed = even.evenly(12.5, 500)
    assert speed == 1.0
    assert [f.time for f in frames] == pytest.approx([0.08 * k for k in range(126)])
    frames, speed = even.evenly(12.5, 50)
    assert speed == pytest.approx(2.5)
    assert len(frames) == 51
    assert frames[-1].time == pytest.approx(10.0)
    uneven = numbered(tape, [0.0, 0.09, 0.12, 0.2])
    assert [f.time for f in uneven.evenly(10.0, 99)[0]] == [0.0, 0.09, 0.2]
    assert [f.time for f in numbered(tape, [3.0]).evenly(25.0, 99)[0]] == [3.0]


def test_the_moment_is_the_nearest_that_was_kept(tape: Tape) -> None:
    kept = numbered(tape, [0.0, 0.04, 0.08])
    assert kept.at(0.05).time == 0.04
    assert kept.at(9.0).time == kept.at(None).time == 0.08


# ---- files


def frames_of(count: int) -> list[Any]:
    """A white bar that goes from left to right."""
    out = np.zeros((count, 48, 64, 3), dtype=np.uint8)
    for k in range(count):
        out[k, :, 4 * k : 4 * k + 4] = 255
    return list(out)


def film_in(path: Path) -> tuple[list[Any], list[int]]:
    """Frames (height, width, 3) and durations, ms, of a film that Pillow reads."""
    with Image.open(path) as film:
        shown = [
            (np.asarray(f.convert("RGB")), f.info["duration"]) for f in ImageSequence.Iterator(film)
        ]
    return [frame for frame, _ in shown], [duration for _, duration in shown]


def picture_in(path: Path) -> Any:
    """Pixels (height, width, 3) of a picture."""
    with Image.open(path) as picture:
        return np.asarray(picture.convert("RGB")).astype(int)


def small(ending: str) -> Any:
    quality = Quality(size=(64, 48), larger=1.0, shadows=256, slices=8)
    return replace(FORMATS[ending], quality=quality)


@pytest.mark.parametrize("ending", [".webp", ".gif"])
def test_pillow_writes_films_that_loop(ending: str, tmp_path: Path) -> None:
    path = tmp_path / f"bar{ending}"
    write_film(path, frames_of(10), small(ending))
    with Image.open(path) as film:
        assert (film.size, film.info["loop"]) == ((64, 48), 0)
    frames, durations = film_in(path)
    assert durations == [round(1e3 / FORMATS[ending].rate)] * 10
    for k, frame in enumerate(frames):
        assert int(frame.mean(axis=(0, 2)).argmax()) // 4 == k


def test_ffmpeg_writes_films(tmp_path: Path) -> None:
    ffmpeg = pytest.importorskip("imageio_ffmpeg")
    path = tmp_path / "bar.mp4"
    write_film(path, iter(frames_of(10)), small(".mp4"))
    decode = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-"]
    ran = subprocess.run(
        [ffmpeg.get_ffmpeg_exe(), "-i", str(path), *decode], capture_output=True, check=True
    )
    said = ran.stderr.decode()
    assert "yuv420p" in said and "64x48" in said and "25 fps" in said
    assert "Duration: 00:00:00.40" in said
    frames = np.frombuffer(ran.stdout, dtype=np.uint8).reshape(-1, 48, 64, 3)
    assert len(frames) == 10
    for k, frame in enumerate(frames):
        assert abs(int(frame.mean(axis=(0, 2)).argmax()) // 4 - k) <= 1
    assert list(tmp_path.iterdir()) == [path]


def test_a_film_that_cannot_be_is_refused_before_the_work(
    plan: GraspPlan, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    check_video(None)
    check_video("run.webp")
    with pytest.raises(TaskError, match=r"'run.avi' is not known; give .mp4, .webp, .gif"):
        check_video("run.avi")
    find = importlib.util.find_spec
    monkeypatch.setattr(
        "sim.show.picture.find_spec",
        lambda name: None if name == "imageio_ffmpeg" else find(name),
    )
    with pytest.raises(TaskError, match=r'pip install "opposable\[video\]"; .webp and .gif need'):
        simulate(plan, video=tmp_path / "run.mp4")
    check_video("run.gif")


@pytest.mark.usefixtures("drawing")
@pytest.mark.parametrize("ending", [".webp", ".gif", ".mp4"])
def test_a_folder_that_is_not_there_gives_a_reason(tape: Tape, ending: str, tmp_path: Path) -> None:
    if ending == ".mp4":
        pytest.importorskip("imageio_ffmpeg")
    short = Tape(tape.model, tape.subject)
    short.frames = tape.frames[:2]
    drawn = draw_tape(short, video=tmp_path / "missing" / f"a{ending}")
    assert drawn.files == ()
    assert (
        drawn.reason
        == f"cannot write {tmp_path / 'missing' / f'a{ending}'}: No such file or directory"
    )


def test_no_states_give_a_reason(tape: Tape, tmp_path: Path) -> None:
    drawn = draw_tape(Tape(tape.model, tape.subject), video=tmp_path / "a.webp")
    assert drawn.reason == "there is nothing to draw: no state was kept"


# ---- what is simulated


def samples_of(report: TrialReport) -> dict[str, str]:
    """All numbers of all samples, to the last bit, by channel."""
    samples = report.samples
    return {f.name: str(np.asarray(getattr(samples, f.name)).tolist()) for f in fields(samples)}


@pytest.mark.slow
def test_a_film_changes_nothing(plan: GraspPlan, tmp_path: Path, can_draw: bool) -> None:
    with brief_trials():
        plain = simulate(plan)
        shown = simulate(
            plan, picture=tmp_path / "held.png", video=tmp_path / "run.webp", arrows=True
        )
    assert samples_of(plain) == samples_of(shown)
    assert (tmp_path / "run.webp").exists() == can_draw
    assert ("run.webp" in shown.drawn) == can_draw
    assert bool(shown.picture) == can_draw


@pytest.mark.slow
def test_hands_move_to_the_last_bit_as_without_their_looks(
    plan: GraspPlan, monkeypatch: pytest.MonkeyPatch
) -> None:
    dressed = simulate(plan, timeline=SHORT)
    monkeypatch.setattr("sim.scene.build.dress_hand", lambda spec, model: None)
    monkeypatch.setattr("sim.scene.build.add_scenery", lambda *args: None)
    bare = simulate(plan, timeline=SHORT)
    assert samples_of(dressed) == samples_of(bare)


@pytest.mark.slow
@pytest.mark.usefixtures("drawing")
def test_a_failure_is_shown_where_it_happened(plan: GraspPlan, tmp_path: Path) -> None:
    report = simulate(
        plan, physics=PhysicsOptions(mu=0.1), timeline=SHORT, picture=tmp_path / "held.png"
    )
    fault = report.verdict.fault
    assert fault is not None
    assert report.picture == tmp_path / "held.png"
    assert report.drawn.startswith(f"held.png at {fault.time:.2f} s, held-end.png (drawn by ")
    moment, end = (picture_in(tmp_path / name) for name in ("held.png", "held-end.png"))
    assert (moment != end).any()


@pytest.mark.slow
@pytest.mark.usefixtures("drawing")
def test_arrows_are_drawn_where_forces_are(tape: Tape, tmp_path: Path) -> None:
    """Red, and only if they are asked for; none before the hand touches."""

    def red(moment: float | None, arrows: bool) -> int:
        path = tmp_path / "a.png"
        draw_tape(tape, pictures={path: moment}, arrows=arrows)
        r, g, b = np.moveaxis(picture_in(path), 2, 0)
        return int(((r > g + 60) & (r > b + 60)).sum())

    assert red(None, False) == 0
    assert red(None, True) > 200
    assert red(0.0, True) == 0


@pytest.mark.usefixtures("drawing")
def test_the_first_simulation_of_a_block_is_filmed(plan: GraspPlan, tmp_path: Path) -> None:
    path = tmp_path / "hold.webp"
    with filmed(path):
        simulation = Simulation(plan)
        for _ in simulation.run("approach", 0.4):
            pass
    assert len(film_in(path)[0]) == 9
    with filmed(None):
        assert Simulation(plan).tape is None
    assert Simulation(plan).tape is None


# ---- the command line


def opposable(*arguments: str | Path) -> tuple[int, str, str]:
    out, err = io.StringIO(), io.StringIO()
    with redirect_stdout(out), redirect_stderr(err), pytest.raises(SystemExit) as ended:
        main([str(a) for a in arguments])
    assert isinstance(ended.value.code, int)
    return ended.value.code, out.getvalue(), " ".join(err.getvalue().split())


@pytest.mark.slow
@pytest.mark.usefixtures("drawing")
def test_simulate_films(plan: GraspPlan, tmp_path: Path) -> None:
    write_plan(plan, tmp_path / "plan.json")
    with brief_trials():
        words = ("test", tmp_path / "plan.json", "--video", tmp_path / "run.gif")
        code, out, err = opposable(*words)
    assert code == 0, err
    assert "run.gif (drawn by " in out
    assert len(film_in(tmp_path / "run.gif")[0]) > 20


@pytest.mark.slow
@pytest.mark.usefixtures("drawing")
def test_plans_are_drawn_without_a_simulation(tmp_path: Path) -> None:
    for command, sort in (("plan", ()), ("manipulate", ("--plan-only", "--rotate", "20"))):
        picture, film = tmp_path / f"{command}.png", tmp_path / f"{command}.webp"
        films = ("--video", film) if command == "manipulate" else ()
        with brief_trials():
            code, out, err = opposable(
                *(command, "allegro_hand", "cylinder", *sort, "-o", tmp_path / "plan.json"),
                *("--picture", picture, "--arrows", *films),
            )
        assert code == 0, err
        assert f"{picture.name} (drawn by " in out
        assert picture_in(picture).shape == (*SMALL_PICTURE.size[::-1], 3)
        if films:
            first, *_, last = film_in(film)[0]
            assert (first != last).any()


def test_bad_films_end_with_one_line(plan: GraspPlan, tmp_path: Path) -> None:
    write_plan(plan, tmp_path / "plan.json")
    for command in (
        ("test", tmp_path / "plan.json"),
        ("run", "allegro_hand", "box"),
        ("manipulate", "allegro_hand", "box"),
        ("manipulate", "--demo"),
        ("manipulate", "--plan-only", "allegro_hand", "box"),
        ("manipulate", "--plan-only", "--gait", "allegro_hand", "box"),
    ):
        code, _, err = opposable(*command, "--video", tmp_path / "run.avi")
        assert code == 3, command
        assert err == "error: a video 'run.avi' is not known; give .mp4, .webp, .gif"
        code, _, err = opposable(*command, "--video", tmp_path / "no" / "run.webp")
        assert code == 3, command
        assert "there is no folder" in err
    code, _, err = opposable(
        *("test", tmp_path / "plan.json", "--protocol", "shake"),
        *("--video", "avi", "--out", tmp_path),
    )
    assert code == 3
    assert "give .mp4, .webp, .gif" in err
