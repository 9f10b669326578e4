"""Reads a LeRobot data set in LeRobot's own environment: a script of that environment's Python.

    python lerobot_reader.py FOLDER OUT.npz FRAME...

Keeps columns, some decoded frames, and statistics.

Prints the versions there as JSON. This file imports nothing of this project.
"""

from __future__ import annotations

import json
import os
import sys
from importlib import import_module
from importlib.metadata import version
from typing import Any

PACKAGES = ("lerobot", "torch", "datasets", "pyarrow", "av", "torchcodec")


def read(folder: str, out: str, frames: list[int]) -> None:
    """Read a data set whole, and decode some frames of its films."""
    os.environ["HF_HUB_OFFLINE"] = "1"  # what is not in the folder is missing
    import numpy as np

    theirs: Any = import_module("lerobot.datasets.compute_stats")
    reader: Any = import_module("lerobot.datasets.lerobot_dataset")
    data = reader.LeRobotDataset("local/episodes", root=folder)
    meta = data.meta
    numeric = {key: f for key, f in meta.features.items() if f["dtype"] != "video"}
    table = data.hf_dataset.with_format("numpy")
    found: dict[str, Any] = {f"column/{key}": np.asarray(table[key]) for key in numeric}
    one_by_one = [data[i] for i in frames]  # as training asks for them
    for key in meta.features:
        found[f"item/{key}"] = np.array([np.asarray(item[key]) for item in one_by_one])
    found["item/task"] = np.array([item["task"] for item in one_by_one])
    episodes = meta.episodes
    per_episode = []
    for k in range(data.num_episodes):
        rows = slice(episodes[k]["dataset_from_index"], episodes[k]["dataset_to_index"])
        columns = {key: found[f"column/{key}"][rows] for key in numeric}
        per_episode.append(theirs.compute_episode_stats(columns, numeric))
    for key, made in theirs.aggregate_stats(per_episode).items():
        for name, values in made.items():
            found[f"theirs/{key}/{name}"] = values
            found[f"stored/{key}/{name}"] = np.asarray(meta.stats[key][name])
    np.savez(out, **found)
    known = {name: version(name) for name in PACKAGES}
    print(
        json.dumps({**known, "frames": len(data), "episodes": data.num_episodes, "fps": meta.fps})
    )


if __name__ == "__main__":
    read(sys.argv[1], sys.argv[2], [int(word) for word in sys.argv[3:]])
