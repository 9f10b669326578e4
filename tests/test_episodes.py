"""Episodes of executed trials: rows are what the simulator had; a data set is whole or absent."""

from __future__ import annotations

import errno
import json
import subprocess
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from conftest import PlanOf
from manipulations import turned_cylinder_report

from planner.errors import FileFormatError, NotFoundError, PlannerError, TaskError
from planner.hands.hand import Hand
from sim.datasets.episodes import (
    FORMATS,
    Asked,
    Robot,
    episodes_of,
    format_named,
    sources,
    write_episodes,
    write_lerobot,
)
from sim.datasets.episodes.episode import frames_at, rates_of
from sim.datasets.episodes.lerobot import VIDEO_KEY
from sim.datasets.episodes.writing import draw_episode, sampled_frames
from sim.manipulation import ManipulationReport
from sim.manipulation.report_file import ManipulationReportFile
from sim.recording import PALM
from sim.report import TrialReport
from sim.report_file import ReportFile
from sim.scene.carrier import Timeline
from sim.scene.physics import PhysicsOptions
from sim.show.picture import write_film
from sim.simulation import Simulation
from sim.trial import simulate

pytestmark = pytest.mark.usefixtures("coarse_steps")

pa = pytest.importorskip("pyarrow")
pytest.importorskip("pyarrow.parquet")

QUICK = Timeline(lift=0.3, hold=0.2)


def stop_early(simulation: Simulation) -> None:
    if simulation.time > 0.4:
        simulation.stop("seen enough")


@pytest.fixture(scope="module")
def held(plan_of: PlanOf) -> TrialReport:
    report = simulate(plan_of("allegro_hand", "box"), timeline=QUICK)
    assert report.success
    return report


@pytest.fixture(scope="module")
def failed(held: TrialReport) -> TrialReport:
    report = simulate(held.plan, timeline=QUICK, on_step=stop_early)
    assert not report.success
    return report


@pytest.fixture(scope="module")
def turned() -> ManipulationReport:
    return turned_cylinder_report()


def with_states(report: TrialReport, **changed: Any) -> TrialReport:
    return replace(report, recording=replace(report.recording, **changed))


def bad_pose(report: TrialReport) -> TrialReport:
    pose = report.recording.T_world_object.copy()
    pose[7, 2] = np.nan
    return with_states(report, T_world_object=pose)


def empty(report: TrialReport) -> TrialReport:
    nothing = episodes_of(report)[0].taken(range(0)).recording
    return replace(report, recording=nothing)


def data_of(folder: Path) -> dict[str, Any]:
    """Columns of a LeRobot data set's only data file."""
    table = pa.parquet.read_table(folder / "data" / "chunk-000" / "file-000.parquet")
    return {name: np.array(table[name].to_pylist()) for name in table.column_names}


def info_of(folder: Path) -> dict[str, Any]:
    told: dict[str, Any] = json.loads((folder / "meta" / "info.json").read_text())
    return told


def rows_of(folder: Path) -> list[dict[str, Any]]:
    path = folder / "meta" / "episodes" / "chunk-000" / "file-000.parquet"
    rows: list[dict[str, Any]] = pa.parquet.read_table(path).to_pylist()
    return rows


# --- an episode --------------------------------------------------------------------------------


def test_an_episode_says_what_was_done_and_how_it_ended(
    held: TrialReport, failed: TrialReport
) -> None:
    (good,), (bad,) = episodes_of(held), episodes_of(failed)
    assert good.sentence == "grasp the box with allegro_hand and hold it"
    assert (good.success, good.reason, good.kind) == (True, "", "grasp")
    assert (bad.success, bad.reason) == (False, failed.reason) and bad.reason
    assert len(good) == len(held.recording)


def test_columns_of_contacts_are_all_fingers_and_the_palm(held: TrialReport) -> None:
    (episode,) = episodes_of(held)
    names = (*held.plan.task.hand.fingers, PALM)
    assert episode.recording.contact_names == episode.robot.contact_names == names
    for name in held.recording.contact_names:
        np.testing.assert_array_equal(
            episode.recording.forces[:, names.index(name)],
            held.recording.forces[:, held.recording.contact_names.index(name)],
        )


