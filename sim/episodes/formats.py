"""All formats of episodes by name; a format is one module, and one registration.

A format has a writer, which takes episodes one by one into a folder of its own. ``opposable
dataset episodes --to NAME`` writes whatever is registered here.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Protocol

from planner.arrays import check_fields, checked_count
from planner.errors import NotFoundError, TaskError
from sim.episodes.episode import Episode

MOST_FPS = 10_000
"""Most frames per second: recordings have one per time step at most, 0.1 ms."""

MOST_PIXELS = 8192
"""Longest side of a film, pixels."""


@dataclass(frozen=True, kw_only=True)
class Asked:
    """What a data set is asked to be.

    Attributes:
        fps: Frames per second; None for what the recordings have.
        video: Whether it is to have a film of every episode.
        size: Width and height of the film, pixels.
    """

    fps: int | None = None
    video: bool = False
    size: tuple[int, int] = (320, 240)

    def __post_init__(self) -> None:
        """Check every number."""
        check_fields(self, ("fps",), least=1, most=MOST_FPS)
        pair = isinstance(self.size, tuple | list) and len(self.size) == 2
        width, height = self.size if pair else "??"
        for name, pixels in (("width", width), ("height", height)):
            checked_count(f"the film's {name}", pixels, least=1, most=MOST_PIXELS, error=TaskError)


class EpisodeWriter(Protocol):
    """Writes one data set; made for a new folder."""

    def add(self, episode: Episode) -> int:
        """Add an episode whole, or leave the data set as it was; the number of its frames.

        Raises:
            TaskError: Its sample times do not fit the frame rate.
            OSError: The folder cannot be written; then the data set is lost.
        """
        ...

    def finish(self) -> None:
        """Write what is known only now, and close all files; called once, after an episode."""
        ...

    def abandon(self) -> None:
        """Close all files; called instead of ``finish`` where something failed."""
        ...


@dataclass(frozen=True, kw_only=True)
class EpisodeFormat:
    """A format of data sets of episodes.

    Attributes:
        name: Lower case, as ``--to`` takes it.
        title: What it is, in a few words, with its version.
        loses: What of a recording it does not hold, a sentence; "" for nothing.
        films: Whether it can hold videos.
        writer: Makes the writer of a folder that exists and is empty.
    """

    name: str
    title: str
    loses: str
    films: bool
    writer: Callable[[Path, Asked], EpisodeWriter]


FORMATS: dict[str, EpisodeFormat] = {}
"""All formats by name; those of others once their authors registered them."""


def register_format(episode_format: EpisodeFormat) -> EpisodeFormat:
    """Register a format under its name.

    Raises:
        TaskError: The name is taken.
    """
    if episode_format.name in FORMATS:
        raise TaskError(f"the format {episode_format.name!r} exists; give yours another name")
    FORMATS[episode_format.name] = episode_format
    return episode_format


def format_named(name: str) -> EpisodeFormat:
    """The format of a name.

    Raises:
        NotFoundError: There is none.
    """
    import_module("sim.episodes.lerobot")  # which registers itself
    if name not in FORMATS:
        raise NotFoundError("format of episodes", name, FORMATS)
    return FORMATS[name]
