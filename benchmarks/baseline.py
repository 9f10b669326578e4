"""FRoGGeR's figures, to compare with.

Li, Culbertson, Burdick, Ames, "FRoGGeR: Fast Robust Grasp Generation via the Min-Weight Metric",
IROS 2023; github.com/alberthli/frogger, commit f91157f. Measured by this project on two EPYC cores,
one thread, five grasps per object: its Allegro hand, floating, four contacts, mu 0.7, 1 mm
clearance, with the one correction that its contact points are taken in the frame in which Drake
gives them (as shipped a fifth of its grasps is not closed).
"""

from __future__ import annotations

from typing import Any

from benchmarks.statistics import median_of

BASELINE_RATE = 0.43
"""Grasps found per CPU second (1/s), over 42 objects."""

BASELINE_EPSILON = {
    "004_sugar_box": 0.104,
    "005_tomato_soup_can": 0.178,
    "006_mustard_bottle": 0.071,
    "010_potted_meat_can": 0.131,
    "011_banana": 0.101,
    "013_apple": 0.230,
    "043_phillips_screwdriver": 0.070,
    "048_hammer": 0.023,
    "054_softball": 0.219,
    "061_foam_brick": 0.189,
    "077_rubiks_cube": 0.212,
}
"""Median epsilon in its own definition (``planner.quality.ball.epsilon_frogger``), by object."""


def against_baseline(cells: list[dict[str, Any]], rate: float | None) -> dict[str, Any]:
    """Ratios to the baseline: of the rate over all cells, and of epsilon per object that it has.

    Args:
        cells: Summaries of cells (``benchmarks.synthesis``).
        rate: Found per CPU second over all of them.
    """
    ratios = {
        cell["object"]: cell["epsilon_frogger"]["median"] / BASELINE_EPSILON[cell["object"]]
        for cell in cells
        if cell["object"] in BASELINE_EPSILON and cell["found"]
    }
    return {
        "rate_ratio": None if rate is None else rate / BASELINE_RATE,
        "epsilon_ratio": ratios,
        "epsilon_ratio_median": median_of(ratios.values()),
        "epsilon_ratio_least": min(ratios.values(), default=None),
    }
