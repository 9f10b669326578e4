"""Grasp quality: pure functions of a ``ContactSet``, wherever its contacts come from."""

from __future__ import annotations

from planner.quality.ball import (
    HullMeasure,
    Interval,
    ball_interval,
    epsilon_frogger,
    epsilon_l1,
    epsilon_linf,
    epsilon_round,
    measure_hull,
    volume_l1,
)
from planner.quality.closure import (
    ClosureResult,
    RoundCones,
    closure_of_wrenches,
    force_closure,
    min_weight,
    plainly_closed,
    primitive_wrenches,
)
from planner.quality.report import (
    QualityReport,
    analyse,
    closure_and_epsilon,
    isotropy,
    singular_values,
    smallest_singular_value,
)

__all__ = [
    "ClosureResult",
    "HullMeasure",
    "Interval",
    "QualityReport",
    "RoundCones",
    "analyse",
    "ball_interval",
    "closure_and_epsilon",
    "closure_of_wrenches",
    "epsilon_frogger",
    "epsilon_l1",
    "epsilon_linf",
    "epsilon_round",
    "force_closure",
    "isotropy",
    "measure_hull",
    "min_weight",
    "plainly_closed",
    "primitive_wrenches",
    "singular_values",
    "smallest_singular_value",
    "volume_l1",
]