def test_a_file_of_the_report_gives_the_same_episode_to_its_rounding(held: TrialReport) -> None:
    data = ReportFile.model_validate(held.to_dict())
    (here,), (there,) = episodes_of(held), episodes_of(data, "report.json")
    assert (there.robot, there.sentence, there.success) == (here.robot, here.sentence, True)
    np.testing.assert_allclose(there.recording.q, here.recording.q, atol=6e-6)
    np.testing.assert_allclose(there.recording.forces, here.recording.forces, atol=6e-4)
    assert there.task is not None and there.task.object.shape.spec == held.object


def test_units_follow_from_joints_and_servos(allegro: Hand) -> None:
    law = allegro.actuation
    assert set(Robot.of(allegro).command_units) == set(Robot.of(allegro).joint_units) == {"rad"}
    one, none = np.ones_like(law.gain), np.zeros_like(law.bias)
    motors = replace(allegro, actuation=replace(law, gain=one, bias=none))
    scaled = replace(allegro, actuation=replace(law, gain=0.3 * one, bias=none))
    assert set(Robot.of(motors).command_units) == {"N m"}
    assert set(Robot.of(scaled).command_units) == {"-"}


def test_a_turn_is_an_episode_with_its_own_sentence(turned: ManipulationReport) -> None:
    (episode,) = episodes_of(turned)
    assert episode.sentence == (
        "pick up the cylinder with allegro_hand, turn it by 25 degrees in the hand and put it down"
    )
    assert episode.kind == "manipulation" and episode.success == turned.success
    file = ManipulationReportFile.model_validate(turned.to_dict())
    (read,) = episodes_of(file)
    assert (read.sentence, read.success, read.reason) == (
        episode.sentence,
        episode.success,
        episode.reason,
    )


def test_a_turn_that_was_begun_again_is_an_episode_per_run(turned: ManipulationReport) -> None:
    ended = replace(turned, complete=False)
    first, second = episodes_of(replace(turned, earlier=ended))
    assert len(first) == len(second) == len(turned.recording)
    assert first.success == turned.success
    assert not second.success and second.reason  # the whole turn was not made in one go


# --- LeRobot, by its schema --------------------------------------------------------------------


def test_a_row_has_what_is_seen_and_the_action_that_leads_on(
    held: TrialReport, tmp_path: Path
) -> None:
    write_lerobot([held], tmp_path / "set")
    found, states = data_of(tmp_path / "set"), episodes_of(held)[0].recording
    m = len(states) - 1
    for key, wanted in (
        ("observation.state", states.q[:m]),
        ("observation.base_pose", states.T_world_base[:m]),
        ("observation.object_pose", states.T_world_object[:m]),
        ("observation.contact_force", np.nan_to_num(states.forces[:m]).reshape(m, -1)),
        ("observation.touch", np.isfinite(states.points[:m, :, 0])),
        ("action", states.commands[1:]),
    ):
        np.testing.assert_array_equal(found[key], wanted.astype(np.float32), err_msg=key)
    np.testing.assert_array_equal(found["timestamp"], (np.arange(m) / 50).astype(np.float32))
    assert (
        found["next.done"].tolist() == found["next.success"].tolist() == [False] * (m - 1) + [True]
    )


def test_the_files_follow_the_schema(
    held: TrialReport, failed: TrialReport, turned: ManipulationReport, tmp_path: Path
) -> None:
    """Types, shapes and places as LeRobot 0.6.1 has them (``sim.datasets.episodes.lerobot``)."""
    folder = tmp_path / "set"
    write_lerobot([held, failed, turned], folder, failed=True)
    info, rows, found = info_of(folder), rows_of(folder), data_of(folder)
    assert (info["codebase_version"], info["fps"], info["robot_type"]) == (
        "v3.0",
        50,
        "allegro_hand",
    )
    table = pa.parquet.read_table(folder / "data" / "chunk-000" / "file-000.parquet")
    assert table.column_names == list(info["features"])
    for key, feature in info["features"].items():
        kind, (width,) = pa.type_for_alias(feature["dtype"]), feature["shape"]
        wanted = kind if width == 1 else pa.list_(kind, width)
        assert table.schema.field(key).type == wanted, key
        assert feature["names"] is None or len(feature["names"]) == width, key
    lengths = [row["length"] for row in rows]
    assert (info["total_episodes"], info["total_frames"]) == (3, sum(lengths)) == (3, len(table))
    assert found["index"].tolist() == list(range(len(table)))
    for k, row in enumerate(rows):
        part = slice(row["dataset_from_index"], row["dataset_to_index"])
        assert set(found["episode_index"][part]) == {k}
        assert found["frame_index"][part].tolist() == list(range(row["length"]))
        path = info["data_path"].format(
            chunk_index=row["data/chunk_index"], file_index=row["data/file_index"]
        )
        assert (folder / path).is_file()
        assert found["next.done"][part].tolist() == [False] * (row["length"] - 1) + [True]
    assert [row["success"] for row in rows] == [True, False, turned.success]
    ends = [row["dataset_to_index"] - 1 for row in rows]
    assert found["next.success"][ends].tolist() == [row["success"] for row in rows]
    assert found["next.success"].sum() == sum(row["success"] for row in rows)


