"""Statistics of the features of a data set, by which LeRobot's policies normalise.

Per episode and feature: least and greatest value, mean, standard deviation, number of frames and
five quantiles; those of the data set follow from the episodes' as LeRobot makes them, quantiles as
means weighted by frames. LeRobot estimates an episode's quantiles by a histogram of 5000 bins;
here they are exact, which differs by less than a bin.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from planner.spatial import FloatArray
from sim.looking.painter import Pixels

Statistics: TypeAlias = dict[str, FloatArray]
"""Name of a statistic -> its values, one per number of the feature; "count" has one."""

QUANTILES = {"q01": 0.01, "q10": 0.10, "q50": 0.50, "q90": 0.90, "q99": 0.99}

LARGEST_PICTURE, SMALLER_PICTURE = 300, 150
"""Pictures at least so wide or high (pixels) are thinned to about the second size, as LeRobot does
before it looks at them."""


def of_columns(columns: Mapping[str, NDArray[Any]]) -> dict[str, Statistics]:
    """Statistics of every column (m,) or (m, n) of an episode."""
    return {key: _of_column(values) for key, values in columns.items()}


def _of_column(values: NDArray[Any]) -> Statistics:
    rows = values.reshape(len(values), -1).astype(np.float64)
    quantiles = np.quantile(rows, list(QUANTILES.values()), axis=0, method="inverted_cdf")
    return {
        "min": rows.min(axis=0),
        "max": rows.max(axis=0),
        "mean": rows.mean(axis=0),
        "std": rows.std(axis=0),
        "count": np.array([len(rows)]),
        **dict(zip(QUANTILES, quantiles, strict=True)),
    }


def of_pictures(pictures: Sequence[Pixels]) -> Statistics:
    """Statistics of pictures (height, width, 3), per colour, (3, 1, 1) each, in [0, 1]."""
    height, width, _ = pictures[0].shape
    step = 1
    if max(height, width) >= LARGEST_PICTURE:
        step = int((width if width > height else height) / SMALLER_PICTURE)
    counts = np.zeros((3, 256))
    for picture in pictures:
        for channel in range(3):
            counts[channel] += np.bincount(picture[::step, ::step, channel].ravel(), minlength=256)
    level = np.arange(256) / 255.0
    total = counts.sum(axis=1)
    mean = counts @ level / total
    variance = counts @ level**2 / total - mean**2
    below = counts.cumsum(axis=1)
    found = {
        "min": level[(counts > 0).argmax(axis=1)],
        "max": level[255 - (counts[:, ::-1] > 0).argmax(axis=1)],
        "mean": mean,
        "std": np.sqrt(np.maximum(variance, 0.0)),
        **{n: level[(below >= q * total[:, None]).argmax(axis=1)] for n, q in QUANTILES.items()},
    }
    shaped = {name: np.asarray(values).reshape(3, 1, 1) for name, values in found.items()}
    return {**shaped, "count": np.array([len(pictures)])}


def of_all(episodes: Sequence[Statistics]) -> Statistics:
    """Statistics of a feature over a data set from those of its episodes."""
    counts = np.array([one["count"][0] for one in episodes], dtype=np.float64)
    share = counts / counts.sum()

    def weighted(values: Sequence[FloatArray]) -> FloatArray:
        return np.asarray(np.tensordot(share, np.array(values), axes=1))

    mean = weighted([one["mean"] for one in episodes])
    variance = weighted([one["std"] ** 2 + (one["mean"] - mean) ** 2 for one in episodes])
    return {
        "min": np.min([one["min"] for one in episodes], axis=0),
        "max": np.max([one["max"] for one in episodes], axis=0),
        "mean": mean,
        "std": np.sqrt(variance),
        "count": np.array([int(counts.sum())]),
        **{name: weighted([one[name] for one in episodes]) for name in QUANTILES},
    }
