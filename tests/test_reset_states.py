"""``sim.datasets.reset_states``: states that are kept are stable, distinct and repeatable."""

from __future__ import annotations

import ast
import json
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from shutil import copytree

import mujoco
import numpy as np
import pytest
from brief import SMALL_SHARD
from scipy.spatial.transform import Rotation

from planner.errors import FileFormatError, ObjectError, TaskError
from planner.objects import parse_object
from planner.task import GraspTask
from sim.datasets.reset_states import Draws, StatesAsked, StateSet, StatesProgress, make_states
from sim.datasets.reset_states.check_states import main as share_held
from sim.datasets.reset_states.hold import (
    DROPPED,
    LIMITS,
    LOOSE,
    PENETRATES,
    REASONS,
    hold,
    write_scene,
)
from sim.datasets.reset_states.shards import (
    BANDS,
    NEAR_JOINT,
    NEAR_POSITION,
    SECTORS,
    TURNS,
    Distinct,
    coverage,
    open_folder,
    orientation_cells,
    read_shard,
    shard_path,
)
from sim.datasets.reset_states.starts import (
    Starts,
    cells_of,
    load_starts,
    plan_jobs,
    planned_sources,
    scaled,
)
from sim.scene.physics import PhysicsOptions

ASKED = StatesAsked(
    hand="allegro_hand", objects=("cylinder:0.03x0.08",), n=8, grasps=6, motions=1, gaits=0
)
CELL = "cylinder-0.03x0.08-s1"

pytestmark = pytest.mark.usefixtures("small_shards")


