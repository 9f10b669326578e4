"""Executed trials as data sets of episodes: a LeRobot data set, or plain Parquet."""

from sim.episodes.episode import AnyReport, Episode, Robot, episodes_of
from sim.episodes.formats import (
    FORMATS,
    Asked,
    EpisodeFormat,
    EpisodeWriter,
    format_named,
    register_format,
)
from sim.episodes.parquet import read_episodes
from sim.episodes.writing import Written, write_episodes, write_lerobot, write_parquet

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
    "read_episodes",
    "register_format",
    "write_episodes",
    "write_lerobot",
    "write_parquet",
]
