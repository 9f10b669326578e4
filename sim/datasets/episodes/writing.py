"""``write_episodes``: reports into a data set, episode by episode, whole or not at all.

A film of an episode has one frame per sample, from one camera that stands still. Unlike the films
of ``--video``, which follow the hand at 25 frames a second, frame k shows the state of row k, and
the camera has one pose per episode, as on a real robot.
"""

from __future__ import annotations

import os
import re
import secrets
import shutil
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from planner.errors import FileFormatError, TaskError
from planner.spatial import FloatArray
from planner.system.threads import interrupts_wait
from sim.datasets.episodes.episode import (
    AnyReport,
    Asked,
    Episode,
    EpisodeWriter,
    Robot,
    episodes_of,
    format_named,
)
from sim.report import TrialReport
from sim.scene.build import Scene, build_scene
from sim.show.camera import FIELD_OF_VIEW_DEG, View, choose_views
from sim.show.painter import Painter, Pixels, Quality, open_painter
from sim.show.picture import FilmFormat, write_film


@contextmanager
def whole_folder(folder: Path) -> Iterator[Path]:
    """A new folder whose content becomes ``folder``, if the block ends without an error.

    Until then it stands beside it under a random name that begins with a dot; an error, such as a
    full disk, removes it.

    Raises:
        FileFormatError: The folder exists and holds something, or cannot be written.
    """
    refuse_full(folder)
    partial = folder.with_name(f".{secrets.token_hex(8)}.part")
    try:
        partial.parent.mkdir(parents=True, exist_ok=True)
        partial.mkdir()
        yield partial
        os.rename(partial, folder)  # onto nothing, or an empty folder
    except OSError as error:
        raise FileFormatError(f"cannot write {folder}: {error.strerror or error}") from error
    except ValueError as error:
        if "null" not in str(error):
            raise
        raise FileFormatError(f"cannot write {str(folder)!r}: {error}") from error
    finally:
        shutil.rmtree(partial, ignore_errors=True)


def refuse_full(folder: Path) -> None:
    """Check that a folder can begin here.

    Raises:
        FileFormatError: It is a file, or holds something.
    """
    try:
        taken = folder.exists() and (not folder.is_dir() or any(folder.iterdir()))
    except (OSError, ValueError) as error:  # too long a name, a barred way, a null character
        reason = getattr(error, "strerror", None) or error
        raise FileFormatError(f"cannot write {folder}: {reason}; give another name") from error
    if taken:
        raise FileFormatError(
            f"{folder} exists and is not empty; a data set is written whole, so name a new folder"
        )


FAILED = "the trial failed: "
"""How the reason of an episode begins that is left out because its trial failed."""


@dataclass(frozen=True, kw_only=True)
class Written:
    """What a data set holds, and what was left out of it.

    Attributes:
        folder: The data set.
        format: Name of the format.
        episodes: Number of episodes.
        succeeded: How many of them are of successful trials.
        frames: Number of rows.
        left_out: Reason -> number of episodes that are not in it.
        complete: Whether every report was taken; False after Ctrl-C.
    """

    folder: Path
    format: str
    episodes: int
    succeeded: int
    frames: int
    left_out: Mapping[str, int]
    complete: bool

    def __str__(self) -> str:
        """One line."""
        left = sum(self.left_out.values())
        told = f"; {left} failed trials left out (--failed keeps them)" if left else ""
        failed = self.episodes - self.succeeded
        good = "all successful" if not failed else f"{self.succeeded} successful, {failed} failed"
        return (
            f"written to {self.folder}: episodes: {self.episodes} ({good}), rows: {self.frames}, "
            f"format {self.format}{told}"
        )

    def to_dict(self) -> dict[str, Any]:
        """Plain data."""
        return {**asdict(self), "folder": str(self.folder), "left_out": dict(self.left_out)}


