"""Films of episodes for policies: one frame per sample, from one camera that stands still.

Unlike the films of ``--video``, which follow the hand at 25 frames a second, frame k shows the
state of row k, and the camera has one pose per episode, as on a real robot.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from planner.errors import TaskError
from planner.spatial import FloatArray
from sim.datasets.episodes.episode import Episode
from sim.scene.build import Scene, build_scene
from sim.show.camera import FIELD_OF_VIEW_DEG, View, choose_views
from sim.show.painter import Painter, Pixels, Quality, open_painter
from sim.show.picture import FilmFormat, write_film

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