def test_tasks_are_sentences_by_number(
    held: TrialReport, turned: ManipulationReport, tmp_path: Path
) -> None:
    folder = tmp_path / "set"
    write_lerobot([held, turned, held], folder, failed=True)
    table = pa.parquet.read_table(folder / "meta" / "tasks.parquet")
    sentences = table["task"].to_pylist()
    assert table["task_index"].to_pylist() == [0, 1] and len(sentences) == 2
    assert json.loads(table.schema.metadata[b"pandas"])["index_columns"] == ["task"]
    rows, found = rows_of(folder), data_of(folder)
    for row in rows:
        (number,) = set(found["task_index"][row["dataset_from_index"] : row["dataset_to_index"]])
        assert row["tasks"] == [sentences[number]]
    pandas = pytest.importorskip("pandas")
    frame = pandas.read_parquet(folder / "meta" / "tasks.parquet")
    assert frame.iloc[1].name == sentences[1] and frame.loc[sentences[1]].task_index == 1


def test_statistics_are_those_of_the_columns(
    held: TrialReport, turned: ManipulationReport, tmp_path: Path
) -> None:
    folder = tmp_path / "set"
    write_lerobot([held, turned], folder, failed=True)
    stats, found, rows = json.loads((folder / "meta/stats.json").read_text()), data_of(folder), []
    for key, column in found.items():
        whole = column.reshape(len(column), -1).astype(np.float64)
        told = {name: np.array(values) for name, values in stats[key].items()}
        assert told["count"].tolist() == [len(whole)]
        for name, wanted in (
            ("min", whole.min(axis=0)),
            ("max", whole.max(axis=0)),
            ("mean", whole.mean(axis=0)),
            ("std", whole.std(axis=0)),
        ):
            np.testing.assert_allclose(told[name], wanted, rtol=1e-9, atol=1e-9, err_msg=key)
        assert (told["q01"] <= told["q50"]).all() and (told["q50"] <= told["q99"]).all()
    rows = rows_of(folder)
    part = found["action"][: rows[0]["length"]].astype(np.float64)
    below = (part <= np.array(rows[0]["stats/action/q10"])).mean(axis=0)
    assert (below >= 0.10).all() and set(rows[0]) >= {"stats/action/q99", "stats/index/mean"}