def write_episodes(
    reports: Iterable[AnyReport | tuple[str, AnyReport]],
    folder: Path | str,
    to: str,
    *,
    fps: int | None = None,
    video: bool = False,
    size: tuple[int, int] = (320, 240),
    failed: bool = False,
    told: Callable[[Episode, str], None] = lambda episode, why: None,
) -> Written:
    """Write a data set of episodes.

    Reports are taken one at a time, so an iterator that runs trials is fine. Ctrl-C ends it with
    the episodes that are whole; any error leaves nothing behind.

    Args:
        reports: Of trials and manipulations, of one hand; or pairs of a name for messages and a
            report.
        folder: The data set; must not exist, or be empty.
        to: Name of a format, "lerobot" or one that was registered.
        fps: Frames per second; None for that of the recordings. Frames are samples, so it must
            divide their rate.
        video: Film every episode, for formats that can hold films.
        size: Width and height of the films, pixels, multiples of 16.
        failed: Also write trials that failed, marked so.
        told: Called for every episode, with why it was left out, "" if it was not.

    Returns:
        What was written.

    Raises:
        TaskError: Different hands, a frame rate that does not fit, a film where there can be none,
            or no episode at all.
        NotFoundError: No format has that name.
        FileFormatError: The folder exists or cannot be written, or a report is damaged.
    """
    chosen = format_named(to)
    if video and not chosen.films:
        raise TaskError(f"the format {to} holds no films; leave the video out, or choose another")
    asked = Asked(fps=fps, video=video, size=size)
    with whole_folder(Path(folder)) as partial:
        writing = _Writing(chosen.writer(partial, asked), failed=failed, told=told)
        complete = False
        try:
            try:
                writing.take_all(reports)
                complete = True
            except KeyboardInterrupt:
                if not writing.episodes:
                    raise
            writing.finish()
        except BaseException:
            writing.writer.abandon()
            raise
    return Written(
        folder=Path(folder),
        format=to,
        episodes=writing.episodes,
        succeeded=writing.succeeded,
        frames=writing.frames,
        left_out=dict(writing.left_out),
        complete=complete,
    )


class _Writing:
    """What was written so far."""

    def __init__(
        self, writer: EpisodeWriter, *, failed: bool, told: Callable[[Episode, str], None]
    ) -> None:
        self.writer = writer
        self.episodes = self.succeeded = self.frames = 0
        self.left_out: Counter[str] = Counter()
        self._failed, self._told = failed, told
        self._robot: Robot | None = None

    def take_all(self, reports: Iterable[AnyReport | tuple[str, AnyReport]]) -> None:
        for number, given in enumerate(reports):
            name, report = given if isinstance(given, tuple) else (f"report {number}", given)
            for episode in episodes_of(report, name):
                if episode.interrupted and isinstance(report, TrialReport):
                    raise KeyboardInterrupt  # which the trial turned into a report
                self._take(episode)

    def _take(self, episode: Episode) -> None:
        kept = episode.success or (self._failed and not episode.interrupted)
        why = "" if kept else FAILED + episode.reason
        if not why and episode.fault:
            if episode.success:
                raise FileFormatError(
                    f"{episode.source} is damaged: {episode.fault}, though it says success; "
                    "leave it out"
                )
            why = f"{FAILED}{episode.reason}, and {episode.fault}"
        if not why:
            self._robot = self._robot or episode.robot
            self._robot.refuse_unless_same(episode.robot, episode.source)
            with interrupts_wait():  # a whole episode, with its film, or none
                self.frames += self.writer.add(episode)
                self.episodes += 1
                self.succeeded += episode.success
        else:
            self.left_out[why] += 1
        self._told(episode, why)

    def finish(self) -> None:
        if not self.episodes:
            reasons = "; ".join(f"{n} because {why}" for why, n in self.left_out.items())
            raise TaskError(
                "there is no episode to write"
                + (f": left out were {reasons}; failed trials can be asked for" if reasons else "")
            )
        self.writer.finish()


def write_lerobot(
    reports: Iterable[AnyReport | tuple[str, AnyReport]],
    folder: Path | str,
    *,
    fps: int | None = None,
    video: bool = False,
    size: tuple[int, int] = (320, 240),
    failed: bool = False,
) -> Written:
    """Write a LeRobot data set, version 3.0; see ``write_episodes``."""
    return write_episodes(
        reports, folder, "lerobot", fps=fps, video=video, size=size, failed=failed
    )


ENCODING = ("-crf", "23", "-preset", "veryfast", "-g", "2", "-bf", "0", "-movflags", "+faststart")
"""Options of ffmpeg: every second frame stands by itself, so that one is decoded without those
before it, which is how training reads them."""

BLOCK = 16
"""Width and height of a film are multiples of this (pixels): H.264 has blocks of so many."""

MOST_PIXELS = 4096
"""Largest width or height."""

LARGER, SHADOWS = 1.5, 1024
"""How frames are drawn: see ``painter.Quality``. A frame of 320 x 240 takes 15 ms of CPU without a
GPU, 25 ms with 2.0 and 2048 (load 8 on 2 cores)."""

HALF_VIEW = float(np.deg2rad(FIELD_OF_VIEW_DEG / 2))
"""Half of the vertical field of view, rad."""

LOOKS = 9
"""Moments of an episode by which its camera is placed."""


