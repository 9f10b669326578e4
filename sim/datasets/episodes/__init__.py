"""Executed trials as data sets of episodes: LeRobot data sets, version 3.0."""

from sim.datasets.episodes.episode import (
    FORMATS,
    AnyReport,
    Asked,
    Episode,
    EpisodeFormat,
    EpisodeWriter,
    Robot,
    episodes_of,
    format_named,
    register_format,
)
from sim.datasets.episodes.writing import Written, write_episodes, write_lerobot

__all__ = [
    "FORMATS",
    "AnyReport",
    "Asked",
    "Episode",
    "EpisodeFormat",
    "EpisodeWriter",
    "Robot",
    "Written",
    "episodes_of",
    "format_named",
    "register_format",
    "write_episodes",
    "write_lerobot",
]