def test_data_files_are_begun_anew_where_one_is_full(
    held: TrialReport, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sim.datasets.episodes.lerobot.DATA_MB", 1e-6)
    write_lerobot([held] * 3, tmp_path / "set")
    files = sorted(p.name for p in (tmp_path / "set/data/chunk-000").iterdir())
    assert files == [f"file-{k:03d}.parquet" for k in range(3)]
    assert [row["data/file_index"] for row in rows_of(tmp_path / "set")] == [0, 1, 2]


# --- films -------------------------------------------------------------------------------------


def decoded(path: Path, size: tuple[int, int]) -> Any:
    """Frames of a film, (frames, height, width, 3)."""
    imageio_ffmpeg = pytest.importorskip("imageio_ffmpeg")
    words = ["-loglevel", "error", "-i", str(path), "-f", "rawvideo", "-pix_fmt", "rgb24", "-"]
    done = subprocess.run(
        [imageio_ffmpeg.get_ffmpeg_exe(), *words], capture_output=True, check=True
    )
    return np.frombuffer(done.stdout, dtype=np.uint8).reshape(-1, size[1], size[0], 3)


@pytest.mark.slow
def test_a_film_shows_the_state_of_every_row(
    held: TrialReport, can_draw: bool, tmp_path: Path
) -> None:
    pytest.importorskip("imageio_ffmpeg")
    if not can_draw:
        pytest.skip("this machine draws nothing")
    folder = tmp_path / "set"
    write_lerobot([held, held], folder, fps=10, video=True, size=(96, 64))
    info, rows = info_of(folder), rows_of(folder)
    assert info["features"][VIDEO_KEY]["shape"] == [64, 96, 3]
    films = [
        decoded(
            folder
            / info["video_path"].format(
                video_key=VIDEO_KEY,
                chunk_index=row[f"videos/{VIDEO_KEY}/chunk_index"],
                file_index=row[f"videos/{VIDEO_KEY}/file_index"],
            ),
            (96, 64),
        )
        for row in rows
    ]
    assert [len(film) for film in films] == [row["length"] for row in rows]
    (episode,) = episodes_of(held)
    framed = episode.taken(frames_at(episode.recording.time, 10, "")[1][:-1])
    _, drawn = draw_episode(framed, tmp_path / "again.mp4", fps=10, size=(96, 64))
    assert sampled_frames(len(framed)) == list(range(len(framed)))  # so all were kept
    off = np.array([[np.abs(1.0 * a - b).mean() for b in films[0]] for a in drawn])
    moving = np.flatnonzero(np.diag(off, 1) > 1.5 * np.diag(off)[:-1])
    assert len(moving) >= 8  # the approach and the lift, 1.3 s; else little moves
    assert (off[moving].argmin(axis=1) == moving).all()
    stats = json.loads((folder / "meta/stats.json").read_text())[VIDEO_KEY]
    mean = np.array(films[0]).mean(axis=(0, 1, 2)) / 255
    np.testing.assert_allclose(np.ravel(stats["mean"]), mean, atol=0.01)
    assert np.shape(stats["std"]) == (3, 1, 1)


def test_a_film_that_ends_early_is_noticed(
    held: TrialReport, can_draw: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("imageio_ffmpeg")
    if not can_draw:
        pytest.skip("this machine draws nothing")

    def short(path: Path, frames: Iterator[Any], given: Any) -> None:
        whole = list(frames)
        write_film(path, whole[:-1], given)

    monkeypatch.setattr("sim.datasets.episodes.writing.write_film", short)
    with pytest.raises(FileFormatError, match=r"only \d+ of \d+ frames"):
        write_lerobot([held], tmp_path / "set", fps=5, video=True, size=(32, 32))
    assert not list(tmp_path.iterdir())


# --- frame rates -------------------------------------------------------------------------------


def grid(rate: float, n: int = 101) -> Any:
    """Times as report files have them, to 1e-6 s."""
    return np.round(np.arange(1, n + 1) / rate, 6)


@pytest.mark.parametrize(
    ("rate", "fitting"),
    [
        (50, (50, 25, 10, 5, 2, 1)),
        (60, (60, 30, 20, 15, 12, 10, 6, 5, 4, 3, 2, 1)),
        (100, (100, 50, 25, 20, 10, 5, 4, 2, 1)),
    ],
)
def test_rates_that_divide_fit(rate: int, fitting: tuple[int, ...]) -> None:
    assert rates_of(grid(rate)) == fitting
    for fps in fitting:
        found, samples = frames_at(grid(rate), fps, "it")
        assert found == fps
        np.testing.assert_allclose(np.diff(grid(rate)[samples]), 1 / fps, atol=3e-6)
    assert frames_at(grid(rate), None, "it")[0] == rate


def test_frames_that_are_no_samples_are_refused() -> None:
    with pytest.raises(TaskError, match=r"30 frames a second .* rates that fit: 50, 25, 10"):
        frames_at(grid(50), 30, "it")
    with pytest.raises(TaskError, match=r"no whole number of frames .* rates that fit: none"):
        frames_at(grid(1 / 0.021), None, "it")
    with pytest.raises(TaskError, match=r"there is no sample at 0\.2000 s"):
        frames_at(np.delete(grid(50), 9), None, "it")
    with pytest.raises(TaskError, match="needs two samples or more, and has 1"):
        frames_at(grid(50, 1), None, "it")
    with pytest.raises(TaskError, match="at 1 frames a second it has one frame"):
        frames_at(grid(50, 20), 1, "it")


def test_a_last_sample_off_the_grid_is_no_frame() -> None:
    """A trial that cannot go on takes a sample where it ends."""
    time = np.append(grid(50), 2.027)
    assert frames_at(time, None, "it")[1].tolist() == list(range(101))


# --- what gets in, and what does not -----------------------------------------------------------


def test_failed_trials_are_left_out_unless_asked_for(
    held: TrialReport, failed: TrialReport, tmp_path: Path
) -> None:
    told: list[tuple[bool, str]] = []
    written = write_episodes(
        [held, failed],
        tmp_path / "good",
        "lerobot",
        told=lambda episode, why: told.append((episode.success, why)),
    )
    assert (written.episodes, written.left_out) == (1, {f"the trial failed: {failed.reason}": 1})
    assert told == [(True, ""), (False, f"the trial failed: {failed.reason}")]
    assert "1 failed trials left out" in str(written)
    with pytest.raises(TaskError, match=f"no episode to write.*{failed.reason}"):
        write_lerobot([failed], tmp_path / "none")
    assert not (tmp_path / "none").exists()


def test_half_a_trial_is_never_an_episode(held: TrialReport, tmp_path: Path) -> None:
    cut = ReportFile.model_validate(held.to_dict())
    cut = cut.model_copy(update={"success": False, "reason": "interrupted"})
    written = write_lerobot([held, cut], tmp_path / "set", failed=True)
    assert written.episodes == 1 and written.complete
    assert written.left_out == {"the trial failed: interrupted": 1}


@pytest.mark.parametrize("spoiled", [bad_pose, empty])
def test_bad_numbers_never_get_in(
    spoiled: Any, held: TrialReport, failed: TrialReport, tmp_path: Path
) -> None:
    with pytest.raises(FileFormatError, match=r"report 1 is damaged: .* though it says success"):
        write_lerobot([held, spoiled(held)], tmp_path / "set")
    assert not list(tmp_path.iterdir())
    written = write_lerobot([held, spoiled(failed)], tmp_path / "set", failed=True)
    assert written.episodes == 1 and sum(written.left_out.values()) == 1


def test_the_place_of_a_bad_number_is_told(held: TrialReport) -> None:
    (good,), (bad,) = episodes_of(held), episodes_of(bad_pose(held))
    assert good.fault == ""
    assert bad.fault == "the object's pose is not finite in sample 7"
    late = held.recording.time.copy()
    late[5] = late[4]
    (stuck,) = episodes_of(with_states(held, time=late))
    assert stuck.fault == "time does not increase after sample 4"


def test_a_report_without_states_or_plan_is_refused(held: TrialReport, tmp_path: Path) -> None:
    bare = ReportFile.model_validate(held.to_dict(states=False))
    with pytest.raises(FileFormatError, match=r"report\.json has no recorded states"):
        write_lerobot([("report.json", bare)], tmp_path / "set")
    nameless = ReportFile.model_validate({**held.to_dict(), "plan": None})
    with pytest.raises(FileFormatError, match="holds no plan, so that its hand is unknown"):
        write_lerobot([nameless], tmp_path / "set")
    assert not list(tmp_path.iterdir())


def test_two_hands_in_one_data_set_are_refused(
    held: TrialReport, allegro: Hand, tmp_path: Path
) -> None:
    ours = Robot.of(allegro)
    other = replace(ours, joint_names=("thumb_9", *ours.joint_names[1:]))
    ours.refuse_unless_same(ours, "it")
    with pytest.raises(TaskError, match=r"its joint names are 'thumb_9' at place 0, and 'index_0'"):
        ours.refuse_unless_same(other, "it")
    (episode,) = episodes_of(held)
    writer = format_named("lerobot").writer(tmp_path, Asked())
    assert writer.add(episode) == len(episode) - 1
    writer.finish()


def test_folders_in_the_way_are_refused(held: TrialReport, tmp_path: Path) -> None:
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "mine.txt").write_text("keep")
    with pytest.raises(FileFormatError, match="exists and is not empty"):
        write_lerobot([held], tmp_path / "full")
    assert (tmp_path / "full" / "mine.txt").read_text() == "keep"
    with pytest.raises(FileFormatError, match="exists and is not empty"):
        write_lerobot([held], tmp_path / "full" / "mine.txt")
    (tmp_path / "empty").mkdir()
    write_lerobot([held], tmp_path / "empty")
    assert info_of(tmp_path / "empty")["total_episodes"] == 1
    for name in ("a\0b", "n" * 300):
        with pytest.raises(FileFormatError, match="cannot write"):
            write_lerobot([held], tmp_path / name)


@pytest.mark.parametrize("which", ["write_table", "close"])
def test_a_full_disk_leaves_nothing(
    held: TrialReport, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, which: str
) -> None:
    calls = []
    true = getattr(pa.parquet.ParquetWriter, which)

    def full(self: Any, *given: Any, **named: Any) -> Any:
        calls.append(which)
        if len(calls) == (2 if which == "write_table" else 1):
            raise OSError(errno.ENOSPC, "No space left on device")
        return true(self, *given, **named)

    monkeypatch.setattr(pa.parquet.ParquetWriter, which, full)
    with pytest.raises(FileFormatError, match=r"cannot write .*set: No space left on device"):
        write_lerobot([held, held], tmp_path / "set")
    assert not list(tmp_path.iterdir())


def test_ctrl_c_keeps_whole_episodes(held: TrialReport, tmp_path: Path) -> None:
    def reports(count: int) -> Iterator[TrialReport]:
        for _ in range(count):
            yield held
        raise KeyboardInterrupt

    written = write_lerobot(reports(2), tmp_path / "set")
    assert (written.episodes, written.complete) == (2, False)
    assert len(rows_of(tmp_path / "set")) == info_of(tmp_path / "set")["total_episodes"] == 2
    with pytest.raises(KeyboardInterrupt):
        write_lerobot(reports(0), tmp_path / "none")
    ended = replace(held, verdict=replace(held.verdict, fault=interrupted(held)))
    assert write_lerobot([held, ended, held], tmp_path / "cut").episodes == 1
    assert {p.name for p in tmp_path.iterdir()} == {"set", "cut"}


def interrupted(report: TrialReport) -> Any:
    from sim.verdict import Fault

    return Fault(reason="interrupted", detail="Ctrl-C")


def test_an_error_while_trials_run_leaves_nothing(held: TrialReport, tmp_path: Path) -> None:
    def reports() -> Iterator[TrialReport]:
        yield held
        raise PlannerError("the second plan is bad")

    with pytest.raises(PlannerError, match="the second plan is bad"):
        write_lerobot(reports(), tmp_path / "set")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("given", "error", "words"),
    [
        ({"to": "hdf5"}, NotFoundError, "hdf5"),
        ({"to": "lerobot", "fps": 0}, TaskError, "fps is 0"),
        ({"to": "lerobot", "video": True, "size": (100, 64)}, TaskError, "multiples of 16"),
        ({"to": "lerobot", "fps": 30}, TaskError, "rates that fit: 50, 25"),
    ],
)
def test_what_cannot_be_is_said_and_leaves_nothing(
    held: TrialReport, tmp_path: Path, given: dict[str, Any], error: type, words: str
) -> None:
    pytest.importorskip("imageio_ffmpeg")
    with pytest.raises(error, match=words):
        write_episodes([held], tmp_path / "set", **given)
    assert not list(tmp_path.iterdir())


