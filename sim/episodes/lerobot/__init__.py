"""LeRobot data sets, version 3.0: Parquet, JSON and films that ``LeRobotDataset`` reads.

The layout follows huggingface/lerobot at tag v0.6.1, which reads version 3.0
(``src/lerobot/datasets``: ``dataset_metadata.py``, ``dataset_writer.py``, ``utils.py``,
``feature_utils.py``, ``compute_stats.py``; looked up at commit
7427f31801f944f5ec9ce53cda02862ce7d1638b).
"""

from sim.episodes.formats import EpisodeFormat, register_format
from sim.episodes.lerobot.features import VIDEO_KEY, features_of, frames_of
from sim.episodes.lerobot.writer import CODEBASE_VERSION, LeRobotWriter

__all__ = ["CODEBASE_VERSION", "VIDEO_KEY", "LeRobotWriter", "features_of", "frames_of"]

register_format(
    EpisodeFormat(
        name="lerobot",
        title="LeRobot data set, version 3.0",
        loses="Numbers are 32 bits wide; places, normals and friction of contacts, phases, and "
        "samples between frames are left out.",
        films=True,
        writer=LeRobotWriter,
    )
)