@pytest.fixture(scope="module")
def cache(small_shards: None, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A cache of 8 states."""
    folder = tmp_path_factory.mktemp("states") / "cache"
    summary = make_states(ASKED, folder, workers=1)
    assert summary == json.loads((folder / "summary.json").read_text(encoding="utf-8"))
    return folder


@pytest.fixture
def starts(cache: Path) -> Starts:
    return load_starts(cache / CELL)


def test_what_is_kept_is_counted_and_lies_within_what_was_asked_for(cache: Path) -> None:
    (cell,) = json.loads((cache / "summary.json").read_text(encoding="utf-8"))["cells"]
    assert cell["states"] == 8
    assert cell["tried"] == 8 + sum(cell["lost"].values())
    assert cell["plans"]["motion"]["poses"] > 2 * cell["plans"]["motion"]["found"]
    states = StateSet.read(cache / CELL / "states.npz")
    assert len(states) == 8
    assert np.allclose(np.linalg.norm(states.gravity, axis=1), 9.81)
    assert ((states.mass >= 0.05) & (states.mass <= 0.15)).all()
    assert ((states.friction >= 0.6) & (states.friction <= 1.2)).all()
    assert np.allclose(np.linalg.norm(states.quaternion, axis=1), 1.0)
    # the hand's servos press: targets lie inside of the object, on average by over a degree
    assert np.abs(states.targets - states.q).mean() > np.deg2rad(1.0)


@pytest.mark.slow
def test_states_are_still_held_by_a_script_that_knows_nothing_of_us(cache: Path) -> None:
    script = cache / "check_states.py"
    done = subprocess.run(
        [sys.executable, str(script), str(cache / CELL / "states.npz")],
        capture_output=True,
        text=True,
        check=True,
    )
    assert "8 of 8 states held" in done.stdout
    for words in ([], ["none.npz"], [str(cache / CELL / "states.npz"), "many"]):
        wrong = subprocess.run(
            [sys.executable, str(script), *words], capture_output=True, text=True, check=False
        )
        assert wrong.returncode == 2, wrong.stderr
        assert (
            wrong.stderr == "usage: python check_states.py CACHE/OBJECT/states.npz [COUNT] [SEED]\n"
        )
    text = script.read_text(encoding="utf-8")
    assert len(text.splitlines()) < 60
    imported = {
        name.name.split(".")[0] if isinstance(node, ast.Import) else str(node.module)
        for node in ast.walk(ast.parse(text))
        if isinstance(node, ast.Import | ast.ImportFrom)
        for name in node.names
    }
    assert imported == {"mujoco", "numpy", "pathlib", "sys"}


@pytest.mark.slow
@pytest.mark.parametrize(
    "fault", ["no squeeze", "joints in another order", "quaternion x, y, z, w", "position in mm"]
)
def test_a_cache_with_a_fault_is_noticed_by_the_script(
    cache: Path, tmp_path: Path, fault: str
) -> None:
    broken = tmp_path / CELL
    copytree(cache / CELL, broken)
    states = StateSet.read(broken / "states.npz")
    if fault == "no squeeze":
        sources = load_starts(cache / CELL).sources
        states = replace(states, commands=np.tile(sources["rest"][0], (8, 1)))
    elif fault == "joints in another order":
        states = replace(states, joint_names=states.joint_names[4:] + states.joint_names[:4])
    elif fault == "quaternion x, y, z, w":
        states = replace(states, quaternion=np.roll(states.quaternion, -1, axis=1))
    else:
        states = replace(states, position=1000.0 * states.position)
    states[:6].write(broken / "states.npz")
    assert share_held(broken / "states.npz") < 0.5


def test_a_hold_without_squeeze_is_lost(starts: Starts) -> None:
    lost = 0
    for index in range(6):
        start = starts.draw(index)
        rest = starts.sources["rest"][start.source]
        starts.put(replace(start, commands=rest, gravity=np.array([0.0, 0.0, -9.81]), mass=0.3))
        lost += bool(hold(starts.scene).reason)
    assert lost >= 5


def test_a_lost_hold_says_why_and_ends_early(starts: Starts) -> None:
    start = starts.draw(0)
    far = replace(start, position=start.position + np.array([0.5, 0.0, 0.0]))
    starts.put(far)
    end = hold(starts.scene)
    assert end.reason == DROPPED
    assert end.steps < 0.1 * 1000
    starts.put(replace(far, gravity=np.zeros(3)))
    assert hold(starts.scene).reason == LOOSE
    # a joint that is driven beyond its end by a servo that never arrives
    joints = starts.scene.model.jnt_range
    joints[0] = start.q[0] + 0.2, start.q[0] + 0.3
    starts.put(replace(far, gravity=np.zeros(3), q=start.q))
    pressed = hold(starts.scene)
    load_starts.cache_clear()  # the model was changed
    assert pressed.reason in (LIMITS, LOOSE, PENETRATES)
    assert len(set(REASONS)) == len(REASONS)


def test_candidate_i_is_the_same_whatever_was_drawn_before(cache: Path, starts: Starts) -> None:
    later = starts.draw(70)
    load_starts.cache_clear()
    again = load_starts(cache / CELL).draw(70)
    assert later.source == again.source
    for name in ("q", "commands", "position", "quaternion", "gravity", "mass", "friction"):
        assert np.array_equal(getattr(later, name), getattr(again, name)), name
    assert not np.array_equal(starts.draw(71).gravity, later.gravity)


@pytest.mark.slow
def test_a_scene_of_a_hand_with_files_of_its_own_stands_alone(tmp_path: Path) -> None:
    pytest.importorskip("gymnasium_robotics")
    task = GraspTask.create("gymnasium-robotics:adroit", "box", table_height=None)
    there = write_scene(task, PhysicsOptions(), tmp_path / "a").parent.rename(tmp_path / "b")
    model, own = mujoco.MjModel.from_xml_path(str(there / "scene.xml")), task.hand.mj_model
    for body in range(1, own.nbody):
        found = model.body(own.body(body).name)
        assert np.allclose(found.mass, own.body_mass[body], rtol=1e-5)
        assert np.allclose(found.inertia, own.body_inertia[body], rtol=1e-4, atol=1e-9)


@pytest.mark.slow
def test_a_gait_gives_poses_that_fewer_fingers_hold() -> None:
    asked = StatesAsked(
        hand="shadow_hand", objects=("cylinder:0.03x0.10",), n=1, grasps=0, motions=0, gaits=3
    )
    _, cells = cells_of(asked)
    plans = map(planned_sources, plan_jobs(asked, cells[0][0]))
    found = next(plan["sources"] for plan in plans if plan["sources"])
    fingers = [len(source["fingers"]) for source in found]
    assert max(fingers) == 5
    assert fingers.count(4) >= 2
    assert {source["kind"] for source in found} == {"gait"}
    assert len({source["pose"] for source in found}) == len(found)


@pytest.mark.slow
def test_processes_give_the_same_states_as_one(tmp_path: Path) -> None:
    few, files = replace(ASKED, n=4, grasps=2, motions=0), []
    for workers in (1, 2):
        make_states(few, tmp_path / str(workers), workers=workers, formats=("npz",))
        files.append(np.load(tmp_path / str(workers) / CELL / "states.npz"))
    one, two = files
    assert one.files == two.files
    for name in one.files:
        assert np.array_equal(one[name], two[name]), name


@pytest.mark.slow
def test_more_states_begin_with_the_same_ones(cache: Path, tmp_path: Path) -> None:
    copytree(cache, tmp_path / "cache")
    seen: list[StatesProgress] = []
    asked = replace(ASKED, n=24)
    make_states(asked, tmp_path / "cache", workers=1, formats=("npz",), progress=seen.append)
    more = StateSet.read(tmp_path / "cache" / CELL / "states.npz")
    assert len(more) == 24
    assert np.array_equal(more.q[:8], StateSet.read(cache / CELL / "states.npz").q)
    assert seen[-1].before > 0  # the first shard was there
    assert (seen[-1].done, seen[-1].total, seen[-1].phase) == (24, 24, "holding")


@pytest.mark.slow
def test_a_killed_run_goes_on(cache: Path, tmp_path: Path) -> None:
    folder = tmp_path / "cache"
    words = [
        sys.executable,
        "-c",
        "from brief import small_shards; from sim.cli import main\nwith small_shards(): main()",
        "dataset",
        "states",
        ASKED.hand,
    ]
    words += [*ASKED.objects, "-n", "100000", "--grasps", "6", "--motions", "1", "--gaits", "0"]
    words += ["--workers", "1"]
    killed = subprocess.Popen([*words, "--out", str(folder)], cwd=Path(__file__).parent)
    first = shard_path(folder / CELL, 0)
    deadline = time.monotonic() + 240.0
    while not first.exists() and killed.poll() is None and time.monotonic() < deadline:
        time.sleep(0.05)
    killed.send_signal(signal.SIGKILL)
    killed.wait()
    written = first.stat().st_mtime_ns
    make_states(ASKED, folder, workers=1, formats=("npz",))
    assert first.stat().st_mtime_ns == written  # it was not held again
    again = StateSet.read(folder / CELL / "states.npz")
    assert np.array_equal(again.q, StateSet.read(cache / CELL / "states.npz").q)


@pytest.mark.slow
def test_a_damaged_shard_is_held_again(cache: Path, tmp_path: Path) -> None:
    copytree(cache, tmp_path / "cache")
    folder = tmp_path / "cache" / CELL
    whole = read_shard(folder, 0)
    assert whole is not None
    assert len(whole.reason) == SMALL_SHARD
    assert (whole.reason == 0).sum() == len(whole.q)
    path = shard_path(folder, 0)
    path.write_bytes(path.read_bytes()[:1000])
    assert read_shard(folder, 0) is None
    make_states(ASKED, tmp_path / "cache", workers=1, formats=("npz",))
    mended = read_shard(folder, 0)
    assert mended is not None
    assert np.array_equal(mended.q, whole.q)


def test_a_folder_with_something_else_is_refused(cache: Path, tmp_path: Path) -> None:
    with pytest.raises(FileFormatError, match=r"seed is 0 there and 1 here"):
        make_states(replace(ASKED, seed=1), cache, workers=1)
    (tmp_path / "note.txt").write_text("mine", encoding="utf-8")
    with pytest.raises(FileFormatError, match="not empty"):
        make_states(ASKED, tmp_path, workers=1)


def test_bad_requests_are_refused() -> None:
    for fault, words in (
        ({"objects": ()}, "no objects"),
        ({"scales": (0.0,)}, "scales is 0.0; give a finite number from 0.01"),
        ({"grasps": 0, "motions": 0}, "to be planned"),
        ({"turn": 4.0}, "turn is"),
        ({"n": 0}, "n is 0"),
    ):
        with pytest.raises(TaskError, match=words):
            replace(ASKED, **fault)
    for draws, words in (
        ({"friction": (1.0, 0.5)}, "the smaller one first"),
        ({"gravity": (0.0, 0.0, 0.0)}, "no direction"),
        ({"angle": float("nan")}, "angle is nan; give a finite number >= 0"),
    ):
        with pytest.raises(TaskError, match=words):
            Draws(**draws)
    with pytest.raises(TaskError, match="no position servos"):
        cells_of(replace(ASKED, hand="shadow_hand_torque"))
    with pytest.raises(TaskError, match="hangs on an arm"):
        cells_of(replace(ASKED, hand="allegro_on_arm7"))
    with pytest.raises(ObjectError, match="two objects are called"):
        cells_of(replace(ASKED, objects=("box", "box")))


def test_a_size_multiplies_lengths_and_no_pure_numbers() -> None:
    item = parse_object("superquadric:0.06x0.06x0.08x0.5x0.4")
    grown = scaled(item, 1.25)
    assert grown.shape.spec == "superquadric:0.075x0.075x0.1x0.5x0.4"
    assert grown.mass == item.mass
    mug = parse_object("mug")
    assert np.isclose(scaled(mug, 0.8).shape.volume, 0.8**3 * mug.shape.volume)


def test_near_duplicates_are_left_out_across_the_border_of_a_cube() -> None:
    distinct = Distinct()
    q, place, turned = np.zeros(4), np.array([0.0009, 0.0, 0.0]), np.array([1.0, 0.0, 0.0, 0.0])
    assert distinct.take(q, place, turned)
    step = np.array([0.9 * NEAR_POSITION, 0.0, 0.0])
    assert not distinct.take(q, place + step, turned)
    assert not distinct.take(q, place, -turned)  # the same orientation
    assert distinct.take(q, place + 1.2 * step, turned)
    assert distinct.take(q + 1.1 * NEAR_JOINT, place, turned)
    more = np.array([np.cos(0.01), np.sin(0.01), 0.0, 0.0])  # 1.15 degrees
    assert distinct.take(q, place, more)


def test_orientation_cells_have_equal_volume() -> None:
    rotations = Rotation.random(200_000, random_state=0).as_matrix()
    counts = np.bincount(orientation_cells(rotations), minlength=BANDS * SECTORS * TURNS)
    assert len(counts) == BANDS * SECTORS * TURNS
    # Poisson: 231 on average, standard deviation 15
    assert counts.min() > 150
    assert counts.max() < 320
    found = coverage(rotations[:1], np.array([[0.0, 0.0, -9.81]]))
    assert found["orientations_of_object_in_palm"]["reached"] == 1
    assert found["directions_of_gravity_in_palm"]["cells"] == 72


def test_another_process_is_kept_out_while_a_cache_is_made(tmp_path: Path) -> None:
    folder = tmp_path / "cache"
    with (
        open_folder(folder, ASKED, "digest"),
        pytest.raises(FileFormatError, match="another process is adding states"),
        open_folder(folder, ASKED, "digest"),
    ):
        pass
    with open_folder(folder, ASKED, "digest"):  # goes on once the other has ended
        assert (folder / "manifest.json").exists()
