"""Area under the ROC curve: how well a number tells successes from failures.

It is the chance that a success has the larger number of a success and a failure drawn at random,
ties counting half: 0.5 is guessing, 1 is perfect, below 0.5 the sign is wrong. (Mann and Whitney's
U over the number of pairs.)
"""

from __future__ import annotations

import math
from collections.abc import Hashable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import mannwhitneyu

from planner.spatial import FloatArray


@dataclass(frozen=True, kw_only=True)
class Auc:
    """An area under the ROC curve.

    Attributes:
        area: In [0, 1].
        error: Standard error (Hanley and McNeil, Radiology 143, 1982, equation 1); None for pairs
            within groups, which that does not cover.
        pairs: Pairs of a success and a failure that were compared.
    """

    area: float
    error: float | None
    pairs: int


def auc(
    values: FloatArray, success: Sequence[bool], groups: Sequence[Hashable] | None = None
) -> Auc | None:
    """The area for values (n,), larger meaning better; None without a pair to compare.

    Args:
        values: The predictor.
        success: What happened, n.
        groups: Compare only within these, n; all with all if None.
    """
    won = np.asarray(success, dtype=bool)
    wins, pairs = 0.0, 0
    labels = [None] * len(won) if groups is None else list(groups)
    for label in dict.fromkeys(labels):
        here = np.array([g == label for g in labels])
        good, bad = values[here & won], values[here & ~won]
        if len(good) and len(bad):
            wins += float(mannwhitneyu(good, bad, method="asymptotic").statistic)
            pairs += len(good) * len(bad)
    if not pairs:
        return None
    area = wins / pairs
    n_good = int(won.sum())
    error = None if groups is not None else _error(area, n_good, len(won) - n_good)
    return Auc(area=area, error=error, pairs=pairs)


def _error(area: float, n_good: int, n_bad: int) -> float:
    q1, q2 = area / (2 - area), 2 * area**2 / (1 + area)
    variance = (
        area * (1 - area) + (n_good - 1) * (q1 - area**2) + (n_bad - 1) * (q2 - area**2)
    ) / (n_good * n_bad)
    return math.sqrt(max(0.0, variance))
