"""LeRobot itself reads our data sets of episodes; ``bench episodes``."""

from benchmarks.episodes.check import agrees, episodes_table, run_episodes

__all__ = ["agrees", "episodes_table", "run_episodes"]
