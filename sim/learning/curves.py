"""``draw_curves``: how often each round succeeded and how far it turned, as a picture."""

from __future__ import annotations

from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

SIZE, DPI = (7.0, 5.0), 100
"""Of the picture, inches, and dots per inch."""


def draw_curves(rows: Sequence[dict[str, Any]], path: Path) -> bool:
    """Draw the rows of ``progress.csv``; returns whether matplotlib is there to draw them.

    Args:
        rows: A row for each episode.
        path: The picture (PNG).
    """
    if find_spec("matplotlib") is None:
        return False
    from matplotlib.figure import Figure

    figure = Figure(figsize=SIZE, dpi=DPI, layout="constrained")
    rates, turns = figure.subplots(2, 1, sharex=True)
    numbers = sorted({row["round"] for row in rows})
    for key, label in (("success", "turned, not dropped"), ("strict", "with closure")):
        share = [np.mean([row[key] for row in rows if row["round"] == k]) for k in numbers]
        rates.plot(numbers, 100.0 * np.array(share), "o-", label=label)
    teacher = [next(row["teacher_share"] for row in rows if row["round"] == k) for k in numbers]
    rates.plot(numbers, 100.0 * np.array(teacher), ":", color="gray", label="teacher drives")
    rates.set(ylabel="% of episodes, or of time", ylim=(-3, 103))
    rates.legend(loc="lower left")
    rates.grid(alpha=0.3)
    known = [row for row in rows if np.isfinite(row["turned_deg"])]
    spread = [0.6 * (row["episode"] % 7 / 7.0 - 0.5) for row in known]
    turns.scatter(
        [row["round"] + s for row, s in zip(known, spread, strict=True)],
        [row["turned_deg"] for row in known],
        s=9,
        c=["C2" if row["strict"] else "C3" for row in known],
    )
    turns.set(
        xlabel="round; 0 is the playback alone",
        ylabel="turned, degrees\n(green: with closure)",
        xticks=numbers,
    )
    turns.grid(alpha=0.3)
    figure.savefig(path)
    return True
