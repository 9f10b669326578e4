"""Executed trials as data sets of episodes: LeRobot data sets, version 3.0."""

from sim.episodes.episode import (
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
from sim.episodes.writing import Written, write_episodes, write_lerobot

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
