"""``write_episodes``: reports into a data set, episode by episode, whole or not at all.

A folder that appears whole or not at all.
"""

from __future__ import annotations

import os
import secrets
import shutil
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from planner.errors import FileFormatError, TaskError
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