def test_an_episode_without_its_task_cannot_be_filmed(held: TrialReport, tmp_path: Path) -> None:
    (episode,) = episodes_of(held)
    with pytest.raises(TaskError, match="cannot be filmed"):
        draw_episode(replace(episode, task=None), tmp_path / "film.mp4", fps=50, size=(32, 32))


def test_a_format_without_films_refuses_them(
    held: TrialReport, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plain = replace(format_named("lerobot"), name="plain", films=False)
    monkeypatch.setitem(FORMATS, "plain", plain)
    with pytest.raises(TaskError, match="plain holds no films"):
        write_episodes([held], tmp_path / "set", "plain", video=True)


def test_a_manipulation_that_ctrl_c_ended_ends_the_writing(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    at = "sim.datasets.episodes.sources"
    monkeypatch.setattr(f"{at}.manipulation_from_dict", lambda *_: None)
    trials = sources.Trials(physics=PhysicsOptions())
    for ended in (False, True):
        report: Any = SimpleNamespace(interrupted=ended)
        monkeypatch.setattr(f"{at}.manipulate", lambda *_, told=report, **__: told)
        if ended:
            with pytest.raises(KeyboardInterrupt):
                trials.turn({}, "a file")
        else:
            assert trials.turn({}, "a file") is report