def check_films(size: tuple[int, int]) -> None:
    """Refuse films that cannot be made, before the work and not after it.

    Args:
        size: Width and height, pixels.

    Raises:
        TaskError: A size that H.264 has not, or no package that writes MP4.
    """
    if any(n % BLOCK or not 0 < n <= MOST_PIXELS for n in size):
        raise TaskError(
            f"a film cannot be {size[0]} x {size[1]} pixels; give multiples of {BLOCK} up to "
            f"{MOST_PIXELS}, such as 320x240"
        )
    if find_spec("imageio_ffmpeg") is None:
        raise TaskError(
            "films are MP4 files, which need a package that is not installed: "
            'pip install "opposable[video]"'
        )


def size_of(text: str) -> tuple[int, int]:
    """Width and height (pixels) out of a text like "320x240".

    Raises:
        TaskError: It is another.
    """
    found = re.fullmatch(r"(\d{1,5})x(\d{1,5})", text)
    if found is None:
        raise TaskError(f"{text!r} is no size of a film; give WIDTHxHEIGHT, such as 320x240")
    return int(found[1]), int(found[2])


def draw_episode(
    episode: Episode, path: Path, *, fps: int, size: tuple[int, int]
) -> tuple[View, list[Pixels]]:
    """Write the film of an episode; every sample is a frame.

    Args:
        episode: With the task that is drawn.
        path: The MP4 file.
        fps: Frames per second.
        size: Width and height, pixels.

    Returns:
        Where the camera stands, and the frames of which statistics are made.

    Raises:
        TaskError: Nothing can be drawn here, or the episode keeps no task.
        OSError: The file cannot be written.
    """
    if episode.task is None:
        raise TaskError(f"{episode.source} keeps no hand and object, so that it cannot be filmed")
    states = episode.recording
    scene = build_scene(episode.task, T_world_base=states.poses(0)[0], q=states.q[0])
    poses = [scene.posed(states.q[i], *states.poses(i)) for i in range(len(episode))]
    quality = Quality(size=size, larger=LARGER, shadows=SHADOWS, slices=20)
    painter = open_painter(scene.model, quality)
    if isinstance(painter, str):
        raise TaskError(f"{episode.source} cannot be filmed: {painter}; leave the video out")
    view = _standing_view(scene, poses, size[0] / size[1])
    sampled = set(sampled_frames(len(poses)))
    kept: list[Pixels] = []

    def frames() -> Iterator[Pixels]:
        for i, pixels in enumerate(_drawn(painter, poses, view)):
            if i in sampled:
                kept.append(pixels)
            yield pixels

    film = FilmFormat(quality=quality, rate=float(fps), most=len(poses), encoding=ENCODING)
    with painter:
        write_film(path, frames(), film)
    _check_length(path, len(poses))
    return view, kept


def _check_length(path: Path, frames: int) -> None:
    """Check that a film has all its frames: ffmpeg may end early without a word, on a full disk.

    Raises:
        OSError: It has others.
    """
    import imageio_ffmpeg

    try:
        found, _ = imageio_ffmpeg.count_frames_and_secs(str(path))
    except RuntimeError as error:  # no film at all
        raise OSError(f"the film of {frames} frames could not be written") from error
    if found != frames:
        raise OSError(f"only {found} of {frames} frames of the film could be written")


def sampled_frames(count: int) -> list[int]:
    """Numbers of the frames of which statistics are made: as many as LeRobot takes."""
    wanted = max(min(100, count), min(int(count**0.75), 10_000))
    return [round(i) for i in np.linspace(0, count - 1, wanted).tolist()]


def _standing_view(scene: Scene, poses: Sequence[FloatArray], aspect: float) -> View:
    """One view that has object and fingers in the picture at all moments that were looked at."""
    moments = np.unique(np.linspace(0, len(poses) - 1, LOOKS).round().astype(int))
    chosen = [poses[i] for i in moments]
    views = choose_views(scene.model, chosen, scene.subject, aspect, follow=None)
    points = np.array([view.lookat for view in views])
    middle = (points.max(axis=0) + points.min(axis=0)) / 2
    right, up, forwards = ((points - middle) @ views[0].axes).T
    aside = np.maximum(np.abs(right) / aspect, np.abs(up)) / np.tan(HALF_VIEW)
    reach = np.array([view.distance for view in views]) + aside - forwards
    return replace(views[0], lookat=middle, distance=float(reach.max()))


def _drawn(painter: Painter, poses: Sequence[FloatArray], view: View) -> Iterator[Pixels]:
    painter.light(view)
    for qpos in poses:
        yield painter.draw(qpos, view)
